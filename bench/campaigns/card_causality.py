"""The line of a card that says how far a filter looks ahead."""

from __future__ import annotations

import itertools
from dataclasses import replace

import numpy as np

from bench import pipeline
from bench.campaigns.card_lines import Line
from bench.campaigns.card_suite import LATE, Suite
from bench.campaigns.plan import Plan
from bench.data import NavSolution, SensorData
from bench.errors import EstimatorError, EstimatorFailedError
from bench.navigation.causality import measure_look_ahead
from bench.wording import one_line

_INSTANTS = 5  # at which the future is changed


def judge_causality(plan: Plan, suite: Suite, label: str) -> Line:
    """Return how far an estimator looks ahead, on the flight whose fixes come late or else on the first.

    The draws are none of the suite, and each run of a class of others has a process of its own: what it has
    seen in another run cannot tell it the future of this one.
    """
    names = [flight.name for flight in suite.members]
    number = names.index(LATE) if LATE in names else 0
    profile = next(cell.profile for cell in plan.cells if cell.condition == number)
    (choice,) = (one for one in profile.estimators if one.label == label)
    value = None
    if choice.use.startswith("file:"):
        text = "uses the future: not proven, its answers were made elsewhere"
    else:
        truth = pipeline.fly(profile)
        one, other = (pipeline.sense(profile, truth, suite.runs + k) for k in range(2))
        fixes, rng = one.data.fixes, np.random.default_rng(profile.seed)
        assert fixes is not None  # every flight of the suite has them
        before = fixes.t_arrival - np.median(np.diff(one.data.imu.t))  # where the next fix has not arrived
        instants = np.sort(rng.choice(before[len(before) // 5 :], _INSTANTS, replace=False))
        count = itertools.count(1)

        def run(data: SensorData) -> NavSolution:
            fresh = replace(choice, label=f"{label} {next(count)}")  # a process is kept by its label
            return pipeline.navigate(fresh, data, one.initial)

        try:
            found = measure_look_ahead(run, one.data, other.data, instants)
            text, value = found.text, found.seconds if found.repeatable else None
        except (ValueError, EstimatorError, EstimatorFailedError) as error:
            text = f"uses the future: not proven, {one_line(str(error))[:200]}"
    return Line(
        topic="causality", flight=names[number], figure="look-ahead [s]", value=value, low=value, high=value,
        sentence=f"{names[number]}: {text}.",
    )  # fmt: skip
