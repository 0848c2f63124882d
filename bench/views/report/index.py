"""The index page of a folder of results: runs, campaigns and studies below it."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from bench.core.files import durable
from bench.core.records.findings import make_table
from bench.core.records.findings.looks import find_look
from bench.core.words.exceptions import ConfigError
from bench.core.words.notebook import ShownText
from bench.core.words.wording import format_number
from bench.evaluation.consistency.headline import make_headline
from bench.experiments.campaigns.stored import read_campaign
from bench.io import results
from bench.io.results.study_folder import read_study
from bench.views.report import page

INDEX = "index.html"


_TITLE = "A row for each filter of each run and campaign; horizontal errors, root mean square"
_KINDS = {
    "folder": "", "estimator": "text", "verdict": "text", "error [m]": "", "reported [m]": "", "IMU": "text",
    "written": "text", "draw": "text", "experiment": "words",
}  # fmt: skip
"""Column -> its class."""
_Row = tuple[str | ShownText, ...]


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
    rows: list[_Row] = []
    problems: list[str] = []
    for folder in folders:
        name = next((name for name in _READERS if (folder / name).is_file()), results.RESULT)
        try:
            rows += _READERS.get(name, _list_run)(folder, _Place.of(folder / name, path.parent))
        except ConfigError as error:
            problems += error.lines
    table = make_table("index", _TITLE, list(_KINDS), rows)
    text = page.render("index.html.jinja", interactive=False, title="Results", table=table, kinds=_KINDS)
    durable.write(path, text)
    return problems


class _Place(NamedTuple):
    """A folder with the link to its report, if there is one, and since when it is there."""

    folder: ShownText
    written: str

    @classmethod
    def of(cls, result: Path, root: Path) -> _Place:
        name = Path(os.path.relpath(result.parent, root)).as_posix()
        there = (result.parent / results.REPORT).is_file()
        link = f"{name}/{results.REPORT}" if there else ""
        return cls(ShownText(name, link=link), page.read_day(result))


def _list_run(folder: Path, place: _Place) -> list[_Row]:
    summary = results.read_summary(folder)
    profile = summary["profile"]
    rows: list[_Row] = []
    for label, values in summary["metrics"].items():
        head = make_headline(label, values)
        word = "; ".join(filter(None, (head.word, head.reason)))
        error, claimed = (format_number(values.get(f"pos_{which}_h_m")) for which in ("rmse", "claimed"))
        draw = f"seed {summary['seed']}, run {summary['run']}"
        verdict, title = ShownText(word, head.look.kind), str(profile.get("title", ""))
        of_run = _find_unit(profile), place.written, draw, title
        rows.append((place.folder, label, verdict, error, claimed, *of_run))
    return rows


def _list_campaign(folder: Path, place: _Place) -> list[_Row]:
    campaign = read_campaign(folder)
    flown = campaign.conditions[0]["as_flown"]
    several = len(campaign.conditions) > 1
    rows: list[_Row] = []
    for one in campaign.outcomes:
        word = one.consistency.word if one.consistency else ""
        said = one.consistency.sentence.replace(": ", "; ", 1) if one.consistency else "–"
        error = one.errors.get("pos_rmse_h_m")
        verdict = ShownText(said, find_look(word).kind if word else "none")
        title, unit = (one.condition, "") if several else (str(flown.get("title", "")), _find_unit(flown))
        shown = format_number(error.value if error else None)
        about = unit, place.written, f"{one.runs} runs", title
        rows.append((place.folder, one.label, verdict, shown, "-", *about))
    return rows


def _list_study(folder: Path, place: _Place) -> list[_Row]:
    study = read_study(folder)
    runs = f"{study.findings.runs} runs" if study.findings.runs else ""
    about = "", place.written, runs, study.question
    return [(place.folder, f"study {study.name}", ShownText("–", "none"), "-", "-", *about)]


def _find_unit(profile: Mapping[str, Any]) -> str:
    on_board = profile.get("sensors") or profile.get("assumed") or {}
    return str(on_board.get("imu") or "")


_READERS: Mapping[str, Callable[[Path, _Place], list[_Row]]] = {
    results.CAMPAIGN_RESULT: _list_campaign,
    results.STUDY_RESULT: _list_study,
}
"""File that says what a folder is -> what lists its rows; other folders are runs."""
