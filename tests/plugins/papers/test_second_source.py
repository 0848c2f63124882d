"""The second source and what stands beside the filter: rows #46, #58 and #59 of the register."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose

from bench.core.mathematics import rotation
from bench.core.mathematics.earth import difference_n
from bench.core.mathematics.units import DEG
from bench.navigation.built_in import load
from bench.navigation.models.classic import Classic22, filter_loop
from bench.navigation.models.classic.extrapolation import extrapolate
from bench.plugins.papers import vector_matching
from bench.plugins.papers.register_linear import draw_outage
from bench.simulation import sensors
from tests.weaving import GNSS, units, weaving


@pytest.fixture(scope="module", params=[(0.0, 0.0, 0.0), (0.8, 0.3, -0.4)], ids=["no-arm", "arm"])
def minute(request):
    """Half a minute of the weaving flight at 50 Hz, with the antenna at the IMU and beside it."""
    return sensors.sense(weaving(30.0, rate=50.0), replace(units(), antenna_b=request.param), 1, 0)


def apart(found, other):
    """Largest difference of two solutions over a standard deviation, and of their deviations."""
    sd, second = (np.sqrt(np.einsum("kii->ki", one.cov)) for one in (other, found))
    turned = rotation.to_rotvec(rotation.multiply(found.q_nb, rotation.conjugate(other.q_nb)))
    off = np.hstack([difference_n(found.lla, other.lla), found.vel_n - other.vel_n, turned])
    return np.abs(off / sd).max(), np.abs(second / sd - 1).max()


def test_58_the_generic_filter_is_the_first_one(minute):
    """#58: error-ekf and classic-22 without feedback, 1e-9 in SI units and of the standard deviations.

    With the antenna off the IMU its f is not linear, and it differs by the second order of the corrections.
    """
    ours = load("error-ekf", {"covariance_hz": 5.0}).run(minute.data, minute.initial)
    first = Classic22(feedback=False, covariance_hz=5.0).run(minute.data, minute.initial)
    off, of_sd = apart(ours, first)
    if not minute.data.antenna_b.any():
        assert np.abs(ours.lla - first.lla).max() < 1e-9
        assert np.abs(ours.vel_n - first.vel_n).max() < 1e-9
        assert np.abs(ours.q_nb - first.q_nb).max() < 1e-9
        assert of_sd < 1e-9
    else:
        assert 1e-6 < off < 0.05


# --- in-flight calibration: #46 -----------------------------------------------------------------------------


CURVES = ("line", "parabola", "schuler")


def test_46_a_curve_through_the_errors_goes_on_through_an_outage():
    """#46: 60 s without fixes, 50 runs: a parabola leaves less than 0.3 of the INS error.

    For a matched model it does not beat the filter's own prediction; a curve drawn through noise goes astray.
    """
    found = draw_outage()
    assert found["parabola"] < 0.3 * found["ins"]
    assert found["prediction"] <= 1.02 * min(found[curve] for curve in CURVES)


@pytest.mark.parametrize("curve", ["parabola"])
def test_46_the_estimator_takes_the_curve_in_an_outage(curve):
    """Before the outage nothing changes, in it position and attitude do, by less than the INS is off."""
    sensed = sensors.sense(weaving(60.0, rate=50.0), units(gnss=replace(GNSS, rate=2.0)), 1, 0)
    fixes = sensed.data.fixes
    data = replace(sensed.data, fixes=fixes.take(fixes.t < 40.0))
    plain, ours = (
        Classic22(feedback=False, covariance_hz=2.0, outage=outage).run(data, sensed.initial)
        for outage in ("prediction", curve)
    )
    before = plain.t < 40.8  # 2.5 intervals after the last fix, of 39.5 s
    np.testing.assert_array_equal(ours.lla[before], plain.lla[before])
    sd, of_plain = (np.sqrt(np.einsum("kii->ki", one.cov)) for one in (ours, plain))
    assert_allclose(sd, of_plain, rtol=0.01)  # only in meters at another place, tilts turned with the heading
    off = np.linalg.norm(difference_n(ours.lla, plain.lla)[~before, :2], axis=1)
    assert (off > 0).all()
    assert off[-1] < 500.0


@pytest.mark.parametrize(
    ("curve", "law"),
    [
        ("line", lambda t: 3.0 - 2.0 * t),
        ("parabola", lambda t: 3.0 - 2.0 * t + 0.01 * t**2),
        ("schuler", lambda t: 3.0 - 2.0 * t + 400.0 * np.sin(1.2406e-3 * t) - 50.0 * np.cos(1.2406e-3 * t)),
    ],
)
def test_46_a_curve_goes_on_as_the_law_that_it_fits(curve, law):
    """Known for half a period of the pendulum, and twenty minutes later it is as the law says."""
    t = np.arange(200.0, 3200.0, 20.0)
    known = np.column_stack([law(t), -2.0 * law(t)])
    found = extrapolate(curve, t, known, 4400.0)
    assert_allclose(found, [law(4400.0), -2.0 * law(4400.0)], rtol=2e-3)


def test_46_what_a_curve_says_is_taken_off_as_an_estimate_is(monkeypatch):
    """Along the last two errors, 130 m at once, the position is within 3 m of the prediction at first."""
    sensed = sensors.sense(weaving(60.0, rate=50.0), units(), 1, 0)
    fixes = sensed.data.fixes
    data = replace(sensed.data, fixes=fixes.take(fixes.t < 40.0))
    sizes = []

    def go_on(curve, t, values, now):
        sizes.append(np.linalg.norm(values[-1][:2]))
        return values[-1] + (values[-1] - values[-2]) * (now - t[-1]) / (t[-1] - t[-2])

    monkeypatch.setattr(filter_loop, "extrapolate", go_on)
    plain, ours = (
        Classic22(feedback=False, covariance_hz=2.0, outage=outage).run(data, sensed.initial)
        for outage in ("prediction", "line")
    )
    k = np.searchsorted(plain.t, 41.8)
    assert sizes[0] > 100.0
    assert 0.0 < np.linalg.norm(difference_n(ours.lla, plain.lla)[k, :2]) < 3.0
    assert np.linalg.norm((ours.vel_n - plain.vel_n)[k]) < 1.0
    turned = rotation.to_rotvec(rotation.multiply(ours.q_nb, rotation.conjugate(plain.q_nb)))
    assert np.linalg.norm(turned[k]) < 0.01


# --- vector matching: #59 -----------------------------------------------------------------------------------

R_I = 316e3 * np.array([0.314, 0.949, 0.03]) / np.linalg.norm([0.314, 0.949, 0.03])
SD = np.array([0.05 * np.sqrt(2.0), np.hypot(5.0, 10.0)])


def velocity(angle):
    """206 m/s at an angle from the position [rad]."""
    across = np.cross(R_I, [0.0, 0.0, 1.0])
    r, a = R_I / np.linalg.norm(R_I), across / np.linalg.norm(across)
    return 206.0 * (np.cos(angle) * r + np.sin(angle) * a)


def test_59_vectors_find_a_misalignment_of_3_7_mrad():
    """#59, B-V: 57.6 deg apart; the mean is right, standard deviations are those printed within 10 %."""
    rng = np.random.default_rng(2)
    truth = rotation.matrix(rotation.from_euler(0.3, -0.2, 1.1))
    turn = np.array([2.0e-3, -2.5e-3, 1.86e-3])
    ins = rotation.matrix(rotation.from_rotvec(turn)) @ truth
    second = np.array([velocity(57.6 * DEG), R_I])
    found = []
    for _ in range(1000):
        first = (second + SD[:, None] * rng.standard_normal((2, 3))) @ truth
        match = vector_matching.match_vectors(first, second, SD)
        found.append(vector_matching.misalignment(ins, match.matrix))
    assert np.linalg.norm(turn) == pytest.approx(3.7e-3, rel=0.01)
    sd = np.std(found, axis=0)
    assert_allclose(np.mean(found, axis=0), turn, atol=4 * sd.max() / np.sqrt(1000))
    assert_allclose(sd, [1.3e-4, 3.8e-4, 3.7e-5], rtol=0.1)
    assert_allclose(np.sqrt(np.diag(match.cov)), sd, rtol=0.1)


def test_59_parallel_vectors_leave_a_turn_about_them_unobserved():
    """Straight flight from the start: position along velocity."""
    seen = []
    for angle in (0.0, 0.1 * DEG, 57.6 * DEG):
        both = np.array([velocity(angle), R_I])
        match = vector_matching.match_vectors(both, both, SD)
        seen.append(match.observability)
        assert np.isinf(match.cov).all() == (angle == 0.0)
    assert seen[0] < 1e-12 < seen[1] < 1e-6 < seen[2]
    with pytest.raises(ValueError, match="a vector has no length"):
        vector_matching.match_vectors(np.zeros((2, 3)), np.zeros((2, 3)), SD)


def test_59_lengths_and_the_angle_between_do_not_see_the_attitude():
    """Invariant control: a misalignment changes nothing, a velocity wrong by 1 % shows in one of them."""
    turned = rotation.matrix(rotation.from_euler(0.3, -0.2, 1.1))
    both = np.array([velocity(57.6 * DEG), R_I])
    assert np.abs(vector_matching.invariant_errors(both @ turned, both)).max() < 1e-9
    wrong = both + np.array([[0.0, 0.0, 2.06], [0.0, 0.0, 0.0]])
    shown = np.abs(vector_matching.invariant_errors(both @ turned, wrong)) > [5 * SD[0], 5 * SD[1], 1e-4]
    assert shown.tolist() == [False, False, True]
    longer = both * [[1.01], [1.0]]
    assert vector_matching.invariant_errors(both @ turned, longer)[0] == pytest.approx(2.06)
