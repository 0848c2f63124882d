"""Attitude from vectors known in two sets of axes: Wahba's problem, its observability, invariants (B-V).

A vector of position and one of velocity, computed in body axes by the INS and in inertial axes by GNSS, tell
how far the INS is turned. No single filter of the bench runs it: it is a check beside them.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from bench.core.mathematics import rotation
from bench.core.mathematics.arrays import FloatArray


class Match(NamedTuple):
    """Attitude that matches vectors."""

    matrix: FloatArray  # (3, 3) A, from the first axes to the second
    cov: FloatArray  # (3, 3) of its error, a rotation vector in the second axes [rad^2]; inf if unobservable
    observability: float  # smallest eigenvalue of the information over the largest: 0 for parallel vectors


def match_vectors(first: ArrayLike, second: ArrayLike, sd: ArrayLike) -> Match:
    """Return the rotation A that minimizes sum of |second_i - A first_i|^2 / sd_i^2 of the directions (B-V).

    Parameters
    ----------
    first, second : (N, 3) arrays
        The same vectors in both axes, N >= 2, in any unit.
    sd : (N,) array
        Standard deviation of each component of their difference, in that unit.

    Raises
    ------
    ValueError
        If a vector has no length.

    Examples
    --------
    >>> A = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    >>> first = np.array([[1.0, 0.0, 0.0], [1.0, 2.0, 0.0]])
    >>> bool(np.allclose(match_vectors(first, first @ A.T, [0.1, 0.1]).matrix, A))
    True
    """
    first, second, sd = (np.asarray(v, float) for v in (first, second, sd))
    length = np.linalg.norm(second, axis=1)
    if not (length > 0).all() or not (np.linalg.norm(first, axis=1) > 0).all():
        raise ValueError("a vector has no length; leave it out")
    u = first / np.linalg.norm(first, axis=1)[:, None]
    v = second / length[:, None]
    weight = (length / sd) ** 2
    U, _, Vt = np.linalg.svd((v * weight[:, None]).T @ u)
    A = U @ np.diag([1.0, 1.0, np.linalg.det(U @ Vt)]) @ Vt
    information = np.eye(3) * weight.sum() - (v * weight[:, None]).T @ v
    values, axes = np.linalg.eigh(information)
    known = values > 1e-12 * values[-1]
    inverse = np.where(known, 1.0 / np.where(known, values, 1.0), np.inf)
    cov = (axes * inverse) @ axes.T if known.all() else np.full((3, 3), np.inf)
    return Match(A, cov, float(max(values[0], 0.0) / values[-1]))


def misalignment(computed: ArrayLike, matched: ArrayLike) -> FloatArray:
    """Return the rotation vector (3,) [rad] from a matched attitude (3, 3) to the computed one."""
    turned = np.asarray(computed, float) @ np.asarray(matched, float).T
    return np.asarray(rotation.to_rotvec(rotation.from_matrix(turned)))


def invariant_errors(first: ArrayLike, second: ArrayLike) -> FloatArray:
    """Return lengths and products of vectors (N, 3) in the second axes less those in the first.

    Lengths come first, in the unit of the vectors, then the cosine between each pair. Rotations change none
    of them: what differs is an error of a vector, whatever the attitude (invariant control, B-V).

    Examples
    --------
    >>> invariant_errors([[1.0, 0.0, 0.0], [0.0, 2.0, 0.0]], [[0.0, 1.0, 0.0], [0.0, 0.0, 2.5]])
    array([0. , 0.5, 0. ])
    """
    found = []
    for vectors in (np.asarray(first, float), np.asarray(second, float)):
        length = np.linalg.norm(vectors, axis=1)
        unit = vectors / length[:, None]
        pairs = np.triu_indices(len(vectors), 1)
        found.append(np.concatenate([length, (unit @ unit.T)[pairs]]))
    return np.asarray(found[1] - found[0])
