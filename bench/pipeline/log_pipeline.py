"""Read and check a recording of real sensors; run filters on it; evaluate them by fixes or a reference."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from pathlib import Path
from typing import Any

import numpy as np

from bench.core.compilation.compiled import watch_compiling
from bench.core.files import disk_arrays
from bench.core.mathematics.arrays import BoolArray, FloatArray, find_later
from bench.core.mathematics.units import SAME_INSTANT
from bench.core.records.data import Events, GnssFixes, GnssObservations, InitialState, NavSolution, SensorData
from bench.core.records.run_records import Reference, Sensed, no_sensor_truth
from bench.core.records.run_result import RunResult
from bench.core.records.sensor_specs import ImuSpec
from bench.core.records.specs import AUTOPILOT, DEFAULT_GUARD, Guard
from bench.core.words.exceptions import ConfigError
from bench.core.words.stages import Progress, Stages
from bench.evaluation.errors import used_fixes
from bench.evaluation.errors.fixes import antenna_errors
from bench.evaluation.errors.reference_errors import compare
from bench.evaluation.judging import Judged, judge_solution
from bench.evaluation.metrics.outages import OutageDrift, make_drift_row, place_outages
from bench.evaluation.motion import validity
from bench.evaluation.motion.fix_reach import find_reachable
from bench.evaluation.motion.motion_noise import assume_motion_noise
from bench.evaluation.motion.recorded_motion import Check, RecordedMotion
from bench.evaluation.motion.rest_noise import assume_rest_noise, assume_vibration
from bench.io import results
from bench.io.config.checks import is_autopilot
from bench.io.config.log import LogSpec, load_log
from bench.io.foreign.loading import load_estimators
from bench.io.log_formats import find_format
from bench.io.logs import own_estimate, reference
from bench.io.logs.log_records import LogRecords, divide_intervals, read_records
from bench.io.logs.log_start import find_start
from bench.io.logs.own_estimate import AutopilotEstimator
from bench.navigation import built_in, estimator
from bench.navigation.engine.kept_rows import take_rows
from bench.pipeline.steps import build_estimator, collect_printed, find_worked, navigate_all

REPORTED = "fix_accuracy"
"""Option that logs whose fixes come with standard deviations set to "reported"."""
OFFSET, OFFSET_SD = "time_offset_sd", 0.1
"""Option that logs without a time_offset_s set, to this [s]: autopilots assume delays of 0.1 to 0.2 s."""
CUTS = (10.0, 30.0, 60.0)
"""Lengths of the outages that are simulated where a recording is long enough [s]."""
_WHOLE = 0.8  # share of an outage after which its last sound fix evaluates it [1]
_END_OF_CUT, _SHORTEST_END = 0.1, 1.0
"""Part of a cut, and at least so long [s], in whose last a reference has to have an epoch."""


@dataclass(frozen=True, slots=True)
class RecordedLog:
    """A recording, the checks of its data, and the filters to run on it.

    ``records`` are in SI, frame b, from the first row of the IMU. Without ``reference`` withheld fixes count.
    """

    spec: LogSpec
    records: LogRecords
    checks: tuple[Check, ...]  # each with its verdict `good`
    estimators: Mapping[str, estimator.Estimator]  # by label
    reference: Reference | None = None


def read_log(
    path: str | Path,
    *,
    estimators: Sequence[str] | None = None,
    allow_code: bool = False,
    overrides: Mapping[str, Any] | None = None,
    tune_noise: bool = False,
    motion_noise: bool = False,
    guard: Guard = DEFAULT_GUARD,
) -> RecordedLog:
    """Read a recorded log and check it; nothing is repaired.

    Parameters
    ----------
    path : str or Path
        The ``.toml`` file of the log: recorded files, mounting of the sensors, assumed datasheets.
    estimators : sequence of str, optional
        Filters, as in `bench.run`. Default: the filters of the log.
    allow_code : bool, optional
        Permit the log to run code it names. Default: no.
    overrides : mapping, optional
        Keys to replace, for example ``{"sensors.assumed.imu": "stim300"}``.
    tune_noise : bool, optional
        Assume the IMU noise measured at rest, if larger than the datasheet.
    motion_noise : bool, optional
        Assume the IMU noise measured in motion, if larger than the datasheet.
    guard : Guard, optional
        Limits for programs and classes.

    Returns
    -------
    RecordedLog
        The records, the ``checks`` and the filters, for `navigate`.

    Raises
    ------
    bench.ConfigError
        If a file is missing or wrong; the message names file and row.
    bench.EstimatorError
        If a filter cannot be built, or requires data that the log does not contain.

    Examples
    --------
    >>> import bench
    >>> bench.read_log("log.toml").checks  # doctest: +SKIP
    """
    spec = load_log(str(path), estimators, allow_code, overrides, guard)
    choices = {c.label: c for c in spec.estimators if not is_autopilot(c.use)}
    built = dict(zip(choices, load_estimators(choices.values()), strict=True))
    for label, one in built.items():
        estimator.check_needs(one, label, spec.records, f"{spec.name}.toml", specs=spec.assumed)
    records = read_records(spec)
    for choice in spec.estimators:
        if is_autopilot(choice.use):
            built[choice.label] = own_estimate.build(choice.use, spec.imu, records.origin)
    built = {choice.label: built[choice.label] for choice in spec.estimators}
    checks = validity.check_recording(
        records.imu, records.fixes, records.instruments, np.asarray(spec.antenna_b)
    )
    if spec.sideways or find_format(spec.imu.format).knows:  # else its axes are those of its course
        checks = [check for check in checks if check.name != "forward_yaw_deg"]
    if records.assumed:
        checks.append(Check("gnss_origin", None, records.assumed, False))
    weighing = {label for label, one in choices.items() if built_in.takes_option(one.use, REPORTED)}
    weighing = weighing if records.reported else set()  # every fix is as good as it says
    timing = {label for label, one in choices.items() if built_in.takes_offset(one.use, built[label])}
    if spec.clock_given or spec.reference is not None:  # a reference may have either clock
        timing = set()
    for label in weighing | timing:
        defaults: dict[str, Any] = {REPORTED: "reported"} if label in weighing else {}
        defaults |= {OFFSET: OFFSET_SD} if label in timing else {}
        choice = choices[label]
        built[label] = build_estimator(replace(choice, options={**defaults, **choice.options}))
    if any(OFFSET not in choices[label].options for label in timing):
        checks.append(validity.describe_offset(OFFSET_SD))
    if weighing and records.fixes.valid.any():
        checks.append(validity.describe_accuracy(records.fixes, records.reported))
    measures: list[Callable[..., tuple[ImuSpec, Check | None]]]
    measures = [validity.assume_range, *([assume_vibration] if spec.vibration else [])]
    for asked, assume in ((tune_noise, assume_rest_noise), (motion_noise, assume_motion_noise)):
        if asked:
            standstills = RecordedMotion.from_records(records.imu, records.fixes).find_standstills()
            measures.append(partial(assume, standstills=standstills))
    for measure in measures:
        imu, found = measure(spec.assumed.imu, records.imu)
        spec = replace(spec, assumed=replace(spec.assumed, imu=imu))
        checks += [found] if found else []
    judge_by = None
    if spec.reference is not None:
        last = float(records.imu.t.max())
        judge_by, aligned = reference.read_reference(
            spec.reference, records.origin, last, records.fixes, np.asarray(spec.antenna_b)
        )
        checks += aligned
        checks.append(reference.check_reference(judge_by, records.fixes))
    return RecordedLog(spec, records, tuple(checks), built, judge_by)


def navigate(
    log: str | Path | RecordedLog,
    *,
    outages: Sequence[float] | None = (),
    places: int = 10,
    progress: Progress | None = None,
) -> RunResult:
    """Run filters on a recorded log and evaluate them.

    The reference is a second system if the log names one; otherwise the fixes that are withheld. A filter
    that raises, or cannot start if another can, has failed.

    Parameters
    ----------
    log : str, Path or RecordedLog
        Path of the ``.toml`` file of a log, or a log from `read_log`.
    outages : sequence of float, optional
        Durations of simulated outages [s], each at several places in runs of their own. None: 10, 30 and 60 s
        if the recording is long enough, none if there is a reference. Default: none.
    places : int, optional
        Number of places of each outage. Default: 10.
    progress : callable, optional
        Called with the current `Stage`.

    Returns
    -------
    RunResult
        ``errors`` relative to withheld fixes or reference [m, m/s, rad; n], ``metrics``; ``more`` has the
        checks of the recording and the outage drift [m].

    Raises
    ------
    bench.ConfigError, bench.EstimatorError
        If a file is missing or wrong, start or outage do not fit the recording, or no filter can start.

    Examples
    --------
    >>> import bench
    >>> result = bench.navigate("log.toml", outages=[30.0])  # doctest: +SKIP
    >>> result.metrics["loose-15"]["outage_30_drift_h_m"]  # doctest: +SKIP
    """
    log = log if isinstance(log, RecordedLog) else read_log(log)
    stages = Stages(progress)
    with watch_compiling(stages.compile):
        return _navigate(log, outages, places, stages)


def _navigate(log: RecordedLog, outages: Sequence[float] | None, places: int, stages: Stages) -> RunResult:
    clock = time.process_time()
    spec = log.spec
    session = Session(spec, log.records, _find_start(log), log.reference)
    cuts = session.choose_cuts(places) if outages is None else dict.fromkeys(outages, places)
    for duration in cuts:
        session.check_room(duration)
    keep, withheld = session.split_fixes()
    gaps = used_fixes.find_outages(session.fixes)
    ends = np.array([end for _, end in gaps])
    data = session.make_data(keep, np.concatenate([session.make_output_times(), withheld.t, ends]))
    _check_needs(log, data)
    drifts = list[dict[str, Any]]()
    own = {label for label, one in log.estimators.items() if isinstance(one, AutopilotEstimator)}

    def measure_drifts(label: str, solution: NavSolution) -> None:
        found = (
            ((one.duration, [one]) for one in used_fixes.measure_outages(solution, session.fixes, data, gaps))
            if label in own
            else (
                (one, session.run_outages(log.estimators[label], label, one, count, outages is not None))
                for one, count in cuts.items()
            )
        )
        imu = spec.assumed.imu
        drifts.extend([make_drift_row(label, duration, rows, imu) for duration, rows in found if rows])

    answers = navigate_all(log.estimators, data, session.initial, spec.assumed, stages, measure_drifts)
    judged = dict[str, Judged]()
    for label, solution in answers.solutions.items():
        by_fixes = None if label in own or spec.gnss is None else withheld
        known = by_fixes if log.reference is None else log.reference
        more, counts = {"unmodeled_errors": answers.unmodeled[label]}, label not in own
        judged[label] = judge_solution(
            label, solution, known, data, spec.evaluation, spec.document, more, counts=counts
        )
        disk_arrays.release()
    metrics = {label: one.metrics for label, one in judged.items()}
    find_worked(log.estimators, metrics, data)
    last = float(log.records.imu.t.max())
    events = Events.from_rows([(0.0, last, "sanity", one.text) for one in log.checks if not one.good])
    checks = [{"name": c.name, "value": c.value, "good": c.good, "text": c.text} for c in log.checks]
    return RunResult(
        profile=spec.document,
        seed=0,
        run=0,
        metrics=metrics,
        errors={label: one.errors for label, one in judged.items()},
        solutions=answers.solutions,
        provenance={**results.provenance(), "cpu_s": {"all": time.process_time() - clock}},
        more={
            "log": {"origin_s": log.records.origin, "start_s": session.initial.t},
            "validity": checks,
            "outages": drifts,
        },
        records={
            "spec": spec,
            "sensed": Sensed(data, session.initial, no_sensor_truth(), events, log.records.sky),
            "withheld": withheld,
            "printed": collect_printed(log.estimators),
            **({} if log.reference is None else {"reference": log.reference}),
        },
    )


def _check_needs(log: RecordedLog, data: SensorData) -> None:
    """Raise EstimatorError if a record is missing that a filter needs; instruments are checked before."""
    present = {name for name in estimator.RECORDS if getattr(data, name) is not None}
    place = ": ".join(filter(None, [log.spec.name, log.records.no_ranges]))
    for label, one in log.estimators.items():
        estimator.check_needs(one, label, present, place)


def _find_start(log: RecordedLog) -> InitialState:
    """Return the initial state, with the heading of the autopilot if the log requests it."""
    own = None
    if log.spec.start.heading_from == AUTOPILOT:
        own = own_estimate.build(AUTOPILOT, log.spec.imu, log.records.origin).attitude
    return find_start(log.records, log.spec, own)


class Session:
    """A recording from its start on: data for the filters, and the fixes or the reference for evaluation."""

    def __init__(
        self,
        spec: LogSpec,
        recorded: LogRecords,
        initial: InitialState,
        judge_by: Reference | None = None,
    ) -> None:
        fixes, imu = recorded.fixes, recorded.imu
        after_start = fixes.t > initial.t if initial.alignment == "given" else fixes.t >= initial.t
        last = float(imu.t.max())
        good = fixes.valid & find_later(fixes.t) & after_start & (fixes.t <= last)
        self.spec, self.recorded, self.initial, self.reference = spec, recorded, initial, judge_by
        self.fixes = fixes.take(good)
        if spec.gnss is not None and not len(self.fixes):
            raise ConfigError(f"{spec.name}.toml: no usable fix after the start at {initial.t:.2f} s")
        if outside := spec.evaluation.describe_outside(last, "recording"):
            raise ConfigError(f"{spec.name}.toml: {outside}")
        self.first, self.last = max(initial.t, spec.evaluation.begin), last
        self.observations = self._cut_observations()

    @cached_property
    def sound(self) -> BoolArray:
        """Whether each fix (M,) agrees with the motion of the IMU."""
        return find_reachable(self.recorded.imu, self.fixes)

    def _cut_observations(self) -> GnssObservations | None:
        """Return the satellite observations of the epochs between start and end."""
        o = self.recorded.observations
        if o is None:
            return None
        begun = o.t > self.initial.t if self.initial.alignment == "given" else o.t >= self.initial.t
        return take_rows(o, np.asarray(begun & (o.t <= self.last)))

    def _keep_observations(self, keep: BoolArray, outage: tuple[float, float]) -> GnssObservations | None:
        """Return the satellite observations for filters: an epoch belongs to the first fix not before it."""
        o = self.observations
        if o is None:
            return None
        with_fix = np.searchsorted(self.fixes.t, o.t - SAME_INSTANT)
        out = (o.t > outage[0] + SAME_INSTANT) & (o.t <= outage[1] + SAME_INSTANT)
        return take_rows(o, np.append(keep, True)[with_fix] & ~out)

    def make_output_times(self) -> FloatArray:
        """Return the output epochs [s], a whole number of output intervals after t = 0."""
        step = 1.0 / self.spec.output_rate
        return np.arange(np.ceil(self.initial.t / step), np.floor(self.last / step) + 1) * step

    def split_fixes(self) -> tuple[BoolArray, GnssFixes]:
        """Return a mask (M,) of the fixes that filters get, and the withheld fixes: every n-th, if sound."""
        keep = np.ones(len(self.fixes), np.bool_)
        if self.spec.withhold:
            keep[self.spec.withhold - 1 :: self.spec.withhold] = False
            keep |= ~self.sound
        return keep, self.fixes.take(~keep)

    def make_data(
        self, keep: BoolArray, output_t: FloatArray, outage: tuple[float, float] = (np.inf, np.inf)
    ) -> SensorData:
        """Return the data for a filter; IMU intervals are divided to end at each fix and output.

        ``keep`` (M,) are the fixes it gets; it gets no ranges after the start of ``outage`` to its end [s].
        """
        fixes, output_t = self.fixes.take(keep), np.unique(output_t)
        others = self.recorded.instruments
        observations = self._keep_observations(keep, outage)
        seen = [] if observations is None else [np.unique(observations.t)]
        cuts = [output_t, fixes.t, *seen, *(record.t for record in others.values())]
        return SensorData(
            imu=divide_intervals(self.recorded.imu, np.concatenate(cuts)),
            fixes=None if self.spec.gnss is None else fixes,
            antenna_b=np.asarray(self.spec.antenna_b),
            specs=self.spec.assumed,
            output_t=output_t,
            ground_alt=self.recorded.ground_alt,
            date=self.spec.date,
            observations=observations,
            **others,
        )

    def choose_cuts(self, most: int) -> dict[float, int]:
        """Return the lengths [s] of outages that fit into the recording, and the number of places of each.

        At ``most``, and no more than have room beside each other: cuts that overlap tell the same twice.
        """
        if self.reference is not None or len(self.fixes) < 2:
            return {}
        room = float(self.fixes.t[-1]) - self.first
        least = float(np.median(np.diff(self.fixes.t))) / (1.0 - _WHOLE)  # so that a fix is near its end
        return {one: min(most, int(room // one)) for one in CUTS if least <= one <= 0.5 * room}

    def check_room(self, duration: float) -> None:
        """Raise ConfigError if an outage does not fit into the evaluated part of the recording."""
        if not len(self.fixes):
            raise ConfigError("--outages: without [gnss] there is nothing to lose; use --outages none")
        last = float(self.fixes.t[-1])
        if self.first + duration > last:
            raise ConfigError(f"--outages: {duration:g} s do not fit into {self.first:.1f} to {last:.1f} s")

    def run_outages(
        self, one: estimator.Estimator, label: str, duration: float, places: int, asked: bool = True
    ) -> list[OutageDrift]:
        """Return the drift over an outage at several places; the filter runs once for each.

        The last sound fix of an outage evaluates it, or the last epoch of the reference in it.

        Raises
        ------
        ConfigError
            If none of them ends with a sound fix or an epoch of the reference, and the user ``asked`` for it.
        """
        t = self.fixes.t
        drifts = []
        for begin in place_outages(self.first, float(t[-1]), duration, places):
            before = max(int(np.searchsorted(t, begin + SAME_INSTANT, "right")) - 1, 0)
            outage = float(t[before]), float(t[before]) + duration
            end = int(np.searchsorted(t, outage[1] + SAME_INSTANT, "right")) - 1
            keep = (t <= t[before]) | (t > t[end])
            if self.reference is None:
                sound = np.flatnonzero(self.sound[before + 1 : end + 1]) + before + 1
                end = int(sound[-1]) if len(sound) else before
                if t[end] - t[before] < _WHOLE * duration - SAME_INSTANT:
                    continue  # no sound fix evaluates this place
            data = self.make_data(keep, self._list_ends(float(t[end]), duration), outage)
            solution = estimator.answer(one, label, data, self.initial)
            if self.reference is None:
                last = self.fixes.take(np.arange(len(t)) == end)
                errors, moved = antenna_errors(solution, last, data)
                own = last.cov_pos_n[-1]
            else:
                errors, moved = compare(solution, self.reference, data)
                own = np.zeros((3, 3))
            if not len(errors):
                continue
            span = float(t[before]), float(errors.t[-1])
            drifts.append(OutageDrift.measure(*span, errors.pos_n[-1], moved.cov[-1], own))
        if not drifts and asked:
            known = "an epoch of [reference]" if self.reference else "a GNSS fix that fits the motion"
            raise ConfigError(
                f"--outages: none of {places} simulated outages of {duration:g} s ends with {known}; "
                f"the last possible end is {t[-1]:.1f} s"
            )
        return drifts

    def _list_ends(self, end: float, duration: float) -> FloatArray:
        """Return the output epochs at the end of an outage [s]; a reference has an epoch among them."""
        if self.reference is None:
            return np.array([end])
        count = int(max(_END_OF_CUT * duration, _SHORTEST_END) * self.spec.output_rate)
        return end - np.arange(count + 1)[::-1] / self.spec.output_rate
