"""Inertial navigation by accelerometers alone: six of them give angular acceleration and specific force.

An accelerometer at r along s reads ``s (f + w' x r + w x (w x r))``. Six readings, less what w itself makes,
are linear in w' and f; w is the integral of w' (A-2.3; the cube: Chen, Lee, DeBra 1994, J. Guidance 17 (2)).
A constant error e of w' makes w drift by e t, the level by e t^2 / 2, and with Schuler's w_s^2 = g / R the
position by ``R e (t^2 / 2 - (1 - cos w_s t) / w_s^2)``: g e t^4 / 24 at first, R e t^2 / 2 in the end.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy.integrate import cumulative_simpson

from bench.core.mathematics.arrays import FloatArray
from bench.core.mathematics.units import STANDARD_GRAVITY
from bench.navigation.engine.integrity import SCHULER_RADIUS


@dataclass(frozen=True)
class AccelerometerArray:
    """Six accelerometers."""

    place_b: FloatArray
    """(6, 3) from the point that is navigated [m]."""
    axis_b: FloatArray
    """(6, 3) unit vectors they sense along."""

    @property
    def solution(self) -> FloatArray:
        """(6, 6), readings to angular acceleration [rad/s^2] and specific force [m/s^2]."""
        return np.linalg.inv(np.hstack([np.cross(self.place_b, self.axis_b), self.axis_b]))

    def turning(self, w_b: FloatArray) -> FloatArray:
        """Return what a rate (K, 3) [rad/s] alone makes them read (K, 6) [m/s^2]."""
        w = w_b[:, None, :]
        inward: FloatArray = np.sum(self.axis_b * np.cross(w, np.cross(w, self.place_b)), axis=-1)
        return inward

    def read(self, w_b: FloatArray, w_rate_b: FloatArray, f_b: FloatArray) -> FloatArray:
        """Return the readings (K, 6) [m/s^2] of a motion (K, 3) each."""
        felt = np.hstack([w_rate_b, f_b]) @ np.linalg.inv(self.solution).T
        return felt + self.turning(w_b)

    def integrate(
        self, readings: FloatArray, interval: float, w_start: ArrayLike
    ) -> tuple[FloatArray, FloatArray]:
        """Return dtheta_b [rad] and dvel_b [m/s] (K-1, 3) of readings (K, 6) at even epochs.

        The rate and what it makes the accelerometers read are solved together, by iteration.
        """
        w = np.tile(np.asarray(w_start, float), (len(readings), 1))
        for _ in range(8):
            solved = (readings - self.turning(w)) @ self.solution.T
            before, w = w, w_start + cumulative_simpson(solved[:, :3], dx=interval, axis=0, initial=0.0)
            if np.abs(w - before).max() < 1e-12:
                break
        whole = cumulative_simpson(np.hstack([w, solved[:, 3:]]), dx=interval, axis=0, initial=0.0)
        steps = np.diff(whole, axis=0)
        return steps[:, :3], steps[:, 3:]


def make_cube(base: float) -> AccelerometerArray:
    """Return six accelerometers on the faces of a cube, opposite ones ``base`` [m] apart, along diagonals."""
    side = 0.5 * base
    place = np.array([[0, 0, -1], [0, 1, 0], [1, 0, 0], [-1, 0, 0], [0, -1, 0], [0, 0, 1]]) * side
    axis = np.array([[1, -1, 0], [1, 0, 1], [0, 1, 1], [0, 1, -1], [1, 0, -1], [1, 1, 0]]) / np.sqrt(2.0)
    return AccelerometerArray(place, axis)


def drift_by_angular_acceleration(t: ArrayLike, error: float) -> FloatArray:
    """Return the position error (N,) [m] after times t [s] of a constant error of w' [rad/s^2].

    Of a level INS at rest on a sphere that does not turn.
    """
    T, w = np.asarray(t, float), np.sqrt(STANDARD_GRAVITY / SCHULER_RADIUS)
    x = w * T
    pendulum = np.where(x < 0.05, x**4 / 24.0 - x**6 / 720.0, 0.5 * x**2 - 2.0 * np.sin(0.5 * x) ** 2)
    drift: FloatArray = SCHULER_RADIUS * error * pendulum / w**2
    return drift
