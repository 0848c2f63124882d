"""Scripted faults: each acts in [start, end) and changes no bit outside of its interval.

Faults of a measurement-level receiver act on its measurements, before it computes its fixes. The noise of
a fault has its own stream, ``fault.<kind>.<sensor>.<part>.<start>``.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import fields, replace
from typing import Any, NamedTuple, TypeVar

import numpy as np

from bench.core.mathematics.arrays import BoolArray, FloatArray, IntArray
from bench.core.records.data import GnssFixes, ImuData
from bench.core.records.instruments import InstrumentData
from bench.core.records.sensor_specs import Fault, GnssSpec, ImuSpec, TriadSpec
from bench.simulation.sensors.draws import SensorDraws
from bench.simulation.sensors.timing import find_interval_rows

Faults = Sequence[Fault]
_Record = TypeVar("_Record", GnssFixes, InstrumentData)


class ReportedRows(NamedTuple):
    """Rows that an instrument outputs, with dropped, repeated, frozen and late rows."""

    content: (
        IntArray  # (M,) row that provides the values; below 0 a row of pieces before, as `HeldRows` has it
    )
    tag: IntArray  # (M,) row that provides the time
    late: FloatArray  # (M,) delay added to the arrival [s]

    def keep(self, kept: BoolArray) -> ReportedRows:
        """Return only the rows marked in ``kept`` (M,)."""
        return ReportedRows(self.content[kept], self.tag[kept], self.late[kept])


class HeldRows:
    """Rows of earlier pieces that a frozen output may repeat: the last row, and one for each frozen fault."""

    def __init__(self) -> None:
        self.rows: list[Any] = []  # records of one row: the last, then those of the faults
        self.slots: dict[int, int] = {}  # number of a fault -> place in it

    def find(self, number: int) -> int:
        """Return the negative row number that a fault from an earlier piece repeats."""
        return self.slots.get(number, 0) - len(self.rows)

    def go_on(self, frozen: dict[int, int], count: int, take: Any) -> None:
        """Store the rows that the next piece may need.

        ``frozen`` is fault -> row that it repeats, of ``count`` rows; ``take`` returns a row as a record.
        """
        found = {number: take(row) for number, row in frozen.items()}
        if count:
            self.rows[:1] = [take(count - 1)]
        for number, row in found.items():
            if number not in self.slots:
                self.slots[number] = len(self.rows)
                self.rows.append(row)


def select_faults(faults: Faults, sensor: str, *kinds: str) -> Iterator[Fault]:
    """Return the faults of a sensor, of the given kinds or of all."""
    return (f for f in faults if f.sensor == sensor and (not kinds or f.kind in kinds))


def find_reported_rows(
    t: FloatArray, faults: Faults, sensor: str, draws: SensorDraws, held: HeldRows
) -> tuple[ReportedRows, dict[int, int]]:
    """Apply faults of the kinds frozen, latency, dropped and repeated to the rows at t (M,) of a piece.

    A frozen output repeats the row before the fault, or the first row if there is none. Returned with the
    rows are the frozen faults by number, and the row that each repeats.
    """
    active = select_faults(faults, sensor, "frozen", "latency", "dropped", "repeated")
    content, late, times = np.arange(len(t)), np.zeros(len(t)), np.ones(len(t), np.int64)
    frozen = dict[int, int]()
    for number, fault in enumerate(active):
        first, stop = find_interval_rows(t, fault.start, fault.end)
        if first == stop:
            continue
        if fault.kind == "frozen":
            begins = number not in held.slots
            before = first - 1 if first else -len(held.rows)
            frozen[number] = before if begins else held.find(number)
            content[first:stop] = frozen[number]
        elif fault.kind == "latency":
            late[first:stop] += fault.delay
        else:
            affected = _stream(fault, "samples", draws).random(stop - first) < fault.share
            times[first:stop][affected] = 0 if fault.kind == "dropped" else 2
    tag = np.repeat(np.arange(len(t)), times)
    return ReportedRows(content[tag], tag, late[tag]), frozen


def draw_bursts(
    t: FloatArray, faults: Faults, sensor: str, part: str, width: int, draws: SensorDraws
) -> FloatArray | None:
    """Draw noise bursts (M, width) as multiples of the sensor's white noise; None if there is no burst."""
    added = None
    for fault in select_faults(faults, sensor, "noise-burst"):
        if added is None:
            added = np.zeros((len(t), width))
        first, stop = find_interval_rows(t, fault.start, fault.end)
        draw = _stream(fault, part, draws).standard_normal((stop - first, width))
        added[first:stop] += fault.times * draw
    return added


def evaluate_steps(t: FloatArray, faults: Iterable[Fault], width: int) -> FloatArray:
    """Return the sum of steps and ramps of faults (M, width) at t, in SI; 0 outside of the faults."""
    added = np.zeros((len(t), width))
    for fault in faults:
        first, stop = find_interval_rows(t, fault.start, fault.end)
        since = (t[first:stop] - fault.start)[:, None]
        added[first:stop] += np.array(fault.step) + since * np.array(fault.ramp)
    return added


def evaluate_rates(t: FloatArray, faults: Iterable[Fault], width: int) -> FloatArray:
    """Return the sum of ramp rates of faults (M, width) at t, per second; 0 outside of the faults."""
    rates = (replace(fault, step=fault.ramp, ramp=(0.0,) * len(fault.ramp)) for fault in faults)
    return evaluate_steps(t, rates, width)


def apply_to_imu(record: ImuData, spec: ImuSpec, faults: Faults, draws: SensorDraws) -> ImuData:
    """Apply the faults of an IMU; return the same record if there are none.

    Steps and bursts are rounded as the IMU rounds, with or without the remainder of the sample before. A
    sample beyond the range is clipped and flagged.
    """
    if not any(fault.sensor in ("imu", "gyro", "accel") for fault in faults):
        return record
    valid = record.valid.copy()
    dtheta_b = _apply_to_triad(record, record.dtheta_b, "gyro", spec.gyro, faults, valid, draws)
    dvel_b = _apply_to_triad(record, record.dvel_b, "accel", spec.accel, faults, valid, draws)
    faulty = ImuData(t=record.t, dt=record.dt, valid=valid, dtheta_b=dtheta_b, dvel_b=dvel_b)
    held = draws.keep("imu", HeldRows, "held")
    out, frozen = find_reported_rows(record.t, faults, "imu", draws, held)
    columns = _take_rows(faulty, out.content, held, frozen)
    return ImuData(**columns)


def _apply_to_triad(
    record: ImuData, increment: FloatArray, sensor: str, spec: TriadSpec, faults: Faults,
    valid: BoolArray, draws: SensorDraws,
) -> FloatArray:  # fmt: skip
    """Return the increments (N, 3) of a triad with its faults; clear ``valid`` where a sample is clipped."""
    t, dt = record.t, record.dt[:, None]
    increment = increment.copy()
    stepped = list(select_faults(faults, sensor, f"{sensor}-step"))
    burst = draw_bursts(t, faults, sensor, "white", 3, draws)
    if stepped or burst is not None:
        added = evaluate_steps(t, stepped, 3) * dt
        if burst is not None:
            added += spec.by_axis("random_walk") * np.sqrt(dt) * burst
        affected: BoolArray = np.asarray(added.any(axis=1))
        if spec.quantization > 0:
            before = draws.keep(sensor, lambda: np.zeros(3), "rounded")
            total = draws.accumulate(f"fault.{sensor}", added)
            whole = spec.quantization * np.rint(total / spec.quantization)
            added = np.where(affected[:, None], np.diff(whole, axis=0, prepend=before[None]), 0.0)
            before[:] = whole[-1] if len(whole) else before
        increment += added
        if spec.resolution > 0:
            step = spec.resolution * dt
            increment = np.where(affected[:, None], step * np.rint(increment / step), increment)
        if spec.range > 0:
            most = spec.range * dt
            beyond = affected & (np.abs(increment) > most).any(axis=1)
            increment[beyond] = np.clip(increment[beyond], -most[beyond], most[beyond])
            valid[beyond] = False
    held = draws.keep(sensor, HeldRows, "held")
    _, frozen = find_reported_rows(t, list(select_faults(faults, sensor, "frozen")), sensor, draws, held)
    for number, fault in enumerate(select_faults(faults, sensor, "frozen")):
        if number in frozen:
            first, stop = find_interval_rows(t, fault.start, fault.end)
            row = frozen[number]
            values = increment[row] if row >= 0 else held.rows[row]
            increment[first:stop, fault.axes] = values[list(fault.axes)]
    held.go_on(frozen, len(t), lambda row: increment[row].copy() if row >= 0 else held.rows[row])
    return increment


def apply_to_instrument(
    record: Any, sensor: str, column: str, lsb: float, faults: Faults, draws: SensorDraws
) -> Any:
    """Apply the faults of an instrument, by its name, to its record; faults of other sensors are ignored.

    ``column`` is the field of the values, ``lsb`` their resolution (0: not rounded).
    """
    values = getattr(record, column)
    wide = values.reshape(len(record), math.prod(values.shape[1:]))
    width = wide.shape[1]
    stepped = list(select_faults(faults, sensor, f"{sensor}-step"))
    burst = draw_bursts(record.t, faults, sensor, "white", width, draws)
    if stepped or burst is not None:
        added = evaluate_steps(record.t, stepped, width)
        if burst is not None:
            added += record.sd[:, None] * burst
        faulty = wide + added
        if lsb > 0:
            faulty = np.where(added != 0.0, lsb * np.rint(faulty / lsb), faulty)
        record = replace(record, **{column: faulty.reshape(values.shape)})
    return report(record, faults, sensor, draws)


def report(
    record: _Record, faults: Faults, sensor: str, draws: SensorDraws, heard: BoolArray | None = None
) -> _Record:
    """Return the rows of a record that the instrument outputs, with their times of arrival.

    ``heard`` (M,) marks the rows whose epochs have no outage; None: there is none.
    """
    if not any(select_faults(faults, sensor)) and (heard is None or heard.all()):
        return record
    held = draws.keep(sensor, HeldRows, "held")
    out, frozen = find_reported_rows(record.t, faults, sensor, draws, held)
    if heard is not None:
        out = out.keep(heard[out.tag])
    columns = _take_rows(record, out.content, held, frozen)
    times = {"t": record.t[out.tag], "t_arrival": record.t_arrival[out.tag] + out.late}
    return type(record)(**columns | times)


def _take_rows(record: Any, content: IntArray, held: HeldRows, frozen: dict[int, int]) -> dict[str, Any]:
    """Return rows of a record by column, negative rows from earlier pieces; store rows for the next piece."""
    columns: dict[str, Any] = {}
    before = len(held.rows) if (content < 0).any() else 0
    for f in fields(record):
        column = getattr(record, f.name)
        if before:
            column = np.concatenate([np.stack([one[f.name] for one in held.rows]), column])
        columns[f.name] = column[content + before]

    def take(row: int) -> Any:
        if row < 0:
            return held.rows[row]
        return {f.name: getattr(record, f.name)[row].copy() for f in fields(record)}

    held.go_on(frozen, len(record.t), take)
    return columns


def compute_passed_magnets(t: FloatArray, faults: Faults) -> FloatArray:
    """Return the field (M, 3) [T], n, of magnets that are passed, at t (M,).

    A dipole passed at a steady speed, its direction kept: ``peak (1 + u^2)^(-3/2)`` with the way u from the
    closest point in distances to it, -4 to 4 over the fault.
    """
    added = np.zeros((len(t), 3))
    for fault in select_faults(faults, "mag", "magnet-passed"):
        first, stop = find_interval_rows(t, fault.start, fault.end)
        u = 8.0 * (t[first:stop] - fault.start) / (fault.end - fault.start) - 4.0
        added[first:stop] += (1.0 + u**2)[:, None] ** -1.5 * np.array(fault.step)
    return added


def compute_spoofing(t: FloatArray, faults: Faults) -> tuple[FloatArray, FloatArray]:
    """Return the offset (M, 3) [m] and velocity (M, 3) [m/s] of a spoofed position at t, n."""
    spoofing = list(select_faults(faults, "gnss", "spoofing"))
    return evaluate_steps(t, spoofing, 3), evaluate_rates(t, (f for f in spoofing if f.coherent), 3)


def compute_fix_errors(
    t: FloatArray, spec: GnssSpec, faults: Faults, draws: SensorDraws
) -> tuple[FloatArray, FloatArray]:
    """Return the errors of faults in position (M, 3) [m] and velocity (M, 3) [m/s] of fixes at t, n."""
    pos, vel = compute_spoofing(t, faults)
    burst = draw_bursts(t, faults, "gnss", "position", 3, draws)
    if burst is not None:
        pos += burst * np.array(spec.pos_white_sd_n)
    burst = draw_bursts(t, faults, "gnss", "velocity", 3, draws)
    if burst is not None:
        vel += burst * np.array(spec.vel_white_sd_n)
    return pos, vel


def compute_loss(t: FloatArray, system: IntArray, sat: IntArray, faults: Faults) -> FloatArray:
    """Return the loss of C/N0 by faults at epochs t (M,) for satellites (S,).

    Returns
    -------
    loss : (M, S) array
        [dB]; infinite for a lost satellite. It has no rows if no fault lowers C/N0.
    """
    active = list(select_faults(faults, "gnss", "jamming", "satellites-lost"))
    if not active:
        return np.empty((0, len(sat)))
    lowered = np.zeros((len(t), len(sat)))
    for fault in active:
        first, stop = find_interval_rows(t, fault.start, fault.end)
        if fault.kind == "jamming":
            lowered[first:stop] += fault.loss
        else:
            lowered[first:stop, _match_satellites(fault, system, sat)] = np.inf
    return lowered


def compute_clock_offset(t: FloatArray, faults: Faults) -> FloatArray:
    """Return the clock offset of the receiver by faults at t (M,) [m]."""
    return evaluate_steps(t, select_faults(faults, "gnss", "receiver-clock"), 1)[:, 0]


def compute_range_errors(
    t: FloatArray, system: IntArray, sat: IntArray, faults: Faults
) -> tuple[FloatArray, FloatArray]:
    """Return the errors of faults in pseudoranges (K,) [m] and range rates (K,) [m/s], equal on all carriers.

    ``t``, ``system``, ``sat`` (K,) are the time and satellite of each row.
    """
    added, rate = np.zeros(len(t)), np.zeros(len(t))
    for fault in select_faults(faults, "gnss", "pseudorange", "satellite-clock"):
        named = _match_satellites(fault, system, sat)
        added += np.where(named, evaluate_steps(t, [fault], 1)[:, 0], 0.0)
        if fault.kind == "satellite-clock":
            rate += np.where(named, evaluate_rates(t, [fault], 1)[:, 0], 0.0)
    return added, rate


def _match_satellites(fault: Fault, system: IntArray, sat: IntArray) -> BoolArray:
    """Return a mask of the rows (K,) of the satellites that the fault names."""
    named = np.zeros(len(sat), bool)
    for code, number in fault.satellites:
        named |= (system == code) & (sat == number)
    return named


def _stream(fault: Fault, part: str, draws: SensorDraws) -> np.random.Generator:
    return draws.stream(f"fault.{fault.kind}.{fault.sensor}.{part}.{fault.start:g}")
