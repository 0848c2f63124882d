"""Legs of a flight into set-points of the guidance system, at 20 Hz on sample instants.

Each leg is a generator: it writes set-points, yields once per instant, returns when
it is flown, and may return in words how it went. Set-points begin and end smoothly,
because a step between samples would put a corner into the truth that no sensor
record can follow.
"""

from __future__ import annotations

import math
from collections.abc import Generator, Iterator
from dataclasses import dataclass
from typing import Any

from bench.errors import FlightError
from bench.flight import legs_air, legs_ground, legs_path, legs_surface
from bench.flight.cockpit import SURFACES, Cockpit
from bench.flight.model import Trim
from bench.flight.shaping import GUIDANCE_RATE, wait
from bench.flight.wind import Weather
from bench.legs import (
    AileronRoll,
    Approach,
    Climb,
    Configuration,
    Cruise,
    Descend,
    Doublet,
    FigureEight,
    Flare,
    Holding,
    LandingRoll,
    Leg,
    SpeedChange,
    Static,
    Straight,
    STurns,
    Survey,
    TakeOff,
    Turn,
    Waypoints,
    WindUpTurn,
)
from bench.specs import FlightSpec

__all__ = ["Cockpit", "FlownLeg", "describe", "engage", "fly_legs"]

_UPSET = math.radians(100.0)  # bank guidance is not expected to come back from [rad]
_LOW = 3.0  # the flight ends above the ground by less [m]
_TIPPED = math.radians(30.0)  # bank on the ground with a wing in it [rad]


@dataclass(frozen=True, slots=True)
class FlownLeg:
    """A leg as flown."""

    start: float  # [s]
    end: float  # [s]
    text: str


def engage(fdm: Any, spec: FlightSpec, trimmed: Trim) -> Cockpit:
    """Switch guidance on in the trimmed and settled flight, without a jump of any command.

    On the ground only its trim is set: brakes are on and the surfaces centred until the take-off.
    """
    fdm["guidance/aileron-trim-norm"] = trimmed.aileron
    fdm["guidance/elevator-trim-norm"] = trimmed.elevator
    fdm["guidance/throttle-trim-norm"] = trimmed.throttle
    fdm["guidance/bank-trim-rad"] = trimmed.roll
    fdm["guidance/pitch-trim-rad"] = trimmed.pitch
    cockpit = Cockpit(fdm, spec.aircraft, spec.runway)
    if spec.on_ground:
        cockpit.brake(1.0)
        for surface in SURFACES:
            cockpit.direct_share[surface](1.0)
        return cockpit
    cockpit.set_speed(spec.speed)
    cockpit.speed_wanted = spec.speed
    cockpit.thr_mode(1)
    cockpit.set_heading(cockpit.course)
    cockpit.lat_mode(2)
    cockpit.hold_alt(spec.alt)
    return cockpit


def fly_legs(
    cockpit: Cockpit, spec: FlightSpec, flown: list[FlownLeg], weather: Weather | None = None
) -> Iterator[float]:
    """Fly the legs in order; yields the start of each interval, and appends each leg when it ends.

    With a duration the last leg is held to it. Legs that need longer are flown to
    their end all the same, to say how long they need.

    Raises
    ------
    FlightError
        Which leg failed, when and why.
    """
    begun = tick = 0
    end = 0 if spec.duration is None else round(spec.duration * GUIDANCE_RATE)

    def instant(leg: Leg) -> float:
        _watch(cockpit, leg)
        cockpit.tick()
        if weather is not None:
            weather.blow(tick / GUIDANCE_RATE, cockpit.alt())
        return tick / GUIDANCE_RATE

    for number, leg in enumerate(spec.legs, 1):
        text = describe(number, leg)
        try:
            speed = getattr(leg, "speed", None)
            if speed is not None and not isinstance(leg, TakeOff):
                cockpit.change_speed(speed)
            steps = _steps(cockpit, leg)
            while True:
                try:
                    next(steps)
                except StopIteration as stopped:
                    outcome: str | None = stopped.value
                    break
                yield instant(leg)
                tick += 1
            if number == len(spec.legs) and tick < end:
                text += f", then held to {end / GUIDANCE_RATE:g} s"
            while number == len(spec.legs) and tick < end:
                yield instant(leg)
                tick += 1
        except FlightError as error:
            raise FlightError(f"leg {text}: at {tick / GUIDANCE_RATE:.1f} s: {error}") from None
        flown.append(
            FlownLeg(begun / GUIDANCE_RATE, tick / GUIDANCE_RATE, f"{text}; {outcome}" if outcome else text)
        )
        begun = tick
    if spec.duration is not None and tick > end:
        raise FlightError(f"the legs need {tick / GUIDANCE_RATE:g} s; duration is {spec.duration:g} s")


def describe(number: int, leg: Leg) -> str:
    """Return a leg in words.

    Examples
    --------
    >>> describe(2, Turn(by=math.pi, bank=math.radians(30.0)))
    '2 turn: 180 deg right, bank 30 deg'
    """
    kind, what = _words(leg)
    speed = getattr(leg, "speed", None)
    if speed is not None and not isinstance(leg, SpeedChange):
        what += f", {speed:g} m/s"
    return f"{number} {kind}: {what}" if what else f"{number} {kind}"


def _deg(angle: float) -> str:
    return f"{math.degrees(angle):.4g} deg"


def _side(value: float) -> str:
    return "right" if value > 0 else "left"


def _count(n: int, what: str) -> str:
    return f"{n} {what}" if n == 1 else f"{n} {what}s"


def _words(leg: Leg) -> tuple[str, str]:
    """Return the kind of a leg, and its figures."""
    match leg:
        case Straight():
            return "straight", f"{leg.duration:g} s"
        case Cruise():
            return "cruise", f"{leg.distance:g} m"
        case SpeedChange():
            return "speed", f"to {leg.speed:g} m/s"
        case Climb():
            return "climb", f"to {leg.to_alt:g} m at {leg.rate:g} m/s"
        case Descend():
            return "descend", f"to {leg.to_alt:g} m at {leg.rate:g} m/s"
        case Turn():
            return "turn", f"{_turn_words(leg)}"
        case FigureEight():
            return "figure-eight", f"{_count(leg.laps, 'lap')}, bank {_deg(leg.bank)}"
        case STurns():
            return "s-turns", f"{leg.count} of {_deg(leg.by)} either side, bank {_deg(leg.bank)}"
        case Waypoints():
            return "waypoints", f"{_count(len(leg.points), 'point')}, bank {_deg(leg.bank)}"
        case Survey():
            strips = f"{_count(leg.strips, 'strip')} of {leg.length:g} m, {leg.spacing:g} m apart"
            return "survey", f"{strips} to the {_side(leg.side)}, bank {_deg(leg.bank)}"
        case Holding():
            laps = f"{_count(leg.laps, 'lap')} {_side(leg.side)}, {leg.leg_time:g} s straights"
            return "holding", f"{laps}, bank {_deg(leg.bank)}"
        case Static():
            return "static", f"{leg.duration:g} s"
        case TakeOff():
            return "take-off", f"to {leg.to_height:g} m above the runway at {leg.rate:g} m/s"
        case Approach():
            return "approach", f"glide path {_deg(leg.glide)}"
        case Flare():
            return "flare", ""
        case LandingRoll():
            return "landing-roll", ""
        case Doublet():
            deflected = f"{leg.surface} {leg.amplitude:+.3g}, {leg.width:g} s each way"
            return "doublet", f"{leg.count} of {deflected}"
        case AileronRoll():
            return "aileron-roll", f"{leg.count} {_side(leg.aileron)}, aileron {abs(leg.aileron):.3g}"
        case WindUpTurn():
            return "wind-up-turn", f"{_side(leg.bank)} to {leg.load:g} g at {_deg(abs(leg.bank))} bank"
        case Configuration():
            moved = [] if leg.flaps is None else [f"flaps {leg.flaps:g}"]
            moved += [] if leg.gear is None else [f"gear {'down' if leg.gear else 'up'}"]
            return "configuration", ", ".join(moved)


def _turn_words(leg: Turn) -> str:
    if leg.by is not None:
        where = f"{_deg(abs(leg.by))} {_side(leg.by)}"
    else:
        assert leg.heading is not None
        where = f"to {_deg(leg.heading)}" + (f" {_side(leg.side)}" if leg.side else "")
    if leg.bank is not None:
        return f"{where}, bank {_deg(leg.bank)}"
    assert leg.rate is not None
    return f"{where}, {_deg(leg.rate)}/s"


def _steps(cockpit: Cockpit, leg: Leg) -> Generator[None, None, str | None] | Iterator[None]:
    match leg:
        case Straight():
            return wait(leg.duration)
        case Cruise():
            return legs_air.cruise(cockpit, leg)
        case SpeedChange():
            return legs_air.settle_speed(cockpit, leg.speed)
        case Climb():
            return legs_air.to_alt(cockpit, leg.to_alt, leg.rate)
        case Descend():
            return legs_air.to_alt(cockpit, leg.to_alt, -leg.rate)
        case Turn():
            return legs_air.turn(cockpit, leg)
        case FigureEight():
            return legs_air.figure_eight(cockpit, leg)
        case STurns():
            return legs_air.s_turns(cockpit, leg)
        case Waypoints():
            return legs_path.waypoints(cockpit, leg)
        case Survey():
            return legs_path.survey(cockpit, leg)
        case Holding():
            return legs_path.holding(cockpit, leg)
        case Static():
            return legs_ground.static(cockpit, leg)
        case TakeOff():
            return legs_ground.take_off(cockpit, leg)
        case Approach():
            return legs_ground.approach(cockpit, leg)
        case Flare():
            return legs_ground.flare(cockpit)
        case LandingRoll():
            return legs_ground.landing_roll(cockpit, leg)
        case Doublet():
            return legs_surface.doublet(cockpit, leg)
        case AileronRoll():
            return legs_surface.aileron_roll(cockpit, leg)
        case WindUpTurn():
            return legs_surface.wind_up_turn(cockpit, leg)
        case Configuration():
            return legs_air.configure(cockpit, leg)


def _watch(cockpit: Cockpit, leg: Leg) -> None:
    """Raise FlightError when the flight has left the air or what guidance is tuned for."""
    speed, agl, roll = cockpit.speed(), cockpit.alt_agl(), cockpit.roll()
    low, high = 0.25 * cockpit.aircraft.min_speed, 2.0 * cockpit.aircraft.max_speed
    on_runway = isinstance(leg, Static | TakeOff | Flare | LandingRoll)
    if not (math.isfinite(speed) and math.isfinite(agl) and math.isfinite(roll)):
        raise FlightError("the motion is no longer finite")
    if agl < _LOW and not on_runway:
        raise FlightError(f"flew into the ground: {cockpit.state()}")
    if agl < _LOW and abs(roll) > _TIPPED:
        raise FlightError(f"a wing hit the ground at a bank of {math.degrees(roll):.0f} deg")
    if speed > high or (speed < low and not on_runway):
        raise FlightError(f"outside the envelope: airspeed {speed:.1f} m/s is not in {low:.1f} to {high:.1f}")
    if abs(roll) > _UPSET and not isinstance(leg, AileronRoll):
        raise FlightError(f"outside the envelope: upset to a bank of {math.degrees(roll):.0f} deg")
