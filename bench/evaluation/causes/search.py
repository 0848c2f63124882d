"""Search for the causes of an inconsistent run: the candidates without which the run is consistent.

The measure is the excess NEES of the block whose covariance is broken, mean NEES less its states. A candidate
is a cause if the run without it has lost `LEAST` of the excess, together with all that take nearly as much as
the best; without these the rest is searched again. Of several, those are dropped without which the others do
as well: a gate that decides otherwise by chance can make a small error look like a cause. Candidates of one
sensor are first tried together, and one by one only where that takes `LEAST`; if no sensor does, each is.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field
from functools import reduce

import numpy as np

from bench.core.records.sensor_specs import AssumedSpecs, SensorsSpec
from bench.core.records.specs import EstimatorChoice
from bench.evaluation.causes.candidates import SKY_ERRORS, WANDER, Candidate
from bench.evaluation.consistency.block_nees import BlockNees, find_broken_block
from bench.evaluation.conventions.convention_search import write_nees
from bench.evaluation.errors.error_series import TITLES
from bench.navigation import built_in, estimator
from bench.navigation.forward_filters import FORWARD

LEAST = 0.30
"""Part of the excess NEES that a cause takes [1]."""
ALIKE = 0.20
"""Within so much of the best the others are causes as well [1]."""

_NEEDED = 0.10
"""Part of what some causes take together that is lost if one of them stays [1]."""

_ROUNDS = 5  # of searching the rest again

Measure = Callable[[SensorsSpec], Mapping[str, BlockNees]]
"""Sensors -> the NEES by block of the filter on them, as `block_nees.judge_blocks` returns it."""


@dataclass(frozen=True, slots=True)
class SearchStep:
    """Candidates that were named together, and the NEES of the inconsistent block with and without them."""

    named: tuple[Candidate, ...]
    block: str
    before: BlockNees
    after: BlockNees


@dataclass(frozen=True, slots=True)
class Causes:
    """Result of a search for causes."""

    steps: tuple[SearchStep, ...]
    left: str | None  # block whose covariance is still broken without all that is named
    before: BlockNees  # of the block whose covariance is broken in the run
    block: str
    runs: int  # of the filter that it took

    @property
    def named(self) -> tuple[Candidate, ...]:
        """All causes, in the order they were found."""
        return tuple(one for step in self.steps for one in step.named)


@dataclass
class _Trials:
    """Runs of the filter without some candidates; each set of candidates is run once."""

    spec: SensorsSpec
    measure: Measure
    done: dict[frozenset[int], Mapping[str, BlockNees]] = field(default_factory=dict)

    def run(self, removed: Collection[Candidate]) -> Mapping[str, BlockNees]:
        key = frozenset(id(one) for one in removed)
        if key not in self.done:
            without = reduce(lambda spec, one: one.remove(spec), removed, self.spec)
            self.done[key] = self.measure(without)
        return self.done[key]


def find_causes(
    spec: SensorsSpec,
    candidates: Sequence[Candidate],
    own: Mapping[str, BlockNees],
    measure: Measure,
) -> Causes | None:
    """Return the causes of an inconsistent run; None if the NEES of no block is above its band.

    Parameters
    ----------
    spec : SensorsSpec
        The sensors on board.
    candidates : sequence of Candidate
        Of `candidates.list_candidates`.
    own : mapping
        The NEES by block of the run itself.
    measure : callable
        Run the filter on other sensors with the same runs.
    """
    first = find_broken_block(own)
    if first is None:
        return None
    trials, rest, removed = _Trials(spec, measure, {frozenset(): own}), list(candidates), list[Candidate]()
    steps, block = list[SearchStep](), first
    left: str | None = first
    for _ in range(_ROUNDS):
        named = _name(trials, rest, removed, block)
        if not named:
            break
        before = trials.run(removed)[block]
        removed += named
        rest = [one for one in rest if one not in named]
        now = trials.run(removed)
        steps.append(SearchStep(tuple(named), block, before, now[block]))
        left = find_broken_block(now)
        if left is None:
            break
        block = left
    return Causes(tuple(steps), left, own[first], first, len(trials.done) - 1)


def _name(
    trials: _Trials, rest: Sequence[Candidate], removed: Sequence[Candidate], block: str
) -> list[Candidate]:
    """Return the candidates that explain most of the excess NEES of a block, if they explain enough of it."""

    def take(more: Sequence[Candidate]) -> float:
        return _share(trials.run(removed)[block], trials.run([*removed, *more])[block])

    groups = {one.group: [other for other in rest if other.group == one.group] for one in rest}
    together = {name: take(members) for name, members in groups.items()}
    tried = [one for one in rest if together[one.group] >= LEAST] or rest
    taken = [take([one]) for one in tried]
    most = max(taken, default=0.0)
    if most >= LEAST:
        named = [one for one, share in zip(tried, taken, strict=True) if share >= (1.0 - ALIKE) * most]
    else:
        best = max(together, key=lambda name: together[name], default=None)
        named = groups[best] if best is not None and together[best] >= LEAST else []
    if len(named) < 2:
        return named
    least = (1.0 - _NEEDED) * take(named)
    needed = [one for one in named if take([other for other in named if other is not one]) < least]
    return needed or named


def _share(before: BlockNees, after: BlockNees) -> float:
    """Return the fraction of the excess NEES that disappeared."""
    if not np.isfinite(before.mean):
        return float(np.isfinite(after.mean))
    return 1.0 - max(after.excess, 0.0) / before.excess if before.excess > 0 else 0.0


def describe_causes(causes: Causes, advice: str) -> str:
    """Return the sentences that explain why a run is not consistent."""
    if not causes.steps:
        return (
            f"not found: no fault and no unmodeled error explains {100 * LEAST:.0f} % of the "
            f"excess NEES of the {TITLES[causes.block]}, {write_nees(causes.before.mean)} where "
            f"{causes.before.states} is expected."
        )
    parts = []
    for number, step in enumerate(causes.steps):
        names = _join([one.words for one in step.named])
        them = "it" if len(step.named) == 1 else "them"
        too = "" if not number else ", too,"
        parts.append(
            f"{names}: without {them}{too} the NEES of the {TITLES[step.block]} is "
            f"{write_nees(step.after.mean)} and not {write_nees(step.before.mean)}"
        )
    told = f"{'; then '.join(parts)} ({causes.before.states} expected)."
    if causes.left is not None:
        told += f" What else breaks the covariance of the {TITLES[causes.left]} was not found."
    return f"{told} {advice}".rstrip()


def advise(choice: EstimatorChoice, specs: AssumedSpecs, named: Collection[Candidate], sky: bool) -> str:
    """Return the name of the smallest built-in filter with states for all named errors, in a sentence.

    Parameters
    ----------
    choice : EstimatorChoice
        The filter that was evaluated; what it takes beside GNSS and barometer the other gets as well.
    specs : AssumedSpecs
        The datasheets of the sensors on board.
    named : collection of Candidate
        The causes.
    sky : bool
        Whether there are observations of satellites.
    """
    told = []
    errors = list(dict.fromkeys(one.error for one in named if one.error))
    if errors:
        names = _join(errors)
        for name in FORWARD if sky else [name for name in FORWARD if name != "tight"]:
            options = {
                key: value for key, value in choice.options.items() if built_in.takes_option(name, key)
            }
            missing = estimator.list_unmodeled(built_in.load(name, options), name, specs) or []
            lasting = WANDER in missing and name != "tight"
            if not any(one in missing or (one in SKY_ERRORS and lasting) for one in errors):
                told.append(f"{name} has states for {'it' if len(errors) == 1 else 'all of them'}.")
                break
        else:
            told.append(f"No built-in filter has states for {names}.")
    if any(one.assumed for one in named):
        told.append("What a filter assumes is set in [sensors.assumed].")
    return " ".join(told)


def _join(words: Sequence[str]) -> str:
    return " and ".join(filter(None, [", ".join(words[:-1]), words[-1]]))
