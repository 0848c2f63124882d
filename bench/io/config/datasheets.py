"""Read sensor datasheets, in the units of the manufacturer, and return specs in SI."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import cache, partial
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import Field, create_model

from bench.core.mathematics.units import from_si, to_si
from bench.core.records.fields import XYZ, triad_figures_of
from bench.core.records.instruments import INSTRUMENTS
from bench.core.records.sensor_specs import (
    AxisFigures,
    GnssSpec,
    ImuSpec,
    SampleClockSpec,
    ThermalSpec,
    TriadSpec,
    VibrationSpec,
)
from bench.core.words.exceptions import ConfigError
from bench.core.words.wording import quantity, suggest
from bench.io.config.sheet import (
    MOST,
    Figure,
    Sheet,
    check_figures,
    check_sources,
    convert_figures,
    make_table_type,
)
from bench.io.config.sky_sheet import SkyTable, read_sky
from bench.io.config.tables import ROWS, Table, between, check_table, collect_errors
from bench.io.config.toml_file import read_toml

MODIFIED = ", modified"
"""Follows the name of a unit of which a figure was replaced."""

_TRIADS = ("gyro", "accel")
_CHOICES = {"bias_model": "flicker", "dead_zone_kind": "subtractive", "noise_shape": "white"}
"""Choices of a triad that are not figures, with their defaults."""


def _make_triad_table(name: str) -> type[Table]:
    """Return the table type of "gyro" or "accel"; every figure may be missing."""
    figures = triad_figures_of(TriadSpec)
    keys = [key for field, figure in figures.items() for key in figure.keys(field, name)]
    rows: dict[str, Any] = dict.fromkeys(keys, (Figure | None, None))
    rows["bias_model"] = (Literal["flicker", "gauss-markov"], _CHOICES["bias_model"])
    rows["dead_zone_kind"] = (Literal["subtractive", "hard"], _CHOICES["dead_zone_kind"])
    rows["noise_shape"] = (Literal["white", "averaged", "sampled"], _CHOICES["noise_shape"])
    return create_model(name.capitalize(), __base__=Table, **rows)


_Meters = Annotated[float, between(-10, 10)]
Place = Annotated[tuple[_Meters, _Meters, _Meters], ROWS]


class LayoutTable(Table):
    """Position of the accelerometers relative to the reference point of the unit, and their directions."""

    accel_cone_deg: Annotated[float, between(0, 89)] = 0.0
    """Angle between each accelerometer and the x axis, for a skewed triad; 0: along the axes."""
    accel_x_m: Place = (0.0, 0.0, 0.0)
    """Position of the x accelerometer: x, y, z."""
    accel_y_m: Place = (0.0, 0.0, 0.0)
    """Position of the y accelerometer."""
    accel_z_m: Place = (0.0, 0.0, 0.0)
    """Position of the z accelerometer."""


_Thermal, _Vibration = make_table_type(ThermalSpec), make_table_type(VibrationSpec)
_Clock = make_table_type(SampleClockSpec)


class ImuSheet(Sheet):
    """Datasheet of an IMU; values that it does not specify are left out."""

    gyro: _make_triad_table("gyro") = Field(default_factory=dict)  # type: ignore[valid-type]
    accel: _make_triad_table("accel") = Field(default_factory=dict)  # type: ignore[valid-type]
    thermal: _Thermal = Field(default_factory=_Thermal)  # type: ignore[valid-type]
    vibration: _Vibration = Field(default_factory=_Vibration)  # type: ignore[valid-type]
    clock: _Clock = Field(default_factory=_Clock)  # type: ignore[valid-type]
    layout: LayoutTable = Field(default_factory=LayoutTable)


class GnssSheet(Sheet):
    """A GNSS receiver: the errors of its fixes and, with [sky], of its measurements."""

    gnss: make_table_type(GnssSpec)  # type: ignore[valid-type]
    sky: SkyTable | None = None


def read_imu(path: Path, shown: str, changes: Mapping[str, Any] | None = None) -> ImuSpec:
    """Read the datasheet of an IMU; return it in SI.

    Parameters
    ----------
    path : Path
        The file.
    shown : str
        What messages call it.
    changes : mapping or None
        Figures to replace, by ``table.key``, in the unit of the key.

    Raises
    ------
    ConfigError
        One message for each problem in the file.
    """
    from bench.simulation.sensors.imu_terms import check_imu

    document = _read_document(path, shown, changes)
    axes, wrong = _split_axes(document)
    if wrong:
        raise ConfigError(*(f"{shown}: {line}" for line in wrong))
    sheet = check_table(ImuSheet, document, shown)
    wrong = check_sources(sheet, document)
    triads = {}
    for name in _TRIADS:
        figures = document.get(name, {})  # checked above
        values = {key: figures.get(key, default) for key, default in _CHOICES.items()}
        for field, figure in triad_figures_of(TriadSpec).items():
            keys = [key for key in figure.keys(field, name) if key in figures]
            if len(keys) > 1:
                wrong.append(f"[{name}] {keys[0]} and {keys[1]} are the same figure; give one of them")
            for key in keys:
                values[field] = to_si(key, figures[key])
        triads[name] = TriadSpec(**values, axes=tuple(axes[name]))
        if triads[name].transient_time and not triads[name].transient_sd:
            wrong.append(f"[{name}] transient_time_s needs transient_sd_*; give both or neither")
    arms = (sheet.layout.accel_x_m, sheet.layout.accel_y_m, sheet.layout.accel_z_m)
    spec = ImuSpec(
        _make_name(path, changes),
        triads["gyro"],
        triads["accel"],
        thermal=ThermalSpec(**convert_figures(ThermalSpec, sheet.thermal)),
        vibration=VibrationSpec(**convert_figures(VibrationSpec, sheet.vibration)),
        clock=SampleClockSpec(**convert_figures(SampleClockSpec, sheet.clock)),
        accel_cone=to_si("accel_cone_deg", sheet.layout.accel_cone_deg),
        accel_arms=arms if any(map(any, arms)) else (),
    )
    wrong += check_imu(spec)
    if wrong:
        raise ConfigError(*(f"{shown}: {line}" for line in wrong))
    return spec


def _split_axes(document: dict[str, Any]) -> tuple[dict[str, list[AxisFigures]], list[str]]:
    """Replace values given for x, y and z by the largest; return the values by axis in SI, and the errors."""
    found: dict[str, list[AxisFigures]] = {name: [] for name in _TRIADS}
    wrong = []
    for name in _TRIADS:
        table = document.get(name)
        if not isinstance(table, dict):
            continue
        for key, value in list(table.items()):
            if isinstance(value, list):
                field = _find_axis_figure(name, key)
                numbers = [one for one in value if type(one) in (int, float) and 0 <= one <= MOST]
                if field is None:
                    wrong.append(f"[{name}] {key} is the same for all axes: give one number")
                elif len(value) != 3 or len(numbers) != 3:
                    wrong.append(
                        f"[{name}] {quantity(key, value)} must be a number, or one for each of x, y and z"
                    )
                else:
                    table[key] = max(numbers)
                    found[name].append(AxisFigures(field, *(to_si(key, float(one)) for one in numbers)))
    return found, wrong


def _find_axis_figure(triad: str, key: str) -> str | None:
    """Return the field of `TriadSpec` for a key that may have values by axis; None for other keys."""
    every = triad_figures_of(TriadSpec).items()
    return next((field for field, one in every if one.by_axis and key in one.keys(field, triad)), None)


def read_gnss(path: Path, shown: str, changes: Mapping[str, Any] | None = None) -> GnssSpec:
    """Read the datasheet of a GNSS receiver; return it in SI. Parameters and errors as for `read_imu`."""
    document = _read_document(path, shown, changes)
    sheet = check_table(GnssSheet, document, shown)
    spec = GnssSpec(name=_make_name(path, changes), **convert_figures(GnssSpec, sheet.gnss))
    wrong = check_sources(sheet, document) + check_figures(GnssSpec, sheet.gnss, "gnss")
    decays = spec.pos_decay_distance or spec.pos_decay_time
    for kind in ("markov", "jump_markov"):
        if (getattr(spec, f"pos_h_{kind}_sd") or getattr(spec, f"pos_v_{kind}_sd")) and not decays:
            wrong.append(f"[gnss] pos_h_{kind}_sd_m needs pos_decay_distance_km or pos_decay_time_s")
        if getattr(spec, f"vel_{kind}_sd") and not spec.vel_decay_time:
            wrong.append(f"[gnss] vel_{kind}_sd_mps needs vel_decay_time_s")
    if max(spec.pos_h_smooth_sd, spec.pos_v_smooth_sd) and not spec.smooth_time:
        wrong.append("[gnss] pos_h_smooth_sd_m and pos_v_smooth_sd_m need smooth_time_s above 0 s")
    if sheet.sky is not None and spec.jumps:
        wrong.append("[gnss] [sky] makes the jumps; leave out the *_jump_* figures")
    if sheet.sky is not None and (spec.smooth_time or spec.latency_jitter or spec.time_tag_error):
        wrong.append(
            "[gnss] smooth_time_s, latency_jitter_s and time_tag_error_s are for receivers without [sky]"
        )
    if sheet.sky is not None:
        with collect_errors(wrong):
            spec = replace(spec, sky=read_sky(sheet.sky, path.parent))
    if wrong:
        raise ConfigError(*(f"{shown}: {line}" for line in wrong))
    return spec


def read_instrument(kind: str, path: Path, shown: str, changes: Mapping[str, Any] | None = None) -> Any:
    """Read the datasheet of an instrument; return it in SI. Parameters and errors as for `read_imu`."""
    row, document = INSTRUMENTS[kind], _read_document(path, shown, changes)
    sheet = check_table(make_sheet_type(kind), document, shown)
    table = getattr(sheet, kind)
    parts = {
        name: part(**convert_figures(part, getattr(sheet, name)))
        for name, part in row.parts.items()
        if getattr(sheet, name) is not None
    }
    spec = row.spec(name=_make_name(path, changes), **convert_figures(row.spec, table), **parts)
    wrong = check_sources(sheet, document) + check_figures(row.spec, table, kind) + row.problems(spec)
    if wrong:
        raise ConfigError(*(f"{shown}: {line}" for line in wrong))
    return spec


def _make_name(path: Path, changes: Mapping[str, Any] | None) -> str:
    return path.stem + (MODIFIED if changes else "")


def _read_document(path: Path, shown: str, changes: Mapping[str, Any] | None) -> dict[str, Any]:
    """Read a datasheet and replace values; the same quantity under another key is left out."""
    document = read_toml(path, shown)
    for key, value in (changes or {}).items():
        table, *inner, name = key.split(".")
        if table in _TRIADS and len(inner) == 1 and name in XYZ:
            axis, name = name, inner.pop()
            value = _replace_axis(document.get(table), shown, table, name, axis, value)
        here = document.setdefault(table, {})
        for part in inner:
            here = here.setdefault(part, {}) if isinstance(here, dict) else None
        if not isinstance(here, dict):
            raise ConfigError(f"{shown}: {key}: {name!r} is not a key of a table")
        for other in _list_same_figures(table, name):
            here.pop(other, None)
            document.get("sources", {}).pop(f"{table}.{other}", None)
            if f"{table}.{other}" in document.get("assumed", []):
                document["assumed"].remove(f"{table}.{other}")
        here[name] = value
    return document


def _replace_axis(figures: object, shown: str, table: str, key: str, axis: str, value: Any) -> list[Any]:
    """Return the values of a parameter for x, y and z, with the value of one axis replaced."""
    if _find_axis_figure(table, key) is None:
        figures_here = triad_figures_of(TriadSpec).items()
        known = [one for field, row in figures_here if row.by_axis for one in row.keys(field, table)]
        hint = suggest(key, known, "figures by axis")
        raise ConfigError(f"{shown}: [{table}] {key} cannot differ by axis{hint}")
    given = figures if isinstance(figures, Mapping) else {}
    used = next((one for one in (key, *_list_same_figures(table, key)) if one in given), key)
    present = given.get(used, 0.0)
    values = list(present) if isinstance(present, list) else [present] * 3
    if used != key:
        values = [from_si(key, to_si(used, one)) if type(one) in (int, float) else one for one in values]
    if len(values) == 3:  # else it is rejected as it is
        values[XYZ.index(axis)] = value
    return values


def _list_same_figures(table: str, name: str) -> list[str]:
    """Return the other keys, in other units, of a figure of a triad."""
    if table not in _TRIADS:
        return []
    every = [figure.keys(field, table) for field, figure in triad_figures_of(TriadSpec).items()]
    return [key for keys in every if name in keys for key in keys if key != name]


@cache
def make_sheet_type(kind: str) -> type[Sheet]:
    """Return the type of the datasheet of an instrument: its table, and the tables of its parts."""
    row = INSTRUMENTS[kind]
    parts: dict[str, Any] = {name: (make_table_type(spec) | None, None) for name, spec in row.parts.items()}
    rows: dict[str, Any] = {kind: (make_table_type(row.spec), ...), **parts}
    return create_model(f"{kind}Sheet", __base__=Sheet, **rows)


SENSORS: Mapping[str, Callable[..., Any]] = {
    "imu": read_imu,
    "gnss": read_gnss,
    **{kind: partial(read_instrument, kind) for kind in INSTRUMENTS},
}
"""Kind of sensor, also the name of its catalog folder -> the function that reads its datasheet."""
