"""Make truth from a table of time, position and attitude.

Column names give quantity, frame and unit (`COLUMNS`). Position and attitude make the truth; a velocity, if
the table has one, is only compared with the position.

The motion between the rows is a quintic spline through at most 60 rows per second: position in the
Earth-fixed frame, attitude as the normalized quaternion from b to that frame. Its acceleration and angular
rate are continuous. Rows of denser tables are not all used, so that their rounding does not enter the
accelerations; the rows in between are compared with the spline. `flight.increments` makes the
increments from it at 400 Hz or more.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from bench.core.mathematics.arrays import FloatArray, IntArray
from bench.core.mathematics.earth import EARTH_RATE, matrix_en, to_ecef, to_geodetic
from bench.core.mathematics.rotation import (
    conjugate,
    continuous,
    from_euler,
    from_matrix,
    multiply,
    rotate,
    to_rotvec,
)
from bench.core.mathematics.units import FACTORS, STANDARD_GRAVITY, split_unit
from bench.core.records.data import EventRow, Events, Trajectory
from bench.core.records.flight_specs import TableSpec, TrackSpec
from bench.core.records.rotor_speeds import ROTORS
from bench.core.words.exceptions import ConfigError
from bench.io.logs.table_files import (
    TableColumns,
    check_times,
    find_first,
    group,
    list_columns,
    list_names,
    read_table,
)
from bench.io.trajectories.motion_commands import fly_commands, is_motion_definition
from bench.io.trajectories.track_files import READERS, order_fixes, read_track
from bench.io.trajectories.track_motion import TableMotion, doubt_degrees, make_motion
from bench.simulation.flight.increments import Motion
from bench.simulation.flight.truth import NO_AIR, NO_GROUND, Stretch, make_truth

MOST_ROWS = 3_000_000
"""Most rows of a table, and most samples of its truth: two hours at 400 Hz."""
_FEWEST = 8  # rows; a quintic spline needs 6
_KNOT_RATE = 60.0  # largest rate of the knots of the spline [Hz]
_FINE_RATE = 400.0  # smallest rate of the steps that make an increment [Hz]
_FASTEST = 1e4  # speed of a rotor: 95,000 rpm [rad/s]
_CHUNK = 50_000  # truth samples made at a time

_NORM_OFF, _NORM_WRONG = 1e-6, 1e-2  # |norm of a quaternion - 1| above which it is reported, rejected
_GAP = 5.0  # an interval longer than this many median intervals is a gap
_ALONG = 0.9  # mean cosine between heading and path above which the nose points along it
_TURN_RATE = math.radians(720.0)  # largest rate between rows; aircraft turn slower; assumed [rad/s]
_TURN = math.radians(90.0)  # largest rotation between rows; beyond it the motion is not known [rad]
_SPEED_OFF = 0.05  # tolerance of the velocity against the derivative of the position [m/s] ...
_SPEED_SHARE = 0.005  # ... or as a fraction of the speed [1]
_OFF_TABLE = 1e-3  # tolerance of a row against the truth [m]
_LIMITS = ((-0.5 * np.pi, 0.5 * np.pi), (-np.pi, 2 * np.pi), (-1e3, 1e5))  # latitude, longitude, height
_RADII = (6.34e6, 6.48e6)  # from the center of the Earth [m]
_FORCE = 10.0  # largest specific force of most aircraft, assumed [g]

_TIMES = (group("time", "t"), group("time", "time"))
_POSITIONS = (
    {**group("angle", "lat", "lon"), **group("length", "alt")},
    group("length", "ecef_x", "ecef_y", "ecef_z"),
)
_ATTITUDES = (
    group("", "q_nb_w", "q_nb_x", "q_nb_y", "q_nb_z"),
    group("", "q_eb_w", "q_eb_x", "q_eb_y", "q_eb_z"),
    group("angle", "roll", "pitch", "heading"),
    group("angle", "roll", "pitch", "yaw"),
)
VELOCITIES = (
    group("speed", "vel_n", "vel_e", "vel_d"),
    group("speed", "ecef_vel_x", "ecef_vel_y", "ecef_vel_z"),
)
_SPINS = (group("revolution", *(f"rotor_speed_{place}" for place in ROTORS)),)
KINDS = {
    "time": _TIMES,
    "position": _POSITIONS,
    "attitude": _ATTITUDES,
    "velocity": VELOCITIES,
    "rotors": _SPINS,
}
"""Kind -> alternative groups of columns; the first complete one is used."""

COLUMNS = {kind: list_names(groups) for kind, groups in KINDS.items()}
"""Column names of a table, by kind; angles also in rad or mrad, lengths in km, speeds as _m_s.

lat, lon, alt: geodetic, WGS 84, ellipsoidal height. ecef: Earth-fixed, WGS 84. roll, pitch, heading (or yaw,
which is the same): yaw-pitch-roll from north-east-down to forward-right-down, heading clockwise from north.
q_nb, q_eb: scalar first, from b to n (north-east-down) or to e. vel: velocity relative to the Earth.
rotor_speed: speeds of the rotors of a multirotor, linear between the rows; also in rpm.
"""


def read_trajectory(spec: TableSpec) -> Iterator[Trajectory]:
    """Yield the truth of a table in pieces, as `bench.simulation.flight.truth.make_truth` does.

    Parameters
    ----------
    spec : TableSpec
        A ``.csv`` or ``.parquet`` file with the columns of `COLUMNS`, and the rate of the truth.

    Yields
    ------
    Trajectory
        Truth from the first row on (t = 0), without air data and controls. Events of kind "sanity" report
        inconsistent rows; row 1 is the first below the header.

    Raises
    ------
    ConfigError
        If the table cannot be read or cannot be made into a truth; one line names the row.
    """
    rows = _read_motion(spec)
    fit = _fit_splines(rows, spec.path.name)
    length = float(rows.t[-1])
    if spec.duration is not None:
        if spec.duration > length + 1e-9:
            raise ConfigError(
                f"{spec.path.name}: it lasts {length:g} s; duration_s = {spec.duration:g} s is longer"
            )
        length = spec.duration
    samples = math.floor(length * spec.rate + 1e-6)
    if samples < spec.rate:
        raise ConfigError(f"{spec.path.name}: it lasts {length:g} s; at least 1 s is needed")
    if samples > MOST_ROWS:
        raise ConfigError(
            f"{spec.path.name}: {length:g} s at rate_hz = {spec.rate:g} Hz are {samples} samples, "
            f"more than {MOST_ROWS}: lower rate_hz, or set duration_s"
        )
    beyond, most, where = np.empty(0), 0.0, 0.0  # times beyond _FORCE; largest force and its time
    for truth in make_truth(_make_stretches(rows, fit, spec.rate, samples), spec.rate):
        force = np.linalg.norm(truth.dvel_b, axis=1) / np.diff(truth.t) / STANDARD_GRAVITY
        beyond = np.append(beyond, truth.t[1:][force > _FORCE])
        if force.max() > most:
            most, where = float(force.max()), float(truth.t[np.argmax(force)])
        end = float(truth.t[-1])
        if round(end * spec.rate) < samples:
            yield truth
    events = [*_report_inconsistencies(rows, fit), (0.0, end, "leg", f"trajectory {spec.name}")]
    if len(beyond):
        row = int(np.searchsorted(rows.t, where)) + 1
        words = f"row {row}: a specific force of {most:.3g} g, beyond {_FORCE:g} g: not a flight"
        events.append((float(beyond[0]), float(beyond[-1]), "sanity", words))
    yield replace(truth, events=Events.from_rows(events))


def _read_motion(spec: TableSpec) -> TableMotion:
    """Return the motion of a table, of a track, or of commands."""
    shown, track = spec.path.name, spec.track or TrackSpec()
    if spec.path.suffix.lower() in READERS:
        return make_motion(read_track(spec.path), track, shown)
    if is_motion_definition(spec.path):
        if spec.track is not None:
            raise ConfigError(
                f"{shown}: [track] is not used, because the commands contain an attitude: leave it out"
            )
        return fly_commands(spec.path)
    table = read_table(spec.path, KINDS, ("velocity", "attitude", "rotors"), MOST_ROWS)
    table.check_groups({"rotors": _SPINS}, shown)
    if "attitude" in table.columns:
        if spec.track is not None:
            raise ConfigError(
                f"{shown}: [track] is not used, because the table contains an attitude: leave it out"
            )
        return _check_rows(table, shown)
    table.check_groups({"attitude": _ATTITUDES}, shown)
    if "rotors" in table.columns:
        raise ConfigError(f"{shown}: {table.names['rotors'][0]} needs an attitude in the table: leave it out")
    position = table.columns["position"]
    lla = position if table.stems["position"][0] == "lat" else to_geodetic(position)
    notes = [table.list_unused()] if table.unused else []
    return make_motion(order_fixes(table.columns["time"][:, 0], lla, notes, shown), track, shown)


# --- checking -----------------------------------------------------------------------------------------


def _check_rows(table: TableColumns, shown: str) -> TableMotion:
    """Check the rows and return their motion.

    Raises
    ------
    ConfigError
        If a row is impossible; the message names the first one.
    """
    t = table.columns["time"][:, 0]
    if len(t) < _FEWEST:
        raise ConfigError(f"{shown}: {len(t)} rows; at least {_FEWEST} are needed")
    for kind, values in table.columns.items():
        for name, column in zip(table.names[kind], values.T, strict=True):
            if (k := find_first(~np.isfinite(column))) is not None:
                raise ConfigError(f"{shown}: row {k + 1}: {name} is not a finite number")
    check_times(t, table.names["time"][0], shown)
    notes: list[EventRow] = []
    if t[0] != 0.0:
        notes.append((0.0, 0.0, "table", f"t = 0 is {table.names['time'][0]} = {t[0]:.9g} of the table"))
    if table.unused:
        notes.append((0.0, 0.0, "table", table.list_unused()))
    position = table.columns["position"]
    check_positions(table, position, np.arange(1, len(t) + 1), _LIMITS, _RADII, shown)
    pos_e = to_ecef(position) if table.stems["position"][0] == "lat" else position
    lat, lon, _ = to_geodetic(pos_e).T
    notes += [(0.0, 0.0, "sanity", text) for text in doubt_degrees(np.column_stack([lat, lon]))]
    q_en = from_matrix(matrix_en(lat, lon))
    q_eb = _read_attitudes(table, shown, q_en, t - t[0], notes)
    if (name := table.names["attitude"][-1]) in ("heading_deg", "yaw_deg"):
        path_n = rotate(conjugate(q_en[:-1]), np.diff(pos_e, axis=0))
        if remark := _doubt_headings(name, np.degrees(table.columns["attitude"][:-1, 2]), path_n):
            notes.append((0.0, float(t[-1] - t[0]), "sanity", remark))
    vel_e = table.columns.get("velocity")
    if vel_e is not None and table.stems["velocity"][0] == "vel_n":
        vel_e = rotate(q_en, vel_e)
    return TableMotion(t - t[0], pos_e, q_eb, vel_e, notes, _check_rotors(table, shown))


def _check_rotors(table: TableColumns, shown: str) -> FloatArray | None:
    """Return the speeds of the rotors (N, 4) [rad/s], or None; raise ConfigError at the first bad one."""
    speeds = table.columns.get("rotors")
    for name, column in zip(table.names.get("rotors", ()), () if speeds is None else speeds.T, strict=True):
        value = column / FACTORS[split_unit(name)[1]]
        if (k := find_first(column > _FASTEST)) is not None:
            raise ConfigError(f"{shown}: row {k + 1}: {name} = {value[k]:.9g} is above {_FASTEST:g} rad/s")
        if (k := find_first(column < 0.0)) is not None:
            raise ConfigError(
                f"{shown}: row {k + 1}: {name} = {value[k]:.9g} is below 0: give the speed, without a sign"
            )
    return speeds


def has_rotor_speeds(path: Path) -> bool:
    """Return whether a table has columns of rotor speeds; reading says why it or one of them is missing."""
    if path.suffix.lower() in READERS or is_motion_definition(path):
        return False
    try:
        return not set(_SPINS[0]).isdisjoint(split_unit(name)[0] for name in list_columns(path))
    except ConfigError:
        return True


def check_positions(
    table: TableColumns,
    position: FloatArray,
    numbers: IntArray,
    limits: Sequence[tuple[float, float]],
    radii: tuple[float, float],
    shown: str,
) -> None:
    """Raise ConfigError at the first position (N, 3) outside its limits, with the number of its row.

    ``limits``: lowest and highest latitude, longitude [rad] and height [m]; ``radii``: smallest and largest
    distance of an Earth-fixed position from the center of the Earth [m].
    """
    if table.stems["position"][0] == "lat":
        for name, values, (low, high) in zip(table.names["position"], position.T, limits, strict=True):
            if (k := find_first((values < low - 1e-12) | (values > high + 1e-12))) is not None:
                value, a, b = (x / FACTORS[split_unit(name)[1]] for x in (values[k], low, high))
                text = f"{name} = {value:.9g} is outside {a:.6g} to {b:.6g}"
                raise ConfigError(f"{shown}: row {numbers[k]}: {text}")
        return
    km, low, high = np.linalg.norm(position, axis=1) / 1e3, radii[0] / 1e3, radii[1] / 1e3
    if (k := find_first((km < low) | (km > high))) is not None:
        text = f"ecef position is {km[k]:.6g} km from the center of the Earth, outside {low:g} to {high:g} km"
        raise ConfigError(f"{shown}: row {numbers[k]}: {text}")


def normalize_quaternions(q: FloatArray, numbers: IntArray, shown: str) -> FloatArray:
    """Return quaternions (N, 4) with norm 1; raise ConfigError if a norm is more than 1 % off."""
    norm = np.linalg.norm(q, axis=1)
    if (k := find_first(np.abs(norm - 1.0) > _NORM_WRONG)) is not None:
        raise ConfigError(f"{shown}: row {numbers[k]}: the quaternion has the norm {norm[k]:.6g}, not 1")
    normalized: FloatArray = q / norm[:, None]
    return normalized


def _read_attitudes(
    table: TableColumns, shown: str, q_en: FloatArray, t: FloatArray, notes: list[EventRow]
) -> FloatArray:
    attitude, stems = table.columns["attitude"], table.stems["attitude"]
    if stems[0] == "roll":
        return continuous(multiply(q_en, from_euler(*attitude.T)))
    q = normalize_quaternions(attitude, np.arange(1, len(t) + 1), shown)
    norm = np.linalg.norm(attitude, axis=1)
    off = np.abs(norm - 1.0)
    rows = np.flatnonzero(off > _NORM_OFF)
    if len(rows):
        worst = int(np.argmax(off))
        words = f"{len(rows)} quaternions from row {rows[0] + 1} on have a norm other than 1"
        worst_norm = f"row {worst + 1} the worst: {norm[worst]:.9g}"
        notes.append((float(t[rows[0]]), float(t[rows[-1]]), "sanity", f"{words}, {worst_norm}"))
    return continuous(q if stems[0] == "q_eb_w" else multiply(q_en, q))


def _doubt_headings(name: str, headings: FloatArray, path_n: FloatArray) -> str:
    """Return a remark if headings (N,) [deg] follow the path between rows only when read as radians."""
    if np.abs(headings).max() > 2 * math.pi + 1e-6:
        return ""
    course, way = np.arctan2(path_n[:, 1], path_n[:, 0]), np.hypot(path_n[:, 0], path_n[:, 1]) + 1e-9
    as_deg, as_rad = (np.average(np.cos(h - course), weights=way) for h in (np.radians(headings), headings))
    if as_deg > _ALONG or as_rad < _ALONG:
        return ""
    ends = f"{headings.min():.3g} to {headings.max():.3g}"
    return f"{name}, {ends}, is along the path as radians only: it would be {name[:-3]}rad"


# --- the motion ---------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class _Fit:
    """Splines through some rows of a table."""

    knots: FloatArray  # (K,) rows that the splines pass through
    origin: FloatArray  # (3,) [m], e
    pos: Any  # t -> position from the origin, e
    vel: Any  # t -> its derivative
    q: Any  # t -> quaternion, not normalized

    def pos_e(self, t: FloatArray) -> FloatArray:
        pos_e: FloatArray = self.origin + self.pos(t)
        return pos_e

    def q_eb(self, t: FloatArray) -> FloatArray:
        q = self.q(t)
        q_eb: FloatArray = q / np.linalg.norm(q, axis=1, keepdims=True)
        return q_eb


def _fit_splines(rows: TableMotion, shown: str) -> _Fit:
    from scipy.interpolate import make_interp_spline

    at = _choose_knots(rows.t)
    origin = rows.pos_e[0]
    pos = make_interp_spline(rows.t[at], rows.pos_e[at] - origin, k=5)
    q = make_interp_spline(rows.t[at], rows.q_eb[at], k=5)
    if not (np.isfinite(pos.c).all() and np.isfinite(q.c).all()):
        raise ConfigError(f"{shown}: no smooth motion fits the rows; their intervals differ too much")
    return _Fit(at, origin, pos, pos.derivative(), q)


def _choose_knots(t: FloatArray) -> Any:
    """Return the rows of the knots: all, or at most 60 per second; always the last row."""
    least = (1.0 - 1e-6) / _KNOT_RATE
    if len(t) < 2 * _FEWEST or np.diff(t).min() >= least:
        return np.arange(len(t))
    kept, last = [0], float(t[0])
    for k, now in enumerate(t.tolist()):
        if now - last >= least:
            kept.append(k)
            last = now
    if kept[-1] != len(t) - 1:
        kept[-1] = len(t) - 1
    if len(kept) < _FEWEST:
        return np.arange(len(t))
    return np.array(kept)


def _make_stretches(rows: TableMotion, fit: _Fit, rate: float, samples: int) -> Iterator[Stretch]:
    """Yield the motion in segments, ``samples`` in all; frame i is frame e at t = 0."""
    substeps = max(1, math.ceil(_FINE_RATE / rate))
    dt = 1.0 / (rate * substeps)
    for begun in range(0, samples, _CHUNK):
        first, end = begun * substeps, min(begun + _CHUNK, samples) * substeps
        t: FloatArray = dt * np.arange(first - (first > 0), end + 2, dtype=np.float64)
        pos_e, q_eb = fit.pos_e(t), fit.q_eb(t)
        half = 0.5 * EARTH_RATE * t
        q_ie = np.stack([np.cos(half), 0 * half, 0 * half, np.sin(half)], axis=-1)
        lat, lon, _ = to_geodetic(pos_e).T
        q_ne = conjugate(from_matrix(matrix_en(lat, lon)))
        motion = Motion(
            dt=dt,
            epa=EARTH_RATE * t,
            pos_i=rotate(q_ie, pos_e),
            vel_i=rotate(q_ie, fit.vel(t) + np.cross([0.0, 0.0, EARTH_RATE], pos_e)),
            q_nb=continuous(multiply(q_ne, q_eb)),
            q_ib=continuous(multiply(q_ie, q_eb)),
        )
        rotors = None
        if rows.rotors is not None:
            rotors = np.stack([np.interp(t, rows.t, speed) for speed in rows.rotors.T], axis=-1)
        yield Stretch(first, motion, NO_AIR, NO_GROUND, rotors=rotors)


# --- what is inconsistent -----------------------------------------------------------------------------


def _report_inconsistencies(rows: TableMotion, fit: _Fit) -> list[EventRow]:
    """Return one event for each kind of inconsistency in a table, with its rows."""
    t, steps = rows.t, np.diff(rows.t)
    found = list(rows.notes)

    def note(where: Any, worst: int, words: str) -> None:
        k = np.flatnonzero(where)
        if len(k):
            many = f"; {len(k)} rows from row {k[0] + 1} on" if len(k) > 1 else ""
            found.append((float(t[k[0]]), float(t[k[-1]]), "sanity", f"row {worst + 1}: {words}{many}"))

    median = float(np.median(steps))
    gaps = np.concatenate([[False], steps > _GAP * median])
    worst = int(np.argmax(steps)) + 1
    note(
        gaps,
        worst,
        f"{steps[worst - 1]:.4g} s after the row before; the median is {median:.4g} s: filled by the spline",
    )
    turned = np.linalg.norm(to_rotvec(multiply(conjugate(rows.q_eb[:-1]), rows.q_eb[1:])), axis=1)
    jumps = np.concatenate([[False], (turned > _TURN) | (turned > _TURN_RATE * steps)])
    worst = int(np.argmax(np.where(jumps[1:], turned, -1.0))) + 1
    by = f"{math.degrees(turned[worst - 1]):.4g} deg in {steps[worst - 1]:.4g} s"
    note(jumps, worst, f"the attitude jumps by {by}")
    if rows.vel_e is not None:
        off = np.linalg.norm(rows.vel_e - fit.vel(t), axis=1)
        speed = np.linalg.norm(rows.vel_e, axis=1)
        wrong = (off > _SPEED_OFF) & (off > _SPEED_SHARE * speed)
        worst = int(np.argmax(off))
        words = f"the velocity is {off[worst]:.3g} m/s off the derivative of the position, which is used"
        note(wrong, worst, words)
    off = np.linalg.norm(rows.pos_e - fit.pos_e(t), axis=1)
    worst = int(np.argmax(off))
    words = f"{off[worst] * 1e3:.3g} mm off the truth, which passes through {len(fit.knots)} of {len(t)} rows"
    note(off > _OFF_TABLE, worst, words)
    return found
