"""The file of a baseline, ``<profile>.json``: the value of every metric in every run."""

from __future__ import annotations

import json
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any

from pydantic import Field

from bench.core.files import durable
from bench.core.files.file_checks import read_json
from bench.core.words.exceptions import ConfigError
from bench.core.words.renames import FORMAT, check_format
from bench.io.config.tables import NOT_NEGATIVE, ROWS, Table, check_table

LEAST_DRAWS = 20
"""Fewest runs of a baseline."""

TOLERANCE = 0.02
"""Change that does not matter, as a fraction [1]; a baseline may say another."""

CPU = "cpu_ratio"
"""Metric of the CPU time of a filter over the time of the strapdown alone, if it was asked for [1]."""

UNKNOWN = ""
"""Digest of the sensor data of a run without a result."""

_PATH = ".toml"
_DIGITS = 10  # of a stored value

Value = float | None


class EstimatorValues(Table):
    """Metrics of one filter, by run."""

    epochs: Annotated[int, Field(ge=0)]  # evaluated in each run
    expected: dict[str, float]  # metric -> its value for a consistent filter
    converged: Annotated[tuple[bool, ...], ROWS]  # by draw
    metrics: dict[str, Annotated[tuple[Value, ...], ROWS]]  # metric -> by draw; null: the run has none
    reasons: Annotated[tuple[str, ...], Field(exclude=True)] = ()  # by draw, why it did not converge


class Baseline(Table):
    """The runs 0, 1, ... of a profile, or the segments of a log."""

    format: int = FORMAT
    profile: str  # shipped name, or path of a .toml; in the file relative to its folder
    requested: Annotated[tuple[str, ...], ROWS] | None  # filters asked for; null: the ones of the profile
    seed: int
    overrides: dict[str, Any] = Field(default_factory=dict)  # of the profile, as --set gives them
    tolerance: Annotated[float, NOT_NEGATIVE] = TOLERANCE
    versions: dict[str, str]
    truth: str  # digest
    sensors: Annotated[tuple[str, ...], ROWS]  # digest by draw
    estimators: dict[str, EstimatorValues]

    @property
    def draws(self) -> int:
        """Number of runs."""
        return len(self.sensors)


def get_name(source: str) -> str:
    """Return the name of a profile from its name or path.

    Examples
    --------
    >>> get_name("flights/short.toml")
    'short'
    """
    return Path(source).stem if source.endswith(_PATH) else source


def is_same_source(one: str, other: str) -> bool:
    """Return whether two names or paths mean the same profile."""
    paths = one.endswith(_PATH) and other.endswith(_PATH)
    return Path(one).resolve() == Path(other).resolve() if paths else one == other


def write_baseline(directory: Path, baseline: Baseline) -> Path:
    """Write a baseline into a folder, atomically, and return its path.

    Raises
    ------
    ConfigError
        If the folder has a baseline of another profile with this name.
    """
    path = directory / f"{get_name(baseline.profile)}.json"
    if path.is_file():
        there = read_baseline(path).profile
        if not is_same_source(there, baseline.profile):
            raise ConfigError(
                f"{path}: is the baseline of another profile, {there}; give one of them another name"
            )
    document = baseline.model_dump(mode="json")
    if not baseline.overrides:
        del document["overrides"]
    if baseline.profile.endswith(_PATH):
        document["profile"] = Path(os.path.relpath(baseline.profile, directory)).as_posix()
    directory.mkdir(parents=True, exist_ok=True)
    durable.write(path, _to_text(document) + "\n")
    return path


def _to_text(value: Any, indent: str = "") -> str:
    """Return JSON with each list on one line, so that a change of one metric is a change of one line."""
    if isinstance(value, Mapping):
        inner = indent + "  "
        rows = [f"{inner}{json.dumps(key)}: {_to_text(item, inner)}" for key, item in value.items()]
        return "{\n" + ",\n".join(rows) + f"\n{indent}}}" if rows else "{}"
    if isinstance(value, list):
        return f"[{', '.join(_to_text(item) for item in value)}]"
    return f"{value:.{_DIGITS}g}" if isinstance(value, float) else json.dumps(value)


def read_baseline(path: Path) -> Baseline:
    """Read a baseline; its profile is a name or path for :func:`bench.io.config.read_profile`.

    Raises
    ------
    ConfigError
        One message for each problem in the file.
    """
    document = read_json(path)
    check_format(document, str(path))
    baseline = check_table(Baseline, document, str(path))
    problems = [
        f"{path}: [estimators.{label}]: {name} must have {baseline.draws} values, one for each run; "
        f"got {len(values)}"
        for label, row in baseline.estimators.items()
        for name, values in {"converged": row.converged, **row.metrics}.items()
        if len(values) != baseline.draws
    ]
    if baseline.draws < 2 or not baseline.estimators:
        problems.append(f"{path}: holds no runs; 'bench check --record' writes some")
    if problems:
        raise ConfigError(*problems)
    if not baseline.profile.endswith(_PATH):
        return baseline
    source = os.path.normpath(path.parent / baseline.profile)
    return baseline.model_copy(update={"profile": source})
