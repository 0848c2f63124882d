"""Checks of times, velocities and heights of a recording, against what is computed by hand."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose

from bench.core.mathematics import earth
from bench.core.records.instruments import BaroData
from bench.evaluation.motion import validity, velocity_checks
from bench.evaluation.motion.recorded_motion import Check, RecordedMotion
from bench.evaluation.motion.velocity_checks import variance_of_sum
from bench.evaluation.motion.velocity_frame import find_frame


def test_times_that_go_back_and_gaps_are_counted_by_rows():
    """Steps of 0.5 s but for one of 0, one back, one of 1.5 s, of 2 s and of 4 s."""
    t = np.array([10.0, 10.5, 11.0, 11.5, 11.5, 11.0, 11.5, 12.0, 13.5, 14.0, 16.0, 16.5, 20.5, 21.0])
    valid = np.ones(14, np.bool_)
    valid[[3, 7]] = False
    rate, back, gaps, bad = validity.check_times("imu", t, valid)
    assert (rate.value, rate.text) == (2.0, "imu: 14 rows, 10.00 to 21.00 s, 2 Hz")
    assert (back.value, back.good) == (3.0, False)  # the third repeats the newest time, not that before it
    assert back.text == "imu: 3 of 14 rows repeat a time or go back and are left out, first row 5"
    assert (gaps.value, gaps.text) == (2.0, "imu: 2 gaps, the longest 4 s before row 13, at 16.50 s")
    assert (bad.value, bad.good) == (2.0, False)
    assert bad.text == "imu: 2 rows are flagged or hold no finite number, the first is row 4"
    (gap,) = validity.check_times("gnss", t[9:], valid[9:])[1:]
    assert gap.text == "gnss: 1 gap, of 4 s before row 4, at 16.50 s"
    (flagged,) = validity.check_times("gnss", t[:4], valid[:4])[1:]
    assert "1 rows are flagged, lie at latitude 0, longitude 0 or hold no finite number" in flagged.text


def test_the_variance_of_a_sum_counts_neighbors():
    """1 to 6: 91 + 2 (70 + 50 + 32 + 17 + 6); by turns 1 and -1 the sum is 0, and a hundredth is left."""
    assert variance_of_sum(np.arange(1.0, 7.0)) == 441.0
    assert variance_of_sum(np.array([1.0, 2.0])) == 9.0
    assert variance_of_sum(np.array([1.0, -1.0] * 2)) == pytest.approx(0.04)


def test_the_variance_of_a_sum_counts_a_slow_part_by_its_blocks():
    """Twelve blocks of 20 rows whose signs are drawn: 400 for each, and 12 / 11 of it."""
    signs = np.random.default_rng(3).choice([1.0, -1.0], 12)
    slow = np.repeat(signs, 20)
    assert variance_of_sum(slow) == pytest.approx(12 * 400 * 12 / 11, rel=0.4)
    assert variance_of_sum(slow) >= 12 * 400 * 12 / 11 - 1e-9


def test_a_ratio_and_its_deviation_by_hand():
    """y = 2 x but for one of three: (1, 2, 3) and (2, 4, 9): 37 / 14; x (y - ratio x) sums to 0."""
    x, y = np.array([1.0, 2.0, 3.0]), np.array([2.0, 4.0, 9.0])
    pulls = x * (y - 37.0 / 14.0 * x)
    expected = np.sqrt(0.01 * pulls @ pulls) / 14.0
    assert velocity_checks.fit_ratio(x, y) == pytest.approx((37.0 / 14.0, expected))
    assert velocity_checks.fit_ratio(np.zeros(3), y) == (1.0, np.inf)


def test_mean_rates_between_instants_are_told_from_their_average():
    """Of t^2 it is the sum of both epochs, of 3 t always 3."""
    t = np.arange(11.0)
    rates = velocity_checks.mean_rate(
        t, np.column_stack([t**2, 3.0 * t]), np.array([1.0, 2.0, 4.0]), np.array([3.0, 3.0, 8.0])
    )
    assert_allclose(rates, np.column_stack([[4.0 - 7.0, 5.0 - 7.0, 12.0 - 7.0], np.zeros(3)]), atol=1e-12)


def wave(t):
    """Three integrals, and their first derivatives."""
    values = np.column_stack([np.sin(0.7 * t), 2.0 * np.cos(0.45 * t), np.sin(0.3 * t + 1.0)])
    rates = np.column_stack([0.7 * np.cos(0.7 * t), -0.9 * np.sin(0.45 * t), 0.3 * np.cos(0.3 * t + 1.0)])
    return values, rates


@pytest.mark.parametrize("shift", [0.2337, -0.7041])
def test_a_shift_and_its_deviation_are_those_of_a_linear_fit(shift):
    """To a hundredth of the step of the search; the reference is 1.3 times as large, with errors of 3 %."""
    t, early = np.arange(0.0, 60.0, 0.002), np.arange(2.0, 55.0, 1.0)
    late = early + 2.0
    errors = 0.03 * np.random.default_rng(2).standard_normal((len(early), 3))

    def rate(at):
        found = (wave(late - at)[0] - wave(early - at)[0]) / 2.0
        return found - found.mean(axis=0)

    clean = 1.3 * rate(shift)
    found, _ = velocity_checks.fit_shift(t, wave(t)[0], early, late, clean + 5.0)
    assert found == pytest.approx(shift, abs=2e-4)
    found, sd = velocity_checks.fit_shift(t, wave(t)[0], early, late, clean + errors)
    seen = clean + errors - errors.mean(axis=0)
    slope = (wave(late - found)[1] - wave(early - found)[1]) / 2.0
    slope -= slope.mean(axis=0)
    own = rate(found)
    both = own - np.sum(own * seen) / np.sum(seen**2) * seen, own - np.sum(own**2) / np.sum(own * seen) * seen
    variance = max(variance_of_sum(np.sum(slope * noise, axis=1)) for noise in both)
    assert sd == pytest.approx(np.sqrt(variance) / np.sum(slope**2), rel=2e-3)
    pulls = np.sum(slope * both[0], axis=1)
    assert abs(found - shift) < 5.0 * np.sqrt(pulls @ pulls) / np.sum(slope**2)


@pytest.mark.parametrize(("end", "enough"), [(24.0, True), (23.0, False)])
def test_a_shift_needs_twenty_references_a_second_within_the_record(end, enough):
    t, early = np.arange(0.0, end, 0.01), np.arange(0.1, 40.0, 1.0)
    found, sd = velocity_checks.fit_shift(t, wave(t)[0], early, early + 2.0, wave(early + 0.8)[1])
    assert np.isfinite([found, sd]).all() == enough
    if enough:
        assert found == pytest.approx(0.2, abs=0.02)


def drive(late=0.0, factors=(1.0, 1.0, 1.0), down=3.0, noise=0.0, t=None):
    """Fixes of a weaving path, every 0.2 s, with velocities that are late and in other units."""
    t = 50.0 + 0.2 * np.arange(300) if t is None else t

    def path(at):
        north, east = 40.0 * np.sin(0.5 * at) + 5.0 * at, 60.0 * np.cos(0.37 * at)
        return np.column_stack([north, east, down * np.sin(0.9 * at) / 0.9])

    lla = earth.displace(np.tile([0.7, 0.3, 150.0], (len(t), 1)), path(t))
    vel_n = (path(t - late + 1e-3) - path(t - late - 1e-3)) / 2e-3 * np.array(factors)
    vel_n += noise * np.random.default_rng(8).standard_normal(vel_n.shape)
    none = np.empty((0, 3))
    return RecordedMotion(np.empty(0), none, none, t, lla, vel_n, 0.0)


@pytest.mark.parametrize(("late", "good"), [(0.0, True), (0.1, False), (-0.3, False), (0.015, True)])
def test_velocities_that_are_late_are_told_by_how_much(late, good):
    (found,) = velocity_checks.check_velocity(drive(late))[0]
    assert (found.value, found.good) == (pytest.approx(-late, abs=2e-3), good)
    assert (f"add {-late:+.3f} to [gnss] velocity_offset_s" in found.text) == (not good)


@pytest.mark.parametrize(
    ("factor", "told"),
    [
        *((3.6, "are these km/h?"), (1.944, "are these knots?"), (3.281, "are these ft/s?")),
        *((1.0 / 1.25, "the unit or a sign"), (1.0 / 0.78, "the unit or a sign")),
        *((1.0 / 1.18, ""), (1.0 / 0.82, "")),
    ],
)
def test_velocities_in_another_unit_are_named_by_axis(factor, told):
    for k, axis in enumerate(("north", "east", "down")):
        factors = [1.0, 1.0, 1.0]
        factors[k] = factor
        found = [one for one in velocity_checks.check_velocity(drive(0.0, factors))[0] if "ratio" in one.name]
        assert [one.name for one in found] == ([f"velocity_ratio_{axis}"] if told else [])
        for one in found:
            assert told in one.text
            assert (one.value, one.good) == (pytest.approx(1.0 / factor, rel=1e-2), False)


@pytest.mark.parametrize(
    ("down", "noise", "compared"),
    [(0.8, 0.0, True), (0.6, 0.0, False), (3.0, 0.8, True), (3.0, 1.3, False)],
)
def test_an_axis_is_compared_if_it_moves_at_half_a_meter_and_eight_times_its_noise(down, noise, compared):
    """The rms of a sine is 0.71 of its size; a quarter of white noise counts as jitter."""
    names = [
        one.name for one in velocity_checks.check_velocity(drive(0.0, (1.0, 1.0, 2.0), 0.5 * down, noise))[0]
    ]
    assert ("velocity_ratio_down" in names) == compared


@pytest.mark.parametrize(("axes", "unit"), [(np.eye(3), 1.0), (np.eye(3)[[1, 0, 2]], 1.0), (np.eye(3), 3.6)])
def test_a_gait_that_is_sampled_hides_no_axes_and_reverses_none(axes, unit):
    """Walks whose vertical velocities and positions have nothing to do with each other, 40 at random."""
    rng = np.random.default_rng(11)
    for _ in range(40):
        level = 0.7 * np.cumsum(rng.standard_normal((300, 2)), axis=0) / 10.0
        down = rng.uniform(0.03, 0.1, 2) * rng.standard_normal((300, 2))
        by_position = np.column_stack([level + 0.05 * rng.standard_normal((300, 2)), down[:, 0]])
        by_velocity = unit * np.column_stack([level, down[:, 1]]) @ axes.T
        found = find_frame(by_position, by_velocity)
        np.testing.assert_allclose(found.matrix, axes.T / unit)
        assert (found.text == "") == (unit == 1.0 and np.array_equal(axes, np.eye(3)))


def test_slow_noise_of_a_velocity_is_no_unit():
    """Positions move half of velocities whose half is slow noise, and no unit is wrong."""
    slow = np.sin(np.arange(4000) / np.array([[31.0], [17.0]]))
    by_position = np.tile(slow[0], (3, 1)).T
    for noise, factor, wrong in ((1.0, 1.0, 0), (1.0, 3.6, 3), (0.0, 2.0, 3), (1.0, -1.0, 3)):
        by_velocity = factor * (by_position + noise * slow[1][:, None])
        assert len(velocity_checks.check_ratios(by_position, by_velocity)) == wrong


def test_a_vertical_velocity_of_zero_is_not_compared():
    """A receiver without one says 0 while its heights change."""
    path = np.sin(np.arange(90) / np.array([[9.0], [7.0], [5.0]])).T
    assert velocity_checks.check_ratios(path, path * [1.0, 1.0, 0.0]) == []


def test_without_enough_velocities_in_a_row_nothing_is_compared():
    said = {}
    for count in (21, 22):
        one = drive(t=50.0 + np.arange(float(count)))
        said[count] = velocity_checks.check_velocity(one)[0][0].text
    assert "no velocity; its positions alone" in said[21]
    assert "whether its velocities are on time" in said[22]
    half = drive()
    half.vel_n[:149] = np.nan
    assert "fits its positions" in velocity_checks.check_velocity(half)[0][0].text
    half.vel_n[:151] = np.nan
    assert "no velocity" in velocity_checks.check_velocity(half)[0][0].text
    steps = np.tile([1.0, 1.6], 30)[:-1]
    (found,) = velocity_checks.check_velocity(drive(t=50.0 + np.concatenate([[0.0], np.cumsum(steps)])))[0]
    assert "too few velocities in a row" in found.text


@pytest.mark.parametrize(
    ("climb", "ratio", "told"), [(19.0, 1.0, None), (21.0, 3.4, "feet"), (21.0, 1.6, "unit")]
)
def test_heights_of_a_short_climb(climb, ratio, told):
    """Two heights by turns, errors of a tenth; a fix after the end of the barometer does not count."""
    t = np.arange(41.0)
    up = np.where(np.arange(41) // 2 % 2, 1.0, -1.0)
    wrong = np.where(np.arange(41) % 2, 0.1, -0.1)
    baro = BaroData(t[:40], t[:40], np.ones(40, np.bool_), (climb * (ratio * up + wrong))[:40], np.ones(40))
    lla = np.column_stack([np.zeros((41, 2)), 100.0 + climb * up])
    lla[40, 2] = 9e3
    none = np.empty((0, 3))
    motion = RecordedMotion(np.empty(0), none, none, t, lla, np.full((41, 3), np.nan), 0.0)
    found = validity.check_heights("baro", motion, baro)
    assert len(found) == (told is not None)
    for one in found:
        assert one.value == pytest.approx(ratio)
        assert "(sd 0.100)" in one.text
        assert (told in one.text, one.good) == (True, told is None)


def test_one_mistake_has_one_line():
    """A unit shows in two checks, one is kept; two changes of a frame that take back each other are none."""

    def check(name, good=False, **advice):
        return Check(name, 1.0, name, good, advice)

    def kept(*checks):
        return [one.name for one in validity.keep_causes(list(checks))]

    assert kept(check("gyro_max_deg_s"), check("turn_gain")) == ["turn_gain"]
    assert kept(check("gyro_max_deg_s"), check("turn_gain", True)) == ["gyro_max_deg_s", "turn_gain"]
    assert kept(check("gravity_ratio"), check("force_gain")) == ["gravity_ratio"]
    up, over = np.diag([1.0, 1.0, -1.0]), np.eye(3)[[1, 0, 2]]
    frames = [
        check("velocity_axes", **{"gnss.velocity": up}),
        check("velocity_ratio_down", **{"gnss.velocity": up}),
    ]
    assert kept(*frames) == []
    frames[0] = check("velocity_axes", **{"gnss.velocity": over})
    assert kept(*frames) == ["velocity_axes", "velocity_ratio_down"]
