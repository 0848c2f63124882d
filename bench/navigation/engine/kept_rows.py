"""Data that wait for their step: measurements, the slots of measured but unused ones, IMU samples."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import fields, replace
from functools import cache
from typing import Any, NamedTuple, TypeVar

import numpy as np

from bench.core.mathematics.arrays import FloatArray, IntArray
from bench.core.records.data import GnssObservations

_Record = TypeVar("_Record")
_WHOLE = ("epoch_start", "klobuchar", "gps_t0")  # not a column


class Rows(NamedTuple):
    """Waiting measurements; measurements of a kind are in the order of their arrival."""

    kind: IntArray  # (M,)
    t: FloatArray  # (M,) validity [s]
    arrival: FloatArray  # (M,) [s]
    values: FloatArray  # (M, 9), of a fix with its antenna; of satellites nothing
    variance: FloatArray  # (M, 6)
    slot: IntArray  # (M,) where it waits, measured but not used; 0: not yet measured
    number: IntArray  # (M,) of satellites: the epoch in the sky

    def take(self, rows: Any) -> Rows:
        """Return selected measurements."""
        return Rows(*(column[rows] for column in self))

    def joined(self, other: Rows) -> Rows:
        """Return these and other measurements as one."""
        return Rows(*(np.concatenate(pair) for pair in zip(self, other, strict=True)))


def make_rows(kind: int, t: FloatArray, arrival: FloatArray) -> Rows:
    """Return measurements of a kind that have no values."""
    m = len(t)
    none = np.zeros(m, np.int64)
    return Rows(np.full(m, kind), t, arrival, np.zeros((m, 9)), np.zeros((m, 6)), none, none)


_names: Callable[[Any], tuple[str, ...]] = cache(lambda kind: tuple(f.name for f in fields(kind)))


def columns(record: Any) -> dict[str, Any]:
    """Return the fields of a record by name."""
    return {name: getattr(record, name) for name in _names(type(record))}


def take_rows(record: _Record, rows: Any) -> _Record:
    """Return rows of a record; the epochs of a satellite record without rows are dropped."""
    if not isinstance(record, GnssObservations):
        return type(record)(*(getattr(record, name)[rows] for name in _names(type(record))))
    counts = np.bincount(record.epoch[rows])
    taken: Any = {name: column[rows] for name, column in columns(record).items() if name not in _WHOLE}
    taken["epoch_start"] = np.concatenate([[0], np.cumsum(counts[counts > 0])])
    return replace(record, **taken)


def join_rows(first: Any, second: Any) -> Any:
    """Return two records of a kind as one."""
    joined = columns(first)
    for name, column in joined.items():
        if name not in _WHOLE:
            joined[name] = np.concatenate([column, getattr(second, name)])
    if isinstance(first, GnssObservations):
        joined["epoch_start"] = np.append(first.epoch_start, first.epoch_start[-1] + second.epoch_start[1:])
    return type(first)(**joined)
