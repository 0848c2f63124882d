"""Satellites: Kepler's laws, derivatives, broadcast sets against each other, the DOP table."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.optimize import brentq
from scipy.spatial.transform import Rotation

from bench.core.mathematics import earth
from bench.core.records.orbit_sets import BEIDOU, GALILEO, GLONASS, GPS, KEPLER, GlonassSets, KeplerSets
from bench.plugins.receiver import almanac
from bench.plugins.receiver.rinex import ephemerides, lines
from bench.simulation.signals import dilution, orbits
from bench.simulation.signals.orbits import C
from tests.data import gnss_file
from tests.signals.test_least_squares import view


def eccentric(**elements):
    """One satellite with every kind of term, exaggerated."""
    values = (
        dict.fromkeys(KEPLER, 0.0)
        | {
            "t_oe": 7200.0,
            "t_oe_week": 266400.0,
            "t_oc": 7000.0,
            "sqrt_a": 5153.6,
            "e": 0.02,
            "i_0": 0.96,
            "i_rate": 4e-10,
            "node_0": 1.1,
            "node_rate": -8e-9,
            "perigee": 0.7,
            "mean_anomaly": 0.3,
            "delta_n": 4.5e-9,
            "c_uc": -2e-6,
            "c_us": 6e-6,
            "c_rc": 230.0,
            "c_rs": -45.0,
            "c_ic": 1e-7,
            "c_is": 3e-8,
            "af_0": 1e-4,
            "af_1": 1e-11,
            "af_2": 1e-17,
        }
        | elements
    )
    return KeplerSets(np.array([5]), np.array([True]), np.array([[values[n] for n in KEPLER]]))


def at(sets, t, row=0):
    t = np.atleast_1d(np.asarray(t, float))
    return orbits.compute_states(sets, np.full(len(t), row), t)


def test_velocity_and_clock_rate_are_the_derivatives():
    """Central differences over 1 s leave 1e-5 m/s of the fourth derivative and 1e-8 of rounding."""
    sets, t, h = eccentric(), np.linspace(0.0, 14400.0, 97), 0.5
    before, here, after = at(sets, t - h), at(sets, t), at(sets, t + h)
    assert_allclose((after.pos_e - before.pos_e) / (2 * h), here.vel_e, rtol=0, atol=1e-5)
    change = (after.clock + after.relativity - before.clock - before.relativity) / (2 * h)
    assert_allclose(C * change, C * here.clock_rate, rtol=0, atol=1e-5)


def position_and_clock(sat, t):
    """Position and clock of a set by IS-GPS-200, table 20-IV, with rotation matrices instead of formulas."""
    dt = t - sat["t_oe"]
    semi_axis = sat["sqrt_a"] ** 2
    mean = sat["mean_anomaly"] + (np.sqrt(3.986005e14 / semi_axis**3) + sat["delta_n"]) * dt
    anomaly = brentq(lambda E: E - sat["e"] * np.sin(E) - mean, mean - 0.1, mean + 0.1, xtol=1e-15)
    true = 2 * np.arctan(np.sqrt((1 + sat["e"]) / (1 - sat["e"])) * np.tan(anomaly / 2))
    phi = true + sat["perigee"]
    wave = np.array([np.cos(2 * phi), np.sin(2 * phi)])
    u = phi + wave @ [sat["c_uc"], sat["c_us"]]
    r = semi_axis * (1 - sat["e"] * np.cos(anomaly)) + wave @ [sat["c_rc"], sat["c_rs"]]
    incl = sat["i_0"] + wave @ [sat["c_ic"], sat["c_is"]] + sat["i_rate"] * dt
    # the node in the Earth-fixed axes: node_0 is that of the start of the week
    node = sat["node_0"] + sat["node_rate"] * dt - orbits.GPS_EARTH_RATE * (sat["t_oe_week"] + dt)
    turn = Rotation.from_euler("ZXZ", [node, incl, u])
    since = t - sat["t_oc"]
    return turn.apply([r, 0.0, 0.0]), sat["af_0"] + sat["af_1"] * since + sat["af_2"] * since**2


@pytest.mark.parametrize(
    "changed", [{}, {"t_oe_week": 0.0}, {"af_1": 0.0}, {"t_oc": -3000.0}, {"af_2": 1e-15}]
)
def test_position_and_clock_are_those_of_the_interface_document(changed):
    """Positions to 1e-6 m, a dozen roundings of 26 000 km; clocks to 1e-9 m of range."""
    sets = eccentric(**changed)
    values = dict(zip(KEPLER, sets.elements[0], strict=True))
    times = np.linspace(0.0, 14400.0, 13)
    found = at(sets, times)
    for k, t in enumerate(times):
        pos_e, clock = position_and_clock(values, t)
        assert_allclose(found.pos_e[k], pos_e, rtol=0, atol=1e-6)
        assert_allclose(C * found.clock[k], C * clock, rtol=0, atol=1e-9)


def test_another_origin_of_time_moves_no_satellite():
    """t_oe and t_oc count from the origin, t_oe_week from the start of the week: it stays."""
    sets = eccentric()
    assert_allclose(at(sets.shift_origin(5000.0), 3000.0).pos_e, at(sets, 8000.0).pos_e, rtol=0, atol=1e-6)
    assert_allclose(at(sets.shift_origin(5000.0), 3000.0).clock, at(sets, 8000.0).clock, rtol=0, atol=1e-18)


def test_without_harmonics_the_inertial_motion_keeps_keplers_laws():
    """Energy and angular momentum of the two-body problem, radius at perigee; written anew."""
    off = dict.fromkeys(
        ["i_rate", "node_rate", "delta_n", "c_uc", "c_us", "c_rc", "c_rs", "c_ic", "c_is"], 0.0
    )
    sets, t = eccentric(**off), np.linspace(0.0, 43000.0, 200)
    found = at(sets, t)
    angle = orbits.GPS_EARTH_RATE * t
    turn = np.array(
        [
            [np.cos(angle), -np.sin(angle), 0 * t],
            [np.sin(angle), np.cos(angle), 0 * t],
            [0 * t, 0 * t, 1 + 0 * t],
        ]
    )
    pos = np.einsum("ijk,kj->ki", turn, found.pos_e)
    vel = np.einsum("ijk,kj->ki", turn, found.vel_e + np.cross([0, 0, orbits.GPS_EARTH_RATE], found.pos_e))
    a, gm = 5153.6**2, 3.986005e14
    energy = 0.5 * np.sum(vel**2, axis=1) - gm / np.linalg.norm(pos, axis=1)
    assert_allclose(energy, -gm / (2 * a), rtol=1e-12)
    momentum = np.cross(pos, vel)
    assert_allclose(
        momentum, np.broadcast_to(momentum[0], momentum.shape), rtol=0, atol=1e-11 * np.abs(momentum).max()
    )
    assert_allclose(momentum[0, 2] / np.linalg.norm(momentum[0]), np.cos(0.96), rtol=1e-12)
    assert_allclose(np.linalg.norm(pos, axis=1).min(), a * (1 - 0.02), rtol=1e-4)


def test_relativity_is_twice_position_times_velocity():
    """The eccentric clock term equals -2 r.v / c^2 of the two-body motion (IS-GPS-200, 20.3.3.3.3.1)."""
    off = dict.fromkeys(
        ["i_rate", "node_rate", "delta_n", "c_uc", "c_us", "c_rc", "c_rs", "c_ic", "c_is"], 0.0
    )
    found = at(eccentric(**off), np.linspace(0.0, 43000.0, 50))
    product = np.sum(found.pos_e * found.vel_e, axis=1)  # the rotation of the frame does no work on it
    assert_allclose(C * found.relativity, -2 * product / C, rtol=0, atol=1e-6)
    assert np.abs(C * found.relativity).max() > 10


def test_the_runge_kutta_step_is_small_enough(monkeypatch):
    """15 min in steps of 60 s and of 10 s are within 1 mm; in steps of 300 s they are not."""
    state = np.array(
        [[0.0, -23809.8e3, -8908.9e3, 2209.4e3, 228.9, 253.6, 3556.0, -3.7e-6, 9.3e-7, -1.9e-6, 1e-5, 1e-12]]
    )
    sets = GlonassSets(np.array([3]), np.array([True]), np.array([5]), state)
    rows, t = np.zeros(3, np.int64), np.array([-900.0, 450.0, 900.0])
    found = {}
    for step in (10.0, 60.0, 300.0):
        monkeypatch.setattr(orbits, "STEP_PZ", step)
        clock = orbits.compute_states(sets, rows, t).clock
        found[step] = orbits.compute_states(sets, rows, t).pos_e
    assert np.abs(found[60.0] - found[10.0]).max() < 1e-3
    assert np.abs(found[300.0] - found[10.0]).max() > 1e-3
    assert_allclose(clock, 1e-5 + 1e-12 * t, rtol=1e-12)


def test_glonass_motion_keeps_its_energy_in_the_rotating_frame():
    """v^2/2 - U(J2) - (w x r)^2/2 is constant without sun and moon: Jacobi's integral."""
    state = np.array([[0.0, -23809.8e3, -8908.9e3, 2209.4e3, 228.9, 253.6, 3556.0, 0, 0, 0, 0, 0]])
    sets = GlonassSets(np.array([3]), np.array([True]), np.array([5]), state)
    found = at(sets, np.linspace(-1800.0, 1800.0, 61))
    r = np.linalg.norm(found.pos_e, axis=1)
    sin2 = (found.pos_e[:, 2] / r) ** 2
    potential = 3.986004418e14 / r * (1 - 1.08262575e-3 * (6378136.0 / r) ** 2 * (1.5 * sin2 - 0.5))
    spin = 0.5 * 7.292115e-5**2 * np.sum(found.pos_e[:, :2] ** 2, axis=1)
    jacobi = 0.5 * np.sum(found.vel_e**2, axis=1) - potential - spin
    assert np.ptp(jacobi) < 1e-11 * potential.mean()


@pytest.mark.parametrize(
    ("name", "median", "most"), [("brdc3050.12n", 0.28, 3.0), ("brdc3050.12g", 0.96, 5.1)]
)
def test_two_consecutive_broadcast_sets_meet_half_way(name, median, most):
    """Independent computation of the same files: median 0.28 m (max 3.0) GPS, 0.96 m (max 5.1) GLONASS."""
    nav = ephemerides.read_navigation(gnss_file(name))
    sets = nav.gps if len(nav.gps) else nav.glonass
    sets = sets.shift_origin(float(sets.t.min()))
    apart, longest = [], 7200.0 if len(nav.gps) else 1800.0
    for sat in np.unique(sets.sat):
        mine = np.flatnonzero((sets.sat == sat) & sets.healthy)
        times, first = np.unique(sets.t[mine], return_index=True)
        mine = mine[first]
        for k in range(len(mine) - 1):
            if 0 < times[k + 1] - times[k] <= longest:
                middle = 0.5 * (times[k] + times[k + 1])
                apart.append(
                    np.linalg.norm(at(sets, middle, mine[k]).pos_e - at(sets, middle, mine[k + 1]).pos_e)
                )
    assert len(apart) > 250
    assert abs(np.median(apart) - median) < 0.05
    assert max(apart) < most + 0.05


def test_a_track_follows_its_ephemerides():
    """Positions and clocks within rounding, rates within 1e-6 m/s, anywhere in the span."""
    sets = eccentric()
    _, track = orbits.fit_track(sets, 0.0, 3600.0)
    out = np.empty(8)
    for t in np.linspace(0.0, 3600.0, 41):
        orbits.track_kernel(track.t_0, track.step, track.coefficients, 0, t, True, out)
        found = at(sets, t)
        assert_allclose(out[:3], found.pos_e[0], rtol=0, atol=3e-7)
        assert_allclose(out[4:7], found.vel_e[0], rtol=0, atol=1e-6)
        assert_allclose(out[3], C * (found.clock[0] + found.relativity[0]), rtol=0, atol=1e-7)
        rates = out.copy()
        orbits.track_kernel(track.t_0, track.step, track.coefficients, 0, t, False, out)
        assert_allclose(out[:3], rates[:3], rtol=0, atol=3e-7)


def test_the_nearest_healthy_set_serves():
    sets = KeplerSets(np.array([3, 3, 3, 7]), np.array([True, True, False, True]), np.zeros((4, len(KEPLER))))
    sets.elements[:, 0] = [7200.0, 0.0, 14400.0, 0.0]
    sat, t = np.array([3, 3, 3, 7, 9]), np.array([3000.0, 4000.0, 14400.0, 8000.0, 0.0])
    assert orbits.find_nearest(sets, sat, t, 7200.0).tolist() == [1, 0, 0, -1, -1]


def test_the_instant_of_transmission_is_that_of_the_satellites_clock():
    """A receiver whose own clock is wrong by 1 ms still finds when and where the signal left."""
    sets = eccentric()
    t_sent, wrong = 5000.0, 1e-3
    found = at(sets, t_sent)
    showed = t_sent + found.clock[0] + found.relativity[0]
    tag = 5000.08 + wrong
    got, states = orbits.find_transmission(
        sets, np.zeros(1, int), np.array([tag]), np.array([C * (tag - showed)])
    )
    assert_allclose(got, t_sent, rtol=0, atol=1e-12)
    assert_allclose(states.pos_e, found.pos_e, rtol=0, atol=1e-7)


REFERENCE = {  # phi 50 deg, mask 5 deg, 24 h
    "gps": ((7, 7.8, 10), (0.97, 1.34, 1.70, 0.84, 1.90), 2.51),
    "glonass": ((7, 8.5, 10), (0.99, 1.52, 1.81, 0.87, 2.01), 2.23),
    "both": ((14, 16.3, 19), (0.66, 0.95, 1.16, 0.64, 1.46), 1.61),
}


@pytest.mark.parametrize("which", REFERENCE)
def test_dop_table_of_the_nominal_constellations(which):
    """Register A-2.1.2 and #25 within 0.05, at the longitude 30 deg of its other examples."""
    sets = {"gps": [orbits.make_nominal(GPS)], "glonass": [orbits.make_nominal(GLONASS)]}
    sets["both"] = sets["gps"] + sets["glonass"]
    there = np.array([np.deg2rad(50.0), np.deg2rad(30.0), 0.0])
    seen = view(
        sets[which],
        there,
        np.arange(0.0, 86400.0, 60.0),
        np.deg2rad(5.0),
        first=1 if which == "glonass" else 0,
    )
    count, medians, most = REFERENCE[which]
    visible = np.diff(seen.epoch_start)
    assert (visible.min(), visible.max()) == (count[0], count[2])
    assert abs(visible.mean() - count[1]) < 0.06
    dop = dilution.compute_dop(seen.epoch_start, seen.los_n, seen.system)
    assert_allclose([np.median(d) for d in dop], medians, rtol=0, atol=0.05)
    assert abs(dop.p.max() - most) < 0.05
    assert visible.min() >= 4


def test_nominal_beidou_stands_where_the_icd_has_it_and_moves_as_a_figure_of_eight():
    """Three satellites stand above 80, 110.5 and 140 deg E to 0.01 deg; three share one track about 118 E,
    as far north as they are inclined, and repeat it after a sidereal day, 86 164.1 s."""
    sets = orbits.make_nominal(BEIDOU)
    assert len(np.unique(sets.sat)) == len(sets) == 30
    t = np.arange(0.0, 86164.0, 600.0)
    for number, east in ((59, 80.0), (60, 110.5), (61, 140.0)):
        there = at(sets, t, int(np.flatnonzero(sets.sat == number)[0]))
        lla = np.rad2deg(earth.to_geodetic(there.pos_e)[:, :2])
        assert_allclose(lla, np.broadcast_to([0.0, east], lla.shape), rtol=0, atol=0.01)
        assert np.abs(there.vel_e).max() < 0.1
    tracks = []
    for number in (43, 44, 45):
        there = at(sets, t, int(np.flatnonzero(sets.sat == number)[0]))
        tracks.append(there.pos_e)
        assert_allclose(np.rad2deg(np.arcsin(np.abs(there.pos_e[:, 2]).max() / 42164170.0)), 55.0, atol=0.2)
        again = at(sets, t + 86164.0905, int(np.flatnonzero(sets.sat == number)[0]))
        assert_allclose(again.pos_e, there.pos_e, rtol=0, atol=1e4)
    near = np.linalg.norm(tracks[0][:, None] - tracks[1], axis=2).min(axis=1)
    assert near.max() < 1.2e6  # the next of 600 s: one track, not two 80 deg apart
    mean = np.mean([np.arctan2(p[:, 1], p[:, 0]).mean() for p in tracks])
    assert abs(np.rad2deg(mean) - 118.0) < 0.5


def test_nominal_galileo_turns_in_its_own_time():
    """17 turns in ten sidereal days: 14 h 4 min 42 s, to a minute, for the axis is rounded; three planes."""
    sets = orbits.make_nominal(GALILEO)
    assert len(sets) == 24
    assert len(np.unique(np.round(sets.get("node_0"), 6))) == 3
    period = 2 * np.pi * np.sqrt(sets.get("sqrt_a")[0] ** 6 / 3.986004418e14)
    assert abs(period - 861640.905 / 17) < 60
    assert sets.system == GALILEO


@pytest.mark.parametrize(
    ("name", "day", "week", "sick"),
    [("yuma_2015-05-06.txt", (2015, 5, 6), 1843, []), ("yuma_2022-02-17.txt", (2022, 2, 17), 2197, [11])],
)
def test_yuma_almanacs_fly_like_gps(name, day, week, sick):
    """Weeks count modulo 1024; radii of 26 560 km, 55 deg, a repeat after a sidereal day, six planes."""
    near = lines.gps_seconds(*day)
    sets = almanac.read_yuma(gnss_file(name), near)
    assert len(sets) == 31
    assert sets.sat[~sets.healthy].tolist() == sick
    assert (sets.t // orbits.WEEK == week).all()
    sets = sets.shift_origin(near)
    now = orbits.compute_states(sets, np.arange(31), np.zeros(31))
    later = orbits.compute_states(sets, np.arange(31), np.full(31, 86164.1))
    assert np.abs(np.linalg.norm(now.pos_e, axis=1) - 26.56e6).max() < 0.7e6
    assert np.median(np.linalg.norm(later.pos_e - now.pos_e, axis=1)) < 60e3
    top = np.abs(earth.to_geodetic(now.pos_e)[:, 0]).max()
    assert top < np.deg2rad(57.5)
