"""The line of a card about the look-ahead of a filter.

The test covers what the card evaluates: it repeats runs of the suite and compares their answers with those of
the card. The choice of runs depends on all answers, so that a filter cannot know it in advance.
"""

from __future__ import annotations

import hashlib
import itertools
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from bench import pipeline
from bench.core.records.data import NavSolution, SensorData
from bench.core.records.specs import EstimatorChoice, Profile
from bench.core.words.exceptions import EstimatorError, EstimatorFailedError
from bench.core.words.wording import one_line
from bench.experiments.campaigns.plan import Plan
from bench.experiments.campaigns.worker import hash_answers
from bench.experiments.card.card_lines import UNPROVEN, Line, Rows
from bench.experiments.card.card_suite import LATE, Suite
from bench.navigation.causality import LookAhead, measure_look_ahead

INSTANTS = 3  # at which the future is changed, of the flight whose fixes come late
_OTHERS, _INSTANTS_THERE = 2, 2  # further flights, and their epochs


def hash_all_answers(own: Rows) -> str:
    """Return a hash of all bits of the solutions of a filter."""
    return hashlib.sha256(" ".join(str(row.get("answers")) for row in own).encode()).hexdigest()[:16]


def judge_causality(plan: Plan, suite: Suite, label: str, own: Sequence[Rows]) -> Line:
    """Return the look-ahead of a filter, on the flight with late fixes and on randomly chosen flights.

    Each run of a foreign filter class has its own process, so that data seen in another run cannot reveal the
    future of this run. ``own`` contains its rows of each flight.
    """
    names = [flight.name for flight in suite.members]
    number = names.index(LATE) if LATE in names else 0
    rng = np.random.default_rng(int(hash_all_answers([row for rows in own for row in rows]), 16))
    others = rng.permutation([k for k in range(len(names)) if k != number])[:_OTHERS].tolist()
    profiles = {cell.condition: cell.profile for cell in plan.cells}
    (choice,) = (one for one in profiles[number].estimators if one.label == label)
    if choice.use.startswith("file:"):
        return _make_line(names[number], "uses the future: not proven, its answers were made elsewhere")
    found = dict[str, LookAhead]()
    for k, instants in ((number, INSTANTS), *((k, _INSTANTS_THERE) for k in others)):
        try:
            found[names[k]] = measure(profiles[k], choice, own[k], instants, rng)
        except (ValueError, EstimatorError, EstimatorFailedError) as error:
            text = f"uses the future: not proven, {one_line(str(error))[:200]}"
            return _make_line(names[number], text + _name_place(k != number, names[k]), word=UNPROVEN)
        if not found[names[k]].repeatable:
            break
    worst = max(found, key=lambda name: (not found[name].repeatable, found[name].seconds))
    one = found[worst]
    text = one.text + _name_place(worst != names[number], worst)
    if not one.repeatable:
        return _make_line(names[number], text, word=UNPROVEN)
    if one.seconds == 0.0 and others:
        text += f", neither here nor on {' and '.join(names[k] for k in others)}"
    return _make_line(names[number], text, one.seconds)


def _name_place(elsewhere: bool, name: str) -> str:
    return f", on {name}" if elsewhere else ""


def _make_line(flight: str, text: str, value: float | None = None, word: str = "") -> Line:
    return Line(
        topic="causality", flight=flight, figure="look-ahead [s]", value=value, low=value, high=value,
        sentence=f"{flight}: {text}.", word=word,
    )  # fmt: skip


def measure(
    profile: Profile, choice: EstimatorChoice, own: Rows, count: int, rng: np.random.Generator
) -> LookAhead:
    """Return the look-ahead in a random run of a flight; its solution must equal that on the card."""
    good = [k for k, row in enumerate(own) if row["converged"]] or list(range(len(own)))
    draw = int(rng.choice(good))
    truth = pipeline.fly(profile)
    one, other = (pipeline.sense(profile, truth, k) for k in (draw, len(own)))
    fixes = one.data.fixes
    assert fixes is not None  # every flight of the suite has them
    before = fixes.t_arrival - np.median(np.diff(one.data.imu.t))  # where the next fix has not arrived
    instants = np.sort(rng.choice(before[len(before) // 5 :], count, replace=False))
    number = itertools.count(1)

    def run(data: SensorData) -> NavSolution:
        fresh = replace(choice, label=f"{choice.label} {next(number)}")  # a process is kept by its label
        return pipeline.navigate(fresh, data, one.initial)

    first = run(one.data)
    if hash_answers(first) != own[draw].get("answers"):
        return LookAhead(0.0, whole=False, repeatable=False)
    return measure_look_ahead(run, one.data, other.data, instants, first)
