"""The schedule of a filter: its steps, and after which of them it measures, updates and answers.

A record may come in pieces. A schedule plans what is known, and a filter goes no further than to where
nothing can come any more that is valid before; the rest waits for the next piece.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from bench.arrays import BoolArray, FloatArray, IntArray, take_increasing
from bench.data import EventRow, GnssFixes, GnssObservations, ImuData, InitialState, SensorData
from bench.errors import EstimatorError
from bench.navigation.engine import timeline
from bench.navigation.engine.kept_rows import Rows, Waiting, check_rows, give_slots, join_rows, take_rows
from bench.navigation.engine.piecewise import refuse
from bench.navigation.engine.session import Kept, Replaced, SessionState, require, require_range
from bench.navigation.engine.timeline import TIME_TOLERANCE, ImuIntake, Steps
from bench.navigation.engine.velocity_consistency import MovedFixes
from bench.navigation.error_state_filter.aiding_sensors import AidingSensor, fix_variance, weigh_fixes
from bench.navigation.error_state_filter.error_state import StateLayout
from bench.navigation.error_state_filter.measurement_rows import SATELLITE_ROWS
from bench.navigation.error_state_filter.ranges import ranging
from bench.navigation.error_state_filter.ranges.range_states import list_range_errors
from bench.navigation.error_state_filter.ranges.satellite_states import Channels
from bench.navigation.error_state_filter.state_processes import assumed
from bench.navigation.options import FixAccuracy
from bench.sensor_specs import GnssSpec, ImuSpec

AT_ONCE, MEASURE, USE, OUTPUT, GO_ON = range(5)
"""Actions: measure and update at once, measure, update with what was measured, output, just go there."""
_BEFORE = -2  # step of what was measured in an earlier piece


_ACTIONS = np.array([AT_ONCE, MEASURE, USE, OUTPUT, GO_ON])
_NONE = np.empty(0, np.int64)


class StepPlan(NamedTuple):
    """What a filter does next."""

    steps: Steps
    entries: IntArray  # (E, 5) as `filter_run` takes them
    ahead: FloatArray  # (A,) part of the next step that an answer lies ahead [1]
    slots: int  # that hold all which waits
    measured: FloatArray  # (R, 9) values, and of a fix its antenna [m], b, of all but satellites
    values: FloatArray  # (R, 6) of them the values
    variance: FloatArray  # (R, 6)
    outputs: IntArray  # (A,) rows of ``output_t`` that are answered
    left: dict[int, Rows]  # what waits afterwards
    go_to: int  # last step taken


class Schedule(SessionState):
    """Collects the measurements of a run and puts them in order.

    Parameters
    ----------
    start : float
        Instant of the initial state [s].
    imu : ImuSpec
        The unit assumed.
    compensate : bool
        Measure at the instant of validity, not at that of arrival.
    accuracy : str
        What the variance of a fix comes from, see :func:`aiding_sensors.weigh_fixes`.
    watch : MovedFixes or None
        Leaves out positions that disagree with the velocities; None: no such test.
    cut : bool
        End a step at every answer: a smoother has a node there.
    as_sampled : bool
        End no step at what arrives in a gap either, and answer at the first step's end from the instant on.
    """

    t: Kept[float]  # end of the last step taken [s]
    last: Kept[bool]  # nothing comes after the last piece
    imu: Replaced[ImuData]
    rows: Replaced[IntArray]  # (N,) of the samples, those to go over
    span: Replaced[FloatArray]  # (N,) of each, from the one before [s]
    output_t: Replaced[FloatArray]  # (M,) answers wanted [s]
    events: Kept[list[EventRow]]
    waiting: Replaced[dict[int, Rows]]  # measurements, by their kind
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
        self.imu = ImuData(nothing, nothing, nothing > 0, np.empty((0, 3)), np.empty((0, 3)))
        self._again = None
        self._earlier = self.rows = np.empty(0, np.int64)
        self.span = self.output_t = np.empty(0)
        self.waiting, self._newest, self._names = {}, {}, {}
        self.sky = ranging.empty_sky()
        self.last = False

    def check(self) -> None:
        """Check what the step kernels take from it."""
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
        for kind, one in self.waiting.items():
            check_rows(f"waiting/{kind}", one)
            epochs = len(sky.epoch_start) - 1
            require_range(f"waiting/{kind}/number", one.number, epochs if kind == SATELLITE_ROWS else 1)

    @property
    def end(self) -> float:
        """Instant of the last sample in use [s], or of the start."""
        return self._intake.newest

    @property
    def _last_sample(self) -> float:
        """The same, -inf without a sample."""
        return self.end if self.end > self.start else -np.inf

    @property
    def imu_t(self) -> FloatArray:
        """Instants (N,) of the samples to process [s]."""
        return take_increasing(self.imu.t, self.rows)

    def take(self, sensors: SensorData, *, last: bool) -> ImuData:
        """Take the IMU samples of the next piece and the instants at which it asks for answers.

        Returns
        -------
        ImuData
            Those samples that are in use.

        Raises
        ------
        EstimatorError
            If one of these has been passed.
        """
        passed = (sensors.output_t < self.t - TIME_TOLERANCE) & (sensors.output_t > self.start)
        if passed.any():
            refuse("an answer", float(sensors.output_t[passed][0]), self.t)
        imu = sensors.imu if self._again is None else join_rows(self._again, sensors.imu)
        rows, span, events, again = self._intake.take(imu, self._spec, last=last)
        self.events += events
        self._again = take_rows(imu, again) if len(again) else None
        taken = imu if len(rows) == len(imu) else take_rows(imu, rows)
        self.last = last
        if len(sensors.output_t):
            self.output_t = np.append(self.output_t, sensors.output_t)
        if not len(taken):
            return taken
        if len(self.imu):
            rows = np.append(self.rows, rows + len(self.imu))
            imu, span = join_rows(self.imu, imu), np.append(self.span, span)
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
        if not len(record) and sensor.kind in self.waiting and self._watch is None:
            return
        values, white = sensor.read(record, spec, sensors, initial, layout)
        white = white + more
        if isinstance(record, GnssFixes):
            variance, needed = weigh_fixes(record, spec, white, self._accuracy), record.lla
        else:
            variance, needed = np.broadcast_to(white, values.shape), values
        sound = record.valid & np.isfinite(record.t) & np.isfinite(record.t_arrival)
        sound &= np.isfinite(needed).all(axis=1)
        rows, t, arrival = self._admit(sensor.kind, sensor.spec, record.t, record.t_arrival, sound)
        if isinstance(record, GnssFixes):
            self.events += timeline.without_velocity(record, rows)
            if self._watch is not None:
                values = np.array(values)
                used, own = record.take(rows), fix_variance(spec, gnss_markov=True)
                own = weigh_fixes(used, spec, own, self._accuracy)
                moved, events = self._watch.take(used, own, last=self.last)
                values[rows[moved], :3] = np.nan
                self.events += events
        self._wait(sensor.kind, t, arrival, values[rows], variance[rows])

    def add_samples(self, kind: int, t: FloatArray, values: FloatArray, variance: FloatArray) -> None:
        """Take measurements made from the IMU at instants t (M,): values (M, m), variance (6,)."""
        if not len(t) and kind in self.waiting:
            return
        self._wait(kind, t, t, values, np.broadcast_to(variance, (len(t), 6)))

    def add_satellites(self, o: GnssObservations, gnss: GnssSpec, lat: float, channels: Channels) -> None:
        """Take the usable satellites of each epoch, and let them have ``channels`` and states."""
        assert gnss.sky is not None
        values, variance = ranging.correct_observations(o, gnss)
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
        sky = ranging.make_sky(o, gnss, rows, of_row[rows], len(epochs), lat, channels)
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
        """Return the rows of a record to use, in the order of their arrival, when to measure and to use them.

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
        self._leave_out(name, t, rows[outside], timeline.OUTSIDE)
        rows = rows[~outside]
        valid = t[rows] if self._compensate else arrival[rows]
        early = valid < self.start - TIME_TOLERANCE
        self._leave_out(name, t, rows[early], "valid before the start")
        rows, valid = rows[~early], valid[~early]
        ahead = valid > arrival[rows] + TIME_TOLERANCE
        if ahead.any():
            text = f"{name}: {int(ahead.sum())} rows valid after their arrival: taken at their arrival"
            self.events.append((float(valid[ahead].min()), float(valid[ahead].max()), "timeline", text, name))
        valid = np.minimum(valid, arrival[rows])
        if self.t > self.start and (late := valid - TIME_TOLERANCE <= self.t).any():
            refuse(f"a row of {name}", float(valid[late][0]), self.t)
        return rows, valid, arrival[rows]

    def _leave_out(self, name: str, t: FloatArray, rows: IntArray, why: str) -> None:
        if len(rows):
            out = np.zeros(len(t), np.bool_)
            out[rows] = True
            self.events += timeline.left_out(name, t, out, why)

    def _wait(
        self,
        kind: int,
        t: FloatArray,
        arrival: FloatArray,
        values: FloatArray,
        variance: FloatArray,
        number: IntArray | None = None,
    ) -> None:
        """Let measurements wait for their step."""
        wide, spread = np.zeros((len(t), 9)), np.zeros((len(t), 6))
        wide[:, : values.shape[1]], spread[:, : variance.shape[1]] = values, variance
        none = np.zeros(len(t), np.int64)
        rows = Rows(t, arrival, wide, spread, none, none if number is None else number)
        before = self.waiting.get(kind)
        self.waiting = {**self.waiting, kind: rows if before is None else before.joined(rows)}

    def plan(self, look_back: float = 0.0) -> StepPlan:
        """Return what a filter does up to where nothing can come any more that is valid before.

        After the last piece that is all there is; else ``look_back`` [s] before the last sample.
        """
        if self.last:
            self._forget_late()
        every = Waiting.of(self.waiting, SATELLITE_ROWS)
        everywhere = every.t[every.slot == 0] if self._compensate else np.empty(0)
        if self._cut:
            everywhere = np.append(everywhere, self.output_t)
        steps = timeline.steps(
            self.imu,
            self.rows,
            self.span,
            self.t,
            everywhere,
            everywhere if self._as_sampled else np.concatenate([everywhere, every.arrival]),
            self._spec,
            self._earlier,
        )
        go_to = len(steps.t) - 1
        if not self.last:
            known = (imu_t := self.imu_t) <= self.end - look_back - 2.0 * TIME_TOLERANCE
            go_to = int(np.searchsorted(steps.t, imu_t[known][-1])) if known.any() else -1
        measure = use = self._step_at(steps.t, every.arrival)
        if self._compensate:
            at_once = np.abs(every.t - every.arrival) < TIME_TOLERANCE
            measure = np.where(at_once, use, self._step_at(steps.t, every.t))
        measure = np.where(every.slot > 0, _BEFORE, measure)
        slot = give_slots(measure, use, every.slot, go_to)
        begun, done, late = measure <= go_to, use <= go_to, slot > 0
        now, new, later = (
            np.flatnonzero(one) for one in (done & ~late, begun & late & (every.slot == 0), done & late)
        )
        outputs, at, ahead = self._answers(steps, go_to)
        go_on = np.full(int(not self.last), go_to)
        step = np.concatenate([use[now], measure[new], use[later], at, go_on])
        picked, m = np.concatenate([now, new, later]), len(at)
        entries = np.zeros((len(step), 5), np.int64)
        entries[:, 0] = step
        entries[:, 1] = np.repeat(_ACTIONS, [len(now), len(new), len(later), m, len(go_on)])
        entries[: len(picked), 2], entries[len(picked) :, 2] = every.kind[picked], 99
        entries[: len(picked), 3], entries[len(picked) : len(picked) + m, 3] = every.row[picked], np.arange(m)
        entries[: len(picked), 4] = slot[picked]
        entries[len(picked) + m :, 2] = 100
        entries = entries[np.lexsort((entries[:, 3], entries[:, 1], entries[:, 2], entries[:, 0]))]
        if done.all():
            left = {kind: rows.take(slice(0)) for kind, rows in self.waiting.items()}
        else:
            left = {
                kind: rows._replace(slot=slot[part]).take(~done[part])
                for (kind, rows), part in zip(self.waiting.items(), every.parts, strict=True)
            }
        most = int(slot.max(initial=0)) + 1
        wide, variance = every.values, every.variance
        return StepPlan(steps, entries, ahead, most, wide, wide[:, :6], variance, outputs, left, go_to)

    def _forget_late(self) -> None:
        """Leave out what waited and never arrives."""
        for kind, rows in self.waiting.items():
            outside = rows.arrival - TIME_TOLERANCE > self._last_sample
            if outside.any():
                if kind in self._names:
                    self.events += timeline.left_out(self._names[kind], rows.t, outside, timeline.OUTSIDE)
                self.waiting = {**self.waiting, kind: rows.take(~outside)}

    def _answers(self, steps: Steps, go_to: int) -> tuple[IntArray, IntArray, FloatArray]:
        """Return which answers are due, the step each comes after, and the part of the next it lies ahead."""
        t = self.output_t
        if self._cut or self._as_sampled:
            inside = (t >= self.start - TIME_TOLERANCE) & (t <= self.end + TIME_TOLERANCE)
            step = self._step_at(steps.t, t)
            due = np.flatnonzero(inside & (step <= go_to))
            return due, step[due], np.zeros(len(due))
        if not len(t):
            return _NONE, _NONE, t
        at = np.searchsorted(steps.t, t - TIME_TOLERANCE)
        ends, spans = np.append(steps.t, np.inf), np.append(steps.span, 1.0)  # nothing is beyond the last
        at_start = np.abs(t - self.t) <= TIME_TOLERANCE
        there = at_start | (np.abs(ends[at] - t) <= TIME_TOLERANCE)
        step = np.where(at_start, -1, at - 1 + there)
        known = (t >= self.start - TIME_TOLERANCE) & (there | (at < len(steps.t)))
        due = np.flatnonzero(known & (step < go_to + there))
        begun = np.where(at > 0, ends[at - 1], self.t)
        ahead = np.where(there, 0.0, (t - begun) / spans[at])[due]
        return due, step[due], ahead

    def advance(self, plan: StepPlan) -> FloatArray:
        """Forget what a filter has done by a plan; return the instants (M,) of the answers that are final."""
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
        if SATELLITE_ROWS in self.waiting:
            rows = self.waiting[SATELLITE_ROWS]
            self.sky = ranging.take_epochs(self.sky, rows.number)
            numbered = rows._replace(number=np.arange(len(rows.t)))
            self.waiting = {**self.waiting, SATELLITE_ROWS: numbered}
        return answered

    def _step_at(self, steps_t: FloatArray, t: FloatArray) -> IntArray:
        """Return the step that ends at each instant t (M,) [s], -1 at the start."""
        at = np.searchsorted(steps_t, t - TIME_TOLERANCE)
        return np.where(t < self.t + TIME_TOLERANCE, -1, at)
