"""Schedule of a filter: its steps, and the measurements, updates and outputs after each step.

A record may come in pieces. A schedule plans what is known, and a filter goes no further than to where
nothing can come any more that is valid before; the rest waits for the next piece.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from bench.core.mathematics.arrays import BoolArray, FloatArray, IntArray, read_only, take_increasing
from bench.core.records.data import EventRow, GnssFixes, GnssObservations, ImuData, InitialState, SensorData
from bench.core.records.sensor_specs import GnssSpec, ImuSpec
from bench.core.words.exceptions import EstimatorError
from bench.navigation.engine import timeline
from bench.navigation.engine.kept_rows import Rows, join_rows, make_rows, take_rows
from bench.navigation.engine.piecewise import refuse
from bench.navigation.engine.session import (
    Kept,
    Replaced,
    SessionState,
    require,
    require_range,
    require_rows,
)
from bench.navigation.engine.timeline import TIME_TOLERANCE, ImuIntake, Steps
from bench.navigation.engine.velocity_consistency import MovedFixes
from bench.navigation.error_state_filter.aiding_sensors import AidingSensor, fix_variance, weigh_fixes
from bench.navigation.error_state_filter.error_state import StateLayout
from bench.navigation.error_state_filter.measurement_rows import SATELLITE_ROWS
from bench.navigation.error_state_filter.ranges import ranging
from bench.navigation.error_state_filter.ranges.range_states import list_range_errors
from bench.navigation.error_state_filter.ranges.satellite_states import Channels
from bench.navigation.error_state_filter.state_processes import assumed
from bench.navigation.error_state_filter.step_entries import FREE, IN_ORDER, plan_kernel
from bench.navigation.options import FixAccuracy


class StepPlan(NamedTuple):
    """Plan of the next steps of a filter."""

    steps: Steps
    entries: IntArray  # (E, 5) as `filter_run` takes them
    ahead: FloatArray  # (A,) part of the next step that an answer lies ahead [1]
    slots: int  # that hold all which waits
    measured: FloatArray  # (R, 9) values, and of a fix its antenna [m], b
    variance: FloatArray  # (R, 6)
    outputs: IntArray  # (A,) rows of ``output_t`` that are answered
    left: Rows  # what waits afterwards
    go_to: int  # last step taken


class Schedule(SessionState):
    """Collects the measurements of a run and puts them in order.

    Parameters
    ----------
    compensate : bool
        Measure at the time of validity, not at that of arrival.
    accuracy : str
        What the variance of a fix comes from, see :func:`aiding_sensors.weigh_fixes`.
    watch : MovedFixes or None
        Leaves out positions that disagree with the velocities; None: no such test.
    cut : bool
        End a step at every answer: a smoother has a node there.
    as_sampled : bool
        End no step at what arrives in a gap either, and answer at the first step's end from the time on.
    """

    t: Kept[float]  # end of the last step taken [s]
    last: Kept[bool]  # nothing comes after the last piece
    imu: Replaced[ImuData]
    rows: Replaced[IntArray]  # (N,) of the samples, those to go over
    span: Replaced[FloatArray]  # (N,) of each, from the one before [s]
    output_t: Replaced[FloatArray]  # (M,) answers wanted [s]
    events: Kept[list[EventRow]]
    waiting: Replaced[Rows]  # measurements
    sky: Replaced[ranging.SkyRows]
    _intake: Kept[ImuIntake]
    _again: Replaced[ImuData | None]  # samples to give again with the next piece
    _earlier: Replaced[IntArray]  # of the samples, those before that a bridge over a gap needs
    _newest: Replaced[dict[int, tuple[float, float]]]  # validity and arrival of the last row of each kind
    _names: Replaced[dict[int, str]]
    _watch: Kept[MovedFixes | None]

    def __init__(
        self,
        start: float,
        imu: ImuSpec,
        *,
        compensate: bool,
        accuracy: FixAccuracy = "datasheet",
        watch: MovedFixes | None = None,
        cut: bool = False,
        as_sampled: bool = False,
    ) -> None:
        self.start, self.t = start, start
        self._spec, self._compensate, self._cut = imu, compensate, cut
        self._as_sampled = as_sampled
        self._accuracy, self._watch = accuracy, watch
        self._intake = ImuIntake(start)
        self.events = []
        nothing = np.empty(0)
        self.imu = ImuData(nothing, nothing, nothing.astype(bool), np.empty((0, 3)), np.empty((0, 3)))
        self._again = None
        self._earlier = self.rows = np.empty(0, np.int64)
        self.span = self.output_t = np.empty(0)
        self._newest, self._names = {}, {}
        self.waiting = make_rows(0, nothing, nothing)
        self.sky = ranging.empty_sky()
        self.last = False

    def check(self) -> None:
        """Check the data that the step kernels read."""
        imu, sky = self.imu, self.sky
        for name, rows in (("earlier", self._earlier), ("rows", self.rows)):
            require_range(name, rows, len(imu))
            require(bool((np.diff(rows) > 0).all()), name, "must increase")
        used = (imu.t[self.rows], imu.dtheta_b[self.rows], imu.dvel_b[self.rows], self.span)
        require(all(np.isfinite(column).all() for column in used), "imu", "must be finite where it is used")
        require(len(self.span) == len(self.rows), "span", "must have one row for each sample")
        require(bool((self.span > 0).all()), "span", "must be positive")
        reached = np.concatenate([[self.t], used[0]])
        require(bool((np.diff(reached) >= 0).all()), "imu/t", "must increase, and begin where the filter is")
        require(self.end == reached[-1], "intake/newest", "must be the last sample")
        ranging.check_sky(sky)
        waiting = self.waiting
        require_rows("waiting", waiting, Rows._fields, len(waiting.t))
        of_satellites = waiting.kind == SATELLITE_ROWS
        if not self._compensate:
            require_range("waiting/slot", waiting.slot, 1)
        require_range("waiting/number", waiting.number[of_satellites], len(sky.epoch_start) - 1)

    @property
    def end(self) -> float:
        """Time of the last sample in use, or of the start [s]."""
        return self._intake.newest

    @property
    def _last_sample(self) -> float:
        """Time of the last sample in use [s]; -inf without a sample."""
        return self.end if self.end > self.start else -np.inf

    @property
    def imu_t(self) -> FloatArray:
        """Epochs (N,) of the samples to process [s]."""
        return take_increasing(self.imu.t, self.rows)

    def take(self, sensors: SensorData, *, last: bool) -> ImuData:
        """Add the IMU samples and output times of the next piece.

        Returns
        -------
        ImuData
            Those samples that are in use.

        Raises
        ------
        EstimatorError
            If one of these has been passed.
        """
        if len(wanted := sensors.output_t):
            passed = (wanted < self.t - TIME_TOLERANCE) & (wanted >= self.start - TIME_TOLERANCE)
            if passed.any():
                refuse("an answer", float(wanted[passed][0]), self.t)
            self.output_t = np.append(self.output_t, wanted)
        imu = sensors.imu if self._again is None else join_rows(self._again, sensors.imu)
        rows, span, events, again = self._intake.take(imu, self._spec, last=last)
        self.events += events
        self._again = take_rows(imu, again) if len(again) else None
        taken = imu if len(rows) == len(imu) else take_rows(imu, rows)
        self.last = last
        if not len(taken):
            return taken
        if len(self.imu):
            rows, span = np.concatenate([self.rows, rows + len(self.imu)]), np.concatenate([self.span, span])
            imu = join_rows(self.imu, imu)
        self.imu, self.rows, self.span = imu, rows, span
        return taken

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
        EstimatorError
            If a row comes too late.
        """
        assert sensor.read is not None
        record, spec = getattr(sensors, sensor.record), assumed(sensors.specs, sensor.spec)
        if not len(record) and self._watch is None:
            return
        values, white = sensor.read(record, spec, sensors, initial, layout)
        white = white + more
        if isinstance(record, GnssFixes):
            variance, needed = weigh_fixes(record, spec, white, self._accuracy), record.lla
        else:
            variance, needed = np.broadcast_to(white, values.shape), values
        sound = timeline.sound_rows(record, needed)
        rows, t, arrival = self._admit(sensor.kind, sensor.spec, record.t, record.t_arrival, sound)
        if isinstance(record, GnssFixes):
            self.events += timeline.without_velocity(record, rows)
            if self._watch is not None:
                values = np.array(values)
                used, own = record.take(rows), fix_variance(spec, gnss_markov=True)
                own = weigh_fixes(used, spec, own, self._accuracy)
                moved, events = self._watch.take(used, own, last=self.last)
                values[rows[moved], 0] = np.nan
                self.events += events
        self._wait(sensor.kind, t, arrival, values[rows], variance[rows])

    def add_samples(self, kind: int, t: FloatArray, values: FloatArray, variance: FloatArray) -> None:
        """Take measurements made from the IMU at epochs t (M,): values (M, m), variance (6,)."""
        if len(t):
            self._wait(kind, t, t, values, variance)

    def add_satellites(self, o: GnssObservations, gnss: GnssSpec, lat: float, channels: Channels) -> None:
        """Take the usable satellites of each epoch, and let them have ``channels`` and states."""
        assert gnss.sky is not None
        values, variance = ranging.correct_observations(o, gnss.sky)
        sound = np.isfinite(values).all(axis=1) & (variance > 0).all(axis=1)
        sound &= np.isfinite(o.sat_pos_e).all(axis=1) & np.isfinite(o.sat_vel_e).all(axis=1)
        sound &= np.isfinite(o.frequency[:, 0])
        self.events += timeline.left_out("satellites", o.t, ~sound, "not finite")
        wanted = np.isin(o.system, gnss.sky.constellations)
        self.events += timeline.empty_epochs(o.t, o.epoch_start, self.start, self.end)
        filled = np.flatnonzero(np.diff(o.epoch_start) > 0)
        first_row = o.epoch_start[filled]
        t, arrival = o.t[first_row], o.t_arrival[first_row]
        usable = np.isfinite(t) & np.isfinite(arrival)
        chosen, t, arrival = self._admit(SATELLITE_ROWS, "satellites", t, arrival, usable)
        epochs, known = filled[chosen], len(self.sky.epoch_start) - 1
        number = np.full(len(o.epoch_start) - 1, -1)
        number[epochs] = np.arange(len(epochs))
        of_row = number[o.epoch]
        rows = np.flatnonzero(sound & wanted & (of_row >= 0))
        rows = rows[np.argsort(of_row[rows], kind="stable")]
        sky = ranging.make_sky(
            o, gnss.sky, values[rows], variance[rows], rows, of_row[rows], len(epochs), lat, channels
        )
        with_states = [k for k in gnss.sky.constellations if any(list_range_errors(gnss.sky, k))]
        wait = (sky.which[:, 3] < 0) & np.isin(o.system[rows], with_states)
        self.events += timeline.left_out(
            "satellites", o.t[rows], wait, "all states of their system are taken"
        )
        self.sky = ranging.join_skies(self.sky, sky) if known else sky
        nothing = np.empty((len(epochs), 0))
        self._wait(SATELLITE_ROWS, t, arrival, nothing, nothing, known + np.arange(len(epochs)))

    def _admit(
        self, kind: int, name: str, t: FloatArray, arrival: FloatArray, sound: BoolArray
    ) -> tuple[IntArray, FloatArray, FloatArray]:
        """Return the rows to use in order of arrival, with the times to measure and to use them.

        Raises
        ------
        EstimatorError
            If a row comes too late.
        """
        if kind not in self._names:
            self._names = {**self._names, kind: name}
        newest, arrived = self._newest.get(kind, (-np.inf, -np.inf))
        if (early := sound & (arrival < arrived - TIME_TOLERANCE)).any():
            raise EstimatorError(
                f"{name}: a row that arrived at {arrival[early][0]:.6g} s comes after one that arrived at "
                f"{arrived:.6g} s; give pieces in the order of arrival"
            )
        rows, events = timeline.fresh_rows(t, arrival, sound, name, newest)
        self.events += events
        if sound.any():
            latest = max(newest, float(t[sound].max())), max(arrived, float(arrival[sound].max()))
            self._newest = {**self._newest, kind: latest}
        outside = arrival[rows] <= self.start - TIME_TOLERANCE
        if self.last:
            outside |= arrival[rows] - TIME_TOLERANCE > self._last_sample
        self.events += timeline.left_out(name, t, rows[outside], timeline.OUTSIDE)
        rows = rows[~outside]
        valid = t[rows] if self._compensate else arrival[rows]
        early = valid < self.start - TIME_TOLERANCE
        self.events += timeline.left_out(name, t, rows[early], "valid before the start")
        rows, valid = rows[~early], valid[~early]
        ahead = valid > arrival[rows] + TIME_TOLERANCE
        if ahead.any():
            text = f"{name}: {int(ahead.sum())} rows valid after their arrival: taken at their arrival"
            self.events.append((float(valid[ahead].min()), float(valid[ahead].max()), "timeline", text, name))
        valid = np.minimum(valid, arrival[rows])
        if self.t > self.start and (late := valid - TIME_TOLERANCE <= self.t).any():
            refuse(f"a row of {name}", float(valid[late][0]), self.t)
        return rows, valid, arrival[rows]

    def _wait(
        self,
        kind: int,
        t: FloatArray,
        arrival: FloatArray,
        values: FloatArray,
        variance: FloatArray,
        number: IntArray | None = None,
    ) -> None:
        """Store measurements until their step."""
        rows = make_rows(kind, t, arrival)
        rows.values[:, : values.shape[1]], rows.variance[:, : variance.shape[-1]] = values, variance
        self.waiting = self.waiting.joined(rows if number is None else rows._replace(number=number))

    def plan(self, look_back: float = 0.0) -> StepPlan:
        """Plan the steps up to a time for which all data have arrived.

        After the last piece that is all there is; else ``look_back`` [s] before the last sample.
        """
        if self.last:
            self._forget_late()
        rows, wanted = self.waiting._replace(slot=self.waiting.slot.copy()), self.output_t
        everywhere = rows.t[rows.slot == 0] if self._compensate else np.empty(0)
        if self._cut:
            everywhere = np.append(everywhere, wanted)
        in_gaps = everywhere if self._as_sampled else np.append(everywhere, rows.arrival)
        steps = timeline.steps(
            self.imu, self.rows, self.span, self.t, everywhere, in_gaps, self._spec, self._earlier
        )
        go_to = len(steps.t) - 1
        if not self.last:
            known = (imu_t := self.imu_t) <= self.end - look_back - 2.0 * TIME_TOLERANCE
            go_to = int(np.searchsorted(steps.t, imu_t[known][-1])) if known.any() else -1
        m, asked = len(rows.t), len(wanted)
        left, work = np.empty(m, np.bool_), np.empty((2, m), np.int64)
        busy = np.full(int(rows.slot.max(initial=0)) + m, FREE)
        entries, ahead = np.empty((2 * m + asked + 1, 5), np.int64), np.empty(asked)
        outputs = np.empty(asked, np.int64)
        count, due, slots = plan_kernel(
            read_only(steps.t), read_only(steps.span), self.t, go_to, rows,
            np.argsort(rows.t, kind="stable"), self._compensate, wanted, self.start, self.end,
            self._cut or self._as_sampled, self.last, left, work, busy, entries, ahead, outputs,
        )  # fmt: skip
        entries = entries[:count]
        entries = entries[np.argsort(entries[:, :3] @ IN_ORDER, kind="stable")]  # rows of a kind are in order
        ahead, outputs, waits = ahead[:due], outputs[:due], rows.take(left)
        return StepPlan(steps, entries, ahead, slots + 1, rows.values, rows.variance, outputs, waits, go_to)

    def _forget_late(self) -> None:
        """Drop stored measurements that can never arrive."""
        rows = self.waiting
        outside = rows.arrival - TIME_TOLERANCE > self._last_sample
        if outside.any():
            for kind, name in self._names.items():
                out = outside & (rows.kind == kind)
                self.events += timeline.left_out(name, rows.t, out, timeline.OUTSIDE)
            self.waiting = rows.take(~outside)

    def advance(self, plan: StepPlan) -> FloatArray:
        """Drop the finished part of a plan; return the epochs (M,) with a final solution."""
        final = self.last | (self.output_t < self.start - TIME_TOLERANCE)
        final[plan.outputs] = True
        answered, self.output_t = self.output_t[final], self.output_t[~final]
        self.waiting = plan.left
        if self.last:
            return answered
        if plan.go_to >= 0:
            self.t = float(plan.steps.t[plan.go_to])
        done = int(np.searchsorted(self.imu_t, self.t, side="right"))
        past = np.concatenate([self._earlier, self.rows[:done]])
        if len(past):
            past = timeline.needed_rows(self.imu, past)
        self.imu = take_rows(self.imu, np.concatenate([past, self.rows[done:]]))
        self._earlier, self.rows = np.split(np.arange(len(self.imu)), [len(past)])
        self.span = self.span[done:]
        if len(self.sky.epoch_start) > 1:
            of_satellites = self.waiting.kind == SATELLITE_ROWS
            self.sky = ranging.take_epochs(self.sky, self.waiting.number[of_satellites])
            number = np.where(of_satellites, np.cumsum(of_satellites) - 1, 0)
            self.waiting = self.waiting._replace(number=number)
        return answered
