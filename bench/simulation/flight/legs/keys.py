"""Declaration of a leg: a field for each key of the profile, which its annotation contains.

    bank: Annotated[float, Key("bank_deg", "bank of the turns", 1, 80, most="max_bank")]

The value of a field is in SI, the key and its limits are in the unit that its name ends in. A field that may
be left out has a default.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import MISSING, dataclass, field, fields
from types import NoneType
from typing import Annotated, Any, Literal, NamedTuple, Union, get_args, get_origin, get_type_hints

from bench.core.mathematics.units import from_si, unit_of
from bench.core.records.flight_specs import (
    BANKS,
    CLIMBS,
    FIXED_WING,
    GLIDER,
    ROTORCRAFT,
    SECONDS,
    SPEEDS,
    AircraftSpec,
    Leg,
    LegStart,
)
from bench.core.words.wording import quantity

SIDES: Mapping[str, int] = {"right": 1, "left": -1, "shorter": 0}


@dataclass(frozen=True, eq=False)
class Key:
    """A key of a profile, and its allowed values."""

    name: str  # ends in its unit
    words: str
    low: float = -math.inf  # in that unit, as is high
    high: float = math.inf
    least: str = ""  # the figure of AircraftSpec that it must reach ...
    most: str = ""  # ... and the one that it must not exceed

    @property
    def unit(self) -> str:
        """Unit of the file."""
        return unit_of(self.name)

    def from_si(self, value: Any) -> Any:
        """Return an SI value in the unit of the file, without digits due to rounding."""
        return float(f"{from_si(self.name, value):.12g}") if isinstance(value, float) else value


class KeyedField(NamedTuple):
    """A field of a leg, or of a row in a leg."""

    field: str
    key: Key
    type: Any  # float, int, Literal[...] or tuple[Row, ...]
    optional: bool  # None: it is left out
    default: Any  # in the unit of the file; MISSING: it must be given

    @property
    def row(self) -> type[Any] | None:
        """Return the type of the rows of an array."""
        return get_args(self.type)[0] if get_origin(self.type) is tuple else None

    @property
    def choices(self) -> tuple[str, ...]:
        """Return the allowed texts."""
        return get_args(self.type) if get_origin(self.type) is Literal else ()


_KNOWN: dict[type[Any], tuple[KeyedField, ...]] = {}


def keys_of(made: type[Any]) -> tuple[KeyedField, ...]:
    """Return the keys of the fields of a class: a leg, or a row in a leg."""
    if made not in _KNOWN:
        hints, found = get_type_hints(made, include_extras=True), []
        for entry in sorted(fields(made), key=lambda entry: bool(entry.kw_only)):
            hint = hints[entry.name]
            parts = get_args(hint) if get_origin(hint) is Union else (hint,)
            kind, key = get_args(next(part for part in parts if part is not NoneType))
            default = MISSING if entry.default is MISSING else key.from_si(entry.default)
            found.append(KeyedField(entry.name, key, kind, NoneType in parts, default))
        _KNOWN[made] = tuple(found)
    return _KNOWN[made]


def write_key(made: Any, name: str) -> str:
    """Return a field of a leg, or of a row in a leg, as written in the file: ``bank_deg = 30 deg``."""
    key = next(entry.key for entry in keys_of(type(made)) if entry.field == name)
    return quantity(key.name, key.from_si(getattr(made, name)))


def require_one(values: Mapping[str, Any]) -> None:
    """Raise ValueError unless exactly one key has a value."""
    given = [name for name, value in values.items() if value is not None]
    if len(given) != 1:
        raise ValueError(f"has {' and '.join(given) or 'none of them'}: needs one of {', '.join(values)}")


def format_deg(angle: float) -> str:
    """Return an angle [rad] in words."""
    return f"{math.degrees(angle):.4g} deg"


def side_of(value: float) -> str:
    """Return the side of a sign."""
    return "right" if value > 0 else "left"


def check_leg(leg: Leg, start: LegStart) -> list[str]:
    """Return the conflicts of a leg with the aircraft or the legs before it, one line each."""
    craft = start.aircraft
    if craft.kind not in leg.flown_by:
        if craft.glides and FIXED_WING in leg.flown_by:
            instead = "use a leg such as winch, straight, turn or thermal"
            return [f"needs an engine, and the {craft.name} is a glider and sinks; {instead}"]
        own = {ROTORCRAFT: "a multirotor or a helicopter", (GLIDER,): "a glider"}.get(leg.flown_by)
        own = own or "an aircraft with wings"
        instead = "hover, goto, sprint or orbit" if craft.hovers else "straight, turn, waypoints or holding"
        return [f"is flown by {own}, and the {craft.name} is none; it flies {instead}"]
    if craft.hovers and isinstance(leg, AtSpeed) and leg.speed is not None:
        return [
            f"{write_key(leg, 'speed')} is an airspeed, which the {craft.name} does not hold; leave it out"
        ]
    return [*_check_limits(leg, start.aircraft), *_check_begin(leg, start), *leg.check(start)]


def _check_limits(leg: Leg, aircraft: AircraftSpec) -> list[str]:
    found = []
    for name, key, *_ in keys_of(type(leg)):
        value = getattr(leg, name)
        if value is None or not key.most:
            continue
        low = getattr(aircraft, key.least) if key.least else -math.inf
        high = getattr(aircraft, key.most)
        if not low <= value <= high * (1 + 1e-9):
            ends = f"outside {key.from_si(low):g} to" if key.least else "above the"
            limit = f"{ends} {key.from_si(high):g} {key.unit} of the {aircraft.name}"
            found.append(f"{write_key(leg, name)} is {limit}")
    return found


def _check_begin(leg: Leg, start: LegStart) -> list[str]:
    after = start.after
    if leg.needs == after:
        return []
    if leg.needs == "ground":
        does = "stands" if leg.leaves == "ground" else "starts"
        landed = "" if start.aircraft.glides else ", or a landing-roll before it"
        return [f"{does} on the ground: [start] on_ground = true{landed}"]
    if leg.needs != "air":
        return [f"must follow {'an' if leg.needs[0] in 'aeiou' else 'a'} {leg.needs}"]
    if after == "approach":
        return ["must be a flare, after an approach"]
    return [f"is flown in the air; a {'winch' if start.aircraft.glides else 'take-off'} must come before it"]


Seconds = Annotated[float, Key("duration_s", "duration of the leg", *SECONDS)]
Bank = Annotated[
    float, Key("bank_deg", "bank angle in turns, limited by the aircraft", *BANKS, most="max_bank")
]
ClimbRate = Annotated[
    float, Key("rate_mps", "climb rate, limited by the aircraft", *CLIMBS, most="max_climb")
]
Speed = Annotated[float, Key("speed_mps", "true airspeed", *SPEEDS, least="min_speed", most="max_speed")]


@dataclass(frozen=True)
class AtSpeed(Leg):
    """A leg that may change the airspeed; otherwise it holds the airspeed of the leg before."""

    speed: Speed | None = field(default=None, kw_only=True)
