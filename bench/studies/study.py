"""What all studies share: options, findings and workers."""

from __future__ import annotations

import contextlib
import dataclasses
import math
import tomllib
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from importlib import import_module
from typing import Annotated, Any, TypeVar

from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, ValidationError

import bench
from bench.campaigns.batches import Lost, compute
from bench.campaigns.campaign_file import CampaignSpec, format_value
from bench.campaigns.plan import plan_campaign
from bench.campaigns.pools import ExecutorPool, ProcessPool, open_pool
from bench.campaigns.running import Campaign, run_campaign
from bench.campaigns.running import Progress as Runs
from bench.errors import ConfigError, WorkersLostError
from bench.evaluation.ensemble import Estimate
from bench.notebook import make_frame, write_sentences, write_table
from bench.plots.series import Plot
from bench.studies import STUDIES, Entry
from bench.units import unit_of
from bench.wording import as_toml, describe_error, format_number, suggest

_Item = TypeVar("_Item")
_Result = TypeVar("_Result")

Progress = Callable[[str, int, int], object]
"""Called with what is being done, and how many parts of how many are done."""


def _split(given: object) -> object:
    return tuple(part.strip() for part in given.split(",")) if isinstance(given, str) else given


Positive = Annotated[float, Field(gt=0)]
"""An option that holds a number above zero."""

Count = Annotated[int, Field(ge=2, le=100_000)]
"""An option that holds a number of draws, enough of them for an interval."""

Numbers = Annotated[tuple[float, ...], Field(min_length=1), BeforeValidator(_split)]
"""An option that holds numbers; on the command line they are separated by commas."""

Durations = Annotated[
    tuple[Annotated[float, Field(gt=0, le=36_000)], ...], Field(min_length=1), BeforeValidator(_split)
]
"""An option that holds times [s]."""

Words = Annotated[tuple[str, ...], Field(min_length=1), BeforeValidator(_split)]
"""An option that holds names; on the command line they are separated by commas."""


def write_settings(given: Mapping[str, Any]) -> tuple[str, ...]:
    """Return values by dotted key as texts KEY=VALUE, which can be hashed, stored and typed again."""
    return tuple(f"{key}={format_value(one)}" for key, one in given.items())


def _take_settings(given: object) -> object:
    return write_settings(given) if isinstance(given, Mapping) else given


Settings = Annotated[tuple[str, ...], BeforeValidator(_take_settings)]
"""An option that holds values of profiles to replace, each a text KEY=VALUE in TOML; a dict gives it."""

Seed = Annotated[int, Field(ge=0)]
"""An option that holds a seed."""


def count_looks(draws: int, most: int) -> int:
    """Return how often draws are looked at that are doubled up to so many."""
    return 1 + max(0, math.ceil(math.log2(max(1.0, most / draws))))


LISTS = {"overrides": "--set"}
"""Options of studies that are repeated on the command line, once for each value -> their flag."""


class StudyOptions(BaseModel):
    """The options of a study: no unknown name, no NaN, no infinity.

    What has no default is an argument of the command line, the others are flags; the text below each is
    its help. A number or a list may be given as text.
    """

    model_config = ConfigDict(
        extra="forbid", frozen=True, allow_inf_nan=False, use_attribute_docstrings=True, validate_default=True
    )


class FlightOptions(StudyOptions):
    """The options of a study that flies profiles: what is replaced in them, and the seed of its draws."""

    overrides: Settings = ()
    """values of the profiles to replace, or figures of datasheets they name"""
    seed: Seed | None = None
    """seed of the noise draws; left out: that of each profile"""

    @property
    def settings(self) -> dict[str, Any]:
        """The values that are replaced, by dotted key."""
        return read_settings(self.overrides)


def read_settings(overrides: Sequence[str]) -> dict[str, Any]:
    """Return the values of texts KEY=VALUE by key."""
    pairs = (text.partition("=") for text in overrides)
    return {key: tomllib.loads(f"value = {value}")["value"] for key, _, value in pairs}


@dataclass(frozen=True)
class StudyTable:
    """A table of a study."""

    name: str  # of its file
    title: str
    columns: Mapping[str, Sequence[Any]]  # name, which ends in its unit -> values (N,); None: no value
    units: Mapping[str, str] = field(default_factory=dict)  # of the columns that have one


def make_table(name: str, title: str, columns: Sequence[str], rows: Sequence[Sequence[Any]]) -> StudyTable:
    """Return a table of rows; a column gets the unit in which its name ends."""
    values = {
        key: [one if one is None or isinstance(one, str | int) else float(one) for one in column]
        for key, column in zip(columns, zip(*rows, strict=True), strict=True)
    }
    return StudyTable(name, title, values, {key: unit for key in columns if (unit := unit_of(key))})


def format_estimate(found: Estimate) -> str:
    """Return a value with its interval, as a sentence has it."""
    return f"{format_number(found.value, 3)} ({found.interval})"


@dataclass(frozen=True)
class Findings:
    """What a study found."""

    verdicts: tuple[str, ...]  # sentences
    tables: tuple[StudyTable, ...]
    figures: tuple[Plot, ...]  # the last part of each path names its file
    draws: int = 0  # noise draws behind each figure with an interval; 0: nothing is drawn
    good: bool = True  # no verdict is negative
    undecided: bool = False  # what was asked cannot be told from so few draws


@dataclass(frozen=True)
class StudyResult:
    """A finished study."""

    name: str
    question: str
    command: str  # that makes it again
    options: Mapping[str, Any]
    findings: Findings
    provenance: Mapping[str, object]
    wall_s: float

    @property
    def verdicts(self) -> tuple[str, ...]:
        """What was found, in sentences."""
        return self.findings.verdicts

    @property
    def tables(self) -> Mapping[str, StudyTable]:
        """The tables by name."""
        return {table.name: table for table in self.findings.tables}

    @property
    def figures(self) -> Mapping[str, Plot]:
        """The figures by name."""
        return {plot.path[-1]: plot for plot in self.findings.figures}

    def plot(self, figure: str | None = None, **look: Any) -> Any:
        """Draw a figure, the first if none is named: see `bench.plot_result`."""
        return bench.plot_result(self, figure, **look)

    def frame(self, table: str | None = None) -> Any:
        """Return a table, the first if none is named, as a pandas.DataFrame."""
        name = table or next(iter(self.tables), "")
        if name not in self.tables:
            raise ConfigError(f"table = {name!r} is not in this study{suggest(name, self.tables, 'tables')}")
        return make_frame(self.tables[name].columns)

    def __repr__(self) -> str:
        """Return the question and what was found."""
        return "\n".join([f"<StudyResult {self.name}: {self.question}>", *self.verdicts])

    def _repr_html_(self) -> str:
        """Return what was found, and the tables."""
        tables = (
            write_table(table.title, list(table.columns), list(zip(*table.columns.values(), strict=True)))
            for table in self.tables.values()
        )
        return write_sentences(self.verdicts) + "".join(tables)


class Work:
    """The workers of a study."""

    def __init__(self, jobs: int, progress: Progress = lambda what, done, of: None) -> None:
        self.jobs, self.progress = jobs, progress
        self._open = contextlib.ExitStack()

    def __enter__(self) -> Work:
        return self

    def __exit__(self, *error: Any) -> None:
        self._open.__exit__(*error)

    @cached_property
    def _pool(self) -> ProcessPool | ExecutorPool:
        pool = open_pool(self.jobs)
        self._open.enter_context(pool)
        return pool

    def map(
        self,
        what: str,
        function: Callable[[_Item], _Result],
        items: Sequence[_Item],
        first: Sequence[int] = (),
    ) -> list[_Result]:
        """Return what an importable function returns for each item, in order.

        The items go to the workers through pickle; ``first`` run before the others, to compile what those
        load.

        Raises
        ------
        bench.errors.WorkersLostError
            If an item ended its worker each time.
        """
        found: dict[int, _Result] = {}
        self.progress(what, 0, len(items))
        for k, value in compute(function, items, self._pool, first):
            if isinstance(value, Lost):
                raise WorkersLostError(f"{what}: {value.reason} at {k + 1} of {len(items)}")
            found[k] = value
            self.progress(what, len(found), len(items))
        return [found[k] for k in range(len(items))]

    def campaign(self, what: str, spec: CampaignSpec, first: int = 0) -> Campaign:
        """Run the draws of a campaign from a number on and return it; errors as for `bench.campaign`."""

        def tell(now: Runs) -> None:
            self.progress(what, now.done, now.runs)

        plan = plan_campaign(spec)
        plan = dataclasses.replace(plan, runs=tuple(one for one in plan.runs if one.run >= first))
        found = run_campaign(plan, jobs=self.jobs, progress=tell)
        if found.interrupted:
            raise KeyboardInterrupt
        return found


def find_study(name: str) -> tuple[Entry, Any]:
    """Return the entry and the module of a study.

    Raises
    ------
    ConfigError
        If there is none of this name.
    """
    if name not in STUDIES:
        raise ConfigError(f"study {name!r} is unknown{suggest(name, STUDIES, 'studies')}")
    return STUDIES[name], import_module(STUDIES[name].module)


def read_options(name: str, model: type[StudyOptions], given: Mapping[str, Any]) -> StudyOptions:
    """Return the options of a study; ConfigError with a line for each that is wrong."""
    try:
        return model.model_validate(given)
    except ValidationError as error:
        details = error.errors(include_url=False)
    wrong = []
    for detail in details:
        key, value = ".".join(map(str, detail["loc"])), detail["input"]
        if detail["type"] == "extra_forbidden":
            wrong.append(f"study {name}: {key} is unknown{suggest(key, model.model_fields, 'options')}")
        elif detail["type"] == "missing":
            wrong.append(f"study {name}: {key} is missing; it must be given")
        else:
            said = describe_error(key, value, detail["type"], detail["msg"], detail.get("ctx", {}))
            wrong.append(f"study {name}: {said}")
    raise ConfigError(*wrong)


def make_command(name: str, options: StudyOptions) -> Iterator[str]:
    """Yield the words of the command that runs a study with these options."""
    yield from ("bench", "study", name)
    flags = []
    for key, field_ in type(options).model_fields.items():
        value = getattr(options, key)
        if field_.is_required():
            yield _format(value)
        elif value != field_.default:
            flags += make_flag(key, value)
    yield from flags


def make_flag(key: str, value: Any) -> list[str]:
    """Return the words of the command line that give an option a value."""
    if key in LISTS:
        return [word for one in value for word in (LISTS[key], one)]
    flag = key.replace("_", "-")
    if isinstance(value, bool):
        return [f"--{flag}" if value else f"--no-{flag}"]
    return [f"--{flag}", _format(value)]


def _format(value: Any) -> str:
    if isinstance(value, tuple):
        return ",".join(map(_format, value))
    return value if isinstance(value, str) else as_toml(value)
