"""The plan of a filter against the same by its definition, row by row, and at the tolerance of time."""

from types import SimpleNamespace

import numpy as np
import pytest

import bench
from bench.core.records.data import ImuData
from bench.core.records.instruments import BaroData
from bench.core.words.exceptions import EstimatorError
from bench.navigation.engine.timeline import TIME_TOLERANCE
from bench.navigation.error_state_filter import schedule as schedule_module
from bench.navigation.error_state_filter.aiding_sensors import BARO
from bench.navigation.error_state_filter.schedule import Schedule
from bench.navigation.error_state_filter.step_entries import (
    AT_ONCE,
    GO_ON,
    MEASURE,
    OUTPUT,
    USE,
    find_kernel,
    plan_kernel,
)
from tests.navigation.test_error_state import plain


@pytest.fixture(autouse=True, scope="module")
def _within_bounds():
    """Plan in plain Python, which does not write beyond the end of an array."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(schedule_module, "plan_kernel", plain(plan_kernel))
        yield


def take(schedule: Schedule, spec, begin: float, end: float, rng) -> None:
    """Let a schedule take samples at 100 Hz, and three kinds of measurements with latency of their own."""
    t = np.arange(round(begin * 100) + 1, round(end * 100) + 1) / 100
    still = np.zeros((len(t), 3))
    imu = ImuData(t, np.full(len(t), 0.01), t > 0, still, still)
    _, span, _, _ = schedule._intake.take(imu, spec, last=schedule.last)
    if len(schedule.imu):
        old = schedule.imu
        span = np.append(schedule.span, span)
        imu = ImuData(*(np.concatenate([getattr(old, n), getattr(imu, n)]) for n in imu.__slots__))
    first = len(imu) - len(span)
    schedule.imu, schedule.span, schedule.rows = imu, span, np.arange(first, len(imu))
    for kind, latency in ((0, 0.23), (2, 0.04), (4, 0.0)):
        arrival = np.sort(rng.uniform(begin + 0.005, end, 12))
        schedule._wait(
            kind, arrival - latency * (arrival > 0.3), arrival, rng.normal(size=(12, 3)), np.ones(6)
        )
    schedule.output_t = np.append(
        schedule.output_t, begin + 0.005 * np.arange(1, round(200 * (end - begin)) + 1)
    )


SPECS = bench.read_profile("figure-eight").sensors.assumed
START, END, NEAR, FAR = 0.5, 1.5, 0.5 * TIME_TOLERANCE, 2.0 * TIME_TOLERANCE
"""Of the first piece; two epochs are the same, and are not."""


def piece(begin, end, rows=(), wanted=()):
    """Samples at 100 Hz, heights (validity, arrival), and epochs to answer at."""
    t = np.arange(round(begin * 100) + 1, round(end * 100) + 1) / 100
    still, (valid, arrival) = np.zeros((len(t), 3)), np.reshape(rows, (-1, 2)).T
    imu = ImuData(t, np.full(len(t), 0.01), t > 0, still, still)
    baro = BaroData(valid, arrival, valid > -1, 10.0 + valid, np.full(len(valid), 0.5))
    return SimpleNamespace(imu=imu, baro=baro, output_t=np.array(wanted, float), specs=SPECS)


def update(schedule, sensors, last=False):
    schedule.take(sensors, last=last)
    schedule.add(BARO, sensors, None, None)
    plan = schedule.plan()
    schedule.advance(plan)
    return plan


def opened(compensate=True):
    return Schedule(START, SPECS.imu, compensate=compensate)


@pytest.mark.parametrize(
    ("valid", "arrival", "used", "told"),
    [
        (START - NEAR, START - NEAR, True, None),
        (START - FAR, START - FAR, False, "baro: 1 rows left out: outside the time of the imu"),
        (START - NEAR, 1.0, True, None),
        (START - FAR, 1.0, False, "baro: 1 rows left out: valid before the start"),
        (1.0, END + NEAR, True, None),
        (1.0, END + FAR, False, "baro: 1 rows left out: outside the time of the imu"),
        (1.0 + NEAR, 1.0, True, None),
        (1.0 + FAR, 1.0, True, "baro: 1 rows valid after their arrival: taken at their arrival"),
    ],
)
def test_a_row_belongs_to_the_record_within_the_tolerance_of_time(valid, arrival, used, told):
    schedule = opened()
    plan = update(schedule, piece(START, END, [(valid, arrival)]), last=True)
    assert [text for *_, text, _ in schedule.events] == ([told] if told else [])
    assert len(plan.measured) == used
    waits = opened()  # its arrival lies in the next piece, or beyond the record
    update(waits, piece(START, 1.2, [(valid, arrival)]))
    update(waits, piece(1.2, END), last=True)
    assert [text for *_, text, _ in waits.events] == ([told] if told else [])


def test_it_stops_before_the_last_sample_and_takes_nothing_from_before_any_more():
    """The newest sample counts when the next one is known; an answer before the record is one of nothing."""

    def after(rows=(), wanted=(), compensate=True):
        schedule = opened(compensate)
        update(schedule, piece(START, END, [(1.0, 1.0)], [1.2]))
        assert schedule.t == 1.49
        return update(schedule, piece(END, 2.0, rows, wanted))

    for t in (1.49 + NEAR, 1.3, 1.2):
        with pytest.raises(EstimatorError, match=rf"a row of baro for {t:.4g} s comes .* on to 1.49 s; open"):
            after([(t, 1.7), (1.6, 1.8)])
    assert after([(1.49 + FAR, 1.7)]).measured[0, 0] == pytest.approx(11.49)
    assert len(after([(1.3, 1.7)], compensate=False).measured) == 1  # counts when it arrives
    with pytest.raises(EstimatorError, match=r"baro: a row that arrived at 0.999998 s comes after .* at 1 s"):
        after([(1.6, 1.0 - FAR), (1.7, 1.7)])
    with pytest.raises(EstimatorError, match=r"a row of baro for 1 s comes"):
        after([(1.49, 1.0 - NEAR)])  # as late as it may
    with pytest.raises(
        EstimatorError, match=r"an answer for 1.48 s comes when the filter has gone on to 1.49 s"
    ):
        after(wanted=[1.48, 1.485, 1.6])
    with pytest.raises(EstimatorError, match=r"an answer for 1.49 s"):
        after(wanted=[1.49 - FAR])
    assert len(after(wanted=[1.49 - NEAR, 1.6]).outputs) == 2
    for t in (START, START - NEAR):
        with pytest.raises(EstimatorError, match=r"an answer for 0\..* has gone on to 1.49 s"):
            after(wanted=[t])
    assert len(after(wanted=[START - FAR]).outputs) == 0


def step_at(ends: list[float], now: float, t: float) -> int:
    """Return the first step that ends at a time or later, -1 at the start."""
    if t < now + TIME_TOLERANCE:
        return -1
    return next((k for k, end in enumerate(ends) if end >= t - TIME_TOLERANCE), len(ends))


def test_every_row_is_measured_and_used_at_its_step_in_a_slot_of_its_own():
    rng, spec = np.random.default_rng(4), bench.read_profile("circuit").sensors.imu
    schedule = Schedule(0.0, spec, compensate=True)
    done = []
    for begin, end in ((0.0, 1.1), (1.1, 2.0), (2.0, 3.0)):
        schedule.last = end == 3.0
        take(schedule, spec, begin, end, rng)
        waiting, wanted, now = schedule.waiting, schedule.output_t, schedule.t
        plan = schedule.plan(0.4)
        ends, due = plan.steps.t.tolist(), plan.entries.tolist()
        expected, held = [], []
        for k, (kind, t, arrival, slot) in enumerate(
            zip(waiting.kind, waiting.t, waiting.arrival, waiting.slot, strict=True)
        ):
            use, measure = step_at(ends, now, arrival), step_at(ends, now, t)
            if slot == 0 and measure == use <= plan.go_to:
                expected.append((use, AT_ONCE, kind, k))
                continue
            if slot == 0 and measure <= plan.go_to:
                expected.append((measure, MEASURE, kind, k))
            if use <= plan.go_to:
                expected.append((use, USE, kind, k))
            if slot > 0 or measure <= plan.go_to:
                given = {one[4] for one in due if one[1] in (MEASURE, USE) and one[3] == k}
                held.append((-2 if slot > 0 else measure, use, *given))
                assert slot in (0, *given)
        found = [tuple(one[:4]) for one in due if one[1] < OUTPUT]
        assert found == sorted(expected, key=lambda one: (one[0], one[2], one[1], one[3]))
        assert {AT_ONCE, USE} <= {one[1] for one in found}
        assert max(slot for _, _, slot in held) < plan.slots < 12
        for k, (first, last, slot) in enumerate(held):
            assert all(slot != other or last < a or b < first for a, b, other in held[:k])
        answers = [one for one in due if one[1] == OUTPUT]
        for (step, _, _, at, _), ahead in zip(
            sorted(answers, key=lambda one: one[3]), plan.ahead, strict=True
        ):
            begun = now if step < 0 else ends[step]
            assert 0 <= ahead < 1
            assert step <= plan.go_to
            length = plan.steps.span[min(step + 1, len(ends) - 1)]
            np.testing.assert_allclose(begun + ahead * length, wanted[plan.outputs[at]], atol=1e-12)
        assert sorted(plan.outputs) == np.flatnonzero(wanted <= ends[plan.go_to] + TIME_TOLERANCE).tolist()
        assert [one[0] for one in due if one[1] == GO_ON] == ([] if schedule.last else [plan.go_to])
        used = np.array([step_at(ends, now, t) <= plan.go_to for t in waiting.arrival])
        np.testing.assert_array_equal(plan.left.arrival, waiting.arrival[~used])
        done += waiting.arrival[used].tolist()
        schedule.advance(plan)
        assert schedule.last or schedule.t == pytest.approx(end - 0.41)  # before what is 0.4 s old
    assert len(set(done)) == len(done) == 3 * 36


def test_an_instant_is_found_wherever_the_search_begins():
    rng = np.random.default_rng(6)
    t = np.sort(rng.integers(0, 40, 60)) / 10.0
    for wanted in np.concatenate([t, t + 0.05, [-1.0, 9.0]]):
        first = int(np.searchsorted(t, wanted, side="left"))
        assert {find_kernel(t, wanted, near) for near in range(-1, len(t) + 1)} == {first}
