"""From a stand along taxiways to a hold short of the runway and onto its centerline."""

from dataclasses import replace
from math import cos, degrees, hypot, pi, radians, sin
from types import SimpleNamespace

import numpy as np
import pytest

from bench.core.mathematics import earth, rotation
from bench.core.words.exceptions import ConfigError, FlightError
from bench.io.config import read_profile
from bench.simulation.flight import fly
from bench.simulation.flight.exceedances import Exceedances
from bench.simulation.flight.ground.taxiway import Taxiway
from bench.simulation.flight.guidance.belief import Belief, NavEstimate
from bench.simulation.flight.guidance.paths import SegmentPath
from bench.simulation.flight.legs.runway import Static, TakeOff
from bench.simulation.flight.legs.taxi import LineUp, Taxi, TaxiRoute
from bench.simulation.flight.legs.tracks import Point
from bench.simulation.flight.recorder import fly_pieces
from tests.flight.plans import fly_here
from tests.flight.test_exceedances import MODEL, exceedances, on_wheels
from tests.flight.test_legs_ground import (
    ALONG,
    GROUND,
    KINDS,
    LAT,
    LON,
    NAVION,
    RUNWAY,
    runway_frame,
    standing,
)

SIZES = {
    "aerosonde": (0.7, 8.0, 8.0, 5.0),
    "navion": (1.0, 20.0, 15.0, 8.0),
    "jet747": (2.0, 60.0, 25.0, 12.0),
}
"""Scale of the way, radius of the turns [m], width of the taxiway [m], speed [m/s]."""

HOLD_SHORT = {"aerosonde": 45.0, "navion": 45.0, "jet747": 65.0}
"""From the centerline to the end of the taxiway, whose turn begins there [m]."""


def north_east(along: float, right: float) -> tuple[float, float]:
    return along * cos(ALONG) - right * sin(ALONG), along * sin(ALONG) + right * cos(ALONG)


def from_stand(name: str, *, leave: float = 0.0, **changes):
    """Parallel to the runway on its left, back to the threshold, left towards it, hold short, line up."""
    kind, (scale, radius, width, speed) = KINDS[name], SIZES[name]
    stand = north_east(200.0 * scale, -100.0 * scale)
    lat, lon, _ = earth.displace([LAT, LON, GROUND], [*stand, 0.0])
    corners = north_east(0.0, -100.0 * scale), north_east(leave, -HOLD_SHORT[name])
    points = tuple(Point(north=n - stand[0], east=e - stand[1]) for n, e in corners)
    legs = Static(1.0), TaxiRoute(radius, speed, width, 5.0, points=points), LineUp(radius, speed, width, 2.0)
    spec = standing(*legs, Static(1.0), aircraft=kind.aircraft, speed=kind.climb[1], rate=100.0)
    return replace(spec, lat=float(lat), lon=float(lon), heading=ALONG + pi, **changes)


def center_of_gravity(truth, aircraft) -> tuple[np.ndarray, np.ndarray]:
    """Its way along the runway and to the right of it [m]."""
    along, right, _ = runway_frame(truth)
    turned = rotation.to_euler(truth.q_nb)[2] - ALONG
    forward, aside, _ = aircraft.imu_b
    return (
        along - forward * np.cos(turned) + aside * np.sin(turned),
        right - forward * np.sin(turned) - aside * np.cos(turned),
    )


def off_the_way(name: str, along, right) -> np.ndarray:
    """Distance to the straights and arcs, by hand: two turns of 90 deg to the left."""
    scale, radius, *_ = SIZES[name]
    back, end = -100.0 * scale, 20.0 + radius
    first = np.where(along > radius, np.abs(right - back), np.nan)
    arc = np.abs(np.hypot(along - radius, right - (back + radius)) - radius)
    one = np.where((along <= radius) & (right <= back + radius), arc, np.nan)
    straight = np.where((right > back + radius) & (right < -radius) & (along < radius), np.abs(along), np.nan)
    arc = np.abs(np.hypot(along - radius, right + radius) - radius)
    two = np.where((along <= radius) & (right >= -radius), arc, np.nan)
    last = np.where((along > radius) & (right > -radius) & (along < end + 5.0), np.abs(right), np.nan)
    return np.nanmin([first, one, straight, two, last], axis=0)


@pytest.mark.parametrize(
    ("name", "seed", "severity"),
    [
        ("navion", 1, 0),
        ("navion", 2, 4),
        ("jet747", 5, 4),
        *(
            pytest.param(name, seed, severity, marks=pytest.mark.long)
            for name, severity in (("aerosonde", 3), ("navion", 4), ("jet747", 4))
            for seed in range(6, 12)
        ),
    ],
)
def test_an_aircraft_taxies_to_the_runway(name, seed, severity):
    """Calm to moderate air with 5 m/s of wind: within an eighth of the taxiway's width, no excursion.

    The Aerosonde, whose 13 kg moderate gusts tip over, in light air with 2 m/s.

    It stops short of the runway for 5 s, then on the centerline. Turns, made for 1 m/s^2 to the side, stay
    below 1.5.
    """
    _, radius, width, speed = SIZES[name]
    wind = {"wind_speed": {0: 0.0, 3: 2.0, 4: 5.0}[severity], "wind_from": 2.0 * seed}
    truth = fly_here(from_stand(name, severity=severity, turbulence_seed=seed, **wind))
    assert exceedances(truth) == []
    craft = KINDS[name].aircraft
    along, right = center_of_gravity(truth, craft)
    assert off_the_way(name, along, right).max() < 0.125 * width
    over_ground = np.hypot(truth.vel_n[:, 0], truth.vel_n[:, 1])
    rate = np.abs(np.gradient(np.unwrap(rotation.to_euler(truth.q_nb)[2]), truth.t))
    assert over_ground.max() < speed + 1.0
    assert 0.8 < (over_ground * rate).max() < 1.5
    turns = over_ground[rate > 0.5 * (over_ground.clip(1.0) / radius)]
    assert turns.max() < 1.25 * radius**0.5
    _, hold, end, _ = (round(row[1] * 100) for row in truth.events.select("leg"))
    assert over_ground[hold - 480 : hold].max() < 0.05
    assert right[hold] == pytest.approx(-HOLD_SHORT[name], abs=1.0)
    assert along[hold] == pytest.approx(0.0, abs=0.1 * width)
    assert along[end] == pytest.approx(20.0 + radius, abs=1.0)
    assert abs(right[end]) < 0.05 * width
    assert abs(degrees(rotation.to_euler(truth.q_nb)[2][end] - ALONG)) < 2.0


# --- excursions -----------------------------------------------------------------------------------------


def found(stretch, taxiways=(), **changes) -> list[str]:
    runway = replace(RUNWAY, heading=radians(90.0), length=800.0)
    spec = replace(from_stand("navion"), runway=runway, **changes)
    watch = Exceedances(spec, MODEL, taxiways=taxiways)
    watch.add(stretch)
    return [text for _, _, _, text in watch.rows()]


def test_wheels_beside_a_taxiway_are_an_excursion():
    """A taxiway from 100 m north of the runway to the runway, 15 m wide; the runway is 40 m wide."""
    path = SegmentPath((100.0, 300.0), pi)
    path.straight(100.0)
    taxiway = [Taxiway(np.array(path.sample(0.5)), 15.0)]
    beside = on_wheels([70.0, 60.0, 50.0], [300.0, 311.2, 307.4])
    assert found(beside, taxiway) == [
        "taxiway excursion: 11.2 m off its centerline, beyond the edge at 7.5 m, for 0.05 s"
    ]
    assert found(on_wheels([70.0, 15.0, -19.0], [307.0, 330.0, 500.0]), taxiway) == []
    past = on_wheels([25.0, 25.0], [500.0, 500.0])  # nearer to the runway
    assert (
        found(past, taxiway)
        == found(past)
        == ["runway excursion: 25 m left of the centerline, beyond the edge at 20 m, for 0.1 s"]
    )


def test_a_stand_is_no_excursion():
    north = earth.local_ned(
        np.array([[from_stand("navion").lat, from_stand("navion").lon, GROUND]]), [LAT, LON, GROUND]
    )[0]
    assert found(on_wheels([north[0] + 29.0], [north[1]])) == []
    assert len(found(on_wheels([north[0] + 31.0], [north[1]]))) == 1
    assert len(found(on_wheels([north[0]], [north[1]]), on_ground=False)) == 1


def test_an_aircraft_that_taxies_by_a_wrong_estimate_leaves_the_taxiway():
    """The estimate drifts to 12 m beside the truth, on a taxiway of 15 m."""
    spec = from_stand("navion", aircraft=replace(NAVION, imu_b=(0.0, 0.0, 0.0)))
    belief, pieces = Belief("held", 0.05), []
    for piece in fly_pieces(spec, seconds=1.0, belief=belief):
        pieces.append(piece)
        wrong = min(12.0, 0.4 * piece.t[-1]) * np.array([sin(ALONG), -cos(ALONG), 0.0])
        one = SimpleNamespace(
            lla=earth.displace(piece.lla[-1], wrong)[None],
            vel_n=piece.vel_n[-1:],
            q_nb=piece.q_nb[-1:],
            gyro_bias_b=np.zeros((1, 3)),
        )
        belief.take(NavEstimate(float(piece.t[-1]), piece, one, np.zeros(3)))
    assert any("taxiway excursion: 1" in text for text in exceedances(pieces[-1]))


# --- what cannot be done --------------------------------------------------------------------------------


def test_a_turn_without_room_is_named():
    spec = from_stand("navion")
    stand, route, line_up, _ = spec.legs
    wide = replace(spec, legs=(stand, replace(route, radius=90.0)))
    with pytest.raises(FlightError, match=r"leg 2 taxi-route: .* point 1: a turn of -90 deg at 90 m radius"):
        fly(wide)
    wide = replace(spec, legs=(stand, route, replace(line_up, radius=60.0)))
    with pytest.raises(FlightError, match=r"line-up: .* no turn of 60 m radius onto the centerline"):
        fly(wide)


def test_what_rolls_along_the_runway_is_lined_up():
    spec = from_stand("navion")
    for leg in (TakeOff(40.0, 3.0, 46.0), Taxi(50.0)):
        with pytest.raises(FlightError, match=r"not along the runway, heading -?180 deg off: line-up comes"):
            fly(replace(spec, legs=(leg,)))


def test_a_narrow_taxiway_is_left():
    spec = from_stand("navion")
    narrow = replace(spec.legs[1], width=0.4)
    with pytest.raises(FlightError, match=r"leg 2 taxi-route: .* ran off the taxiway"):
        fly(replace(spec, legs=(spec.legs[0], narrow)))


def test_a_stand_beside_a_runway_is_read_from_a_profile():
    runway = {"lat_deg": 47.26, "lon_deg": 11.34, "alt_m": 600.0, "heading_deg": 85.0}
    beside = {f"runway.{key}": value for key, value in runway.items()}
    flight = read_profile("circuit", {**beside, "start.lat_deg": 47.261}).flight
    assert flight.on_ground
    assert hypot(flight.runway.lat - radians(47.26), flight.lat - radians(47.261)) < 1e-12
    with pytest.raises(
        ConfigError, match=r"\[start\] width_m = 30 m is not used: the runway is in \[runway\]"
    ):
        read_profile("circuit", {**beside, "start.width_m": 30.0})
    with pytest.raises(
        ConfigError, match=r"\[start\] alt_m = 600 m is not the height of the runway, alt_m = 610"
    ):
        read_profile("circuit", {**beside, "runway.alt_m": 610.0})
