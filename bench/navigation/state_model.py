"""What an estimator believes of its states: their layout, spread at the start, process noise and decay.

Everything comes from the datasheets an estimator is told to assume; nothing from a result.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from bench.arrays import FloatArray, IntArray
from bench.data import InitialState
from bench.instruments import AirspeedData, MagData
from bench.navigation.error_state import CORE, GYRO, StateLayout
from bench.signals import air
from bench.signals.orbits import C
from bench.specs import AssumedSpecs, TriadSpec

WIND_SD = 10.0  # of each horizontal component of the wind at the start, a fresh breeze [m/s]
WIND_WALK = 0.1  # change of the wind as the aircraft moves through it: 2.4 m/s in 10 minutes [m/s/sqrt(s)]


@dataclass(frozen=True, slots=True)
class Blocks:
    """Which states there are beyond position, velocity, attitude and biases."""

    baro_bias: bool = False  # a random walk
    gnss_markov: bool = False  # Gauss-Markov part of the GNSS position and velocity errors
    mems: bool = False  # scale factors, and g-sensitivity of the gyros: 3 x 3, as the sensor has it
    clock: bool = False  # offset and drift of the receiver's clock, offset of its GLONASS
    lever_arm: float = 0.0  # sd of each component of the antenna's place [m]; 0: no states
    wind: bool = False  # north and east, random walks


@dataclass(frozen=True, slots=True)
class StateModel:
    """A layout of n states and the processes they follow between measurements."""

    layout: StateLayout
    P: FloatArray  # (n, n) at the start
    q: FloatArray  # (n,) density of the white noise that drives each state [unit^2/s]
    decay_time: FloatArray  # (n,) rate at which a Gauss-Markov state forgets by time [1/s], else 0
    decay_distance: FloatArray  # (n,) and by distance over ground [1/m], else 0
    stationary: FloatArray  # (n,) variance a Gauss-Markov state tends to, in place of q; else 0
    drives: IntArray  # (D, 3) a state, the bias it acts like, and the rate (0-2) or force (3-5) it multiplies

    def at(self, name: str) -> int:
        """Return where a block begins, -1 without it."""
        return self.layout.slice(name).start if self.layout.has(name) else -1


def state_model(initial: InitialState, specs: AssumedSpecs, blocks: Blocks) -> StateModel:
    """Return position, velocity, attitude and IMU biases, and the blocks asked for.

    Parameters
    ----------
    initial : InitialState
        Covariance of position, velocity and attitude at the start, and theirs with the biases.
    specs : AssumedSpecs
        The datasheets to believe.
    blocks : Blocks
        The rest.

    Raises
    ------
    ValueError
        When a sensor has no assumed spec.

    Notes
    -----
    Clock: ``c^2 h_0 / 2`` into the offset and ``2 pi^2 c^2 h_-2`` into the drift (Brown and Hwang); flicker,
    h_-1, has no state of finite size.
    """
    named: list[tuple[str, str, int]] = []
    if blocks.baro_bias:
        named.append(("baro_bias", "m", 1))
    if blocks.gnss_markov:
        named += [("gnss_pos", "m", 3), ("gnss_vel", "m_s", 3)]
    if blocks.mems:
        named += [("gyro_scale", "1", 3), ("accel_scale", "1", 3)]
        named += [(f"g_sensitivity_{axis}", "rad_s_per_m_s2", 3) for axis in "xyz"]
    if blocks.clock:
        named += [("clock_offset", "m", 1), ("clock_drift", "m_s", 1), ("glonass_offset", "m", 1)]
    if blocks.lever_arm > 0:
        named.append(("antenna_b", "m", 3))
    if blocks.wind:
        named += [("wind_north", "m_s", 1), ("wind_east", "m_s", 1)]
    layout = StateLayout(*named)
    n = layout.size
    P = np.zeros((n, n))
    q, decay_time, decay_distance, stationary = np.zeros((4, n))
    drives: list[tuple[int, int, int]] = []
    gyro, accel = specs.imu.gyro, specs.imu.accel
    P[:9, :9] = initial.cov
    P[:9, GYRO:CORE], P[GYRO:CORE, :9] = initial.bias_cov, initial.bias_cov.T
    q[layout.slice("vel")] = accel.random_walk**2
    q[layout.slice("phi")] = gyro.random_walk**2
    for name, triad in (("gyro_bias", gyro), ("accel_bias", accel)):
        block = layout.slice(name)
        variance, q[block], decay_time[block] = _bias_process(triad)
        P[block, block] = np.eye(3) * variance
    if blocks.baro_bias:
        baro = known(specs.baro, "baro")
        block = layout.slice("baro_bias")
        P[block, block] = baro.bias_sd**2
        q[block] = baro.bias_walk**2
    if blocks.gnss_markov:
        gnss = known(specs.gnss, "gnss")
        pos, vel = layout.slice("gnss_pos"), layout.slice("gnss_vel")
        stationary[pos] = np.square([gnss.pos_h_markov_sd, gnss.pos_h_markov_sd, gnss.pos_v_markov_sd])
        stationary[vel] = gnss.vel_markov_sd**2
        decay_time[pos], decay_distance[pos] = gnss.pos_decay_time, gnss.pos_decay_distance
        decay_time[vel] = gnss.vel_decay_time
        P += np.diag(stationary)
    if blocks.mems:
        for name, sd, bias, rate in (
            ("gyro_scale", gyro.scale_factor_sd, "gyro_bias", 0),
            ("accel_scale", accel.scale_factor_sd, "accel_bias", 3),
        ):
            block = layout.slice(name)
            P[block, block] = np.eye(3) * sd**2
            at = layout.slice(bias).start
            drives += [(block.start + i, at + i, rate + i) for i in range(3)]
        for i, axis in enumerate("xyz"):
            block = layout.slice(f"g_sensitivity_{axis}")
            P[block, block] = np.eye(3) * gyro.g_sensitivity_sd**2
            drives += [(block.start + j, layout.slice("gyro_bias").start + i, 3 + j) for j in range(3)]
    if blocks.clock:
        sky = known(specs.gnss, "gnss").sky
        offset, drift = layout.slice("clock_offset"), layout.slice("clock_drift")
        second = layout.slice("glonass_offset")
        P[offset, offset], P[drift, drift] = sky.clock_offset_sd**2, sky.clock_drift_sd**2
        P[second, second] = sky.glonass_offset_sd**2
        q[offset] = 0.5 * C**2 * sky.clock_h_0
        q[drift] = 2.0 * np.pi**2 * C**2 * sky.clock_h_m2
    if blocks.lever_arm > 0:
        block = layout.slice("antenna_b")
        P[block, block] = np.eye(3) * blocks.lever_arm**2
    if blocks.wind:
        for name in ("wind_north", "wind_east"):
            block = layout.slice(name)
            P[block, block], q[block] = WIND_SD**2, WIND_WALK**2
    return StateModel(
        layout,
        P,
        q,
        decay_time,
        decay_distance,
        stationary,
        np.array(drives, np.int64).reshape(-1, 3),
    )


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


def airspeed_variance(record: AirspeedData, specs: AssumedSpecs, height: float) -> FloatArray:
    """Return the variance (M, 1) taken as white in an airspeed: with bias, zero and scale factor.

    The zero of the pressure counts as a speed in the standard air at a ``height`` [m]: that of the start.
    """
    a = known(specs.airspeed, "airspeed")
    zero = replace(a, white_sd=0.0, pressure_white_sd=a.pressure_bias_sd)
    pressure, temperature, _ = air.standard(height)
    shifted = air.airspeed_sd(zero, record.airspeed_true, pressure, temperature)
    scale = a.scale_factor_sd * record.airspeed_true
    variance: FloatArray = (record.sd**2 + a.bias_sd**2 + shifted**2 + scale**2)[:, None]
    return variance


def field_variance(record: MagData, specs: AssumedSpecs) -> FloatArray:
    """Return the variance (M, 3) taken as white in a magnetic field, what calibration left too."""
    m = known(specs.mag, "mag")
    size2 = np.sum(record.field_b**2, axis=1)
    left = m.scale_factor_sd**2 + m.soft_iron_sd**2 + m.misalignment_sd**2
    total = record.sd**2 + m.hard_iron_sd**2 + left * size2
    variance: FloatArray = np.repeat(total[:, None], 3, axis=1)
    return variance


def known(spec: Any, name: str) -> Any:
    """Return the spec of a sensor in use, or say that none is assumed."""
    if spec is None:
        raise ValueError(f"the record holds {name} data, but sensors.assumed names no {name} unit")
    return spec


def unmodelled(
    specs: AssumedSpecs,
    *,
    gnss: bool,
    baro: bool,
    gnss_markov: bool,
    mems: bool = False,
    tight: bool = False,
    latency: bool = False,
    airspeed: bool = False,
    magnetometer: bool = False,
) -> tuple[str, ...]:
    """Name the errors of these units that the states have no room for, in words.

    ``gnss`` and ``baro`` say which are used, ``tight`` that it is by satellite, ``latency`` that it is
    allowed for.
    """
    found = []
    for name, triad in (("gyro", specs.imu.gyro), ("accelerometer", specs.imu.accel)):
        found += [
            f"{name} {what}"
            for what, value in {
                "scale factor": 0.0 if mems else triad.scale_factor_sd,
                "misalignment": triad.misalignment_sd,
                "quantization": triad.quantization,
                "rate random walk": triad.rate_random_walk,
                "scale factor asymmetry": triad.scale_asymmetry_sd,
                "nonlinearity": max(triad.nonlinearity_sd, triad.quadratic_sd),
                "non-orthogonality": triad.nonorthogonality_sd,
                "alignment": triad.alignment_sd,
                "g-sensitivity": max(0.0 if mems else triad.g_sensitivity_sd, triad.g2_sensitivity_sd),
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
    if gnss:
        found += gnss_unmodelled(specs, markov=gnss_markov, tight=tight, latency=latency)
    if airspeed and specs.airspeed is not None:
        a = specs.airspeed
        if max(a.bias_sd, a.pressure_bias_sd, a.scale_factor_sd) > 0:
            found.append("airspeed bias and scale factor")
        if a.lag > 0:
            found.append("airspeed lag")
    if magnetometer and specs.mag is not None:
        m = specs.mag
        if max(m.hard_iron_sd, m.soft_iron_sd, m.scale_factor_sd, m.misalignment_sd) > 0:
            found.append("magnetometer calibration")
    if baro and specs.baro is not None and specs.baro.quantization > 0:
        found.append("barometer quantization")
    if baro and specs.baro is not None and specs.baro.physical is not None:
        found.append("barometer errors with height, airspeed and incidence")
    return tuple(found)


def gnss_unmodelled(
    specs: AssumedSpecs, *, markov: bool = False, tight: bool = False, latency: bool = False
) -> tuple[str, ...]:
    """Name the errors of the receiver that a filter has no room for, in words.

    ``markov`` says that it estimates the correlated part, ``tight`` that it takes every satellite by itself,
    ``latency`` that it allows for the latency.
    """
    if specs.gnss is None:
        return ()
    found: list[str] = []
    sky = specs.gnss.sky if tight else None
    if sky is not None:
        slow = {
            "satellite orbit and clock error": max(sky.gps_space_sd, sky.glonass_space_sd),
            "ionosphere beyond the broadcast model": sky.ionosphere_sd if sky.bands == 1 else 0.0,
            "troposphere beyond the model": sky.troposphere_sd,
            "multipath": max(sky.multipath_zenith_sd, sky.multipath_horizon_sd),
            "flicker of the receiver's clock": sky.clock_h_m1,
            "g-sensitivity of the receiver's clock": abs(sky.clock_g),
        }
        found += [what for what, sd in slow.items() if sd > 0]
    elif tight:
        found.append("GNSS at all: tight coupling needs a receiver with [sky]")
    elif not markov:
        if max(specs.gnss.pos_h_markov_sd, specs.gnss.pos_v_markov_sd) > 0:
            found.append("time-correlated GNSS position error")
        if specs.gnss.vel_markov_sd > 0:
            found.append("time-correlated GNSS velocity error")
    if specs.gnss.latency > 0 and not latency:
        found.append("GNSS latency")
    if specs.gnss.jumps and not tight:
        found.append("jumps of the GNSS error where the satellites change")
    return tuple(found)


def _bias_process(triad: TriadSpec) -> tuple[float, float, float]:
    """Return variance at the start, density and decay rate [1/s] of a bias state."""
    instability2 = triad.instability_sd**2
    if instability2 == 0:
        return triad.turn_on_bias_sd**2, 0.0, 0.0
    density = 2 * instability2 / triad.bias_correlation
    decay_rate = 0.0 if triad.turn_on_bias_sd > 0 else 1 / triad.bias_correlation
    return triad.turn_on_bias_sd**2 + instability2, density, decay_rate
