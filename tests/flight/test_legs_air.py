"""Turns to headings and at rates, S-turns, speeds, distances; wind by altitude, gusts, flaps; surfaces."""

import shutil
from dataclasses import replace
from math import atan, cos, degrees, pi, radians

import numpy as np
import pytest
from numpy.testing import assert_allclose

from bench.core.mathematics import earth, rotation
from bench.core.records.flight_specs import Gust, WindLayer
from bench.core.words.exceptions import FlightError
from bench.io.config import read_profile
from bench.simulation.flight import fly
from bench.simulation.flight.legs.climbs import Climb
from bench.simulation.flight.legs.level import Configuration, Cruise, SpeedChange, Straight
from bench.simulation.flight.legs.surfaces import AileronRoll, Doublet, WindUpTurn
from bench.simulation.flight.legs.turns import STurns, Turn
from tests.flight.plans import AEROSONDE, plan, roll, truth_of, turned

# --- by heading ---------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("heading", "side", "by"),
    [(175, "shorter", 90), (355, "shorter", -90), (175, "left", -270), (85, "shorter", 0)],
)
def test_a_turn_to_a_heading_takes_the_side_it_is_told(heading, side, by):
    legs = Turn(by=None, bank=radians(35.0), heading=radians(heading), side=side), Straight(6.0)
    truth = fly(plan(*legs))
    assert_allclose(turned(truth)[-1] - turned(truth)[0], by, atol=1.0)


def test_a_standard_rate_turn_turns_at_three_degrees_per_second():
    """By the bank of a coordinated turn; the side force of a little sideslip takes 4 % off it."""
    truth = fly(plan(Turn(by=pi, bank=None, rate=radians(3.0))))
    rate = np.diff(turned(truth)) / truth.t[1]
    middle = rate[len(rate) // 3 : 2 * len(rate) // 3]
    assert_allclose(middle, 3.0, atol=0.15)
    assert_allclose(roll(truth)[len(rate) // 2], degrees(atan(radians(3.0) * 25.0 / 9.81)), atol=1.0)


def test_a_rate_beyond_the_bank_of_the_aircraft_is_named():
    with pytest.raises(FlightError, match=r"leg 1 turn: .* 40 deg/s .* needs a bank of 61 deg; .* 45 deg"):
        fly(plan(Turn(by=pi, bank=None, rate=radians(40.0))))


def test_s_turns_swing_to_both_sides_and_end_on_the_course():
    truth = fly(plan(STurns(radians(40.0), radians(30.0), 2), Straight(5.0)))
    off = turned(truth) - 85.0
    assert_allclose([off.max(), off.min()], [40.0, -40.0], atol=4.0)
    assert_allclose(off[-1], 0.0, atol=1.0)
    crossings = np.sum(np.diff(np.sign(off[np.abs(off) > 10.0])) != 0)
    assert crossings == 3  # right, left, right, left


def test_airspeed_changes_smoothly_and_arrives():
    truth = fly(plan(SpeedChange(28.0), Straight(10.0, speed=23.0), Straight(10.0)))
    speed = truth.air.airspeed_true
    first = round(truth.events.select("leg")[0][1] * 20)
    assert_allclose(speed[first], 28.0, atol=0.6)
    assert_allclose(speed[-1], 23.0, atol=0.5)
    assert np.abs(np.diff(speed)).max() * 20 < 1.5  # [m/s^2]
    assert_allclose(truth.lla[:, 2], 1200.0, atol=6.0)


def test_a_cruise_is_as_long_over_ground_as_said():
    truth = fly(plan(Cruise(600.0), wind_from=radians(265.0), wind_speed=6.0))
    flown = np.linalg.norm(earth.difference_n(truth.lla[-1], truth.lla[0]))
    assert_allclose(flown, 600.0, atol=1.0)
    assert truth.t[-1] < 20.5  # at 31 m/s


# --- the air ------------------------------------------------------------------------------------------


def test_wind_layers_blow_by_altitude():
    layers = WindLayer(1200.0, radians(270.0), 2.0), WindLayer(1240.0, radians(180.0), 6.0)
    truth = fly(plan(Climb(1240.0, 3.0), Straight(2.0), wind_layers=layers))
    alt = np.interp(truth.air.t, truth.t, truth.lla[:, 2])
    share = np.clip((alt - 1200.0) / 40.0, 0.0, 1.0)
    # the wind of a time is written at its beginning: a climb of 3 m/s is 0.15 m late
    assert_allclose(truth.air.wind_n[1:, 0], 6.0 * share[1:], atol=0.05)
    assert_allclose(truth.air.wind_n[1:, 1], 2.0 * (1 - share[1:]), atol=0.05)


def test_a_gust_rises_and_falls_as_a_cosine_in_its_direction():
    gust = Gust(start=2.0, rise=1.0, hold=0.5, fall=2.0, air_n=(3.0, 0.0, -4.0))
    truth = fly(plan(Straight(8.0), gusts=(gust,)))
    wind, t = truth.air.wind_n, truth.air.t
    assert np.abs(wind[t < 2.0]).max() < 1e-9
    assert np.abs(wind[t > 5.6]).max() < 1e-9
    at = (t > 2.0) & (t < 3.0)
    shape = 0.5 * (1 - np.cos(pi * (t[at] - 2.0)))
    assert_allclose(wind[at], shape[:, None] * [3.0, 0.0, -4.0], atol=0.05)
    assert_allclose(wind[(t > 3.1) & (t < 3.4)], np.broadcast_to([3.0, 0.0, -4.0], (5, 3)), atol=0.05)
    calm = fly(plan(Straight(8.0)))
    assert np.abs(truth.vel_n[:, 2] - calm.vel_n[:, 2]).max() > 0.5  # it moves the aircraft


# --- surfaces -----------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("surface", "axis", "sign"), [("aileron", 0, 1), ("elevator", 1, -1), ("rudder", 2, -1)]
)
def test_a_doublet_moves_its_own_axis_to_both_sides_and_is_flown_out(surface, axis, sign):
    truth = fly(plan(Straight(1.0), Doublet(surface, 0.4, 0.5, 1, 6.0), Straight(10.0)))
    rate = truth.dtheta_b[:, axis] / truth.t[1]
    first = rate[140:190]  # while the surface is on its first side
    second = rate[195:240]
    assert sign * first[np.abs(first).argmax()] > 0.1
    assert sign * second[np.abs(second).argmax()] < -0.1
    deflected = getattr(truth.controls, surface)
    assert_allclose(np.ptp(deflected[20:60]), 0.8, atol=0.12)
    assert_allclose(turned(truth)[-1], 85.0, atol=3.0)
    assert_allclose(truth.lla[-1, 2], 1200.0, atol=3.0)


def test_an_aileron_roll_goes_all_the_way_around():
    truth = fly(plan(AileronRoll(-0.9, 1, radians(15.0), 3.0, speed=28.0)))
    around = np.rad2deg(np.unwrap(rotation.to_euler(truth.q_nb)[0]))
    assert_allclose(around[-1], -360.0, atol=3.0)
    assert np.diff(around).min() / truth.t[1] < -100.0  # [deg/s]
    assert_allclose(truth.lla[-1, 2], 1200.0, atol=5.0)


def test_a_wind_up_turn_reaches_its_load_factor_and_recovers():
    truth = fly(plan(WindUpTurn(radians(-72.0), 3.0, 5.0, 2.0, speed=28.0)))
    load = -truth.dvel_b[:, 2] / truth.t[1] / 9.80665
    assert_allclose(load.max(), 3.0, atol=0.2)
    assert roll(truth).min() < -65.0
    assert abs(roll(truth)[-1]) < 6.0


def test_a_load_factor_out_of_reach_is_named():
    with pytest.raises(FlightError, match=r"leg 1 wind-up-turn: .* a load factor of \d\.\d+ of 8 only"):
        fly(plan(WindUpTurn(radians(60.0), 8.0, 5.0, 2.0)))


def test_high_dynamics_is_what_it_says(recorded):
    """More than 100 deg/s of roll and 3 g."""
    spec = read_profile("high-dynamics").flight
    truth = truth_of(recorded(spec), spec.rate)
    assert np.rad2deg(np.abs(truth.dtheta_b[:, 0]).max() / truth.t[1]) > 100.0
    assert (-truth.dvel_b[:, 2]).max() / truth.t[1] / 9.80665 > 2.95


def test_flaps_move_where_there_are_any(tmp_path):
    """An Aerosonde with a flap that adds drag: an aircraft with a configuration, made for this test."""
    shutil.copytree(AEROSONDE.folder, tmp_path / "aerosonde")
    model = tmp_path / "aerosonde" / "aerosonde.xml"
    text = model.read_text()
    old = "<product> <value> 0.0135 </value> <property> fcs/elevator-pos-rad </property> </product>"
    new = "<product> <value> 0.03 </value> <property> fcs/flap-cmd-norm </property> </product>"
    assert old in text
    model.write_text(text.replace(old, old + new))
    craft = replace(AEROSONDE, folder=tmp_path / "aerosonde", configuration=("flaps",))
    truth = fly(plan(Straight(2.0), Configuration(1.0, None, 4.0), Straight(10.0), aircraft=craft))
    throttle = truth.controls.throttle
    assert throttle[-1] > throttle[20] + 0.05  # the drag has to be paid for
    assert np.abs(np.diff(throttle)).max() < 0.02
    assert_allclose(truth.air.airspeed_true[-1], 25.0, atol=0.7)
    assert cos(roll(truth)[-1]) > 0
