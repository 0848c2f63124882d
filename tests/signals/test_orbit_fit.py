"""Messages fitted to satellites: nominal orbits come back exactly, broadcast ones to a millimeter."""

from __future__ import annotations

import numpy as np
import pytest

from bench.core.records.orbit_sets import BEIDOU, GALILEO, GLONASS, GPS, GlonassSets
from bench.plugins.receiver.rinex.ephemerides import read_navigation
from bench.simulation.signals import orbits
from bench.simulation.signals.orbit_fit import fit_glonass, fit_kepler
from bench.simulation.signals.orbits import WEEK, C
from tests.data import gnss_file

BROADCAST = read_navigation(gnss_file("ESBC00DNK_2020177_GREC_MN.rnx")).list_sets()


def distances(sets, sat, middle, span):
    """Largest error of position [m], velocity [m/s] and clock [m] of a message fitted to samples of 10 s."""
    t = middle + np.linspace(-span / 2, span / 2, int(span / 10) + 1)
    row = orbits.find_nearest(sets, np.array([sat]), np.array([middle]), np.inf)
    true = orbits.compute_states(sets, np.repeat(row, len(t)), t)
    clock = C * (true.clock + true.relativity)
    if isinstance(sets, GlonassSets) or sets.system == GLONASS:
        found = fit_glonass(sat, 0, middle, t, true.pos_e, true.vel_e, clock)
    else:
        found = fit_kepler(sat, sets.system, middle, middle % WEEK, t, true.pos_e, true.vel_e, clock)
    again = orbits.compute_states(found, np.zeros(len(t), np.int64), t)
    apart = C * (again.clock + again.relativity) - clock
    return [np.abs(one).max() for one in (again.pos_e - true.pos_e, again.vel_e - true.vel_e, apart)]


@pytest.mark.parametrize("system", [GPS, GALILEO, BEIDOU])
def test_nominal_orbits_come_back_exactly(system):
    """Circles, over a message and over a time; those of BeiDou geostationary and inclined, too."""
    nominal = orbits.make_nominal(system)
    for sat in nominal.sat:
        for span in (0.0, 300.0):
            position, velocity, clock = distances(nominal, int(sat), 45000.0, span)
            assert (position < 1e-6, velocity < 1e-9, clock < 1e-9) == (True, True, True)


@pytest.mark.parametrize("system", [GPS, GALILEO, BEIDOU])
def test_an_instant_away_from_the_reference_time_tells_a_circle(system):
    nominal = orbits.make_nominal(system)
    for row, sat in enumerate(nominal.sat.tolist()):
        t = np.array([44900.0, 45100.0])
        true = orbits.compute_states(nominal, np.array([row, row]), t)
        one = [t[:1], true.pos_e[:1], true.vel_e[:1], np.zeros(1)]
        found = orbits.compute_states(
            fit_kepler(sat, system, 45000.0, 45000.0, *one), np.zeros(2, np.int64), t
        )
        assert np.abs(found.pos_e - true.pos_e).max() < 1e-5


@pytest.mark.parametrize(
    ("system", "span"), [(GPS, 300.0), (GALILEO, 300.0), (BEIDOU, 300.0), (GLONASS, 120.0)]
)
def test_broadcast_orbits_come_back_to_two_millimeters(system, span):
    """With their harmonics and clocks, anywhere in their hours: a few of each constellation."""
    sets = BROADCAST[system][0]
    for sat in np.unique(sets.sat[sets.healthy])[::4]:
        middle = float(np.round(np.median(sets.t[sets.sat == sat]))) + 1000.0
        position, velocity, clock = distances(sets, int(sat), middle, span)
        assert position < 2e-3, sat
        assert velocity < 2e-4, sat
        assert clock < 2e-3, sat


@pytest.mark.parametrize(("span", "far", "fast"), [(120.0, 5e-4, 1e-4), (900.0, 0.2, 3e-3)])
def test_glonass_of_two_bodies_is_followed_with_an_acceleration(span, far, fast):
    """The nominal orbit has no J2. Without the acceleration 0.1 m is left over two minutes."""
    nominal = orbits.make_nominal(GLONASS)
    for sat in nominal.sat[::5]:
        position, velocity, _ = distances(nominal, int(sat), 45000.0, span)
        assert position < far
        assert velocity < fast


def test_an_instant_of_glonass_far_from_the_reference_time_needs_no_acceleration():
    nominal = orbits.make_nominal(GLONASS)
    true = orbits.compute_states(nominal, np.zeros(1, np.int64), np.array([45450.0]))
    found = fit_glonass(1, 0, 45000.0, np.array([45450.0]), true.pos_e, true.vel_e, np.zeros(1))
    assert np.abs(found.state[0, 7:10]).max() < 1e-6
    again = orbits.compute_states(found, np.zeros(1, np.int64), np.array([45450.0]))
    assert np.abs(again.pos_e - true.pos_e).max() < 1e-5


def test_an_eccentricity_is_never_negative():
    """Epochs that run fast by 1e-7 make a circle an ellipse; its other apsis is the perigee."""
    nominal, t = orbits.make_nominal(GPS), 45000.0 + np.linspace(-150.0, 150.0, 31)
    signs = set()
    for row, sat in list(enumerate(nominal.sat.tolist()))[::3]:
        true = orbits.compute_states(nominal, np.full(len(t), row), t)
        for rate in (1e-7, -1e-7):
            told = t + rate * (t - 44900.0)
            found = fit_kepler(sat, GPS, 45000.0, 45000.0, told, true.pos_e, true.vel_e, np.zeros(len(t)))
            again = orbits.compute_states(found, np.zeros(len(t), np.int64), told)
            assert np.abs(again.pos_e - true.pos_e).max() < 2e-2
            assert found.get("e")[0] >= 0.0
            signs.add(bool(np.cos(found.get("mean_anomaly")[0]) > 0))
    assert signs == {True, False}
