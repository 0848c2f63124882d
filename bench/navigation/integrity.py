"""Is a measurement sound? Tests of an innovation sub-vector, and how long an uncorrected navigator may run.

Sources: A-5.4.6 and A-5.4.7 (innovations), A-5.4.T (tolerance), A-5.4.10 (correction period). Pure functions;
the estimators decide what to do with the answer.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from bench.arrays import BoolArray, FloatArray
from bench.data import GnssFixes
from bench.earth import matrix_en, to_ecef
from bench.specs import GnssSpec

WINDOWS = (10.0, 30.0, 100.0)
"""Times over which positions are compared with velocities [s]; a slow ramp shows over a long one."""
_NEAR = 5  # fixes whose median stands for one, so that a bad one that passed does no harm
_JERK = 10.0  # [m/s^3]: what the sum of velocities a step apart leaves out
SCHULER_RADIUS = 6_371_000.0  # sphere of the Schuler loop, R3 [m], equations 1.5
SCHULER_GRAVITY = 9.80665  # g0 [m/s^2], equations section 4


def nis(y: ArrayLike, S: ArrayLike) -> float:
    """Return the normalized innovation squared y' S^-1 y (A-5.4.7), chi-square with len(y) degrees.

    Examples
    --------
    >>> nis([2.0, 3.0], [[4.0, 0.0], [0.0, 1.0]])
    10.0
    """
    y = np.asarray(y, float)
    return float(y @ np.linalg.solve(np.asarray(S, float), y))


def nis_limit(size: int, false_alarm: float) -> float:
    """Return the NIS a sound sub-vector of this size exceeds with the given probability.

    Examples
    --------
    >>> [round(nis_limit(3, p), 2) for p in (1e-2, 1e-3, 1e-4, 1e-5)]  # A-5.4.7
    [11.34, 16.27, 21.11, 25.9]
    """
    from scipy.special import gammainccinv

    return float(2.0 * gammainccinv(0.5 * size, false_alarm))


def trace_ratio(y: ArrayLike, S: ArrayLike) -> float:
    """Return Sp(y y') / Sp(S), the source's test of a sub-vector (A-5.4.7); all components in one unit.

    It is blind on the accurate axis of an S with one dominant axis: :func:`nis` is the test to rely on.
    """
    y = np.asarray(y, float)
    return float(y @ y / np.trace(np.asarray(S, float)))


def tolerance(
    interval: float, sd: ArrayLike, *, order: int, max_acceleration: float, sigmas: float
) -> FloatArray:
    """Return how far a fix may lie from the last accepted one carried on by the INS (A-5.4.T).

    Parameters
    ----------
    interval : float
        Time since the last accepted fix [s].
    sd : (3,) array
        Standard deviation of the difference of two fixes [m] or [m/s].
    order : int
        Integrals of acceleration: 2 for position, 1 for velocity.
    max_acceleration : float
        What the aircraft can do unnoticed [m/s^2].
    sigmas : float
        Multiple of ``sd`` granted to the receiver.
    """
    reach = max_acceleration * interval if order == 1 else 0.5 * max_acceleration * interval**2
    bound: FloatArray = reach + sigmas * np.asarray(sd, float)
    return bound


def find_moved_fixes(fixes: GnssFixes, variance: FloatArray, gnss: GnssSpec, false_alarm: float) -> BoolArray:
    """Return which positions (M,) moved otherwise than the velocities of the receiver say.

    The way from an earlier fix less the sum of the velocities in between has to fit its variance: by white
    and Markov errors of both ends and of the velocities. The earlier fix is the median of the last few that
    passed, and of the first within each of `WINDOWS`; one that failed is no measure, so a ramp is told until
    it ends. Fixes without velocity pass; the test begins anew after a gap.

    Parameters
    ----------
    fixes : GnssFixes
        In order of time.
    variance : (M, 6) array
        White variances of position [m^2] and velocity [m^2/s^2], n.
    gnss : GnssSpec
        For the Markov errors.
    false_alarm : float
        Chance that a sound fix is told.
    """
    moved = np.zeros(len(fixes), np.bool_)
    limit = nis_limit(3, false_alarm / (len(WINDOWS) + 1))
    rows = np.flatnonzero(fixes.valid & np.isfinite(np.hstack([fixes.lla, fixes.vel_n])).all(axis=1))
    steps = np.diff(fixes.t[rows])
    usual = float(np.median(steps)) if len(steps) else 0.0
    for part in np.split(rows, np.flatnonzero(steps > 2.5 * usual) + 1):
        if len(part) > 1:
            moved[part] = _find_moved(fixes.take(part), variance[part], gnss, limit)
    return moved


def _find_moved(fixes: GnssFixes, variance: FloatArray, gnss: GnssSpec, limit: float) -> BoolArray:
    """Return what :func:`find_moved_fixes` does, of fixes without a gap."""
    t, dt = fixes.t, np.diff(fixes.t)
    C_en = matrix_en(*fixes.lla[:, :2].T)
    vel_e, pos_e = np.einsum("kij,kj->ki", C_en, fixes.vel_n), to_ecef(fixes.lla)
    change = np.diff(vel_e, axis=0)
    way = np.cumsum(0.5 * (vel_e[1:] + vel_e[:-1]) * dt[:, None], axis=0)
    rest = pos_e - pos_e[0]  # position less the sum of velocities, by Euler and Maclaurin
    rest[1:] += change * dt[:, None] / 12.0 - way
    rest_n = rest @ C_en[0]
    speed = float(np.linalg.norm(fixes.vel_n, axis=1).mean())
    decay = gnss.pos_decay_time + speed * gnss.pos_decay_distance
    markov = np.square([gnss.pos_h_markov_sd, gnss.pos_h_markov_sd, gnss.pos_v_markov_sd])
    jump = np.square([gnss.pos_h_jump_sd, gnss.pos_h_jump_sd, gnss.pos_v_jump_sd])
    left = np.full(len(t), _JERK * float(np.median(dt)) ** 3 / 24.0)  # by the sum of velocities [m]
    bend = np.linalg.norm(np.diff(change, axis=0), axis=1) * dt[1:] / 12.0
    left[1:-1] += bend
    left[2:] += bend
    ends, slow = variance[:, :3] + jump + np.square(left)[:, None], gnss.vel_decay_time
    summed = np.cumsum(np.vstack([np.zeros(3), variance[1:, 3:] * np.square(dt)[:, None]]), axis=0)

    def passes(k: int, rest_0: FloatArray, j: int) -> bool:
        T = abs(float(t[k] - t[j]))
        wander = T * T if slow * T < 1e-3 else 2.0 * (slow * T - 1.0 + np.exp(-slow * T)) / slow**2
        var = ends[k] + ends[j] + 2.0 * markov * -np.expm1(-decay * T)
        var += np.abs(summed[k] - summed[j]) + gnss.vel_markov_sd**2 * wander
        return bool(np.sum(np.square(rest_n[k] - rest_0) / var) <= limit)

    first = int(np.searchsorted(t, t[0] + WINDOWS[0]))
    middle = np.median(rest_n[:first], axis=0)
    good = [k for k in range(first) if passes(k, middle, first // 2)] or [0]
    moved = np.ones(len(t), np.bool_)
    moved[good] = False
    for k in range(first, len(t)):
        begins = np.searchsorted(t[good], t[k] - np.array(WINDOWS))
        for b in {min(int(b), max(len(good) - _NEAR, 0)) for b in (*begins, len(good))}:
            some = good[b : b + _NEAR]
            if not passes(k, np.median(rest_n[some], axis=0), some[len(some) // 2]):
                break
        else:
            good.append(k)
            moved[k] = False
    return moved


def correction_period(admissible: float, start: float, gyro: float, accel: float) -> float:
    """Return the time [s] an INS may run before its attitude error can exceed ``admissible`` [rad].

    The bound of A-5.4.10, for T far below 84.4 min (the Schuler feedback, left out, has the opposite sign):

        start + gyro T + ((start g + accel) T^2 / 2 + g gyro T^3 / 6) / R

    with ``start`` the error the correction leaves [rad], ``gyro`` drift [rad/s] and ``accel`` bias [m/s^2].
    Zero when ``start`` exceeds ``admissible``, infinite when nothing makes the error grow.

    Examples
    --------
    >>> deg = np.pi / 180  # 10 deg/h, 0.5 deg, 5 mg, limit 1 deg (A-5.4.10)
    >>> round(correction_period(1.0 * deg, 0.5 * deg, 10 / 3600 * deg, 5e-3 * 9.80665), 1)
    172.2
    """
    if admissible <= start:
        return 0.0
    g, R = SCHULER_GRAVITY, SCHULER_RADIUS
    roots = np.roots([g * gyro / (6.0 * R), (start * g + accel) / (2.0 * R), gyro, start - admissible])
    positive = roots.real[(np.abs(roots.imag) < 1e-9 * np.abs(roots)) & (roots.real > 0)]
    return float(positive.min()) if len(positive) else np.inf
