"""Checks of a recording in the air: sound flights pass; seeded mistakes are found if the motion shows it."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.optimize import least_squares

from bench.core.files.places import PACKAGE
from bench.core.mathematics import earth
from bench.core.records.instruments import BaroData
from bench.evaluation.motion import axis_search, motion_checks, motion_fit, validity
from bench.evaluation.motion.axis_names import name_axes
from bench.evaluation.motion.clock_search import find_offsets
from bench.evaluation.motion.recorded_motion import RecordedMotion
from bench.io.config.listing import list_profiles
from tests.evaluation import seeded


def wrong(found):
    return [c.text for c in found.values() if not c.good and c.name not in seeded.TRUE_REMARKS]


@pytest.mark.parametrize(
    ("unit", "fixes", "told"),
    [
        (1.0, 25, ["receiver (sd"]),
        (0.3048, 25, ["are these feet?"]),
        (-1.0, 25, ["unit or the sign"]),
        (1.0, 19, []),
    ],
)
def test_a_barometer_climbs_with_the_receiver(unit, fixes, told):
    """100 m up in 25 s; fewer than 20 fixes tell nothing."""
    t = np.arange(25.0)
    baro = BaroData(t, t, np.ones(25, np.bool_), (300.0 + 4.0 * t) / unit, np.ones(25))
    none, lla = np.empty((0, 3)), np.column_stack([np.zeros((fixes, 2)), 350.0 + 4.0 * t[:fixes]])
    motion = RecordedMotion(np.empty(0), none, none, t[:fixes], lla, np.full((fixes, 3), np.nan), 0.0)
    found = validity.check_heights("baro", motion, baro)
    assert len(found) == len(told)
    for one, text in zip(found, told, strict=True):
        assert text in one.text
        assert one.value == pytest.approx(1.0 / unit)
        assert one.good == (unit == 1.0)


def test_a_ratio_of_heights_is_as_sure_as_its_minutes():
    """Errors of 8 m by turns over heights of 40 m rms: a fifth, over the root of four minutes."""
    t = 1000.0 + np.arange(241.0)
    climb = 40.0 * np.where(np.arange(241) // 2 % 2, 1.0, -1.0)
    wrong = 8.0 * np.where(np.arange(241) % 2, 1.0, -1.0)
    baro = BaroData(t, t, np.ones(241, np.bool_), 300.0 + climb + wrong, np.ones(241))
    lla = np.column_stack([np.zeros((241, 2)), 350.0 + climb])
    none = np.empty((0, 3))
    motion = RecordedMotion(np.empty(0), none, none, t, lla, np.full((241, 3), np.nan), 0.0)
    (found,) = validity.check_heights("baro", motion, baro)
    assert "(sd 0.100)" in found.text


@pytest.mark.parametrize(("axis", "gain", "tilt_deg"), [(0, 1.015, 5.0), (1, 0.9, 25.0), (1, 1.0, 0.0)])
def test_gravity_and_rates_at_rest_by_hand(axis, gain, tilt_deg):
    """It stands from 10 to 40 s, and half a second at each end does not count; the rate is 0.3 deg/s."""
    t, fix_t, tilt = np.arange(0.0, 60.0, 0.1), np.arange(60.0), np.deg2rad(tilt_deg)
    stands, counts = (fix_t >= 10.0) & (fix_t <= 40.0), (t > 10.5 + 1e-6) & (t < 39.5 - 1e-6)
    lla = np.column_stack([np.full((60, 2), 0.8), np.full(60, 200.0)])
    size = gain * np.linalg.norm(earth.gravity_n(0.8, 200.0))
    gyro = np.where(counts[:, None], np.deg2rad([0.1, -0.2, 0.2]), 1.0)
    accel = np.where(counts[:, None], size * np.array([np.sin(tilt), 0.0, -np.cos(tilt)]), 99.0)
    vel_n = np.zeros((60, 3))
    vel_n[~stands, axis] = -3.0
    motion = RecordedMotion(t, gyro, accel, fix_t, lla, vel_n, np.deg2rad(3999.0))
    ratio, tilted, rate = validity.check_rest(motion)
    assert "at rest (30 s)" in ratio.text
    assert (ratio.value, ratio.good) == (pytest.approx(gain), abs(gain - 1.0) < 0.03)
    assert (tilted.value, tilted.good) == (pytest.approx(tilt_deg, abs=1e-5), tilt_deg < 20.0)
    assert f"{tilt_deg:.1f} deg off" in tilted.text
    assert ("mounting_deg" in tilted.text) == (not tilted.good)
    assert (rate.value, rate.good) == (pytest.approx(0.3), True)
    assert "0.100, -0.200, 0.200 deg/s" in rate.text
    most = validity.check_rates(motion)
    assert (most.value, most.good) == (pytest.approx(3999.0), True)
    assert "3999 deg/s" in most.text
    assert not validity.check_rates(replace(motion, most_rate=np.deg2rad(4001.0))).good
    (nothing,) = validity.check_rest(replace(motion, vel_n=vel_n - 3.0))
    assert "shows no standstill" in nothing.text
    for heave, good in ((20.0, False), (21.2, True)):  # in 30 s it may change the force by 7 %
        bobbing = vel_n + np.where(fix_t == 20.0, heave, 0.0)[:, None] * [0.0, 0.0, 1.0]
        found = validity.check_rest(replace(motion, accel=accel * 0.9 / gain, vel_n=bobbing))[0]
        assert found.good == good
    moved = lla + np.where(stands, 0.0, 1e-5 * np.arange(60.0))[:, None] * [1.0, 0.0, 0.0]
    ratio, *_ = validity.check_rest(replace(motion, lla=moved, vel_n=np.full((60, 3), np.nan)))
    assert ratio.value == pytest.approx(gain)


@pytest.fixture(scope="module")
def sound():
    """Rolls, wind-up turns and climbs."""
    return seeded.record("high-dynamics")


def test_a_sound_flight_has_no_false_line(sound):
    found = sound.check()
    assert wrong(found) == []
    assert found["imu_shift_s"].value == pytest.approx(0.0, abs=0.02)
    assert found["turn_gain"].value == pytest.approx(1.0, abs=0.05)
    assert not any("mounting_deg" in one.text for one in found.values())


def shake(one, sd, seed=4):
    """Return the record with white noise of ``sd`` [m/s] added to the velocities of its fixes."""
    noise = sd * np.random.default_rng(seed).standard_normal(one.fixes.vel_n.shape)
    return replace(one, fixes=replace(one.fixes, vel_n=one.fixes.vel_n + noise))


def test_velocities_with_more_noise_than_assumed_have_it_named(sound):
    """0.5 m/s are named with the value to set; once assumed, or beside another mistake, they are not."""
    loud = shake(sound, 0.5)
    found = loud.check()["velocity_sd_mps"]
    sd = found.advice["gnss.velocity_sd_mps"]
    assert sd == pytest.approx(0.5, rel=0.2)
    assert f"velocity_sd_mps = {sd:g} in [gnss]" in found.text
    cov = np.tile(sd**2 * np.eye(3), (len(loud.fixes.t), 1, 1))
    told = replace(loud, fixes=replace(loud.fixes, cov_vel_n=cov))
    assert "velocity_sd_mps" not in told.check()
    spoil, names = seeded.MISTAKES["gyros 10 % too large"]
    found = spoil(loud).check()
    assert seeded.describe(found, names) == "found"
    assert "velocity_sd_mps" not in found


def test_a_vertical_velocity_that_is_always_0_is_no_measurement(sound):
    """The flight climbs: as measured, the zeros make the forces wrong and the antenna, too."""
    flat = replace(sound, fixes=replace(sound.fixes, vel_n=sound.fixes.vel_n * [1.0, 1.0, 0.0]))
    found = flat.check()
    assert wrong(found) == []
    assert "no velocity" in found["velocity_shift_s"].text


@pytest.mark.parametrize(
    ("rms", "assumed", "named"),
    [(0.21, 0.1, True), (0.19, 0.1, False), (0.09, 0.01, False), (0.99, 0.1, True), (1.01, 0.1, False)],
)
def test_the_noise_of_velocities_counts_from_twice_the_assumed_on(rms, assumed, named):
    fit, t = SimpleNamespace(rms=np.array([0.0, rms, 9.0])), 0.02 * np.arange(5000)
    still = SimpleNamespace(t=t, accel=np.zeros((5000, 3)), assumed_sd=assumed)
    check = motion_checks.check_velocity_noise
    assert bool(check(fit, still)) == named
    assert check(SimpleNamespace(rms=np.array([9.0])), still) == []
    still.assumed_sd = np.nan
    assert check(fit, still) == []


def test_what_noise_of_the_accelerometers_explains_is_none_of_the_receiver():
    """White noise in 20 s of a strong vibration; the scatter of its integral is that without a line."""
    drawn = np.random.default_rng(8).standard_normal((100, 1000, 3))
    t = 0.02 * np.arange(1000)
    walked = 0.02 * np.cumsum(drawn, axis=1)
    line = np.column_stack([np.ones(1000), t])
    rest = walked - line @ np.linalg.lstsq(line, walked.transpose(1, 0, 2).reshape(1000, -1), rcond=None)[
        0
    ].reshape(2, 100, 3).transpose(1, 0, 2)
    scatter = float(np.sqrt(np.mean(rest**2)))
    motion = SimpleNamespace(t=t, accel=drawn[0], assumed_sd=0.0)
    for factor, named in ((1.8, False), (2.2, True)):
        fit = SimpleNamespace(rms=np.full(3, factor * scatter))
        assert bool(motion_checks.check_velocity_noise(fit, motion)) == named


@pytest.mark.parametrize(
    "mistake",
    [
        "gyro x, y exchanged",
        "gyros 10 % too large",
        "IMU 0.1 s late",
        "antenna 2 m right",
        "velocity in knots",
    ],
)
def test_a_seeded_mistake_is_found(sound, mistake):
    spoil, names = seeded.MISTAKES[mistake]
    assert seeded.describe(spoil(sound).check(), names) == "found"


def test_the_derivatives_of_the_fit_are_those_of_its_own_integral(sound):
    """Central differences of u by each parameter; a roll of 400 deg/s turns 8 deg in a step of both."""
    motion = RecordedMotion.from_records(sound.imu, sound.fixes)
    few = motion_fit.find_stretches(motion.t, *motion.take_velocities()).take_liveliest(2)
    parts = (few, motion.t, motion.gyro, motion.accel)
    U = motion_fit.integrate(*parts, np.zeros(15))[1]
    for k in range(11):
        step = np.zeros(15)
        step[k] = 1e-4
        more, less = (motion_fit.integrate(*parts, sign * step)[0] for sign in (1.0, -1.0))
        sign = -1.0 if k < 8 else 1.0  # biases and gains are taken off
        expected = (more - less) / 2e-4
        assert_allclose(sign * U[..., k], expected, atol=2e-2 * np.abs(expected).max())


@pytest.mark.parametrize(("sd", "good", "value"), [(0.01, True, 1.02), (0.5, True, None), (0.01, False, 1.5)])
def test_a_gain_of_the_specific_force_is_told_if_it_is_known(sd, good, value):
    gain = np.where(np.array(motion_fit.NAMES) == "accel_gain", np.log(value or 1.02), 0.0)
    cov, empty = sd**2 * np.eye(len(gain)), np.empty(0)
    found = motion_checks.check_force_gain(motion_fit.MotionFit(gain, cov, empty, np.empty((0, 3, 3)), empty))
    assert found.good is good
    assert found.value == (None if value is None else pytest.approx(value))


def test_what_no_stretch_tells_is_as_uncertain_as_it_was_before(sound):
    """Biases within 6 deg/s and 0.1 of gravity, gains, turns and times about right, a measured arm."""
    motion = RecordedMotion.from_records(sound.imu, sound.fixes)
    none = motion_fit.find_stretches(motion.t, *motion.take_velocities()).take_liveliest(0)
    fit = motion_fit.fit_motion(none, motion.t, motion.gyro, motion.accel, np.zeros(3))
    before = {"gyro_bias": 0.1, "gyro_gain": 1.0, "accel_bias": 1.0, "accel_gain": 1.0, "turn": 1.0}
    before |= {"shift": 1.0, "arm": 0.5}
    expected = [before[name] if name in before else before[name[:-2]] for name in motion_fit.NAMES]
    assert_allclose(np.sqrt(np.diag(fit.cov)), expected)


UP, AHEAD = np.array([0.0, 0.0, -9.8]), np.array([1.0, 0.1, 0.0])
EYE, TURNED = np.eye(3), np.diag([-1.0, -1.0, 1.0])


@pytest.mark.parametrize(
    ("gyro", "accel", "told"),
    [
        (EYE, EYE, ""),
        (EYE, -EYE, "the accelerometers show gravity, not specific force"),
        (
            np.diag([1.0, -1.0, 1.0]),
            EYE,
            "the gyros fit the motion with their axes x, y, z taken from x, -y, z",
        ),
        (EYE, EYE[[1, 0, 2]], "the accelerometers fit the motion with their axes x, y, z taken from y, x, z"),
        (
            np.diag([1.0, -1.0, 1.0]),
            np.diag([1.0, -1.0, 1.0]),
            "left-handed; forward, right, down are x, -y, z",
        ),
        (EYE[[1, 0, 2]], EYE[[1, 0, 2]], "left-handed; forward, right, down are y, x, z"),
        (
            np.diag([1.0, -1.0, -1.0]),
            np.diag([1.0, -1.0, -1.0]),
            "forward, right, down are x, -y, -z of its axes",
        ),
        (TURNED, -TURNED, "are taken from -x, -y, z and the signs of the accelerometers are reversed"),
        (EYE[[1, 0, 2]], np.diag([1.0, 1.0, -1.0]), "gyros from y, x, z, accelerometers from x, y, -z"),
    ],
)
def test_axes_are_named_by_the_simplest_description(gyro, accel, told):
    """The search finds them up to one of 24 common rotations, drawn here; gravity and motion say which."""
    rng = np.random.default_rng(11)
    rotations = [one for one, _ in axis_search.list_axes()[:48] if np.linalg.det(one) > 0]
    for k in rng.integers(24, size=6):
        R = rotations[k]
        named = name_axes(R @ gyro, R @ accel, R @ UP, R @ AHEAD)
        assert (named.gyro == gyro).all()
        assert (named.accel == accel).all()
        assert told in named.text if told else not named.text


def test_axes_that_the_motion_does_not_order_are_as_given():
    """Without a forward axis any heading agrees: nothing is wrong then."""
    assert name_axes(EYE, EYE, UP, None).text == ""
    assert name_axes(TURNED, TURNED, UP, None).text == ""
    assert "show gravity" in name_axes(TURNED, -TURNED, UP, None).text


@pytest.mark.parametrize("arm", ["forward", "right", "down"])
def test_at_rest_no_cause_is_named_that_does_not_show(arm):
    """Nothing moves, so the antenna may be anywhere: no line is wrong, and none says where it is."""
    spoil, _ = seeded.MISTAKES[f"antenna 2 m {arm}"]
    found = spoil(seeded.record("static")).check()
    assert wrong(found) == []
    assert "nothing moves" in found["imu_shift_s"].text
    assert not {"arm_off_m", "imu_axes"} & set(found)


def test_a_lever_arm_that_was_given_is_not_repeated_as_found():
    """A component as uncertain after the fit as before is unknown."""
    names = motion_fit.NAMES
    sd = np.array([0.1 if name == "arm_x" else 0.499 for name in names])
    empty = np.empty(0)
    fit = motion_fit.MotionFit(np.zeros(len(names)), np.diag(sd**2), empty, np.empty((0, 3, 3)), empty)
    assert "at 1.00, ?, ? m" in motion_checks.check_arm(fit, np.ones(3)).text
    blind = replace(fit, cov=0.25 * np.eye(len(names)))
    assert motion_checks.check_arm(blind, np.ones(3)).value is None


@pytest.mark.parametrize(
    ("ratio", "said"),
    [
        (1.05 / 9.80665, "are these g in a column of m/s^2?"),
        (0.95 * 9.80665, "are these m/s^2 in a column of g?"),
        (1.0, "the unit or the scale looks wrong"),
        (0.85 * 9.80665, "the unit or the scale looks wrong"),
        (1.15 / 9.80665, "the unit or the scale looks wrong"),
    ],
)
def test_a_force_that_is_off_by_gravity_is_in_the_other_unit(ratio, said):
    assert motion_checks.guess_force_unit(ratio) == f": {said}"


@pytest.mark.parametrize(("sd_deg", "good"), [(0.1, False), (2.0, True), (5.5, True)])
def test_the_turn_between_the_triads_is_told_in_degrees(sd_deg, good):
    """6 and -8 deg about two axes are 10 deg; they count if they are known well enough."""
    turns = {"turn_x": np.deg2rad(6.0), "turn_z": np.deg2rad(-8.0)}
    values = np.array([turns.get(name, 0.0) for name in motion_fit.NAMES])
    cov, empty = np.deg2rad(sd_deg) ** 2 * np.eye(len(values)), np.empty(0)
    found = motion_checks.check_triads(motion_fit.MotionFit(values, cov, empty, np.empty((0, 3, 3)), empty))
    assert found.good is good
    assert (found.value is None) == (sd_deg > 5.0)
    if not good:
        assert "turned by +6.0, +0.0, -8.0 deg about x, y, z" in found.text
        assert found.value == pytest.approx(10.0)


@pytest.mark.parametrize(("rise", "good"), [(12.4, True), (12.6, False)])
def test_a_turn_between_the_triads_is_told_if_the_likelihood_rises_by_five_deviations(rise, good):
    """Half of 5 squared; else the motion does not show it."""
    found = motion_checks.check_triads(fitted(0.001, turn_z=1.2), lambda: rise)
    assert (found.good, found.value is None) == (good, good)


@pytest.mark.long
@pytest.mark.parametrize("name", [entry.name for entry in list_profiles()])
def test_every_shipped_profile(name):
    """No false line, and each mistake is found unless the motion does not show it."""
    one = seeded.record(name)
    assert wrong(one.check()) == []
    became = {
        what: seeded.describe(spoil(one).check(), names) for what, (spoil, names) in seeded.MISTAKES.items()
    }
    assert {what for what, found in became.items() if found != "found"} <= seeded.NOT_SHOWN.get(name, set())


@pytest.mark.parametrize(
    ("sd_deg", "yaw_deg", "off"), [(1.9, 20.0, True), (1.9, 3.0, False), (2.1, 20.0, None)]
)
def test_the_forward_axis_is_judged_where_the_heading_is_known(sd_deg, yaw_deg, off):
    """Four courses in a wind of 5 m/s, the motion through the air so far right of the axis; two deg sd."""
    course = np.repeat(np.deg2rad([0.0, 90.0, 180.0, 270.0]), 10)
    air = 25.0 * np.column_stack([np.cos(course), np.sin(course), 0.0 * course])
    nose = course - np.deg2rad(yaw_deg)
    C_nb = np.zeros((40, 3, 3))
    C_nb[:, 0, 0], C_nb[:, 1, 0] = np.cos(nose), np.sin(nose)
    stretches = motion_fit.Stretches(
        np.arange(0, 41, 10), np.arange(40.0), np.zeros((40, 3)), air + np.array([4.0, -3.0, 0.0]),
        np.tile(np.eye(3), (40, 1, 1)), np.ones(4),
    )  # fmt: skip
    fit = SimpleNamespace(heading_sd=np.full(4, np.deg2rad(sd_deg)), C_nb=C_nb)
    check = motion_checks.check_forward_axis(fit, stretches)
    if off is None:
        assert (check.value, check.good) == (None, True)
        assert check.text == "imu: the motion does not show where its forward axis points"
    else:
        assert check.value == pytest.approx(yaw_deg, abs=0.2)
        assert check.good is not off


def fitted(sd=0.0, **values):
    """A fit with some parameters, each as uncertain as the others."""
    of = np.array([values.get(name, 0.0) for name in motion_fit.NAMES])
    empty = np.empty(0)
    return motion_fit.MotionFit(of, sd**2 * np.eye(len(of)), empty, np.empty((0, 3, 3)), empty)


@pytest.mark.parametrize(
    ("gain", "factor", "sd", "value", "told"),
    [
        (1.04, 1.0, 0.01, 1.04, "1.040 times the motion"),
        (1.06, 1.0, 0.01, 1.06, "the unit or the scale looks wrong"),
        (1.06, 1.0, 0.02, 1.06, "1.060 times the motion"),
        (1.06, 1.0, 0.06, None, "does not show the unit of the angular rates (sd 0.06)"),
        (50.0, 1.0, 0.01, 50.0, "deg/s in a column of rad/s"),
        (1.1 / 57.3, 1.0, 0.01, 1.1 / 57.3, "rad/s in a column of deg/s"),
        (1.0, np.pi / 180.0, 0.01, 180.0 / np.pi, "deg/s in a column of rad/s"),
        (1.0, 180.0 / np.pi, 0.01, np.pi / 180.0, "rad/s in a column of deg/s"),
    ],
)
def test_a_gain_of_the_rates_names_the_unit(gain, factor, sd, value, told):
    """Wrong beyond 5 % and five deviations; what the search of the axes has taken off counts."""
    found = motion_checks.check_rate_gain(fitted(sd, gyro_gain=np.log(gain)), factor)
    assert told in found.text
    assert found.value == (None if value is None else pytest.approx(value))
    assert found.good == (value is None or abs(value - 1.0) <= max(0.05, 5.0 * sd))
    assert ("looks wrong" in found.text or "are these" in found.text) == (not found.good)


@pytest.mark.parametrize(
    ("shift", "sd", "good", "told"),
    [
        (0.019, 0.001, True, "fits the receiver's with +0.019 s added (sd 0.001 s)"),
        (-0.021, 0.001, False, "add -0.021 to [imu] time_offset_s"),
        (-0.021, 0.005, True, "fits the receiver's with -0.021 s added"),
        (0.019, 0.021, True, "does not show the shift between the clocks"),
    ],
)
def test_a_shift_of_the_clocks_counts_beyond_20_ms_and_five_deviations(shift, sd, good, told):
    found = motion_checks.check_shift(fitted(sd, shift=shift))
    assert told in found.text
    assert (found.good, "add " in found.text) == (good, not good)


@pytest.mark.parametrize(
    ("late", "late_sd", "key", "told"),
    [
        (0.0, 0.001, "imu.time_offset_s", "add +0.200 to [imu] time_offset_s"),
        (0.0, np.inf, "imu.time_offset_s", ", or if only the receiver's velocity is late: -0.200 to [gnss]"),
        (-0.05, 0.04, "imu.time_offset_s", ", or if only the receiver's velocity is late: -0.200 to [gnss]"),
        (
            -0.15,
            0.04,
            "gnss.velocity_offset_s",
            "more likely only the receiver's velocity is late: add -0.200 to [gnss]",
        ),
        (-0.15, 0.005, "imu.time_offset_s", "add +0.200 to [imu] time_offset_s"),
        (-0.105, 0.05, "imu.time_offset_s", ", or if only the receiver's velocity is late: -0.200 to [gnss]"),
        (-0.13, 0.06, "imu.time_offset_s", ", or if only the receiver's velocity is late: -0.200 to [gnss]"),
        (
            -0.14,
            0.06,
            "gnss.velocity_offset_s",
            "more likely only the receiver's velocity is late: add -0.200 to [gnss]",
        ),
    ],
)
def test_a_clock_is_told_from_a_late_velocity_by_the_positions(late, late_sd, key, told):
    """They say how late the velocity is; where that is 7.4 times likelier by it, it is not the clock."""
    found = motion_checks.check_shift(fitted(0.001, shift=0.2), 0.0, late, late_sd)
    given = 0.2 if key == "imu.time_offset_s" else -0.2
    assert (list(found.advice), found.advice[key]) == ([key], pytest.approx(given))
    assert told in found.text
    assert ("only the receiver's velocity is late" in found.text) == (abs(0.2 + late) < 5.0 * late_sd)


def test_an_arm_that_is_off_is_told_by_axis():
    """0.6 m of one axis, known to 0.1 m; an axis that is known to 0.3 m only has no figure."""
    fit = fitted(0.1, arm_x=0.6, arm_y=0.3, arm_z=-0.1)
    fit.cov[14, 14] = 0.09
    found = motion_checks.check_arm(fit, np.array([1.0, 2.0, 3.0]))
    assert "at 1.60, 2.30, ? m" in found.text
    assert "not at 1.00, 2.00, 3.00 m: is position_m right?" in found.text
    assert (found.value, found.good) == (pytest.approx(np.hypot(0.6, 0.3)), False)
    assert motion_checks.check_arm(fitted(0.1, arm_x=0.45), np.zeros(3)).good


def test_the_forward_axis_is_that_of_a_least_squares_with_a_wind():
    """Its deviation allows for courses whose errors last: evaluated where five of them are just less."""
    rng = np.random.default_rng(5)
    course = np.repeat(np.deg2rad([10.0, 80.0, 200.0, 290.0]), 10)
    scatter = np.repeat(rng.standard_normal((4, 2)), 10, axis=0) + 0.1 * rng.standard_normal((40, 2))
    nose = course - np.deg2rad(16.0)
    C_nb = np.zeros((40, 3, 3))
    C_nb[:, 0, 0], C_nb[:, 1, 0] = np.cos(nose), np.sin(nose)
    fit = SimpleNamespace(heading_sd=np.full(4, 0.01), C_nb=C_nb)

    def off(x, vel):
        return (vel[:, 1] - x[2]) * np.cos(nose + x[0]) - (vel[:, 0] - x[1]) * np.sin(nose + x[0])

    def compare(size):
        vel = 25.0 * np.column_stack([np.cos(course), np.sin(course)]) + [6.0, -4.0] + size * scatter
        wind = min(15.0, 0.3 * np.median(np.hypot(*vel.T)))
        found = least_squares(lambda x: np.append(off(x, vel), x[1:] / wind), [0.3, 0.0, 0.0], xtol=1e-14)
        x, J = found.x, found.jac[:40]
        inverse, prior = np.linalg.inv(found.jac.T @ found.jac), np.diag([0.0, 1.0, 1.0]) / wind**2
        pulls = (J * off(x, vel)[:, None]).reshape(4, 10, 3).sum(axis=1)
        sd = np.sqrt((inverse @ (4.0 / 3.0 * pulls.T @ pulls + prior) @ inverse)[0, 0])
        stretches = motion_fit.Stretches(
            np.arange(0, 41, 10), np.arange(40.0), np.zeros((40, 3)), np.column_stack([vel, np.zeros(40)]),
            np.tile(np.eye(3), (40, 1, 1)), np.ones(4),
        )  # fmt: skip
        return x[0], sd, motion_checks.check_forward_axis(fit, stretches)

    angle, _, found = compare(0.5)
    assert found.value == pytest.approx(np.rad2deg(angle), abs=1e-3)
    assert "if it moves forward, change mounting_deg so that x points there" in found.text
    excess = {}
    for size in np.arange(1.0, 30.0, 0.2):
        angle, sd, found = compare(size)
        if found.value is not None:  # it moves forward
            excess[angle / sd] = found.good
            assert found.good == (angle <= max(motion_checks.YAW_OFF, 5.0 * sd)), size
    assert min(abs(ratio - 5.0) for ratio in excess) < 0.1
    assert set(excess.values()) == {True, False}


def explained(rms, hypothesis=axis_search.AS_GIVEN, vel_n=10.0):
    """Two segments of 9 and 10 fixes, of which 21 and 24 residuals are free."""
    swing = vel_n * np.where(np.arange(19) % 2, 1.0, -1.0)[:, None] * [1.0, 0.0, 0.0]
    slices = [slice(0, 9), slice(9, 19)]
    stretches = SimpleNamespace(begin=np.array([0, 9, 19]), vel_n=swing, slices=slices)
    return axis_search.Explained(
        hypothesis, stretches, SimpleNamespace(rms=np.array(rms), values=np.zeros(15))
    )


def test_the_cost_of_a_hypothesis_is_the_likelihood_of_its_residuals():
    """For each residual; 5 cm/s are the receiver's."""
    total = 21.0 * np.log(np.hypot(0.1, 0.05)) + 24.0 * np.log(np.hypot(0.3, 0.05))
    assert explained([0.1, 0.3]).cost == pytest.approx(total / 45.0)
    every = axis_search.list_axes()
    assert len(every) == 96
    assert (every[0][0] == EYE).all()
    assert {round(np.linalg.det(accel)) for _, accel in every} == {1, -1}
    assert sum(round(np.linalg.det(gyro)) for gyro, _ in every) == 0
    assert len({(tuple(gyro.ravel()), tuple(accel.ravel())) for gyro, accel in every}) == 96


@pytest.mark.parametrize(
    ("evidence", "vel_n", "found"), [(29.0, 10.0, False), (31.0, 10.0, True), (31.0, 0.1, False)]
)
def test_other_axes_are_taken_if_they_are_30_more_likely(monkeypatch, sound, evidence, vel_n, found):
    """One assignment leaves only the noise of the receiver; where the velocity is noise it is not taken."""
    right, accel = axis_search.list_axes()[70]
    residual = 0.05 * np.sqrt(np.exp(2.0 * evidence / 45.0) - 1.0)

    def explain(motion, antenna_b, one, most=None, iterations=10):
        fits = (one.gyro == right).all() and (one.accel == accel).all() and one.unit == one.down == 1.0
        return explained(
            [0.05, 0.05] if fits and vel_n < 1.0 else [0.0, 0.0] if fits else [residual] * 2, one, vel_n
        )

    monkeypatch.setattr(axis_search, "explain", explain)
    motion = RecordedMotion.from_records(sound.imu, sound.fixes)
    plain = explained([np.hypot(residual, 0.05 if vel_n < 1.0 else 0.0)] * 2, vel_n=vel_n)
    best = axis_search.search(motion, np.zeros(3), plain)
    assert (best is not plain) == found
    if found:
        assert (best.hypothesis.gyro == right).all()


@pytest.mark.parametrize("offset", [-18.0, -0.4, 0.0, 7.3, 25.0])
def test_a_coarse_offset_is_found_with_any_axes(sound, offset):
    """Axes of both triads exchanged and reversed, and a unit wrong: sizes do not change but for a factor."""
    motion = RecordedMotion.from_records(sound.imu, sound.fixes)
    spoiled = replace(
        motion, t=motion.t - offset, gyro=57.3 * motion.gyro[:, [2, 0, 1]], accel=-motion.accel[:, [1, 0, 2]]
    )
    assert find_offsets(spoiled)[0] == pytest.approx(offset, abs=0.15)


def test_the_limits_are_those_of_the_guide():
    rest, level, triads, yaw = (
        f"{np.rad2deg(one):g} deg"
        for one in (
            validity.TILT_OFF,
            motion_checks.LEVEL_OFF,
            motion_checks.TRIADS_OFF,
            motion_checks.YAW_OFF,
        )
    )
    rate, force, both = (
        f"{100.0 * one:g} %" for one in (motion_checks.RATE_OFF, motion_checks.GRAVITY_OFF, validity.GAIN_OFF)
    )
    shift = f"{motion_checks.SHIFT_OFF:g} s"
    text = (PACKAGE / "guide" / "log-format.md").read_text()
    for row in (
        f"| clock of the IMU | {shift} |",
        f"| up axis | {rest} at rest, {level} on the move |",
        f"| angular rates, specific force | {rate}, {force} |",
        f"| gyros against accelerometers | {triads} |",
        f"| antenna | {motion_checks.ARM_OFF:g} m |",
        f"| forward axis | {yaw} |",
        f"| velocity | {shift}, {both} |",
        "| noise of the velocity | twice what" if motion_checks.NOISE_OFF == 2.0 else "",
        f"{motion_checks.SIGMAS:g} standard deviations.",
    ):
        assert row in text


def test_the_tilt_of_the_mean_force_is_told_in_degrees(monkeypatch):
    """Forces 4 deg off the vertical, of a fit that has no other fault; 40 deg are the mounting."""
    one = SimpleNamespace(
        hypothesis=axis_search.AS_GIVEN, stretches=None, fit=SimpleNamespace(rms=np.zeros(1))
    )
    sound = motion_checks.Check("x", None, "", True)
    monkeypatch.setattr(motion_checks, "find_stretches", lambda *given: [1])
    monkeypatch.setattr(motion_checks, "explain_as_given", lambda *given: one)
    monkeypatch.setattr(motion_checks, "_name", lambda *given: (one, "", True))
    for name in ("shift", "rate_gain", "force_gain", "triads", "arm", "forward_axis"):
        monkeypatch.setattr(motion_checks, f"check_{name}", lambda *given: sound)
    for tilt, good in ((4.0, True), (40.0, False)):
        force = -9.8 * np.array([np.sin(np.deg2rad(tilt)), 0.0, np.cos(np.deg2rad(tilt))])
        motion = SimpleNamespace(
            t=np.arange(3.0), gyro=np.zeros((3, 3)), accel=np.tile(force, (3, 1)), moves=True,
            take_velocities=lambda: (), find_standstills=lambda: [], velocity_shift_sd=0.0,
            velocity_shift=0.0, velocity_shift_left=0.0, assumed_sd=1.0,
        )  # fmt: skip
        found = motion_checks.check_motion(motion, np.zeros(3))[0][0]
        assert (found.name, found.good) == ("level_tilt_deg", good)
        assert found.value == pytest.approx(tilt)
        assert f"the up axis is {tilt:.1f} deg off" in found.text
        assert ("mounting_deg" in found.text) != good


def test_fixes_in_close_pairs_have_no_coarse_offset(sound):
    """Their usual step is 50 ms, and no ten of them lie within half a second."""
    motion = RecordedMotion.from_records(sound.imu, sound.fixes)
    t = np.sort(np.concatenate([np.arange(0.0, 60.0), np.arange(0.05, 60.0)]))
    pairs = replace(motion, fix_t=t, lla=np.tile([0.8, 0.2, 100.0], (len(t), 1)), vel_n=np.ones((len(t), 3)))
    assert find_offsets(pairs) == []
