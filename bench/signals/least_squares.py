"""Position and velocity of each epoch from ranges and range rates: iterated weighted least squares.

Unknowns are the position and one clock offset per satellite system (B-13, B-14), then the velocity and the
drift of the receiver's oscillator (B-14b). Every function takes whole records: a row per satellite and epoch,
and ``epoch_start`` with the first row of each epoch.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from bench.arrays import BoolArray, FloatArray, IntArray
from bench.compiled import kernel
from bench.signals.delays import range_kernel, range_rate_kernel
from bench.signals.orbits import GPS_EARTH_RATE

CLOSE = 0.1  # a step below this ends the iteration [m]; the error is its square over the range, 5e-10 m
_MOST = 20  # largest number of steps


class PositionFixes(NamedTuple):
    """Positions and clock offsets; an epoch without solution is NaN."""

    pos_e: FloatArray  # (M, 3) [m], e
    clock: FloatArray  # (M, 2) receiver clock against each system [m]; NaN if the system is not used
    cov_e: FloatArray  # (M, 3, 3) of the position [m^2], e
    steps: IntArray  # (M,) iterations
    used: BoolArray  # (K,) rows in the final solution
    residual: FloatArray  # (K,) measured minus computed [m]; NaN where not used
    chi2: FloatArray  # (M,) weighted sum of squared residuals
    passed: BoolArray  # (M,) solved, and chi2 below its threshold


class VelocityFixes(NamedTuple):
    """Velocities and drift of the receiver's clock; an epoch without solution is NaN."""

    vel_e: FloatArray  # (M, 3) [m/s], e
    drift: FloatArray  # (M,) [m/s]
    cov_e: FloatArray  # (M, 3, 3) [m^2/s^2], e


@kernel
def inverse_kernel(A: FloatArray, n: int, inverse: FloatArray) -> bool:
    """Invert the symmetric positive definite upper-left (n, n) of A through its Cholesky factor.

    ``A`` is overwritten. Return False if it is not positive definite to working precision.
    """
    for i in range(n):
        scale = A[i, i]
        for j in range(i):
            s = A[i, j]
            for m in range(j):
                s -= A[i, m] * A[j, m]
            A[i, j] = s / A[j, j]
        s = A[i, i]
        for m in range(i):
            s -= A[i, m] * A[i, m]
        if not s > 1e-12 * scale:
            return False
        A[i, i] = np.sqrt(s)
    for i in range(n):  # inverse of the factor, into the upper triangle of ``inverse``
        inverse[i, i] = 1.0 / A[i, i]
        for j in range(i):
            s = 0.0
            for m in range(j, i):
                s -= A[i, m] * inverse[j, m]
            inverse[j, i] = s / A[i, i]
    for i in range(n):
        for j in range(i, n):
            s = 0.0
            for m in range(j, n):
                s += inverse[i, m] * inverse[j, m]
            A[i, j] = s
    for i in range(n):
        for j in range(i, n):
            inverse[i, j] = A[i, j]
            inverse[j, i] = A[i, j]
    return True


@kernel
def count_kernel(a: int, b: int, system: IntArray, used: BoolArray, one_clock: bool) -> tuple[int, int, int]:
    """Count the used rows from a to b; with 1 or 0 for the clock of GPS (or the only one) and of GLONASS."""
    count, first, second = 0, 0, 0
    for k in range(a, b):
        if used[k]:
            count += 1
            if system[k] == 0 or one_clock:
                first = 1
            else:
                second = 1
    return count, first, second


@kernel
def _normal_kernel(
    a: int, b: int, sat: FloatArray, measured: FloatArray, sd: FloatArray, column: IntArray, used: BoolArray,
    rate: float, x: FloatArray, N: FloatArray, g: FloatArray, design: FloatArray, residual: FloatArray,
) -> float:  # fmt: skip
    """Fill the lower normal matrix N and right side g at x (5,) [m]; return the weighted sum of squares."""
    N[:] = 0.0
    g[:] = 0.0
    total = 0.0
    for k in range(a, b):
        if not used[k]:
            continue
        distance, ex, ey, ez = range_kernel(sat[k, 0], sat[k, 1], sat[k, 2], x[0], x[1], x[2], rate)
        c = column[k]
        res = measured[k] - distance - x[c]
        residual[k] = res
        design[k, 0], design[k, 1], design[k, 2] = -ex, -ey, -ez
        w = 1.0 / (sd[k] * sd[k])
        wx, wy, wz = w * ex, w * ey, w * ez
        total += w * res * res
        N[0, 0] += wx * ex
        N[1, 0] += wy * ex
        N[1, 1] += wy * ey
        N[2, 0] += wz * ex
        N[2, 1] += wz * ey
        N[2, 2] += wz * ez
        for i, weighted in enumerate((wx, wy, wz)):
            N[c, i] -= weighted
            g[i] -= weighted * res
        N[c, c] += w
        g[c] += w * res
    return total


@kernel
def _position_kernel(
    epoch_start: IntArray, sat: FloatArray, measured: FloatArray, sd: FloatArray, system: IntArray,
    one_clock: bool, rate: float, start: FloatArray, close: float, threshold: FloatArray,
    N: FloatArray, inverse: FloatArray, design: FloatArray, column: IntArray,
    pos: FloatArray, clock: FloatArray, cov: FloatArray, steps: IntArray, used: BoolArray,
    residual: FloatArray, chi2: FloatArray, passed: BoolArray, work: FloatArray,
) -> None:  # fmt: skip
    """Solve every epoch; ``used`` marks the rows that may be used and, on return, the rows used.

    ``threshold`` (dof,) limits the weighted sum of squares; if it is empty, nothing is tested or excluded. An
    epoch starts from its row of ``start``, or if that is NaN from the epoch before, or from the centre of the
    Earth. The last step updates the residuals to first order, with an error of its square over the range.
    ``work`` (3, 5) holds zeros.
    """
    x, g, dx = work[0], work[1], work[2]
    for m in range(epoch_start.shape[0] - 1):
        a, b = epoch_start[m], epoch_start[m + 1]
        steps[m] = 0
        solved = False
        if not np.isnan(start[m, 0]):
            for i in range(3):
                x[i] = start[m, i]
            x[3:] = 0.0  # no bit of a fix depends on the epochs before it
        while True:
            count, first, second = count_kernel(a, b, system, used, one_clock)
            n = 3 + first + second
            if count < n:
                break
            for k in range(a, b):
                column[k] = 4 if (first and system[k] != 0 and not one_clock) else 3
            solved = False
            for _ in range(_MOST):
                total = _normal_kernel(
                    a, b, sat, measured, sd, column, used, rate, x, N, g, design, residual
                )  # fmt: skip
                steps[m] += 1
                if not inverse_kernel(N, n, inverse):
                    break
                length = 0.0
                for i in range(n):
                    dx[i] = 0.0
                    for j in range(n):
                        dx[i] += inverse[i, j] * g[j]
                    x[i] += dx[i]
                    total -= dx[i] * g[i]
                    if i < 3:
                        length += dx[i] * dx[i]
                if length < close * close:
                    solved = True
                    break
            if not solved:
                break
            chi2[m] = max(total, 0.0)
            for k in range(a, b):
                if used[k]:
                    residual[k] -= dx[column[k]]
                    for i in range(3):
                        residual[k] -= design[k, i] * dx[i]
            dof = count - n
            if threshold.shape[0] == 0 or dof == 0 or chi2[m] <= threshold[min(dof, threshold.shape[0] - 1)]:
                passed[m] = True
                break
            if dof < 2:
                break
            worst, largest = -1, 0.0
            for k in range(a, b):
                if used[k]:
                    c = column[k]
                    spread = inverse[c, c]
                    for i in range(3):
                        spread += 2.0 * design[k, i] * inverse[i, c]
                        for j in range(3):
                            spread += design[k, i] * inverse[i, j] * design[k, j]
                    free = sd[k] * sd[k] - spread
                    if free > 1e-6 * sd[k] * sd[k]:
                        size = residual[k] * residual[k] / free
                        if size > largest:
                            worst, largest = k, size
            if worst < 0:
                break
            used[worst] = False
            residual[worst] = np.nan
        if solved:
            for i in range(3):
                pos[m, i] = x[i]
                for j in range(3):
                    cov[m, i, j] = inverse[i, j]
            if first:
                clock[m, 0] = x[3]
            if second:
                clock[m, 1] = x[4] if first else x[3]
        else:
            x[:] = 0.0
            for k in range(a, b):
                used[k] = False
                residual[k] = np.nan


@kernel
def _velocity_kernel(
    epoch_start: IntArray, sat: FloatArray, sat_vel: FloatArray, measured: FloatArray, sd: FloatArray,
    used: BoolArray, rate: float, pos: FloatArray, N: FloatArray, inverse: FloatArray,
    vel: FloatArray, drift: FloatArray, cov: FloatArray, work: FloatArray,
) -> None:  # fmt: skip
    g, h = work[0], work[1]
    for m in range(epoch_start.shape[0] - 1):
        N[:] = 0.0
        g[:] = 0.0
        count = 0
        px, py, pz = pos[m, 0], pos[m, 1], pos[m, 2]
        for k in range(epoch_start[m], epoch_start[m + 1]):
            if not used[k] or np.isnan(measured[k]):
                continue
            count += 1
            distance, ex, ey, ez = range_kernel(sat[k, 0], sat[k, 1], sat[k, 2], px, py, pz, rate)
            a, b = range_rate_kernel(
                sat[k, 0], sat[k, 1], sat[k, 2], sat_vel[k, 0], sat_vel[k, 1], sat_vel[k, 2],
                px, py, pz, ex, ey, ez, distance, rate,
            )  # fmt: skip
            h[0], h[1], h[2], h[3] = -ex / b, -ey / b, -ez / b, 1.0
            res = measured[k] - a / b
            w = 1.0 / (sd[k] * sd[k])
            for i in range(4):
                g[i] += w * h[i] * res
                for j in range(i + 1):
                    N[i, j] += w * h[i] * h[j]
        if count < 4 or np.isnan(px) or not inverse_kernel(N, 4, inverse):
            continue
        for i in range(3):
            vel[m, i] = 0.0
            for j in range(4):
                vel[m, i] += inverse[i, j] * g[j]
            for j in range(3):
                cov[m, i, j] = inverse[i, j]
        drift[m] = 0.0
        for j in range(4):
            drift[m] += inverse[3, j] * g[j]


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
    threshold: FloatArray | None = None,
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
        Standard deviation of each pseudorange [m].
    system : (K,) array of int
        0 GPS, 1 GLONASS; each has its own clock offset.
    use : (K,) array of bool or None
        Rows that may be used; None: all.
    start_e : (M, 3) array or None
        First guesses [m]. If NaN or None: the epoch before, or the centre of the Earth for the first epoch.
    close : float
        A step shorter than this ends the iteration [m]; the error is its square over the range.
    threshold : (D,) array or None
        Largest weighted sum of squared residuals by degrees of freedom, see :func:`compute_thresholds`. While
        it is exceeded, the satellite with the largest normalised residual is excluded, which needs two
        redundant satellites. None: no test.
    one_clock : bool
        Estimate one clock offset for all systems.
    sagnac : bool
        Rotate the satellites with the Earth during the travel time.
    """
    M, K = len(epoch_start) - 1, len(pseudorange)
    used = np.isfinite(pseudorange) & np.isfinite(sat_pos_e[:, 0])
    if use is not None:
        used &= use
    fixes = PositionFixes(
        pos_e=np.full((M, 3), np.nan),
        clock=np.full((M, 2), np.nan),
        cov_e=np.full((M, 3, 3), np.nan),
        steps=np.zeros(M, np.int64),
        used=used,
        residual=np.full(K, np.nan),
        chi2=np.full(M, np.nan),
        passed=np.zeros(M, bool),
    )
    start = np.full((M, 3), np.nan) if start_e is None else np.ascontiguousarray(start_e, float)
    bounds, rate = np.empty(0) if threshold is None else threshold, GPS_EARTH_RATE if sagnac else 0.0
    epochs, systems = (np.ascontiguousarray(a, np.int64) for a in (epoch_start, system))
    sat, measured, sds = (np.ascontiguousarray(a) for a in (sat_pos_e, pseudorange, sd))
    N, inverse, design, column = np.empty((5, 5)), np.empty((5, 5)), np.empty((K, 3)), np.empty(K, np.int64)
    _position_kernel(
        epochs, sat, measured, sds, systems, one_clock, rate, start, close, bounds,
        N, inverse, design, column, *fixes, np.zeros((3, 5)),
    )  # fmt: skip
    return fixes


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
        [m/s]; NaN rows are not used. Both systems share the drift of the receiver's oscillator.
    used : (K,) array of bool
        Rows to use.
    pos_e : (M, 3) array
        Position of each epoch [m]; an epoch with NaN has no velocity.
    """
    M = len(epoch_start) - 1
    fixes = VelocityFixes(np.full((M, 3), np.nan), np.full(M, np.nan), np.full((M, 3, 3), np.nan))
    columns = (sat_pos_e, sat_vel_e, range_rate, sd, pos_e)
    sat, sat_vel, measured, sds, pos = (np.ascontiguousarray(a) for a in columns)
    rate, N, inverse = GPS_EARTH_RATE if sagnac else 0.0, np.empty((5, 5)), np.empty((5, 5))
    epochs, rows = np.ascontiguousarray(epoch_start, np.int64), np.ascontiguousarray(used)
    work = np.zeros((2, 5))
    _velocity_kernel(epochs, sat, sat_vel, measured, sds, rows, rate, pos, N, inverse, *fixes, work)
    return fixes


def compute_thresholds(false_alarm: float, most: int = 60) -> FloatArray:
    """Return the chi-square thresholds (most + 1,) for 0 to ``most`` degrees of freedom.

    ``false_alarm`` is the probability that a chi-square variable exceeds its threshold.

    Examples
    --------
    >>> print(np.round(compute_thresholds(1e-3)[[1, 4]], 2))
    [10.83 18.47]
    """
    from scipy.special import gammainccinv

    bounds: FloatArray = 2 * gammainccinv(np.arange(most + 1) / 2, false_alarm)
    bounds[0] = np.inf
    return bounds
