"""The tilt of a filter where an IMU comes to rest, against the accelerometers over the whole rest.

The filter is compared at the start of a rest, when the rest has hardly corrected it. A bias of the
accelerometers is in the filter and in the mean, so it is not part of the error. A steady acceleration
without vibration, such as simulated braking, looks like a rest, and its tilt is wrong.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from bench.core.mathematics import rotation
from bench.core.mathematics.arrays import FloatArray
from bench.core.mathematics.units import SAME_INSTANT, STANDARD_GRAVITY
from bench.core.records.data import ImuData, NavSolution

_SCATTER = {"gyro": 0.03, "accel": 0.3}
"""Scatter of a rest over the three axes: of consumer IMUs, and below that of an engine [rad/s; m/s^2]."""
_TURNING = 0.01  # mean rate away from the first rest, or from most rests: a steady turn [rad/s]
_OFF = 1.0  # of the specific force from gravity, by bias and scale of consumer accelerometers [m/s^2]
_LATE = 0.5  # from the start of a rest to the epoch of the filter [s]
_FEWEST_ROWS = 40


def measure_rest_tilt(solution: NavSolution, imu: ImuData, begin: float) -> dict[str, Any]:
    """Return the tilt error at the start of each rest after a motion, from ``begin`` on.

    Returns
    -------
    dict
        ``rests`` is their number, ``tilt_rmse_deg`` the root mean square of the angle between vertical and
        estimated vertical; empty without such a rest.
    """
    t, up_b = find_rests_after_motion(imu)
    k = np.searchsorted(solution.t, t - SAME_INSTANT)
    near = (t >= begin) & (k < len(solution))
    t, up_b, k = t[near], up_b[near], k[near]
    q_nb = solution.q_nb[k]
    used = (solution.t[k] - t <= _LATE) & np.isfinite(q_nb).all(axis=1)
    if not used.any():
        return {}
    estimate = rotation.rotate(rotation.conjugate(q_nb[used]), np.array([0.0, 0.0, -1.0]))
    sine = np.linalg.norm(np.cross(estimate, up_b[used]), axis=1)
    angles = np.rad2deg(np.arctan2(sine, np.einsum("ki,ki->k", estimate, up_b[used])))
    return {"rests": int(used.sum()), "tilt_rmse_deg": float(np.sqrt(np.mean(angles**2)))}


def find_rests_after_motion(imu: ImuData) -> tuple[FloatArray, FloatArray]:
    """Return the start (R,) [s] of each rest after a motion, and the direction of its force (R, 3), b."""
    from bench.evaluation.motion.pose_fit import find_rests

    rows = np.flatnonzero(imu.valid)
    if len(rows) < _FEWEST_ROWS:
        return np.empty(0), np.empty((0, 3))
    triads = {
        name: np.asarray(increments[rows] / imu.dt[rows, None])
        for name, increments in (("gyro", imu.dtheta_b), ("accel", imu.dvel_b))
    }
    rests = [
        one
        for one in find_rests(triads, float(np.median(imu.dt[rows])))
        if all(np.sqrt(rates[one].var(axis=0).sum()) < _SCATTER[name] for name, rates in triads.items())
    ]
    if not rests:
        return np.empty(0), np.empty((0, 3))
    rates, force = (np.array([triads[name][one].mean(axis=0) for one in rests]) for name in _SCATTER)
    begins_at_rest = rests[0].start == 0
    usual = rates[0] if begins_at_rest else np.median(rates, axis=0)
    still = np.linalg.norm(rates - usual, axis=1) < _TURNING
    still[0] &= not begins_at_rest
    still &= np.abs(np.linalg.norm(force, axis=1) - STANDARD_GRAVITY) < _OFF
    starts = imu.t[rows[[one.start for one in rests]]]
    return starts[still], (force / np.linalg.norm(force, axis=1, keepdims=True))[still]
