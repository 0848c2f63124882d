"""Runway excursion, hard landing, stall, overspeed: by hand, in flights that have them, and in none other."""

from dataclasses import replace
from math import radians
from types import SimpleNamespace

import numpy as np
import pytest

from bench.core.mathematics import earth
from bench.core.records.flight_specs import EnvelopeSpec, Gust
from bench.core.words.exceptions import ConfigError
from bench.io.config import read_profile
from bench.simulation.flight.exceedances import Exceedances, limit_sink
from bench.simulation.flight.guidance.belief import Belief, NavEstimate
from bench.simulation.flight.increments import Motion
from bench.simulation.flight.legs.landing import Approach, Flare, LandingRoll
from bench.simulation.flight.legs.level import Straight
from bench.simulation.flight.legs.turns import Turn
from bench.simulation.flight.recorder import fly_pieces
from bench.simulation.flight.truth import Stretch
from tests.flight.pilot import find_excess, look_at
from tests.flight.plans import CALM, fly_here, plan, record_whole
from tests.flight.test_legs_ground import ALONG, JET, KINDS, NAVION, RUNWAY, final, runway_frame

MODEL = {"inertia/weight-lbs": 2750.0, "metrics/Sw-sqft": 184.0}
FINE = (101325.0, 288.15, 50.0, 50.0, 0.05, *[0.0] * 9)
"""Air at sea level: pressure, temperature, airspeeds, angle of attack."""


def found_in(stretches, **changes) -> list[str]:
    """Exceedances of segments, on a runway towards the east."""
    east = replace(RUNWAY, heading=radians(90.0))
    spec = replace(CALM, **{"aircraft": NAVION, "runway": east, **changes})
    watch = Exceedances(spec, MODEL)
    for stretch in stretches:
        assert watch.add(stretch) is stretch
    return [text for _, _, _, text in watch.rows()]


def on_wheels(north, east) -> Stretch:
    """Wheels on the ground at places of the center of gravity [m] from the threshold, a row each 50 ms."""
    north, east = np.broadcast_arrays(np.asarray(north, float), np.asarray(east, float))
    n = len(north)
    ned = np.column_stack([north, east, np.zeros(n)]) + NAVION.imu_b  # attitude: level, to the north
    C_en = earth.matrix_en(RUNWAY.lat, RUNWAY.lon)
    pos = earth.to_ecef([RUNWAY.lat, RUNWAY.lon, RUNWAY.alt]) + ned @ C_en.T
    level = np.tile([1.0, 0.0, 0.0, 0.0], (n, 1))
    motion = Motion(0.05, np.zeros(n), pos, np.zeros((n, 3)), level, level)
    ground = np.tile([1.0, 0.0, 1.0, 0.0], (n, 1))
    return Stretch(0, motion, np.tile(FINE, (n, 1)), ground)


def in_the_air(n: int = 60, **columns) -> Stretch:
    """Flight with some columns of the air other ones: ``attack``, ``true`` and so on."""
    air = np.tile(FINE, (n, 1))
    names = ("pressure", "temperature", "true", "calibrated", "attack")
    for name, values in columns.items():
        air[:, names.index(name)] = values
    return replace(on_wheels(np.zeros(n), 500.0), air=air, ground=np.tile([100.0, 0.0, 0.0, 0.0], (n, 1)))


# --- by hand --------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("north", "east", "said"),
    [
        ([19.9, -19.9, 0.0], [500.0, 500.0, -0.9], []),
        ([0.0, 91.0, 50.0], 500.0, ["91 m left of the centerline, beyond the edge at 20 m, for 0.1 s"]),
        ([-30.0, -20.1], 500.0, ["30 m right of the centerline, beyond the edge at 20 m, for 0.1 s"]),
        ([0.0, 0.0], [-12.0, -1.1], ["12 m before the threshold, for 0.1 s"]),
        ([0.0, 0.0], [799.0, 830.0], ["30 m beyond the end of 800 m, for 0.05 s"]),
    ],
)
def test_wheels_beside_or_beyond_the_runway_are_an_excursion(north, east, said):
    runway = replace(RUNWAY, heading=radians(90.0), length=800.0)
    assert found_in([on_wheels(north, east)], runway=runway) == [f"runway excursion: {text}" for text in said]
    assert found_in([on_wheels(north, east)], runway=None) == []
    above = replace(on_wheels(north, east), ground=np.zeros((len(north), 4)))
    assert found_in([above], runway=runway) == []  # flown over


def test_width_and_end_are_those_of_the_runway():
    rolled = on_wheels([8.0, 8.0], [100.0, 2000.0])
    assert found_in([rolled]) == []  # 40 m wide, without a stated end
    narrow = replace(RUNWAY, heading=radians(90.0), width=15.0)
    assert "left of the centerline, beyond the edge at 7.5 m" in found_in([rolled], runway=narrow)[0]


def test_the_limit_of_the_sink_is_the_one_of_the_rule():
    """By hand: 2750 lb on 184 ft^2 are 14.95 lb/ft^2, whose fourth root is 1.966; 4.4 of it are 8.65 ft/s."""
    assert limit_sink("light", 2750 / 184)[0] == pytest.approx(8.65 * 0.3048, abs=2e-3)
    assert limit_sink("uav", 4.1)[0] == pytest.approx(7 * 0.3048)  # 6.26 ft/s, but 7 are the least
    assert limit_sink("light", 40.0)[0] == limit_sink("transport", 120.0)[0] == pytest.approx(3.048)


def test_a_touch_down_is_hard_by_the_sink_before_it():
    """The gear stops the sink within the 50 ms; a hop and what rolls sinks as it may."""
    ground = np.array([[3, 2.7, 0, 0], [1, 0.4, 1, 0], [1, 5.0, 1, 0], [1, 0.5, 0, 0], [1, 0.1, 1, 0]], float)
    stretch = replace(on_wheels(np.zeros(5), 500.0), ground=ground)
    said = "hard landing: touch-down at 2.70 m/s, beyond 2.64 m/s of 14 CFR 23.473(d), once"
    assert found_in([stretch]) == [said]
    soft = ground.copy()
    soft[0, 1] = 2.6
    assert found_in([replace(stretch, ground=soft)]) == []
    parts = [replace(on_wheels(np.zeros(1), 500.0), ground=row[None]) for row in ground]
    assert found_in(parts) == [said]  # where two segments meet, too


def test_a_stall_is_of_what_flies():
    limit = np.rad2deg(NAVION.envelope.stall)
    said = f"stall: angle of attack up to 17.2 deg, beyond {limit:.4g} deg, for 0.5 s"
    attack = np.where(np.arange(60) < 10, 0.3, 0.19)
    assert found_in([in_the_air(attack=attack)]) == [said]
    assert found_in([in_the_air(attack=0.19)]) == []
    rolling = in_the_air(attack=0.3)
    hops = np.where(np.arange(60) % 15 == 0, 1.0, 0.0)  # off the wheels for 0.7 s at a time
    hopping = np.column_stack([np.ones(60), np.zeros(60), hops, np.zeros(60)])
    assert found_in([replace(rolling, ground=hopping)]) == []
    unknown = replace(NAVION, envelope=EnvelopeSpec())
    watch = Exceedances(replace(CALM, aircraft=unknown), MODEL)
    watch.add(rolling)
    assert watch.rows() == []


@pytest.mark.parametrize(
    ("limit", "columns", "most"),
    [  # the standard atmosphere at 11 000 m: 22 632 Pa, 216.65 K, 0.36391 kg/m^3, sound 295.07 m/s
        (
            {"max_mach": 0.92},
            {"pressure": 22632.0, "temperature": 216.65, "true": 271.46},
            "Mach up to 0.921",
        ),
        ({"max_eas": 192.9}, {"pressure": 22632.0, "temperature": 216.65, "true": 353.92}, "equivalent"),
        ({"max_cas": 70.0}, {"calibrated": 70.0}, "calibrated airspeed up to 70.1 m/s"),
    ],
)
def test_overspeed_is_measured_as_its_limit_is(limit, columns, most):
    """A thousandth below the limit there is none."""
    speed = "calibrated" if "max_cas" in limit else "true"
    aircraft = replace(NAVION, envelope=EnvelopeSpec(**limit))
    for factor in (0.999, 1.001):
        watch = Exceedances(replace(CALM, aircraft=aircraft), MODEL)
        watch.add(in_the_air(**{**columns, speed: columns[speed] * factor}))
        assert [most in text for _, _, _, text in watch.rows()] == [True] * (factor > 1)


def test_what_is_not_finite_exceeds_nothing():
    assert found_in([in_the_air(attack=np.nan, temperature=np.inf, true=np.inf)]) == []


# --- in flights -----------------------------------------------------------------------------------------


def landed(**changes):
    """A landing of the Navion in calm air, from half a minute before."""
    kind = KINDS["navion"]._replace(before=(1300.0, 60.0))
    legs = Approach(radians(3.5), 60.0), Flare(), LandingRoll(0.1)
    return plan(*legs, **{**final(kind), **changes})


def exceedances(truth) -> list[str]:
    return [text for _, _, text in truth.events.select("exceedance")]


def test_a_landing_is_silent_and_the_same_one_on_a_runway_elsewhere_is_not():
    """As far beside that one as it is displaced, and beyond an end as far as the aircraft rolls."""
    spec = landed()
    stretch = record_whole(spec)
    assert [row for row in stretch.events if row[2] == "exceedance"] == []
    truth = fly_here(spec)
    stop = runway_frame(truth)[0][-1] - NAVION.imu_b[0]  # of the center of gravity
    beside = earth.displace(
        [RUNWAY.lat, RUNWAY.lon, RUNWAY.alt], 91.0 * np.array([np.sin(ALONG), -np.cos(ALONG), 0])
    )
    lat, lon, _ = (float(v) for v in beside)
    for runway, wanted in (
        (replace(RUNWAY, lat=lat, lon=lon), "91 m right of the centerline"),
        (replace(RUNWAY, length=200.0), f"{stop - 200.0:.0f} m beyond the end of 200 m"),
    ):
        watch = Exceedances(replace(spec, runway=runway), MODEL)
        watch.add(stretch)
        (row,) = watch.rows()
        assert wanted in row[3]


def test_a_landing_by_a_wrong_estimate_is_an_excursion():
    """The estimate is 91 m to the left of the truth: guidance lands that far to the right."""
    spec = landed(aircraft=replace(NAVION, imu_b=(0.0, 0.0, 0.0)))
    belief = Belief("held", 0.05)
    wrong = 91.0 * np.array([np.sin(ALONG), -np.cos(ALONG), 0.0])
    found = []
    for piece in fly_pieces(spec, seconds=5.0, belief=belief):
        found.append(piece)
        lla = earth.displace(piece.lla[-1], wrong)
        one = SimpleNamespace(
            lla=lla[None], vel_n=piece.vel_n[-1:], q_nb=piece.q_nb[-1:], gyro_bias_b=np.zeros((1, 3))
        )
        belief.take(NavEstimate(float(piece.t[-1]), piece, one, np.zeros(3)))
    (text,) = exceedances(found[-1])
    assert text.startswith("runway excursion: 9")
    assert "m right of the centerline, beyond the edge at 20 m" in text


def test_a_flare_that_aims_at_more_than_the_limit_lands_hard():
    firm = replace(NAVION, runway=replace(NAVION.runway, touch_down_sink=3.0))
    truth = fly_here(landed(aircraft=firm))
    (text,) = exceedances(truth)
    said = float(text.split("touch-down at ")[1].split()[0])
    touch = round(truth.events.select("leg")[1][1] / truth.t[1])
    assert said == pytest.approx(truth.vel_n[touch - 30 : touch, 2].max(), abs=0.3)
    assert "beyond 2.64 m/s of 14 CFR 23.473(d), once" in text


def test_a_gust_from_below_stalls_and_a_smaller_one_does_not():
    for up, stalls in ((10.0, True), (2.0, False)):
        gust = Gust((0.0, 0.0, -up), start=3.0, rise=0.5, hold=0.5, fall=0.5)
        truth = fly_here(plan(Straight(8.0), aircraft=NAVION, speed=40.0, gusts=(gust,)))
        most = np.rad2deg(truth.air.alpha.max())
        assert bool(most > 11.48) is stalls
        assert [f"up to {most:.1f} deg" in text for text in exceedances(truth)] == [True] * stalls


def test_the_jet_is_too_fast_in_a_gust_from_ahead():
    gust = Gust((-20.0 * np.cos(ALONG), -20.0 * np.sin(ALONG), 0.0), start=3.0, rise=1.0, hold=1.0, fall=1.0)
    spec = plan(Straight(8.0), aircraft=JET, alt=11000.0, speed=262.0, gusts=(gust,))
    truth = fly_here(spec)
    mach = truth.air.airspeed_true / (
        20.0468 * np.sqrt(truth.air.temperature)
    )  # ICAO Doc 7488: a = 20.0468 sqrt(T)
    (text,) = exceedances(truth)
    assert f"overspeed: Mach up to {mach.max():.3f}, beyond 0.92, for" in text
    assert exceedances(fly_here(replace(spec, gusts=()))) == []


# --- in files -------------------------------------------------------------------------------------------


def test_a_runway_has_a_width_and_a_length():
    stated = {"start.width_m": 30.0, "start.length_m": 900.0}
    flight = read_profile("circuit", stated).flight
    assert (flight.runway.width, flight.runway.length) == (30.0, 900.0)
    with pytest.raises(ConfigError, match=r"\[start\] width_m = 30 .* is not used: it is of a runway"):
        read_profile("figure-eight", {"start.width_m": 30.0})


# --- what a pilot looks at ------------------------------------------------------------------------------


def test_the_eye_of_a_pilot_sees_each_excess():
    """A gust from the side and below, 40 deg of bank where 20 are asked, and a descent to 30 m."""
    legs = Straight(3.0), Turn(radians(30.0), radians(20.0))
    spec = plan(*legs, aircraft=NAVION, speed=50.0, alt=1000.0)
    assert find_excess(spec, look_at(spec, fly_here(spec))) == []
    gust = Gust((8.0, 0.0, -25.0), start=1.0, rise=0.5, hold=0.5, fall=0.5)
    truth = fly_here(
        plan(Straight(3.0), Turn(radians(60.0), radians(40.0)), aircraft=NAVION, speed=50.0, gusts=(gust,))
    )
    low = replace(spec, flat_alt=float(truth.lla[:, 2].min()) - 30.0)
    found = [line.split(":")[0] for line in find_excess(low, look_at(low, truth))]
    assert {"bank", "sideslip", "height"} <= {*found}
