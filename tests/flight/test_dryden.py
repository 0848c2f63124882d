"""Turbulence: its discretization against the shaping filters of MIL-F-8785C, its runs, ground and wind."""

from dataclasses import replace
from math import cos, pi, radians, sin

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.linalg import expm
from scipy.stats import chi2

from bench.core.mathematics.random_streams import stream
from bench.core.records.flight_specs import MULTIROTOR
from bench.io.config import read_profile
from bench.simulation.flight import fly
from bench.simulation.flight.executive import load_aircraft
from bench.simulation.flight.jsbsim_units import FT
from bench.simulation.flight.legs.level import Straight
from bench.simulation.flight.trimming import TrimCondition, present_accelerations, trim_aircraft, wait
from bench.simulation.flight.turbulence.dryden import (
    GUSTS,
    RATES,
    GustFilters,
    carrying_speed,
    discretize_chain,
    scales_and_intensities,
    through_turbulence,
)
from tests.flight.gust_spectra import CENTERS, SPAN, measure, shaping
from tests.flight.plans import AEROSONDE, plan


@pytest.mark.parametrize("height", [30.0, 76.0, 250.0, 1200.0])
@pytest.mark.parametrize(("span", "speed"), [(2.8956, 25.0), (10.2, 55.0), (59.64, 80.0), (59.64, 240.0)])
def test_the_discrete_response_is_that_of_the_shaping_filters(span, speed, height):
    """At the step of a flight, from 0.02 to 10 Hz, each gust within 2 %.

    Sampling folds what lies above 200 Hz down: a floor of 0.01 % of the highest density, which shows only
    where a rate of turning has almost none of its own (0.02 Hz).
    """
    dt, figures = 1 / 400, scales_and_intensities(height, 4)
    filters = GustFilters(span)
    phi, noise = filters.make_step(figures[0], figures[1], speed * dt)
    out = filters.gusts(np.eye(8), figures).T
    omegas = 2 * pi * np.geomspace(0.02, 10.0, 25)
    turns = np.exp(1j * omegas * dt)[:, None, None] * np.eye(8)
    spectra = dt / pi * (np.abs(out @ np.linalg.solve(turns - phi, noise)) ** 2).sum(axis=2)
    for k, name in enumerate(GUSTS):
        expected = shaping(name, omegas, speed, span, figures)
        assert_allclose(spectra[:, k], expected, rtol=0.02, atol=1e-4 * expected.max(), err_msg=name)


def test_turbulence_turns_as_a_mass_of_air_does():
    """q is -dw/dx and r is dv/dx: a gust that grows along the path, over the two meters before."""
    filters = GustFilters(1.0)
    rng = np.random.default_rng(1)
    phi, noise = filters.make_step(100.0, 100.0, 0.05)
    states = [np.zeros(8)]
    for _ in range(4000):
        states.append(phi @ states[-1] + noise @ rng.standard_normal(8))
    _, v, w, _, q, r = filters.gusts(np.array(states), (100.0, 100.0, 1.0, 1.0)).T
    for rate, gust, sign in ((q, w, -1), (r, v, 1)):
        slope = (gust[40:] - gust[:-40]) / (40 * 0.05)
        assert np.corrcoef(rate[30:-10], sign * slope)[0, 1] > 0.6


# --- intensities against the table --------------------------------------------------------------------


@pytest.mark.parametrize(("name", "wind_kt"), [("light", 15), ("moderate", 30), ("severe", 45)])
def test_intensities_near_the_ground_are_a_tenth_of_the_wind_at_20_feet(name, wind_kt):
    """Figures 10 and 11 of MIL-F-8785C: sigma_w = 0.1 W20 at all heights, at 1000 ft sigma_u equals it."""
    severity = {"light": 3, "moderate": 4, "severe": 6}[name]
    wind = wind_kt * 1852 / 3600
    for feet in (20.0, 200.0, 1000.0):
        length_u, length_w, sigma_u, sigma_w = scales_and_intensities(feet * FT, severity)
        assert_allclose(sigma_w, 0.1 * wind, rtol=2e-3)
        assert_allclose(sigma_u / sigma_w, (0.177 + 0.000823 * feet) ** -0.4, rtol=1e-12)
        assert_allclose(
            [length_w / FT, length_u / FT], [feet, feet / (0.177 + 0.000823 * feet) ** 1.2], rtol=1e-12
        )


def test_intensities_high_up_are_those_of_figure_7_and_join_without_a_step():
    for severity, sigma in ((3, 6.7), (4, 10.1), (6, 23.6)):  # at 7500 ft, in ft/s
        assert_allclose(
            scales_and_intensities(7500 * FT, severity), np.array([1750, 1750, sigma, sigma]) * FT
        )
    heights = np.arange(900.0, 2200.0) * FT
    for severity in range(1, 8):
        figures = np.array([scales_and_intensities(h, severity) for h in heights])
        assert (np.abs(np.diff(figures, axis=0)).max(axis=0) < [0.5, 0.5, 0.01, 0.01]).all()


# --- the driver over ground and in wind ---------------------------------------------------------------


class Still:
    """As much of JSBSim as the driver reads: a flight at one height and airspeed, in one wind."""

    def __init__(self, height, speed, wind_n, span=SPAN, heading=0.0):
        air = np.array([speed * cos(heading), speed * sin(heading), 0.0])
        ground = air + wind_n
        self.values = {"metrics/bw-ft": span / FT, "position/h-agl-ft": height / FT}
        for k, axis in enumerate(("north", "east", "down")):
            self.values[f"velocities/v-{axis}-fps"] = ground[k] / FT
            self.values[f"atmosphere/wind-{axis}-fps"] = wind_n[k] / FT
            self.values[f"atmosphere/gust-{axis}-fps"] = 0.0
        self.values |= dict.fromkeys(RATES, 0.0)
        self.names = [f"atmosphere/gust-{axis}-fps" for axis in ("north", "east", "down")] + list(RATES)

    def get_property_manager(self):
        return self

    def get_node(self, name):
        values = self.values

        class Node:
            def get_double_value(self):
                return values[name]

            def set_double_value(self, value):
                values[name] = value

        return Node()

    def __getitem__(self, name):
        return self.values[name]

    def __setitem__(self, name, value):
        self.values[name] = value

    def run(self):
        return True

    def gusts(self, seed, seconds, dt=0.01, severity=4, aircraft=AEROSONDE, speed=None):
        """(T, 6) along north, east, down [m/s] and p, q, r [rad/s]; speed(t): over ground to the north."""
        spec = plan(Straight(1.0), severity=severity, turbulence_seed=seed, heading=0.0, aircraft=aircraft)
        step = through_turbulence(self, spec, dt)
        rows = []
        for k in range(round(seconds / dt)):
            if speed is not None:
                self.values["velocities/v-north-fps"] = speed(k * dt) / FT
            step()
            rows.append([self.values[name] for name in self.names])
        return np.array(rows) * [FT, FT, FT, 1.0, 1.0, 1.0]


@pytest.mark.slow
@pytest.mark.parametrize(("height", "speed"), [(60.0, 25.0), (60.0, 55.0), (1200.0, 100.0)])
def test_twenty_draws_have_the_spectra_and_no_mean(height, speed):
    """1,000 s each: third-octaves within 15 % from 0.1 Hz and 25 % below, the mean below 0.15 sigma."""
    measured, expected, mean = measure(height, speed)
    _, _, sigma_u, sigma_w = scales_and_intensities(height, 4)
    assert (np.abs(mean)[:3] < 0.15 * np.array([sigma_u, sigma_u, sigma_w])).all()
    low = CENTERS < 0.1
    assert_allclose(measured[low], expected[low], rtol=0.25)
    assert_allclose(measured[~low], expected[~low], rtol=0.15)


@pytest.mark.parametrize("wind_n", [(-5.0, 0.0, 0.0), (0.0, 5.0, 0.0)])
def test_what_is_written_is_the_draw_of_the_filters_in_head_and_in_crosswind(wind_n):
    """The flight northbound through the air writes u, v, w as north, east, down, whatever the wind."""
    written = Still(60.0, 25.0, np.array(wind_n)).gusts(7, 1.0)
    figures = scales_and_intensities(60.0, 4)
    filters = GustFilters(SPAN)
    phi, noise = filters.make_step(figures[0], figures[1], 0.25)
    rng, x, states = stream(7, 0, "turbulence"), np.zeros(8), []
    for row in rng.standard_normal((100, 8)):
        x = phi @ x + noise @ row
        states.append(x)
    assert_allclose(written, filters.gusts(np.array(states), figures), atol=1e-9)


def test_the_field_is_frozen_in_the_air_and_stands_when_the_aircraft_does():
    still = Still(50.0, 0.0, np.zeros(3)).gusts(1, 2.0)
    assert np.abs(np.diff(still, axis=0)).max() == 0.0
    parked = Still(50.0, 0.0, np.array([-8.0, 0.0, 0.0]))
    parked.values |= {f"velocities/v-{axis}-fps": 0.0 for axis in ("north", "east", "down")}
    assert np.abs(parked.gusts(1, 2.0)[:, :3]).max() > 0.1  # the wind carries it past


# --- what hovers --------------------------------------------------------------------------------------


HOVERER = replace(AEROSONDE, kind=MULTIROTOR)


def test_gusts_in_a_hover_live_with_the_variance_of_the_standard():
    """No wind, no motion: 120 values 25 s apart (six scales) of u, v and w; band of 99.9 % for the three."""
    gusts = Still(10.0, 0.0, np.zeros(3)).gusts(2, 3025.0, dt=0.05, aircraft=HOVERER)[500::500, :3]
    _, _, sigma_u, sigma_w = scales_and_intensities(10.0, 4)
    found = (gusts**2).sum(axis=0) / np.square([sigma_u, sigma_u, sigma_w])
    low, high = chi2.ppf([0.001 / 6, 1 - 0.001 / 6], len(gusts))
    assert (found > low).all()
    assert (found < high).all()


def largest_step_of_a_reversal(aircraft, severity):
    """From 20 m/s northbound to 20 m/s southbound in 8 s, ten draws: largest change in 50 ms [m/s]."""
    worst = 0.0
    for seed in range(10):
        air = Still(30.0, 20.0, np.zeros(3))
        rows = air.gusts(seed, 60.0, dt=0.05, severity=severity, aircraft=aircraft, speed=reverse)
        worst = max(worst, float(np.abs(np.diff(rows[:, :2], axis=0)).max()))
    return worst


def reverse(t):
    return 20.0 - 5.0 * min(max(t - 40.0, 0.0), 8.0)


@pytest.mark.parametrize("severity", [3, 4])
def test_a_reversal_throws_no_gust_round(severity):
    """Axes that follow the path through the air do, which the wings keep: more than 4 m/s at once."""
    assert largest_step_of_a_reversal(HOVERER, severity) < 4.0
    assert largest_step_of_a_reversal(AEROSONDE, severity) > 4.0


def test_in_forward_flight_what_hovers_meets_the_air_of_the_wings():
    """Above the wind at 20 ft; in a hover the axes come to lie along the wind, against what blows."""
    wings, rotors = (
        Still(60.0, 20.0, np.zeros(3)).gusts(3, 20.0, aircraft=one) for one in (AEROSONDE, HOVERER)
    )
    assert_allclose(rotors, wings, atol=1e-9)
    wind = np.array([0.0, -4.0, 0.0])
    hover, north = Still(60.0, 0.0, wind), Still(60.0, carrying_speed(4), np.zeros(3))
    hover.values |= {f"velocities/v-{axis}-fps": 0.0 for axis in ("north", "east", "down")}
    upwind = hover.gusts(3, 20.0, aircraft=HOVERER)[200:]  # 90 deg to the east, which takes a second
    along = north.gusts(3, 20.0, aircraft=HOVERER)[200:]
    assert_allclose(upwind[:, 1], along[:, 0], atol=1e-9)
    assert_allclose(upwind[:, 0], -along[:, 1], atol=1e-9)


def test_u_is_along_the_path_through_the_air_whatever_the_wind():
    """The same run eastbound is that northbound, turned; a crosswind changes neither."""
    north = Still(300.0, 40.0, np.zeros(3)).gusts(3, 20.0)
    east = Still(300.0, 40.0, np.array([7.0, -3.0, 0.0]), heading=pi / 2).gusts(3, 20.0)
    assert_allclose(east[:, 1], north[:, 0], atol=1e-9)
    assert_allclose(east[:, 0], -north[:, 1], atol=1e-9)
    assert_allclose(east[:, 2:], north[:, 2:], atol=1e-12)


def flown(alt, ground, **changes):
    """Straight for 20 s over the ground of a runway."""
    runway = replace(read_profile("circuit").flight.runway, alt=ground)
    values = {"severity": 4, "turbulence_seed": 4, "runway": runway, "alt": alt} | changes
    return fly(plan(Straight(20.0), **values))


def test_turbulence_follows_the_height_above_ground_not_above_the_sea():
    """60 m above ground at sea level and at 900 m are the same air; 960 m above the sea is another."""
    low, mountain, high = flown(60.0, 0.0), flown(960.0, 900.0), flown(960.0, 0.0)
    gust, same, other = (truth.air.wind_n[:, 2] for truth in (low, mountain, high))
    assert np.corrcoef(gust, same)[0, 1] > 0.99
    assert np.corrcoef(gust, other)[0, 1] < 0.9
    # much less height, much shorter waves: the gust changes faster for its size
    quick = [np.diff(column).std() / column.std() for column in (gust, other)]
    assert quick[0] > 1.5 * quick[1]


@pytest.mark.parametrize(
    ("profile", "alt", "speed"),
    [("figure-eight", 200.0, 25.0), ("circuit-navion", 200.0, 53.0), ("climb-cruise-descend", 400.0, 85.0)],
)
def test_the_rates_of_the_air_turn_the_aircraft(profile, alt, speed):
    """The air turns the aircraft with it, about each axis."""
    aircraft = read_profile(profile).flight.aircraft
    fdm = load_aircraft(aircraft, 0.0025)
    trim_aircraft(fdm, TrimCondition(radians(47.0), radians(11.0), alt, 0.5, speed))
    still = present_accelerations(fdm)[3:]
    for axis, name in enumerate(RATES):
        fdm[name] = 0.02
        wait(fdm, 1)
        turned = present_accelerations(fdm)[3:] - still
        assert turned[axis] > 1e-4, name
        fdm[name] = 0.0
        wait(fdm, 1)


def test_the_step_of_a_calm_flight_is_that_of_jsbsim():
    fdm = load_aircraft(AEROSONDE, 0.0025)
    assert through_turbulence(fdm, plan(Straight(1.0)), 0.0025) == fdm.run


def test_a_step_is_that_of_van_loan():
    """Transition and covariance by the exponential of one matrix (1978); scale and lag may be equal."""
    rng, root = np.random.default_rng(1), np.sqrt(3.0)
    for k in range(200):
        length, tail = 10.0 ** rng.uniform(0.3, 2.8), 10.0 ** rng.uniform(0.0, 1.9)
        if k % 4 == 0:
            tail = length * (1.0 + (k % 8) * 10.0 ** rng.uniform(-14.0, -1.0))
        step = min(length, tail) * (0.0 if k == 1 else 10.0 ** rng.uniform(-6.0, 0.3))
        A = np.array([[-1.0, 0.0, 0.0], [1.0, -1.0, 0.0], [0.0, 0.0, 0.0]]) / length
        A[2] = root / tail, (1.0 - root) / tail, -1.0 / tail
        pair = np.block([[-A, np.diag([1.0 / length, 0.0, 0.0])], [np.zeros((3, 3)), A.T]])
        both = expm(pair * step)
        phi, noise = discretize_chain(length, tail, step)
        assert_allclose(phi, both[3:, 3:].T, rtol=0, atol=1e-13)
        assert_allclose(noise @ noise.T, both[3:, 3:].T @ both[:3, 3:], rtol=0, atol=1e-13)
