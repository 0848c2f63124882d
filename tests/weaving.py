"""A banked, weaving flight made without JSBSim, and units whose every error the loose filter models.

The increments are smooth closed forms of time; the truth is what the mechanization of the bench makes of
them, so an error-free navigator returns it exactly and every error left is one of the sensors or the filter.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from bench.core.mathematics import rotation
from bench.core.records.data import AirData, Controls, Trajectory, no_events
from bench.core.records.instruments import BaroSpec
from bench.core.records.sensor_specs import AssumedSpecs, GnssSpec, ImuSpec, SensorsSpec, TriadSpec
from bench.navigation import mechanization

DEG = np.pi / 180

IMU = ImuSpec(
    "weaving-mems",
    TriadSpec(
        random_walk=0.15 * DEG / 60,
        bias_instability=5 * DEG / 3600,
        bias_correlation=300.0,
        bias_model="gauss-markov",
        turn_on_bias_sd=30 * DEG / 3600,
    ),
    TriadSpec(
        random_walk=0.03 / 60,
        bias_instability=50e-6 * 9.81,
        bias_correlation=300.0,
        bias_model="gauss-markov",
        turn_on_bias_sd=2e-3 * 9.81,
    ),
)
GNSS = GnssSpec("weaving-gnss", 1.0, 1.5, 2.5, 0.05)
BARO = BaroSpec("weaving-baro", 5.0, 0.5, 3.0, 0.05)


def units(imu: ImuSpec = IMU, gnss: GnssSpec | None = GNSS, baro: BaroSpec | None = BARO) -> SensorsSpec:
    """Sensors whose specs the filter is told truly, the antenna off the IMU on every axis."""
    return SensorsSpec(
        imu=imu,
        gnss=gnss,
        baro=baro,
        assumed=AssumedSpecs(imu, gnss, baro=baro),
        antenna_b=(0.8, 0.3, -0.4),
        gnss_outages=(),
        initial_pos_sd=(3.0, 3.0, 5.0),
        initial_vel_sd=(0.2, 0.2, 0.2),
        initial_tilt_sd=0.5 * DEG,
        initial_heading_sd=2.0 * DEG,
        output_rate=10.0,
    )


def weaving(
    duration: float, rate: float = 200.0, straight_from: float = np.inf, wind_n: ArrayLike | None = None
) -> Trajectory:
    """Bank swings to 30 deg and back each minute, pitch and thrust swing faster; 47 deg north, 25 m/s.

    From ``straight_from`` on, a whole number of minutes, it flies straight. Pitch and thrust turn the
    velocity away from the nose in time; with a wind [m/s], n, they are left out, and the nose points where
    the aircraft moves through the air.
    """
    n = round(duration * rate)
    t = np.arange(n + 1) / rate
    middle = 0.5 * (t[1:] + t[:-1])
    swing = 2 * np.pi / 60
    moving = (middle < straight_from) * 1.0
    bank = 30 * DEG * np.sin(swing * middle) * moving
    roll_rate = 30 * DEG * swing * np.cos(swing * middle) * moving
    turn_rate = 9.81 / 25.0 * np.tan(bank)
    swings = moving * (wind_n is None)
    pitch_rate = 2 * DEG * np.sin(0.9 * middle) * swings
    w_b = np.column_stack([roll_rate, turn_rate * np.sin(bank) + pitch_rate, turn_rate * np.cos(bank)])
    along, across = 0.5 * np.cos(0.5 * middle) * swings, 0.1 * np.sin(middle) * swings
    f_b = np.column_stack([along, across, -9.81 / np.cos(bank)])
    nav = mechanization.propagate(
        [47 * DEG, 11 * DEG, 800.0],
        25.0 * np.array([np.cos(0.6), np.sin(0.6), 0.0]) + (0.0 if wind_n is None else np.asarray(wind_n)),
        rotation.from_euler(0.0, 0.0, 0.6),
        np.full(n, 1 / rate),
        w_b / rate,
        f_b / rate,
    )
    two, zero = np.array([0.0, duration]), np.zeros(2)
    air = AirData(two, zero, zero, zero, zero, zero, zero, np.zeros((2, 3)), zero)
    return Trajectory(
        t=t,
        lla=nav[:, :3],
        vel_n=nav[:, 3:6],
        q_nb=rotation.continuous(nav[:, 6:]),
        dtheta_b=w_b / rate,
        dvel_b=f_b / rate,
        air=air,
        controls=Controls(two, zero, zero, zero, zero),
        events=no_events(),
    )
