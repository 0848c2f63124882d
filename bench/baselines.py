"""Accuracy limits of profiles: the last accepted value of each metric, and whether it still holds.

A baseline is a file ``<profile>.json``. For each estimator and metric it holds the mean over some runs (noise
draws 0, 1, ... of the profile's seed on one truth), its standard error, the tolerance, the direction and the
reason for the tolerance. A check repeats the same truth and the same draws, so any difference comes from the
code, even if it is small compared with the spread of the draws. The mean of an RMSE over runs is a number to
compare with, not a pooled RMSE.
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
from bench.errors import ConfigError
from bench.evaluation.metrics import find_metric
from bench.run_result import RunResult
from bench.specs import Profile
from bench.wording import suggest

DIRECTORY = Path("tests/baselines")
"""Default folder of the baselines of ``bench check``."""

RUNS = 10
"""Number of noise draws of a new baseline."""

PROBABILITY = 0.999
"""Probability that the mean of fewer draws lies within its allowance of the mean of all."""

RELATIVE_TOLERANCE = 0.02
"""Tolerance for the same draws on other processors and library versions, as a fraction of the mean [1]."""

CONVERGED = "converged"
"""Name of the fraction of runs that converged; every baseline holds it."""

_PATH = ".toml"

Direction = Literal["lower", "higher", "both"]
Progress = Callable[[str, int, int], None]
"""Called with the name of the profile, the number of finished runs and the number of all runs."""


class Limit(Table):
    """One metric of one estimator."""

    mean: float
    standard_error: Annotated[float, NOT_NEGATIVE]
    n: Annotated[int, Field(ge=1)]  # number of runs that have the metric
    tolerance: Annotated[float, NOT_NEGATIVE]
    direction: Direction  # "lower": smaller is better; "both": any change is worse
    reason: str  # for the tolerance


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
    measured: float | None  # None if no run has the metric any more
    tolerance: float
    direction: Direction
    regressed: bool
    improved: bool


Measured = Mapping[str, Mapping[str, Statistic]]


def measure(results: Sequence[RunResult]) -> dict[str, dict[str, Statistic]]:
    """Return the statistics of every metric that baselines hold, by estimator.

    These are the metrics with a direction in :data:`bench.evaluation.metrics.METRICS`, after the alignment
    window, over the runs that have them, and the fraction of runs that converged.
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
    """Return the direction in which a metric is better, or None if baselines do not hold it."""
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
    """Fly a profile, run its estimators on some noise draws, and return its baseline for :func:`write`.

    Parameters
    ----------
    profile : Profile
        What to fly.
    runs : int
        Number of noise draws, at least 2.
    source : str
        Name or path with which :func:`bench.config.load_profile` finds the profile; default its name.
    progress : callable
        Called before each run and after the last one, as `Progress` says.

    Raises
    ------
    ConfigError
        If there are fewer than two runs.
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
    """Return the limit of a metric for a check with the same draws."""
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
    """Return how far the mean of m of the n draws may lie from the mean of all n.

    It is Student's t with n - 1 degrees of freedom times the standard error of the mean of m of n draws.
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
        results.append(
            replace(pipeline.run(profile, run=k, truth=truth), records={})
        )  # keep only the metrics
    if progress:
        progress(profile.name, runs, runs)
    return results


def write(directory: Path, baseline: Mapping[str, Any]) -> Path:
    """Write a baseline into a folder, atomically, and return its path.

    The path of its profile is stored relative to the folder.
    """
    source = str(baseline["profile"])
    path = directory / f"{Path(source).stem}.json"
    directory.mkdir(parents=True, exist_ok=True)
    if source.endswith(_PATH):
        source = os.path.relpath(source, directory)
    store.write_json(path, {**baseline, "profile": source})
    return path


def read(path: Path) -> dict[str, Any]:
    """Read a baseline; its profile is a name or path for :func:`bench.config.load_profile`.

    Raises
    ------
    ConfigError
        One message for each problem in the file.
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
    problems: list[str] = []
    for label, metrics in baseline["estimators"].items():
        for name, limit in metrics.items():
            with collect_errors(problems):
                check_table(Limit, limit, f"{path}: [estimators.{label}.{name}]")
    if not any(baseline["estimators"].values()):
        problems.append(f"{path}: [estimators] holds no limit; 'bench check --record' writes some")
    if problems:
        raise ConfigError(*problems)
    if baseline["profile"].endswith(_PATH):
        baseline["profile"] = os.path.normpath(path.parent / baseline["profile"])
    return baseline


def compare(baseline: Mapping[str, Any], measured: Measured) -> list[Verdict]:
    """Return a verdict for every metric of a baseline.

    A metric is worse if its mean is out of tolerance on the wrong side: above for direction "lower", below
    for "higher", either for "both", which has no better side. It is also worse if no run has it any more.
    If the number of draws differs from that of the baseline, the tolerance is wider by what their spread
    explains.
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
    """Fly the profiles that have a baseline and compare their metrics with it.

    Parameters
    ----------
    directory : Path
        Folder of the baselines.
    names : sequence of str
        Names of the baselines, without ``.json``; None checks all in the folder.
    runs : int
        Number of noise draws; None takes as many as the baseline has.
    progress : callable
        Called before each run and after the last one of each profile.

    Raises
    ------
    ConfigError
        If a baseline or its profile is missing or malformed. This is checked before anything is flown.
    """
    if runs is not None and runs < 1:
        raise ConfigError(f"runs = {runs} must be at least 1")
    known = sorted(path.stem for path in directory.glob("*.json"))
    if not known:
        raise ConfigError(f"{directory}: no baseline (*.json) in it; 'bench check --record' makes one")
    unknown = [name for name in names or () if name not in known]
    if unknown:
        raise ConfigError(
            *(f"{directory}: no baseline {name!r}{suggest(name, known, 'baselines')}" for name in unknown)
        )
    baselines = [read(directory / f"{name}.json") for name in names or known]
    profiles = [load_profile(baseline["profile"]) for baseline in baselines]
    changed = [
        f"{directory / profile.name}.json: seed = {baseline['seed']} differs from the profile's "
        f"seed = {profile.seed}"
        for baseline, profile in zip(baselines, profiles, strict=True)
        if baseline["seed"] != profile.seed
    ]
    if changed:
        raise ConfigError(*changed)
    verdicts = []
    for baseline, profile in zip(baselines, profiles, strict=True):
        results = _fly_runs(profile, runs or baseline["runs"], progress)
        verdicts += compare(baseline, measure(results))
    return verdicts
