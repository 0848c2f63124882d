"""The index page of a folder of results: a row for each results folder below it."""

from __future__ import annotations

import os
from collections.abc import Sequence
from datetime import datetime
from pathlib import Path
from typing import Any, NamedTuple

from bench import durable, store
from bench.errors import ConfigError
from bench.evaluation.headline import make_headline
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
    unit: str  # the IMU
    written: str  # day, local time


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
    durable.write(path, page.render("index.html.jinja", interactive=False, title="Results", rows=rows))
    return problems


def _list_rows(folder: Path, summary: dict[str, Any], root: Path) -> list[_IndexRow]:
    name = Path(os.path.relpath(folder, root)).as_posix()
    profile = summary["profile"]
    title = str(profile.get("title", ""))
    on_board = profile.get("sensors") or profile.get("assumed") or {}
    written = datetime.fromtimestamp((folder / store.RESULT).stat().st_mtime)
    heads = {label: make_headline(label, values) for label, values in summary["metrics"].items()}
    return [
        _IndexRow(
            name,
            f"{name}/{store.REPORT}" if (folder / store.REPORT).is_file() else "",
            title,
            int(summary["seed"]),
            int(summary["run"]),
            label,
            heads[label].word,
            heads[label].look.kind,
            format_number(values.get("pos_rmse_h_m")),
            format_number(values.get("pos_claimed_h_m")),
            str(on_board.get("imu") or ""),
            f"{written:%Y-%m-%d %H:%M}",
        )
        for label, values in summary["metrics"].items()
    ]
