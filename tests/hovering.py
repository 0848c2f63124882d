"""A vehicle that hovers, or stands, and then flies off: truths by formula, as `tests.weaving` makes them."""

from __future__ import annotations

import numpy as np

from bench.core.mathematics import rotation
from bench.core.mathematics.earth import EARTH_RATE, gravity_n
from bench.core.records.data import AirData, Trajectory, no_controls, no_events
from bench.navigation import mechanization

DEG = np.pi / 180
START = np.array([47 * DEG, 11 * DEG, 800.0])
HEADING = 0.6
SPEED, GATHERING = 7.0, 6.0
"""Of the flight [m/s]; it is reached after so many seconds."""


def hovering(
    duration: float, rate: float, still_s: float = 30.0, turn_deg_s: float = 0.0, jitter_deg: float = 0.8
) -> Trajectory:
    """Return the truth of a multirotor that hovers for a while, its nose turning, and flies off by curves.

    Roll, pitch and yaw jitter by so much (rms) as a flight controller leaves it; without jitter it stands.
    """
    n = round(duration * rate)
    t = np.arange(n + 1) / rate
    phase = np.random.default_rng(3).uniform(0.0, 2 * np.pi, (3, 3, 1))
    waves = np.sin(2 * np.pi * np.array([0.37, 0.83, 1.7])[None, :, None] * t + phase)
    since = np.maximum(t - still_s, 0.0)
    flying = np.clip(since / GATHERING, 0.0, 1.0)
    shaken = np.sqrt(2.0 / 3.0) * jitter_deg * DEG * waves.sum(axis=1)
    curve = 60 * DEG * (1.0 - np.cos(2 * np.pi * np.maximum(since - GATHERING, 0.0) / 40.0))
    course = HEADING + turn_deg_s * DEG * np.minimum(t, still_s) + curve
    speed = SPEED * (3.0 * flying**2 - 2.0 * flying**3)
    vel_n = speed[:, None] * np.column_stack([np.cos(course), np.sin(course), 0.0 * t])
    acc_n = np.gradient(vel_n, 1.0 / rate, axis=0)
    along = np.cos(course) * acc_n[:, 0] + np.sin(course) * acc_n[:, 1]
    across = -np.sin(course) * acc_n[:, 0] + np.cos(course) * acc_n[:, 1]
    tilts = (jitter_deg > 0.0) * np.array([across, -along]) / 9.81  # rotors push along the axis alone
    q_nb = rotation.from_euler(shaken[0] + tilts[0], shaken[1] + tilts[1], course + shaken[2])
    w_ie = EARTH_RATE * np.array([np.cos(START[0]), 0.0, -np.sin(START[0])])
    step = rotation.to_rotvec(rotation.multiply(rotation.conjugate(q_nb[:-1]), q_nb[1:]))
    dtheta = step + rotation.rotate(rotation.conjugate(q_nb[:-1]), w_ie) / rate
    f_n = np.diff(vel_n, axis=0) + (np.cross(2 * w_ie, vel_n[1:]) - gravity_n(START[0], START[2])) / rate
    back = rotation.conjugate(rotation.multiply(q_nb[:-1], rotation.from_rotvec(0.5 * step)))
    dvel = rotation.rotate(back, f_n)
    nav = mechanization.propagate(START, np.zeros(3), q_nb[0], np.full(n, 1.0 / rate), dtheta, dvel)
    two, none = np.array([0.0, duration]), np.zeros(2)
    air = AirData(two, none + 9.2e4, none + 283.0, none, none, none, none, np.zeros((2, 3)), none)
    columns = (nav[:, :3], nav[:, 3:6], rotation.continuous(nav[:, 6:]))
    return Trajectory(t, *columns, dtheta, dvel, air, no_controls(), no_events())
