"""Read YUMA almanacs: approximate orbits of all GPS satellites, for weeks around a date."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

from bench.core.records.orbit_sets import KEPLER, KeplerSets
from bench.core.words.exceptions import ConfigError
from bench.plugins.receiver.rinex.lines import Lines, open_lines
from bench.simulation.signals.orbits import WEEK

_ROLLOVER = 1024 * WEEK  # the week number of an almanac is modulo 1024 [s]
_MOST = 100_000  # satellites in a file: 30 years of weeks
_ENTRIES = {
    "id": "sat",
    "health": "health",
    "eccentricity": "e",
    "time of applicability": "t_oe_week",
    "orbital inclination": "i_0",
    "rate of right ascen": "node_rate",
    "sqrt": "sqrt_a",
    "right ascen at week": "node_0",
    "argument of perigee": "perigee",
    "mean anom": "mean_anomaly",
    "af0": "af_0",
    "af1": "af_1",
    "week": "week",
}
"""Beginning of the name of an entry, in small letters -> column."""
_LIMITS = {
    "sat": (1, 63), "week": (0, 9999), "e": (0.0, 0.2), "t_oe_week": (0.0, WEEK), "sqrt_a": (4900.0, 5400.0),
}  # fmt: skip


def read_yuma(path: Path, near: float, shown: str | None = None) -> KeplerSets:
    """Return the satellites of a YUMA almanac.

    Parameters
    ----------
    path : Path
        The file.
    near : float
        A time within ten years of the almanac, in s since 1980-01-06; the week number in the file is modulo
        1024 (19.6 years).
    shown : str or None
        Name of the file in messages; default its file name.

    Returns
    -------
    sets : KeplerSets
        Times in s since 1980-01-06; elements that an almanac does not have (harmonics, group delay) are 0.

    Raises
    ------
    ConfigError
        If the file is malformed, truncated or empty: one line with file and line number.
    """
    shown = path.name if shown is None else shown
    rows: list[dict[str, float]] = []
    with open_lines(path, shown) as lines:
        begun, entries = 0, dict[str, float]()
        while (line := lines.read_line()) is not None:
            if line.startswith("*"):
                if entries:
                    raise lines.error(_describe_unfinished(entries, begun))
                continue
            if not line.strip():
                continue
            name, value = _parse_entry(lines, line)
            if name in entries:
                raise lines.error(
                    f"gives {line.partition(':')[0].strip()!r} twice; the almanac from line {begun}"
                )
            begun = begun if entries else lines.number
            entries[name] = value
            if len(entries) == len(_ENTRIES):
                rows.append(entries)
                entries = {}
                if len(rows) > _MOST:
                    raise lines.error(f"more than {_MOST} almanacs")
        if entries:
            raise lines.error(_describe_unfinished(entries, begun))
    if not rows:
        raise ConfigError(f"{shown}: has no almanac in it")
    elements = np.zeros((len(rows), len(KEPLER)))
    for k, row in enumerate(rows):
        t_oe = row["week"] * WEEK + row["t_oe_week"]
        t_oe += _ROLLOVER * round((near - t_oe) / _ROLLOVER)
        known = {**row, "t_oe": t_oe, "t_oc": t_oe}
        elements[k] = [known.get(name, 0.0) for name in KEPLER]
    sat = np.array([int(row["sat"]) for row in rows])
    return KeplerSets(sat, np.array([row["health"] == 0 for row in rows]), elements)


def _parse_entry(lines: Lines, line: str) -> tuple[str, float]:
    """Return the column and the value of a line."""
    label, colon, text = line.partition(":")
    name = next((n for begin, n in _ENTRIES.items() if label.strip().lower().startswith(begin)), None)
    if not colon or name is None:
        raise lines.error(f"{line.strip()[:30]!r} is not an entry of a YUMA almanac")
    if not re.fullmatch(r"\s*[+-]?\d+(\.\d*)?([EeDd][+-]?\d+)?\s*", text):
        raise lines.error(f"{label.strip()} must be a number; got {text.strip()[:30]!r}")
    value = float(text.strip().upper().replace("D", "E"))
    low, high = _LIMITS.get(name, (-1e6, 1e6))
    if not low <= value <= high:
        raise lines.error(f"{label.strip()} = {value:g} is outside {low:g} to {high:g}")
    return name, value


def _describe_unfinished(entries: dict[str, float], begun: int) -> str:
    return f"the almanac from line {begun} has {len(entries)} of {len(_ENTRIES)} entries"
