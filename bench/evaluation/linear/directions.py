"""Observability of heading, tilts and biases on a flight, relative to their initial uncertainty.

With P of these nine states and D their initial standard deviations, the eigenvalues of D^-1 P D^-1 give the
remaining variance of each direction (F. M. Ham and R. G. Brown, IEEE Trans. Aerospace and Electronic Systems
19 (2), 1983): 1 is an unobserved direction, and the greatest is the least observable.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bench.core.mathematics.arrays import BoolArray, FloatArray
from bench.core.mathematics.units import DEG
from bench.core.records.data import Trajectory
from bench.evaluation.linear.best_linear import Bound

FIGURES = (
    *("tilt north", "tilt east", "heading"),
    *(f"{triad} bias {axis}" for triad in ("gyro", "accelerometer") for axis in "xyz"),
)
"""What is looked at: tilts and heading [rad], biases of gyros [rad/s] and accelerometers [m/s^2]."""
TURNING = 1.0 * DEG  # rate of the course from which on it is a turn [rad/s]


@dataclass(frozen=True, slots=True)
class Observed:
    """Standard deviations of the `FIGURES` in the best linear filter at M epochs, and their directions."""

    t: FloatArray  # (M,) [s]
    sd: FloatArray  # (M, 9)
    left: FloatArray  # (M, D) standard deviation along the eigen-directions over that at the start, rising
    directions: FloatArray  # (M, 9, D) unit vectors in units of the start, a column for each


def observe(bound: Bound) -> Observed:
    """Return the uncertainty along the flight; quantities without initial uncertainty have no direction."""
    M = np.vstack([np.eye(9, bound.bias.shape[1])[6:], bound.bias])
    P = M @ bound.causal @ M.T
    start = np.sqrt(np.diag(M @ bound.start @ M.T))
    unknown = np.flatnonzero(start > 0)
    within = P[:, unknown[:, None], unknown] / np.outer(start[unknown], start[unknown])
    values, own = np.linalg.eigh(within)
    vectors = np.zeros((len(P), 9, len(unknown)))
    vectors[:, unknown] = own
    sd = np.sqrt(np.einsum("mii->mi", P))
    return Observed(bound.t, sd, np.sqrt(np.maximum(values, 0.0)), vectors)


def describe_direction(direction: FloatArray) -> str:
    """Return the quantities that dominate a direction (9,), with their components.

    Examples
    --------
    >>> describe_direction(np.array([0.0, 0.6, 0.8, 0, 0, 0, 0, 0, 0.01]))
    'heading 0.80, tilt east 0.60'
    """
    order = np.argsort(-np.abs(direction), kind="stable")
    sign = np.sign(direction[order[0]])
    parts = [f"{FIGURES[k]} {sign * direction[k]:.2f}" for k in order[:3] if abs(direction[k]) > 0.2]
    return ", ".join(parts)


def find_turns(truth: Trajectory, t: FloatArray) -> BoolArray:
    """Return whether the course turns faster than `TURNING` at epochs t (M,), over ground."""
    course = np.unwrap(np.arctan2(truth.vel_n[:, 1], truth.vel_n[:, 0]))
    ahead, behind = (
        np.interp(np.clip(t + half, truth.t[0], truth.t[-1]), truth.t, course) for half in (0.5, -0.5)
    )
    return np.abs(ahead - behind) > TURNING
