"""True position of a receiver, to evaluate its fixes: a known point, or a table of positions."""

from __future__ import annotations

import re
from pathlib import Path
from typing import NamedTuple

import numpy as np

from bench.core.mathematics import earth
from bench.core.mathematics.arrays import FloatArray
from bench.core.words.exceptions import ConfigError

_POINT = re.compile(r"\s*([^,\s]+)\s*,\s*([^,\s]+)\s*,\s*([^,\s]+)\s*")
_COLUMNS = ("gps_time", "lat_deg", "lon_deg", "alt_m")
_GAP = 2.0  # longest step of a table that is interpolated [s]; assumed


class Truth(NamedTuple):
    """Positions of the antenna."""

    origin: float  # of the times [s since 1980-01-06]
    t: FloatArray  # (N,) [s]; empty: a point that is right at all times
    lla: FloatArray  # (N, 3), or (1, 3) of a point [rad, rad, m]

    def at(self, origin: float, t: FloatArray) -> FloatArray:
        """Return the positions (M, 3) at times (M,) [s from ``origin``]; NaN where none is near."""
        if len(self.t) == 0:
            return np.broadcast_to(self.lla[0], (len(t), 3))
        when = t + (origin - self.origin)
        after = np.searchsorted(self.t, when).clip(1, max(len(self.t) - 1, 1))
        before = after - 1
        if len(self.t) == 1:
            before = after = np.zeros_like(after)
        step = self.t[after] - self.t[before]
        part = np.where(step > 0, (when - self.t[before]) / np.where(step > 0, step, 1.0), 0.0)
        away = earth.difference_n(self.lla[after], self.lla[before])
        found = earth.displace(self.lla[before], part[:, None] * away)
        near = np.minimum(np.abs(when - self.t[before]), np.abs(when - self.t[after])) < 1e-3
        inside = (part >= -1e-6) & (part <= 1 + 1e-6) & (step <= _GAP)
        found[~(near | inside)] = np.nan
        return found


def read_truth(text: str) -> Truth:
    """Read the truth of an option: ``LAT,LON,H`` [deg, deg, m, WGS 84] or the name of a CSV file.

    The file has columns gps_time (ISO 8601), lat_deg, lon_deg and alt_m, as `bench fixes -o` writes them.

    Raises
    ------
    ConfigError
        If it is neither.
    """
    point = _POINT.fullmatch(text)
    if point is not None:
        try:
            lat, lon, alt = (float(part) for part in point.groups())
        except ValueError:
            raise ConfigError(f"--truth {text!r}: LAT,LON,H must be three numbers [deg, deg, m]") from None
        if not (abs(lat) <= 90 and abs(lon) <= 360 and -1000 <= alt <= 1e6):
            raise ConfigError(f"--truth {text!r}: expected LAT,LON,HEIGHT [deg, deg, m] of a place on Earth")
        return Truth(0.0, np.empty(0), np.array([[np.deg2rad(lat), np.deg2rad(lon), alt]]))
    return _read_table(Path(text), text)


def _read_table(path: Path, shown: str) -> Truth:
    try:
        head, *rows = path.read_text(encoding="utf-8").splitlines()
    except FileNotFoundError:
        raise ConfigError(
            f"--truth {shown}: expected LAT,LON,HEIGHT [deg, deg, m] or the path of an existing file"
        ) from None
    except (OSError, UnicodeDecodeError, ValueError) as error:
        raise ConfigError(f"{shown}: cannot be read: {error}") from None
    names = [name.strip() for name in head.split(",")]
    missing = [name for name in _COLUMNS if name not in names]
    if missing:
        raise ConfigError(f"{shown}: has no column {missing[0]}; a truth has {', '.join(_COLUMNS)}")
    times, places = [], []
    at = [names.index(name) for name in _COLUMNS]
    for number, row in enumerate(rows, 2):
        fields = row.split(",")
        if not row.strip():
            continue
        try:
            times.append(np.datetime64(fields[at[0]].strip(), "ns"))
            places.append([float(fields[k]) for k in at[1:]])
        except (ValueError, IndexError):
            raise ConfigError(f"{shown}: line {number}: must have a time and three numbers") from None
    if not times:
        raise ConfigError(f"{shown}: has no rows")
    t = (np.array(times) - np.datetime64("1980-01-06", "ns")) / np.timedelta64(1, "s")
    lla = np.array(places)
    lla[:, :2] = np.deg2rad(lla[:, :2])
    known = np.isfinite(lla).all(axis=1)
    t, lla = t[known], lla[known]
    if not len(t) or (np.diff(t) <= 0).any():
        raise ConfigError(f"{shown}: its times must increase")
    return Truth(float(t[0]), t - t[0], lla)
