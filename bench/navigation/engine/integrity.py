"""Tests of an innovation sub-vector, and the longest time without corrections.

Sources: A-5.4.6 and A-5.4.7 (innovations), A-5.4.T (tolerance), A-5.4.10 (correction period). Pure functions;
the filters decide what to do with the answer.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from bench.core.mathematics.arrays import FloatArray
from bench.core.mathematics.units import STANDARD_GRAVITY

SCHULER_RADIUS = 6_371_000.0  # sphere of the Schuler loop, R3 [m], equations 1.5


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
    """Return the tolerance of a fix to the last accepted fix, propagated by the INS (A-5.4.T).

    Parameters
    ----------
    interval : float
        Time since the last accepted fix [s].
    sd : (3,) array
        Standard deviation of the difference of two fixes [m] or [m/s].
    order : int
        Integrals of acceleration: 2 for position, 1 for velocity.
    max_acceleration : float
        What the aircraft can do undetected [m/s^2].
    sigmas : float
        Multiple of ``sd`` granted to the receiver.
    """
    reach = max_acceleration * interval if order == 1 else 0.5 * max_acceleration * interval**2
    bound: FloatArray = reach + sigmas * np.asarray(sd, float)
    return bound


def correction_period(admissible: float, start: float, gyro: float, accel: float) -> float:
    """Return the time [s] an INS may run before its attitude error can exceed ``admissible`` [rad].

    The bound of A-5.4.10, for T far below 84.4 min (the Schuler feedback, left out, has the opposite sign):

        start + gyro T + ((start g + accel) T^2 / 2 + g gyro T^3 / 6) / R

    with ``start`` the error the correction leaves [rad], ``gyro`` drift [rad/s] and ``accel`` bias [m/s^2].
    Zero when ``start`` exceeds ``admissible``, infinite when nothing makes the error grow.

    Examples
    --------
    >>> deg = np.pi / 180  # 10 deg/h, 0.5 deg, 5 mg, limit 1 deg (A-5.4.10)
    >>> round(correction_period(1.0 * deg, 0.5 * deg, 10 / 3600 * deg, 5e-3 * 9.8), 1)
    172.2
    """
    if admissible <= start:
        return 0.0
    g, R = STANDARD_GRAVITY, SCHULER_RADIUS
    roots = np.roots([g * gyro / (6.0 * R), (start * g + accel) / (2.0 * R), gyro, start - admissible])
    positive = roots.real[roots.real > 0]  # one: the factors of all powers are positive, so others have none
    return float(positive[0]) if len(positive) else np.inf
