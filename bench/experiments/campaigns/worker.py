"""Work of a campaign worker: execute one run and keep its results."""

from __future__ import annotations

import hashlib
from base64 import b64decode, b64encode
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import lru_cache
from math import ceil, isfinite
from typing import Any

import numpy as np

from bench import pipeline
from bench.core.files.spawned import Printed
from bench.core.mathematics.arrays import FloatArray
from bench.core.mathematics.units import SAME_INSTANT
from bench.core.records.data import NavSolution, Trajectory
from bench.core.records.run_records import ErrorSeries
from bench.core.records.run_result import RunResult
from bench.core.records.specs import Profile
from bench.core.words.exceptions import BenchError
from bench.core.words.wording import one_line
from bench.evaluation.consistency.chi_square import nis_by_sensor
from bench.evaluation.ensembles.ensemble import sum_repetition
from bench.evaluation.errors.error_series import heading_sd, select_epochs
from bench.experiments.campaigns.heap import keep_freed_memory
from bench.io import results
from bench.navigation.engine.kept_rows import columns

_PRINTED = 5_000  # of the begin and of the end of what a filter prints in a run [byte]

MOST_INSTANTS = 600
"""Epochs of a run whose errors are kept."""

FEW_INSTANTS = 50
"""Epochs of a run that are kept if a condition has very many runs; their values have two bytes."""

CHANNELS = {
    "pos_err_n_m": "m",
    "pos_err_e_m": "m",
    "pos_err_d_m": "m",
    "vel_err_n_mps": "m/s",
    "vel_err_e_mps": "m/s",
    "vel_err_d_mps": "m/s",
    "tilt_deg": "deg",
    "heading_err_deg": "deg",
    "pos_sd_h_m": "m",
    "pos_sd_d_m": "m",
    "heading_sd_deg": "deg",
    "nees": "1",
}
"""What is kept at each time, and its unit; ``sd`` is what the filter reports."""


@dataclass(frozen=True)
class RunTask:
    """One run for a worker."""

    key: str
    truth_key: str
    profile: Profile
    run: int
    step: float  # interval of the epochs that are kept [s]
    many: bool = False  # its condition has very many runs


def measure(task: RunTask) -> dict[str, Any]:
    """Run a task and return its row of the journal, and the ``printed`` output of filters.

    A run that raises has only an ``error``.
    """
    keep_freed_memory()
    row: dict[str, Any] = {"key": task.key}
    try:
        closed = task.profile.guidance is not None  # then each run flies its own
        truth = None if closed else get_truth(task.truth_key, task.profile)
        result = pipeline.run(task.profile, task.run, truth=truth)
        cpu_s = {name: result.provenance[name] for name in ("cpu_s", "estimator_cpu_s")}
        found = {label: _collect(result, label, task) for label in result.metrics}
        printed = {label: shorten(text) for label, text in result.records["printed"].items()}
    except Exception as error:
        return {**row, "error": describe_error(error)}
    return {**row, "step": task.step, **cpu_s, "estimators": found, "printed": printed}


def shorten(text: str) -> str:
    """Return the beginning and the end of the printed output of a filter in a run."""
    short = Printed(_PRINTED, _PRINTED)
    short.add(text.encode())
    return short.text


def describe_error(error: Exception) -> str:
    """Return the reason why a run has no result, in one line."""
    return one_line(str(error) if isinstance(error, BenchError) else repr(error))[:500]


def fly(profile: Profile) -> float:
    """Fly the truth of a profile into the cache and return its duration [s]."""
    return float(pipeline.fly(profile).t[-1])


def choose_step(duration: float, rate: float, *, many: bool = False) -> float:
    """Return the interval of at most `MOST_INSTANTS` epochs of a flight, a multiple of 1 / rate [s].

    The interval of at most `FEW_INSTANTS` for ``many`` runs is a multiple of it.
    """
    every = max(1, ceil(duration * rate / MOST_INSTANTS - SAME_INSTANT))
    if many:
        every *= max(1, ceil(duration * rate / every / FEW_INSTANTS - SAME_INSTANT))
    return every / rate


def encode(columns: FloatArray) -> str:
    """Return numbers in single precision as text."""
    return b64encode(np.ascontiguousarray(columns, "<f4").tobytes()).decode()


def decode(text: str) -> FloatArray:
    """Return the numbers (M, C) of :func:`encode`, a column for each of `CHANNELS`."""
    return np.frombuffer(b64decode(text), "<f4").reshape(-1, len(CHANNELS))


def shorten_numbers(columns: FloatArray) -> FloatArray:
    """Return numbers in single precision with 8 of 24 bits, right within 0.2 %; the other bits are zero.

    Examples
    --------
    >>> shorten_numbers(np.array([1.0, 1.001, -123.4, np.inf])).tolist()
    [1.0, 1.0, -123.5, inf]
    """
    with np.errstate(over="ignore"):
        single = np.ascontiguousarray(columns, np.float32)
    whole = (single.view(np.uint32) + np.uint32(0x8000)) & np.uint32(0xFFFF0000)
    return np.where(np.isfinite(single), whole.view(np.float32), single)


@dataclass(frozen=True)
class _Keyed:
    key: str
    profile: Profile = field(compare=False)


def get_truth(key: str, profile: Profile) -> Trajectory:
    """Return the truth of a profile by its key, mapped from the cache; the last truth stays open."""
    return _read_truth(_Keyed(key, profile))


@lru_cache(maxsize=1)
def _read_truth(flight: _Keyed) -> Trajectory:
    truth = results.read_truth(flight.key)
    return pipeline.fly(flight.profile) if truth is None else truth


def _collect(result: RunResult, label: str, task: RunTask) -> dict[str, Any]:
    """Return the stored results of a filter: its metrics, and its errors at some epochs."""
    errors, solution = result.errors[label], result.solutions[label]
    begun = task.profile.evaluation.first
    nis = nis_by_sensor(solution.innovations, begun)
    with np.errstate(all="ignore"):  # a filter that is lost may report any innovations
        repetition = sum_repetition(solution.innovations, begun)
    metrics = {name: value for name, value in result.metrics[label].items() if is_plain(value)}
    kept = _thin(errors, solution, task.step)
    return {
        "metrics": {**metrics, "answers": hash_answers(solution)},
        "states": errors.states,
        "nis_dof": {sensor: int(series.dof.sum()) for sensor, series in nis.items()},
        "repetition": {
            sensor: sums.tolist() for sensor, sums in repetition.items() if np.isfinite(sums).all()
        },
        "instants": encode(shorten_numbers(kept) if task.many else kept),
    }


def hash_answers(solution: NavSolution) -> str:
    """Return a hash of all that a solution answers, events included; all NaN are equal."""
    digest = hashlib.sha256(repr((solution.extra_names, solution.events.rows())).encode())
    for name, column in columns(solution).items():
        if isinstance(column, np.ndarray):
            digest.update(name.encode() + np.where(np.isnan(column), np.nan, column).tobytes())
    return digest.hexdigest()[:16]


def is_plain(value: object) -> bool:
    """Return whether JSON can contain a value unchanged."""
    return (
        isfinite(value) if isinstance(value, float) else value is None or isinstance(value, bool | int | str)
    )


def _thin(errors: ErrorSeries, solution: NavSolution, step: float) -> FloatArray:
    """Return the `CHANNELS` (M, C) at whole multiples of a step, from the first on; NaN where unknown."""
    number = np.round(errors.t / step).astype(np.int64)
    wanted = (number > 0) & (number <= MOST_INSTANTS)
    rows = np.flatnonzero((np.abs(errors.t - number * step) < SAME_INSTANT) & wanted)
    at = select_epochs(solution, rows)
    with np.errstate(invalid="ignore"):
        variance = np.einsum("kii->ki", at.cov)
        claimed = {
            "pos_sd_h_m": np.sqrt(variance[:, 0] + variance[:, 1]),
            "pos_sd_d_m": np.sqrt(variance[:, 2]),
            "heading_sd_deg": np.rad2deg(heading_sd(at)),
        }
    found: Mapping[str, FloatArray] = {
        **{f"pos_err_{axis}_m": errors.pos_n[rows, k] for k, axis in enumerate("ned")},
        **{f"vel_err_{axis}_mps": errors.vel_n[rows, k] for k, axis in enumerate("ned")},
        "tilt_deg": np.rad2deg(np.hypot(*errors.phi_n[rows, :2].T)),
        "heading_err_deg": np.rad2deg(errors.heading[rows]),
        **claimed,
        "nees": errors.nees[rows],
    }
    kept = np.full((int(number[rows].max(initial=0)), len(CHANNELS)), np.nan)
    with np.errstate(over="ignore"):  # beyond single precision: infinite
        kept[number[rows] - 1] = np.column_stack([found[name] for name in CHANNELS])
    return kept
