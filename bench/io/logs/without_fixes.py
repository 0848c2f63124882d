"""Logs without a receiver: no fixes, and a start at the place that the log gives."""

from __future__ import annotations

import numpy as np

from bench.core.mathematics.rotation import from_euler
from bench.core.records.data import GnssFixes, InitialState
from bench.io.config.log import LogSpec

_PLACE_SD = 1e3  # of a place that is typed in [m]
_SPEED_SD = 300.0  # of a velocity that may be any, each axis [m/s]


def no_fixes() -> GnssFixes:
    """Return fixes without rows."""
    n, v, c = np.empty(0), np.empty((0, 3)), np.empty((0, 3, 3))
    return GnssFixes(n, n, np.empty(0, np.bool_), v, v, c, c, np.empty(0, np.int64))


def name_records(spec: LogSpec) -> set[str]:
    """Return the names of the records of a log, as filters need them (`estimator.RECORDS`)."""
    found = set(spec.instruments)
    if spec.gnss is not None:
        found |= {"fixes", "observations"} if spec.gnss.observations else {"fixes"}
    return found


def start_at_place(spec: LogSpec) -> InitialState:
    """Return the initial state of a log without a receiver: at rest or of any velocity, at its place."""
    assert spec.place is not None
    given, lla = spec.start, np.array(spec.place)
    lla[:2] = np.radians(lla[:2])
    variance = np.repeat([_PLACE_SD**2, _SPEED_SD**2, np.inf], 3)
    vel_n, q_nb = np.full(3, np.nan), np.full(4, np.nan)
    if given.alignment == "given":
        vel_n, q_nb = np.zeros(3), from_euler(*given.attitude)
        variance[6:] = np.square([given.tilt_sd, given.tilt_sd, given.heading_sd])
    else:
        variance[3:6] = np.inf
    return InitialState(
        given.at, lla, vel_n, q_nb, np.diag(variance), given.alignment, align_for=given.align_for
    )
