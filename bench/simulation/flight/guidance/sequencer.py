"""Conversion of legs to set-points of the guidance system, at 20 Hz on sample epochs.

Each leg is a generator: it writes set-points, yields once per time, returns when
it is flown, and may return in words how it went. Set-points begin and end smoothly,
because a step between samples would put a corner into the truth that no sensor
record can follow.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

from bench.core.records.flight_specs import FlightSpec, Leg
from bench.core.words.exceptions import FlightError
from bench.simulation.flight.cockpit import SURFACES, Cockpit
from bench.simulation.flight.guidance.belief import Belief
from bench.simulation.flight.guidance.shaping import GUIDANCE_RATE
from bench.simulation.flight.legs.keys import AtSpeed
from bench.simulation.flight.rotor_cockpit import RotorCockpit
from bench.simulation.flight.trimming import Trim
from bench.simulation.flight.turbulence.wind import Weather

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


def engage(fdm: Any, spec: FlightSpec, trimmed: Trim, belief: Belief | None = None) -> Cockpit:
    """Switch guidance on in the trimmed and settled flight, without a jump of any command.

    On the ground only its trim is set: brakes are on and the surfaces centered until the take-off.
    """
    fdm["guidance/aileron-trim-norm"] = trimmed.aileron
    fdm["guidance/elevator-trim-norm"] = trimmed.elevator
    fdm["guidance/throttle-trim-norm"] = trimmed.throttle
    fdm["guidance/bank-trim-rad"] = trimmed.roll
    fdm["guidance/pitch-trim-rad"] = trimmed.pitch
    if belief is not None:
        belief.board(fdm, spec.aircraft.imu_b)
    cockpit = Cockpit(fdm, spec, belief)
    if spec.on_ground:
        cockpit.brake(1.0)
        for surface in SURFACES:
            cockpit.direct_share[surface](1.0)
        return cockpit
    cockpit.set_speed(spec.speed)
    cockpit.speed_wanted = spec.speed
    cockpit.thr_mode(0 if spec.aircraft.glides else 1)
    cockpit.set_heading(cockpit.course)
    cockpit.lat_mode(2)
    cockpit.hold_alt(spec.alt)
    return cockpit


def fly_legs(
    cockpit: Cockpit | RotorCockpit, spec: FlightSpec, flown: list[FlownLeg], weather: Weather | None = None
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
        cockpit.move_ground()
        _watch(cockpit, leg)
        cockpit.tick()
        if weather is not None:
            weather.blow(tick / GUIDANCE_RATE, cockpit.true_alt())
        return tick / GUIDANCE_RATE

    for number, leg in enumerate(spec.legs, 1):
        text = describe(number, leg)
        try:
            if isinstance(leg, AtSpeed) and leg.speed is not None:
                cockpit.change_speed(leg.speed)
            steps = leg.fly(cockpit)
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
            flown.append(
                FlownLeg(begun / GUIDANCE_RATE, tick / GUIDANCE_RATE, f"{text}; not flown to its end")
            )
            raise FlightError(f"leg {text}: at {tick / GUIDANCE_RATE:.1f} s: {error}") from None
        flown.append(
            FlownLeg(begun / GUIDANCE_RATE, tick / GUIDANCE_RATE, f"{text}; {outcome}" if outcome else text)
        )
        begun = tick
    if spec.duration is not None and tick > end:
        raise FlightError(f"the legs need {tick / GUIDANCE_RATE:g} s; duration is {spec.duration:g} s")


def describe(number: int, leg: Leg) -> str:
    """Return a leg in words: ``2 turn: 180 deg right, bank 30 deg``."""
    what = leg.describe()
    if isinstance(leg, AtSpeed) and leg.speed is not None:
        what += f", {leg.speed:g} m/s"
    return f"{number} {leg.kind}: {what}" if what else f"{number} {leg.kind}"


def _watch(cockpit: Cockpit | RotorCockpit, leg: Leg) -> None:
    """Raise FlightError if the aircraft has hit the ground or left the envelope of the guidance."""
    if isinstance(cockpit, RotorCockpit):
        cockpit.watch(may_touch=leg.needs != "air" or leg.leaves != "air")
        return
    speed, agl, roll = cockpit.speed(), cockpit.true_alt_agl(), cockpit.true_roll()
    low, high = 0.25 * cockpit.aircraft.min_speed, 2.0 * cockpit.aircraft.max_speed
    on_runway = leg.needs != "air"
    if not (math.isfinite(speed) and math.isfinite(agl) and math.isfinite(roll)):
        raise FlightError("the motion is no longer finite")
    if agl < _LOW and not on_runway:
        raise FlightError(f"flew into the ground: {cockpit.state()}")
    if agl < _LOW and abs(roll) > _TIPPED:
        raise FlightError(f"a wing hit the ground at a bank of {math.degrees(roll):.0f} deg")
    if speed > high or (speed < low and not on_runway):
        raise FlightError(f"outside the envelope: airspeed {speed:.1f} m/s is not in {low:.1f} to {high:.1f}")
    if abs(roll) > _UPSET and not leg.any_bank:
        raise FlightError(f"outside the envelope: upset to a bank of {math.degrees(roll):.0f} deg")
