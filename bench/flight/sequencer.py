"""Legs of a flight into set-points of the guidance system, at 20 Hz on sample instants.

Each leg is a generator: it writes set-points, yields once per instant, returns when
it is flown. Set-points begin and end smoothly, because a step between samples would
put a corner into the truth that no sensor record can follow.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

from bench.flight.model import FlightError, Trim, node
from bench.flight.units import FT
from bench.specs import AircraftSpec, Climb, Descend, FigureEight, FlightSpec, Leg, Straight, Turn

RATE = 20.0
"""Instants per second at which set-points are written [Hz]."""

_ROLL_RATE = math.radians(20.0)  # fastest change of a bank set-point [rad/s]
_CLIMB_CHANGE = 1.0  # fastest change of a climb set-point [m/s^2]
_NEAR_ALT = 2.0  # an altitude is reached within [m]
_NEAR_HEADING = math.radians(2.0)  # a heading is reached within [rad]
_PATIENCE = 120.0  # how much longer than planned a leg may take [s]
_UPSET = math.radians(100.0)  # bank guidance is not expected to come back from [rad]
_LOW = 3.0  # the flight ends above the ground by less [m]
_G = 9.81  # [m/s^2]

Steps = Iterator[None]


class Cockpit:
    """What the sequencer reads from the model and writes to its guidance system, in SI."""

    def __init__(self, fdm: Any, aircraft: AircraftSpec) -> None:
        def reader(name: str) -> Callable[[], float]:
            read: Callable[[], float] = node(fdm, name).get_double_value
            return read

        def writer(name: str) -> Callable[[float], None]:
            write: Callable[[float], None] = node(fdm, f"guidance/{name}").set_double_value
            return write

        def gain(name: str) -> float:
            value = reader(f"guidance/{name}")()
            if not value > 0:
                raise FlightError(f"aircraft {aircraft.name}: gain {name} must be above 0; it is {value:g}")
            return value

        self._alt_ft, self._agl_ft = reader("position/geod-alt-ft"), reader("position/h-agl-ft")
        self._down_fps, self._speed_fps = reader("velocities/v-down-fps"), reader("velocities/vt-fps")
        self.heading, self.roll = reader("attitude/psi-rad"), reader("attitude/phi-rad")
        self.lat_mode, self.lon_mode, self.thr_mode = (writer(f"{k}-mode") for k in ("lat", "lon", "thr"))
        self.set_bank, self.set_heading = writer("bank-setpoint-rad"), writer("heading-setpoint-rad")
        self.set_climb, self.set_alt = writer("climb-setpoint-mps"), writer("altitude-setpoint-m")
        self.set_speed = writer("airspeed-setpoint-mps")
        self.aircraft = aircraft
        self.course = self.heading()  # the heading to hold between turns, not wrapped [rad]
        # what the loops lag behind a moving set-point
        self.bank_lag = 2 / gain("bank-lag-rad_sec")
        self.climb_lag = 1 / gain("pitch-lag-rad_sec") + 1 / gain("climb-gain")

    def alt(self) -> float:
        """Ellipsoidal height [m]."""
        return self._alt_ft() * FT

    def alt_agl(self) -> float:
        """Height above ground [m]."""
        return self._agl_ft() * FT

    def climb(self) -> float:
        """Vertical speed, up [m/s]."""
        return -self._down_fps() * FT

    def speed(self) -> float:
        """True airspeed [m/s]."""
        return self._speed_fps() * FT


@dataclass(frozen=True, slots=True)
class FlownLeg:
    """A leg as flown."""

    start: float  # [s]
    end: float  # [s]
    text: str


def engage(fdm: Any, spec: FlightSpec, trimmed: Trim) -> Cockpit:
    """Switch guidance on in the trimmed and settled flight, without a jump of any command."""
    fdm["guidance/aileron-trim-norm"] = trimmed.aileron
    fdm["guidance/elevator-trim-norm"] = trimmed.elevator
    fdm["guidance/throttle-trim-norm"] = trimmed.throttle
    fdm["guidance/bank-trim-rad"] = trimmed.roll
    fdm["guidance/pitch-trim-rad"] = trimmed.pitch
    cockpit = Cockpit(fdm, spec.aircraft)
    cockpit.set_speed(spec.speed)
    cockpit.thr_mode(1)
    _hold(cockpit, spec.alt)
    return cockpit


def fly_legs(cockpit: Cockpit, spec: FlightSpec, flown: list[FlownLeg]) -> Iterator[float]:
    """Fly the legs in order; yields the start of each interval, and appends each leg when it ends.

    With a duration the last leg is held to it. Legs that need longer are flown to
    their end all the same, to say how long they need.

    Raises
    ------
    FlightError
        Which leg failed, when and why.
    """
    begun = tick = 0
    end = 0 if spec.duration is None else round(spec.duration * RATE)
    for number, leg in enumerate(spec.legs, 1):
        text = describe(number, leg)
        try:
            for _ in _steps(cockpit, leg):
                _watch(cockpit)
                yield tick / RATE
                tick += 1
            while number == len(spec.legs) and tick < end:
                _watch(cockpit)
                yield tick / RATE
                tick += 1
        except FlightError as error:
            raise FlightError(f"leg {text}: at {tick / RATE:.1f} s: {error}") from None
        flown.append(FlownLeg(begun / RATE, tick / RATE, text))
        begun = tick
    if spec.duration is not None and tick > end:
        raise FlightError(f"the legs need {tick / RATE:g} s; duration is {spec.duration:g} s")


def describe(number: int, leg: Leg) -> str:
    """Return a leg in words.

    Examples
    --------
    >>> describe(2, Turn(by=math.pi, bank=math.radians(30.0)))
    '2 turn: 180 deg right, bank 30 deg'
    """
    match leg:
        case Straight():
            return f"{number} straight: {leg.duration:g} s"
        case Climb():
            return f"{number} climb: to {leg.to_alt:g} m at {leg.rate:g} m/s"
        case Descend():
            return f"{number} descend: to {leg.to_alt:g} m at {leg.rate:g} m/s"
        case Turn():
            side = "right" if leg.by > 0 else "left"
            by, bank = math.degrees(abs(leg.by)), math.degrees(leg.bank)
            return f"{number} turn: {by:.4g} deg {side}, bank {bank:.4g} deg"
        case FigureEight():
            laps = f"{leg.laps} lap" if leg.laps == 1 else f"{leg.laps} laps"
            return f"{number} figure-eight: {laps}, bank {math.degrees(leg.bank):.4g} deg"


def _steps(cockpit: Cockpit, leg: Leg) -> Steps:
    match leg:
        case Straight():
            return _wait(leg.duration)
        case Climb():
            return _to_alt(cockpit, leg.to_alt, leg.rate)
        case Descend():
            return _to_alt(cockpit, leg.to_alt, -leg.rate)
        case Turn():
            return _turn(cockpit, leg.by, leg.bank)
        case FigureEight():
            return _figure_eight(cockpit, leg)


def _hold(cockpit: Cockpit, alt: float) -> None:
    cockpit.set_heading(cockpit.course)
    cockpit.lat_mode(2)
    cockpit.set_alt(alt)
    cockpit.lon_mode(3)


def _wait(duration: float) -> Steps:
    for _ in range(round(duration * RATE)):
        yield


def _to_alt(cockpit: Cockpit, alt: float, rate: float) -> Steps:
    """Ramp the vertical speed up, hold it, ramp it down into the altitude."""
    begun = cockpit.alt()
    # a short way is climbed slower, so that the ramps fit into it; 0.1 m/s when there is no way at all
    fits = max(0.1, math.sqrt(abs(alt - begun) * _CLIMB_CHANGE / 2))
    rate = math.copysign(min(abs(rate), fits), rate)
    ramp = 1.5 * abs(rate) / _CLIMB_CHANGE
    cockpit.set_climb(0.0)
    cockpit.lon_mode(2)
    for share in _smooth(ramp):
        cockpit.set_climb(share * rate)
        yield
    lead = abs(rate) * (ramp / 2 + cockpit.climb_lag)
    planned = abs(alt - begun) / abs(rate)
    for _ in _ticks(planned + _PATIENCE):
        if (alt - cockpit.alt()) * math.copysign(1.0, rate) <= lead:
            break
        yield
    else:
        raise FlightError(f"{alt:g} m not reached in {planned + _PATIENCE:.0f} s: {_state(cockpit)}")
    for share in _smooth(ramp):
        cockpit.set_climb((1 - share) * rate)
        yield
    cockpit.set_alt(alt)
    cockpit.lon_mode(3)
    for _ in _ticks(_PATIENCE):
        if abs(alt - cockpit.alt()) < _NEAR_ALT:
            return
        yield
    raise FlightError(f"{alt:g} m not held within {_PATIENCE:g} s: {_state(cockpit)}")


def _turn(cockpit: Cockpit, by: float, bank: float) -> Steps:
    """Roll in, hold the bank, roll out on the new heading and catch it."""
    yield from _roll_through(cockpit, by, bank)
    for _ in _ticks(_PATIENCE):
        error = math.remainder(cockpit.course - cockpit.heading(), math.tau)
        if abs(error) < _NEAR_HEADING:
            return
        yield
    raise FlightError(f"heading not held within {_PATIENCE:g} s: {_state(cockpit)}")


def _figure_eight(cockpit: Cockpit, leg: FigureEight) -> Steps:
    for _ in range(leg.laps):
        yield from _roll_through(cockpit, math.tau, leg.bank)
        yield from _turn(cockpit, -math.tau, leg.bank)


def _roll_through(cockpit: Cockpit, by: float, bank: float) -> Steps:
    """Turn by an angle through a smooth bank; ends with wings level, in heading mode."""
    begun = cockpit.heading()
    to_go = abs(by) + math.copysign(1.0, by) * math.remainder(cockpit.course - begun, math.tau)
    bank = _bank_that_fits(cockpit, to_go, bank)
    side = math.copysign(1.0, by)
    ramp = _roll_time(bank)
    cockpit.set_bank(0.0)
    cockpit.lat_mode(1)
    turned, last = 0.0, begun

    def turn_on() -> None:
        nonlocal turned, last
        now = cockpit.heading()
        turned += side * math.remainder(now - last, math.tau)
        last = now

    for share in _smooth(ramp):
        cockpit.set_bank(side * share * bank)
        yield
        turn_on()
    # what the roll out turns, times the airspeed it is flown at [m]
    lead = _turned_in_roll(bank, 1.0) + _G * math.tan(bank) * cockpit.bank_lag
    planned = to_go / (_G * math.tan(bank) / cockpit.speed())
    for _ in _ticks(1.5 * planned + _PATIENCE):
        if to_go - turned <= lead / cockpit.speed():
            break
        yield
        turn_on()
    else:
        raise FlightError(f"turned {math.degrees(turned):.0f} of {math.degrees(to_go):.0f} deg only")
    for share in _smooth(ramp):
        cockpit.set_bank(side * (1 - share) * bank)
        yield
    cockpit.course += by
    cockpit.set_heading(cockpit.course)
    cockpit.lat_mode(2)


def _roll_time(bank: float) -> float:
    return max(1.0, 1.5 * bank / _ROLL_RATE)


def _turned_in_roll(bank: float, speed: float) -> float:
    """Heading change while a bank is rolled in or out [rad]."""
    n = 40
    mean_tan = sum(math.tan(bank * _smoothstep(k / n)) for k in range(n + 1)) / (n + 1)
    return _G / speed * mean_tan * _roll_time(bank)


def _bank_that_fits(cockpit: Cockpit, to_go: float, bank: float) -> float:
    """Largest bank up to the wanted one whose roll in and out turn no further than wanted."""
    while bank > math.radians(1.0) and 2 * _turned_in_roll(bank, cockpit.speed()) > to_go:
        bank *= 0.95
    return bank


def _smooth(duration: float) -> Iterator[float]:
    """Yield 0 to 1 with zero slope at both ends, one value per instant, the last one 1."""
    n = max(1, math.ceil(duration * RATE))
    for k in range(1, n + 1):
        yield _smoothstep(k / n)


def _smoothstep(x: float) -> float:
    return x * x * (3 - 2 * x)


def _ticks(duration: float) -> range:
    return range(math.ceil(duration * RATE))


def _watch(cockpit: Cockpit) -> None:
    """Raise FlightError when the flight has left the air or what guidance is tuned for."""
    speed, agl, roll = cockpit.speed(), cockpit.alt_agl(), cockpit.roll()
    low, high = 0.25 * cockpit.aircraft.min_speed, 2.0 * cockpit.aircraft.max_speed
    if not (math.isfinite(speed) and math.isfinite(agl) and math.isfinite(roll)):
        raise FlightError("the motion is no longer finite")
    if agl < _LOW:
        raise FlightError(f"flew into the ground: {_state(cockpit)}")
    if not low <= speed <= high:
        raise FlightError(f"outside the envelope: airspeed {speed:.1f} m/s is not in {low:.1f} to {high:.1f}")
    if abs(roll) > _UPSET:
        raise FlightError(f"outside the envelope: upset to a bank of {math.degrees(roll):.0f} deg")


def _state(cockpit: Cockpit) -> str:
    return (
        f"at {cockpit.alt():.0f} m, climbing {cockpit.climb():.1f} m/s, "
        f"heading {math.degrees(cockpit.heading()):.0f} deg, airspeed {cockpit.speed():.1f} m/s"
    )
