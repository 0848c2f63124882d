"""The lines of a card: the results of a filter in the runs of a flight, a value and a sentence each."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Annotated, Any

import numpy as np
from pydantic import Field
from scipy.special import gammaincinv

from bench.core.words.wording import one_line
from bench.evaluation.ensembles import ensemble
from bench.evaluation.ensembles.ensemble import Estimate, qualify
from bench.evaluation.ensembles.ensemble_consistency import (
    WHOLE,
    estimate_share,
    judge_ratios,
    read_inside,
    read_ratios,
)
from bench.evaluation.ensembles.rare_runs import measure_scatter
from bench.evaluation.ensembles.regression import average_changes
from bench.evaluation.errors.error_series import TITLES
from bench.evaluation.linear.quantities import count_freedom
from bench.experiments.card.card_suite import SuiteFlight
from bench.io.config.tables import ROWS, Table

_LEAST = 2  # runs that have an interval
ERRORS = {
    "accuracy": ("horizontal error", "pos_rmse_h_m", ""),
    "height": ("height error", "pos_rmse_d_m", ""),
    "velocity": ("velocity error", "vel_rmse_3d_mps", ""),
    "tilt": ("tilt", "tilt_rmse_deg", ""),
    "heading": ("heading error", "heading_rmse_deg", ""),
    "outages": ("growth of the error in outages", "outage_", "_growth_h_m"),
    "faults": ("largest error during faults", "fault_", "_max_h_m"),
}
"""Topic -> its figure in words, and how the names of its metrics begin and end."""
_ANSWERED = "availability_"
_UNLIKELY = 1e-5  # that an error is below the bound by chance: one of 1000 cards with 90 such errors
_BELOW = 0.9  # of the bound; nearer to it a filter that is not linear may come
_RIGHT = "heading_right_s_all"

SAME = 1e-6
"""Relative difference of a value that is the same, on another processor for example."""

COUNT = "count"
"""Word of a line that counts."""

SHARE = "least share of epochs"
"""Figure of the line of coverage."""

IMPOSSIBLE = "impossible"
"""Word of an error below the bound."""

CONVENTIONS = "conventions"
"""Topic of the line that says which convention a filter looks like."""

UNPROVEN = "not proven"
"""Word of a filter whose causality cannot be proven: it fails, or does not repeat its answers."""

_PARTS = ("nees_ratio_", "coverage_1sigma_", "coverage_2sigma_", "coverage_3sigma_", "log_score_")

Rows = Sequence[Mapping[str, Any]]
"""Metrics of a filter by draw."""


class Line(Table):
    """One score of a card."""

    topic: str  # "convergence", "coverage", "causality", a key of `ERRORS`, "honesty", "alarms", ... "speed"
    flight: str
    figure: str  # what it is of
    value: float | None  # None: never
    low: float | None  # 95 % interval; None: open to this side
    high: float | None
    sentence: str
    word: str = ""  # of consistency the verdict; COUNT: ``by_draw`` holds 1 where it happened, else 0
    by_draw: Annotated[tuple[float | None, ...], ROWS] = ()  # what the filter achieved itself
    id: str = ""  # of a requirement, as its owner numbers it
    text: str = ""  # of a requirement, as its owner words it
    parts: dict[str, float] = Field(default_factory=dict)  # of consistency: metrics, means over the runs
    over_bound: Annotated[tuple[float, float, float] | None, ROWS] = None  # of an error, with interval


def judge_flight(
    flight: SuiteFlight,
    own: Rows,
    other: Rows,
    label: str,
    without: Rows,
    bound: tuple[Mapping[str, float], str] = ({}, ""),
) -> list[Line]:
    """Return the lines of a flight.

    Parameters
    ----------
    flight : SuiteFlight
        What it is.
    own, other : rows
        Of the filter, and of the one to compare with, whose ``label`` that is; no rows: with none.
    without : rows
        Of the filter on the same flight without what happens in this one; no rows if nothing does.
    bound : (mapping, str)
        What `bench.experiments.card.card_bound.bound_errors_of` returns.
    """
    lines = [judge_coverage(flight, own), judge_start(flight, own), judge_convergence(flight, own)]
    lines += compare_errors(flight, own, other, label, bound)
    lines += judge_honesty(flight, own)
    lines += judge_alarms(flight, own)
    if without:
        lines += judge_robustness(flight, own, without)
    return lines + judge_heading(flight, own)


def judge_convergence(flight: SuiteFlight, own: Rows) -> Line:
    """Return the line of the runs that converged."""
    by_draw = tuple(float(row["converged"]) for row in own)
    rate = ensemble.estimate_rate(int(sum(by_draw)), len(own))
    text = f"converged in {sum(by_draw):.0f} of {len(own)} runs"
    lost = [k for k, good in enumerate(by_draw) if not good]
    if lost:
        text += f"; run {lost[0]}: {one_line(str(own[lost[0]].get('reason')))[:200]}"
    return _make_line("convergence", flight, "runs that converged", rate, text, by_draw, COUNT)


def judge_coverage(flight: SuiteFlight, own: Rows) -> Line:
    """Return the smallest fraction of epochs with a solution in any run, by block, and the missing blocks."""
    shares = {title: [row.get(f"{_ANSWERED}{block}") for row in own] for block, title in TITLES.items()}
    declared = {title: values for title, values in shares.items() if any(v is not None for v in values)}
    least = {title: min(v or 0.0 for v in values) for title, values in declared.items()}
    by_draw = tuple(
        min((values[k] or 0.0 for values in declared.values()), default=0.0) for k in range(len(own))
    )
    if not declared:
        text = "answers nothing"
    elif min(least.values()) == 1.0:
        text = "answers at all epochs"
    else:
        parts = [f"{title} at {100.0 * share:.4g} %" for title, share in least.items()]
        text = f"answers {', '.join(parts)} of the epochs, each in the run with the fewest"
    absent = [title for title in TITLES.values() if title not in declared]
    if absent and declared:
        text += f"; no {', no '.join(absent)}"
    found = Estimate(min(by_draw), min(by_draw), max(by_draw))
    return _make_line("coverage", flight, SHARE, found, text, by_draw)


def judge_start(flight: SuiteFlight, own: Rows) -> Line:
    """Return the longest time to the first solution of any run."""
    by_draw = tuple(row.get("first_answer_s_all") if _answers(row) else None for row in own)
    known = [value for value in by_draw if value is not None]
    longest = max(known) if len(known) == len(own) else None
    text = "never answers in some run" if longest is None else f"first answer after {longest:.3g} s at most"
    return Line(
        topic="coverage", flight=flight.name, figure="longest time to the first answer [s]", value=longest,
        low=min(known, default=None), high=longest, sentence=f"{flight.name}: {text}.", by_draw=by_draw,
    )  # fmt: skip


def _answers(row: Mapping[str, Any]) -> bool:
    return any(row.get(f"{_ANSWERED}{block}_all") is not None for block in TITLES)


def compare_errors(
    flight: SuiteFlight, own: Rows, other: Rows, label: str, bound: tuple[Mapping[str, float], str]
) -> list[Line]:
    """Return errors as ratios to the errors of another filter on the same runs, and to the bound."""
    lines = []
    for topic, (figure, start, end) in ERRORS.items():
        if topic == "faults" and flight.without:
            continue
        names = find_names(own, start, end)
        values = pool_names(own, names)
        ratio = compare_rms(values, pool_names(other, names)) if other else None
        held, word = compare_bound(values, bound[0].get(topic))
        parts = [] if ratio is None else [f"{_format(ratio)} times that of {label}"]
        parts += [] if held is None else [f"{_format(held)} times the bound"]
        if not parts:
            continue
        text = f"{figure} {' and '.join(parts)}"
        both = sum(value is not None for value in values)
        text += "" if both == len(own) else f", in the {both} of {len(own)} runs that converged"
        text += qualify(both)
        if topic == "accuracy" and bound[1]:
            text += f"; {bound[1]}"
        if word:
            text += ": no causal filter can; it has the future, or the truth"
        text += f"; {_scatter(values, pool_names(other, names) if ratio else ())}"
        shown = ratio or held
        assert shown is not None
        line = _make_line(topic, flight, figure, shown, text, values, word)
        over = None if held is None else (held.value, held.low, held.high)
        lines.append(line.model_copy(update={"over_bound": over}))
    return lines


def _scatter(own: Sequence[float | None], other: Sequence[float | None]) -> str:
    """Return the scatter of errors in words, with the median of their ratios to another filter's errors."""
    errors = np.array([value for value in own if value is not None])
    pairs = [a / b for a, b in zip(own, other, strict=False) if a is not None and b]
    return measure_scatter(errors, np.array(pairs) if pairs else None).describe()


def compare_bound(values: Sequence[float | None], bound: float | None) -> tuple[Estimate | None, str]:
    """Return the error over the bound, pooled over the runs, and `IMPOSSIBLE` if it is certainly below.

    Certain is what the spread of the runs allows: the upper end of the mean square of so many independent
    errors as they hold (`count_freedom`). The bound is of all runs: of a filter that has lost some, perhaps
    the worst, nothing is certain.
    """
    squares = np.square([value for value in values if value is not None])
    if not bound or len(squares) < _LEAST or not squares.all():
        return None, ""
    pooled = ensemble.pool_rmse(squares)
    half = 0.5 * count_freedom(squares)
    most = pooled.value * (half / float(gammaincinv(half, _UNLIKELY))) ** 0.5
    whole = len(squares) == len(values)
    word = IMPOSSIBLE if whole and most < bound and pooled.value < _BELOW * bound else ""
    return Estimate(pooled.value / bound, pooled.low / bound, pooled.high / bound), word


def list_values(row: Mapping[str, Any]) -> dict[str, float | None]:
    """Return the values of a run in the lines of a flight, by topic."""
    found = {
        topic: pool_names([row], find_names([row], start, end))[0]
        for topic, (_, start, end) in ERRORS.items()
    }
    return {**found, "honesty": _normalize(row)}


def _normalize(row: Mapping[str, Any]) -> float | None:
    """Return NEES over its expectation; None without NEES, or if the run did not converge."""
    mean = row.get("nees_mean") if row["converged"] else None
    return None if mean is None else float(mean / row["nees_states"])


def judge_honesty(flight: SuiteFlight, own: Rows) -> list[Line]:
    """Return the ratio of NEES to its expectation with the verdict; none without a covariance."""
    by_draw = tuple(map(_normalize, own))
    kept = [row for row, value in zip(own, by_draw, strict=True) if value is not None]
    if len(kept) < _LEAST:
        return []
    whole = np.array([value for value in by_draw if value is not None], float)
    judged = judge_ratios({**read_ratios(kept), WHOLE: whole}, read_inside(kept))
    blocks = [
        f"{title} {write_figure(judged.ratios[b].value)}" for b, title in TITLES.items() if b in judged.ratios
    ]
    text = f"NEES is {_format(judged.ratios[WHOLE])} times its expectation"
    text += f" ({', '.join(blocks)}): {judged.text}" if blocks else f": {judged.text}"
    line = _make_line(
        "honesty", flight, "NEES over its expectation", judged.ratios[WHOLE], text, by_draw, judged.word
    )
    names = {
        name: [row.get(name) for row in kept]
        for name in kept[0]
        if name.startswith(_PARTS) and not name.endswith("_all")
    }
    parts = {name: float(np.mean(np.array(each, float))) for name, each in names.items() if None not in each}
    return [line.model_copy(update={"parts": parts})]


def judge_alarms(flight: SuiteFlight, own: Rows) -> list[Line]:
    """Return the number of detected faults out of the detectable faults, and the number of false alarms."""
    lines = []
    names = [] if flight.without else find_names(own, "fault_", "_detected")
    by_draw = tuple(row[name] for row in own for name in names if row.get(name) is not None)
    if by_draw:
        rate = ensemble.estimate_rate(int(sum(by_draw)), len(by_draw))
        text = f"detected {sum(by_draw):.0f} of {len(by_draw)} faults"
        lines.append(_make_line("faults", flight, "faults detected", rate, text, by_draw, COUNT))
    shares, rates = (
        [row[name] for row in own if row.get(name) is not None]
        for name in ("false_alarm_share", "false_alarm_rate_per_h")
    )
    if len(shares) >= _LEAST and not flight.without:
        share = estimate_share(np.array(shares))
        text = f"in alarm for {_format(share, 100.0)} % of the time outside faults"
        text += f", {np.mean(rates):.3g} false alarms an hour"
        values = tuple(row.get("false_alarm_share") for row in own)
        lines.append(_make_line("alarms", flight, "time in false alarm", share, text, values))
    return lines


def judge_robustness(flight: SuiteFlight, own: Rows, without: Rows) -> list[Line]:
    """Return the ratio of the error to the error in the same runs of the same flight without the event."""
    _, start, end = ERRORS["accuracy"]
    values = [pool_names(rows, find_names(own, start, end)) for rows in (own, without)]
    ratio = compare_rms(*values)
    if ratio is None:
        return []
    text = (
        f"horizontal error {_format(ratio)} times its own on the same flight without them{qualify(len(own))}"
    )
    return [_make_line("robustness", flight, "horizontal error", ratio, text, values[0])]


def judge_heading(flight: SuiteFlight, own: Rows) -> list[Line]:
    """Return the median time until the heading stays correct, on a flight with a wrong initial heading."""
    estimated = any(row.get("heading_rmse_deg") is not None for row in own)
    if "initial_error_sd.heading_deg" not in flight.values or not estimated:
        return []
    by_draw = tuple(row.get(_RIGHT) if row["converged"] else None for row in own)
    times = np.array([np.inf if value is None else value for value in by_draw])
    found = ensemble.estimate_quantile(times, 0.5)
    low, high = (end if end is not None and np.isfinite(end) else None for end in (found.low, found.high))
    if not np.isfinite(found.value):
        text = "most runs never find the heading"
    else:
        text = f"half of the runs have the heading within 3 deg of the truth after {found.value:.3g} s"
        last = "never" if high is None else f"{high:.3g} s"
        text += f" ({'the start' if low is None else f'{low:.3g} s'} to {last})"
    value = found.value if np.isfinite(found.value) else None
    return [
        Line(
            topic="convergence",
            flight=flight.name,
            figure="median time to the heading [s]",
            value=value,
            low=low,
            high=high,
            sentence=f"{flight.name}: {text}.",
            by_draw=by_draw,
        )
    ]


def measure_speed(own: Sequence[float], yardstick: Sequence[float], label: str) -> Line | None:
    """Return the CPU time as a multiple of the CPU time of the yardstick in the same runs."""
    if not own:
        return None
    found = ensemble.estimate_quantile(np.array(own) / np.array(yardstick), 0.5)
    interval = f"{found.low or found.value:.3g} to {found.high or found.value:.3g}"
    return Line(
        topic="speed",
        flight="all flights",
        figure=f"CPU time over that of {label}",
        value=found.value,
        low=found.low,
        high=found.high,
        sentence=f"speed: {found.value:.3g} ({interval}) times the CPU of {label} on the same samples; "
        "measured anew for each card.",
    )


def _make_line(
    topic: str,
    flight: SuiteFlight,
    figure: str,
    found: Estimate,
    text: str,
    by_draw: Sequence[float | None],
    word: str = "",
) -> Line:
    low, high = (end if np.isfinite(end) else None for end in (found.low, found.high))
    return Line(
        topic=topic,
        flight=flight.name,
        figure=figure,
        value=found.value,
        low=low,
        high=high,
        sentence=f"{flight.name}: {text}.",
        word=word,
        by_draw=tuple(by_draw),
    )


def find_names(rows: Rows, start: str, end: str) -> list[str]:
    """Return the names of metrics in any row that begin and end with these texts."""
    names = dict.fromkeys(name for row in rows for name, value in row.items() if value is not None)
    return [
        name for name in names if name == start or (end and name.startswith(start) and name.endswith(end))
    ]


def pool_names(rows: Rows, names: Sequence[str]) -> tuple[float | None, ...]:
    """Return the RMS of some metrics in each run; None if a run has none or did not converge."""
    return tuple(
        float(np.sqrt(np.mean([row[name] ** 2 for name in names])))
        if names and row["converged"] and all(row.get(name) is not None for name in names)
        else None
        for row in rows
    )


def compare_rms(own: Sequence[float | None], other: Sequence[float | None]) -> Estimate | None:
    """Return the ratio of root mean squares, over the runs that have both; None if too few.

    The mean of the log ratios of the runs, by Student's t: its interval holds what it says with eight runs,
    too, where that of a ratio of pooled squares holds 91 to 94 instead of 95 %.
    """
    pairs = [(a, b) for a, b in zip(own, other, strict=True) if a is not None and b is not None]
    if len(pairs) < _LEAST or not np.all(pairs):
        return None
    mine, theirs = np.array(pairs, float).T
    change = average_changes(np.log(mine / theirs))
    low, high = change.interval(1.0 - ensemble.CONFIDENCE)
    return Estimate(*np.exp([change.estimate, low, high]).tolist())


def _format(found: Estimate, scale: float = 1.0) -> str:
    value, low, high = (write_figure(scale * one) for one in (found.value, found.low, found.high))
    return f"{value} ({low} to {high})"


def write_figure(value: float | None) -> str:
    """Return a number with three digits; a dash for None."""
    return "-" if value is None else f"{value:#.3g}".rstrip(".")
