"""How often a convention is named where there is none, and how large one must be to be named.

    python -m tests.evaluation.convention_power --runs 300 --sizes 60

False names: of sound runs, of runs with a covariance that is wrong by a factor of each block or with random
walks, and of runs with a fault that is no convention (`tests.evaluation.unlisted`). Detection: an oracle
knows the convention and fits its size. It detects the convention if the NEES of the run is too large and the
likelihood ratio to the null is above the 99 % quantile of sound runs. The size that it detects in half of the
runs is one unit, and sizes are drawn log-uniform from 1 to 30 units.
"""

from __future__ import annotations

import argparse
from collections import Counter
from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import cache
from itertools import pairwise
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation
from scipy.stats import beta

from bench.core.mathematics import earth, rotation
from bench.core.records.data import NavSolution
from bench.evaluation.conventions import convention_search
from bench.evaluation.conventions.convention_search import find_mistakes
from bench.evaluation.conventions.known_conventions import Answers, list_conventions, move
from bench.evaluation.errors.error_series import BLOCKS, interpolate_truth, select_epochs
from tests.evaluation import unlisted
from tests.evaluation.unlisted import Base

SEED = 20261130
CLASSES = ("sound", "misjudged", "unlisted")
BINS = (1.0, 2.0, 4.0, 8.0, 16.0, 30.0)  # units of the oracle
_ORACLE_RUNS = 12
_ORACLE_CHANCE = 0.01  # of the oracle in sound runs
_SOUND_RUNS = 60


def ask(base: Base, solution: NavSolution) -> list[str]:
    """Return the conventions that are named."""
    found = find_mistakes([base.truth], [solution], base.antenna_b, base.begin)
    return [row["convention"] for row in found.get("looks_like", ())]


def make(kind: str, number: int) -> tuple[Base, NavSolution, str]:
    """Return a run without a mistaken convention, and what is wrong with it."""
    base, r = unlisted.draw(number), np.random.default_rng((SEED, CLASSES.index(kind), number))
    if kind == "sound":
        return base, base.solution, ""
    if kind == "misjudged":
        return base, unlisted.misjudge(base, r), ""
    name = list(unlisted.FAULTS)[number // 2 % len(unlisted.FAULTS)]
    return base, unlisted.spoil(base, name, r), name


def bound(count: int, runs: int) -> float:
    """Return the upper 95 % bound of a rate (Clopper and Pearson, Biometrika 26, 1934)."""
    return float(beta.ppf(0.95, count + 1, runs - count))


# --- mistakes of a size, made without the functions that undo them ----------------------------------------


def _errors(base: Base) -> np.ndarray:
    lla, vel_n, q_nb = interpolate_truth(base.truth, base.solution.t)
    turned = rotation.multiply(base.solution.q_nb, rotation.conjugate(q_nb))
    off_n = earth.difference_n(base.solution.lla, lla)
    return np.hstack([off_n, base.solution.vel_n - vel_n, rotation.to_rotvec(turned)])


def _shift(base: Base, late: float, attitude: bool) -> NavSolution:
    """Return the answers of another time, with the errors of this one."""
    rows = base.solution.t - abs(late) >= base.truth.t[0]
    rows &= base.solution.t + abs(late) <= base.truth.t[-1]
    there = select_epochs(base.solution, rows)
    lla, vel_n, q_nb = interpolate_truth(base.truth, there.t - late)
    if not attitude:
        q_nb = interpolate_truth(base.truth, there.t)[2]
    return unlisted.add(replace(there, lla=lla, vel_n=vel_n, q_nb=q_nb), _errors(base)[rows])


def _extend(base: Base, arm_b: np.ndarray) -> NavSolution:
    """Return the motion of a point beside the IMU."""
    t = base.solution.t
    C = Rotation.from_quat(np.roll(base.solution.q_nb, -1, axis=1))
    inner = np.clip(t, base.truth.t[0] + 0.02, base.truth.t[-1] - 0.02)
    before, after = (
        earth.displace(np.zeros((len(t), 3)), Rotation.from_quat(np.roll(q, -1, axis=1)).apply(arm_b))
        for q in (interpolate_truth(base.truth, inner + step)[2] for step in (-0.02, 0.02))
    )
    swing = earth.difference_n(after, before) / 0.04
    return unlisted.add(base.solution, np.hstack([C.apply(arm_b), swing, np.zeros((len(t), 3))]))


def _lift(base: Base, size: float) -> NavSolution:
    error = np.zeros((len(base.solution), 9))
    error[:, 2] = size
    return unlisted.add(base.solution, error)


def _turn(base: Base, turn: np.ndarray, level: bool) -> NavSolution:
    own, by = Rotation.from_quat(np.roll(base.solution.q_nb, -1, axis=1)), Rotation.from_rotvec(turn)
    turned = by * own if level else own * by
    return replace(base.solution, q_nb=np.roll(turned.as_quat(), 1, axis=1))


def _stretch(base: Base, scale: float) -> NavSolution:
    """Return attitudes that are integrated from turns of the body that are too large."""
    q = Rotation.from_quat(np.roll(base.truth.q_nb[::10], -1, axis=1))
    steps = (q[:-1].inv() * q[1:]).as_rotvec() * (1.0 + scale)
    wrong = [q[0]]
    for turn in Rotation.from_rotvec(steps):
        wrong.append(wrong[-1] * turn)
    off = (Rotation.concatenate(wrong) * q.inv()).as_rotvec()
    columns = [np.interp(base.solution.t, base.truth.t[::10], column) for column in off.T]
    error = np.column_stack([np.zeros((len(base.solution), 6)), *columns])
    return unlisted.add(base.solution, error)


Plant = Callable[[Base, float, np.ndarray], NavSolution]
PLANTS: Mapping[str, tuple[Plant, float, str]] = {
    "time offset": (lambda base, size, along: _shift(base, size * np.sign(along[0]), True), 0.01, "s"),
    "time offset of the fixes": (
        lambda base, size, along: _shift(base, size * np.sign(along[0]), False), 0.01, "s",
    ),
    "gyro scale": (lambda base, size, along: _stretch(base, size * np.sign(along[0])), 1e-3, "1"),
    "lever arm": (lambda base, size, along: _extend(base, size * along), 0.3, "m"),
    "height": (lambda base, size, along: _lift(base, size * np.sign(along[0])), 5.0, "m"),
    "rotation of the body": (lambda base, size, along: _turn(base, size * along, False), 0.01, "rad"),
    "rotation of the level": (lambda base, size, along: _turn(base, size * along, True), 0.01, "rad"),
}  # fmt: skip
"""Convention with a constant -> how it is put there, a first guess of its unit, and the unit of its size."""


UNITS: Mapping[str, float] = {
    "time offset": 0.0037,
    "time offset of the fixes": 0.011,
    "gyro scale": 8.9e-5,
    "lever arm": 0.25,
    "height": 1.1,
    "rotation of the body": 1.1e-3,
    "rotation of the level": 1.04e-3,
}
"""What `find_unit` returns for each, rounded."""


def plant(name: str, base: Base, size: float, r: np.random.Generator) -> NavSolution:
    """Return a sound solution with a mistake of a size in a direction that is drawn."""
    along = r.normal(size=3)
    return PLANTS[name][0](base, size, along / np.linalg.norm(along))


# --- an oracle that knows the convention ------------------------------------------------------------------


def weigh(name: str, base: Base, solution: NavSolution) -> tuple[float, bool]:
    """Return twice the log likelihood ratio of one convention to the null, and if the NEES is too large."""
    (one,) = (one for one in list_conventions(base.antenna_b) if one.name == name)
    s = select_epochs(solution, np.flatnonzero(solution.t >= base.begin)[::2])
    own = Answers(s.t, s.lla, s.vel_n, s.q_nb, s.cov, np.zeros(len(s), np.int64))
    truths, blocks = [base.truth], [block for block in BLOCKS if block in one.blocks]
    constants = convention_search.fit(truths, own, replace(one, starts=(0.0,)), blocks)
    total = 0.0
    for answers, sign in ((own, 1.0), (one.undo(own, move(truths, own), constants), -1.0)):
        motion, error, cov = convention_search.see(truths, answers)
        total += sign * convention_search.sum_misfit(motion, error, cov, blocks, 1.0)
    judged = convention_search.judge(truths, own, blocks)
    return total * len(error), any(judged[block].mean > judged[block].high for block in blocks)


@cache
def find_unit(name: str) -> float:
    """Return the size that the oracle detects in half of the runs."""
    sound = [weigh(name, unlisted.draw(k), unlisted.draw(k).solution)[0] for k in range(_SOUND_RUNS)]
    limit = np.quantile(sound, 1.0 - _ORACLE_CHANCE)
    low, high = PLANTS[name][1] / 30.0, PLANTS[name][1] * 30.0
    for _ in range(7):
        size, detected = np.sqrt(low * high), 0
        for k in range(_ORACLE_RUNS):
            base = unlisted.draw(k)
            ratio, broken = weigh(name, base, plant(name, base, size, np.random.default_rng(k)))
            detected += ratio > limit and broken
        low, high = (low, size) if 2 * detected >= _ORACLE_RUNS else (size, high)
    return float(np.sqrt(low * high))


def detect(name: str, count: int) -> list[tuple[float, list[str]]]:
    """Return the size in units of the oracle and the names of a number of runs."""
    rows, unit = [], find_unit(name)
    for k in range(count):
        r = np.random.default_rng((SEED, sorted(PLANTS).index(name), k))
        size, base = float(np.exp(r.uniform(0.0, np.log(BINS[-1])))), unlisted.draw(k)
        rows.append((size, ask(base, plant(name, base, size * unit, r))))
    return rows


def list_false(runs: int) -> dict[str, list[tuple[int, str, list[str]]]]:
    """Return the runs of each class in which a convention is named: number, fault and names."""
    wrong: dict[str, list[Any]] = {kind: [] for kind in CLASSES}
    for kind in CLASSES:
        for number in range(runs):
            base, solution, fault = make(kind, number)
            if names := ask(base, solution):
                wrong[kind].append((number, fault, names))
    return wrong


def main() -> None:
    """Print the false names of each class and the detection curve of each convention."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--runs", type=int, default=300, help="of each class")
    parser.add_argument("--sizes", type=int, default=60, help="of each convention")
    given = parser.parse_args()
    wrong = list_false(given.runs)
    for kind, rows in wrong.items():
        print(f"{kind}: {len(rows)} of {given.runs} named, below {100 * bound(len(rows), given.runs):.2f} %")
        for number, fault, names in rows:
            print(f"   {number} {fault}: {', '.join(names)}")
    total, runs = sum(map(len, wrong.values())), given.runs * len(wrong)
    print(f"all: {total} of {runs}, below {100 * bound(total, runs):.2f} %", flush=True)
    heads = [f"{low:g} to {high:g}" for low, high in pairwise(BINS)]
    print("| convention | unit |", " | ".join(heads), "| only others |")
    for name in PLANTS if given.sizes else ():
        rows = detect(name, given.sizes)
        where = np.digitize([size for size, _ in rows], BINS[1:-1])
        named = np.array([name in names for _, names in rows])
        others = Counter(other for _, names in rows if name not in names for other in names)
        cells = [f"{named[where == k].sum()} of {(where == k).sum()}" for k in range(len(heads))]
        unit = f"{find_unit(name):.3g} {PLANTS[name][2]}"
        print(f"| {name} | {unit} |", " | ".join(cells), f"| {dict(others) or ''} |", flush=True)


if __name__ == "__main__":
    main()
