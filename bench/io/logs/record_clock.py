"""Clocks that jump back: seconds of a GPS week at its end, the clock of a recorder at a restart."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from bench.core.files import disk_arrays
from bench.core.mathematics.arrays import BoolArray, FloatArray, IntArray
from bench.core.words.exceptions import ConfigError
from bench.io.logs.rows import LogRows
from bench.simulation.signals.gps_time import UNIX_TO_GPS, leap_seconds, may_be_gps, to_date
from bench.simulation.signals.orbits import WEEK

_NEAR = 600.0  # a gap over the end of a week may be twice as long [s]


def unwrap_week(rows: LogRows, shown: str) -> LogRows:
    """Return rows with seconds of a GPS week continued beyond the end of the week."""
    weeks = _count_weeks(rows.t)
    if weeks is None:
        return rows
    values = dict(rows.values)
    if "arrival" in values and (late := _count_weeks(values["arrival"])) is not None:
        values["arrival"] = values["arrival"] + WEEK * late
    first = int(np.argmax(weeks != 0)) + 1
    note = f"{shown}: seconds of a week that ends before row {first}; times go on there"
    t = disk_arrays.fill(len(rows.t), lambda block: rows.t[block] + WEEK * weeks[block])
    return replace(rows, t=t, values=values, notes=(*rows.notes, note), week_ends=True)


def _count_weeks(t: FloatArray) -> IntArray | None:
    """Return the number of weeks of each time (N,) after the first row; None if no week ends."""
    if not len(t) or t.min() < 0.0 or t.max() > WEEK:
        return None
    ends, begins = t > WEEK - _NEAR, t < _NEAR
    on, back = ends[:-1] & begins[1:], begins[:-1] & ends[1:]
    if not on.any():
        return None
    return np.concatenate([[0], np.cumsum(on.astype(np.int64) - back)])


def find_week(t: FloatArray, first: float, last: float) -> float:
    """Return the offset [s] that moves times into the week of an IMU, from first to last; 0 if none fits.

    The seconds of a receiver that begins after the end of the week, or ends before it, are of another week.
    """
    for week in (0.0, WEEK, -WEEK):
        if len(t) and t.min() + week <= last and t.max() + week >= first:
            return week if min(t.min(), first) >= 0.0 and max(t.max(), last) <= 2 * WEEK else 0.0
    return 0.0


def meet_week(rows: LogRows, first: float, last: float) -> LogRows:
    """Return rows with their times in the week of an IMU that has times from first to last [s]."""
    week = find_week(rows.t, first, last)
    if not week:
        return _meet_unix(rows, first, last)
    return replace(_shift(rows, week), week_ends=True)


def _meet_unix(rows: LogRows, first: float, last: float) -> LogRows:
    """Return rows with GPS times since 1980-01-06 moved to the clock of an IMU that counts from 1970.

    That clock is UTC, or GPS time if the rows and the IMU then have more time in common.
    """
    if not len(rows.t) or first < rows.t.max() or not may_be_gps(float(rows.t.min())):
        return rows
    ahead = leap_seconds(to_date(float(rows.t.min())))
    shared = {
        shift: min(rows.t.max() + shift, last) - max(rows.t.min() + shift, first)
        for shift in (UNIX_TO_GPS - ahead, UNIX_TO_GPS)
    }
    utc, gps = shared
    shift = gps if shared[gps] > shared[utc] + 1.0 else utc
    if shared[shift] < 0.0:
        return rows
    taken, other, more = ("UTC", "GPS time", -ahead) if shift == utc else ("GPS time", "UTC", ahead)
    note = (
        f"the fixes count GPS time from 1980, the IMU from 1970: taken as {taken}; if it counts {other}, "
        f"[imu] time_offset_s must add {more:+d}"
    )
    return replace(_shift(rows, shift), notes=(*rows.notes, note))


def _shift(rows: LogRows, by: float) -> LogRows:
    late = {name: rows.values[name] + by for name in ("arrival",) if name in rows.values}
    return replace(rows, t=rows.t + by, values={**rows.values, **late})


def check_order(t: FloatArray, valid: BoolArray, origin: float, shown: str) -> None:
    """Raise ConfigError if most sound rows of a record are earlier than one above them: no filter uses them.

    t = 0 is ``origin`` on the clock of the file [s].
    """
    sound = np.flatnonzero(valid)
    newest = np.maximum.accumulate(t[sound])
    earlier = np.flatnonzero(t[sound] < newest)
    if 2 * len(earlier) > len(sound):
        k = earlier[0]
        clock = f"the clock goes back from {newest[k] + origin:.9g} to {t[sound[k]] + origin:.9g} s"
        lost = f"{len(earlier)} of {len(t)} rows are earlier than one above them"
        raise ConfigError(
            f"{shown}: row {sound[k] + 1}: {clock}, and {lost}; give each part of the file a log of its own"
        )
