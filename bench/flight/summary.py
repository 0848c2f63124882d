"""What a flight was, in numbers."""

from __future__ import annotations

from typing import Any

import numpy as np

from bench.data import Trajectory
from bench.earth import difference_n
from bench.rotation import to_euler

_STANDARD_G = 9.80665  # [m/s^2]


def summarise(truth: Trajectory) -> dict[str, Any]:
    """Return the extremes of a flight, the unit in each key, and its legs as (start, end, text).

    The load factor is the specific force along -z of the body over 9.80665 m/s^2; rates are those
    of the body relative to i; both are means over one sample.
    """
    roll, pitch, _ = to_euler(truth.q_nb)
    alt = truth.lla[:, 2]
    over_ground = np.hypot(*difference_n(truth.lla[1:], truth.lla[:-1])[:, :2].T)
    dt = np.diff(truth.t)
    load = -truth.dvel_b[:, 2] / dt / _STANDARD_G
    rates = np.abs(truth.dtheta_b / dt[:, None]).max(axis=0)
    speed = truth.air.airspeed_true
    return {
        "duration_s": float(truth.t[-1] - truth.t[0]),
        "samples": len(truth),
        "rate_hz": float(1 / dt.mean()),
        "path_over_ground_m": float(over_ground.sum()),
        "alt_min_m": float(alt.min()),
        "alt_max_m": float(alt.max()),
        "airspeed_min_mps": float(speed.min()),
        "airspeed_max_mps": float(speed.max()),
        "ground_speed_min_mps": float(np.hypot(*truth.vel_n[:, :2].T).min()),
        "ground_speed_max_mps": float(np.hypot(*truth.vel_n[:, :2].T).max()),
        "bank_max_rad": float(np.abs(roll).max()),
        "pitch_min_rad": float(pitch.min()),
        "pitch_max_rad": float(pitch.max()),
        "load_factor_min": float(load.min()),
        "load_factor_max": float(load.max()),
        "roll_rate_max_rad_s": float(rates[0]),
        "pitch_rate_max_rad_s": float(rates[1]),
        "yaw_rate_max_rad_s": float(rates[2]),
        "legs": truth.events.of("leg"),
    }
