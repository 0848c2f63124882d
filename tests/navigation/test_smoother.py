"""The smoother: filterpy's on a linear problem, nowhere less sure than its filter, consistent."""

from dataclasses import replace

import numpy as np
import pytest
from filterpy.kalman import KalmanFilter
from numpy.testing import assert_allclose

from bench import pipeline
from bench.core.files import disk_arrays
from bench.core.mathematics import rotation
from bench.core.records.data import GnssFixes
from bench.io.config import read_profile
from bench.navigation.built_in import load
from bench.navigation.engine.kept_rows import take_rows
from bench.navigation.error_state_filter.error_state import StateLayout, less_errors, state_errors
from bench.navigation.error_state_filter.filter_run import Nodes
from bench.navigation.models.smoother import smooth
from tests.builders import assert_same_solution, take
from tests.navigation.test_layouts import RUNS, claims
from tests.navigation.test_pieces import record

BASE = np.concatenate(
    [[0.8, 0.2, 500.0], [20.0, 5.0, -1.0], rotation.from_euler(0.1, 0.2, 0.3), np.zeros(6), [0.0]]
)


@pytest.fixture(scope="module")
def matched():
    return read_profile("figure-eight-matched")


def test_equals_filterpys_smoother_on_a_linear_problem():
    """Sixteen states of millimeters and microradians, so that the manifold is flat to 1e-9 of them."""
    rng = np.random.default_rng(3)
    n, steps, size = 16, 40, 1e-4
    Phi = np.eye(n) + 0.1 * rng.normal(size=(steps, n, n)) / np.sqrt(n)
    kf = KalmanFilter(dim_x=n, dim_z=4)
    kf.P, kf.Q, kf.R = np.eye(n) * size**2, np.eye(n) * (0.1 * size) ** 2, np.eye(4) * (0.3 * size) ** 2
    kf.H = rng.normal(size=(4, n))
    xs, Ps, before, P_before = [], [], [], []
    for k in range(steps):
        kf.predict(F=Phi[k])
        before.append(kf.x.copy()), P_before.append(kf.P.copy())
        kf.update(size * rng.normal(size=(4, 1)))
        xs.append(kf.x.copy()), Ps.append(kf.P.copy())
    wanted, wanted_P, _, _ = kf.rts_smoother(np.array(xs), np.array(Ps), Fs=list(Phi), Qs=[kf.Q] * steps)
    rows = [[less_errors(BASE, -x[:, 0]) for x in pair] for pair in zip(before, xs, strict=True)]
    nodes = Nodes(
        StateLayout(("baro_bias", "m", 1)),
        np.arange(steps) * 1.0,
        np.array(rows),
        np.stack([P_before, Ps], axis=1),
        Phi,
        np.arange(steps),
    )
    parts = [
        Nodes(
            nodes.layout,
            *(getattr(nodes, name)[rows].copy() for name in ("t", "state", "P", "Phi", "output")),
        )
        for rows in (slice(0, 13), slice(13, 20), slice(20, None))
    ]
    smooth([nodes])
    smooth(parts)
    for name in ("state", "P"):
        joined = np.concatenate([getattr(part, name) for part in parts])
        assert_allclose(joined, getattr(nodes, name), rtol=1e-12, atol=1e-20)
    got = -state_errors(BASE, nodes.state[:, 1])
    assert_allclose(got, wanted[:, :, 0], rtol=0, atol=1e-3 * size)
    assert_allclose(nodes.P[:, 1], wanted_P, rtol=1e-3, atol=1e-3 * size**2)  # tilts turn by the heading


def test_what_does_not_move_is_known_before_as_it_is_after():
    """No noise, and a measurement that turns it by 40 deg: the node before ends as it, in the same axes."""
    rng = np.random.default_rng(4)
    n = 16
    A, x = rng.normal(size=(n, n)), 0.1 * rng.normal(size=n)
    x[8] = 0.7
    P = A @ A.T + n * np.eye(n)
    K = 0.5 * np.diag(rng.uniform(0.2, 0.9, n))
    P_after = (np.eye(n) - K) @ P @ (np.eye(n) - K)
    after = less_errors(BASE, x)
    nodes = Nodes(
        StateLayout(("baro_bias", "m", 1)),
        np.arange(2.0),
        np.array([[BASE, BASE], [BASE, after]]),
        np.array([[P, P], [P, P_after]]),
        np.stack([np.eye(n)] * 2),
        np.arange(2),
    )
    smooth([nodes])
    assert_allclose(nodes.state[0, 1], after, rtol=1e-9, atol=1e-9)
    assert_allclose(nodes.P[0, 1], P_after, rtol=0, atol=1e-9)


@pytest.mark.parametrize("name", ["loose-15", "loose-22", "loose-full"])
def test_nowhere_less_sure_than_its_filter_and_equal_at_the_end(matched, five_minutes, name):
    sensed = pipeline.sense(matched, five_minutes)
    forward = load(name, {}).run(sensed.data, sensed.initial)
    smoothed = load("smoother", {"over": name}).run(sensed.data, sensed.initial)
    for got, limit in (
        (np.einsum("kii->ki", smoothed.cov), np.einsum("kii->ki", forward.cov)),
        (smoothed.extra_sd**2, forward.extra_sd**2),
    ):
        assert (got <= limit * (1 + 1e-9)).all()
        assert (got[len(got) // 2] < limit[len(got) // 2])[:6].all()
    for name in ("lla", "vel_n", "q_nb", "cov", "extra"):
        assert_allclose(getattr(smoothed, name)[-1], getattr(forward, name)[-1], rtol=1e-12, atol=1e-15)


def test_the_outage_is_bridged_from_both_sides(matched, figure_eight_truth):
    sensed = pipeline.sense(matched, figure_eight_truth)
    growth = {}
    for name in ("loose-15", "smoother"):
        solution = load(name, {}).run(sensed.data, sensed.initial)
        _, metrics = pipeline.measure(matched, figure_eight_truth, solution)
        growth[name] = metrics["outage_1_drift_h_m"]
    assert growth["smoother"] < growth["loose-15"] / 3


@pytest.mark.parametrize("name", ["loose-15", "loose-22"])
def test_a_step_that_stays_is_a_step_backwards_too(matched, five_minutes, name):
    """200 m north from 150 s on, taken for true 10 s later: what lies before is not drawn after it."""
    sensed = pipeline.sense(matched, five_minutes)
    lla = sensed.data.fixes.lla.copy()
    lla[sensed.data.fixes.t >= 150.0, 0] += 200.0 / 6.37e6
    columns = {name: getattr(sensed.data.fixes, name) for name in GnssFixes.__slots__}
    data = replace(sensed.data, fixes=GnssFixes(**{**columns, "lla": lla}))
    forward, place = load(name, {}).run(data, sensed.initial), load("smoother", {"over": name})
    stepped, sound = place.run(data, sensed.initial), place.run(sensed.data, sensed.initial)
    got, limit = (np.einsum("kii->ki", s.cov) for s in (stepped, forward))
    assert (got <= limit * (1 + 1e-9)).all()
    north = (stepped.lla[:, 0] - sound.lla[:, 0]) * 6.37e6 / np.sqrt(sound.cov[:, 0, 0])
    assert np.abs(north[sound.t < 140.0]).max() < 1.0
    assert (stepped.lla[-1, 0] - sound.lla[-1, 0]) * 6.37e6 == pytest.approx(200.0, abs=5.0)


@pytest.mark.parametrize("over", ["loose-15", "loose-full", "tight"])
def test_a_long_record_is_smoothed_in_blocks_with_the_bits_of_the_whole(over, monkeypatch):
    """Fixes come late, three seconds of them and some samples of the IMU are missing."""
    initial, data = record(over)
    seen = data.fixes.t if over != "tight" else data.observations.t
    heard = (seen < 5.0) | (seen > 8.0)
    if over != "tight":
        data = replace(data, fixes=take(data.fixes, heard))
    else:
        data = replace(data, observations=take_rows(data.observations, heard))
    expected = load("smoother", {"over": over}).run(data, initial)
    assert np.isfinite(expected.cov).all()
    for rows in (83, 290):
        monkeypatch.setattr(disk_arrays, "ROWS", rows)
        monkeypatch.setattr(disk_arrays, "LARGE", 0)
        found = load("smoother", {"over": over}).run(data, initial)
        assert_same_solution(found, expected)
        assert sorted(found.events.rows()) == sorted(expected.events.rows())


@pytest.mark.slow
def test_the_smoother_knows_its_errors(five_minutes):
    """40 seeds of 300 s: all three are consistent; with half the sigma none would be."""
    every_second = read_profile("figure-eight-matched", {"evaluation.output_hz": 1.0})
    result = claims("smoother", every_second, five_minutes, RUNS)
    assert not result.rejected, result.reasons
    assert 2 * result.low > 1.25
