"""Accuracy limits of profiles: what each metric was when it was last accepted, and whether it still is.

A baseline is ``<profile>.json`` in a folder of them: by estimator and metric the mean
over some runs (the sensor draws 0, 1, ... of the profile's seed on one truth), its
standard error, the tolerance, the direction and the reason of the tolerance. A check
flies the same truth and the same draws, so that a difference is a change of the code,
however small beside the spread of the draws. The mean of an RMSE over runs is a number
to compare with, not a pooled RMSE.
"""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import Field

from bench import pipeline, store
from bench.config import load_profile
from bench.config.tables import NOT_NEGATIVE, Table, check_table, collect_errors
from bench.data import RunResult
from bench.errors import ConfigError
from bench.evaluation.metrics import find_metric
from bench.specs import Profile
from bench.wording import suggest

DIRECTORY = Path("tests/baselines")
"""Where ``bench check`` looks for baselines when not told."""

RUNS = 10
"""Sensor draws of a new baseline."""

PROBABILITY = 0.999
"""A mean of fewer draws lies within its allowance of the mean of all with this probability."""

RELATIVE_TOLERANCE = 0.02
"""Tolerance of the same draws, as a fraction of the mean [1]: other processors and library versions."""

CONVERGED = "converged"
"""Name of the fraction of runs that converged, which stands in every baseline."""

_PATH = ".toml"

Direction = Literal["lower", "higher", "both"]
Progress = Callable[[str, int, int], None]
"""Called with the profile's name, the runs done and the runs wanted."""


class Limit(Table):
    """One metric of one estimator."""

    mean: float
    standard_error: Annotated[float, NOT_NEGATIVE]
    n: Annotated[int, Field(ge=1)]  # runs that have the metric
    tolerance: Annotated[float, NOT_NEGATIVE]
    direction: Direction  # "lower": a smaller mean is better; "both": any change is worse
    reason: str  # where the tolerance comes from


class _File(Table):
    profile: str  # name of a shipped profile, or path of a .toml from the folder of the baseline
    seed: int
    runs: Annotated[int, Field(ge=2)]
    versions: dict[str, str]
    estimators: dict[str, dict[str, dict[str, Any]]]


@dataclass(frozen=True, slots=True)
class Statistic:
    """A metric over some runs."""

    mean: float
    standard_error: float
    n: int


@dataclass(frozen=True, slots=True)
class Verdict:
    """One metric compared with its baseline."""

    profile: str
    estimator: str
    metric: str
    expected: float
    measured: float | None  # None when no run has the metric any more
    tolerance: float
    direction: Direction
    regressed: bool
    improved: bool


Measured = Mapping[str, Mapping[str, Statistic]]


def measure(results: Sequence[RunResult]) -> dict[str, dict[str, Statistic]]:
    """Return the statistics of every metric that baselines hold, by estimator.

    The metrics are those with a direction in :data:`bench.evaluation.metrics.METRICS`,
    after the alignment window, over the runs in which they are numbers; and the
    fraction of runs that converged.
    """
    measured: dict[str, dict[str, Statistic]] = {}
    for label in results[0].metrics:
        runs = [result.metrics[label] for result in results]
        names = dict.fromkeys(name for run in runs for name in run)
        columns = {
            name: [float(run[name]) for run in runs if run.get(name) is not None]
            for name in names
            if _find_direction(name)
        }
        measured[label] = {name: _make_statistic(values) for name, values in columns.items() if values}
    return measured


def _find_direction(name: str) -> Direction | None:
    """Return which way a metric gets worse, or None for one that baselines do not hold."""
    if name == CONVERGED:
        return "higher"
    row = None if name.endswith("_all") else find_metric(name)
    return (row.direction or None) if row else None


def _make_statistic(values: Sequence[float]) -> Statistic:
    spread = float(np.std(values, ddof=1)) if len(values) > 1 else 0.0
    return Statistic(float(np.mean(values)), spread / len(values) ** 0.5, len(values))


def record(
    profile: Profile, runs: int = RUNS, *, source: str | None = None, progress: Progress | None = None
) -> dict[str, Any]:
    """Fly a profile, navigate some sensor draws and return its baseline, ready for :func:`write`.

    Parameters
    ----------
    profile : Profile
        What to fly.
    runs : int
        Sensor draws, at least 2.
    source : str
        What :func:`bench.config.load_profile` finds the profile by; default its name.
    progress : callable
        Told how far the runs are.

    Raises
    ------
    ConfigError
        When there are fewer than two runs.
    """
    if runs < 2:
        raise ConfigError(f"runs = {runs} must be at least 2: the standard error comes from the spread")
    results = _fly_runs(profile, runs, progress)
    return {
        "profile": source or profile.name,
        "seed": profile.seed,
        "runs": runs,
        "versions": dict(results[0].provenance["versions"]),
        "estimators": {
            label: {name: _make_limit(name, found) for name, found in metrics.items()}
            for label, metrics in measure(results).items()
        },
    }


def _make_limit(name: str, found: Statistic) -> dict[str, Any]:
    """Return the limit of a metric over the same draws."""
    row = find_metric(name)
    if row is None:  # the fraction of runs that converged
        tolerance, reason = 0.0, "a run that diverges is worse"
    elif row.unit == "1" and abs(found.mean) < 1.0:
        tolerance, reason = RELATIVE_TOLERANCE, f"{RELATIVE_TOLERANCE:g}: same draws, another processor"
    else:
        tolerance = RELATIVE_TOLERANCE * abs(found.mean)
        reason = f"{RELATIVE_TOLERANCE:.0%} of the mean: same draws, another processor"
    return {**asdict(found), "tolerance": tolerance, "direction": _find_direction(name), "reason": reason}


def _allow_for_fewer_draws(limit: Mapping[str, Any], m: int) -> float:
    """Return how far the mean of m of the n draws may lie from the mean of all, by their spread.

    Student's t with n - 1 degrees of freedom times the standard error of a mean of m of n.
    """
    from scipy.special import stdtrit

    n = limit["n"]
    if m == n:
        return 0.0
    quantile = float(stdtrit(max(n - 1, 1), 0.5 + 0.5 * PROBABILITY))
    return float(quantile * limit["standard_error"] * abs(n / m - 1.0) ** 0.5)


def _fly_runs(profile: Profile, runs: int, progress: Progress | None) -> list[RunResult]:
    truth = pipeline.fly(profile)
    results = []
    for k in range(runs):
        if progress:
            progress(profile.name, k, runs)
        results.append(replace(pipeline.run(profile, run=k, truth=truth), records={}))  # metrics alone
    if progress:
        progress(profile.name, runs, runs)
    return results


def write(directory: Path, baseline: Mapping[str, Any]) -> Path:
    """Write a baseline into a folder, atomically, and return its file; it names its profile from there."""
    source = str(baseline["profile"])
    path = directory / f"{Path(source).stem}.json"
    directory.mkdir(parents=True, exist_ok=True)
    if source.endswith(_PATH):
        source = os.path.relpath(source, directory)
    store.write_json(path, {**baseline, "profile": source})
    return path


def read(path: Path) -> dict[str, Any]:
    """Return a baseline, its profile as :func:`bench.config.load_profile` finds it.

    Raises
    ------
    ConfigError
        One message per thing that is wrong with the file.
    """
    try:
        document = json.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        raise ConfigError(f"{path}: no such file") from None
    except OSError as error:
        raise ConfigError(f"{path}: {error.strerror or error}") from None
    except ValueError as error:
        raise ConfigError(f"{path}: not valid JSON: {error}") from None
    if not isinstance(document, dict):
        raise ConfigError(f"{path}: must hold one JSON object")
    baseline = check_table(_File, document, str(path)).model_dump()
    wrong: list[str] = []
    for label, metrics in baseline["estimators"].items():
        for name, limit in metrics.items():
            with collect_errors(wrong):
                check_table(Limit, limit, f"{path}: [estimators.{label}.{name}]")
    if not any(baseline["estimators"].values()):
        wrong.append(f"{path}: [estimators] holds no limit; 'bench check --record' writes some")
    if wrong:
        raise ConfigError(*wrong)
    if baseline["profile"].endswith(_PATH):
        baseline["profile"] = os.path.normpath(path.parent / baseline["profile"])
    return baseline


def compare(baseline: Mapping[str, Any], measured: Measured) -> list[Verdict]:
    """Return a verdict for every metric of a baseline.

    A metric is worse when its mean lies beyond the tolerance on the wrong side: above for
    direction "lower", below for "higher", on either for "both", which knows no improvement;
    also when no run has it any more. Over fewer or more draws than the baseline has, the tolerance is
    wider by what the spread of the draws explains.
    """
    verdicts = []
    for label, limits in baseline["estimators"].items():
        for name, limit in limits.items():
            found = measured.get(label, {}).get(name)
            expected, tolerance, direction = limit["mean"], limit["tolerance"], limit["direction"]
            above = below = False
            if found is not None:
                tolerance += _allow_for_fewer_draws(limit, found.n)
                above = found.mean > expected + tolerance
                below = found.mean < expected - tolerance
            worse = {"lower": above, "higher": below, "both": above or below}[direction]
            better = {"lower": below, "higher": above, "both": False}[direction]
            verdicts.append(
                Verdict(
                    profile=Path(baseline["profile"]).stem,
                    estimator=label,
                    metric=name,
                    expected=expected,
                    measured=None if found is None else found.mean,
                    tolerance=tolerance,
                    direction=direction,
                    regressed=worse or found is None,
                    improved=better,
                )
            )
    return verdicts


def check(
    directory: Path = DIRECTORY,
    names: Sequence[str] | None = None,
    runs: int | None = None,
    progress: Progress | None = None,
) -> list[Verdict]:
    """Fly the profiles that have a baseline and compare.

    Parameters
    ----------
    directory : Path
        Folder of the baselines.
    names : sequence of str
        Profiles, by the name of their file; all of the folder when None.
    runs : int
        Sensor draws; as many as the baseline has when None.
    progress : callable
        Told how far the runs of each profile are.

    Raises
    ------
    ConfigError
        When a baseline is missing or malformed, or its profile is; before anything flies.
    """
    if runs is not None and runs < 1:
        raise ConfigError(f"runs = {runs} must be at least 1")
    known = sorted(path.stem for path in directory.glob("*.json"))
    if not known:
        raise ConfigError(f"{directory}: no baseline (*.json) there; 'bench check --record' makes one")
    unknown = [name for name in names or () if name not in known]
    if unknown:
        raise ConfigError(
            *(f"{directory}: no baseline {name!r}{suggest(name, known, 'baselines')}" for name in unknown)
        )
    baselines = [read(directory / f"{name}.json") for name in names or known]
    profiles = [load_profile(baseline["profile"]) for baseline in baselines]
    moved = [
        f"{directory / profile.name}.json: seed = {baseline['seed']} is not the profile's, {profile.seed}"
        for baseline, profile in zip(baselines, profiles, strict=True)
        if baseline["seed"] != profile.seed
    ]
    if moved:
        raise ConfigError(*moved)
    verdicts = []
    for baseline, profile in zip(baselines, profiles, strict=True):
        results = _fly_runs(profile, runs or baseline["runs"], progress)
        verdicts += compare(baseline, measure(results))
    return verdicts
