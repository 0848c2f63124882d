"""Motion of a vehicle from a track of positions.

The fixes are smoothed (`trajectories.track_fit`) and an attitude is added that a track does not have: an
aircraft turns without sideslip and without side force, at an angle of incidence that is told; a ground
vehicle keeps its wheels on the ground, points where it goes and does not lean. What cannot be known is said,
and what no vehicle does is rejected.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from bench.core.mathematics.arrays import BoolArray, FloatArray
from bench.core.mathematics.earth import matrix_en, to_ecef, to_geodetic
from bench.core.mathematics.rotation import conjugate, continuous, from_matrix, multiply, rotate, to_rotvec
from bench.core.mathematics.units import STANDARD_GRAVITY
from bench.core.records.data import EventRow
from bench.core.records.flight_specs import TrackSpec
from bench.core.words.exceptions import ConfigError
from bench.core.words.wording import format_count
from bench.io.trajectories.track_files import LEAST_FIXES, FixSeries
from bench.io.trajectories.track_fit import TrackFit, fit_track

_RATE = 20.0  # rows per second of the motion
_OUTLIER = 6.0  # a fix further off, in robust standard deviations, is left out
_STANDING, _STANDS_FOR = 0.4, 10.0  # slower than that [m/s] for so long [s] is standing
_HELD = 1e6  # weight of the place of a standstill
_SLOW = 1.0  # the course of a slower vehicle is not known [m/s]
_GAP = 3.0  # an interval longer than this many median intervals is told
_GROWTH = 4.0**2  # a bounded acceleration leaves the middle of twice the interval off by 4 times, at least
_BLURRED, _LOST = 2.0, 5.0  # turns taken for noise [m]: told, rejected
_JUMP = 5.0  # times the speed of nine tenths of the steps is no motion; assumed
_MISSED, _MISSED_NOISE = 15.0, 6.0  # a fix missed by more [m] and [sd] is not predicted by its neighbors
_LOAD = (-0.5, 5.0)  # of an aircraft; assumed [g]
_ROLL_RATE = math.radians(120.0)  # of an aircraft; assumed [rad/s]
_VEHICLES = {"aircraft": "aircraft", "ground": "ground vehicle"}
_PUSH = 1.2  # horizontal acceleration of a ground vehicle; assumed [g]


@dataclass(frozen=True, slots=True)
class TableMotion:
    """A motion in rows: times from 0, Earth-fixed positions, attitudes, and velocity if recorded."""

    t: FloatArray  # (N,) [s]
    pos_e: FloatArray  # (N, 3) [m]
    q_eb: FloatArray  # (N, 4), sign-continuous
    vel_e: FloatArray | None  # (N, 3) [m/s]
    notes: list[EventRow]
    rotors: FloatArray | None = None  # (N, 4) speed of each rotor [rad/s]


def make_motion(track: FixSeries, spec: TrackSpec, shown: str) -> TableMotion:
    """Return the smoothed motion of a track at 20 Hz, with remarks on what was changed.

    Raises
    ------
    ConfigError
        If the fixes do not tell the motion, or no vehicle of its kind moves like that.
    """
    notes = [*track.notes, *doubt_degrees(track.lla)]
    asked = (track.t >= spec.begin) & (track.t <= spec.end)
    if asked.sum() < LEAST_FIXES:
        raise ConfigError(
            f"{shown}: [track] from_s and to_s select {int(asked.sum())} of {len(track.t)} fixes; "
            f"the track lasts {track.t[-1]:.6g} s. At least {LEAST_FIXES} are needed"
        )
    t, lla = choose_piece(track.t[asked], track.lla[asked], spec.bridge, notes)
    if len(t) < LEAST_FIXES:
        raise ConfigError(
            f"{shown}: the longest piece without a gap of more than {spec.bridge:g} s (bridge_s) has "
            f"{format_count(len(t), 'fix')}; at least {LEAST_FIXES} are needed, and their median interval is "
            f"{np.median(np.diff(track.t[asked])):.4g} s"
        )
    origin, C_en = to_ecef(lla[0]), matrix_en(lla[0, 0], lla[0, 1])
    fixes = (to_ecef(lla) - origin) @ C_en
    jump = find_jump(t, fixes)
    level, height = _smooth(t, fixes, spec, notes, shown, jump)
    at = np.arange(math.floor((t[-1] - t[0]) * _RATE + 1e-6) + 1) / _RATE + t[0]
    pos, vel, acc = (
        np.column_stack(
            [fit.spline.derivative(order)(at) if order else fit.spline(at) for fit in (level, height)]
        )
        for order in range(3)
    )
    pos_e = origin + pos @ C_en.T
    lat, lon, _ = to_geodetic(pos_e).T
    q_en = from_matrix(matrix_en(lat, lon))
    turn = conjugate(q_en)
    vel_n, acc_n = rotate(turn, vel @ C_en.T), rotate(turn, acc @ C_en.T)
    force_n = acc_n - np.array([0.0, 0.0, STANDARD_GRAVITY])
    if spec.vehicle == "aircraft":
        matrices = coordinate(vel_n - np.asarray(spec.wind_n), force_n, spec.incidence)
    else:
        matrices = _roll_on_wheels(vel_n)
    q_nb = continuous(from_matrix(matrices))
    q_eb = continuous(multiply(q_en, q_nb))
    _report(at - t[0], level, height, force_n, q_nb, vel_n, spec, notes, shown, jump)
    return TableMotion(at - t[0], pos_e, q_eb, None, [(0.0, 0.0, "table", note) for note in notes])


def doubt_degrees(lla: FloatArray) -> list[str]:
    """Return a remark if latitudes and longitudes [rad] that were read as degrees may have been radians.

    Those within 90 and 180 deg then all lie in an open sea around 0, 0.
    """
    if (np.abs(np.degrees(lla[:, :2])) > [0.5 * math.pi, math.pi]).any():
        return []
    lat, lon = np.degrees(lla[0, :2])
    return [f"{lat:.4f}, {lon:.4f} deg is in the sea off West Africa: are latitude and longitude in radians?"]


def choose_piece(
    t: FloatArray, lla: FloatArray, bridge: float, notes: list[str]
) -> tuple[FloatArray, FloatArray]:
    """Return the longest piece without an interval above ``bridge`` [s]; note cuts and remaining gaps."""
    steps, median = np.diff(t), float(np.median(np.diff(t)))
    edges = [0, *(np.flatnonzero(steps > bridge) + 1).tolist(), len(t)]
    begin, end = max(pairwise(edges), key=lambda pair: t[pair[1] - 1] - t[pair[0]])
    if len(edges) > 2:
        notes.append(
            f"cut at {format_count(len(edges) - 2, 'gap')} of more than {bridge:g} s; the longest piece "
            f"is used: {t[begin]:.6g} to {t[end - 1]:.6g} s"
        )
    steps = steps[begin : end - 1]
    gaps = steps > _GAP * median
    if gaps.any():
        notes.append(
            f"{format_count(int(gaps.sum()), 'gap')} of up to {steps.max():.3g} s bridged by the curve; "
            f"the median interval is {median:.3g} s"
        )
    return t[begin:end], lla[begin:end]


def _smooth(
    t: FloatArray, fixes: FloatArray, spec: TrackSpec, notes: list[str], shown: str, jump: str
) -> tuple[TrackFit, TrackFit]:
    """Fit splines to north and east together and to down, without outliers and with zero motion at rest."""
    used = ~find_lone(t, fixes)
    weights, target = np.ones(len(t)), fixes.copy()

    def fit() -> tuple[TrackFit, TrackFit]:
        at, w = t[used], weights[used]
        return (
            fit_track(at, target[used, :2], w, spec.noise),
            fit_track(at, target[used, 2:], w, spec.vertical_noise),
        )

    level, height = fit()
    off = np.abs(np.column_stack([level.spline(t), height.spline(t)]) - fixes)
    scale = np.maximum(1.4826 * np.median(off, axis=0), 0.1)
    noises = [level.noise, level.noise, height.noise]
    wild: BoolArray = np.any(off > _OUTLIER * np.maximum(scale, noises), axis=1)
    wild[[0, -1]] = False
    if wild.any() and wild.sum() < 0.1 * len(t):
        many = format_count(int(wild.sum()), "outlier")
        notes.append(f"left out: {many}, up to {off[wild].max():.3g} m off")
        used[wild] = False
        level, height = fit()
    blurred = _blur(t[used], fixes[used, :2], level) if spec.noise is None else 0.0
    # before stands are looked for: a curve through the middle of circles stands
    _check_resolved(t[used], level, blurred, spec, shown, jump)
    if blurred > _BLURRED:
        notes.append(
            f"fixes {np.median(np.diff(t)):.3g} s apart: {blurred:.2g} m of the {level.noise:.3g} m of noise "
            "may be turns that they do not resolve, which the curve leaves out; noise_m keeps them"
        )
    speed = np.linalg.norm(level.spline.derivative()(t), axis=1)
    stands, total = find_standing(t, speed), 0.0
    if stands:
        for rows in stands:
            target[rows] = fixes[rows].mean(axis=0)
            weights[rows] = _HELD
            total += float(t[rows.stop - 1] - t[rows.start])
        count = "once" if len(stands) == 1 else f"{len(stands)} times"
        notes.append(f"stands {count}, {total:.4g} s in all; its place there is the mean of the fixes")
        found, (level, height) = (level.noise, height.noise), fit()
        at = t[used]  # fixes that were moved tell neither noise nor residual
        level = replace(level, noise=found[0], left=fixes[used, :2] - level.spline(at))
        height = replace(height, noise=found[1], left=fixes[used, 2:] - height.spline(at))
    return level, height


def find_standing(t: FloatArray, speed: FloatArray) -> list[slice]:
    """Return the rows of each standstill that lasts long enough."""
    slow = np.concatenate([[False], speed < _STANDING, [False]])
    edges = np.flatnonzero(np.diff(slow.astype(int)))
    pairs = zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True)
    return [slice(a, b) for a, b in pairs if t[b - 1] - t[a] >= _STANDS_FOR]


def _blur(t: FloatArray, fixes: FloatArray, level: TrackFit) -> float:
    """Return the part of the estimated noise that is due to turns which the fixes do not resolve [m].

    Noise stays what it is when every second fix is left out; turns between fixes grow with the square of the
    interval, at least.
    """
    if len(t) < 2 * LEAST_FIXES:
        return 0.0
    halves = [fit_track(t[k::2], fixes[k::2], np.ones(len(t[k::2])), None).noise for k in (0, 1)]
    more = float(np.mean(np.square(halves))) - level.noise**2
    return min(level.noise, math.sqrt(max(more, 0.0) / (_GROWTH - 1)))


def _speeds(t: FloatArray, fixes: FloatArray, skip: int = 1) -> FloatArray:
    """Return the speeds between each fix and the fix ``skip`` rows later [m/s]."""
    return np.asarray(np.linalg.norm(fixes[skip:] - fixes[:-skip], axis=1) / (t[skip:] - t[:-skip]))


def find_lone(t: FloatArray, fixes: FloatArray) -> BoolArray:
    """Return which fixes are far from both neighbors, which are near each other.

    One that is far enough bends the first curve so that its neighbors are off, too.
    """
    steps, lone = _speeds(t, fixes), np.zeros(len(t), dtype=bool)
    there, back = steps[:-1], steps[1:]
    near = _speeds(t, fixes, 2) < np.minimum(there, back) / _JUMP
    lone[1:-1] = near & (there > _JUMP * np.percentile(steps, 90))
    return lone


def find_jump(t: FloatArray, fixes: FloatArray) -> str:
    """Return a text that names the fastest step between fixes, if it is exceptional."""
    steps = _speeds(t, fixes)
    k = int(np.argmax(steps))
    if steps[k] < _JUMP * np.percentile(steps, 90):
        return ""
    return f". They jump by {steps[k] * (t[k + 1] - t[k]):.4g} m at {t[k + 1]:.6g} s (from_s, to_s)"


def _check_resolved(
    t: FloatArray, level: TrackFit, blurred: float, spec: TrackSpec, shown: str, jump: str
) -> None:
    """Reject fixes that do not resolve the motion, and estimated noise that is due to turns."""
    lost = ""
    if level.missed > max(_MISSED, _MISSED_NOISE * (spec.noise or 0.0)):
        lost = f"one that is left out is missed by {level.missed:.3g} m"
    elif blurred > _LOST:
        lost = f"{blurred:.2g} m of the {level.noise:.3g} m of noise are turns (noise_m keeps them)"
    if lost:
        raise ConfigError(
            f"{shown}: its fixes, {np.median(np.diff(t)):.3g} s apart, do not resolve its turns: {lost}{jump}"
        )


def coordinate(air_n: FloatArray, force_n: FloatArray, incidence: float) -> FloatArray:
    """Return C_nb (T, 3, 3) without side force: x along the air path, pitched up by the incidence."""
    along = fill_slow(air_n)
    x = along / np.linalg.norm(along, axis=1, keepdims=True)
    down = -(force_n - (force_n * x).sum(axis=1, keepdims=True) * x)
    z = down / np.linalg.norm(down, axis=1, keepdims=True)
    y = np.cross(z, x)
    c, s = math.cos(incidence), math.sin(incidence)
    return np.stack([c * x - s * z, y, s * x + c * z], axis=-1)


def _roll_on_wheels(vel_n: FloatArray) -> FloatArray:
    """Return C_nb (T, 3, 3): x along the path, y level."""
    along = fill_slow(vel_n)
    x = along / np.linalg.norm(along, axis=1, keepdims=True)
    y = np.cross(np.array([0.0, 0.0, 1.0]), x)
    y /= np.linalg.norm(y, axis=1, keepdims=True)
    return np.stack([x, y, np.cross(x, y)], axis=-1)


def fill_slow(vel_n: FloatArray) -> FloatArray:
    """Return velocities with directions interpolated and leveled at speeds too low to have a direction."""
    speed = np.hypot(vel_n[:, 0], vel_n[:, 1])
    known = speed > _SLOW
    if not known.any():
        return np.broadcast_to([1.0, 0.0, 0.0], vel_n.shape)
    rows = np.arange(len(vel_n))
    course = np.interp(rows, rows[known], np.unwrap(np.arctan2(vel_n[known, 1], vel_n[known, 0])))
    slope = np.interp(rows, rows[known], vel_n[known, 2] / speed[known]) * np.minimum(speed / _SLOW, 1.0)
    filled = np.column_stack([np.cos(course), np.sin(course), slope])
    return np.where(known[:, None], vel_n, filled)


def _report(
    t: FloatArray,
    level: TrackFit,
    height: TrackFit,
    force_n: FloatArray,
    q_nb: FloatArray,
    vel_n: FloatArray,
    spec: TrackSpec,
    notes: list[str],
    shown: str,
    jump: str,
) -> None:
    """Report the changes and the extreme values; reject motions that no vehicle can make."""
    rms = [math.sqrt(float((fit.left**2).sum(axis=1).mean())) for fit in (level, height)]
    told = ["told" if given is not None else "estimated" for given in (spec.noise, spec.vertical_noise)]
    notes.append(
        f"smoothed: {rms[0]:.3g} m horizontally and {rms[1]:.3g} m vertically off the fixes (rms); noise "
        f"{level.noise:.3g} m each axis ({told[0]}), {height.noise:.3g} m in height ({told[1]})"
    )
    load = -rotate(conjugate(q_nb), force_n)[:, 2] / STANDARD_GRAVITY
    rates = to_rotvec(multiply(conjugate(q_nb[:-1]), q_nb[1:])) * _RATE
    push = np.hypot(force_n[:, 0], force_n[:, 1]) / STANDARD_GRAVITY
    bank = find_bank(q_nb)
    roll_rate = np.abs(rates[:, 0])
    speed = np.linalg.norm(vel_n, axis=1)
    if spec.vehicle == "aircraft":
        notes.append(
            f"load {load.min():.2f} to {load.max():.2f}, bank up to {math.degrees(bank.max()):.0f} deg, "
            f"roll up to {math.degrees(roll_rate.max()):.0f} deg/s; attitude by coordinated turns at an "
            f"incidence of {math.degrees(spec.incidence):g} deg, which a track does not contain: "
            f"pitch is off by as much as it is"
        )
        wrong = [
            (load < _LOAD[0], f"a load of {load.min():.3g}", load.argmin()),
            (load > _LOAD[1], f"a load of {load.max():.3g}", load.argmax()),
            (
                roll_rate > _ROLL_RATE,
                f"a roll of {math.degrees(roll_rate.max()):.3g} deg/s",
                roll_rate.argmax(),
            ),
        ]
    else:
        notes.append(
            f"horizontal acceleration up to {push.max():.2f} g, speed up to {speed.max():.3g} m/s; "
            f"it points where it goes and does not lean"
        )
        wrong = [(push > _PUSH, f"a horizontal acceleration of {push.max():.3g} g", push.argmax())]
    for beyond, what, k in wrong:
        if beyond.any():
            raise ConfigError(
                f"{shown}: {what} at {t[int(k)]:.1f} s: no {_VEHICLES[spec.vehicle]} moves like that; "
                f"the fixes do not resolve its motion, or their noise is above {level.noise:.2g} m "
                f"(noise_m){jump}"
            )


def find_bank(q_nb: FloatArray) -> FloatArray:
    """Return the size of the bank angles (N,) [rad]."""
    down_b = rotate(conjugate(q_nb), np.array([0.0, 0.0, 1.0]))
    bank: FloatArray = np.abs(np.arctan2(down_b[:, 1], down_b[:, 2]))
    return bank
