"""How far a flight was from the tracks between its waypoints: the flight technical error."""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from bench.arrays import FloatArray, IntArray
from bench.data import Trajectory
from bench.earth import matrix_en, to_ecef
from bench.flight.legs.tracks import Waypoints
from bench.flight.shaping import G
from bench.specs import FlightSpec

_ROLL = 5.0  # by which a turn begins before its arc and ends after it [s]


def measure_off_track(spec: FlightSpec, truth: Trajectory, rows: IntArray) -> tuple[FloatArray, FloatArray]:
    """Return where a flight was off its tracks, and their directions.

    Tracks are the straights between the points of each ``waypoints`` leg. A turn by a point has no track of
    its own, nor has the way to the first point; the turn there is taken to be of 90 deg.

    Parameters
    ----------
    spec : FlightSpec
        The flight.
    truth : Trajectory
        How it went.
    rows : (M,) array of int
        Rows of the truth, increasing.

    Returns
    -------
    off : (M,) array
        Distance to the right of the track [m]; NaN where there is none.
    course : (M,) array
        Direction of the track there [rad]; NaN where there is none.
    """
    t, lla = truth.t[rows], truth.lla[rows]
    speed = np.hypot(truth.vel_n[rows, 0], truth.vel_n[rows, 1])
    at = to_ecef(lla)
    off, course = np.full(len(t), np.nan), np.full(len(t), np.nan)
    for leg, (start, end, _) in zip(spec.legs, truth.events.select("leg"), strict=False):
        inside = np.flatnonzero((t >= start) & (t < end))
        if not isinstance(leg, Waypoints) or len(inside) < len(leg.points):
            continue
        places = [point.place((spec.lat, spec.lon, spec.alt)) for point in leg.points]
        alt = float(lla[inside, 2].mean())
        points = to_ecef([(*place, alt) for place in places])
        passed = inside[_pass_in_order(np.linalg.norm(at[inside, None] - points, axis=2))]
        fastest = float(speed[inside].max())
        radius = fastest**2 / (G * np.tan(leg.bank))
        tracks = [_lay_track(*pair, place) for pair, place in zip(pairwise(points), places, strict=False)]
        turns = [np.remainder(b[0] - a[0] + np.pi, 2 * np.pi) - np.pi for a, b in pairwise(tracks)]
        arcs = [radius, *(radius * np.tan(0.5 * np.abs(turn)) for turn in turns)]
        cuts = [*(arc + _ROLL * fastest for arc in arcs), 0.0]
        for k, (direction, length, to_n) in enumerate(tracks):
            between = np.arange(passed[k], passed[k + 1] + 1)
            north, east, _ = ((at[between] - points[k]) @ to_n).T
            along = north * np.cos(direction) + east * np.sin(direction)
            on = (along >= cuts[k]) & (along <= length - cuts[k + 1])
            off[between[on]] = (east * np.cos(direction) - north * np.sin(direction))[on]
            course[between[on]] = direction
    return off, course


def _pass_in_order(distance: FloatArray) -> IntArray:
    """Return the rows (K,), in order, at which the sum of the distances (M, K) to K points is least."""
    least, chosen = distance[:, 0], [np.arange(len(distance))]
    for k in range(1, distance.shape[1]):
        best = np.minimum.accumulate(least)
        first = np.maximum.accumulate(np.where(least == best, np.arange(len(least)), 0))
        chosen.append(first)
        least = best + distance[:, k]
    row = int(least.argmin())
    rows = [row]
    for first in chosen[:0:-1]:
        row = int(first[row])
        rows.append(row)
    return np.array(rows[::-1])


def _lay_track(
    here: FloatArray, there: FloatArray, place: tuple[float, float]
) -> tuple[float, float, FloatArray]:
    """Return the direction [rad] and the length [m] of a track, and C_en at its start."""
    to_n = matrix_en(*place)
    north, east, _ = (there - here) @ to_n
    return float(np.arctan2(east, north)), float(np.hypot(north, east)), to_n
