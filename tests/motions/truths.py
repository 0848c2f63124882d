"""Truths from velocities and attitudes over time, for vehicles without a flight model."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from bench.core.mathematics import earth, rotation
from bench.core.mathematics.arrays import FloatArray
from bench.core.records.data import AirData, Trajectory, no_controls, no_events
from bench.navigation import mechanization

RATE = 100.0
"""Of the IMU [Hz]."""
PLACE = (np.deg2rad(47.0), np.deg2rad(11.0), 800.0)


@dataclass(frozen=True)
class Motion:
    """What a vehicle does from its start on, at the rate of the IMU.

    Attributes
    ----------
    vel_n : ndarray, (N + 1, 3)
        Velocity [m/s], north, east, down.
    euler : ndarray, (N + 1, 3)
        Roll, pitch and heading [rad], continuous.
    starts : tuple of str
        Alignments that apply: "level", at rest on the ground for the first `rest` seconds; "course", faster
        than 6 m/s for the first 20 s with the nose along the course but for `drift_deg`. "given" and
        "unknown", a start that is known but for the heading, always apply.
    rest : float
        Time at rest at the start [s].
    drift_deg : float
        Sd of the angle between course and nose at the start [deg].
    """

    vel_n: FloatArray
    euler: FloatArray
    starts: tuple[str, ...] = ()
    rest: float = 0.0
    drift_deg: float = 1.0
    figures: dict[str, float] = field(default_factory=dict)  # that were drawn


Kind = Callable[[np.random.Generator], Motion]


def clock(seconds: float) -> FloatArray:
    """Return the epochs (N + 1,) of a motion [s]."""
    return np.arange(round(seconds * RATE) + 1) / RATE


def make_truth(
    vel_n: FloatArray, euler: FloatArray, rate: float = RATE, place: tuple[float, float, float] = PLACE
) -> Trajectory:
    """Return the truth of a motion of N + 1 epochs: increments from differences, and their strapdown.

    vel_n (N + 1, 3) is in m/s, euler (N + 1, 3) in rad; rate in Hz; place is latitude, longitude [rad] and
    height [m].
    """
    dt, start = 1.0 / rate, np.array(place)
    n = len(vel_n) - 1
    q_nb = rotation.from_euler(*euler.T)
    w_ie = earth.EARTH_RATE * np.array([np.cos(start[0]), 0.0, -np.sin(start[0])])
    middle = 0.5 * (vel_n[1:] + vel_n[:-1])
    meridian, normal = earth.radii(start[0])
    w_en = np.column_stack(
        [
            middle[:, 1] / (normal + start[2]),
            -middle[:, 0] / (meridian + start[2]),
            -middle[:, 1] * np.tan(start[0]) / (normal + start[2]),
        ]
    )
    back = rotation.conjugate(q_nb[:-1])
    step = rotation.to_rotvec(rotation.multiply(back, q_nb[1:]))
    dtheta = step + rotation.rotate(back, w_ie + w_en) * dt
    gravity = earth.gravity_n(start[0], start[2])
    f_n = np.diff(vel_n, axis=0) + (np.cross(2 * w_ie + w_en, middle) - gravity) * dt
    half = rotation.conjugate(rotation.multiply(q_nb[:-1], rotation.from_rotvec(0.5 * step)))
    dvel = rotation.rotate(half, f_n)
    nav = mechanization.propagate(start, vel_n[0], q_nb[0], np.full(n, dt), dtheta, dvel)
    for _ in range(2):  # what a step leaves out would add up, and a vehicle that stops would creep
        off = np.diff(nav[:, 3:6] - vel_n, axis=0)
        dvel = dvel - rotation.rotate(rotation.conjugate(nav[:-1, 6:]), off)
        nav = mechanization.propagate(start, vel_n[0], q_nb[0], np.full(n, dt), dtheta, dvel)
    two, none = np.array([0.0, n * dt]), np.zeros(2)
    air = AirData(two, none + 9.2e4, none + 283.0, none, none, none, none, np.zeros((2, 3)), none)
    columns = (nav[:, :3], nav[:, 3:6], rotation.continuous(nav[:, 6:]))
    return Trajectory(np.arange(n + 1) * dt, *columns, dtheta, dvel, air, no_controls(), no_events())
