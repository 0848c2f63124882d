"""The linear error dynamics are the Jacobian of our own mechanization, element by element (gate G1).

The mechanization runs as plain Python with 30 digits, so that differences over a short step have no rounding.
"""

import types
from itertools import pairwise

import mpmath
import numpy as np
import pytest
from numpy.testing import assert_allclose

from bench.core.compilation.wide_rows import widened
from bench.core.mathematics import earth, rotation
from bench.core.mathematics.units import STANDARD_GRAVITY
from bench.navigation import mechanization
from bench.navigation.error_state_filter import corrections, error_state

DIGITS = mpmath.mp.clone()
DIGITS.dps = 30
LONG_NUMPY = types.SimpleNamespace(sqrt=DIGITS.sqrt, sin=DIGITS.sin, cos=DIGITS.cos)


def plain(kernel, numpy=np):
    """Return a kernel as Python that calls only Python, with the numpy to compute with."""
    function = kernel.py_func
    space = dict(function.__globals__) | {"np": numpy}
    for name in function.__code__.co_names:
        if hasattr(space.get(name), "py_func"):
            space[name] = plain(space[name], numpy)
    return types.FunctionType(function.__code__, space, function.__name__, function.__defaults__)


def long(values):
    """Return numbers with 30 digits."""
    return np.vectorize(DIGITS.mpf, otypes=[object])(np.asarray(values, object))


def long_zeros(*shape):
    return long(np.zeros(shape))


STEP = plain(mechanization.step_kernel, LONG_NUMPY)
BODY = plain(mechanization.body_step_kernel, LONG_NUMPY)
TURN = plain(mechanization.turn_kernel, LONG_NUMPY)
RADII = plain(earth.radii_kernel, LONG_NUMPY)


def displaced(nav, error):
    """Return a state with an error (estimate minus truth) added to it."""
    state = nav.copy()
    meridian, prime = RADII(DIGITS.sin(nav[0]))
    state[0] += error[0] / (meridian + nav[2])
    state[1] += error[1] / ((prime + nav[2]) * DIGITS.cos(nav[0]))
    state[2] -= error[2]
    state[3:6] += error[3:6]
    TURN(state, 0, 0, error[8], True)
    TURN(state, error[6], error[7], 0, True)
    return state


def difference(state, nav):
    """Return the error of a state against nav, meters at nav."""
    meridian, prime = RADII(DIGITS.sin(nav[0]))
    d = long_zeros(9)
    d[0] = (state[0] - nav[0]) * (meridian + nav[2])
    d[1] = (state[1] - nav[1]) * (prime + nav[2]) * DIGITS.cos(nav[0])
    d[2] = nav[2] - state[2]
    d[3:6] = state[3:6] - nav[3:6]
    w, x, y, z = state[6:]
    a, b, c, e = nav[6], -nav[7], -nav[8], -nav[9]
    s = w * a - x * b - y * c - z * e
    v = np.array(
        [w * b + x * a + y * e - z * c, w * c - x * e + y * a + z * b, w * e + x * c - y * b + z * a]
    )
    tangent = DIGITS.sqrt(np.sum(v * v)) / s
    d[6:] = 2 * v / s * (DIGITS.atan(tangent) / tangent if tangent > 0 else 1)
    return d


def one_step(nav, f_b, w_ib_b, biases, dt):
    state = nav.copy()
    rotvec, dv, dv_n, C = long_zeros(3), long_zeros(3), long_zeros(3), long_zeros(3, 3)
    dtheta, dvel = (w_ib_b - biases[:3]) * dt, (f_b - biases[3:]) * dt
    BODY(dt, dtheta, dvel, long_zeros(7), rotvec, dv)
    STEP(state, dt, rotvec, dv, C, dv_n)
    return state


SIZE = np.array([1e3] * 3 + [10.0] * 3 + [1e-3] * 3 + [1e-4] * 3 + [0.1] * 3)
STEP_LENGTH = 0.02


def numerical_dynamics(nav, f_b, w_ib_b):
    """Central differences of the step map in the errors; the limit dt -> 0 by Richardson, order dt^4 left."""
    size = long(SIZE)

    def slope(dt):
        F = long_zeros(9, 15)
        reference = one_step(nav, f_b, w_ib_b, long_zeros(6), dt)
        for k in range(15):
            ends = []
            for sign in (1, -1):
                error = long_zeros(15)
                error[k] = sign * size[k]
                state = one_step(displaced(nav, error[:9]), f_b, w_ib_b, error[9:], dt)
                ends.append(difference(state, reference))
            F[:, k] = (ends[0] - ends[1]) / (2 * size[k])
        return (F - np.eye(9, 15)) / dt

    table = [slope(DIGITS.mpf(STEP_LENGTH) / 2**k) for k in range(4)]
    for order in range(1, 4):
        table = [(2**order * b - a) / (2**order - 1) for a, b in pairwise(table)]
    return table[0].astype(float)


def allowed(numeric):
    """Return the difference that passes: 1e-4 of an element.

    An element that is zero by structure may differ by 1e-4 of the largest of its block, or by 1e-6 in a block
    that is zero: the rest of Richardson's limit.
    """
    return 1e-4 * np.abs(numeric)


def block_largest(matrix):
    blocks = np.abs(matrix).reshape(3, 3, 5, 3).max(axis=(1, 3))
    return np.kron(blocks, np.ones((3, 3)))


CASES = [
    # lat deg, height, speeds n e d, roll pitch heading deg, f_b
    (47.0, 1200.0, (20.0, 15.0, -2.0), (30.0, 5.0, 70.0), (0.5, 0.3, -11.0)),
    (-35.0, 11000.0, (-180.0, 140.0, 7.0), (-25.0, 2.0, 145.0), (1.0, -0.5, -10.5)),
    (78.0, 300.0, (5.0, -60.0, 3.0), (10.0, -8.0, 280.0), (-1.0, 2.0, -9.0)),
    (0.5, 0.0, (100.0, 100.0, 20.0), (170.0, 60.0, 10.0), (3.0, 1.0, 5.0)),
]


@pytest.mark.parametrize("case", CASES)
def test_dynamics_are_the_jacobian_of_the_mechanization(case):
    """A-5.1.10 in NED and meters; every element to 1e-4 of itself, or of its block where it is zero."""
    nav, f_b, w_ib_b, F = dynamics_of(case)
    numeric = numerical_dynamics(nav, f_b, w_ib_b)
    zero = np.maximum(1e-4 * block_largest(F), np.where(block_largest(F) == 0, 1e-6, 0))
    bad = np.abs(F - numeric) > np.where(F == 0, zero, 0) + allowed(numeric)
    assert not bad.any(), [(i, j, F[i, j], numeric[i, j]) for i, j in np.argwhere(bad)]


def dynamics_of(case):
    lat, alt, vel, euler, f_b = case
    q = rotation.from_euler(*np.deg2rad(euler))
    nav = np.concatenate([[np.deg2rad(lat), 0.3, alt], vel, q])
    C = rotation.matrix(q)
    w_ib_b = np.array([0.1, -0.05, 0.2])
    return long(nav), long(f_b), long(w_ib_b), error_state.dynamics(nav, C, C @ f_b)


def test_the_gate_catches_a_misprint():
    """Every element that is not zero, 1 % off, is caught (A-5.1.10's own misprints were 16 % and more)."""
    nav, f_b, w_ib_b, F = dynamics_of(CASES[1])
    numeric = numerical_dynamics(nav, f_b, w_ib_b)
    caught = np.abs(0.99 * F - numeric) > allowed(numeric)
    assert caught[F != 0].all(), np.argwhere(~caught & (F != 0))


def test_register_elements_in_their_own_frame():
    """A-5.1.10 as printed and corrected, mapped by equations 1.3 (alpha_NED = -phi_n)."""
    nav, f_b, _, F = dynamics_of(CASES[1])
    nav = nav.astype(float)
    f_n = rotation.matrix(nav[6:]) @ f_b.astype(float)
    R_M, R_P = earth.radii(nav[0])
    u, tan, sin, cos = earth.EARTH_RATE, np.tan(nav[0]), np.sin(nav[0]), np.cos(nav[0])
    lon_rate = nav[4] / ((R_P + nav[2]) * cos)
    assert_allclose(F[4, 3], 2 * u * sin + 2 * lon_rate * sin - lon_rate * sin, rtol=1e-12)  # f4,5 = U sin
    assert_allclose(F[3, 4], -2 * (u + lon_rate) * sin, rtol=1e-12)  # f5,4
    assert_allclose(-F[5, 4], 2 * (u + lon_rate) * cos, rtol=1e-12)  # f6,4, down is -h
    assert_allclose(F[5, 3], -2 * nav[3] / (R_M + nav[2]), rtol=1e-12)  # f6,5
    assert_allclose(F[3, 7], f_n[2], rtol=1e-12)  # f5,7 = a_h: -a_h alpha_E with both signs turned
    assert_allclose(F[8, 4], tan / (R_P + nav[2]), rtol=1e-12)  # f9,4


def test_transition_is_the_matrix_exponential_to_second_order():
    from scipy.linalg import expm

    _, _, _, F = dynamics_of(CASES[0])
    full = np.zeros((15, 15))
    full[:9] = F
    for T in (0.005, 0.05):
        G = np.zeros((9, 15))
        error_state.transition_kernel(F, T, G)
        missing = expm(full * T)[:9] - np.eye(9, 15) - G
        # what is left: third order along the chain, second order in the slow rates (2e-4 1/s) and
        # in the Schuler rate (g / R = 1.54e-6 1/s^2)
        third = block_largest((full @ full @ full)[:9]) * T**3
        bound = third + 1e-3 * T * block_largest(G) + 1.6e-6 * T**2
        assert (np.abs(missing) < bound).all()


def test_covariance_step_is_the_dense_product():
    rng = np.random.default_rng(8)
    _, _, _, F = dynamics_of(CASES[2])
    for n in (15, 16, 20):
        root = rng.normal(size=(n, n))
        P = root @ root.T
        G = np.zeros((9, 15))
        error_state.transition_kernel(F, 0.5, G)
        decay = np.concatenate([np.ones(9), rng.uniform(0.5, 1.0, n - 9)])
        q = rng.uniform(size=n)
        Phi = np.diag(decay)
        Phi[:9, :15] += G
        wanted = Phi @ P @ Phi.T + np.diag(q)
        got = covariance_step(P, G, decay, q, np.empty((0, 3), np.int64), np.empty(0))
        assert_allclose(got, wanted, rtol=1e-12, atol=1e-12 * np.abs(wanted).max())
        assert (got == got.T).all()


def covariance_step(P, G, decay, noise, drives, factor):
    """Return P (n, n) after a step; what the kernel must not read is NaN before."""
    n = len(P)
    got = widened(P)
    got[9:, :9] = np.nan
    fading = int(np.append(np.flatnonzero(decay != 1.0), n)[0])
    work = error_state.covariance_work(n)
    error_state.covariance_kernel(got, G, widened(decay), noise, fading, drives, factor, work)
    error_state.mirror_kernel(got)
    assert (got[:, n:] == 0).all()
    return got[:, :n]


def test_the_structure_of_a_step_is_that_of_its_numbers():
    _, _, _, F = dynamics_of(CASES[1])
    G = np.zeros((9, 15))
    error_state.transition_kernel(F, 0.5, G)
    assert tuple(tuple(np.flatnonzero(row).tolist()) for row in G) == error_state.ACTING


MEMS_STATES = [
    *(("gyro scale", i, error_state.GYRO + i, i) for i in range(3)),
    *(("accel scale", i, error_state.ACCEL + i, 3 + i) for i in range(3)),
    *(("g-sensitivity", 3 * i + j, error_state.GYRO + i, 3 + j) for i in range(3) for j in range(3)),
]


@pytest.mark.parametrize("case", CASES[:2])
def test_scale_factors_and_g_sensitivity_act_as_the_sensors_have_them(case):
    """Columns of F: that of a bias times the rate or the force; against central differences of the step.

    The increments are those of a sensor, (1 + s) w + M f and (1 + s) f, put through the corrections.
    """
    nav, f_b, w_ib_b, F = dynamics_of(case)
    correction = plain(corrections.correct_kernel, LONG_NUMPY)
    begin = {"gyro scale": 16, "accel scale": 19, "g-sensitivity": 22}
    drives = np.array([(begin[name] - 1 + i, bias, by) for name, i, bias, by in MEMS_STATES])
    reading = np.concatenate([w_ib_b, f_b]).astype(float)

    def slope(name, index, dt):
        size = 1e-3
        ends = []
        for sign in (1, -1):
            state = long_zeros(31)
            state[:10] = nav
            state[begin[name] + index] = sign * size
            dth, dv = w_ib_b * dt, f_b * dt
            correction(state, dt, drives, np.zeros(3), dth, dv, long_zeros(2, 6))
            rates = long_zeros(6)
            ends.append(one_step(nav, dv / dt, dth / dt, rates, dt))
        return (difference(ends[0], nav) - difference(ends[1], nav)) / (2 * size) / dt

    for name, index, bias, by in MEMS_STATES:
        table = [slope(name, index, DIGITS.mpf(STEP_LENGTH) / 2**k) for k in range(4)]
        for order in range(1, 4):
            table = [(2**order * b - a) / (2**order - 1) for a, b in pairwise(table)]
        numeric, wanted = table[0].astype(float), F[:, bias] * reading[by]
        scale = np.abs(wanted).max()
        np.testing.assert_allclose(numeric, wanted, rtol=1e-3, atol=1e-3 * scale + 1e-9, err_msg=name)
        assert scale > 0


@pytest.mark.parametrize("driven", [False, True])
def test_steps_of_p_phi_and_a_waiting_row_are_one_transition(driven):
    """Dense products, with states that act through the biases: P, the smoother's Phi, and h Phi^-1."""
    rng = np.random.default_rng(9)
    n = 31
    _, _, _, F = dynamics_of(CASES[2])
    drives = np.array([(16 + k, bias, by) for k, (_, _, bias, by) in enumerate(MEMS_STATES)])
    drives = drives if driven else drives[:0]
    factor = rng.normal(size=len(drives))
    decay = np.concatenate([np.ones(9), rng.uniform(0.99, 1.0, n - 9)])
    G, back = np.zeros((9, 15)), np.zeros((9, 15))
    T = 0.05
    error_state.transition_kernel(F, T, G)
    error_state.transition_kernel(F, -T, back)
    dense = np.diag(decay)
    dense[:9, :15] += G
    for (state, bias, _), by in zip(drives, factor, strict=True):
        dense[:9, state] += G[:, bias] * by
    root = rng.normal(size=(n, n))
    P, q = root @ root.T, rng.uniform(size=n)
    got = covariance_step(P, G, decay, q, drives, factor)
    wanted = dense @ P @ dense.T + np.diag(q)
    assert_allclose(got, wanted, rtol=1e-12, atol=1e-12 * np.abs(wanted).max())
    Phi = rng.normal(size=(n, n))
    accumulated, work = widened(Phi), error_state.covariance_work(n)
    error_state.accumulate_kernel(accumulated, G, decay, drives, factor, work)
    assert_allclose(accumulated[:, :n], dense @ Phi, rtol=1e-12, atol=1e-12)
    h = rng.normal(size=n)
    carried = h.copy()
    error_state.backward_kernel(carried, back, decay, drives, factor, np.empty(n))
    # the inverse to second order: the rest is the third along the chain and the decay of a step
    assert_allclose(carried @ dense, h, rtol=0, atol=2e-3 * np.abs(h).max())
    assert np.abs(carried - h).max() > 0.02


def test_feedback_takes_the_error_away():
    """A-5.4.8, A-5.4.9: a state with an error, corrected by that error, is the state without."""
    lat, alt, vel, euler, _ = CASES[0]
    nav = np.concatenate([[np.deg2rad(lat), 0.3, alt], vel, rotation.from_euler(*np.deg2rad(euler))])
    error = np.array([3.0, -4, 5, 0.1, -0.2, 0.3, 1e-3, -2e-3, 3e-3, 1e-5, 2e-5, 3e-5, 1e-3, 2e-3, 3e-3, 0.7])
    state = displaced(nav, error[:9])
    state, dx = np.concatenate([state, error[9:]]), error.copy()
    error_state.feedback_kernel(state, dx)
    assert_allclose(earth.difference_n(state[:3], nav[:3]), 0, atol=1e-5)
    assert_allclose(state[3:10], nav[3:], atol=1e-12)
    assert not np.concatenate([state[10:], dx]).any()


@pytest.mark.parametrize(("heading", "share"), [(0.0, 0.0), (0.3, 0.0), (0.3, 0.4)])
def test_a_correction_is_no_turn_that_was_flown(heading, share):
    """A tilt and what hides behind it, a ``share`` of it another state that acts like the bias: no steady
    flight tells them, before a correction or after; a row that waits sees the same."""
    attitude = rotation.from_euler(0.2, 0.1, 1.1)
    state = np.concatenate([[0.8, 0.2, 500.0, 40.0, -20.0, 0.0], attitude, np.zeros(9)])
    f_n, tilt = np.array([0.0, 0.0, -STANDARD_GRAVITY]), np.array([0.02, -0.03, 0.0])
    drives, factor = np.array([[15 + k, 12 + k, 0] for k in range(3)]), np.array([5.0, -2.0, 3.0])

    def velocity_rows():
        F = error_state.dynamics(state[:10], rotation.matrix(state[6:10]), f_n)[3:6]
        return np.hstack([F, F[:, 12:] * factor])

    F = velocity_rows()
    hidden = np.zeros(18)
    force = rotation.matrix(attitude).T @ F[:, 6:9] @ tilt
    hidden[6:9], hidden[12:15], hidden[15:] = tilt, (1.0 - share) * force, share * force / factor
    assert_allclose(F @ hidden, 0.0, atol=1e-12)
    P, turn, dx = np.outer(hidden, hidden), np.empty((5, 3)), 0.7 * hidden
    H = np.linspace(-1.0, 1.0, 36).reshape(2, 18)
    seen = H @ hidden
    dx[8] = heading
    corrections.axes_kernel(state, dx, drives, factor, turn)
    corrections.reset_kernel(P, turn, drives, factor, np.empty((3, 18)))
    corrections.turn_rows_kernel(H, turn, drives, factor)
    error_state.feedback_kernel(state, dx)
    assert_allclose(P, P.T, atol=1e-15)
    assert_allclose(velocity_rows() @ P, 0.0, atol=1e-12)
    assert np.abs(velocity_rows() @ np.outer(hidden, hidden)).max() > 1e-5
    assert_allclose(H @ P @ H.T, np.outer(seen, seen), rtol=1e-12, atol=1e-12)


def test_a_reset_turns_p_by_its_axes():
    """T P T' with whole matrices: tilts by the heading, all of a force by its turn."""
    rng = np.random.default_rng(8)
    n, drives, factor = 20, np.array([[15, 13, 0], [17, 12, 0], [18, 10, 0]]), np.array([5.0, -2.0, 3.0])
    state = np.concatenate([[0.8, 0.2, 500.0, 40.0, -20.0, 0.0], rotation.from_euler(0.2, 0.1, 1.1)])
    turn, dx = np.empty((5, 3)), rng.normal(size=n) * 0.3
    corrections.axes_kernel(state, dx, drives, factor, turn)
    assert np.abs(turn[:3] - np.eye(3)).max() > 0.01
    T, force = np.eye(n), np.zeros((3, n))
    s, c = np.sin(dx[8]), np.cos(dx[8])
    T[6:8, 6:8] = [[c, s], [-s, c]]
    force[:, 12:15] = np.eye(3)
    force[1, 15], force[0, 17] = 5.0, -2.0
    T[12:15] += (turn[:3] - np.eye(3)) @ force
    root = rng.normal(size=(n, n))
    P = root @ root.T
    expected = T @ P @ T.T
    corrections.reset_kernel(P, turn, drives, factor, np.empty((3, n)))
    assert_allclose(P, expected, rtol=1e-12, atol=1e-12)
    np.testing.assert_array_equal(P, P.T)


def test_layout_names_every_state_once():
    layout = error_state.StateLayout(("baro_bias", "m", 1), ("clock", "m", 2))
    assert layout.size == 18
    covered = [i for name, _, _ in layout.blocks for i in range(layout.size)[layout.slice(name)]]
    assert covered == list(range(18))
    assert len(layout.labels()) == 9
    with pytest.raises(KeyError, match="no state block 'scale'; there are pos, vel"):
        layout.slice("scale")


def test_errors_and_truths_are_inverse():
    """By the kernels and by the plain functions: the errors of a state less these errors are these errors."""
    rng = np.random.default_rng(5)
    start = [0.8, 0.2, 500.0, 20.0, 5.0, -1.0, *rotation.from_euler(0.1, 0.2, 0.3), *rng.normal(size=7)]
    d = rng.normal(size=(20, 16)) * np.repeat([5.0, 0.5, 0.3, 1e-3, 1e-2, 3.0], [3, 3, 3, 3, 3, 1])
    state = np.array(start)
    truths = error_state.less_errors(state, d)
    assert_allclose(error_state.state_errors(state, truths), d, rtol=1e-5, atol=1e-9)
    assert_allclose(error_state.less_errors(state, d[3]), truths[3], rtol=1e-15)
    fed = state.copy()
    error_state.feedback_kernel(fed, d[3].copy())
    fed[6:10] *= np.sign(fed[6] * truths[3, 6])
    assert_allclose(fed, truths[3], rtol=1e-12)


@pytest.mark.parametrize("turn", [0.0, 1e-6, 1e-3, 0.5, 3.0])
@pytest.mark.parametrize("sign", [-1.0, 1.0])
def test_the_difference_of_the_kernel_is_that_of_two_states(turn, sign):
    """Across the date line, by any turn, with either sign of the quaternion."""
    rng = np.random.default_rng(5)
    q = rotation.from_euler(0.3, -0.4, 5.0)
    state = np.concatenate([[0.8, np.pi - 1e-9, 500.0], rng.normal(size=3), q, rng.normal(size=9)])
    d = rng.normal(size=len(state) - 1)
    d[6:9] *= turn / np.linalg.norm(d[6:9])
    truth, found = error_state.less_errors(state, d), np.empty_like(d)
    wanted = error_state.state_errors(state, truth)
    truth[1] += 2 * np.pi
    truth[6:10] *= sign
    error_state.difference_kernel(state, truth, found)
    assert_allclose(found[3:], wanted[3:], rtol=1e-12, atol=1e-14)
    assert_allclose(found, d, rtol=1e-5, atol=2e-9)
