"""The ``[sky]`` table of a GNSS datasheet: satellites and errors of a measurement-level receiver."""

from __future__ import annotations

from collections.abc import Sequence
from datetime import datetime
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from pydantic import AfterValidator
from pydantic_core import PydanticCustomError

from bench.core.mathematics.units import STANDARD_GRAVITY
from bench.core.records.orbit_sets import GLONASS, GPS, SYSTEM_NAMES, GlonassSets, KeplerSets, parse_systems
from bench.core.records.sky_spec import SkySpec
from bench.core.words.exceptions import ConfigError
from bench.io.config.sheet import convert_figures, make_table_type
from bench.io.config.tables import ROWS, collect_errors
from bench.io.fix_readers import Orbits, ask_reader
from bench.simulation.signals.gps_time import EPOCH

_DAY = 86400.0
_STALE = {GLONASS: 1800.0}  # longest time from an ephemeris to the start of a flight [s]
_STALE_KEPLER = 4 * 3600.0  # the same of the others [s]
_PROCESSES = {
    "gps_space": "space",
    "glonass_space": "space",
    "galileo_space": "space",
    "beidou_space": "space",
    "ionosphere": "ionosphere",
    "troposphere": "troposphere",
    "multipath_zenith": "multipath",
    "multipath_horizon": "multipath",
}
"""Beginning of the key of a standard deviation -> that of the correlation time it needs."""

_Eight = Annotated[tuple[float, float, float, float, float, float, float, float], ROWS]


def _check_systems(systems: str) -> str:
    try:
        parse_systems(systems)
    except ValueError as error:
        raise PydanticCustomError("message", "is wrong: {why}", {"why": str(error)}) from None
    return systems


class SkyTable(make_table_type(SkySpec)):  # type: ignore[misc]
    """Satellites, antenna, receiver, and measurement errors; omitted errors are zero."""

    start: datetime
    """GPS time of the start of the flight."""
    almanac: str | None = None
    """YUMA file beside the datasheet, GPS only; without files the nominal constellations fly."""
    navigation: Annotated[tuple[str, ...], ROWS] = ()
    """RINEX navigation files beside the datasheet."""
    klobuchar: _Eight | None = None
    """Klobuchar parameters, instead of the navigation file; 0 for nominal satellites."""
    systems: Annotated[str, AfterValidator(_check_systems)] = "both"
    """Constellations that the receiver has: gps, glonass, galileo, beidou, some of them with commas between,
    both (GPS and GLONASS) or all; auto: GPS, GLONASS or both, whichever fixes best."""
    bands: Literal[1, 2] = 1
    """Frequencies; with 2 the fixes are free of the ionosphere."""


def read_sky(table: SkyTable, beside: Path) -> SkySpec:
    """Return the [sky] of a datasheet in SI, with its satellites.

    Parameters
    ----------
    table : SkyTable
        The table as read from the file.
    beside : Path
        Folder of the datasheet, which holds its almanac and navigation files.

    Raises
    ------
    ConfigError
        One message for each problem in the table or its files, without the name of the datasheet.
    """
    figures = convert_figures(SkySpec, table)
    wrong = [
        f"[sky] {process}_sd_m needs {correlation}_correlation_s"
        for process, correlation in _PROCESSES.items()
        if figures[f"{process}_sd"] > 0 and not figures[f"{correlation}_correlation"]
    ]
    if table.start.tzinfo is not None:
        wrong.append(f"[sky] start = {table.start} must have no time zone: it is GPS time")
    if table.almanac is not None and table.navigation:
        wrong.append("[sky] give either almanac or navigation, not both")
    midnight = (table.start.date() - EPOCH).days * _DAY
    clock = table.start.time()
    of_day = clock.hour * 3600.0 + clock.minute * 60.0 + clock.second + 1e-6 * clock.microsecond
    orbits: dict[int, KeplerSets | GlonassSets] | None = None
    broadcast: Sequence[float] | None = None
    if not wrong:
        with collect_errors(wrong):
            orbits, broadcast = _read_satellites(table, beside, midnight, of_day)
    if wrong:
        raise ConfigError(*wrong)
    klobuchar = table.klobuchar if table.klobuchar is not None else broadcast
    figures["clock_g"] /= STANDARD_GRAVITY  # the file gives it per g
    return SkySpec(
        **figures,
        systems=table.systems,
        bands=table.bands,
        day=table.start.date(),
        gps_t0=of_day,
        orbits=orbits,
        klobuchar=tuple(klobuchar) if klobuchar is not None else (0.0,) * 8,
    )


def _read_satellites(
    table: SkyTable, beside: Path, midnight: float, of_day: float
) -> tuple[dict[int, KeplerSets | GlonassSets] | None, Sequence[float] | None]:
    """Read orbits by system and the ionosphere parameters; None selects the nominal ones."""
    if table.almanac is not None:
        path = beside / table.almanac
        almanac = ask_reader(path, "read_almanac", KeplerSets, path, midnight, table.almanac)
        sets = almanac.shift_origin(midnight)
        if abs(sets.t - of_day).min() > 90 * _DAY:
            raise ConfigError(f"{table.almanac}: is more than 90 days from start = {table.start}")
        return {GPS: sets}, None
    if not table.navigation:
        return None, None
    paths = {name: beside / name for name in table.navigation}
    files = ask_reader(paths[table.navigation[0]], "read_orbits", Orbits, paths)
    orbits = {system: sets.shift_origin(midnight) for system, sets in files.sets.items()}
    for system in parse_systems("both" if table.systems == "auto" else table.systems):
        t = orbits[system].t if system in orbits else np.empty(0)
        if len(t) == 0 or np.abs(t - of_day).min() > _STALE.get(system, _STALE_KEPLER):
            name = SYSTEM_NAMES[system]
            raise ConfigError(f"{files.shown}: has no {name} ephemeris near start = {table.start}")
    return orbits, None if files.klobuchar is None else [float(v) for v in files.klobuchar]
