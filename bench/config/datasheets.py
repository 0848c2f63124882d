"""Sensors by their datasheets: a catalog entry in its maker's units -> a spec in SI."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import Field, create_model

from bench.config.tables import NOT_NEGATIVE, ConfigError, Table, between, checked, quantity, read
from bench.specs import BaroSpec, GnssSpec, ImuSpec, TriadSpec

_DEG = math.pi / 180
_HOUR = 3600.0
_G = 9.80665  # standard gravity, the unit of datasheets [m/s^2]

_COMMON = {
    "bias_correlation": {"bias_correlation_s": 1.0},
    "scale_factor_sd": {"scale_factor_sd_ppm": 1e-6, "scale_factor_sd_percent": 1e-2},
    "misalignment_sd": {"misalignment_sd_mrad": 1e-3, "misalignment_sd_deg": _DEG},
}
GYRO: dict[str, dict[str, float]] = {
    "random_walk": {"noise_deg_sqrt_h": _DEG / math.sqrt(_HOUR), "noise_deg_s_sqrt_hz": _DEG},
    "bias_instability": {"bias_instability_deg_h": _DEG / _HOUR},
    "turn_on_bias_sd": {"turn_on_bias_sd_deg_h": _DEG / _HOUR, "turn_on_bias_sd_deg_s": _DEG},
    "quantization": {"quantization_rad": 1.0, "quantization_deg": _DEG},
    **_COMMON,
}
"""Field of ``TriadSpec`` -> the keys a datasheet may give it by -> factor to SI."""
ACCEL: dict[str, dict[str, float]] = {
    "random_walk": {"noise_m_s_sqrt_h": 1 / math.sqrt(_HOUR), "noise_ug_sqrt_hz": 1e-6 * _G},
    "bias_instability": {"bias_instability_ug": 1e-6 * _G, "bias_instability_mg": 1e-3 * _G},
    "turn_on_bias_sd": {"turn_on_bias_sd_mg": 1e-3 * _G},
    "quantization": {"quantization_m_s": 1.0},
    **_COMMON,
}
"""The same for accelerometers."""

Grade = Literal["consumer", "industrial", "tactical", "navigation", "synthetic"]
Figure = Annotated[float, NOT_NEGATIVE]
Rate = Annotated[float, between(0.01, 400)]


def _triad(name: str, units: Mapping[str, Mapping[str, float]]) -> type[Table]:
    """Build the model of a triad from its table of units: every figure may be absent."""
    keys = [key for spellings in units.values() for key in spellings]
    figures: dict[str, Any] = dict.fromkeys(keys, (Figure | None, None))
    figures["bias_model"] = (Literal["flicker", "gauss-markov"], "flicker")
    return create_model(name, __base__=Table, **figures)


class Sheet(Table):
    """What every datasheet says: where its figures come from."""

    title: str | None = None
    grade: Grade | None = Field(default=None, alias="class")
    source: str
    sources: dict[str, str] = Field(default_factory=dict)  # of single figures, by "table.key"
    assumed: list[str] = Field(default_factory=list)  # figures that no source states


class ImuSheet(Sheet):
    """An IMU; a figure the datasheet does not give is absent."""

    gyro: _triad("Gyro", GYRO) = Field(default_factory=dict)  # type: ignore[valid-type]
    accel: _triad("Accel", ACCEL) = Field(default_factory=dict)  # type: ignore[valid-type]


class GnssTable(Table):
    """Errors of position and velocity, as the receiver puts them out."""

    rate_hz: Rate
    pos_h_white_sd_m: Figure
    pos_v_white_sd_m: Figure
    vel_white_sd_mps: Figure
    pos_h_markov_sd_m: Figure = 0.0
    pos_v_markov_sd_m: Figure = 0.0
    vel_markov_sd_mps: Figure = 0.0
    pos_decay_distance_km: Figure | None = None
    pos_decay_time_s: Figure | None = None
    vel_decay_time_s: Figure | None = None
    latency_s: Figure = 0.0


class GnssSheet(Sheet):
    """A GNSS receiver at the level of position and velocity."""

    gnss: GnssTable


class BaroTable(Table):
    """Errors of the altitude, as the instrument puts it out."""

    rate_hz: Rate
    white_sd_m: Figure
    bias_sd_m: Figure = 0.0
    bias_walk_m_sqrt_s: Figure = 0.0
    quantization_m: Figure = 0.0
    latency_s: Figure = 0.0


class BaroSheet(Sheet):
    """A barometric altimeter."""

    baro: BaroTable


def read_imu(path: Path, shown: str) -> ImuSpec:
    """Return the IMU of a datasheet file, in SI.

    Raises
    ------
    ConfigError
        One message per thing that is wrong with the file ``shown``.
    """
    document = read(path, shown)
    sheet = checked(ImuSheet, document, shown)
    wrong = _unsourced(sheet, document)
    triads = {}
    for name, units in {"gyro": GYRO, "accel": ACCEL}.items():
        given = document.get(name, {})  # checked above
        for spellings in units.values():
            twice = [key for key in spellings if key in given]
            if len(twice) > 1:
                wrong.append(f"[{name}] {twice[0]} and {twice[1]} are one figure; give one of them")
        values = {
            field: given[key] * factor
            for field, spellings in units.items()
            for key, factor in spellings.items()
            if key in given
        }
        triads[name] = TriadSpec(**values, bias_model=given.get("bias_model", "flicker"))
        if triads[name].bias_instability > 0 and triads[name].bias_correlation <= 0:
            wrong.append(f"[{name}] bias_instability needs bias_correlation_s above 0 s")
    if wrong:
        raise ConfigError(*(f"{shown}: {line}" for line in wrong))
    return ImuSpec(path.stem, triads["gyro"], triads["accel"])


def read_gnss(path: Path, shown: str) -> GnssSpec:
    """Return the GNSS receiver of a datasheet file, in SI; raise ConfigError as `read_imu` does."""
    document = read(path, shown)
    sheet = checked(GnssSheet, document, shown)
    table = sheet.gnss
    wrong = _unsourced(sheet, document)
    decays = ("pos_decay_distance_km", "pos_decay_time_s", "vel_decay_time_s")
    wrong += [
        f"[gnss] {quantity(key, 0)} must be above 0; leave it out when there is no such decay"
        for key in decays
        if getattr(table, key) == 0
    ]
    wrong += _reported(table, "gnss", "pos_h_white_sd_m", "pos_v_white_sd_m", "vel_white_sd_mps")
    position = table.pos_h_markov_sd_m or table.pos_v_markov_sd_m
    if position and table.pos_decay_distance_km is None and table.pos_decay_time_s is None:
        wrong.append("[gnss] pos_h_markov_sd_m needs pos_decay_distance_km or pos_decay_time_s")
    if table.vel_markov_sd_mps and table.vel_decay_time_s is None:
        wrong.append("[gnss] vel_markov_sd_mps needs vel_decay_time_s")
    if wrong:
        raise ConfigError(*(f"{shown}: {line}" for line in wrong))
    return GnssSpec(
        name=path.stem,
        rate=table.rate_hz,
        pos_h_white_sd=table.pos_h_white_sd_m,
        pos_v_white_sd=table.pos_v_white_sd_m,
        vel_white_sd=table.vel_white_sd_mps,
        pos_h_markov_sd=table.pos_h_markov_sd_m,
        pos_v_markov_sd=table.pos_v_markov_sd_m,
        vel_markov_sd=table.vel_markov_sd_mps,
        pos_decay_distance=1e-3 / table.pos_decay_distance_km if table.pos_decay_distance_km else 0.0,
        pos_decay_time=1 / table.pos_decay_time_s if table.pos_decay_time_s else 0.0,
        vel_decay_time=1 / table.vel_decay_time_s if table.vel_decay_time_s else 0.0,
        latency=table.latency_s,
    )


def read_baro(path: Path, shown: str) -> BaroSpec:
    """Return the barometer of a datasheet file, in SI; raise ConfigError as `read_imu` does."""
    document = read(path, shown)
    sheet = checked(BaroSheet, document, shown)
    table = sheet.baro
    wrong = _unsourced(sheet, document) + _reported(table, "baro", "white_sd_m")
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
    )


def _reported(table: Table, name: str, *keys: str) -> list[str]:
    """Say which of the noises that the unit itself reports, and a filter divides by, are 0."""
    return [
        f"[{name}] {quantity(key, getattr(table, key))} must be above 0: the unit reports it"
        for key in keys
        if getattr(table, key) == 0
    ]


def _unsourced(sheet: Sheet, document: Mapping[str, Any]) -> list[str]:
    """Say which of the figures named in ``sources`` and ``assumed`` the file does not give."""
    tables = [key for key in document if key not in Sheet.model_fields and isinstance(document[key], dict)]
    figures = {f"{table}.{key}" for table in tables for key in document[table]}
    return [
        f"{where}: {name!r} is no figure of this file"
        for where, names in {"[sources]": sheet.sources, "assumed": sheet.assumed}.items()
        for name in names
        if name not in figures
    ]


SENSORS: dict[str, Callable[[Path, str], ImuSpec | GnssSpec | BaroSpec]] = {
    "imu": read_imu,
    "gnss": read_gnss,
    "baro": read_baro,
}
"""Kind of sensor, which is also its folder in the catalog -> how its datasheet is read."""
