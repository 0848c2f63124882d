"""Name the axes of an IMU that are exchanged or reversed.

A rotation of both triads changes nothing in the fit of the motion, so one finding has 24 descriptions.
Gravity says which axis is down and the motion which is forward; of the descriptions that agree with both, the
one that changes least is named.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from bench.core.mathematics.arrays import FloatArray
from bench.core.mathematics.rotation import list_signed_axes, write_axes

_LEAN = np.cos(np.deg2rad(50.0))  # a vector that belongs to an axis is at least this much along it


class NamedAxes(NamedTuple):
    """Matrices from the columns of a recording to forward, right, down, and the line that names them."""

    gyro: FloatArray  # (3, 3)
    accel: FloatArray  # (3, 3)
    text: str  # empty: they are as given


def name_axes(gyro: FloatArray, accel: FloatArray, up: FloatArray, ahead: FloatArray | None) -> NamedAxes:
    """Return the simplest description of the axes.

    Parameters
    ----------
    gyro, accel : (3, 3) arrays
        Axes with which the motion fits, up to a common rotation.
    up, ahead : (3,) arrays
        Directions of the specific force and of the motion, in the axes so made; None if that does not show.
    """
    turns = [one for one in list_signed_axes() if np.linalg.det(one) > 0]
    for known in ((up, ahead), (up, None), (None, None)):
        fitting = [R for R in turns if _agrees(R, *known)]
        if fitting:
            break
    best = min(fitting, key=lambda R: _count_changes(R @ gyro, R @ accel))
    gyro, accel = best @ gyro, best @ accel
    return NamedAxes(gyro, accel, _describe(gyro, accel))


def _agrees(R: FloatArray, up: FloatArray | None, ahead: FloatArray | None) -> bool:
    upright = up is None or -float((R @ up)[2]) > _LEAN * float(np.linalg.norm(up))
    forward = ahead is None or float((R @ ahead)[0]) > _LEAN * float(np.linalg.norm(ahead))
    return upright and forward


def _count_changes(gyro: FloatArray, accel: FloatArray) -> tuple[int, int]:
    """Return how many triads differ from the file, 1 for both alike, and in how many entries."""
    given = np.eye(3)
    changed = [not np.array_equal(one, given) for one in (gyro, accel)]
    triads = 1 if all(changed) and np.array_equal(gyro, accel) else sum(changed)
    return triads, int(np.abs(gyro - given).sum() + np.abs(accel - given).sum())


def _describe(gyro: FloatArray, accel: FloatArray) -> str:
    given = np.eye(3)
    same_gyro, same_accel = np.array_equal(gyro, given), np.array_equal(accel, given)
    if same_gyro and same_accel:
        return ""
    if same_gyro and np.array_equal(accel, -given):
        return "imu: the accelerometers show gravity, not specific force: their signs are reversed"
    if same_gyro or same_accel:
        which, matrix = ("accelerometers", accel) if same_gyro else ("gyros", gyro)
        return f"imu: the {which} fit the motion with their axes x, y, z taken from {write_axes(matrix)}"
    if not np.array_equal(gyro, accel):
        if np.array_equal(gyro, -accel):
            taken = (
                f"from {write_axes(gyro)} and the signs of the accelerometers are reversed: they show gravity"
            )
            return f"imu: forward, right, down are taken {taken}"
        taken = f"gyros from {write_axes(gyro)}, accelerometers from {write_axes(accel)}"
        return f"imu: both triads fit the motion with other axes x, y, z: {taken}"
    if np.linalg.det(gyro) < 0:
        return f"imu: the axes are left-handed; forward, right, down are {write_axes(gyro)}"
    return f"imu: forward, right, down are {write_axes(gyro)} of its axes: mounting_deg does not say so"
