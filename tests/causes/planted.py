"""Runs whose causes were put there: a matched filter and twelve sources, of which one or two are large.

All twelve are on board in every run, so that each is a candidate. Small they break no covariance; one or two
are made so large that they do. What a run should name does not come from the search: a source counts if the
run with it alone made large is not consistent.

    python -m tests.causes.planted --runs 240        # a line for each wrong answer, and the shares
"""

from __future__ import annotations

import argparse
from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass, replace
from functools import cache
from typing import Any

import numpy as np

from bench import pipeline
from bench.core.mathematics.units import DEG, HOUR, STANDARD_GRAVITY
from bench.core.records.data import Trajectory
from bench.core.records.sensor_specs import AssumedSpecs, Fault, SensorsSpec
from bench.core.records.specs import Profile
from bench.evaluation.causes.candidates import list_candidates
from bench.evaluation.causes.search import Causes, find_causes
from bench.evaluation.consistency.block_nees import BlockNees, find_broken_block, judge_blocks
from bench.evaluation.errors.error_series import error_series
from bench.io import config
from bench.navigation import built_in, estimator
from bench.simulation import sensors

USE, OPTIONS = "loose-15", {"covariance_hz": 10.0}
_OVERRIDES: Mapping[str, Any] = {
    "rate_hz": 100,
    "leg": [
        {"kind": "straight", "duration_s": 20.0},
        {"kind": "s-turns", "by_deg": 60.0, "bank_deg": 30.0, "count": 8},
    ],
    "evaluation.from_s": 30.0,
    "evaluation.output_hz": 5.0,
    "sensors.imu": "matched-mems",
    "sensors.gnss": "matched-white",
    "sensors.baro": "matched-walk",
}
_SLOW = 1.0 / 60.0  # decay of what wanders [1/s]
_PER_G = DEG / HOUR / STANDARD_GRAVITY  # deg/h/g in SI
_FIGURES: Mapping[str, tuple[str, Mapping[str, float]]] = {
    "gyro scale factor": ("gyro", {"scale_factor_sd": 2e-2}),
    "gyro misalignment": ("gyro", {"misalignment_sd": 2e-2}),
    "gyro g-sensitivity": ("gyro", {"g_sensitivity_sd": 1000.0 * _PER_G}),
    "accelerometer scale factor": ("accel", {"scale_factor_sd": 3e-2}),
    "accelerometer misalignment": ("accel", {"misalignment_sd": 3e-2}),
    "time-correlated GNSS position error": ("gnss", {"pos_h_markov_sd": 8.0, "pos_v_markov_sd": 8.0}),
    "time-correlated GNSS velocity error": ("gnss", {"vel_markov_sd": 1.0}),
    "GNSS position noise other than assumed": ("gnss", {"pos_h_white_sd": 12.0, "pos_v_white_sd": 20.0}),
    "barometer quantization": ("baro", {"quantization": 20.0}),
}
"""Source -> where it is, and its figures where it is large."""
_FAULTS: Mapping[str, tuple[Fault, Fault]] = {
    "fault 1 (spoofing)": (
        Fault("spoofing", "gnss", 60.0, 90.0, "", step=(0.0,) * 3, ramp=(0.0, 1.0, 0.0), coherent=False),
        Fault("spoofing", "gnss", 60.0, 90.0, "", step=(0.0,) * 3, ramp=(0.0, 0.01, 0.0), coherent=False),
    ),
    "fault 2 (gyro-step)": (
        Fault("gyro-step", "gyro", 100.0, 130.0, "", step=(0.0, 0.0, 2000.0 * DEG / HOUR), ramp=(0.0,) * 3),
        Fault("gyro-step", "gyro", 100.0, 130.0, "", step=(0.0, 0.0, 1.0 * DEG / HOUR), ramp=(0.0,) * 3),
    ),
    "fault 3 (noise-burst)": (
        Fault("noise-burst", "gnss", 40.0, 150.0, "", times=4.0),
        Fault("noise-burst", "gnss", 40.0, 150.0, "", times=0.05),
    ),
}
"""Source -> the fault where it is large, and where it is not."""
SOURCES = (*_FIGURES, *_FAULTS)
_SMALL = 0.002  # of a figure in every other run


@dataclass(frozen=True)
class Answer:
    """What a run named, and what it should have."""

    large: tuple[str, ...]  # sources
    run: int
    honest: bool
    named: frozenset[str]
    right: frozenset[str]  # of the large ones those that break a covariance by themselves
    causes: Causes | None

    @property
    def good(self) -> bool:
        """Whether every source that breaks a covariance is named, and none that is not large."""
        return self.right <= self.named <= frozenset(self.large)


@cache
def fly() -> tuple[Profile, Trajectory]:
    """Return the flight, two minutes of turns to both sides."""
    profile = config.read_profile("s-turns", _OVERRIDES, estimators=[USE])
    return profile, pipeline.fly(profile)


def plant(spec: SensorsSpec, large: Collection[str]) -> SensorsSpec:
    """Return sensors with all twelve sources, some of them large; what filters assume stays."""
    for name, (part, figures) in _FIGURES.items():
        whole = spec.imu if part in ("gyro", "accel") else spec
        own = getattr(whole, part)
        sizes = figures if name in large else {key: _SMALL * value for key, value in figures.items()}
        if name.endswith("assumed") and name not in large:
            sizes = {key: (1.0 + _SMALL) * getattr(own, key) for key in figures}
        changed = replace(own, **sizes)
        if part == "gnss":
            changed = replace(changed, pos_decay_time=_SLOW, vel_decay_time=_SLOW)
        spec = (
            replace(spec, imu=replace(spec.imu, **{part: changed}))
            if whole is not spec
            else replace(spec, **{part: changed})
        )
    return replace(spec, faults=tuple(pair[name not in large] for name, pair in _FAULTS.items()))


def ask(large: Collection[str], run: int) -> Answer:
    """Return what a run names in which some sources are large."""
    profile, truth = fly()
    one = built_in.load(USE, OPTIONS)

    def measure(spec: SensorsSpec) -> dict[str, BlockNees]:
        sensed = sensors.sense(truth, spec, profile.seed, run)
        solution = estimator.answer(one, USE, sensed.data, sensed.initial)
        return judge_blocks(error_series(truth, solution), solution, profile.evaluation.begin)

    spec = plant(profile.sensors, large)
    own = measure(spec)
    on_board = AssumedSpecs(imu=spec.imu, gnss=spec.gnss, baro=spec.baro)
    unmodeled = estimator.list_unmodeled(one, USE, on_board) or []
    candidates = list_candidates(spec, unmodeled)
    assert {candidate.words for candidate in candidates} == set(SOURCES)
    causes = find_causes(spec, candidates, own, measure)
    right = {name for name in large if find_broken_block(measure(plant(profile.sensors, [name])))}
    named = frozenset(one.words for one in causes.named) if causes else frozenset()
    return Answer(tuple(large), run, causes is None, named, frozenset(right), causes)


def ask_many(count: int, seed: int = 31) -> Iterator[Answer]:
    """Yield the answers of so many inconsistent runs, with one or two large sources each in turn."""
    rng, found, run = np.random.default_rng(seed), 0, 0
    while found < count:
        large = rng.choice(len(SOURCES), 1 + run % 2, replace=False)
        answer = ask([SOURCES[k] for k in large], run)
        run += 1
        if answer.right or not answer.honest:
            found += 1
            yield answer


def main() -> None:
    """Print wrong answers and shares."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--runs", type=int, default=240)
    parser.add_argument("--honest", type=int, default=0)
    given = parser.parse_args()
    answers = list[Answer]()
    for answer in ask_many(given.runs):
        answers.append(answer)
        if not answer.good:
            print(
                answer.run, answer.large, "right", set(answer.right), "named", set(answer.named), flush=True
            )
            for step in answer.causes.steps if answer.causes else ():
                print("   ", [one.words for one in step.named], step.block, step.before.mean, step.after.mean)
    for count in (1, 2):
        own = [answer for answer in answers if len(answer.large) == count]
        print(f"{count} large: {sum(answer.good for answer in own)} of {len(own)} right")
    words = [ask((), 100_000 + run).named for run in range(given.honest)]
    if words:
        print(f"none large: {sum(map(bool, words))} of {len(words)} named anything")


if __name__ == "__main__":
    main()
