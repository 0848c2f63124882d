"""Every row of the register's coverage table: printed, required and computed, and the rows that fail."""

from __future__ import annotations

from collections import Counter
from typing import Annotated, Any

from pydantic import Field

from bench.core.records.findings import Findings, FindingTable
from bench.experiments.studies.study import StudyOptions, StudyWorkers
from bench.plugins.papers.register_measures import RowFinding
from bench.plugins.papers.register_rows import ROWS

QUESTION = "Which rows of the register of source equations does bench fulfill, and with which values?"

_PARTS = (  # last row, name, title: tables that a terminal shows whole
    (12, "mechanizations", "Mechanizations, #1 to #12"),
    (33, "sensors", "Sensors and GNSS, #13 to #33"),
    (50, "filters", "Filters and integrity, #34 to #50"),
    (60, "second-source", "The second source and the truth, #51 to #60"),
)


class Options(StudyOptions):
    """Options of the study."""

    row: Annotated[int, Field(ge=0, le=len(ROWS))] = 0
    """the only row to compute; 0 for all rows"""


def run(options: Options, work: StudyWorkers) -> Findings:
    """Compute the rows that take seconds, and name the tests of the others."""
    rows = [row for row in ROWS if options.row in (0, row.number)]
    computed = [row.number for row in rows if row.measure is not None]
    found = dict(zip(computed, work.map("rows", measure_row, computed), strict=True))
    parts: dict[str, dict[str, list[Any]]] = {}
    failed, opened = [], []
    states = Counter[str]()
    for row in rows:
        ours, holds = ("by its test", "test") if row.test else (row.open_because, "open")
        if row.number in found:
            ours, holds = found[row.number].ours, "yes" if found[row.number].holds else "no"
        states[holds] += 1
        if holds == "no":
            failed.append(f"#{row.number} {row.what}: {row.required}, found {ours}")
        if holds == "open":
            opened.append(f"#{row.number} {row.what} ({row.open_because})")
        told = {
            "row": row.number,
            "capability": row.what,
            "source": row.source,
            "printed": row.printed,
            "required": row.required,
            "ours": ours,
            "holds": holds,
            "test": row.test,
        }
        columns = parts.setdefault(next(name for last, name, _ in _PARTS if row.number <= last), {})
        for key, value in told.items():
            columns.setdefault(key, []).append(value)
    verdicts = [
        f"Of {len(rows)} rows, {states['yes']} computed here and holding, {states['test']} held by a test, "
        f"{states['no']} not holding, {states['open']} open."
    ]
    verdicts += [f"Does not hold: {text}." for text in failed]
    if opened:
        verdicts.append(f"Open: {'; '.join(opened)}.")
    tables = tuple(FindingTable(name, title, parts[name]) for _, name, title in _PARTS if name in parts)
    return Findings(tuple(verdicts), tables, (), good=not failed)


def measure_row(number: int) -> RowFinding:
    """Return the result of bench for a row that has a function."""
    (measure,) = (row.measure for row in ROWS if row.number == number)
    assert measure is not None
    return measure()
