"""``bench navigate LOG.toml``: estimators on a recording, judged by fixes they were not given."""

from __future__ import annotations

import sys
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console
from rich.table import Table

from bench import pipeline, store
from bench.arrays import BoolArray, FloatArray
from bench.config.log import LogSpec, load_log
from bench.data import (
    Events,
    GnssFixes,
    InitialState,
    RunResult,
    Sensed,
    SensorData,
    SensorTruth,
)
from bench.errors import ConfigError
from bench.evaluation import outages, validity
from bench.evaluation.fixes import antenna_errors, judge
from bench.exchange.log import Recording, divided, read_log
from bench.exchange.log_start import start
from bench.navigation import estimator
from bench.units import SAME_INSTANT
from bench.workbench import show
from bench.workbench.flight_verbs import RUNS

PLACES = 10
"""Places of the recording where each outage is cut, when not told."""


@dataclass(frozen=True, slots=True)
class Cut:
    """What one outage at one place did to an estimator."""

    start: float  # the last fix before it [s]
    duration: float  # from there to the fix that ends it [s]
    drift: float  # horizontal error at the fix that ends it [m]
    drift_v: float  # vertical [m]
    claimed: float  # standard deviation by axis that the filter claims there [m]


def navigate(
    name: str,
    *,
    console: Console,
    estimators: Sequence[str] | None = None,
    durations: Sequence[float] = (),
    places: int = PLACES,
    out: Path | None = None,
    recording: bool = True,
    force: bool = False,
    allow_commands: bool = False,
) -> dict[str, Any]:
    """Check a recording, run estimators on it, judge them, and write the results folder.

    Parameters
    ----------
    name : str
        Path of the log's ``.toml``.
    console : Console
        Where the report and the tables go.
    estimators : sequence of str or None
        As `bench.config.log.load_log` takes them.
    durations : sequence of float
        GNSS outages to cut [s]; each at ``places`` places, each in a run of its own.
    out, recording, force, allow_commands
        As `bench.workbench.flight_verbs.run` takes them; the folder is ``runs/<log>`` when not told.

    Returns
    -------
    summary : dict
        ``metrics`` by estimator, ``validity`` and ``outages``, as in ``result.json``.

    Raises
    ------
    ConfigError, bench.errors.EstimatorError, OSError
        With nothing left behind.
    """
    if str(Path.cwd()) not in sys.path:
        sys.path.append(str(Path.cwd()))  # where the user's own estimators are looked for, after all else
    spec = load_log(name, estimators, allow_commands)
    built = {c.label: pipeline.build(c) for c in spec.estimators}
    for label, one in built.items():
        estimator.check_needs(one, label, {"fixes"} | ({"baro"} if spec.baro else set()))
    folder = out or RUNS / spec.name
    store.check_folder(folder, force=force)
    begun, clock = time.perf_counter(), time.process_time()
    recorded = read_log(spec)
    checks = validity.check(recorded.imu, recorded.fixes, recorded.baro, np.asarray(spec.antenna_b))
    _report(console, spec, recorded, checks)
    session = Session(spec, recorded, start(recorded, spec))
    table = []
    for duration in durations:
        session.check_room(duration)
    keep, withheld = session.withheld()
    data = session.data(keep, np.concatenate([session.grid(), withheld.t]))
    records = {name for name in estimator.RECORDS if getattr(data, name) is not None}
    for label, one in built.items():
        estimator.check_needs(one, label, records, spec.name)
    solutions, errors, metrics = {}, {}, {}
    for label, one in built.items():
        solutions[label] = estimator.answer(one, label, data, session.initial)
        errors[label], metrics[label] = judge(solutions[label], withheld, data, spec.evaluation_from)
        if asked := getattr(one, "unmodelled", None):
            metrics[label]["unmodelled"] = list(asked(spec.assumed))
        table += [
            drift_row(label, duration, session.cuts(one, label, duration, places), spec)
            for duration in durations
        ]
    result = RunResult(
        profile=spec.document,
        seed=0,
        run=0,
        metrics=metrics,
        errors=errors,
        solutions=solutions,
        provenance={**store.provenance(), "cpu_s": {"all": time.process_time() - clock}},
    )
    more = {
        "log": {"origin_s": recorded.origin, "start_s": session.initial.t},
        "validity": [{"name": c.name, "value": c.value, "good": c.good, "text": c.text} for c in checks],
        "outages": table,
    }
    sensed = Sensed(data, session.initial, _NOTHING_DRAWN, _events(recorded, checks))
    console.print(f"{spec.title}: {len(withheld)} fixes withheld, from {spec.evaluation_from:g} s on")
    show.metrics(console, metrics, solutions)
    if table:
        _drifts(console, table)
    with store.new_folder(folder, force=force) as partial:
        store.save(partial, result, None, sensed, more)
        if recording:
            from bench.errors import NothingToShowError
            from bench.recording import write

            try:
                write(partial / store.RECORDING, spec, None, sensed, solutions, errors, metrics, _page(table))
            except NothingToShowError as error:
                recording = False
                console.print(f"No recording: {error}.")
    console.print(f"Wrote {folder} in {time.perf_counter() - begun:.1f} s.")
    if recording:
        console.print(f"Next: bench view {folder}")
    return {"metrics": metrics, **more}


_NOTHING_DRAWN = SensorTruth(np.empty(0), np.empty((0, 3)), np.empty((0, 3)))


class Session:
    """A recording from its start on, with the fixes a filter is given and those that judge it."""

    def __init__(self, spec: LogSpec, recorded: Recording, initial: InitialState) -> None:
        fixes, imu = recorded.fixes, recorded.imu
        newest = np.concatenate([[-np.inf], np.maximum.accumulate(fixes.t)[:-1]])
        begun = fixes.t > initial.t if initial.alignment == "given" else fixes.t >= initial.t
        good = fixes.valid & (fixes.t > newest) & begun & (fixes.t <= imu.t.max())
        self.spec, self.recorded, self.initial = spec, recorded, initial
        self.fixes = taken(fixes, good)
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
        """Return which fixes (M,) a filter is given, and the others: every so manyth."""
        keep = np.ones(len(self.fixes), np.bool_)
        if self.spec.withhold:
            keep[self.spec.withhold - 1 :: self.spec.withhold] = False
        return keep, taken(self.fixes, ~keep)

    def data(self, keep: BoolArray, output_t: FloatArray) -> SensorData:
        """Return what an estimator gets: fixes to keep, IMU intervals that end at them and at outputs."""
        fixes, output_t = taken(self.fixes, keep), np.unique(output_t)
        baro = self.recorded.baro
        cuts = [output_t, fixes.t] + ([baro.t] if baro is not None else [])
        return SensorData(
            imu=divided(self.recorded.imu, np.concatenate(cuts)),
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

    def cuts(self, one: estimator.Estimator, label: str, duration: float, places: int) -> list[Cut]:
        """Return the drift over an outage at each place, each in a run of its own."""
        t = self.fixes.t
        found = []
        for begin in outages.places(self.first, float(t[-1]), duration, places):
            before = max(int(np.searchsorted(t, begin + SAME_INSTANT, "right")) - 1, 0)
            end = int(np.searchsorted(t, t[before] + duration + SAME_INSTANT, "right")) - 1
            keep = (t <= t[before]) | (t > t[end])
            data = self.data(keep, t[end : end + 1])
            solution = estimator.answer(one, label, data, self.initial)
            error = antenna_errors(solution, taken(self.fixes, np.arange(len(t)) == end), data).pos_n[0]
            variance = np.diag(solution.cov[0])
            found.append(
                Cut(
                    start=float(t[before]),
                    duration=float(t[end] - t[before]),
                    drift=float(np.hypot(error[0], error[1])),
                    drift_v=float(abs(error[2])),
                    claimed=float(np.sqrt(0.5 * (variance[0] + variance[1]))),
                )
            )
        return found


def taken(fixes: GnssFixes, rows: BoolArray) -> GnssFixes:
    """Return some of the fixes."""
    columns = {f.name: getattr(fixes, f.name)[rows] for f in fields(fixes)}
    return GnssFixes(**columns)


def drift_row(label: str, duration: float, cuts: Sequence[Cut], spec: LogSpec) -> dict[str, Any]:
    """Return a line of the drift table: horizontal drift, its quantiles, and what was to be expected [m]."""
    drift = np.array([cut.drift for cut in cuts])
    median, most = outages.quantile(drift, 0.5), outages.quantile(drift, 0.95)
    law = outages.closed_form_sd(spec.assumed.imu, duration)
    return {
        "estimator": label,
        "duration_s": duration,
        "places": len(cuts),
        "median_h_m": median.value,
        "median_h_low_m": median.low,
        "median_h_high_m": median.high,
        "p95_h_m": most.value,
        "p95_h_low_m": most.low,
        "p95_h_high_m": most.high,
        "rms_h_m": float(np.sqrt(np.mean(drift**2))),
        "median_v_m": float(np.median([cut.drift_v for cut in cuts])),
        "claimed_median_h_m": float(outages.RAYLEIGH_MEDIAN * np.median([cut.claimed for cut in cuts])),
        "closed_form_median_h_m": outages.RAYLEIGH_MEDIAN * law,
        "closed_form_p95_h_m": outages.RAYLEIGH_95 * law,
        "starts_s": [cut.start for cut in cuts],
        "drifts_h_m": drift.tolist(),
    }


def _report(console: Console, spec: LogSpec, recorded: Recording, checks: Sequence[validity.Check]) -> None:
    console.print(f"{spec.title}: t = 0 is {recorded.origin:.9g} s on the clock of the files")
    for check in checks:
        mark, style = ("  ", None) if check.good else ("! ", "yellow")
        console.print(mark + check.text, style=style, soft_wrap=True)
    for note in recorded.notes:
        console.print(f"  {note}")


def _events(recorded: Recording, checks: Sequence[validity.Check]) -> Events:
    last = float(recorded.imu.t.max())
    return Events.from_rows([(0.0, last, "sanity", check.text) for check in checks if not check.good])


def _drifts(console: Console, table: Sequence[Mapping[str, Any]]) -> None:
    """Print the drift table; an end of an interval that so few places cannot give is a dash."""
    shown = Table(*_COLUMNS, title="Horizontal drift without GNSS [m]", title_justify="left")
    for row in table:
        shown.add_row(*_cells(row))
    console.print(shown)
    console.print(_MEANING, soft_wrap=True)


_COLUMNS = ("outage", "estimator", "places", "median", "95 %", "claimed", "law")
_MEANING = (
    "In brackets the 95 % interval of the quantile, from the places alone. Claimed: the median the filter "
    "says of itself. Law: the median by bias instability and noise of the assumed datasheet after a perfect "
    "start."
)


def _cells(row: Mapping[str, Any]) -> tuple[str, ...]:
    return (
        f"{row['duration_s']:g} s",
        row["estimator"],
        str(row["places"]),
        _interval(row, "median_h"),
        _interval(row, "p95_h"),
        _number(row["claimed_median_h_m"]),
        f"{row['closed_form_median_h_m']:.3g}",
    )


def _page(table: Sequence[Mapping[str, Any]]) -> str:
    """Return the drift table in markdown."""
    if not table:
        return ""
    rows = [_COLUMNS, ("---",) * len(_COLUMNS), *map(_cells, table)]
    lines = [f"| {' | '.join(row)} |" for row in rows]
    return "\n".join(["", "**Horizontal drift without GNSS** [m]", "", *lines, "", _MEANING, ""])


def _interval(row: Mapping[str, Any], name: str) -> str:
    low, high = row[f"{name}_low_m"], row[f"{name}_high_m"]
    if not np.isfinite(row[f"{name}_m"]):
        return "-"
    ends = " to ".join(map(_number, (low, high)))
    return f"{row[f'{name}_m']:.3g} ({ends})"


def _number(value: float | None) -> str:
    return "-" if value is None or not np.isfinite(value) else f"{value:.3g}"
