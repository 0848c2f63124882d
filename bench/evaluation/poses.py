"""Estimated and true poses of a run, and what of them differs over a time or a distance."""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np

from bench import earth, rotation
from bench.arrays import BoolArray, FloatArray, IntArray
from bench.data import ErrorSeries, NavSolution

_PACE = 1.0  # a relative error begins every so many seconds [s]


@dataclass(frozen=True, slots=True)
class Poses:
    """Estimated and true poses at the same instants; without an attitude the axes of e stand for b."""

    t: FloatArray  # (M,) [s]
    estimate_e: FloatArray  # (M, 3) [m], e
    truth_e: FloatArray  # (M, 3) [m], e
    q_estimate: FloatArray  # (M, 4) of b relative to e
    q_truth: FloatArray  # (M, 4)
    travelled: FloatArray  # (M,) along the true path [m]

    @classmethod
    def from_errors(cls, solution: NavSolution, errors: ErrorSeries) -> Poses | None:
        """Make the poses from a solution and its errors; None if a position is not finite."""
        if not (np.isfinite(errors.pos_n).all() and np.isfinite(solution.lla).all()):
            return None
        lla = earth.displace(solution.lla, -errors.pos_n)
        truth_e = earth.to_ecef(lla)
        steps = lengths(np.diff(truth_e, axis=0))
        q_estimate = q_truth = np.tile([1.0, 0.0, 0.0, 0.0], (len(solution), 1))
        if np.isfinite(errors.phi_n).all():
            q_en = rotation.from_euler(0.0, -0.5 * np.pi - lla[:, 0], lla[:, 1])
            q_estimate = rotation.multiply(q_en, solution.q_nb)
            q_nb = rotation.multiply(rotation.from_rotvec(-errors.phi_n), solution.q_nb)
            q_truth = rotation.multiply(q_en, q_nb)
        travelled = np.concatenate([[0.0], np.cumsum(steps)])
        return cls(solution.t, earth.to_ecef(solution.lla), truth_e, q_estimate, q_truth, travelled)

    def select(self, rows: BoolArray | IntArray | slice) -> Poses | None:
        """Return the poses of some epochs; None if there are fewer than three."""
        taken = {field.name: getattr(self, field.name)[rows] for field in fields(self)}
        return Poses(**taken) if len(taken["t"]) >= 3 else None

    def pairs(self, along: FloatArray, step: float) -> tuple[IntArray, IntArray]:
        """Return the first rows, one a second, and the last rows of the pieces that are a step long."""
        first = np.searchsorted(self.t, np.arange(self.t[0], self.t[-1], _PACE))
        last = np.searchsorted(along, along[first] + step * (1.0 - 1e-9))
        inside = last < len(along)
        return first[inside], last[inside]

    def distance(self, first: IntArray, last: IntArray) -> FloatArray:
        """Return the error (K,) of the displacements from first to last rows, seen in b at the first [m]."""
        moved = [
            rotation.rotate(rotation.conjugate(q[first]), pos_e[last] - pos_e[first])
            for pos_e, q in ((self.estimate_e, self.q_estimate), (self.truth_e, self.q_truth))
        ]
        return lengths(moved[0] - moved[1])

    def angle(self, first: IntArray, last: IntArray) -> FloatArray:
        """Return the angle (K,) between the estimated and the true rotation from first to last rows [rad]."""
        turned = [
            rotation.multiply(rotation.conjugate(q[first]), q[last]) for q in (self.q_estimate, self.q_truth)
        ]
        apart = rotation.to_rotvec(rotation.multiply(rotation.conjugate(turned[1]), turned[0]))
        return lengths(apart)


def lengths(vectors: FloatArray) -> FloatArray:
    """Return the lengths (M,) of vectors (M, 3): the bits of ``np.linalg.norm`` in a quarter of its time.

    Examples
    --------
    >>> lengths(np.array([[2.0, 3.0, 6.0]]))
    array([7.])
    """
    x, y, z = vectors.T
    return np.asarray(np.sqrt(x * x + y * y + z * z))


def align(points: FloatArray, reference: FloatArray) -> FloatArray:
    """Return points (M, 3) turned and shifted, not scaled, to fit a reference (M, 3) best.

    Umeyama, Least-squares estimation of transformation parameters (PAMI 13, 1991), eqs. 34 to 43.
    """
    centre, target = points.mean(axis=0), reference.mean(axis=0)
    U, _, Vt = np.linalg.svd((reference - target).T @ (points - centre))
    S = np.diag([1.0, 1.0, np.sign(np.linalg.det(U) * np.linalg.det(Vt))])
    return np.asarray((points - centre) @ (U @ S @ Vt).T + target)
