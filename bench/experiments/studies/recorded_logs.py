"""Filters compared on many recordings; each log is one trial.

LOGS are files LOG.toml, or folders with them, separated by commas. Each log is navigated as in bench
navigate: evaluated by its reference, else by the withheld fixes, and by simulated outages of 10, 30 and 60
s if it is long enough. Filters are compared with the first one on the logs on which both have a result:
geometric mean of the ratios and Student's t, all comparisons together at 5 %. To find the logs that got
worse after a change of code or parameters, record baselines and use bench check LOG.toml...
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from pydantic import Field

from bench.core.records.findings import Findings, FindingTable, make_table, series
from bench.core.records.findings.series import Plot, Series
from bench.core.words.exceptions import ConfigError, EstimatorError
from bench.core.words.wording import one_line
from bench.evaluation.ensembles.ensemble import CONFIDENCE, Estimate, qualify
from bench.evaluation.ensembles.regression import average_changes, decide
from bench.experiments.studies.study import (
    Settings,
    StudyOptions,
    StudyWorkers,
    Words,
    format_estimate,
    read_settings,
)
from bench.io.config.log import is_log
from bench.pipeline import log_pipeline

STUDY = 8, "logs"
QUESTION = "Which filter does better on many recordings?"

_LEAST = 3  # logs that tell how much ratios scatter


class Options(StudyOptions):
    """Options of the study."""

    logs: Words
    estimators: Words | None = None
    """filters to run; default: all of each log"""
    places: Annotated[int, Field(ge=2, le=1000)] = 5
    """places of each simulated outage in each log"""
    allow_code: bool = False
    """permit the logs to run code they name"""
    overrides: Settings = ()
    """values of the logs to replace, or figures of datasheets they name"""


@dataclass(frozen=True)
class LogResult:
    """A filter on a log."""

    log: str
    label: str
    word: str  # the verdict, or "no result"
    reason: str  # why there is none, or why it did not converge
    good: bool
    values: Mapping[str, float]  # of the quantities that are known


def run(options: Options, work: StudyWorkers) -> Findings:
    """Return the result of each filter on each log, and the comparison of each filter with the first."""
    paths = find_logs(options.logs)
    function = partial(
        navigate_one,
        estimators=options.estimators,
        places=options.places,
        allow_code=options.allow_code,
        overrides=read_settings(options.overrides),
    )
    names = name_logs(paths)
    every = work.map("logs", function, [str(path) for path in paths], first=[0])
    rows = [LogResult(names[k], *one) for k, found in enumerate(every) for one in found]
    labels = list(dict.fromkeys(row.label for row in rows if row.label))
    told = list(compare_filters(rows, labels))
    return Findings(
        verdicts=tuple(tell_logs(rows, labels, len(paths), told)),
        tables=tuple(tabulate_logs(rows, told)),
        figures=tuple(plot_logs(rows, labels, list(names))),
        good=all(row.good for row in rows),
    )


def find_logs(given: Sequence[str]) -> list[Path]:
    """Return the logs of files and folders, logs of a folder by name.

    Raises
    ------
    ConfigError
        If a file is none, a folder has none, or one is given twice.
    """
    found: list[Path] = []
    for name in given:
        path = Path(name)
        inside = sorted(one for one in path.glob("*.toml") if is_log(one)) if path.is_dir() else [path]
        if not inside:
            raise ConfigError(f"study logs: {name}: no LOG.toml in this folder; bench new log writes one")
        found += inside
    resolved = [path.resolve() for path in found]
    for path, where in zip(found, resolved, strict=True):
        if resolved.count(where) > 1:
            raise ConfigError(f"study logs: {path} is given twice; it would count as two trials")
    return found


def name_logs(paths: Sequence[Path]) -> list[str]:
    """Return a name for each log: its file name, with as many folders as make all names unique."""
    for depth in range(1, max(len(path.resolve().parts) for path in paths) + 1):
        names = ["/".join(path.resolve().with_suffix("").parts[-depth:]) for path in paths]
        if len(set(names)) == len(names):
            break
    return names


_One = tuple[str, str, str, bool, dict[str, float]]


def navigate_one(
    path: str, estimators: Sequence[str] | None, places: int, allow_code: bool, overrides: Mapping[str, Any]
) -> list[_One]:
    """Return label, verdict, reason, success and values of each filter on a log; runs in a worker."""
    if not path.endswith(".toml"):
        return [
            ("", "no result", f"it has no LOG.toml; bench new log {path} writes it, or says why", False, {})
        ]
    try:
        log = log_pipeline.read_log(path, estimators=estimators, allow_code=allow_code, overrides=overrides)
        result = log_pipeline.navigate(log, outages=None, places=places)
    except (ConfigError, EstimatorError) as error:
        return [("", "no result", one_line(str(error)), False, {})]
    return [
        (
            label,
            str(values.get("verdict", "")),
            one_line(str(values["reason"] or "")),
            bool(values["converged"]),
            dict(list_values(label, values, result.more["outages"])),
        )
        for label, values in result.metrics.items()
    ]


def list_values(
    label: str, values: Mapping[str, Any], drifts: Sequence[Mapping[str, Any]]
) -> Iterator[tuple[str, float]]:
    """Yield the compared quantities by name with unit: errors, and drifts in simulated outages."""
    known = {"horizontal_m": "pos_rmse_h_m", "height_m": "pos_rmse_d_m", "velocity_mps": "vel_rmse_3d_mps"}
    for name, metric in known.items():
        value = values.get(metric)
        if value is not None and math.isfinite(value):
            yield name, float(value)
    for row in drifts:
        if row["estimator"] == label and row["duration_s"] in log_pipeline.CUTS:
            yield f"drift_{row['duration_s']:g}_s_m", float(row["median_h_m"])


def compare_filters(
    rows: Sequence[LogResult], labels: Sequence[str]
) -> Iterator[tuple[str, str, Estimate, int, str]]:
    """Yield quantity, filter, ratio to the first filter over the logs, number of logs, and verdict.

    By the mean of the log ratios; Holm's method keeps the probability of any false word. A filter that lost a
    log that the other one kept is not called better: it may lack the worst.
    """
    values = {(row.label, row.log): row.values if row.good else {} for row in rows}
    logs = list(dict.fromkeys(row.log for row in rows))
    pairs = []
    for label in labels[1:]:
        for name in dict.fromkeys(key for row in rows for key in row.values):
            a, b = (
                np.array([values.get((one, log), {}).get(name, np.nan) for log in logs])
                for one in (label, labels[0])
            )
            both = (a > 0.0) & (b > 0.0)
            if both.sum() >= _LEAST:
                changes = np.log(a[both] / b[both])
                lost = int(np.sum((b > 0.0) & ~(a > 0.0))), int(np.sum((a > 0.0) & ~(b > 0.0)))
                pairs.append((name, label, average_changes(changes), lost))
    if not pairs:
        return
    proven, levels = decide([change for _, _, change, _ in pairs], 1.0 - CONFIDENCE)
    for (name, label, change, lost), sure, level in zip(pairs, proven, levels, strict=True):
        low, high = change.interval(level)
        better = change.estimate < 0.0
        word = ("better" if better else "worse") if sure else "undecided"
        if sure and lost[0 if better else 1] > lost[1 if better else 0]:
            word = "undecided: it lost logs that the other kept"
        yield name, label, Estimate(*np.exp([change.estimate, low, high]).tolist()), change.draws, word


def tell_logs(
    rows: Sequence[LogResult],
    labels: Sequence[str],
    count: int,
    told: Sequence[tuple[str, str, Estimate, int, str]],
) -> Iterator[str]:
    """Yield the verdicts of each filter, how filters compare, and what failed."""
    for label in labels:
        own = [row for row in rows if row.label == label]
        words: dict[str, int] = {}
        for row in own:
            words[row.word] = words.get(row.word, 0) + 1
        listed = ", ".join(f"{word} on {number}" for word, number in words.items())
        yield f"{label}, {count} {'log' if count == 1 else 'logs'}: {listed}."
    for name, label, ratio, logs, word in told:
        if word in ("better", "worse"):
            text = (
                f"{format_estimate(ratio)} times that of {labels[0]} on {logs} logs{qualify(logs)}: {word}."
            )
            yield f"{label}: {_say(name)} {text}"
    open_ones = sum(word not in ("better", "worse") for *_, word in told)
    if open_ones:
        yield f"{open_ones} of {len(told)} comparisons with {labels[0]} are undecided; the table has them."
    if len(labels) > 1 and not told:
        yield f"Fewer than {_LEAST} logs have results of both filters: nothing is compared."
    for row in rows:
        if not row.good:
            yield f"{row.log}{', ' if row.label else ''}{row.label}: {row.reason}"


def _say(name: str) -> str:
    if name.startswith("drift_"):
        return f"drift in {name.split('_')[1]} s without GNSS"
    return {"horizontal_m": "horizontal error", "height_m": "height error"}.get(name, "velocity error")


def tabulate_logs(
    rows: Sequence[LogResult], told: Sequence[tuple[str, str, Estimate, int, str]]
) -> Iterator[FindingTable]:
    """Yield a row for each filter on each log and, if there are some, the comparisons."""
    names = list(dict.fromkeys(key for row in rows for key in row.values))
    table = [(row.log, row.label or "-", row.word, *(row.values.get(name) for name in names)) for row in rows]
    yield make_table("logs", "Each filter on each log", ("log", "estimator", "verdict", *names), table)
    if told:
        pairs = [(_say(n), label, r.value, r.low, r.high, logs, word) for n, label, r, logs, word in told]
        columns = ("quantity", "estimator", "ratio", "low", "high", "logs", "word")
        yield make_table("comparison", "Over the first filter, 95 % over all comparisons", columns, pairs)


def plot_logs(rows: Sequence[LogResult], labels: Sequence[str], logs: Sequence[str]) -> Iterator[Plot]:
    """Yield a plot of each quantity, with a dot for each log and filter."""
    colors = series.estimator_colors(labels)
    places = {log: k + 1.0 for k, log in enumerate(logs)}
    for name in dict.fromkeys(key for row in rows for key in row.values):
        lines = []
        for label in labels:
            known = [(places[r.log], r.values[name]) for r in rows if r.label == label and r.values.get(name)]
            if known:
                x, y = np.array(known).T
                lines.append(Series(label, x, y[:, None], (label,), (colors[label],), (5.0,), marks=True))
        if lines:
            yield Plot(
                ("logs", name.removesuffix("_m")),
                f"{_say(name)} [{'m/s' if name.endswith('mps') else 'm'}]",
                tuple(lines),
                across="",
                over="log",
                log="y",
                ticks=tuple((places[log], log) for log in logs),
            )
