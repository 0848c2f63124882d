"""Common parts of all studies: options, findings and workers."""

from __future__ import annotations

import contextlib
import dataclasses
import tomllib
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import cached_property
from itertools import product
from pathlib import PurePath
from typing import Annotated, Any, TypeVar

from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, ValidationError

from bench.core.records.findings import Findings, join_findings
from bench.core.words.exceptions import ConfigError, WorkersLostError
from bench.core.words.stages import Stage
from bench.core.words.wording import as_toml, describe_error, format_number, format_value, suggest
from bench.evaluation.ensembles.ensemble import Estimate
from bench.experiments.campaigns.batches import Lost, compute
from bench.experiments.campaigns.campaign_file import CampaignSpec
from bench.experiments.campaigns.outcome import Campaign
from bench.experiments.campaigns.plan import plan_campaign
from bench.experiments.campaigns.pools import ExecutorPool, ProcessPool, open_pool
from bench.experiments.campaigns.running import run_campaign
from bench.experiments.studies.unit_study.catalog_units import find_units

_Item = TypeVar("_Item")
_Result = TypeVar("_Result")

ShowParts = Callable[[str, int, int], object]
"""Called with what is being done, and how many parts of how many are done."""


def _split(given: object) -> object:
    return tuple(part.strip() for part in given.split(",")) if isinstance(given, str) else given


Positive = Annotated[float, Field(gt=0)]
"""An option that holds a number above zero."""

Count = Annotated[int, Field(ge=2, le=100_000)]
"""An option that holds a number of runs, enough of them for an interval."""

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
    """Options of a study that flies profiles: the replaced values, and the seed of the runs."""

    overrides: Settings = ()
    """values of the profiles to replace, or figures of datasheets they name"""
    seed: Seed | None = None
    """seed of the runs; default: the seed of each profile"""

    @property
    def settings(self) -> dict[str, Any]:
        """The values that are replaced, by dotted key."""
        return read_settings(self.overrides)


class UnitOptions(FlightOptions):
    """Options of a study that answers the same question for each flight with each unit."""

    profiles: Words
    """names of shipped profiles, or .toml files of your own, separated by commas"""
    units: Words | None = None
    """IMUs of the catalog, or .toml files of your own, instead of the IMU of the profile; each in a study
    of its own"""

    @property
    def profile(self) -> str:
        """The flight of options from `ask_each`."""
        return self.profiles[0]

    @property
    def imu(self) -> str | None:
        """Return the IMU of options from `ask_each`; None selects the IMU of the profile."""
        return self.units[0] if self.units else None

    @property
    def settings(self) -> dict[str, Any]:
        """The values that are replaced, the unit among them, by dotted key."""
        return super().settings | ({"sensors.imu": self.imu} if self.units else {})


_Asked = TypeVar("_Asked", bound=UnitOptions)


def ask_each(
    study: str,
    options: _Asked,
    work: StudyWorkers,
    check: Callable[[_Asked], object],
    ask: Callable[[_Asked, StudyWorkers], Findings],
    *,
    together: bool = False,
) -> Findings:
    """Return the findings for each flight with each unit, each with its own options.

    All are checked before the first is asked. If ``together``, the units of a flight are asked at once.

    Raises
    ------
    bench.ConfigError
        With a line for each unit and flight that is wrong.
    """
    find_units(study, options.units or ())
    alone = [(unit,) for unit in options.units or ()]
    groups = [options.units] if together or not alone else alone
    cases: dict[str, _Asked] = {}
    for profile, units in product(options.profiles, groups):
        several = ((profile, options.profiles), (units and units[0], groups))
        name = "-".join(PurePath(one).stem for one, every in several if one and len(every) > 1)
        one = options.model_copy(update={"profiles": (profile,), "units": units})
        cases[f"{name}-{len(cases) + 1}" if name in cases else name] = one
    wrong: dict[str, None] = {}
    for one in cases.values():
        try:
            check(one)
        except ConfigError as error:
            wrong |= dict.fromkeys(error.messages)
    if wrong:
        raise ConfigError(*wrong)
    return join_findings({name: ask(one, work) for name, one in cases.items()})


FLOWN_BY = "guidance.navigation"
"""Key of a profile that names the filter that flies."""


def refuse_navigation(study: str, options: FlightOptions, option: str) -> None:
    """Raise ConfigError if replaced values name the guiding filter, which an option of the study sets."""
    if FLOWN_BY in options.settings:
        raise ConfigError(
            f"study {study}: --set {FLOWN_BY}: {option} sets the filter that flies; leave --set out"
        )


def read_settings(overrides: Sequence[str]) -> dict[str, Any]:
    """Return the values of texts KEY=VALUE by key."""
    pairs = (text.partition("=") for text in overrides)
    return {key: tomllib.loads(f"value = {value}")["value"] for key, _, value in pairs}


def format_estimate(found: Estimate) -> str:
    """Return a value with its interval, as a sentence has it."""
    return f"{format_number(found.value, 3)} ({found.interval})"


class StudyWorkers:
    """The workers of a study."""

    def __init__(self, jobs: int, progress: ShowParts = lambda what, done, of: None) -> None:
        self.jobs, self.progress = jobs, progress
        self._open = contextlib.ExitStack()

    def __enter__(self) -> StudyWorkers:
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
        bench.core.words.exceptions.WorkersLostError
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
        """Run the runs of a campaign from a number on and return it; errors as for `bench.campaign`."""

        def tell(now: Stage) -> None:
            self.progress(what, int(now.done), int(now.total or 0))

        plan = plan_campaign(spec)
        plan = dataclasses.replace(plan, runs=tuple(one for one in plan.runs if one.run >= first))
        found = run_campaign(plan, pool=self._pool, progress=tell)
        if found.interrupted:
            raise KeyboardInterrupt
        return found


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
    """Return the command-line words that set an option."""
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
