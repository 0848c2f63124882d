"""Pieces of a record: cut, joined, and as plain columns."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from bench.arrays import BoolArray, FloatArray, IntArray
from bench.data import GnssObservations, NavSolution, SensorData
from bench.navigation.engine.kept_rows import join_rows, take_observations, take_rows
from bench.navigation.engine.timeline import TIME_TOLERANCE


def newest_sample(record: SensorData) -> float:
    """Return the instant of the last IMU sample [s], -inf without one."""
    t = record.imu.t[np.isfinite(record.imu.t)]
    return float(t.max(initial=-np.inf))


def first_sample(record: SensorData) -> float:
    """Return the instant of the first IMU sample [s], inf without one."""
    t = record.imu.t[np.isfinite(record.imu.t)]
    return float(t.min(initial=np.inf))


def nothing_known(t: FloatArray) -> NavSolution:
    """Return a solution that knows nothing at instants t (M,)."""
    none = np.full((len(t), 9, 9), np.nan)
    three, four = none[:, 0, :3], none[:, 0, :4]
    return NavSolution(t, three, three, four, three, three, none, (), none[:, 0, :0], none[:, 0, :0])


def aiding_records(sensors: SensorData) -> dict[str, Any]:
    """Return the aiding records, by name."""
    gnss = ("fixes", "observations")
    return {name: one for name in gnss if (one := getattr(sensors, name)) is not None} | sensors.instruments


def without_orbits(specs: Any) -> Any:
    """Return datasheets without the true orbits of a sky, which no filter knows."""
    if specs.gnss is None or specs.gnss.sky is None:
        return specs
    return replace(specs, gnss=replace(specs.gnss, sky=replace(specs.gnss.sky, orbits=None)))


def _take(record: Any, rows: BoolArray | slice) -> Any:
    """Return some rows of a record of satellites or of another sensor."""
    take = take_observations if isinstance(record, GnssObservations) else take_rows
    return take(record, rows)


def take_head(piece: SensorData) -> SensorData:
    """Return a piece without rows."""
    none = slice(0)
    cut = {name: _take(one, none) for name, one in aiding_records(piece).items()}
    imu, specs = take_rows(piece.imu, none), without_orbits(piece.specs)
    return replace(piece, imu=imu, output_t=piece.output_t[none], specs=specs, **cut)


def take_piece(record: SensorData, begin: float, end: float) -> SensorData:
    """Return what came after an instant and until another [s]: the piece that a filter is fed next.

    IMU samples and wanted answers by their time, measurements by their arrival.
    """

    def inside(t: FloatArray) -> BoolArray:
        found: BoolArray = (t > begin) & (t <= end)
        return found

    cut = {name: _take(one, inside(one.t_arrival)) for name, one in aiding_records(record).items()}
    imu, output_t = record.imu, record.output_t
    return replace(record, imu=take_rows(imu, inside(imu.t)), output_t=output_t[inside(output_t)], **cut)


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


def cut_piece(record: SensorData, samples: slice | IntArray, after: float, until: float) -> SensorData:
    """Return some IMU samples of a record, and what arrived or is wanted after an instant until another [s].

    Both may be infinite; what has no time is there from the begin of the record.
    """

    def inside(t: FloatArray, slack: float) -> BoolArray:
        found: BoolArray = ~(t > until + slack)
        return found if np.isneginf(after) else found & (t > after + slack)

    every = aiding_records(record).items()
    cut = {name: _take(one, inside(arrivals(one), TIME_TOLERANCE)) for name, one in every}
    wanted = record.output_t[inside(record.output_t, 0.0)]
    return replace(record, imu=take_rows(record.imu, samples), output_t=wanted, **cut)


def goes_beyond(record: SensorData, t: float) -> bool:
    """Return whether anything arrives or is wanted after an instant [s], IMU samples aside."""
    arrival = (one.t_arrival for one in aiding_records(record).values())
    late = any(len(one) and (one > t + TIME_TOLERANCE).any() for one in arrival)
    return late or bool(len(record.output_t) and (record.output_t > t).any())
