"""What an estimator believes of its states: their layout, spread at the start, process noise and decay.

Everything comes from the datasheets an estimator is told to assume; nothing from a result.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from bench.arrays import FloatArray
from bench.data import InitialState
from bench.navigation.error_state import StateLayout
from bench.specs import AssumedSpecs, TriadSpec


@dataclass(frozen=True, slots=True)
class StateModel:
    """A layout of n states and the processes they follow between measurements."""

    layout: StateLayout
    P: FloatArray  # (n, n) at the start
    q: FloatArray  # (n,) density of the white noise that drives each state [unit^2/s]
    decay_time: FloatArray  # (n,) rate at which a Gauss-Markov state forgets by time [1/s], else 0
    decay_distance: FloatArray  # (n,) and by distance over ground [1/m], else 0
    stationary: FloatArray  # (n,) variance a Gauss-Markov state tends to, in place of q; else 0


def state_model(
    initial: InitialState, specs: AssumedSpecs, *, baro_bias: bool, gnss_markov: bool
) -> StateModel:
    """Return position, velocity, attitude and IMU biases, and the blocks asked for.

    Parameters
    ----------
    initial : InitialState
        Covariance of position, velocity and attitude at the start.
    specs : AssumedSpecs
        The datasheets to believe.
    baro_bias : bool
        A random-walk barometer bias (A-5.3.2).
    gnss_markov : bool
        The Gauss-Markov part of the GNSS position and velocity errors (A-5.2.2, A-5.4.2), in metres.

    Raises
    ------
    ValueError
        When a sensor has no assumed spec.
    """
    blocks: list[tuple[str, str, int]] = []
    if baro_bias:
        blocks.append(("baro_bias", "m", 1))
    if gnss_markov:
        blocks += [("gnss_pos", "m", 3), ("gnss_vel", "m_s", 3)]
    layout = StateLayout(*blocks)
    n = layout.size
    P = np.zeros((n, n))
    q, decay_time, decay_distance, stationary = np.zeros((4, n))
    P[:9, :9] = initial.cov
    q[layout.slice("vel")] = specs.imu.accel.random_walk**2
    q[layout.slice("phi")] = specs.imu.gyro.random_walk**2
    for name, triad in (("gyro_bias", specs.imu.gyro), ("accel_bias", specs.imu.accel)):
        block = layout.slice(name)
        variance, q[block], decay_time[block] = _bias_process(triad)
        P[block, block] = np.eye(3) * variance
    if baro_bias:
        baro = known(specs.baro, "baro")
        block = layout.slice("baro_bias")
        P[block, block] = baro.bias_sd**2
        q[block] = baro.bias_walk**2
    if gnss_markov:
        gnss = known(specs.gnss, "gnss")
        pos, vel = layout.slice("gnss_pos"), layout.slice("gnss_vel")
        stationary[pos] = np.square([gnss.pos_h_markov_sd, gnss.pos_h_markov_sd, gnss.pos_v_markov_sd])
        stationary[vel] = gnss.vel_markov_sd**2
        decay_time[pos], decay_distance[pos] = gnss.pos_decay_time, gnss.pos_decay_distance
        decay_time[vel] = gnss.vel_decay_time
        P += np.diag(stationary)
    return StateModel(layout, P, q, decay_time, decay_distance, stationary)


def fix_variance(specs: AssumedSpecs, *, gnss_markov: bool) -> FloatArray:
    """Return the variances (6,) taken as white in a fix, position then velocity, n.

    With Markov states the white part of the datasheet; without, white and Markov part together.
    """
    g = known(specs.gnss, "gnss")
    rest = 0.0 if gnss_markov else 1.0
    h = g.pos_h_white_sd**2 + rest * g.pos_h_markov_sd**2
    v = g.pos_v_white_sd**2 + rest * g.pos_v_markov_sd**2
    s = g.vel_white_sd**2 + rest * g.vel_markov_sd**2
    return np.array([h, h, v, s, s, s])


def known(spec: Any, name: str) -> Any:
    """Return the spec of a sensor in use, or say that none is assumed."""
    if spec is None:
        raise ValueError(f"the record holds {name} data, but sensors.assumed names no {name} unit")
    return spec


def unmodelled(specs: AssumedSpecs, *, gnss: bool, baro: bool, gnss_markov: bool) -> tuple[str, ...]:
    """Name the errors of these units that the states have no room for, in words."""
    found = []
    for name, triad in (("gyro", specs.imu.gyro), ("accelerometer", specs.imu.accel)):
        found += [
            f"{name} {what}"
            for what, value in {
                "scale factor": triad.scale_factor_sd,
                "misalignment": triad.misalignment_sd,
                "quantization": triad.quantization,
                "rate random walk": triad.rate_random_walk,
                "scale factor asymmetry": triad.scale_asymmetry_sd,
                "nonlinearity": max(triad.nonlinearity_sd, triad.quadratic_sd),
                "non-orthogonality": triad.nonorthogonality_sd,
                "alignment": triad.alignment_sd,
                "g-sensitivity": max(triad.g_sensitivity_sd, triad.g2_sensitivity_sd),
                "temperature bias": triad.temperature_sd,
                "dead zone": triad.dead_zone,
                "bandwidth and delay": max(triad.bandwidth, triad.delay),
            }.items()
            if value > 0
        ]
        if triad.bias_instability > 0 and triad.bias_model == "flicker":
            found.append(f"{name} bias instability as flicker noise")
    if specs.imu.accel_arms:
        found.append("distance between the accelerometers")
    shaking = specs.imu.vibration
    if max(shaking.engine_gyro, shaking.engine_accel, shaking.gust_gyro, shaking.gust_accel) > 0:
        found.append("vibration")
    if gnss and specs.gnss is not None:
        if max(specs.gnss.pos_h_markov_sd, specs.gnss.pos_v_markov_sd) > 0 and not gnss_markov:
            found.append("time-correlated GNSS position error")
        if specs.gnss.vel_markov_sd > 0 and not gnss_markov:
            found.append("time-correlated GNSS velocity error")
        if specs.gnss.latency > 0:
            found.append("GNSS latency")
        if specs.gnss.jumps:
            found.append("jumps of the GNSS error where the satellites change")
    if baro and specs.baro is not None and specs.baro.quantization > 0:
        found.append("barometer quantization")
    if baro and specs.baro is not None and specs.baro.physical is not None:
        found.append("barometer errors with height, airspeed and incidence")
    return tuple(found)


def _bias_process(triad: TriadSpec) -> tuple[float, float, float]:
    """Return variance at the start, density and decay rate [1/s] of a bias state."""
    instability2 = triad.instability_sd**2
    if instability2 == 0:
        return triad.turn_on_bias_sd**2, 0.0, 0.0
    density = 2 * instability2 / triad.bias_correlation
    decay_rate = 0.0 if triad.turn_on_bias_sd > 0 else 1 / triad.bias_correlation
    return triad.turn_on_bias_sd**2 + instability2, density, decay_rate
