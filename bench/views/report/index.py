"""The index page of a folder of results: runs, campaigns and studies below it."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from bench.core.files import durable
from bench.core.records.findings.looks import find_look
from bench.core.words.exceptions import ConfigError
from bench.core.words.wording import format_number
from bench.evaluation.consistency.headline import make_headline
from bench.experiments.campaigns.stored import load_campaign
from bench.io import results
from bench.io.results.study_folder import load_study
from bench.views.report import page

INDEX = "index.html"


class _IndexRow(NamedTuple):
    """One estimator of one results folder."""

    folder: str
    link: str  # to its report
    title: str
    draw: str  # seed and run, or how many runs a campaign has
    label: str
    word: str  # of its verdict
    kind: str  # class of the verdict
    error: str  # horizontal [m]
    claimed: str  # [m]
    unit: str  # the IMU
    written: str  # day, local time


def find_folders(root: Path) -> list[Path]:
    """Return the folders of runs, campaigns and studies below a folder, two levels deep."""
    places = [f"{depth}/{name}" for depth in ("*", "*/*") for name in (results.RESULT, *_READERS)]
    return sorted({path.parent for place in places for path in root.glob(place)})


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
        name = next((name for name in _READERS if (folder / name).is_file()), results.RESULT)
        try:
            rows += _READERS.get(name, _list_run)(folder, _Place.of(folder / name, path.parent))
        except ConfigError as error:
            problems += error.lines
    durable.write(path, page.render("index.html.jinja", interactive=False, title="Results", rows=rows))
    return problems


class _Place(NamedTuple):
    """Where a folder is, and since when."""

    name: str  # relative to the page
    link: str  # to its report; "" if there is none
    written: str

    @classmethod
    def of(cls, result: Path, root: Path) -> _Place:
        name = Path(os.path.relpath(result.parent, root)).as_posix()
        there = (result.parent / results.REPORT).is_file()
        return cls(name, f"{name}/{results.REPORT}" if there else "", page.read_day(result))


def _list_run(folder: Path, place: _Place) -> list[_IndexRow]:
    summary = results.read_summary(folder)
    profile = summary["profile"]
    rows = []
    for label, values in summary["metrics"].items():
        head = make_headline(label, values)
        word = "; ".join(filter(None, (head.word, head.reason)))
        error, claimed = (format_number(values.get(f"pos_{which}_h_m")) for which in ("rmse", "claimed"))
        draw = f"seed {summary['seed']}, run {summary['run']}"
        rows.append(
            _IndexRow(
                place.name, place.link, str(profile.get("title", "")), draw, label, word, head.look.kind,
                error, claimed, _find_unit(profile), place.written,
            )
        )  # fmt: skip
    return rows


def _list_campaign(folder: Path, place: _Place) -> list[_IndexRow]:
    campaign = load_campaign(folder)
    flown = campaign.conditions[0]["as_flown"]
    several = len(campaign.conditions) > 1
    rows = []
    for one in campaign.outcomes:
        word = one.consistency.word if one.consistency else ""
        said = one.consistency.sentence.replace(": ", "; ", 1) if one.consistency else "–"
        error = one.errors.get("pos_rmse_h_m")
        rows.append(
            _IndexRow(
                place.name, place.link, one.condition if several else str(flown.get("title", "")),
                f"{one.runs} runs", one.label, said, find_look(word).kind if word else "none",
                format_number(error.value) if error else "-", "-", "" if several else _find_unit(flown),
                place.written,
            )
        )  # fmt: skip
    return rows


def _list_study(folder: Path, place: _Place) -> list[_IndexRow]:
    study = load_study(folder)
    draws = f"{study.findings.draws} draws" if study.findings.draws else ""
    return [
        _IndexRow(
            place.name, place.link, study.question, draws, f"study {study.name}", "–", "none", "-", "-", "",
            place.written,
        )
    ]  # fmt: skip


def _find_unit(profile: Mapping[str, Any]) -> str:
    on_board = profile.get("sensors") or profile.get("assumed") or {}
    return str(on_board.get("imu") or "")


_READERS: Mapping[str, Callable[[Path, _Place], list[_IndexRow]]] = {
    results.CAMPAIGN_RESULT: _list_campaign,
    results.STUDY_RESULT: _list_study,
}
"""File that says what a folder is -> what lists its rows; other folders are runs."""
