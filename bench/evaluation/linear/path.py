"""True motion in short steps, each with the transition matrix of the INS errors."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bench.core.mathematics import rotation
from bench.core.mathematics.arrays import FloatArray, IntArray
from bench.core.records.data import Trajectory
from bench.core.records.sensor_specs import ImuSpec
from bench.navigation.error_state_filter.error_state import dynamics_kernel, transition_kernel
from bench.navigation.error_state_filter.state_processes import ABSOLUTE, CUBE, SQUARE, STEADY, WARMTH
from bench.simulation.sensors.imu_terms import compute_temperature

STEP = 0.1  # longest step: the attitude turns by a few degrees in it [s]
FACTORS = CUBE + 6
"""Factors of the motion by which errors act, numbered as in `state_processes`."""


@dataclass(frozen=True, slots=True)
class LinearPath:
    """K steps along a true motion; n is north, east, down."""

    t: FloatArray  # (K + 1,) [s]
    rows: IntArray  # (K + 1,) of the truth
    lla: FloatArray  # (K + 1, 3)
    C_nb: FloatArray  # (K + 1, 3, 3) at the epochs
    C_mean: FloatArray  # (K, 3, 3) over the steps
    rate_b: FloatArray  # (K + 1, 3) of b relative to i in the sample before [rad/s]
    speed: FloatArray  # (K,) over ground [m/s]
    factors: FloatArray  # (K, `FACTORS`) means over the steps
    G: FloatArray  # (K, 9, 15) transition of position, velocity and attitude errors by the core, less I

    @property
    def span(self) -> FloatArray:
        """Length of the steps (K,) [s]."""
        return np.diff(self.t)


def make_path(truth: Trajectory, imu: ImuSpec, stops: FloatArray, step: float = STEP) -> LinearPath:
    """Return the steps of a truth: none is longer than ``step`` [s], and one ends at each of ``stops`` [s].

    Each step ends at the epoch of the truth that is nearest to the time wanted. ``imu`` gives
    ranges and temperature.
    """
    t = truth.t
    count = max(1, int(np.ceil((t[-1] - t[0]) / step - 1e-9)))
    wanted = np.concatenate([np.linspace(t[0], t[-1], count + 1), stops])
    after = np.clip(np.searchsorted(t, wanted), 1, len(t) - 1)
    rows = np.unique(np.where(wanted - t[after - 1] < t[after] - wanted, after - 1, after))
    first, dt = rows[:-1], np.diff(t)[:, None]
    T = np.diff(t[rows])
    C = rotation.matrix(truth.q_nb)
    C_sample = 0.5 * (C[1:] + C[:-1])
    C_mean = np.add.reduceat(C_sample * dt[:, :, None], first) / T[:, None, None]
    f_n = np.add.reduceat(np.einsum("kij,kj->ki", C_sample, truth.dvel_b), first) / T[:, None]
    rates = np.hstack([truth.dtheta_b, truth.dvel_b]) / dt
    samples = np.zeros((len(dt), FACTORS))
    samples[:, :6], samples[:, STEADY] = rates, 1.0
    samples[:, ABSOLUTE:SQUARE], samples[:, SQUARE:CUBE] = np.abs(rates), rates**2
    full = np.repeat([imu.gyro.range, imu.accel.range], 3)
    u = np.divide(rates, full, out=np.zeros_like(rates), where=full > 0)
    samples[:, CUBE:] = rates * (4.0 * u**2 - 3.0)
    factors = np.add.reduceat(samples * dt, first) / T[:, None]
    if max(imu.gyro.temperature_sd, imu.accel.temperature_sd) > 0:
        warm = compute_temperature(truth, rows, imu.thermal) - imu.thermal.reference
        factors[:, WARMTH] = 0.5 * (warm[1:] + warm[:-1])
    nav = np.hstack([truth.lla, truth.vel_n, truth.q_nb])[first]
    F, G = np.zeros((9, 15)), np.zeros((len(T), 9, 15))
    for k in range(len(T)):
        dynamics_kernel(nav[k], C_mean[k], f_n[k], F)
        transition_kernel(F, T[k], G[k])
    return LinearPath(
        t[rows], rows, truth.lla[rows], C[rows], C_mean, rates[np.maximum(rows - 1, 0), :3],
        np.hypot(nav[:, 3], nav[:, 4]), factors, G,
    )  # fmt: skip
