"""Print how often intervals over runs hold the truth, and the level of the test of NEES: tables of the guide.

``python -m tests.evaluation.interval_coverage`` takes a minute. ``--cases`` is the number of simulated cases.
"""

import argparse

import numpy as np
from scipy.stats import ttest_1samp

from bench.evaluation.ensembles import ensemble
from bench.evaluation.ensembles.ensemble_consistency import _test_means
from bench.evaluation.ensembles.paired_draws import compare_draws_of

RUNS = (8, 59, 100, 400)
LEVEL = 0.005

SCATTERS = {
    "normal": (lambda rng, shape: np.abs(rng.standard_normal(shape)), 1.0, 0.674490),
    "log-normal, 1.5": (lambda rng, shape: np.exp(1.5 * rng.standard_normal(shape)), np.exp(2.25), 1.0),
    "normal, one run in twenty 10 times": (
        lambda rng, shape: np.abs(rng.standard_normal(shape)) * np.where(rng.random(shape) < 0.05, 10.0, 1.0),
        np.sqrt(0.95 + 0.05 * 100.0),
        0.711668,
    ),
}
"""Errors of runs in words -> a draw of them, their root mean square, their median."""

SKEWED = {
    "normal, 0.3": lambda rng, shape: 1.0 + 0.3 * rng.standard_normal(shape),
    "chi-square, 1 degree of freedom": lambda rng, shape: rng.chisquare(1, shape),
    "chi-square, 3": lambda rng, shape: rng.chisquare(3, shape) / 3.0,
    "chi-square, 9": lambda rng, shape: rng.chisquare(9, shape) / 9.0,
    "log-normal, 0.5": lambda rng, shape: np.exp(0.5 * rng.standard_normal(shape) - 0.125),
    "log-normal, 1": lambda rng, shape: np.exp(rng.standard_normal(shape) - 0.5),
}
"""Scatter of run averages of NEES over its expectation, with mean 1."""


def count_held(rng, cases, runs, scatter):
    """Return how many intervals hold the truth: of the pooled RMSE, of a ratio of RMSEs, of the median.

    The ratio is that of a filter with the scatter to one with normal errors on the same runs.
    """
    draw, rms, median = SCATTERS[scatter]
    held = np.zeros(3, int)
    for _ in range(cases):
        errors, other = draw(rng, runs), np.abs(rng.standard_normal(runs))
        pooled = ensemble.pool_rmse(np.square(errors))
        ratio = compare_draws_of(("a", "b"), errors, other).ratio
        middle = ensemble.estimate_quantile(errors, 0.5)
        held += [
            one.low <= truth <= one.high for one, truth in ((pooled, rms), (ratio, rms), (middle, median))
        ]
    return held


def count_false(rng, cases, runs, scatter):
    """Return how many means of 1 are called too small and too large at `LEVEL`: by the cube root, by t."""
    values = SKEWED[scatter](rng, (cases, runs))
    mean = values.mean(axis=1)
    spread = values.var(axis=1, ddof=1) / (9.0 * runs * mean**2)
    found = [*_test_means(mean, spread, runs - 1)]
    found += [ttest_1samp(values, 1.0, axis=1, alternative=side).pvalue for side in ("less", "greater")]
    return [int(np.sum(p < LEVEL)) for p in found]


def count_same(rng, cases, runs, ratio, scatter):
    """Return how often each sentence calls filters the same whose RMSEs have a ratio: in m, and by ratio."""
    found = np.zeros(2, int)
    for _ in range(cases):
        common = np.exp(0.3 * rng.standard_normal(runs))
        first = ratio * common * np.exp(scatter * rng.standard_normal(runs))
        second = common * np.exp(scatter * rng.standard_normal(runs))
        found += [
            "the same" in ensemble.compare_rmse(("a", "b"), first, second, "m").sentence,
            compare_draws_of(("a", "b"), first, second).word == "same",
        ]
    return found


def main():
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--cases", type=int, default=4000)
    cases = parser.parse_args().cases
    rng = np.random.default_rng(61)
    print("| errors of the runs | runs | pooled RMSE | ratio of RMSEs | median |\n|---|---|---|---|---|")
    for scatter in SCATTERS:
        for runs in RUNS:
            shares = " | ".join(f"{100 * x:.0f} %" for x in count_held(rng, cases, runs, scatter) / cases)
            print(f"| {scatter} | {runs} | {shares} |", flush=True)
    print("\n| scatter | runs | too small | too large | too small by t | too large by t |")
    print("|---|---|---|---|---|---|")
    for scatter in SKEWED:
        for runs in (8, 40, 100):
            shares = " | ".join(f"{100 * x / 20_000:.1f} %" for x in count_false(rng, 20_000, runs, scatter))
            print(f"| {scatter} | {runs} | {shares} |", flush=True)
    print("\n| ratio of RMSEs | runs | the same, by the difference | by the ratio |\n|---|---|---|---|")
    for ratio, scatter in ((1.0, 0.02), (1.05, 0.02), (1.05, 0.1), (1 / 1.05, 0.02)):
        for runs in (8, 59):
            shares = " | ".join(
                f"{100 * x:.1f} %" for x in count_same(rng, cases, runs, ratio, scatter) / cases
            )
            print(f"| {ratio:.3g}, scatter {100 * scatter:g} % | {runs} | {shares} |", flush=True)


if __name__ == "__main__":
    main()
