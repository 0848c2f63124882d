"""Clock of a receiver: offset and drift, noise of the oscillator, sensitivity to acceleration."""

from __future__ import annotations

import numpy as np

from bench.core.compilation.compiled import kernel
from bench.core.mathematics.arrays import FloatArray, IntArray
from bench.core.records.data import Trajectory
from bench.core.records.sky_spec import SkySpec
from bench.simulation.sensors.draws import SensorDraws
from bench.simulation.sensors.gnss import rate_at
from bench.simulation.signals import allan
from bench.simulation.signals.orbits import C

STAGES = (0.05, 0.55, 6.05, 66.55, 732.05, 8052.55)  # correlation times of flicker [s]
FLAT_TIMES = (0.1, 1e4, 161)  # averaging times over which the Allan deviation of their sum is flat [s]


@kernel
def flicker_kernel(
    dt: FloatArray, tau: FloatArray, sd: FloatArray, noise: FloatArray, begun: bool, state: FloatArray,
    out: FloatArray,
) -> None:  # fmt: skip
    """Add Gauss-Markov stages to out[:, 1] (M,) and their integrals to out[:, 0], exactly for any dt (M,).

    ``noise`` (M, K, 2) is unit white noise. ``state`` (K, 2), the stages and their integrals before, becomes
    those at the end; they are stationary at the first epoch unless they have ``begun``. The covariance of a
    stage and of its integral over a step, given the stage at the start of the step, is
    ``s^2 [[1 - w^2, T (1 - w)^2], [., T^2 (2 dt / T - 3 + 4 w - w^2)]]`` with w = exp(-dt / T).
    """
    for k in range(tau.shape[0]):
        T, x, total = tau[k], state[k, 0], state[k, 1]
        for m in range(dt.shape[0]):
            if m == 0 and not begun:
                x = sd[k] * noise[0, k, 0]
                out[0, 1] += x
                continue
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
            one, two = noise[m, k, 0], noise[m, k, 1]
            total += x * T * away + sd[k] * (b * one + c * two)
            x = w * x + sd[k] * a * one
            out[m, 0] += total
            out[m, 1] += x
        state[k, 0], state[k, 1] = x, total


def simulate_receiver_clock(
    truth: Trajectory, rows: IntArray, steps: FloatArray, sky: SkySpec, draws: SensorDraws
) -> tuple[FloatArray, FloatArray]:
    """Simulate the clock of a receiver; return its offset (M,) [m] and drift (M,) [m/s] at some rows.

    ``steps`` (M,) is the time before each of them [s]; ``draws`` are those of the clock.

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
    if sky.clock_g != 0:  # first: it counts the motion of pieces without an epoch, too
        gain, force = C * sky.clock_g, truth.dvel_b[:, 2:3]
        velocity = draws.accumulate("velocity", force)
        drift += gain * rate_at("force", truth.t, force, rows, draws)[:, 0]
        offset += gain * velocity[rows - 1, 0]
    if not len(t):
        return offset, drift
    first, begun = draws.keep("first", lambda: float(t[0])), bool(draws.keep("begun", list[bool]))
    draws.put("begun", [True])
    if sky.clock_offset_sd > 0:
        offset += sky.clock_offset_sd * draws.constant("offset")
    if sky.clock_drift_sd > 0:
        constant = sky.clock_drift_sd * draws.constant("drift")
        drift += constant
        offset += constant * (t - first)
    if sky.clock_h_0 > 0 or sky.clock_h_m2 > 0:
        white, walk = 0.5 * C**2 * sky.clock_h_0, 2 * np.pi**2 * C**2 * sky.clock_h_m2
        later = slice(0 if begun else 1, None)  # there is no step before the first epoch
        dt = steps[later]
        one, two = draws.stream("noise").standard_normal((len(dt), 2)).T
        before = draws.keep("walked", lambda: np.zeros(1))
        changed = np.sqrt(walk * dt) * one  # of the drift
        walked = draws.accumulate("walk", changed)
        own = np.sqrt(white * dt + walk * dt**3 / 12) * two
        since = np.concatenate([before, walked])
        offset[later] += draws.accumulate("walk of the offset", since[:-1] * dt + 0.5 * changed * dt + own)
        drift[later] += walked
        before[:] = since[-1]
    if sky.clock_h_m1 > 0:
        level = C * float(np.sqrt(2.0 * np.log(2.0) * sky.clock_h_m1))
        noise = draws.stream("flicker").standard_normal((len(t), len(STAGES), 2))
        sd = level * draws.keep("stages", lambda: allan.fit_flat_deviation(STAGES, *FLAT_TIMES))
        state, flicker = draws.keep("flicker", lambda: np.zeros((len(STAGES), 2))), np.zeros((len(t), 2))
        flicker_kernel(steps, np.array(STAGES), sd, noise, begun, state, flicker)
        offset += flicker[:, 0]
        drift += flicker[:, 1]
    return offset, drift
