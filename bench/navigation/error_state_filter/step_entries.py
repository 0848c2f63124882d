"""Entries of a plan, written in a compiled pass: measurements, updates and outputs after each step."""

from __future__ import annotations

from bench.core.compilation.compiled import inner, kernel
from bench.core.mathematics.arrays import BoolArray, FloatArray, IntArray
from bench.navigation.engine.kept_rows import Rows
from bench.navigation.engine.timeline import TIME_TOLERANCE
from bench.navigation.error_state_filter.measurement_rows import SATELLITE_ROWS

AT_ONCE, MEASURE, USE, OUTPUT, GO_ON = range(5)
"""Actions: measure and update at once, measure, update with what was measured, output, just go there."""
_BEFORE = -2  # step of what was measured in an earlier piece
IN_ORDER = (1024, 1, 8)
"""Entries rise by step, by kind and by action, each of these at most 127 and 7: weights of the columns."""
FREE = -3  # step until which a slot is taken that nothing waits in


@kernel
def find_kernel(t: FloatArray, wanted: float, near: int) -> int:
    """Return the first of increasing epochs t (K,) that is not before the one ``wanted``; K: none.

    It is looked for from ``near`` on, in growing steps, where it is not before that.
    """
    low, high, stride = 0, t.shape[0], 1
    if 0 < near <= high and t[near - 1] < wanted:
        low = near
        while low + stride < high and t[low + stride - 1] < wanted:
            low += stride
            stride *= 2
        high = min(high, low + stride)
    while low < high:
        middle = (low + high) // 2
        if t[middle] < wanted:
            low = middle + 1
        else:
            high = middle
    return low


@inner
def _step_kernel(t: FloatArray, start: float, wanted: float, near: int) -> int:
    """Return the step out of those that end at t (K,) that ends at a time [s], -1 at the start."""
    return -1 if wanted < start + TIME_TOLERANCE else find_kernel(t, wanted - TIME_TOLERANCE, near)


@inner
def _slots_kernel(
    measure: IntArray, use: IntArray, order: IntArray, go_to: int, slot: IntArray, busy: IntArray
) -> int:
    """Give each measurement (M,) its slot: 0 if it is used at once, else a free slot while it waits.

    Measurements with a slot keep it; measurements due after the step ``go_to`` get none. ``order``: order of
    measurement; ``busy``: step until which each slot is taken. Return the last slot in use.
    """
    most = 0
    for k in range(slot.shape[0]):
        if slot[k] > 0:
            busy[slot[k] - 1] = use[k]
            most = max(most, slot[k])
    for at in range(slot.shape[0]):
        k = order[at]
        if slot[k] == 0 and measure[k] != use[k] and measure[k] <= go_to:
            free = 0
            while busy[free] >= measure[k]:
                free += 1
            busy[free] = use[k]
            slot[k] = free + 1
            most = max(most, slot[k])
    return most


@inner
def _write_kernel(entries: IntArray, at: int, step: int, action: int, kind: int, row: int, slot: int) -> int:
    """Write an entry; return the place of the next."""
    one = entries[at]
    one[0], one[1], one[2], one[3], one[4] = step, action, kind, row, slot
    return at + 1


@kernel
def plan_kernel(
    t: FloatArray,
    span: FloatArray,
    now: float,
    go_to: int,
    rows: Rows,
    order: IntArray,
    compensate: bool,
    wanted: FloatArray,
    start: float,
    end: float,
    at_ends: bool,
    last: bool,
    left: BoolArray,
    work: IntArray,
    busy: IntArray,
    entries: IntArray,
    ahead: FloatArray,
    outputs: IntArray,
) -> tuple[int, int, int]:
    """Write the entries of a plan until the step ``go_to``; return how many, of how many answers, and slots.

    The steps end at t (K,) after ``span``, the first begins at ``now`` [s]. Of the rows that wait (M,)
    ``order`` is that of validity, the slots go on, and ``left`` is what has not been used then. Of ``wanted``
    (A,) those that are due fill ``outputs``, and how far ahead of a step's end each lies; with ``at_ends``
    each is given at the first step's end from its time on.
    """
    kind, slot = rows.kind, rows.slot
    measure, use, e, m, near = work[0], work[1], 0, 0, 0
    for k in range(slot.shape[0]):
        near = _step_kernel(t, now, rows.arrival[k], near)
        use[k] = near
        measure[k] = use[k]
        if slot[k] > 0:
            measure[k] = _BEFORE
        elif compensate and abs(rows.t[k] - rows.arrival[k]) >= TIME_TOLERANCE:
            measure[k] = _step_kernel(t, now, rows.t[k], 0)
    slots = _slots_kernel(measure, use, order, go_to, slot, busy)
    for k in range(slot.shape[0]):
        row = rows.number[k] if kind[k] == SATELLITE_ROWS else k
        left[k] = use[k] > go_to
        if slot[k] > 0 and measure[k] != _BEFORE:
            e = _write_kernel(entries, e, measure[k], MEASURE, kind[k], row, slot[k])
        if not left[k]:
            e = _write_kernel(entries, e, use[k], USE if slot[k] > 0 else AT_ONCE, kind[k], row, slot[k])
    at = 0
    for k in range(wanted.shape[0]):
        asked = wanted[k]
        at = find_kernel(t, asked - TIME_TOLERANCE, at)
        at_start = abs(asked - now) <= TIME_TOLERANCE
        there = at_start or (at < t.shape[0] and abs(t[at] - asked) <= TIME_TOLERANCE)
        part = 0.0
        if at_ends:
            step = _step_kernel(t, now, asked, at)
            due = asked <= end + TIME_TOLERANCE and step <= go_to
        else:
            step = -1 if at_start else at - 1 + there
            due = (there or at < t.shape[0]) and step < go_to + there
            if due and not there:
                part = (asked - (t[at - 1] if at > 0 else now)) / span[at]
        if due and asked >= start - TIME_TOLERANCE:
            outputs[m], ahead[m] = k, part
            e = _write_kernel(entries, e, step, OUTPUT, 99, m, 0)
            m += 1
    if not last:
        e = _write_kernel(entries, e, go_to, GO_ON, 100, 0, 0)
    return e, m, slots
