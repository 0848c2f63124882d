"""What is scripted to go wrong: each fault acts in [start, end) and leaves every other bit as it was.

Faults of a receiver at measurement level act on what it measures, before it computes its fixes. The noise of
a fault has its own stream, ``fault.<kind>.<sensor>.<part>.<start>``.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import fields, replace
from typing import Any, NamedTuple, TypeVar

import numpy as np

from bench.arrays import BoolArray, FloatArray, IntArray
from bench.data import GnssFixes, ImuData
from bench.instruments import InstrumentData
from bench.sensors.timing import interval_rows
from bench.specs import Fault, GnssSpec, ImuSpec, TriadSpec, stream

Faults = Sequence[Fault]
_Record = TypeVar("_Record", GnssFixes, InstrumentData)


class Reported(NamedTuple):
    """What of an instrument's rows is put out, in place of all of them."""

    content: IntArray  # (M,) row whose values come
    tag: IntArray  # (M,) row whose time they carry
    late: FloatArray  # (M,) added to the arrival [s]

    def where(self, kept: BoolArray) -> Reported:
        """Return the rows (M,) that are kept."""
        return Reported(self.content[kept], self.tag[kept], self.late[kept])


def of(faults: Faults, sensor: str, *kinds: str) -> Iterator[Fault]:
    """Return the faults of a sensor, those of some kinds or of all."""
    return (f for f in faults if f.sensor == sensor and (not kinds or f.kind in kinds))


def reported(t: FloatArray, faults: Faults, sensor: str, seed: int, run: int) -> Reported:
    """Return what comes of rows at t (M,), frozen, late, dropped or repeated.

    An output that freezes repeats the row before the fault, or its first one when there is none.
    """
    active = of(faults, sensor, "frozen", "latency", "dropped", "repeated")
    content, late, times = np.arange(len(t)), np.zeros(len(t)), np.ones(len(t), np.int64)
    for fault in active:
        first, stop = interval_rows(t, fault.start, fault.end)
        if fault.kind == "frozen":
            content[first:stop] = max(first - 1, 0)
        elif fault.kind == "latency":
            late[first:stop] += fault.delay
        else:
            struck = _stream(fault, "samples", seed, run).random(stop - first) < fault.share
            times[first:stop][struck] = 0 if fault.kind == "dropped" else 2
    tag = np.repeat(np.arange(len(t)), times)
    return Reported(content[tag], tag, late[tag])


def noise(
    t: FloatArray, faults: Faults, sensor: str, part: str, width: int, seed: int, run: int
) -> FloatArray | None:
    """Return the noise (M, width) of bursts, in units of the sensor's own white noise; None without any."""
    added = None
    for fault in of(faults, sensor, "noise-burst"):
        if added is None:
            added = np.zeros((len(t), width))
        first, stop = interval_rows(t, fault.start, fault.end)
        unit = _stream(fault, part, seed, run).standard_normal((stop - first, width))
        added[first:stop] += fault.times * unit
    return added


def steps(t: FloatArray, faults: Iterable[Fault], width: int) -> FloatArray:
    """Return step and ramp (M, width) of faults at t, 0 outside of them, in their unit."""
    added = np.zeros((len(t), width))
    for fault in faults:
        first, stop = interval_rows(t, fault.start, fault.end)
        since = (t[first:stop] - fault.start)[:, None]
        added[first:stop] += np.array(fault.step) + since * np.array(fault.ramp)
    return added


def rates(t: FloatArray, faults: Iterable[Fault], width: int) -> FloatArray:
    """Return how fast the ramps (M, width) of faults grow at t, 0 outside of them."""
    return steps(
        t, (replace(fault, step=fault.ramp, ramp=(0.0,) * len(fault.ramp)) for fault in faults), width
    )


def imu(record: ImuData, spec: ImuSpec, faults: Faults, seed: int, run: int) -> ImuData:
    """Return what an IMU with faults reports; the same record when it has none.

    What a step or a burst adds is rounded to the least bit, its remainder carried to the next sample; beyond
    the range it is clipped and the sample flagged.
    """
    if not any(fault.sensor in ("imu", "gyro", "accel") for fault in faults):
        return record
    valid = record.valid.copy()
    columns = {}
    for sensor, name, triad in (("gyro", "dtheta_b", spec.gyro), ("accel", "dvel_b", spec.accel)):
        columns[name] = _triad(record, getattr(record, name), sensor, triad, faults, valid, seed, run)
    faulty = ImuData(t=record.t, dt=record.dt, valid=valid, **columns)
    out = reported(record.t, faults, "imu", seed, run)
    return ImuData(*(getattr(faulty, f.name)[out.content] for f in fields(ImuData)))


def _triad(
    record: ImuData,
    increment: FloatArray,
    sensor: str,
    spec: TriadSpec,
    faults: Faults,
    valid: BoolArray,
    seed: int,
    run: int,
) -> FloatArray:
    """Return the increments (N, 3) with the faults of a triad; clear rows of valid."""
    t, dt = record.t, record.dt[:, None]
    increment = increment.copy()
    stepped = list(of(faults, sensor, f"{sensor}-step"))
    burst = noise(t, faults, sensor, "white", 3, seed, run)
    if stepped or burst is not None:
        added = steps(t, stepped, 3) * dt
        if burst is not None:
            added += spec.random_walk * np.sqrt(dt) * burst
        struck: BoolArray = np.asarray(added.any(axis=1))
        if spec.quantization > 0:
            whole = spec.quantization * np.rint(np.cumsum(added, axis=0) / spec.quantization)
            added = np.where(struck[:, None], np.diff(whole, axis=0, prepend=0.0), 0.0)
        increment += added
        if spec.range > 0:
            most = spec.range * dt
            beyond = struck & (np.abs(increment) > most).any(axis=1)
            increment[beyond] = np.clip(increment[beyond], -most[beyond], most[beyond])
            valid[beyond] = False
    for fault in of(faults, sensor, "frozen"):
        first, stop = interval_rows(t, fault.start, fault.end)
        for axis in fault.axes:
            increment[first:stop, axis] = increment[max(first - 1, 0), axis]
    return increment


def instrument(record: Any, sensor: str, column: str, lsb: float, faults: Faults, seed: int, run: int) -> Any:
    """Return what an instrument with faults reports.

    Parameters
    ----------
    record : InstrumentData
        Without them; returned when it has none.
    sensor, column : str
        Name of the instrument, and the field of its values.
    lsb : float
        Least bit of the values, 0 none.
    faults : sequence of Fault
        Those of other sensors count for nothing.
    seed, run : int
        Which draw of the faults' own noise.
    """
    values = getattr(record, column)
    wide = values.reshape(len(record), -1)
    width = wide.shape[1]
    stepped = list(of(faults, sensor, f"{sensor}-step"))
    burst = noise(record.t, faults, sensor, "white", width, seed, run)
    if stepped or burst is not None:
        added = steps(record.t, stepped, width)
        if burst is not None:
            added += record.sd[:, None] * burst
        faulty = wide + added
        if lsb > 0:
            faulty = np.where(added != 0.0, lsb * np.rint(faulty / lsb), faulty)
        record = replace(record, **{column: faulty.reshape(values.shape)})
    return put_out(record, reported(record.t, faults, sensor, seed, run))


def spoofed(t: FloatArray, faults: Faults) -> tuple[FloatArray, FloatArray]:
    """Return how far (M, 3) [m], and how fast (M, 3) [m/s], a receiver is led away at t, n."""
    leading = list(of(faults, "gnss", "spoofing"))
    return steps(t, leading, 3), rates(t, (fault for fault in leading if fault.coherent), 3)


def fix_errors(
    t: FloatArray, spec: GnssSpec, faults: Faults, seed: int, run: int
) -> tuple[FloatArray, FloatArray]:
    """Return what faults add to position (M, 3) [m] and velocity (M, 3) [m/s] of fixes at t, n."""
    pos, vel = spoofed(t, faults)
    burst = noise(t, faults, "gnss", "position", 3, seed, run)
    if burst is not None:
        pos += burst * np.array([spec.pos_h_white_sd, spec.pos_h_white_sd, spec.pos_v_white_sd])
    burst = noise(t, faults, "gnss", "velocity", 3, seed, run)
    if burst is not None:
        vel += burst * spec.vel_white_sd
    return pos, vel


def loss(t: FloatArray, system: IntArray, sat: IntArray, faults: Faults) -> FloatArray:
    """Return by how much faults lower C/N0 [dB] at epochs t of satellites (S,); infinitely where one is lost.

    Returns
    -------
    loss : (M, S) array
        Without rows when no fault does.
    """
    active = list(of(faults, "gnss", "jamming", "satellites-lost"))
    if not active:
        return np.empty((0, len(sat)))
    lowered = np.zeros((len(t), len(sat)))
    for fault in active:
        first, stop = interval_rows(t, fault.start, fault.end)
        if fault.kind == "jamming":
            lowered[first:stop] += fault.loss
        else:
            lowered[first:stop, _among(fault, system, sat)] = np.inf
    return lowered


def clock(t: FloatArray, faults: Faults) -> FloatArray:
    """Return by how much the receiver's clock is off at t (M,) [m]."""
    return steps(t, of(faults, "gnss", "receiver-clock"), 1)[:, 0]


def range_errors(
    t: FloatArray, system: IntArray, sat: IntArray, faults: Faults
) -> tuple[FloatArray, FloatArray]:
    """Return what faults add to the pseudoranges (K,) [m] and range rates (K,) [m/s], all carriers alike.

    ``t``, ``system``, ``sat`` (K,) are epoch and satellite of each row.
    """
    added, rate = np.zeros(len(t)), np.zeros(len(t))
    for fault in of(faults, "gnss", "pseudorange", "satellite-clock"):
        named = _among(fault, system, sat)
        added += np.where(named, steps(t, [fault], 1)[:, 0], 0.0)
        if fault.kind == "satellite-clock":
            rate += np.where(named, rates(t, [fault], 1)[:, 0], 0.0)
    return added, rate


def _among(fault: Fault, system: IntArray, sat: IntArray) -> BoolArray:
    named = np.zeros(len(sat), bool)
    for code, number in fault.satellites:
        named |= (system == code) & (sat == number)
    return named


def put_out(record: _Record, out: Reported) -> _Record:
    """Return what of a record comes, and when."""
    columns = {f.name: getattr(record, f.name)[out.content] for f in fields(record)}
    return type(record)(
        **columns | {"t": record.t[out.tag], "t_arrival": record.t_arrival[out.tag] + out.late}
    )


def _stream(fault: Fault, part: str, seed: int, run: int) -> np.random.Generator:
    return stream(seed, run, f"fault.{fault.kind}.{fault.sensor}.{part}.{fault.start:g}")
