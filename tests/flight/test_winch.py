"""A glider starts on the cable of a winch: work, speeds, loads and height of it, and what it cannot do."""

from __future__ import annotations

from dataclasses import replace
from math import cos, degrees, pi, sin

import numpy as np
import pytest
from numpy.testing import assert_allclose

from bench.core.mathematics.earth import difference_n, displace
from bench.core.mathematics.rotation import to_euler
from bench.core.records.flight_specs import FlightSpec, Leg
from bench.core.words.exceptions import ConfigError, FlightError
from bench.io.config import read_profile
from bench.simulation.flight import fly
from bench.simulation.flight.executive import load_aircraft
from bench.simulation.flight.guidance.sequencer import fly_legs
from bench.simulation.flight.legs.level import Straight
from bench.simulation.flight.legs.runway import Static
from bench.simulation.flight.legs.winch import Winch
from bench.simulation.flight.recorder import prepare
from bench.simulation.flight.standing import stand
from bench.simulation.flight.trimming import TrimCondition
from bench.simulation.flight.turbulence.wind import Weather
from tests.flight.inertial import replay

FT, LBF, G, MASS, AREA = 0.3048, 4.4482216, 9.807, 322.05, 13.073
STALL, FASTEST = 31 * 1852 / 3600, 110 / 3.6
"""Stall speed (all-aero.com) and the least design speed of a winch launch (CS 22.335): CAS [m/s]."""
PULL = 3000.0  # [N]
LAUNCH = read_profile("winch-launch").flight
COURSE = LAUNCH.heading
COLUMNS = {
    "v_n": ("velocities/v-north-fps", FT),
    "v_e": ("velocities/v-east-fps", FT),
    "v_d": ("velocities/v-down-fps", FT),
    "f_n": ("winch/north-lbs", LBF),
    "f_e": ("winch/east-lbs", LBF),
    "f_d": ("winch/down-lbs", LBF),
    "runner": ("winch/runner-lbsft", LBF * FT),
    "tension": ("winch/tension-n", 1.0),
    "angle": ("winch/angle-rad", 180 / pi),
    "lat": ("position/lat-geod-rad", 1.0),
    "lon": ("position/long-gc-rad", 1.0),
    "alt": ("position/geod-alt-ft", FT),
    "speed": ("velocities/vt-fps", FT),
    "cas": ("velocities/vc-kts", 1852 / 3600),
    "alpha": ("aero/alpha-rad", 180 / pi),
    "pitch": ("attitude/theta-rad", 180 / pi),
    "rate": ("velocities/q-rad_sec", 180 / pi),
    "bank": ("attitude/phi-rad", 180 / pi),
    "rho": ("atmosphere/rho-slugs_ft3", 515.3788),
    "wheel": ("gear/unit[0]/WOW", 1.0),
    "left_tip": ("contact/unit[3]/WOW", 1.0),
    "right_tip": ("contact/unit[4]/WOW", 1.0),
}


def calm(*legs: Leg, **changes: object) -> FlightSpec:
    return replace(LAUNCH, legs=legs, severity=0, wind_speed=0.0, thermals=None, **changes)


class Launch:
    """Columns of every step of a flight, and the rows on the cable in the air."""

    def __init__(self, spec: FlightSpec) -> None:
        fdm, cockpit = prepare(spec, 1 / 400)
        nodes = [fdm.get_property_manager().get_node(name) for name, _ in COLUMNS.values()]
        rows = []
        for _ in fly_legs(cockpit, spec, [], Weather(fdm, spec)):
            for _ in range(20):
                fdm.run()
                rows.append([node.get_double_value() for node in nodes])
        table = np.array(rows).T * np.array([[unit] for _, unit in COLUMNS.values()])
        self.columns = dict(zip(COLUMNS, table, strict=True))
        lifted = np.flatnonzero(self["wheel"])[-1] + 1 if self["wheel"].any() else 0
        self.lift_off, self.release = lifted, np.flatnonzero(self["tension"])[-1] + 1
        self.flown = slice(self.lift_off, self.release)

    def __getitem__(self, name: str) -> np.ndarray:
        return self.columns[name]

    @property
    def velocity(self) -> np.ndarray:
        return np.array([self["v_n"], self["v_e"], self["v_d"]])

    @property
    def force(self) -> np.ndarray:
        return np.array([self["f_n"], self["f_e"], self["f_d"]])

    def lift(self) -> np.ndarray:
        """Lift [N]: what the motion needs across the path in still air, less weight and cable."""
        across = MASS * np.gradient(self.velocity, 1 / 400, axis=1) - self.force
        across[2] -= MASS * G
        along = self.velocity / np.maximum(np.linalg.norm(self.velocity, axis=0), 0.1)
        return np.linalg.norm(across - along * np.sum(across * along, axis=0), axis=0)

    def gained(self) -> float:
        return self["alt"][self.release] - self["alt"][0]


WINDS = {"calm": (0.0, 0.0), "headwind": (COURSE, 6.0), "crosswind": (COURSE + pi / 2, 5.0)}


@pytest.fixture(scope="module", params=WINDS)
def launch(request) -> Launch:
    toward, speed = WINDS[request.param]
    return launch_in(toward, speed)


LAUNCHED: dict[tuple[float, float], Launch] = {}


def launch_in(wind_from: float, speed: float) -> Launch:
    """The launch of the profile in a wind, flown once."""
    if (wind_from, speed) not in LAUNCHED:
        legs = (Static(2.0), Winch(speed=27.0), Straight(8.0))
        LAUNCHED[wind_from, speed] = Launch(replace(calm(*legs), wind_from=wind_from, wind_speed=speed))
    return LAUNCHED[wind_from, speed]


def test_a_launch_across_the_date_line_is_like_any_other():
    """To the east, the winch on the other side: height and places as 30 degrees to the west."""
    height, east = [], []
    for lon in (pi - 50.0 / 6.4e6, pi - 0.5):
        one = Launch(calm(Static(2.0), Winch(), Straight(2.0), lon=lon, heading=pi / 2))
        height.append(one.gained())
        east.append(np.unwrap(one["lon"])[-1] - lon)
    assert height[0] == pytest.approx(height[1], abs=0.01)
    assert east[0] == pytest.approx(east[1], rel=1e-4)
    assert east[0] * 6.4e6 * cos(LAUNCH.lat) > 500.0


def test_the_work_of_the_cable_is_energy_and_drag():
    """In still air, by the published polar at the lift that the motion needs."""
    one = launch_in(*WINDS["calm"])
    air = one.flown
    work = np.sum(one.force * one.velocity, axis=0)[air].sum() / 400
    speed, pressure = one["speed"][air], 0.5 * one["rho"][air] * one["speed"][air] ** 2 * AREA
    lift = one.lift()[air] / pressure
    drag = (0.01544 - 0.00605 * lift + 0.02354 * lift**2) * pressure
    energy = MASS * (0.5 * speed**2 + G * one["alt"][air])
    gained = energy[-1] - energy[0]
    lost = np.sum(drag * speed) / 400
    assert lost > 0.05 * work
    assert_allclose(gained + lost, work, rtol=1e-3)


def test_the_cable_pulls_toward_the_winch():
    """The place of the winch by the ellipsoid: 1000 m ahead of the start, on the ground."""
    one = launch_in(*WINDS["calm"])
    lla = np.array([one["lat"], one["lon"], one["alt"]]).T[one.flown]
    ahead = np.array([[1000 * cos(COURSE), 1000 * sin(COURSE), 0.0]])
    winch = displace(np.array([LAUNCH.lat, LAUNCH.lon, 600.0]), ahead)[0]
    toward = difference_n(np.broadcast_to([*winch[:2], 600.0], lla.shape), lla)
    force = one.force[:, one.flown].T
    across = np.cross(force, toward) / np.linalg.norm(force, axis=1)[:, None]
    assert np.linalg.norm(across, axis=1).max() < 1.0  # passes the winch by so much [m]
    assert (np.sum(force * toward, axis=1) > 0).all()


def test_the_path_is_the_one_that_leaves_the_airspeed():
    """By hand, P = 0.95 W under a cable that falls by 45 deg: 21.9 deg, 1.7 less by a drag of 0.053 W."""
    one = launch_in(*WINDS["calm"])
    path = np.degrees(np.arcsin(-one["v_d"] / np.maximum(one["speed"], 0.1)))
    row = np.searchsorted(one["angle"][one.flown], 45.0) + one.lift_off
    assert_allclose(path[row], 21.9 - 1.7, atol=1.0)


def test_the_roll_takes_the_rest_of_the_work():
    """From rest: kinetic energy and a rolling friction of 0.03 of the weight on the wheel."""
    one = launch_in(*WINDS["calm"])
    rolled = slice(0, one.lift_off)
    work = np.sum(one.force * one.velocity, axis=0)[rolled].sum() / 400
    way = one["speed"][rolled].sum() / 400
    kinetic = 0.5 * MASS * one["speed"][one.lift_off] ** 2
    assert 0 < work - kinetic < 0.12 * MASS * G * way
    assert 20.0 < way < 40.0


def test_speeds_and_loads_are_those_of_a_winch_launch(launch):
    air = launch.flown
    assert launch["cas"][air].min() > 1.3 * STALL
    assert launch["cas"][air].max() < FASTEST
    assert launch["alpha"][air].max() < 12.0  # 16 at the stall
    assert 35.0 < launch["pitch"][air].max() < 50.0
    assert np.abs(launch["rate"][air]).max() < 15.0
    assert launch["tension"].max() <= PULL
    assert launch.lift()[air].max() < MASS * G + PULL
    steady = slice(launch.lift_off + 400 * 15, launch.release - 400 * 5)
    assert np.abs(launch["speed"][steady] - 27.0).max() < 2.0


def test_the_cable_gives_its_height(launch):
    assert 350.0 < launch.gained() < 500.0
    assert_allclose(launch["angle"][launch.release - 1], 75.0, atol=3.0)


def test_the_wings_stay_level_on_the_roll_and_the_way_straight(launch):
    rolled = slice(0, launch.lift_off)
    assert not launch["left_tip"].any()
    assert not launch["right_tip"].any()
    assert np.abs(launch["bank"][rolled]).max() < 2.0
    right = (launch["v_e"] * cos(COURSE) - launch["v_n"] * sin(COURSE)).cumsum() / 400
    assert abs(right[launch.lift_off]) < 1.0
    assert np.abs(right[: launch.release]).max() < 30.0


def test_nothing_pulls_after_the_release(launch):
    after = slice(launch.release, None)
    assert not launch.force[:, after].any()
    assert not launch["runner"][launch.lift_off :].any()
    assert np.ptp(launch["alt"][after]) < 30.0
    assert launch["speed"][after].min() > 1.3 * STALL


def test_nothing_pulls_in_a_flight_that_starts_in_the_air():
    spec = calm(Straight(2.0), on_ground=False, alt=1500.0, speed=24.0)
    fdm, cockpit = prepare(spec, 1 / 400)
    for _ in fly_legs(cockpit, spec, []):
        fdm.run()
        assert [fdm[COLUMNS[name][0]] for name in ("f_n", "f_e", "f_d", "runner")] == [0.0] * 4


@pytest.mark.parametrize("held", [True, False])
def test_a_wing_drops_unless_somebody_holds_it(held):
    """The tips are 0.95 m above the wheel, 7.03 m out: 7.7 deg."""
    fdm = load_aircraft(LAUNCH.aircraft, 1 / 400)
    fdm["ic/terrain-elevation-ft"] = 600.0 / FT
    stand(fdm, TrimCondition(LAUNCH.lat, LAUNCH.lon, 600.0, COURSE, 0.0, wind_n=(4.0, 0.0, 0.0)), held=held)
    assert_allclose(abs(degrees(fdm["attitude/phi-rad"])), 0.0 if held else 7.7, atol=0.6)
    assert fdm["contact/unit[3]/WOW"] + fdm["contact/unit[4]/WOW"] == (0.0 if held else 1.0)
    assert_allclose(fdm["position/h-agl-ft"] * FT, LAUNCH.aircraft.rest_height, atol=0.005 if held else 0.1)


def test_the_truth_of_a_launch_replays():
    truth = fly(calm(Static(5.0), Winch(to_height=200.0), Straight(5.0)))
    assert replay(truth, 200.0)[0] < 1e-3
    begun, end, text = truth.events.select("leg")[1]
    assert text == "2 winch: 1000 m of cable to 200 m above the start"
    released = truth.lla[np.searchsorted(truth.t, end), 2]
    assert_allclose(released - truth.lla[0, 2], 200.0, atol=10.0)
    felt = truth.dvel_b[:, 0] * 200.0
    assert 8.0 < felt[truth.t[1:] < begun + 8.0].max() < 10.0  # of the pull, 0.95 g


@pytest.mark.parametrize(
    ("leg", "wind", "message"),
    [
        (Winch(to_height=490.0), 0.0, r"490 m not reached: 1000 m of cable gave 3\d\d m; lay out more"),
        (Winch(speed=21.0), 0.0, r"not off the ground on 500 m of the cable, at 2\d m/s; a higher speed"),
        (Winch(), 16.5, r"a headwind of 1[67] m/s is too strong, at most 16 m/s at 26.6 m/s of airspeed"),
        (Winch(), -7.0, r"a tailwind of 7 m/s is too strong, at most 5 m/s; launch upwind"),
    ],
)
def test_a_launch_that_fails_says_why(leg, wind, message):
    with pytest.raises(FlightError, match=message):
        Launch(replace(calm(leg), wind_from=COURSE, wind_speed=wind))


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (
            {"leg.2.to_height_m": 760.0},
            "to_height_m = 760 m is above 0.75 of cable_m = 1000 m, the most",
        ),
        ({"leg.2.cable_m": 100.0}, "cable_m = 100 m is outside 400 to 3000 m"),
        ({"leg.2.speed_mps": 15.0}, "speed_mps = 15 m/s is outside 19 to 47 m/s of the sgs"),
        ({"leg.2.rope_m": 15.0}, "unknown key 'rope_m'"),
        ({"leg.3": {"kind": "winch"}}, "3 (winch): starts on the ground"),
        ({"leg.1": {"kind": "winch"}, "start.on_ground": False}, "1 (winch): starts on the ground"),
        ({"aircraft": "navion"}, "(winch): is flown by a glider, and the navion is none"),
        ({"aircraft": "hummingbird"}, "(winch): is flown by a glider, and the hummingbird is none"),
    ],
)
def test_wrong_launches_are_said_in_one_message(change, message):
    with pytest.raises(ConfigError) as raised:
        read_profile("winch-launch", overrides=change)
    assert message in str(raised.value)


def test_three_quarters_of_the_cable_may_be_asked_for():
    legs = read_profile("winch-launch", overrides={"leg.2.to_height_m": 750.0}).flight.legs
    assert legs[1] == Winch(cable=1000.0, to_height=750.0, speed=27.0)


@pytest.mark.long
@pytest.mark.parametrize(("severity", "attack", "bank"), [(3, 13.0, 10.0), (5, 25.0, 20.0)])
def test_launches_in_gusts_end_at_their_height(severity, attack, bank):
    """Winds of 0 to 6 m/s from ahead to abeam; light turbulence stays off the stall at 16 deg."""
    rng = np.random.default_rng(20260152)
    for seed in range(12):
        wind = {"wind_from": COURSE + rng.uniform(-pi / 2, pi / 2), "wind_speed": rng.uniform(0.0, 6.0)}
        legs = (Static(2.0), Winch(), Straight(8.0))
        truth = fly(replace(calm(*legs), severity=severity, turbulence_seed=seed, **wind))
        height = truth.lla[:, 2] - truth.lla[0, 2]
        high = np.interp(truth.air.t, truth.t, height) > 5.0
        assert np.degrees(truth.air.alpha[high]).max() < attack
        assert np.degrees(np.abs(to_euler(truth.q_nb)[0]).max()) < bank
        assert 330.0 < height[np.searchsorted(truth.t, truth.events.select("leg")[1][1])] < 520.0
