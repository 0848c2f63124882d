"""What waits for its step: measurements, the slots of those measured and not yet used, IMU samples."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields, replace
from itertools import accumulate
from typing import Any, NamedTuple

import numpy as np

from bench.arrays import BoolArray, FloatArray, IntArray
from bench.data import GnssObservations
from bench.navigation.engine.session import require

_WHOLE = ("epoch_start", "klobuchar", "gps_t0")  # not a column


class Rows(NamedTuple):
    """Measurements of one kind that wait, in the order of their arrival."""

    t: FloatArray  # (M,) validity [s]
    arrival: FloatArray  # (M,) [s]
    values: FloatArray  # (M, 9), of a fix with its antenna; of satellites nothing
    variance: FloatArray  # (M, 6)
    slot: IntArray  # (M,) where it waits, measured but not used; 0: not yet measured
    number: IntArray  # (M,) of satellites: the epoch in the sky

    def take(self, rows: Any) -> Rows:
        """Return some of them."""
        return Rows(*(column[rows] for column in self))

    def joined(self, other: Rows) -> Rows:
        """Return these and others."""
        return Rows(*(np.concatenate(pair) for pair in zip(self, other, strict=True)))


_NO_ROWS = Rows(
    np.zeros(0), np.zeros(0), np.zeros((0, 9)), np.zeros((0, 6)), np.zeros(0, np.int64), np.zeros(0, np.int64)
)


class Waiting(NamedTuple):
    """What waits, of all kinds."""

    kind: IntArray  # (M,)
    t: FloatArray  # (M,) validity [s]
    arrival: FloatArray  # (M,) [s]
    slot: IntArray  # (M,) where it waits, measured but not used; 0: not yet measured
    row: IntArray  # (M,) of satellites the epoch in the sky, of all others the row of ``values``
    values: FloatArray  # (R, 9) of all but satellites
    variance: FloatArray  # (R, 6)
    parts: list[slice]  # of each kind

    @classmethod
    def of(cls, rows: Mapping[int, Rows], satellites: int) -> Waiting:
        """Return the rows of all kinds, ``satellites`` that of satellites, as one."""
        every = [_NO_ROWS, *rows.values()]
        lengths = [len(one.t) for one in every]
        kind = np.repeat(np.array([0, *rows]), lengths)
        t, arrival, values, variance, slot, number = map(np.concatenate, zip(*every, strict=True))
        row = np.arange(len(t))
        if satellites in rows:
            tabled = kind != satellites
            values, variance = values[tabled], variance[tabled]
            row = np.where(tabled, np.cumsum(tabled) - 1, number)
        ends = list(accumulate(lengths))
        return cls(kind, t, arrival, slot, row, values, variance, list(map(slice, ends, ends[1:])))


def check_rows(place: str, rows: Rows) -> None:
    """Check the shapes of measurements that come from a file.

    Raises
    ------
    ValueError
        With the name of what is wrong.
    """
    m = len(rows.t)
    for name, column, shape in zip(Rows._fields, rows, ((m,), (m,), (m, 9), (m, 6), (m,), (m,)), strict=True):
        require(column.shape == shape, f"{place}/{name}", f"must have shape {shape}")


def give_slots(measure: IntArray, use: IntArray, slot: IntArray, go_to: int) -> IntArray:
    """Return the slot of each measurement: 0 if it is used at once, else one that is free while it waits.

    Those that have one keep it; those to measure after the step ``go_to`` get none.
    """
    slot = slot.copy()
    busy = [-1] * int(slot.max(initial=0))  # until which step each slot is taken
    for k in np.flatnonzero(slot > 0).tolist():
        busy[slot[k] - 1] = int(use[k])
    late = np.flatnonzero((slot == 0) & (measure != use) & (measure <= go_to))
    late = late[np.argsort(measure[late], kind="stable")]
    given = []
    for begun, until in zip(measure[late].tolist(), use[late].tolist(), strict=True):
        at = next((at for at, end in enumerate(busy) if end < begun), len(busy))
        busy[at : at + 1] = [until]
        given.append(at + 1)
    slot[late] = given
    return slot


def columns(record: Any) -> dict[str, Any]:
    """Return the fields of a record by name."""
    return {f.name: getattr(record, f.name) for f in fields(record)}


def take_rows(record: Any, rows: Any) -> Any:
    """Return rows of a record of columns."""
    return type(record)(*(getattr(record, f.name)[rows] for f in fields(record)))


def take_observations(o: GnssObservations, rows: BoolArray) -> GnssObservations:
    """Return some rows (K,) of a record of satellites, in the epochs that have any."""
    counts = np.bincount(o.epoch[rows], minlength=len(o.epoch_start) - 1)
    by_row = {name: column[rows] for name, column in columns(o).items() if name not in _WHOLE}
    return replace(o, epoch_start=np.concatenate([[0], np.cumsum(counts[counts > 0])]), **by_row)


def join_rows(first: Any, second: Any) -> Any:
    """Return two records of a kind as one."""
    joined = columns(first)
    for name, column in joined.items():
        if name not in _WHOLE:
            joined[name] = np.concatenate([column, getattr(second, name)])
    if isinstance(first, GnssObservations):
        joined["epoch_start"] = np.append(first.epoch_start, first.epoch_start[-1] + second.epoch_start[1:])
    return type(first)(**joined)
