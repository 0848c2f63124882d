"""Fixes of Septentrio receivers as a log: PVTGeodetic, with PosCovGeodetic and VelCovGeodetic.

The layouts are those of the PolaRx5TR Reference Guide 5.5.0, section 4.2.10, as pysbf2
(github.com/semuconsulting/pysbf2) lists them, too. Times are GPS time since 1980-01-06.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bench.core.mathematics.arrays import FloatArray
from bench.core.words.exceptions import ConfigError
from bench.io.logs.file_kinds import describe_unreadable
from bench.io.logs.rows import MOST_ROWS, LogRows, spread_accuracy
from bench.plugins.receiver.receiver_streams.sbf import find_time, read_blocks

FORMAT = {"endings": (".sbf",), "fixes": True}
"""Its row in `bench.io.log_formats`."""

_PVT, _POSITION, _VELOCITY = 4007, 5906, 5908
_HEAD = [("tow", "<u4"), ("week", "<u2"), ("mode", "u1"), ("error", "u1")]
_FIX = np.dtype(
    [*_HEAD, ("lla", "<f8", 3), ("undulation", "<f4"), ("vel", "<f4", 3), ("", "V16"), ("system", "u1"),
     ("datum", "u1"), ("satellites", "u1"), ("", "V15"), ("accuracy", "<u2", 2)]
)  # fmt: skip
_COVARIANCE = np.dtype([*_HEAD, ("variance", "<f4", 3)])
_LAYOUTS = {_PVT: _FIX, _POSITION: _COVARIANCE, _VELOCITY: _COVARIANCE}
_QUALITIES = np.full(16, np.nan)
_QUALITIES[[4, 7, 5, 8, 6, 2, 1, 10]] = 1.0, 1.0, 2.0, 2.0, 3.0, 4.0, 5.0, 6.0
"""Class of RTKLIB by type of the solution; none for a place that was typed in, and without a solution."""
_FLAT = 0x80  # bit of the mode: the height is assumed


def read(form: str, path: Path, kind: str, topic: str | None) -> LogRows:
    """Read the fixes of an SBF stream.

    ``quality`` has the classes of RTKLIB: 1 fixed, 2 float, 3 SBAS, 4 DGPS, 5 single, 6 PPP. Without
    PosCovGeodetic, positions get half the accuracies of PVTGeodetic, which are 2 sigma.
    """
    if kind != "gnss":
        raise ConfigError(describe_unreadable(path, f"no {kind.upper()} in an SBF recording"))
    bodies: dict[int, list[bytes]] = {number: [] for number in _LAYOUTS}
    damaged = early = 0
    for number, body in read_blocks(path, path.name):
        damaged += body is None
        if body is None or number not in _LAYOUTS:
            continue
        if find_time(body) is None:
            early += number == _PVT
        else:  # blocks of an earlier revision are shorter
            size = _LAYOUTS[number].itemsize
            bodies[number].append(body[:size].ljust(size, b"\xff"))
        if len(bodies[number]) > MOST_ROWS:
            raise ConfigError(f"{path.name}: more than {MOST_ROWS} fixes")
    if not bodies[_PVT]:
        what = "no fix with a time" if early else "no fix (SBF PVTGeodetic)"
        raise ConfigError(f"{path.name}: has {what}; bench fixes {path.name} computes fixes from its ranges")
    rows, positions, velocities = (
        np.frombuffer(b"".join(those), _LAYOUTS[number]) for number, those in bodies.items()
    )
    lla, quality = rows["lla"].copy(), _QUALITIES[rows["mode"] & 15]
    inside = (np.abs(lla) <= [np.pi / 2, np.pi, 1e6]).all(axis=1)  # -2e10 stands for nothing
    lla[~inside | np.isnan(quality) | (rows["error"] > 0) | (rows["mode"] & _FLAT > 0)] = np.nan
    vel = rows["vel"].astype(float)
    accuracy = np.where(rows["accuracy"] == 0xFFFF, np.nan, 0.5e-2 * rows["accuracy"])
    sd_pos = _find_sd(rows, positions)
    values = {
        "lla": lla,
        "vel_n": np.where(np.abs(vel) < 1e4, vel * [1.0, 1.0, -1.0], np.nan),
        "sd_pos": np.where(np.isnan(sd_pos), spread_accuracy(accuracy), sd_pos),
        "sd_vel": _find_sd(rows, velocities),
        "quality": quality,
        "satellites": np.where(rows["satellites"] == 0xFF, np.nan, rows["satellites"].astype(float)),
    }
    counts = ((damaged, "damaged blocks"), (early, "fixes before the receiver set its clock"))
    notes = tuple(f"{path.name}: {count} {words} are left out" for count, words in counts if count)
    found = {name: value for name, value in values.items() if name == "lla" or np.isfinite(value).any()}
    return LogRows(_find_times(rows), found, notes)


def _find_times(rows: NDArray[Any]) -> FloatArray:
    return np.asarray(604800.0 * rows["week"] + 1e-3 * rows["tow"])


def _find_sd(rows: NDArray[Any], covariances: NDArray[Any]) -> FloatArray:
    """Return sd (N, 3) along north, east, down of the blocks with the time of each fix; NaN without one."""
    sd = np.full((len(rows), 3), np.nan)
    _, at, of = np.intersect1d(_find_times(rows), _find_times(covariances), return_indices=True)
    variance = covariances["variance"][of]
    sd[at] = np.sqrt(np.where((variance > 0) & (variance < 1e12), variance, np.nan))
    return sd
