"""Legs, wind and runway of a profile become SI; what does not fit together is one line that says why."""

import math

import pytest

from bench.core.mathematics import earth
from bench.core.records.flight_specs import Runway
from bench.io import config
from tests.config.test_config import errors, write

RUNWAY_LEGS = [
    {"kind": "static", "duration_s": 5.0},
    {"kind": "take-off", "to_height_m": 50.0, "rate_mps": 2.0, "speed_mps": 24.0},
    {"kind": "approach", "glide_deg": 3.5},
    {"kind": "flare"},
    {"kind": "landing-roll"},
]
ON_GROUND = {"lat_deg": 47.0, "lon_deg": 11.0, "alt_m": 600.0, "heading_deg": 90.0, "on_ground": True}


def test_a_start_on_the_ground_makes_the_runway(tmp_path):
    flight = config.read_profile(write(tmp_path), {"start": ON_GROUND, "leg": RUNWAY_LEGS}).flight
    assert flight.on_ground
    assert flight.runway == Runway(flight.lat, flight.lon, 600.0, flight.heading)
    assert flight.speed == 24.0
    assert [type(leg).__name__ for leg in flight.legs] == [
        "Static",
        "TakeOff",
        "Approach",
        "Flare",
        "LandingRoll",
    ]


def test_local_waypoints_are_meters_from_the_start(tmp_path):
    points = [{"north_m": 3000.0, "east_m": -4000.0}, {"lat_deg": 47.0, "lon_deg": 11.0, "alt_m": 900.0}]
    leg = {"kind": "waypoints", "points": points, "bank_deg": 20.0}
    flight = config.read_profile(write(tmp_path), {"leg": [leg]}).flight
    here, there = flight.legs[0].points
    start = flight.lat, flight.lon, flight.alt
    ned = earth.local_ned([*here.place(start), flight.alt], start)
    assert abs(ned[0] - 3000.0) < 1.0
    assert abs(ned[1] + 4000.0) < 1.0
    assert here.alt is None
    assert (there.lat, there.lon, there.alt) == (math.radians(47.0), math.radians(11.0), 900.0)


WRONG_LEGS = [
    ([{"kind": "turn", "bank_deg": 20}], "[[leg]] 1 (turn): has none of them: needs one of by_deg,"),
    (
        [{"kind": "turn", "by_deg": 20, "to_heading_deg": 30, "bank_deg": 20}],
        "[[leg]] 1 (turn): has by_deg and to_heading_deg: needs one of",
    ),
    (
        [{"kind": "turn", "by_deg": 20, "side": "left", "bank_deg": 20}],
        "[[leg]] 1 (turn): has by_deg and side: the sign of by_deg is the side",
    ),
    (
        [{"kind": "waypoints", "bank_deg": 20, "points": [{"lat_deg": 47.0, "north_m": 5.0}]}],
        "[[leg]] 1 (waypoints) points[0]: needs either lat_deg and lon_deg or north_m and east_m",
    ),
    (
        [{"kind": "waypoints", "bank_deg": 20, "points": [{"lat_deg": 97.0, "lon_deg": 5.0}]}],
        "[[leg]] 1 (waypoints) points[0]: lat_deg = 97 deg is outside -90 to 90 deg",
    ),
    ([{"kind": "flare"}], "[[leg]] 1 (flare): must follow an approach"),
    ([{"kind": "static", "duration_s": 5}], "[[leg]] 1 (static): stands on the ground: [start] on_ground"),
    (
        [{"kind": "straight", "duration_s": 5, "speed_mps": 70}],
        "[[leg]] 1 (straight): speed_mps = 70 m/s is outside 20 to 29 m/s of the aerosonde",
    ),
    (
        [{"kind": "configuration", "flaps": 1.0}],
        "[[leg]] 1 (configuration): the aerosonde has no flaps to move",
    ),
    ([{"kind": "configuration"}], "[[leg]] 1 (configuration): needs flaps or gear"),
    (
        [{"kind": "doublet", "surface": "rudder", "amplitude": 0, "width_s": 1}],
        "[[leg]] 1 (doublet): a deflection of 0 does nothing",
    ),
]


@pytest.mark.parametrize(("legs", "message"), WRONG_LEGS)
def test_a_leg_that_is_wrong_says_why(tmp_path, legs, message):
    (found,) = errors(write(tmp_path), overrides={"leg": legs})
    assert found.startswith(f"own.toml: {message}")


WRONG_AIR = [
    (
        {"wind.layers": [{"alt_m": 0, "from_deg": 0, "speed_mps": 3}], "wind.speed_mps": 5},
        "[wind] speed_mps = 5",
    ),
    (
        {"wind.layers": [{"alt_m": 5, "from_deg": 0, "speed_mps": 3}] * 2, "wind.speed_mps": 0},
        "[wind] layers[1] alt_m = 5 m is given twice",
    ),
    ({"gust": [{"start_s": 3.0}]}, "[[gust]] 1: needs a north_mps, east_mps or up_mps other than 0"),
    (
        {"gust": [{"start_s": 3.0, "up_mps": 2.0}, {"start_s": 4.0, "up_mps": 2.0}]},
        "[[gust]] 2: start_s = 4 s is before the end of another at 5 s",
    ),
    (
        {"start": {**ON_GROUND, "speed_mps": 5.0}, "leg": RUNWAY_LEGS},
        "[start] speed_mps = 5 m/s is not used with on_ground",
    ),
    (
        {"start": ON_GROUND},
        "[[leg]] 1 (straight): is flown in the air; a take-off must come before it",
    ),
]


@pytest.mark.parametrize(("overrides", "message"), WRONG_AIR)
def test_air_and_start_that_are_wrong_say_why(tmp_path, overrides, message):
    found = errors(write(tmp_path), overrides=overrides)
    assert found[0].startswith(f"own.toml: {message}")
