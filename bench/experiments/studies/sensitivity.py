"""A sweep of one value of a profile, over the runs of a campaign.

KEY is any key of --set: a value of the profile such as leg.2.bank_deg, or a datasheet parameter such as
sensors.gnss.latency_s, sensors.gnss.rate_hz or sensors.imu.gyro.noise_deg_sqrt_h. With sensors.assumed
instead of sensors only the filter assumes the value. All values use the same runs. While the best and the
worst value cannot be separated, runs are added up to --max-runs.
"""

from __future__ import annotations

import math
import tomllib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from bench.core.files.places import PACKAGE
from bench.core.mathematics.units import unit_of
from bench.core.records.findings import Findings, FindingTable, make_table, series
from bench.core.records.findings.series import Plot, Series
from bench.core.words.exceptions import ConfigError
from bench.evaluation.ensembles.ensemble import Estimate, pool_rmse
from bench.evaluation.ensembles.paired_draws import PairedRatio, compare_draws_of
from bench.evaluation.metrics.run_metrics import find_metric
from bench.evaluation.requirements.required_metrics import Looks
from bench.experiments.campaigns.campaign_file import CampaignSpec
from bench.experiments.campaigns.plan import plan_campaign
from bench.experiments.studies.study import Count, StudyWorkers, UnitOptions, Words, ask_each, format_estimate
from bench.io.config import read_profile
from bench.io.config.library import find_datasheet
from bench.io.config.toml_file import read_toml

STUDY = 3, "sensitivity"
QUESTION = "How much does one value of a profile matter?"

_SHOWN = ("pos_rmse_h_m", "pos_rmse_d_m", "vel_rmse_3d_mps", "tilt_rmse_deg", "heading_rmse_deg")


_TOLD = ("pos_rmse_h_m", "heading_rmse_deg")
_ERROR = 0.05  # probability of a wrong word about the best and the worst value, over all looks
_FACTORS = (0.25, 0.5, 1.0, 2.0, 4.0)
"""Of the value of its own, unless others are given."""


class Options(UnitOptions):
    """Options of the study."""

    key: str
    values: Words | None = None
    """values of KEY; default: a quarter to four times the value of the profile"""
    estimators: Words | None = None
    """filters to evaluate; default: all of the profile"""
    runs: Count = 12
    """initial number of runs of each value"""
    max_runs: Count = 24
    """largest number of runs, if two values cannot be separated"""


@dataclass(frozen=True)
class Swept:
    """One filter at one value: the metrics of its runs in order."""

    value: Any
    runs: tuple[Mapping[str, Any], ...]

    @property
    def lost(self) -> int:
        """Runs that did not converge."""
        return sum(not row["converged"] for row in self.runs)

    def select(self, name: str) -> dict[int, float]:
        """Return a metric of the runs that converged, by their number."""
        return {row["run"]: row[name] for row in self.runs if row["converged"] and row.get(name) is not None}

    def pool(self, name: str) -> Estimate | None:
        """Return the RMS of a metric over the converged runs; None for fewer than two runs."""
        known = np.array(list(self.select(name).values()))
        return pool_rmse(np.square(known)) if len(known) > 1 else None


def run(options: Options, work: StudyWorkers) -> Findings:
    """Return the errors of each filter for each value."""
    return ask_each("sensitivity", options, work, lambda one: plan_campaign(_plan(one, 1)), ask_profile)


def ask_profile(options: Options, work: StudyWorkers) -> Findings:
    """Return the errors for each value on one profile, with as many runs as the extreme values need."""
    values = find_values(options)
    looks = len(Looks(options.runs, options.max_runs).numbers)
    rows: list[Mapping[str, Any]] = []
    runs, first = options.runs, 0
    while True:
        title = f"{options.key} of {options.profile}"
        rows += work.campaign(title, _plan(options, runs), first).runs.to_pylist()
        swept = {
            label: tuple(
                Swept(value, tuple(row for row in rows if (row["estimator"], row["condition"]) == (label, k)))
                for k, value in enumerate(values)
            )
            for label in dict.fromkeys(row["estimator"] for row in rows)
        }
        pairs = {
            (label, name): compare_ends(one, name, _ERROR / looks)
            for label, one in swept.items()
            for name in _TOLD
        }
        if runs >= options.max_runs or not any(pair and pair.deciding for pair in pairs.values()):
            break
        first, runs = runs, min(2 * runs, options.max_runs)
    return Findings(
        verdicts=tuple(_tell(options, swept, pairs)),
        tables=(tabulate_sweep(options, swept),),
        figures=tuple(_plot(options, swept)),
        runs=runs,
        good=not any(one.lost for every in swept.values() for one in every),
    )


def _plan(options: Options, runs: int) -> CampaignSpec:
    """Return the campaign of every filter and value."""
    return CampaignSpec(
        name="sensitivity",
        profiles=(options.profile,),
        runs=runs,
        seed=options.seed,
        estimators=options.estimators,
        fixed=options.settings,
        varied=tuple({options.key: value} for value in find_values(options)),
    )


def compare_ends(swept: Sequence[Swept], name: str, error: float) -> PairedRatio | None:
    """Compare the best and the worst value by a metric on the runs that both have; None without a pair.

    They are chosen of all pairs by these runs, so each pair has its part of the ``error`` (Bonferroni).
    """
    known = [(found.value, k) for k, one in enumerate(swept) if (found := one.pool(name)) is not None]
    if len(known) < 2:
        return None
    best, worst = (swept[end(known)[1]] for end in (min, max))
    first, second = best.select(name), worst.select(name)
    both = sorted(first.keys() & second.keys())
    if len(both) < 2 or best is worst:
        return None
    return compare_draws_of(
        (str(best.value), str(worst.value)),
        np.array([first[run] for run in both]),
        np.array([second[run] for run in both]),
        error / math.comb(len(known), 2),
    )


def find_values(options: Options) -> list[Any]:
    """Return the values to sweep; ConfigError if none are given and the key has no number of its own."""
    if options.values is not None:
        return [_read(text) for text in options.values]
    own: Any = read_profile(options.profile, options.settings).document
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


def tabulate_sweep(options: Options, swept: Mapping[str, Sequence[Swept]]) -> FindingTable:
    """Return the metrics of each filter at each value."""
    rows = []
    for label, every in swept.items():
        for one in every:
            for name in _SHOWN:
                found = one.pool(name)
                measured = (found.value, found.low, found.high) if found else (None, None, None)
                rows.append((label, one.value, name, *measured, len(one.runs), one.lost))
    columns = ("estimator", options.key.rpartition(".")[2], "metric", "value", "low", "high", "runs", "lost")
    title = f"{options.profile}, {options.key}: pooled over the runs that converged, 95 % intervals"
    return make_table("sensitivity", title, columns, rows)


def _tell(
    options: Options,
    swept: Mapping[str, Sequence[Swept]],
    pairs: Mapping[tuple[str, str], PairedRatio | None],
) -> Iterator[str]:
    unit = unit_of(options.key)
    for label, every in swept.items():
        for name in _TOLD:
            pair = pairs[label, name]
            if pair is None:
                continue
            known = {str(one.value): found for one in every if (found := one.pool(name)) is not None}
            low, high = (
                f"{format_estimate(known[end])} at {end} {unit}".rstrip() for end in (pair.first, pair.second)
            )
            yield f"{label}: {name} from {low} to {high}; on the same runs {pair.sentence}."
        lost = [
            f"{' '.join(f'{one.value} {unit}'.split())}: {one.lost} of {len(one.runs)}"
            for one in every
            if one.lost
        ]
        if lost:
            yield f"{label} lost runs at {', '.join(lost)}: they are in no figure."


def _plot(options: Options, swept: Mapping[str, Sequence[Swept]]) -> Iterator[Plot]:
    """Yield a plot of each error over the value, or over its index if the value is no number."""
    values = [one.value for one in next(iter(swept.values()))]
    numbers = all(isinstance(value, int | float) and not isinstance(value, bool) for value in values)
    x = np.array(values if numbers else range(1, len(values) + 1), float)
    over = options.key if numbers else f"number of the value of {options.key}"
    order = np.argsort(x)
    colors = series.estimator_colors(swept)
    for name in _SHOWN:
        lines = []
        for label, every in swept.items():
            rows = [
                (found.value, found.low, found.high) if (found := one.pool(name)) else (np.nan,) * 3
                for one in every
            ]
            if np.isfinite(rows).any():
                color = colors[label]
                y = np.array(rows)[order]
                lines.append(
                    Series(label, x[order], y, (label,) * 3, (color,) * 3, (1.5, 1.0, 1.0), band=(1, 2))
                )
        if lines:
            known = find_metric(name)
            across = (unit_of(options.key) if numbers else "") or "1"
            title = f"{name} [{known.unit if known else ''}]"
            yield Plot(("sensitivity", name), title, tuple(lines), across=across, over=over, log="y")
