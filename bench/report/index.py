"""The index page of a folder of results: a row for each results folder below it."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

from bench import durable, store
from bench.errors import ConfigError
from bench.findings.looks import find_look
from bench.report import page
from bench.wording import format_number

INDEX = "index.html"


class _IndexRow(NamedTuple):
    """One estimator of one results folder."""

    folder: str
    link: str  # to its report
    title: str
    seed: int
    run: int
    label: str
    word: str  # of its verdict
    kind: str  # class of the verdict
    error: str  # horizontal [m]
    claimed: str  # [m]


def find_folders(root: Path) -> list[Path]:
    """Return the results folders below a folder, two levels deep."""
    found = {path.parent for depth in ("*", "*/*") for path in root.glob(f"{depth}/{store.RESULT}")}
    return sorted(found)


def write_index(path: Path, folders: Sequence[Path]) -> list[str]:
    """Write the index of results folders, with links to their reports.

    Returns
    -------
    problems : list of str
        A message for each folder that could not be read.

    Raises
    ------
    OSError
        If the file cannot be written; an existing file is left unchanged.
    """
    rows: list[_IndexRow] = []
    problems: list[str] = []
    for folder in folders:
        try:
            rows += _list_rows(folder, store.read_summary(folder), path.parent)
        except ConfigError as error:
            problems += error.lines
    durable.write(path, page.render("index.html.jinja", title="Results", rows=rows))
    return problems


def _list_rows(folder: Path, summary: dict[str, Any], root: Path) -> list[_IndexRow]:
    name = folder.relative_to(root).as_posix()
    title = str(summary["profile"].get("title", ""))
    return [
        _IndexRow(
            name,
            f"{name}/{store.REPORT}" if (folder / store.REPORT).is_file() else "",
            title,
            int(summary["seed"]),
            int(summary["run"]),
            label,
            str(values.get("verdict", "")),
            find_look(str(values.get("verdict", "")))[0],
            format_number(values.get("pos_rmse_h_m")),
            format_number(values.get("pos_claimed_h_m")),
        )
        for label, values in summary["metrics"].items()
    ]
