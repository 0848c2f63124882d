"""Which rows of a sensor record are used, and the count of the rest.

A row is used at the first IMU sample at or after its arrival. What is left out
is never repaired: it becomes a "timeline" event of the solution.
"""

from __future__ import annotations

import numpy as np

from bench.arrays import BoolArray, FloatArray, IntArray
from bench.data import BaroData, Events, GnssFixes, ImuData

TIME_TOLERANCE = 1e-6  # instants closer than this are the same [s]


def imu_rows(imu: ImuData, start: float) -> tuple[IntArray, FloatArray, list[tuple[float, float, str, str]]]:
    """Return the rows of an IMU record to integrate, the interval each one has to cover, and the events.

    Parameters
    ----------
    imu : ImuData
        Record; rows that are flagged, not finite, without length or not later than the row before are
        left out.
    start : float
        Instant of the initial state [s]; earlier rows are left out.

    Returns
    -------
    rows : (K,) int array
    span : (K,) array
        From the row before (or ``start``) to each row [s]. It exceeds ``imu.dt`` where rows are missing: the
        rates of the row are then held over the gap, and an event says so.
    events : list of (t, t_end, kind, text)
    """
    sound = imu.valid & np.isfinite(imu.t) & np.isfinite(imu.dt) & (imu.dt > 0)
    sound &= np.isfinite(imu.dtheta_b).all(axis=1) & np.isfinite(imu.dvel_b).all(axis=1)
    events = _left_out("imu", imu.t, ~sound, "flagged, not finite or without length")
    later = sound & (imu.t > start + TIME_TOLERANCE)
    rows = np.flatnonzero(later)
    t = imu.t[rows]
    if len(t):
        newest = np.concatenate([[start], np.maximum.accumulate(t)[:-1]])
        ordered = t > newest + TIME_TOLERANCE
        out = np.zeros(len(imu.t), np.bool_)
        out[rows[~ordered]] = True
        events += _left_out("imu", imu.t, out, "repeated or going back in time")
        rows, t = rows[ordered], t[ordered]
    span = np.diff(t, prepend=start)
    gaps = np.flatnonzero(span > imu.dt[rows] + TIME_TOLERANCE)
    events += [
        (float(t[k] - span[k]), float(t[k]), "timeline", f"imu: gap of {span[k] - imu.dt[rows[k]]:.6g} s")
        for k in gaps
    ]
    return rows, span, events


def aiding_rows(
    record: GnssFixes | BaroData, values: FloatArray, name: str, imu_t: FloatArray, start: float
) -> tuple[IntArray, IntArray, list[tuple[float, float, str, str]]]:
    """Return the rows of an aiding record to use, the IMU sample each is used at, and the events.

    Parameters
    ----------
    record : GnssFixes or BaroData
        Record; rows that are flagged, not finite or repeated are left out.
    values : (M, n) array
        What must be finite in a row.
    name : str
        What the events call the record.
    imu_t : (K,) array
        Instants of the IMU samples in use [s].
    start : float
        Instant of the initial state [s]; rows that arrive earlier are left out.
    """
    sound = record.valid & np.isfinite(record.t) & np.isfinite(record.t_arrival)
    sound &= np.isfinite(values).all(axis=1)
    events = _left_out(name, record.t, ~sound, "flagged or not finite")
    rows = np.flatnonzero(sound)
    rows = rows[np.argsort(record.t_arrival[rows], kind="stable")]
    t = record.t[rows]
    if len(t):
        newest = np.concatenate([[-np.inf], np.maximum.accumulate(t)[:-1]])
        fresh = t > newest + TIME_TOLERANCE
        out = np.zeros(len(record.t), np.bool_)
        out[rows[~fresh]] = True
        events += _left_out(name, record.t, out, "repeated or going back in time")
        rows = rows[fresh]
    sample = np.searchsorted(imu_t, record.t_arrival[rows] - TIME_TOLERANCE)
    inside = (sample < len(imu_t)) & (record.t_arrival[rows] > start - TIME_TOLERANCE)
    out = np.zeros(len(record.t), np.bool_)
    out[rows[~inside]] = True
    events += _left_out(name, record.t, out, "outside the time of the imu")
    return rows[inside], sample[inside].astype(np.int64), events


def as_events(rows: list[tuple[float, float, str, str]]) -> Events:
    """Return the collected rows as one table."""
    return Events.from_rows(rows)


def _left_out(name: str, t: FloatArray, out: BoolArray, why: str) -> list[tuple[float, float, str, str]]:
    if not out.any():
        return []
    times = t[out]
    finite = times[np.isfinite(times)]
    first, last = (float(finite.min()), float(finite.max())) if len(finite) else (0.0, 0.0)
    return [(first, last, "timeline", f"{name}: {int(out.sum())} rows left out: {why}")]
