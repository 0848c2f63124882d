"""The Cartesian frame t of gtsam, fixed to the Earth with the axes n of the start, and its omissions.

In t, v' = C_tb f + g(p) - 2 w_ie x v, and C_tb turns with w_ib less the rate of the Earth: the same as in any
frame fixed to the Earth. gtsam knows a constant g and no w_ie; both are supplied with the measurements.
"""

from __future__ import annotations

from dataclasses import dataclass
from importlib import import_module
from importlib.util import find_spec
from typing import Any

import numpy as np

from bench.core.mathematics import earth, rotation
from bench.core.mathematics.arrays import FloatArray
from bench.core.mathematics.earth import EARTH_RATE
from bench.core.records.data import InitialState
from bench.core.words.exceptions import EstimatorError


def load_gtsam() -> Any:
    """Return the module gtsam.

    Raises
    ------
    EstimatorError
        If it is not installed.
    """
    if find_spec("gtsam") is None:
        raise EstimatorError("it needs the package gtsam: pip install gtsam")
    return import_module("gtsam")


@dataclass(frozen=True, slots=True)
class FlatFrame:
    """The frame t of a start; with ``supply`` false the Earth is flat and rests."""

    origin_e: FloatArray  # (3,) [m], e
    C_et: FloatArray  # (3, 3)
    w_t: FloatArray  # (3,) rate of the Earth [rad/s], t
    g_t: FloatArray  # (3,) gravity at the origin [m/s^2], t
    supply: bool

    @classmethod
    def at(cls, lla: FloatArray, supply: bool) -> FlatFrame:
        """Return the frame with its origin at a place (3,)."""
        C_et = earth.matrix_en(lla[0], lla[1])
        w_t = C_et.T @ np.array([0.0, 0.0, EARTH_RATE if supply else 0.0])
        return cls(earth.to_ecef(lla), C_et, w_t, earth.gravity_n(lla[0], lla[2]), supply)

    def place(self, p_t: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return latitude, longitude, height (3,) of a position and C_tn (3, 3) there."""
        lla = earth.to_geodetic(self.origin_e + self.C_et @ p_t)
        return lla, self.C_et.T @ earth.matrix_en(lla[0], lla[1])

    def locate(self, lla: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the position (3,) of a place and C_tn (3, 3) there."""
        C_tn = self.C_et.T @ earth.matrix_en(lla[0], lla[1])
        return self.C_et.T @ (earth.to_ecef(lla) - self.origin_e), C_tn

    def gravity(self, p_t: FloatArray) -> FloatArray:
        """Return gravity (3,) at a position, t; the gravity of the origin if nothing is supplied."""
        if not self.supply:
            return self.g_t
        lla, C_tn = self.place(p_t)
        return np.asarray(C_tn @ earth.gravity_n(lla[0], lla[2]))

    def answer(
        self, C_tb: FloatArray, p_t: FloatArray, v_t: FloatArray, P: FloatArray
    ) -> tuple[FloatArray, ...]:
        """Return a state (10,) of place, velocity and attitude, and its covariance (9, 9) in n.

        ``P`` (9, 9) is that of the errors of gtsam: attitude, position, velocity along the body axes, true
        state = state * exp(error).
        """
        lla, C_tn = self.place(p_t)
        C_nb = C_tn.T @ C_tb
        J = np.zeros((9, 9))
        J[0:3, 3:6] = J[3:6, 6:9] = J[6:9, 0:3] = -C_nb
        return np.concatenate([lla, C_tn.T @ v_t, rotation.from_matrix(C_nb)]), J @ P @ J.T

    def begin(self, initial: InitialState) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
        """Return attitude, position, velocity of a start and P (9, 9), as :meth:`answer` takes them."""
        p_t, C_tn = self.locate(initial.lla)
        J = self.turn_errors(initial)
        return C_tn @ rotation.matrix(initial.q_nb), p_t, C_tn @ initial.vel_n, J @ initial.cov @ J.T

    @staticmethod
    def turn_errors(initial: InitialState) -> FloatArray:
        """Return J (9, 9), which maps initial errors to errors in the order and sign of gtsam."""
        J = np.zeros((9, 9))
        J[3:6, 0:3] = J[6:9, 3:6] = J[0:3, 6:9] = -rotation.matrix(initial.q_nb).T
        return J
