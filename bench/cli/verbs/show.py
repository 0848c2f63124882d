"""Print flights and catalogs as tables in the terminal."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from rich.console import Console

from bench.cli.listings import list_exports, list_metrics, list_studies
from bench.cli.verbs.other_packages import list_packages, list_plugin_problems
from bench.cli.verbs.printing import print_table, print_tables
from bench.core.records.findings import FindingTable, make_table
from bench.core.records.specs import Profile
from bench.core.words.notebook import ShownFigure
from bench.core.words.wording import one_line
from bench.io import config
from bench.io.config.figure_table import MARKS, tabulate_figures
from bench.io.config.listing import KINDS, CatalogEntry, KeyEntry, find_sheets
from bench.navigation.built_in import BUILT_IN
from bench.simulation.signals.terrain import read_grid

_DEG = 180 / math.pi
_OF_KINDS = ("sensors", "packages")  # shelves whose entries are of several kinds
_OF_KEYS = ("key", "may be", "default", "what")


def print_flight(console: Console, profile: Profile, summary: Mapping[str, Any]) -> None:
    """Print the legs of a flight and its extremes, as `bench.pipeline.fly_over` returns them."""
    console.print(f"{one_line(profile.title)}: {profile.flight.label}")
    legs = [
        (ShownFigure(f"{start:.1f} s"), ShownFigure(f"{end:.1f} s"), text)
        for start, end, text in summary["legs"]
    ]
    figures = _describe_flight(summary)
    if (terrain := profile.sensors.terrain) is not None:
        low, high = summary["height_min_m"], summary["height_max_m"]
        grid = f"over {terrain.path.name}, {read_grid(terrain).describe()}"
        figures["above ground"] = f"{low:.0f} to {high:.0f} m {grid}"
    tables = [
        make_table("legs", "", ("from", "to", "leg"), legs),
        make_table("flight", "", ("figure", "value"), list(figures.items())),
    ]
    print_tables(console, tables)
    for _, _, text in summary["table"]:
        console.print(f"{profile.flight.label}: {text}", soft_wrap=True)
    print_remarks(console, "sanity", summary["sanity"])
    print_remarks(console, "exceedance", summary["exceedances"])


def describe_replay(position: float, attitude: float) -> str:
    """Return the errors of a replay [m], [rad] in words, in suitable units.

    Examples
    --------
    >>> describe_replay(0.0003, 1.2e-7)
    '0.3 mm, 0.12 microradian'
    >>> describe_replay(0.79, 3.4e-3)
    '0.79 m, 3.4 mrad'
    """
    lengths, angles = ((1.0, "m"), (1e-3, "mm")), ((1.0, "rad"), (1e-3, "mrad"), (1e-6, "microradian"))

    def describe(value: float, units: tuple[tuple[float, str], ...]) -> str:
        size, unit = next((row for row in units if value >= 0.1 * row[0]), units[-1])
        return f"{value / size:.2g} {unit}"

    return f"{describe(position, lengths)}, {describe(attitude, angles)}"


def print_remarks(console: Console, kind: str, remarks: Sequence[tuple[float, float, str]]) -> None:
    """Print events of a kind: "sanity", what is implausible, or "exceedance", limits of the aircraft."""
    for start, end, text in remarks:
        when = f"{start:.1f} s" if end == start else f"{start:.1f} to {end:.1f} s"
        console.print(f"{kind}, {when}: {text}", style="yellow")


def _describe_flight(summary: Mapping[str, Any]) -> dict[str, str]:
    """Return the figures of a flight as text, by name."""

    def format_range(name: str, unit: str, digits: int, scale: float = 1.0) -> str:
        ends = [summary.get(f"{name}_{end}{unit}") for end in ("min", "max")]
        return " to ".join("-" if end is None else f"{scale * end:.{digits}f}" for end in ends)

    def format_degrees(name: str) -> str:
        return f"{_DEG * summary[name]:.1f}"

    rates = ", ".join(format_degrees(f"{axis}_rate_max_rad_s") for axis in ("roll", "pitch", "yaw"))
    shown = {
        "duration": f"{summary['duration_s']:g} s, {summary['samples']} samples at {summary['rate_hz']:g} Hz",
        "distance over ground": f"{summary['path_over_ground_m'] / 1000:.2f} km",
        "altitude": f"{format_range('alt', '_m', 1)} m",
        "true airspeed": f"{format_range('airspeed', '_mps', 1)} m/s",
        "ground speed": f"{format_range('ground_speed', '_mps', 1)} m/s",
        "climb": f"{format_range('climb', '_mps', 1)} m/s",
        "bank": f"up to {format_degrees('bank_max_rad')} deg",
        "pitch": f"{format_range('pitch', '_rad', 1, _DEG)} deg",
        "load factor": format_range("load_factor", "", 2),
        "roll, pitch, yaw rate": f"up to {rates} deg/s",
        "replay": f"{describe_replay(summary['replay_position_m'], summary['replay_attitude_rad'])}: "
        "largest error of an error-free two-sample strapdown within 10 minutes",
    }
    if "airspeed_max_mps" not in summary:  # a table says nothing of the air
        del shown["true airspeed"]
    return shown


_EXAMPLES = {
    "profiles": ("figure-eight", "approach", "survey"),
    "aircraft": ("aerosonde", "navion", "jet747"),
    "legs": ("straight", "turn", "climb"),
    "estimators": ("loose-15", "loose-full", "tight"),
    "exports": ("csv", "rinex", "rosbag2"),
    "studies": ("sensors", "outages", "budget"),
    "metrics": ("pos_rmse_h_m", "nees_mean"),
}
"""Kind -> names in the overview."""
_USES = {
    "profiles": "bench run NAME",
    "aircraft": 'aircraft = "NAME"',
    "legs": '[[leg]] kind = "NAME"',
    "sensors": '[sensors] imu = "NAME"',
    "estimators": "bench run ... -e NAME",
    "exports": "bench export DIR --to NAME",
    "studies": "bench study NAME",
    "metrics": "[[requirement]] metric",
    "packages": "added by installed packages",
}

_SHELVES: Mapping[str, tuple[str, Callable[[], list[CatalogEntry]]]] = {
    "profiles": ("bench run NAME", config.list_profiles),
    "aircraft": ("aircraft = NAME", config.list_aircraft),
    "legs": ("[[leg]] kind = NAME", config.list_legs),
    "sensors": (f"[sensors] {', '.join(KINDS)} = NAME", config.list_sensors),
    "estimators": (
        "use = NAME, 'module:Class', 'file:SOLUTION' or 'command:PROGRAM ...'",
        config.list_estimators,
    ),
    "exports": ("bench export RUN --to NAME", list_exports),
    "studies": ("bench study NAME", list_studies),
    "metrics": (
        "metric = NAME; of many the name has {}, one of n, e, d, a sensor, a number or *",
        list_metrics,
    ),
    "packages": ("added by what is installed beside bench", list_packages),
}
"""Kind that `bench list` shows -> how it is selected, and the function that lists its entries."""


def list_catalog(kind: str | None = None) -> dict[str, list[CatalogEntry]]:
    """Return the catalog entries of all shelves by name; with ``kind``, one shelf or one kind of sensor."""
    if kind in KINDS:
        return {"sensors": [entry for entry in config.list_sensors() if entry.kind == kind]}
    return {name: entries() for name, (_, entries) in _SHELVES.items() if kind in (None, name)}


def print_catalog(console: Console, kind: str | None = None) -> None:
    """Print the entries of `list_catalog`.

    With a kind, aircraft and sensors also show their figures and sources and what is assumed, legs their
    keys, filters their options.
    """
    if kind is None:
        _print_overview(console)
        return
    for name, entries in list_catalog(kind).items():
        if kind == "legs":
            for entry in entries:
                rows = [_describe_key(key) for key in entry.keys]
                _print_rows(console, f"{entry.name}: {entry.title}", _OF_KEYS, rows)
            continue
        rows = []
        for entry in entries:
            what = f"{entry.title}: {entry.note}" if entry.note else entry.title
            rows.append((entry.kind, entry.name, what) if name in _OF_KINDS else (entry.name, what))
        heads = ("kind", "name", "what") if name in _OF_KINDS else ("name", "what")
        _print_rows(console, f"{name.capitalize()} ({_SHELVES[name][0]})", heads, rows)
    if kind == "estimators":
        _print_options(console)
    _print_problems(console)


def _print_overview(console: Console) -> None:
    """Print one row for each kind: number of entries, some names, and how to select one."""
    rows = []
    for kind, entries in list_catalog().items():
        names = [entry.name for entry in entries]
        shown = [name for name in _EXAMPLES.get(kind, ()) if name in names] or names[:3]
        counts = Counter(entry.kind for entry in entries).most_common(3)
        texts = [f"{number} {name}" for name, number in counts] if kind == "sensors" else shown
        if names:
            rows.append((kind, ShownFigure(str(len(names))), ", ".join(texts), _USES[kind]))
    print_table(console, make_table("kinds", "", ("kind", "count", "for example", "use"), rows))
    console.print("Details     bench list KIND             names, one line each")
    console.print("            bench list sensors --long   all datasheet values in one table")
    console.print("Your own    a profile or datasheet is a .toml file: give its path,")
    console.print("            a filter is MODULE:CLASS, file:SOLUTION or 'command:PROGRAM ...'")
    _print_problems(console)


def _print_problems(console: Console) -> None:
    for line in list_plugin_problems():
        console.print(one_line(line), style="yellow")


def print_sensors(console: Console, kinds: Sequence[str]) -> None:
    """Print the figures of the sensors of the catalog, a table for each kind."""
    for kind in kinds:
        figures = tabulate_figures(kind)
        columns = {
            name: cells if name in (kind, "class") else [ShownFigure(cell) for cell in cells]
            for name, cells in figures.items()
        }
        print_table(console, FindingTable(kind, kind, columns))
    marks = "; ".join(f"{mark.strip()} {words}" for mark, words in MARKS.items())
    text = f"{marks}; unmarked: read in the source of the file; - absent, the model lacks this error."
    console.print(text, soft_wrap=True)


def draw_imus(picture: Path, console: Console, *, force: bool) -> None:
    """Draw the Allan deviation of the IMUs of the catalog by class, and print where."""
    from bench.io.config.datasheets import read_imu
    from bench.io.config.library import find_datasheet
    from bench.io.config.toml_file import read_toml
    from bench.views.report import allan_picture

    allan_picture.check_picture(picture, force=force)
    units = [
        (str(read_toml(path, shown).get("class")), read_imu(path, shown))
        for path, shown in (find_datasheet("imu", name, Path()) for name in find_sheets("imu"))
    ]
    allan_picture.draw_catalog(picture, units)
    console.print(f"picture: {picture}", soft_wrap=True)


def _print_rows(console: Console, title: str, heads: Sequence[str], rows: Sequence[Sequence[str]]) -> None:
    """Print a table of words; without rows, print only its title."""
    table = make_table("rows", title, heads, rows) if rows else FindingTable("rows", title, {})
    print_table(console, table)


def _describe_key(key: KeyEntry) -> tuple[str, ...]:
    """Return the cells for a key of a leg: name, limits, default, description."""
    holds = ", ".join(key.choices) or "tables"
    if key.low is not None:
        holds = f"{key.low:g} to {key.high:g} {key.unit}"
    default = "required" if key.required else "optional"
    if key.default is not None:
        default = key.default if isinstance(key.default, str) else f"{key.default:g} {key.unit}"
    return key.name, holds, default, key.words


def _print_options(console: Console) -> None:
    """Print the options of the built-in filters; those that share options are shown together."""
    from bench.navigation.options import Options, described

    owners: dict[type[Options], list[str]] = {}
    for name, row in BUILT_IN.items():
        owners.setdefault(row.options, []).append(name)
    for model, names in owners.items():
        base = next((one for one in model.__bases__ if one in owners), None)
        known = described(base) if base else []
        rows = [option for option in described(model) if option not in known]
        shared = f": those of {owners[base][0]}{', and' if rows else ''}" if base else ""
        _print_rows(console, f"Options of {', '.join(names)}{shared}", ("option", "default", "what"), rows)
