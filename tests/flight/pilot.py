"""What a pilot would look at in a flight: bank, load, speed, sideslip, surfaces at their stops, height."""

from __future__ import annotations

from math import degrees, radians
from typing import Any, NamedTuple

import numpy as np

from bench.core.mathematics import rotation
from bench.core.mathematics.units import STANDARD_GRAVITY
from bench.core.records.data import Trajectory
from bench.core.records.flight_specs import FlightSpec
from bench.simulation.flight.sanity import LIMITS
from bench.simulation.signals.terrain import ground_at

STOP = 0.999  # of the travel of a surface


class Pilot(NamedTuple):
    """Figures of the part of a flight in which it is in the air; NaN where there is none."""

    bank: float  # most, either side [deg]
    load: tuple[float, float]  # least and most specific force along -z of the body [g]
    speed: tuple[float, float]  # least and most true airspeed [m/s]
    slip: float  # most, either side [deg]; NaN of a multirotor, which flies sideways
    stopped: float  # time in which aileron, elevator or rudder is at its stop [%]
    height: float  # least above the ground between take-off and approach [m]

    def cells(self) -> list[str]:
        """Return the cells of its row."""

        def shown(value: float, form: str) -> str:
            return "-" if np.isnan(value) else format(value, form)

        def span(pair: tuple[float, float], form: str) -> str:
            return "-" if np.isnan(pair[0]) else f"{pair[0]:{form}} to {pair[1]:{form}}"

        return [
            shown(self.bank, ".0f"),
            span(self.load, ".2f"),
            span(self.speed, ".0f"),
            shown(self.slip, ".1f"),
            shown(self.stopped, ".1f"),
            shown(self.height, ".0f"),
        ]


def look_at(spec: FlightSpec, truth: Trajectory) -> Pilot:
    """Measure a flight."""
    ground = spec.ground_alt if spec.terrain is None else ground_at(spec.terrain, *truth.lla[:, :2].T)
    height = truth.lla[:, 2] - ground
    flies = height > (spec.aircraft.rest_height or 0.0) + 1.0
    if not flies.any():
        return Pilot(*(np.nan,), (np.nan, np.nan), (np.nan, np.nan), np.nan, np.nan, np.nan)
    between = flies.copy()
    for leg, (begin, end, _) in zip(spec.legs, truth.events.select("leg"), strict=True):
        if leg.needs != "air" or leg.leaves != "air":
            between &= (truth.t < begin) | (truth.t > end)
    air, controls = truth.air, truth.controls
    slow = np.interp(air.t, truth.t, flies.astype(float)) > 0.5
    surfaces = np.abs([controls.aileron, controls.elevator, controls.rudder])[:, slow]
    load = -truth.dvel_b[:, 2] / np.diff(truth.t) / STANDARD_GRAVITY
    load, speed, hovers = load[flies[1:]], air.airspeed_true[slow], spec.aircraft.hovers
    bank = np.degrees(np.abs(rotation.to_euler(truth.q_nb)[0]))[flies].max()
    return Pilot(
        float(bank),
        (float(load.min()), float(load.max())),
        (float(speed.min()), float(speed.max())),
        np.nan if hovers else float(np.degrees(np.abs(air.beta[slow]).max())),
        np.nan if hovers else float(100.0 * (surfaces > STOP).any(axis=0).mean()),
        float(height[between].min()) if between.any() else np.nan,
    )


def asked_bank(spec: FlightSpec) -> float:
    """Return the largest bank that the legs of a flight ask for [deg]; 30 deg if an approach has none."""
    asked: list[Any] = [getattr(leg, "bank", None) for leg in spec.legs]
    asked += [
        radians(30.0)
        for leg, bank in zip(spec.legs, asked, strict=True)
        if leg.kind == "approach" and not bank
    ]
    return degrees(max((bank for bank in asked if bank), default=0.0))


def find_excess(spec: FlightSpec, pilot: Pilot) -> list[str]:
    """Return what is beyond the limits of a flight with wings, a line each; nothing of what never flies.

    The bank is the one asked for within 3 deg in smooth air, 8 deg in rough air. A thermal carries a circle
    off; back to it the guidance banks up to the limit of the aircraft. Loads are within those of the class,
    airspeeds within a tenth of the aircraft's limits. Aerobatics have wider limits.
    """
    craft, load = spec.aircraft, LIMITS[spec.aircraft.category]
    if np.isnan(pilot.bank) or craft.hovers:
        return []
    smooth = spec.severity == 0 and not spec.gusts
    spare, slip, stopped = (3.0, 5.0, 0.5) if smooth else (8.0, 10.0, 2.0)
    asked = degrees(craft.max_bank) if spec.thermals else asked_bank(spec)
    gentle = not any(leg.any_bank for leg in spec.legs)
    slow, fast = 0.9 * craft.min_speed, (1.1 if gentle else 1.3) * craft.max_speed
    limits = {
        "bank": (pilot.bank, 0.0, asked + spare if gentle else 180.0),
        "least load": (pilot.load[0], load.load_low, load.load_high),
        "most load": (pilot.load[1], load.load_low, load.load_high),
        "least airspeed": (pilot.speed[0], slow, fast),
        "most airspeed": (pilot.speed[1], slow, fast),
        "sideslip": (pilot.slip, 0.0, slip if gentle else 30.0),
        "at a stop": (pilot.stopped, 0.0, stopped if gentle else 5.0),
        "height": (pilot.height, 50.0, np.inf),
    }
    return [
        f"{name}: {value:.3g} is outside {low:.3g} to {high:.3g}"
        for name, (value, low, high) in limits.items()
        if value < low or value > high
    ]
