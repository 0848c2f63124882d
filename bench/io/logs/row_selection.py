"""The rows of a file that a sensor measured: without other sensors, repetitions and rows without a value."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from bench.core.files import disk_arrays
from bench.core.mathematics.arrays import BoolArray, FloatArray, IntArray
from bench.io.logs.rows import LogRows

HELD = 0.05
"""Fixes in steps shorter than this may be repetitions [s]: few receivers have more than 20 a second."""
_MOVING = 1.0  # speed at which no position stays the same [m/s]
REGULAR = 1.5
"""An interval up to this many median intervals lacks no row [1]."""


def drop_others(rows: LogRows, shown: str) -> LogRows:
    """Return the rows of an IMU without rows of other sensors, which contain no IMU values.

    A row without values stays if the interval without it is too long for the IMU.
    """
    columns = [rows.values[name] for name in ("gyro", "accel", "dtheta", "dvel") if name in rows.values]

    def find_full(block: slice) -> BoolArray:
        return np.asarray(~np.isnan(np.column_stack([column[block] for column in columns])).all(axis=1))

    full = disk_arrays.fill(len(rows.t), find_full, np.bool_)
    if full.all() or np.count_nonzero(full) < 2:
        return rows
    kept, empty = np.flatnonzero(full), np.flatnonzero(~full)
    steps = np.diff(rows.t[kept])
    usual = np.concatenate([[True], steps <= REGULAR * np.median(steps), [True]])
    full[empty] = ~usual[np.searchsorted(kept, empty)]
    if full.all():
        return rows
    note = f"{shown}: {np.count_nonzero(~full)} rows in the table of the IMU have none of its values"
    return _take(rows, np.flatnonzero(full), f"{note} and are left out")


def _take(rows: LogRows, kept: IntArray, note: str) -> LogRows:
    values = {name: disk_arrays.take(value, kept) for name, value in rows.values.items()}
    return replace(rows, t=disk_arrays.take(rows.t, kept), values=values, notes=(*rows.notes, note))


def drop_repeated(rows: LogRows, shown: str) -> LogRows:
    """Return the rows where a fix is new, if a table at the rate of an IMU repeats it or has none in most.

    A fix whose velocity alone is new in most rows, as if interpolated, is new where its position is.
    """
    steps = np.diff(rows.t)
    if not len(steps) or float(np.median(steps)) > HELD:
        return rows
    lla = rows.values["lla"]

    def find_present(block: slice) -> BoolArray:
        return np.asarray(np.isfinite(lla[block]).all(axis=1) & lla[block, :2].any(axis=1))

    has = disk_arrays.fill(len(lla), find_present, np.bool_)
    for block in (("lla", "vel_n"), ("lla",)):
        new = np.flatnonzero(has & _find_new([rows.values[name] for name in block if name in rows.values]))
        if 2 * len(new) <= len(rows.t):
            break
    else:
        return rows
    if not len(new):
        return rows
    note = (
        f"{shown}: most rows repeat a fix or have none; the {len(new)} of {len(rows.t)} that are new are used"
    )
    return _take(rows, new, note)


def _find_new(columns: Sequence[FloatArray]) -> BoolArray:
    """Return which rows (N,) of columns differ from the row before them."""

    def differ(block: slice) -> BoolArray:
        first = max(block.start - 1, 0)
        near = np.column_stack([column[first : block.stop] for column in columns])
        same = (near[1:] == near[:-1]) | (np.isnan(near[1:]) & np.isnan(near[:-1]))
        other = ~same.all(axis=1)
        return other if block.start else np.concatenate([[True], other])

    return disk_arrays.fill(len(columns[0]), differ, np.bool_)


def drop_timeless(rows: LogRows, kind: str, shown: str) -> LogRows:
    """Return the rows with a time: of an IMU, rows that have values must have one, too."""
    lacks = np.isnan(rows.t)
    if not lacks.any() or lacks.all():
        return rows
    if kind == "imu":
        lacks[lacks] = np.isnan(np.column_stack([value[lacks] for value in rows.values.values()])).all(axis=1)
    if not lacks.any():
        return rows
    note = f"{shown}: {np.count_nonzero(lacks)} of {len(lacks)} rows have no time and are left out"
    return _take(rows, np.flatnonzero(~lacks), note)


def drop_frozen(rows: LogRows, shown: str) -> LogRows:
    """Return the rows without fixes that repeat position and velocity in motion, if these are not most."""
    vel = rows.values.get("vel_n")
    if vel is None or len(vel) < 2:
        return rows
    with np.errstate(invalid="ignore"):
        frozen = ~_find_new([rows.values["lla"], vel]) & (np.hypot(vel[:, 0], vel[:, 1]) > _MOVING)
    if not frozen.any() or 2 * np.count_nonzero(frozen) > len(frozen):
        return rows
    note = f"{shown}: {np.count_nonzero(frozen)} of {len(frozen)} fixes repeat the one before in motion"
    return _take(rows, np.flatnonzero(~frozen), f"{note} and are left out")


def drop_unreported(rows: LogRows, shown: str) -> LogRows:
    """Return the rows without unusable standard deviations: receivers write 0, -1 or NaN for unknown."""
    values, notes = dict(rows.values), list(rows.notes)
    for block, of, what in (("pos", "lla", "position"), ("vel", "vel_n", "velocity")):
        for name in [name for name in (f"sd_{block}", f"cov_{block}") if name in values and of in values]:
            sizes = values[name] if name.startswith("sd") else values[name][:, ::4]
            known = np.isfinite(sizes) & (sizes > 0)
            without = np.isfinite(values[of]).all(axis=1) & ~known.all(axis=1)
            above = f"a standard deviation of {what} above 0"
            if not known.any():
                del values[name]
                notes.append(f"{shown}: no fix has {above}; these columns are not used")
            elif without.any():
                some = f"{without.sum()} of {len(sizes)} fixes"
                notes.append(f"{shown}: {some} lack {above} along an axis; there the datasheet's is used")
    return replace(rows, values=values, notes=tuple(notes))
