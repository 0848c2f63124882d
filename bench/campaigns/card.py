"""The card of an estimator: a fixed suite of flights, and what it says beside a built-in filter."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from bench import store
from bench.campaigns.plan import Plan, plan_study
from bench.campaigns.running import Progress, run_campaign
from bench.campaigns.study import Study
from bench.evaluation import ensemble, regression
from bench.evaluation.ensemble import Estimate
from bench.evaluation.ensemble_consistency import TOLERATED

SUITE = 1
"""Version of the suite; it changes with any flight, sensor or number of draws in it."""

AGAINST = "loose-full"
"""The filter that others are compared with."""

_PROFILES = (
    "figure-eight-matched",
    "figure-eight",
    "survey",
    "gnss-denied-leg",
    "gnss-faults",
    "high-dynamics",
    "turbulent-loiter",
)
_FULL = Study("card", _PROFILES, runs=40)
_QUICK = Study("card-quick", ("figure-eight-matched", "figure-eight", "gnss-faults"), runs=8)
_LEAST = 2  # draws that have an interval


@dataclass(frozen=True)
class Line:
    """One figure of a card."""

    topic: str  # "accuracy", "heading", "honesty", "outages", "faults" or "convergence"
    profile: str
    value: float
    low: float  # 95 % interval
    high: float
    sentence: str


@dataclass(frozen=True)
class Card:
    """What an estimator achieves in the suite; equal inputs give equal cards."""

    estimator: str
    against: str
    suite: str  # version and extent
    suite_hash: str  # of flights, sensors and draws: only cards with equal hashes compare
    draws: int  # of each profile
    versions: Mapping[str, str]
    lines: tuple[Line, ...]

    @property
    def sentences(self) -> tuple[str, ...]:
        """The lines in words."""
        return tuple(line.sentence for line in self.lines)


def make_card(
    estimator: str,
    *,
    against: str = AGAINST,
    quick: bool = False,
    jobs: int | None = None,
    progress: Callable[[Progress], None] = lambda progress: None,
) -> Card:
    """Judge an estimator over the suite, draw by draw beside another one.

    Parameters
    ----------
    estimator : str
        Built-in name, ``module:Class`` or ``command:./program {sensors} {solution}``.
    against : str
        The one to compare with.
    quick : bool
        Three flights of 8 draws instead of seven of 40.
    jobs, progress
        As for `bench.campaigns.running.run_campaign`.

    Raises
    ------
    bench.errors.ConfigError, bench.errors.EstimatorError
        If an estimator cannot be built.
    """
    study = _QUICK if quick else _FULL
    uses = tuple(dict.fromkeys((estimator, against)))
    plan = plan_study(Study(study.name, study.profiles, study.runs, estimators=uses))
    result = run_campaign(plan, jobs=jobs, progress=progress)
    labels = [choice.label for choice in plan.cells[0].profile.estimators]
    rows = result.runs.to_pylist()
    lines: list[Line] = []
    for profile in study.profiles:
        own, other = (
            [row for row in rows if (row["profile"], row["estimator"]) == (profile, label)]
            for label in (labels[0], labels[-1])
        )
        lines += _judge(profile, own, other if len(labels) > 1 else None, labels)
    return Card(
        estimator=labels[0],
        against=labels[-1],
        suite=f"{SUITE}, {'quick' if quick else 'full'}",
        suite_hash=_hash_suite(plan),
        draws=study.runs,
        versions=store.list_versions(),
        lines=tuple(lines),
    )


def _hash_suite(plan: Plan) -> str:
    """Return a hash of the flights, sensors and draws, whatever the estimators are."""
    parts = [
        [
            {key: value for key, value in cell.profile.document.items() if key != "estimator"},
            store.hash_spec(cell.profile.sensors),
        ]
        for cell in plan.cells
    ]
    text = json.dumps([SUITE, parts, len(plan.runs)], sort_keys=True, default=str)
    return hashlib.sha256(text.encode()).hexdigest()[:16]


def _judge(
    profile: str,
    own: Sequence[Mapping[str, Any]],
    other: Sequence[Mapping[str, Any]] | None,
    labels: Sequence[str],
) -> list[Line]:
    """Return the lines of one profile from the rows of both estimators, of the same draws in order."""
    good = [row for row in own if row["converged"]]
    rate = ensemble.estimate_rate(len(good), len(own))
    text = f"converged in {len(good)} of {len(own)} draws"
    lines = [Line("convergence", profile, rate.value, rate.low, rate.high, f"{profile}: {text}.")]
    if other is not None:
        pairs = [(a, b) for a, b in zip(own, other, strict=True) if a["converged"] and b["converged"]]
        for topic, title, names in (
            ("accuracy", "horizontal error", ["pos_rmse_h_m"]),
            ("heading", "heading error", ["heading_rmse_deg"]),
            ("outages", "growth of the error in outages", _find_names(own, "outage_", "_growth_h_m")),
            ("faults", "largest error during faults", _find_names(own, "fault_", "_max_h_m")),
        ):
            ratio = _compare(pairs, names)
            if ratio is not None:
                sentence = f"{profile}: {title} {_format(ratio)} times that of {labels[-1]}."
                lines.append(Line(topic, profile, ratio.value, ratio.low, ratio.high, sentence))
    lines += _judge_honesty(profile, good)
    noticed = [
        row[name] for row in own for name in _find_names(own, "fault_", "_detected") if row[name] is not None
    ]
    if noticed:
        found = ensemble.estimate_rate(int(sum(noticed)), len(noticed))
        sentence = f"{profile}: noticed {int(sum(noticed))} of {len(noticed)} faults."
        lines.append(Line("faults", profile, found.value, found.low, found.high, sentence))
    return lines


def _judge_honesty(profile: str, good: Sequence[Mapping[str, Any]]) -> list[Line]:
    """Return the ratio of NEES to its expectation; none without a covariance."""
    nees = [row.get("nees_mean") for row in good]
    if len(good) < _LEAST or None in nees:
        return []
    root = ensemble.pool_rmse(np.array(nees, float) / float(good[0]["nees_states"]))
    ratio = Estimate(root.value**2, root.low**2, root.high**2)
    least, most = TOLERATED
    if ratio.low > most:
        word = "overconfident"
    elif ratio.high < least:
        word = "underconfident"
    else:
        word = "consistent" if least <= ratio.low and ratio.high <= most else "not proven honest or dishonest"
    sentence = f"{profile}: NEES is {_format(ratio)} times its expectation: {word}."
    return [Line("honesty", profile, ratio.value, ratio.low, ratio.high, sentence)]


def _find_names(rows: Sequence[Mapping[str, Any]], start: str, end: str) -> list[str]:
    """Return the metrics between these ends that any row has."""
    names = dict.fromkeys(name for row in rows for name, value in row.items() if value is not None)
    return [name for name in names if name.startswith(start) and name.endswith(end)]


def _compare(
    pairs: Sequence[tuple[Mapping[str, Any], Mapping[str, Any]]], names: Sequence[str]
) -> Estimate | None:
    """Return the ratio of the pooled root mean squares of two estimators on the same draws."""
    values = [
        [np.mean([row[name] ** 2 for name in names]) for row in pair]
        for pair in pairs
        if names and all(row.get(name) is not None for row in pair for name in names)
    ]
    if len(values) < _LEAST:
        return None
    own, other = np.array(values, float).T
    change = regression.estimate_change(other, own, lambda mean: 0.5 * np.log(mean), paired=True)
    low, high = change.interval(1.0 - ensemble.CONFIDENCE)
    return Estimate(*np.exp([change.estimate, low, high]).tolist())


def _format(ratio: Estimate) -> str:
    return f"{ratio.value:.3g} ({ratio.low:.3g} to {ratio.high:.3g})"
