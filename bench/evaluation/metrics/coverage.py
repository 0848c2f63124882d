"""Fraction of the requested epochs with a solution, and the error counted at the other epochs.

Each estimated block (position, velocity, attitude) counts at every time from its first answer on. An epoch
without an answer gets the error of the last answer, extrapolated by its own velocity: a filter without
answers where its errors are large must not look better than a filter that answers.

A filter may answer at its own rate. It is then evaluated at its own epochs, nothing is interpolated, and one
answer in each of its intervals is required.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from bench.core.mathematics import earth
from bench.core.mathematics.arrays import BoolArray, FloatArray, IntArray
from bench.core.mathematics.units import SAME_INSTANT
from bench.core.records.data import NavSolution, SensorData
from bench.evaluation.errors.error_series import TITLES, VALUES, find_answered_epochs

ENOUGH = 0.99
"""Share of the epochs that each block of a solution has to answer [1]."""

_LATE = 1.0  # a first answer later than this after the first epoch is mentioned [s]
_GAP = 1.5  # a sensor or filter is silent after this many of its usual intervals [1]
_SLOWEST = 2.0  # longest interval of a filter at its own rate; a longer one is silence [s]


@dataclass(frozen=True, slots=True)
class Coverage:
    """Fraction of the epochs with a solution, by block, out of the epochs at which the data allow one."""

    shares: Mapping[str, float]  # by block that is estimated, from the first answer on [1]
    waited: float  # from the first epoch asked for to the first answer [s]
    first: float | None  # the first answer [s], if it came late
    longest: tuple[float, float]  # first and last epoch of the longest run without an answer [s]
    interval: float | None = None  # of its answers, if the epochs are closer together [s]

    @property
    def share(self) -> float:
        """Fraction of the block with the fewest solutions; 1 without any, which has its own verdict."""
        return min(self.shares.values(), default=1.0)

    @property
    def enough(self) -> bool:
        """Return whether every block has a solution at all but a few epochs."""
        return self.share >= ENOUGH

    @property
    def text(self) -> str:
        """The fractions in words, rounded down."""
        begin, end = self.longest
        shares = {block: f"{math.floor(1e3 * share) / 10:g} %" for block, share in self.shares.items()}
        if len(set(shares.values())) == 1:
            text = f"answers {next(iter(shares.values()))} of the epochs asked for"
        else:
            parts = [f"{TITLES[block]} at {share}" for block, share in shares.items()]
            text = f"answers {', '.join(parts)} of the epochs asked for"
        if self.interval is not None:
            text = f"{text}, at its own rate of {1.0 / self.interval:.3g} Hz"
        late = " from its first answer on" if self.first is not None else ""
        silence = f", with the longest silence from {begin:g} to {end:g} s" if self.share < 1.0 else ""
        return text + late + silence


def measure_coverage(solution: NavSolution, data: SensorData | None) -> Coverage:
    """Return the fraction of the requested epochs with a solution, by block.

    A time at which any value of a block is not finite, or that a table does not cover, has no answer of
    it. Those do not count that :func:`find_excused` names.
    """
    t, answered = solution.t, find_answered_epochs(solution)
    if not answered.any():
        return Coverage({}, 0.0, None, (0.0, 0.0))  # that is another verdict
    first = int(np.argmax(answered))
    interval, between = find_own_rate(solution)
    counted = (np.arange(len(t)) >= first) & ~between
    excused = find_excused(solution, data)
    weight = 1.0 if interval is None else float(np.median(np.diff(t))) / interval
    shares, lost = {}, np.zeros(len(t), np.bool_)
    for block, column in VALUES.items():
        there = answered & np.isfinite(getattr(solution, column)).all(axis=1)
        if not there.any():
            continue
        asked = counted & (there | ~excused)
        missing = asked & ~there
        shares[block] = float(there.sum() / (there.sum() + weight * missing.sum()))
        lost |= missing
    begun = float(t[first]) if t[first] > t[0] + _LATE else None
    longest = find_longest(t, np.flatnonzero(lost))
    return Coverage(shares, float(t[first] - t[0]), begun, longest, interval)


def find_own_rate(solution: NavSolution) -> tuple[float | None, BoolArray]:
    """Return the interval of the answers [s], and a mask (M,) of the epochs between them.

    None and no epochs for a filter that answers each epoch, or less often than every 2 s. Epochs in a gap of
    more than 1.5 intervals are not between answers: there it is silent.
    """
    t, answered = solution.t, find_answered_epochs(solution)
    between, at = np.zeros(len(t), np.bool_), np.flatnonzero(answered)
    if len(at) < 3:
        return None, between
    gaps = np.diff(t[at])
    interval = float(np.median(gaps))
    if not _GAP * float(np.median(np.diff(t))) < interval <= _SLOWEST + SAME_INSTANT:
        return None, between
    inside = np.arange(at[0], len(t))
    gaps = np.append(gaps, t[-1] - t[at[-1]])
    short = gaps[np.searchsorted(at, inside, "right") - 1] <= _GAP * interval
    between[inside] = short & ~answered[inside]
    return interval, between


def find_longest(t: FloatArray, lost: IntArray) -> tuple[float, float]:
    """Return the first and the last epoch of the longest run of rows."""
    if not len(lost):
        return 0.0, 0.0
    runs = np.split(lost, np.flatnonzero(np.diff(lost) > 1) + 1)
    longest = max(runs, key=lambda run: float(t[run[-1]] - t[run[0]]))
    return float(t[longest[0]]), float(t[longest[-1]])


def find_excused(solution: NavSolution, data: SensorData | None) -> BoolArray:
    """Return a mask (M,) of the epochs at which a gap of the data excuses a missing solution.

    While the IMU was silent, and for a solution without attitude, which is made of fixes, while these were.
    """
    excused = np.zeros(len(solution), np.bool_)
    if data is not None:
        excused |= is_silent(solution.t, data.imu.t[data.imu.valid])
        if np.isnan(solution.q_nb).all():
            record = data.fixes if data.fixes is not None else data.observations
            if record is not None:
                excused |= is_silent(solution.t, record.t)
    return excused


def is_silent(t: FloatArray, reports: FloatArray) -> BoolArray:
    """Return a mask of the epochs t (M,) at which a sensor that reported at other epochs was silent."""
    known = np.unique(reports[np.isfinite(reports)])
    if len(known) < 2:
        return np.ones(len(t), np.bool_)
    most = _GAP * float(np.median(np.diff(known)))
    after = np.searchsorted(known, t - SAME_INSTANT)
    ends = np.concatenate([[-np.inf], known, [np.inf]])
    silent: BoolArray = ends[after + 1] - ends[after] > most
    return silent


# --- silences ---------------------------------------------------------------------------------------------


def find_silent_epochs(solution: NavSolution) -> BoolArray:
    """Return a mask (M,) of the epochs without a solution after the first, and not between its own epochs."""
    answered = find_answered_epochs(solution)
    return ~answered & (np.cumsum(answered) > 0) & ~find_own_rate(solution)[1]


def carry_on(solution: NavSolution, silent: BoolArray) -> NavSolution:
    """Return a solution with its missing epochs (M,) filled by extrapolation of the last solution.

    Position moves by the velocity of the last answer; velocity and attitude stay. No sigma is reported there.
    """
    if not silent.any():
        return solution
    given, filled = np.flatnonzero(~silent), np.flatnonzero(silent)
    number = np.searchsorted(given, filled) - 1  # of the answer before
    filled, number = filled[number >= 0], number[number >= 0]
    last = given[number]
    lla, vel_n, q_nb, cov = map(np.array, (solution.lla, solution.vel_n, solution.q_nb, solution.cov))
    until = solution.t[filled]
    lla[filled] = carry_positions(solution.t[given], lla[given], vel_n[given], number, until)
    vel_n[filled], q_nb[filled], cov[filled] = vel_n[last], q_nb[last], np.nan
    return replace(solution, lla=lla, vel_n=vel_n, q_nb=q_nb, cov=cov)


def carry_positions(
    t: FloatArray, lla: FloatArray, vel_n: FloatArray, rows: IntArray, until: FloatArray
) -> FloatArray:
    """Extrapolate positions at t (M,) from ``rows`` (K,) to the epochs ``until`` (K,); the result is (K, 3).

    By the velocity of each answer; without one, by that from the answer before it.
    """
    speed_n = vel_n[rows]
    bare = np.flatnonzero(np.isnan(speed_n).any(axis=1) & (rows > 0))
    at = rows[bare]
    with np.errstate(all="ignore"):  # a diverged solution is a result, not a warning
        speed_n[bare] = earth.difference_n(lla[at], lla[at - 1]) / (t[at] - t[at - 1])[:, None]
        moved: FloatArray = earth.displace(lla[rows], np.nan_to_num(speed_n) * (until - t[rows])[:, None])
    return moved
