"""The verb warm: compile kernels before they are needed."""

from __future__ import annotations

import time
from dataclasses import replace
from pathlib import Path

from rich.console import Console

from bench import pipeline
from bench.core.compilation.compiled import choose_cache
from bench.core.records.flight_specs import FlightSpec
from bench.core.records.specs import EstimatorChoice, EvaluationWindow, Profile
from bench.core.words.exceptions import ConfigError
from bench.io import config
from bench.navigation.built_in import BUILT_IN
from bench.simulation.flight.legs.level import Straight

_EVERY_SENSOR = "all-sensors"
"""The shipped profile with the sensors that any built-in filter uses."""
_SECONDS = 10.0  # of flight: every sensor reports, every kernel runs


def warm(name: str | None, *, console: Console, estimators: tuple[str, ...] | None) -> None:
    """Compile the kernels of the built-in filters of a profile, or of all, into the cache.

    Sensors, filters and judge run over ten seconds of level flight. Filters of the user are not run.

    Parameters
    ----------
    name : str or None
        A profile; None: every sensor and every built-in filter that needs no other package.
    console : Console
        Where to print how many kernels were compiled, how long it took, and the folder.
    estimators : tuple of str or None
        Only these.

    Raises
    ------
    bench.ConfigError
        If there is no such profile, or it has no built-in estimator.
    """
    own = tuple(use for use, row in BUILT_IN.items() if row.package is None)
    chosen = estimators or (own if name is None else None)
    profile = config.read_profile(name or _EVERY_SENSOR, estimators=chosen, allow_code=True)
    built_in = tuple(choice for choice in profile.estimators if choice.use in BUILT_IN)
    if not built_in:
        raise ConfigError(f"{profile.name}: no built-in filter to compile; there are {', '.join(BUILT_IN)}")
    folder, begun = choose_cache(), time.perf_counter()
    before = _count_kernels(folder)
    run_shortly(profile, built_in)
    compiled, spent = _count_kernels(folder) - before, time.perf_counter() - begun
    what = (
        f"Compiled {compiled} kernels in {spent:.1f} s" if compiled else "All kernels were compiled already"
    )
    console.print(f"{what}: {folder}", soft_wrap=True)


def run_shortly(profile: Profile, choices: tuple[EstimatorChoice, ...]) -> None:
    """Run a short level flight: the sensors of a profile, the filters and the evaluation."""
    base = config.read_profile(_EVERY_SENSOR)
    assert isinstance(base.flight, FlightSpec)
    rate = max(base.flight.rate, getattr(profile.flight, "rate", 0.0))
    flight = replace(base.flight, legs=(Straight(_SECONDS),), duration=None, rate=rate)
    truth = pipeline.fly(replace(base, flight=flight), cache=False)
    sensors = replace(profile.sensors, gnss_outages=(), faults=(), alignment="given")
    short = replace(profile, sensors=sensors, evaluation=EvaluationWindow())
    sensed = pipeline.sense(short, truth)
    for choice in choices:
        solution = pipeline.navigate(choice, sensed.data, sensed.initial)
        pipeline.measure(short, truth, solution, sensed.truth)


def _count_kernels(folder: Path) -> int:
    return sum(1 for _ in folder.rglob("*.nbc"))
