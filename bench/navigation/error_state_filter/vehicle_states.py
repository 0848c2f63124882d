"""States of a vehicle on wheels and of coordinated flight, for the measurements of `vehicle_motion`."""

from __future__ import annotations

import numpy as np

from bench.navigation.error_state_filter.state_processes import Block, States
from bench.navigation.options import FusionOptions

SQUAT_SD = 0.006  # pitch of a body by its forward specific force: 3.4 deg by g [rad s^2/m]
LIFT_SD = 0.01  # angle of attack by the load on the wings: 5.6 deg by g [rad s^2/m]
SIDESLIP_SD = float(np.deg2rad(1.5))  # of an aircraft between gusts and its fin [rad]
SIDESLIP_TIME = 1.0  # in which it comes and goes [s]
GUST_TIME = 5.0  # in which an aircraft of 25 m/s crosses an eddy of 125 m [s]


def _axis(at: tuple[float, float], sd: float, slip_sd: float, slip_s: float, gain_sd: float) -> list[States]:
    """Return the axis along which a vehicle moves: its mean yaw and pitch, slip, and pitch by a force."""
    mean, slip, rate = sd**2, slip_sd**2, 1.0 / slip_s
    return [
        States("axis_yaw", "rad", 1, mean, value=at[0]),
        States("axis_pitch", "rad", 1, mean, value=at[1]),
        States("slip_yaw", "rad", 1, slip, decay_time=rate, stationary=slip),
        States("slip_pitch", "rad", 1, slip, decay_time=rate, stationary=slip),
        States("pitch_by_force", "rad_per_m_s2", 1, gain_sd**2),
    ]


def vehicle(options: FusionOptions) -> list[Block]:
    """Return the states of a vehicle on wheels and of coordinated flight (`vehicle_motion`)."""
    mounting, slip, alpha, sd = np.deg2rad(
        [options.mounting_sd_deg, options.slip_sd_deg, options.alpha_deg, options.alpha_sd_deg]
    )
    wheels = [
        *_axis((0.0, 0.0), mounting, slip, options.slip_s, SQUAT_SD),
        States("axle_b", "m", 3, options.axle_sd**2, value=np.array(options.axle_b)),
    ]
    gust = options.gust_sd**2
    wings = [
        *_axis((0.0, -alpha), sd, SIDESLIP_SD, SIDESLIP_TIME, LIFT_SD),
        States("gust_n", "m_s", 3, gust, decay_time=1.0 / GUST_TIME, stationary=gust),
    ]
    return [Block("nonholonomic", lambda _: wheels), Block("coordinated", lambda _: wings)]
