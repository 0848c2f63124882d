"""Exact increments in, what an IMU would have reported out.

Per triad: ``(I + M)(true increment) + bias dt + white noise``, then quantization with the remainder
carried to the next sample (A-5.1.8 without its g and rate-derivative terms). M holds scale factor
errors on its diagonal and misalignments beside it. Every random term has its own stream,
``imu.<triad>.<term>``; a term that is off draws nothing.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from bench.arrays import FloatArray, IntArray
from bench.compiled import kernel
from bench.data import ImuData, Trajectory
from bench.sensors.processes import bias_stages, gauss_markov
from bench.specs import ImuSpec, TriadSpec, stream

_BIAS_STEP = 0.05  # step of bias processes slower than _FAST, interpolated in between [s]
_FAST = 1.0  # a bias stage with a shorter correlation time is stepped at every sample [s]


class ImuBias(NamedTuple):
    """The biases that were applied; linear between their instants, first and last of the truth included."""

    t: FloatArray  # (B,) [s]
    gyro_b: FloatArray  # (B, 3) [rad/s], b
    accel_b: FloatArray  # (B, 3) [m/s^2], b


@kernel
def _measure_kernel(
    t: FloatArray,
    increment: FloatArray,
    M: FloatArray,
    knots: IntArray,
    bias: FloatArray,
    white: FloatArray,
    random_walk: float,
    lsb: float,
    out: FloatArray,
) -> None:
    """Fill out (N-1, 3) from increment (N-1, 3) between t (N,); bias (B, 3) at rows knots (B,) of t.

    ``white`` has no rows when the triad has no white noise. The bias is linear between knots, so
    its value half way through a sample, times dt, is its integral.
    """
    j = 0
    rest0, rest1, rest2 = 0.0, 0.0, 0.0
    for k in range(increment.shape[0]):
        while knots[j + 1] <= k:
            j += 1
        dt = t[k + 1] - t[k]
        t0, t1 = t[knots[j]], t[knots[j + 1]]
        s = (0.5 * (t[k] + t[k + 1]) - t0) / (t1 - t0)
        x, y, z = increment[k, 0], increment[k, 1], increment[k, 2]
        e0 = M[0, 0] * x + M[0, 1] * y + M[0, 2] * z + (bias[j, 0] + s * (bias[j + 1, 0] - bias[j, 0])) * dt
        e1 = M[1, 0] * x + M[1, 1] * y + M[1, 2] * z + (bias[j, 1] + s * (bias[j + 1, 1] - bias[j, 1])) * dt
        e2 = M[2, 0] * x + M[2, 1] * y + M[2, 2] * z + (bias[j, 2] + s * (bias[j + 1, 2] - bias[j, 2])) * dt
        if white.shape[0] > 0:
            sd = random_walk * np.sqrt(dt)
            e0 += sd * white[k, 0]
            e1 += sd * white[k, 1]
            e2 += sd * white[k, 2]
        x, y, z = x + e0, y + e1, z + e2
        if lsb > 0.0:
            want0, want1, want2 = x + rest0, y + rest1, z + rest2
            x, y, z = lsb * np.rint(want0 / lsb), lsb * np.rint(want1 / lsb), lsb * np.rint(want2 / lsb)
            rest0, rest1, rest2 = want0 - x, want1 - y, want2 - z
        out[k, 0], out[k, 1], out[k, 2] = x, y, z


def measure(truth: Trajectory, spec: ImuSpec, seed: int, run: int) -> tuple[ImuData, ImuBias]:
    """Return what the IMU reports of the true motion, and the biases it had.

    Parameters
    ----------
    truth : Trajectory
        The motion, N instants.
    spec : ImuSpec
        The unit; with all errors 0 the record equals the true increments.
    seed, run : int
        Which draw of the errors.

    Returns
    -------
    imu : ImuData
        N - 1 samples.
    bias : ImuBias
        Turn-on bias plus bias instability, at 20 Hz.

    Raises
    ------
    ValueError
        When a triad has a bias instability without correlation time, or an unknown bias model.
    """
    t = truth.t
    reported = _knots(t, _BIAS_STEP)
    dtheta_b, gyro_bias = _triad("imu.gyro", t, truth.dtheta_b, spec.gyro, reported, seed, run)
    dvel_b, accel_bias = _triad("imu.accel", t, truth.dvel_b, spec.accel, reported, seed, run)
    imu = ImuData(t=t[1:], dt=np.diff(t), valid=np.ones(len(t) - 1, bool), dtheta_b=dtheta_b, dvel_b=dvel_b)
    return imu, ImuBias(t[reported], gyro_bias, accel_bias)


def _triad(
    name: str, t: FloatArray, increment: FloatArray, spec: TriadSpec, reported: IntArray, seed: int, run: int
) -> tuple[FloatArray, FloatArray]:
    """Return the measured increments (N-1, 3) and the bias at the reported rows."""
    M = np.zeros((3, 3))
    if spec.scale_factor_sd > 0:
        np.fill_diagonal(
            M, spec.scale_factor_sd * stream(seed, run, f"{name}.scale_factor").standard_normal(3)
        )
    if spec.misalignment_sd > 0:
        angles = spec.misalignment_sd * stream(seed, run, f"{name}.misalignment").standard_normal(6)
        M[~np.eye(3, dtype=bool)] = angles
    knots, bias = _bias(name, t, spec, reported, seed, run)
    white = np.empty((0, 3))
    if spec.random_walk > 0:
        white = stream(seed, run, f"{name}.white").standard_normal((len(t) - 1, 3))
    out = np.empty_like(increment)
    _measure_kernel(t, increment, M, knots, bias, white, spec.random_walk, spec.quantization, out)
    return out, bias[np.searchsorted(knots, reported)]


def _bias(
    name: str, t: FloatArray, spec: TriadSpec, reported: IntArray, seed: int, run: int
) -> tuple[IntArray, FloatArray]:
    """Return rows of t that include the reported ones, and the bias (B, 3) there."""
    knots = reported
    bias = np.zeros((len(knots), 3))
    if spec.bias_instability > 0:
        correlation, sd = bias_stages(spec)
        if correlation.min() < _FAST:
            knots = np.arange(len(t))
        decay = np.exp(-np.diff(t[knots])[:, None] / correlation)
        noise = stream(seed, run, f"{name}.instability").standard_normal((len(knots), len(sd), 3))
        bias = gauss_markov(decay, sd, noise)
    if spec.turn_on_bias_sd > 0:
        bias += spec.turn_on_bias_sd * stream(seed, run, f"{name}.turn_on").standard_normal(3)
    return knots, bias


def _knots(t: FloatArray, step: float) -> IntArray:
    """Return rows of t about ``step`` seconds apart, first and last included."""
    interval = (t[-1] - t[0]) / (len(t) - 1)
    stride = max(1, round(step / interval))
    return np.append(np.arange(0, len(t) - 1, stride), len(t) - 1)
