"""Comparison of two cards of the same suite, run by run."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from bench.core.mathematics.arrays import FloatArray
from bench.core.words.exceptions import ConfigError
from bench.evaluation.ensembles import ensemble
from bench.evaluation.ensembles.ensemble import qualify
from bench.evaluation.ensembles.regression import Change, average_changes, decide
from bench.experiments.card.card_lines import CONVENTIONS, COUNT, SAME, SHARE, Line, write_figure
from bench.experiments.card.card_making import Card

_ERROR = 1.0 - ensemble.CONFIDENCE  # probability of any false word over the quantities
_POWER = 0.8


@dataclass(frozen=True)
class ComparedLine:
    """A score of two cards."""

    topic: str
    flight: str
    figure: str
    values: tuple[float | None, float | None]  # as they stand on the cards
    sentence: str
    better: str | None = None  # the filter that is proven better, as the sentence calls it


def compare_cards(first: Card, second: Card, names: tuple[str, str] | None = None) -> list[ComparedLine]:
    """Compare the values that two cards have in common, on the same noise.

    Parameters
    ----------
    first, second : Card
        Cards of the same suite, from `bench.make_card` or `bench.read_card`.
    names : (str, str), optional
        Names of the filters in the sentences. Default: the names on the cards.

    Returns
    -------
    list of ComparedLine
        Topic, flight, value on both cards, ``sentence``, and ``better``: the filter that is proven better.

    Raises
    ------
    bench.ConfigError
        If the cards are from different suites.

    Examples
    --------
    >>> import bench
    >>> lines = bench.compare_cards(bench.read_card("a.json"), bench.read_card("b.json"))  # doctest: +SKIP
    >>> [line.sentence for line in lines if line.better]  # doctest: +SKIP
    """
    names = names or name_cards((first, second), ("the first", "the second"))
    if (first.suite, first.suite_hash) != (second.suite, second.suite_hash):
        raise ConfigError(
            f"the cards are from different suites: {names[0]} has {first.suite}, {first.suite_hash}; "
            f"{names[1]} has {second.suite}, {second.suite_hash}"
        )
    found: list[ComparedLine] = []
    same = 0
    quantities: dict[tuple[str, str], list[_Pair]] = {}
    others = {(line.topic, line.flight, line.figure): line for line in second.lines}
    for line in first.lines:
        other = others.get((line.topic, line.flight, line.figure))
        if other is None or line.topic in ("robustness", "requirements", CONVENTIONS):
            continue
        if are_same(line, other):
            same += 1
        elif text := tell_values(line, other):
            sentence = f"{line.flight}: {text}."
            found.append(
                ComparedLine(line.topic, line.flight, line.figure, (line.value, other.value), sentence)
            )
        elif (changes := list_changes(line, other)) is not None:
            quantities.setdefault((line.topic, line.figure), []).append((line, other, changes))
    found = judge_quantities(names, list(quantities.values())) + found
    if same:
        sentence = f"{same} figures are the same in every run."
        found.append(ComparedLine("same", "all flights", "figures", (None, None), sentence))
    if first.speed and second.speed:
        a, b = first.speed.value, second.speed.value
        if a and b:
            sentence = f"speed: {names[0]} takes {write_figure(a / b)} times the CPU of {names[1]}."
            found.append(ComparedLine("speed", "all flights", first.speed.figure, (a, b), sentence))
    return found


def list_differences(first: Card, second: Card) -> list[str]:
    """Return the differences besides the filters: versions of bench and its libraries."""
    names = dict.fromkeys([*first.versions, *second.versions])
    return [
        f"{name} {first.versions.get(name, '-')} and {second.versions.get(name, '-')}"
        for name in names
        if first.versions.get(name) != second.versions.get(name)
    ]


def are_same(one: Line, other: Line) -> bool:
    """Return whether every run has the same value, apart from rounding on another processor."""
    a, b = (np.array(line.by_draw or (line.value,), float) for line in (one, other))  # None: NaN
    return a.shape == b.shape and bool(np.isclose(a, b, rtol=SAME, atol=0.0, equal_nan=True).all())


def tell_values(one: Line, other: Line) -> str | None:
    """Return the values of a score that is not tested."""
    if one.figure.startswith("median"):
        texts = ("never" if line.value is None else f"{line.value:.3g} s" for line in (one, other))
        return "heading found after {} and {}".format(*texts)
    if one.topic == "coverage" and one.figure != SHARE:
        waited = ("never" if line.value is None else f"{line.value:.3g} s" for line in (one, other))
        return "first answer after {} and {}".format(*waited)
    if one.topic == "coverage":
        shares = (f"{100.0 * (line.value or 0.0):.4g}" for line in (one, other))
        return "answers at {} and {} % of the epochs".format(*shares)
    if one.topic == "causality":
        ahead = ("not proven" if line.value is None else f"{line.value:.3g} s" for line in (one, other))
        return "look-ahead: {} and {}".format(*ahead)
    if one.word == COUNT:
        counts = (f"{sum(value or 0.0 for value in line.by_draw):.0f}" for line in (one, other))
        return f"{one.figure}: {' and '.join(counts)} of {len(one.by_draw)}"
    return None


_Pair = tuple[Line, Line, FloatArray]
"""A figure of a flight on two cards, and by draw the log of how much larger the first is; NaN: unknown."""


def list_changes(one: Line, other: Line) -> FloatArray | None:
    """Return the log ratio of the first to the second card by run; None if fewer than two runs have both.

    Of NEES it is that of the factors between each run and its expectation. The factor of a mean over runs
    has no derivative where it is right, and a jackknife of it reports too much for two consistent filters.
    """
    a, b = (np.array(line.by_draw, float) for line in (one, other))
    known = np.isfinite(a) & np.isfinite(b) & (a > 0.0) & (b > 0.0)
    if known.sum() < 2:
        return None
    changes = np.full(len(a), np.nan)
    logs = np.log(a[known]), np.log(b[known])
    mine, theirs = np.abs(logs) if one.topic == "honesty" else logs
    changes[known] = mine - theirs
    return changes


def pool_flights(changes: FloatArray) -> Change:
    """Return the mean over flights (rows) and runs (columns), by Student over runs.

    The flights of a run may share their noise, so a run counts once. A run that lacks a flight is compared
    with the means of the flights that it has.
    """
    means = np.nanmean(changes, axis=1)
    seen = np.isfinite(changes).any(axis=0)
    by_draw = np.nanmean((changes - means[:, None])[:, seen], axis=0)
    return replace(average_changes(by_draw), estimate=float(means.mean()))


def judge_quantities(names: tuple[str, str], quantities: list[list[_Pair]]) -> list[ComparedLine]:
    """Return the better filter for each quantity over all flights, then for single flights.

    Holm's method over the quantities keeps the probability of any false word. Only the flights of a quantity
    that differs are tested, by Holm within it, on its share of that probability: over all lines at once
    eight runs would prove nothing.
    """
    pooled = [pool_flights(np.array([changes for _, _, changes in pairs])) for pairs in quantities]
    proven, levels = decide(pooled, _ERROR)
    found = []
    for pairs, change, differs, level in zip(quantities, pooled, proven, levels, strict=True):
        one, other, _ = pairs[0]
        lost = _count_lost(pairs)
        if differs and lost[change.estimate > 0.0] > lost[change.estimate <= 0.0]:
            found.append(_tell_lost(names, one, change, lost))
            continue
        if len(pairs) == 1:
            found.append(tell_change(names, one, other, one.flight, change, level, differs))
            continue
        found.append(tell_change(names, one, other, "all flights", change, level, differs))
        flights = [pool_flights(changes[None]) for *_, changes in pairs]
        there, flight_levels = decide(flights, _ERROR / len(quantities))
        for k, (mine, theirs, _) in enumerate(pairs):
            word = bool(there[k]) if differs else None
            by = flight_levels[k] if differs else _ERROR
            found.append(tell_change(names, mine, theirs, mine.flight, flights[k], by, word))
    return found


def _count_lost(pairs: list[_Pair]) -> tuple[int, int]:
    """Return the number of runs that each card lacks but the other card has."""
    lacks = [[np.isnan(np.array(line.by_draw, float)) for line in pair[:2]] for pair in pairs]
    return sum(int((a & ~b).sum()) for a, b in lacks), sum(int((b & ~a).sum()) for a, b in lacks)


def _tell_lost(names: tuple[str, str], one: Line, change: Change, lost: tuple[int, int]) -> ComparedLine:
    """Return the line for a filter that is better only in the common runs, but lost more runs."""
    k = int(change.estimate > 0.0)
    text = (
        f"{names[k]} is better in the runs that both have, but lost {lost[k]} that {names[1 - k]} kept: "
        "not proven to differ"
    )
    text = f"all flights: {one.figure}: {text}."
    return ComparedLine(one.topic, "all flights", one.figure, (None, None), text)


def tell_change(
    names: tuple[str, str],
    one: Line,
    other: Line,
    flight: str,
    change: Change,
    level: float,
    differs: bool | None,
) -> ComparedLine:
    """Return the line of a change; ``differs`` None means that no test is made and no verdict given."""
    low, high = change.interval(level)
    ratio, least, most = (write_figure(float(np.exp(end))) for end in (change.estimate, low, high))
    name = names[0] if change.estimate < 0.0 else names[1]
    if one.topic != "honesty":
        text = f"{one.figure} of {names[0]} {ratio} times that of {names[1]} ({least} to {most}"
        text += f"{qualify(change.draws)})"
    elif flight == "all flights":
        text = (
            f"NEES of {names[0]} in a run off by {ratio} times the factor of {names[1]} ({least} to {most})"
        )
    else:
        text = f"NEES is {write_figure(one.value)} and {write_figure(other.value)} times its expectation"
    better = name if differs else None
    if better is not None:
        text += f": {better} is {'nearer' if one.topic == 'honesty' else 'better'}"
    elif differs is not None:
        text += f": not proven to differ; {find_power(change, level)} would be found in {_POWER:.0%}"
    values = (None, None) if flight == "all flights" else (one.value, other.value)
    return ComparedLine(one.topic, flight, one.figure, values, f"{flight}: {text}.", better)


def find_power(change: Change, level: float) -> str:
    """Return the smallest ratio that these runs distinguish from 1, in words."""
    from scipy.special import stdtrit

    reach = float(stdtrit(change.dof, 1.0 - 0.5 * level) + stdtrit(change.dof, _POWER))
    return f"a ratio of {write_figure(float(np.exp(reach * change.standard_error)))}"


def name_cards(cards: Sequence[Card], paths: Sequence[str]) -> tuple[str, str]:
    """Return names for two cards: their filters, or their files if those are the same."""
    first, second = (card.estimator for card in cards)
    return (first, second) if first != second else (paths[0], paths[1])
