"""A helicopter: its published model written anew, its hover, what it flies and holds; its truth."""

from __future__ import annotations

import dataclasses
from math import cos, pi, radians, sin, sqrt

import numpy as np
import pytest
from numpy.testing import assert_allclose

from bench.core.records.flight_specs import LegStart
from bench.core.words.exceptions import FlightError
from bench.io.config.library import read_aircraft
from bench.simulation.flight.executive import load_aircraft
from bench.simulation.flight.hover_trim import trim_hover
from bench.simulation.flight.legs.climbs import Climb, Descend
from bench.simulation.flight.legs.keys import check_leg
from bench.simulation.flight.legs.level import Straight
from bench.simulation.flight.legs.rotors import Goto, Hover, Land, Orbit, Sprint, Yaw
from bench.simulation.flight.legs.runway import Static, TakeOff
from bench.simulation.flight.recorder import prepare
from tests.flight.inertial import replay
from tests.flight.plans import fly_here
from tests.flight.test_aircraft_files import AIRCRAFT
from tests.flight.test_multirotor import PAD, Flown, hold_in_moderate_air, plan, shifted, turned_by_lift_off
from tests.flight.test_rotor_forces import ALOFT, loads

HELION = read_aircraft(AIRCRAFT / "helion", AIRCRAFT)
MASS, OMEGA, GRAVITY = 9.75, 193.73, 9.781


def expected_loads(rho, air, collective, right, back, tail):
    """Forces [N] and moments [N m] of the source without rates of the body, inflow by its own iteration."""
    u, v, w = air

    def rotor(along, across2, blade, radius, slope):
        inflow = 5.0
        for _ in range(500):
            nu = 0.5 * (across2 + along * (along - 2.0 * inflow))
            load = slope * (blade - inflow) / (2.0 * rho * pi * radius**2)
            inflow += 0.3 * (sqrt(sqrt(nu * nu + load * load) - nu) - inflow)
        return slope * (blade - inflow), inflow

    along = u * back - v * right + w
    blade = along + 2.0 * OMEGA * 0.705 * collective / 3.0
    slope = rho * OMEGA * 0.705**2 * 5.5218 * 2 * 0.062 / 4.0
    thrust, inflow = rotor(along, u * u + v * v, blade, 0.705, slope)
    x = -0.5 * rho * 0.1026 * u * max(abs(u), inflow)
    y = -0.5 * rho * 0.9 * v * max(abs(v), inflow)
    z = -0.5 * rho * 0.084 * (w - inflow) * abs(w - inflow)
    tip = OMEGA * 0.705
    power = 0.5 * rho * 0.01 * 2 * 0.062 * (0.705 / 4.0) * tip * (tip**2 + 4.6 * (u * u + v * v))
    power += thrust * inflow + MASS * GRAVITY * abs(min(w, 0.0)) - x * u - y * v - z * (w - inflow)
    turning = OMEGA * 4.65
    slope = rho * turning * 0.128**2 * 2.8214 * 2 * 0.029 / 4.0
    pull, _ = rotor(v, u * u + w * w, v + 2.0 * turning * 0.128 * tail / 3.0, 0.128, slope)
    fins = []
    for area, motion in ((0.011, w - inflow), (0.0072, v)):
        lifts = abs(motion) <= 0.3 * abs(u)
        fins.append(-0.5 * rho * area * motion * (2.865 * abs(u) if lifts else abs(motion)))
    side, aft = thrust * sin(right), thrust * sin(back)
    force = [x - aft, side + y - pull + fins[1], z - thrust * cos(back) * cos(right) + fins[0]]
    roll = side * 0.337 + 113.7942 * right - pull * 0.172 + fins[1] * 0.184
    pitch = aft * 0.337 + 113.7942 * back + fins[0] * 0.751
    yaw = -power / OMEGA + pull * 1.035 - fins[1] * 0.984
    return np.array(force), np.array([roll, pitch, yaw])


@pytest.mark.parametrize("wind", [(0.0, 0.0, 0.0), (-4.0, 3.0, 0.5), (-11.0, -2.0, -1.0), (6.0, 0.0, 1.0)])
def test_its_loads_are_those_of_the_source(wind):
    blades = (0.11, 0.02, -0.03, 0.16)
    force, moment, air = loads(HELION, blades, wind, roll=0.05, pitch=-0.1, density="rotor/density-kg_m3")
    rho = 1.225 * (1.0 - 2.25577e-5 * 100.0) ** 4.2559
    expected = expected_loads(rho, air, *blades)
    assert_allclose(force * rho, expected[0], rtol=2e-4, atol=0.01)
    assert_allclose(moment * rho, expected[1], rtol=2e-4, atol=0.01)


def test_its_hover_is_the_hover_that_the_source_lists():
    """Roll 0.0389 and pitch 0.000887 rad, flapping -0.000874 back and 0.0048 right, in denser air."""
    found = trim_hover(load_aircraft(HELION, 1 / 400), ALOFT, HELION.max_bank)
    assert found.residual < 1e-9
    assert found.roll == pytest.approx(0.0389, rel=0.02)
    assert found.pitch == pytest.approx(0.000887, rel=0.02)
    assert found.commands[1] == pytest.approx(0.0048, rel=0.03)
    assert found.commands[2] == pytest.approx(-0.000874, rel=0.02)


def test_the_disk_follows_its_cyclic_and_the_rates_as_the_source_says():
    """Euler steps of the two equations of the source beside the model, which its loads turn."""
    fdm = load_aircraft(HELION, 1 / 400)
    trim_hover(fdm, ALOFT, HELION.max_bank)
    fdm["guidance/direct-share"] = 0.0
    lag, blade, cross, gain = 0.2970931, 0.0565424, 0.2219857, 0.77
    for _ in range(5):  # until the law has the blades
        fdm.run()
    right, back = fdm["rotor/flap-right-rad"], fdm["rotor/flap-back-rad"]
    errors, moved = [], 0.0
    for _ in range(120):
        p, q = fdm["velocities/p-rad_sec"], fdm["velocities/q-rad_sec"]
        fdm.run()
        lateral, longitudinal = (fdm[f"guidance/cyclic-{side}-cmd"] for side in ("right", "back"))
        rate_right = (gain * lateral - lag * p - blade * cross * back - right) / lag
        rate_back = (gain * longitudinal - lag * q + blade * cross * right - back) / lag
        right, back = right + rate_right / 400, back + rate_back / 400
        errors.append(abs(right - fdm["rotor/flap-right-rad"]) + abs(back - fdm["rotor/flap-back-rad"]))
        moved = max(moved, abs(right - 0.0049) + abs(back))
    assert moved > 0.004
    assert max(errors) < 0.05 * moved


TOUR = (
    Static(2.0),
    TakeOff(to_height=10.0, rate=2.0),
    Hover(8.0),
    Goto(north=40.0, east=0.0, speed=6.0, accel=2.0),
    Yaw(radians(-120.0), radians(45.0)),
    Orbit(radius=20.0, speed=5.0),
    Sprint(distance=130.0, speed=12.0, accel=2.5),
    Hover(4.0),
    Climb(630.0, 3.0),
    Descend(612.0, 1.5),
    Land(),
    Static(2.0),
)


@pytest.fixture(scope="module")
def tour() -> Flown:
    return Flown(fly_here(plan(*TOUR, on_ground=True, aircraft=HELION)))


def test_a_calm_tour_keeps_its_bounds(tour):
    """A hover 0.05 m, 6 m/s 0.5 m, a sprint 1 m across the way; it hangs 2.2 deg to the right of level."""
    rest = HELION.rest_height
    hover = tour.ned[tour.leg(3)]
    assert np.abs(hover[400:] - [0.0, 0.0, rest - 10.0]).max() < 0.05
    assert np.rad2deg(tour.roll[tour.leg(3)][-1]) == pytest.approx(2.2, abs=0.05)
    north = tour.ned[tour.leg(4)]
    assert np.abs(north[:, 1]).max() < 0.5
    assert np.abs(north[-1] - [40.0, 0.0, rest - 10.0]).max() < 0.1
    rows = tour.leg(6)
    course = tour.heading[rows][0]
    center = tour.ned[rows][0, :2] + 20.0 * np.array([cos(course), sin(course)])
    assert np.abs(np.hypot(*(tour.ned[rows][:, :2] - center).T) - 20.0).max() < 0.5
    sprint, course = tour.ned[tour.leg(7)], tour.heading[tour.leg(7)][0]
    across = (sprint - sprint[0]) @ [-np.sin(course), np.cos(course), 0.0]
    assert np.abs(across).max() < 1.0
    assert np.ptp(sprint[:, 2]) < 0.5
    assert -tour.ned[tour.leg(9)][-1][2] == pytest.approx(30.0 - rest, abs=0.05)
    assert abs(tour.ned[-1][2]) < 0.005
    assert tour.tilt().max() < 30.5
    assert not tour.truth.air.engine_speed.std()


def test_a_calm_flight_replays_to_a_tenth_of_a_millimeter_in_the_air(tour):
    first, last = tour.leg(3).start, tour.leg(10).stop
    truth = tour.truth
    air = dataclasses.replace(
        truth,
        **{name: getattr(truth, name)[first:last] for name in ("t", "lla", "vel_n", "q_nb")},
        **{name: getattr(truth, name)[first : last - 1] for name in ("dtheta_b", "dvel_b")},
    )
    assert replay(shifted(air), 200.0)[0] < 1e-4
    assert replay(truth, 200.0)[0] < 5e-3


def test_moderate_air_is_held():
    rms, largest = hold_in_moderate_air(HELION, 3)
    assert 0.01 < rms < 0.5
    assert largest < 1.5


@pytest.mark.long
@pytest.mark.parametrize("wind", [0.0, 5.0])
def test_moderate_air_is_held_over_ten_seeds(wind):
    found = np.array([hold_in_moderate_air(HELION, seed, wind) for seed in range(10)])
    assert (found < [0.5, 1.5]).all(), found


def test_a_lift_off_in_wind_keeps_its_heading():
    turned, flown = turned_by_lift_off(aircraft=HELION)
    assert 0.01 < turned < 3.0
    assert np.hypot(*flown.ned[-1, :2]) < 0.05


@pytest.mark.long
def test_a_lift_off_in_wind_and_moderate_air_keeps_its_heading_over_ten_seeds():
    """On the ground its blades press it down, so that no gust turns it round on its skids."""
    air = {"aircraft": HELION, "severity": 4}
    assert max(turned_by_lift_off(turbulence_seed=seed, **air)[0] for seed in range(10)) < 3.0


def test_its_legs_are_those_that_hover():
    start, found = LegStart(HELION, 600.0, PAD, "ground"), []
    for leg in TOUR:
        found += check_leg(leg, start)
        start = dataclasses.replace(start, alt=leg.alt_after(start), after=leg.leaves)
    assert found == []
    refused = check_leg(Straight(5.0), LegStart(HELION, 600.0, PAD, "air"))
    assert any("is flown by an aircraft with wings, and the helion is none" in line for line in refused)


def test_a_figure_that_its_model_lacks_is_named(tmp_path):
    folder = tmp_path / "aircraft" / "kite"
    folder.mkdir(parents=True)
    for shipped, name in (("helion.xml", "kite.xml"), ("aircraft.toml", "aircraft.toml")):
        text = (AIRCRAFT / "helion" / shipped).read_text()
        (folder / name).write_text(text.replace('"0.705"', '"0"'))
    with pytest.raises(FlightError, match="aircraft kite: rotor/main-radius-m must be above 0; it is 0"):
        prepare(plan(Hover(1.0), aircraft=read_aircraft(folder, AIRCRAFT)), 1 / 400)
