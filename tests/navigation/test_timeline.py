"""Rows that cannot be used are left out, counted and told; the solution is bit-identical to one without them.

Each reason in turn: flagged by the unit, not finite, repeated, going back in time, too early or too late; and
the order of arrival, which is the order of use. Nothing is repaired: a missing IMU row is a gap that an event
names.
"""

from __future__ import annotations

from dataclasses import fields, replace

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from bench.core.mathematics import earth, rotation
from bench.navigation.built_in import load
from bench.navigation.engine import timeline
from bench.navigation.models.loose_tight import Loose
from tests.builders import assert_same_solution, put, take
from tests.weaving import units

FLIGHT, UNITS = (20.0,), units()


@pytest.fixture(scope="module")
def sound(sensed):
    solution = Loose(covariance_hz=None).run(sensed.data, sensed.initial)
    assert len(solution.events) == 0
    return solution


def with_bad_row(record, after, **values):
    """A record with one more row after another, a copy of it but for some values."""
    rows = np.insert(np.arange(len(record)), after + 1, after)
    return put(take(record, rows), after + 1, **values)


def run(sensed, **changes):
    return Loose(covariance_hz=None).run(replace(sensed.data, **changes), sensed.initial)


def left_out(solution):
    """What the events say, without times."""
    return [text for _, _, text in solution.events.select("timeline")]


# --- aiding -------------------------------------------------------------------------------------------

GARBAGE = {"lla": [0.1, 0.2, 3.0], "vel_n": [900.0, 0.0, 0.0]}

BAD_FIXES = {
    "flagged": ({"valid": False, **GARBAGE}, "flagged or not finite"),
    "position NaN": ({"lla": np.nan}, "flagged or not finite"),
    "one position infinite": ({"lla": [0.8, np.inf, 800.0]}, "flagged or not finite"),
    "no time": ({"t": np.nan, **GARBAGE}, "flagged or not finite"),
    "never arrived": ({"t_arrival": np.nan, **GARBAGE}, "flagged or not finite"),
    "repeated": ({}, "repeated or going back in time"),
    "repeated with other values": (GARBAGE, "repeated or going back in time"),
    "repeated a nanosecond later": ({"t": 8.0 + 1e-9, **GARBAGE}, "repeated or going back in time"),
    "older than the row before": ({"t": 6.5, **GARBAGE}, "repeated or going back in time"),
    "arrives after the end": ({"t": 20.5, "t_arrival": 20.6, **GARBAGE}, "outside the time of the imu"),
    "arrives before the start": ({"t": -0.6, "t_arrival": -0.5, **GARBAGE}, "outside the time of the imu"),
}


@pytest.mark.parametrize("case", BAD_FIXES)
def test_a_fix_left_out_is_counted_and_leaves_no_trace(sensed, sound, case):
    values, why = BAD_FIXES[case]
    fixes = with_bad_row(sensed.data.fixes, 7, **values)
    solution = run(sensed, fixes=fixes)
    assert_same_solution(solution, sound)
    assert left_out(solution) == [f"gnss: 1 rows left out: {why}"]


BAD_HEIGHTS = {
    "flagged": ({"valid": False, "alt_baro": -1e4}, "flagged or not finite"),
    "NaN": ({"alt_baro": np.nan}, "flagged or not finite"),
    "repeated": ({"alt_baro": -1e4}, "repeated or going back in time"),
    "older": ({"t": 3.3, "alt_baro": -1e4}, "repeated or going back in time"),
    "late": ({"t": 20.2, "t_arrival": 20.2, "alt_baro": -1e4}, "outside the time of the imu"),
}


@pytest.mark.parametrize("case", BAD_HEIGHTS)
def test_a_height_left_out_is_counted_and_leaves_no_trace(sensed, sound, case):
    values, why = BAD_HEIGHTS[case]
    solution = run(sensed, baro=with_bad_row(sensed.data.baro, 39, **values))
    assert_same_solution(solution, sound)
    assert left_out(solution) == [f"baro: 1 rows left out: {why}"]


def test_a_row_that_is_used_does_leave_a_trace(sensed, sound):
    """What the tests above would miss if aiding were ignored altogether."""
    solution = run(sensed, baro=put(sensed.data.baro, 39, alt_baro=sensed.data.baro.alt_baro[39] + 0.1))
    assert left_out(solution) == []
    assert not np.array_equal(solution.lla, sound.lla)


def test_an_event_spans_the_rows_it_counts(sensed):
    fixes = sensed.data.fixes
    valid = fixes.valid.copy()
    valid[[3, 4, 11]] = False
    fixes = type(fixes)(**{f.name: getattr(fixes, f.name) for f in fields(fixes)} | {"valid": valid})
    (event,) = run(sensed, fixes=fixes).events.select("timeline")
    assert event == (4.0, 12.0, "gnss: 3 rows left out: flagged or not finite")


def test_rows_in_any_order_are_used_in_the_order_they_arrive(sensed, sound):
    """A log written backwards holds the same rows."""
    solution = run(
        sensed,
        fixes=take(sensed.data.fixes, np.s_[::-1]),
        baro=take(sensed.data.baro, np.s_[::-1]),
    )
    assert_same_solution(solution, sound)
    assert left_out(solution) == []


def test_a_row_is_used_at_the_first_imu_sample_after_it_arrives(sensed):
    fixes = put(sensed.data.fixes, 4, t_arrival=5.0021)
    innovations = run(sensed, fixes=fixes, baro=None).innovations
    assert_allclose(np.unique(innovations.t)[3:6], [4.0, 5.005, 6.0], atol=1e-9)


def test_a_row_overtaken_on_its_way_is_left_out(sensed):
    fixes = put(sensed.data.fixes, 4, t_arrival=6.5)
    solution = run(sensed, fixes=fixes, baro=None)
    assert left_out(solution) == ["gnss: 1 rows left out: repeated or going back in time"]
    assert_allclose(np.unique(solution.innovations.t)[3:6], [4.0, 6.0, 7.0], atol=1e-9)


def test_a_start_in_the_middle_of_a_record_uses_only_what_comes_after_it(sensed, sound):
    """A fix from before the start would pull the aircraft back to where it was."""
    k = int(np.flatnonzero(np.isclose(sound.t, 9.5))[0])
    initial = replace(
        sensed.initial,
        t=9.5,
        lla=sound.lla[k],
        vel_n=sound.vel_n[k],
        q_nb=sound.q_nb[k],
        cov=sound.cov[k],
    )
    solution = Loose(covariance_hz=None).run(sensed.data, initial)
    assert_allclose(np.unique(solution.innovations.t)[0], 9.6, atol=1e-9)
    assert len(solution.innovations) == 6 * 11 + 53
    before = solution.t < 9.5 - 1e-6
    assert np.isnan(solution.lla[before]).all()
    assert np.isfinite(solution.lla[~before]).all()
    assert_array_equal(solution.lla[k], initial.lla)
    assert sorted(left_out(solution)) == [
        "baro: 47 rows left out: outside the time of the imu",
        "gnss: 9 rows left out: outside the time of the imu",
        "imu: 1900 rows left out: before the start",
    ]


@pytest.mark.parametrize(
    "name", ["loose-22", "ukf", "classic-22", "bench.cli.new_files.starting_point:StartingPoint"]
)
def test_a_measurement_at_the_start_is_compared_with_the_start(truth, sensed, name):
    """True state, error-free fix in a turn: no innovation. One sample later it would be 0.1 m."""
    k = 1000
    start = replace(
        sensed.initial, t=float(truth.t[k]), lla=truth.lla[k], vel_n=truth.vel_n[k], q_nb=truth.q_nb[k]
    )
    arm_b = sensed.data.antenna_b
    rate_b = truth.dtheta_b[k] / (truth.t[k + 1] - truth.t[k])
    fixes = put(
        sensed.data.fixes, 4, t=start.t, t_arrival=start.t,
        lla=earth.displace(start.lla, rotation.rotate(start.q_nb, arm_b)),
        vel_n=start.vel_n + rotation.rotate(start.q_nb, np.cross(rate_b, arm_b)),
    )  # fmt: skip
    table = load(name, {}).run(replace(sensed.data, fixes=fixes, baro=None), start).innovations
    first = table.t < start.t + 1e-6
    assert first.sum() == 6
    assert_allclose(table.z[first], 0.0, atol=5e-3)  # noise of the gyros on the arm


def test_records_without_rows_are_no_aiding(sensed):
    none = np.s_[:0]
    empty = run(sensed, fixes=take(sensed.data.fixes, none), baro=take(sensed.data.baro, none))
    assert len(empty.innovations) == 0
    without_fixes = run(sensed, fixes=None, baro=take(sensed.data.baro, none))
    assert_array_equal(empty.lla, without_fixes.lla)


# --- the IMU ------------------------------------------------------------------------------------------

BAD_SAMPLES = {
    "flagged": ({"valid": False, "dvel_b": 50.0}, "flagged, not finite or without length"),
    "rotation NaN": ({"dtheta_b": np.nan}, "flagged, not finite or without length"),
    "velocity infinite": ({"dvel_b": -np.inf}, "flagged, not finite or without length"),
    "no time": ({"t": np.nan, "dvel_b": 50.0}, "flagged, not finite or without length"),
    "no length": ({"dt": 0.0, "dvel_b": 50.0}, "flagged, not finite or without length"),
    "length NaN": ({"dt": np.nan, "dvel_b": 50.0}, "flagged, not finite or without length"),
    "length infinite": ({"dt": np.inf, "dvel_b": 50.0}, "flagged, not finite or without length"),
    "repeated": ({}, "repeated or going back in time"),
    "repeated with other values": ({"dvel_b": 0.5}, "repeated or going back in time"),
    "older": ({"t": 3.0, "dvel_b": 0.5}, "repeated or going back in time"),
    "time of another day": ({"t": 86_400.0, "dvel_b": 0.5}, "ahead of the rows after it"),
    "velocity of 1e6 m/s": (
        {"dvel_b": [0.0, 1e6, 0.0]},
        "accelerometer at or beyond its range of 100 g",
    ),
    "turn of 1 rad": ({"dtheta_b": [-1.0, 0.0, 0.0]}, "gyro at or beyond its range of 5700 deg/s"),
}


@pytest.mark.parametrize("case", BAD_SAMPLES)
def test_an_imu_row_left_out_is_counted_and_leaves_no_trace(sensed, sound, case):
    values, why = BAD_SAMPLES[case]
    solution = run(sensed, imu=with_bad_row(sensed.data.imu, 1000, **values))
    assert_same_solution(solution, sound)
    assert left_out(solution) == [f"imu: 1 rows left out: {why}"]


def test_the_range_of_the_unit_assumed_is_a_limit(sensed):
    """A sensor that reads its full range says no more than that there was more."""
    spec = sensed.data.specs.imu
    ranged = replace(spec, gyro=replace(spec.gyro, range=2.0), accel=replace(spec.accel, range=60.0))
    imu = put(sensed.data.imu, 400, dvel_b=[-60.0 * 0.005, 0.0, 0.0])
    imu = put(imu, [600, 601], dtheta_b=[[0.0, 0.0, 0.01], [0.0, 0.0, 0.0099]])
    rows, _, events = timeline.imu_rows(imu, 0.0, ranged)
    assert set(np.arange(len(imu))) - set(rows) == {400, 600}
    assert [row[3] for row in events] == [
        "imu: 1 rows left out: gyro at or beyond its range of 114.6 deg/s",
        "imu: 1 rows left out: accelerometer at or beyond its range of 6.118 g",
        "imu: gap of 0.005 s",
        "imu: gap of 0.005 s",
    ]


def test_a_missing_imu_row_is_a_gap_over_which_the_rates_before_it_are_held(sensed, sound):
    keep = np.delete(np.arange(len(sensed.data.imu)), 1000)
    solution = run(sensed, imu=take(sensed.data.imu, keep))
    assert left_out(solution) == ["imu: gap of 0.005 s"]
    (gap,) = solution.events.select("timeline")
    assert_allclose(gap[:2], [sensed.data.imu.t[999], sensed.data.imu.t[1001]])
    early = sound.t < 5.0
    assert_array_equal(solution.lla[early], sound.lla[early])
    moved = np.abs(solution.vel_n - sound.vel_n).max()
    assert 0 < moved < 0.02  # the noise of one sample; without the row's 9.8 m/s^2 it would be 0.05 m/s


def test_imu_rows_and_spans_by_hand(sensed):
    imu = take(sensed.data.imu, np.arange(6))  # ends at 5, 10, ... 30 ms
    imu = put(put(imu, 2, valid=False), 4, t=0.012)
    rows, span, events = timeline.imu_rows(imu, 0.0025, sensed.data.specs.imu)
    assert_array_equal(rows, [0, 1, 3, 5])
    assert_allclose(span, [0.0025, 0.005, 0.01, 0.01], atol=1e-12)
    assert [text for _, _, _, text, _ in events] == [
        "imu: 1 rows left out: flagged, not finite or without length",
        "imu: 1 rows left out: repeated or going back in time",
        "imu: gap of 0.005 s",
        "imu: gap of 0.005 s",
    ]
    steps = timeline.steps(
        imu, rows, span, 0.0025, np.array([0.007, 0.0275]), np.array([0.0124]), sensed.data.specs.imu
    )
    # cut at 7 ms; 10 to 15 ms and 20 to 25 ms bridged by the means before, the first cut at 12.4 ms
    assert_allclose(steps.t, [0.005, 0.007, 0.01, 0.0124, 0.015, 0.02, 0.025, 0.0275, 0.03])
    assert_array_equal(steps.row, [0, 1, 1, 6, 6, 3, 7, 5, 5])
    assert_allclose(steps.share, [0.5, 0.4, 0.6, 0.0024, 0.0026, 1, 0.005, 0.5, 0.5], atol=1e-9)
    for held, before in ((6, [0, 1]), (7, [0, 1, 3])):
        assert_allclose(steps.dtheta_b[held], imu.dtheta_b[before].sum(axis=0) / (0.005 * len(before)))
        assert_allclose(steps.dvel_b[held], imu.dvel_b[before].sum(axis=0) / (0.005 * len(before)))
    assert_array_equal(steps.dvel_b[:6], imu.dvel_b)
    assert_allclose(steps.span, np.diff(steps.t, prepend=0.0025))
    bridged = steps.unknown[:, 0] > 0
    assert_array_equal(np.flatnonzero(bridged), [3, 4, 6])
    # all of the rows before lie in one block of 0.1 s: no spread
    whole = timeline.bridge_variance(np.array([0.005]), np.zeros((1, 2)))[0]
    assert_allclose(steps.unknown[3] + steps.unknown[4], whole)
    assert_allclose(steps.unknown[6], whole)


def test_what_a_gap_adds_is_the_integral_of_a_wandering_rate():
    """Monte Carlo of a Gauss-Markov rate less its value at the start: 4000 runs, 99.9 % of chi-square."""
    rng = np.random.default_rng(3)
    tau, sd, dt, n = timeline.BRIDGE_CORRELATION, timeline.BRIDGE_RATE_SD, 0.02, 400
    x = sd * rng.normal(size=4000)
    start, total, got = x.copy(), np.zeros(4000), []
    for k in range(n):
        old = x
        x = np.exp(-dt / tau) * x + sd * np.sqrt(-np.expm1(-2 * dt / tau)) * rng.normal(size=4000)
        total += 0.5 * dt * (old + x - 2 * start)
        if (k + 1) % 100 == 0:
            got.append(total.var())
    wanted = timeline.bridge_variance(dt * np.arange(100, n + 1, 100), np.zeros((4, 2)))[:, 1]
    assert_allclose(got, wanted, rtol=3.3 * np.sqrt(2 / 4000) + 0.01)
    short = np.array([2.9e-3, 3.1e-3])
    small = timeline.bridge_variance(short, np.zeros((2, 2)))[:, 1] / short**3
    assert_allclose(small, 2 / 3 * sd**2 / tau, rtol=2e-3)
    more = timeline.bridge_variance(short, np.full((2, 2), 0.3)) - timeline.bridge_variance(
        short, np.zeros((2, 2))
    )
    assert_allclose(more, 0.09 * np.tile(short[:, None] ** 2, 2))


def test_an_imu_record_without_a_usable_row_gives_the_start_and_nothing_else(sensed):
    imu = sensed.data.imu
    flagged = type(imu)(imu.t, imu.dt, np.zeros(len(imu), bool), imu.dtheta_b, imu.dvel_b)
    for record in (take(imu, np.s_[:0]), flagged):
        solution = run(sensed, imu=record)
        assert_array_equal(solution.lla[0], sensed.initial.lla)
        assert np.isnan(solution.lla[1:]).all()
        assert "gnss: 20 rows left out: outside the time of the imu" in left_out(solution)


def test_output_beyond_the_imu_is_absent(sensed):
    imu = take(sensed.data.imu, np.arange(2000))  # to 10 s
    solution = run(sensed, imu=imu)
    assert np.isfinite(solution.lla[solution.t <= 10.0]).all()
    assert np.isnan(solution.lla[solution.t > 10.0 + 1e-6]).all()
    assert np.isnan(solution.cov[solution.t > 10.0 + 1e-6]).all()


@pytest.mark.parametrize(
    ("t", "epoch_start", "span"),
    [
        ([], [0, 0, 0], (10.0, 20.0)),
        ([12.0, 12.0, 14.0], [0, 2, 2, 3], (12.0, 14.0)),
        ([12.0, np.nan], [0, 0, 1, 1, 2], (10.0, 20.0)),
        ([1.0, 2.0], [0, 1, 1, 2], (10.0, 10.0)),
        ([12.0, 30.0], [0, 1, 2, 2], (20.0, 20.0)),
    ],
    ids=["nothing at all", "a bridge", "at the start, before a NaN", "before the run", "after the run"],
)
def test_epochs_without_satellites_lie_between_their_neighbors(t, epoch_start, span):
    ((first, last, kind, text, _),) = timeline.empty_epochs(np.array(t), np.array(epoch_start), 10.0, 20.0)
    assert (first, last) == span
    assert kind == "timeline"
    assert text == f"satellites: {np.sum(np.diff(epoch_start) == 0)} epochs without satellites"
    assert not timeline.empty_epochs(np.array([1.0]), np.array([0, 1]), 10.0, 20.0)
