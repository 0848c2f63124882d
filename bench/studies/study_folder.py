"""The folder of a study: tables, figures as numbers, and what was found in words."""

from __future__ import annotations

import dataclasses
import json
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from bench import store
from bench.files import read_json
from bench.plots.series import Plot, Series
from bench.studies.study import Findings, StudyResult, StudyTable

TABLES, FIGURES = "tables", "figures.json"
"""Folder of the tables, and the file of the figures."""


def save_study(folder: Path, result: StudyResult, *, force: bool = False) -> None:
    """Write a study into a new folder, completely or not at all.

    Raises
    ------
    bench.errors.ConfigError
        If the folder cannot be made or must not be replaced.
    OSError
        If a file cannot be written; nothing is left behind.
    """
    found = result.findings
    with store.make_folder(folder, force=force, kind=store.STUDY) as partial:
        (partial / TABLES).mkdir()
        for table in found.tables:
            units = {name: unit for name, unit in table.units.items() if name in table.columns}
            columns = {name: list(values) for name, values in table.columns.items()}
            store.write_table(partial / TABLES / f"{table.name}.parquet", columns, units, title=table.title)
        store.write_json(partial / FIGURES, {"figures": [_describe_plot(plot) for plot in found.figures]})
        store.write_json(partial / store.STUDY_RESULT, _summarize(result) | {"tables": list(result.tables)})


def describe_study(result: StudyResult) -> dict[str, Any]:
    """Return what a study found, in words and tables, for JSON."""
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
        "draws": result.findings.draws,
        "good": result.findings.good,
        "wall_s": result.wall_s,
        "provenance": result.provenance,
    }


def load_study(folder: str | os.PathLike[str]) -> StudyResult:
    """Read the folder of a study back.

    Raises
    ------
    bench.errors.ConfigError
        If the folder is not that of a study, or is damaged.
    """
    folder = Path(folder)
    with store.open_summary(folder, store.STUDY_RESULT, "study") as summary:
        figures = read_json(folder / FIGURES)
        with store.report_damage(folder):
            tables = tuple(_read_table(folder / TABLES, str(name)) for name in summary["tables"])
        findings = Findings(
            tuple(map(str, summary["verdicts"])),
            tables,
            tuple(map(_read_plot, figures["figures"])),
            int(summary["draws"]),
            bool(summary["good"]),
        )
        return StudyResult(
            str(summary["study"]),
            str(summary["question"]),
            str(summary["command"]),
            dict(summary["options"]),
            findings,
            dict(summary["provenance"]),
            float(summary["wall_s"]),
        )


def _read_table(folder: Path, name: str) -> StudyTable:
    table = store.read_table(folder / f"{name}.parquet")
    units = {field.name: field.metadata[b"unit"].decode() for field in table.schema if field.metadata}
    return StudyTable(name, json.loads(table.schema.metadata[b"bench"])["title"], table.to_pydict(), units)


def _describe_plot(plot: Plot) -> dict[str, Any]:
    facts = {one.name: getattr(plot, one.name) for one in dataclasses.fields(plot) if one.name != "series"}
    return facts | {
        "series": [
            {one.name: getattr(line, one.name) for one in dataclasses.fields(line)} for line in plot.series
        ]
    }


def _read_plot(facts: Mapping[str, Any]) -> Plot:
    kept = {key: facts[key] for key in ("title", "across", "over", "log")}
    return Plot(tuple(facts["path"]), series=tuple(map(_read_series, facts["series"])), **kept)


def _read_series(facts: Mapping[str, Any]) -> Series:
    values = np.array(facts["values"], float).reshape(len(facts["t"]), len(facts["names"]))
    return Series(
        str(facts["key"]),
        np.array(facts["t"], float),
        values,
        tuple(facts["names"]),
        tuple(tuple(colour) for colour in facts["colours"]),
        tuple(facts["widths"]),
        marks=bool(facts["marks"]),
        band=None if facts["band"] is None else (int(facts["band"][0]), int(facts["band"][1])),
    )
