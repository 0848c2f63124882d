"""Search for a mistaken convention that explains the errors of an inconsistent solution.

A convention is named only if undoing it, with the same constants in both halves of the flight, brings the
NEES of the blocks that it changes into their band or down tenfold, by more than its constants do by chance.
It has to be likelier than that the answers are right and each block overconfident by a factor of its own: a
claim as it is then, answers with such factors on what is left. All that the flight cannot tell from the best
are named with it. What is left is searched again.
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
from bench.evaluation.consistency.chi_square import chi2_quantile
from bench.evaluation.conventions.known_conventions import (
    Answers,
    Convention,
    compare,
    list_conventions,
    move,
)
from bench.evaluation.errors.error_series import (
    BLOCKS,
    claimed_blocks,
    find_covered_epochs,
    normalized_squares,
    select_epochs,
)

_TENFOLD = 10.0
_CHANCE = 1e-6  # of naming a convention where there is none, by its constants alone
_SAME = 0.5  # of its length: how far a constant of half a flight may be from that of all
_ALIKE = 0.20  # of the best: within so much the flight does not tell conventions apart
_SURE = 10.8  # NEES over all independent values, 99.9 % of one degree of freedom: the same
_FITS = 4.0  # errors of a state over its sigma, rms of one run, or one over it: its covariance may be right
_OF_UNITS = 0.5  # of what a unit alone takes off: any attitude is within half a turn, in a unit 57 times less
_ROUNDS = 3  # of searching the rest again
_ITERATIONS = 6  # of a fit
_MOST = 1500  # epochs that are looked at
_FEW = 300  # of them for the starts of a fit

_NOTHING = np.empty(0)


@dataclass(frozen=True, slots=True)
class Mistake:
    """A convention that was mistaken, with its constants, and the NEES once it is undone."""

    convention: Convention
    constants: FloatArray
    answers: Answers  # without it
    before: BlockNees  # of the blocks that it changes
    after: BlockNees
    left: dict[str, BlockNees]  # of each block without it; "all" of all


@np.errstate(all="ignore")  # a diverged solution is a result, not a warning
def find_mistakes(
    truth: Trajectory, solutions: Sequence[NavSolution], antenna_b: FloatArray, begin: float
) -> dict[str, Any]:
    """Return the mistaken conventions that explain the errors of inconsistent solutions; empty for none.

    Parameters
    ----------
    truth : Trajectory
        The motion.
    solutions : sequence of NavSolution
        What is evaluated: answers of one filter, of one run of the noise or of several. One constant has to
        do for all of them.
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
        parts.append(select_epochs(one, rows[:: max(1, len(solutions) * len(rows) // _MOST)]))
    t, lla, vel_n, q_nb, cov = (
        np.concatenate([getattr(part, name) for part in parts])
        for name in ("t", "lla", "vel_n", "q_nb", "cov")
    )
    answers = Answers(t, lla, vel_n, q_nb, cov)
    if not move(truth, answers).inside.any():
        return {}
    steps = list[list[Mistake]]()
    first = judge(truth, answers, claimed)
    for _ in range(_ROUNDS):
        found = search(truth, answers, claimed, list_conventions(antenna_b))
        if not found:
            break
        steps.append(found)
        answers = found[0].answers
        if is_consistent(judge(truth, answers, claimed)):
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
    whole = judge(truth, answers, claimed)["all"]
    return {"looks_like": values, "why_text": describe(steps, first["all"], whole)}


def judge(truth: Trajectory, answers: Answers, claimed: Sequence[str]) -> dict[str, BlockNees]:
    """Return the mean NEES of each block, and of all states."""
    motion = move(truth, answers)
    error, cov = compare(answers, motion), answers.cov[motion.inside]
    return {
        **{name: _measure(error, cov, [name]) for name in claimed},
        "all": _measure(error, cov, claimed),
    }


def _measure(error: FloatArray, cov: FloatArray, blocks: Sequence[str]) -> BlockNees:
    kept = _list_states(blocks)
    return measure_nees(error[:, kept], cov[:, kept][:, :, kept])


def _list_states(blocks: Sequence[str]) -> FloatArray:
    return np.hstack([np.arange(9)[BLOCKS[name]] for name in blocks])


def is_consistent(found: dict[str, BlockNees]) -> bool:
    """Return whether no block has a NEES above its bounds or below them."""
    return find_broken_block(found) is None and all(one.mean >= one.low for one in found.values())


def search(
    truth: Trajectory, answers: Answers, claimed: Sequence[str], conventions: Sequence[Convention]
) -> list[Mistake]:
    """Return the best convention and all that the flight cannot distinguish from it; empty if none fits."""
    own = judge(truth, answers, claimed)
    motion = move(truth, answers)
    error, cov = compare(answers, motion), answers.cov[motion.inside]
    found = list[Mistake]()
    for one in conventions:
        blocks = [name for name in one.blocks if name in claimed]
        if not blocks or (not one.of_claim and all(own[name].mean <= own[name].high for name in blocks)):
            continue
        before = _measure(error, cov, blocks)
        mistake = try_convention(truth, answers, one, blocks, claimed, before)
        if mistake is not None:
            found.append(mistake)
    # a covariance is wrong only if no wrong answers explain it; those that leave nothing come first
    answered = [one for one in found if not one.convention.of_claim]
    whole = [one for one in answered if one.left["all"].mean <= one.left["all"].high]
    found = whole or answered or found
    if not found:
        return []
    best = min(found, key=lambda one: one.left["all"].mean)
    named = [one for one in found if is_alike(best, one)]
    if not any(one.convention.alone for one in named):
        return []
    return sorted(named, key=lambda one: (not one.convention.alone, one.convention.constants))


def is_alike(best: Mistake, one: Mistake) -> bool:
    """Return whether two conventions fit the blocks that either of them changes equally well."""
    blocks = [name for name in best.left if name in {*best.convention.blocks, *one.convention.blocks}]
    least, found = (sum(mistake.left[name].mean for name in blocks) for mistake in (best, one))
    return found <= least + max(_ALIKE * least, _SURE / max(best.after.samples, 1.0))


def try_convention(
    truth: Trajectory,
    answers: Answers,
    one: Convention,
    blocks: Sequence[str],
    claimed: Sequence[str],
    before: BlockNees,
) -> Mistake | None:
    """Return a convention as a mistake if undoing it makes the covariance of its blocks consistent."""
    constants, both = _NOTHING, True
    if one.derivative is not None:
        constants, both = fit(truth, answers, one, blocks)
        if not (both and one.least <= float(np.linalg.norm(constants)) <= one.most):
            return None
    undone = one.undo(answers, move(truth, answers), constants)
    motion = move(truth, undone)
    error, cov = compare(undone, motion), undone.cov[motion.inside]
    after = _measure(error, cov, blocks)
    if one.of_claim:  # a wider claim makes any NEES small: it has to fit every state
        kept = _list_states(blocks)
        sigmas = error[:, kept] / np.sqrt(np.einsum("kii->ki", cov)[:, kept])
        size = np.sqrt(np.mean(np.square(sigmas), axis=0))
        if before.inside or not (after.inside and size.max() <= _FITS and size.min() >= 1.0 / _FITS):
            return None
    elif not (after.inside or after.mean * _TENFOLD <= before.mean):
        return None
    known = move(truth, answers)
    null = _find_misfit(compare(answers, known), answers.cov[known.inside], blocks, free=True)
    better = null - 2.0 * one.shrinks - _find_misfit(error, cov, blocks, free=not one.of_claim)
    gained = max(before.samples, 1.0) * abs(before.mean - after.mean)
    if gained < chi2_quantile(1.0 - _CHANCE, one.constants + 1) or not better > _OF_UNITS * abs(one.shrinks):
        return None
    return Mistake(one, constants, undone, before, after, judge(truth, undone, claimed))


def _find_misfit(error: FloatArray, cov: FloatArray, blocks: Sequence[str], *, free: bool) -> float:
    """Return the mean of -2 log likelihood of errors (K, 9) by block, without the constant term.

    If ``free`` the covariance of each block has the factor that fits it best: it is overconfident by it.
    """
    total = 0.0
    for name in blocks:
        kept = _list_states([name])
        own = cov[:, kept][:, :, kept]
        nees = float(np.mean(normalized_squares(error[:, kept], own)))
        with np.errstate(divide="ignore"):  # an error of zero is likelier than any other
            spent = len(kept) * (1.0 + float(np.log(nees / len(kept)))) if free else nees
        total += float(np.linalg.slogdet(own)[1].mean()) + spent
    return total


def fit(
    truth: Trajectory, answers: Answers, one: Convention, blocks: Sequence[str]
) -> tuple[FloatArray, bool]:
    """Return the constants of a convention, and whether both halves of the flight give the same ones."""
    start = np.zeros(one.constants)
    if len(one.starts) > 1:
        few = _take(answers, slice(None, None, max(1, len(answers.t) // _FEW)))
        squares = [_weigh(truth, few, one, blocks, np.array([value])) for value in one.starts]
        start[0] = one.starts[int(np.argmin(squares))]
    constants = start
    for _ in range(_ITERATIONS):
        step, halves = solve(truth, answers, one, blocks, constants)
        if step is None:
            return constants, False
        constants = constants + step
    size = float(np.linalg.norm(constants))
    return constants, all(float(np.linalg.norm(half)) <= _SAME * size for half in halves)


def _take(answers: Answers, rows: slice) -> Answers:
    return Answers(
        answers.t[rows], answers.lla[rows], answers.vel_n[rows], answers.q_nb[rows], answers.cov[rows],
        answers.late,
    )  # fmt: skip


def _weigh(
    truth: Trajectory, answers: Answers, one: Convention, blocks: Sequence[str], constants: FloatArray
) -> float:
    """Return the mean NEES of the blocks with given constants; infinite if it is not finite."""
    undone = one.undo(answers, move(truth, answers), constants)
    motion = move(truth, undone)
    return _measure(compare(undone, motion), undone.cov[motion.inside], blocks).mean


def solve(
    truth: Trajectory, answers: Answers, one: Convention, blocks: Sequence[str], constants: FloatArray
) -> tuple[FloatArray | None, list[FloatArray]]:
    """Return a weighted least-squares step for the constants: of the whole flight and of each half."""
    assert one.derivative is not None
    undone = one.undo(answers, move(truth, answers), constants)
    motion = move(truth, undone)
    kept = _list_states(blocks)
    error, P = compare(undone, motion)[:, kept], undone.cov[motion.inside][:, kept][:, :, kept]
    J = one.derivative(motion)[:, kept]
    try:
        weighted = np.linalg.solve(P, np.concatenate([J, error[:, :, None]], axis=2))
        products = np.einsum("kip,kiq->kpq", J, weighted)
        half = len(products) // 2
        whole, *parts = (
            np.linalg.solve(total[:, :-1], total[:, -1])
            for total in (products.sum(axis=0), products[:half].sum(axis=0), products[half:].sum(axis=0))
        )
    except np.linalg.LinAlgError:
        return None, []
    return (whole if np.isfinite(whole).all() else None), parts


def describe(steps: Sequence[Sequence[Mistake]], before: BlockNees, after: BlockNees) -> str:
    """Return the sentence that names the mistakes."""
    parts = []
    for step in steps:
        words = [one.convention.words(one.constants) for one in step]
        parts.append(" or ".join(filter(None, [", ".join(words[:-1]), words[-1]])))
        if len(step) > 1:
            parts[-1] += " (this flight does not show which)"
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
