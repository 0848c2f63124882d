"""Automatic gain design for the guidance of an aircraft: trim, linearize, place the poles of each loop.

The loops of `aircraft/systems/guidance.xml` are cascades, so each is placed by itself: roll rate, bank, pitch
rate, pitch, climb, airspeed, each a few times slower than the one inside it. What the aircraft can do (roll
damping, surface power, thrust) comes from differences of the model about its trimmed flight.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Any

from bench.core.mathematics.arrays import FloatArray
from bench.core.records.flight_specs import AircraftSpec, FlightSpec, Leg
from bench.core.words.exceptions import FlightError
from bench.simulation.flight.executive import find_property, load_aircraft
from bench.simulation.flight.jsbsim_units import FT, POUND
from bench.simulation.flight.legs.climbs import Climb, Descend
from bench.simulation.flight.legs.level import SpeedChange, Straight
from bench.simulation.flight.legs.turns import Turn
from bench.simulation.flight.trimming import (
    Trim,
    TrimCondition,
    move_surfaces,
    place,
    present_accelerations,
    run_engines,
    trim_aircraft,
)

_DT = 0.0025
_HEAVY = 6000.0  # [kg]
_TURNS_BACK = 7.0  # time constant of the heading loop, which is airspeed over gravity and its gain [s]
_ALTS = (1200.0, 3000.0)  # light, heavy [m]
_DENSITIES = (1.09, 0.91)  # there [kg/m^3]
_MISSING = re.compile(r"The property (\S+) does not exist")  # as JSBSim says it
_MOST_STUBS = 20
_SQUARE_FOOT, _G = 0.09290304, 9.81
BANK, RISE, FASTER = math.radians(20.0), 150.0, 1.06
"""Of the flight that a design is accepted by: bank of its circle [rad], climb [m], change of airspeed [1]."""

_STARTS = {  # of engines, and a clean aircraft; those that a model has are set
    "fcs/mixture-cmd-norm": 1.0,
    "propulsion/magneto_cmd": 3.0,
    "propulsion/cutoff_cmd": 0.0,
    "gear/gear-cmd-norm": 0.0,
    "fcs/flap-cmd-norm": 0.0,
}


@dataclass(frozen=True, slots=True)
class GainDesign:
    """Result of the gain design for an aircraft."""

    alt: float  # ellipsoidal [m]
    speed: float  # true airspeed [m/s]
    climb: float  # vertical speed it is given, up and down [m/s]
    mass: float  # [kg]
    span: float  # [m]
    trim: Trim
    gains: Mapping[str, float]
    derivatives: Mapping[str, float]  # per unit of command, rad/s or rad


def prepare_aircraft(aircraft: AircraftSpec) -> AircraftSpec:
    """Return a foreign aircraft with its initial properties, and 0 for properties that it lacks.

    Raises
    ------
    FlightError
        If it does not load, or no airspeed can be guessed: no design changes that.
    """
    stubs = find_stubs(aircraft)
    aircraft = set_properties(aircraft, {}, stubs)
    aircraft = set_properties(aircraft, _choose_properties(aircraft), stubs)
    if not load_aircraft(aircraft, _DT)["metrics/Sw-sqft"] > 0:
        raise FlightError(f"aircraft {aircraft.name}: it has no wing area to guess an airspeed from")
    return aircraft


def design_gains(aircraft: AircraftSpec, lift: float, pace: float, hold: float = 1.0) -> GainDesign:
    """Trim a foreign aircraft at a lift coefficient, and compute the gains of its control loops.

    Parameters
    ----------
    aircraft : AircraftSpec
        It as it was prepared.
    lift : float
        Lift coefficient over its wing area that the airspeed is chosen for.
    pace : float
        How fast the outer loops are, 1 usual.
    hold : float
        How fast a bank that stays off is taken back, 1 usual; a turn may roll the aircraft as it yaws.

    Raises
    ------
    FlightError
        If no steady flight is found.
    """
    fdm = load_aircraft(aircraft, _DT)
    mass = fdm["inertia/weight-lbs"] * POUND
    span = fdm["metrics/bw-ft"] * FT
    heavy = mass > _HEAVY
    alt, density = _ALTS[heavy], _DENSITIES[heavy]
    area = fdm["metrics/Sw-sqft"] * _SQUARE_FOOT
    speed = round(math.sqrt(2 * mass * _G / (density * area * lift)), 0)
    condition = TrimCondition(math.radians(47.0), math.radians(11.0), alt, 0.5, speed)
    trim = trim_aircraft(fdm, condition, guided=False)
    found = _linearize(fdm, condition, trim)
    gains, climb = place_loops(found, condition.speed, trim, pace)
    gains["bank-integral-gain"] *= hold
    return GainDesign(alt, condition.speed, climb, mass, span, trim, gains, found)


def set_properties(
    aircraft: AircraftSpec, properties: Mapping[str, float], stubs: tuple[str, ...]
) -> AircraftSpec:
    """Return a foreign aircraft with properties that are set and others that are declared."""
    assert aircraft.foreign is not None
    return replace(aircraft, foreign=replace(aircraft.foreign, properties=properties, stubs=stubs))


def find_stubs(aircraft: AircraftSpec) -> tuple[str, ...]:
    """Return the properties that the model reads but does not define, found one per load; 0 replaces them."""
    stubs: tuple[str, ...] = ()
    while True:
        try:
            load_aircraft(set_properties(aircraft, {}, stubs), _DT)
        except FlightError as error:
            missing = _MISSING.search(str(error))
            if missing is None or missing[1] in stubs or len(stubs) == _MOST_STUBS:
                raise
            stubs = (*stubs, missing[1])
        else:
            return stubs


def _choose_properties(aircraft: AircraftSpec) -> dict[str, float]:
    fdm = load_aircraft(aircraft, _DT)
    chosen = {}
    for name, value in _STARTS.items():
        try:
            find_property(fdm, name)
        except FlightError:
            continue
        chosen[name] = value
    return chosen


def _linearize(fdm: Any, condition: TrimCondition, trim: Trim) -> dict[str, float]:
    """Differences about the trimmed flight, by name: control power, damping, stiffness, thrust."""

    def accelerations(
        aileron: float = 0.0,
        elevator: float = 0.0,
        rudder: float = 0.0,
        throttle: float = 0.0,
        alpha: float = 0.0,
        rates: tuple[float, float, float] = (0.0, 0.0, 0.0),
    ) -> FloatArray:
        a, e = trim.aileron + aileron, trim.elevator + elevator
        place(
            fdm,
            condition,
            trim.alpha + alpha,
            trim.beta,
            trim.roll,
            a,
            e,
            trim.throttle + throttle,
            pitch=trim.pitch + alpha,
            rates_b=rates,
        )
        fdm["fcs/rudder-cmd-norm"] = rudder
        move_surfaces(fdm, a, e)
        run_engines(fdm)
        return present_accelerations(fdm)

    still = accelerations()
    step, turn = 0.05, 0.05
    push = 0.1 if trim.throttle < 0.85 else -0.1
    return {
        "roll per aileron": float((accelerations(aileron=step) - still)[3] / step),
        "pitch per elevator": float((accelerations(elevator=step) - still)[4] / step),
        "yaw per rudder": float((accelerations(rudder=step) - still)[5] / step),
        "roll damping": float((accelerations(rates=(turn, 0.0, 0.0)) - still)[3] / turn),
        "pitch damping": float((accelerations(rates=(0.0, turn, 0.0)) - still)[4] / turn),
        "pitch stiffness": float((accelerations(alpha=0.01) - still)[4] / 0.01),
        "thrust per throttle": float((accelerations(throttle=push) - still)[0] / push),
        "dynamic pressure": float(fdm["aero/qbar-psf"]),
    }


def place_loops(
    found: Mapping[str, float], speed: float, trim: Trim, pace: float
) -> tuple[dict[str, float], float]:
    """Return gains of guidance, and the vertical speed that thrust allows [m/s]."""
    aileron, damping = max(abs(found["roll per aileron"]), 0.05), found["roll damping"]
    elevator, stiffness = max(abs(found["pitch per elevator"]), 0.05), -found["pitch stiffness"]
    thrust = max(found["thrust per throttle"], 0.2)
    roll = min(max(1.2 * abs(damping), 2.0), 6.0)
    roll_gain = max(roll + damping, 0.3) / aileron
    pitch = max(1.5, min(3.0, 1.2 * math.sqrt(max(stiffness, 0.3))))
    pitch_gain = max(pitch + found["pitch damping"], 0.4 * pitch) / elevator
    climb = max(1.5, min(8.0, 0.5 * thrust * speed / _G * (1 - trim.throttle)))
    return {
        "qbar-ref-psf": found["dynamic pressure"],
        "bank-lag-rad_sec": min(3.0, 0.5 * roll) * min(pace, 1.0),
        "heading-gain": min(2.5, max(0.7, speed / (_G * _TURNS_BACK))) * pace,
        "bank-gain": 0.22 * roll**2 / (aileron * roll_gain),  # 0.25: the poles of bank coincide
        "roll-rate-gain": roll_gain,
        "bank-rate-gain": roll_gain - damping / aileron,
        "bank-integral-gain": 0.1 * roll_gain,
        "yaw-rate-gain": 0.4 / max(abs(found["yaw per rudder"]), 0.1),
        "pitch-lag-rad_sec": 1.5,
        "pitch-gain": 0.5 * pitch,
        "pitch-rate-gain": pitch_gain,
        "pitch-integral-gain": 0.4 * pitch_gain * pitch,
        "altitude-gain": 0.1 * pace,
        "climb-gain": 0.7 * pace,
        "climb-integral-gain": 0.08 * pace,
        "underspeed-gain": 0.3,
        "underspeed-margin-mps": 0.08 * speed,
        "elevator-turn-gain": 0.0,
        "throttle-turn-gain": 0.0,
        "speed-gain": 0.15 / thrust,
        "speed-integral-gain": 0.012 / thrust,
    }, climb


def acceptance_legs(design: GainDesign) -> tuple[Leg, ...]:
    """Return the legs of the acceptance flight: straight, a full circle, up, down, faster, straight."""
    rate = 0.6 * design.climb
    return (
        Straight(30.0),
        Turn(by=2 * math.pi, bank=BANK),
        Straight(20.0),
        Climb(design.alt + RISE, rate),
        Descend(design.alt, rate),
        SpeedChange(FASTER * design.speed),
        Straight(30.0),
    )


def plan_acceptance(aircraft: AircraftSpec, design: GainDesign) -> FlightSpec:
    """Return the acceptance flight of a design, in calm air."""
    return FlightSpec(
        aircraft=aircraft,
        rate=100.0,
        lat=math.radians(47.0),
        lon=math.radians(11.0),
        alt=design.alt,
        heading=math.radians(30.0),
        speed=design.speed,
        wind_from=0.0,
        wind_speed=0.0,
        severity=0,
        turbulence_seed=0,
        legs=acceptance_legs(design),
        duration=None,
    )


def attempts() -> Iterator[tuple[float, ...]]:
    """Yield lift coefficients, paces and holds of `design_gains` in the order they are tried."""
    yield from ((0.4, 1.0), (0.3, 1.0), (0.55, 1.0), (0.3, 0.6), (0.2, 1.0), (0.15, 1.0), (0.3, 1.0, 5.0))
