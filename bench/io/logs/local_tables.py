"""Positions of a table in a local frame: their place on the Earth, which is assumed if none is given."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from bench.core.mathematics.arrays import BoolArray, FloatArray
from bench.core.words.exceptions import ConfigError
from bench.io.foreign.local_frames import LocalFrame, read_frame
from bench.io.foreign.solution_rows import Placing
from bench.io.logs.rows import LOCAL_AXES, LogRows
from bench.io.logs.table_files import TableColumns

ASSUMED = np.array([np.deg2rad(45.0), 0.0, 0.0])
"""Latitude, longitude [rad], height [m] of an origin that is not given."""
_FRAME = "enu-flu"  # of x, y, z, as of poses without a frame
_FAR = 1e7  # a local position that is impossible [m]


def place_rows(
    rows: LogRows, table: TableColumns, placing: Placing, shown: str
) -> tuple[LogRows, bool | None]:
    """Return rows with geodetic positions, and whether their place is known; None if they are not local.

    Velocities along north, east, down and attitudes ``q_nb`` of the rows refer to the north axis of
    the frame and to the horizontal at its origin.

    Raises
    ------
    ConfigError
        If a frame is named for positions that are not local, is unknown, or contradicts their names.
    """
    named = LOCAL_AXES.get(table.stems["position"])
    if named is None:
        if placing.origin is not None or placing.frame is not None:
            key = "frame" if placing.origin is None else "origin"
            raise ConfigError(
                f"{shown}: {key} is only for positions in a local frame, not for "
                f"{table.names['position'][0]}: leave out {key}"
            )
        return rows, None
    axes = f"{named}-frd" if named else placing.frame or _FRAME
    frame, known = placing.find_frame(axes, (), shown)
    if named and placing.frame is not None and not placing.frame.lower().startswith(named):
        columns = f"the columns {', '.join(table.names['position'])}, which are {named}"
        raise ConfigError(f"{shown}: frame {placing.frame!r} contradicts {columns}; leave it out")
    world = read_frame(axes)[0]
    values, pos = dict(rows.values), rows.values["pos_l"]
    good = np.asarray((np.abs(pos) < _FAR).all(axis=1))
    n = int(good.sum())
    given = [values[name][good] if name in values else np.zeros((n, k)) for name, k in _TURNED.items()]
    found = LocalFrame("ned-frd", frame.origin, frame.heading).place(pos[good] @ world.T, *given)
    for (name, k), placed in zip({"lla": 3, **_TURNED}.items(), found, strict=True):
        if name == "lla" or name in values:
            values[name] = _spread_rows(placed, good, k)
    values.pop("pos_l")
    note = f"{shown}: {', '.join(table.names['position'])} are in a local frame, taken as {axes[:3]}"
    assumed = ""
    if not known:
        lat, lon = np.rad2deg(frame.origin[:2])
        assumed = (
            f"{note} at an assumed origin, {lat:.7g}, {lon:.7g} deg, {frame.origin[2]:.4g} m: set origin; "
            "without it, gravity and Earth rate are of the assumed place, and only changes of position count"
        )
    return replace(rows, values=values, notes=(*rows.notes, note), assumed=assumed), known


_TURNED = {"q_nb": 4, "vel_n": 3}
"""Values that are turned with the positions -> their width."""


def _spread_rows(values: FloatArray, good: BoolArray, width: int) -> FloatArray:
    whole = np.full((len(good), width), np.nan)
    whole[good] = values
    return whole
