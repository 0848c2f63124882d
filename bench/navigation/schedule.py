"""The schedule of a filter: its steps, and after which of them it measures, updates and answers."""

from __future__ import annotations

from typing import Any

import numpy as np

from bench.arrays import BoolArray, FloatArray, IntArray
from bench.data import GLONASS, GPS, EventRow, GnssFixes, GnssObservations, InitialState, SensorData
from bench.navigation import integrity, ranging, timeline
from bench.navigation.aiding import SATELLITE_ROWS
from bench.navigation.blocks import assumed
from bench.navigation.error_state import StateLayout
from bench.navigation.measurements import AidingSensor, fix_variance, weigh_fixes
from bench.navigation.options import FixAccuracy
from bench.navigation.timeline import TIME_TOLERANCE, Steps
from bench.specs import GnssSpec

AT_ONCE, MEASURE, USE, OUTPUT = range(4)
"""Actions: measure and update at once, measure, update with what was measured, output."""


class Schedule:
    """Collects the measurements of a run and puts them in order.

    Parameters
    ----------
    sensors : SensorData
        The record.
    start : float
        Instant of the initial state [s].
    compensate : bool
        Measure at the instant of validity, not at that of arrival.
    accuracy : str
        What the variance of a fix comes from, see :func:`bench.navigation.measurements.weigh_fixes`.
    false_alarm : float or None
        Chance of :func:`bench.navigation.integrity.find_moved_fixes`, whose positions are left out; None: no
        such test.
    """

    def __init__(
        self,
        sensors: SensorData,
        start: float,
        *,
        compensate: bool,
        accuracy: FixAccuracy = "datasheet",
        false_alarm: float | None = None,
    ) -> None:
        self.rows, self.span, self.events = timeline.imu_rows(sensors.imu, start, sensors.specs.imu)
        self.imu_t = sensors.imu.t[self.rows]
        self._imu, self._start, self._compensate = sensors.imu, start, compensate
        self._accuracy, self._false_alarm = accuracy, false_alarm
        self._end = max(start, float(self.imu_t[-1])) if len(self.imu_t) else start
        self._kinds: list[tuple[int, IntArray, FloatArray, FloatArray]] = []  # kind, row, valid, arrival
        self._values: list[FloatArray] = []
        self._variance: list[FloatArray] = []
        self._count = 0
        wanted = sensors.output_t
        inside = (wanted >= start - TIME_TOLERANCE) & (wanted <= self._end + TIME_TOLERANCE)
        self.outputs: IntArray = np.flatnonzero(inside)
        """Rows of ``output_t`` within the record."""
        self._output_t = wanted[self.outputs]

    def add(
        self,
        sensor: AidingSensor,
        sensors: SensorData,
        initial: InitialState,
        layout: StateLayout,
        more: FloatArray | float = 0.0,
    ) -> None:
        """Take the record of a sensor, with the variance of its datasheet and ``more``.

        Raises
        ------
        ValueError
            If its datasheet is not among those assumed.
        """
        assert sensor.read is not None
        record, spec = getattr(sensors, sensor.record), assumed(sensors.specs, sensor.spec)
        values, white = sensor.read(record, spec, sensors, initial, layout)
        white = white + more
        variance = np.broadcast_to(white, values.shape)
        if isinstance(record, GnssFixes):
            variance = weigh_fixes(record, white, self._accuracy)
            rows, _, events = timeline.fix_rows(record, self.imu_t, self._start)
            if self._false_alarm is not None:
                values = np.array(values)
                own = weigh_fixes(record, fix_variance(spec, gnss_markov=True), self._accuracy)[rows]
                moved = integrity.find_moved_fixes(record.take(rows), own, spec, self._false_alarm)
                values[rows[moved], :3] = np.nan
                events += _list_moved(record.t[rows], moved)
        else:
            rows, _, events = timeline.aiding_rows(record, values, sensor.spec, self.imu_t, self._start)
        self.events += events
        t, arrival = record.t[rows], record.t_arrival[rows]
        self._plan(sensor.kind, sensor.spec, t, arrival, values[rows], variance[rows])

    def add_samples(self, kind: int, last: IntArray, values: FloatArray, variance: FloatArray) -> None:
        """Take measurements made from the IMU at the samples ``last``: values (M, m), variance (6,)."""
        t = self.imu_t[last]
        self._plan(kind, "imu", t, t, values, np.broadcast_to(variance, (len(t), 6)))

    def add_satellites(self, o: GnssObservations, gnss: GnssSpec, lat: float) -> ranging.Sky:
        """Take the usable satellites of each epoch, and return them."""
        assert gnss.sky is not None
        values, variance = ranging.correct_observations(o, gnss)
        sound = np.isfinite(values).all(axis=1) & (variance > 0).all(axis=1)
        sound &= np.isfinite(o.sat_pos_e).all(axis=1) & np.isfinite(o.sat_vel_e).all(axis=1)
        sound &= np.isfinite(o.frequency[:, 0])
        self.events += timeline.left_out("satellites", o.t, ~sound, "not finite")
        system = {"gps": [GPS], "glonass": [GLONASS]}.get(gnss.sky.systems, [GPS, GLONASS])
        wanted = np.isin(o.system, system)
        self.events += timeline.empty_epochs(o.t, o.epoch_start, self._start, self._end)
        filled = np.flatnonzero(np.diff(o.epoch_start) > 0)
        first_row = o.epoch_start[filled]
        t, arrival = o.t[first_row], o.t_arrival[first_row]
        usable = np.isfinite(t) & np.isfinite(arrival)
        epochs, _, events = timeline.ordered_rows(t, arrival, usable, "satellites", self.imu_t, self._start)
        self.events += events
        first = self._plan(SATELLITE_ROWS, "satellites", t[epochs], arrival[epochs], None, None)
        epochs = filled[epochs[first:]]
        number = np.full(len(o.epoch_start) - 1, -1)
        number[epochs] = np.arange(len(epochs))
        of_row = number[o.epoch]
        rows = np.flatnonzero(sound & wanted & (of_row >= 0))
        rows = rows[np.argsort(of_row[rows], kind="stable")]
        return ranging.make_sky(o, gnss, rows, of_row[rows], len(epochs), lat)

    def _plan(
        self,
        kind: int,
        name: str,
        t: FloatArray,
        arrival: FloatArray,
        values: FloatArray | None,
        variance: FloatArray | None,
    ) -> int:
        """Enter measurements; return how many of the first are dropped as valid before the start."""
        if not self._compensate:
            t = arrival
        early = t < self._start - TIME_TOLERANCE
        self.events += timeline.left_out(name, t, early, "valid before the start")
        ahead = t > arrival + TIME_TOLERANCE
        if ahead.any():
            text = f"{name}: {int(ahead.sum())} rows valid after their arrival: taken at their arrival"
            self.events.append((float(t[ahead].min()), float(t[ahead].max()), "timeline", text, name))
        first = int(early.sum())  # in order of validity
        t, arrival = np.minimum(t, arrival)[first:], arrival[first:]
        if values is None or variance is None:
            row = np.arange(len(t))
        else:
            row = self._count + np.arange(len(t))
            wide = np.zeros((2, len(t), 6))
            wide[0, :, : values.shape[1]], wide[1, :, : variance.shape[1]] = values[first:], variance[first:]
            self._values.append(wide[0])
            self._variance.append(wide[1])
            self._count += len(t)
        self._kinds.append((kind, row, t, arrival))
        return first

    def table(self) -> tuple[FloatArray, FloatArray]:
        """Return values and variances (R, 6) of all measurements but satellites."""
        if not self._values:
            return np.zeros((0, 6)), np.zeros((0, 6))
        return np.concatenate(self._values), np.concatenate(self._variance)

    def order(self) -> tuple[Steps, IntArray, int]:
        """Return the steps, the schedule (E, 5) of `bench.navigation.forward`, and the slots it needs."""
        nothing = np.empty(0)
        valid = np.concatenate([t for _, _, t, _ in self._kinds]) if self._kinds else nothing
        arrivals = np.concatenate([a for *_, a in self._kinds]) if self._kinds else nothing
        everywhere = np.concatenate([valid if self._compensate else nothing, self._output_t])
        steps = timeline.steps(
            self._imu, self.rows, self.span, self._start, everywhere, np.concatenate([everywhere, arrivals])
        )
        entries = []
        for kind, row, t, arrival in self._kinds:
            use = self._step_at(steps.t, arrival)
            measure = use
            if self._compensate:
                measure = np.where(np.abs(t - arrival) < TIME_TOLERANCE, use, self._step_at(steps.t, t))
            entries.append(np.column_stack([np.full(len(row), kind), row, measure, use]))
        planned = np.concatenate(entries) if entries else np.empty((0, 4), np.int64)
        slot = _slots(planned[:, 2], planned[:, 3])
        late = slot > 0
        at = self._step_at(steps.t, self._output_t)
        kinds, rows, measures, uses = planned.T
        parts: list[tuple[Any, ...]] = [
            (uses[~late], AT_ONCE, kinds[~late], rows[~late], 0),
            (measures[late], MEASURE, kinds[late], rows[late], slot[late]),
            (uses[late], USE, kinds[late], rows[late], slot[late]),
            (at, OUTPUT, 99, 0, 0),
        ]
        schedule = np.concatenate([np.column_stack(np.broadcast_arrays(*part)) for part in parts])
        schedule = schedule[np.lexsort((schedule[:, 3], schedule[:, 1], schedule[:, 2], schedule[:, 0]))]
        return steps, np.ascontiguousarray(schedule), int(slot.max(initial=0)) + 1

    def _step_at(self, steps_t: FloatArray, t: FloatArray) -> IntArray:
        """Return the step that ends at each instant t (M,) [s], -1 at the start."""
        at = np.searchsorted(steps_t, t - TIME_TOLERANCE)
        return np.where(t < self._start + TIME_TOLERANCE, -1, at)


def _list_moved(t: FloatArray, moved: BoolArray) -> list[EventRow]:
    """Return an event for each stretch of fixes whose position moved otherwise than their velocity."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], moved.astype(np.int8), [0]]))).reshape(-1, 2)
    words = "positions moved otherwise than the velocities of the receiver"
    return [
        (float(t[a]), float(t[b - 1]), "integrity", f"{b - a} {words}", "gnss_position") for a, b in edges
    ]


def _slots(measure: IntArray, use: IntArray) -> IntArray:
    """Return the slot of each measurement: 0 if it is used at once, else one that is free while it waits."""
    slot = np.zeros(len(use), np.int64)
    busy: list[int] = []  # until which step each slot is taken
    for k in np.argsort(measure, kind="stable"):
        if measure[k] == use[k]:
            continue
        free = [s for s, until in enumerate(busy) if until < measure[k]]
        if not free:
            free = [len(busy)]
            busy.append(0)
        busy[free[0]] = int(use[k])
        slot[k] = free[0] + 1
    return slot
