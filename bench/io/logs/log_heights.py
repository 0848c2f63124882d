"""Heights that a log does not contain: the setting of the altimeter, the ground below a radar."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from bench.core.records.data import GnssFixes
from bench.core.records.instruments import INSTRUMENTS, BaroData
from bench.io.config.log import LogSpec

_SETTING = 10.0  # time at the start by which an altimeter is set [s]


def set_altimeter(baro: BaroData, fixes: GnssFixes, begin: float, judged: float) -> BaroData:
    """Return a barometer set at the start to the height of the fixes, as a pilot sets the field elevation.

    Fixes from ``judged`` on [s] may be withheld to evaluate filters: they set it only if there is none
    before. No log contains the pressure of the day; without it, heights are off by a hundred meters.
    """
    near = fixes.valid & (fixes.t >= begin) & (fixes.t <= begin + _SETTING)
    before = near & (fixes.t < judged)
    near = before if before.any() else near
    known = baro.valid & np.isfinite(baro.alt_baro)
    if not near.any() or not known.any():
        return baro
    order = np.argsort(baro.t[known], kind="stable")
    own = np.interp(fixes.t[near], baro.t[known][order], baro.alt_baro[known][order])
    return replace(baro, alt_baro=baro.alt_baro + np.median(fixes.lla[near, 2] - own))


def find_ground(spec: LogSpec, instruments: Mapping[str, Any], fixes: GnssFixes) -> float:
    """Return the height of the ground below a radar [m], from the log or from the first radar row."""
    if spec.ground_alt is not None or "radar" not in instruments:
        return spec.ground_alt or 0.0
    radar, heights = instruments["radar"], INSTRUMENTS["radar"].values(instruments["radar"])[:, 0]
    seen, near = np.flatnonzero(radar.valid), np.flatnonzero(fixes.valid)
    if not len(seen) or not len(near):
        return 0.0
    fix = near[np.argmin(np.abs(fixes.t[near] - radar.t[seen[0]]))]
    return float(fixes.lla[fix, 2] - heights[seen[0]])
