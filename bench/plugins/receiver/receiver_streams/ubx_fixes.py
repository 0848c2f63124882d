"""Fixes of u-blox receivers as a log: UBX-NAV-PVT, with NAV-HPPOSLLH where it is there, too.

The layouts are those of the u-blox interface description UBX-18010854 (5.14.4, 5.14.10); pyubx2 reads the
same values. Times are GPS time since 1980-01-06, heights those above the ellipsoid.
"""

from __future__ import annotations

from datetime import date
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bench.core.mathematics.arrays import FloatArray
from bench.core.words.exceptions import ConfigError
from bench.io.logs.file_kinds import describe_unreadable
from bench.io.logs.rows import MOST_ROWS, LogRows
from bench.plugins.receiver.receiver_streams.ubx import FrameLayout, read_messages
from bench.simulation.signals.gps_time import gps_seconds, leap_seconds
from bench.simulation.signals.orbits import WEEK

FORMAT = {"endings": (".ubx",), "fixes": True}
"""Its row in `bench.io.log_formats`."""

_PVT, _PRECISE = b"\x01\x07", b"\x01\x14"
_LAYOUTS = {_PVT: FrameLayout(92), _PRECISE: FrameLayout(36)}
_FIX = np.dtype(
    [("tow", "<u4"), ("year", "<u2"), ("day", "u1", 2), ("time", "u1", 3), ("timely", "u1"), ("", "<u4"),
     ("nano", "<i4"), ("fix", "u1"), ("flags", "u1"), ("", "u1"), ("satellites", "u1"), ("lon", "<i4"),
     ("lat", "<i4"), ("height", "<i4"), ("sea", "<i4"), ("sd", "<u4", 2), ("vel", "<i4", 3), ("speed", "<i4"),
     ("course", "<i4"), ("speed_sd", "<u4"), ("course_sd", "<u4"), ("pdop", "<u2"), ("flags_3", "<u2"),
     ("rest", "V12")]
)  # fmt: skip
_EXACT = np.dtype(
    [("version", "u1"), ("", "V2"), ("wrong", "u1"), ("tow", "<u4"), ("lon", "<i4"), ("lat", "<i4"),
     ("height", "<i4"), ("sea", "<i4"), ("lon_rest", "i1"), ("lat_rest", "i1"), ("height_rest", "i1"),
     ("sea_rest", "i1"), ("sd", "<u4", 2)]
)  # fmt: skip
_SPATIAL = (3, 4)  # fixes in three dimensions, without and with dead reckoning
_DATE_AND_TIME, _SOUND, _WRONG = 0b11, 1, 1
_CARRIER = {2: 1.0, 1: 2.0}  # fixed and float ambiguities -> quality as RTKLIB counts it
_DIFFERENTIAL, _SINGLE = 4.0, 5.0


def read(form: str, path: Path, kind: str, topic: str | None) -> LogRows:
    """Read the fixes of a UBX stream; ``quality`` is that of RTKLIB: 1 fixed, 2 float, 4 DGPS, 5 single."""
    if kind != "gnss":
        raise ConfigError(describe_unreadable(path, f"no {kind.upper()} in a UBX recording"))
    found: dict[bytes, list[bytes]] = {_PVT: [], _PRECISE: []}
    damaged = 0
    for which, message in read_messages(path, path.name, _LAYOUTS):
        if message is None:
            damaged += 1
        else:
            found[which].append(message)
        if len(found[_PVT]) > MOST_ROWS:
            raise ConfigError(f"{path.name}: more than {MOST_ROWS} fixes")
    rows = np.frombuffer(b"".join(found[_PVT]), _FIX)
    timed = (rows["timely"] & _DATE_AND_TIME) == _DATE_AND_TIME
    if not timed.any():
        what = "no fix (UBX-NAV-PVT)" if not len(rows) else "no fix with a date"
        raise ConfigError(f"{path.name}: has {what}; bench fixes {path.name} computes fixes from its ranges")
    notes = [f"{path.name}: {damaged} damaged messages are left out"] if damaged else []
    if not timed.all():
        notes.append(f"{path.name}: {(~timed).sum()} fixes before the receiver set its clock are left out")
    rows = rows[timed]
    t = _find_times(rows)
    place = np.column_stack([1e-7 * rows["lat"], 1e-7 * rows["lon"], 1e-3 * rows["height"]])
    sd = 1e-3 * rows["sd"]
    exact = np.frombuffer(b"".join(found[_PRECISE]), _EXACT)
    exact = exact[(exact["wrong"] & _WRONG) == 0]
    _, at, of = np.intersect1d(rows["tow"], exact["tow"], return_indices=True)
    fine = exact[of]
    for k, name in enumerate(("lat", "lon", "height")):
        unit = 1e-3 if name == "height" else 1e-7
        place[at, k] = unit * (fine[name] + 1e-2 * (10.0 if name == "height" else 1.0) * fine[f"{name}_rest"])
    sd[at] = 1e-4 * fine["sd"]
    lost = (rows["flags"] & _SOUND == 0) | (rows["flags_3"] & _WRONG > 0)
    lost |= ~np.isin(rows["fix"], _SPATIAL)
    place[lost] = np.nan
    carrier, differential = rows["flags"] >> 6, rows["flags"] & 2 > 0
    single = np.where(differential, _DIFFERENTIAL, _SINGLE)
    quality = np.select([carrier == k for k in _CARRIER], list(_CARRIER.values()), single)
    values = {
        "lla": np.column_stack([np.deg2rad(place[:, :2]), place[:, 2]]),
        "vel_n": 1e-3 * rows["vel"],
        "sd_pos": np.column_stack([sd[:, 0], sd[:, 0], np.sqrt(2.0) * sd[:, 1]]) / np.sqrt(2.0),
        "sd_vel": np.column_stack([1e-3 * rows["speed_sd"]] * 3) / np.sqrt(3.0),
        "quality": quality,
        "satellites": rows["satellites"].astype(float),
    }
    return LogRows(t, values, tuple(notes))


def _find_times(rows: NDArray[Any]) -> FloatArray:
    """Return GPS times (N,) [s since 1980-01-06]: second of week by iTOW, the week by the date in UTC."""
    first = rows[0]
    try:
        day = date(int(first["year"]), *map(int, first["day"]))
    except ValueError:
        day = date(1980, 1, 6)
    tow = 1e-3 * rows["tow"].astype(float)
    tow += WEEK * np.concatenate([[0.0], np.cumsum(np.diff(tow) < -WEEK / 2)])
    hour, minute, second = map(int, first["time"])
    utc = gps_seconds(day.year, day.month, day.day, 3600.0 * hour + 60.0 * minute + second)
    return np.asarray(tow + WEEK * round((utc + leap_seconds(day) - tow[0]) / WEEK))
