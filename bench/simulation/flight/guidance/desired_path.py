"""Deviation of a flight from the desired path of its legs: waypoints, or a runway approach.

The path of a runway is the extended centerline, from the turn onto it on, and the glide path below the height
at which the approach began. Legs by heading, bank or surface have no path.
"""

from __future__ import annotations

import numpy as np

from bench.core.mathematics.arrays import FloatArray, IntArray
from bench.core.mathematics.earth import matrix_en, to_ecef
from bench.core.mathematics.units import SAME_INSTANT
from bench.core.records.data import Trajectory
from bench.core.records.flight_specs import FlightSpec
from bench.core.records.run_records import OffPath
from bench.simulation.flight.guidance.off_track import measure_off_track
from bench.simulation.flight.legs.landing import Approach, Flare, LandingRoll

_ALONG = 0.035  # an approach is on its centerline when its track is first so close to it [rad]
_CAPTURED = 20.0  # below the height it began at, an approach is on its glide path [m]


def measure_steered(spec: object, truth: Trajectory, t: FloatArray) -> OffPath | None:
    """Return the path deviation of a flight at epochs (M,) [s]; None if the truth is a table."""
    if not isinstance(spec, FlightSpec):
        return None
    return measure_off_path(spec, truth, np.searchsorted(truth.t, t - SAME_INSTANT))


def measure_off_path(spec: FlightSpec, truth: Trajectory, rows: IntArray) -> OffPath:
    """Return the path deviation of a flight at increasing rows (M,) of the truth."""
    right, course = measure_off_track(spec, truth, rows)
    above, t = np.full(len(rows), np.nan), truth.t[rows]
    runway, figures = spec.runway, spec.aircraft.runway
    if runway is None:
        return OffPath(t, right, above, course)
    for leg, (start, end, _) in zip(spec.legs, truth.events.select("leg"), strict=False):
        inside = np.flatnonzero((t >= start) & (t < end))
        if not isinstance(leg, Approach | Flare | LandingRoll) or not len(inside):
            continue
        at = to_ecef(truth.lla[rows[inside]]) - to_ecef([runway.lat, runway.lon, runway.alt])
        north, east, _ = (at @ matrix_en(runway.lat, runway.lon)).T
        c, s = np.cos(runway.heading), np.sin(runway.heading)
        along, across = north * c + east * s, east * c - north * s
        on = np.ones(len(inside), bool)
        if isinstance(leg, Approach):
            vel_n = truth.vel_n[rows[inside]]
            turned = np.arctan2(vel_n[:, 1], vel_n[:, 0]) - runway.heading
            on = np.maximum.accumulate(np.abs(np.remainder(turned + np.pi, 2 * np.pi) - np.pi) < _ALONG)
            alt = truth.lla[rows[inside], 2]
            # the height of the leg is that of the center of gravity, which the IMU is at to decimeters
            rest = 0.0 if figures is None else figures.height
            glide = runway.alt + rest + np.tan(leg.glide) * (leg.aim - along)
            captured = on & (glide < alt[0] - _CAPTURED)
            above[inside[captured]] = (alt - glide)[captured]
        right[inside[on]] = across[on]
        # its direction where the aircraft is: north there is not north at the runway
        ahead = matrix_en(runway.lat, runway.lon) @ np.array([c, s, 0.0])
        lla = truth.lla[rows[inside]]
        ahead_n = np.einsum("mij,i->mj", matrix_en(lla[:, 0], lla[:, 1]), ahead)
        course[inside[on]] = np.arctan2(ahead_n[:, 1], ahead_n[:, 0])[on]
    return OffPath(t, right, above, course)
