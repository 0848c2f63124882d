"""Poses in the frames of ROS REP 103: local frame east, north, up; body frame forward, left, up."""

from __future__ import annotations

import numpy as np

from bench.core.mathematics import earth, rotation
from bench.core.mathematics.arrays import FloatArray

_ENU_NED = np.array([0.0, np.sqrt(0.5), np.sqrt(0.5), 0.0])  # swaps x and y, reverses z; its own inverse
_FRD_FLU = np.array([0.0, 1.0, 0.0, 0.0])  # half a turn about x


def to_enu(v_n: FloatArray) -> FloatArray:
    """Convert vectors (..., 3) from north, east, down to east, north, up."""
    return v_n[..., [1, 0, 2]] * [1.0, 1.0, -1.0]


def to_flu(v_b: FloatArray) -> FloatArray:
    """Convert vectors (..., 3) from forward, right, down to forward, left, up."""
    v_flu: FloatArray = v_b * [1.0, -1.0, -1.0]
    return v_flu


def to_poses(lla: FloatArray, q_nb: FloatArray, origin: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return positions (N, 3) [m] and attitudes (N, 4), scalar first, in the tangent frame at an origin.

    Parameters
    ----------
    lla : (N, 3) array
        Latitude, longitude [rad], ellipsoidal height [m].
    q_nb : (N, 4) array
        From forward, right, down to north, east, down at each position.
    origin : (3,) array
        Latitude, longitude [rad], height [m] of the origin; the axes are east, north, up there.
    """
    position = to_enu(earth.local_ned(lla, origin))
    q_oe = rotation.conjugate(rotation.from_matrix(earth.matrix_en(origin[0], origin[1])))
    q_en = rotation.from_matrix(earth.matrix_en(lla[:, 0], lla[:, 1]))
    q_ob = rotation.multiply(q_oe, rotation.multiply(q_en, q_nb))
    return position, rotation.multiply(_ENU_NED, rotation.multiply(q_ob, _FRD_FLU))
