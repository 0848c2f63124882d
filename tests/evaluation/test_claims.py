"""Bands of one run: consistent filters are rarely outside, whatever lasts; a wrong covariance is."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import lfilter
from scipy.stats import binom

from bench.core.mathematics.units import split_unit
from bench.core.records.run_records import SensorTruth
from bench.core.records.specs import EvaluationWindow
from bench.evaluation.consistency.verdict import is_outside
from bench.evaluation.metrics.claims import count_independent, find_least_inside
from bench.evaluation.metrics.run_metrics import measure
from tests.evaluation.solutions import COV, weaving_truth, wrong_solution

RUNS = 40


def lasting(rng, tau, rows, columns, step=0.1):
    """Unit-variance errors (rows, columns) that last tau seconds: first-order Gauss-Markov from its start."""
    keep = np.exp(-step / tau) if tau else 0.0
    noise = rng.normal(size=(rows, columns)) * np.sqrt(1.0 - keep**2)
    return lfilter([1.0], [1.0, -keep], noise, axis=0, zi=keep * rng.normal(size=(1, columns)))[0]


@pytest.fixture(scope="module")
def truth():
    return weaving_truth(60.0, 20.0)


def measured(truth, tau, claim=1.0, runs=RUNS):
    """Metrics of runs whose errors last tau [s]; the covariance holds so many times the true variance."""
    found = []
    for k in range(runs):
        errors = lasting(np.random.default_rng(k), tau, 601, 9) * np.sqrt(np.diag(COV))
        parts = {"pos_n": errors[:, :3], "vel_n": errors[:, 3:6], "phi_n": errors[:, 6:]}
        solution = wrong_solution(truth, every=2, cov=claim * COV, **parts)
        found.append(measure(truth, solution, evaluation=EvaluationWindow(0.0), outages=())[1])
    return found


@pytest.mark.parametrize("tau", [0.0, 3.0, 30.0, 1e5])
def test_an_honest_filter_stays_in_its_bounds_however_long_its_errors_last(truth, tau):
    """0.5 % a run are allowed for NEES, 0.4 % an axis for coverage: 3 of 40 and 9 of 360 have P < 0.1 %."""
    runs = measured(truth, tau)
    out = sum(not run["nees_low"] <= run["nees_mean"] <= run["nees_high"] for run in runs)
    axes = [f"{block}_{axis}" for block in ("pos", "vel", "phi") for axis in "ned"]
    below = sum(run[f"coverage_3sigma_{name}"] < run[f"coverage_low_{name}"] for run in runs for name in axes)
    assert out < 3
    assert below < 9


def test_a_covariance_that_is_too_small_is_outside_as_soon_as_the_run_can_tell(truth):
    """A tenth of the variance: NEES 90. Errors of 0.3 s or 3 s show it in every run of a minute."""
    for tau in (0.3, 3.0):
        assert all(run["nees_mean"] > run["nees_high"] for run in measured(truth, tau, claim=0.1, runs=10))


def test_independent_values_are_counted_by_how_long_an_error_lasts():
    """White: all of them. A first-order process: T / (2 tau), and one value if it lasts the whole run."""
    rng = np.random.default_rng(4)
    assert count_independent(lasting(rng, 0.0, 20_000, 1)[:, 0]) > 15_000
    counts = [count_independent(lasting(rng, 10.0, 20_000, 1)[:, 0]) for _ in range(20)]
    assert np.mean(counts) == pytest.approx(2000.0 / 20.0, rel=0.25)
    for memory in (1.0, 30.0, 300.0, 3000.0):  # sums that end in the first quarter, later, and nowhere
        values = lasting(rng, memory, 1001, 1)[:, 0]
        values -= 0.9 * values.mean()
        full = np.correlate(values, values, "full")[len(values) - 1 :] / np.square(values).sum()
        pairs = full[0:-1:2] + full[1::2]
        until = np.flatnonzero(pairs <= 0.0)
        total = 2.0 * pairs[: until[0] if len(until) else None].sum() - 1.0
        wanted = np.clip(len(values) / max(total, 1.0), 1.0, len(values))
        assert count_independent(values) == pytest.approx(wanted, rel=1e-9)
    assert count_independent(np.full(500, -3.0)) == pytest.approx(1.0)
    assert count_independent(np.array([1.0, np.nan])) == 0.0


def test_errors_of_biases_have_rmse_coverage_and_squares(truth):
    """A gyro bias that is off by 2 sigma and an accelerometer bias that is off by 4 sigma on one axis."""
    names = tuple(f"gyro_bias_{a}_rad_s" for a in "xyz") + tuple(f"accel_bias_{a}_m_s2" for a in "xyz")
    sd = np.array([1e-5] * 3 + [1e-3] * 3)
    true = np.array([1e-4, 2e-4, 3e-4, 0.01, 0.02, 0.03])
    off = np.array([2e-5, 0.0, 0.0, 0.0, 0.0, 4e-3])
    solution = wrong_solution(truth)
    m = len(solution)
    solution = replace(
        solution,
        gyro_bias_b=np.tile((true + off)[:3], (m, 1)),
        accel_bias_b=np.tile((true + off)[3:], (m, 1)),
        extra_names=names,
        extra=np.tile(true + off, (m, 1)),
        extra_sd=np.tile(sd, (m, 1)),
    )
    drawn = SensorTruth(np.array([0.0, 60.0]), np.tile(true[:3], (2, 1)), np.tile(true[3:], (2, 1)))
    found = measure(truth, solution, evaluation=EvaluationWindow(0.0), outages=(), drawn=drawn)[1]
    assert found["gyro_bias_rmse_x_deg_h"] == pytest.approx(np.rad2deg(2e-5) * 3600)
    assert found["gyro_bias_rmse_y_deg_h"] == pytest.approx(0.0, abs=1e-9)
    assert found["accel_bias_rmse_z_mg"] == pytest.approx(4e-3 / 9.80665e-3)
    assert found["coverage_3sigma_bias_gyro_bias_x"] == 1.0
    assert found["coverage_3sigma_bias_accel_bias_z"] == 0.0
    squares = {"gyro_bias_x": 4.0, "accel_bias_z": 16.0}
    for name in (f"{kind}_bias_{axis}" for kind in ("gyro", "accel") for axis in "xyz"):
        assert found[f"nees_bias_{name}"] == pytest.approx(squares.get(name, 0.0), abs=1e-9)
        outside = is_outside(f"nees_bias_{name}", found)  # 2 and 4 sigma all along; 0 has no band
        assert outside == (name == "accel_bias_z")


@pytest.mark.parametrize("tau", [0.0, 3.0, 1e5])
def test_an_honest_bias_state_stays_in_its_band_and_one_with_half_its_sigma_does_not(truth, tau):
    """0.5 % of 240 states outside: more than 6 have P < 0.1 %. A sigma of a half shows in the mean
    square, 4, wherever errors pass, and in every twentieth run-long error.
    """
    outside = {1.0: 0, 0.5: 0}
    names = tuple(f"gyro_bias_{a}_rad_s" for a in "xyz") + tuple(f"accel_bias_{a}_m_s2" for a in "xyz")
    drawn = SensorTruth(np.array([0.0, 60.0]), np.zeros((2, 3)), np.zeros((2, 3)))
    solution = wrong_solution(truth, every=2)
    for k in range(RUNS):
        off = lasting(np.random.default_rng(k), tau, len(solution), 6)
        for claim in outside:
            one = replace(
                solution,
                gyro_bias_b=off[:, :3],
                accel_bias_b=off[:, 3:],
                extra_names=names,
                extra=off,
                extra_sd=np.full_like(off, claim),
            )
            found = measure(truth, one, evaluation=EvaluationWindow(0.0), outages=(), drawn=drawn)[1]
            outside[claim] += sum(is_outside(f"nees_bias_{split_unit(name)[0]}", found) for name in names)
    assert outside[1.0] <= 6
    assert outside[0.5] > (0.5 if tau < 10.0 else 0.05) * RUNS * 6


@pytest.mark.parametrize("count", [1, 40, 1000])
def test_the_least_share_inside_is_that_of_a_binomial_and_half_a_value(count):
    allowed = binom.ppf(0.995, count, 0.0027)
    assert find_least_inside(count + 0.9) == pytest.approx(max(0.0, 1.0 - (allowed + 0.5) / count))
    assert find_least_inside(0.9) is None
