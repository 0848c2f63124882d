"""Datasheet values of all sensors of a kind side by side, each quantity in one unit."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np

from bench.core.mathematics.units import from_si, to_si
from bench.core.records.fields import triad_figures_of
from bench.core.records.sensor_specs import TriadSpec
from bench.core.words.wording import format_number
from bench.io.config.listing import find_sheets
from bench.io.config.toml_file import read_toml

ASSUMED = "*"
"""Follows a figure that no source states."""
MARKS: Mapping[str, str] = {
    ASSUMED: "typical of the class, no source states it",
    " f": "front page of the datasheet",
    " m": "another page of the maker",
    " q": "quoted by others",
    " t": "table of grades",
}
"""What follows a figure that was not read in the source of its file -> where it is from."""

_TRIADS = ("gyro", "accel")
_GRADES = ("navigation", "tactical", "industrial", "consumer")
_DIGITS = 3


def tabulate_figures(kind: str) -> dict[str, list[str]]:
    """Return columns of the sensors of a kind: name, class, and each figure that any of them has.

    Figures of triads are in the first unit that a file may use, others in that of the files. "-": absent,
    the model then lacks the error; :data:`MARKS` follow what was not read in the datasheet. Of figures by
    axis the root mean square is shown. The best class comes first.
    """
    sheets = {name: read_toml(path, path.name) for name, (path, _) in find_sheets(kind).items()}
    names = sorted(sheets, key=lambda name: (_rank(sheets[name]), name))
    rows = [dict(_list_figures(sheets[name])) for name in names]
    heads = sorted({head for row in rows for head in row}, key=_place)
    columns = {kind: names, "class": [str(sheets[name].get("class", "-")) for name in names]}
    for head in heads:
        columns[head.replace(".", " ")] = [row.get(head, "-") for row in rows]
    return columns


def _rank(sheet: Mapping[str, Any]) -> int:
    grade = sheet.get("class")
    return _GRADES.index(grade) if grade in _GRADES else len(_GRADES)


def _place(head: str) -> tuple[int, int, str]:
    """Return the place of a column: gyros first, and figures in the order of their declaration."""
    table, _, key = head.partition(".")
    if table not in _TRIADS:
        return len(_TRIADS), 0, head
    order = [one for name, figure in triad_figures_of(TriadSpec).items() for one in figure.keys(name, table)]
    return _TRIADS.index(table), order.index(key), head


def _list_figures(sheet: Mapping[str, Any]) -> Iterator[tuple[str, str]]:
    """Yield ``table.key`` and text of each number of a datasheet."""
    for table, values in sheet.items():
        if not isinstance(values, Mapping) or table == "sources":
            continue
        for key, value in values.items():
            parts = value if isinstance(value, list) else [value]
            if not all(type(one) in (int, float) for one in parts):
                continue
            size = float(parts[0]) if len(parts) == 1 else float(np.sqrt(np.mean(np.square(parts))))
            shown = _find_unit(table, key)
            mark = mark_figure(sheet, f"{table}.{key}")
            text = format_number(size if shown == key else from_si(shown, to_si(key, size)), _DIGITS)
            yield f"{table}.{shown}", text + mark


def mark_figure(sheet: Mapping[str, Any], name: str) -> str:
    """Return the mark of :data:`MARKS` of a figure ``table.key`` of a datasheet; empty if it was read there.

    The source of the figure counts, then the confidence of the file.

    Examples
    --------
    >>> sheet = {"confidence": "datasheet", "sources": {"gyro.range_deg_s": "front page: +-500 deg/s"}}
    >>> mark_figure(sheet, "gyro.range_deg_s")
    ' f'
    """
    if name in sheet.get("assumed", ()):
        return ASSUMED
    source = str(sheet.get("sources", {}).get(name, ""))
    if "quot" in source:
        return " q"
    if source.startswith("front page"):
        return " f"
    known = {"front page": " f", "maker": " m", "quoted": " q", "table": " t"}
    return known.get(str(sheet.get("confidence")), "")


def _find_unit(table: str, key: str) -> str:
    """Return the key in the unit in which a figure is shown."""
    if table in _TRIADS:
        for name, figure in triad_figures_of(TriadSpec).items():
            keys = figure.keys(name, table)
            if key in keys:
                return keys[0]
    return key
