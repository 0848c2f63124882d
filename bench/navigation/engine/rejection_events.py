"""What a filter refused in a row, as events."""

from __future__ import annotations

import numpy as np

from bench.arrays import FloatArray, IntArray
from bench.data import EventRow

Refused = dict[int, tuple[float, float, int]]
"""Channel -> instants of the first and the last [s] and number of the refusals that have not ended."""


def refusals(
    t: FloatArray,
    marks: IntArray,
    names: list[str],
    so_far: Refused,
    *,
    last: bool,
) -> list[EventRow]:
    """Return an event for every row of refusals of one channel that has ended, from its first to its last.

    ``so_far`` holds those of earlier pieces that have not; after the ``last`` piece all have.
    """
    if not so_far and marks[2].all():
        return []
    ended: list[tuple[int, tuple[float, float, int]]] = []
    first = marks[1] == 0
    for channel in {*np.unique(marks[3, first & (marks[2] == 0)]).tolist(), *so_far}:
        rows = np.flatnonzero(first & (marks[3] == channel))
        refused = marks[2, rows] == 0
        edges = np.flatnonzero(np.diff(np.concatenate([[False], refused, [False]]).astype(np.int64)))
        before = so_far.pop(channel, None)
        if before is not None and not refused[:1].any():
            ended.append((channel, before))
        for begin, end in edges.reshape(-1, 2).tolist():
            row = float(t[rows[begin]]), float(t[rows[end - 1]]), end - begin
            if before is not None and begin == 0:
                row = before[0], row[1], before[2] + row[2]
            ended.append((channel, row))
        if ended and ended[-1][0] == channel and not last and (not len(rows) or refused[-1]):
            so_far[channel] = ended.pop()[1]
    return sorted(
        (begin, end, "refused", f"{names[channel]}: {count} in a row refused", names[channel])
        for channel, (begin, end, count) in ended
    )
