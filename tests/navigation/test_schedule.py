"""The plan of a filter against the same by its definition, row by row, without a compiled pass."""

import numpy as np

import bench
from bench.data import ImuData
from bench.navigation.engine.timeline import TIME_TOLERANCE
from bench.navigation.error_state_filter.schedule import Schedule
from bench.navigation.error_state_filter.step_entries import (
    AT_ONCE,
    GO_ON,
    MEASURE,
    OUTPUT,
    USE,
    find_kernel,
)


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


def step_at(ends: list[float], now: float, t: float) -> int:
    """Return the first step that ends at an instant or later, -1 at the start."""
    if t < now + TIME_TOLERANCE:
        return -1
    return next((k for k, end in enumerate(ends) if end >= t - TIME_TOLERANCE), len(ends))


def test_every_row_is_measured_and_used_at_its_step_in_a_slot_of_its_own():
    rng, spec = np.random.default_rng(4), bench.load_profile("circuit").sensors.imu
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
    assert len(set(done)) == len(done) == 3 * 36


def test_an_instant_is_found_wherever_the_search_begins():
    rng = np.random.default_rng(6)
    t = np.sort(rng.integers(0, 40, 60)) / 10.0
    for wanted in np.concatenate([t, t + 0.05, [-1.0, 9.0]]):
        first = int(np.searchsorted(t, wanted, side="left"))
        assert {find_kernel(t, wanted, near) for near in range(-1, len(t) + 1)} == {first}
