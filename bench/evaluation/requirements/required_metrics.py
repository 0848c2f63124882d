"""Requirements on a filter, and whether one run, or many runs, meet them.

A requirement is a row ``[[requirement]]`` of a profile or a log. One run meets it if its metric does; a run
that did not converge, or has no such metric, does not. Of many runs, at least the fraction ``share`` must
meet it: the verdict is met or missed if the 95 % bound on this fraction decides it (Clopper and Pearson, one
side), else more runs are needed.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

from bench.core.words.wording import format_number
from bench.evaluation.ensembles.ensemble import Estimate, estimate_rate
from bench.evaluation.metrics.run_metrics import find_metric

MET, MISSED, UNDECIDED = "met", "missed", "undecided"
EVERY = "*"
"""In the name of a metric: every outage or fault, the worst of them."""

_ERROR = 0.05  # of the bound at each end
_MOST_RUNS = 100_000  # that are thought of

Values = Mapping[str, Any]


@dataclass(frozen=True, slots=True)
class Finding:
    """Verdict on one requirement of a filter."""

    label: str
    metric: str
    word: str  # MET, MISSED or UNDECIDED
    sentence: str


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


def count_meeting_runs(share: float) -> int:
    """Return the smallest number of runs that proves a required fraction if all runs meet the requirement.

    Examples
    --------
    >>> count_meeting_runs(0.95), count_meeting_runs(0.5)
    (59, 5)
    """
    return math.ceil(math.log(_ERROR) / math.log(share))


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
        found.append(Finding(label, row["metric"], word, text))
    return found


def judge_result(document: Mapping[str, Any], metrics: Mapping[str, Values]) -> list[Finding]:
    """Return whether one run meets the requirements of its profile or log on each filter."""
    every = ((label, values, list_requirements(document, label)) for label, values in metrics.items())
    return [one for label, values, rows in every for one in judge_run(label, values, rows)]


def judge_runs(
    label: str, runs: Sequence[Values], rows: Sequence[Mapping[str, Any]], looks: Looks | None = None
) -> list[Finding]:
    """Return whether enough of the runs meet each requirement; parameters as for :func:`judge_run`.

    Runs that are looked at several times, while more are added until it is decided, have ``looks``.
    """
    found = []
    for row in rows if runs else ():
        count, n, share = sum(_keeps(row, values) for values in runs), len(runs), float(row["share"])
        held = _bound(count, n, share, looks)
        word = decide(count, n, share, looks)
        text = (
            f"{label}: {row['metric']} is {describe_limit(row)} in {count} of {n} runs, "
            f"{100 * held.low:.3g} to {100 * held.high:.3g} % of all, {100 * share:g} % are required: {word}"
        )
        if word == UNDECIDED:
            needed = count_deciding_runs(count, n, share, looks)
            text += "; no number of runs decides it" if needed is None else f"; {needed} runs would decide it"
        found.append(Finding(label, row["metric"], word, f"{text}."))
    return found


def _bound(count: int, n: int, share: float, looks: Looks | None) -> Estimate:
    """Return a fraction with its bounds; the looks that can decide share the error probability equally.

    With fewer runs than show the share if all keep it the word cannot be `MET`, nor `MISSED` with fewer than
    show that it is missed if none does: such a look takes no part.
    """
    numbers = [n] if looks is None else looks.numbers
    low, high = (
        estimate_rate(count, n, 1.0 - 2.0 * _ERROR / max(1, sum(one >= least for one in numbers)))
        for least in (count_meeting_runs(share), count_meeting_runs(1.0 - share))
    )
    return Estimate(low.value, low.low, high.high)


def decide(count: int, n: int, share: float, looks: Looks | None = None) -> str:
    """Return the verdict on a required fraction if ``count`` of n runs meet it, at one of several looks.

    Examples
    --------
    >>> decide(58, 58, 0.95), decide(59, 59, 0.95), decide(50, 59, 0.95)
    ('undecided', 'met', 'missed')
    """
    held = _bound(count, n, share, looks)
    return MET if held.low >= share else MISSED if held.high < share else UNDECIDED


def count_deciding_runs(count: int, n: int, share: float, looks: Looks | None = None) -> int | None:
    """Return the number of runs that would decide if the fraction stays the same; None for more than 100,000.

    With ``looks`` so many are the most: what is looked at more often needs more.

    Examples
    --------
    >>> count_deciding_runs(8, 8, 0.95)
    59
    """
    more = n + 1
    while more <= _MOST_RUNS:
        most = looks and replace(looks, most=more)
        if decide(round(count / n * more), more, share, most) != UNDECIDED:
            return more
        more += max(1, more // 200)
    return None


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
