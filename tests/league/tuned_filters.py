"""Filters of the league with parameters found on training flights: ``python -m tests.league.tuned_filters``.

The training flights are the suite's with another seed, one run each. The search goes through the parameters
one after the other, from the defaults of the authors, by factors; it minimizes the mean logarithm of the rms
total error, so that no flight outweighs another.
"""

from __future__ import annotations

import json
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np

from bench import pipeline
from bench.core.mathematics import rotation
from tests.league import ahrs_filters, other_attitude

TUNED = Path(__file__).with_name("tuned.json")
SEED = 440404  # of the training runs
FACTORS = (0.03, 0.1, 0.3, 3.0, 10.0, 30.0)
FINER = (0.6, 1.7)
STARTS = {
    "Madgwick": {"gain": 0.041},
    "Mahony": {"k_P": 1.0, "k_I": 0.3},
    "Aqua": {"alpha": 0.01, "beta": 0.01},
    "AhrsEkf": {"var_acc": 0.25, "var_mag": 0.64},
    "Fusion": {"gain": 0.5},
    "Vqf": {"tauAcc": 3.0, "tauMag": 9.0},
}
"""The defaults of the authors, from which the search begins."""


def _find_values(name: str) -> dict[str, float]:
    return json.loads(TUNED.read_text(encoding="utf-8"))[name] if TUNED.exists() else {}


class TunedMadgwick(ahrs_filters.Madgwick):
    values = _find_values("Madgwick")


class TunedMahony(ahrs_filters.Mahony):
    values = _find_values("Mahony")


class TunedAqua(ahrs_filters.Aqua):
    values = _find_values("Aqua")


class TunedAhrsEkf(ahrs_filters.AhrsEkf):
    values = _find_values("AhrsEkf")


class TunedFusion(other_attitude.Fusion):
    values = _find_values("Fusion")


class TunedVqf(other_attitude.Vqf):
    values = _find_values("Vqf")


def make_training():
    """Return truth, sensors and start of the evaluation of each training flight."""
    from tests.league.entries import ATTITUDE
    from tests.league.league import plan_suite

    suite = replace(ATTITUDE, draw_seed=SEED, draws=1)
    plan = plan_suite(suite, ["ahrs"])
    for number, flight in enumerate(suite.members):
        if not flight.without:
            profile = suite.profile_of(plan, number, 0)
            truth = pipeline.fly(profile)
            yield truth, pipeline.sense(profile, truth), profile.evaluation.begin


def measure_total(made, truth, sensed, begin) -> float:
    """Return the rms angle of q_est^-1 q_true from ``begin`` on [rad]; pi for a filter that ends."""
    try:
        solution = made.run(sensed.data, sensed.initial)
    except (ValueError, ArithmeticError):
        return np.pi
    row = np.searchsorted(truth.t, solution.t - 1e-9).clip(0, len(truth.t) - 1)
    off = rotation.multiply(rotation.conjugate(solution.q_nb), truth.q_nb[row])
    angle = np.linalg.norm(rotation.to_rotvec(off), axis=1)[solution.t >= begin]
    rms = float(np.sqrt(np.mean(angle**2)))
    return rms if np.isfinite(rms) else np.pi


def tune(name: str, training) -> dict[str, float]:
    """Return the parameters of a filter with the smallest cost on the training flights."""
    kind = getattr(sys.modules[__name__], f"Tuned{name}")

    def cost(values: dict[str, float]) -> float:
        made = kind()
        made.values = values
        return float(np.mean([np.log(measure_total(made, *one)) for one in training]))

    best = dict(STARTS[name])
    lowest = cost(best)
    for factors in (FACTORS, FINER):
        for key in STARTS[name]:
            for tried in [{**best, key: best[key] * factor} for factor in factors]:
                if (found := cost(tried)) < lowest:
                    best, lowest = tried, found
    return {key: float(f"{value:.3g}") for key, value in best.items()}


def main() -> None:
    """Tune all filters; write what was found."""
    training = list(make_training())
    found = {name: tune(name, training) for name in STARTS}
    TUNED.write_text(json.dumps({"seed": SEED, **found}, indent=1) + "\n", encoding="utf-8")
    print(TUNED.read_text(encoding="utf-8"))


if __name__ == "__main__":
    main()
