"""Pieces of a record: cut and join them, and divide long records into blocks to limit memory."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np

from bench.core.files import disk_arrays
from bench.core.mathematics.arrays import BoolArray, FloatArray, IntArray
from bench.core.records.data import GnssObservations, NavSolution, SensorData
from bench.navigation.engine.kept_rows import join_rows, take_rows
from bench.navigation.engine.timeline import TIME_TOLERANCE


def newest_sample(record: SensorData) -> float:
    """Return the time of the last IMU sample [s], -inf without one."""
    t = record.imu.t[np.isfinite(record.imu.t)]
    return float(t.max(initial=-np.inf))


def first_sample(record: SensorData) -> float:
    """Return the time of the first IMU sample [s], inf without one."""
    t = record.imu.t[np.isfinite(record.imu.t)]
    return float(t.min(initial=np.inf))


def nothing_known(t: FloatArray) -> NavSolution:
    """Return an empty solution: NaN at epochs t (M,)."""
    none = np.full((len(t), 9, 9), np.nan)
    three, four = none[:, 0, :3], none[:, 0, :4]
    return NavSolution(t, three, three, four, three, three, none, (), none[:, 0, :0], none[:, 0, :0])


def aiding_records(sensors: SensorData) -> dict[str, Any]:
    """Return the aiding records, by name."""
    gnss = ("fixes", "observations")
    return {name: one for name in gnss if (one := getattr(sensors, name)) is not None} | sensors.instruments


def without_orbits(specs: Any) -> Any:
    """Return datasheets without the true satellite orbits, which filters must not get."""
    if specs.gnss is None or specs.gnss.sky is None:
        return specs
    return replace(specs, gnss=replace(specs.gnss, sky=replace(specs.gnss.sky, orbits=None)))


def take_head(piece: SensorData) -> SensorData:
    """Return a piece without rows."""
    none = slice(0)
    cut = {name: take_rows(one, none) for name, one in aiding_records(piece).items()}
    imu, specs = take_rows(piece.imu, none), without_orbits(piece.specs)
    return replace(piece, imu=imu, output_t=piece.output_t[none], specs=specs, **cut)


def slice_sensors(record: SensorData, begin: float, end: float) -> SensorData:
    """Return the part of a sensor record with begin < t <= end.

    Use it to update a filter from `open_filter` with a recorded flight. IMU samples and output times are
    selected by their time, aiding measurements by their time of arrival.

    Parameters
    ----------
    record : SensorData
        Complete record.
    begin, end : float
        Start (exclusive) and end (inclusive) of the interval [s].

    Returns
    -------
    SensorData
        The same sensors and datasheets, with the rows of the interval. A sensor without rows is kept, empty.

    Examples
    --------
    >>> import bench
    >>> sensed = bench.sense("approach", bench.fly("approach"))
    >>> float(bench.slice_sensors(sensed.data, 10.0, 11.0).imu.t[-1])
    11.0
    """
    t = record.imu.t
    return cut_piece(record, (t > begin) & (t <= end), begin, end)


def join_pieces(first: SensorData, second: SensorData) -> SensorData:
    """Return two pieces of a record as one."""
    joined: dict[str, Any] = {
        name: join_rows(one, getattr(second, name)) for name, one in aiding_records(first).items()
    }
    output_t = np.append(first.output_t, second.output_t)
    return replace(first, imu=join_rows(first.imu, second.imu), output_t=output_t, **joined)


def arrivals(record: Any) -> FloatArray:
    """Return when each row of a record arrives [s]; the rows of an epoch arrive with its first."""
    arrival: FloatArray = record.t_arrival
    if isinstance(record, GnssObservations):
        arrival = arrival[record.epoch_start[:-1][record.epoch]]
    return arrival


def cut_piece(
    record: SensorData, samples: slice | IntArray | BoolArray, after: float, until: float
) -> SensorData:
    """Return some IMU samples of a record, with the arrivals and output times between two times [s].

    Both may be infinite; what has no time is there from the start of the record.
    """

    def inside(t: FloatArray, slack: float) -> BoolArray:
        found: BoolArray = ~(t > until + slack)
        return found if np.isneginf(after) else found & (t > after + slack)

    every = aiding_records(record).items()
    cut = {name: take_rows(one, inside(arrivals(one), TIME_TOLERANCE)) for name, one in every}
    wanted = record.output_t[inside(record.output_t, 0.0)]
    return replace(record, imu=take_rows(record.imu, samples), output_t=wanted, **cut)


def goes_beyond(record: SensorData, t: float) -> bool:
    """Return whether a measurement or an output time, apart from the IMU, comes after a time [s]."""
    arrival = (one.t_arrival for one in aiding_records(record).values())
    late = any(len(one) and (one > t + TIME_TOLERANCE).any() for one in arrival)
    return late or bool(len(record.output_t) and (record.output_t > t).any())


def is_long(record: SensorData) -> bool:
    """Return whether a record is so long that filters process it in blocks."""
    return len(record.imu) > disk_arrays.LONG * disk_arrays.ROWS


def longest_wait(record: SensorData) -> float:
    """Return the longest time from the validity of a measurement to its arrival [s]."""
    waits = [one.t_arrival - one.t for one in aiding_records(record).values()]
    longest = max((float(wait[np.isfinite(wait)].max(initial=0.0)) for wait in waits), default=0.0)
    return longest + 2.0 * TIME_TOLERANCE


def cut_blocks(record: SensorData) -> Iterator[tuple[SensorData, bool]]:
    """Yield a record in blocks of IMU samples, in their order, and whether a block is the last.

    A measurement is in the block at whose end it has arrived, an answer wanted in that which reaches it; the
    last block has all that is left. What earlier blocks touched on disk is released.
    """
    reached = -np.inf
    for rows in disk_arrays.blocks(len(record.imu)):
        last, t = rows.stop == len(record.imu), record.imu.t[rows]
        begin, reached = reached, max(reached, float(t[np.isfinite(t)].max(initial=-np.inf)))
        yield cut_piece(record, rows, begin, np.inf if last else reached), last
