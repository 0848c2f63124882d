"""The scalar kernels do what the matrix formulas of the Kalman filter say, and P stays a covariance.

A sub-vector used component by component equals the stacked vector update (independent components); the
innovation squared is that of the whole sub-vector; P stays symmetric and positive after 1e5 updates (register
36), where the short form of the update loses it.
"""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from bench.core.compilation.wide_rows import widened
from bench.navigation.engine.gate import DRIFTED, LOST, STEPPED, growth
from bench.navigation.engine.kalman import nis_kernel, open_all_kernel, open_kernel, update_kernel
from bench.navigation.engine.late_updates import (
    DEPTH,
    late_rows_kernel,
    late_update_kernel,
    late_updates,
    settle_kernel,
)

N = 16


def columns():
    return np.zeros((6, N + 1), np.int64)


def problem(seed, m=3, n=N):
    """P, dx, H, z, r with correlations, unlike scales, and H with empty columns."""
    rng = np.random.default_rng(seed)
    scale = 10.0 ** rng.uniform(-4, 2, n)
    root = scale[:, None] * rng.normal(size=(n, n))
    H = rng.normal(size=(m, n)) * (rng.random((m, n)) < 0.4) / scale
    H[:, 0] = 1.0 / scale[0]
    return root @ root.T, rng.normal(size=n) * scale, H, rng.normal(size=m), rng.uniform(0.1, 2.0, m)


def sequential(P, dx, H, z, r, update=update_kernel):
    P, dx = P.copy(), dx.copy()
    for a in range(len(z)):
        update(P, dx, H[a], z[a], r[a], np.empty(len(P)), np.empty(len(P)))
    return P, dx


def stacked(P, dx, H, z, r):
    """The Joseph form with whole matrices (A-5.4.5)."""
    R = np.diag(r)
    K = np.linalg.solve(H @ P @ H.T + R, H @ P).T
    keep = np.eye(len(P)) - K @ H
    return keep @ P @ keep.T + K @ R @ K.T, dx + K @ (z - H @ dx)


def nis(P, dx, H, z, r, kernel=nis_kernel):
    m = len(z)
    var, work = np.full(m, np.nan), np.zeros((m, m + 1))
    return kernel(P, dx, H, z, r, var, work, np.empty_like(H), columns()), var


@pytest.mark.parametrize("m", [1, 2, 3])
@pytest.mark.parametrize("seed", range(5))
def test_component_by_component_equals_the_stacked_update(seed, m):
    case = problem(seed, m)
    P, dx = sequential(*case)
    P_whole, dx_whole = stacked(*case)
    sd = np.sqrt(np.diag(case[0]))  # of before: what an element can be off by, relative
    assert_allclose(P / np.outer(sd, sd), P_whole / np.outer(sd, sd), rtol=0, atol=1e-12)
    assert_allclose(dx / sd, dx_whole / sd, rtol=0, atol=1e-12)
    assert_array_equal(P, P.T)
    assert np.abs(dx - case[1]).max() > 0  # an update took place


def test_the_order_of_the_components_does_not_matter():
    P, dx, H, z, r = problem(11)
    forward = sequential(P, dx, H, z, r)
    backward = sequential(P, dx, H[::-1].copy(), z[::-1].copy(), r[::-1].copy())
    sd = np.sqrt(np.diag(P))
    assert_allclose(forward[0] / np.outer(sd, sd), backward[0] / np.outer(sd, sd), rtol=0, atol=1e-12)
    assert_allclose(forward[1] / sd, backward[1] / sd, rtol=0, atol=1e-12)


@pytest.mark.parametrize("m", [1, 2, 3])
@pytest.mark.parametrize("seed", range(5))
def test_nis_and_variances_are_those_of_the_whole_sub_vector(seed, m):
    P, dx, H, z, r = problem(seed, m)
    S = H @ P @ H.T + np.diag(r)
    innovation = z - H @ dx
    value, var = nis(P, dx, H, z, r)
    assert_allclose(value, innovation @ np.linalg.solve(S, innovation), rtol=1e-10)
    assert_allclose(var, np.diag(S), rtol=1e-12)


def test_nis_sees_a_fault_that_points_across_the_correlation():
    """Two components told apart only by their correlation: each alone is ordinary, together they are not."""
    P = np.array([[1.0, 0.99], [0.99, 1.0]])
    value, var = nis(P, np.zeros(2), np.eye(2), np.array([1.0, -1.0]), np.full(2, 1e-4))
    assert_allclose(value, 2 / (0.01 + 1e-4), rtol=1e-12)
    assert (1.0 / var < 1.0).all()


@pytest.mark.parametrize("m", [1, 2, 3])
@pytest.mark.parametrize("seed", range(5))
def test_p_grows_by_the_refused_correction_and_by_a_step_of_the_measured(seed, m):
    """A-5.4.7: then the rejected innovation is one to be expected, NIS at most m; the smoother's P alike."""
    P, dx, H, z, r = problem(seed, m)
    H[:, :m] = np.eye(m)  # as a fix: each component is one state by itself, and others beside it
    e = 30.0 * np.sqrt(np.diag(H @ P @ H.T) + r)
    z = H @ dx + e
    var, work = np.empty(m), np.zeros((m, m + 1))
    opened, before = P.copy(), 2.0 * P
    assert nis_kernel(P, dx, H, z, r, var, work, np.empty_like(H), columns()) > 899.0
    own = np.arange(N) < m
    open_kernel(opened, before, H, e, own, True, work, np.empty(N))
    x = P @ H.T @ np.linalg.solve(H @ P @ H.T + np.diag(r), e)
    step = np.zeros(N)
    step[:m] = e
    size = np.sqrt(np.diag(P))
    unit = np.outer(size, size)
    assert_allclose((opened - P) / unit, (np.outer(x, x) + np.diag(step**2)) / unit, rtol=1e-6, atol=1e-6)
    for verdict, part in ((LOST, opened - P), (STEPPED, np.diag(step**2)), (DRIFTED, np.outer(x, x))):
        E = growth(verdict, x, H, e, own)
        assert_allclose(E @ E.T / unit, part / unit, rtol=1e-6, atol=1e-6)
    alone, same = P.copy(), 2.0 * P
    open_kernel(alone, same, H, e, own, False, work, np.empty(N))
    assert_allclose((alone - P) / unit, np.diag(step**2) / unit, rtol=1e-6, atol=1e-6)
    assert_allclose((same - 2.0 * P) / unit, (alone - P) / unit, rtol=1e-9, atol=1e-9)
    assert_allclose((before - 2.0 * P) / unit, (opened - P) / unit, rtol=1e-9, atol=1e-9)
    assert_array_equal(opened, opened.T)
    assert nis(opened, dx, H, z, r)[0] <= m


@pytest.mark.parametrize("broken", [np.nan, -5.0])
def test_a_covariance_that_is_none_gives_a_nis_that_no_gate_accepts(broken):
    P, dx, H, z, r = problem(3)
    P[0, 0] = broken * abs(P[0, 0])
    value, _ = nis(P, dx, H, z, r)
    assert not value <= np.inf


def test_an_exact_measurement_leaves_no_variance_and_a_worthless_one_changes_nothing():
    P, dx, H, z, _ = problem(4, 1)
    exact, moved = sequential(P, dx, H, z, np.array([0.0]))
    assert abs(H[0] @ exact @ H[0]) < 1e-12 * (H[0] @ P @ H[0])
    assert_allclose(H[0] @ moved, z[0], rtol=1e-9)
    worthless, still = sequential(P, dx, H, z, np.array([1e30]))
    assert_allclose(worthless, P, rtol=1e-12, atol=1e-15)
    assert_allclose(still, dx, rtol=1e-12, atol=1e-15)


def short_form(P, dx, h, z, r, Ph, K):
    """P - K h' P: equal on paper."""
    Ph[:] = P @ h
    s = h @ Ph + r
    K[:] = Ph / s
    dx += K * (z - h @ dx)
    P -= np.outer(K, Ph)


def smallest_eigenvalue(P):
    sd = np.sqrt(np.abs(np.diag(P)))
    return np.linalg.eigvalsh(P / np.outer(sd, sd))[0]


def many_updates(update, count):
    """Measurements of 15 states in 60 combinations, each variance 1e-14 of what is known before the first."""
    rng = np.random.default_rng(36)
    sd = np.repeat([1e4, 1e2, 1.0, 1e-3, 1e-2], 3)
    root = sd[:, None] * (np.eye(15) + 0.3 * rng.normal(size=(15, 15)))
    P, dx = root @ root.T, np.zeros(15)
    H = rng.normal(size=(60, 15)) / sd
    z, work = rng.normal(size=60) * 1e-7, np.empty((2, 15))
    for k in range(count):
        update(P, dx, H[k % 60], z[k % 60], 1e-14, work[0], work[1])
    return P


@pytest.mark.parametrize("count", [1, 15, 16, 60, 1000, 100_000])
def test_p_stays_symmetric_and_positive_up_to_1e5_updates(count):
    P = many_updates(update_kernel, count)
    assert_array_equal(P, P.T)
    assert (np.diag(P) > 0).all()
    assert smallest_eigenvalue(P) > 0


def test_the_short_form_of_the_update_does_not_survive_that():
    P = many_updates(short_form, 5000)
    assert smallest_eigenvalue(0.5 * (P + P.T)) < 0


def test_compiled_kernels_agree_with_their_own_python():
    for seed in range(3):
        case = problem(seed)
        compiled, plain = sequential(*case), sequential(*case, update=update_kernel.py_func)
        sd = np.sqrt(np.diag(case[0]))
        assert_allclose(compiled[0] / np.outer(sd, sd), plain[0] / np.outer(sd, sd), rtol=0, atol=1e-13)
        assert_allclose(compiled[1] / sd, plain[1] / sd, rtol=0, atol=1e-13)
        value, var = nis(*case)
        own, own_var = nis(*case, kernel=nis_kernel.py_func)
        assert_allclose(value, own, rtol=1e-12)
        assert_allclose(var, own_var, rtol=1e-12)


def test_two_states_seen_together_open_by_the_least_step_that_explains():
    """Along their row of H: the innovation is one to be expected, and what the row does not see stays."""
    P, dx, H, _, r = problem(1, 1)
    H[:] = 0.0
    H[0, 2:4] = -1.2, 1.6
    e = np.array([50.0])
    work = np.zeros((1, 2))
    nis_kernel(P, dx, H, H @ dx + e, r, np.empty(1), work, np.empty_like(H), columns())
    opened = P.copy()
    own = (np.arange(N) >= 2) & (np.arange(N) < 4)
    open_kernel(opened, P.copy(), H, e, own, True, work, np.empty(N))
    x = P @ H[0] * (e[0] / (H[0] @ P @ H[0] + r[0]))
    step = opened - P - np.outer(x, x)
    assert_allclose(step[2:4, 2:4], 625.0 * np.outer([-0.6, 0.8], [-0.6, 0.8]), rtol=1e-9, atol=1e-6)
    assert_allclose(np.array([0.8, 0.6]) @ step[2:4, 2:4], 0.0, atol=1e-6)
    E = growth(STEPPED, x, H, e, own)
    assert_allclose(E @ E.T, step, rtol=1e-9, atol=1e-6)


def test_a_step_of_some_size_opens_its_states_alone_and_rows_may_be_longer_than_the_states():
    """A covariance of wide rows: what lies behind its columns belongs to nothing."""
    P, dx, H, z, r = problem(2, 1, 5)
    wide_P, wide_before = widened(P), widened(2.0 * P)
    wide_P[:, 5:] = wide_before[:, 5:] = 1e9
    opens = np.array([False, True, False, False, True])
    open_all_kernel(wide_P, wide_before, 3.0, opens)
    assert_allclose(wide_P[:, :5] - P, 9.0 * np.diag(opens), atol=1e-9 * P.max())
    assert_allclose(wide_before[:, :5] - 2.0 * P, 9.0 * np.diag(opens), atol=1e-9 * P.max())
    P = wide_P[:, :5].copy()
    update_kernel(wide_P, dx.copy(), H[0], z[0], r[0], np.empty(5), np.empty(5))
    assert_allclose(wide_P[:, :5], sequential(P, dx, H, z, r)[0], rtol=1e-12)
    assert (wide_P[:, 5:] == 1e9).all()


# --- updates whose change of P waits ------------------------------------------------------------------------


def late(P, dx, H, z, r, lengths):
    """P, dx and the rows times P that each sub-vector saw, by updates that wait."""
    n = len(P)
    P, dx, memory, count, seen = widened(P), dx.copy(), late_updates(n), 0, []
    for a, m in zip(np.cumsum(lengths) - lengths, lengths, strict=True):
        part = slice(a, a + m)
        late_rows_kernel(P, H[part], memory, count)
        seen.append(memory.HP[:m, :n].copy())
        count = late_update_kernel(P, dx, H[part], z[part], r[part], memory, count)
        assert count == (a + m) % DEPTH
    settle_kernel(P, memory, count)
    return P, dx, np.vstack(seen)


@pytest.mark.parametrize("lengths", [[1], [3, 3], [1] * 7, [3, 1, 2] * 4, [1] * (2 * DEPTH + 3)])
def test_updates_that_wait_equal_those_that_do_not(lengths):
    """Also the rows of a later sub-vector know of them; P is exactly symmetric."""
    P, dx, H, z, r = problem(7, sum(lengths))
    found, moved, seen = late(P, dx, H, z, r, np.array(lengths))
    sd = np.sqrt(np.diag(P))
    a = 0
    for m in lengths:
        part = slice(a, a + m)
        assert_allclose(seen[part] / sd, H[part] @ P / sd, rtol=0, atol=1e-9)
        P, dx = stacked(P, dx, H[part], z[part], r[part])
        a += m
    assert_allclose(found[:, :N] / np.outer(sd, sd), P / np.outer(sd, sd), rtol=0, atol=1e-12)
    assert_allclose(moved / sd, dx / sd, rtol=0, atol=1e-12)
    assert_array_equal(found[:, :N], found[:, :N].T)
    assert not found[:, N:].any()


@pytest.mark.parametrize("count", [15, 60, 5000])
def test_what_shrinks_p_by_orders_does_not_wait(count):
    """As `many_updates`; did they all wait, P would not be positive after the first fifteen."""
    memory, waits, wide_P = late_updates(15), 0, None

    def update(P, dx, h, z, r, *_):
        nonlocal waits, wide_P
        wide_P = widened(P) if wide_P is None else wide_P
        late_rows_kernel(wide_P, h[None], memory, waits)
        waits = late_update_kernel(wide_P, dx, h[None], np.array([z]), np.array([r]), memory, waits)

    many_updates(update, count)
    settle_kernel(wide_P, memory, waits)
    P = wide_P[:, :15]
    assert_array_equal(P, P.T)
    assert smallest_eigenvalue(P) > 0
