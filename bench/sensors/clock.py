"""Clock of a receiver: offset and drift, noise of the oscillator, sensitivity to acceleration."""

from __future__ import annotations

import numpy as np

from bench.arrays import FloatArray, IntArray
from bench.compiled import kernel
from bench.data import Trajectory
from bench.signals import allan
from bench.signals.orbits import C
from bench.specs import SkySpec, stream

_STAGES = (0.05, 0.55, 6.05, 66.55, 732.05, 8052.55)  # correlation times of flicker [s]
_FLAT = (0.1, 1e4, 161)  # averaging times over which the Allan deviation of their sum is flat [s]


@kernel
def _flicker_kernel(
    dt: FloatArray, tau: FloatArray, sd: FloatArray, noise: FloatArray, out: FloatArray
) -> None:
    """Add Gauss-Markov stages to out[:, 1] (M,) and their integrals to out[:, 0], exactly for any dt (M-1,).

    ``noise`` (M, K, 2) is unit white noise. The covariance of a stage and of its integral over a step, given
    the stage at the start of the step, is ``s^2 [[1 - w^2, T (1 - w)^2], [., T^2 (2 dt / T - 3 + 4 w -
    w^2)]]`` with w = exp(-dt / T).
    """
    for k in range(tau.shape[0]):
        T, x, total = tau[k], sd[k] * noise[0, k, 0], 0.0
        out[0, 1] += x
        for m in range(dt.shape[0]):
            r = dt[m] / T
            w = np.exp(-r)
            away = -np.expm1(-r)
            own = away * (1.0 + w)
            cross = T * away * away
            if r > 1e-3:
                integral = T * T * (2.0 * r - 3.0 + 4.0 * w - w * w)
            else:  # series: the closed form loses precision
                integral = T * T * r * r * r * (2.0 / 3.0 - 0.5 * r)
            a = np.sqrt(own)
            b = cross / a
            c = np.sqrt(max(integral - b * b, 0.0))
            one, two = noise[m + 1, k, 0], noise[m + 1, k, 1]
            total += x * T * away + sd[k] * (b * one + c * two)
            x = w * x + sd[k] * a * one
            out[m + 1, 0] += total
            out[m + 1, 1] += x


def simulate_receiver_clock(
    truth: Trajectory, rows: IntArray, sky: SkySpec, seed: int, run: int
) -> tuple[FloatArray, FloatArray]:
    """Simulate the clock of a receiver; return its offset (M,) [m] and drift (M,) [m/s].

    Notes
    -----
    White noise and random walk of frequency: a two-state model with the spectral densities ``c^2 h_0 / 2``
    of the offset and ``2 pi^2 c^2 h_-2`` of the drift, discretized exactly (Brown and Hwang, Introduction to
    Random Signals and Applied Kalman Filtering, 3rd ed., 10.3). Flicker of frequency: Gauss-Markov stages
    with a flat Allan variance of ``2 ln 2 h_-1`` from 0.1 s to 1e4 s (IEEE Std 1139). Specific force along
    body down changes the frequency.
    """
    t = truth.t[rows]
    offset, drift = np.zeros(len(t)), np.zeros(len(t))
    if sky.clock_offset_sd > 0:
        offset += sky.clock_offset_sd * stream(seed, run, "gnss.sky.clock.offset").standard_normal()
    if sky.clock_drift_sd > 0:
        constant = sky.clock_drift_sd * stream(seed, run, "gnss.sky.clock.drift").standard_normal()
        drift += constant
        offset += constant * (t - t[0])
    if sky.clock_h_0 > 0 or sky.clock_h_m2 > 0:
        white, walk = 0.5 * C**2 * sky.clock_h_0, 2 * np.pi**2 * C**2 * sky.clock_h_m2
        dt = np.diff(t)
        one, two = stream(seed, run, "gnss.sky.clock.noise").standard_normal((2, len(dt)))
        steps = np.sqrt(walk * dt) * one  # of the drift
        walked = np.concatenate([[0.0], np.cumsum(steps)])
        own = np.sqrt(white * dt + walk * dt**3 / 12) * two
        offset[1:] += np.cumsum(walked[:-1] * dt + 0.5 * steps * dt + own)
        drift += walked
    if sky.clock_h_m1 > 0:
        level = C * float(np.sqrt(2.0 * np.log(2.0) * sky.clock_h_m1))
        noise = stream(seed, run, "gnss.sky.clock.flicker").standard_normal((len(t), len(_STAGES), 2))
        flicker = np.zeros((len(t), 2))
        sd = level * allan.fit_flat_deviation(_STAGES, *_FLAT)
        _flicker_kernel(np.diff(t), np.array(_STAGES), sd, noise, flicker)
        offset += flicker[:, 0]
        drift += flicker[:, 1]
    if sky.clock_g != 0:
        gain = C * sky.clock_g
        velocity = np.add.reduceat(truth.dvel_b[:, 2], np.append(0, rows[:-1]))  # between epochs
        if rows[-1] < len(truth.dvel_b):
            velocity[-1] -= truth.dvel_b[rows[-1] :, 2].sum()
        before, after = np.maximum(rows - 1, 0), np.minimum(rows, len(truth.dvel_b) - 1)
        rates = (truth.dvel_b[at, 2] / (truth.t[at + 1] - truth.t[at]) for at in (before, after))
        offset += gain * np.cumsum(velocity)
        drift += gain * 0.5 * sum(rates)
    return offset, drift
