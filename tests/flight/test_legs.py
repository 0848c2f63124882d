"""A leg is one declaration: its keys, limits, words and flight come from nowhere else."""

from dataclasses import dataclass
from typing import Annotated

import numpy as np
import pytest
from pydantic import TypeAdapter

from bench.core.mathematics.rotation import to_euler
from bench.core.mathematics.units import split_unit
from bench.core.records.flight_specs import LegStart
from bench.io import config
from bench.io.config.leg_tables import build_leg_type
from bench.simulation.flight import fly, legs
from bench.simulation.flight.guidance.shaping import smooth
from bench.simulation.flight.legs.keys import AtSpeed, Bank, Key, keys_of, write_key
from bench.simulation.flight.legs.landing import Approach, LandingRoll
from bench.simulation.flight.legs.surfaces import AileronRoll
from tests.config.test_config import PROFILE, errors, write


@dataclass(frozen=True)
class Waggle(AtSpeed):
    """Rock the wings about the course."""

    kind = "waggle"
    bank: Bank
    count: Annotated[int, Key("count", "of both sides", 1, 10)] = 2

    def describe(self) -> str:
        return f"{self.count} times"

    def check(self, start: LegStart) -> list[str]:
        return [f"{write_key(self, 'bank')} at {start.alt:g} m is one too many"] if self.count == 9 else []

    def fly(self, cockpit):
        cockpit.set_bank(0.0)
        cockpit.lat_mode(1)
        last = 0.0
        for bank in (*self.count * (self.bank, -self.bank), 0.0):
            for share in smooth(2.0):
                cockpit.set_bank(last + share * (bank - last))
                yield
            last = bank
        cockpit.hold_heading()
        return f"{self.count} waggles"


@pytest.fixture
def waggle(monkeypatch, tmp_path):
    """A profile with one straight and one leg from elsewhere."""
    monkeypatch.setattr(legs, "LEGS", (*legs.LEGS, Waggle))
    head, tail = PROFILE.split("[[leg]]")[0], PROFILE[PROFILE.index("[sensors]") :]
    own = '[[leg]]\nkind = "straight"\nduration_s = 2\n[[leg]]\nkind = "waggle"\nbank_deg = 20.0\n'
    return write(tmp_path, f"duration_s = 14\n{head}{own}{tail}[evaluation]\nfrom_s = 5\n")


def test_a_leg_from_elsewhere_is_flown_from_a_profile(waggle):
    truth = fly(config.read_profile(waggle, {"leg.2.speed_mps": 26}).flight)
    assert [text for _, _, text in truth.events.select("leg")] == [
        "1 straight: 2 s",
        "2 waggle: 2 times, 26 m/s, then held to 14 s; 2 waggles",
    ]
    roll = np.rad2deg(to_euler(truth.q_nb)[0])
    assert 15.0 < roll.max() < 25.0
    assert -25.0 < roll.min() < -15.0
    assert "waggle" in {leg.name for leg in config.list_legs()}


def test_its_mistakes_are_said_as_those_of_any_other(waggle):
    assert errors(waggle, overrides={"leg.2.bank_deg": 90, "leg.2.coun": 3}) == [
        "own.toml: [[leg]] 2 (waggle): bank_deg = 90 deg is outside 1 to 80 deg",
        "own.toml: [[leg]] 2 (waggle): unknown key 'coun'. Did you mean 'count'?\n"
        "  known keys: bank_deg, count, kind, speed_mps",
    ]
    assert errors(waggle, overrides={"leg.2.bank_deg": 50.1, "leg.2.count": 9, "leg.2.speed_mps": 40}) == [
        "own.toml: [[leg]] 2 (waggle): bank_deg = 50.1 deg is above the 45 deg of the aerosonde",
        "own.toml: [[leg]] 2 (waggle): speed_mps = 40 m/s is outside 20 to 29 m/s of the aerosonde",
        "own.toml: [[leg]] 2 (waggle): bank_deg = 50.1 deg at 1000 m is one too many",
    ]


def test_every_leg_says_what_it_does_and_what_its_keys_are():
    kinds = [leg.kind for leg in legs.LEGS]
    assert len(set(kinds)) == len(kinds) >= 20
    for leg in config.list_legs():
        assert leg.title.endswith("."), leg
        for key in leg.keys:
            assert key.words, key
            assert bool(key.choices) + (key.low is not None) + (key.name == "points") == 1, key
            assert split_unit(key.name)[1] == key.unit


@pytest.mark.parametrize("leg", [Approach(), LandingRoll(), AileronRoll(0.5)])
def test_a_default_in_the_file_is_the_one_in_si(leg):
    (row,) = TypeAdapter(build_leg_type(legs.LEGS)).validate_python([{"kind": leg.kind, **required(leg)}])
    assert row.build() == leg


def required(leg):
    return {e.key.name: getattr(leg, e.field) for e in keys_of(type(leg)) if e.field == "aileron"}
