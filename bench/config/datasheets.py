"""Sensors by their datasheets: a catalog entry in its maker's units -> a spec in SI."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import Field, create_model

from bench.config.air_sheets import (
    AirspeedTable,
    BaroTable,
    MagTable,
    read_airspeed,
    read_baro,
    read_mag,
)
from bench.config.sheet import Figure, Rate, Sheet, reported, unsourced
from bench.config.sky_sheet import SkyTable, read_sky
from bench.config.tables import ROWS, Table, between, checked, noting, quantity, read
from bench.errors import ConfigError
from bench.specs import (
    AirspeedSpec,
    BaroSpec,
    GnssSpec,
    ImuSpec,
    MagSpec,
    ThermalSpec,
    TriadSpec,
    VibrationSpec,
)
from bench.unit_names import split_unit

_DEG = math.pi / 180
_HOUR = 3600.0
_G = 9.80665  # standard gravity, the unit of datasheets [m/s^2]

_ARCSEC = _DEG / 3600


def _angles(name: str) -> dict[str, float]:
    return {f"{name}_mrad": 1e-3, f"{name}_deg": _DEG, f"{name}_arcsec": _ARCSEC, f"{name}_percent": 1e-2}


def _shares(name: str) -> dict[str, float]:
    return {f"{name}_ppm": 1e-6, f"{name}_percent": 1e-2}


def _drift(name: str) -> dict[str, float]:
    return {f"{name}_deg_h": _DEG / _HOUR, f"{name}_deg_s": _DEG}


def _acceleration(name: str) -> dict[str, float]:
    return {f"{name}_ug": 1e-6 * _G, f"{name}_mg": 1e-3 * _G}


_COMMON = {
    "bias_correlation": {"bias_correlation_s": 1.0},
    "scale_factor_sd": _shares("scale_factor_sd"),
    "misalignment_sd": _angles("misalignment_sd"),
    "scale_asymmetry_sd": _shares("scale_asymmetry_sd"),
    "nonlinearity_sd": _shares("nonlinearity_sd"),
    "nonorthogonality_sd": _angles("nonorthogonality_sd"),
    "alignment_sd": _angles("alignment_sd"),
    "bandwidth": {"bandwidth_hz": 1.0},
    "delay": {"delay_s": 1.0},
}
GYRO: dict[str, dict[str, float]] = {
    "random_walk": {"noise_deg_sqrt_h": _DEG / math.sqrt(_HOUR), "noise_deg_s_sqrt_hz": _DEG},
    "bias_instability": _drift("bias_instability"),
    "turn_on_bias_sd": _drift("turn_on_bias_sd"),
    "quantization": {"quantization_rad": 1.0, "quantization_deg": _DEG},
    "rate_random_walk": {
        "rate_random_walk_deg_h_sqrt_h": _DEG / _HOUR / math.sqrt(_HOUR),
        "rate_random_walk_deg_s_sqrt_s": _DEG,
    },
    "g_sensitivity_sd": {
        "g_sensitivity_sd_deg_h_g": _DEG / _HOUR / _G,
        "g_sensitivity_sd_deg_s_g": _DEG / _G,
    },
    "g2_sensitivity_sd": {
        "g2_sensitivity_sd_deg_h_g2": _DEG / _HOUR / _G**2,
        "g2_sensitivity_sd_deg_s_g2": _DEG / _G**2,
    },
    "temperature_sd": {"temperature_sd_deg_h_k": _DEG / _HOUR, "temperature_sd_deg_s_k": _DEG},
    "dead_zone": _drift("dead_zone"),
    "range": {"range_deg_s": _DEG},
    **_COMMON,
}
"""Field of ``TriadSpec`` -> the keys a datasheet may give it by -> factor to SI."""
ACCEL: dict[str, dict[str, float]] = {
    "random_walk": {
        "noise_m_s_sqrt_h": 1 / math.sqrt(_HOUR),
        "noise_ug_sqrt_hz": 1e-6 * _G,
        "noise_mg_sqrt_hz": 1e-3 * _G,
    },
    "bias_instability": _acceleration("bias_instability"),
    "turn_on_bias_sd": _acceleration("turn_on_bias_sd"),
    "quantization": {"quantization_m_s": 1.0},
    "rate_random_walk": {"rate_random_walk_ug_sqrt_h": 1e-6 * _G / math.sqrt(_HOUR)},
    "quadratic_sd": {"quadratic_sd_ug_g2": 1e-6 / _G},
    "temperature_sd": {"temperature_sd_ug_k": 1e-6 * _G, "temperature_sd_mg_k": 1e-3 * _G},
    "dead_zone": _acceleration("dead_zone"),
    "range": {"range_g": _G},
    **_COMMON,
}
"""The same for accelerometers."""
_TRIAD = {
    "noise": ("random_walk",),
    "bias instability": ("bias_instability",),
    "turn-on bias": ("turn_on_bias_sd",),
    "scale factor": ("scale_factor_sd",),
    "misalignment": ("misalignment_sd", "nonorthogonality_sd", "alignment_sd"),
    "temperature": ("temperature_sd",),
    "range": ("range",),
    "bandwidth": ("bandwidth",),
}
_EXPECTED = {
    "gyro": _TRIAD | {"g-sensitivity": ("g_sensitivity_sd", "g2_sensitivity_sd")},
    "accel": _TRIAD,
}  # what a reader looks for on a datasheet -> the fields that may say it
_CHOICES = {"bias_model": "flicker", "dead_zone_kind": "subtractive"}
"""What a triad chooses instead of measuring, and what it chooses when it does not say."""


def _triad(name: str, units: Mapping[str, Mapping[str, float]]) -> type[Table]:
    """Build the model of a triad from its table of units: every figure may be absent."""
    keys = [key for spellings in units.values() for key in spellings]
    figures: dict[str, Any] = dict.fromkeys(keys, (Figure | None, None))
    figures["bias_model"] = (Literal["flicker", "gauss-markov"], _CHOICES["bias_model"])
    figures["dead_zone_kind"] = (Literal["subtractive", "hard"], _CHOICES["dead_zone_kind"])
    return create_model(name, __base__=Table, **figures)


class ThermalTable(Table):
    """How warm the unit is, and at which temperature it was calibrated."""

    reference_degc: Annotated[float, between(-60, 150)] = 25.0
    self_heating_k: Figure = 0.0
    time_constant_s: Figure = 0.0


class VibrationTable(Table):
    """Shaking at the place of the unit, rms of each axis."""

    engine_gyro_deg_s: Figure = 0.0
    engine_accel_mg: Figure = 0.0
    engine_reference_rpm: Figure = 0.0
    engine_order: Figure = 1.0
    gust_gyro_deg_s_per_mps: Figure = 0.0
    gust_accel_mg_per_mps: Figure = 0.0
    mode_frequency_hz: Figure = 0.0
    mode_damping: Annotated[float, between(0, 1)] = 0.0


_Metres = Annotated[float, between(-10, 10)]
Place = Annotated[tuple[_Metres, _Metres, _Metres], ROWS]


class LayoutTable(Table):
    """Where the accelerometers sit, from the unit's reference point, and what they point along."""

    accel_cone_deg: Annotated[float, between(0, 89)] = 0.0
    accel_x_m: Place = (0.0, 0.0, 0.0)
    accel_y_m: Place = (0.0, 0.0, 0.0)
    accel_z_m: Place = (0.0, 0.0, 0.0)


class ImuSheet(Sheet):
    """An IMU; a figure the datasheet does not give is absent."""

    gyro: _triad("Gyro", GYRO) = Field(default_factory=dict)  # type: ignore[valid-type]
    accel: _triad("Accel", ACCEL) = Field(default_factory=dict)  # type: ignore[valid-type]
    thermal: ThermalTable = ThermalTable()
    vibration: VibrationTable = VibrationTable()
    layout: LayoutTable = LayoutTable()


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
    pos_h_jump_sd_m: Figure = 0.0
    pos_v_jump_sd_m: Figure = 0.0
    vel_jump_sd_mps: Figure = 0.0
    pos_h_jump_markov_sd_m: Figure = 0.0
    pos_v_jump_markov_sd_m: Figure = 0.0
    vel_jump_markov_sd_mps: Figure = 0.0
    optimism: Annotated[float, between(0.05, 20)] = 1.0  # true over reported standard deviation


_JUMPS = ("pos_h_jump", "pos_v_jump", "vel_jump", "pos_h_jump_markov", "pos_v_jump_markov", "vel_jump_markov")
"""Jumps of a position-level receiver where the satellites in use change."""


class GnssSheet(Sheet):
    """A GNSS receiver: what it puts out and, with [sky], what it measures."""

    gnss: GnssTable
    sky: SkyTable | None = None


def read_imu(path: Path, shown: str) -> ImuSpec:
    """Return the IMU of a datasheet file, in SI.

    Raises
    ------
    ConfigError
        One message per thing that is wrong with the file ``shown``.
    """
    document = read(path, shown)
    sheet = checked(ImuSheet, document, shown)
    wrong = unsourced(sheet, document)
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
        triads[name] = TriadSpec(**values, **{key: given.get(key, usual) for key, usual in _CHOICES.items()})
        if triads[name].nonlinearity_sd > 0 and triads[name].range <= 0:
            unit = "range_deg_s" if name == "gyro" else "range_g"
            wrong.append(f"[{name}] nonlinearity_sd needs {unit} above 0: it is a share of the range")
        if triads[name].bias_instability > 0 and triads[name].bias_correlation <= 0:
            wrong.append(f"[{name}] bias_instability needs bias_correlation_s above 0 s")
    wrong += _incomplete(sheet.vibration)
    if wrong:
        raise ConfigError(*(f"{shown}: {line}" for line in wrong))
    arms = (sheet.layout.accel_x_m, sheet.layout.accel_y_m, sheet.layout.accel_z_m)
    return ImuSpec(
        path.stem,
        triads["gyro"],
        triads["accel"],
        thermal=ThermalSpec(
            reference=sheet.thermal.reference_degc + 273.15,
            self_heating=sheet.thermal.self_heating_k,
            time_constant=sheet.thermal.time_constant_s,
        ),
        vibration=_vibration(sheet.vibration),
        accel_cone=_DEG * sheet.layout.accel_cone_deg,
        accel_arms=arms if any(map(any, arms)) else (),
    )


def _vibration(table: VibrationTable) -> VibrationSpec:
    return VibrationSpec(
        engine_gyro=_DEG * table.engine_gyro_deg_s,
        engine_accel=1e-3 * _G * table.engine_accel_mg,
        engine_reference=2 * math.pi / 60 * table.engine_reference_rpm,
        engine_order=table.engine_order,
        gust_gyro=_DEG * table.gust_gyro_deg_s_per_mps,
        gust_accel=1e-3 * _G * table.gust_accel_mg_per_mps,
        mode_frequency=table.mode_frequency_hz,
        mode_damping=table.mode_damping,
    )


def _incomplete(table: VibrationTable) -> list[str]:
    """Say which vibration lacks the figures it needs."""
    wrong = []
    engine = table.engine_gyro_deg_s or table.engine_accel_mg
    if engine and not (table.engine_reference_rpm > 0 and table.engine_order > 0):
        wrong.append("[vibration] engine shaking needs engine_reference_rpm and engine_order above 0")
    if table.gust_gyro_deg_s_per_mps or table.gust_accel_mg_per_mps:
        if table.mode_frequency_hz <= 0:
            wrong.append("[vibration] shaking by gusts needs mode_frequency_hz above 0 Hz")
        if not 0 < table.mode_damping < 1:
            wrong.append("[vibration] shaking by gusts needs mode_damping above 0 and below 1")
    return wrong


def read_gnss(path: Path, shown: str) -> GnssSpec:
    """Return the GNSS receiver of a datasheet file, in SI; raise ConfigError as `read_imu` does."""
    document = read(path, shown)
    sheet = checked(GnssSheet, document, shown)
    table = sheet.gnss
    wrong = unsourced(sheet, document)
    decays = ("pos_decay_distance_km", "pos_decay_time_s", "vel_decay_time_s")
    wrong += [
        f"[gnss] {quantity(key, 0)} must be above 0; leave it out when there is no such decay"
        for key in decays
        if getattr(table, key) == 0
    ]
    wrong += reported(table, "gnss", "pos_h_white_sd_m", "pos_v_white_sd_m", "vel_white_sd_mps")
    position = table.pos_h_markov_sd_m or table.pos_v_markov_sd_m
    if position and table.pos_decay_distance_km is None and table.pos_decay_time_s is None:
        wrong.append("[gnss] pos_h_markov_sd_m needs pos_decay_distance_km or pos_decay_time_s")
    if table.vel_markov_sd_mps and table.vel_decay_time_s is None:
        wrong.append("[gnss] vel_markov_sd_mps needs vel_decay_time_s")
    jumps = {name: getattr(table, f"{name}_sd_{'mps' if name.startswith('vel') else 'm'}") for name in _JUMPS}
    lasting = jumps["pos_h_jump_markov"] or jumps["pos_v_jump_markov"]
    if lasting and table.pos_decay_distance_km is None and table.pos_decay_time_s is None:
        wrong.append("[gnss] pos_h_jump_markov_sd_m needs pos_decay_distance_km or pos_decay_time_s")
    if jumps["vel_jump_markov"] and table.vel_decay_time_s is None:
        wrong.append("[gnss] vel_jump_markov_sd_mps needs vel_decay_time_s")
    if sheet.sky is not None and any(jumps.values()):
        wrong.append("[gnss] jumps follow from the satellites of [sky]; leave their figures out")
    sky = None
    if sheet.sky is not None:
        with noting(wrong):
            sky = read_sky(sheet.sky, path.parent)
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
        **{f"{name}_sd": value for name, value in jumps.items()},
        optimism=table.optimism,
        sky=sky,
    )


def absent(kind: str, document: Mapping[str, Any]) -> list[str]:
    """Name, in words, what a datasheet does not say: errors that the unit then does not have.

    Parameters
    ----------
    kind : str
        A key of ``SENSORS``.
    document : mapping
        A file that has been checked.
    """
    if kind == "imu":
        return [
            f"{part} {what}"
            for part, units in (("gyro", GYRO), ("accel", ACCEL))
            for what, fields in _EXPECTED[part].items()
            if not any(key in document.get(part, {}) for field in fields for key in units[field])
        ]
    tables: dict[str, type[Table]] = {
        "gnss": GnssTable,
        "baro": BaroTable,
        "mag": MagTable,
        "airspeed": AirspeedTable,
    }
    said = {split_unit(key)[0] for table in document.values() if isinstance(table, dict) for key in table}
    names = [split_unit(key)[0] for key in tables[kind].model_fields]
    return [name.removesuffix("_sd").replace("_", " ") for name in names if name not in said]


SENSORS: dict[str, Callable[[Path, str], ImuSpec | GnssSpec | BaroSpec | MagSpec | AirspeedSpec]] = {
    "imu": read_imu,
    "gnss": read_gnss,
    "baro": read_baro,
    "mag": read_mag,
    "airspeed": read_airspeed,
}
"""Kind of sensor, which is also its folder in the catalog -> how its datasheet is read."""
