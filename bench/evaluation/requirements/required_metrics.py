"""Requirements on a filter, and whether one run, or many runs, meet them.

A requirement is a row ``[[requirement]]`` of a profile or a log. One run meets it if its metric does; a run
that did not converge, or has no such metric, does not. Of many runs, at least the fraction ``share`` must
meet it: :class:`ShareTest` decides.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from bench.core.records.findings import FindingTable, make_table
from bench.core.records.findings.looks import find_look
from bench.core.words.notebook import ShownText
from bench.core.words.wording import format_number
from bench.evaluation.metrics.run_metrics import find_metric
from bench.evaluation.requirements.share_test import MET, MISSED, UNDECIDED, ShareTest

EVERY = "*"
"""In the name of a metric: every outage or fault, the worst of them."""

Values = Mapping[str, Any]


@dataclass(frozen=True, slots=True)
class Finding:
    """Verdict on one requirement of a filter."""

    label: str
    metric: str
    word: str  # MET, MISSED or UNDECIDED
    sentence: str
    id: str = ""  # of the requirement, as its owner numbers it
    text: str = ""  # of the requirement, as its owner words it


@dataclass(frozen=True, slots=True)
class Looks:
    """Numbers of runs at which a verdict is computed: ``first``, doubled up to ``most``."""

    first: int
    most: int

    @property
    def numbers(self) -> list[int]:
        """Return the number of runs at each look."""
        found = [self.first]
        while found[-1] < self.most:
            found.append(min(2 * found[-1], self.most))
        return found


def is_metric(name: str) -> bool:
    """Return whether a requirement may name this metric; :data:`EVERY` may replace a number."""
    return find_metric(name.replace(EVERY, "1")) is not None


def list_requirements(document: Mapping[str, Any], label: str) -> list[Mapping[str, Any]]:
    """Return the requirements that a profile or log as flown has for a filter."""
    return [row for row in document.get("requirement", ()) if row.get("estimator", label) == label]


def judge_run(label: str, values: Values, rows: Sequence[Mapping[str, Any]]) -> list[Finding]:
    """Return whether one run meets each requirement.

    Parameters
    ----------
    label : str
        Of the estimator.
    values : mapping
        Its metrics.
    rows : sequence of mapping
        Of :func:`list_requirements`.
    """
    found = []
    for row in rows:
        word = MET if _keeps(row, values) else MISSED
        value = take_value(row, values)
        shown = "has no value" if value is None else f"is {_show(row, value)}"
        if not values.get("converged", True):
            shown += " in a run that did not converge"
        text = f"{label}: {row['metric']} {shown}, {describe_limit(row)} is required: {word}."
        found.append(_find(label, row, word, text))
    return found


def judge_result(document: Mapping[str, Any], metrics: Mapping[str, Values]) -> list[Finding]:
    """Return whether one run meets the requirements of its profile or log on each filter."""
    every = ((label, values, list_requirements(document, label)) for label, values in metrics.items())
    return [one for label, values, rows in every for one in judge_run(label, values, rows)]


def judge_runs(
    label: str, runs: Sequence[Values], rows: Sequence[Mapping[str, Any]], *, sequential: bool = False
) -> list[Finding]:
    """Return whether enough of the runs meet each requirement; parameters as for :func:`judge_run`.

    ``sequential``: runs are added until it is decided, whatever ``plan`` the row has.
    """
    found = []
    for row in rows if runs else ():
        kept, test = [_keeps(row, values) for values in runs], ShareTest.from_row(row, sequential)
        word, after = test.decide(kept)
        count, n, share = sum(kept[:after]), after, f"{100 * test.share:g} % are required: {word}"
        text = f"{label}: {row['metric']} is {describe_limit(row)} in {count} of {n} runs"
        if not test.sequential:
            held = test.bound(count, n)
            text += f", {100 * held.low:.3g} to {100 * held.high:.3g} % of all"
        text += f", {share}"
        if word == UNDECIDED:
            text += f"; {_advise(test, n)}"
        found.append(_find(label, row, word, f"{text}."))
    return found


def _advise(test: ShareTest, n: int) -> str:
    """Return the number of runs that would decide, in words."""
    needed, percent = test.count_runs(), f"{100 * test.expected:.4g} %"
    if needed is None:
        return f"no number of runs would show it if {percent} of all runs meet it"
    if needed <= n:
        return f"fewer runs meet it than the {percent} expected: more than {needed} runs are needed"
    chance = 100 * (1.0 - test.beta)
    return f"{needed} runs would show it in {chance:g} % of cases if {percent} of all runs meet it"


def _find(label: str, row: Mapping[str, Any], word: str, sentence: str) -> Finding:
    return Finding(label, row["metric"], word, sentence, row.get("id") or "", row.get("text") or "")


def trace(findings: Sequence[Finding]) -> FindingTable:
    """Return the trace matrix of requirements: a row for each of a filter, with its verdict."""
    names = ("id", "requirement", "filter", "verdict", "in words")
    rows = []
    for one in findings:
        word = ShownText(one.word, find_look(one.word).kind)
        rows.append((one.id, one.text or one.metric, one.label, word, one.sentence))
    return make_table("requirements", "Requirements", names, rows)


def take_value(row: Mapping[str, Any], values: Values) -> float | None:
    """Return the worst value of the metrics of a row; None if one is missing."""
    pattern = re.escape(row["metric"]).replace(re.escape(EVERY), r"\d+")
    found = [value for name, value in values.items() if re.fullmatch(pattern, name)]
    if not found or not all(isinstance(value, int | float) and math.isfinite(value) for value in found):
        return None
    return float(max(found) if "most" in row else min(found))


def _keeps(row: Mapping[str, Any], values: Values) -> bool:
    value = take_value(row, values)
    if value is None or not values.get("converged", True):
        return False
    return bool(value <= row.get("most", math.inf) and value >= row.get("least", -math.inf))


def describe_limit(row: Mapping[str, Any]) -> str:
    """Return the limit of a requirement in words, as "at most 12 m"."""
    word = "most" if "most" in row else "least"
    return f"at {word} {_show(row, float(row[word]))}"


def _show(row: Mapping[str, Any], value: float) -> str:
    metric = find_metric(row["metric"].replace(EVERY, "1"))
    unit = "" if metric is None or metric.unit == "1" else f" {metric.unit}"
    return f"{format_number(value)}{unit}"
