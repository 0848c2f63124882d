"""A glider holds its airspeed by its nose and sinks as its published polar says; thermals lift it."""

from __future__ import annotations

import itertools
import re
from dataclasses import replace
from math import hypot, pi, radians, sin, sqrt, tan
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose

import bench
from bench.core.mathematics.earth import difference_n
from bench.core.mathematics.rotation import to_euler
from bench.core.records.flight_specs import ThermalsSpec
from bench.core.words.exceptions import ConfigError, FlightError
from bench.io.config import read_profile
from bench.io.config.library import read_aircraft
from bench.simulation.flight import fly
from bench.simulation.flight.executive import load_aircraft
from bench.simulation.flight.guidance.paths import SegmentPath
from bench.simulation.flight.legs.level import Straight
from bench.simulation.flight.legs.soaring import CircleThermal, join_circle
from bench.simulation.flight.legs.turns import Turn
from bench.simulation.flight.trimming import TrimCondition, trim_aircraft
from bench.simulation.flight.turbulence.thermals import ThermalField, locate_thermals, outer_radius
from bench.simulation.signals import air

AIRCRAFT = Path(__file__).parents[2] / "aircraft"
KMH, KT = 1 / 3.6, 1852 / 3600
SOARING = read_profile("thermal-soaring").flight
GROUND = {"lat_deg": 47.26, "lon_deg": 11.34, "alt_m": 600.0, "heading_deg": 60.0, "on_ground": True}
DESERT = ThermalsSpec(w_star=2.56, depth=1401.0)


def glide(fdm, speed: float, alt: float = 300.0) -> tuple[float, float]:
    """Sink [m/s] and glide ratio at a calibrated airspeed [m/s], as if at sea level."""
    thinner = sqrt(1.225 / float(air.standard_atmosphere(alt)[2]))
    condition = TrimCondition(radians(47.0), radians(11.0), alt, 1.0, speed * thinner)
    found = trim_aircraft(fdm, condition, glides=True)
    assert found.residual < 1e-9
    assert found.throttle == 0.0
    assert max(abs(found.elevator), abs(found.aileron)) < 0.9
    return -speed * sin(found.climb_angle), -1 / tan(found.climb_angle)


def test_the_glider_sinks_as_the_published_polar_says():
    """The drag was made from the three points; glide ratio and least sink are of other sources."""
    fdm = load_aircraft(read_aircraft(AIRCRAFT / "sgs", AIRCRAFT), 1 / 400)
    for kmh, sink in ((75.98, 0.68), (132.96, 2.0), (170.95, 4.1)):
        assert_allclose(glide(fdm, kmh * KMH)[0], sink, rtol=0.003)
    assert_allclose(glide(fdm, 46 * KT)[1], 31.0, rtol=0.015)
    least = min(glide(fdm, kt * KT)[0] for kt in range(33, 46))
    assert_allclose(least, 0.67, rtol=0.06)
    assert glide(fdm, 31.5 * KT)[0] < 0.67  # it stalls at 31 kt
    assert glide(fdm, 30.5 * KT)[0] > 2.0
    low, high = glide(fdm, 24.0), glide(fdm, 24.0, alt=3000.0)
    assert_allclose(low, high, rtol=2e-3)  # the polar is one of calibrated airspeed


@pytest.fixture(scope="module")
def calm():
    """Straight, a turn of 360 deg and a faster straight, in still air."""
    legs = (Straight(30.0), Turn(by=2 * pi, bank=radians(30.0)), Straight(60.0, speed=30.0))
    return fly(replace(SOARING, legs=legs, severity=0, wind_speed=0.0, thermals=None))


def test_the_nose_holds_the_airspeed(calm):
    speed, t = calm.air.airspeed_true, calm.air.t
    legs = [(start, end) for start, end, _ in calm.events.select("leg")]
    assert np.abs(speed[t < legs[0][1]] - 24.0).max() < 0.01
    turning = (t > legs[1][0]) & (t < legs[1][1])
    assert np.abs(speed[turning] - 24.0).max() < 1.5
    assert_allclose(speed[t > legs[2][0] + 45.0], 30.0, atol=0.2)
    assert not np.any(calm.controls.throttle)
    assert not np.any(calm.air.engine_speed)


def test_banks_are_as_asked_and_the_rudder_keeps_the_string_straight(calm):
    roll = np.degrees(to_euler(calm.q_nb)[0])
    assert_allclose(roll.max(), 30.0, atol=3.0)
    assert np.degrees(np.abs(calm.air.beta)).max() < 5.0
    assert abs(roll[-1]) < 0.1


def test_energy_is_lost_to_drag_alone(calm):
    """The height of the total energy, V^2 / 2g + h, falls by V / (L/D), in the turn by more."""
    t = np.arange(1.0, calm.t[-1], 0.5)
    rows = np.searchsorted(calm.t, t - 1e-6)
    total = calm.lla[rows, 2] + np.sum(calm.vel_n[rows] ** 2, axis=1) / (2 * 9.807)
    rate = np.diff(total) / 0.5
    legs = [end for _, end, _ in calm.events.select("leg")]
    straight, turning = rate[t[1:] < legs[0]], rate[(t[1:] > legs[0] + 3) & (t[1:] < legs[0] + 12)]
    assert_allclose(straight, -0.77, atol=0.01)
    assert np.all(rate < -0.6)
    assert -1.2 < turning.mean() < straight.mean() - 0.1


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (
            {"leg.1": {"kind": "climb", "to_alt_m": 2000.0, "rate_mps": 1.0}},
            "(climb): needs an engine, and the sgs",
        ),
        (
            {"leg.1": {"kind": "take-off", "to_height_m": 50.0, "rate_mps": 2.0}},
            "(take-off): needs an engine, and the sgs is a glider",
        ),
        (
            {
                "leg.1": {
                    "kind": "waypoints",
                    "bank_deg": 30.0,
                    "points": [{"north_m": 900.0, "east_m": 900.0, "alt_m": 1500.0}],
                }
            },
            "points[0] alt_m = 1500 m: a glider holds no altitude; leave it out",
        ),
        (
            {"leg.1": {"kind": "hover", "duration_s": 9.0}},
            "is flown by a multirotor or a helicopter, and the sgs is none",
        ),
        (
            {"start": GROUND},
            "[[leg]] 1 (straight): is flown in the air; a winch must come before it",
        ),
        (
            {"terrain": {"file": "valley.asc"}},
            "[wind.thermals] stand on flat ground; leave [terrain] file out",
        ),
        (
            {"guidance": {"navigation": "loose-15"}},
            "fixed-wing aircraft fly by an estimate or commands; sgs does not",
        ),
    ],
)
def test_what_a_glider_cannot_fly_is_said_in_one_message(change, message):
    with pytest.raises(ConfigError) as raised:
        read_profile("thermal-soaring", overrides=change)
    assert message in str(raised.value)


PLAN = """
aircraft = "jsbsim:SGS"
rate_hz = 100
[start]
lat_deg = 47.0
lon_deg = 11.0
alt_m = 1200.0
heading_deg = 85.0
speed_mps = 24.0
[[leg]]
kind = "straight"
duration_s = 20.0
[[leg]]
kind = "turn"
by_deg = 60.0
bank_deg = 20.0
[sensors]
imu = "adis16475"
[[estimator]]
use = "free-inertial"
"""


def test_a_glider_of_the_jsbsim_wheel_flies_if_its_file_says_that_it_is_one(tmp_path):
    """It sinks by its own tables, by hand; of another kind it is asked for an engine.

    At 1200 m 24 m/s need a lift of 0.770, the elevator takes 0.014 of it, the wing gives it at 0.0713 rad,
    where the drag is 0.0007 + 0.0354: 1.126 m/s.
    """
    (tmp_path / "aircraft/jsbsim").mkdir(parents=True)
    (tmp_path / "plan.toml").write_text(PLAN)
    stands = (AIRCRAFT / "sgs/aircraft.toml").read_text()
    own = re.sub(r"\[stand\].*\nheight_m.*\n", "", stands).replace('"stand", ', "")
    sheet = tmp_path / "aircraft/jsbsim/SGS.toml"
    sheet.write_text(own)
    truth = fly(read_profile(tmp_path / "plan.toml").flight)
    sunk = truth.lla[0, 2] - truth.lla[np.searchsorted(truth.t, 15.0), 2]
    assert_allclose(sunk, 15 * 1.126, atol=0.1)
    assert np.abs(truth.air.airspeed_true - 24.0).max() < 1.0
    assert_allclose(np.degrees(to_euler(truth.q_nb)[2][-1]), 145.0, atol=3.0)
    sheet.write_text(own.replace('kind  = "glider"', ""))
    with pytest.raises(FlightError, match=r"no engine to hold a speed with; is it of kind = 'glider'\?"):
        fly(read_profile(tmp_path / "plan.toml").flight)
    sheet.write_text(stands)
    (tmp_path / "plan.toml").write_text(
        PLAN.replace("speed_mps = 24.0", "on_ground = true", 1).replace(
            "[[leg]]", "[[leg]]\nkind = 'winch'\n[[leg]]", 1
        )
    )
    with pytest.raises(FlightError, match=r'SGS: nothing holds its wings .* needs <system file="winch"/>'):
        fly(read_profile(tmp_path / "plan.toml").flight)


def test_a_thermal_leg_is_of_a_glider_and_needs_its_thermal():
    with pytest.raises(ConfigError, match=r"\(thermal\): is flown by a glider, and the aerosonde is none"):
        read_profile("thermal-soaring", overrides={"aircraft": "aerosonde"})
    leg = CircleThermal(1, 1800.0, 60.0, radians(40.0))
    with pytest.raises(ConfigError, match=r"\[\[leg\]\] 2 \(thermal\): needs \[wind\.thermals\]"):
        read_profile("thermal-soaring", overrides={"wind": {"from_deg": 0.0, "speed_mps": 0.0}})
    with pytest.raises(FlightError, match=r"number = 9999: there are \d+ thermals$"):
        fly(replace(SOARING, legs=(replace(leg, number=9999),), duration=None))


@pytest.mark.parametrize("side", [1, -1])
def test_the_way_to_a_circle_ends_on_it_along_its_tangent(side):
    rng = np.random.default_rng(20260151)
    for _ in range(200):
        center, course = tuple(rng.uniform(-800, 800, 2)), rng.uniform(-pi, pi)
        path = SegmentPath((0.0, 0.0), course)
        join_circle(path, center, 60.0, side)
        north, east = path.point[0] - center[0], path.point[1] - center[1]
        assert_allclose(hypot(north, east), 60.0, rtol=1e-6)
        across = north * np.cos(path.course) + east * np.sin(path.course)
        inward = side * (north * np.sin(path.course) - east * np.cos(path.course))
        assert abs(across) < 1e-3
        assert inward > 0  # the center is on the side of the turn
        assert path.length < hypot(*center) + 2 * pi * 60.0 + 120.0


def alone(thermals: ThermalsSpec) -> ThermalField:
    """One mean thermal at the origin of an area so large that nothing sinks."""
    field = ThermalField(thermals, 1)
    field.places, field.strengths, field.widths, field.side = np.zeros((1, 2)), np.ones(1), np.ones(1), 1e6
    return field


def test_a_thermal_has_the_size_and_speed_of_the_paper():
    """Allen's example of 280 m, and points of his figure 10 as the tests of glideslope have read them."""
    assert_allclose(outer_radius(280.0, DESERT), 79.4, atol=0.05)
    read = {
        (0.2, 0.0): 2.73,
        (0.4, 0.0): 2.42,
        (0.6, 0.0): 1.68,
        (0.8, 0.0): 0.65,
        (0.8, 160.0): -0.11,
        (0.2, 110.0): 0.0,
        (0.4, 120.0): 0.0,
    }
    field = alone(DESERT)
    for (share, away), speed in read.items():
        assert_allclose(field.vertical_wind(away, 0.0, share * 1401.0), speed, atol=0.05)


def test_the_profile_at_a_row_of_the_table_is_that_of_the_program():
    """q = 0.36 is a row: r_2 = 200 m, here at 0.2 z_i; by hand at r_2 / 2, and beyond the updraft nothing."""
    depth = 200.0 / (0.102 * 0.2 ** (1 / 3) * 0.95)
    mean = 2.0 * 0.2 ** (1 / 3) * 0.78
    core = 3 * mean * (1 - 0.36) / (1 - 0.36**3)
    by_hand = core * (1 / (1 + (1.4866 * abs(0.5 - 0.0320)) ** 4.8356) - 0.0818 * 0.5)
    field = alone(ThermalsSpec(w_star=2.0, depth=depth))
    assert_allclose(field.vertical_wind(0.0, 100.0, 0.2 * depth), by_hand, rtol=1e-4)
    assert abs(field.vertical_wind(0.0, 399.0, 0.2 * depth)) < 1e-5


@pytest.mark.parametrize("share", [0.02, 0.2, 0.5, 0.7, 0.88, 0.95])
def test_what_rises_sinks_elsewhere(share):
    """The mean over the square that repeats is zero; the grid resolves it to 1e-4 of what rises."""
    field, count = ThermalField(DESERT, 3), 420
    along = (np.arange(count) + 0.5) * field.side / count
    at = np.array([*itertools.product(along, along)])
    winds = np.concatenate([field.vertical_winds(part, share * 1401.0) for part in np.split(at, 84)])
    rising = winds[winds > 0].sum() / len(winds)
    assert abs(winds.mean()) <= 1e-4 * rising
    assert (rising > 0.01) == (share < 0.9)


def test_the_wind_of_thermals_has_no_step():
    """A step of half the length changes the wind half as much: along a line, and up through the layer."""
    field = ThermalField(DESERT, 3)
    for share in (0.3, 0.6, 0.89):
        most = []
        for step in (1.0, 0.5):
            way = np.arange(0.0, 2 * field.side, step)
            line = np.column_stack([0.31 * way, way])
            parts = [field.vertical_winds(part, share * 1401.0) for part in np.array_split(line, 40)]
            most.append(np.abs(np.diff(np.concatenate(parts))).max())
        assert most[1] < 0.55 * most[0] < 0.1
    for place in [*field.places[:3], (20.0, 40.0)]:
        most = []
        for step in (1.0, 0.5):
            heights = np.arange(20.0, 1400.0, step)
            most.append(np.abs(np.diff([field.vertical_wind(*place, height) for height in heights])).max())
        assert most[1] < 0.55 * most[0] < 0.1


def test_thermals_follow_from_the_seed():
    one, again, other = (ThermalField(DESERT, seed) for seed in (3, 3, 4))
    assert_allclose(one.places, again.places, rtol=0, atol=0)
    assert not np.allclose(one.places, other.places)
    assert one.vertical_wind(10.0, 20.0, 500.0) == again.vertical_wind(10.0, 20.0, 500.0)
    assert len(one.places) == round(0.6 * one.side**2 / (1401.0 * outer_radius(0.4 * 1401.0, DESERT)))
    near = np.array([(*place, SOARING.alt) for place in locate_thermals(SOARING)])
    away = np.hypot(*difference_n(near, np.array([SOARING.lat, SOARING.lon, SOARING.alt]))[:, :2].T)
    assert (np.diff(away) > -0.5).all()  # the Earth is round


def test_a_glider_rises_in_its_thermal_by_the_air_that_it_meets():
    """In calm air else: the recorded wind is the one of the field, less the sink of the polar the climb."""
    leg = CircleThermal(1, 1800.0, 90.0, radians(40.0), speed=22.5)
    truth = fly(replace(SOARING, legs=(Straight(5.0), leg), severity=0, wind_speed=0.0, duration=None))
    field = ThermalField(SOARING.thermals, SOARING.turbulence_seed)
    t = np.arange(12.0, truth.t[-1], 1.0)
    rows, airs = np.searchsorted(truth.t, t - 1e-6), np.searchsorted(truth.air.t, t - 1e-6)
    up = -truth.air.wind_n[airs, 2]
    north = (truth.lla[rows, 0] - SOARING.lat) * 6369e3
    east = (truth.lla[rows, 1] - SOARING.lon) * 6391e3 * np.cos(SOARING.lat)
    height = truth.lla[rows, 2] - 600.0
    assert_allclose(
        up, [field.vertical_wind(*row) for row in zip(north, east, height, strict=True)], rtol=0, atol=0.05
    )
    circling = t > truth.t[-1] - 60.0
    climb, speed = -truth.vel_n[rows, 2][circling].mean(), truth.air.airspeed_true[airs][circling].mean()
    load = 1 / np.cos(np.abs(to_euler(truth.q_nb[rows][circling])[0]).mean())
    lift = load * 241.6 / (0.5 * float(air.standard_atmosphere(1500.0)[2]) * speed**2)
    sink = load * speed * (0.01544 - 0.00605 * lift + 0.02354 * lift**2) / lift
    assert climb > 0.5
    assert_allclose(up[circling].mean() - climb, sink, atol=0.1)
    assert truth.events.select("leg")[1][2].split("; ")[-1].startswith("from ")


@pytest.mark.long
def test_a_filter_with_every_state_is_consistent_in_thermals():
    """Six runs, each within the 99.9 % band of its own mean."""
    for run in range(6):
        found = bench.run("thermal-soaring", run=run).metrics["loose-full"]
        assert found["nees_low"] < found["nees_mean"] < found["nees_high"]


@pytest.mark.long
def test_the_thermals_of_other_seeds_lift_it_too():
    """No stall, which is at 16 deg of incidence, and each of three thermals is left higher than entered."""
    for seed in range(1, 9):
        truth = fly(replace(SOARING, turbulence_seed=seed))
        assert np.degrees(truth.air.alpha).max() < 16.0
        climbs = [
            text.split("; from ")[1].split() for *_, text in truth.events.select("leg") if "; from" in text
        ]
        assert len(climbs) == 3
        assert all(float(end) > float(begin) + 50.0 for begin, _, end, _ in climbs)
