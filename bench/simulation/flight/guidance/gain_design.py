"""Automatic gain design for the guidance of an aircraft: trim, linearize, place the poles of each loop.

The loops of `aircraft/systems/guidance.xml` are cascades, so each is placed by itself: roll rate, bank, pitch
rate, pitch, climb, airspeed, each a few times slower than the one inside it. What the aircraft can do (roll
damping, surface power, thrust) comes from differences of the model about its trimmed flight.
"""

from __future__ import annotations

import itertools
import math
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Any

from bench.core.mathematics.arrays import FloatArray
from bench.core.records.flight_specs import GLIDER, AircraftSpec, FlightSpec, Leg
from bench.core.words.exceptions import FlightError
from bench.simulation.flight.executive import load_aircraft
from bench.simulation.flight.jsbsim_units import FT, POUND
from bench.simulation.flight.legs.climbs import Climb, Descend
from bench.simulation.flight.legs.level import SpeedChange, Straight
from bench.simulation.flight.legs.turns import Turn
from bench.simulation.flight.model_files import count_engines, read_xml
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
_LEAN = 0.8  # mixture of the most power there, of a piston engine of JSBSim
_NOSE = 1.4  # frequency of the sideslip of a glider, held by the rudder [rad/s]
_TURNING = 30.0  # full circles last as long at least [s]
_NO_THRUST = 0.1  # what full throttle adds where the engines pull nothing [m/s^2]
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

    What has no engine is a glider.

    Raises
    ------
    FlightError
        If it does not load, or no airspeed can be guessed: no design changes that.
    """
    model = f"{aircraft.name}.xml"
    if not count_engines(read_xml(aircraft.folder / model, model)):
        aircraft = replace(aircraft, kind=GLIDER)
    stubs = find_stubs(aircraft)
    aircraft = set_properties(aircraft, {}, stubs)
    aircraft = set_properties(aircraft, _choose_properties(aircraft), stubs)
    fdm = load_aircraft(aircraft, _DT)
    if not fdm["metrics/Sw-sqft"] > 0:
        raise FlightError(f"aircraft {aircraft.name}: it has no wing area to guess an airspeed from")
    if not (fdm["metrics/bw-ft"] > 0 and fdm["metrics/cbarw-ft"] > 0):
        raise FlightError(f"aircraft {aircraft.name}: it has no wing span or chord")
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
    glides = aircraft.glides
    try:
        trim = trim_aircraft(fdm, condition, guided=False, glides=glides)
    except FlightError:
        if not glides and (added := _measure_thrust(fdm, condition)) < _NO_THRUST:
            reason = f"its engines do not pull: full throttle adds {added:.2f} m/s^2 at {speed:g} m/s"
            raise FlightError(f"aircraft {aircraft.name}: {reason}") from None
        raise
    found = _linearize(fdm, condition, trim, glides=glides)
    gains, climb = place_loops(found, condition.speed, trim, pace, glides=glides)
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
    manager = fdm.get_property_manager()
    chosen = {name: value for name, value in _STARTS.items() if manager.get_node(name)}
    if fdm["inertia/weight-lbs"] * POUND > _HEAVY:  # it flies high
        pistons = itertools.count() if manager.get_node("propulsion/engine/map-inhg") else iter(())
        numbered = (f"fcs/mixture-cmd-norm[{n}]" if n else "fcs/mixture-cmd-norm" for n in pistons)
        chosen |= dict.fromkeys(itertools.takewhile(manager.get_node, numbered), _LEAN)
    return chosen


def _measure_thrust(fdm: Any, condition: TrimCondition) -> float:
    """Return what full throttle adds to the forward acceleration [m/s^2]."""
    found = []
    for throttle in (0.0, 1.0):
        place(fdm, condition, 0.0, 0.0, 0.0, 0.0, 0.0, throttle)
        run_engines(fdm)
        found.append(float(present_accelerations(fdm)[0]))
    return found[1] - found[0]


def _linearize(fdm: Any, condition: TrimCondition, trim: Trim, *, glides: bool) -> dict[str, float]:
    """Differences about the trimmed flight, by name: control power, damping, stiffness, thrust."""

    def accelerations(
        aileron: float = 0.0,
        elevator: float = 0.0,
        rudder: float = 0.0,
        throttle: float = 0.0,
        alpha: float = 0.0,
        beta: float = 0.0,
        rates: tuple[float, float, float] = (0.0, 0.0, 0.0),
    ) -> FloatArray:
        a, e = trim.aileron + aileron, trim.elevator + elevator
        place(
            fdm,
            condition,
            trim.alpha + alpha,
            trim.beta + beta,
            trim.roll,
            a,
            e,
            trim.throttle + throttle,
            pitch=trim.pitch + alpha,
            rates_b=rates,
        )
        fdm["fcs/rudder-cmd-norm"] = rudder
        move_surfaces(fdm, a, e)
        if not glides:
            run_engines(fdm)
        return present_accelerations(fdm)

    still = accelerations()
    step, turn = 0.05, 0.05
    push = 0.1 if trim.throttle < 0.85 else -0.1
    last = {"thrust per throttle": float((accelerations(throttle=push) - still)[0] / push)}
    if glides:
        last = {
            "yaw per aileron": float((accelerations(aileron=step) - still)[5] / step),
            "yaw per sideslip": float((accelerations(beta=turn) - still)[5] / turn),
            "yaw damping": float((accelerations(rates=(0.0, 0.0, turn)) - still)[5] / turn),
        }
    return {
        "roll per aileron": float((accelerations(aileron=step) - still)[3] / step),
        "pitch per elevator": float((accelerations(elevator=step) - still)[4] / step),
        "yaw per rudder": float((accelerations(rudder=step) - still)[5] / step),
        "roll damping": float((accelerations(rates=(turn, 0.0, 0.0)) - still)[3] / turn),
        "pitch damping": float((accelerations(rates=(0.0, turn, 0.0)) - still)[4] / turn),
        "pitch stiffness": float((accelerations(alpha=0.01) - still)[4] / 0.01),
        **last,
        "dynamic pressure": float(fdm["aero/qbar-psf"]),
    }


def place_loops(
    found: Mapping[str, float], speed: float, trim: Trim, pace: float, *, glides: bool = False
) -> tuple[dict[str, float], float]:
    """Return gains of guidance, and the vertical speed that thrust allows [m/s].

    A glider's airspeed follows its pitch as V' = -g theta, whatever its size. Its rudder takes the yaw of the
    ailerons away, and makes its nose follow the air, well damped at 1.4 rad/s.
    """
    aileron, damping = max(abs(found["roll per aileron"]), 0.05), found["roll damping"]
    elevator, stiffness = max(abs(found["pitch per elevator"]), 0.05), -found["pitch stiffness"]
    thrust, rudder = max(found.get("thrust per throttle", 0.0), 0.2), max(abs(found["yaw per rudder"]), 0.1)
    roll = min(max(1.2 * abs(damping), 2.0), 6.0)
    roll_gain = max(roll + damping, 0.3) / aileron
    damped = aileron * roll_gain - damping  # the damping of the closed loop [1/s]
    pitch = max(1.5, min(3.0, 1.2 * math.sqrt(max(stiffness, 0.3))))
    pitch_gain = max(pitch + found["pitch damping"], 0.4 * pitch) / elevator
    usual = speed / (_G * _TURNS_BACK)
    climb = max(1.5, min(8.0, 0.5 * thrust * speed / _G * (1 - trim.throttle)))
    held = {
        "altitude-gain": 0.1 * pace,
        "climb-gain": 0.7 * pace,
        "climb-integral-gain": 0.08 * pace,
        "underspeed-gain": 0.3,
        "underspeed-margin-mps": 0.08 * speed,
        "elevator-turn-gain": 0.0,
        "throttle-turn-gain": 0.0,
        "speed-gain": 0.15 / thrust,
        "speed-integral-gain": 0.012 / thrust,
    }
    if glides:
        firm = max(2.5, 1.5 * math.sqrt(max(stiffness, 0.0)))  # beyond the stiffness [rad/s]
        pitch_gain = max(1.6 * firm + found["pitch damping"], 0.4 * firm) / elevator
        held = {
            "pitch-gain": firm**2 / (elevator * pitch_gain),
            "pitch-rate-gain": pitch_gain,
            "pitch-integral-gain": 0.1 * firm**3 / elevator,
            "glide-gain": 0.3 * pace / _G,
            "glide-integral-gain": 0.05 * pace / _G,
            "rudder-aileron-gain": max(-found["yaw per aileron"], 0.0) / rudder,
            "sideslip-gain": max(_NOSE**2 - found["yaw per sideslip"], 0.0) / rudder,
            "yaw-rate-gain": max(1.4 * _NOSE + found["yaw damping"], 0.4) / rudder,
        }
    return {
        "qbar-ref-psf": found["dynamic pressure"],
        "bank-lag-rad_sec": min(3.0, 0.5 * roll) * min(pace, 1.0),
        "heading-gain": min(2.5, max(min(0.7, 2 * usual), usual)) * pace,
        "bank-gain": 0.22 * damped * min(damped, 10.0) / (aileron * roll_gain),  # 0.25: the poles coincide
        "roll-rate-gain": roll_gain,
        "bank-rate-gain": roll_gain - damping / aileron,
        "bank-integral-gain": 0.1 * roll_gain,
        "yaw-rate-gain": 0.4 / rudder,
        "pitch-lag-rad_sec": 1.5,
        "pitch-gain": 0.5 * pitch,
        "pitch-rate-gain": pitch_gain,
        "pitch-integral-gain": 0.4 * pitch_gain * pitch,
        **held,
    }, climb


def acceptance_legs(design: GainDesign, *, glides: bool = False) -> tuple[Leg, ...]:
    """Return the legs of the acceptance flight: straight, full circles, up, down, faster, straight.

    A glider circles to the other side where others climb and descend.
    """
    rate = 0.6 * design.climb
    circle = 2 * math.pi * design.speed / (_G * math.tan(BANK))  # [s]
    circles = 2 * math.pi * math.ceil(_TURNING / circle)
    up_and_down: tuple[Leg, ...] = (Climb(design.alt + RISE, rate), Descend(design.alt, rate))
    return (
        Straight(30.0),
        Turn(by=circles, bank=BANK),
        Straight(20.0),
        *((Turn(by=-circles, bank=BANK), Straight(20.0)) if glides else up_and_down),
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
        legs=acceptance_legs(design, glides=aircraft.glides),
        duration=None,
    )


def attempts(*, glides: bool = False) -> Iterator[tuple[float, ...]]:
    """Yield lift coefficients, paces and holds of `design_gains` in the order they are tried."""
    if glides:
        yield from ((0.7, 1.0), (0.9, 1.0), (0.55, 1.0), (0.4, 1.0), (0.7, 0.6), (0.7, 1.0, 5.0))
        return
    yield from ((0.4, 1.0), (0.3, 1.0), (0.55, 1.0), (0.3, 0.6), (0.2, 1.0), (0.15, 1.0), (0.3, 1.0, 5.0))
