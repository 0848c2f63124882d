"""Is a motion flying? What no aircraft of its class does is found and said, not repaired.

The report is part of the result: events of kind "sanity". A flight fails only when no
truth can be made of it.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np

from bench.arrays import BoolArray
from bench.earth import RATE
from bench.errors import FlightError
from bench.flight.increments import Motion, earth_relative, step_increments
from bench.flight.shaping import GUIDANCE_RATE
from bench.flight.tape import Ticks
from bench.flight.units import FT

_STANDARD_G = 9.80665  # [m/s^2]
_HARD = 10.0 * FT  # sink rate a landing gear is made for [m/s], 14 CFR 25.473(a)(2), the most of 23.473(d)
_ROLLING = 2.0  # ground speed at which a structure on the ground is no longer parked [m/s], assumed
_PLACE = 1e-2  # a position is off the integral of its velocity by more: it was set [m]
_SPEED = 5.0  # velocity change in one step that is no motion: 200 g at 400 Hz [m/s]
_ANGLE = 0.5  # rotation in one step that is no motion: 200 rad/s at 400 Hz [rad]
_ENOUGH = 10.0  # a flight between two changes of place is flown from this length on [s]
_LEAST = 1.0  # shorter than this nothing can be navigated [s]

Row = tuple[float, float, str, str]


@dataclass(frozen=True, slots=True)
class Limits:
    """What an aircraft of a class can do; the rates are assumed, about twice what such aircraft fly."""

    load_low: float  # load factors of the design [g]
    load_high: float
    rate: float  # largest component of the angular rate [rad/s]
    source: str  # of the load factors


LIMITS = {
    "uav": Limits(-10.0, 10.0, math.radians(400.0), "assumed"),
    "light": Limits(-3.0, 6.0, math.radians(180.0), "14 CFR 23.337, acrobatic category"),
    "transport": Limits(-1.0, 2.5, math.radians(60.0), "14 CFR 25.337"),
    "fighter": Limits(-3.0, 9.0, math.radians(400.0), "assumed"),
}
"""By class of aircraft."""


def stretch(dt: float, motion: Motion, what: str) -> tuple[slice, list[Row]]:
    """Return the steps of the first continuous flight worth the name, and what was left out.

    A trim or a reset inside a script puts the aircraft somewhere else between two steps. Truth
    is one motion: the first stretch of at least 10 s between such changes, else the longest.

    Raises
    ------
    FlightError
        When no second of continuous motion is left.
    """
    v, r = motion.vel_i, motion.pos_i
    gap = np.linalg.norm(np.diff(r, axis=0) - 0.5 * dt * (v[1:] + v[:-1]), axis=1)
    turned = 2.0 * np.arccos(np.clip(np.abs(np.sum(motion.q_ib[1:] * motion.q_ib[:-1], axis=1)), 0.0, 1.0))
    faster = np.linalg.norm(np.diff(v, axis=0), axis=1)
    earth = np.abs(np.diff(motion.epa) - RATE * dt)
    cut = (gap > _PLACE) | (turned > _ANGLE) | (faster > _SPEED) | (earth > 0.5 * RATE * dt)
    edges = [0, *(np.flatnonzero(cut) + 1), len(r)]
    pieces = [(int(a), int(b)) for a, b in pairwise(edges)]
    long_enough = [(a, b) for a, b in pieces if (b - a - 1) * dt >= _ENOUGH]
    first, end = long_enough[0] if long_enough else max(pieces, key=lambda ab: ab[1] - ab[0])
    if (end - first) * dt < _LEAST:
        raise FlightError(
            f"{what}: no truth can be made of it, the motion jumps (the first at {gap_at(cut, dt)})"
        )
    if not cut.any():
        return slice(0, len(r)), []
    times = ", ".join(f"{(k + 1) * dt:.2f} s" for k in np.flatnonzero(cut)[:5])
    more = f" and {np.count_nonzero(cut) - 5} times more" if np.count_nonzero(cut) > 5 else ""
    text = (
        f"{what}: the motion jumps at {times}{more} (by up to {gap.max():.4g} m): "
        f"truth is its flight from {first * dt:.2f} to {(end - 1) * dt:.2f} s"
    )
    return slice(first, end), [(0.0, 0.0, "sanity", text)]


def gap_at(cut: BoolArray, dt: float) -> str:
    """Return the time of the first change of place."""
    return f"{(int(np.argmax(cut)) + 1) * dt:.2f} s" if cut.any() else "its end"


def report(motion: Motion, ticks: Ticks, category: str) -> list[Row]:
    """Return what is beyond the class of the aircraft, one event for each kind of excess.

    Parameters
    ----------
    motion : Motion
        One continuous flight, from t = 0.
    ticks : Ticks
        Ground contacts at 20 Hz, from t = 0.
    category : str
        A key of ``LIMITS``.
    """
    limits, dt = LIMITS[category], motion.dt
    th, be = step_increments(motion)
    t = dt * np.arange(1, len(th) + 1)
    force = be / dt / _STANDARD_G
    load = -force[:, 2]
    rate = np.abs(th).max(axis=1) / dt
    jump = np.linalg.norm(np.diff(force, axis=0), axis=1)
    most_jump = 0.5 * (limits.load_high - limits.load_low)
    t_slow = np.arange(len(ticks.rows)) / GUIDANCE_RATE
    at = np.minimum(np.round(t_slow / dt).astype(int), len(motion.epa) - 1)
    _, vel_n = earth_relative(motion.epa[at], motion.pos_i[at], motion.vel_i[at])
    speed = np.hypot(vel_n[:, 0], vel_n[:, 1])
    touched = np.diff(ticks.wheels.astype(int), prepend=int(ticks.wheels[0])) > 0
    sink = np.concatenate([ticks.sink[:1], ticks.sink[:-1]])  # before the touch
    of_class = f"of the class {category}"

    def said() -> Iterator[tuple[Any, Any, str]]:
        beyond = f"{limits.load_low:g} to {limits.load_high:g} {of_class} ({limits.source})"
        words = f"load factor {load.min():.2f} to {load.max():.2f} is beyond {beyond}"
        yield (load < limits.load_low) | (load > limits.load_high), t, words
        most_rate, fastest = np.rad2deg((limits.rate, rate.max()))
        words = f"angular rate {fastest:.0f} deg/s is beyond {most_rate:.0f} {of_class}"
        yield rate > limits.rate, t, words
        worst = jump.max(initial=0.0)
        words = f"specific force jumps by {worst:.1f} g in a step, beyond {most_jump:g} {of_class}"
        yield jump > most_jump, t[1:], words
        hard = touched & (sink > _HARD)
        words = f"wheels hit the ground at {sink[hard].max(initial=0.0):.1f} m/s, beyond {_HARD:.2f}"
        yield hard, t_slow, words
        scraped = ticks.structure & (speed > _ROLLING)
        words = f"not only wheels touch the ground, at up to {speed[scraped].max(initial=0.0):.1f} m/s"
        yield scraped, t_slow, words
        under = ticks.agl < 0
        words = f"the centre of gravity is up to {-ticks.agl.min(initial=0.0):.1f} m under the ground"
        yield under, t_slow, words
        yield (
            ~np.isfinite(ticks.rows).all(axis=1),
            t_slow,
            "air data or controls are not finite; they stand as 0",
        )

    rows = []
    for found, when, words in said():
        if found.any():
            k = np.flatnonzero(found)
            times = "once" if len(k) == 1 else f"{len(k)} times"
            rows.append((float(when[k[0]]), float(when[k[-1]]), "sanity", f"{words}, {times}"))
    return rows
