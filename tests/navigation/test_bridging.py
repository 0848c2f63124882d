"""Gaps of an IMU by hand: which rates are held, how far they may be off, where steps end, what is wild."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from bench.core.records.data import GnssFixes, ImuData
from bench.core.records.sensor_specs import ImuSpec, TriadSpec
from bench.navigation.engine import timeline
from bench.navigation.engine.imu_range import count_lost, find_beyond, name_ranges
from bench.navigation.engine.imu_sampler import ImuSampler, sum_segments
from tests.builders import put, take

UNIT = ImuSpec("unit", TriadSpec(range=2.0), TriadSpec(range=50.0))
DT = 0.02


def samples(count, rate=0.3, force=-9.0):
    """A record of one length of sample, whose rates go up with the axis."""
    t = DT * np.arange(1, count + 1)
    axes = np.array([1.0, 2.0, 3.0])
    return ImuData(
        t,
        np.full(count, DT),
        np.ones(count, np.bool_),
        np.outer(np.full(count, rate * DT), axes / 3.0),
        np.outer(np.full(count, force * DT), axes / 3.0),
    )


def without(imu, begin, end):
    return take(imu, (imu.t < begin + 1e-6) | (imu.t > end + 1e-6))


def bridged(imu, start=0.0, instants=(), in_gaps=(), spec=UNIT):
    rows, span, _ = timeline.imu_rows(imu, start, spec)
    return timeline.steps(imu, rows, span, start, np.array(instants), np.array(in_gaps), spec)


def test_over_a_gap_the_mean_of_the_last_quarter_second_is_held():
    """A step of the rate counts by how much of that time it takes: thirteen samples."""
    imu = samples(300)
    for last, share in ((13, 1.0), (18, 1.0), (6, 6 / 13)):
        moved = imu.dtheta_b.copy()
        moved[200 - last : 200, 1] += 0.1 * DT
        steps = bridged(without(replace(imu, dtheta_b=moved), 4.0, 4.4))
        held = steps.dtheta_b[-1]
        assert_allclose(held, [0.1, 0.2 + 0.1 * share, 0.3])
        assert_allclose(steps.dvel_b[-1], [-3.0, -6.0, -9.0])


def test_rates_that_varied_over_the_last_two_seconds_may_be_off_by_as_much():
    """Means of a tenth of a second, their spread and the axes' mean square, times the length of the gap."""
    imu = samples(400)
    dtheta, dvel = imu.dtheta_b.copy(), imu.dvel_b.copy()
    block = np.arange(400) // 5
    wave = np.where(block % 2 == 0, 1.0, -1.0)  # from one tenth of a second to the next
    dtheta[:, 0] += 0.06 * wave * DT
    dvel[:, 2] += 0.9 * wave * DT
    inside = np.arange(400) % 2 * 2.0 - 1.0
    dvel[:, 1] += 5.0 * inside * DT  # within one it is noise: 5 samples leave a fifth
    dvel[:99, 0] += 40.0 * DT * (np.arange(99) % 2)  # longer ago
    moved = replace(imu, dtheta_b=dtheta, dvel_b=dvel)
    steps = bridged(without(moved, 4.0, 4.4))
    force = np.sqrt((0.9**2 + 1.0**2) / 3.0)
    rate = np.sqrt(0.06**2 / 3.0)
    plain = bridged(without(imu, 4.0, 4.4)).unknown.sum(axis=0)
    assert_allclose(steps.unknown.sum(axis=0) - plain, np.square([0.4 * force, 0.4 * rate]), rtol=1e-6)


@pytest.mark.parametrize(
    ("name", "size", "more"), [("dvel_b", 41.0, (10.0, 0.0)), ("dtheta_b", 1.7, (0.0, 1.0))]
)
def test_near_the_end_of_a_range_the_true_rate_is_likely_beyond_it(name, size, more):
    """Of the last sample more than 0.8 of the range, either way: 10 m/s^2 or 1 rad/s, for all of the gap."""
    imu = samples(300)
    plain = bridged(without(imu, 4.0, 4.4)).unknown.sum(axis=0)
    values = getattr(imu, name).copy()
    limit = 50.0 if name == "dvel_b" else 2.0
    for part, wanted in ((0.79, np.zeros(2)), (-0.81, np.square(0.4 * np.array(more)))):
        values[199] = values[198]
        values[199, 2] = part * limit * DT
        changed = bridged(without(replace(imu, **{name: values}), 4.0, 4.4)).unknown.sum(axis=0)
        values_spread = np.abs(changed - plain - wanted)
        spread = np.var([np.r_[values[195:200, 2].mean(), [values[190, 2]] * 19]]) / DT**2 / 3.0 * 0.16
        assert values_spread[0 if name == "dvel_b" else 1] == pytest.approx(spread, rel=1e-6)
    assert size / limit > 0.8


def test_what_a_wandering_rate_adds_is_the_integral_of_a_gauss_markov_process():
    """sd 2.5 m/s^2 and 0.15 rad/s, 3 s: the double integral of its covariance less its value at the start."""
    T, n = 4.0, 400
    s = (np.arange(n) + 0.5) * T / n
    a, b = s[:, None], s[None, :]
    kernel = np.exp(-np.abs(a - b) / 3.0) - np.exp(-a / 3.0) - np.exp(-b / 3.0) + 1.0
    integral = kernel.sum() * (T / n) ** 2
    found = timeline.bridge_variance(np.array([T]), np.array([[0.7, 0.2]]))[0]
    assert_allclose(found, integral * np.square([2.5, 0.15]) + np.square([0.7 * T, 0.2 * T]), rtol=1e-4)
    tiny = timeline.bridge_variance(np.array([3e-3 * 0.9]), np.zeros((1, 2)))[0]
    assert_allclose(tiny, 2.0 / 3.0 * (3e-3 * 0.9) ** 3 / 3.0 * np.square([2.5, 0.15]), rtol=1e-9)


def test_steps_over_a_gap_are_no_longer_than_a_twentieth_of_a_second():
    imu = without(samples(300), 4.0, 4.36)
    steps = bridged(imu, instants=[4.013, 5.013], in_gaps=[4.02, 5.027])
    ends = np.linspace(4.0, 4.36, 9)[1:]
    inside = (steps.t > 4.0 + 1e-6) & (steps.t < 4.36 + 1e-6)
    assert_allclose(steps.t[inside], np.sort([*ends, 4.013, 4.02]))
    assert np.isclose(steps.t, 5.013).any()
    assert not np.isclose(steps.t, 5.027).any()
    assert_allclose(steps.span, np.diff(steps.t, prepend=0.0))
    assert_allclose(steps.share[inside], steps.span[inside])  # of one second of the rates held
    assert (steps.row[inside] == len(imu)).all()
    assert_allclose(
        steps.share[~inside],
        np.where(
            np.isin(steps.row[~inside], [np.searchsorted(imu.t, 5.013 - 1e-9)]), steps.span[~inside] / DT, 1.0
        ),
    )
    assert (np.diff(np.cumsum(steps.unknown[:, 0])[inside]) > 0).all()
    assert not steps.unknown[~inside].any()


def test_what_is_held_over_a_gap_after_the_start_comes_from_the_rows_before_it():
    """And where there is none, from the first row behind it."""
    imu = samples(300)
    imu = replace(imu, dtheta_b=imu.dtheta_b * np.where(imu.t < 2.0 + 1e-6, 1.0, 3.0)[:, None])
    later = without(imu, 2.0, 2.4)
    rows, span, _ = timeline.imu_rows(later, 2.0, UNIT)
    steps = timeline.steps(later, rows, span, 2.0, np.empty(0), np.empty(0), UNIT, np.arange(100))
    assert_allclose(steps.dtheta_b[-1], [0.1, 0.2, 0.3])
    steps = timeline.steps(later, rows, span, 2.0, np.empty(0), np.empty(0), UNIT)
    assert_allclose(steps.dtheta_b[-1], [0.3, 0.6, 0.9])


def test_rows_that_a_gap_may_need_are_those_of_the_last_two_seconds():
    imu = samples(300)
    assert_array_equal(timeline.needed_rows(imu, np.arange(0, 300, 2)), np.arange(200, 300, 2))
    fast = replace(imu, t=1.0 + 1e-4 * np.arange(300))
    many = take(fast, np.zeros(9000, np.int64))
    many = replace(many, t=1.0 + 1e-4 * np.arange(9000))
    assert_array_equal(timeline.needed_rows(many, np.arange(9000)), np.arange(5000, 9000))


def test_a_row_whose_time_leaps_ahead_of_those_after_it_is_left_out_alone():
    imu = samples(100)
    rows, span, events = timeline.imu_rows(put(imu, 40, t=imu.t[40] + 0.6), 0.0, UNIT)
    assert set(range(100)) - set(rows.tolist()) == {40}
    assert [text for *_, text, _ in events] == [
        "imu: 1 rows left out: ahead of the rows after it", "imu: gap of 0.02 s"
    ]  # fmt: skip
    assert_allclose(span[40], 2 * DT)
    for bad, back in (
        (put(imu, 40, t=imu.t[40] + 0.4), 20),
        (put(imu, slice(40, None), t=imu.t[40:] - 0.3), 15),
    ):
        rows, _, events = timeline.imu_rows(bad, 0.0, UNIT)
        assert len(rows) == 100 - back
        assert f"imu: {back} rows left out: repeated or going back in time" in [row[3] for row in events]


def test_a_last_row_that_leaps_ahead_waits_for_the_next():
    """It is kept where the next goes on from there; a smaller leap does not wait."""
    imu = samples(100)
    for leap, waits in ((0.47, False), (0.49, True)):
        intake = timeline.ImuIntake(0.0)
        late = put(imu, slice(49, None), t=imu.t[49:] + leap)
        rows, _, _, again = intake.take(take(late, slice(50)), UNIT, last=False)
        assert again.tolist() == ([49] if waits else [])
        assert len(rows) == 50 - waits
        assert intake.newest == intake.before == late.t[49 - waits]
        rows, span, events, again = intake.take(take(late, slice(50 - waits, None)), UNIT, last=False)
        assert len(rows) == 50 + waits
        assert not len(again)
        if waits:
            assert_allclose(span[0], 0.51)
            assert [row[3] for row in events] == [f"imu: gap of {leap:.6g} s"]
    alone = timeline.ImuIntake(0.0)
    rows, _, _, again = alone.take(take(put(imu, 0, t=0.6), slice(1)), UNIT, last=False)
    assert (len(rows), again.tolist()) == (0, [0])
    rows, *_ = timeline.ImuIntake(0.0).take(take(put(imu, 0, t=0.6), slice(1)), UNIT, last=True)
    assert rows.tolist() == [0]


def test_an_event_of_a_gap_says_how_much_is_missing():
    imu = without(samples(100), 1.0, 1.06)
    _, _, events = timeline.imu_rows(imu, 0.0, UNIT)
    ((begin, end, kind, text, sensor),) = events
    assert (kind, text, sensor) == ("timeline", "imu: gap of 0.06 s", "imu")
    assert_allclose([begin, end], [1.0, 1.08])
    shifted = samples(10)
    shifted = put(shifted, 5, t=shifted.t[5] + 0.9e-6)  # epochs closer than a microsecond are the same
    assert not timeline.imu_rows(shifted, 0.0, UNIT)[2]
    shifted = put(shifted, 5, t=shifted.t[5] + 0.6e-6)  # 1.5 in all
    assert len(timeline.imu_rows(shifted, 0.0, UNIT)[2]) == 1


@pytest.mark.parametrize("compiled", [True, False])
@pytest.mark.parametrize("axis", [0, 1, 2])
def test_every_axis_at_the_end_of_its_range_is_seen(axis, compiled):
    """Either way; a nanopart of the range lower it is a sample as any other."""
    check = timeline.check_kernel if compiled else timeline.check_kernel.py_func
    for name, limit in (("dtheta_b", 2.0), ("dvel_b", 50.0)):
        for part, sound in ((1.0, False), (-1.0, False), (1.0 - 1.5e-9, True), (0.5, True)):
            values = getattr(samples(6), name).copy()
            values[3, axis] = part * limit * DT
            imu = replace(samples(6), **{name: values})
            found = check(imu.t, imu.dt, imu.valid, imu.dtheta_b, imu.dvel_b, 0.0, 2.0, 50.0, np.empty(6))
            assert found == (0 if sound else -1)
            beyond = [rows.tolist() for _, rows in find_beyond(imu, UNIT)]
            alone = [False] * 3 + [not sound] + [False] * 2
            assert beyond == ([alone, [False] * 6] if name == "dtheta_b" else [[False] * 6, alone])


@pytest.mark.parametrize("compiled", [True, False])
def test_what_makes_a_row_of_an_imu_no_sample(compiled):
    check = timeline.check_kernel if compiled else timeline.check_kernel.py_func
    span = np.empty(6)

    def look(start=0.0, **values):
        imu = put(samples(6), 3, **values) if values else samples(6)
        return check(imu.t, imu.dt, imu.valid, imu.dtheta_b, imu.dvel_b, start, 2.0, 50.0, span)

    assert look() == 0
    assert_allclose(span, DT)
    assert look(t=0.085) == 1  # a gap before it alone
    assert_allclose(span, [DT, DT, DT, 0.025, 0.015, DT])
    assert look(start=-0.01) == 1
    for wrong in (
        {"valid": False},
        {"t": 0.06 + 0.9e-6},
        {"t": np.inf},
        {"dt": np.inf},
        {"dt": np.nan},
        {"dt": 0.0},
    ):
        assert look(**wrong) == -1
    assert look(t=0.06 + 1.1e-6) == 1


def test_a_flagged_sample_a_quantum_off_the_end_counts_where_the_datasheet_has_a_range():
    """Not where none is known; a row counts for one triad alone, and what is not finite for none."""
    quantized = TriadSpec(range=2.0, quantization=1e-4)
    spec = ImuSpec("unit", quantized, TriadSpec())
    values = samples(6).dtheta_b.copy()
    values[[1, 2, 3], 1] = 2.0 * DT - 0.9e-4, 2.0 * DT - 0.9e-4, 2.0 * DT - 1.1e-4
    imu = replace(samples(6), dtheta_b=values, valid=np.array([True, True, False, False, True, True]))
    force = imu.dvel_b.copy()
    force[[2, 4], 0] = 1e3 * DT
    force[5, 0] = np.nan
    (gyro, first), (accel, second) = find_beyond(replace(imu, dvel_b=force), spec)
    assert gyro == "gyro at or beyond its range of 114.6 deg/s"
    assert accel == "accelerometer at or beyond its range of 100 g"
    assert np.flatnonzero(first).tolist() == [2]
    assert np.flatnonzero(second).tolist() == [4]
    (_, first), _ = find_beyond(imu, replace(spec, gyro=replace(quantized, range=None)))
    assert not first.any()
    counts = count_lost({}, replace(imu, dvel_b=force), slice(1, 3), spec)
    counts = count_lost(counts, replace(imu, dvel_b=force), slice(3, 6), spec)
    assert count_lost(counts, imu, slice(2, 2), spec) is counts
    said = f"1 of 5 samples have the {gyro} and 1 of 5 samples have the {accel}"
    assert name_ranges(counts) == f" ({said})"
    assert name_ranges({}) == ""
    assert name_ranges({"all": 3, gyro: 0}) == ""


class EndsAlone(ImuSampler):
    """Says of each interval its last sample."""

    def measure(self, imu, last):
        return last >= 0, imu.dtheta_b[last], np.arange(6.0)

    def first_needed(self, imu, last):
        return int(last[-1]) if len(last) else 0


@pytest.mark.parametrize("cuts", [[], [1, 2, 30, 31, 77]])
def test_an_interval_ends_with_the_first_sample_at_or_behind_its_end(cuts):
    """Counted from 0.05 s on in steps of 0.1 s; a sample a millionth of a step early is at the end."""
    imu = samples(100)
    imu = put(imu, [22, 42], t=[0.45 - 0.5e-7, 0.85 - 1.5e-7])
    imu = put(imu, slice(None), dtheta_b=np.arange(300.0).reshape(100, 3))
    sampler, found = EndsAlone(0.05, 0.1), []
    for begin, end in zip([0, *cuts], [*cuts, 100], strict=True):
        t, values, variance = sampler.take(take(imu, slice(begin, end)))
        found += zip(t.tolist(), values[:, 0].tolist(), strict=True)
        assert len(variance) == 6
    wanted = [int(np.ceil((0.05 + 0.1 * k) / DT - 1e-9)) - 1 for k in range(0, 20)]
    wanted[4], wanted[8] = 22, 43
    assert [round(t, 4) for t, _ in found] == [round(imu.t[k], 4) for k in wanted]
    assert [v for _, v in found] == [3.0 * k for k in wanted]


def test_sums_of_segments_are_those_of_their_rows():
    values = np.arange(14.0).reshape(7, 2)
    found = sum_segments(values, np.array([0, 1, 5]), np.array([2, 4, 7]))
    assert found.tolist() == [[2.0, 4.0], [12.0, 15.0], [22.0, 24.0]]


def test_fixes_are_used_after_the_sample_at_which_they_have_arrived():
    """From the start on, to the last sample; what comes with the start is used there."""
    t = np.array([0.5, 1.0 - 0.5e-6, 1.0 + 0.5e-6, 1.1, 1.2, 1.2, 1.15, 2.0 + 0.5e-6, 2.5])
    arrival = t + np.array([0.4, 0.0, 0.0, 0.0, 0.05, 0.0, 0.0, 0.0, 0.0])
    sound, none = np.ones(len(t), np.bool_), np.zeros((len(t), 3, 3))
    vel_n = np.zeros((len(t), 3))
    fixes = GnssFixes(t, arrival, sound, np.zeros((len(t), 3)), vel_n, none, none, 9 * sound)
    fixes = put(fixes, [1, 2], t=[1.0 - 0.5e-6, 1.0 + 2.5e-6], t_arrival=[1.0 - 0.5e-6, 1.0 + 0.5e-6])
    fixes = put(fixes, [3, 4], vel_n=[[np.nan] * 3, [0.0, np.nan, 1.0]])
    imu_t = 1.0 + 0.1 * np.arange(1, 11)
    rows, sample, events = timeline.fix_rows(fixes, imu_t, 1.0)
    assert rows.tolist() == [1, 2, 3, 6, 5, 7]
    assert sample.tolist() == [-1, -1, 0, 1, 1, 9]
    assert [(row[0], row[1], row[3]) for row in events] == [
        (1.2, 1.2, "gnss: 1 rows left out: repeated or going back in time"),
        (0.5, 2.5, "gnss: 2 rows left out: outside the time of the imu"),
        (1.1, 1.1, "gnss: 1 fixes without velocity"),
    ]
