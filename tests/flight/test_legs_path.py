"""Legs along tracks keep the track whatever the wind; geometry that cannot be flown says so."""

from dataclasses import replace
from itertools import pairwise
from math import cos, degrees, hypot, pi, radians, sin

import numpy as np
import pytest
from numpy.testing import assert_allclose

from bench.core.mathematics import earth, rotation
from bench.core.records.flight_specs import Gust
from bench.core.words.exceptions import FlightError
from bench.simulation.flight import fly
from bench.simulation.flight.guidance import paths
from bench.simulation.flight.guidance.paths import Segment, SegmentPath
from bench.simulation.flight.legs.level import Straight
from bench.simulation.flight.legs.tracks import Holding, Survey, Waypoint, Waypoints
from tests.flight.plans import CALM, fly_here, plan

BANK = radians(30.0)
WINDY = {"wind_from": radians(10.0), "wind_speed": 6.0}


def place(north: float, east: float, alt: float | None = None) -> Waypoint:
    """A waypoint by meters from the start of the test flights."""
    lat, lon, _ = earth.displace([CALM.lat, CALM.lon, CALM.alt], [north, east, 0.0])
    return Waypoint(float(lat), float(lon), alt=alt)


def ground(truth) -> np.ndarray:
    return earth.local_ned(truth.lla, truth.lla[0])[:, :2]


# --- geometry -----------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "segment",
    [
        Segment((10.0, -20.0), 1.0, 500.0, 0.0),
        Segment((10.0, -20.0), 1.0, 500.0, 1 / 150.0),
        Segment((10.0, -20.0), -2.0, 150.0 * radians(300.0), -1 / 150.0),
    ],
)
def test_a_point_beside_a_segment_is_found_where_it_was_put(segment):
    for along in np.linspace(0.02, 0.98, 9) * segment.length:
        (north, east), course = segment.at(float(along))
        for off in (-40.0, 0.0, 40.0):
            point = north - off * sin(course), east + off * cos(course)
            found = segment.relative(point)
            assert_allclose(found[:2], [along, off], atol=1e-9)
            assert_allclose(np.exp(1j * found[2]), np.exp(1j * course), atol=1e-9)


def test_a_path_towards_a_point_leads_to_it():
    for target in ((3000.0, 400.0), (-2000.0, -900.0), (-500.0, 1000.0)):
        path = SegmentPath((100.0, 50.0), radians(85.0))
        path.towards(target, 200.0, "it")
        path.straight(hypot(target[0] - path.point[0], target[1] - path.point[1]))
        assert_allclose(path.point, target, atol=1e-6)


# --- flown --------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def round_trip():
    points = [(0.0, 1500.0), (-1200.0, 1500.0), (-1200.0, -500.0), (300.0, -500.0)]
    legs = Straight(3.0), Waypoints(tuple(place(*p) for p in points), BANK)
    return fly(plan(*legs, **WINDY)), points


def test_waypoints_are_flown_by_on_the_inside_and_tracks_are_kept(round_trip):
    truth, points = round_trip
    flown = ground(truth)
    radius = (25.0 + 6.0) ** 2 / (9.81 * np.tan(BANK))
    for here, there in pairwise(points):
        a, b = np.array(here), np.array(there)
        length = np.linalg.norm(b - a)
        u = (b - a) / length
        along, off = (flown - a) @ u, (flown - a) @ [-u[1], u[0]]
        middle = (along > radius + 150) & (along < length - radius - 150) & (np.abs(off) < 200)
        assert middle.sum() > 500
        assert np.abs(off[middle]).max() < 3.0
    nearest = [np.linalg.norm(flown - np.array(p), axis=1).min() for p in points]
    inside = radius * (np.sqrt(2) - 1)  # an arc in a right angle
    assert_allclose(nearest[1:3], inside, atol=6.0)
    assert nearest[3] < 5.0  # the last is flown over


def test_the_wind_moves_the_nose_not_the_track(round_trip):
    """On the westward track the crab is asin(6 cos(wind angle) / 25) to the right, into the wind."""
    truth, _ = round_trip
    flown = ground(truth)
    at = (np.abs(flown[:, 0] + 1200.0) < 20) & (flown[:, 1] < 1000) & (flown[:, 1] > 100)
    heading = np.rad2deg(rotation.to_euler(truth.q_nb)[2][at])
    assert_allclose(heading, 270.0 + degrees(np.arcsin(6.0 * cos(radians(10.0)) / 25.0)), atol=1.5)


def test_banks_stay_near_what_was_asked_for(round_trip):
    truth, _ = round_trip
    assert np.abs(rotation.to_euler(truth.q_nb)[0]).max() < BANK + radians(7.0)


def test_waypoints_may_have_heights():
    points = place(0.0, 1500.0, 1240.0), place(900.0, 2400.0, 1220.0)
    truth = fly(plan(Waypoints(points, BANK), Straight(5.0)))
    flown = ground(truth)
    first = int(np.linalg.norm(flown - [0.0, 1500.0], axis=1).argmin())
    assert_allclose(truth.lla[first, 2], 1240.0, atol=4.0)
    assert_allclose(truth.lla[-1, 2], 1220.0, atol=3.0)


def test_a_height_that_is_too_steep_is_named():
    with pytest.raises(
        FlightError, match=r"leg 1 waypoints: .* 400 m of height in .* m/s; the aerosonde has"
    ):
        fly(plan(Waypoints((place(0.0, 1500.0, 1600.0),), BANK)))


def test_waypoints_too_close_for_the_turns_are_named():
    close = place(0.0, 1000.0), place(60.0, 1000.0), place(60.0, 0.0)
    with pytest.raises(
        FlightError, match=r"waypoint 1: a turn of -90 deg at \d+ m radius needs \d+ m .* 60 m"
    ):
        fly(plan(Waypoints(close, BANK)))
    beside = (place(60.0, 30.0),)
    with pytest.raises(FlightError, match=r"waypoint 1 is inside the turn that leads to it, of \d+ m radius"):
        fly(plan(Waypoints(beside, BANK)))


@pytest.mark.parametrize("spacing", [120.0, 500.0])
def test_survey_strips_are_parallel_and_as_far_apart_as_said(spacing):
    legs = Straight(2.0), Survey(700.0, spacing, 3, BANK, radians(85.0), "left")
    flown = ground(fly(plan(*legs, **WINDY)))
    flown = flown - flown[200]  # where the survey begins
    c, s = cos(radians(85.0)), sin(radians(85.0))
    along, right = flown @ [c, s], flown @ [-s, c]
    for strip in range(3):
        # the first is met from the heading of the start, which is not the track in this wind
        inner = (along > 350) & (along < 650) & (np.abs(right + strip * spacing) < 40)
        assert inner.sum() > 500
        assert np.abs(right[inner] - right[inner].mean()).max() < 3.0
        assert_allclose(right[inner].mean(), -strip * spacing, atol=3.0)


def test_every_lap_of_a_holding_is_the_same_over_ground():
    legs = (Holding(2, radians(25.0), radians(85.0), 20.0),)
    truth = fly(plan(*legs, **WINDY))
    flown = ground(truth)
    start, end, _ = truth.events.select("leg")[0]
    assert end - start > 100.0
    c, s = cos(radians(85.0)), sin(radians(85.0))
    along, right = flown @ [c, s], flown @ [-s, c]
    radius = 31.0**2 / (9.81 * np.tan(radians(25.0)))
    assert_allclose(right.max(), 2 * radius, atol=8.0)
    assert right.min() > -8.0
    half = len(flown) // 2
    for piece in (flown[:half], flown[half:]):  # both laps come by the far corner
        assert np.linalg.norm(piece - flown[int((right).argmax())], axis=1).min() < 15.0
    inbound = (along < -50) & (along > -250) & (right < 60)
    assert np.abs(right[inbound]).max() < 4.0
    assert end < 2 * (2 * pi * radius + 2 * 500) / 19.0


@pytest.mark.parametrize(("lat", "lon"), [(84.0, 20.0), (0.0, 179.999)])
def test_tracks_are_straight_where_longitude_is_awkward(lat, lon):
    """At 84 deg a course of constant heading bends 26 m in 3 km; the track over ground must not."""
    start = {"lat": radians(lat), "lon": radians(lon)}
    there = earth.to_geodetic(
        earth.to_ecef([start["lat"], start["lon"], 1200.0])
        + earth.matrix_en(start["lat"], start["lon"]) @ [0.0, 3000.0, 0.0]
    )
    flown = ground(
        fly(plan(Waypoints((Waypoint(there[0], there[1], None),), BANK), heading=radians(90.0), **start))
    )
    assert np.abs(flown[:, 0]).max() < 1.0
    assert_allclose(flown[-1, 1], 3000.0, atol=5.0)


def test_a_flight_blown_off_its_track_is_named():
    """A guidance that may bank by a degree only cannot make the turn."""
    stiff = replace(CALM.aircraft, max_bank=radians(1.0))
    with pytest.raises(
        FlightError, match=r"leg 1 waypoints: .* m off the track to the (right|left): at 1200 m"
    ):
        fly(plan(Waypoints((place(-1500.0, 0.0),), BANK), aircraft=stiff))


# --- banks as asked -----------------------------------------------------------------------------------


ASKED = radians(20.0)
SHORT = {  # two begin with a turn of 60 deg onto their first track
    "holding": Holding(1, ASKED, course=radians(145.0), leg_time=25.0),
    "survey": Survey(900.0, 500.0, 2, ASKED, course=radians(20.0)),
    "waypoints": Waypoints((place(0.0, 1500.0), place(1500.0, 1500.0)), ASKED),
}


def most_bank(truth, begin: float = 0.0) -> float:
    return float(np.degrees(np.abs(rotation.to_euler(truth.q_nb[truth.t >= begin])[0]).max()))


@pytest.mark.parametrize("kind", SHORT)
def test_a_bank_in_calm_air_is_the_one_that_is_asked_for(kind):
    """Within 3 deg, the turn onto a first track 60 deg off the course included."""
    assert 20.0 < most_bank(fly(plan(SHORT[kind]))) < 23.0


def test_without_its_limit_the_turn_onto_a_track_banks_as_far_as_the_aircraft_goes(monkeypatch):
    monkeypatch.setattr(paths, "_SPARE", radians(60.0))
    assert most_bank(fly_here(plan(SHORT["holding"]))) > 40.0


def test_in_gusts_a_track_that_is_met_may_take_more_bank():
    """A wind of 10 m/s towards its outside comes up within the turn: 3 deg more do not hold the track."""
    gust = Gust((0.0, 10.0, 0.0), start=50.0, rise=2.0, hold=20.0)
    assert most_bank(fly_here(plan(SHORT["waypoints"], gusts=(gust,)))) > 25.0


@pytest.mark.parametrize("course", [170.0, 260.0, 355.0])
def test_a_track_is_met_from_any_course(course):
    """From 85 deg: it turns at the bank asked for, comes back to the track and holds it."""
    leg = Holding(1, ASKED, course=radians(course), leg_time=60.0)
    truth = fly_here(plan(leg))
    assert most_bank(truth) < 23.0
    c, s = cos(radians(course)), sin(radians(course))
    ned = ground(truth)
    off = ned[:, 1] * c - ned[:, 0] * s
    inbound = truth.t > truth.t[-1] - 20.0
    assert np.abs(off[inbound]).max() < 3.0
