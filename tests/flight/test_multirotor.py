"""A multirotor: what it flies, holds and refuses; its truth in the air and on the ground."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from math import inf, pi, radians

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.integrate import cumulative_trapezoid

from bench.core.mathematics.arrays import FloatArray
from bench.core.mathematics.earth import matrix_en, to_ecef
from bench.core.mathematics.rotation import to_euler
from bench.core.records.data import Trajectory
from bench.core.records.flight_specs import MULTIROTOR, AircraftSpec, FlightSpec, Leg, LegStart, Runway
from bench.core.records.rotor_speeds import no_rotors
from bench.core.words.exceptions import ConfigError, FlightError
from bench.io.config.library import read_aircraft
from bench.simulation.flight.guidance.rides import Ride
from bench.simulation.flight.legs.climbs import Climb, Descend
from bench.simulation.flight.legs.keys import check_leg
from bench.simulation.flight.legs.level import Straight
from bench.simulation.flight.legs.rotors import Goto, Hover, Land, Orbit, Sprint, Yaw
from bench.simulation.flight.legs.runway import Static, TakeOff
from bench.simulation.flight.recorder import fly_pieces, prepare
from bench.simulation.flight.rotor_cockpit import RotorCockpit
from tests.flight.inertial import replay
from tests.flight.plans import AEROSONDE, fly_here
from tests.flight.test_aircraft_files import AIRCRAFT

HUMMINGBIRD, X500 = FRAMES = [read_aircraft(AIRCRAFT / name, AIRCRAFT) for name in ("hummingbird", "x500")]
MASS = {"hummingbird": 0.5, "x500": 2.0643077}  # [kg]
THRUST = {"hummingbird": 5.57e-6, "x500": 8.54858e-6}  # [N s^2]
TILT = {"hummingbird": (45.0, 60.5), "x500": (25.0, 45.0)}  # of the sprint, between [deg]
LEAN = {"hummingbird": 25.2, "x500": 5.4}  # in 8 m/s of wind [deg]
PER_FRAME = pytest.mark.parametrize("aircraft", FRAMES, ids=lambda one: one.name)
PAD = Runway(radians(47.26), radians(11.34), 600.0, 0.6)
AIR = 610.0  # where a flight in the air begins [m]


def plan(*legs: Leg, on_ground: bool = False, **changes) -> FlightSpec:
    """Legs in calm air from 10 m above the pad, heading 0.6 rad, or from the pad itself."""
    values = {
        "aircraft": HUMMINGBIRD,
        "rate": 200.0,
        "lat": PAD.lat,
        "lon": PAD.lon,
        "alt": PAD.alt if on_ground else AIR,
        "heading": PAD.heading,
        "speed": 0.0,
        "wind_from": radians(250.0),
        "wind_speed": 0.0,
        "severity": 0,
        "turbulence_seed": 1,
        "duration": None,
        "runway": PAD,
    }
    return FlightSpec(legs=legs, on_ground=on_ground, **values | changes)


@dataclass
class Flown:
    """A flight in the plane of its start [m], at the rate of its truth."""

    truth: Trajectory

    def __post_init__(self):
        first = self.truth.lla[0]
        C_en = matrix_en(first[0], first[1])
        self.ned: FloatArray = (to_ecef(self.truth.lla) - to_ecef(first)) @ C_en
        self.roll, self.pitch, self.heading = to_euler(self.truth.q_nb)

    def leg(self, number: int) -> slice:
        begin, end, _ = self.truth.events.select("leg")[number - 1]
        return slice(*np.searchsorted(self.truth.t, [begin - 1e-9, end + 1e-9]))

    def tilt(self) -> FloatArray:
        return np.rad2deg(np.arccos(np.cos(self.roll) * np.cos(self.pitch)))


TOUR = (
    Static(2.0),
    TakeOff(to_height=10.0, rate=2.0),
    Hover(10.0),
    Goto(north=40.0, east=0.0, speed=6.0),
    Goto(north=40.0, east=30.0, speed=6.0, alt=614.0, nose="course"),
    Yaw(radians(-120.0), radians(60.0)),
    Orbit(radius=15.0, speed=6.0, laps=1.0),
    Sprint(distance=130.0, speed=15.0),
    Hover(4.0),
    Climb(630.0, 4.0),
    Descend(606.0, 2.0),
    Land(),
    Static(2.0),
)


@pytest.fixture(scope="module", params=FRAMES, ids=lambda one: one.name)
def frame(request):
    return request.param


@pytest.fixture(scope="module")
def tour(frame) -> Flown:
    return Flown(fly_here(plan(*TOUR, on_ground=True, aircraft=frame)))


def test_a_calm_tour_is_flown_as_its_legs_say(frame, tour):
    """Ends of the legs, read from the truth: the plane of the pad, of which the start is the origin."""
    ends = [tour.ned[tour.leg(k)][-1] for k in range(1, len(TOUR) + 1)]
    takeoff, hover, north, corner, yaw, orbit = ends[1:7]
    for found, height in ((takeoff, 10.0), (hover, 10.0)):
        assert np.abs(found - [0.0, 0.0, -height + frame.rest_height]).max() < 0.05
    assert np.abs(north - [40.0, 0.0, frame.rest_height - 10.0]).max() < 0.05
    assert np.abs(corner - [40.0, 30.0, frame.rest_height - 14.0]).max() < 0.05
    assert np.abs(yaw - corner).max() < 0.05
    assert np.abs(orbit - corner).max() < 0.1
    sprint = ends[7] - orbit
    course = tour.heading[tour.leg(8)][0]
    assert np.abs(sprint - 130.0 * np.array([np.cos(course), np.sin(course), 0.0])).max() < 0.2
    assert -ends[9][2] == pytest.approx(30.0 - frame.rest_height, abs=0.05)
    assert -ends[10][2] == pytest.approx(6.0 - frame.rest_height, abs=0.05)
    assert abs(ends[12][2]) < 0.005


def test_a_calm_hover_and_its_paths_keep_their_bounds(frame, tour):
    """A hover 0.05 m; at 6 m/s 0.5 m across the way, in the sprint 1 m, and all within the limit of tilt."""
    hover = tour.ned[tour.leg(3)]
    assert np.abs(hover[400:] - hover[-1]).max() < 0.05
    north = tour.ned[tour.leg(4)]
    assert np.abs(north[:, 1]).max() < 0.5
    sprint, course = tour.ned[tour.leg(8)], tour.heading[tour.leg(8)][0]
    across = (sprint - sprint[0]) @ [-np.sin(course), np.cos(course), 0.0]
    assert np.abs(across).max() < 1.0
    assert np.ptp(sprint[:, 2]) < 0.5
    assert TILT[frame.name][0] < tour.tilt().max() < TILT[frame.name][1]
    speed = np.hypot(*tour.truth.vel_n[tour.leg(8)].T[:2])
    assert 14.5 < speed.max() < 15.6


def test_an_orbit_looks_at_its_center(tour):
    rows = tour.leg(7)
    ned, heading = tour.ned[rows], tour.heading[rows]
    ahead = np.array([np.cos(heading[0]), np.sin(heading[0])])
    center = ned[0, :2] + 15.0 * ahead
    to_center = center - ned[:, :2]
    assert np.abs(np.hypot(*to_center.T) - 15.0).max() < 0.5
    off = np.angle(np.exp(1j * (np.arctan2(to_center[:, 1], to_center[:, 0]) - heading)))
    assert np.rad2deg(np.abs(off)).max() < 3.0
    east_of = np.unwrap(np.arctan2(-to_center[:, 1], -to_center[:, 0]))
    assert east_of[-1] - east_of[0] == pytest.approx(2 * pi, abs=0.02)


def test_a_calm_flight_replays_in_the_air_to_a_tenth_of_a_millimeter(tour):
    """By two samples at 200 Hz; with lift-off and touch-down, which are not smooth, to 5 mm."""
    first, last = tour.leg(3).start, tour.leg(11).stop
    truth = tour.truth
    air = dataclasses.replace(
        truth,
        **{name: getattr(truth, name)[first:last] for name in ("t", "lla", "vel_n", "q_nb")},
        **{name: getattr(truth, name)[first : last - 1] for name in ("dtheta_b", "dvel_b")},
        rotors=no_rotors(),
    )
    assert replay(shifted(air), 200.0)[0] < 1e-4
    assert replay(truth, 200.0)[0] < 5e-3


def shifted(truth: Trajectory) -> Trajectory:
    """The same motion from t = 0 on."""
    return dataclasses.replace(truth, t=truth.t - truth.t[0])


def test_air_data_and_rotor_speeds_are_those_of_a_hover(frame, tour):
    """The weight by the published thrust; no angle of attack where there is no flow; no control surfaces."""
    air, t = tour.truth.air, tour.truth.air.t
    begin, end, _ = tour.truth.events.select("leg")[2]
    rows = (t > begin + 2.0) & (t < end)
    density = air.pressure[rows] / (287.05287 * air.temperature[rows])
    weight = MASS[frame.name] * 9.8062
    expected = np.sqrt(weight / 4 / THRUST[frame.name] * 1.225 / density)
    assert np.abs(air.engine_speed[rows] / expected - 1).max() < 1e-3
    rotors = tour.truth.rotors
    mean = np.interp(t, rotors.t, rotors.speed.mean(axis=1))
    assert_allclose(mean, air.engine_speed, rtol=0, atol=1e-9)  # of the same step
    slow = air.airspeed_true < 3.0
    assert 0.2 < slow.mean() < 0.9
    assert not air.alpha[slow].any()
    assert not air.beta[slow].any()
    assert air.alpha[~slow].all()
    assert 0.0 < tour.truth.controls.throttle[rows].min() < tour.truth.controls.throttle.max() < 1.0
    assert not np.any([tour.truth.controls.aileron, tour.truth.controls.elevator, tour.truth.controls.rudder])


def turned_by_lift_off(**air) -> tuple[float, Flown]:
    """Return how far the nose turns [deg], and the flight, in 8 m/s of wind."""
    legs = (TakeOff(to_height=6.0, rate=2.0), Hover(3.0))
    flown = Flown(fly_here(plan(*legs, on_ground=True, wind_speed=8.0, **air)))
    off = np.angle(np.exp(1j * (flown.heading - PAD.heading)))
    return float(np.rad2deg(np.abs(off)).max()), flown


@PER_FRAME
def test_a_lift_off_in_wind_keeps_its_heading(aircraft):
    """8 m/s from the side: the weight is taken at once, the tilt within a second."""
    turned, flown = turned_by_lift_off(aircraft=aircraft)
    assert 0.01 < turned < 3.0
    assert flown.tilt()[-1] == pytest.approx(LEAN[aircraft.name], abs=1.0)
    assert np.hypot(*flown.ned[-1, :2]) < 0.05


@pytest.mark.long
@PER_FRAME
def test_a_lift_off_in_wind_and_moderate_air_keeps_its_heading_over_ten_seeds(aircraft):
    air = {"aircraft": aircraft, "severity": 4}
    assert max(turned_by_lift_off(turbulence_seed=seed, **air)[0] for seed in range(10)) < 3.0


def test_it_takes_off_again_from_ground_that_is_no_runway():
    """10 m above flat ground at 600 m it starts; a second hover is 5 m above that ground."""
    legs = (Land(), Static(1.0), TakeOff(to_height=5.0, rate=2.0), Hover(1.0))
    flown = Flown(fly_here(plan(*legs, runway=None, flat_alt=600.0)))
    assert flown.truth.lla[flown.leg(2), 2].max() == pytest.approx(600.098, abs=0.002)
    assert flown.truth.lla[-1, 2] == pytest.approx(605.0, abs=0.02)


def test_a_steep_way_keeps_the_limits_of_climb_and_descent():
    up = Goto(north=5.0, east=0.0, speed=12.0, alt=650.0)
    down = Goto(north=0.0, east=0.0, speed=12.0, alt=612.0)
    sink = Flown(fly_here(plan(up, down))).truth.vel_n[:, 2]
    assert -sink.min() == pytest.approx(HUMMINGBIRD.max_climb, abs=0.1)
    assert sink.max() == pytest.approx(HUMMINGBIRD.max_descent, abs=0.1)


def hold_in_moderate_air(aircraft: AircraftSpec, seed: int, wind: float = 0.0) -> tuple[float, float]:
    """Return rms and largest horizontal distance of a minute's hover [m]."""
    air = {"severity": 4, "turbulence_seed": seed, "wind_speed": wind}
    spec = plan(Hover(60.0), aircraft=aircraft, rate=100.0, **air)
    ned = Flown(fly_here(spec)).ned
    off = np.hypot(*ned.T[:2])
    assert np.abs(ned[:, 2]).max() < 0.5
    return float(np.sqrt(np.mean(off**2))), float(off.max())


@PER_FRAME
def test_moderate_air_is_held(aircraft):
    rms, largest = hold_in_moderate_air(aircraft, 3)
    assert 0.01 < rms < 0.5
    assert largest < 1.5


@pytest.mark.long
@PER_FRAME
@pytest.mark.parametrize("wind", [0.0, 5.0])
def test_moderate_air_is_held_over_ten_seeds(aircraft, wind):
    found = np.array([hold_in_moderate_air(aircraft, seed, wind) for seed in range(10)])
    assert (found < [0.5, 1.5]).all(), found


def test_a_flight_in_pieces_is_the_whole_flight():
    spec = plan(Hover(2.0), Goto(north=10.0, east=5.0, speed=4.0), wind_speed=4.0, severity=3)
    whole, pieces = fly_here(spec), list(fly_pieces(spec, seconds=1.5))
    assert len(pieces) > 2
    assert np.concatenate([piece.dvel_b for piece in pieces]).tobytes() == whole.dvel_b.tobytes()


def test_what_the_tilt_does_not_give_ends_the_flight_with_one_message():
    fast = plan(Sprint(distance=200.0, speed=15.0, off_nose=radians(250.0) - 0.6), wind_speed=10.0)
    with pytest.raises(FlightError, match=r"leg 1 sprint: .* off its path: speed and wind ask for more"):
        fly_here(fast)
    with pytest.raises(
        FlightError, match=r"no hover found for hummingbird in a wind of 25 m/s: .* 60 at most"
    ):
        prepare(plan(Hover(1.0), wind_speed=25.0), 1 / 400)
    with pytest.raises(FlightError, match=r"leg 1 descend: .* flew into the ground"):
        fly_here(plan(Descend(599.0, 2.0)))
    with pytest.raises(FlightError, match=r"leg 1 drop: .* no ground within 0.5 m below"):
        fly_here(plan(Drop()))


@pytest.fixture
def own(tmp_path):
    """A multirotor of somebody: the Hummingbird with some text of its model or its sheet changed."""

    def make(old: str, new: str):
        folder = tmp_path / "aircraft" / "kite"
        folder.mkdir(parents=True, exist_ok=True)
        for shipped, name in (("hummingbird.xml", "kite.xml"), ("aircraft.toml", "aircraft.toml")):
            text = (AIRCRAFT / "hummingbird" / shipped).read_text()
            (folder / name).write_text(text.replace(old, new))
        return read_aircraft(folder, tmp_path)

    return make


def test_a_heavier_multirotor_of_somebody_hovers_by_its_own_figures(own):
    """Mass is read from the model: twice of it turns the rotors faster by the root of 2."""
    light, heavy = (
        fly_here(plan(Hover(3.0), aircraft=one)) for one in (HUMMINGBIRD, own('"KG"> 0.5 <', '"KG"> 1.0 <'))
    )
    ratio = heavy.air.engine_speed[-1] / light.air.engine_speed[-1]
    assert ratio == pytest.approx(np.sqrt(2.0), rel=1e-6)
    assert np.abs(Flown(heavy).ned).max() < 0.001


BROKEN = [
    ('value="200.0"> rotor/lag', 'value="0"> rotor/lag', "rotor/lag-rad_sec must be above 0; it is 0"),
    ('value="200.0"> rotor/lag-down', 'value="0"> rotor/lag-down', "rotor/lag-down-rad_sec must be above 0"),
    ("yaw-gain         = 3.0", "yaw-gain         = 0.0", "guidance/yaw-gain must be above 0; it is 0"),
]


@pytest.mark.parametrize(("old", "new", "message"), BROKEN)
def test_a_figure_that_a_model_lacks_is_named(own, old, new, message):
    with pytest.raises(FlightError, match=rf"aircraft kite: {message}"):
        prepare(plan(Hover(1.0), aircraft=own(old, new)), 1 / 400)


MISTAKES = [
    (
        "min_speed_mps   = 0.0",
        "min_speed_mps   = 2.0",
        "min_speed_mps = 2 m/s must be 0 with kind = 'multirotor'",
    ),
    ('kind  = "multirotor"', "", "min_speed_mps = 0 m/s is below 1 m/s; 0 is for what hovers"),
    ("[stand] ", "[[trim]]\nalt_m = 1.0\nspeed_mps = 5.0\n\n[stand] ", "[trim] is not used with kind"),
    ('<system file="multirotor"/>', "", "the model must name <system file='multirotor'/>"),
]


@pytest.mark.parametrize(("old", "new", "message"), MISTAKES)
def test_a_mistake_in_its_sheet_is_said_in_one_line(own, old, new, message):
    with pytest.raises(ConfigError) as caught:
        own(old, new)
    assert len(caught.value.messages) == 1
    assert message in caught.value.messages[0]


class Drop(Leg):
    """Land on ground that is not there."""

    kind = "drop"
    flown_by = (MULTIROTOR,)
    leaves = "ground"

    def fly(self, cockpit):
        return cockpit.touch_down(0.3, 0.5)


REFUSED = [
    (HUMMINGBIRD, Straight(5.0), "is flown by an aircraft with wings, and the hummingbird is none"),
    (AEROSONDE, Hover(5.0), "is flown by a multirotor or a helicopter, and the aerosonde is none"),
    (
        HUMMINGBIRD,
        Climb(700.0, 2.0, speed=5.0),
        "speed_mps = 5 m/s is an airspeed, which the hummingbird does not hold",
    ),
    (HUMMINGBIRD, TakeOff(10.0, 2.0, 5.0), "speed_mps = 5 m/s is not used by a multirotor"),
    (AEROSONDE, TakeOff(50.0, 2.0), "speed_mps is missing"),
    (AEROSONDE, TakeOff(10.0, 2.0, 25.0), "to_height_m = 10 m is below the 20 m of an aircraft with wings"),
    (HUMMINGBIRD, Goto(10.0, 0.0, 17.0), "speed_mps = 17 m/s is above the 16 m/s"),
    (HUMMINGBIRD, Orbit(2.0, 10.0), "speed_mps = 10 m/s on radius_m = 2 m needs a tilt of 78.9"),
]


@pytest.mark.parametrize(("aircraft", "leg", "message"), REFUSED)
def test_a_leg_that_is_not_flown_says_why(aircraft, leg, message):
    start = LegStart(aircraft, 600.0, PAD, leg.needs)
    assert [line for line in check_leg(leg, start) if message in line], check_leg(leg, start)


def test_the_legs_of_a_tour_are_accepted():
    start, found = LegStart(HUMMINGBIRD, 600.0, PAD, "ground"), []
    for leg in TOUR:
        found += check_leg(leg, start)
        start = dataclasses.replace(start, alt=leg.alt_after(start), after=leg.leaves)
    assert found == []


@pytest.mark.parametrize("length", [0.3, 20.0, 500.0])
def test_a_ride_is_smooth_up_to_its_jerk_and_keeps_its_limits(length):
    """Its derivatives are those of its length, by central differences; rest at both ends."""
    ride = Ride.plan(length, 6.0, 3.0)
    t, h = np.linspace(-0.1, ride.duration + 0.1, 4001), 1e-5
    rows = np.array([ride.at(x) for x in t])
    slopes = np.array([(np.array(ride.at(x + h)) - ride.at(x - h)) / (2 * h) for x in t])
    assert np.abs(slopes[:, :3] - rows[:, 1:]).max() < 5e-3
    assert rows[-1].tolist() == [length, 0.0, 0.0, 0.0]
    assert rows[0].tolist() == [0.0, 0.0, 0.0, 0.0]
    assert rows[:, 1].max() <= 6.0 + 1e-9
    assert np.abs(rows[:, 2]).max() <= 3.0 + 1e-9
    if length == 500.0:
        assert rows[:, 1].max() == pytest.approx(6.0)
        assert np.abs(rows[:, 2]).max() == pytest.approx(3.0, rel=1e-3)
    assert inf > ride.duration > 0.0


@pytest.mark.parametrize(("side", "sign"), [("left", -1.0), ("right", 1.0)])
def test_an_orbit_sets_off_to_its_side_and_its_path_has_its_own_derivatives(side, sign, monkeypatch):
    monkeypatch.setattr(RotorCockpit, "follow", lambda _, path, duration: (path, duration))
    cockpit = object.__new__(RotorCockpit)
    cockpit.course, cockpit.place = 0.3, np.array([5.0, -2.0, -10.0])
    leg = Orbit(radius=15.0, speed=6.0, laps=2.0, side=side)
    path, duration = leg.fly(cockpit)
    ahead, right = np.array([np.cos(0.3), np.sin(0.3), 0.0]), np.array([-np.sin(0.3), np.cos(0.3), 0.0])
    center, h = cockpit.place + 15.0 * ahead, 1e-4
    assert path(1.0)[0][1] @ right * sign > 0.1
    for t in np.linspace(0.1, 0.9, 9) * duration:
        before, (rows, heading, rate), after = path(t - h), path(t), path(t + h)
        assert_allclose((after[0][:3] - before[0][:3]) / (2.0 * h), rows[1:], atol=1e-5)
        assert (after[1] - before[1]) / (2.0 * h) == pytest.approx(rate, abs=1e-6)
        nose = np.array([np.cos(heading), np.sin(heading), 0.0])
        assert_allclose(rows[0] + 15.0 * nose, center, atol=1e-9)


def test_angles_of_rotors_from_speeds_at_200_hz_are_those_of_every_step(frame, tour):
    """Trapezoids of 5 ms and 2.5 ms of one flight: 0.02 rad in the air, 0.2 rad with the take-off."""
    fine = fly_here(plan(*TOUR[:5], on_ground=True, rate=400.0, aircraft=frame)).rotors
    angles = cumulative_trapezoid(fine.speed, fine.t, axis=0, initial=0.0)[::2]
    coarse = fine.speed[::2]
    n = len(coarse)
    assert_allclose(coarse, tour.truth.rotors.speed[:n], rtol=0, atol=1e-6)
    off = cumulative_trapezoid(coarse, fine.t[::2], axis=0, initial=0.0) - angles
    air = slice(*np.searchsorted(fine.t[::2], [9.0, fine.t[-1]]))
    assert np.abs(off).max() < 0.2
    assert np.ptp(off[air], axis=0).max() < 0.02
