"""Flight plans for tests: the Aerosonde with the shipped gains, one leg list at a time; what was flown."""

from __future__ import annotations

from dataclasses import replace
from math import inf, radians
from typing import Any

import numpy as np

from bench.core.mathematics import rotation
from bench.core.records.data import Trajectory
from bench.core.records.flight_specs import FlightSpec, Leg, ScriptSpec
from bench.io.config import read_profile
from bench.simulation.flight.legs.climbs import Climb
from bench.simulation.flight.legs.level import Straight
from bench.simulation.flight.legs.turns import Turn
from bench.simulation.flight.recorder import fly_pieces, record_plan
from bench.simulation.flight.truth import Stretch, make_truth

FIGURE_EIGHT: FlightSpec = read_profile("figure-eight").flight
AEROSONDE = FIGURE_EIGHT.aircraft
CALM = replace(
    FIGURE_EIGHT,
    lat=radians(47.26),
    lon=radians(11.34),
    alt=1200.0,
    heading=radians(85.0),
    speed=25.0,
    rate=100.0,
    wind_from=0.0,
    wind_speed=0.0,
    severity=0,
    turbulence_seed=1,
    duration=None,
)


def plan(*legs: Leg, **changes: Any) -> FlightSpec:
    """Legs from 47.26 N 11.34 E, 1200 m, heading 85 deg at 25 m/s in calm air, unless changed."""
    return replace(CALM, legs=legs, **changes)


def short_plan() -> FlightSpec:
    """A minute at 100 Hz in a west wind of 5 m/s: straight, a 120 deg right turn, a climb, straight."""
    legs = (Straight(10.0), Turn(radians(120.0), radians(30.0)), Climb(1220.0, 2.0), Straight(5.0))
    return plan(*legs, wind_from=radians(270.0), wind_speed=5.0, duration=60.0)


def record_whole(spec: FlightSpec) -> Stretch:
    """Fly a plan, recorded as one segment."""
    (stretch,) = record_plan(spec, seconds=inf)
    return stretch


def fly_here(spec: FlightSpec | ScriptSpec) -> Trajectory:
    """Fly in this process what others wrote, too, for which `fly` starts one."""
    (truth,) = fly_pieces(spec, seconds=inf)
    return truth


def truth_of(stretch: Stretch, rate: float) -> Trajectory:
    (truth,) = make_truth([stretch], rate)
    return truth


def turned(truth: Trajectory) -> np.ndarray:
    """Heading since the start, not wrapped [deg]."""
    return np.rad2deg(np.unwrap(rotation.to_euler(truth.q_nb)[2]))


def roll(truth: Trajectory) -> np.ndarray:
    return np.rad2deg(rotation.to_euler(truth.q_nb)[0])
