"""The public functions of Python: what ``bench run`` does.

``run`` is its four steps in a row; each can be called by itself, with any of its inputs exchanged:

    profile = bench.load_profile("figure-eight", seed=7)
    truth = bench.fly(profile)
    sensed = bench.sense(profile, truth)
    solution = bench.navigate("loose-15", sensed.data, sensed.initial)
    errors, metrics = bench.judge(profile, truth, solution)
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from bench import pipeline, store
from bench.config import load_profile
from bench.data import ErrorSeries, InitialState, NavSolution, RunResult, Sensed, SensorData, Trajectory
from bench.errors import ConfigError
from bench.specs import EstimatorChoice, Profile

load = store.load

__all__ = ["fly", "judge", "load", "load_profile", "navigate", "run", "sense"]


def run(
    profile: str | Path | Profile,
    *,
    seed: int | None = None,
    run: int = 0,
    estimators: Sequence[str] | None = None,
    sensors: Mapping[str, str] | None = None,
) -> RunResult:
    """Fly one profile, sense, navigate with every estimator, and judge.

    Parameters
    ----------
    profile : str, Path or Profile
        Shipped name, path of a TOML file, or a profile already read, which takes ``run`` alone.
    seed : int or None
        Seed of the noise and of the turbulence; the profile's own when None.
    run : int
        The noise draw of the seed.
    estimators : sequence of str or None
        Built-in names, ``module:Class``, ``file:solution.csv`` or ``command:./program {sensors} {solution}``.
        The profile's own when None, but no programs: `load_profile` with ``allow_commands`` lets it.
    sensors : mapping or None
        Units to exchange, for example ``{"imu": "icm-42688-p"}``.

    Returns
    -------
    result : RunResult
        Metrics, errors and solutions by estimator, and what it takes to repeat them.

    Raises
    ------
    bench.errors.ConfigError
        When the profile or an argument is wrong.
    bench.errors.EstimatorError
        When an estimator cannot be built.
    bench.errors.FlightError
        When the aircraft cannot be loaded, trimmed or flown.
    """
    if isinstance(profile, Profile):
        if (seed, estimators, sensors) != (None, None, None):
            raise ConfigError("bench.run: a profile already read takes no seed, estimators or sensors")
    else:
        overrides = {f"sensors.{kind}": name for kind, name in (sensors or {}).items()}
        profile = load_profile(str(profile), overrides, seed, estimators)
    if run != int(run) or run < 0:
        raise ConfigError(f"bench.run: run = {run} must be a whole number, at least 0")
    return pipeline.run(profile, int(run)).result


def fly(profile: str | Path | Profile) -> Trajectory:
    """Return the truth of a profile; it is flown once and cached."""
    return pipeline.fly(_read(profile))


def sense(profile: str | Path | Profile, truth: Trajectory, run: int = 0) -> Sensed:
    """Return what the sensors of a profile report on a truth, in one noise draw."""
    return pipeline.sense(_read(profile), truth, run)


def navigate(
    use: str, data: SensorData, initial: InitialState, options: Mapping[str, Any] | None = None
) -> NavSolution:
    """Return the solution of an estimator, a built-in name or ``module:Class``."""
    return pipeline.navigate(EstimatorChoice(use, use, dict(options or {})), data, initial)


def judge(
    profile: str | Path | Profile, truth: Trajectory, solution: NavSolution
) -> tuple[ErrorSeries, dict[str, Any]]:
    """Return the errors of a solution and its metrics."""
    return pipeline.judge(_read(profile), truth, solution)


def _read(profile: str | Path | Profile) -> Profile:
    return profile if isinstance(profile, Profile) else load_profile(str(profile))
