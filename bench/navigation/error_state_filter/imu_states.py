"""States for an IMU: biases, and a state or noise for each error in its datasheet."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from bench.core.mathematics.arrays import FloatArray
from bench.core.records.sensor_specs import AssumedSpecs, ImuSpec, TriadSpec
from bench.navigation.error_state_filter.error_state import CORE_BLOCKS, StateLayout
from bench.navigation.error_state_filter.state_processes import (
    ABSOLUTE,
    CUBE,
    SQUARE,
    STEADY,
    WARMTH,
    Block,
    States,
)
from bench.simulation.signals import air
from bench.simulation.signals.allan import fit_flat_deviation

AIR_SD = 10.0  # of the temperature of the air about the standard atmosphere [K]
AIR_WALK = 0.01  # change of that on the way, 0.6 K in an hour [K/sqrt(s)]

ROUNDING_TIME = 1.0  # over which the carried rounding of increments counts as one step of a random walk [s]
FLICKER_STAGES = (0.05, 0.55, 6.0)
"""Correlation times of Gauss-Markov processes whose sum is flicker noise, over that of the triad [1]."""


def thermal_figures(t: float, height: float, imu: ImuSpec) -> FloatArray:
    """Return the temperature of an IMU in the standard atmosphere, switched on at t = 0 (`Process`).

    It begins at a time [s] and a height [m].
    """
    spec = imu.thermal
    ground = air.SEA_LEVEL_TEMPERATURE + spec.self_heating - spec.reference
    begun = ground + air.LAPSE * height
    if spec.time_constant > 0:
        begun -= spec.self_heating * np.exp(-max(t, 0.0) / spec.time_constant)
    return np.array([begun, ground, air.LAPSE, spec.time_constant])


def core_states(specs: AssumedSpecs, *, changing: bool) -> list[States]:
    """Return the states of every layout; P of the first three comes from the initial state.

    ``changing`` biases hold temperature and rate random walk, too, and the noise what the samples are rounded
    by: its sum is carried, so it differs between two epochs by the variance of two roundings.
    """
    gyro, accel = specs.imu.gyro, specs.imu.accel
    pos, vel, phi, gyro_bias, accel_bias = CORE_BLOCKS
    rounding = 1.0 / (6.0 * ROUNDING_TIME) if changing else 0.0
    return [
        States(*pos),
        States(*vel, density=accel.random_walk**2 + rounding * accel.quantization**2),
        States(*phi, density=gyro.random_walk**2 + rounding * gyro.quantization**2),
        *(
            _changing_bias(bias, triad) if changing else bias
            for bias, triad in ((_bias(*gyro_bias, gyro), gyro), (_bias(*accel_bias, accel), accel))
        ),
    ]


def _changing_bias(bias: States, triad: TriadSpec) -> States:
    """Return bias states with the slow stage of flicker, temperature and a rate random walk."""
    if stages := _flicker_stages(triad):
        time, slow2 = stages[-1]
        decay = 0.0 if triad.turn_on_bias_sd > 0 else 1.0 / time
        variance = triad.by_axis("turn_on_bias_sd") ** 2 + slow2
        bias = replace(bias, variance=variance, density=2.0 * slow2 / time, decay_time=decay)
    by_heat = triad.by_axis("temperature_sd")
    heat2 = (by_heat * AIR_SD) ** 2
    more = (by_heat * AIR_WALK) ** 2 + triad.by_axis("rate_random_walk") ** 2
    if not more.any():
        return bias
    return replace(bias, variance=bias.variance + heat2, density=bias.density + more, decay_time=0.0)


def _bias(name: str, unit: str, size: int, triad: TriadSpec) -> States:
    """Return bias states: random walks, or without a turn-on bias Gauss-Markov processes."""
    instability2 = triad.instability_by_axis**2
    variance = triad.by_axis("turn_on_bias_sd") ** 2 + instability2
    if not instability2.any():
        return States(name, unit, size, variance)
    decay = 0.0 if triad.turn_on_bias_sd > 0 else 1 / triad.bias_correlation
    return States(name, unit, size, variance, 2 * instability2 / triad.bias_correlation, decay)


def _mems(specs: AssumedSpecs) -> list[States]:
    gyro, accel = specs.imu.gyro, specs.imu.accel
    same = tuple((i, i, i) for i in range(3))
    along = tuple((i, 3 + i, 3 + i) for i in range(3))
    return [
        States("gyro_scale", "1", 3, gyro.by_axis("scale_factor_sd") ** 2, drives=same),
        States("accel_scale", "1", 3, accel.by_axis("scale_factor_sd") ** 2, drives=along),
        *_g_sensitivity(specs),
    ]


def _g_sensitivity(specs: AssumedSpecs) -> list[States]:
    variance = specs.imu.gyro.g_sensitivity_sd**2
    return [
        States(
            f"g_sensitivity_{axis}",
            "rad_s_per_m_s2",
            3,
            variance,
            drives=tuple((j, i, 3 + j) for j in range(3)),
        )
        for i, axis in enumerate("xyz")
    ]


MEMS = Block("mems", _mems, takes=("gyro scale factor", "accelerometer scale factor", "gyro g-sensitivity"))
"""Scale factors, and the g-sensitivity of the gyros: 3 x 3, as the sensor has it (A-5.1.8)."""


def _g2_sensitivity(specs: AssumedSpecs) -> list[States]:
    sd, name, unit = specs.imu.gyro.g2_sensitivity_sd, "g2_sensitivity", "rad_s_per_m2_s4"
    return [
        States(f"{name}_{axis}", unit, 3, sd**2, drives=tuple((j, i, SQUARE + 3 + j) for j in range(3)))
        for i, axis in enumerate("xyz")
        if sd > 0
    ]


def _every_error(specs: AssumedSpecs) -> list[States]:
    found: list[States] = []
    for name, triad, at in (("gyro", specs.imu.gyro, 0), ("accel", specs.imu.accel, 3)):
        scale = triad.by_axis("scale_factor_sd") ** 2
        across = triad.misalignment_sd**2 + 0.25 * triad.nonorthogonality_sd**2 + triad.alignment_sd**2
        if across > 0:  # row by row of M in (I + M) w
            for i, axis in enumerate("xyz"):
                variance = np.full(3, across)
                variance[i] = scale[i]
                drives = tuple((j, at + i, at + j) for j in range(3))
                found.append(States(f"{name}_matrix_{axis}", "1", 3, variance, drives=drives))
        elif scale.any():
            drives = tuple((i, at + i, at + i) for i in range(3))
            found.append(States(f"{name}_scale", "1", 3, scale, drives=drives))
        for kind, unit, figure, factor in (
            ("asymmetry", "1", "scale_asymmetry_sd", ABSOLUTE + at),
            ("nonlinearity", "1", "nonlinearity_sd", CUBE + at),
            ("quadratic", "s2_per_m", "quadratic_sd", SQUARE + at),
            ("temperature", "per_K", "temperature_sd", WARMTH),
        ):
            sd = triad.by_axis(figure)
            if sd.any():
                step = 0 if factor == WARMTH else 1
                drives = tuple((i, at + i, factor + step * i) for i in range(3))
                found.append(States(f"{name}_{kind}", unit, 3, sd**2, drives=drives))
    found += _flicker("gyro", "rad_s", specs.imu.gyro, 0) + _flicker("accel", "m_s2", specs.imu.accel, 3)
    found += _g_sensitivity(specs) if specs.imu.gyro.g_sensitivity_sd > 0 else []
    return found + _g2_sensitivity(specs)


def correlate_axes(P: FloatArray, layout: StateLayout, imu: ImuSpec) -> None:
    """Add to P (n, n) what the elements ij and ji of each 3 x 3 matrix have in common.

    Non-orthogonality leans both axes of a pair by half of it, alignment turns them. A triad that is turned
    and leveled by itself measures as if it was not turned.
    """
    for name, triad in (("gyro", imu.gyro), ("accel", imu.accel)):
        common = 0.25 * triad.nonorthogonality_sd**2 - triad.alignment_sd**2
        if common and layout.has(f"{name}_matrix_x"):
            first = layout.slice(f"{name}_matrix_x").start
            for i, j in ((0, 1), (0, 2), (1, 2)):
                one, other = first + 3 * i + j, first + 3 * j + i
                P[one, other] = P[other, one] = common


def _flicker_stages(triad: TriadSpec) -> list[tuple[float, FloatArray]]:
    """Return correlation time [s] and variance (3,) of the stages of a flicker bias, the slowest last."""
    if triad.bias_model != "flicker" or triad.bias_instability == 0:
        return []
    sd = np.outer(fit_flat_deviation(FLICKER_STAGES, 0.1, 10.0, 81), triad.by_axis("bias_instability"))
    times = triad.bias_correlation * np.array(FLICKER_STAGES)
    return list(zip(times.tolist(), sd**2, strict=True))


def _flicker(name: str, unit: str, triad: TriadSpec, at: int) -> list[States]:
    """Return the fast stages of a flicker bias; the slowest one is part of the bias."""
    drives = tuple((i, at + i, STEADY) for i in range(3))
    return [
        States(f"{name}_flicker_{k}", unit, 3, variance, 0.0, 1.0 / time, stationary=variance, drives=drives)
        for k, (time, variance) in enumerate(_flicker_stages(triad)[:-1], 1)
    ]


EVERY_ERROR = Block(
    "every_error",
    _every_error,
    takes=tuple(
        f"{triad} {error}"
        for triad in ("gyro", "accelerometer")
        for error in (
            "scale factor",
            "misalignment",
            "non-orthogonality",
            "alignment",
            "nonlinearity",
            "scale factor asymmetry",
            "g-sensitivity",
            "temperature bias",
            "rate random walk",
            "bias instability as flicker noise",
            "quantization",
            "sensitivity to g squared",
        )
    )
    + tuple(f"{sensor} quantization" for sensor in ("barometer", "radar altimeter", "odometer")),
)
"""Scale factors and misalignments as the 3 x 3 matrix of each triad; asymmetry, nonlinearity, sensitivity to
temperature and to acceleration and its square; what is 0 has no state.

With it the biases also hold a rate random walk and what the air differs from the standard atmosphere does to
them, and flicker noise is a sum of processes: its fast stages are states, the slowest is part of the bias.
Roundings are noise (`aiding_sensors`).
"""
