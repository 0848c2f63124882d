"""CAMPAIGN.toml: profiles, filters and values to vary; every combination is a condition of the campaign."""

from __future__ import annotations

import itertools
import os
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any

from pydantic import Field

from bench.core.words.exceptions import ConfigError
from bench.io.config.checks import is_code
from bench.io.config.tables import ROWS, Table, check_table
from bench.io.config.toml_file import read_toml

Values = Mapping[str, Any]
"""Dotted keys of a profile, as --set takes them, and their values."""

MOST_CONDITIONS = 10_000
"""Conditions of a campaign."""


class CampaignTable(Table):
    """The file of a campaign."""

    profiles: Annotated[tuple[str, ...], ROWS, Field(min_length=1)]
    """Shipped profiles, or files beside this one."""
    runs: Annotated[int, Field(ge=1)] = 200
    """Runs of each flight."""
    flights: Annotated[int, Field(ge=1)] = 1
    """Flights of each condition, each with turbulence of its own."""
    seed: Annotated[int, Field(ge=0)] | None = None
    """Seed of all conditions. Default: the seed of each profile."""
    estimators: Annotated[tuple[str, ...], ROWS, Field(min_length=1)] | None = None
    """Filters to run. Default: the filters of each profile."""
    set_: dict[str, Any] = Field(default_factory=dict, alias="set")
    """A table: values for all conditions, by the keys of --set."""
    variant: Annotated[tuple[dict[str, Any], ...], ROWS] = ()
    """Tables of values that belong together, a condition each."""
    sweep: dict[str, Any] = Field(default_factory=dict)
    """A table: lists of values; every combination is a condition."""


@dataclass(frozen=True)
class CampaignSpec:
    """Profiles, runs, filters and varied values of a campaign."""

    name: str
    profiles: tuple[str, ...]
    runs: int = 200  # runs of each flight
    flights: int = 1  # of each condition, each with turbulence of its own
    seed: int | None = None
    estimators: tuple[str, ...] | None = None
    fixed: Values = field(default_factory=dict)
    varied: tuple[Values, ...] = ({},)  # one for each condition of a profile

    def conditions(self) -> Iterator[tuple[str, Values]]:
        """Yield profile and varied values of each condition, in order."""
        return itertools.product(self.profiles, self.varied)


def is_campaign_file(source: str) -> bool:
    """Return whether a file is a campaign file and not a profile."""
    return source.endswith(".toml") and "profiles" in read_toml(Path(source), source)


def read_campaign_file(source: str, *, allow_code: bool = False) -> CampaignSpec:
    """Read a campaign file; profiles in it are found beside it, or shipped.

    Raises
    ------
    ConfigError
        If the file is wrong, or names code without permission.
    """
    path = Path(source)
    table = check_table(CampaignTable, read_toml(path, source), source)
    fixed = flatten(table.set_)
    variants = [flatten(row) for row in table.variant] or [{}]
    sweep = flatten(table.sweep)
    wrong = [
        f"{source}: [sweep] {key} = {value!r} must be a list of values"
        for key, value in sweep.items()
        if not isinstance(value, list) or not value
    ]
    keys = [*fixed, *dict.fromkeys(key for row in variants for key in row), *sweep]
    wrong += [
        f"{source}: {key} is given twice, in [set], [[variant]] or [sweep]"
        for key in dict.fromkeys(keys)
        if keys.count(key) > 1
    ]
    code = [use for use in table.estimators or () if is_code(use)]
    if code and not allow_code:
        wrong.append(f"{source}: {code[0][:60]!r} runs code on this machine; --allow-code permits it")
    if wrong:
        raise ConfigError(*wrong)
    combinations = [
        {**row, **dict(zip(sweep, values, strict=True))}
        for row in variants
        for values in itertools.product(*sweep.values())
    ]
    if len(combinations) * len(table.profiles) > MOST_CONDITIONS:
        raise ConfigError(f"{source}: more than {MOST_CONDITIONS} conditions")
    return CampaignSpec(
        name=path.stem,
        profiles=tuple(_locate(name, path.parent) for name in table.profiles),
        runs=table.runs,
        flights=table.flights,
        seed=table.seed,
        estimators=table.estimators,
        fixed=fixed,
        varied=tuple(combinations),
    )


def _locate(profile: str, beside: Path) -> str:
    """Return the name or path of a profile of a campaign file relative to the current folder."""
    return os.path.relpath(beside / profile) if profile.endswith(".toml") else profile


def flatten(table: Values, above: str = "") -> dict[str, Any]:
    """Return the values of nested tables by dotted key."""
    found: dict[str, Any] = {}
    for key, value in table.items():
        if isinstance(value, Mapping):
            found |= flatten(value, f"{above}{key}.")
        else:
            found[above + key] = value
    return found
