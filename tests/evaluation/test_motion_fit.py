"""The fit of IMU and receiver against one made otherwise: a plain integral and one large least squares."""

from __future__ import annotations

from dataclasses import replace
from itertools import accumulate, pairwise

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy import stats
from scipy.spatial.transform import Rotation

from bench.core.mathematics import earth
from bench.evaluation.motion import motion_fit
from bench.evaluation.motion.motion_fit import Stretches, find_stretches, fit_motion

ARM = np.array([0.4, -0.3, 0.2])
BEGIN = np.array([0, 9, 19, 29])
T = np.arange(1, 4001) / 100.0
GYRO = np.column_stack([0.2 * np.sin(0.9 * T), 0.15 * np.cos(1.3 * T), 0.25 * np.sin(0.7 * T + 1.0)])
ACCEL = np.column_stack([2.0 * np.sin(0.8 * T), 1.5 * np.cos(1.1 * T), -9.8 + np.sin(1.7 * T)])


def integrate(times, w, f):
    """Velocity gained and attitudes at times since the first; the force turns in the middle of a step."""
    edges = np.unique(np.concatenate([times, T[(times[0] < T) & (times[-1] > T)]]))
    steps, row = np.diff(edges), np.searchsorted(T, 0.5 * (edges[1:] + edges[:-1]))
    turn = Rotation.from_rotvec(steps[:, None] * w[row]).as_matrix()
    C = np.array([np.eye(3), *accumulate(turn, np.matmul)])
    halfway = Rotation.from_rotvec(0.5 * steps[:, None] * w[row]).apply(f[row])
    gained = steps[:, None] * np.einsum("kij,kj->ki", C[:-1], halfway)
    at = np.searchsorted(edges, times)
    return np.vstack([np.zeros(3), np.cumsum(gained, axis=0)])[at], C[at]


def corrected(values):
    """Rates and forces with biases, gains and a turn taken off."""
    w = GYRO * np.exp(-values[3]) - values[:3]
    return w, Rotation.from_rotvec(values[8:11]).apply(ACCEL * np.exp(-values[7]) - values[4:7])


@pytest.fixture(scope="module")
def stretches():
    """Three, with what a receiver 5 cm/s off would say in axes of its own."""
    random = np.random.default_rng(4)
    fix_t = np.concatenate([2.003 + np.arange(9), 13.007 + np.arange(10), 25.001 + np.arange(10)])
    gained = []
    for a, b in pairwise(BEGIN):
        u, _ = integrate(fix_t[a:b], GYRO, ACCEL)
        noise = 0.05 * (1 + a / 9) * random.standard_normal(u.shape)
        gained.append(Rotation.random(random_state=random).apply(u) + random.standard_normal(3) + noise)
    C_in = Rotation.random(29, random_state=random).as_matrix()
    return Stretches(BEGIN, fix_t, np.vstack(gained), random.standard_normal((29, 3)), C_in, np.ones(3))


def solve(stretches, values, weights):
    """One step of the fit: with a turn and a velocity of each segment as unknowns like the others."""
    H, pull, scores = np.diag(motion_fit.PRIOR_SD**-2), -values / motion_fit.PRIOR_SD**2, []
    rms, C_nb, heading_sd, sizes = [], [], [], []
    for weight, a, b in zip(weights, BEGIN[:-1], BEGIN[1:], strict=True):
        at = stretches.fix_t[a:b] - values[11]
        first = at[0] - 0.05
        every = np.concatenate([[first], np.sort(np.concatenate([at - 0.05, at, at + 0.05]))[1:]])

        def gain(change, every=every):
            u, C = integrate(every, *corrected(values + change))
            return u[1::3], C[1::3], (u[2::3] - u[::3]) / 0.1

        u, C_sb, u_dot = gain(np.zeros(15))
        rate = corrected(values)[0][np.searchsorted(T, at, "right")]
        x = u + np.einsum("kij,kj->ki", C_sb, np.cross(rate, ARM + values[12:]))
        y = stretches.gained[a:b] - stretches.gained[a:b].mean(axis=0)
        turn, _ = Rotation.align_vectors(y, x - x.mean(axis=0))
        R, turned = turn.as_matrix(), turn.apply(x - x.mean(axis=0))
        J = np.empty((len(x), 3, 15))
        for k in range(11):
            step = 1e-5 * np.eye(15)[k]
            J[:, :, k] = (gain(step)[0] - gain(-step)[0]) / 2e-5 @ R.T
        J[:, :, 11] = -u_dot @ R.T
        for k in range(3):
            J[:, :, 12 + k] = np.einsum("kij,kj->ki", R @ C_sb, np.cross(rate, np.eye(3)[k]))
        nuisance = np.concatenate(
            [np.tile(np.eye(3), (len(x), 1, 1)), np.cross(np.eye(3), turned[:, None]).swapaxes(1, 2)], axis=2
        ).reshape(-1, 6)
        J, r = J.reshape(-1, 15), (y - turned).ravel()
        J = J - nuisance @ np.linalg.lstsq(nuisance, J, rcond=None)[0]
        rms.append(np.sqrt(r @ r / (len(r) - 6)))
        H += weight * J.T @ J
        pull += weight * J.T @ r
        scores.append(weight * J.T @ r)
        sizes.append(weight * np.linalg.norm(J, axis=0) * np.linalg.norm(r))
        C_nb.append(stretches.C_in[a:b].swapaxes(1, 2) @ R @ C_sb)
        across = np.linalg.norm(np.cross(stretches.C_in[a][:, 2], turned))
        heading_sd.append(np.hypot(rms[-1], 0.05) / across)
    after = values + np.linalg.solve(H, pull)
    return after, np.array(rms), H, np.array(scores), np.array(sizes), np.vstack(C_nb), np.array(heading_sd)


def test_steps_of_the_fit_are_those_of_a_least_squares_over_all_unknowns(stretches):
    """The derivatives of the fit count a step of 10 ms at its end, so they are right to a hundredth.

    Its covariance follows from them, with the scatter of three segments.
    """
    values = np.zeros(15)
    for steps in range(2):
        fit = fit_motion(stretches, T, GYRO, ACCEL, ARM, iterations=steps)
        assert_allclose(fit.values, values, rtol=0.02, atol=2e-3)
        weights = 1.0 / (fit.rms**2 + 0.05**2)
        values, rms, H, scores, sizes, C_nb, heading_sd = solve(stretches, fit.values, weights)
        assert_allclose(fit.rms, rms, rtol=0.02)
        assert_allclose(fit.C_nb, C_nb, atol=2e-3)
        assert_allclose(fit.heading_sd, heading_sd, rtol=0.02)
        motion = motion_fit.integrate(stretches, T, GYRO, ACCEL, fit.values)
        own = motion_fit._compare(stretches, motion, ARM, motion_fit.PRIOR_SD, fit.values)
        own_H = np.diag(motion_fit.PRIOR_SD**-2) + np.einsum("w,wij->ij", weights, own.normals)
        S = weights[:, None] * own.scores
        if steps == 0:  # later they leave out products of a bias or a turn with what it changes
            scale = np.sqrt(np.diag(H))
            assert_allclose(own_H / np.outer(scale, scale), H / np.outer(scale, scale), atol=0.02)
            assert (np.abs(S - scores) <= 0.01 * sizes).all()
        inverse = np.linalg.inv(own_H)
        few = 1.5 * (stats.t.ppf(0.995, 2) / stats.norm.ppf(0.995)) ** 2  # three segments
        cov = inverse @ (few * S.T @ S + np.diag(motion_fit.PRIOR_SD**-2)) @ inverse
        np.fill_diagonal(cov, np.maximum(np.diag(cov), np.diag(inverse)))
        assert_allclose(fit.cov, cov, rtol=1e-6, atol=1e-12)


def test_the_integral_is_that_of_plain_steps(stretches):
    """Also where all parameters are used, and where samples hardly turn (2 mrad) or turn by 0.2 rad."""
    values = np.array([0.02, -0.01, 0.03, 0.1, 0.2, -0.3, 0.1, -0.05, 0.2, -0.1, 0.3, 0.017, 0.1, 0.2, 0.3])
    for size in (1.0, 40.0):
        u, _, C_sb, rate, u_dot = motion_fit.integrate(stretches, T, size * GYRO, ACCEL, values)
        w, f = corrected(values)
        w = size * (w + values[:3]) - values[:3]
        for a, b in pairwise(BEGIN):
            at = stretches.fix_t[a:b] - 0.017
            every = np.sort(np.concatenate([at - 0.05, at, at + 0.05]))
            own_u, own_C = integrate(every, w, f)
            assert_allclose(u[a:b], own_u[1::3], atol=1e-9)
            assert_allclose(C_sb[a:b], own_C[1::3], atol=1e-9)
            assert_allclose(rate[a:b], w[np.searchsorted(T, at, "right")], atol=1e-12)
            assert_allclose(u_dot[a:b], (own_u[2::3] - own_u[::3]) / 0.1, atol=1e-7)


def test_fixes_closer_than_the_step_of_the_derivative_shorten_it(stretches):
    close = replace(stretches, fix_t=2.003 + 0.04 * np.arange(29))
    u_dot = motion_fit.integrate(close, T, 0.0 * GYRO, ACCEL, np.zeros(15))[4]
    row = np.searchsorted(T, close.fix_t[:, None] + [-0.01, 0.0, 0.01])
    assert_allclose(u_dot, ACCEL[row].mean(axis=1), atol=0.02)


def test_a_gain_far_from_one_is_where_the_fit_starts():
    for factor, start in ((0.51, 0.0), (1.99, 0.0), (0.0, 0.0), (0.1, np.log(0.1)), (9.8, np.log(9.8))):
        force = factor * 9.80665 * np.tile([0.6, 0.0, -0.8], (5, 1))
        assert motion_fit.guess_gain(force) == pytest.approx(start)


def test_steps_are_no_longer_than_what_is_known_before_allows(stretches, monkeypatch):
    """Rates a hundred times too large, and clocks 1.4 s apart where the record leaves 0.95 s."""
    tried, compare = [], motion_fit._compare
    monkeypatch.setattr(motion_fit, "_LONGEST", 0.5)
    monkeypatch.setattr(motion_fit, "_compare", lambda *a: tried.append(a[-1]) or compare(*a))
    fit_motion(stretches, T, 100.0 * GYRO, ACCEL, ARM, iterations=1)
    assert np.abs(tried[1] / motion_fit.PRIOR_SD).max() == pytest.approx(0.5)
    monkeypatch.undo()
    for sign in (1.0, -1.0):
        moved = replace(stretches, fix_t=stretches.fix_t + sign * 1.4)
        assert fit_motion(moved, T, GYRO, ACCEL, ARM).values[11] == pytest.approx(sign * 0.95)


def test_a_step_after_which_the_fit_is_worse_is_shortened(stretches, monkeypatch):
    """Where Gauss-Newton goes too far the cost never rises, and the fit comes as close as from 0."""
    costs, compare = [], motion_fit._compare

    def watch(*given):
        trial = compare(*given)
        costs.append(trial.cost)
        return trial

    monkeypatch.setattr(motion_fit, "_compare", watch)
    fit = fit_motion(stretches, T, 3.0 * GYRO, ACCEL, ARM, iterations=30)
    assert min(costs) < costs[0]
    assert fit.values[3] == pytest.approx(np.log(3.0), abs=0.1)


def flight():
    """Fixes of a path over the Earth for 60 s, every 0.1 s: places, and velocities by differences."""
    t = 100.0 + np.arange(601) / 10.0
    s = t - 100.0
    north, east = 150.0 * s + 300.0 * np.sin(0.1 * s), 120.0 * s - 200.0 * np.cos(0.12 * s)

    R_M, R_P = earth.radii(0.7)
    lla = np.column_stack(
        [0.7 + north / R_M, 0.4 + east / (R_P * np.cos(0.7)), 2000.0 + 30.0 * np.sin(0.2 * s)]
    )
    return t, lla


def test_gained_velocity_is_that_of_space_less_gravitation():
    """By differences of places, in axes that do not turn with the Earth: gravitation is g + w x (w x r)."""
    t, lla = flight()
    r_e = earth.to_ecef(lla)
    v_e = np.gradient(r_e, t, axis=0, edge_order=2)
    C_en = earth.matrix_en(lla[:, 0], lla[:, 1])
    vel_n = np.einsum("kji,kj->ki", C_en, v_e)
    imu_t = np.arange(99.0, 162.0, 0.01)
    found = find_stretches(imu_t, t, lla, vel_n)
    assert len(found) == 3
    w = np.array([0.0, 0.0, earth.EARTH_RATE])
    for rows in found.slices:
        k = np.searchsorted(t, found.fix_t[rows] - 1e-6)
        since = t[k] - t[k[0]]
        turn = Rotation.from_rotvec(since[:, None] * w)
        v_i = turn.apply(v_e[k] + np.cross(w, r_e[k]))
        gravity = np.einsum("kij,kj->ki", C_en[k], earth.gravity_n(lla[k, 0], lla[k, 2]))
        pull = turn.apply(gravity + np.cross(w, np.cross(w, r_e[k])))
        fallen = np.vstack([np.zeros(3), np.cumsum(0.05 * (pull[1:] + pull[:-1]), axis=0)])
        assert_allclose(found.gained[rows], v_i - v_i[0] - fallen, atol=2e-4)
        assert_allclose(found.C_in[rows], turn.as_matrix() @ C_en[k], atol=1e-12)
        assert_allclose(found.vel_n[rows], vel_n[k])
    for change, rows in zip(found.change, found.slices, strict=True):
        assert change == pytest.approx(np.std(np.diff(found.vel_n[rows], axis=0)))


def test_a_stretch_lasts_20_s_or_twelve_fixes_and_holds_no_gap():
    """Fixes every 2 s: segments of 24 s; a second at each end of the IMU does not count."""
    t = 10.0 + 2.0 * np.arange(40)
    lla, vel_n = np.tile([0.7, 0.4, 100.0], (40, 1)), np.random.default_rng(1).standard_normal((40, 3))
    every = np.arange(9.0, 90.0, 0.1)
    lengths = {
        "whole": (every, [12, 12, 12]),
        "a gap": (every[(every < 44.0) | (every > 44.65)], [12, 12]),
        "a step": (every[(every < 44.0) | (every > 44.25)], [12, 12, 12]),
        "late": (every[every > 10.5], [11, 12, 12]),
        "soon over": (every[every < 74.95], [12, 12, 8]),
        "sooner over": (every[every < 72.95], [12, 12]),
    }
    for what, (imu_t, expected) in lengths.items():
        found = find_stretches(imu_t, t, lla, vel_n)
        assert np.diff(found.begin).tolist() == expected, what
    assert len(find_stretches(every, t[:7], lla[:7], vel_n[:7])) == 0
    none = find_stretches(every[:1], t, lla, vel_n)
    assert len(none) == len(none.fix_t) == len(none.vel_n) == len(none.change) == 0


def test_the_liveliest_are_taken_in_order_of_time(stretches):
    some = replace(stretches, change=np.array([2.0, 1.0, 3.0])).take_liveliest(2)
    assert some.begin.tolist() == [0, 9, 19]
    assert_allclose(some.fix_t, np.delete(stretches.fix_t, slice(9, 19)))
    assert some.change.tolist() == [2.0, 3.0]
    assert [len(one) for one in (some.gained, some.vel_n, some.C_in)] == [19, 19, 19]


def test_rows_near_a_stretch_are_those_within_two_seconds(stretches):
    """The row after the margin belongs to it; between 11.003 and 13.007 s margins overlap."""
    rows = stretches.find_near(T)
    held = ((T >= 0.003) & (T < 24.0175)) | ((T >= 23.001) & (T < 36.0115))
    assert_allclose(T[rows], T[held])
    one = stretches.take_liveliest(1)
    assert_allclose(one.find_near(np.array([0.0, 0.1, 12.9, 14.0, 15.0])), [1, 2])
