"""Subset simulation finds what plain runs count, and what the normal distribution says."""

from __future__ import annotations

import pickle

import numpy as np
import pytest
from scipy.stats import norm

from bench.core.mathematics.moved_runs import MovedRun
from bench.core.mathematics.random_streams import stream
from bench.evaluation.ensembles.rare_events import RareEvent, simulate_subsets
from bench.simulation.sensors.draws import SensorDraws

EPOCHS = 40
DECAY, DRIVE, NOISE = 0.95, 0.3, 1.0


def find_gain() -> tuple[float, float]:
    """The steady gain and the variance after the update of a Kalman filter of a Gauss-Markov error."""
    variance = 1.0
    for _ in range(1000):
        before = DECAY**2 * variance + DRIVE**2
        gain = before / (before + NOISE**2)
        variance = (1.0 - gain) * before
    return gain, variance


def run_filter(noise: np.ndarray) -> np.ndarray:
    """The errors (N, EPOCHS) of the steady filter from normal numbers (N, 1 + 2 EPOCHS)."""
    gain, variance = find_gain()
    error = np.sqrt(variance) * noise[:, 0]
    errors = []
    for drive, measured in zip(noise[:, 1 : 1 + EPOCHS].T, noise[:, 1 + EPOCHS :].T, strict=True):
        error = (1.0 - gain) * (DECAY * error - DRIVE * drive) + gain * NOISE * measured
        errors.append(error)
    return np.array(errors).T


def draw(runs: list[MovedRun]) -> np.ndarray:
    return np.array([one.open(lambda k: stream(1, k, "x")).standard_normal(1 + 2 * EPOCHS) for one in runs])


def measure_largest(runs: list[MovedRun]) -> np.ndarray:
    found: np.ndarray = np.abs(run_filter(draw(runs))).max(axis=1)
    return found


def measure_last(runs: list[MovedRun]) -> np.ndarray:
    found: np.ndarray = np.abs(run_filter(draw(runs))[:, -1])
    return found


def test_the_last_error_is_beyond_a_limit_as_often_as_the_normal_distribution_says():
    """One in a million, by fewer than 10,000 runs."""
    sd = np.sqrt(find_gain()[1])
    limit = sd * norm.isf(0.5e-6)
    found = simulate_subsets(measure_last, limit, 200)
    assert found.probability.low < 1e-6 < found.probability.high
    assert found.probability.high < 40.0 * found.probability.low
    assert found.runs == 200 * (sum(found.levels) + 5) < 10_000
    assert set(found.levels) <= {5, 6, 7}


@pytest.mark.slow
def test_the_largest_error_is_beyond_a_limit_as_often_as_in_a_million_plain_runs():
    limit, beyond = 4.3 * np.sqrt(find_gain()[1]), 0
    rng = np.random.default_rng(5)
    for _ in range(50):
        beyond += int(
            (np.abs(run_filter(rng.standard_normal((20_000, 1 + 2 * EPOCHS)))) > limit).any(axis=1).sum()
        )
    assert 100 < beyond < 1000
    found = simulate_subsets(measure_largest, limit, 200, first=7000).probability
    assert found.low < 1e-6 * beyond * (1.0 + 3.0 / np.sqrt(beyond))
    assert found.high > 1e-6 * beyond * (1.0 - 3.0 / np.sqrt(beyond))


def test_an_event_that_is_frequent_never_or_always_there_is_told():
    def measure(runs: list[MovedRun]) -> np.ndarray:
        return np.array([one.open(lambda k: stream(1, k, "x")).standard_normal() for one in runs])

    half: RareEvent = simulate_subsets(measure, 0.0, 100)
    assert (half.levels, half.runs) == ((0,) * 5, 500)
    assert half.probability.low < 0.5 < half.probability.high
    never = simulate_subsets(lambda runs: np.zeros(len(runs)), 1.0, 100).probability
    assert (never.value, never.low) == (0.0, 0.0)  # equal values: no tenth is above the others
    assert 0.02 < never.high < 0.05
    assert simulate_subsets(lambda runs: np.full(len(runs), np.nan), 1.0, 100).probability.value == 1.0


def test_the_noise_of_a_moved_run_is_normal_whatever_its_parts():
    run = MovedRun(0)
    for k in range(1, 30):
        run = run.move(k, 0.5)
    assert sum(weight**2 for _, weight in run.parts) == pytest.approx(1.0)
    assert run == pickle.loads(pickle.dumps(run)) != MovedRun(0)
    assert len({run, MovedRun(0), MovedRun(0), 0}) == 3
    moved, plain = (SensorDraws(1, one).stream("imu") for one in (run, 0))
    assert moved.random(3).tolist() == plain.random(3).tolist()
    noise = moved.standard_normal((100_000, 1))
    assert (noise.mean(), noise.std()) == (pytest.approx(0.0, abs=0.02), pytest.approx(1.0, abs=0.01))
    again, out = SensorDraws(1, run).stream("imu"), np.empty((100_000, 1))
    again.random(3)
    assert again.standard_normal(out=out) is out
    assert np.array_equal(out, noise)
    near = SensorDraws(1, MovedRun(0).move(1, 0.1)).stream("imu").standard_normal(1000)
    assert np.corrcoef(near, SensorDraws(1, 0).stream("imu").standard_normal(1000))[0, 1] > 0.98
