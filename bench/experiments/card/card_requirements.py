"""User requirements on a filter on the flights of the suite: a file of rows, TOML or CSV."""

from __future__ import annotations

import contextlib
import csv
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any

from pydantic import Field

from bench.core.files.file_checks import check_file
from bench.core.words.exceptions import ConfigError
from bench.evaluation.requirements.required_metrics import judge_runs
from bench.experiments.card.card_lines import Line, Rows
from bench.io.config.checks import check_requirements
from bench.io.config.profile_tables import RequirementTable
from bench.io.config.tables import ROWS, Table, check_table
from bench.io.config.toml_file import MOST_BYTES, read_toml

_WORDS = ("metric", "estimator", "flight", "plan", "id", "text")
"""Keys whose cells are texts."""


class FlightRequirement(RequirementTable):
    """A limit on a metric that a filter must meet on the flights of the suite."""

    flight: str | None = None
    """The only flight on which it has to; all, if left out."""


class RequirementFile(Table):
    """A file of requirements."""

    requirement: Annotated[tuple[FlightRequirement, ...], ROWS, Field(min_length=1)]
    """Each as in a profile."""


def read_requirements(path: Path, flights: list[str]) -> tuple[Mapping[str, Any], ...]:
    """Read the requirements in a file: TOML with rows ``[[requirement]]``, or CSV with a column for each key.

    Raises
    ------
    ConfigError
        If the file cannot be read, or a row names no metric, no limit, or no flight of the suite.
    """
    document = _read_csv(path) if path.suffix.lower() == ".csv" else read_toml(path, str(path))
    rows = check_table(RequirementFile, document, str(path)).requirement
    wrong = check_requirements(rows, ())
    for k, row in enumerate(rows, 1):
        if row.flight not in (None, *flights):
            wrong.append(f"[[requirement]] {k}: no flight {row.flight!r}; there are {', '.join(flights)}")
    if wrong:
        raise ConfigError(*(f"{path}: {line}" for line in wrong))
    return tuple(row.model_dump(exclude_none=True) for row in rows)


def _read_csv(path: Path) -> dict[str, Any]:
    """Return the rows of a CSV file as a TOML file would hold them; an empty cell leaves a key out."""
    try:
        check_file(path, str(path), MOST_BYTES)
        table = csv.reader(path.read_text(encoding="utf-8-sig").splitlines(), strict=True)
        heads, *lines = [[cell.strip() for cell in line] for line in table if any(line)] or [[]]
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise ConfigError(f"{path}: cannot be read: {getattr(error, 'strerror', None) or error}") from None
    for k, line in enumerate(lines, 1):
        if len(line) != len(heads):
            raise ConfigError(f"{path}: row {k} has {len(line)} cells, the head {len(heads)}")
    named = (zip(heads, line, strict=True) for line in lines)
    return {"requirement": [{key: _take_number(key, cell) for key, cell in row if cell} for row in named]}


def _take_number(key: str, cell: str) -> float | str:
    with contextlib.suppress(ValueError):
        return cell if key in _WORDS else float(cell)
    return cell


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
            id=one.id,
            text=one.text,
        )
        for one in judge_runs(label, own, here)
    ]
