"""Position and velocity of each epoch from ranges and range rates: iterated generalized least squares.

Unknowns are the position and one clock offset per satellite system (B-13, B-14), then the velocity and the
drift of the receiver's oscillator (B-14b). Every function takes whole records: a row per satellite and epoch,
and ``epoch_start`` with the first row of each epoch. Inside, epochs are solved together: their rows lie in
padded arrays (M, S), where a weight of 0 stands for a place without a satellite.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from bench.core.compilation.compiled import on_arrays
from bench.core.mathematics.arrays import BoolArray, FloatArray, IntArray
from bench.core.records.orbit_sets import LETTERS
from bench.simulation.signals.delays import find_range, range_rate_kernel
from bench.simulation.signals.fault_test import find_alarms
from bench.simulation.signals.orbits import GPS_EARTH_RATE

CLOSE = 0.1  # a step below this ends the iteration [m]; the error is its square over the range, 5e-10 m
_MOST = 20  # largest number of steps
_STEP = 4  # rows by which padded epochs grow
_TOGETHER = 512  # epochs; with 40 satellites their matrices take 7 MB
_SYSTEMS = len(LETTERS)
_UNKNOWNS = 3 + _SYSTEMS
_SINGULAR = 1e-13  # smallest determinant of a normal matrix with a unit diagonal
_MEDIAN = 0.6745  # median of the size of a standard normal variable
_ROUNDS = 10  # of new weights, `_reweight`
_KEPT, _LEFT = 1.5, 3.0  # normalized residuals of full and of no weight; Yang 2002: 1 to 1.5, 2.5 to 8
_NEXT_TO_NOTHING = 1e3  # factor on a variance that leaves a range without weight
EARTH_RADIUS = 6371e3  # [m]
SHELL = EARTH_RADIUS + 350e3  # of the ionosphere [m]; IS-GPS-200, 20.3.3.5.2.5
_NO_DECAY = 1e-6  # stands for a decay of 0: errors of satellites are independent [m]


class Shared(NamedTuple):
    """Errors that the ranges of one epoch have in common: standard deviations of each row (K,) [m].

    The errors of the ionosphere have a correlation of exp(-distance / decay) between the points where the
    signals pierce it; the error of the troposphere is one for all.
    """

    ionosphere: FloatArray
    troposphere: FloatArray
    pierce: FloatArray  # (K, 2) north and east on the shell [m], `find_pierce_points`
    decay: float  # [m]


class PositionFixes(NamedTuple):
    """Positions and clock offsets; an epoch without solution is NaN."""

    pos_e: FloatArray  # (M, 3) [m], e
    clock: FloatArray  # (M, 4) receiver clock against each system [m]; NaN if the system is not used
    cov_e: FloatArray  # (M, 3, 3) of the position [m^2], e
    steps: IntArray  # (M,) iterations
    used: BoolArray  # (K,) rows in the final solution
    residual: FloatArray  # (K,) measured minus computed [m]; NaN where not used
    normalized: FloatArray  # (K,) the same over its sd, the statistic of the w-test; NaN where untestable
    chi2: FloatArray  # (M,) weighted sum of squared residuals
    passed: BoolArray  # (M,) solved, and no fault is found among the satellites used


class VelocityFixes(NamedTuple):
    """Velocities and drift of the receiver's clock; an epoch without solution is NaN."""

    vel_e: FloatArray  # (M, 3) [m/s], e
    drift: FloatArray  # (M,) [m/s]
    cov_e: FloatArray  # (M, 3, 3) [m^2/s^2], e


def find_pierce_points(los_n: FloatArray, el: FloatArray) -> FloatArray:
    """Return the ionospheric pierce points of signals (K,): north and east (K, 2) of the receiver [m].

    The shell is taken as flat around the receiver: distances are right to 7 % at an elevation of 10 deg.
    """
    away = np.pi / 2 - el - np.arcsin(np.clip(EARTH_RADIUS / SHELL * np.cos(el), -1.0, 1.0))
    across = np.maximum(np.hypot(los_n[:, 0], los_n[:, 1]), 1e-12)
    points: FloatArray = (SHELL * away / across)[:, None] * los_n[:, :2]
    return points


class _Padded:
    """Several epochs as one array: row of each place (M, S), and mask of the places with a usable row."""

    def __init__(self, epochs: IntArray, epoch_start: IntArray, used: BoolArray) -> None:
        self.epochs = epochs  # all of one width: no bit of a fix depends on the others
        first, count = epoch_start[:-1][epochs], np.diff(epoch_start)[epochs]
        place = np.arange(max(int(_widths(count).max(initial=0)), _STEP))
        inside = place < count[:, None]
        self.rows = np.where(inside, first[:, None] + place, 0)
        self.used = inside & used[self.rows]
        width = max(int(_widths(self.used.sum(axis=1)).max(initial=0)), _STEP)
        order = np.argsort(~self.used, axis=1, kind="stable")[:, :width]  # used rows first
        self.rows = np.take_along_axis(self.rows, order, axis=1)
        self.used = np.take_along_axis(self.used, order, axis=1)

    def take(self, column: FloatArray) -> FloatArray:
        """Return the values (M, S, ...) of a column; 0 where no row is used."""
        values: FloatArray = column[self.rows]
        values[~self.used] = 0.0
        return values


def _group(epochs: IntArray, epoch_start: IntArray, used: BoolArray) -> list[IntArray]:
    """Return some epochs in groups of one width of padded rows."""
    width = _widths(_count(epoch_start, used))[epochs]
    groups = [epochs[width == one] for one in np.unique(width)]
    return [group[k : k + _TOGETHER] for group in groups for k in range(0, len(group), _TOGETHER)]


def _count(epoch_start: IntArray, used: BoolArray) -> IntArray:
    """Return the number of rows of each epoch that are used."""
    total = np.concatenate([[0], np.cumsum(used)])
    return np.asarray(total[epoch_start[1:]] - total[epoch_start[:-1]])


def _widths(count: IntArray) -> IntArray:
    """Return the number of places for a number of rows: a multiple of four."""
    return np.asarray(-(-count // _STEP) * _STEP)


def _weigh(padded: _Padded, sd: FloatArray, shared: Shared | None, spread: FloatArray) -> FloatArray:
    """Return the weight matrices (M, S, S) [1/m^2]; ``spread`` (M, S) multiplies the variance of rows."""
    free = padded.take(sd) ** 2 * spread
    M, S = free.shape
    R: Any = np.zeros((M, S, S))
    if shared is not None:
        points, above, below = (
            padded.take(c) for c in (shared.pierce, shared.ionosphere, shared.troposphere)
        )
        apart = points[:, :, None] - points[:, None]
        R = np.exp(-np.hypot(apart[..., 0], apart[..., 1]) / max(shared.decay, _NO_DECAY))
        R *= above[:, :, None] * above[:, None]
        R += below[:, :, None] * below[:, None]
    R[:, np.arange(S), np.arange(S)] += np.where(padded.used, free, 1.0)
    W: FloatArray = np.linalg.inv(R)
    W[~padded.used] = 0.0
    W.transpose(0, 2, 1)[~padded.used] = 0.0
    return W


def invert(N: FloatArray) -> tuple[FloatArray, BoolArray]:
    """Return the inverses of symmetric matrices (M, n, n), and which of them are regular."""
    scale = np.sqrt(np.maximum(np.einsum("mii->mi", N), 1e-300))
    unit = N / (scale[:, :, None] * scale[:, None])
    regular: BoolArray = np.linalg.det(unit) > _SINGULAR
    unit[~regular] = np.eye(N.shape[-1])
    return np.linalg.inv(unit) / (scale[:, :, None] * scale[:, None]), regular


class _Solution(NamedTuple):
    """Solution of M epochs with S places each."""

    x: FloatArray  # (M, 7) position and clocks
    solved: BoolArray  # (M,)
    steps: IntArray  # (M,)
    cov: FloatArray  # (M, 7, 7)
    present: BoolArray  # (M, 4) systems
    residual: FloatArray  # (M, S)
    normalized: FloatArray  # (M, S) absolute; 0 where it says nothing
    share: FloatArray  # (M, S) by which a meter of a range changes it [1/m]; 0 where it says nothing
    chi2: FloatArray  # (M,)
    spare: IntArray  # (M,) redundancy


def _iterate(
    padded: _Padded, W: FloatArray, x: FloatArray, sat: FloatArray, measured: FloatArray, system: IntArray,
    rate: float, close: float,
) -> _Solution:  # fmt: skip
    """Solve by Gauss-Newton from x (M, 7); weights W are (M, S, S), or (M, S) without correlation."""
    M, S = padded.rows.shape
    pos, z = padded.take(sat), padded.take(measured)
    pos[~padded.used] = 4e7  # no direction is undefined
    which = np.where(padded.used, system[padded.rows], -1)
    one = np.stack([which == k for k in range(_SYSTEMS)], axis=-1)
    present = np.asarray(one.any(axis=1))
    absent = np.zeros((M, _UNKNOWNS))
    absent[:, 3:] = ~present
    spare = padded.used.sum(axis=1) - 3 - present.sum(axis=1)
    x, going = x.copy(), spare >= 0
    solved, steps = np.zeros(M, bool), np.zeros(M, np.int64)
    H = np.empty((M, S, _UNKNOWNS))
    H[:, :, 3:] = one
    residual, cov = np.zeros((M, S)), np.zeros((M, _UNKNOWNS, _UNKNOWNS))
    full = W.ndim == 3

    def weigh(A: FloatArray, at: BoolArray) -> FloatArray:
        return W[at] @ A if full else W[at][:, :, None] * A

    for _ in range(_MOST):
        if not going.any():
            break
        px, py, pz = (x[going, k, None] for k in range(3))
        q = pos[going]
        distance, ex, ey, ez = find_range(q[..., 0], q[..., 1], q[..., 2], px, py, pz, rate)
        left = (
            np.where(padded.used[going], z[going] - distance, 0.0) - (one[going] @ x[going, 3:, None])[..., 0]
        )
        A = H[going]
        for k, e in enumerate((ex, ey, ez)):
            A[:, :, k] = np.where(padded.used[going], -e, 0.0)
        WA = weigh(A, going)
        N = A.transpose(0, 2, 1) @ WA
        N[:, np.arange(_UNKNOWNS), np.arange(_UNKNOWNS)] += absent[going]
        inverse, regular = invert(N)
        step = (inverse @ (WA.transpose(0, 2, 1) @ left[..., None]))[..., 0]
        x[going] += step
        steps[going] += 1
        H[going] = A
        # the last step updates the residuals to first order, with an error of its square over the range
        residual[going] = left - (A @ step[..., None])[..., 0]
        cov[going] = inverse
        done = regular & (np.linalg.norm(step[:, :3], axis=1) < close)
        at = np.flatnonzero(going)
        solved[at[done]] = True
        going[at[done | ~regular | ~np.isfinite(step).all(axis=1)]] = False
    normalized, share, chi2 = np.zeros((M, S)), np.zeros((M, S)), np.full(M, np.nan)
    if full:
        WH = weigh(H, np.ones(M, bool))
        weighted = (W @ residual[..., None])[..., 0]
        free = np.einsum("mss->ms", W) - np.einsum("msi,msi->ms", WH @ cov, WH)
        told = padded.used & (free > 1e-6 * np.einsum("mss->ms", W))
        share = np.sqrt(np.where(told, free, 0.0))
        normalized = np.where(told, np.abs(weighted) / np.where(told, share, 1.0), 0.0)
        chi2 = np.maximum(np.einsum("ms,ms->m", residual, weighted), 0.0)
    return _Solution(x, solved, steps, cov, present, residual, normalized, share, chi2, spare)


def _reweight(normalized: FloatArray, used: BoolArray, final: bool) -> FloatArray:
    """Return the variance factor of each row (M, S): Huber's factor at first, then the factor of IGG III.

    The first grows with the residual and moves the solution, bent by faults, towards the one that most ranges
    agree with; the second has no bound. It takes residuals relative to their median, if the median is larger
    than it would be without faults.

    Yang, Song, Xu, Robust filter for correlated observations based on bifactor equivalent weights,
    Journal of Geodesy 76 (2002) 353-358.
    """
    if not final:
        return np.asarray(np.maximum(normalized / _KEPT, 1.0))
    median = np.nanmedian(np.where(used, normalized, np.nan), axis=1, keepdims=True)
    size = np.maximum(normalized / np.maximum(median / _MEDIAN, 1.0), _KEPT)
    factor = _KEPT / size * np.clip((_LEFT - size) / (_LEFT - _KEPT), 1e-4, 1.0) ** 2
    return 1.0 / factor


def _make_unsolved(M: int, K: int) -> PositionFixes:
    """Return fixes of M epochs and K ranges before they are solved."""
    return PositionFixes(
        pos_e=np.full((M, 3), np.nan),
        clock=np.full((M, _SYSTEMS), np.nan),
        cov_e=np.full((M, 3, 3), np.nan),
        steps=np.zeros(M, np.int64),
        used=np.zeros(K, bool),
        residual=np.full(K, np.nan),
        normalized=np.full(K, np.nan),
        chi2=np.full(M, np.nan),
        passed=np.zeros(M, bool),
    )


def solve_positions(
    epoch_start: IntArray,
    sat_pos_e: FloatArray,
    pseudorange: FloatArray,
    sd: FloatArray,
    system: IntArray,
    *,
    use: BoolArray | None = None,
    start_e: FloatArray | None = None,
    close: float = CLOSE,
    shared: Shared | None = None,
    false_alarm: float = 0.0,
    robust: bool = False,
    rough: bool = False,
    one_clock: bool = False,
    sagnac: bool = True,
) -> PositionFixes:
    """Solve the position of every epoch from corrected pseudoranges (B-12 to B-14).

    Parameters
    ----------
    epoch_start : (M + 1,) array of int
        First row of each epoch, and the number of rows.
    sat_pos_e : (K, 3) array
        Satellites, Earth-fixed at transmission [m].
    pseudorange : (K,) array
        Corrected for satellite clock and atmosphere [m]; rows that are not finite are not used.
    sd : (K,) array
        Standard deviation of each pseudorange [m], without what is ``shared``.
    system : (K,) array of int
        Code of `bench.core.records.orbit_sets`; each has its own clock offset.
    use : (K,) array of bool or None
        Rows that may be used; None: all.
    start_e : (M, 3) array or None
        First guesses [m]. If NaN or None: the center of the Earth.
    close : float
        A step shorter than this ends the iteration [m]; the error is its square over the range.
    shared : Shared or None
        Errors that ranges have in common; None: they are independent.
    false_alarm : float
        Chance that a sound epoch loses a satellite. While a fault is found, its satellite is left out; an
        epoch where one is still found has not passed. 0: nothing is tested.
    robust : bool
        Give large normalized residuals less weight before they are tested.
    rough : bool
        Weights alone, no statistics: for a first guess.
    one_clock : bool
        Estimate one clock offset for all systems.
    sagnac : bool
        Rotate the satellites with the Earth during the travel time.

    Notes
    -----
    The normalized residual of row i is ``(W v)_i / sqrt((W - W H (H' W H)^-1 H' W)_ii)``, W the inverse of
    the covariance of the ranges and v their residuals: the w-test of Baarda for correlated measurements
    (Teunissen, Testing Theory, 2006). :func:`bench.simulation.signals.fault_test.find_alarms`
    finds the fault.

    At most half of the redundant satellites are left out, with ``robust`` too; an epoch that needs more has
    not passed. With n satellites and u unknowns k wrong ranges and u - 1 sound ones can agree with a false
    position, as n - k agree with the true one: the truth has the most only while n - u >= 2 k.
    """
    M, K = len(epoch_start) - 1, len(pseudorange)
    used = np.isfinite(pseudorange) & np.isfinite(sat_pos_e).all(axis=1) & np.isfinite(sd)
    if use is not None:
        used &= use
    fixes = _make_unsolved(M, K)
    rate = GPS_EARTH_RATE if sagnac else 0.0
    begin = np.zeros((M, _UNKNOWNS))
    if start_e is not None:
        known = np.isfinite(start_e).all(axis=1)
        begin[known, :3] = start_e[known]
    column = np.zeros_like(system) if one_clock else system
    waiting, whole = _group(np.arange(M), epoch_start, used), _count(epoch_start, used)
    while waiting:
        padded = _Padded(waiting.pop(), epoch_start, used)
        weights = np.where(padded.used, 1.0 / np.where(padded.used, sd[padded.rows], 1.0) ** 2, 0.0)
        x, weightless = begin[padded.epochs], np.zeros(len(padded.epochs), np.int64)
        far: BoolArray = np.asarray(~x[:, :3].any(axis=1))
        if rough or far.any():
            found = _iterate(
                padded, weights, x, sat_pos_e, pseudorange, column, rate, close if rough else 1e3
            )
            x = np.where(far[:, None], found.x, x)
        if not rough:
            spread = np.ones(padded.rows.shape)
            W = _weigh(padded, sd, shared, spread)
            first = np.where(far, found.steps, 0) if far.any() else 0
            found = _iterate(padded, W, x, sat_pos_e, pseudorange, column, rate, close)
            found = found._replace(steps=found.steps + first)
            for step in range(_ROUNDS if robust else 0):
                final = step >= _ROUNDS // 2
                spread = _reweight(found.normalized * np.sqrt(spread), padded.used, final)
                W = _weigh(padded, sd, shared, spread)
                found = _iterate(padded, W, found.x, sat_pos_e, pseudorange, column, rate, close)
            light = padded.used & (spread > _NEXT_TO_NOTHING)
            used[padded.rows[light]], weightless = False, light.sum(axis=1)
        kept = padded.used.sum(axis=1) - weightless
        left, spare = whole[padded.epochs] - kept, found.spare - weightless
        passed = found.solved & (rough | (spare >= left))
        if false_alarm > 0 and not rough:
            alarm, worst = find_alarms(found.normalized, found.share, false_alarm)
            alarm &= found.solved
            passed &= ~alarm
            again = np.flatnonzero(alarm & (spare >= left + 2))  # the next one keeps what is said below
            if len(again):
                used[padded.rows[again, worst[again]]] = False
                begin[padded.epochs[again]] = found.x[again]
                waiting += _group(padded.epochs[again], epoch_start, used)
        _store(fixes, padded, found, passed, one_clock)
    fixes.used[~used] = False
    fixes.residual[~fixes.used] = np.nan
    fixes.normalized[~fixes.used] = np.nan
    return fixes


def _store(
    fixes: PositionFixes, padded: _Padded, found: _Solution, passed: BoolArray, one_clock: bool
) -> None:
    """Store the results of some epochs, over earlier results."""
    at, good = padded.epochs, found.solved
    fixes.pos_e[at] = np.where(good[:, None], found.x[:, :3], np.nan)
    fixes.clock[at] = np.where(good[:, None] & found.present, found.x[:, 3:], np.nan)
    if one_clock:
        fixes.clock[at, 1:] = np.nan
    fixes.cov_e[at] = np.where(good[:, None, None], found.cov[:, :3, :3], np.nan)
    fixes.steps[at] += found.steps
    fixes.chi2[at] = found.chi2
    fixes.passed[at] = passed
    fixes.used[padded.rows[padded.used]] = np.broadcast_to(good[:, None], padded.used.shape)[padded.used]
    fixes.residual[padded.rows[padded.used]] = found.residual[padded.used]
    told = np.where(found.normalized > 0, found.normalized, np.nan)
    fixes.normalized[padded.rows[padded.used]] = told[padded.used]


def solve_velocities(
    epoch_start: IntArray,
    sat_pos_e: FloatArray,
    sat_vel_e: FloatArray,
    range_rate: FloatArray,
    sd: FloatArray,
    used: BoolArray,
    pos_e: FloatArray,
    *,
    sagnac: bool = True,
) -> VelocityFixes:
    """Solve the velocity of every epoch from range rates corrected for satellite clock drift (B-14b).

    Parameters
    ----------
    epoch_start, sat_pos_e, sd
        As in :func:`solve_positions`; sd [m/s].
    sat_vel_e : (K, 3) array
        [m/s], e at transmission.
    range_rate : (K,) array
        [m/s]; NaN rows are not used. All systems share the drift of the receiver's oscillator.
    used : (K,) array of bool
        Rows to use.
    pos_e : (M, 3) array
        Position of each epoch [m]; an epoch with NaN has no velocity.
    """
    M, rate = len(epoch_start) - 1, GPS_EARTH_RATE if sagnac else 0.0
    fixes = VelocityFixes(np.full((M, 3), np.nan), np.full(M, np.nan), np.full((M, 3, 3), np.nan))
    epoch = np.repeat(np.arange(M), np.diff(epoch_start))
    rows = np.flatnonzero(used & np.isfinite(range_rate) & np.isfinite(pos_e[epoch, 0]))
    if len(rows) == 0:
        return fixes
    epoch, sat, vel = epoch[rows], sat_pos_e[rows].T, sat_vel_e[rows].T
    distance, *e = find_range(*sat, *pos_e[epoch].T, rate)
    a, b = on_arrays(range_rate_kernel)(*sat, *vel, *pos_e[epoch].T, *e, distance, rate)
    H = np.column_stack([-e[0] / b, -e[1] / b, -e[2] / b, np.ones(len(rows))])
    left, w = range_rate[rows] - a / b, 1.0 / sd[rows] ** 2
    N, g = np.zeros((M, 4, 4)), np.zeros((M, 4))
    for i in range(4):
        g[:, i] = np.bincount(epoch, w * H[:, i] * left, M)
        for j in range(i + 1):
            N[:, i, j] = N[:, j, i] = np.bincount(epoch, w * H[:, i] * H[:, j], M)
    enough = np.bincount(epoch, minlength=M) >= 4
    inverse, regular = invert(N[enough])
    at = np.flatnonzero(enough)[regular]
    found = (inverse @ g[enough][..., None])[regular, :, 0]
    fixes.vel_e[at], fixes.drift[at], fixes.cov_e[at] = found[:, :3], found[:, 3], inverse[regular, :3, :3]
    return fixes
