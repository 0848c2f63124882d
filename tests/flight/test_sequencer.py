"""Legs are flown as asked and smoothly; what cannot be flown says which leg and why."""

from dataclasses import replace
from itertools import pairwise
from math import radians

import numpy as np
import pytest
from numpy.testing import assert_allclose

from bench.core.records.data import Trajectory
from bench.core.words.exceptions import FlightError
from bench.simulation.flight import fly
from bench.simulation.flight.legs.climbs import Climb, Descend
from bench.simulation.flight.legs.level import Straight
from bench.simulation.flight.legs.turns import FigureEight, Turn
from tests.flight.plans import AEROSONDE, FIGURE_EIGHT, plan, roll, turned


def legs(truth: Trajectory) -> list[tuple[slice, str]]:
    """Samples of each leg, and its text."""
    rate = 1 / truth.t[1]
    return [(slice(round(a * rate), round(b * rate) + 1), text) for a, b, text in truth.events.select("leg")]


def test_legs_follow_each_other_without_gaps_on_instants_of_the_sequencer(figure_eight_truth):
    rows = figure_eight_truth.events.select("leg")
    assert [text.split()[0] for _, _, text in rows] == [str(k + 1) for k in range(len(FIGURE_EIGHT.legs))]
    assert rows[0][0] == 0.0
    assert rows[-1][1] == figure_eight_truth.t[-1] == 600.0
    for (_, end, _), (start, _, _) in pairwise(rows):
        assert start == end
        assert_allclose(end * 20, round(end * 20), rtol=0, atol=1e-9)


def test_every_leg_of_figure_eight_is_what_it_says(figure_eight_truth):
    """Altitude within 5 m and airspeed within 2 m/s all along; each leg ends where it should."""
    truth = figure_eight_truth
    heading, bank, alt = turned(truth), roll(truth), truth.lla[:, 2]
    assert_allclose(truth.air.airspeed_true, 25.0, atol=2.0)
    course, level = heading[0], 1200.0
    for leg, (at, text) in zip(FIGURE_EIGHT.legs, legs(truth), strict=True):
        match leg:
            case Climb() | Descend():
                assert_allclose(alt[at][-1], leg.to_alt, atol=2.0, err_msg=text)
                level = leg.to_alt
            case Turn():
                course += np.rad2deg(leg.by)
                assert_allclose(heading[at][-1], course, atol=2.0, err_msg=text)
                assert_allclose(np.abs(bank[at]).max(), np.rad2deg(leg.bank), atol=2.0, err_msg=text)
            case FigureEight():
                around = heading[at] - course
                assert_allclose([around.max(), around[-1]], [360.0, 0.0], atol=4.0, err_msg=text)
                assert_allclose(
                    [bank[at].max(), -bank[at].min()], np.rad2deg(leg.bank), atol=2.5, err_msg=text
                )
            case Straight():
                assert_allclose(heading[at][-1], course, atol=1.0, err_msg=text)
        if not isinstance(leg, Climb | Descend):
            assert_allclose(alt[at], level, atol=5.0, err_msg=text)


def test_the_climb_keeps_its_rate(figure_eight_truth):
    truth = figure_eight_truth
    at = next(at for at, text in legs(truth) if "climb" in text)
    climb = -truth.vel_n[at, 2]
    middle = climb[len(climb) // 3 : 2 * len(climb) // 3]
    assert_allclose(middle.mean(), 2.5, atol=0.2)


def test_onsets_are_smooth(short_truth):
    """From sample to sample the body rate changes by less than 0.02 rad/s: no set-point steps."""
    rate = short_truth.dtheta_b / 0.01
    assert np.abs(np.diff(rate, axis=0)).max() < 0.02
    assert np.abs(rate[:, 0]).max() > 0.2  # it did roll


def test_a_small_turn_rolls_no_further_than_it_can_roll_out_of():
    truth = fly(plan(Turn(radians(-6.0), radians(40.0)), Straight(15.0)))
    assert -15.0 < roll(truth).min() < -3.0
    assert_allclose(turned(truth)[-1], 85.0 - 6.0, atol=0.5)


def test_a_figure_eight_goes_right_then_left():
    truth = fly(plan(FigureEight(radians(40.0), 1)))
    heading = turned(truth) - 85.0
    top = int(heading.argmax())
    assert_allclose(heading[top], 360.0, atol=5.0)
    assert_allclose(heading[-1], 0.0, atol=2.0)
    assert np.diff(heading[:top]).min() > -0.05  # right until there ...
    assert np.diff(heading[top:-400]).max() < 0.05  # ... and left from there, but for catching the heading


def test_the_last_leg_is_held_to_the_duration():
    held = fly(plan(Straight(4.0), Turn(radians(20.0), radians(20.0)), duration=30.0))
    assert held.t[-1] == 30.0
    assert held.events.select("leg")[-1][1:] == (30.0, "2 turn: 20 deg right, bank 20 deg, then held to 30 s")
    assert_allclose(turned(held)[-1], 105.0, atol=0.5)
    free = fly(plan(Straight(4.0), Turn(radians(20.0), radians(20.0))))
    assert 5.0 < free.t[-1] < 15.0
    assert "held" not in free.events.select("leg")[-1][2]


def test_legs_that_need_longer_than_the_duration_say_how_long():
    with pytest.raises(FlightError, match="the legs need 8 s; duration is 5 s") as caught:
        fly(plan(Straight(3.0), Straight(5.0), duration=5.0))
    assert "\n" not in str(caught.value)
    assert fly(plan(Straight(3.0), Straight(5.0), duration=8.0)).t[-1] == 8.0


# --- what cannot be flown -----------------------------------------------------------------------------


def test_an_altitude_out_of_reach_is_named():
    """A guidance that may climb at 0.1 m/s only does not get there."""
    sluggish = replace(AEROSONDE, max_climb=0.1)
    with pytest.raises(
        FlightError, match=r"^leg 2 climb: to 1300 m at 3 m/s: at \d+\.\d s: 1300 m not reached in"
    ):
        fly(plan(Straight(1.0), Climb(1300.0, 3.0), aircraft=sluggish))


def test_the_ground_is_named():
    with pytest.raises(
        FlightError, match=r"^leg 1 descend: .* flew into the ground: at \d m, climbing -[23]\.\d m/s"
    ):
        fly(plan(Descend(-50.0, 3.0), alt=30.0))


@pytest.mark.parametrize(
    ("gain", "value", "message"),
    [
        ("bank-gain", -5.0, r"^leg 1 turn: .*: outside the envelope: upset to a bank of -?\d+ deg$"),
        (
            "speed-gain",
            -0.5,
            r"^leg \d .*: outside the envelope: airspeed \d+\.\d m/s is not in 5\.0 to 58\.0$",
        ),
    ],
)
def test_a_flight_out_of_control_is_named(gain, value, message):
    wild = replace(AEROSONDE, gains={**AEROSONDE.gains, gain: value})
    with pytest.raises(FlightError, match=message):
        fly(plan(Turn(radians(90.0), radians(30.0)), Straight(300.0), aircraft=wild, severity=2))


@pytest.mark.parametrize("gain", ["bank-lag-rad_sec", "pitch-lag-rad_sec", "climb-gain"])
def test_a_gain_the_sequencer_needs_cannot_be_zero(gain):
    with pytest.raises(FlightError, match=f"aircraft aerosonde: gain {gain} must be above 0; it is 0"):
        fly(plan(Straight(1.0), aircraft=replace(AEROSONDE, gains={**AEROSONDE.gains, gain: 0.0})))


# --- wind and turbulence ------------------------------------------------------------------------------


def test_wind_from_behind_is_ground_speed():
    behind = fly(plan(Straight(2.0), heading=radians(90.0), wind_from=radians(270.0), wind_speed=5.0))
    assert_allclose(behind.vel_n, np.broadcast_to([0.003, 30.0, 0.0], behind.vel_n.shape), atol=0.05)
    across = fly(plan(Straight(2.0), heading=0.0, wind_from=radians(270.0), wind_speed=5.0))
    assert_allclose(across.vel_n, np.broadcast_to([25.0, 5.0, 0.0], across.vel_n.shape), atol=0.05)


def test_more_severe_turbulence_moves_the_flight_more_and_the_seed_decides_how():
    def vertical(severity: int, seed: int = 1) -> np.ndarray:
        return fly(plan(Straight(40.0), severity=severity, turbulence_seed=seed)).vel_n[:, 2]

    calm, light, moderate, severe = (vertical(severity).std() for severity in (0, 3, 4, 6))
    assert calm < 0.01
    assert 0.1 < light < moderate < severe
    other = vertical(3, seed=2)
    assert np.abs(vertical(3) - other).max() > 0.5
    assert (vertical(3, seed=2) == other).all()


def test_a_turn_a_climb_and_an_eight_are_flown_in_moderate_turbulence():
    truth = fly(replace(FIGURE_EIGHT, severity=4, legs=FIGURE_EIGHT.legs[:4], duration=None))
    assert len(truth.events.select("leg")) == 4
    assert np.abs(turned(truth)[-1] - turned(truth)[0]) > 1.0
    assert truth.air.airspeed_true.min() > 15.0
