"""gnss-only: Singer's model in closed form, consistent in its own world and in a flight; #48.

Register #48, extrapolation between 1 Hz fixes: an INS leaves less than 0.05 m, a receiver alone several
times that.
"""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import mpmath
import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy import stats

import bench
from bench.core.mathematics import earth
from bench.core.records.data import GnssFixes, Trajectory, no_air, no_controls, no_events
from bench.core.records.specs import EvaluationWindow
from bench.core.words.exceptions import EstimatorError
from bench.evaluation.errors.error_series import error_series
from bench.evaluation.metrics import run_metrics
from bench.navigation.built_in import load
from bench.navigation.engine.gate import DRIFTED, LOST, REFUSED, SOUND, InnovationGate, growth
from bench.navigation.models.gnss_only import GnssOnly
from bench.navigation.models.loose_tight import Loose
from bench.navigation.options import GnssOnlyOptions
from bench.navigation.start.fix_track import FixTrack
from bench.navigation.start.singer import singer_kernel, track_work
from bench.simulation import sensors
from tests.builders import band, student
from tests.weaving import GNSS, units, weaving


def singer(T, sd, tau):
    """Phi and Q (3, 3) of one axis."""
    work = track_work()
    singer_kernel(T, sd, tau, work)
    return work.Phi, work.Q


@pytest.mark.parametrize("T", [1e-6, 1e-3, 0.1, 1.0, 9.0, 60.0, 600.0])
def test_singers_transition_and_noise_are_those_of_van_loan(T):
    """By one matrix exponential (C. F. van Loan, IEEE Trans. AC-23 (3), 1978), taken with 100 digits.

    The bound is that of rounding. T is halved until x = T / tau is below 1. There x - (1 - exp(-x)) magnifies
    rounding by 2 / x, or the series for x below 1e-4 leaves x^3 / 60 out. All terms are positive, so each
    doubling back to T at most doubles the relative error.
    """
    sd, tau = 3.0, 10.0
    M = mpmath.zeros(6)
    with mpmath.workdps(100):
        for row, column, value in [(0, 1, -1), (1, 2, -1), (2, 2, 1 / mpmath.mpf(tau))]:
            M[row, column], M[3 + column, 3 + row] = value, -value
        M[2, 5] = 2 * sd**2 / mpmath.mpf(tau)
        E = mpmath.expm(M * T)
        Phi = E[3:, 3:].T
        Q = Phi * E[:3, 3:]
    doublings = max(0, int(np.ceil(np.log2(T / tau))))
    x = T / tau / 2**doublings
    lost = 2.0 / x if x >= 1e-4 else 0.0
    bound = 2**doublings * (32 * np.finfo(float).eps * (1.0 + lost) + 1e-12 / 60)
    for found, exact in zip(singer(T, sd, tau), (Phi, Q), strict=True):
        assert_allclose(found, np.array(exact.tolist(), float), rtol=bound, atol=0)


def plain_track(options, t, x, P, fixes, r, output):
    """A Kalman filter of whole matrices over a plane: x and P at the outputs, innovations and verdicts."""
    gate = InnovationGate(("gnss_position", "gnss_velocity"), t, options.gate_probability, 3.0)
    found, now, verdicts = {}, t, []

    def carry(T):
        Phi, Q = (np.kron(one, np.eye(3)) for one in singer(T, options.acceleration, options.correlation_s))
        return Phi @ x, Phi @ P @ Phi.T + Q

    for k, at in sorted([*enumerate(fixes[0]), *((None, one) for one in output)], key=lambda one: one[1]):
        if k is None:
            found[at] = carry(at - now)
            continue
        (x, P), now = carry(at - now), at
        H, y = np.eye(6, 9), fixes[1][k] - x[:6]
        if np.isfinite(y).all():
            gate.see_fix(at, y, H @ P @ H.T + np.diag(r[k]), r[k, :3])
        else:
            gate.see_position()
        for code in range(2):
            part = slice(3 * code, 3 * code + 3)
            e, Hc, R = fixes[1][k][part] - x[part], H[part], np.diag(r[k, part])
            if not np.isfinite(e).all():
                continue
            S = Hc @ P @ Hc.T + R
            nis = e @ np.linalg.solve(S, e)
            verdict = gate.decide(at, code, e, np.diag(S), nis, sound=nis <= gate.limits[3])
            verdicts.append((code, verdict))
            if verdict == REFUSED:
                continue
            if verdict != SOUND:
                E = growth(verdict, P @ Hc.T @ np.linalg.solve(S, e), Hc, e, np.arange(9) // 3 == code)
                P = P + E @ E.T
            K = P @ Hc.T @ np.linalg.inv(Hc @ P @ Hc.T + R)
            x, P = x + K @ e, (np.eye(9) - K @ Hc) @ P @ (np.eye(9) - K @ Hc).T + K @ R @ K.T
    return found, gate.take(last=True)[0], verdicts


def test_a_track_of_fixes_is_a_kalman_filter_of_whole_matrices():
    """Without velocity, rejected, re-admitted after 3 s, and after an outage; one comes twice."""
    options, rng = (
        GnssOnlyOptions(acceleration=2.0, correlation_s=5.0, readmit_after_s=3.0),
        np.random.default_rng(4),
    )
    t = np.array([1.0, 2.0, 2.5, 4.0, 5.0, 6.0, 7.0, 8.0, 9.5, 25.0, 26.0, *range(27, 33)])
    rows = np.column_stack([7.0 * t, -4.0 * t, 2.0 * t, *np.tile([[7.0], [-4.0], [2.0]], len(t))])
    rows += rng.normal(size=rows.shape) * [3, 3, 5, 0.3, 0.3, 0.4]
    rows[4:, :3] += [300.0, -200.0, 50.0]  # the receiver steps
    rows[9:, :3] += [2500.0, 0.0, 0.0]  # the aircraft has gone another way
    rows[9:, 3:] += [150.0, 0.0, 0.0]
    rows[11:, 1] += 50.0 * (t[11:] - 27.0)  # and turns at once
    rows[11:, 4] += 50.0
    rows[2, 3] = rows[3, 4] = rows[7, 3] = rows[10, 5] = np.nan  # a velocity in part is none
    r = rng.uniform(0.5, 2.0, (len(t), 6)) * np.square([3, 3, 5, 0.3, 0.3, 0.4])
    origin, root = np.array([0.8, 0.2, 500.0]), rng.normal(size=(6, 6))
    x, cov = np.concatenate([[5.0, -6.0, 7.0, 7.3, -4.2, 1.7, 0, 0, 0]]), root @ root.T + np.eye(6)
    output = np.array([0.5, 1.5, 3.0, 5.5, 8.5, 9.0, 9.75, 25.5, 26.5, 33.0])
    lla = earth.displace(np.tile(origin, (len(t), 1)), rows[:, :3])
    track = FixTrack(options, 0.5, earth.displace(origin, x[:3]), x[3:6], cov)
    late = np.array([*range(3), 1, *range(3, len(t))])  # one comes once more, and changes nothing
    sound = np.ones(len(t), np.bool_)
    fixes = GnssFixes(
        t, t, sound, lla, rows[:, 3:], np.zeros((len(t), 3, 3)), np.zeros((len(t), 3, 3)), 10 * sound
    )
    found, P = track.run(fixes, late, r, np.searchsorted(output, t[late]), output)
    start = np.zeros((9, 9))
    start[:6, :6], start[6:, 6:] = cov, 4.0 * np.eye(3)
    wanted, table, verdicts = plain_track(options, 0.5, x, start, (t, rows), r, output.tolist())
    assert set(verdicts) > {(0, REFUSED), (0, DRIFTED), (0, LOST), (1, REFUSED), (1, LOST)}
    for k, at in enumerate(output.tolist()):
        plane = np.concatenate([earth.difference_n(found[k, :3], origin), found[k, 3:]])
        assert_allclose(plane, wanted[at][0], rtol=1e-4, atol=0.05)
        sd = np.sqrt(np.diag(wanted[at][1]))
        assert_allclose(P[k] / np.outer(sd, sd), wanted[at][1] / np.outer(sd, sd), rtol=0, atol=2e-3)
    innovations = track.take_innovations()
    for name in ("t", "code", "component", "accepted"):
        np.testing.assert_array_equal(getattr(innovations, name), getattr(table, name))
    assert_allclose(innovations.S, table.S, rtol=2e-3)
    assert_allclose(innovations.z, table.z, rtol=1e-3, atol=0.05)
    assert_allclose(innovations.nis, table.nis, rtol=1e-2, atol=1e-2)
    assert len(track.take_innovations()) == 0
    assert track.t == 32.0
    assert np.isnan(track.at([31.9])[0]).all()
    assert np.isfinite(track.at([32.0])[0]).all()


@cache
def manoeuvring(seconds, sd, tau, seed, rate=10.0):
    """A truth that follows the model itself: nothing else of it is seen."""
    rng = np.random.default_rng(seed)
    n = round(seconds * rate)
    Phi, Q = singer(1 / rate, sd, tau)
    root = np.linalg.cholesky(Q)
    x = np.zeros((3, 3))  # position, velocity, acceleration by axis
    x[1], x[2] = [30.0, 10.0, 0.0], sd * rng.standard_normal(3)
    lla, vel = [np.array([0.8, 0.2, 5000.0])], [x[1].copy()]
    for _ in range(n):
        x[0] = 0.0
        x = Phi @ x + root @ rng.standard_normal((3, 3))
        lla.append(earth.displace(lla[-1], x[0]))
        vel.append(x[1].copy())
    t = np.arange(n + 1) / rate
    q = np.tile([1.0, 0, 0, 0], (n + 1, 1))
    rows = (np.array(lla), np.array(vel), q, np.zeros((n, 3)), np.zeros((n, 3)))
    return Trajectory(t, *rows, no_air(), no_controls(), no_events())


def ensemble(runs, believed, spec=None):
    """Mean NEES of each run and mean NIS of all, the antenna at the IMU."""
    spec = replace(spec or units(baro=None), antenna_b=(0.0, 0.0, 0.0))
    nees, nis = [], []
    for run in range(runs):
        truth = manoeuvring(40.0, 3.0, 10.0, seed=run)
        sensed = sensors.sense(truth, spec, 7, run)
        solution = GnssOnly(acceleration=believed).run(sensed.data, sensed.initial)
        errors = error_series(truth, solution)
        assert errors.states == 6
        nees.append(errors.nees[errors.t >= 10.0].mean())
        nis.append(solution.innovations.nis[solution.innovations.component == 0])
    return np.array(nees), np.concatenate(nis)


@pytest.mark.parametrize("latency", [0.0, 0.3])
def test_it_is_consistent_in_the_world_it_believes_in(latency):
    """25 runs: NEES of six states and NIS in their 99.9 % bands; late fixes too."""
    late = replace(GNSS, latency=latency)
    nees, nis = ensemble(25, 3.0, units(gnss=late, baro=None))
    assert abs(nees.mean() - 6.0) < student(25) * nees.std(ddof=1) / np.sqrt(25)
    low, high = band(len(nis), states=3)
    assert low < nis.mean() < high


def test_a_world_twice_as_wild_is_seen():
    nees, nis = ensemble(20, 1.5)
    assert (nees.mean() - 6.0) > student(20) * nees.std(ddof=1) / np.sqrt(20)
    assert nis.mean() > band(len(nis), states=3)[1]


@pytest.fixture(scope="module")
def flight():
    """A minute and a half, with an answer at 10 Hz."""
    truth = weaving(90.0, rate=100.0)
    return truth, sensors.sense(truth, units(baro=None), 1, 0)


def test_in_a_flight_it_covers_its_errors_and_says_nothing_of_attitude(flight):
    truth, sensed = flight
    solution = GnssOnly().run(sensed.data, sensed.initial)
    bench.check_estimator(GnssOnly(), sensed.data, sensed.initial)
    _, judged = run_metrics.measure(truth, solution, evaluation=EvaluationWindow(10.0), outages=())
    assert judged["converged"]
    assert judged["nees_states"] == 6
    most = stats.binom.ppf(0.999, 80, 2 * stats.norm.sf(3.0)) / 80  # of what the 80 fixes allow
    for axis in "ned":
        assert 1.0 - judged[f"coverage_3sigma_pos_{axis}"] <= most
        assert 1.0 - judged[f"coverage_3sigma_vel_{axis}"] <= most
    assert "heading_rmse_deg" not in judged
    assert np.isnan(solution.q_nb).all()


def test_the_antenna_in_an_unknown_direction_is_part_of_what_it_does_not_know(flight):
    _, sensed = flight
    arm = np.array([3.0, 0.0, 0.0])
    far = GnssOnly().run(replace(sensed.data, antenna_b=arm), sensed.initial)
    near = GnssOnly().run(replace(sensed.data, antenna_b=0 * arm), sensed.initial)
    assert_allclose(far.cov[:, 0, 0] - near.cov[:, 0, 0], 3.0, rtol=1e-9)
    assert_allclose(far.cov[:, 3, 3] - near.cov[:, 3, 3], 0.03, rtol=1e-6)


def test_48_an_ins_carries_on_between_fixes_where_a_receiver_alone_cannot(flight):
    """#48: how far the error moves from one fix to just before the next; and 10 Hz lines against 100 Hz."""
    truth, sensed = flight
    data = replace(sensed.data, output_t=truth.t)  # at 100 Hz
    moved = {}
    for name, estimator in {"ins": Loose(), "receiver": GnssOnly()}.items():
        solution = estimator.run(data, sensed.initial)
        pos = error_series(truth, solution).pos_n
        fixes = np.flatnonzero(np.abs(solution.t - np.round(solution.t)) < 1e-6)
        fixes = fixes[(solution.t[fixes] >= 30.0) & (solution.t[fixes] < 89.5)]
        gone = np.linalg.norm(pos[fixes + 99] - pos[fixes], axis=1)  # 0.99 s after the fix
        moved[name] = float(np.sqrt(np.mean(gone**2)))
        if name == "ins":
            whole = solution
    assert moved["ins"] < 0.05
    assert moved["receiver"] > 5 * moved["ins"]
    t = whole.t[6000:]
    tenth = slice(6000, None, 10)
    local = earth.difference_n(whole.lla, whole.lla[6000])
    jumps = np.abs(t - np.round(t)) < 0.1  # a line across a correction is not an extrapolation
    line = np.column_stack([np.interp(t, whole.t[tenth], local[tenth, i]) for i in range(3)])
    off = np.linalg.norm(line - local[6000:], axis=1)[~jumps]
    assert off.max() < 0.05


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"acceleration": 0.0}, "acceleration = 0 must be positive"),
        ({"correlation_s": "long"}, "correlation_s = 'long' must be a number"),
        ({"gate_probability": 1.0}, "gate_probability = 1 must be between 0 and 1"),
        ({"readmit_after_s": -1.0}, "readmit_after_s = -1 s must be 0 or more"),
        ({"gnss": False}, "unknown option 'gnss'\n  known options: acceleration, correlation_s, fix_acc"),
    ],
)
def test_a_wrong_option_says_why(options, message):
    with pytest.raises(EstimatorError) as caught:
        load("gnss-only", options)
    assert message in str(caught.value)


def test_every_option_moves_the_answer(flight):
    _, sensed = flight
    data = sensed.data
    wild = data.fixes.lla.copy()
    wild[40:44, 0] += 300.0 / 6.4e6
    data = replace(data, fixes=replace(data.fixes, lla=wild))
    plain = GnssOnly().run(data, sensed.initial)
    for options in (
        {"acceleration": 5.0}, {"correlation_s": 3.0}, {"gate_probability": 0.3}, {"readmit_after_s": 2.0}
    ):  # fmt: skip
        assert not np.array_equal(GnssOnly(**options).run(data, sensed.initial).lla, plain.lla), options
    named = GnssOnly().unmodeled_errors(replace(units().assumed, gnss=replace(GNSS, pos_h_markov_sd=2.0)))
    assert named == ("time-correlated GNSS position error",)
