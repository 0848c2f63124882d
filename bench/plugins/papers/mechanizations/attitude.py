"""Attitude by direction cosines, Euler angles, one or two quaternions, and the rotation vector.

Each integrates ``C' = C [w_b x] - [w_in x] C`` (A-2.2.P), C from the body axes (forward, up, right) to the
axes of the navigation frame, over a step: ``theta``, the increment or rotation vector of the body, and
``frame``, the turn of the navigation frame [rad].
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Protocol

import numpy as np

from bench.core.mathematics import rotation
from bench.core.mathematics.arrays import FloatArray
from bench.plugins.papers.mechanizations.vectors import (
    Quaternion,
    Vector,
    compose,
    cross_matrix,
    exact_turn,
    matrix,
    scale,
)

NORM_THRESHOLD = 1e-12
"""Deviation of a squared norm from 1 at which a quaternion is normalized (B-N)."""
EULER_GUARD = math.radians(80.0)
"""Pitch from which a step of Euler angles goes by direction cosines."""


class Attitude(Protocol):
    """An attitude that is carried on by steps."""

    C: FloatArray
    """(3, 3), body to navigation frame."""

    def step(self, theta: Vector, frame: Vector) -> None:
        """Carry C over a step."""


def normalize(q: Quaternion, threshold: float = NORM_THRESHOLD) -> Quaternion:
    """Return a quaternion of norm 1; the same one if its squared norm is within ``threshold`` of 1 (B-N)."""
    norm = q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3]
    if abs(norm - 1.0) < threshold:
        return q
    k = 1.0 / math.sqrt(norm)
    return q[0] * k, q[1] * k, q[2] * k, q[3] * k


def picard_turn(v: Vector, order: int = 2) -> Quaternion:
    """Return 1 + v/2 - v^2/8, the turn of Picard's method to the first or second order (A-2.2.5)."""
    square = v[0] * v[0] + v[1] * v[1] + v[2] * v[2] if order == 2 else 0.0
    return 1.0 - square / 8.0, 0.5 * v[0], 0.5 * v[1], 0.5 * v[2]


def poisson_step(C: FloatArray, theta: Vector, frame: Vector) -> FloatArray:
    """Return C after a step of Poisson's equation by the midpoint rule, made orthogonal to first order."""
    W, N = cross_matrix(theta), cross_matrix(frame)
    middle = C + 0.5 * (C @ W - N @ C)
    C = C + middle @ W - N @ middle
    orthogonal: FloatArray = C @ (1.5 * np.eye(3) - 0.5 * C.T @ C)
    return orthogonal


class Poisson:
    """Direction cosines (A-2.2.P, A-5.1.3)."""

    def __init__(self, C: FloatArray) -> None:
        self.C = C

    def step(self, theta: Vector, frame: Vector) -> None:
        """Carry C over a step."""
        self.C = poisson_step(self.C, theta, frame)


class Euler:
    """Euler angles by the midpoint rule (A-2.2.6, A-2.2.7): yaw counter-clockwise about up, pitch, roll.

    From a pitch of ``guard`` [rad] on, where the rates of yaw and roll grow beyond bounds, a step goes by
    direction cosines; a guard of 90 deg leaves the equations to themselves.
    """

    def __init__(self, C: FloatArray, to_nhe: FloatArray, guard: float = EULER_GUARD) -> None:
        self._to_nhe, self._guard = to_nhe, guard
        self.C = C
        self.angles = read_euler(to_nhe @ C)

    def _slope(self, angles: Vector, theta: Vector, frame: Vector) -> Vector:
        _, pitch, roll = angles
        x, y, z = (np.array(theta) - nhe_matrix(*angles).T @ np.array(frame)).tolist()
        s, c = math.sin(roll), math.cos(roll)
        across = y * c - z * s
        return across / math.cos(pitch), y * s + z * c, x - math.tan(pitch) * across

    def step(self, theta: Vector, frame: Vector) -> None:
        """Carry C over a step."""
        f: Vector = tuple((self._to_nhe @ np.array(frame)).tolist())
        if abs(self.angles[1]) >= self._guard:
            B = poisson_step(nhe_matrix(*self.angles), theta, f)
            self.angles = read_euler(B)
        else:
            first = self._slope(self.angles, theta, f)
            a, b, c = self.angles
            middle = (a + 0.5 * first[0], b + 0.5 * first[1], c + 0.5 * first[2])
            da, db, dc = self._slope(middle, theta, f)
            self.angles = (a + da, b + db, c + dc)
            B = nhe_matrix(*self.angles)
        self.C = self._to_nhe.T @ B


def nhe_matrix(yaw: float, pitch: float, roll: float) -> FloatArray:
    """Return B (3, 3), forward, up, right to north, up, east: R_y(yaw) R_z(pitch) R_x(roll) (A-2.2.B)."""
    sy, cy, sp, cp = math.sin(yaw), math.cos(yaw), math.sin(pitch), math.cos(pitch)
    sr, cr = math.sin(roll), math.cos(roll)
    return np.array(
        [
            [cy * cp, sy * sr - cy * sp * cr, sy * cr + cy * sp * sr],
            [sp, cp * cr, -cp * sr],
            [-sy * cp, cy * sr + sy * sp * cr, cy * cr - sy * sp * sr],
        ]
    )


def read_euler(B: FloatArray) -> Vector:
    """Return yaw, pitch, roll [rad] of B (A-2.2.3)."""
    (b11, _, _), (b21, b22, b23), (b31, _, _) = B.tolist()
    return math.atan2(-b31, b11), math.atan2(b21, math.hypot(b22, b23)), math.atan2(-b23, b22)


def _quaternion_of(C: FloatArray) -> Quaternion:
    w, x, y, z = rotation.from_matrix(C).tolist()
    return w, x, y, z


class OneQuaternion:
    """Quaternion to the frame; its turn is resolved by the attitude before the step (A-2.2.4)."""

    def __init__(self, C: FloatArray) -> None:
        self.C, self.q = C, _quaternion_of(C)

    def step(self, theta: Vector, frame: Vector) -> None:
        """Carry C over a step."""
        x, y, z = (np.array(theta) - self.C.T @ np.array(frame)).tolist()
        self.q = normalize(compose(self.q, picard_turn((x, y, z))))
        self.C = matrix(self.q)


class TwoQuaternions:
    """Quaternions of the body and of the navigation frame to inertial axes, B = C' A (A-2.2.5b)."""

    def __init__(self, C: FloatArray) -> None:
        self.C, self.body = C, _quaternion_of(C)
        self.frame: Quaternion = (1.0, 0.0, 0.0, 0.0)

    def step(self, theta: Vector, frame: Vector) -> None:
        """Carry C over a step: Picard to the second order for the body, to the first for the frame."""
        self.body = normalize(compose(self.body, picard_turn(theta)))
        self.frame = normalize(compose(self.frame, picard_turn(frame, order=1)))
        w, x, y, z = self.frame
        self.C = matrix(compose((w, -x, -y, -z), self.body))


class RotationVector(OneQuaternion):
    """Quaternion to the navigation frame by exact turns of the body and of the frame."""

    def step(self, theta: Vector, frame: Vector) -> None:
        """Carry C over a step."""
        turned = compose(self.q, exact_turn(theta))
        self.q = normalize(compose(exact_turn(scale(frame, -1.0)), turned))
        self.C = matrix(self.q)


_MAKERS: dict[str, Callable[[FloatArray], Attitude]] = {
    "poisson": Poisson,
    "quaternion": OneQuaternion,
    "two-quaternions": TwoQuaternions,
    "rotation-vector": RotationVector,
}
ATTITUDES = ("poisson", "euler", "quaternion", "two-quaternions", "rotation-vector")
"""Names for :func:`make_attitude`."""


def make_attitude(name: str, C: FloatArray, to_nhe: FloatArray | None = None) -> Attitude:
    """Return the attitude of a name that starts at C (3, 3), body to navigation frame.

    Parameters
    ----------
    to_nhe : (3, 3) array or None
        Navigation frame to north, up, east; None if the one turns in the other.

    Raises
    ------
    ValueError
        If there is no such attitude, or the angles of Euler are asked for without a meridian.
    """
    if name == "euler":
        if to_nhe is None:
            raise ValueError("Euler angles need a triad along the meridian; choose nhe or enu")
        return Euler(C, to_nhe)
    if name not in _MAKERS:
        raise ValueError(f"no attitude {name!r}; choose from {', '.join(ATTITUDES)}")
    return _MAKERS[name](C)
