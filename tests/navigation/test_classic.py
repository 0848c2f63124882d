"""classic-22, the readable filter, against the compiled loose-22 and against its own equations.

The two are the same filter in other axes, coordinates and code; they share the datasheets, the Earth and
the choice of rows of a record. tests/plugins/papers/test_register.py holds it against the register.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.linalg import expm

from bench import pipeline
from bench.core.mathematics import earth, rotation
from bench.core.words.exceptions import EstimatorError
from bench.io.config import read_profile
from bench.navigation.built_in import load
from bench.navigation.engine import kalman
from bench.navigation.error_state_filter import antenna_rows, corrections, error_state
from bench.navigation.error_state_filter.state_blocks import state_model
from bench.navigation.models.classic import (
    Classic22,
    error_dynamics,
    navigator,
    observation_model,
    process_model,
)
from bench.navigation.models.classic.filter_loop import FilterLoop
from bench.navigation.models.classic.navigator import FRD_OF_FUR, NED_OF_ENU, R3, Nav
from bench.navigation.models.loose_tight import Loose
from bench.navigation.options import ClassicOptions
from bench.simulation import sensors
from tests.navigation import equations
from tests.weaving import BARO, GNSS, IMU, units, weaving

WANDERING = replace(
    GNSS,
    pos_h_markov_sd=6.0,
    pos_v_markov_sd=8.5,
    vel_markov_sd=0.08,
    pos_decay_distance=4e-6,
    pos_decay_time=5e-4,
    vel_decay_time=0.01,
)
FLIGHT, UNITS = (60.0,), units(gnss=WANDERING)


def rms(a, b):
    """RMS difference of position [m], velocity [m/s] and attitude [rad]."""
    turned = rotation.to_rotvec(rotation.multiply(a.q_nb, rotation.conjugate(b.q_nb)))
    return [
        math.sqrt(np.mean(np.sum(d * d, axis=1)))
        for d in (earth.difference_n(a.lla, b.lla), a.vel_n - b.vel_n, turned)
    ]


def assert_close(a, b, tolerance):
    assert (np.array(rms(a, b)) < tolerance).all(), rms(a, b)


@pytest.fixture(scope="module")
def solution(sensed):
    return Classic22().run(sensed.data, sensed.initial)


# --- the same filter as loose-22 -----------------------------------------------------------------------


def test_it_says_what_loose_22_says(sensed, solution):
    """A minute of weaving flight: 1 mm, 0.02 mm/s, 1 microradian; sigmas, biases and Markov states too."""
    loose = Loose(gnss_markov=True).run(sensed.data, sensed.initial)
    assert_close(solution, loose, [1e-3, 2e-5, 1e-6])
    assert solution.extra_names == loose.extra_names
    assert np.abs((solution.extra - loose.extra) / loose.extra_sd).max() < 1e-2
    assert_allclose(solution.extra_sd, loose.extra_sd, rtol=2e-3)
    sd = np.sqrt(np.einsum("kii->ki", loose.cov))
    assert_allclose(solution.cov / sd[:, :, None] / sd[:, None, :], loose.cov / sd[:, :, None] / sd[:, None,
    :],
                    atol=2e-3)  # fmt: skip
    for name in ("t", "code", "component", "accepted"):
        order = [np.lexsort((v.component, v.code, v.t)) for v in (solution.innovations, loose.innovations)]
        both = (solution.innovations, loose.innovations)
        mine, theirs = (getattr(v, name)[o] for v, o in zip(both, order, strict=True))
        np.testing.assert_array_equal(mine, theirs)
    for code, within in ((0, 1e-5), (1, 0.15), (2, 0.15)):  # S of one before any is used, of the other after
        rows = [o[v.code[o] == code] for v, o in zip(both, order, strict=True)]
        (z, S, nis), (z_too, S_too, nis_too) = (
            (v.z[k], v.S[k], v.nis[k]) for v, k in zip(both, rows, strict=True)
        )
        assert np.abs((z - z_too) / np.sqrt(S_too)).max() < within
        assert_allclose(S, S_too, rtol=max(within / 4, 1e-5))
        assert_allclose(nis, nis_too, rtol=within, atol=within)


@pytest.mark.parametrize(
    "name",
    ["gnss-faults", *(pytest.param(name, marks=pytest.mark.long) for name in ("circuit", "gnss-denied-leg"))],
)
def test_it_says_what_loose_22_says_on_whole_flights(name):
    """4 to 10 minutes, GNSS lost, spoofed and frozen: 5 mm, 0.05 mm/s, 1.5 microradian RMS.

    Both step their covariance by the mean attitude and force of 50 ms, by which noise is told from a force.
    """
    profile = read_profile(name)
    flown = pipeline.sense(profile, pipeline.fly(profile))
    mine = Classic22().run(flown.data, flown.initial)
    assert_close(mine, Loose(gnss_markov=True).run(flown.data, flown.initial), [5e-3, 5e-5, 1.5e-6])


def test_the_comparison_sees_small_defects(sensed, solution):
    """R of the barometer a fifth too large; the antenna a centimeter to the side."""
    data = sensed.data
    louder = replace(data, specs=replace(data.specs, baro=replace(BARO, white_sd=0.55)))
    aside = replace(data, antenna_b=data.antenna_b + np.array([0.0, 0.01, 0.0]))
    for changed in (louder, aside):
        other = Loose(gnss_markov=True).run(changed, sensed.initial)
        assert max(np.array(rms(solution, other)) / [1e-3, 2e-5, 1e-6]) > 1


NAV = Nav(0.83, 0.3, 2500.0, np.array([41.0, -55.0, 3.0]), equations.body_to_enu(2.1, 0.15, -0.4))
NAV_N = np.concatenate([[0.83, 0.3, 2500.0], NED_OF_ENU @ NAV.V, rotation.from_euler(-0.4, 0.15, 2.1)])
A_ENU = np.array([1.5, -2.5, 9.6])


def to_ned(nav):
    """The linear map T (22, 22) from the source's errors to those of loose-22 (equations 1.3)."""
    figure = navigator.ellipsoid(nav.lat, nav.h)
    T = np.zeros((22, 22))
    T[:9, :9] = observation_model.ned_matrix(nav, figure)
    T[9:12, 9:12] = T[12:15, 12:15] = -FRD_OF_FUR  # estimate less truth, against measured less true
    T[15, 15] = -1.0
    T[16:19, 16:19] = -T[0:3, 0:3]
    T[19:22, 19:22] = -NED_OF_ENU
    return T


def test_the_axes_are_those_of_the_bench():
    C_nb = rotation.matrix(NAV_N[6:])
    assert_allclose(NED_OF_ENU @ NAV.B @ FRD_OF_FUR.T, C_nb, atol=1e-15)
    assert np.linalg.det(FRD_OF_FUR) == pytest.approx(1.0)


def test_the_axes_of_both_filters_turn_alike():
    x, turn = np.zeros(22), np.empty((5, 3))
    x[6:15] = [0.02, -0.01, 0.3, 1e-4, 2e-4, -1e-4, 0.2, -0.3, 0.1]
    T = to_ned(NAV)
    state, none = np.concatenate([NAV_N, np.zeros(6)]), (np.empty((0, 3), np.int64), np.empty(0))
    corrections.axes_kernel(state, (T @ x)[:15], *none, turn)
    turned = T @ navigator.axes_turned(NAV, x) @ np.linalg.inv(T)
    assert_allclose(turned[12:15, 12:15], turn[:3], atol=1e-12)
    assert_allclose(turned[6:8, 6:8], [[turn[3, 1], turn[3, 0]], [-turn[3, 0], turn[3, 1]]], atol=1e-12)
    assert np.abs(turn[:3] - np.eye(3)).max() > 0.01


def test_p_of_both_filters_is_one_at_the_start(sensed):
    """With what an alignment has left between attitude and biases."""
    rng = np.random.default_rng(1)
    A = rng.normal(size=(9, 9)) * np.repeat([1.0, 0.1, 1e-3], 3)[:, None]
    start = replace(sensed.initial, cov=A @ A.T, bias_cov=1e-6 * rng.normal(size=(9, 6)))
    loop, loose = FilterLoop(ClassicOptions(), sensed.data, start), Loose(gnss_markov=True)
    P = state_model(start, sensed.data.specs, loose.blocks_for(sensed.data)).P
    T, sd = to_ned(loop.nav), np.sqrt(np.diag(P))
    mapped = T @ loop.form.covariance @ T.T
    assert_allclose(mapped / np.outer(sd, sd), P / np.outer(sd, sd), atol=1e-12)


def test_markov_states_keep_their_meters_on_the_way(sensed):
    """They are stationary: 600 km on and 50 km up, each has the standard deviation it had, in meters."""
    loop = FilterLoop(ClassicOptions(), sensed.data, sensed.initial)
    before = np.diag(loop.form.covariance)[16:18] / np.square(loop.scale)
    loop.elapsed, loop.B_sum = 0.01, 0.01 * loop.nav.B
    loop.nav = replace(loop.nav, lat=loop.nav.lat - 0.1, h=loop.nav.h + 5e4)
    loop.predict()
    there = np.square(navigator.reduced(loop.nav, navigator.ellipsoid(loop.nav.lat, loop.nav.h)))
    assert_allclose(np.diag(loop.form.covariance)[16:18] / there, before, rtol=1e-3)


def test_f_of_both_filters_is_one_matrix():
    """F_NED = (T F + T') T^-1, each element to 1e-7 of its row; T' as reduced meters stretch on the way."""
    F = error_dynamics.dynamics_matrix(NAV, A_ENU, navigator.ellipsoid(NAV.lat, NAV.h))
    (lat_rate, lon_rate, h_rate), _, _ = equations.rates(
        NAV, np.zeros(3), np.zeros(3), navigator.ellipsoid(NAV.lat, NAV.h)
    )
    step = 1.0
    ends = [
        to_ned(replace(NAV, lat=NAV.lat + s * lat_rate, h=NAV.h + s * h_rate))[:15, :15]
        for s in (-step, step)
    ]
    T = to_ned(NAV)[:15, :15]
    mapped = (T @ F + (ends[1] - ends[0]) / (2 * step)) @ np.linalg.inv(T)
    loose = error_state.dynamics(NAV_N, rotation.matrix(NAV_N[6:]), NED_OF_ENU @ A_ENU)
    effect = np.abs(loose * np.repeat([1.0, 1e-3, 1e-6, 1e-7, 1e-4], 3)).max(axis=1, keepdims=True)
    assert (np.abs(mapped[:9] - loose) * np.repeat([1.0, 1e-3, 1e-6, 1e-7, 1e-4], 3) < 1e-7 * effect).all()
    assert lon_rate != 0


def test_h_gain_and_update_of_both_filters_are_one():
    """From one P, mapped: H, z, x and P after seven rows agree to 1e-9 (common linear model)."""
    rng = np.random.default_rng(8)
    antenna, w_b = np.array([0.8, 0.3, -0.4]), np.array([0.05, -0.2, 0.1])
    fix_lla, fix_vel = NAV_N[:3] + np.array([2e-7, -3e-7, 2.0]), NAV_N[3:6] + np.array([0.1, -0.2, 0.05])
    C = rotation.matrix(NAV_N[6:])
    H_n, z_n = np.zeros((7, 22)), np.zeros(7)
    antenna_rows.antenna_kernel(NAV_N, C, antenna, w_b, fix_lla, fix_vel, H_n, z_n)
    H_n[:6, 16:22] += np.eye(6)
    H_n[6, 2], H_n[6, 15], z_n[6] = -1.0, 1.0, NAV_N[2] - 2504.0

    figure = navigator.ellipsoid(NAV.lat, NAV.h)
    H = observation_model.measurement_matrix()
    arm = FRD_OF_FUR.T @ antenna
    observation_model.antenna_matrix(H, NAV, figure, arm, FRD_OF_FUR.T @ w_b)
    east, north = navigator.reduced(NAV, figure)
    D = np.zeros((7, 7))  # rows of Y to rows of z
    D[6, 0] = 1.0
    D[0:3, 1:4] = NED_OF_ENU @ np.diag([1 / east, 1 / north, 1.0])
    D[3:6, 4:7] = NED_OF_ENU
    T = to_ned(NAV)
    assert_allclose(H_n @ T, D @ H[:7], rtol=1e-12, atol=1e-12)

    Y = np.zeros(7)
    offset, swept = NAV.B @ arm, NAV.B @ observation_model.antenna_sweep(NAV, arm, FRD_OF_FUR.T @ w_b)
    Y[0] = NAV.h - 2504.0
    Y[1] = (NAV.lon - fix_lla[1]) * R3 + offset[0] * east
    Y[2] = (NAV.lat - fix_lla[0]) * R3 + offset[1] * north
    Y[3] = NAV.h - fix_lla[2] + offset[2]
    Y[4:7] = NAV.V + swept - NED_OF_ENU @ fix_vel
    assert_allclose(D @ Y, z_n, rtol=1e-9, atol=1e-9)

    root = rng.normal(size=(22, 22)) * np.repeat(
        [2.0, 0.1, 1e-3, 1e-5, 1e-3, 1, 3.0, 0.1], [3, 3, 3, 3, 3, 1, 3, 3]
    )
    P_n = np.ascontiguousarray(root.T @ root)
    r = np.array([4.0, 4.0, 7.0, 1e-3, 1e-3, 1e-3, 0.25])
    inverse = np.linalg.inv(T)
    from filterpy.kalman import KalmanFilter

    kf = KalmanFilter(22, 7)
    kf.P = inverse @ P_n @ inverse.T
    back = np.linalg.inv(D)
    kf.update(Y[:, None], R=back @ np.diag(r) @ back.T, H=H[:7])
    dx, vectors = np.zeros(22), np.zeros((2, 22))
    for i in range(7):
        kalman.update_kernel(P_n, dx, H_n[i], z_n[i], r[i], vectors[0], vectors[1])
    sd = np.sqrt(np.diag(P_n))
    assert_allclose((T @ kf.x[:, 0]) / sd, dx / sd, atol=1e-9)
    assert_allclose(T @ kf.P @ T.T / np.outer(sd, sd), P_n / np.outer(sd, sd), atol=1e-9)


# --- its own equations -------------------------------------------------------------------------------------


def test_the_step_integrates_the_equations():
    """20 s of a turn by `mechanize` at 200 Hz against Runge-Kutta on `rates`: 1e-4 m, 1e-5 m/s, 1e-7 rad."""
    from scipy.integrate import solve_ivp

    def motion(t):
        w = np.array([0.2 * np.cos(0.5 * t), -0.1, 0.05 * np.sin(0.3 * t)])
        return w, np.array([0.4 * np.sin(t), 9.9, 0.8 * np.cos(0.7 * t)])

    def slope(t, y):
        nav = Nav(y[0], y[1], y[2], y[3:6], y[6:15].reshape(3, 3))
        w, a = motion(t)
        parts = equations.rates(nav, w, a, navigator.ellipsoid(nav.lat, nav.h))
        return np.concatenate([parts[0], parts[1], parts[2].ravel(), w, a])

    y0 = np.concatenate([[NAV.lat, NAV.lon, NAV.h], NAV.V, NAV.B.ravel(), np.zeros(6)])
    dt, n = 0.005, 4000
    grid = dt * np.arange(n + 1)
    found = solve_ivp(slope, (0, dt * n), y0, t_eval=grid, rtol=1e-11, atol=1e-12, method="DOP853").y
    increments = np.diff(found[15:21], axis=1).T
    nav, before = NAV, None
    for row in increments.tolist():
        dtheta, dvel = tuple(row[:3]), tuple(row[3:])
        nav, _ = navigator.mechanize(nav, dt, *navigator.body_increments(dt, dtheta, dvel, before))
        before = (dt, dtheta, dvel)
    end = found[:, -1]
    assert np.abs(np.array([nav.lat, nav.lon, nav.h]) - end[:3]).max() < 1e-4
    assert abs(nav.lat - end[0]) * R3 < 1e-4
    assert abs(nav.lon - end[1]) * R3 < 1e-4
    assert np.abs(nav.V - end[3:6]).max() < 1e-5
    assert np.abs(nav.B - end[6:15].reshape(3, 3)).max() < 1e-7
    assert np.abs(nav.B @ nav.B.T - np.eye(3)).max() < 1e-12


def test_the_sweep_of_the_antenna_is_left_out_of_nothing(sensed, solution):
    """A filter that is told of no lever arm says something else: position by a part of a meter."""
    blind = Classic22().run(replace(sensed.data, antenna_b=np.zeros(3)), sensed.initial)
    assert rms(solution, blind)[0] > 0.2


def test_van_loan_is_that_of_filterpy():
    """Phi and Q of the inertial block for steps of 5 ms to 1 s.

    The series of Phi = exp(F T) is rounded in proportion to the same series with all terms positive,
    exp(|F| T), and Q in proportion to the standard deviations.
    """
    from filterpy.common import van_loan_discretization

    figure, sig = navigator.ellipsoid(NAV.lat, NAV.h), process_model.sigmas(units(gnss=WANDERING).assumed)
    for T in (0.005, 0.05, 1.0):
        Phi, Q = process_model.model_van_loan(NAV, figure, A_ENU, sig, T)
        _, G = process_model.model(NAV, figure, A_ENU, sig, 1.0)
        F = error_dynamics.dynamics_matrix(NAV, A_ENU, figure)
        F = process_model.turn_motion(F, NAV, A_ENU, figure, sig.accel**2 / T)
        theirs = van_loan_discretization(F, G[:15, :21], T)
        sd = np.sqrt(np.diag(Q)[:15])
        assert (np.abs(Phi[:15, :15] - theirs[0]) <= 1e-10 * expm(np.abs(F) * T) + 1e-16).all()
        assert_allclose(Q[:15, :15] / np.outer(sd, sd), theirs[1] / np.outer(sd, sd), atol=1e-9)


# --- options have their effect ------------------------------------------------------------------------------


def test_eight_rows_are_seven(sensed, solution):
    """The published vector with its pseudo-inverse, in flight."""
    found = Classic22(rows=8).run(sensed.data, sensed.initial)
    assert_close(found, solution, [1e-6, 1e-8, 1e-9])
    assert rms(found, solution)[0] > 0  # by other arithmetic


def test_discretization_and_rate_move_the_answer_a_little():
    sensed = sensors.sense(weaving(30.0, rate=100.0), units(gnss=WANDERING, baro=None), 1, 0)
    data = replace(sensed.data, output_t=sensed.data.output_t[::10])  # none of them forces a step
    full = Classic22(covariance_hz=100.0).run(data, sensed.initial)
    distance = [
        rms(full, Classic22(**options).run(data, sensed.initial))[1]
        for options in ({}, {"discretization": "euler"}, {"covariance_hz": 4.0})
    ]
    assert 0 < distance[0] < distance[1] < 0.01
    assert distance[0] < distance[2] < 0.01


def test_a_new_set_of_satellites_opens_the_filter(sensed, solution):
    """Jump variances count from the epoch the number of satellites changes, and only there."""
    fixes = sensed.data.fixes
    satellites = np.where(fixes.t < 29.5, 8, 7)
    columns = {name: getattr(fixes, name) for name in type(fixes).__slots__}
    data = replace(sensed.data, fixes=type(fixes)(**{**columns, "satellites": satellites}))
    jumps = {"jump_white_sd": [2.5, 3.75, 0.11], "jump_markov_sd": [3.5, 5.0, 0.015]}
    found = Classic22(**jumps).run(data, sensed.initial)
    k = solution.t < 29.9
    np.testing.assert_array_equal(found.lla[k], solution.lla[k])
    after = np.searchsorted(solution.t, 30.0 - 1e-6)
    for axis in "xy":
        markov = solution.extra_names.index(f"gnss_pos_{axis}_m")
        grown = found.extra_sd[after, markov] ** 2 - solution.extra_sd[after, markov] ** 2
        assert 5.0 < grown < 3.5**2 + 0.1
    assert rms(found, solution)[0] > 0.01


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"covariance_hz": 0.0}, "covariance_hz = 0 Hz must be positive"),
        ({"discretization": "exact"}, "discretization = 'exact' must be 'van-loan' or 'euler'"),
        ({"rows": 6}, "rows = 6 must be 7 or 8"),
        ({"form": "qr"}, "form = 'qr' must be 'joseph', 'conventional', 'potter', 'carlson' or 'ud'"),
        ({"floor": 1.5}, "floor = 1.5 must be at least 0 and below 1"),
        ({"integrity": "nis"}, "integrity = 'nis' must be a list"),
        ({"integrity": ["chi"]}, "integrity[0] = 'chi' must be 'nis', 'trace', 'tolerance' or 'velocity'"),
        ({"gate_probability": 0.0}, "gate_probability = 0 must be between 0 and 1"),
        ({"readmit_after_s": "1"}, "readmit_after_s = '1' must be a number"),
        ({"feedback": 1}, "feedback = 1 must be true or false"),
        ({"correction_period": -1.0}, "correction_period = -1 must be 0 or more, or 'auto'"),
        ({"correction_period": "soon"}, "correction_period = 'soon' must be 0 or more, or 'auto'"),
        ({"jump_white_sd": [1.0]}, "jump_white_sd[1] = [1] has too few values"),
        ({"trace_limit": -1}, "trace_limit = -1 must be positive"),
        ({"admissible_deg": True}, "admissible_deg = true must be a number"),
        (
            {"gate": 3},
            "unknown option 'gate'. Did you mean 'gate_probability'?\n  known options: admissible_deg",
        ),
        ({"form_": "qr"}, "unknown option 'form_'. Did you mean 'form'?"),
    ],
)
def test_a_wrong_option_says_why(options, message):
    with pytest.raises(EstimatorError) as caught:
        load("classic-22", options)
    assert message in str(caught.value)


def test_it_names_what_it_has_no_room_for():
    """A bias that only wanders about zero, a Gauss-Markov process; one with a turn-on bias is a walk."""

    def named(triad, **changes):
        imu = replace(IMU, **{triad: replace(getattr(IMU, triad), **changes)})
        return load("classic-22", {}).unmodeled_errors(units(imu).assumed)

    for triad, words in (("gyro", "gyro"), ("accel", "accelerometer")):
        assert named(triad) == ()
        fading = f"{words} bias instability that fades (taken as a random walk)"
        assert named(triad, turn_on_bias_sd=0.0) == (fading,)
        assert fading not in named(triad, turn_on_bias_sd=0.0, bias_model="flicker")
        assert named(triad, turn_on_bias_sd=0.0, bias_instability=0.0) == ()
