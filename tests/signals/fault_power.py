"""How often a fault of one satellite is found and left out, on real ranges and as the covariance predicts.

``python -m tests.signals.fault_power OBSERVATIONS NAVIGATION`` adds ``--fault`` meters to each satellite in
turn at each epoch with eight or more. Predicted: the same test on errors drawn from the covariance of the
ranges. At most: what a test finds in these that knows the size of the fault and has as many false alarms; no
test of one epoch finds more of such faults (lemma of Neyman and Pearson). An interval is 99.9 % by draws of
whole epochs, whose satellites share their errors; the epochs of a day hang together besides.
"""

from __future__ import annotations

import argparse
from dataclasses import replace
from pathlib import Path

import numpy as np

import bench
from bench.core.mathematics import earth
from bench.core.mathematics.arrays import BoolArray, FloatArray
from bench.plugins.receiver.rinex_fixes import RinexFixes
from bench.simulation.signals import receiver_solution
from bench.simulation.signals.fault_test import find_alarms
from bench.simulation.signals.look import share_errors
from bench.simulation.signals.processing import Processing

LEAST = 8  # satellites of an epoch
DRAWS = 100


def try_faults(solved: RinexFixes, processing: Processing, fault: float) -> tuple[FloatArray, BoolArray]:
    """Return epoch and row (F, 2) of each trial, and which faults (F,) are left out of a fix."""
    o, used = solved.seen, solved.solution.used
    count = np.bincount(o.epoch[used], minlength=len(solved.fixes))
    place = np.concatenate([np.arange(n) for n in np.diff(o.epoch_start)])
    trials, found = [], []
    for k in range(int(np.diff(o.epoch_start).max())):
        rows = np.flatnonzero((place == k) & used & (count[o.epoch] >= LEAST))
        ranges = o.pseudorange.copy()
        ranges[rows] += fault
        again = receiver_solution.solve_fixes(replace(o, pseudorange=ranges), processing)
        trials.append(np.column_stack([o.epoch[rows], rows]))
        found.append(~again.used[rows] & again.fixes.valid[o.epoch[rows]])
    return np.concatenate(trials), np.concatenate(found)


def predict(
    solved: RinexFixes, processing: Processing, trials: FloatArray, fault: float, rng: np.random.Generator
) -> tuple[FloatArray, FloatArray]:
    """Return the chance (F,) of each trial by the covariance, and that of a test that knows the size."""
    o = solved.seen
    lla = solved.fixes.lla
    near = receiver_solution.look_around(o, earth.to_ecef(lla), processing)
    shared = share_errors(near, o.frequency[:, 0], processing)
    common = shared.ionosphere**2 + shared.troposphere**2
    own = np.maximum(o.sd_pseudorange**2 - common, (0.1 * o.sd_pseudorange) ** 2)
    chance, sound, told_size = np.empty(len(trials)), [], np.empty((len(trials), DRAWS))
    for epoch in np.unique(trials[:, 0]):
        at = np.flatnonzero(trials[:, 0] == epoch)
        rows = np.flatnonzero((o.epoch == epoch) & solved.solution.used)
        apart = shared.pierce[rows, None] - shared.pierce[rows]
        R = np.exp(-np.hypot(apart[..., 0], apart[..., 1]) / shared.decay)
        R = R * np.outer(shared.ionosphere[rows], shared.ionosphere[rows])
        R += np.outer(shared.troposphere[rows], shared.troposphere[rows]) + np.diag(own[rows])
        clocks = (o.system[rows, None] == np.unique(o.system[rows])).astype(float)
        H = np.column_stack([-near.los_n[rows], clocks])
        W = np.linalg.inv(R)
        Q = W - W @ H @ np.linalg.solve(H.T @ W @ H, H.T @ W)
        told = np.diag(Q) > 1e-6 * np.diag(W)
        share = np.sqrt(np.where(told, np.diag(Q), 0.0))
        scale = np.where(told, 1.0 / np.where(told, share, 1.0), 0.0)
        noise = rng.standard_normal((DRAWS, len(rows))) @ np.linalg.cholesky(R).T
        size = fault * share
        sound.append(find_odds(noise @ Q * scale, size).max(axis=1))
        for trial in at:
            i = int(np.flatnonzero(rows == trials[trial, 1])[0])
            w = (noise + fault * (np.arange(len(rows)) == i)) @ Q * scale
            alarm, worst = find_alarms(np.abs(w), np.tile(share, (DRAWS, 1)), processing.false_alarm)
            chance[trial] = np.mean(alarm & (worst == i))
            odds = find_odds(w, size)
            told_size[trial] = np.where(odds.argmax(axis=1) == i, odds[:, i], -np.inf)
    limit = np.quantile(np.concatenate(sound), 1.0 - processing.false_alarm)
    return chance, np.mean(told_size > limit, axis=1)


def find_odds(w: FloatArray, size: FloatArray) -> FloatArray:
    """Return the logarithmic odds (D, n) of a fault in each row that shifts its w by ``size``, either way."""
    return np.asarray(np.logaddexp(w * size, -w * size) - size**2 / 2.0)


def resample(values: FloatArray, epochs: FloatArray, rng: np.random.Generator) -> tuple[float, float]:
    """Return the 99.9 % interval of the mean by draws of whole epochs."""
    _, which = np.unique(epochs, return_inverse=True)
    total, count = np.bincount(which, values), np.bincount(which)
    drawn = rng.integers(0, len(count), (4000, len(count)))
    means = total[drawn].sum(axis=1) / count[drawn].sum(axis=1)
    low, high = np.percentile(means, [0.05, 99.95])
    return float(low), float(high)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("observations", type=Path)
    parser.add_argument("navigation", type=Path)
    parser.add_argument("--systems", nargs="+", default=["gps", "galileo", "beidou", "both", "all"])
    parser.add_argument("--fault", type=float, nargs="+", default=[12.0, 15.0])
    parser.add_argument("--each", type=int, default=1, help="of this many epochs one is tried")
    args = parser.parse_args()
    print(
        f"{'systems':18s} fault trials  excluded (99.9 %)       predicted  at most  alarms  "
        "where it predicts 98 or more: part, excluded, and elsewhere predicted, excluded"
    )
    for systems in args.systems:
        solved = bench.solve_rinex(args.observations, args.navigation, systems=systems)
        processing = Processing(systems=systems)
        good = solved.fixes.valid
        lost = solved.solution.wanted & ~solved.solution.used & good[solved.seen.epoch]
        alarms = len(np.unique(solved.seen.epoch[lost]))
        for fault in args.fault:
            rng = np.random.default_rng(0)
            trials, found = try_faults(solved, processing, fault)
            kept = trials[:, 0] % args.each == 0
            trials, found = trials[kept], found[kept]
            if len(trials) == 0:
                print(f"{systems:18s} {fault:5.1f} no epoch with {LEAST} satellites")
                continue
            chance, most = predict(solved, processing, trials, fault, rng)
            sure = chance >= 0.98
            rest = (
                f"{100 * chance[~sure].mean():.1f} {100 * found[~sure].mean():.1f}" if (~sure).any() else "-"
            )
            low, high = resample(found.astype(float), trials[:, 0], rng)
            print(
                f"{systems:18s} {fault:5.1f} {len(found):6d}  {100 * found.mean():5.1f} ({low * 100:.1f} to "
                f"{high * 100:.1f})  {100 * chance.mean():9.1f}  {100 * most.mean():7.1f}  "
                f"{alarms} of {good.sum()}  {100 * sure.mean():.1f} {100 * found[sure].mean():.1f}, {rest}"
            )


if __name__ == "__main__":
    main()
