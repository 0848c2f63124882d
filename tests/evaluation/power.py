"""Print how often the checks find a loss, and how often they raise a false alarm: the tables of the guide.

``python -m tests.evaluation.power`` takes a minute. ``--cases`` is the number of simulated cases of a row.
"""

import argparse

import numpy as np
from scipy.special import stdtr

from bench.evaluation.ensembles import regression
from bench.evaluation.ensembles.ensemble_consistency import check_consistency

ROWS, LOOKS = 100, (20, 40, 80)
STATES = 9
TIME_CONSTANTS = np.array([900.0] * 5 + [60.0] * 2 + [5.0] * 2)  # [s]
STEP, EPOCHS = 60.0, 11  # 600 s

LOSSES = ((0.03, 0.02), (0.05, 0.02), (0.05, 0.05), (0.10, 0.05), (0.10, 0.10), (0.20, 0.10), (0.20, 0.20))
SCATTERS = ((0.05, 0.3), (0.20, 0.3), (0.50, 0.6))
FACTORS = (
    ("right", 1.0), ("9 % too small", 1.1), ("20 % too small", 1.25), ("25 % too small", 1 / 0.75),
    ("33 % too small", 1.5), ("50 % too large", 1 / 1.5),
)  # fmt: skip
"""P in words -> factor on NEES."""


def draw_rmse(rng, checks, loss, scatter, spread):
    """RMSE (checks, 80) before and after: log-normal over the runs, a loss with a scatter per run."""
    old = np.exp(rng.normal(0.0, spread, (checks, LOOKS[-1])))
    return old, old * (1 + loss) * np.exp(rng.normal(0.0, scatter, old.shape))


def is_proven(old, new):
    """Whether a change beyond 2 % is proven, as one of 100 rows at one of three looks."""
    by_draw = np.log(new / old)
    change = regression.estimate_change(
        old**2, new**2, regression.half_log_of_mean, paired=True, by_draw=by_draw
    )
    return abs(change.estimate) > np.log(1.02) and change.p_value < 0.01 / len(LOOKS) / ROWS


def find_losses(rng, cases, loss, scatter, spread=0.3):
    """Return the looks (cases, 3) at or before which a loss is proven."""
    old, new = draw_rmse(rng, cases, loss, scatter, spread)
    proven = np.array([[is_proven(a[:n], b[:n]) for n in LOOKS] for a, b in zip(old, new, strict=True)])
    return np.logical_or.accumulate(proven, axis=1)


def count_alarms(rng, checks, scatter, spread):
    """Return how many checks of 100 rows without a loss call any of them changed at any look."""
    count = 0
    for _ in range(checks):
        old, new = draw_rmse(rng, ROWS, 0.0, scatter, spread)
        by_draw = np.log(new / old)
        count += any(
            is_proven(old[k, :n], new[k, :n])
            for n in LOOKS
            for k in np.flatnonzero(
                _test_draws(by_draw[:, :n]) < 0.01 / len(LOOKS) / ROWS
            )  # the others cannot
        )
    return count


def _test_draws(by_draw):
    """Return the p-values of Student's t test of rows (R, N)."""
    n = by_draw.shape[1]
    return 2 * stdtr(n - 1, -np.abs(by_draw.mean(axis=1)) / by_draw.std(axis=1, ddof=1) * n**0.5)


def draw_nees(rng, ensembles, runs):
    """NEES (ensembles, runs, EPOCHS) of a matched filter with run-long errors."""
    a = np.exp(-STEP / TIME_CONSTANTS)
    x = rng.standard_normal((ensembles, runs, STATES))
    nees = np.empty((ensembles, runs, EPOCHS))
    for k in range(EPOCHS):
        nees[:, :, k] = np.square(x).sum(axis=2)
        x = a * x + np.sqrt(1 - a * a) * rng.standard_normal(x.shape)
    return nees


def judge_ensembles(rng, ensembles, runs, factor):
    """Return how many ensembles are rejected, and the most frequent word."""
    found = [check_consistency(factor * nees, STATES, {}) for nees in draw_nees(rng, ensembles, runs)]
    words = [one.word for one in found]
    return sum(one.rejected for one in found), max(set(words), key=words.count)


def write_percent(count, cases):
    """Return a share of cases, with a digit behind the point below 10 %."""
    percent = 100.0 * count / cases
    return f"{percent:.1f} %" if percent < 10 else f"{percent:.0f} %"


def main():
    """Print the three tables."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--cases", type=int, default=1000)
    cases = parser.parse_args().cases
    rng = np.random.default_rng(1)
    print("| loss | scatter | found in 20 runs | in 40 | in 80 |\n|---|---|---|---|---|")
    for loss, scatter in LOSSES:
        shares = [f"{100 * x:.0f} %" for x in find_losses(rng, cases, loss, scatter).mean(axis=0)]
        print(f"| {100 * loss:.0f} % | {100 * scatter:.0f} % | {' | '.join(shares)} |", flush=True)
    print("\n| what changed | checks with a false alarm |\n|---|---|")
    for scatter, spread in SCATTERS:
        text = f"every run by {100 * scatter:.0f} %, runs that differ by {100 * spread:.0f} %"
        print(f"| {text} | {write_percent(count_alarms(rng, cases, scatter, spread), cases)} |", flush=True)
    print("\n| P | rejected, 40 runs | 80 | 200 | most often, 40 runs | 200 |\n|---|---|---|---|---|---|")
    for text, factor in FACTORS:
        found = [judge_ensembles(rng, cases, runs, factor) for runs in (40, 80, 200)]
        shares = " | ".join(write_percent(count, cases) for count, _ in found)
        print(f"| {text} | {shares} | {found[0][1]} | {found[2][1]} |", flush=True)


if __name__ == "__main__":
    main()
