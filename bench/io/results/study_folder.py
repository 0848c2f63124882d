"""The folder of a study: tables, data of the figures, and the answer in sentences."""

from __future__ import annotations

import dataclasses
import json
import os
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, model_validator

from bench.core.files.file_checks import read_json
from bench.core.records.findings import Findings, FindingTable, StudyResult
from bench.core.records.findings.series import Plot, Series
from bench.io import results
from bench.io.config.tables import ROWS

_Numbers = list[float | None]
_Line = Annotated[int, Field(ge=0)]


class _Stored(BaseModel):
    model_config = ConfigDict(strict=True)


class _StoredSeries(_Stored):
    key: str
    t: _Numbers
    values: list[_Numbers] | _Numbers
    names: list[str]
    colors: list[Annotated[tuple[int, int, int], ROWS]]
    widths: list[float]
    marks: bool
    band: Annotated[tuple[_Line, _Line], ROWS] | None
    labels: list[str] = []

    @model_validator(mode="after")
    def _fits(self) -> _StoredSeries:
        lines = len(self.names)
        rows = [row if isinstance(row, list) else [row] for row in self.values]
        whole = len(rows) == len(self.t) and all(len(row) == lines for row in rows)
        if not whole or {len(self.colors), len(self.widths)} != {lines} or max(self.band or (0,)) >= lines:
            raise ValueError("the columns of a line do not fit each other")
        if self.labels and len(self.labels) != len(self.t):
            raise ValueError("not every dot has its name")
        if not np.isfinite(np.array(self.t, float)).any():
            raise ValueError("a line has no place on its axis")
        return self


class _StoredPlot(_Stored):
    path: list[str]
    title: str
    across: str
    over: str
    log: Literal["", "x", "y", "xy"]
    ticks: list[Annotated[tuple[float, str], ROWS]] = []
    series: Annotated[list[_StoredSeries], Field(min_length=1)]


class _StoredStudy(_Stored):
    """Contents of `study.json`."""

    study: str
    question: str
    command: str
    options: dict[str, Any]
    verdicts: list[str]
    tables: list[str]
    runs: Annotated[int, Field(ge=0)]
    good: bool
    undecided: bool = False
    wall_s: float
    provenance: dict[str, Any]


TABLES, FIGURES = "tables", "figures.json"
"""Folder of the tables, and the file of the figures."""


def write_study(folder: Path, result: StudyResult, *, force: bool = False) -> None:
    """Write a study into a new folder, completely or not at all.

    Raises
    ------
    bench.ConfigError
        If the folder cannot be made or must not be replaced.
    OSError
        If a file cannot be written; nothing is left behind.
    """
    found = result.findings
    with results.make_folder(folder, force=force, kind=results.STUDY) as partial:
        (partial / TABLES).mkdir()
        for table in found.tables:
            units = {name: unit for name, unit in table.units.items() if name in table.columns}
            columns = {name: list(values) for name, values in table.columns.items()}
            results.write_table(partial / TABLES / f"{table.name}.parquet", columns, units, title=table.title)
        results.write_json(partial / FIGURES, {"figures": [_describe_plot(plot) for plot in found.figures]})
        results.write_json(
            partial / results.STUDY_RESULT, _summarize(result) | {"tables": list(result.tables)}
        )


def describe_study(result: StudyResult) -> dict[str, Any]:
    """Return the answer of a study, in sentences and tables, for JSON."""
    tables = {
        name: {"title": table.title, "units": table.units, "columns": table.columns}
        for name, table in result.tables.items()
    }
    return _summarize(result) | {"tables": tables}


def _summarize(result: StudyResult) -> dict[str, Any]:
    return {
        "study": result.name,
        "question": result.question,
        "command": result.command,
        "options": result.options,
        "verdicts": result.verdicts,
        "runs": result.findings.runs,
        "good": result.findings.good,
        "undecided": result.findings.undecided,
        "wall_s": result.wall_s,
        "provenance": result.provenance,
    }


def read_study(folder: str | os.PathLike[str]) -> StudyResult:
    """Read the folder of a study.

    Parameters
    ----------
    folder : str or Path
        Folder that ``bench study`` or `bench.study` wrote.

    Returns
    -------
    StudyResult
        Answer, tables and figures.

    Raises
    ------
    bench.ConfigError
        If the folder is not a study or is damaged.

    Examples
    --------
    >>> import bench, tempfile
    >>> with tempfile.TemporaryDirectory() as place:
    ...     found = bench.study("requirements", out=place + "/a")
    ...     bench.read_study(place + "/a").findings.verdicts == found.findings.verdicts
    True
    """
    folder = Path(folder)
    with results.open_summary(folder, results.STUDY_RESULT, "study") as summary:
        found = _StoredStudy.model_validate(summary)
        with results.report_damage(folder):
            plots = [_StoredPlot.model_validate(one) for one in read_json(folder / FIGURES)["figures"]]
            tables = tuple(_read_table(folder / TABLES, name) for name in found.tables)
            figures = tuple(map(_make_plot, plots))
        findings = Findings(tuple(found.verdicts), tables, figures, found.runs, found.good, found.undecided)
        named = found.study, found.question, found.command, found.options
        return StudyResult(*named, findings, found.provenance, found.wall_s)


def _read_table(folder: Path, name: str) -> FindingTable:
    table = results.read_table(folder / f"{name}.parquet")
    units = {field.name: field.metadata[b"unit"].decode() for field in table.schema if field.metadata}
    return FindingTable(name, json.loads(table.schema.metadata[b"bench"])["title"], table.to_pydict(), units)


def _describe_plot(plot: Plot) -> dict[str, Any]:
    facts = {one.name: getattr(plot, one.name) for one in dataclasses.fields(plot) if one.name != "series"}
    return facts | {
        "series": [
            {one.name: getattr(line, one.name) for one in dataclasses.fields(line)} for line in plot.series
        ]
    }


def _make_plot(found: _StoredPlot) -> Plot:
    lines = tuple(map(_make_series, found.series))
    return Plot(
        tuple(found.path), found.title, lines, across=found.across, over=found.over, log=found.log,
        ticks=tuple(found.ticks),
    )  # fmt: skip


def _make_series(found: _StoredSeries) -> Series:
    return Series(
        found.key,
        np.array(found.t, float),
        np.array(found.values, float).reshape(len(found.t), len(found.names)),
        tuple(found.names),
        tuple(found.colors),
        tuple(found.widths),
        marks=found.marks,
        band=found.band,
        labels=tuple(found.labels),
    )
