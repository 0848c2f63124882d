"""Metrics of the attitude error: by axis, and as its total angle, inclination and turn about the vertical.

The last three are those of BROAD (D. Laidig, M. Caruso, A. Cereatti, T. Seel, Data 6 (7), 2021). The error
``q_est * q_true^-1 = (w, x, y, z)``, n, is a turn about the vertical and the smallest turn that tilts:

    total 2 acos |w|,  inclination 2 acos sqrt(w^2 + z^2),  vertical part 2 atan |z / w|.

Its vertical part is the heading error of level flight; unlike it, it exists at any pitch.
"""

from __future__ import annotations

from collections.abc import Mapping
from itertools import pairwise

import numpy as np

from bench.core.mathematics.arrays import BoolArray, FloatArray
from bench.core.mathematics.units import SAME_INSTANT
from bench.evaluation.errors.poses import lengths
from bench.evaluation.metrics import claims
from bench.evaluation.metrics.case import Case

HEADING_LIMIT = np.deg2rad(1.0)
"""A heading has converged below the larger of this and 3 sigma [rad]."""

HEADING_RIGHT = np.deg2rad(3.0)
"""A heading is right below this [rad]."""


def _rms_deg(angles: FloatArray) -> float:
    return float(np.rad2deg(np.sqrt(np.mean(np.square(angles)))))


def phi_rmse(case: Case) -> Mapping[str, float]:
    """Root mean square of the attitude error [deg] about n, e and d."""
    return {axis: _rms_deg(case.phi_n[:, k]) for k, axis in enumerate(claims.AXES)}


def tilt_rmse(case: Case) -> float:
    """Root mean square of the angle between true and estimated vertical, first order [deg]."""
    return _rms_deg(np.hypot(case.phi_n[:, 0], case.phi_n[:, 1]))


def heading_rmse(case: Case) -> float:
    """Root mean square of the heading error [deg]."""
    return _rms_deg(case.heading)


def heading_max(case: Case) -> float:
    """Largest heading error [deg]."""
    return float(np.rad2deg(np.abs(case.heading).max()))


def split_error(phi_n: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return total error, inclination and vertical part (M,) of rotation vectors phi_n (M, 3), all [rad].

    Each is 0 to pi. At an inclination of pi the vertical part is not defined; it is 0 or pi there.

    Examples
    --------
    >>> total, inclination, vertical = split_error(np.array([[0.3, 0.0, 0.0], [0.0, 0.0, -0.2]]))
    >>> total.round(6), inclination.round(6), vertical.round(6)
    (array([0.3, 0.2]), array([0.3, 0. ]), array([0. , 0.2]))
    """
    angle = lengths(phi_n)
    w, s = np.cos(0.5 * angle), 0.5 * np.sinc(0.5 * angle / np.pi)
    z, level = s * phi_n[:, 2], s * np.hypot(phi_n[:, 0], phi_n[:, 1])
    total = 2.0 * np.arctan2(np.hypot(level, z), np.abs(w))  # acos is not exact near its ends
    return total, 2.0 * np.arctan2(level, np.hypot(w, z)), 2.0 * np.arctan2(np.abs(z), np.abs(w))


def total_error_rmse(case: Case) -> float:
    """Root mean square of the total attitude error, the angle of q_est^-1 q_true [deg]."""
    return _rms_deg(split_error(case.phi_n)[0])


def total_error_max(case: Case) -> float:
    """Largest total attitude error [deg]."""
    return float(np.rad2deg(split_error(case.phi_n)[0].max()))


def inclination_rmse(case: Case) -> float:
    """Root mean square of the angle between true and estimated vertical [deg]."""
    return _rms_deg(split_error(case.phi_n)[1])


def vertical_part_rmse(case: Case) -> float:
    """Root mean square of the turn of the attitude error about the vertical [deg]; it exists at any pitch."""
    return _rms_deg(split_error(case.phi_n)[2])


def heading_drift_rmse(case: Case) -> float:
    """Root mean square of the heading error less its value at the first evaluated epoch [deg].

    For a filter without a heading sensor, whose heading is aligned once.
    """
    return _rms_deg(np.angle(np.exp(1j * (case.heading - case.heading[0]))))


def heading_convergence(case: Case) -> float | None:
    """Time from which the heading error stays below max(1 deg, 3 sigma), to the end or an outage [s].

    None if there is none.
    """
    return _settle(case, np.abs(case.heading) < np.fmax(HEADING_LIMIT, 3.0 * case.heading_sd))


def heading_right(case: Case) -> float | None:
    """Time from which the heading error stays below 3 deg, whatever is reported, to the end or an outage [s].

    None if there is none.
    """
    return _settle(case, np.abs(case.heading) < HEADING_RIGHT)


def _settle(case: Case, below: BoolArray) -> float | None:
    """Return the time from which a condition (M,) holds to the end or an outage; None if it never holds."""
    starts = [int(np.searchsorted(case.t, start - SAME_INSTANT)) for _, start, _ in case.outages]
    edges = sorted({0, *starts, len(case.t)})
    for first, end in pairwise(edges):
        above = np.flatnonzero(~below[first:end])
        settled = first + (int(above[-1]) + 1 if len(above) else 0)
        if settled < end:
            return float(case.t[settled])
    return None
