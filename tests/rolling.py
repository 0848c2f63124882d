"""A car on a winding, hilly road: what it does is drawn from the model of `vehicle_motion`.

The IMU follows the turns and slopes of the road. The motion of the axle is turned from its axes by mounting,
slip and the force upon the car, the axle shakes, and the IMU is off the axle.
"""

from __future__ import annotations

import tempfile
from pathlib import Path

import numpy as np
from scipy.interpolate import make_interp_spline
from scipy.signal import lfilter

from bench.core.mathematics import earth, rotation
from bench.core.records.data import Trajectory
from bench.core.records.flight_specs import TableSpec
from bench.io.results import join_pieces
from bench.io.trajectories.trajectory import read_trajectory
from bench.navigation.error_state_filter.vehicle_motion import SHAKING_SD, SLIP_FORCE
from bench.navigation.error_state_filter.vehicle_states import SQUAT_SD
from bench.navigation.options import FusionOptions

KNOTS = 50.0  # rate of the table [Hz]
SHAKING_S = 0.05  # correlation time of the shaking [s]


def _wandering(random: np.random.Generator, n: int, sd: float, correlation: float) -> np.ndarray:
    """Return a Gauss-Markov process (n, 2) at the rate of the table."""
    decay = np.exp(-1.0 / (KNOTS * correlation))
    drive = random.standard_normal((n, 2))
    drive[1:] *= np.sqrt(1.0 - decay**2)
    return sd * lfilter([1.0], [1.0, -decay], drive, axis=0)


def rolling(seed: int, duration: float = 90.0, *, slip: float = 1.0, mounting: float = 1.0) -> Trajectory:
    """Return a drive of its own for each seed, with multiples of slip and mounting."""
    random, believed = np.random.default_rng([seed, 77]), FusionOptions(nonholonomic=True)
    n = round(duration * KNOTS) + 1
    t = np.arange(n) / KNOTS
    speed = 9.0 + 5.0 * np.sin(2 * np.pi * t / 37.0 + random.uniform(0, 6))
    turn = 0.3 * np.sin(2 * np.pi * t / 23.0 + random.uniform(0, 6)) * np.sin(2 * np.pi * t / 9.0)
    course = random.uniform(0, 6) + np.cumsum(turn) / KNOTS
    climb = 0.05 * np.sin(2 * np.pi * t / 31.0 + random.uniform(0, 6))
    push = np.gradient(speed, t) + 9.81 * np.sin(climb)
    yaw, pitch = mounting * np.deg2rad(believed.mounting_sd_deg) * random.standard_normal((2, 1))
    drift = slip * _wandering(random, n, np.deg2rad(believed.slip_sd_deg), believed.slip_s)
    yaw = yaw + drift[:, 0] * (1.0 + np.abs(speed * turn) / SLIP_FORCE)
    pitch = pitch + drift[:, 1] + SQUAT_SD * random.standard_normal() * push
    axle_b = believed.axle_sd * random.standard_normal(3)

    zero = np.zeros(n)
    q_nb = rotation.from_euler(zero, climb, course)
    motion = rotation.multiply(q_nb, rotation.from_euler(zero, pitch, yaw))
    shaking = _wandering(random, n, SHAKING_SD, SHAKING_S)
    between = make_interp_spline(t, np.cumsum(shaking, axis=0) / KNOTS, k=5).derivative()
    shaking *= SHAKING_SD / between(np.arange(0.0, duration, 0.003)).std()
    vel_n = rotation.rotate(motion, np.column_stack([speed, shaking]))
    path = np.cumsum(vel_n, axis=0) / KNOTS - rotation.rotate(q_nb, np.tile(axle_b, (n, 1)))
    lla = earth.displace(np.array([np.deg2rad(47.0), np.deg2rad(11.0), 500.0]), path)
    columns = [t, np.rad2deg(lla[:, 0]), np.rad2deg(lla[:, 1]), lla[:, 2], *q_nb.T]
    with tempfile.TemporaryDirectory() as folder:
        table = Path(folder) / "road.csv"
        header = "t_s,lat_deg,lon_deg,alt_m,q_nb_w,q_nb_x,q_nb_y,q_nb_z"
        np.savetxt(table, np.column_stack(columns), delimiter=",", header=header, comments="", fmt="%.13f")
        return join_pieces(read_trajectory(TableSpec("road", table, 100.0, None)))
