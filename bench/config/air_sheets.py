"""Barometers, magnetometers and airspeed units by their datasheets -> specs in SI."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Annotated

from bench.config.sheet import Figure, Rate, Sheet, reported, unsourced
from bench.config.tables import Table, between, checked, read
from bench.errors import ConfigError
from bench.specs import AirspeedSpec, BaroSpec, MagSpec, StaticPressureSpec

_DEG = math.pi / 180
_HOUR = 3600.0


class BaroTable(Table):
    """Errors of the altitude, as the instrument puts it out."""

    rate_hz: Rate
    white_sd_m: Figure
    bias_sd_m: Figure = 0.0
    bias_walk_m_sqrt_s: Figure = 0.0
    quantization_m: Figure = 0.0
    latency_s: Figure = 0.0


class PhysicalTable(Table):
    """A barometer by the static pressure it feels; an error that is left out is off."""

    pressure_white_sd_pa: Figure = 0.0
    pressure_bias_sd_pa: Figure = 0.0
    temperature_sd_pa_k: Figure = 0.0
    isa_deviation_k: Annotated[float, between(-60, 60)] = 0.0
    isa_deviation_sd_k: Annotated[float, between(0, 20)] = 0.0
    qnh_sd_hpa: Annotated[float, between(0, 50)] = 0.0
    qnh_walk_hpa_sqrt_h: Annotated[float, between(0, 50)] = 0.0
    position_error: Annotated[float, between(-0.5, 0.5)] = 0.0
    position_error_alpha_per_deg: Annotated[float, between(-0.1, 0.1)] = 0.0
    position_error_beta2_per_deg2: Annotated[float, between(-0.01, 0.01)] = 0.0
    lag_s: Annotated[float, between(0, 60)] = 0.0
    quantization_pa: Figure = 0.0


class BaroSheet(Sheet):
    """A barometric altimeter: what it puts out and, with [physical], what it feels."""

    baro: BaroTable
    physical: PhysicalTable | None = None


class MagTable(Table):
    """Errors of the magnetic field, as the unit puts it out where it is mounted."""

    rate_hz: Rate
    white_sd_nt: Figure
    hard_iron_sd_nt: Figure = 0.0
    soft_iron_sd_percent: Annotated[float, between(0, 100)] = 0.0
    scale_factor_sd_percent: Annotated[float, between(0, 100)] = 0.0
    misalignment_sd_deg: Annotated[float, between(0, 45)] = 0.0
    range_ut: Figure = 0.0
    quantization_nt: Figure = 0.0
    latency_s: Figure = 0.0


class MagSheet(Sheet):
    """A magnetometer."""

    mag: MagTable


class AirspeedTable(Table):
    """Errors of a pitot tube, its pressure sensor and the true airspeed computed of it."""

    rate_hz: Rate
    pressure_white_sd_pa: Figure = 0.0
    white_sd_mps: Figure = 0.0
    pressure_bias_sd_pa: Figure = 0.0
    bias_sd_mps: Figure = 0.0
    scale_factor_sd_percent: Annotated[float, between(0, 50)] = 0.0
    lag_s: Annotated[float, between(0, 60)] = 0.0
    range_pa: Figure = 0.0
    quantization_pa: Figure = 0.0
    min_speed_mps: Annotated[float, between(0, 100)] = 0.0
    latency_s: Figure = 0.0


class AirspeedSheet(Sheet):
    """An airspeed unit."""

    airspeed: AirspeedTable


def read_baro(path: Path, shown: str) -> BaroSpec:
    """Return the barometer of a datasheet file, in SI; raise ConfigError for each thing wrong."""
    document = read(path, shown)
    sheet = checked(BaroSheet, document, shown)
    table = sheet.baro
    wrong = unsourced(sheet, document) + reported(table, "baro", "white_sd_m")
    physical = sheet.physical
    if physical is not None and table.quantization_m:
        wrong.append(
            "[baro] quantization_m is not for a barometer with [physical]: give quantization_pa there"
        )
    if wrong:
        raise ConfigError(*(f"{shown}: {line}" for line in wrong))
    return BaroSpec(
        name=path.stem,
        rate=table.rate_hz,
        white_sd=table.white_sd_m,
        bias_sd=table.bias_sd_m,
        bias_walk=table.bias_walk_m_sqrt_s,
        quantization=table.quantization_m,
        latency=table.latency_s,
        physical=None if physical is None else _physical(physical),
    )


def _physical(table: PhysicalTable) -> StaticPressureSpec:
    return StaticPressureSpec(
        white_sd=table.pressure_white_sd_pa,
        bias_sd=table.pressure_bias_sd_pa,
        temperature_sd=table.temperature_sd_pa_k,
        isa_deviation=table.isa_deviation_k,
        isa_deviation_sd=table.isa_deviation_sd_k,
        qnh_sd=100.0 * table.qnh_sd_hpa,
        qnh_walk=100.0 / math.sqrt(_HOUR) * table.qnh_walk_hpa_sqrt_h,
        position_error=table.position_error,
        position_error_alpha=table.position_error_alpha_per_deg / _DEG,
        position_error_beta2=table.position_error_beta2_per_deg2 / _DEG**2,
        lag=table.lag_s,
        quantization=table.quantization_pa,
    )


def read_mag(path: Path, shown: str) -> MagSpec:
    """Return the magnetometer of a datasheet file, in SI; raise ConfigError for each thing wrong."""
    document = read(path, shown)
    sheet = checked(MagSheet, document, shown)
    table = sheet.mag
    wrong = unsourced(sheet, document) + reported(table, "mag", "white_sd_nt")
    if wrong:
        raise ConfigError(*(f"{shown}: {line}" for line in wrong))
    return MagSpec(
        name=path.stem,
        rate=table.rate_hz,
        white_sd=1e-9 * table.white_sd_nt,
        hard_iron_sd=1e-9 * table.hard_iron_sd_nt,
        soft_iron_sd=1e-2 * table.soft_iron_sd_percent,
        scale_factor_sd=1e-2 * table.scale_factor_sd_percent,
        misalignment_sd=_DEG * table.misalignment_sd_deg,
        range=1e-6 * table.range_ut,
        quantization=1e-9 * table.quantization_nt,
        latency=table.latency_s,
    )


def read_airspeed(path: Path, shown: str) -> AirspeedSpec:
    """Return the airspeed unit of a datasheet file, in SI; raise ConfigError for each thing wrong."""
    document = read(path, shown)
    sheet = checked(AirspeedSheet, document, shown)
    table = sheet.airspeed
    wrong = unsourced(sheet, document)
    if table.pressure_white_sd_pa == 0 and table.white_sd_mps == 0:
        wrong.append("[airspeed] pressure_white_sd_pa or white_sd_mps must be above 0: the unit reports it")
    if wrong:
        raise ConfigError(*(f"{shown}: {line}" for line in wrong))
    return AirspeedSpec(
        name=path.stem,
        rate=table.rate_hz,
        pressure_white_sd=table.pressure_white_sd_pa,
        white_sd=table.white_sd_mps,
        pressure_bias_sd=table.pressure_bias_sd_pa,
        bias_sd=table.bias_sd_mps,
        scale_factor_sd=1e-2 * table.scale_factor_sd_percent,
        lag=table.lag_s,
        range=table.range_pa,
        quantization=table.quantization_pa,
        min_speed=table.min_speed_mps,
        latency=table.latency_s,
    )
