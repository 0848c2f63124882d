"""Vectors and quaternions as tuples of floats, faster than arrays for single steps of a mechanization."""

from __future__ import annotations

import math

import numpy as np

from bench.core.mathematics.arrays import FloatArray

Vector = tuple[float, float, float]
Quaternion = tuple[float, float, float, float]
ZERO: Vector = (0.0, 0.0, 0.0)


def cross(a: Vector, b: Vector) -> Vector:
    """Return a x b."""
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


def add(a: Vector, b: Vector, times: float = 1.0) -> Vector:
    """Return a + times b."""
    return a[0] + times * b[0], a[1] + times * b[1], a[2] + times * b[2]


def scale(a: Vector, by: float) -> Vector:
    """Return by a."""
    return by * a[0], by * a[1], by * a[2]


def turn(M: FloatArray, a: Vector) -> Vector:
    """Return M a of a matrix (3, 3)."""
    x, y, z = (M @ np.array(a)).tolist()
    return x, y, z


def compose(p: Quaternion, q: Quaternion) -> Quaternion:
    """Return p o q (A-2.2.4)."""
    a, b, c, d = p
    w, x, y, z = q
    return (
        a * w - b * x - c * y - d * z,
        a * x + b * w + c * z - d * y,
        a * y - b * z + c * w + d * x,
        a * z + b * y - c * x + d * w,
    )


def exact_turn(v: Vector) -> Quaternion:
    """Return the quaternion of a rotation vector [rad]."""
    angle2 = v[0] * v[0] + v[1] * v[1] + v[2] * v[2]
    angle = math.sqrt(angle2)
    s = math.sin(0.5 * angle) / angle if angle > 1e-4 else 0.5 - angle2 / 48.0  # the next term is below 1e-19
    return math.cos(0.5 * angle), s * v[0], s * v[1], s * v[2]


def matrix(q: Quaternion) -> FloatArray:
    """Return the matrix (3, 3) of a quaternion."""
    w, x, y, z = q
    return np.array(
        [
            [w * w + x * x - y * y - z * z, 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), w * w - x * x + y * y - z * z, 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), w * w - x * x - y * y + z * z],
        ]
    )


def cross_matrix(a: Vector) -> FloatArray:
    """Return [a x] (3, 3)."""
    x, y, z = a
    return np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
