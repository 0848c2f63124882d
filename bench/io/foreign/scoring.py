"""Evaluate a solution from a file on a run, as if it were the solution of a filter of bench."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from bench.core.mathematics import earth, rotation
from bench.core.mathematics.arrays import FloatArray
from bench.core.records.data import Events, GnssFixes, NavSolution, SensorData, Trajectory
from bench.core.records.run_records import ErrorSeries, Reference
from bench.core.records.run_result import RunResult
from bench.core.words.exceptions import ConfigError
from bench.evaluation.consistency.verdict import BROKEN
from bench.evaluation.conventions.convention_search import find_mistakes
from bench.evaluation.errors.error_series import interpolate_truth
from bench.evaluation.errors.resampling import ForeignSolution, resample
from bench.evaluation.judging import Known, judge_solution
from bench.io import results
from bench.io.config import fault_tables
from bench.io.config.checks import LABEL
from bench.io.exports.outgoing import make_calendar
from bench.io.foreign.local_frames import FREEDOM, NONE, YAW, align, is_origin
from bench.io.foreign.run_clock import RunClock
from bench.io.foreign.solution_rows import Placing
from bench.io.foreign.solutions import check_unit, read_solution
from bench.simulation.sensors.timing import select_output_times
from bench.simulation.signals.orbits import WEEK


@dataclass(frozen=True, slots=True)
class Score:
    """A solution, its errors and metrics, and the run it is evaluated on."""

    label: str
    solution: NavSolution  # at the output times of the run; NaN where the file has no solution
    errors: ErrorSeries
    metrics: Mapping[str, Any]
    run: RunResult
    coverage: float  # fraction of the output times with a solution [1]
    rows: int  # number of rows in the file


@dataclass(frozen=True, slots=True)
class Matching:
    """How times and positions of a file are matched with a run; None: found by the file."""

    t_0: float | None = None  # time in the file at the start of the run [s]
    longest: float | None = None  # longest interval between rows that is interpolated [s]
    align: str | None = None  # "se3", "yaw" or "none"
    frame: str | None = None  # axes of local positions, such as "enu-flu"
    origin: tuple[float, ...] | None = None  # latitude, longitude [deg], height [m], heading [deg] if given

    def check(self) -> None:
        """Raise ConfigError if a value is impossible."""
        for option, seconds in (("--t0", self.t_0), ("--max-gap", self.longest)):
            if seconds is not None and not math.isfinite(seconds):
                raise ConfigError(f"{option} {seconds:g} must be a number of seconds")
        if self.align is not None and self.align not in FREEDOM:
            raise ConfigError(f"--align {self.align!r} must be {', '.join(FREEDOM)}")
        if self.origin is not None and not is_origin(self.origin):
            raise ConfigError("--origin must be LAT,LON,HEIGHT or LAT,LON,HEIGHT,HEADING [deg, deg, m, deg]")


def score(path: Path, folder: Path, label: str | None, how: Matching) -> Score:
    """Evaluate a solution on a run; parameters and errors as `bench.cli.exchanging.score_solution`."""
    label = label or re.sub(r"[^A-Za-z0-9_.-]+", "-", path.stem)
    if not LABEL.fullmatch(label):
        raise ConfigError(
            f"--label {label!r} must be a name of letters, digits, '-', '_' and '.', 100 at most"
        )
    how.check()
    if path.is_dir() and folder.is_file():
        raise ConfigError(f"{folder} is a file and {path} a folder; the solution comes first, then the run")
    with results.report_damage(folder):
        run = results.read_result(folder)
        if label in run.metrics:
            raise ConfigError(f"{folder} has a solution {label!r} already; choose another name with --label")
        if run.truth is None and "log" in run.more:
            return _score_log(path, run, label, how)
        truth, sensed = results.load_truth(folder), run.sensed
        profile = run.profile
        rows = [
            (row["start_s"], row["start_s"] + row["duration_s"]) for row in profile.get("gnss_outage", [])
        ]
        outages = tuple(sorted(rows))
        faults = fault_tables.read_faults(profile.get("fault", []))
        t = select_output_times(truth.t, profile["evaluation"]["output_hz"], outages)
        year = float(results.load_start(folder)["date"])
    observations = sensed.data.observations if sensed else None
    calendar = make_calendar(year, None if observations is None else observations.gps_t0)
    clock = RunClock.of_run(float(truth.t[0]), float(truth.t[-1]), WEEK * calendar.week + calendar.second)
    foreign, kind = _read_matched(path, how, clock, truth.lla[0])
    if kind == NONE:
        check_unit(foreign, float(truth.t[0]), truth.lla[0])
    solution = resample(foreign, t, how.longest)
    if kind != NONE:
        target = interpolate_truth(truth, t)[0]
        solution = _align(kind, foreign, solution, (t, target, np.zeros(3)), how)
    facts = {
        "outages": outages,
        "faults": faults,
        "assumed": sensed.data.specs if sensed else None,
        "drawn": sensed.truth if sensed else None,
    }
    return _make_score(label, solution, truth, run, len(foreign), **facts)


def _score_log(path: Path, run: RunResult, label: str, how: Matching) -> Score:
    """Evaluate a solution on a log, by its reference or its withheld fixes."""
    data, by = run.sensors, run.records.get("reference")
    assert data is not None
    if not len(data.output_t):
        raise ConfigError("no filter of this log has epochs to compare with: navigate it again")
    fixes, known = data.fixes, run.records["withheld"] if by is None else by
    times = data.output_t
    clock = RunClock.of_log(float(times[0]), float(times[-1]), float(run.more["log"]["origin_s"]))
    targets = _list_targets(known, data)
    near = np.full(3, np.nan) if fixes is None or not len(fixes) else fixes.lla[0]
    if not np.isfinite(near).all():
        near = next((row for row in targets[1] if np.isfinite(row).all()), near)
    foreign, kind = _read_matched(path, how, clock, near)
    if kind == NONE and fixes is not None and len(fixes):
        check_unit(foreign, float(fixes.t[0]), fixes.lla[0])
    solution = resample(foreign, times, how.longest)
    if kind != NONE:
        solution = _align(kind, foreign, solution, targets, how)
    return _make_score(label, solution, known, run, len(foreign))


# --- times and positions ------------------------------------------------------------------------------

_Targets = tuple[FloatArray, FloatArray, FloatArray]
"""Times (N,) [s], positions (N, 3) [rad, rad, m], and their point relative to the IMU (3,) [m], b."""


def _list_targets(known: Reference | GnssFixes, data: SensorData) -> _Targets:
    """Return the positions of a log that a solution is aligned with."""
    if isinstance(known, Reference):
        return known.track.t, known.track.lla, known.point_b
    return known.t[known.valid], known.lla[known.valid], data.antenna_b


def _read_matched(
    path: Path, how: Matching, clock: RunClock, near: FloatArray
) -> tuple[ForeignSolution, str]:
    """Return the solution in a file on the times of the run, and the kind of its alignment."""
    foreign = read_solution(path, placing=Placing(how.frame, how.origin, near))
    kind = how.align or (NONE if foreign.placed else YAW)
    if kind == NONE and not foreign.placed:
        raise ConfigError(
            f"{foreign.shown}: its local frame has no known place: align it by --align yaw or se3, or give "
            "its place by --origin LAT,LON,HEIGHT"
        )
    t_0, remark = (how.t_0, "") if how.t_0 is not None else clock.find_start(foreign.t, foreign.clock)
    if "--t0" in remark and (foreign.clock or kind != NONE):
        raise ConfigError(f"{foreign.shown}: {remark}")
    remarks = (*foreign.remarks, remark) if remark else foreign.remarks
    return replace(foreign, t=foreign.t - t_0, remarks=remarks), kind


def _align(
    kind: str, foreign: ForeignSolution, solution: NavSolution, targets: _Targets, how: Matching
) -> NavSolution:
    """Return a solution aligned with positions of the run, and the alignment as an event."""
    t, target, point_b = targets
    there = resample(foreign, t, how.longest)
    arm_n = np.nan_to_num(rotation.rotate(there.q_nb, point_b))  # 0 if the attitude is unknown
    found = align(kind, earth.displace(there.lla, arm_n), target, foreign.shown)
    events = [(float(t[0]), float(t[-1]), "table", str(found)), *solution.events.rows()]
    return replace(found.apply(solution), events=Events.from_rows(events))


def _make_score(
    label: str, solution: NavSolution, known: Known, run: RunResult, rows: int, **facts: Any
) -> Score:
    """Return the verdict of a solution, and with a truth also the convention that may be mistaken."""
    blocks = (solution.lla, solution.vel_n, solution.q_nb)
    empty = np.all([np.isnan(block).all(axis=1) for block in blocks], axis=0)
    coverage = float(np.mean(np.isfinite(solution.t) & ~empty))
    judged = judge_solution(label, solution, known, run.sensors, run.evaluation, run.profile, **facts)
    if isinstance(known, Trajectory) and judged.metrics["verdict"] in BROKEN:
        antenna_b = np.zeros(3) if run.sensors is None else run.sensors.antenna_b
        judged = judged.explain(find_mistakes([known], [solution], antenna_b, run.evaluation.begin))
    return Score(label, solution, judged.errors, judged.metrics, run, coverage, rows)
