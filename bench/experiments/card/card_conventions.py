"""The line of a card about a mistaken convention that explains an inconsistent filter."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from bench import pipeline
from bench.core.words.exceptions import EstimatorError, EstimatorFailedError
from bench.evaluation.consistency.verdict import BROKEN
from bench.evaluation.conventions.convention_search import find_mistakes
from bench.experiments.campaigns.plan import Plan
from bench.experiments.card.card_lines import CONVENTIONS, Line, Rows
from bench.experiments.card.card_suite import Suite
from bench.navigation.built_in import BUILT_IN

_DRAWS = 3  # that have to share the constants
_MOST_BROKEN = 0.5  # of the runs of a flight


def judge_conventions(plan: Plan, suite: Suite, label: str, own: Sequence[Rows]) -> list[Line]:
    """Return the line with the mistaken convention that fits a filter; no line if none fits.

    Its answers of some runs of a flight on which its covariance is broken are made again and searched
    together, so that one constant has to do for all. A flight is taken on which nothing breaks, if there is
    one.

    Parameters
    ----------
    plan, suite : Plan, Suite
        Of the card.
    label : str
        Of the filter.
    own : sequence of rows
        Its rows of each flight.
    """
    broken = {
        k: [draw for draw, row in enumerate(rows) if row.get("verdict") in BROKEN]
        for k, rows in enumerate(own)
    }
    flights = [k for k, draws in broken.items() if len(draws) > _MOST_BROKEN * len(own[k])]
    if not flights:
        return []
    number = min(flights, key=lambda k: (bool(suite.profile_of(plan, k, 0).sensors.faults), k))
    draws, name = broken[number][:_DRAWS], suite.members[number].name
    profiles = [suite.profile_of(plan, number, draw) for draw in draws]
    (choice,) = (one for one in profiles[0].estimators if one.label == label)
    if choice.use in BUILT_IN:
        return []
    truths = list(map(pipeline.fly, profiles))
    solutions, antenna_b = [], np.zeros(3)
    try:
        for profile, truth in zip(profiles, truths, strict=True):
            sensed = pipeline.sense(profile, truth)
            antenna_b = sensed.data.antenna_b
            solutions.append(pipeline.navigate(choice, sensed.data, sensed.initial))
        found = find_mistakes(truths, solutions, antenna_b, profiles[0].evaluation.begin)
    except (ValueError, EstimatorError, EstimatorFailedError):  # the card says of its runs what they raised
        return []
    if not found:
        return []
    text = str(found["why_text"])
    text = f"{text[0].lower()}{text[1:].rstrip('.')}, with the same constants in {len(solutions)} runs"
    return [
        Line(
            topic=CONVENTIONS, flight=name, figure=" and ".join(dict.fromkeys(
                str(row["convention"]) for row in found["looks_like"])),
            value=None, low=None, high=None, sentence=f"{name}: {text}.",
        )
    ]  # fmt: skip
