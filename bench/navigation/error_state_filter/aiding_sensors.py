"""Measurement models of the aiding instruments: one row a sensor.

A row says which record and datasheet belong to the sensor, and which rows of `measurement_rows` it fills and
how. Its errors are those that the figures of its datasheet describe. A new instrument is a row here and its
kernel in `measurement_rows.ROWS`. Satellites alone come another way (`ranging`).
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Iterator, Sequence
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np

from bench.core.mathematics import earth
from bench.core.mathematics.arrays import FloatArray
from bench.core.records.data import GnssFixes, InitialState, SensorData
from bench.core.records.fields import figures_of
from bench.core.records.instruments import (
    AirspeedData,
    AirspeedSpec,
    BaroData,
    BaroSpec,
    HeadingData,
    HeadingSpec,
    MagData,
    OdometerData,
    OdometerSpec,
    RadarData,
    RadarSpec,
)
from bench.core.records.sensor_specs import AssumedSpecs, GnssSpec, ImuSpec
from bench.navigation.error_state_filter.error_state import StateLayout
from bench.navigation.error_state_filter.measurement_rows import (
    AIRSPEED_ROWS,
    BARO_ROWS,
    FIX_ROWS,
    HEADING_ROWS,
    MAGNETIC_ROWS,
    ODOMETER_ROWS,
    RADAR_ROWS,
    SATELLITE_ROWS,
)
from bench.navigation.error_state_filter.state_blocks import CHANGES
from bench.navigation.options import FixAccuracy
from bench.simulation.signals import air
from bench.simulation.signals.magnetic import field_n

LATENCY, LAG = "GNSS latency", "lag of the receiver under acceleration"

Errors = Iterator[tuple[str, object]]
"""Words for an error of a sensor, and its size: zero or false where the unit has no such error."""

Reader = Callable[[Any, Any, SensorData, InitialState, StateLayout], tuple[FloatArray, FloatArray]]
"""Record (M rows), its datasheet, all sensors, start, layout -> values (M, m), up to six, and their variance
(m,) or (M, m)."""


def declared_errors(spec: Any) -> Errors:
    """Yield the errors that the figures of a datasheet describe."""
    for name, one in figures_of(type(spec)).items():
        if one.error:
            yield one.error, getattr(spec, name)


@dataclass(frozen=True, slots=True)
class AidingSensor:
    """One aiding sensor, its field in the records and its measurement model."""

    option: str  # of the filter, that switches it on
    record: str  # of `SensorData`
    spec: str  # of `AssumedSpecs`; its name in events, too
    kind: int  # of its rows
    read: Reader | None  # None: satellites
    errors: Callable[[Any], Errors] = declared_errors  # of its datasheet, beyond white noise
    on_request: bool = True  # a filter that asks for it cannot work without its record
    # variance of errors of one row; for ``every_error`` alone
    short: Callable[[Any], FloatArray] | None = None


def fix_variance(gnss: GnssSpec, *, gnss_markov: bool) -> FloatArray:
    """Return the variances (6,) taken as white in a fix, position [m^2] then velocity [m^2/s^2], n.

    With Markov states the white part of the datasheet; without, white and Markov part together. The error of
    carrier-smoothed code has no state and counts as white.
    """
    rest = 0.0 if gnss_markov else 1.0
    h = gnss.pos_h_white_sd**2 + rest * gnss.pos_h_markov_sd**2 + gnss.pos_h_smooth_sd**2
    v = gnss.pos_v_white_sd**2 + rest * gnss.pos_v_markov_sd**2 + gnss.pos_v_smooth_sd**2
    s = np.square(gnss.vel_white_sd_n) + rest * gnss.vel_markov_sd**2
    return np.array([h, h, v, *s])


def weigh_fixes(fixes: GnssFixes, gnss: GnssSpec, white: FloatArray, accuracy: FixAccuracy) -> FloatArray:
    """Return the variances (M, 6) of the fixes of a record.

    Parameters
    ----------
    fixes : GnssFixes
        Record; what it reports and is not above 0 is not used.
    gnss : GnssSpec
        The receiver, as it is assumed.
    white : (6,) array
        Variances by the datasheet, as :func:`fix_variance` returns them.
    accuracy : str
        "datasheet", "reported" by the receiver with each fix, or the "larger" of both: what it reports above
        the datasheet in all is added, so that an error with a state counts once. "auto": the larger for a
        receiver with [sky], whose geometry changes, and the datasheet for others.
    """
    stated = np.tile(white, (len(fixes), 1))
    if accuracy == "datasheet" or (accuracy == "auto" and gnss.sky is None):
        return stated
    found = np.hstack([np.einsum("mii->mi", cov) for cov in (fixes.cov_pos_n, fixes.cov_vel_n)])
    found = np.where(np.isfinite(found) & (found > 0), found, stated)
    if accuracy == "reported":
        return found
    total: FloatArray = np.maximum(fix_variance(gnss, gnss_markov=False), white)
    return stated + np.maximum(found - total, 0.0)


def jumps(gnss: GnssSpec) -> FloatArray:
    """Return the variance (6,) per epoch due to jumps [m^2], [m^2/s^2], from their size and rate."""
    sd = np.repeat([gnss.pos_h_jump_sd, gnss.pos_v_jump_sd, gnss.vel_jump_sd], [2, 1, 3])
    return np.asarray(min(CHANGES / gnss.rate, 1.0) * sd**2)


def _rounding(spec: BaroSpec | RadarSpec | OdometerSpec | HeadingSpec) -> FloatArray:
    return np.array([spec.quantization**2 / 12.0])


def _read_fixes(
    fixes: GnssFixes, gnss: GnssSpec, sensors: SensorData, _: InitialState, layout: StateLayout
) -> tuple[FloatArray, FloatArray]:
    variance = fix_variance(gnss, gnss_markov=layout.has("gnss_pos"))
    return np.hstack([fixes.lla, fixes.vel_n, np.tile(sensors.antenna_b, (len(fixes), 1))]), variance


def fix_errors(gnss: GnssSpec) -> Errors:
    """Yield the errors of a receiver's fixes beyond white noise."""
    yield "time-correlated GNSS position error", max(gnss.pos_h_markov_sd, gnss.pos_v_markov_sd)
    yield "time-correlated GNSS velocity error", gnss.vel_markov_sd
    yield "error of carrier-smoothed code", max(gnss.pos_h_smooth_sd, gnss.pos_v_smooth_sd)
    yield LATENCY, gnss.latency or gnss.latency_jitter
    yield "time tags of the fixes", gnss.time_tag_error
    yield "jumps of the GNSS error where the satellites change", gnss.jumps
    yield LAG, gnss.tracking_bandwidth


def _satellite_errors(gnss: GnssSpec) -> Errors:
    sky = gnss.sky
    if sky is None:
        yield "GNSS at all: tight coupling needs a receiver with [sky]", True
    else:
        yield "satellite orbit and clock error", max(sky.space_sd[system] for system in sky.constellations)
        yield "ionosphere beyond the broadcast model", sky.bands == 1 and sky.ionosphere_left
        yield "troposphere beyond the model", sky.troposphere_sd
        yield "multipath", max(sky.multipath_zenith_sd, sky.multipath_horizon_sd)
        yield "flicker of the receiver's clock", sky.clock_h_m1
        yield "g-sensitivity of the receiver's clock", sky.clock_g
    yield LATENCY, gnss.latency
    yield LAG, gnss.tracking_bandwidth


def _read_baro(record: BaroData, baro: BaroSpec, *_: object) -> tuple[FloatArray, FloatArray]:
    return record.alt_baro[:, None], np.array([baro.white_sd**2])


def _baro_errors(baro: BaroSpec) -> Errors:
    yield from declared_errors(baro)
    yield "barometer errors with height, airspeed and incidence", baro.physical is not None


def airspeed_variance(record: AirspeedData, airspeed: AirspeedSpec, height: float) -> FloatArray:
    """Return the variance (M, 1) taken as white in an airspeed [m^2/s^2]: with bias, zero and scale factor.

    The zero of the pressure counts as a speed in the standard air at a ``height`` [m]: that of the start.
    """
    zero = replace(airspeed, white_sd=0.0, pressure_white_sd=airspeed.pressure_bias_sd)
    pressure, temperature, _ = air.standard_atmosphere(height)
    shifted = air.airspeed_sd(zero, record.airspeed_true, pressure, temperature)
    scale = airspeed.scale_factor_sd * record.airspeed_true
    variance: FloatArray = (record.sd**2 + airspeed.bias_sd**2 + shifted**2 + scale**2)[:, None]
    return variance


def _read_airspeed(
    record: AirspeedData, airspeed: AirspeedSpec, _: SensorData, initial: InitialState, __: StateLayout
) -> tuple[FloatArray, FloatArray]:
    variance = airspeed_variance(record, airspeed, float(initial.lla[2]))
    return record.airspeed_true[:, None], variance


def _read_radar(
    record: RadarData, radar: RadarSpec, sensors: SensorData, *_: object
) -> tuple[FloatArray, FloatArray]:
    """Return the ellipsoidal height of the IMU: height above the runway plus height of the runway."""
    return (record.height + sensors.ground_alt)[:, None], np.array([radar.white_sd**2])


def _read_odometer(record: OdometerData, odometer: OdometerSpec, *_: object) -> tuple[FloatArray, FloatArray]:
    return record.speed[:, None], np.array([odometer.white_sd**2])


def _read_heading(record: HeadingData, *_: object) -> tuple[FloatArray, FloatArray]:
    return record.heading[:, None], np.square(record.sd)[:, None]


def _read_field(record: MagData, *_: object) -> tuple[FloatArray, FloatArray]:
    return record.field_b, np.repeat(np.square(record.sd)[:, None], 3, axis=1)


def magnetic_map(lla: FloatArray, date: float) -> FloatArray:
    """Return the field (4, 3) at a place [T], n, and its change by meter north, east and down.

    What is left out at 100 km is up to 16 nT, at 500 km 400 nT.
    """
    step = 1e4  # two cells of the grid of `bench.simulation.signals.magnetic` [m]
    ends = np.concatenate([step * np.eye(3), -step * np.eye(3)])
    around = field_n(np.vstack([lla, earth.displace(lla, ends)]), date)
    return np.vstack([around[0], (around[1:4] - around[4:]) / (2.0 * step)])


FIXES = AidingSensor("gnss", "fixes", "gnss", FIX_ROWS, _read_fixes, fix_errors, False, jumps)
SATELLITES = AidingSensor(
    "gnss", "observations", "gnss", SATELLITE_ROWS, None, _satellite_errors, on_request=False
)
AIRSPEED = AidingSensor("airspeed", "airspeed", "airspeed", AIRSPEED_ROWS, _read_airspeed)
MAGNETOMETER = AidingSensor("magnetometer", "mag", "mag", MAGNETIC_ROWS, _read_field)
RADAR = AidingSensor("radar", "radar", "radar", RADAR_ROWS, _read_radar, short=_rounding)
ODOMETER = AidingSensor("odometer", "odometer", "odometer", ODOMETER_ROWS, _read_odometer, short=_rounding)
HEADING = AidingSensor("heading", "heading", "heading", HEADING_ROWS, _read_heading, short=_rounding)
BARO = AidingSensor("baro", "baro", "baro", BARO_ROWS, _read_baro, _baro_errors, False, _rounding)

AIDING = (FIXES, SATELLITES, AIRSPEED, MAGNETOMETER, RADAR, ODOMETER, HEADING, BARO)


def records_needed(aiding: Sequence[AidingSensor]) -> tuple[str, ...]:
    """Return the records that a filter requires: GNSS or else the barometer, and the requested sensors."""
    usual = [sensor.record for sensor in aiding if not sensor.on_request]
    return (*usual[:1], *(sensor.record for sensor in aiding if sensor.on_request))


def unmodeled(specs: AssumedSpecs, aiding: Iterable[AidingSensor], taken: Collection[str]) -> tuple[str, ...]:
    """Return the errors of the IMU and of the sensors in use in words, without the ``taken`` errors."""
    found = list(imu_errors(specs.imu))
    for sensor in aiding:
        spec = getattr(specs, sensor.spec)
        found += () if spec is None else sensor.errors(spec)
    return remaining(found, taken)


def remaining(errors: Iterable[tuple[str, object]], taken: Collection[str]) -> tuple[str, ...]:
    """Return the errors of a sensor that no state or noise models, in words.

    Examples
    --------
    >>> remaining([("lag", 0.2), ("bias", 1.0), ("drift", 0.0)], taken={"bias"})
    ('lag',)
    """
    return tuple(dict.fromkeys(words for words, size in errors if size and words not in taken))


def imu_errors(imu: ImuSpec) -> Errors:
    """Yield the errors of an IMU beyond white noise and biases."""
    for name, triad in (("gyro", imu.gyro), ("accelerometer", imu.accel)):
        for one in fields(triad):
            if "triad" in one.metadata and one.metadata["triad"].error:
                yield f"{name} {one.metadata['triad'].error}", getattr(triad, one.name)
        flicker = triad.bias_model == "flicker"
        yield f"{name} bias instability as flicker noise", triad.bias_instability if flicker else 0.0
        yield f"{name} noise through the filter of the bandwidth", triad.noise_shape != "white"
    yield "distance between the accelerometers", imu.accel_arms
    yield "time tags of the IMU", max(imu.clock.drift, imu.clock.jitter)
    yield "vibration", imu.vibration.by_engine or imu.vibration.by_rotors
