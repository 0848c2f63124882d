"""Standstill, detected from the IMU alone.

Over windows of a second the gyros and accelerometers show only their noise, and their means are the rate of
the Earth and gravity. Steady flight in calm air looks the same: the gate of the filter, which knows the
velocity, decides.
"""

from __future__ import annotations

import numpy as np

from bench.arrays import FloatArray, IntArray
from bench.data import ImuData
from bench.earth import EARTH_RATE, GAMMA_E
from bench.specs import ImuSpec, TriadSpec

WINDOW = 1.0  # [s]
VELOCITY_SD = 0.02  # of an aircraft that stands and rocks in the wind [m/s]
RATE_SD = 2e-5  # the same [rad/s]
_NOISY = 1.5  # sd of the samples over that of their noise: 200 samples stay below 1.2
_SIGMAS = 4.0  # of the biases, granted to the means
_GRAVITY_SPREAD = 0.06  # normal gravity between equator, poles and 12 km [m/s^2]


def windows(imu: ImuData, rows: IntArray, spec: ImuSpec) -> tuple[IntArray, FloatArray]:
    """Return where the unit stood still: the last sample of each window, and the mean rate over it.

    Parameters
    ----------
    imu : ImuData
        Record.
    rows : (K,) array of int
        Rows in use.
    spec : ImuSpec
        The unit assumed.

    Returns
    -------
    last : (W,) array of int
        Index into ``rows``.
    rate_b : (W, 3) array
        Measured mean rate [rad/s], b.
    """
    t, dt = imu.t[rows], imu.dt[rows]
    count = max(round(WINDOW / float(np.median(dt))), 4) if len(t) else 4
    whole = len(t) // count
    if whole == 0:
        return np.empty(0, np.int64), np.empty((0, 3))
    shape = (whole, count)
    steps = dt[: whole * count].reshape(shape)
    last = np.arange(1, whole + 1) * count - 1
    spans = t[last] - (t[last - count + 1] - steps[:, 0])
    still = np.abs(spans - steps.sum(axis=1)) < 0.5 * steps[:, 0]  # no gap in the window
    means = []
    for increment, triad, extra in (
        (imu.dtheta_b, spec.gyro, spec.vibration.engine_gyro),
        (imu.dvel_b, spec.accel, spec.vibration.engine_accel),
    ):
        rate = increment[rows[: whole * count]].reshape(*shape, 3) / steps[:, :, None]
        noise = _sample_sd(triad, float(np.median(dt)), extra)
        still &= (rate.std(axis=1) < _NOISY * noise).all(axis=1)
        means.append(rate.mean(axis=1))
    turn, force = means
    by_g = spec.gyro.g_sensitivity_sd * GAMMA_E
    still &= (np.abs(turn) < EARTH_RATE + _SIGMAS * (_bias_sd(spec.gyro) + RATE_SD + by_g)).all(axis=1)
    size = np.linalg.norm(force, axis=1)
    allowed = _GRAVITY_SPREAD + _SIGMAS * (_bias_sd(spec.accel) + GAMMA_E * spec.accel.scale_factor_sd)
    still &= np.abs(size - GAMMA_E) < allowed
    return last[still], turn[still]


def rate_variance(spec: ImuSpec) -> float:
    """Return the variance of a window's mean rate about that of the Earth and the bias [rad^2/s^2]."""
    return spec.gyro.random_walk**2 / WINDOW + RATE_SD**2


def _sample_sd(triad: TriadSpec, dt: float, vibration: float) -> float:
    """Return the sd of a sample's rate at rest; 1e-9 of the unit where there is no noise at all."""
    lsb = triad.quantization / dt
    return float(np.sqrt(triad.random_walk**2 / dt + lsb**2 / 6.0 + vibration**2)) + 1e-9


def _bias_sd(triad: TriadSpec) -> float:
    return float(np.hypot(triad.turn_on_bias_sd, triad.instability_sd))
