"""The five modes of an aircraft, twice: from a published derivative table and from a model in JSBSim.

The table becomes the textbook state matrices of level flight: R. C. Nelson, *Flight Stability and Automatic
Control*, 2nd ed. (1998), chapters 4 and 5, with the pitch-rate and alpha-dot terms of Z and the product of
inertia kept. They share nothing with the model but the table.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from bench.core.mathematics.arrays import FloatArray
from bench.simulation.flight.trimming import Trim, TrimCondition, place, present_accelerations, trim_aircraft

G = 9.80665  # standard gravity [m/s^2]
LONGITUDINAL, LATERAL = [0, 2, 4, 7], [1, 3, 5, 6]  # u, w, q, pitch; v, p, r, roll of ``linearize``
BOUNDS = {"short period": 0.01, "phugoid": 0.03, "dutch roll": 0.01, "roll": 0.01, "spiral": 0.03}

Modes = dict[str, complex]


@dataclass(frozen=True, slots=True)
class Flight:
    """A level flight of an airframe; inertia in stability axes, SI."""

    mass: float
    Ixx: float
    Iyy: float
    Izz: float
    Ixz: float  # + integral of x z dm
    S: float
    b: float
    c: float
    density: float
    speed: float

    @property
    def force(self) -> float:
        """Dynamic pressure times wing area [N]."""
        return 0.5 * self.density * self.speed**2 * self.S


@dataclass(frozen=True, slots=True)
class LongitudinalTable:
    """Derivatives in stability axes, per rad, rates times c / 2V; u is the speed over the reference speed.

    CDu holds what the thrust loses with speed too: 0 is a constant thrust.
    """

    CL: float
    CD: float
    CLa: float
    CDa: float
    Cma: float
    CLad: float
    Cmad: float
    CLq: float
    Cmq: float
    CLu: float = 0.0
    CDu: float = 0.0
    Cmu: float = 0.0


@dataclass(frozen=True, slots=True)
class LateralTable:
    """Derivatives in stability axes, per rad, rates times b / 2V; CY along the y axis of the body."""

    CYb: float
    Clb: float
    Cnb: float
    Clp: float
    Cnp: float
    Clr: float
    Cnr: float
    CYp: float = 0.0
    CYr: float = 0.0


def longitudinal_matrix(at: Flight, d: LongitudinalTable) -> np.ndarray:
    """State matrix of u, w [m/s], q [rad/s], pitch [rad], (4, 4)."""
    V, half = at.speed, at.c / (2 * at.speed)
    force, moment = at.force / at.mass, at.force * at.c / at.Iyy
    X = force / V * np.array([-(2 * d.CD + d.CDu), d.CL - d.CDa, 0.0, 0.0]) - [0.0, 0.0, 0.0, G]
    Z = force / V * np.array([-(2 * d.CL + d.CLu), -(d.CLa + d.CD), -d.CLq * half * V, 0.0]) + [0, 0, V, 0]
    w_dot = Z / (1 + force / V * d.CLad * half)
    M = moment * np.array([d.Cmu / V, d.Cma / V, d.Cmq * half, 0.0]) + moment * d.Cmad * half / V * w_dot
    return np.array([X, w_dot, M, [0.0, 0.0, 1.0, 0.0]])


def lateral_matrix(at: Flight, d: LateralTable) -> np.ndarray:
    """State matrix of v [m/s], p, r [rad/s], roll [rad], (4, 4)."""
    V, half = at.speed, at.b / (2 * at.speed)
    Y = at.force / at.mass * np.array([d.CYb / V, d.CYp * half, d.CYr * half, 0.0]) + [0.0, 0.0, -V, G]
    moments = (
        at.force
        * at.b
        * np.array(
            [[d.Clb / V, d.Clp * half, d.Clr * half, 0.0], [d.Cnb / V, d.Cnp * half, d.Cnr * half, 0.0]]
        )
    )
    p_dot, r_dot = np.linalg.solve([[at.Ixx, -at.Ixz], [-at.Ixz, at.Izz]], moments)
    return np.array([Y, p_dot, r_dot, [0.0, 1.0, 0.0, 0.0]])


def named(longitudinal: np.ndarray, lateral: np.ndarray) -> Modes:
    """Short period, phugoid, Dutch roll (upper of each pair), roll and spiral."""
    slow, fast = sorted((v for v in np.linalg.eigvals(longitudinal) if v.imag > 0), key=abs)
    values = np.linalg.eigvals(lateral)
    roll, spiral = sorted(v.real for v in values if v.imag == 0)
    (dutch,) = (v for v in values if v.imag > 0)
    return {"short period": fast, "phugoid": slow, "dutch roll": dutch, "roll": roll, "spiral": spiral}


def of_table(at: Flight, longitudinal: LongitudinalTable, lateral: LateralTable) -> Modes:
    """The modes a derivative table has."""
    return named(longitudinal_matrix(at, longitudinal), lateral_matrix(at, lateral))


def of_model(fdm: Any, condition: TrimCondition) -> Modes:
    """The modes the model has about its trimmed flight in a condition."""
    A = linearize(fdm, condition, trim_aircraft(fdm, condition))
    return named(A[np.ix_(LONGITUDINAL, LONGITUDINAL)], A[np.ix_(LATERAL, LATERAL)])


def differences(found: Modes, reference: Modes) -> dict[str, float]:
    """Distance of each mode from its reference, relative to the size of the reference."""
    return {mode: abs(found[mode] - reference[mode]) / abs(reference[mode]) for mode in reference}


def beyond(found: Modes, reference: Modes, bounds: Mapping[str, float] = BOUNDS) -> dict[str, float]:
    """The modes that differ from their reference by more than their bound, and by how much."""
    apart = differences(found, reference)
    return {mode: apart[mode] for mode in bounds if not apart[mode] <= bounds[mode]}


def linearize(fdm: Any, condition: TrimCondition, trimmed: Trim, step: float = 1e-4) -> FloatArray:
    """Return the state matrix about a trimmed flight by central differences, (8, 8).

    States: u, v, w [m/s], p, q, r [rad/s], roll, pitch [rad], body axes, no wind.
    """
    V, alpha, beta = condition.speed, trimmed.alpha, trimmed.beta
    x0 = np.array(
        [
            *(V * np.array([np.cos(alpha) * np.cos(beta), np.sin(beta), np.sin(alpha) * np.cos(beta)])),
            *(0.0, 0.0, 0.0),
            *(trimmed.roll, trimmed.pitch),
        ]
    )

    def derivative(x: FloatArray) -> FloatArray:
        u, v, w, p, q, r, roll, pitch = (float(value) for value in x)
        speed = float(np.linalg.norm(x[:3]))
        moved = TrimCondition(condition.lat, condition.lon, condition.alt, condition.heading, speed)
        place(
            fdm,
            moved,
            float(np.arctan2(w, u)),
            float(np.arcsin(v / speed)),
            roll,
            trimmed.aileron,
            trimmed.elevator,
            trimmed.throttle,
            pitch=pitch,
            rates_b=(p, q, r),
        )
        roll_rate = p + np.tan(pitch) * (q * np.sin(roll) + r * np.cos(roll))
        pitch_rate = q * np.cos(roll) - r * np.sin(roll)
        return np.array([*present_accelerations(fdm), roll_rate, pitch_rate])

    columns = [(derivative(x0 + e) - derivative(x0 - e)) / (2 * step) for e in step * np.eye(8)]
    return np.column_stack(columns)
