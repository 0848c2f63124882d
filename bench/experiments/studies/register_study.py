"""Every row of the register's coverage table: printed, required, found here, and what does not hold."""

from __future__ import annotations

from collections import Counter
from typing import Annotated, Any

from pydantic import Field

from bench.core.records.findings import Findings, FindingTable
from bench.experiments.studies.register_measures import RowFinding
from bench.experiments.studies.register_proofs import find_root, group_tests, run_tests
from bench.experiments.studies.register_rows import ROWS
from bench.experiments.studies.study import StudyOptions, StudyWorkers

_PARTS = (  # last row, name, title: tables that a terminal shows whole
    (12, "mechanizations", "Mechanizations, #1 to #12"),
    (33, "sensors", "Sensors and GNSS, #13 to #33"),
    (50, "filters", "Filters and integrity, #34 to #50"),
    (60, "second-source", "The second source and the truth, #51 to #60"),
)


class Options(StudyOptions):
    """What may be asked."""

    row: Annotated[int, Field(ge=0, le=len(ROWS))] = 0
    """a row alone; 0 for all"""
    prove: bool = False
    """run the tests of the rows that are not computed, too; in the repository"""


def run(options: Options, work: StudyWorkers) -> Findings:
    """Compute the rows that take seconds, and name the tests of the others or run them."""
    rows = [row for row in ROWS if options.row in (0, row.number)]
    tests = [row.test for row in rows if row.measure is None and row.test] if options.prove else []
    groups = group_tests(find_root(), tests) if tests else []
    proofs = {name: proof for one in work.map("tests", run_tests, groups) for name, proof in one.items()}
    computed = [row.number for row in rows if row.measure is not None]
    found = dict(zip(computed, work.map("rows", measure_row, computed), strict=True))
    parts: dict[str, dict[str, list[Any]]] = {}
    failed, opened = [], []
    states = Counter[str]()
    for row in rows:
        ours, holds = ("by its test", "test") if row.test else (row.open_because, "open")
        if row.number in found:
            ours, holds = found[row.number].ours, "yes" if found[row.number].holds else "no"
        elif row.test in proofs:
            proof = proofs[row.test]
            ours = f"{proof.cases - proof.failed} of {proof.cases} cases of its test, {proof.seconds:.0f} s"
            holds = "yes" if proof.holds else "no"
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
    how = "proven" if options.prove else "computed"
    verdicts = [
        f"Of {len(rows)} rows, {states['yes']} {how} here and holding, {states['test']} held by a test, "
        f"{states['no']} not holding, {states['open']} open."
    ]
    verdicts += [f"Does not hold: {text}." for text in failed]
    if opened:
        verdicts.append(f"Open: {'; '.join(opened)}.")
    tables = tuple(FindingTable(name, title, parts[name]) for _, name, title in _PARTS if name in parts)
    return Findings(tuple(verdicts), tables, (), good=not failed)


def measure_row(number: int) -> RowFinding:
    """Return what the bench finds for a row that has a function."""
    (measure,) = (row.measure for row in ROWS if row.number == number)
    assert measure is not None
    return measure()
