"""Sensors by their datasheets: a catalog entry in its maker's units -> a spec in SI."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import cache, partial
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import Field, create_model

from bench.config.sheet import Figure, Sheet, check_figures, check_sources, convert_figures, make_table_type
from bench.config.sky_sheet import SkyTable, read_sky
from bench.config.tables import ROWS, Table, between, check_table, collect_errors, read_toml
from bench.errors import ConfigError
from bench.fields import figures_of, triad_figures_of
from bench.instruments import INSTRUMENTS
from bench.specs import GnssSpec, ImuSpec, ThermalSpec, TriadSpec, VibrationSpec
from bench.units import split_unit, to_si

_TRIADS = ("gyro", "accel")
_CHOICES = {"bias_model": "flicker", "dead_zone_kind": "subtractive"}
"""What a triad chooses instead of measuring, and what it chooses when it does not say."""


def _make_triad_table(name: str) -> type[Table]:
    """Build the table of "gyro" or "accel": every figure may be absent."""
    keys = [key for field, told in triad_figures_of(TriadSpec).items() for key in told.keys(field, name)]
    rows: dict[str, Any] = dict.fromkeys(keys, (Figure | None, None))
    rows["bias_model"] = (Literal["flicker", "gauss-markov"], _CHOICES["bias_model"])
    rows["dead_zone_kind"] = (Literal["subtractive", "hard"], _CHOICES["dead_zone_kind"])
    return create_model(name.capitalize(), __base__=Table, **rows)


_Metres = Annotated[float, between(-10, 10)]
Place = Annotated[tuple[_Metres, _Metres, _Metres], ROWS]


class LayoutTable(Table):
    """Where the accelerometers sit, from the unit's reference point, and what they point along."""

    accel_cone_deg: Annotated[float, between(0, 89)] = 0.0
    accel_x_m: Place = (0.0, 0.0, 0.0)
    accel_y_m: Place = (0.0, 0.0, 0.0)
    accel_z_m: Place = (0.0, 0.0, 0.0)


_Thermal, _Vibration = make_table_type(ThermalSpec), make_table_type(VibrationSpec)


class ImuSheet(Sheet):
    """An IMU; a figure the datasheet does not give is absent."""

    gyro: _make_triad_table("gyro") = Field(default_factory=dict)  # type: ignore[valid-type]
    accel: _make_triad_table("accel") = Field(default_factory=dict)  # type: ignore[valid-type]
    thermal: _Thermal = _Thermal()  # type: ignore[valid-type]
    vibration: _Vibration = _Vibration()  # type: ignore[valid-type]
    layout: LayoutTable = LayoutTable()


_JUMPS = [name for name in figures_of(GnssSpec) if "_jump_" in name]
"""Jumps of a position-level receiver where the satellites in use change."""


class GnssSheet(Sheet):
    """A GNSS receiver: what it puts out and, with [sky], what it measures."""

    gnss: make_table_type(GnssSpec)  # type: ignore[valid-type]
    sky: SkyTable | None = None


def read_imu(path: Path, shown: str) -> ImuSpec:
    """Return the IMU of a datasheet file, in SI.

    Raises
    ------
    ConfigError
        One message per thing that is wrong with the file ``shown``.
    """
    document = read_toml(path, shown)
    sheet = check_table(ImuSheet, document, shown)
    wrong = check_sources(sheet, document)
    triads = {}
    for name in _TRIADS:
        given = document.get(name, {})  # checked above
        values = {key: given.get(key, usual) for key, usual in _CHOICES.items()}
        for field, told in triad_figures_of(TriadSpec).items():
            keys = [key for key in told.keys(field, name) if key in given]
            if len(keys) > 1:
                wrong.append(f"[{name}] {keys[0]} and {keys[1]} are one figure; give one of them")
            for key in keys:
                values[field] = to_si(key, given[key])
        triads[name] = TriadSpec(**values)
        if triads[name].nonlinearity_sd > 0 and triads[name].range <= 0:
            unit = "range_deg_s" if name == "gyro" else "range_g"
            wrong.append(f"[{name}] nonlinearity_sd needs {unit} above 0: it is a share of the range")
        if triads[name].bias_instability > 0 and triads[name].bias_correlation <= 0:
            wrong.append(f"[{name}] bias_instability needs bias_correlation_s above 0 s")
    vibration = VibrationSpec(**convert_figures(VibrationSpec, sheet.vibration))
    wrong += _check_vibration(vibration)
    if wrong:
        raise ConfigError(*(f"{shown}: {line}" for line in wrong))
    arms = (sheet.layout.accel_x_m, sheet.layout.accel_y_m, sheet.layout.accel_z_m)
    return ImuSpec(
        path.stem,
        triads["gyro"],
        triads["accel"],
        thermal=ThermalSpec(**convert_figures(ThermalSpec, sheet.thermal)),
        vibration=vibration,
        accel_cone=to_si("accel_cone_deg", sheet.layout.accel_cone_deg),
        accel_arms=arms if any(map(any, arms)) else (),
    )


def _check_vibration(shaking: VibrationSpec) -> list[str]:
    """Say which vibration lacks the figures it needs."""
    wrong = []
    engine = shaking.engine_gyro or shaking.engine_accel
    if engine and not (shaking.engine_reference > 0 and shaking.engine_order > 0):
        wrong.append("[vibration] engine shaking needs engine_reference_rpm and engine_order above 0")
    if shaking.gust_gyro or shaking.gust_accel:
        if shaking.mode_frequency <= 0:
            wrong.append("[vibration] shaking by gusts needs mode_frequency_hz above 0 Hz")
        if not 0 < shaking.mode_damping < 1:
            wrong.append("[vibration] shaking by gusts needs mode_damping above 0 and below 1")
    return wrong


def read_gnss(path: Path, shown: str) -> GnssSpec:
    """Return the GNSS receiver of a datasheet file, in SI; raise ConfigError as `read_imu` does."""
    document = read_toml(path, shown)
    sheet = check_table(GnssSheet, document, shown)
    spec = GnssSpec(name=path.stem, **convert_figures(GnssSpec, sheet.gnss))
    wrong = check_sources(sheet, document) + check_figures(GnssSpec, sheet.gnss, "gnss")
    decays = spec.pos_decay_distance or spec.pos_decay_time
    for kind in ("markov", "jump_markov"):
        if (getattr(spec, f"pos_h_{kind}_sd") or getattr(spec, f"pos_v_{kind}_sd")) and not decays:
            wrong.append(f"[gnss] pos_h_{kind}_sd_m needs pos_decay_distance_km or pos_decay_time_s")
        if getattr(spec, f"vel_{kind}_sd") and not spec.vel_decay_time:
            wrong.append(f"[gnss] vel_{kind}_sd_mps needs vel_decay_time_s")
    if sheet.sky is not None and any(getattr(spec, name) for name in _JUMPS):
        wrong.append("[gnss] jumps follow from the satellites of [sky]; leave their figures out")
    if sheet.sky is not None:
        with collect_errors(wrong):
            spec = replace(spec, sky=read_sky(sheet.sky, path.parent))
    if wrong:
        raise ConfigError(*(f"{shown}: {line}" for line in wrong))
    return spec


def read_instrument(kind: str, path: Path, shown: str) -> Any:
    """Return an instrument of a datasheet file, in SI; raise ConfigError as `read_imu` does."""
    row, document = INSTRUMENTS[kind], read_toml(path, shown)
    sheet = check_table(_make_sheet_type(kind), document, shown)
    table = getattr(sheet, kind)
    parts = {
        name: part(**convert_figures(part, getattr(sheet, name)))
        for name, part in row.parts.items()
        if getattr(sheet, name) is not None
    }
    spec = row.spec(name=path.stem, **convert_figures(row.spec, table), **parts)
    wrong = check_sources(sheet, document) + check_figures(row.spec, table, kind) + row.problems(spec)
    if wrong:
        raise ConfigError(*(f"{shown}: {line}" for line in wrong))
    return spec


@cache
def _make_sheet_type(kind: str) -> type[Sheet]:
    """Return the model of the datasheet of an instrument: its table, and those of its parts."""
    row = INSTRUMENTS[kind]
    parts: dict[str, Any] = {name: (make_table_type(spec) | None, None) for name, spec in row.parts.items()}
    rows: dict[str, Any] = {kind: (make_table_type(row.spec), ...), **parts}
    return create_model(f"{kind}Sheet", __base__=Sheet, **rows)


def list_missing_figures(kind: str, document: Mapping[str, Any]) -> list[str]:
    """Name, in words, what a datasheet does not say: errors that the unit then does not have.

    Parameters
    ----------
    kind : str
        A key of ``SENSORS``.
    document : mapping
        A file that has been checked.
    """
    if kind == "imu":
        found: dict[str, bool] = {}
        for name in _TRIADS:
            for field, told in triad_figures_of(TriadSpec).items():
                keys = told.keys(field, name)
                if told.sought and keys:
                    what = f"{name} {told.sought}"
                    found[what] = found.get(what, False) or any(key in document.get(name, {}) for key in keys)
        return [what for what, there in found.items() if not there]
    named = {split_unit(key)[0] for table in document.values() if isinstance(table, dict) for key in table}
    spec = GnssSpec if kind == "gnss" else INSTRUMENTS[kind].spec
    return [name.removesuffix("_sd").replace("_", " ") for name in figures_of(spec) if name not in named]


SENSORS: Mapping[str, Callable[[Path, str], Any]] = {
    "imu": read_imu,
    "gnss": read_gnss,
    **{kind: partial(read_instrument, kind) for kind in INSTRUMENTS},
}
"""Kind of sensor, which is also its folder in the catalog -> how its datasheet is read."""
