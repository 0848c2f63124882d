"""Barometric altitude from the static pressure: errors of port, lines, sensor, weather and setting."""

from __future__ import annotations

import numpy as np

from bench.core.mathematics import rotation
from bench.core.mathematics.arrays import FloatArray
from bench.core.mathematics.units import SAME_INSTANT, STANDARD_GRAVITY
from bench.core.records.data import Trajectory
from bench.core.records.instruments import BaroData, BaroSpec, StaticPressureSpec
from bench.simulation.sensors.draws import SensorDraws
from bench.simulation.sensors.sampling import Sampler, round_to
from bench.simulation.signals import air

_REFERENCE = 298.15  # temperature of the calibration [K]


def measure(
    truth: Trajectory,
    spec: BaroSpec,
    qnh: float,
    static_port_b: tuple[float, float, float],
    draws: SensorDraws,
) -> tuple[BaroData, FloatArray]:
    """Simulate a barometer with a ``physical`` part; return its record and its error without noise.

    Parameters
    ----------
    truth, spec, draws
        As for `Sampler`, with the air of the flight at 20 Hz, interpolated linearly; the reported ``sd`` is
        the ``white_sd`` of the spec.
    qnh : float
        Altimeter setting [Pa].
    static_port_b : (3,) tuple
        Static port relative to the center of gravity, to which the air data belong [m], b.

    Returns
    -------
    baro : BaroData
        Geopotential height of the standard atmosphere between setting and measured pressure.
    bias : (M,) array
        Altitude without noise and rounding, minus the ellipsoidal height [m]: errors of weather, port and
        lag, and the difference of geopotential and geometric height (16 m at 10 km).

    Raises
    ------
    ValueError
        If the rate is above that of the truth, or the truth has no air data.
    """
    unit = spec.physical
    if unit is None:
        raise ValueError(f"baro {spec.name!r} has no physical part")
    if not len(truth.air.t):
        raise ValueError("baro: the truth has no air data")
    samples = Sampler("baro", truth, spec, draws)
    t, draw = samples.t, samples.draw
    warmer = unit.isa_deviation + float(draw("isa_deviation", unit.isa_deviation_sd))
    outside = compute_port_pressure(truth, unit, warmer, static_port_b)
    pressure = np.interp(t, truth.air.t, samples.lag("port", truth.air.t, outside, unit.lag))
    pressure += draw("pressure_bias", unit.pressure_bias_sd)
    warmth = np.interp(t, truth.air.t, truth.air.temperature) + warmer - _REFERENCE
    pressure += draw("temperature", unit.temperature_sd) * warmth
    sea_level = draw("qnh", unit.qnh_sd) + samples.draw_walk("qnh_walk", unit.qnh_walk)
    pressure *= 1.0 + sea_level / air.SEA_LEVEL_PRESSURE  # the pressure at all heights changes in proportion
    bias = air.pressure_altitude(pressure, qnh) - truth.lla[samples.rows, 2]
    pressure += samples.draw_white("pressure_white", unit.pressure_white_sd)
    pressure = round_to(pressure, unit.quantization)
    baro = BaroData(
        t=t,
        t_arrival=t + spec.latency,
        valid=np.ones(len(t), bool),
        alt_baro=air.pressure_altitude(pressure, qnh),
        sd=np.full(len(t), spec.white_sd),
    )
    return baro, bias


def compute_port_pressure(
    truth: Trajectory, unit: StaticPressureSpec, warmer: float, static_port_b: tuple[float, float, float]
) -> FloatArray:
    """Return the pressure at the static port (A,) [Pa], at the epochs of the air data.

    The position error of the unit is in proportion to the impact pressure. ``warmer`` [K] is added to the air
    of the flight from sea level to the port; the pressure at sea level does not change. ``static_port_b``
    (3,) [m] is relative to the point of the air data, b.
    """
    around = truth.air
    nearest = np.minimum(np.searchsorted(truth.t, around.t - SAME_INSTANT), len(truth.t) - 1)
    pressure, temperature = around.pressure, around.temperature + warmer
    if warmer:
        height = air.to_geopotential(truth.lla[nearest, 2])
        pressure = pressure * air.standard_atmosphere(height, warmer)[0] / air.standard_atmosphere(height)[0]
    if any(static_port_b):
        below = rotation.rotate(truth.q_nb[nearest], np.array(static_port_b))[:, 2]
        pressure = pressure * np.exp(STANDARD_GRAVITY * below / (air.GAS_CONSTANT * temperature))
    coefficient = (
        unit.position_error
        + unit.position_error_alpha * around.alpha
        + unit.position_error_beta2 * around.beta**2
    )
    if coefficient.any():
        pressure = pressure + coefficient * air.impact_pressure(around.airspeed_true, pressure, temperature)
    return pressure
