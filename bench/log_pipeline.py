"""A recording of real sensors: read, checked, navigated, and judged by fixes the filters were not given."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields

import numpy as np

from bench import pipeline, store
from bench.arrays import BoolArray, FloatArray
from bench.config.log import LogSpec, load_log
from bench.data import Events, GnssFixes, InitialState, RunResult, Sensed, SensorData, nothing_drawn
from bench.errors import ConfigError
from bench.evaluation import outages, validity
from bench.evaluation.fixes import antenna_errors, judge
from bench.evaluation.outages import OutageDrift, make_drift_row
from bench.exchange.log_records import LogRecords, divide_intervals, read_records
from bench.exchange.log_start import find_start
from bench.navigation import estimator
from bench.units import SAME_INSTANT


@dataclass(frozen=True, slots=True)
class RecordedLog:
    """A recording with what looks wrong in it, and the estimators that are to run on it."""

    spec: LogSpec
    records: LogRecords
    checks: tuple[validity.Check, ...]  # `good` or not
    estimators: Mapping[str, estimator.Estimator]  # by label


def read_log(name: str, estimators: Sequence[str] | None = None, allow_commands: bool = False) -> RecordedLog:
    """Read a log and check its records; parameters and errors as `bench.api.read_log`."""
    spec = load_log(name, estimators, allow_commands)
    built = {c.label: pipeline.build_estimator(c) for c in spec.estimators}
    for label, one in built.items():
        estimator.check_needs(one, label, {"fixes"} | ({"baro"} if spec.baro else set()))
    records = read_records(spec)
    checks = validity.check_recording(records.imu, records.fixes, records.baro, np.asarray(spec.antenna_b))
    return RecordedLog(spec, records, tuple(checks), built)


def navigate_log(log: RecordedLog, durations: Sequence[float], places: int) -> RunResult:
    """Run estimators on a recording and judge them; parameters and errors as `bench.api.navigate_log`."""
    clock = time.process_time()
    spec = log.spec
    session = Session(spec, log.records, find_start(log.records, spec))
    for duration in durations:
        session.check_room(duration)
    keep, withheld = session.withheld()
    data = session.data(keep, np.concatenate([session.grid(), withheld.t]))
    there = {name for name in estimator.RECORDS if getattr(data, name) is not None}
    for label, one in log.estimators.items():
        estimator.check_needs(one, label, there, spec.name)
    solutions, errors, metrics, drifts = {}, {}, {}, []
    for label, one in log.estimators.items():
        solutions[label] = estimator.answer(one, label, data, session.initial)
        errors[label], metrics[label] = judge(solutions[label], withheld, data, spec.evaluation_from)
        if asked := getattr(one, "unmodelled", None):
            metrics[label]["unmodelled"] = list(asked(spec.assumed))
        for duration in durations:
            cuts = session.cuts(one, label, duration, places)
            drifts.append(make_drift_row(label, duration, cuts, spec.assumed.imu))
    doubts = [check for check in log.checks if not check.good]
    last = float(log.records.imu.t.max())
    events = Events.from_rows([(0.0, last, "sanity", check.text) for check in doubts])
    checks = [{"name": c.name, "value": c.value, "good": c.good, "text": c.text} for c in log.checks]
    return RunResult(
        profile=spec.document,
        seed=0,
        run=0,
        metrics=metrics,
        errors=errors,
        solutions=solutions,
        provenance={**store.provenance(), "cpu_s": {"all": time.process_time() - clock}},
        more={
            "log": {"origin_s": log.records.origin, "start_s": session.initial.t},
            "validity": checks,
            "outages": drifts,
        },
        records={
            "spec": spec,
            "sensed": Sensed(data, session.initial, nothing_drawn(), events),
            "withheld": withheld,
        },
    )


class Session:
    """A recording from its start on, with the fixes a filter is given and those that judge it."""

    def __init__(self, spec: LogSpec, recorded: LogRecords, initial: InitialState) -> None:
        fixes, imu = recorded.fixes, recorded.imu
        newest = np.concatenate([[-np.inf], np.maximum.accumulate(fixes.t)[:-1]])
        begun = fixes.t > initial.t if initial.alignment == "given" else fixes.t >= initial.t
        good = fixes.valid & (fixes.t > newest) & begun & (fixes.t <= imu.t.max())
        self.spec, self.recorded, self.initial = spec, recorded, initial
        self.fixes = _select_fixes(fixes, good)
        if not len(self.fixes):
            raise ConfigError(f"{spec.name}.toml: no usable fix after the start at {initial.t:.2f} s")
        last = float(imu.t.max())
        if spec.evaluation_from >= last:
            raise ConfigError(
                f"{spec.name}.toml: [evaluation] from_s = {spec.evaluation_from:g} s is outside the "
                f"recording, 0 to {last:.2f} s"
            )
        self.first, self.last = max(initial.t, spec.evaluation_from), last

    def grid(self) -> FloatArray:
        """Return the instants at which solutions are wanted [s]."""
        step = 1.0 / self.spec.output_rate
        return np.arange(np.ceil(self.initial.t / step), np.floor(self.last / step) + 1) * step

    def withheld(self) -> tuple[BoolArray, GnssFixes]:
        """Return which fixes (M,) a filter is given, and the others: every n-th."""
        keep = np.ones(len(self.fixes), np.bool_)
        if self.spec.withhold:
            keep[self.spec.withhold - 1 :: self.spec.withhold] = False
        return keep, _select_fixes(self.fixes, ~keep)

    def data(self, keep: BoolArray, output_t: FloatArray) -> SensorData:
        """Return what an estimator gets: fixes to keep, IMU intervals that end at them and at outputs."""
        fixes, output_t = _select_fixes(self.fixes, keep), np.unique(output_t)
        baro = self.recorded.baro
        cuts = [output_t, fixes.t] + ([baro.t] if baro is not None else [])
        return SensorData(
            imu=divide_intervals(self.recorded.imu, np.concatenate(cuts)),
            fixes=fixes,
            baro=baro,
            antenna_b=np.asarray(self.spec.antenna_b),
            specs=self.spec.assumed,
            output_t=output_t,
        )

    def check_room(self, duration: float) -> None:
        """Raise ConfigError when an outage is longer than what there is of the recording."""
        last = float(self.fixes.t[-1])
        if self.first + duration > last:
            raise ConfigError(
                f"--outages: {duration:g} s do not fit between {self.first:.1f} and {last:.1f} s, where the "
                "filters are judged"
            )

    def cuts(self, one: estimator.Estimator, label: str, duration: float, places: int) -> list[OutageDrift]:
        """Return the drift over an outage at each place, each in a run of its own."""
        t = self.fixes.t
        found = []
        for begin in outages.place_outages(self.first, float(t[-1]), duration, places):
            before = max(int(np.searchsorted(t, begin + SAME_INSTANT, "right")) - 1, 0)
            end = int(np.searchsorted(t, t[before] + duration + SAME_INSTANT, "right")) - 1
            keep = (t <= t[before]) | (t > t[end])
            data = self.data(keep, t[end : end + 1])
            solution = estimator.answer(one, label, data, self.initial)
            last = _select_fixes(self.fixes, np.arange(len(t)) == end)
            error = antenna_errors(solution, last, data).pos_n[0]
            variance = np.diag(solution.cov[0])
            found.append(
                OutageDrift(
                    start=float(t[before]),
                    duration=float(t[end] - t[before]),
                    drift=float(np.hypot(error[0], error[1])),
                    drift_v=float(abs(error[2])),
                    claimed=float(np.sqrt(0.5 * (variance[0] + variance[1]))),
                )
            )
        return found


def _select_fixes(fixes: GnssFixes, rows: BoolArray) -> GnssFixes:
    """Return some of the fixes."""
    return GnssFixes(**{f.name: getattr(fixes, f.name)[rows] for f in fields(fixes)})
