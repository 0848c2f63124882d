"""User requirements on a filter on the flights of the suite: a file of rows ``[[requirement]]``."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any

from pydantic import Field

from bench.core.words.exceptions import ConfigError
from bench.evaluation.requirements.required_metrics import judge_runs
from bench.experiments.card.card_lines import Line, Rows
from bench.io.config.checks import check_requirements
from bench.io.config.profile_tables import RequirementTable
from bench.io.config.tables import ROWS, Table, check_table
from bench.io.config.toml_file import read_toml


class FlightRequirement(RequirementTable):
    """A limit on a metric that a filter must meet on the flights of the suite."""

    flight: str | None = None
    """The only flight on which it has to; all, if left out."""


class RequirementFile(Table):
    """A file of requirements."""

    requirement: Annotated[tuple[FlightRequirement, ...], ROWS, Field(min_length=1)]
    """Each as in a profile."""


def read_requirements(path: Path, flights: list[str]) -> tuple[Mapping[str, Any], ...]:
    """Read the requirements in a file.

    Raises
    ------
    ConfigError
        If a row names no metric, no limit, or no flight of the suite.
    """
    rows = check_table(RequirementFile, read_toml(path, str(path)), str(path)).requirement
    wrong = check_requirements(rows, ())
    for k, row in enumerate(rows, 1):
        if row.flight not in (None, *flights):
            wrong.append(f"[[requirement]] {k}: no flight {row.flight!r}; there are {', '.join(flights)}")
    if wrong:
        raise ConfigError(*(f"{path}: {line}" for line in wrong))
    return tuple(row.model_dump(exclude_none=True) for row in rows)


def judge_requirements(flight: str, label: str, own: Rows, rows: tuple[Mapping[str, Any], ...]) -> list[Line]:
    """Return whether the runs of a flight meet the requirements."""
    here = [row for row in rows if row.get("flight", flight) == flight]
    return [
        Line(
            topic="requirements",
            flight=flight,
            figure=one.metric,
            value=None,
            low=None,
            high=None,
            sentence=f"{flight}: {one.sentence}",
            word=one.word,
        )
        for one in judge_runs(label, own, here)
    ]
