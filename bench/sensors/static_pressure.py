"""Barometric altitude from the static pressure: errors of port, lines, sensor, weather and setting."""

from __future__ import annotations

import numpy as np

from bench import rotation
from bench.arrays import FloatArray
from bench.data import Trajectory
from bench.instruments import BaroData, BaroSpec, StaticPressureSpec
from bench.sensors.processes import apply_lag
from bench.sensors.timing import find_epoch_rows
from bench.signals import air
from bench.specs import stream
from bench.units import STANDARD_GRAVITY

_REFERENCE = 298.15  # temperature of the calibration [K]


def measure(
    truth: Trajectory,
    spec: BaroSpec,
    qnh: float,
    static_port_b: tuple[float, float, float],
    seed: int,
    run: int,
) -> tuple[BaroData, FloatArray]:
    """Simulate a barometer with a ``physical`` part; return its record and its error without noise.

    Parameters
    ----------
    truth : Trajectory
        With the air of the flight at 20 Hz, interpolated linearly.
    spec : BaroSpec
        The instrument; the reported ``sd`` is its ``white_sd``.
    qnh : float
        Altimeter setting [Pa].
    static_port_b : (3,) tuple
        Static port relative to the centre of gravity, to which the air data belong [m], b.
    seed, run : int
        Select the draw of the errors.

    Returns
    -------
    baro : BaroData
        Geopotential height of the standard atmosphere between setting and measured pressure, at
        t = 1/rate, 2/rate, ...
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
    rows = find_epoch_rows("baro", truth.t, spec.rate)
    t = truth.t[rows]

    def draw(name: str, sd: float, count: int = 1) -> FloatArray:
        if sd <= 0:
            return np.zeros(count)
        noise: FloatArray = sd * stream(seed, run, f"baro.{name}").standard_normal(count)
        return noise

    warmer = unit.isa_deviation + float(draw("isa_deviation", unit.isa_deviation_sd)[0])
    outside = compute_port_pressure(truth, unit, warmer, static_port_b)
    pressure = np.interp(t, truth.air.t, apply_lag(truth.air.t, outside, outside[0], unit.lag))
    pressure += draw("pressure_bias", unit.pressure_bias_sd)
    warmth = np.interp(t, truth.air.t, truth.air.temperature) + warmer - _REFERENCE
    pressure += draw("temperature", unit.temperature_sd) * warmth
    sea_level = draw("qnh", unit.qnh_sd) + np.zeros(len(t))
    if unit.qnh_walk > 0:
        steps = draw("qnh_walk", 1.0, len(t))
        sea_level += unit.qnh_walk * np.cumsum(np.sqrt(np.diff(t, prepend=truth.t[0])) * steps)
    pressure *= 1.0 + sea_level / air.SEA_LEVEL_PRESSURE  # the pressure at all heights changes in proportion
    bias = air.pressure_altitude(pressure, qnh) - truth.lla[rows, 2]
    pressure = pressure + draw("pressure_white", unit.pressure_white_sd, len(t))
    if unit.quantization > 0:
        pressure = unit.quantization * np.rint(pressure / unit.quantization)
    baro = BaroData(
        t=t,
        t_arrival=t + spec.latency,
        valid=np.ones(len(t), bool),
        alt_baro=air.pressure_altitude(pressure, qnh),
        sd=np.full(len(t), spec.white_sd),
    )
    return baro, bias


def compute_port_pressure(
    truth: Trajectory,
    unit: StaticPressureSpec,
    warmer: float,
    static_port_b: tuple[float, float, float],
) -> FloatArray:
    """Return the pressure at the static port (A,) [Pa], at the instants of the air data.

    Parameters
    ----------
    truth : Trajectory
        With the air of the flight.
    unit : StaticPressureSpec
        Its position error is proportional to the impact pressure of the air data.
    warmer : float
        Temperature added to the air of the flight, from sea level to the port [K]; the pressure at sea level
        does not change.
    static_port_b : (3,) tuple
        Port relative to the point of the air data [m], b.
    """
    around = truth.air
    nearest = np.clip(np.searchsorted(truth.t, around.t - 1e-6), 0, len(truth.t) - 1)
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
