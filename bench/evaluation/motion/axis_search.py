"""Search for exchanged, reversed or mis-scaled axes of an IMU that make its motion fit the receiver's."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import permutations, product

import numpy as np

from bench.core.mathematics.arrays import FloatArray
from bench.evaluation.motion.motion_fit import MotionFit, Stretches, fit_motion

_STRETCHES = 6  # tried in the first round: those in which the velocity changes most
_KEPT = 3  # candidates of the first round that are fitted in full
_EVIDENCE = 30.0  # by which the logarithm of the likelihood must rise: residuals count as independent in it
_NOISE = 0.05  # [m/s], as in the fit


@dataclass(frozen=True, slots=True)
class Axes:
    """Matrices that turn the columns of a recording into the rates and forces that fit the receiver."""

    gyro: FloatArray  # (3, 3)
    accel: FloatArray  # (3, 3)

    @property
    def are_given(self) -> bool:
        """Return whether no axis is exchanged or reversed."""
        return bool((self.gyro / self.gyro_factor == np.eye(3)).all() and (self.accel == np.eye(3)).all())

    @property
    def gyro_factor(self) -> float:
        """Factor that converts the gyros to rad/s [1]."""
        return float(np.abs(self.gyro).max())


def describe_axes(axes: Axes, tilted: bool) -> str:
    """Return a line on axes that are not as given.

    A common rotation of both triads changes nothing in the fit, so one finding has several causes: the one
    that changes a single triad is named. ``tilted``: the accelerometers, so turned, do not point up.
    """
    mirrored = axes.accel[0, 0] < 0
    proper = np.linalg.det(axes.gyro) > 0
    if mirrored and (axes.gyro == -np.eye(3)).all():
        return (
            "imu: the axes are left-handed: in gyros and accelerometers alike two are exchanged "
            "or one has the wrong sign"
        )
    if proper and (mirrored or tilted):
        which, matrix = "accelerometers", axes.accel @ axes.gyro.T
    elif not mirrored:
        which, matrix = "gyros", axes.gyro
    else:
        return "imu: no single exchange of axes makes gyros and accelerometers fit the motion: both are wrong"
    names = ", ".join(
        f"{'-' if row.min() < 0 else ''}{'xyz'[int(np.argmax(np.abs(row)))]}" for row in np.asarray(matrix)
    )
    return f"imu: the {which} fit the motion with their axes x, y, z taken from {names}, not as they are"


def list_axes() -> list[Axes]:
    """Return the 96 assignments of axes that differ by more than a common rotation; the given one first."""
    signed = []
    for order in permutations(range(3)):
        for signs in product((1.0, -1.0), repeat=3):
            one = np.zeros((3, 3))
            one[range(3), order] = signs
            signed.append(one)
    return [Axes(gyro, sign * np.eye(3)) for sign in (1.0, -1.0) for gyro in signed]


def find_axes(
    stretches: Stretches,
    t: FloatArray,
    gyro: FloatArray,
    accel: FloatArray,
    arm_b: FloatArray,
    plain: MotionFit,
) -> tuple[Axes, MotionFit]:
    """Return the axes that fit best and their fit; those given unless others fit far better."""
    units = [Axes(factor * np.eye(3), np.eye(3)) for factor in (np.pi / 180.0, 180.0 / np.pi)]
    few = stretches.take_liveliest(_STRETCHES)

    def fit(axes: Axes, on: Stretches, iterations: int) -> MotionFit:
        return fit_motion(on, t, gyro @ axes.gyro.T, accel @ axes.accel.T, arm_b, iterations=iterations)

    given, *others = list_axes()
    tried = sorted(
        ((weigh_residuals(fit(axes, few, 1), few), k) for k, axes in enumerate([*others, *units])),
        key=lambda x: x[0],
    )
    best, best_fit = given, plain
    cost = weigh_residuals(plain, stretches) - _EVIDENCE
    for _, k in tried[:_KEPT]:
        axes = [*others, *units][k]
        found = fit(axes, stretches, 6)
        if weigh_residuals(found, stretches) < cost:
            best, best_fit, cost = axes, found, weigh_residuals(found, stretches)
    return best, best_fit


def weigh_residuals(fit: MotionFit, stretches: Stretches) -> float:
    """Return the negative logarithm of the likelihood with an unknown noise in every segment."""
    free = 3 * np.diff(stretches.begin) - 6
    return float(0.5 * free @ np.log(fit.rms**2 + _NOISE**2))
