"""One value of a profile swept, over the noise draws of a campaign.

KEY is what --set reaches: a value of the profile such as leg.2.bank_deg, or a figure of a datasheet it names
such as sensors.gnss.latency_s, sensors.gnss.rate_hz, sensors.imu.gyro.noise_deg_sqrt_h; with sensors.assumed
instead of sensors only the filter assumes it. All values have the same draws.
"""

from __future__ import annotations

import tomllib
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np

from bench.campaigns.campaign_file import CampaignSpec
from bench.campaigns.outcome import Outcome
from bench.config import load_profile
from bench.config.library import find_datasheet
from bench.config.toml_file import read_toml
from bench.errors import ConfigError
from bench.evaluation.ensemble import compare_rmse
from bench.evaluation.metrics import find_metric
from bench.places import PACKAGE
from bench.plots import series
from bench.plots.series import Plot, Series
from bench.studies.study import (
    Count,
    Findings,
    StudyOptions,
    StudyTable,
    Words,
    Work,
    format_estimate,
    make_table,
)
from bench.units import unit_of

_SHOWN = ("pos_rmse_h_m", "pos_rmse_d_m", "vel_rmse_3d_mps", "tilt_rmse_deg", "heading_rmse_deg")


_FACTORS = (0.25, 0.5, 1.0, 2.0, 4.0)
"""Of the value of its own, unless others are given."""


class Options(StudyOptions):
    """What may be asked."""

    profile: str
    key: str
    values: Words | None = None
    """values of KEY; a quarter to four times its own if left out"""
    estimators: Words | None = None
    """filters to judge; those of the profile if left out"""
    draws: Count = 12
    """noise draws of each value"""


def run(options: Options, work: Work) -> Findings:
    """Return the errors of each filter over the values."""
    values = find_values(options)
    spec = CampaignSpec(
        name="sensitivity",
        profiles=(options.profile,),
        runs=options.draws,
        estimators=options.estimators,
        varied=tuple({options.key: value} for value in values),
    )
    done = work.campaign(f"{options.key} of {options.profile}", spec)
    outcomes = done.outcomes
    labels = list(dict.fromkeys(one.label for one in outcomes))
    by_label = {label: [one for one in outcomes if one.label == label] for label in labels}
    return Findings(
        verdicts=tuple(_tell(options, values, by_label, done.runs.to_pylist())),
        tables=(_fill(options, values, by_label),),
        figures=tuple(_plot(options, values, by_label)),
        draws=options.draws,
        good=all(one.converged.value == 1.0 for one in outcomes),
    )


def find_values(options: Options) -> list[Any]:
    """Return the values to sweep; ConfigError if none are given and the key has no number of its own."""
    if options.values is not None:
        return [_read(text) for text in options.values]
    own: Any = load_profile(options.profile).document
    parts = options.key.split(".")
    for k, part in enumerate(parts):
        own = own.get(part) if isinstance(own, Mapping) else None
        if isinstance(own, str) and parts[0] == "sensors" and k + 1 < len(parts):
            path, shown = find_datasheet(part, own, PACKAGE)
            sheet = read_toml(path, shown)
            own = {**sheet, **sheet.get(part, {})}
    if isinstance(own, bool) or not isinstance(own, int | float) or own == 0:
        raise ConfigError(
            f"study sensitivity: values is missing: {options.key} has no number of its own in "
            f"{options.profile}; give --values A,B,C"
        )
    return [factor * own for factor in _FACTORS]


def _read(text: str) -> Any:
    """Return a value as --set reads it: TOML or, if that fails, a text."""
    try:
        return tomllib.loads(f"value = {text}")["value"]
    except tomllib.TOMLDecodeError:
        return text


def _fill(options: Options, values: Sequence[Any], by_label: dict[str, list[Outcome]]) -> StudyTable:
    rows = []
    for label, outcomes in by_label.items():
        for value, one in zip(values, outcomes, strict=True):
            for name in _SHOWN:
                found = one.errors.get(name)
                measured = (found.value, found.low, found.high) if found else (None, None, None)
                rows.append((label, value, name, *measured, one.converged_runs))
    columns = ("estimator", options.key.rpartition(".")[2], "metric", "value", "low", "high", "runs")
    title = f"{options.profile}, {options.key}: pooled over the runs that converged, 95 % intervals"
    return make_table("sensitivity", title, columns, rows)


def _tell(
    options: Options,
    values: Sequence[Any],
    by_label: dict[str, list[Outcome]],
    runs: Sequence[Mapping[str, Any]],
) -> Iterator[str]:
    unit = unit_of(options.key)
    for label, outcomes in by_label.items():
        for name in ("pos_rmse_h_m", "heading_rmse_deg"):
            known = [k for k, one in enumerate(outcomes) if name in one.errors]
            if len(known) < 2:
                continue
            least, most = (end(known, key=lambda k: outcomes[k].errors[name].value) for end in (min, max))
            first, second = (_select(runs, label, k, name) for k in (most, least))
            both = sorted(first.keys() & second.keys())
            change = compare_rmse(
                (label, label),
                np.array([first[run] for run in both]),
                np.array([second[run] for run in both]),
                "",
            ).difference
            low, high = (format_estimate(outcomes[k].errors[name]) for k in (least, most))
            yield (
                f"{label}: {name} from {low} at {values[least]} {unit} to {high} at {values[most]} {unit}; "
                f"on the same draws {format_estimate(change)} apart."
            )
        lost = [str(value) for value, one in zip(values, outcomes, strict=True) if one.converged.value < 1.0]
        if lost:
            yield f"{label} did not converge in every run at {', '.join(lost)} {unit}."


def _select(runs: Sequence[Mapping[str, Any]], label: str, condition: int, name: str) -> dict[int, float]:
    """Return a metric of the runs of a condition that converged, by the number of the run."""
    mine = (row for row in runs if row["estimator"] == label and row["condition"] == condition)
    return {row["run"]: row[name] for row in mine if row["converged"] and row.get(name) is not None}


def _plot(options: Options, values: Sequence[Any], by_label: dict[str, list[Outcome]]) -> Iterator[Plot]:
    """Yield a plot of each error over the value, or over its number if it is no number."""
    numbers = all(isinstance(value, int | float) and not isinstance(value, bool) for value in values)
    x = np.array(values if numbers else range(1, len(values) + 1), float)
    over = options.key if numbers else f"number of the value of {options.key}"
    order = np.argsort(x)
    colours = series.estimator_colours(by_label)
    for name in _SHOWN:
        lines = []
        for label, outcomes in by_label.items():
            rows = [
                (found.value, found.low, found.high) if (found := one.errors.get(name)) else (np.nan,) * 3
                for one in outcomes
            ]
            if np.isfinite(rows).any():
                colour = colours[label]
                y = np.array(rows)[order]
                lines.append(
                    Series(label, x[order], y, (label,) * 3, (colour,) * 3, (1.5, 1.0, 1.0), band=(1, 2))
                )
        if lines:
            known = find_metric(name)
            across = (unit_of(options.key) if numbers else "") or "1"
            title = f"{name} [{known.unit if known else ''}]"
            yield Plot(("sensitivity", name), title, tuple(lines), across=across, over=over, log="y")
