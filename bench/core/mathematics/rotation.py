"""Rotations: quaternions, matrices, Euler angles, rotation vectors, and axes in another order or reversed.

``q_ab`` and ``C_ab`` take a vector from b to a: ``v_a = C_ab @ v_b``. Quaternions are Hamilton, scalar first
(w, x, y, z). Every function takes one time, or a series with one time per row.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import permutations, product

import numpy as np
from numpy.typing import ArrayLike

from bench.core.mathematics.arrays import FloatArray, join_last, split_last

_OPPOSITE = np.array([1.0, -1.0, -1.0, -1.0])
_SMALL2 = 1e-8  # squared angle [rad^2] below which series replace sines; the next terms are below 1e-20


def multiply(q_ab: ArrayLike, q_bc: ArrayLike) -> FloatArray:
    """Return q_ac = q_ab o q_bc, shapes (..., 4) broadcast together.

    Examples
    --------
    >>> multiply([0, 1, 0, 0], [0, 0, 1, 0])  # i j = k
    array([0., 0., 0., 1.])
    """
    p, q = np.asarray(q_ab, float), np.asarray(q_bc, float)
    pw, px, py, pz = split_last(p)
    qw, qx, qy, qz = split_last(q)
    return join_last(
        [
            pw * qw - px * qx - py * qy - pz * qz,
            pw * qx + px * qw + py * qz - pz * qy,
            pw * qy - px * qz + py * qw + pz * qx,
            pw * qz + px * qy - py * qx + pz * qw,
        ]
    )


def conjugate(q_ab: ArrayLike) -> FloatArray:
    """Return q_ba of unit quaternions (..., 4)."""
    turned: FloatArray = np.asarray(q_ab, float) * _OPPOSITE
    return turned


def rotate(q_ab: ArrayLike, v_b: ArrayLike) -> FloatArray:
    """Return v_a (..., 3): the vector v_b (..., 3) resolved in frame a."""
    q, v = np.asarray(q_ab, float), np.asarray(v_b, float)
    w, x, y, z = q[..., 0], q[..., 1], q[..., 2], q[..., 3]
    a, b, c = v[..., 0], v[..., 1], v[..., 2]
    d, e, f = 2.0 * (y * c - z * b), 2.0 * (z * a - x * c), 2.0 * (x * b - y * a)
    turned = [a + w * d + (y * f - z * e), b + w * e + (z * d - x * f), c + w * f + (x * e - y * d)]
    return join_last(turned)


def cross(a: FloatArray, b: FloatArray) -> FloatArray:
    """Return a x b of vectors (..., 3) of one shape: the bits of `np.cross`, four times as fast."""
    x, y, z = split_last(a)
    u, v, w = split_last(b)
    return join_last([y * w - z * v, z * u - x * w, x * v - y * u])


def matrix(q_ab: ArrayLike) -> FloatArray:
    """Return C_ab (..., 3, 3) of unit quaternions (..., 4). Source: equations B-1."""
    w, x, y, z = split_last(np.asarray(q_ab, float))
    rows = [
        [w * w + x * x - y * y - z * z, 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), w * w - x * x + y * y - z * z, 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), w * w - x * x - y * y + z * z],
    ]
    return join_last([element for row in rows for element in row]).reshape(*w.shape, 3, 3)


def from_matrix(C_ab: ArrayLike) -> FloatArray:
    """Return q_ab (..., 4) with w >= 0 of rotation matrices (..., 3, 3).

    Shepperd's method: the largest component comes first, which is accurate for all rotations.
    """
    C = np.asarray(C_ab, float)
    trace = np.trace(C, axis1=-2, axis2=-1)
    d0, d1, d2 = C[..., 0, 0], C[..., 1, 1], C[..., 2, 2]
    a = C[..., 2, 1] - C[..., 1, 2], C[..., 0, 2] - C[..., 2, 0], C[..., 1, 0] - C[..., 0, 1]
    s01, s02, s12 = C[..., 0, 1] + C[..., 1, 0], C[..., 0, 2] + C[..., 2, 0], C[..., 1, 2] + C[..., 2, 1]
    candidates = np.stack(
        [
            np.stack([1 + trace, a[0], a[1], a[2]], axis=-1),
            np.stack([a[0], 1 + 2 * d0 - trace, s01, s02], axis=-1),
            np.stack([a[1], s01, 1 + 2 * d1 - trace, s12], axis=-1),
            np.stack([a[2], s02, s12, 1 + 2 * d2 - trace], axis=-1),
        ],
        axis=-2,
    )
    best = np.argmax(np.stack([trace, d0, d1, d2], axis=-1), axis=-1)
    q = np.take_along_axis(candidates, best[..., None, None], axis=-2)[..., 0, :]
    q = q / np.linalg.norm(q, axis=-1, keepdims=True)
    positive: FloatArray = np.where(q[..., :1] < 0, -q, q)
    return positive


def fit_vectors(a: FloatArray, b: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the rotation (3, 3) that turns vectors a (K, 3) into b best, and the singular values (3,)."""
    left, s, right = np.linalg.svd(b.T @ a)  # Wahba's problem, without a reflection
    return (left * [1.0, 1.0, np.linalg.det(left) * np.linalg.det(right)]) @ right, s


def from_euler(roll: ArrayLike, pitch: ArrayLike, heading: ArrayLike) -> FloatArray:
    """Return q_nb (..., 4) of roll, pitch, heading [rad], yaw-pitch-roll (A-2.2.Q1, NED/FRD)."""
    r, p, h = (0.5 * np.asarray(angle, float) for angle in (roll, pitch, heading))
    cr, sr, cp, sp, ch, sh = np.cos(r), np.sin(r), np.cos(p), np.sin(p), np.cos(h), np.sin(h)
    return join_last(
        [
            ch * cp * cr + sh * sp * sr,
            ch * cp * sr - sh * sp * cr,
            ch * sp * cr + sh * cp * sr,
            sh * cp * cr - ch * sp * sr,
        ]
    )


def to_euler(q_nb: ArrayLike) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return roll (-pi, pi], pitch [-pi/2, pi/2], heading [0, 2 pi) [rad] of q_nb (..., 4).

    Examples
    --------
    >>> np.round(np.rad2deg(to_euler(from_euler(0.1, -0.2, 6.0))), 6)
    array([  5.729578, -11.459156, 343.774677])
    """
    w, x, y, z = split_last(np.asarray(q_nb, float))
    roll = np.arctan2(2 * (y * z + w * x), w * w - x * x - y * y + z * z)
    pitch = np.arcsin(np.clip(2 * (w * y - x * z), -1.0, 1.0))
    return roll, pitch, to_heading(q_nb)


def to_heading(q_nb: ArrayLike) -> FloatArray:
    """Return the heading [0, 2 pi) [rad] of q_nb (..., 4), as :func:`to_euler` does."""
    w, x, y, z = split_last(np.asarray(q_nb, float))
    heading = np.mod(np.arctan2(2 * (x * y + w * z), w * w + x * x - y * y - z * z), 2 * np.pi)
    return np.where(heading >= 2 * np.pi, 0.0, heading)  # mod of a tiny negative angle rounds up


def from_rotvec(rotvec: ArrayLike) -> FloatArray:
    """Return q (..., 4) of rotation vectors (..., 3) [rad]."""
    v = np.asarray(rotvec, float)
    angle2 = _square(v)
    small = angle2 < _SMALL2
    angle = np.sqrt(np.where(small, 1.0, angle2))
    c = np.where(small, 1 - angle2 / 8 + angle2 * angle2 / 384, np.cos(0.5 * angle))
    s = np.where(small, 0.5 - angle2 / 48 + angle2 * angle2 / 3840, np.sin(0.5 * angle) / angle)
    return np.concatenate([c, s * v], axis=-1)


def _square(v: FloatArray) -> FloatArray:
    """Return the squared lengths (..., 1) of vectors (..., 3): the bits of a sum over the axis, faster."""
    x, y, z = v[..., :1], v[..., 1:2], v[..., 2:]
    return np.asarray(x * x + y * y + z * z)


def to_rotvec(q_ab: ArrayLike) -> FloatArray:
    """Return the rotation vector (..., 3) [rad], at most pi long, of unit quaternions (..., 4)."""
    q = np.asarray(q_ab, float)
    q = np.where(q[..., :1] < 0, -q, q)
    sine = np.sqrt(_square(q[..., 1:]))
    small = sine * sine < _SMALL2
    scale = np.where(
        small,
        2.0 + sine * sine / 3.0,  # 2 asin(s) / s
        2.0 * np.arctan2(sine, q[..., :1]) / np.where(small, 1.0, sine),
    )
    vector: FloatArray = scale * q[..., 1:]
    return vector


def continuous(q_ab: ArrayLike) -> FloatArray:
    """Return a series of quaternions (N, 4) without jumps of sign between neighbors."""
    q = np.array(q_ab, float)
    if len(q) > 1:
        jumps = np.sum(q[1:] * q[:-1], axis=1) < 0
        if jumps.any():
            q[1:] *= np.cumprod(np.where(jumps, -1.0, 1.0))[:, None]
    return q


def skew(v: ArrayLike) -> FloatArray:
    """Return [v x] (..., 3, 3) of vectors (..., 3): ``skew(v) @ u = cross(v, u)``."""
    v = np.asarray(v, float)
    cross = np.zeros((*v.shape, 3))
    cross[..., [2, 0, 1], [1, 2, 0]] = v
    cross[..., [1, 2, 0], [2, 0, 1]] = -v
    return cross


def to_scalar_last(q_ab: ArrayLike) -> FloatArray:
    """Return (x, y, z, w) of (w, x, y, z), rows (..., 4): the order of scipy and rerun."""
    return np.roll(np.asarray(q_ab, float), -1, axis=-1)


def from_scalar_last(q_ab: ArrayLike) -> FloatArray:
    """Return (w, x, y, z) of (x, y, z, w), rows (..., 4)."""
    return np.roll(np.asarray(q_ab, float), 1, axis=-1)


def list_signed_axes() -> list[FloatArray]:
    """Return the 48 orders and signs of three axes; the given one first."""
    orders, signs = permutations(range(3)), list(product((1.0, -1.0), repeat=3))
    return [np.eye(3)[list(order)] * np.array(one)[:, None] for order in orders for one in signs]


def write_axes(matrix: FloatArray, names: Sequence[str] = "xyz") -> str:
    """Return the columns from which axes are taken, with their signs: ``-y, x, z``."""
    return ", ".join(f"{'-' if row.min() < 0 else ''}{names[int(np.argmax(np.abs(row)))]}" for row in matrix)
