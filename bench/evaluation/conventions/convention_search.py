"""Search for a mistaken convention that explains the errors of an inconsistent solution.

A convention is named only if undoing it brings the NEES of the affected blocks into their band, or reduces it
to a tenth. It must also explain the errors better than the null model: a covariance that is wrong by a factor
in each block, and errors with a random walk. With the convention undone, the errors may have random walks
too, and a factor unless the convention is one of the covariance. Conventions that the flight cannot
distinguish from the best are named with it. The search is then repeated on the remaining errors.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from bench.core.mathematics.arrays import FloatArray
from bench.core.mathematics.units import SAME_INSTANT
from bench.core.records.data import NavSolution, Trajectory
from bench.core.words.wording import format_number
from bench.evaluation.consistency.block_nees import BlockNees, find_broken_block, measure_nees
from bench.evaluation.conventions.known_conventions import (
    Answers,
    Convention,
    TrueMotion,
    compare,
    list_conventions,
    move,
)
from bench.evaluation.conventions.null_model import find_misfit, fit_noise, normalize, whiten
from bench.evaluation.errors.error_series import BLOCKS, claimed_blocks, find_covered_epochs, select_epochs

_TENFOLD = 10.0
_BEYOND = 20.0  # least twice the log likelihood ratio to the null of a named convention; by simulation
_ALIKE = 14.0  # twice the log likelihood ratio within which the flight cannot distinguish conventions
_FITS = 4.0  # errors of a state over its sigma, rms of one run, or one over it: its covariance may be right
_OF_UNITS = 0.5  # of what a unit alone takes off: any attitude is within half a turn, in a unit 57 times less
_ROUNDS = 3  # of searching the rest again
_ITERATIONS = 6  # of a fit
_UNWEIGHTED = 2  # first iterations, before the noise of the residuals is known
_MOST = 1500  # epochs that are looked at
_SPACING = 1.0  # between them at least [s]
_FEW = 300  # of them for the starts of a fit


@dataclass(frozen=True, slots=True)
class Mistake:
    """A convention that was mistaken, with its constants, and the NEES once it is undone."""

    convention: Convention
    constants: FloatArray
    answers: Answers  # without it
    before: BlockNees  # of the blocks that it changes
    after: BlockNees
    left: dict[str, BlockNees]  # of each block without it; "all" of all
    beyond: float  # twice the log likelihood ratio to the null, less the log of the epochs for each constant


@np.errstate(all="ignore")  # a diverged solution is a result, not a warning
def find_mistakes(
    truths: Sequence[Trajectory], solutions: Sequence[NavSolution], antenna_b: FloatArray, begin: float
) -> dict[str, Any]:
    """Return the mistaken conventions that explain the errors of inconsistent solutions; empty for none.

    Parameters
    ----------
    truths : sequence of Trajectory
        The motion of each solution.
    solutions : sequence of NavSolution
        What is evaluated: answers of one filter, of one run or of several. One constant has to do for all of
        them.
    antenna_b : (3,) array
        Place of the antenna [m], b.
    begin : float
        End of the alignment window [s].

    Returns
    -------
    values : dict
        ``looks_like``, a row for each ``convention``: its ``constants`` in SI, the mean NEES of what it
        changes with and without it (``nees``, ``nees_without``) and the ``step``, the same for those that
        the flight does not tell apart; and ``why_text``.
    """
    blocks = [claimed_blocks(one) for one in solutions]
    claimed = [name for name in blocks[0] if all(name in others for others in blocks)]
    if not claimed:
        return {}
    parts = []
    for one in solutions:
        rows = np.flatnonzero(find_covered_epochs(one) & (one.t >= begin - SAME_INSTANT))
        spaced = int(np.ceil(_SPACING / np.median(np.diff(one.t[rows])) - 0.01)) if len(rows) > 1 else 1
        parts.append(select_epochs(one, rows[:: max(1, spaced, len(solutions) * len(rows) // _MOST)]))
    t, lla, vel_n, q_nb, cov = (
        np.concatenate([getattr(part, name) for part in parts])
        for name in ("t", "lla", "vel_n", "q_nb", "cov")
    )
    answers = Answers(t, lla, vel_n, q_nb, cov, np.repeat(np.arange(len(parts)), [len(one) for one in parts]))
    if not move(truths, answers).inside.any():
        return {}
    steps = list[list[Mistake]]()
    first = judge(truths, answers, claimed)
    for _ in range(_ROUNDS):
        found = search(truths, answers, claimed, list_conventions(antenna_b))
        if not found:
            break
        steps.append(found)
        answers = found[0].answers
        if is_consistent(judge(truths, answers, claimed)):
            break
    if not steps:
        return {}
    values = [
        {
            "convention": one.convention.name,
            "constants": one.constants.tolist(),
            "nees": keep_finite(one.before.mean),
            "nees_without": keep_finite(one.after.mean),
            "step": number,
        }
        for number, step in enumerate(steps, 1)
        for one in step
    ]
    whole = judge(truths, answers, claimed)["all"]
    return {"looks_like": values, "why_text": describe(steps, first["all"], whole)}


def judge(truths: Sequence[Trajectory], answers: Answers, claimed: Sequence[str]) -> dict[str, BlockNees]:
    """Return the mean NEES of each block, and of all states."""
    _, error, cov = see(truths, answers)
    blocks = {name: _measure(error, cov, [name]) for name in claimed}
    return {**blocks, "all": _measure(error, cov, claimed)}


def see(truths: Sequence[Trajectory], answers: Answers) -> tuple[TrueMotion, FloatArray, FloatArray]:
    """Return the motion, the errors (K, 9) and their reported covariance (K, 9, 9)."""
    motion = move(truths, answers)
    return motion, compare(answers, motion), answers.cov[motion.inside]


def _measure(error: FloatArray, cov: FloatArray, blocks: Sequence[str]) -> BlockNees:
    kept = _list_states(blocks)
    return measure_nees(error[:, kept], cov[:, kept][:, :, kept])


def _list_states(blocks: Sequence[str]) -> FloatArray:
    return np.hstack([np.arange(9)[BLOCKS[name]] for name in blocks])


def is_consistent(found: dict[str, BlockNees]) -> bool:
    """Return whether no block has a NEES above its bounds or below them."""
    return find_broken_block(found) is None and all(one.mean >= one.low for one in found.values())


def search(
    truths: Sequence[Trajectory], answers: Answers, claimed: Sequence[str], conventions: Sequence[Convention]
) -> list[Mistake]:
    """Return the best convention and all that the flight cannot distinguish from it; empty if none fits."""
    own = judge(truths, answers, claimed)
    found = list[Mistake]()
    for one in conventions:
        blocks = [name for name in one.blocks if name in claimed]
        if not blocks or (not one.of_claim and all(own[name].mean <= own[name].high for name in blocks)):
            continue
        mistake = try_convention(truths, answers, one, blocks, claimed)
        if mistake is not None:
            found.append(mistake)
    # a covariance is wrong only if no wrong answers explain it; those that leave nothing come first
    answered = [one for one in found if not one.convention.of_claim]
    whole = [one for one in answered if one.left["all"].mean <= one.left["all"].high]
    found = whole or answered or found
    if not found:
        return []
    best = max(one.beyond for one in found)
    named = [one for one in found if one.beyond >= best - _ALIKE]
    if not any(one.convention.alone for one in named):
        return []
    return sorted(named, key=lambda one: (not one.convention.alone, one.convention.constants))


def try_convention(
    truths: Sequence[Trajectory],
    answers: Answers,
    one: Convention,
    blocks: Sequence[str],
    claimed: Sequence[str],
) -> Mistake | None:
    """Return a convention as a mistake if it explains enough of its blocks, and more than the null does."""
    constants = np.empty(0)
    if one.derivative is not None:
        constants = fit(truths, answers, one, blocks)
        if not (one.least <= float(np.linalg.norm(constants)) <= one.most):
            return None
    given = see(truths, answers)
    before = _measure(*given[1:], blocks)
    undone = one.undo(answers, given[0], constants)
    motion, error, cov = see(truths, undone)
    after = _measure(error, cov, blocks)
    if one.of_claim:  # a wider claim makes any NEES small: it has to fit every state
        kept = _list_states(blocks)
        sigmas = error[:, kept] / np.sqrt(np.einsum("kii->ki", cov)[:, kept])
        size = np.sqrt(np.mean(np.square(sigmas), axis=0))
        if before.inside or not (after.inside and size.max() <= _FITS and size.min() >= 1.0 / _FITS):
            return None
    elif not (after.inside or after.mean * _TENFOLD <= before.mean):
        return None
    null = sum_misfit(*given, blocks, 0.0 if one.of_claim else 1.0)
    limits = (1.0, 1.0) if one.of_claim else (1.0,)
    better = null - 2.0 * one.shrinks - sum_misfit(motion, error, cov, blocks, *limits)
    beyond = len(error) * better - one.constants * float(np.log(len(error)))
    if not (beyond > _BEYOND and better > _OF_UNITS * abs(one.shrinks)):
        return None
    return Mistake(one, constants, undone, before, after, judge(truths, undone, claimed), beyond)


def sum_misfit(
    motion: TrueMotion, error: FloatArray, cov: FloatArray, blocks: Sequence[str], *limits: float
) -> float:
    """Return the mean of -2 log likelihood of errors (K, 9) over blocks, each with its factor and walks.

    ``limits`` bound the factor. For a convention of the solution it is at least 1, because small errors prove
    no mistake. For a convention of the covariance it is free before undoing, and 1 after it.
    """
    parts = (_list_states([name]) for name in blocks)
    return sum(find_misfit(error[:, kept], cov[:, kept][:, :, kept], motion, *limits) for kept in parts)


def fit(truths: Sequence[Trajectory], answers: Answers, one: Convention, blocks: Sequence[str]) -> FloatArray:
    """Return the constants of a convention; NaN if the flight does not determine them."""
    constants = np.zeros(one.constants)
    if len(one.starts) > 1:
        few = answers.take(slice(None, None, max(1, len(answers.t) // _FEW)))
        undone = (one.undo(few, move(truths, few), np.array([value])) for value in one.starts)
        squares = [_measure(*see(truths, other)[1:], blocks).mean for other in undone]
        constants[0] = one.starts[int(np.argmin(squares))]
    for number in range(_ITERATIONS):
        constants = constants + solve(truths, answers, one, blocks, constants, number < _UNWEIGHTED)
    return constants


def solve(
    truths: Sequence[Trajectory],
    answers: Answers,
    one: Convention,
    blocks: Sequence[str],
    constants: FloatArray,
    white: bool,
) -> FloatArray:
    """Return a least-squares step for the constants; NaN if the flight does not determine them.

    The weights follow from the noise model that fits the residuals best, or from ``white`` noise.
    """
    assert one.derivative is not None
    motion, error, cov = see(truths, one.undo(answers, move(truths, answers), constants))
    columns = np.concatenate([one.derivative(motion), error[:, :, None]], axis=2)
    total = np.zeros((one.constants, one.constants + 1))
    try:
        for kept in (_list_states([name]) for name in blocks):
            own, _ = whiten(columns[:, kept], cov[:, kept][:, :, kept])
            rows = own if white else normalize(own, motion, fit_noise(own[:, :, -1], motion, 1.0))
            total += np.einsum("kip,kiq->pq", rows[:, :, :-1], rows)
        return np.asarray(np.linalg.solve(total[:, :-1], total[:, -1]), np.float64)
    except np.linalg.LinAlgError:
        return np.full(one.constants, np.nan)


def describe(steps: Sequence[Sequence[Mistake]], before: BlockNees, after: BlockNees) -> str:
    """Return the sentence that names the mistakes."""
    parts = []
    for step in steps:
        words = [one.convention.words(one.constants) for one in step]
        parts.append(" or ".join(filter(None, [", ".join(words[:-1]), words[-1]])))
        if len(step) > 1:
            parts[-1] += " (this motion cannot distinguish them)"
    them = "that" if len(steps) == 1 else "these"
    return (
        f"Looks like {', and '.join(parts)}: without {them} its NEES is {write_nees(after.mean)} and not "
        f"{write_nees(before.mean)} ({after.states} expected)."
    )


def write_nees(nees: float) -> str:
    """Return a mean NEES in words."""
    return format_number(nees, 3) if np.isfinite(nees) else "without bound"


def keep_finite(value: float) -> float | None:
    """Return a value, or None if it is not finite, because JSON cannot contain it."""
    return value if np.isfinite(value) else None
