"""Roughness of the runway: its spectrum, what each wheel and the aircraft make of it, and none by default."""

from dataclasses import replace
from itertools import pairwise
from math import pi
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.signal import welch

from bench.core.mathematics import rotation
from bench.core.mathematics.random_streams import stream
from bench.core.words.exceptions import ConfigError
from bench.io.config import read_profile
from bench.io.config.library import read_jsbsim_aircraft
from bench.simulation.flight import recorder
from bench.simulation.flight.executive import load_aircraft
from bench.simulation.flight.ground.gear import Wheel, find_wheels
from bench.simulation.flight.ground.roughness import (
    ElevationProfile,
    _RoughGround,
    elevation_psd,
    over_rough_ground,
)
from bench.simulation.flight.jsbsim_units import INCH
from bench.simulation.flight.legs.runway import TakeOff
from bench.simulation.flight.legs.taxi import Taxi
from tests.flight import inertial
from tests.flight.plans import fly_here, record_whole, truth_of
from tests.flight.test_legs_ground import JET, KINDS, NAVION, RUNWAY, runway_frame, standing

TYPICAL = 0.13e-6


def rough(spec, index=TYPICAL):
    return replace(spec, runway=replace(RUNWAY, roughness=index))


def test_the_density_of_the_profile_is_the_stated_one():
    """In third octaves from 80 m to 2.2 m, by Welch's method from places every 0.4 m; none beyond them."""
    places = np.arange(0.0, 8192.0, 0.4)
    profile = ElevationProfile(stream(1, 0, "runway.along"), TYPICAL)
    heights = np.array([profile.at(float(place)) for place in places])
    cycles, density = welch(heights, 1 / 0.4, nperseg=2048)
    frequency, density = 2 * pi * cycles, density / (2 * pi)
    edges = 2 * pi / 80.0 * 2.0 ** (np.arange(16) / 3)
    for low, high in pairwise(edges[edges < 2 * pi / 2.2]):
        inside = (frequency >= low) & (frequency < high)
        if inside.sum() > 3:
            ratio = density[inside].sum() / (0.13e-6 * frequency[inside] ** -2.2).sum()
            assert 0.9 < ratio < 1.1, (low, ratio)
    assert density[frequency > 1.1 * pi].max() < 1e-3 * elevation_psd(pi, TYPICAL)
    assert elevation_psd(0.99 * 2 * pi / 100.0, TYPICAL) == elevation_psd(1.01 * pi, TYPICAL) == 0.0


def test_a_profile_follows_from_its_stream_and_has_no_steps():
    one, again, other = (
        ElevationProfile(stream(*key), TYPICAL) for key in ((1, 0, "a"), (1, 0, "a"), (2, 0, "a"))
    )
    assert one.heights == again.heights != other.heights
    fine = np.array([one.at(100.0 + 0.001 * k) for k in range(20_000)])
    assert np.abs(np.diff(fine)).max() < 0.001 * 10 * 7e-4  # ten times the rms of the slope
    assert one.at(-3.7) == pytest.approx(one.at(8192.0 - 3.7), abs=1e-12)
    assert one.at(25.0) == one.heights[100]


def test_the_wheels_of_a_model_are_where_its_file_says():
    """The Navion: wheels 1.65 m ahead, 0.55 m behind; 2600 N s/m on 26 kN/m and 4300 N s/m on 39 kN/m."""
    nose, left, right = find_wheels(NAVION, load_aircraft(NAVION, 0.0025))
    assert (nose.forward, nose.right, nose.lead) == pytest.approx((1.65, 0.0, 0.1), abs=1e-6)
    assert (left.forward, left.right, left.lead) == pytest.approx((-0.55, -1.32, 4300 / 39000), abs=1e-6)
    assert (right.right, right.unit) == (pytest.approx(1.32, abs=1e-6), "gear/unit[2]")
    cessna = read_jsbsim_aircraft("jsbsim:c172x", None, Path())
    leads = [wheel.lead for wheel in find_wheels(cessna, load_aircraft(cessna, 0.0025))]
    assert leads == pytest.approx([500 / 1800, 160 / 5400, 0.0])  # in pounds and feet; the last by a function


class Rolled:
    """A roll of the Navion at 12 m/s, with the wheels as they were moved."""

    def __init__(self, monkeypatch) -> None:
        self.moved: list[list[float]] = []
        self.spec = rough(
            standing(Taxi(500.0, 12.0, stop=1.0), aircraft=NAVION, speed=46.0, rate=400.0), 1e-6
        )

        def watch(fdm, panel, spec, dt, run):
            step = over_rough_ground(fdm, panel, spec, dt, run)
            wheels = [f"gear/unit[{k}]/z-position" for k in range(3)]
            begun = [fdm[name] for name in wheels]

            def watched():
                done = step()
                self.moved.append([(b - fdm[name]) * INCH for name, b in zip(wheels, begun, strict=True)])
                return done

            return watched

        monkeypatch.setattr(recorder, "over_rough_ground", watch)
        self.stretch = record_whole(self.spec)
        self.truth = truth_of(self.stretch, 400.0)
        self.heights = np.array(self.moved)[: len(self.truth)]
        self.speed = np.hypot(self.truth.vel_n[:, 0], self.truth.vel_n[:, 1])


@pytest.fixture(scope="module")
def rolled():
    with pytest.MonkeyPatch.context() as patch:
        return Rolled(patch)


def test_the_main_wheels_follow_the_nose_wheel_by_the_wheelbase(rolled):
    """2.2 m, to 5 cm, by the way at the best correlation; the ground is level where the aircraft stands."""
    along = runway_frame(rolled.truth)[0]
    steady = rolled.speed > 11.5
    ways = np.arange(along[steady][0], along[steady][-1], 0.02)
    nose, main = (np.interp(ways, along[steady], rolled.heights[steady, k]) for k in (0, 1))
    shifts = np.arange(60, 180)
    fits = [np.corrcoef(nose[: -shifts[-1]], main[s : len(main) - shifts[-1] + s])[0, 1] for s in shifts]
    assert shifts[int(np.argmax(fits))] * 0.02 == pytest.approx(2.2, abs=0.05)
    assert max(fits) > 0.99
    assert np.abs(rolled.heights[:400]).max() == 0.0


def test_the_aircraft_moves_as_springs_and_dampers_on_that_ground(rolled):
    """Heave and pitch of a rigid body on three struts, integrated by scipy, agree in 20 % of the rms.

    It shares with the bench the figures of the aircraft's file and the way of the wheels over the ground. It
    leaves out thrust, drag and air.
    """
    truth, dt = rolled.truth, 1 / 400.0
    steady = np.flatnonzero(rolled.speed > 11.5)
    first, last = steady[0], steady[-1]
    spring, damper = np.array([26e3, 39e3, 39e3]), np.array([2600.0, 4300.0, 4300.0])
    x = np.array([1.65, -0.55, -0.55])
    fdm = load_aircraft(NAVION, 0.0025)
    mass, inertia = fdm["inertia/mass-slugs"] * 14.5939, fdm["inertia/iyy-slugs_ft2"] * 1.35582
    times = dt * np.arange(last - first + 1)
    pushed = spring * rolled.heights[first : last + 1]  # springs and dampers by the ground alone [N]

    def rate(t, state):
        z, pitch, up, turn = state
        force = np.array([np.interp(t, times, column) for column in pushed.T])
        force -= spring * (z + x * pitch) + damper * (up + x * turn)
        return [up, turn, force.sum() / mass, (x * force).sum() / inertia]

    solved = solve_ivp(rate, (0.0, times[-1]), [0.0] * 4, t_eval=times, max_step=0.01, rtol=1e-6)
    expected = np.gradient(solved.y[2], dt)
    f_n = rotation.rotate(truth.q_nb[1:], truth.dvel_b / dt)
    arm = NAVION.imu_b  # of the IMU; the pitch moves it
    pitching = np.gradient(solved.y[3], dt)
    expected = expected + arm[0] * pitching
    found = -(f_n[first : last + 1, 2] - f_n[first : last + 1, 2].mean())
    settled = slice(400, -40)
    miss = found[settled][: len(expected[settled])] - expected[settled]
    assert found[settled].std() > 0.1
    assert miss.std() < 0.2 * found[settled].std(), (miss.std(), found[settled].std())


def test_no_roughness_is_the_smooth_runway_to_the_bit():
    spec = standing(Taxi(60.0, stop=1.0), aircraft=NAVION, speed=46.0)
    smooth, zero = record_whole(spec), record_whole(rough(spec, 0.0))
    assert np.array_equal(smooth.motion.pos_i, zero.motion.pos_i)
    once, again, other = (
        record_whole(rough(replace(spec, turbulence_seed=seed))).motion.pos_i for seed in (1, 1, 2)
    )
    assert np.array_equal(once, again)
    assert not np.array_equal(once, other)
    assert not np.array_equal(once, smooth.motion.pos_i)


@pytest.mark.parametrize("name", ["aerosonde", "navion", pytest.param("jet747", marks=pytest.mark.long)])
def test_a_take_off_from_a_typical_runway_is_felt_and_replayed(name):
    """Hall and Morris (NASA SP, 1965, abstract): at most 0.4 g is acceptable; a typical runway is within it.

    The increments of 200 Hz replay the position within a millimeter.
    """
    kind = KINDS[name]
    spec = standing(TakeOff(kind.top, *kind.climb), aircraft=kind.aircraft, speed=kind.climb[1], rate=200.0)
    felt = {}
    for index in (0.0, TYPICAL):
        truth = fly_here(rough(spec, index))
        assert [text for _, _, text in truth.events.select("exceedance")] == []
        pos, att = inertial.replay(truth, 200.0)
        assert pos < 1e-3
        assert att < 1e-6
        speed = np.hypot(truth.vel_n[1:, 0], truth.vel_n[1:, 1])
        run = (speed > 0.5 * kind.aircraft.runway.rotate_speed) & (
            speed < 0.85 * kind.aircraft.runway.rotate_speed
        )
        up = -truth.dvel_b[run, 2] / np.diff(truth.t)[run] / 9.81
        felt[index] = up.std()
        assert np.abs(up - up.mean()).max() < 0.4
    assert 0.005 < felt[TYPICAL] < 0.1, felt
    assert felt[TYPICAL] > 1.5 * felt[0.0], felt


def test_a_rough_runway_is_beyond_the_criterion():
    """The airliner on forty times the typical index."""
    kind = KINDS["jet747"]
    spec = standing(TakeOff(kind.top, *kind.climb), aircraft=JET, speed=kind.climb[1])
    truth = fly_here(rough(spec, 40 * TYPICAL))
    up = -truth.dvel_b[:, 2] / np.diff(truth.t) / 9.81
    assert np.abs(up - 1.0).max() > 0.4


def test_roughness_is_a_key_of_a_runway():
    flight = read_profile("circuit", {"start.roughness_cm3": 0.13}).flight
    assert flight.runway.roughness == pytest.approx(0.13e-6)
    assert read_profile("circuit").flight.runway.roughness == 0.0
    with pytest.raises(ConfigError, match=r"roughness_cm3 = 0.13 cm\^3 is not used: it is of a runway"):
        read_profile("figure-eight", {"start.roughness_cm3": 0.13})
    with pytest.raises(ConfigError, match=r"\[start\] roughness_cm3 is not used by a multirotor"):
        read_profile("delivery", {"start.roughness_cm3": 0.13})
    with pytest.raises(ConfigError, match=r"roughness_cm3 = 60 .* is outside 0 to 50"):
        read_profile("circuit", {"start.roughness_cm3": 60.0})


class _Slope(_RoughGround):
    """Ground that rises by 0.01 along and falls by 0.02 to the right, 0.05 m higher at each step."""

    def __init__(self, turned):
        self._wheels = [Wheel("nose", 2.0, 0.0, 0.1, 0.0), Wheel("right", -1.0, 1.5, 0.2, 0.0)]
        self._runway, self._read_heading, self._dt = (0.3, 1.0, 0.0), lambda: 0.3 + turned, 0.5
        self._panel, self._near, self._before = SimpleNamespace(true_alt_agl=lambda: 1.0), 20.0, None
        self._place, self._run, self._at_rest = lambda: (100.0, -7.0), lambda: True, [5.0, 6.0]
        self.seen, self.risen = [], 0.0
        self._moves = [lambda inches, k=k: self.seen.append((k, inches)) for k in range(2)]

    def elevation(self, along, across):
        return 0.01 * along - 0.02 * across + self.risen


@pytest.mark.parametrize(
    ("turned", "nose", "right"), [(0.0, (2, 0), (-1, 1.5)), (pi / 2, (0, 2), (-1.5, -1))]
)
def test_each_wheel_is_at_its_own_place_and_a_rise_leads(turned, nose, right):
    """By hand: nose and right wheel along and across; rising ground adds c / k times its speed."""
    ground = _Slope(turned)
    ground.step()
    ground.risen = 0.05
    ground.step()
    for k, ((along, across), lead) in enumerate(zip((nose, right), (0.1, 0.2), strict=True)):
        height = 0.01 * (100.0 + along) - 0.02 * (-7.0 + across)
        for n, moved in enumerate((height, height + 0.05 + lead * 0.05 / 0.5)):
            assert ground.seen[2 * n + k] == (k, pytest.approx([5.0, 6.0][k] - moved / INCH))
