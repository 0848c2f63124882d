"""Check of the motion of a flight: motion beyond the limits of the aircraft class is reported, not changed.

The report is part of the result: events of kind "sanity". A flight fails only if no truth can be made of it.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from bench.core.mathematics.arrays import BoolArray, FloatArray
from bench.core.mathematics.earth import EARTH_RATE
from bench.core.mathematics.units import STANDARD_GRAVITY
from bench.core.records.data import EventRow
from bench.core.words.exceptions import FlightError
from bench.simulation.flight.increments import Motion, earth_relative, step_increments
from bench.simulation.flight.jsbsim_units import FT
from bench.simulation.flight.truth import Stretch

_HARD = 10.0 * FT  # sink rate a landing gear is made for [m/s], 14 CFR 25.473(a)(2), the most of 23.473(d)
_ROLLING = 2.0  # ground speed at which a structure on the ground is no longer parked [m/s], assumed
_PLACE = 1e-2  # a position is off the integral of its velocity by more: it was set [m]
_SPEED = 5.0  # velocity change in one step that is no motion: 200 g at 400 Hz [m/s]
_ANGLE = 0.5  # rotation in one step that is no motion: 200 rad/s at 400 Hz [rad]
_ENOUGH = 10.0  # a flight between two changes of place is flown from this length on [s]
_LEAST = 1.0  # shorter than this nothing can be navigated [s]


@dataclass(frozen=True, slots=True)
class Limits:
    """Limits of an aircraft class; the rates are assumed to be twice the usual rates of such aircraft."""

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


def choose_flight(motions: Iterable[Motion], what: str) -> tuple[slice, list[EventRow]]:
    """Return the steps of the first sufficiently long continuous flight, and the parts left out.

    A trim or a reset inside a script puts the aircraft somewhere else between two steps. Truth
    is one motion: the first segment of at least 10 s between such changes, else the longest.

    Parameters
    ----------
    motions : iterable of Motion
        The whole flight in parts; each begins with the last row of the one before.
    what : str
        How messages call it: "script c1723".

    Raises
    ------
    FlightError
        When no second of continuous motion is left.
    """
    parts, dt, widest = [np.zeros(0, np.bool_)], 0.0, 0.0
    for motion in motions:
        dt, v, r, q = motion.dt, motion.vel_i, motion.pos_i, motion.q_ib
        gap = np.linalg.norm(np.diff(r, axis=0) - 0.5 * dt * (v[1:] + v[:-1]), axis=1)
        turned = 2.0 * np.arccos(np.clip(np.abs(np.sum(q[1:] * q[:-1], axis=1)), 0.0, 1.0))
        faster = np.linalg.norm(np.diff(v, axis=0), axis=1)
        earth = np.abs(np.diff(motion.epa) - EARTH_RATE * dt)
        parts.append((gap > _PLACE) | (turned > _ANGLE) | (faster > _SPEED) | (earth > 0.5 * EARTH_RATE * dt))
        widest = max(widest, float(gap.max()))
    jumps = np.concatenate(parts)
    cuts = [int(k) + 1 for k in np.flatnonzero(jumps)]
    flights = list(pairwise([0, *cuts, len(jumps) + 1]))
    long_enough = [(a, b) for a, b in flights if (b - a - 1) * dt >= _ENOUGH]
    first, end = long_enough[0] if long_enough else max(flights, key=lambda ab: ab[1] - ab[0])
    if (end - first) * dt < _LEAST:
        where = f"{cuts[0] * dt:.2f} s" if cuts else "its end"
        raise FlightError(f"{what}: no truth can be made of it: the motion jumps (the first at {where})")
    if not cuts:
        return slice(first, end), []
    times = ", ".join(f"{k * dt:.2f} s" for k in cuts[:5])
    more = f" and {len(cuts) - 5} times more" if len(cuts) > 5 else ""
    text = (
        f"{what}: the motion jumps at {times}{more} (by up to {widest:.4g} m): "
        f"truth is its flight from {first * dt:.2f} to {(end - 1) * dt:.2f} s"
    )
    return slice(first, end), [(0.0, 0.0, "sanity", text)]


def report_sanity(stretches: Iterable[Stretch], category: str, *, landings: bool = True) -> Iterator[Stretch]:
    """Pass on the segments of a flight; add an event for each kind of excess to the last segment.

    Parameters
    ----------
    stretches : iterable of Stretch
        One continuous flight, from t = 0.
    category : str
        Class of the aircraft, a key of ``LIMITS``.
    landings : bool
        Whether the report covers hard landings; those of a plan are exceedances.
    """
    report = _Report(category, landings)
    for stretch in stretches:
        report.add(stretch)
        if stretch.events is None:
            yield stretch
        else:
            yield replace(stretch, events=stretch.events + report.rows())


class _Report:
    """Motion beyond the limits of the class of an aircraft, collected from the segments of its flight."""

    def __init__(self, category: str, landings: bool) -> None:
        self._category, self._limits, self._landings = category, LIMITS[category], landings
        self._jump = 0.5 * (self._limits.load_high - self._limits.load_low)  # [g]
        self._force_b = np.empty((0, 3))  # of the last step [g]
        self._ground = np.empty((0, 4))  # the last row
        self._found: dict[str, tuple[float, float, int]] = {}  # kind: first and last time [s], how often
        self._least: dict[str, float] = {}  # figure of a kind
        self._most: dict[str, float] = {}

    def add(self, stretch: Stretch) -> None:
        """Process the next segment, and the step after it."""
        motion, limits, dt, before = stretch.motion, self._limits, stretch.motion.dt, stretch.before
        th, be = (column[2 * before :] for column in step_increments(motion))
        t: FloatArray = dt * (stretch.first + before + np.arange(1.0, len(th) + 1))
        force = be / dt / STANDARD_GRAVITY
        load = -force[:, 2]
        self._note("load", (load < limits.load_low) | (load > limits.load_high), t, load)
        rate = np.abs(th).max(axis=1) / dt
        self._note("rate", rate > limits.rate, t, np.rad2deg(rate))
        jump = np.linalg.norm(np.diff(np.concatenate([self._force_b, force]), axis=0), axis=1)
        self._note("jump", jump > self._jump, t[-len(jump) :], jump)
        self._force_b = force[-1:]
        t_air, ground = stretch.t_air, stretch.ground
        at = np.minimum(np.round(t_air / dt).astype(int) - stretch.first + before, len(motion.epa) - 1)
        _, vel_n = earth_relative(motion.epa[at], motion.pos_i[at], motion.vel_i[at])
        speed = np.hypot(vel_n[:, 0], vel_n[:, 1])
        earlier = np.concatenate([self._ground if len(self._ground) else ground[:1], ground[:-1]])
        self._ground = ground[-1:]
        touches = self._landings & (ground[:, 2] > earlier[:, 2])
        hard = touches & (earlier[:, 1] > _HARD)  # by the sink rate before the touch
        self._note("hit", hard, t_air, earlier[hard, 1])
        scraped = (ground[:, 3] > 0) & (speed > _ROLLING)
        self._note("scrape", scraped, t_air, speed[scraped])
        under = ground[:, 0] < 0
        self._note("under", under, t_air, -ground[under, 0])
        infinite: BoolArray = np.any(~np.isfinite(np.hstack([stretch.air, ground])), axis=1)
        self._note("infinite", infinite, t_air, speed[infinite])

    def _note(self, kind: str, found: BoolArray, t: FloatArray, figure: FloatArray) -> None:
        if len(figure):
            self._least[kind] = min(self._least.get(kind, math.inf), float(figure.min()))
            self._most[kind] = max(self._most.get(kind, -math.inf), float(figure.max()))
        k = np.flatnonzero(found)
        if len(k):
            first, _, count = self._found.get(kind, (float(t[k[0]]), 0.0, 0))
            self._found[kind] = (first, float(t[k[-1]]), count + len(k))

    def rows(self) -> list[EventRow]:
        """Return an event for each kind of excess."""
        limits, of_class = self._limits, f"of the class {self._category}"
        words = {
            "load": f"load factor {{:.2f}} to {{:.2f}} is beyond {limits.load_low:g} to {limits.load_high:g} "
            f"{of_class} ({limits.source})",
            "rate": f"angular rate {{1:.0f}} deg/s is beyond {math.degrees(limits.rate):.0f} {of_class}",
            "jump": f"specific force jumps by {{1:.1f}} g in a step, beyond {self._jump:g} {of_class}",
            "hit": f"wheels hit the ground at {{1:.1f}} m/s, beyond {_HARD:.2f}",
            "scrape": "not only wheels touch the ground, at up to {1:.1f} m/s",
            "under": "the center of gravity is up to {1:.1f} m under the ground",
            "infinite": "air data or controls are not finite; they stand as 0",
        }
        rows = list[EventRow]()
        for kind, text in words.items():
            if kind in self._found:
                first, last, count = self._found[kind]
                said = text.format(self._least[kind], self._most[kind])
                rows.append((first, last, "sanity", f"{said}, {'once' if count == 1 else f'{count} times'}"))
        return rows
