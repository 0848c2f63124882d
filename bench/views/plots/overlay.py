"""Several results in one: for the recording and the report of a comparison."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, TypeVar

import numpy as np

from bench.core.records.data import Trajectory
from bench.core.records.run_result import RunResult
from bench.core.words.exceptions import ConfigError

_T = TypeVar("_T")


def merge_results(results: Mapping[str, RunResult]) -> RunResult:
    """Return one result with the filters of several results, each with the name of its result.

    Parameters
    ----------
    results : mapping of str to RunResult
        Results of one flight or one log, by name. The sensors are those of the first.

    Raises
    ------
    bench.ConfigError
        If they are not of the same flight or log.
    """
    (name, first), *others = results.items()
    for other, result in others:
        if not _is_same_motion(first, result):
            raise ConfigError(f"{other}: not drawn over {name}, it is of another flight or log")
    more: dict[str, Any] = {"scene": first.more["scene"]} if "scene" in first.more else {}
    if "log" in first.more:
        more["log"] = first.more["log"]
    return RunResult(
        profile={**first.profile, "title": " and ".join(results)},
        seed=first.seed,
        run=first.run,
        metrics=_join({key: one.metrics for key, one in results.items()}),
        errors=_join({key: one.errors for key, one in results.items()}),
        solutions=_join({key: one.solutions for key, one in results.items()}),
        provenance={},
        more=more,
        records=first.records,
    )


def _join(by_result: Mapping[str, Mapping[str, _T]]) -> dict[str, _T]:
    """Return all records by "filter, result"."""
    return {f"{label}, {name}": one for name, found in by_result.items() for label, one in found.items()}


def _is_same_motion(one: RunResult, other: RunResult) -> bool:
    """Return whether two results are of the same flight, or of the same log."""
    if isinstance(one.truth, Trajectory) and isinstance(other.truth, Trajectory):
        return np.array_equal(one.truth.t, other.truth.t) and bool(
            (np.abs(one.truth.lla - other.truth.lla) < 1e-9).all()
        )
    if one.truth is not None or other.truth is not None or one.sensors is None or other.sensors is None:
        return False
    return np.array_equal(one.sensors.imu.t, other.sensors.imu.t)
