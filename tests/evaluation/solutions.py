"""A truth of known motion and solutions that are wrong by known errors, made by hand for the judgment."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from bench.core.mathematics import earth, rotation
from bench.core.records.data import (
    AirData,
    Controls,
    Innovations,
    NavSolution,
    Trajectory,
    no_events,
    no_innovations,
)

COV = np.diag([4.0, 4.0, 9.0, 0.04, 0.04, 0.09, 1e-4, 1e-4, 4e-4])


def weaving_truth(duration: float = 20.0, rate: float = 100.0) -> Trajectory:
    """Latitude, longitude, height and attitude swing as sines; velocity is their exact rate."""
    t = np.arange(round(duration * rate) + 1) / rate
    lat = 0.8 + 2e-6 * np.sin(0.5 * t)
    lon = -0.2 + 6e-6 * t
    alt = 500.0 + 10.0 * np.sin(0.3 * t)
    R_M, R_P = earth.radii(lat)
    vel_n = np.column_stack(
        [1e-6 * np.cos(0.5 * t) * (R_M + alt), 6e-6 * (R_P + alt) * np.cos(lat), -3.0 * np.cos(0.3 * t)]
    )
    q_nb = rotation.from_euler(0.5 * np.sin(0.4 * t), 0.1 + 0.05 * np.cos(0.4 * t), 0.2 * np.sin(0.2 * t))
    two = np.array([0.0, duration])
    zero = np.zeros(2)
    return Trajectory(
        t=t,
        lla=np.column_stack([lat, lon, alt]),
        vel_n=vel_n,
        q_nb=rotation.continuous(q_nb),
        dtheta_b=np.zeros((len(t) - 1, 3)),
        dvel_b=np.zeros((len(t) - 1, 3)),
        air=AirData(two, zero, zero, zero, zero, zero, zero, np.zeros((2, 3)), zero),
        controls=Controls(two, zero, zero, zero, zero),
        events=no_events(),
    )


def wrong_solution(
    truth: Trajectory,
    *,
    every: int = 10,
    pos_n=0.0,
    vel_n=0.0,
    phi_n=0.0,
    cov=COV,
    innovations: Innovations | None = None,
    events=None,
) -> NavSolution:
    """Every n-th row of the truth, wrong by pos_n [m], vel_n [m/s], phi_n [rad], each (3,) or (M, 3)."""
    rows = np.arange(0, len(truth), every)
    m = len(rows)

    def column(error):
        return np.broadcast_to(error, (m, 3))

    return NavSolution(
        t=truth.t[rows],
        lla=earth.displace(truth.lla[rows], column(pos_n)),
        vel_n=truth.vel_n[rows] + column(vel_n),
        q_nb=rotation.multiply(rotation.from_rotvec(column(phi_n)), truth.q_nb[rows]),
        gyro_bias_b=np.zeros((m, 3)),
        accel_bias_b=np.zeros((m, 3)),
        cov=np.broadcast_to(cov, (m, 9, 9)).copy(),
        extra_names=(),
        extra=np.empty((m, 0)),
        extra_sd=np.empty((m, 0)),
        innovations=no_innovations() if innovations is None else innovations,
        events=no_events() if events is None else events,
    )


def without(solution: NavSolution, *blocks: str) -> NavSolution:
    """The solution of a filter that does not estimate some blocks: NaN in values and covariance."""
    rows = {"pos": slice(0, 3), "vel": slice(3, 6), "phi": slice(6, 9)}
    names = {"pos": "lla", "vel": "vel_n", "phi": "q_nb"}
    cov = solution.cov.copy()
    changes = {}
    for block in blocks:
        cov[:, rows[block], :] = np.nan
        cov[:, :, rows[block]] = np.nan
        changes[names[block]] = np.full_like(getattr(solution, names[block]), np.nan)
    return replace(solution, cov=cov, **changes)
