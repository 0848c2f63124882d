"""Plan of a campaign: every run with its profile in full, its key, and the command that repeats it."""

from __future__ import annotations

import contextlib
import dataclasses
import hashlib
import json
import re
import shlex
import shutil
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from functools import cache, cached_property
from importlib.util import find_spec
from pathlib import Path
from typing import Any, overload

import numpy as np

from bench import pipeline
from bench.core.files.places import PACKAGE
from bench.core.mathematics.arrays import IntArray
from bench.core.records.flight_specs import FlightSpec
from bench.core.records.specs import DEFAULT_GUARD, EstimatorChoice, Guard, Profile
from bench.core.words.exceptions import ConfigError
from bench.core.words.wording import format_value
from bench.experiments.campaigns.campaign_file import (
    CampaignSpec,
    Values,
    is_campaign_file,
    read_campaign_file,
)
from bench.io import results
from bench.io.config import read_profile
from bench.io.results.truth_cache import hash_file

_BLOCK = 1 << 20  # [byte]
_MOST_NAMED = 200  # files that wrappers name


@dataclass(frozen=True)
class Condition:
    """A condition, for which statistics are computed: a profile with some values replaced."""

    source: str  # the profile, as it was named
    values: Values  # that distinguish it from the other conditions

    @property
    def name(self) -> str:
        """The profile and the varied values in one line."""
        return ", ".join([self.source, *(f"{key} = {_shorten(value)}" for key, value in self.values.items())])


@dataclass(frozen=True)
class Cell:
    """One flight of a condition with its sensors and filters; its runs differ only in noise."""

    condition: int  # its number in the plan
    profile: Profile
    command: tuple[str, ...]  # ``bench run ...`` without --run

    @cached_property
    def truth_key(self) -> str:
        """Hash of all inputs of the truth."""
        return pipeline.find_truth_key(self.profile)

    @cached_property
    def key(self) -> str:
        """Hash of all inputs of the results of a run, apart from its number."""
        profile = self.profile
        parts = {
            "truth": self.truth_key,
            "sensors": results.hash_spec(profile.sensors),
            "seed": profile.seed,
            "estimators": [_describe_estimator(choice) for choice in profile.estimators],
            "evaluation": asdict(profile.evaluation),
            "software": describe_software(),
        }
        return hashlib.sha256(json.dumps(parts, sort_keys=True, default=str).encode()).hexdigest()[:32]

    def repeat(self, run: int) -> str:
        """Return the command that repeats a run alone."""
        return shlex.join([*self.command, "--run", str(run)])


@dataclass(frozen=True)
class PlannedRun:
    """A run of a cell."""

    cell: int  # its number in the plan
    run: int  # number of the run


@dataclass(frozen=True)
class EveryRun(Sequence[PlannedRun]):
    """The same runs of every cell; a million of them need no memory."""

    cells: int
    runs: int  # of each cell, from 0 on

    def __len__(self) -> int:
        return self.cells * self.runs

    @overload
    def __getitem__(self, number: int) -> PlannedRun: ...

    @overload
    def __getitem__(self, number: slice) -> Sequence[PlannedRun]: ...

    def __getitem__(self, number: int | slice) -> PlannedRun | Sequence[PlannedRun]:
        found = range(len(self))[number]
        if isinstance(found, range):
            return [PlannedRun(*divmod(k, self.runs)) for k in found]
        return PlannedRun(*divmod(found, self.runs))


@dataclass(frozen=True)
class Plan:
    """The conditions of a campaign, their flights and their runs, in the order of the tables."""

    name: str
    conditions: tuple[Condition, ...]
    cells: tuple[Cell, ...]
    runs: Sequence[PlannedRun]  # the runs of a cell are neighbors

    def number_runs(self) -> dict[int, IntArray]:
        """Return the numbers of the runs of each cell."""
        if isinstance(self.runs, EveryRun):
            return {k: np.arange(self.runs.runs) for k in range(self.runs.cells)}
        found: dict[int, list[int]] = {}
        for one in self.runs:
            found.setdefault(one.cell, []).append(one.run)
        return {cell: np.array(runs, np.int64) for cell, runs in found.items()}

    def run_key(self, planned: PlannedRun) -> str:
        """Return the key of a run in the journal."""
        return f"{self.cells[planned.cell].key}-{planned.run}"


def plan_runs(
    source: str,
    runs: int | None = None,
    *,
    flights: int | None = None,
    seed: int | None = None,
    estimators: Sequence[str] | None = None,
    overrides: Values | None = None,
    allow_code: bool = False,
    guard: Guard = DEFAULT_GUARD,
) -> Plan:
    """Read a profile or a campaign file and plan its runs.

    Parameters
    ----------
    source : str
        Shipped name or path of a profile, or path of a campaign file.
    runs : int or None
        Runs of each flight, from 0 on; None takes those of the campaign file, or 200.
    flights : int or None
        Flights of each condition; that number j has the seed of the first one plus j, so its turbulence
        and noise are its own. None takes those of the campaign file, or 1.
    seed, filters, overrides, allow_code, guard
        As for `bench.io.config.read_profile`; they win over the campaign file.

    Raises
    ------
    ConfigError
        As for `config.read_profile`, and if a filter is a solution in a file, which belongs to one
        draw, or if several flights would be the same.
    """
    spec = (
        read_campaign_file(source, allow_code=allow_code)
        if is_campaign_file(source)
        else CampaignSpec(Path(source).stem, (source,))
    )
    spec = replace(
        spec,
        runs=spec.runs if runs is None else runs,
        flights=spec.flights if flights is None else flights,
        seed=spec.seed if seed is None else seed,
        estimators=tuple(estimators) if estimators else spec.estimators,
    )
    return plan_campaign(spec, overrides, allow_code, guard)


def plan_campaign(
    spec: CampaignSpec,
    overrides: Values | None = None,
    allow_code: bool = False,
    guard: Guard = DEFAULT_GUARD,
) -> Plan:
    """Plan the runs of a campaign; errors as for :func:`plan_runs`."""
    uses = spec.estimators
    conditions, cells = [], []
    for number, (name, values) in enumerate(spec.conditions()):
        conditions.append(Condition(name, values))
        given = {**spec.fixed, **values, **(overrides or {})}
        first = read_profile(name, given, spec.seed, uses, allow_code, guard)
        cells.append(_make_cell(number, name, first, uses, given, allow_code))
        given = {key: value for key, value in given.items() if key not in ("seed", "turbulence_seed")}
        for j in range(1, spec.flights):
            another = read_profile(name, given, first.seed + j, uses, allow_code, guard)
            if not isinstance(first.flight, FlightSpec) or first.flight.severity == 0:
                raise ConfigError(f"{name}: has no turbulence, so all its flights are the same")
            cells.append(_make_cell(number, name, another, uses, given, allow_code))
    return Plan(spec.name, tuple(conditions), tuple(cells), EveryRun(len(cells), spec.runs))


def _make_cell(
    condition: int,
    source: str,
    profile: Profile,
    estimators: Sequence[str] | None,
    overrides: Values,
    allow_code: bool,
) -> Cell:
    files = [choice for choice in profile.estimators if choice.use.startswith("file:")]
    for choice in files:
        if not (choice.beside / choice.use.removeprefix("file:")).is_dir():
            raise ConfigError(
                f"{source}: {choice.label!r} is a solution in a file, which belongs to one run; "
                "file:FOLDER names a folder with one for each"
            )
    words = ["bench", "run", source]
    for use in estimators or ():
        words += ["-e", use]
    turbulence = profile.document.get("turbulence_seed", profile.seed)
    given = {key: value for key, value in overrides.items() if key not in ("seed", "turbulence_seed")}
    given |= {} if turbulence == profile.seed else {"turbulence_seed": turbulence}
    for key, value in given.items():
        words += ["--set", f"{key}={format_value(value)}"]
    words += ["--allow-code"] if allow_code else []
    words += next((name_limits(one.guard) for one in profile.estimators if one.guard != DEFAULT_GUARD), [])
    return Cell(condition, profile, (*words, "--seed", str(profile.seed)))


def name_limits(guard: Guard) -> list[str]:
    """Return the command-line options for the limits of a guard."""
    limits = {"--timeout": guard.timeout, "--memory": guard.memory, "--output": guard.output}
    factors = {"--timeout": 1.0, "--memory": 1e-9, "--output": 1e-6}
    given = {name: value for name, value in limits.items() if value not in (None, DEFAULT_GUARD.output)}
    words = [word for name, value in given.items() for word in (name, f"{factors[name] * value:g}")]
    return [*words, "--in-process"] if guard.in_process else words


def _shorten(value: Any) -> str:
    return value if isinstance(value, str) else format_value(value)


def _describe_estimator(choice: EstimatorChoice) -> dict[str, Any]:
    """Return the inputs on which the results of a filter depend, apart from the sources of bench."""
    plain = dataclasses.asdict(choice) | {"beside": ""}
    return plain | {"source": [hash_file(path) for path in find_sources(choice)]}


def hash_estimator(plan: Plan, label: str) -> str:
    """Return a hash of the options and of the sources, or the program, of a filter of a plan."""
    (choice,) = (one for one in plan.cells[0].profile.estimators if one.label == label)
    own = {**_describe_estimator(choice), "guard": "", "package": _hash_package()}
    return hashlib.sha256(json.dumps(own, sort_keys=True, default=str).encode()).hexdigest()[:16]


def find_sources(choice: EstimatorChoice) -> list[Path]:
    """Return the source files of a filter: its package or module, or the files of its program."""
    kind, _, rest = choice.use.partition(":")
    if kind == "command":
        try:
            words = [word.replace("{here}", str(choice.beside)) for word in shlex.split(rest)]
        except ValueError:  # building the filter tells it
            return []
        on_path = [Path(found) for found in [shutil.which(words[0]) if words else None] if found]
        given = [path for path in (*on_path, *(choice.beside / word for word in words)) if path.is_file()]
        return given + find_named_files(given[len(on_path) :])
    if kind == "file":
        return sorted(path for path in (choice.beside / rest).rglob("*") if path.is_file())
    found = find_module_files(choice.use)
    return found + find_named_files(found)


def find_named_files(sources: Sequence[Path]) -> list[Path]:
    """Return the files next to some sources that the sources name, such as a program that a wrapper calls.

    And those that these name. What a wrapper finds by the PATH, or puts together, is not seen.
    """
    found, todo = dict.fromkeys(path.resolve() for path in sources), list(sources)
    given = len(found)
    while todo and len(found) < _MOST_NAMED:
        path = todo.pop()
        try:
            text = path.read_text("utf-8") if path.stat().st_size <= _BLOCK else ""
        except (OSError, UnicodeDecodeError):  # a program
            continue
        words = dict.fromkeys(re.findall(r"[\w./+-]*\w", text))
        for word in dict.fromkeys([*words, *(word.rpartition("/")[2] for word in words)]):
            named = path.parent / word
            with contextlib.suppress(OSError):
                if named.is_file() and named.resolve() not in found:
                    found[named.resolve()] = None
                    todo.append(named)
    return sorted(list(found)[given:])


def find_module_files(use: str) -> list[Path]:
    """Return the file of the module of a filter ``module:Class``, or all of its package."""
    module, _, rest = use.partition(":")
    if not rest or module in ("command", "file"):
        return []
    try:
        found = find_spec(module.partition(".")[0])
    except (ImportError, ValueError):
        return []
    if found is None or found.origin is None or Path(found.origin).is_relative_to(PACKAGE):
        return []
    origin = Path(found.origin)
    return sorted(origin.parent.rglob("*.py")) if found.submodule_search_locations else [origin]


@cache
def describe_software() -> dict[str, str]:
    """Return the versions on which results depend, and a hash of the sources of bench."""
    return {**results.list_versions(), "source": _hash_package()}


@cache
def _hash_package() -> str:
    digest = hashlib.sha256()
    for path in sorted(PACKAGE.rglob("*.py")):
        digest.update(f"{path.relative_to(PACKAGE)}\0{hash_file(path)}".encode())
    return digest.hexdigest()
