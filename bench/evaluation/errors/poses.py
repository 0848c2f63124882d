"""Estimated and true poses of a run, and their relative errors over a time or a distance."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields

import numpy as np

from bench.core.compilation.compiled import inner, kernel
from bench.core.files import disk_arrays
from bench.core.mathematics import earth, rotation
from bench.core.mathematics.arrays import BoolArray, FloatArray, IntArray, read_only
from bench.core.records.data import NavSolution
from bench.core.records.run_records import ErrorSeries

_PACE = 1.0  # a relative error begins every so many seconds [s]


@dataclass(frozen=True, slots=True)
class Poses:
    """Estimated and true poses at the same epochs; without an attitude, axes e replace axes b."""

    t: FloatArray  # (M,) [s]
    estimate_e: FloatArray  # (M, 3) [m], e
    truth_e: FloatArray  # (M, 3) [m], e
    q_estimate: FloatArray  # (M, 4) of b relative to e
    q_truth: FloatArray  # (M, 4)
    traveled: FloatArray  # (M,) along the true path [m]

    @classmethod
    def from_errors(cls, solution: NavSolution, errors: ErrorSeries) -> Poses | None:
        """Make the poses from a solution and its errors; None if a position is not finite."""
        if not (np.isfinite(errors.pos_n).all() and np.isfinite(solution.lla).all()):
            return None
        turned = bool(np.isfinite(errors.phi_n).all())
        estimate_e, truth_e = (disk_arrays.empty((len(solution), 3)) for _ in range(2))
        q_estimate, q_truth = (disk_arrays.empty((len(solution), 4)) for _ in range(2))
        for rows in disk_arrays.blocks(len(solution)):
            lla = earth.displace(solution.lla[rows], -errors.pos_n[rows])
            estimate_e[rows], truth_e[rows] = earth.to_ecef(solution.lla[rows]), earth.to_ecef(lla)
            q_estimate[rows] = q_truth[rows] = [1.0, 0.0, 0.0, 0.0]
            if turned:
                q_en = rotation.from_euler(0.0, -0.5 * np.pi - lla[:, 0], lla[:, 1])
                q_estimate[rows] = rotation.multiply(q_en, solution.q_nb[rows])
                q_nb = rotation.multiply(rotation.from_rotvec(-errors.phi_n[rows]), solution.q_nb[rows])
                q_truth[rows] = rotation.multiply(q_en, q_nb)
        traveled = np.concatenate([[0.0], np.cumsum(lengths(np.diff(truth_e, axis=0)))])
        return cls(solution.t, estimate_e, truth_e, q_estimate, q_truth, traveled)

    def select(self, rows: BoolArray | IntArray | slice) -> Poses | None:
        """Return the poses of some epochs; None if there are fewer than three."""
        taken = {field.name: getattr(self, field.name)[rows] for field in fields(self)}
        return Poses(**taken) if len(taken["t"]) >= 3 else None

    def pairs(self, along: FloatArray, steps: Sequence[float]) -> list[tuple[IntArray, IntArray]]:
        """Return the first rows, one a second, and the last rows of the segments of each length."""
        first = np.searchsorted(self.t, np.arange(self.t[0], self.t[-1], _PACE))
        begun = along[first]
        found = []
        for step in steps:
            last = np.searchsorted(along, begun + step * (1.0 - 1e-9))
            inside = last < len(along)
            found.append((first[inside], last[inside]))
        return found

    def distance(self, first: IntArray, last: IntArray) -> FloatArray:
        """Return the error (K,) of the displacements from first to last rows [m], in b of the first rows."""
        apart = np.empty(len(first))
        estimate_e, truth_e = read_only(self.estimate_e), read_only(self.truth_e)
        q_estimate, q_truth = read_only(self.q_estimate), read_only(self.q_truth)
        _distance_kernel(first, last, estimate_e, q_estimate, truth_e, q_truth, apart)
        return apart

    def angle(self, first: IntArray, last: IntArray) -> FloatArray:
        """Return the angle (K,) between the estimated and the true rotation from first to last rows [rad]."""
        apart = np.empty(len(first))
        _angle_kernel(first, last, read_only(self.q_estimate), read_only(self.q_truth), apart)
        return apart


def lengths(vectors: FloatArray) -> FloatArray:
    """Return the lengths (M,) of vectors (M, 3): the bits of ``np.linalg.norm`` in a quarter of its time.

    Examples
    --------
    >>> lengths(np.array([[2.0, 3.0, 6.0]]))
    array([7.])
    """
    x, y, z = vectors.T
    return np.asarray(np.sqrt(x * x + y * y + z * z))


def centroid(vectors: FloatArray) -> FloatArray:
    """Return the mean (3,) of vectors (M, 3), in a fifth of the time of ``vectors.mean(axis=0)``.

    Examples
    --------
    >>> centroid(np.array([[2.0, 3.0, 6.0], [4.0, 5.0, 8.0]]))
    array([3., 4., 7.])
    """
    return np.asarray(np.einsum("ki->i", vectors) / len(vectors))


@inner
def _turn_between_kernel(
    a: float, i: float, j: float, k: float, w: float, x: float, y: float, z: float
) -> tuple[float, float, float, float]:
    """Return the product of the conjugate of the first quaternion and the second."""
    return (
        a * w + i * x + j * y + k * z,
        a * x - i * w - j * z + k * y,
        a * y + i * z - j * w - k * x,
        a * z - i * y + j * x - k * w,
    )


@kernel
def _angle_kernel(
    first: IntArray, last: IntArray, q_estimate: FloatArray, q_truth: FloatArray, out: FloatArray
) -> None:
    """Fill out (K,) with the angle between the estimated and the true rotation from first to last rows."""
    for k in range(first.shape[0]):
        p, q, r, s = q_estimate[first[k]], q_estimate[last[k]], q_truth[first[k]], q_truth[last[k]]
        estimate = _turn_between_kernel(p[0], p[1], p[2], p[3], q[0], q[1], q[2], q[3])
        truth = _turn_between_kernel(r[0], r[1], r[2], r[3], s[0], s[1], s[2], s[3])
        w, x, y, z = _turn_between_kernel(
            truth[0], truth[1], truth[2], truth[3], estimate[0], estimate[1], estimate[2], estimate[3]
        )
        out[k] = 2.0 * np.arctan2(np.sqrt(x * x + y * y + z * z), abs(w))


@inner
def _turn_back_kernel(pos_e: FloatArray, q: FloatArray, first: int, last: int) -> tuple[float, float, float]:
    """Return the displacement from the first to the last row, in the body axes of the first row."""
    w, x, y, z = q[first, 0], -q[first, 1], -q[first, 2], -q[first, 3]
    a, b, c = (
        pos_e[last, 0] - pos_e[first, 0],
        pos_e[last, 1] - pos_e[first, 1],
        pos_e[last, 2] - pos_e[first, 2],
    )
    d, e, f = 2.0 * (y * c - z * b), 2.0 * (z * a - x * c), 2.0 * (x * b - y * a)
    return a + w * d + (y * f - z * e), b + w * e + (z * d - x * f), c + w * f + (x * e - y * d)


@kernel
def _distance_kernel(
    first: IntArray, last: IntArray, estimate_e: FloatArray, q_estimate: FloatArray, truth_e: FloatArray,
    q_truth: FloatArray, out: FloatArray,
) -> None:  # fmt: skip
    """Fill out (K,) with the distance between the estimated and the true displacement, both in b."""
    for k in range(first.shape[0]):
        a, b, c = _turn_back_kernel(estimate_e, q_estimate, first[k], last[k])
        x, y, z = _turn_back_kernel(truth_e, q_truth, first[k], last[k])
        x, y, z = a - x, b - y, c - z
        out[k] = np.sqrt(x * x + y * y + z * z)


def align(points: FloatArray, reference: FloatArray) -> FloatArray:
    """Return points (M, 3), rotated and shifted without scaling to the best fit of a reference (M, 3).

    Umeyama, Least-squares estimation of transformation parameters (PAMI 13, 1991), eqs. 34 to 43.
    """
    center, target = centroid(points), centroid(reference)
    U, _, Vt = np.linalg.svd((reference - target).T @ (points - center))
    S = np.diag([1.0, 1.0, np.sign(np.linalg.det(U) * np.linalg.det(Vt))])
    return np.asarray((points - center) @ (U @ S @ Vt).T + target)
