"""Find factors on the noises that a filter assumes, so that its covariance describes its errors."""

from __future__ import annotations

import itertools
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from bench.core.files import durable
from bench.core.mathematics.arrays import FloatArray
from bench.core.records.specs import DEFAULT_GUARD, Guard
from bench.core.words.exceptions import ConfigError
from bench.core.words.stages import Progress, Stage
from bench.core.words.wording import format_number, suggest
from bench.evaluation.ensembles.ensemble import qualify
from bench.experiments.campaigns.pools import ProcessPool, count_processors
from bench.experiments.tuning.factor_search import REACH, FoundFactor, search_factors
from bench.experiments.tuning.trials import Goal, HeldOutScore, LogTrial, ProfileTrial, Trial
from bench.io.config.library import find_datasheet
from bench.io.config.toml_file import read_toml

DEFAULT_FACTORS = (
    "imu.gyro.noise",
    "imu.accel.noise",
    "gnss.gnss.pos_h_white,gnss.gnss.pos_v_white",
    "gnss.gnss.vel_white,gnss.gnss.vel_v_white",
)
"""Beginnings of the figures that share a factor, if none are asked for: kind, table and key."""

_AT_BOUND = 0.98  # of the logarithm of the bound
_REPEATS = 0.1  # correlation of neighboring innovations that matters [1]


@dataclass(frozen=True)
class Tuning:
    """Factors on the assumed noise, with the results before and after."""

    label: str
    goal: Goal
    factors: Mapping[str, float]  # beginning of the figures -> factor
    intervals: Mapping[str, tuple[float | None, float | None]]
    """Of each factor, with 95 %; None where the data tell no end, or where the search did not converge."""
    converged: bool
    starts: int  # of the search
    agreed: int  # starts that came to the same cost
    before: HeldOutScore
    after: HeldOutScore
    evaluations: int
    datasheets: Mapping[str, str]  # kind of sensor -> text of the tuned datasheet

    @property
    def sentences(self) -> tuple[str, ...]:
        """Return the results in sentences."""
        found = [self._describe_search()]
        found += [
            _describe_factor(name, factor, *self.intervals[name], told=self.converged)
            for name, factor in self.factors.items()
        ]
        for name, title in (("nees_ratio", "NEES over its expectation"), ("rmse_h_m", "horizontal RMSE [m]")):
            old, new = (getattr(one, name) for one in (self.before, self.after))
            found.append(
                f"{title}, on data not used for tuning: {format_number(old.value, 3)} ({old.interval}) "
                f"before, {format_number(new.value, 3)} ({new.interval}) after{qualify(self.after.runs)}"
            )
        if self.before.lost or self.after.lost:
            found.append(
                f"runs that did not converge, which are in neither figure: {self.before.lost} before, "
                f"{self.after.lost} after"
            )
        found += [
            f"innovations of {sensor} still repeat from one update to the next: correlation {value:.2f}, "
            f"within {band:.2f} is right; {self.label} lacks a state there, and white noise only hides it"
            for sensor, (value, band) in self.after.repetition.items()
            if abs(value) > max(band, _REPEATS)
        ]
        return tuple(found)

    def _describe_search(self) -> str:
        if not self.converged:
            return (
                f"NOT converged after {self.evaluations} sets of factors: these are the best of them, "
                "without intervals; --evaluations allows more"
            )
        best = ", the best of them is given" if self.agreed < self.starts else ""
        return (
            f"converged after {self.evaluations} sets of factors; {self.agreed} of {self.starts} starts came "
            f"to the same cost{best}"
        )

    def write(self, folder: str | Path) -> list[Path]:
        """Write the tuned datasheets, ``<kind>-tuned.toml``, and return the files.

        ``[sensors.assumed]`` of a profile or a log names them.
        """
        Path(folder).mkdir(parents=True, exist_ok=True)
        paths = [Path(folder) / f"{kind}-tuned.toml" for kind in self.datasheets]
        for path, text in zip(paths, self.datasheets.values(), strict=True):
            durable.write(path, text)
        return paths


@dataclass(frozen=True, slots=True)
class TuningStage(Stage):
    """Progress of a tuning: ``done`` sets of factors were tried, ``total`` at most.

    Attributes
    ----------
    cost : float
        Mean cost of the last set.
    """

    cost: float = np.nan

    def __str__(self) -> str:
        return f"set {self.done:.0f}, cost {self.cost:.4g}; at most {self.total:.0f} until it converges"


def tune(
    source: str | Path,
    estimator: str,
    *,
    log: bool = False,
    goal: Goal = "consistency",
    factors: Sequence[str] | None = None,
    runs: int = 20,
    evaluations: int = 400,
    seed: int | None = None,
    overrides: Mapping[str, Any] | None = None,
    allow_code: bool = False,
    guard: Guard = DEFAULT_GUARD,
    jobs: int | None = None,
    progress: Progress | None = None,
) -> Tuning:
    """Find factors on the noises that a filter assumes, and evaluate them on other data.

    The search runs on the logarithms of the factors, from several starts (`tuning.factor_search`).

    Parameters
    ----------
    source : str or Path
        Profile, or the ``.toml`` file of a log.
    estimator : str
        Filter to tune.
    log : bool, optional
        Whether ``source`` is a log: fixes withheld in the first half tune, the others evaluate.
    goal : {"consistency", "rmse"}, optional
        "consistency": smallest log score (`consistency.log_score`) of the errors, or of the innovations of a
        log; "rmse": smallest horizontal RMSE.
    factors : sequence of str, optional
        Groups of parameters that share a factor, by the beginning of their names: "imu.gyro.noise"; several
        with commas between them. Default: the `DEFAULT_FACTORS` that the assumed datasheets have.
    runs : int, optional
        Runs of a profile that tune; as many others evaluate. Default: 20.
    evaluations : int, optional
        Largest number of sets of factors before the search ends without convergence. Default: 400.
    seed : int, optional
        Seed of a profile.
    overrides, allow_code, guard
        See `bench.read_profile`.
    jobs : int, optional
        Number of processes for a profile. Default: the number of processors.
    progress : callable, optional
        Called with a `TuningStage` after each set.

    Returns
    -------
    Tuning
        ``factors`` with ``intervals``, ``converged``, ``before`` and ``after``; ``write(folder)`` writes the
        tuned datasheets.

    Raises
    ------
    bench.ConfigError, bench.EstimatorError, bench.FlightError
        If the source, the filter or a factor is wrong, or a run cannot be evaluated.

    Examples
    --------
    >>> import bench
    >>> tuning = bench.tune("approach", "loose-15", factors=["imu.gyro.noise"])  # doctest: +SKIP
    >>> tuning.factors, tuning.converged  # doctest: +SKIP
    """
    with ProcessPool(jobs or count_processors()) as pool:
        trial: Trial
        if log:
            trial = LogTrial(str(source), estimator, overrides or {}, allow_code=allow_code, guard=guard)
        else:
            options = {"seed": seed, "overrides": overrides, "allow_code": allow_code, "guard": guard}
            trial = ProfileTrial(str(source), estimator, runs, pool, options)
        known = read_figures(trial)
        groups = group_figures(known, factors)
        sets, unit = itertools.count(1), 1.0

        def find_costs(x: FloatArray) -> FloatArray:
            costs = trial.score(_name_keys(scale(groups, known, np.exp(x))), goal) / unit
            number = next(sets)
            if progress:
                progress(TuningStage("tuning", number, evaluations, "sets", cost=float(costs.mean())))
            return costs

        if goal == "rmse":  # relative to the datasheets: the search knows costs of the size of 1
            unit = float(find_costs(np.zeros(len(groups))).mean()) or 1.0
        found = search_factors(find_costs, len(groups), evaluations)
        best = np.exp(found.x)
        figures = scale(groups, known, best)
        before, after = trial.judge({}), trial.judge(_name_keys(figures))
    return Tuning(
        label=trial.label,
        goal=goal,
        factors=dict(zip(groups, best.tolist(), strict=True)),
        intervals={name: _name_ends(found, k) for k, name in enumerate(groups)},
        converged=found.converged,
        starts=found.starts,
        agreed=found.agreed,
        before=before,
        after=after,
        evaluations=next(sets) - 1,
        datasheets=write_datasheets(trial, figures),
    )


def _name_ends(found: FoundFactor, k: int) -> tuple[float | None, float | None]:
    """Return the interval of a factor; None for an open end."""
    low, high = (float(np.exp(ends[k])) if np.isfinite(ends[k]) else None for ends in (found.low, found.high))
    return low, high


def _describe_factor(name: str, factor: float, low: float | None, high: float | None, *, told: bool) -> str:
    text = f"{name}: {factor:.3g} times the datasheet"
    if abs(np.log(factor)) >= _AT_BOUND * REACH:
        text += ": the bound, so the right one was not found; ask whether this noise is in the error at all"
    elif not told:
        return text
    elif low is not None and high is not None:
        text += f" ({low:.3g} to {high:.3g})"
    else:
        ends = [f"at least {low:.3g} times"] if low is not None else []
        ends += [f"at most {high:.3g} times"] if high is not None else []
        text += f", but these data do not bound it: {ends[0] if ends else 'any factor does'}"
    return text


def read_figures(trial: Trial) -> dict[str, float]:
    """Return the figures of the assumed datasheets that are above zero, by kind, table and key."""
    found: dict[str, float] = {}
    for kind, name in trial.assumed.items():
        for table, rows in read_toml(*find_datasheet(kind, name, trial.beside)).items():
            if isinstance(rows, Mapping):
                numbers = {key: value for key, value in rows.items() if isinstance(value, int | float)}
                found |= {f"{kind}.{table}.{key}": float(x) for key, x in numbers.items() if x > 0}
    return found


def group_figures(known: Mapping[str, float], asked: Sequence[str] | None) -> dict[str, list[str]]:
    """Return the figures that share each factor."""
    groups = {
        starts: [key for key in known if key.startswith(tuple(starts.split(",")))]
        for starts in asked or DEFAULT_FACTORS
    }
    empty = [start for start, keys in groups.items() if not keys]
    if asked and empty:
        raise ConfigError(f"no assumed figure begins with {empty[0]!r}{suggest(empty[0], known, 'figures')}")
    found = {start: keys for start, keys in groups.items() if keys}
    if not found:
        raise ConfigError(
            f"the assumed datasheets have no noise parameter to tune{suggest('', known, 'figures')}"
        )
    return found


def scale(
    groups: Mapping[str, Sequence[str]], known: Mapping[str, float], factors: FloatArray
) -> dict[str, float]:
    """Return the figures times their factors."""
    pairs = zip(groups.values(), factors.tolist(), strict=True)
    return {key: known[key] * factor for keys, factor in pairs for key in keys}


def _name_keys(figures: Mapping[str, float]) -> dict[str, float]:
    """Return values by their keys of --set, as assumed datasheet values."""
    return {f"sensors.assumed.{key}": value for key, value in figures.items()}


def write_datasheets(trial: Trial, figures: Mapping[str, float]) -> dict[str, str]:
    """Return the texts of the datasheets with the tuned values; everything else is unchanged."""
    texts = {}
    for kind in dict.fromkeys(key.partition(".")[0] for key in figures):
        path, _ = find_datasheet(kind, trial.assumed[kind], trial.beside)
        table, lines = "", [f"# {trial.assumed[kind]}, its noise tuned for {trial.label} by bench tune."]
        for line in path.read_text(encoding="utf-8").splitlines():
            if header := re.fullmatch(r"\[(\w+)\]\s*", line):
                table = header[1]
            key, equals, _ = line.partition("=")
            value = figures.get(f"{kind}.{table}.{key.strip()}") if equals else None
            lines.append(line if value is None else f"{key.rstrip()} = {value:.6g}")
        texts[kind] = "\n".join(lines) + "\n"
    return texts
