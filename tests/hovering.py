"""A vehicle that hovers, or stands, and then flies off: truths by formula, as `tests.weaving` makes them."""

from __future__ import annotations

import numpy as np

from bench.core.records.data import Trajectory
from tests.motions.truths import make_truth

DEG = np.pi / 180
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
    euler = np.column_stack([shaken[0] + tilts[0], shaken[1] + tilts[1], course + shaken[2]])
    return make_truth(vel_n, euler, rate)
