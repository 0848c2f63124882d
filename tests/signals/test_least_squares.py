"""Fixes: exact without noise from the center of the Earth, DOP predicts the error, faults are found.

Statistical bounds are two-sided 99.9 % bands of their statistic at fixed seeds.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import pytest
from numpy.testing import assert_allclose

from bench.core.mathematics import earth
from bench.core.records.orbit_sets import GLONASS, GPS
from bench.simulation.signals import delays, dilution, fault_test, least_squares, orbits
from bench.simulation.signals.orbits import GPS_EARTH_RATE

THERE = np.array([np.deg2rad(50.0), np.deg2rad(30.0), 1200.0])


class View(NamedTuple):
    epoch_start: np.ndarray
    system: np.ndarray
    los_n: np.ndarray
    pos_e: np.ndarray  # at transmission
    vel_e: np.ndarray
    distance: np.ndarray
    rate: np.ndarray  # for a receiver moving at VELOCITY_E


VELOCITY_E = np.array([60.0, -180.0, 90.0])


def view(constellations, lla, t, mask, first=0):
    """Satellites above the mask; distances by an iteration that turns vectors, not by the kernels."""
    here = earth.to_ecef(lla)
    C_en = earth.matrix_en(lla[0], lla[1])
    rows = []
    for system, sets in enumerate(constellations, first):
        which, when = np.tile(np.arange(len(sets)), len(t)), np.repeat(t, len(sets))
        travel = np.full(len(when), 0.07)
        for _ in range(5):
            found = orbits.compute_states(sets, which, when - travel)
            c, s = np.cos(GPS_EARTH_RATE * travel), np.sin(GPS_EARTH_RATE * travel)
            turned = np.column_stack(
                [
                    c * found.pos_e[:, 0] + s * found.pos_e[:, 1],
                    c * found.pos_e[:, 1] - s * found.pos_e[:, 0],
                    found.pos_e[:, 2],
                ]
            )
            travel = np.linalg.norm(turned - here, axis=1) / orbits.C
        distance = np.linalg.norm(turned - here, axis=1)
        los_n = (turned - here) / distance[:, None] @ C_en
        rows.append(
            (
                np.repeat(np.arange(len(t)), len(sets)),
                np.full(len(when), system),
                los_n,
                found.pos_e,
                found.vel_e,
                distance,
                np.zeros(len(when)),
            )
        )
    epoch, system, los_n, pos, vel, distance, rate = (np.concatenate(c) for c in zip(*rows, strict=True))
    seen = -los_n[:, 2] > np.sin(mask)
    order = np.argsort(epoch[seen], kind="stable")
    start = np.searchsorted(epoch[seen][order], np.arange(len(t) + 1))
    return View(start, *(c[seen][order] for c in (system, los_n, pos, vel, distance, rate)))


@pytest.fixture(scope="module")
def both():
    sets = [orbits.make_nominal(GPS), orbits.make_nominal(GLONASS)]
    return view(sets, THERE, np.arange(0.0, 86400.0, 300.0), np.deg2rad(5.0))


def epoch_of(seen):
    return np.repeat(np.arange(len(seen.epoch_start) - 1), np.diff(seen.epoch_start))


def test_from_the_center_of_the_earth_in_six_steps(both):
    """B-13, #56: 1e-8 m after at most 6 steps; every epoch starts at the center here."""
    clock = np.array([5000.0, -3000.0])
    measured = both.distance + clock[both.system]
    center = np.zeros((len(both.epoch_start) - 1, 3))
    fix = least_squares.solve_positions(
        both.epoch_start, both.pos_e, measured, np.ones(len(measured)), both.system, start_e=center
    )
    assert fix.steps.max() <= 6
    apart = np.linalg.norm(fix.pos_e - earth.to_ecef(THERE), axis=1)
    assert np.median(apart) < 1e-8
    assert apart.max() < 4e-8  # ranges of 2e7 m are rounded to 4e-9 m
    assert_allclose(fix.clock[:, :2], np.broadcast_to(clock, (len(fix.clock), 2)), rtol=0, atol=1e-7)
    assert np.isnan(fix.clock[:, 2:]).all()
    assert fix.passed.all()
    assert fix.used.all()


def test_without_sagnac_the_fix_goes_east(both):
    """Ranges are wrong by 12.9 m in the mean at 50 deg (B-12); the fix by 23 m, nearly all of it east."""
    gps = both.system == 0
    sat, here = both.pos_e.T, earth.to_ecef(THERE)
    added = orbits.GPS_EARTH_RATE / orbits.C * (sat[0] * here[1] - sat[1] * here[0])
    assert abs(np.abs(added[gps]).mean() - 12.9) < 0.3
    away = np.linalg.norm(both.pos_e - earth.to_ecef(THERE), axis=1)
    assert_allclose(both.distance - away, added, rtol=0, atol=1e-3)
    ones = np.ones(len(away))
    exact = least_squares.solve_positions(both.epoch_start, both.pos_e, both.distance, ones, both.system)
    wrong = least_squares.solve_positions(
        both.epoch_start, both.pos_e, both.distance, ones, both.system, sagnac=False
    )
    shift_n = (wrong.pos_e - exact.pos_e) @ earth.matrix_en(THERE[0], THERE[1])
    assert 20 < shift_n[:, 1].mean() < 27
    assert np.abs(shift_n[:, [0, 2]]).max() < 2.5


def test_one_clock_for_two_systems_is_wrong_by_their_offset(both):
    measured = both.distance + 6.2 * both.system
    ones = np.ones(len(measured))
    two = least_squares.solve_positions(both.epoch_start, both.pos_e, measured, ones, both.system)
    one = least_squares.solve_positions(
        both.epoch_start, both.pos_e, measured, ones, both.system, one_clock=True
    )
    assert np.linalg.norm(two.pos_e - earth.to_ecef(THERE), axis=1).max() < 1e-7
    assert np.median(np.linalg.norm(one.pos_e - earth.to_ecef(THERE), axis=1)) > 0.3


def test_doppler_velocity_is_exact(both):
    """B-14b, #57: 1e-9 m/s, clock drift included; the next test holds the range rate itself."""
    here = earth.to_ecef(THERE)
    closed = np.empty(len(both.system))
    for k in range(len(closed)):
        d, *e = delays.range_kernel(*both.pos_e[k], *here, GPS_EARTH_RATE)
        a, b = delays.range_rate_kernel(*both.pos_e[k], *both.vel_e[k], *here, *e, d, GPS_EARTH_RATE)
        closed[k] = (a - np.dot(e, VELOCITY_E)) / b
    M = len(both.epoch_start) - 1
    fix = least_squares.solve_velocities(
        both.epoch_start, both.pos_e, both.vel_e, closed + 77.0, np.full(len(closed), 0.1),
        np.ones(len(closed), bool), np.tile(here, (M, 1)),
    )  # fmt: skip
    assert np.abs(fix.vel_e - VELOCITY_E).max() < 1e-9
    assert np.abs(fix.drift - 77.0).max() < 1e-9


def test_the_range_rate_is_the_rate_of_the_range():
    """Differences of distances, each with its own emission time, to a receiver that moves at 200 m/s."""
    sets, h = orbits.make_nominal(GPS), 0.05
    t0, here = 30000.0, earth.to_ecef(THERE)

    def moved(t):
        there = here + VELOCITY_E * t
        travel = np.full(24, 0.07)
        for _ in range(6):
            found = orbits.compute_states(sets, np.arange(24), np.full(24, t0 + t) - travel)
            ranges = np.array([delays.range_kernel(*p, *there, GPS_EARTH_RATE)[0] for p in found.pos_e])
            travel = ranges / orbits.C
        return ranges, found

    (after, _), (before, _), (middle, found) = moved(h), moved(-h), moved(0.0)
    for k in range(24):
        d, *e = delays.range_kernel(*found.pos_e[k], *here, GPS_EARTH_RATE)
        a, b = delays.range_rate_kernel(*found.pos_e[k], *found.vel_e[k], *here, *e, d, GPS_EARTH_RATE)
        assert abs((a - np.dot(e, VELOCITY_E)) / b - (after[k] - before[k]) / (2 * h)) < 1e-6
    assert np.abs(middle).min() > 1.9e7


def test_rms_error_is_sd_times_pdop(both):
    """A-2.1.3: the ratio is 1 +- 0.03 over 4000 trials; 99.9 % of such ratios lie within 0.02."""
    draw, sd = np.random.default_rng(3), 2.0
    first = both.epoch_start[1]
    rows = np.tile(np.arange(first), 4000)
    start = np.arange(4001) * first
    measured = both.distance[rows] + draw.normal(scale=sd, size=len(rows))
    here = np.tile(earth.to_ecef(THERE), (4000, 1))
    fix = least_squares.solve_positions(
        start, both.pos_e[rows], measured, np.full(len(rows), sd), both.system[rows], start_e=here
    )
    rms = np.sqrt(np.mean(np.sum((fix.pos_e - here) ** 2, axis=1)))
    pdop = dilution.compute_dop(both.epoch_start[:2], both.los_n[:first], both.system[:first]).p[0]
    assert abs(rms / (sd * pdop) - 1) < 0.03
    assert_allclose(np.sqrt(np.trace(fix.cov_e[0])), sd * pdop, rtol=1e-3)
    ratio = fix.chi2.mean() / (first - 5)
    assert abs(ratio - 1) < 3.29 * np.sqrt(2 / (4000 * (first - 5)))


def test_weights_by_elevation_beat_equal_weights(both):
    """#56: with noise that grows towards the horizon; both fixes see the same noise."""
    draw = np.random.default_rng(4)
    sd = 0.5 / -both.los_n[:, 2]
    measured = both.distance + sd * draw.standard_normal(len(sd))
    fixes = [
        least_squares.solve_positions(both.epoch_start, both.pos_e, measured, weights, both.system)
        for weights in (sd, np.ones(len(sd)))
    ]
    weighted, plain = (np.sqrt(np.mean(np.sum((f.pos_e - earth.to_ecef(THERE)) ** 2, axis=1))) for f in fixes)
    assert weighted < 0.8 * plain


def test_dop_against_the_inverse_of_its_definition(both):
    for m in (0, 100):
        a, b = both.epoch_start[m : m + 2]
        G = np.column_stack([-both.los_n[a:b], both.system[a:b] == 0, both.system[a:b] == 1])
        Q = np.linalg.inv(G.T @ G)
        dop = dilution.compute_dop(both.epoch_start, both.los_n, both.system)
        expected = [Q[0, 0] + Q[1, 1], Q[2, 2], np.trace(Q[:3, :3]), Q[3, 3], np.trace(Q)]
        assert_allclose([d[m] for d in dop], np.sqrt(expected), rtol=1e-10)


@pytest.mark.parametrize("sd_glonass", [0.6, 1.5, 4.0])
def test_the_best_set_is_that_of_brute_force(both, sd_glonass):
    """#28: over 24 h, by inverting each of the three sets' own normal matrix."""
    sd = np.where(both.system == 0, 1.0, sd_glonass)
    use = np.ones(len(sd), bool)
    kept, chosen = dilution.choose_satellites(both.epoch_start, both.los_n, both.system, sd, use)
    for m in range(0, len(chosen), 7):
        a, b = both.epoch_start[m : m + 2]
        figures = []
        for wanted in ((0,), (1,), (0, 1)):
            rows = np.isin(both.system[a:b], wanted)
            G = np.column_stack(
                [both.los_n[a:b][rows], *((both.system[a:b][rows] == w) for w in wanted)]
            ).astype(float)
            Q = np.linalg.inv(G.T @ G)
            figures.append(np.sqrt(np.trace(Q[:3, :3]) * np.mean(sd[a:b][rows] ** 2)))
        best = (0, 1, 4)[np.argmin(figures)]  # 4: all systems
        assert chosen[m] == best
        numbers = {0: np.sum(both.system[a:b] == 0), 1: np.sum(both.system[a:b] == 1), 4: b - a}
        assert kept[a:b].sum() == numbers[best]
    assert len(set(chosen)) > 1 or sd_glonass != 1.5


def test_a_fault_is_found_and_left_out(both):
    """One range 40 m wrong in every epoch: detected and identified in nearly all, the fix as without it.

    Sound epochs are declared faulty at the stated rate: within the 99.9 % band of 1e-2 over 288 epochs.
    """
    draw = np.random.default_rng(5)
    M = len(both.epoch_start) - 1
    sound = both.distance + draw.standard_normal(len(both.system))
    victim = both.epoch_start[:-1] + np.arange(M) % np.diff(both.epoch_start)
    broken = sound.copy()
    broken[victim] += 40.0
    ones, here = np.ones(len(sound)), earth.to_ecef(THERE)

    def solved(measured, false_alarm):
        return least_squares.solve_positions(
            both.epoch_start, both.pos_e, measured, ones, both.system, false_alarm=false_alarm
        )

    found = solved(broken, 1e-2)
    assert np.mean(~found.used[victim]) > 0.97
    assert np.isnan(found.residual[~found.used]).all()
    error = [
        np.median(np.linalg.norm(f.pos_e - here, axis=1))
        for f in (found, solved(broken, 0.0), solved(sound, 0.0))
    ]
    assert error[0] < 1.3 * error[2]
    assert error[1] > 2 * error[2]
    clean = solved(sound, 1e-2)
    alarms = len(np.unique(epoch_of(both)[~clean.used]))
    assert 0 <= alarms <= 10  # binomial(288, 0.01): 0 to 10 hold 99.9 %


def test_normalized_residuals_are_those_of_their_formula(both):
    """Six satellites, of which some have little redundancy: v / sqrt(diag(R - H (H' W H)^-1 H')) by NumPy."""
    draw, here, count = np.random.default_rng(12), earth.to_ecef(THERE), 80
    gps = np.flatnonzero(both.system == 0)
    epoch = epoch_of(both)[gps]
    enough = np.flatnonzero(np.bincount(epoch) >= 6)
    rows = [draw.choice(gps[epoch == m], 6, replace=False) for m in draw.choice(enough, count)]
    at, sd = np.concatenate(rows), draw.uniform(0.5, 2.0, 6 * count)
    measured = both.distance[at] + draw.standard_normal(len(at))
    fix = least_squares.solve_positions(
        6 * np.arange(count + 1), both.pos_e[at], measured, sd, both.system[at],
        start_e=np.tile(here, (count, 1)), false_alarm=1e-9,
    )  # fmt: skip
    least = 1.0
    for m in np.flatnonzero(fix.passed):
        k = slice(6 * m, 6 * m + 6)
        H, R = np.column_stack([-both.los_n[at[k]], np.ones(6)]), np.diag(sd[k] ** 2)
        cov = R - H @ np.linalg.inv(H.T @ np.linalg.inv(R) @ H) @ H.T
        part = np.diag(cov) / np.diag(R)
        told = part > 1e-4
        expected = np.abs(fix.residual[k]) / np.sqrt(np.abs(np.diag(cov)))
        assert_allclose(fix.normalized[k][told], expected[told], rtol=1e-3)
        least = min(least, part[told].min())
    assert least < 0.02


def test_four_range_rates_give_a_velocity(both):
    rows = np.flatnonzero(both.system[: both.epoch_start[1]] == 0)[:4]
    here = earth.to_ecef(THERE)
    for count, known in ((4, True), (3, False)):
        use = np.arange(4) < count
        fix = least_squares.solve_velocities(
            np.array([0, 4]), both.pos_e[rows], np.zeros((4, 3)), np.zeros(4), np.ones(4), use, here[None]
        )
        assert np.isfinite(fix.vel_e).all() == known


def test_too_few_satellites_give_no_fix_and_the_next_epoch_recovers(both):
    use = np.ones(len(both.system), bool)
    a, b = both.epoch_start[1:3]
    use[a + 4 : b] = False
    use[a : a + 4] = both.system[a : a + 4] == 0
    lonely = both.system.copy()
    lonely[a] = 1  # four satellites, two clocks: five unknowns
    fix = least_squares.solve_positions(
        both.epoch_start, both.pos_e, both.distance, np.ones(len(use)), lonely, use=use
    )
    assert np.isnan(fix.pos_e[1]).all()
    assert not fix.passed[1]
    assert not fix.used[a:b].any()
    assert fix.passed[[0, 2]].all()


def test_what_is_not_finite_is_not_used(both):
    measured = both.distance.copy()
    measured[both.epoch_start[:-1]] = np.nan
    fix = least_squares.solve_positions(
        both.epoch_start, both.pos_e, measured, np.ones(len(measured)), both.system
    )
    assert not fix.used[both.epoch_start[:-1]].any()
    assert np.linalg.norm(fix.pos_e - earth.to_ecef(THERE), axis=1).max() < 1e-6


def test_the_inverse_against_numpy_and_a_singular_matrix():
    draw = np.random.default_rng(6)
    root = draw.standard_normal((3, 5, 7))
    want = root @ root.transpose(0, 2, 1)
    want[1] = 1.0
    inverse, regular = least_squares.invert(want)
    assert regular.tolist() == [True, False, True]
    assert_allclose((inverse @ want)[regular], np.broadcast_to(np.eye(5), (2, 5, 5)), rtol=0, atol=1e-9)


SKY = [orbits.make_nominal(GPS), orbits.make_nominal(GLONASS)]


def test_shared_errors_of_ranges_are_in_the_weights_the_covariance_and_the_tests():
    """Monte Carlo of an ionosphere correlated over the pierce points and a troposphere for all, 2000 epochs.

    NEES over 3 is 1, and normalized residuals have a variance of 1, within 99.9 % of these statistics; taken
    as independent errors of the same size, the NEES is outside; weights by the covariance beat them.
    """
    draw, count = np.random.default_rng(7), 2000
    seen = view(SKY, THERE, np.array([0.0]), np.deg2rad(10.0))
    n, here = len(seen.system), earth.to_ecef(THERE)
    el = np.arcsin(-seen.los_n[:, 2])
    slant = 1 + 16 * (0.53 - el / np.pi) ** 3
    points = least_squares.find_pierce_points(seen.los_n, el)
    apart = np.linalg.norm(points[:, None] - points, axis=-1)
    below = 0.3 / np.sin(el)
    own = np.full(n, 0.7)
    shared = 1.5**2 * np.outer(slant, slant) * np.exp(-apart / 3e6) + np.outer(below, below)
    errors = draw.multivariate_normal(np.zeros(n), np.diag(own**2) + shared, count)
    rows, start = np.tile(np.arange(n), count), n * np.arange(count + 1)

    def solve(sd, common):
        return least_squares.solve_positions(
            start, seen.pos_e[rows], (seen.distance + errors).ravel(), np.tile(sd, count), seen.system[rows],
            start_e=np.tile(here, (count, 1)), shared=common, false_alarm=1e-9,
        )  # fmt: skip

    tiled = least_squares.Shared(np.tile(1.5 * slant, count), np.tile(below, count), points[rows], 3e6)
    total = np.sqrt(np.diag(np.diag(own**2) + shared))
    nees, rms = {}, {}
    for name, fix in (("shared", solve(own, tiled)), ("alone", solve(total, None))):
        error = fix.pos_e - here
        nees[name] = np.einsum("mi,mij,mj->m", error, np.linalg.inv(fix.cov_e), error).mean() / 3
        rms[name] = np.sqrt(np.mean(error**2))
    half = 3.29 * np.sqrt(2 / (3 * count))
    assert abs(nees["shared"] - 1) < half
    assert abs(nees["alone"] - 1) > 3 * half
    assert rms["shared"] < rms["alone"]
    size = solve(own, tiled).normalized.reshape(count, n) ** 2
    assert np.abs(size.mean(axis=0) - 1).max() < 4.2 * np.sqrt(2 / count)  # the largest of n = 15


def test_faults_are_found_as_often_as_the_covariance_predicts():
    """A range 5.5 sigma off: the non-central normal beyond its threshold, within 99.9 %.

    The threshold of a row is by its odds; the chances of all rows, by SciPy, have the sum that is said.
    """
    from scipy.optimize import brentq
    from scipy.stats import norm

    draw, count, size = np.random.default_rng(8), 3000, 5.5
    seen = view(SKY, THERE, np.array([0.0]), np.deg2rad(10.0))
    n, here = len(seen.system), earth.to_ecef(THERE)
    G = np.column_stack([-seen.los_n, seen.system == 0, seen.system == 1]).astype(float)
    free = 1 - np.einsum("ij,jk,ik->i", G, np.linalg.inv(G.T @ G), G)
    victim = int(np.argmax(free))
    measured = seen.distance + draw.standard_normal((count, n))
    measured[:, victim] += size
    fix = least_squares.solve_positions(
        n * np.arange(count + 1), np.tile(seen.pos_e, (count, 1)), measured.ravel(), np.ones(n * count),
        np.tile(seen.system, count), start_e=np.tile(here, (count, 1)), false_alarm=1e-2,
    )  # fmt: skip
    margin = np.log(1 + 900.0 * free)
    odds = brentq(lambda c: 2 * norm.sf(np.sqrt(c + margin)).sum() - 1e-2, 0.0, 50.0)
    predicted = norm.cdf(size * np.sqrt(free[victim]) - np.sqrt(odds + margin[victim]))
    found = np.mean(~fix.used.reshape(count, n)[:, victim])
    assert abs(found - predicted) < 3.29 * np.sqrt(predicted * (1 - predicted) / count) + 0.01
    assert 0.3 < predicted < 0.95


@pytest.mark.parametrize("false_alarm", [0.3, 1e-2, 5e-3, 1e-6])
def test_the_likeliest_fault_alarms_as_often_as_is_said(false_alarm):
    """The threshold of one row is that of the normal distribution; of many their chances have the sum said.

    The odds are those of a fault whose size is uniform over a width of 30 m sqrt(2 pi), integrated by SciPy.
    """
    from scipy.integrate import quad
    from scipy.stats import norm

    limit = norm.isf(false_alarm / 2)
    w = np.array([[limit - 1e-3], [limit + 1e-3]])
    alarm, _ = fault_test.find_alarms(w, np.full((2, 1), 0.4), false_alarm)
    assert alarm.tolist() == [False, True]

    share = np.array([0.9, 0.3, 0.25, 0.1, 0.02, 0.0])
    told = share > 0
    margin = np.log(1 + (30 * share) ** 2)
    low, high = -10.0, 60.0
    for _ in range(60):  # the odds where the alarm begins, by the alarms alone
        middle = (low + high) / 2
        w = np.diag(np.sqrt(np.maximum(middle + margin, 0.0)))[:5] * told
        alarm, worst = fault_test.find_alarms(w, np.tile(share, (5, 1)), false_alarm)
        assert worst[alarm].tolist() == np.flatnonzero(alarm).tolist()
        low, high = (low, middle) if alarm[0] else (middle, high)
    chance = 2 * norm.sf(np.sqrt(np.maximum(high + margin, 0.0)))[told].sum()
    assert_allclose(chance, false_alarm, rtol=1e-3)

    w, wide = np.array([3.9, 4.05]), 30 * np.sqrt(2 * np.pi)
    for share in ([0.9, 0.3], [0.4, 0.35], [0.2, 0.9]):
        odds = [
            quad(lambda b, s=s, x=x: np.exp(b * s * x - (b * s) ** 2 / 2) / wide, -300, 300, limit=200)[0]
            for s, x in zip(share, w, strict=True)
        ]
        _, worst = fault_test.find_alarms(w[None], np.array([share]), false_alarm)
        assert worst[0] == np.argmax(odds)


def test_a_row_that_tells_nothing_has_no_fault():
    alarm, _ = fault_test.find_alarms(np.zeros((2, 3)), np.zeros((2, 3)), 5e-3)
    assert not alarm.any()


def lie(seen, here, rows, liars, draw):
    """Return the ranges of an epoch of which ``liars`` fit a place 24 km away, where three others do, too."""
    measured = np.array([delays.range_kernel(*p, *here, GPS_EARTH_RATE)[0] for p in seen.pos_e[rows]])
    sound = draw.choice([k for k in range(len(rows)) if k not in liars], 3, replace=False)
    x = np.append(here, 0.0)
    for step in range(8):  # along what three ranges leave open, then back to where they are right
        found = [delays.range_kernel(*seen.pos_e[rows[k]], *x[:3], GPS_EARTH_RATE) for k in sound]
        A = np.array([[-e for e in one[1:]] + [1.0] for one in found])
        if step == 0:
            along = np.linalg.svd(A)[2][3]
            x += 24e3 * along / np.linalg.norm(along[:3])
        else:
            x += np.linalg.pinv(A) @ (measured[sound] - [one[0] for one in found] - x[3])
    for k in liars:
        measured[k] = delays.range_kernel(*seen.pos_e[rows[k]], *x[:3], GPS_EARTH_RATE)[0] + x[3]
    return measured


@pytest.mark.parametrize("robust", [False, True])
@pytest.mark.parametrize("count", [7, 8])
def test_two_ranges_that_agree_on_a_false_place_do_not_win(count, robust):
    """With seven satellites as many ranges agree on it as on the truth: no fix. With eight, one less."""
    draw, trials = np.random.default_rng(10), 60
    seen = view(SKY[:1], THERE, np.arange(0.0, 86400.0, 900.0), np.deg2rad(0.0))
    here, first = earth.to_ecef(THERE), seen.epoch_start
    enough = np.flatnonzero(np.diff(first) >= count)
    rows, measured = [], []
    for _ in range(trials):
        m = draw.choice(enough)
        rows.append(draw.choice(np.arange(*first[m : m + 2]), count, replace=False))
        measured.append(lie(seen, here, rows[-1], draw.choice(count, 2, replace=False), draw))
    at, start = np.concatenate(rows), count * np.arange(trials + 1)
    fix = least_squares.solve_positions(
        start, seen.pos_e[at], np.concatenate(measured), np.ones(len(at)), seen.system[at],
        start_e=np.tile(here, (trials, 1)), false_alarm=5e-3, robust=robust,
    )  # fmt: skip
    if count == 7:
        assert not fix.passed.any()
    else:
        assert fix.passed.any()
    assert_allclose(fix.pos_e[fix.passed], np.tile(here, (fix.passed.sum(), 1)), rtol=0, atol=0.01)


def test_as_many_ranges_are_left_out_as_the_others_can_tell(both):
    """Faults of some hundred meters: k of them need 2 k redundant satellites, and no more."""
    draw, here = np.random.default_rng(11), earth.to_ecef(THERE)
    spare = np.diff(both.epoch_start) - 5
    for k in (1, 2, 3):
        measured = both.distance + 0.1 * draw.standard_normal(len(both.system))
        for a, b in zip(both.epoch_start[:-1], both.epoch_start[1:], strict=True):
            measured[draw.choice(np.arange(a, b), k, replace=False)] += draw.uniform(300, 900, k)
        fix = least_squares.solve_positions(
            both.epoch_start,
            both.pos_e,
            measured,
            np.ones(len(measured)),
            both.system,
            false_alarm=1e-3,
        )
        left = np.bincount(epoch_of(both)[~fix.used], minlength=len(spare))
        assert (left <= spare // 2).all()
        assert (left[fix.passed] == k).mean() > 0.97  # one that looks worse in their company goes first
        assert np.linalg.norm(fix.pos_e - here, axis=1)[fix.passed].max() < 3.0
        assert fix.passed[spare >= 2 * k + 2].mean() > 0.9


def test_robust_weights_resist_several_reflections():
    """Three of nineteen ranges 20 to 60 m long in each epoch: half of the fixes within 2 m, not beyond 10."""
    draw, count = np.random.default_rng(9), 300
    sets = [*SKY, orbits.make_walker(3, 8, 1, semi_axis=29.6e6, inclination=np.deg2rad(56.0))]
    seen = view(sets, THERE, np.array([0.0]), np.deg2rad(10.0))
    n, here = len(seen.system), earth.to_ecef(THERE)
    measured = seen.distance + draw.standard_normal((count, n))
    for row in measured:
        row[draw.choice(n, 3, replace=False)] += draw.uniform(20, 60, 3)
    start, pos = n * np.arange(count + 1), np.tile(seen.pos_e, (count, 1))

    def find_errors(**options):
        fix = least_squares.solve_positions(
            start, pos, measured.ravel(), np.ones(n * count), np.tile(seen.system, count), **options
        )
        return np.percentile(np.linalg.norm(fix.pos_e - here, axis=1), [50, 90])

    (plain, _), (middle, most) = find_errors(), find_errors(robust=True)
    assert plain > 10.0
    assert middle < 2.0
    assert most < 5.0
