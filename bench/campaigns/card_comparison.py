"""Two cards of the same suite: where one filter is better, draw by draw."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from bench.campaigns.card import COUNT, Card, Line, compare_rms, write_figure
from bench.errors import ConfigError
from bench.evaluation import ensemble, regression

_SAME = 1e-6  # relative difference of a value that is the same, on another processor for example


@dataclass(frozen=True)
class ComparedLine:
    """A figure of two cards."""

    topic: str
    flight: str
    figure: str
    values: tuple[float | None, float | None]  # as they stand on the cards
    sentence: str


def compare_cards(first: Card, second: Card, names: tuple[str, str] | None = None) -> list[ComparedLine]:
    """Compare the figures that both cards have, on the same noise.

    Parameters
    ----------
    first, second : Card
        As `bench.make_card` or `bench.read_card` returns them.
    names : (str, str) or None
        What the sentences call them; None takes the names of the estimators.

    Raises
    ------
    ConfigError
        If they are not of the same suite.
    """
    names = names or name_cards((first, second), ("the first", "the second"))
    if (first.suite, first.suite_hash) != (second.suite, second.suite_hash):
        raise ConfigError(
            f"the cards are not of the same suite: {names[0]} has {first.suite}, {first.suite_hash}; "
            f"{names[1]} has {second.suite}, {second.suite_hash}"
        )
    found, same = [], 0
    others = {(line.topic, line.flight, line.figure): line for line in second.lines}
    for line in first.lines:
        other = others.get((line.topic, line.flight, line.figure))
        if other is None or line.topic == "robustness":  # its error is compared as accuracy
            continue
        if _are_same(line, other):
            same += 1
        elif text := _compare_lines(names, line, other):
            sentence = f"{line.flight}: {text}."
            found.append(
                ComparedLine(line.topic, line.flight, line.figure, (line.value, other.value), sentence)
            )
    if same:
        sentence = f"{same} figures are the same in every draw."
        found.append(ComparedLine("same", "all flights", "figures", (None, None), sentence))
    if first.speed and second.speed:
        a, b = first.speed.value, second.speed.value
        if a and b:
            sentence = f"speed: {names[0]} takes {write_figure(a / b)} times the CPU of {names[1]}."
            found.append(ComparedLine("speed", "all flights", first.speed.figure, (a, b), sentence))
    return found


def list_differences(first: Card, second: Card) -> list[str]:
    """Return what differs besides the filters: versions of bench and its libraries."""
    names = dict.fromkeys([*first.versions, *second.versions])
    return [
        f"{name} {first.versions.get(name, '-')} and {second.versions.get(name, '-')}"
        for name in names
        if first.versions.get(name) != second.versions.get(name)
    ]


def _are_same(one: Line, other: Line) -> bool:
    """Tell whether every draw has the same value, but for the processor."""
    a, b = (np.array(line.by_draw, float) for line in (one, other))  # None: NaN
    return a.shape == b.shape and bool(np.isclose(a, b, rtol=_SAME, atol=0.0, equal_nan=True).all())


def _compare_lines(names: tuple[str, str], one: Line, other: Line) -> str | None:
    if one.topic == "honesty":
        return _compare_honesty(names, one, other)
    if one.figure.startswith("median"):
        texts = ("never" if line.value is None else f"{line.value:.3g} s" for line in (one, other))
        return "heading found after {} and {}".format(*texts)
    if one.word == COUNT:
        counts = (f"{sum(value or 0.0 for value in line.by_draw):.0f}" for line in (one, other))
        return f"{one.figure}: {' and '.join(counts)} of {len(one.by_draw)}"
    ratio = compare_rms(one.by_draw, other.by_draw)
    if ratio is None:
        return None
    text = f"{one.figure} of {names[0]} {write_figure(ratio.value)} times that of {names[1]}"
    better = names[0] if ratio.high < 1.0 else names[1] if ratio.low > 1.0 else None
    word = "not proven to differ" if better is None else f"{better} is better"
    return f"{text} ({write_figure(ratio.low)} to {write_figure(ratio.high)}): {word}"


def _compare_honesty(names: tuple[str, str], one: Line, other: Line) -> str | None:
    """Compare the factors between mean NEES and its expectation."""
    pairs = [
        (a, b) for a, b in zip(one.by_draw, other.by_draw, strict=True) if a is not None and b is not None
    ]
    text = f"NEES is {write_figure(one.value)} and {write_figure(other.value)} times its expectation"
    if len(pairs) < 2:
        return text
    a, b = np.array(pairs, float).T
    change = regression.estimate_change(a, b, regression.log_distance_from(1.0), paired=True)
    low, high = change.interval(1.0 - ensemble.CONFIDENCE)
    if low <= 0.0 <= high:
        return f"{text}: neither is proven nearer"
    return f"{text}: {names[0] if low > 0.0 else names[1]} is nearer"


def name_cards(cards: Sequence[Card], paths: Sequence[str]) -> tuple[str, str]:
    """Return names for two cards: their estimators, or their files if those are the same."""
    first, second = (card.estimator for card in cards)
    return (first, second) if first != second else (paths[0], paths[1])
