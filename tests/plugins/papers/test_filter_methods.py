"""Forms of the update and methods beside the Kalman filter: rows #37 and #38 of the register."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy import stats

from bench.core.mathematics import rotation
from bench.core.mathematics.earth import difference_n
from bench.experiments.studies.linear_flight import GRADES, LinearFlight, update
from bench.navigation.models.classic import Classic22, process_model, square_root
from bench.navigation.models.classic.covariance_forms import Joseph, make_form
from bench.navigation.options import ClassicOptions
from bench.plugins.papers import given_gains
from bench.simulation import sensors
from tests.weaving import units, weaving

FLIGHT, GRADE = LinearFlight(), GRADES["grade-3"]
NAV = FLIGHT.place(0.0)[0]


@pytest.fixture(scope="module")
def minutes():
    """Two minutes of the weaving flight at 50 Hz, fixes and barometer at 1 Hz both."""
    spec = units()
    spec = replace(spec, baro=replace(spec.baro, rate=1.0), output_rate=2.0)
    spec = replace(spec, assumed=replace(spec.assumed, baro=spec.baro))
    return sensors.sense(weaving(120.0, rate=50.0), spec, 1, 0)


@pytest.fixture(scope="module")
def coarse(minutes):
    """What Joseph's form in double says of them, with a step of the covariance twice a second."""
    return Classic22(covariance_hz=2.0).run(minutes.data, minutes.initial)


def bierman(x, S, h, z, r):
    """Bierman's update of a root, for tests of all three."""
    d = np.diag(S)
    x, U, D = square_root.bierman(x, S / d, d * d, h, z, r)
    return x, U * np.sqrt(D)


FORMS = (square_root.potter, square_root.carlson, bierman)


@pytest.mark.parametrize("form", FORMS)
def test_37_square_root_forms_are_josephs(form):
    """#37: seven rows of a linear flight a row at a time; x and P of Joseph's form to 1e-9 of sigma."""
    P = FLIGHT.start(GRADE)
    for k in range(1, 31):
        Phi, G = FLIGHT.move(GRADE.sigmas, k)
        P = Phi @ P @ Phi.T + G @ G.T
    H, R = FLIGHT.measure(GRADE.sigmas, 31)
    Y = np.random.default_rng(3).standard_normal(7)
    K, _, joseph = update(P, H, R)
    x, S = np.zeros(22), square_root.triangular_root(square_root.root_columns(P))
    assert_allclose(S @ S.T, P, rtol=1e-9, atol=1e-12)
    for k in range(7):
        x, S = form(x, S, H[k], Y[k], R[k, k])
        if form is not square_root.potter:
            assert not np.tril(S, -1).any()
    sd = np.sqrt(np.diag(P))
    assert_allclose(x / sd, K @ Y / sd, rtol=0, atol=1e-9)
    assert_allclose(S @ S.T / np.outer(sd, sd), joseph / np.outer(sd, sd), rtol=0, atol=1e-9)


@pytest.mark.parametrize("form", FORMS)
def test_37_half_the_digits_are_enough_for_a_square_root_and_not_for_p(form):
    """#37: two nearly equal rows in float32 (Bierman's example): P - K h P turns singular, S S' does not.

    Its smaller variance is that of float64 to 1 %; without a root both are lost, the larger by a half.
    """
    one, eps, r = np.float32(1.0), np.float32(1e-3), np.float32(1e-8)
    P, exact = np.eye(2, dtype=np.float32), np.eye(2)
    x, S = np.zeros(2, np.float32), np.eye(2, dtype=np.float32)
    for h in np.array([[one, one], [one, one + eps]], np.float32):
        Ph = P @ h
        P = P - np.outer(Ph, Ph) / (h @ Ph + r)
        x, S = form(x, S, h, 0.5, float(r))
        wide = h.astype(float)
        exact = exact - np.outer(exact @ wide, exact @ wide) / (wide @ exact @ wide + float(r))
    assert S.dtype == x.dtype == P.dtype == np.float32
    kept = S.astype(float) @ S.astype(float).T
    true = np.linalg.eigvalsh(exact)
    assert_allclose(np.linalg.eigvalsh(kept), true, rtol=0.01)
    lost = np.linalg.eigvalsh(P.astype(float))
    assert lost[0] <= 0
    assert lost[1] < 0.6 * true[1]


def apart(found, sound):
    """Largest difference of two solutions in standard deviations, and of these deviations."""
    sd, other = (np.sqrt(np.einsum("kii->ki", one.cov)) for one in (sound, found))
    turned = rotation.to_rotvec(rotation.multiply(found.q_nb, rotation.conjugate(sound.q_nb)))
    off = np.hstack([difference_n(found.lla, sound.lla), found.vel_n - sound.vel_n, turned])
    return np.abs(off / sd).max(), np.abs(other / sd - 1).max()


@pytest.mark.parametrize(
    ("precision", "form", "estimate", "deviation"),
    [
        *(("double", form, 1e-6, 1e-9) for form in ("conventional", "potter", "carlson", "ud")),
        *(("single", form, 3e-2, 1e-2) for form in ("joseph", "conventional")),
        *(("single", form, 3e-3, 3e-4) for form in ("potter", "carlson", "ud")),
    ],
)
def test_37_the_filter_flies_with_each_form(minutes, coarse, precision, form, estimate, deviation):
    """#37: two minutes of classic-22 with step and update in each form, beside Joseph's in double.

    In single precision the roots hold an order of magnitude more of P than P itself.
    """
    one = Classic22(form=form, covariance_precision=precision, covariance_hz=2.0)
    found = one.run(minutes.data, minutes.initial)
    assert (found.lla != coarse.lla).any()
    off, of_sd = apart(found, coarse)
    assert off < estimate
    assert of_sd < deviation


def step_in_half_the_digits(form, steps=60):
    """Smallest eigenvalue of the scaled P of one form in single precision: fixes a thousand times finer."""
    sig = replace(GRADE.sigmas, white=(1e-3, 1e-3, 1e-5), markov=(6.0, 8.5, 0.1), h=1e-3)
    options = ClassicOptions(form=form, covariance_precision="single")
    kept, low = make_form(options, FLIGHT.start(GRADE)), 1.0
    for k in range(1, steps):
        Phi, G = FLIGHT.move(sig, k)
        kept.predict(Phi, G @ G.T, 1.0)
        H, R = FLIGHT.measure(sig, k)
        kept.update(np.zeros(len(H)), H, R, list(range(len(H))), NAV)
        variance = np.diag(kept.covariance)
        if not (variance > 0).all():
            return -1.0
        sd = np.sqrt(variance)
        low = min(low, np.linalg.eigvalsh(kept.covariance / np.outer(sd, sd))[0])
    return low


def test_37_in_single_precision_the_roots_survive_fine_fixes():
    """#37: a linear flight with fixes of a millimeter: U D, Potter, Carlson stay positive, P - K H P not."""
    assert step_in_half_the_digits("conventional") < 0
    for form in ("potter", "carlson", "ud"):
        assert step_in_half_the_digits(form) > -1e-9


# --- #38: the methods beside the Kalman filter -------------------------------------------------------------


def other_methods(runs=20, seconds=900, seed=9):
    """RMS of the corrected INS after 300 s, position [m] and velocity [m/s], by method (A 4, #38).

    Each corrects the same INS errors, without feedback, by the same measurements.
    """
    rng = np.random.default_rng(seed)
    sig, P, meters = GRADE.sigmas, FLIGHT.start(GRADE), np.ones(22)
    meters[[0, 16]], meters[[1, 17]] = FLIGHT.reduced
    settled = given_gains.settle_gain(P / np.outer(meters, meters), NAV, sig, (1.0, 1.0))
    methods = {
        "kalman": make_form(ClassicOptions(), P),
        "fixed-gain": given_gains.ConstantGain(P, settled),
        "complementary": given_gains.CompensatedDifferences(P, (1.0, 1.0), 10.0),
        "least-squares": given_gains.FadingFit(P, sig, 60.0),
    }
    x = np.sqrt(np.diag(P))[:, None] * rng.standard_normal((22, runs))
    for form in methods.values():
        form.x = np.zeros((22, runs))
    squares, claimed = (dict.fromkeys(methods, 0.0) for _ in range(2))
    for k in range(1, seconds + 1):
        Phi, G = FLIGHT.move(sig, k)
        x = Phi @ x + G @ rng.standard_normal((process_model.NOISES, runs))
        H, R = FLIGHT.measure(sig, k)
        z = H @ x + np.sqrt(np.diag(R))[:, None] * rng.standard_normal((7, runs))
        here = FLIGHT.place(float(k))[0]
        for name, form in methods.items():
            step(form, Phi, G @ G.T, 1.0)
            use(form, z, H, R, here)
            if k > 300:
                off = (form.x - x)[:6] / meters[:6, None]
                squares[name] = squares[name] + np.mean(off**2, axis=1)
                claimed[name] = claimed[name] + (np.diag(form.covariance) / meters**2)[:6]
    return {
        name: [
            math.sqrt(v[part].sum() / (seconds - 300)) for v in (squares[name], claimed[name])
            for part in (slice(0, 3), slice(3, 6))
        ]
        for name in methods
    }  # fmt: skip


def step(form, Phi, Q, T):
    """Step a form, Joseph's on the many columns that filterpy has no room for."""
    if isinstance(form, Joseph):
        many, form.x = form.x, np.zeros(22)
        form.predict(Phi, Q, T)
        form.x = Phi @ many
    else:
        form.predict(Phi, Q, T)


def use(form, z, H, R, nav):
    """Use measurements, a column for each flight."""
    if isinstance(form, Joseph):
        many, form.x = form.x, np.zeros(22)
        form.update(np.zeros(7), H, R, list(range(7)), nav)
        form.x = many + form.kf.K @ (z - H @ many)
    else:
        form.update(z, H, R, list(range(7)), nav)


def test_38_the_kalman_filter_is_no_worse_than_the_other_methods():
    """#38: 20 seeds of 900 s; velocities of the others are worse by a fifth or more, and each knows its own.

    What a filter reports of its velocity is within the 99.9 % band of 20 flights, taken with the 20 degrees
    of freedom that one error a flight has.
    """
    found = other_methods()
    best = found["kalman"]
    low, high = np.sqrt(stats.chi2.ppf([0.0005, 0.9995], 20) / 20)
    for name, (position, velocity, _, claimed) in found.items():
        assert low < velocity / claimed < high, (name, velocity, claimed)
        if name != "kalman":
            assert best[0] <= position, (name, best, position)
            assert 1.2 * best[1] <= velocity, (name, best, velocity)


def close_loop(form, course):
    """Return (I - K H) Phi (22, 22) of a second of straight flight, and the navigator there."""
    flight = LinearFlight(turns=False, course=course)
    nav = flight.place(10.0)[0]
    Phi, H, R = flight.move(GRADE.sigmas, 10)[0], *flight.measure(GRADE.sigmas, 10)
    return (np.eye(22) - form.find_gain(H, R, list(range(7)), nav) @ H) @ Phi, nav


@pytest.mark.parametrize("course", [0.0, 0.8, 2.5, -1.2])
@pytest.mark.parametrize("seconds", [4.0, 10.0])
def test_38_every_loop_of_the_complementary_filter_has_two_poles_where_they_are_meant(course, seconds):
    """#38: exp(-T / time constant), whatever the course: a velocity and its tilt, the vertical velocity and
    the upward accelerometer, height and the bias of the barometer; position alone has one.
    """
    form = given_gains.CompensatedDifferences(FLIGHT.start(GRADE), (1.0, 1.0), seconds)
    M, nav = close_loop(form, course)
    z, basis = math.exp(-1.0 / seconds), np.eye(22)
    upward = np.zeros(22)
    upward[12:15] = nav.B[2]
    for pair in ((basis[3], basis[7]), (basis[4], basis[6]), (basis[5], upward), (basis[2], basis[15])):
        loop = np.array([[a @ M @ b for b in pair] for a in pair])
        assert np.trace(loop) == pytest.approx(2.0 * z, rel=1e-3)
        assert np.linalg.det(loop) == pytest.approx(z * z, rel=1e-3)
    assert_allclose(np.diag(M)[:2], z, rtol=1e-5)
    assert np.abs(np.linalg.eigvals(M)).max() < 1.0 + 1e-6


def test_38_the_fixed_gain_turns_with_the_course():
    """#38: the closed loop has the same poles on every course, nine of them inside the unit circle."""
    meters = np.ones(22)
    meters[[0, 16]], meters[[1, 17]] = FLIGHT.reduced
    P = FLIGHT.start(GRADE)
    settled = given_gains.settle_gain(P / np.outer(meters, meters), NAV, GRADE.sigmas, (1.0, 1.0))
    form = given_gains.ConstantGain(P, settled)
    poles = [
        np.sort(np.abs(np.linalg.eigvals(close_loop(form, course)[0]))) for course in (0.0, 0.8, 2.5, -1.2)
    ]
    for found in poles:
        assert_allclose(found[:8], poles[0][:8], rtol=2e-3)
        assert found[8] < 0.995
        assert found[-1] < 1.0 + 1e-6


def test_38_the_fading_fit_is_the_batch_solution():
    """#38: carried on from fix to fix, it is the least squares of all measurements at once, to 1e-8."""
    rng = np.random.default_rng(4)
    sig, P = GRADE.sigmas, FLIGHT.start(GRADE)
    fit, kept = given_gains.FadingFit(P, sig, 20.0), math.exp(-1 / 20.0)
    n = 16
    sd = np.sqrt(np.diag(P))[:n]
    now = np.eye(n)  # Phi from the start
    rows, seen, weights = [now], [np.zeros(n)], [1 / sd**2]
    for k in range(1, 31):
        Phi = FLIGHT.move(sig, k)[0]
        H, R = FLIGHT.measure(sig, k)
        now = Phi[:n, :n] @ now
        z = rng.standard_normal(7)
        east, north = FLIGHT.reduced
        spread = process_model.per_axis(sig.markov) * [east, north, 1, 1, 1, 1]
        rows += [now, H[:, :n] @ now]
        seen += [Phi[:n, :n] @ fit.x[:n], z]  # P0 keeps its weight about what is assumed
        weights = [kept * w for w in weights]
        weights += [(1 - kept) / sd**2, 1 / (np.diag(R) + np.append(0.0, spread) ** 2)]
        fit.predict(Phi, np.zeros((22, 22)), 1.0)
        fit.update(z, H, R, list(range(7)), FLIGHT.place(float(k))[0])
        A, b = np.vstack(rows), np.concatenate(seen)
        w = np.sqrt(np.concatenate(weights))
        first = np.linalg.lstsq((A * w[:, None]) * sd, b * w, rcond=None)[0] * sd
        assert_allclose(fit.x[:n] / sd, now @ first / sd, rtol=0, atol=1e-8)


def metric_start():
    """Return the covariance of the start in meters, and of each state its meters."""
    meters = np.ones(22)
    meters[[0, 16]], meters[[1, 17]] = FLIGHT.reduced
    return FLIGHT.start(GRADE) / np.outer(meters, meters), meters


@pytest.mark.parametrize("rates", [(1.0, 1.0), (0.0, 2.0)])
def test_38_the_settled_gain_is_that_of_the_information_filter(rates):
    """#38: the inverse of P is carried on, without the states of the IMU, whose errors are noise."""
    sig, (P, meters) = GRADE.sigmas, metric_start()
    K, T = given_gains.settle_gain(P, NAV, sig, rates), 1.0 / max(rates)
    kept = np.setdiff1d(np.arange(22), np.arange(9, 15))
    part = np.ix_(kept, kept)
    speed = math.hypot(*NAV.V[:2])
    north = replace_nav(NAV, np.array([0.0, speed, 0.0]))
    earth = given_gains.ellipsoid(NAV.lat, NAV.h)
    Phi, Q = process_model.model_van_loan(north, earth, [0.0, 0.0, earth.g], sig, T)
    Phi, Q, P = (Phi * meters / meters[:, None])[part], (Q / np.outer(meters, meters))[part], P[part]
    Q[range(3, 9), range(3, 9)] += 10.0 * T * np.repeat([sig.da**2, sig.eps**2], 3)
    H = given_gains.measurement_matrix()[:7]
    root = given_gains.measurement_noise(sig, 1.0, 1.0, False)[:7]
    weight, h = 1.0 / np.diag(root @ root.T), H[:, kept]
    weight[1:] *= rates[0] > 0.0
    for _ in range(round(300 / T)):
        P = Phi @ P @ Phi.T + Q
        fixed = np.linalg.inv(np.linalg.inv(P) + h[1:].T * weight[1:] @ h[1:])
        P = np.linalg.inv(np.linalg.inv(fixed) + h[:1].T * weight[0] @ h[:1])
    expected = np.column_stack([P @ h[:1].T * weight[0], fixed @ h[1:].T * weight[1:]])
    assert_allclose(K[kept], expected, rtol=1e-5, atol=1e-7)
    assert not K[9:15].any()


def test_38_a_given_gain_leaves_what_the_errors_and_the_noise_make_of_it():
    """#38: one reading of one state, K = 1/4, P = 9 and R = 4: 9 (3/4)^2 + 4 / 4^2; then 4 more."""
    K = np.zeros((22, 7))
    K[2, 0] = 0.25
    form = given_gains.ConstantGain(np.diag(np.where(np.arange(22) == 2, 9.0, 1.0)), K)
    form.update(np.array([2.0]), np.eye(22)[2:3], np.array([[4.0]]), [0], NAV)
    assert form.x[2] == pytest.approx(0.5)
    assert form.covariance[2, 2] == pytest.approx(5.3125)
    form.add(2.0 * np.eye(22)[:, 2:3])
    form.predict(2.0 * np.eye(22), np.eye(22), 1.0)
    assert form.covariance[2, 2] == pytest.approx(4.0 * 9.3125 + 1.0)
    assert form.covariance[0, 0] == pytest.approx(5.0)


def replace_nav(nav, V):
    """Return a navigator that flies level to the north."""
    return given_gains.Nav(nav.lat, nav.lon, nav.h, V, np.array([[0.0, 0, 1], [1, 0, 0], [0, 1, 0]]))


def test_38_the_settled_gain_by_its_rates_and_course():
    """#38: four readings between two fixes are one of half the noise; what has no rate has no gain."""
    sig, (P, _) = GRADE.sigmas, metric_start()

    def settle(rates, sig=sig, nav=NAV):
        return given_gains.settle_gain(P, nav, sig, rates)

    four, one = settle((1.0, 4.0)), settle((1.0, 1.0), replace(sig, h=0.5 * sig.h))
    assert_allclose(four[:, 0], one[:, 0] / 4.0, rtol=1e-9, atol=1e-12)
    assert_allclose(four[:, 1:], one[:, 1:], rtol=1e-9, atol=1e-12)
    assert not settle((0.0, 2.0))[:, 1:].any()
    assert settle((0.0, 2.0))[2, 0] > 0.0
    assert not settle((2.0, 0.0))[:, 0].any()
    assert not settle((0.0, 0.0)).any()
    speed = math.hypot(*NAV.V[:2])
    east, north = (
        settle((1.0, 1.0), nav=replace_nav(NAV, np.array(V))) for V in ([speed, 0, 0.0], [0, speed, 0.0])
    )
    assert_allclose(east, north, rtol=1e-12)


def test_38_rates_are_those_of_what_was_recorded(minutes):
    data = minutes.data
    specs = replace(
        data.specs, gnss=replace(data.specs.gnss, rate=5.0), baro=replace(data.specs.baro, rate=2.0)
    )
    data = replace(data, specs=specs)
    assert given_gains.find_rates(data) == (5.0, 2.0)
    assert given_gains.find_rates(replace(data, baro=None)) == (5.0, 0.0)
    assert given_gains.find_rates(replace(data, fixes=None)) == (0.0, 2.0)
    assert given_gains.find_rates(replace(data, specs=replace(specs, gnss=None, baro=None))) == (0.0, 0.0)


def test_38_the_fading_fit_by_parts():
    """#38: half a second twice is a second, the barometer before the fix is both; what is known stays so."""
    sig, P = GRADE.sigmas, FLIGHT.start(GRADE)
    P[14], P[:, 14] = 0.0, 0.0
    whole, parts = given_gains.FadingFit(P, sig, 20.0), given_gains.FadingFit(P, sig, 20.0)
    rng, none, sd = np.random.default_rng(5), np.zeros((22, 22)), np.sqrt(np.diag(FLIGHT.start(GRADE)))
    for k in range(1, 6):
        Phi, (H, R) = FLIGHT.move(sig, k)[0], FLIGHT.measure(sig, k)
        z, nav, rows = rng.standard_normal(7), FLIGHT.place(float(k))[0], list(range(7))
        whole.predict(Phi @ Phi, none, 1.0)
        whole.update(z, H, R, rows, nav)
        for _ in range(2):
            parts.predict(Phi, none, 0.5)
        for some in ([0], rows[1:]):
            parts.update(z[some], H[some], R[np.ix_(some, some)], some, nav)
        assert_allclose(parts.x / sd, whole.x / sd, rtol=0, atol=1e-8)
        assert parts.age == 0.0
        assert parts.x[14] == 0.0
        assert not parts.x[16:].any(), "the Markov errors of GNSS are noise to it"
