"""Distance of a flight from the tracks between its waypoints: the flight technical error."""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from bench.core.mathematics.arrays import FloatArray, IntArray
from bench.core.mathematics.earth import matrix_en, to_ecef
from bench.core.records.data import Trajectory
from bench.core.records.flight_specs import FlightSpec
from bench.simulation.flight.guidance.shaping import G
from bench.simulation.flight.legs.tracks import PointToPoint

_ROLL = 5.0  # by which a turn begins before its arc and ends after it [s]


def measure_off_track(spec: FlightSpec, truth: Trajectory, rows: IntArray) -> tuple[FloatArray, FloatArray]:
    """Return the deviation of a flight from its tracks, and the directions of the tracks.

    Tracks are the straights between the points of each ``waypoints`` leg, and the arcs by which its guidance
    joins them: tangent to both, with the radius of the bank at the highest ground speed of the leg. With a
    wind that changes with height the radius is not known from here, and the turns have no track. The way to
    the first point has none; the turn there is taken to be of 90 deg.

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
    for number, (leg, (start, end, _)) in enumerate(zip(spec.legs, truth.events.select("leg"), strict=False)):
        inside = np.flatnonzero((t >= start) & (t < end))
        if not isinstance(leg, PointToPoint) or len(inside) < len(leg.points):
            continue
        places = [point.place((spec.lat, spec.lon, spec.alt)) for point in leg.points]
        alt = float(lla[inside, 2].mean())
        points = to_ecef([(*place, alt) for place in places])
        passed = inside[_pass_in_order(np.linalg.norm(at[inside, None] - points, axis=2))]
        fastest = float(speed[inside].max())
        known = None if spec.wind_layers else _find_radius(spec, number, leg.bank)
        radius = fastest**2 / (G * np.tan(leg.bank)) if known is None else known
        rolling = _ROLL * fastest if known is None else 0.0
        tracks = [_lay_track(*pair, place) for pair, place in zip(pairwise(points), places, strict=False)]
        turns = [np.remainder(b[0] - a[0] + np.pi, 2 * np.pi) - np.pi for a, b in pairwise(tracks)]
        arcs = [radius * np.tan(0.5 * np.abs(turn)) for turn in turns]
        cuts = [radius + _ROLL * fastest, *(arc + rolling for arc in arcs), 0.0]
        for k, (direction, length, to_n) in enumerate(tracks):
            between = np.arange(passed[k], passed[k + 1] + 1)
            along, right = _resolve(at[between], points[k], to_n, direction)
            on = (along >= cuts[k]) & (along <= length - cuts[k + 1])
            off[between[on]] = right[on]
            course[between[on]] = direction
        for k, (turn, arc) in enumerate(zip(turns, arcs, strict=True) if known is not None else ()):
            between, corner, to_n = np.arange(passed[k], passed[k + 2] + 1), points[k + 1], tracks[k + 1][2]
            before, right = _resolve(at[between], corner, to_n, tracks[k][0])
            after, _ = _resolve(at[between], corner, to_n, tracks[k + 1][0])
            on = (before >= -arc) & (after <= arc) & np.isnan(off[between])
            side = np.sign(turn)
            ahead, across = (before + arc)[on], (right - side * radius)[on]  # from the center of the arc
            off[between[on]] = side * (radius - np.hypot(ahead, across))
            course[between[on]] = tracks[k][0] + side * np.arctan2(ahead, -side * across)
    return off, course


def _find_radius(spec: FlightSpec, number: int, bank: float) -> float:
    """Return the turn radius of a leg [m], as its guidance computes it (`guidance.paths`)."""
    wanted = [spec.speed, *(getattr(leg, "speed", None) for leg in spec.legs[: number + 1])]
    speeds = [speed for speed in wanted if speed is not None]
    begun = [speed for speed in wanted[:-1] if speed is not None]
    fastest = max(begun[-1], speeds[-1]) + spec.wind_speed
    return float(fastest**2 / (G * np.tan(bank)))


def _resolve(
    at: FloatArray, origin: FloatArray, to_n: FloatArray, direction: float
) -> tuple[FloatArray, FloatArray]:
    """Return the distances of points (K, 3) from an origin, along a direction [rad] and to its right [m]."""
    north, east, _ = ((at - origin) @ to_n).T
    c, s = np.cos(direction), np.sin(direction)
    return north * c + east * s, east * c - north * s


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
