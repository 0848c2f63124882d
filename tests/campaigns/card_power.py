"""Print how often cards hold a false word, find a loss, and hold the truth in an interval: the guide's table.

``python -m tests.campaigns.card_power`` takes 15 s of CPU. ``--trials`` is the number of simulated pairs:
five quantities on seven flights of 8 runs, log-normal, with the scatter between the runs of two filters.
"""

import argparse

import numpy as np

import bench
from bench.experiments.card.card_lines import Line, compare_rms
from bench.experiments.card.card_making import Card

TOPICS, FLIGHTS, DRAWS = ("accuracy", "heading", "outages", "faults", "honesty"), 7, 8


def make_card(rng: np.random.Generator, scatter: float, factor: float) -> Card:
    """A card with figures around a factor."""
    lines = [
        Line(
            topic=topic, flight=f"flight {k}", figure=topic, value=1.0, low=None, high=None, sentence="",
            by_draw=tuple(factor * np.exp(scatter * rng.normal(size=DRAWS))),
        )
        for topic in TOPICS
        for k in range(FLIGHTS)
    ]  # fmt: skip
    return Card(
        estimator="x", against="y", suite="s", suite_hash="0", draws=DRAWS, versions={},
        lines=tuple(lines), speed=None,
    )  # fmt: skip


def count_words(rng: np.random.Generator, trials: int, scatter: float, factor: float) -> tuple[int, int]:
    """Return how many comparisons call any filter better, and how many the first, better by a factor."""
    said = []
    for _ in range(trials):
        pair = (make_card(rng, scatter / 2**0.5, one) for one in (1.0, factor))
        said.append([line.better for line in bench.compare_cards(*pair, names=("a", "b"))])
    return sum(any(words) for words in said), sum("a" in words for words in said)


def count_inside(rng: np.random.Generator, trials: int, spread: float, scatter: float) -> int:
    """Return how many intervals of a ratio of two equal filters hold 1; runs differ by a spread."""
    inside = 0
    for _ in range(trials):
        base = np.exp(rng.normal(0.0, spread, DRAWS))
        pair = (base * np.exp(rng.normal(0.0, scatter / 2**0.5, DRAWS)) for _ in range(2))
        found = compare_rms(*(one.tolist() for one in pair))
        inside += found is not None and found.low <= 1.0 <= found.high
    return inside


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--trials", type=int, default=300)
    trials = parser.parse_args().trials
    rng = np.random.default_rng(31)
    for scatter in (0.05, 0.2):
        false, _ = count_words(rng, trials, scatter, 1.0)
        print(f"equal filters, {scatter:.0%} scatter: a false word in {false} of {trials} comparisons")
    for factor in (1.05, 1.1, 1.2):
        _, found = count_words(rng, trials, 0.2, factor)
        print(f"{factor - 1:.0%} worse everywhere, 20 % scatter: found in {found} of {trials}")
    for spread, scatter in ((0.3, 0.05), (0.6, 0.5)):
        inside = count_inside(rng, 5 * trials, spread, scatter)
        print(f"95 % interval of a ratio, 8 runs, {scatter:.0%} scatter: right in {inside / 5 / trials:.1%}")


if __name__ == "__main__":
    main()
