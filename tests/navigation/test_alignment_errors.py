"""The covariance of an alignment is what small errors of its inputs make of it, one after another.

Each input of an error-free record is moved both ways, and the alignment made again: its response is a column
of the Jacobian, found without the formulas of the alignment. Then a datasheet names one error alone.
"""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from numpy.testing import assert_allclose

from bench.core.mathematics import earth, rotation
from bench.core.records.data import GnssFixes
from bench.core.records.sensor_specs import GnssSpec, ImuSpec, ThermalSpec, TriadSpec
from bench.core.words.exceptions import EstimatorError
from bench.navigation.mechanization import propagate
from bench.navigation.start import alignment, course, leveling
from bench.simulation import sensors
from tests.builders import at_rest, take
from tests.weaving import DEG, units, weaving

PERFECT = ImuSpec("perfect", TriadSpec(), TriadSpec())
EXACT = GnssSpec("exact", 1.0, 0.0, 0.0, 0.0)
T = 9.0  # length of the segment [s]; it is from the first fix on that shows a speed


@cache
def drawn(velocities):
    """An error-free turn with the nose along the course, its start, and what is found of it."""
    truth = weaving(14.0, rate=50.0, wind_n=[0.0, 0.0, 0.0])
    spec = replace(units(PERFECT, EXACT, baro=None), alignment="course", align_for=T)
    sensed = sensors.sense(truth, spec, 1, 0)
    data = sensed.data if velocities else moved(sensed.data, "fixes", "vel_n", np.nan)
    start, ((begin, end, _, _),) = alignment.complete(data, sensed.initial)
    assert (begin, end) == (1.0 if velocities else 2.0, start.t)
    assert end == pytest.approx(begin + T + 0.02)  # with the sample behind the last fix
    return truth, data, sensed.initial, start


def moved(data, record, name, change):
    one = getattr(data, record)
    return replace(data, **{record: replace(one, **{name: getattr(one, name) + change})})


def difference(one, other):
    turn = rotation.to_rotvec(rotation.multiply(one.q_nb, rotation.conjugate(other.q_nb)))
    return np.concatenate([earth.difference_n(one.lla, other.lla), one.vel_n - other.vel_n, turn])


def respond(data, initial, change, step):
    """The columns (9, 3) by which a start follows a change along each axis."""
    found = [
        [alignment.complete(change(data, s * axis), initial)[0] for s in (step, -step)] for axis in np.eye(3)
    ]
    return np.array([difference(*pair) for pair in found]).T / (2.0 * step)


def bias(name):
    return lambda data, b: moved(data, "imu", name, b * data.imu.dt[:, None])


def velocity(k):
    return lambda data, v: moved(data, "fixes", "vel_n", np.outer(np.arange(len(data.fixes)) == k, v))


def position(k):
    def change(data, p):
        lla = data.fixes.lla.copy()
        lla[k] = earth.displace(lla[k], p)
        return replace(data, fixes=replace(data.fixes, lla=lla))

    return change


def claims(velocities, imu=PERFECT, gnss=EXACT, **changes):
    """The start that is found with a datasheet that is assumed."""
    _, data, initial, _ = drawn(velocities)
    data = replace(data, specs=replace(data.specs, imu=imu, gnss=gnss))
    return alignment.complete(data, replace(initial, **changes))[0]


def assert_close(found, wanted, part):
    """Assert that no element is off by more than a part of what its row and column allow."""
    sd = np.sqrt(np.maximum(np.diag(found), np.diag(wanted)))
    scale = np.maximum(sd, 0.02 * np.repeat(sd.reshape(-1, 3).max(axis=1), 3))
    off = np.abs(found - wanted) - part * np.outer(scale, scale)
    assert off.max() <= 1e-12, np.unravel_index(off.argmax(), off.shape)


# --- moving ---------------------------------------------------------------------------------------------


@pytest.mark.parametrize("velocities", [True, False])
def test_without_errors_a_turn_is_found_and_nothing_is_left_open(velocities):
    truth, _, _, start = drawn(velocities)
    k = int(np.argmin(np.abs(truth.t - start.t)))
    off = difference(start, replace(start, lla=truth.lla[k], vel_n=truth.vel_n[k], q_nb=truth.q_nb[k]))
    assert np.abs(off).max() < 2e-3
    assert not start.cov.any()
    assert not start.bias_cov.any()


def test_a_course_by_velocities_errs_as_its_first_and_last_fix():
    _, data, initial, _ = drawn(True)
    columns = [respond(data, initial, velocity(k), 1e-2) for k in (0, 9)]
    found = claims(True, gnss=replace(EXACT, vel_white_sd=0.3))
    assert_close(found.cov[3:, 3:], 0.09 * sum((J @ J.T)[3:, 3:] for J in columns), 0.02)
    assert not found.cov[:3].any()
    placed = claims(True, gnss=replace(EXACT, pos_h_white_sd=2.0, pos_v_white_sd=3.0, pos_h_markov_sd=5.0))
    assert_allclose(placed.cov, np.diag([29.0, 29.0, 9.0] + [0.0] * 6), atol=1e-9)
    assert_allclose(placed.fix_cov, [25.0, 25.0, 0.0])


@pytest.mark.parametrize("lacking", [None, 4, 7])
def test_a_course_by_positions_errs_as_the_fixes_at_both_ends(lacking):
    """Each end is two fixes a third of the segment apart, or less, whose place gives its mean velocity."""
    _, data, initial, _ = drawn(False)
    ends = [1, 4, 7, 10] if lacking is None else [1, 3, 6, 9] if lacking == 4 else [1, 4, 7, 9]
    if lacking is not None:
        data = replace(data, fixes=take(data.fixes, np.arange(len(data.fixes)) != lacking))
    columns = [respond(data, initial, position(k), 1.0) for k in ends]
    wanted = sum(J @ np.diag([4.0, 4.0, 9.0]) @ J.T for J in columns)
    gnss = replace(EXACT, pos_h_white_sd=2.0, pos_v_white_sd=3.0)
    found = alignment.complete(replace(data, specs=replace(data.specs, gnss=gnss)), initial)[0].cov
    assert_close(found, wanted, 0.18)
    assert_allclose(found[[2, 5], 5], wanted[[2, 5], 5], rtol=0.05)
    assert_allclose(found[5, 5], wanted[5, 5], rtol=0.01)
    assert_allclose(found, found.T)
    if lacking is not None:
        return
    slow = claims(False, gnss=replace(EXACT, pos_h_markov_sd=2.0, pos_v_markov_sd=3.0)).cov
    assert not slow[:3, 3:].any()
    assert_allclose(slow[3:, 3:], found[3:, 3:])


def test_a_course_errs_as_its_accelerometers_and_gyros():
    """Noise by the variance of the mean of a Wiener process, T / 3."""
    truth, data, initial, _ = drawn(True)
    for name, triad, step, part in (("accel", "dvel_b", 1e-3, 0.1), ("gyro", "dtheta_b", 1e-5, 0.12)):
        J, sd = respond(data, initial, bias(triad), step), 5.0 * step
        found = claims(True, imu=replace(PERFECT, **{name: TriadSpec(turn_on_bias_sd=sd)}))
        assert_close(found.cov[6:, 6:], sd**2 * (J @ J.T)[6:, 6:], part)
        which = slice(0, 3) if name == "gyro" else slice(3, 6)
        scale = sd**2 * np.linalg.norm(J[6:], axis=1).max()
        assert_allclose(found.bias_cov[6:, which], -(sd**2) * J[6:], rtol=0, atol=0.18 * scale)
        rest = np.delete(found.bias_cov, which, axis=1)
        assert not rest.any()
    walks = replace(PERFECT, accel=TriadSpec(random_walk=0.06), gyro=TriadSpec(random_walk=2e-3))
    tilt = 0.06**2 / T / 9.81**2 + 2e-3**2 * T / 3.0
    assert_allclose(np.diag(claims(True, imu=walks).cov)[6:8], tilt, rtol=0.02)
    begin, end = (int(np.argmin(np.abs(truth.t - t))) for t in (1.0, 10.0))
    g = earth.gravity_n(truth.lla[end, 0], truth.lla[end, 2])[2]
    F_D = (truth.vel_n[end, 2] - truth.vel_n[begin, 2]) / T - g
    leans = replace(PERFECT, accel=TriadSpec(misalignment_sd=2e-3))
    assert_allclose(np.diag(claims(True, imu=leans).cov)[6:8], (2e-3 * g / F_D) ** 2, rtol=2e-4)
    warms = replace(PERFECT, accel=TriadSpec(temperature_sd=1e-3), thermal=ThermalSpec(298.15, 15.0, 100.0))
    warmth = 288.15 - 0.0065 * truth.lla[end, 2] - 298.15  # at 0 s its own heat is still to come
    assert_allclose(np.diag(claims(True, imu=warms).cov)[6:8], (1e-3 * warmth / F_D) ** 2, rtol=2e-3)
    scaled = TriadSpec(scale_factor_sd=3e-3, misalignment_sd=4e-3)
    rows = (truth.t[1:] > 1.0) & (truth.t[1:] < 10.01)
    turned = np.cumsum(truth.dtheta_b[rows], axis=0)[-1]  # about each axis one way
    found = claims(True, imu=replace(PERFECT, gyro=scaled))
    assert_allclose(np.diag(found.cov)[6:8], (5e-3 * 0.5 * np.linalg.norm(turned)) ** 2, rtol=0.02)


def test_a_course_off_the_nose_tilts_by_the_force_along_it():
    """What is felt stays as it is: a heading error turns it by as much as the tilt takes back."""
    truth, data, initial, _ = drawn(True)
    begin, end = (int(np.argmin(np.abs(truth.t - t))) for t in (1.0, 10.0))
    F = (truth.vel_n[end] - truth.vel_n[begin]) / T - earth.gravity_n(truth.lla[end, 0], 800.0)
    column = np.array([F[0] / F[2], F[1] / F[2], 1.0])
    found, ((*_, text),) = alignment.complete(data, replace(initial, drift_sd=0.1))
    assert_allclose(found.cov[6:, 6:], 0.01 * np.outer(column, column), rtol=0.02, atol=1e-6)
    tilt = np.rad2deg(0.1 * np.abs(column[:2]).max())
    said = f"9 s at 25 m/s, sd 5.7 deg, 5.7 deg of it wind and sideslip; tilt sd {tilt:.2g} deg"
    assert text == f"heading by the course of {said}"


# --- the segment of a course --------------------------------------------------------------------------------


def test_a_stretch_moves_throughout_and_reaches_over_no_long_gap():
    t, speed, none = np.arange(21.0), np.full(21, 5.1), np.empty(0)
    assert course.find_motion(t, speed, 10.0, none) == (0, 10)
    assert course.find_motion(t, speed, 10.0 + 0.5e-6, none) == (0, 10)
    assert course.find_motion(t, np.where(t == 3.0, 4.9, 5.1), 10.0, none) == (4, 14)
    assert course.find_motion(t, speed, 10.0, np.array([7.5, 7.9])) == (8, 18)
    assert course.find_motion(t, speed, 10.0, np.array([7.5, 8.5])) == (9, 19)
    assert course.find_motion(t, speed, 10.0, np.array([8.0, 8.9])) == (9, 19)  # a fix at its begin
    for some, told in (
        (slice(0, 3), "the fastest of 3 fixes has 7.25 m/s"),
        (slice(0, 0), "there is no sound fix"),
    ):
        with pytest.raises(EstimatorError) as caught:
            course.find_motion(t[some], np.array([5.5, 7.25, 6.0])[some], 10.0, none)
        assert str(caught.value) == f"alignment course needs 10 s of fixes above 5 m/s over ground; {told}"


@pytest.mark.parametrize(("length", "begin"), [(0.5, 1.0), (0.56, 5.0)])
def test_a_gap_of_the_imu_of_more_than_half_a_second_begins_a_stretch_anew(length, begin):
    truth, data, initial, _ = drawn(True)
    kept = (data.imu.t < 3.92 + 1e-6) | (data.imu.t > 3.92 + length + 1e-6)  # a fix at 4 s is in it
    found, ((t, end, _, _),) = alignment.complete(replace(data, imu=take(data.imu, kept)), initial)
    assert (t, end) == (begin, pytest.approx(min(begin + 9.02, 14.0)))  # or the last sample there is
    off = rotation.multiply(found.q_nb, rotation.conjugate(truth.q_nb[round(50 * end)]))
    assert np.abs(rotation.to_rotvec(off)).max() < 0.02  # bridged by the sample behind it


def test_a_course_is_by_velocities_where_half_of_the_fixes_have_one():
    _, data, initial, _ = drawn(True)
    for first in (0, 1):
        vel_n = data.fixes.vel_n.copy()
        vel_n[first::2] = np.nan
        _, ((begin, *_),) = alignment.complete(
            replace(data, fixes=replace(data.fixes, vel_n=vel_n)), replace(initial, align_for=8.0)
        )
        assert begin == 2.0 - first
    vel_n[:4] = np.nan
    _, ((begin, *_),) = alignment.complete(
        replace(data, fixes=replace(data.fixes, vel_n=vel_n)), replace(initial, align_for=8.0)
    )
    assert begin == 2.0  # by positions, of which the first shows no speed


def test_a_fix_at_the_start_belongs_to_the_stretch():
    """To a microsecond; one of before does not, whenever it arrives."""
    _, data, initial, _ = drawn(True)
    for early, begin in ((0.0, 1.0), (0.5e-6, 1.0), (1.5e-6, 2.0)):
        fixes = replace(data.fixes, t=data.fixes.t - early * (np.arange(len(data.fixes)) == 0))
        _, ((t, _, _, _),) = alignment.complete(replace(data, fixes=fixes), replace(initial, t=1.0))
        assert t == pytest.approx(begin)


def test_a_speed_is_that_since_a_second_before():
    """Along a parabola at 0.4 s; before a second has passed, since the first fix."""
    t = 0.4 * np.arange(6.0)
    way = np.column_stack([3.0 * t**2, -4.0 * t**2, 99.0 * t])
    none = np.zeros((6, 3, 3))
    sound = np.ones(6, np.bool_)
    lla = earth.displace(np.tile([0.8, 0.2, 500.0], (6, 1)), way)
    fixes = GnssFixes(t, t, sound, lla, way, none, none, 9 * sound)
    found = course.speeds(fixes, np.arange(6))
    before = np.interp(np.maximum(t - 1.0, 0.0), t, 5.0 * t**2)
    passed = np.minimum(t, 1.0)
    assert_allclose(found[1:], (5.0 * t**2 - before)[1:] / passed[1:], rtol=1e-3)
    assert found[0] == 0.0
    assert not len(course.speeds(fixes, np.arange(0)))
    assert course.speeds(fixes, np.arange(1)).tolist() == [0.0]


def test_the_ends_of_a_stretch_are_a_third_of_it():
    one = drawn(False)[1].fixes

    def ends(*t):
        some = take(one, np.zeros(len(t), np.int64))
        return course.quartet(replace(some, t=np.array(t)), np.arange(len(t)))

    assert ends(*range(10)) == (0, 3, 6, 9)
    assert ends(0.0, 1.0, 2.0) == (0, 1, 1, 2)
    assert ends(0.0, 2.9, 3.0 + 0.5e-6, 4.0, 6.0 - 0.5e-6, 6.1, 9.0) == (0, 2, 4, 6)
    assert ends(0.0, 2.9, 3.0 + 1.5e-6, 4.0, 6.0 - 1.5e-6, 6.1, 9.0) == (0, 1, 5, 6)
    with pytest.raises(EstimatorError) as caught:
        ends(0.0, 9.0)
    said = "alignment course by fixes without velocity needs more than the 2 there are in 9 s; a longer"
    assert str(caught.value) == f"{said} [alignment] duration_s has more"


@pytest.mark.parametrize(
    ("roll", "pitch", "heading"), [(0.5, 0.6, 2.2), (np.pi, -0.6, 0.6), (2.09, 0.6, 4.0), (-2.09, -0.6, -2.3)]
)
def test_an_aircraft_may_fly_on_its_back_or_its_side_while_it_is_aligned(roll, pitch, heading):
    """From 40 m/s straight on, faster by 2 m/s^2; from another roll the iteration ends nowhere."""
    rate, n = 50.0, 600
    along, q_nb = np.array([np.cos(heading), np.sin(heading), 0.0]), rotation.from_euler(roll, pitch, heading)
    f_b = rotation.rotate(rotation.conjugate(q_nb), 2.0 * along - [0.0, 0.0, 9.81])
    dtheta, dvel, dt = np.zeros((n, 3)), np.tile(f_b / rate, (n, 1)), np.full(n, 1.0 / rate)
    nav = propagate([0.8, 0.2, 800.0], 40.0 * along, q_nb, dt, dtheta, dvel)
    truth = weaving(12.0, rate=rate)
    truth = replace(truth, lla=nav[:, :3], vel_n=nav[:, 3:6], q_nb=nav[:, 6:], dtheta_b=dtheta, dvel_b=dvel)
    spec = replace(units(PERFECT, EXACT, baro=None), alignment="course", align_for=T)
    sensed = sensors.sense(truth, spec, 1, 0)
    start, _ = alignment.complete(sensed.data, sensed.initial)
    off = rotation.multiply(start.q_nb, rotation.conjugate(truth.q_nb[int(start.t * rate)]))
    assert np.abs(rotation.to_rotvec(off)).max() < 5e-3


def test_no_attitude_makes_an_aircraft_fall_that_does_not():
    """By 3 m/s^2 and more: what the IMU feels is not of this flight."""
    _, data, initial, _ = drawn(True)
    for off, sound in ((2.0, True), (-2.0, True), (4.5, False), (-4.5, False)):
        other = moved(data, "imu", "dvel_b", np.outer(data.imu.dt, [0.0, 0.0, off]))
        if sound:
            alignment.complete(other, initial)
        else:
            with pytest.raises(EstimatorError) as caught:
                alignment.complete(other, initial)
            said = "no attitude makes the inertial velocity follow the fixes; do they belong together?"
            assert str(caught.value) == f"alignment course: {said}"


# --- at rest --------------------------------------------------------------------------------------------

LAT, HEIGHT = 50 * DEG, 250.0
E_RATE = earth.EARTH_RATE * np.cos(LAT)


@cache
def standing(duration=24.0):
    truth = at_rest(duration, 20.0, (LAT, 0.3, HEIGHT), 0.2, -0.3, 2.4)
    spec = replace(units(PERFECT, None, baro=None), alignment="level", align_for=20.0)
    sensed = sensors.sense(truth, spec, 1, 0)
    return truth, sensed.data, sensed.initial


def believing(data, imu):
    return replace(data, specs=replace(data.specs, imu=imu))


def test_at_rest_attitude_and_biases_err_as_accelerometers_and_gyros_do():
    _, data, initial = standing()
    for name, triad, step, which in (
        ("accel", "dvel_b", 1e-4, slice(3, 6)),
        ("gyro", "dtheta_b", 1e-8, slice(0, 3)),
    ):
        J, sd = respond(data, initial, bias(triad), step)[6:], 3.0 * step
        imu = replace(PERFECT, **{name: TriadSpec(turn_on_bias_sd=sd)})
        found, _ = alignment.complete(believing(data, imu), initial)
        assert_close(found.cov[6:, 6:], sd**2 * J @ J.T, 0.01)
        wanted = np.zeros((9, 6))
        wanted[6:, which] = -(sd**2) * J
        assert_allclose(found.bias_cov, wanted, rtol=0, atol=0.01 * np.abs(wanted).max())
        assert_allclose(found.cov[3:6, 3:6], 1e-4 * np.eye(3))  # it stands to a centimeter per second
        assert_allclose(found.cov[:3, :3], initial.cov[:3, :3])
        assert not found.vel_n.any()
        assert found.t == pytest.approx(20.0)


@pytest.mark.parametrize(("sd", "known"), [(1e-7, 4e-4), (4e-4, 4e-4), (4e-4, None)])
def test_at_rest_a_heading_is_given_or_unknown_where_the_gyros_do_not_tell_it(sd, known):
    _, data, initial = standing()
    imu = ImuSpec("unit", TriadSpec(turn_on_bias_sd=sd), TriadSpec(turn_on_bias_sd=3e-2))
    start = initial = replace(initial, t=3.0)
    if known is not None:
        cov = initial.cov.copy()
        cov[8, 8] = known**2
        start = replace(initial, q_nb=rotation.from_euler(0.9, 0.8, 1.1), cov=cov)
    found, ((begin, end, kind, text),) = alignment.complete(believing(data, imu), start)
    assert (begin, end, kind) == (3.0, found.t, "alignment")
    assert found.t == pytest.approx(23.0)
    roll, pitch, heading = rotation.to_euler(found.q_nb)
    assert_allclose([roll, pitch], [0.2, -0.3], atol=1e-5)
    J = respond(data, initial, bias("dvel_b"), 1e-3)[6:8]
    if known is not None:  # the tilts are along the axes of the heading that is given
        assert heading == pytest.approx(1.1)
        turn = np.array([[np.cos(1.3), np.sin(1.3)], [-np.sin(1.3), np.cos(1.3)]])  # from 2.4 to 1.1
        J = turn @ J
        said = f"heading given, sd {np.rad2deg(known):.2g} deg"
    else:
        assert heading == pytest.approx(2.4, abs=1e-4)
        said = "heading is unknown: gyros of 83 deg/h cannot gyrocompass with 9.7 deg/h of Earth rate; motion"
        said += " makes it observable"
    tilt = np.rad2deg(3e-2 / 9.81)
    assert text == f"leveled at rest, 20 s: tilt sd {tilt:.2g} deg each axis; {said}"
    expected = np.zeros((9, 6))
    expected[6:8, 3:] = -9e-4 * J
    assert_allclose(found.bias_cov, expected, rtol=0, atol=0.01 * np.abs(expected).max())
    wanted = np.diag([*np.diag(9e-4 * J @ J.T), np.pi**2 / 3.0 if known is None else known**2])
    assert_allclose(found.cov[6:, 6:], wanted, rtol=0.01, atol=1e-12)


def test_gyros_tell_a_heading_better_than_what_is_given():
    _, data, initial = standing()
    cov = initial.cov.copy()
    cov[8, 8] = 0.03**2
    start = replace(initial, q_nb=rotation.from_euler(0.0, 0.0, 1.1), cov=cov)
    imu = replace(PERFECT, gyro=TriadSpec(turn_on_bias_sd=0.02 * E_RATE))
    found, ((*_, text),) = alignment.complete(believing(data, imu), start)
    assert text == "leveled at rest, 20 s: tilt sd 0 deg each axis; heading gyrocompassed, sd 1.1 deg"
    assert found.cov[8, 8] == pytest.approx(0.02**2)


def test_a_short_gap_in_a_standstill_takes_the_rates_behind_it():
    truth, data, initial = standing()
    kept = (data.imu.t < 5.0 + 1e-6) | (data.imu.t > 5.4 + 1e-6)
    found, _ = alignment.complete(replace(data, imu=take(data.imu, kept)), initial)
    off = rotation.multiply(found.q_nb, rotation.conjugate(truth.q_nb[0]))
    assert np.abs(rotation.to_rotvec(off)).max() < 1e-6


def test_what_adds_to_a_mean_at_rest():
    """By hand, every part another: biases, three misalignments, what warms, what gravity does, and noise."""
    accel = TriadSpec(
        turn_on_bias_sd=0.2, bias_instability=0.3, misalignment_sd=0.04, nonorthogonality_sd=0.05,
        alignment_sd=0.06, temperature_sd=0.07, random_walk=0.8, bias_model="flicker",
    )  # fmt: skip
    gyro = replace(accel, g_sensitivity_sd=0.03, g2_sensitivity_sd=0.005)
    fixed = 0.2**2 + accel.instability_sd**2 + (0.07 * 3.0) ** 2
    turned = 100.0 * (0.04**2 + 0.05**2 + 0.06**2)
    by_g = (10.0 * 0.03) ** 2 + (100.0 * 0.005) ** 2
    assert leveling.bias_sd(accel, 10.0, -3.0) == pytest.approx(np.sqrt(fixed + turned))
    assert leveling.rate_sd(gyro, 10.0, -3.0) == pytest.approx(np.sqrt(fixed + by_g))
    _, data, _ = standing()
    data = believing(data, ImuSpec("unit", gyro, accel))
    found = leveling.mean_sd(data, 16.0, 10.0, -3.0)
    assert found == pytest.approx((np.sqrt(fixed + turned + 0.04), np.sqrt(fixed + by_g + 0.04)))


def test_a_bias_that_wanders_has_in_common_with_its_mean_what_its_autocorrelation_says():
    """By the integral of exp(-s / 40 s) over the last 25 s; half of a flicker."""
    wanders = TriadSpec(
        turn_on_bias_sd=0.2, bias_instability=0.3, bias_correlation=40.0, bias_model="gauss-markov"
    )
    s = (np.arange(100_000) + 0.5) * 25.0 / 100_000
    common = 0.04 + wanders.instability_sd**2 * np.exp(-s / 40.0).mean()
    assert_allclose(leveling.common_variance(wanders, 25.0), np.full(3, common))
    flickers = replace(wanders, bias_model="flicker")
    assert_allclose(leveling.common_variance(flickers, 25.0), 0.04 + 0.5 * flickers.instability_sd**2)
    assert_allclose(leveling.common_variance(TriadSpec(turn_on_bias_sd=0.2), 25.0), 0.04)


REST = ImuSpec("unit", TriadSpec(random_walk=2e-4), TriadSpec(random_walk=2e-3, turn_on_bias_sd=4e-3))
STEPS = {  # 0.05 m/s^2, 0.5 deg/s and five sigma of noise
    "force": ("dvel_b", [0.0, 0.05 + 5.0 * 2e-3 * np.sqrt(2.0), 0.0], "the specific force changes"),
    "turn": (
        "dtheta_b",
        [0.5 * DEG + 5.0 * 2e-4 * np.sqrt(2.0), 0.0, 0.0],
        "it turns, or the unit of its gyros is wrong",
    ),
}


@pytest.mark.parametrize("case", STEPS)
def test_a_standstill_ends_where_the_mean_of_a_second_has_changed(case):
    """Five sigma of noise beyond what an aircraft on its wheels does; 3 % less is no motion."""
    _, data, initial = standing()
    name, step, why = STEPS[case]
    data = believing(data, REST)

    def stepped(size, after):
        return size * np.array(step) * data.imu.dt[:, None] * (data.imu.t > after + 1e-6)[:, None]

    for size, end in ((0.97, 20.0), (1.03, 16.0), (-1.03, 16.0)):
        found, _ = alignment.complete(moved(data, "imu", name, stepped(size, 16.0)), initial)
        assert found.t == pytest.approx(end)
    early = stepped(1.03, 7.0)
    with pytest.raises(
        EstimatorError, match=f"^alignment level needs a standstill of 10 s at the start; at 7 s {why}$"
    ):
        alignment.complete(moved(data, "imu", name, early), initial)


def test_a_standstill_feels_gravity_alone():
    """From the start on: 0.05 m/s^2 and five sigma of what the accelerometers add to it."""
    _, data, initial = standing()
    most = 0.05 + 5.0 * np.hypot(4e-3, 2e-3)
    g = earth.gravity_n(LAT, HEIGHT)[2]
    for size, stands in ((0.97, True), (1.03, False), (-1.03, False)):
        data_ = replace(
            believing(data, REST), imu=replace(data.imu, dvel_b=data.imu.dvel_b * (1.0 + size * most / g))
        )
        if stands:
            alignment.complete(data_, initial)
        else:
            with pytest.raises(EstimatorError, match=r"at 0 s the specific force is .* not gravity"):
                alignment.complete(data_, initial)


def test_a_standstill_ends_at_the_first_fix_that_moves():
    truth, data, initial = standing()
    spec = replace(units(PERFECT, EXACT, baro=None), alignment="level", align_for=20.0)
    data = sensors.sense(truth, spec, 1, 0).data
    gnss = replace(EXACT, vel_white_sd=0.3)
    data = replace(data, specs=replace(data.specs, gnss=gnss))
    k = int(np.searchsorted(data.fixes.t, 15.5))
    for speed, valid, end in ((1.95, True, 20.0), (1.97, True, 15.0), (1.97, False, 20.0)):
        vel_n, sound = data.fixes.vel_n.copy(), data.fixes.valid.copy()
        vel_n[k], sound[k] = [0.6 * speed, 0.0, -0.8 * speed], valid
        found, _ = alignment.complete(
            replace(data, fixes=replace(data.fixes, vel_n=vel_n, valid=sound)), initial
        )
        assert found.t == pytest.approx(end)
    unknown = replace(data, specs=replace(data.specs, gnss=None))  # how well it knows its speed
    assert alignment.complete(unknown, initial)[0].t == pytest.approx(20.0)
    vel_n[2] = [3.0, 4.0, 0.0]
    sound[2] = True
    with pytest.raises(EstimatorError, match=r"standstill of 10 s at the start; at 2 s GNSS reports 5 m/s$"):
        alignment.complete(replace(data, fixes=replace(data.fixes, vel_n=vel_n, valid=sound)), initial)


def test_a_standstill_too_short_says_what_ends_it():
    _, data, initial = standing(6.5)
    for align_for, told in (
        (20.0, "10 s at the start; at 6 s the record of the imu ends"),
        (0.5, "0.5 s at the start; at 0 s the time of the alignment is over"),
    ):
        with pytest.raises(EstimatorError) as caught:
            alignment.complete(data, replace(initial, align_for=align_for))
        assert str(caught.value) == f"alignment level needs a standstill of {told}"
    found, _ = alignment.complete(data, replace(initial, align_for=3.0))
    assert found.t == pytest.approx(3.0)
