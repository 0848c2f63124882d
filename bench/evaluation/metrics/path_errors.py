"""Metrics of the path as other tools define them: absolute and relative pose error, drift in percent.

APE is the position error of each epoch; without alignment its root mean square is pos_rmse_3d_m. RPE compares
the displacement over a time or a distance, seen from the attitude at its start, and the rotation. Both are
defined by Sturm et al., A benchmark for the evaluation of RGB-D SLAM systems (IROS 2012), and computed by
programs such as evo; drift over segments of 100 to 800 m by Geiger et al., Are we ready for autonomous
driving? (KITTI, CVPR 2012). What does not fit into a run is absent.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Literal

import numpy as np

from bench.core.mathematics.arrays import FloatArray, IntArray
from bench.core.mathematics.units import DEG
from bench.evaluation.errors.poses import align, centroid, lengths
from bench.evaluation.metrics.case import Case

TIMES = {"1s": 1.0, "10s": 10.0, "60s": 60.0}
"""Part of a name -> time between the poses of a relative error [s]."""
DISTANCES = {"100m": 100.0, "1km": 1000.0}
"""Part of a name -> distance traveled between the poses [m]."""
SEGMENTS = np.arange(100.0, 801.0, 100.0)
"""Lengths of the segments of KITTI [m]."""
_STILL = 10.0  # a shorter path has no drift in percent [m]


def _rms(lengths: FloatArray) -> float:
    return float(np.sqrt(np.mean(lengths**2)))


def ape_aligned(case: Case) -> float | None:
    """Root mean square of the 3D position error after the best rotation and shift of the whole path [m]."""
    if case.poses is None:
        return None
    apart = align(case.poses.estimate_e, case.poses.truth_e) - case.poses.truth_e
    return _rms(lengths(apart))


def _relative(
    pairs: Sequence[tuple[IntArray, IntArray]], measure: Callable[[IntArray, IntArray], FloatArray]
) -> list[FloatArray]:
    """Return the relative error from the first to the last row of each pair."""
    first, last = (np.concatenate(rows) for rows in zip(*pairs, strict=True))
    return np.split(measure(first, last), np.cumsum([len(rows) for rows, _ in pairs])[:-1])


def rpe(unit: Literal["m", "deg"], case: Case) -> Mapping[str, float | None]:
    """Relative pose error, displacement or rotation, RMS [m or deg]: over 1s, 10s, 60s, 100m and 1km."""
    poses = case.poses
    if poses is None:
        return {}
    pairs = poses.pairs(poses.t, tuple(TIMES.values())) + poses.pairs(
        poses.traveled, tuple(DISTANCES.values())
    )
    errors = _relative(pairs, poses.distance if unit == "m" else poses.angle)
    scale = 1.0 if unit == "m" else 1.0 / DEG
    return {
        name: scale * _rms(error)
        for name, error in zip((*TIMES, *DISTANCES), errors, strict=True)
        if len(error)
    }


def drift_percent(case: Case) -> Mapping[str, float | None]:
    """Drift over the distance traveled [%]: segments of 100 to 800 m; end: the horizontal error."""
    if case.poses is None:
        return {}
    traveled, found = case.poses.traveled, {}
    errors = _relative(case.poses.pairs(traveled, SEGMENTS.tolist()), case.poses.distance)
    rates = np.concatenate([error / length for error, length in zip(errors, SEGMENTS, strict=True)])
    if len(rates):
        found["segments"] = float(100.0 * rates.mean())
    if traveled[-1] > _STILL:
        found["end"] = float(100.0 * np.hypot(*case.pos_n[-1, :2]) / traveled[-1])
    return found


def time_offset(case: Case) -> float | None:
    """Time by which the estimate is ahead of the truth [ms], from the position errors.

    Least squares of ``error = constant + velocity * offset``. None if that explains less than a tenth of the
    error, or the velocity hardly changes.
    """
    velocity = case.solution.vel_n - case.vel_n
    velocity = velocity - centroid(velocity)
    error = case.pos_n - centroid(case.pos_n)
    power, common = np.sum(velocity**2), np.sum(error * velocity)
    if power <= len(velocity) or common**2 < 0.1 * power * np.sum(error**2):  # 1 m/s on average
        return None
    return float(1e3 * common / power)
