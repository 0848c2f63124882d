"""Folders and files that bench itself wrote, damaged: results, campaigns, cards, baselines, studies.

Beside random edits of bytes a document gets a value of another kind in some place, a table loses a column,
gets one of another type or other rows, and a line of a journal gets its right sum again, as after an edit by
hand.
"""

from __future__ import annotations

import io
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

import bench
from bench.experiments.baselines import checking
from bench.experiments.baselines.baseline_file import read_baseline
from bench.experiments.baselines.checking import record_baselines
from bench.experiments.baselines.comparing import compare
from bench.experiments.campaigns import parts
from bench.experiments.campaigns.journal import NAME, sum_text
from bench.experiments.campaigns.pools import SerialExecutor
from bench.experiments.card.card_comparison import compare_cards, list_differences
from bench.experiments.card.card_making import read_card
from bench.io import results
from bench.io.results.folders import MARK
from bench.io.results.study_folder import write_study
from bench.views.report import campaign_page, card_page, page, study_page
from bench.views.report.paper import list_drawings
from tests.faults import PROFILE, make_card

Made = tuple[list[Path], Callable[[Path], object], Callable[[np.random.Generator, Path, bytes], bytes]]
"""Files to damage, what reads them, and how."""

_VALUES: tuple[Any, ...] = (
    None, True, 0, -1, 1.5, 1e308, float("inf"), float("nan"), 10**30, "", "text", "\x1b[31m", [], [[]], {},
    {"a": 1}, [None], [1e400, "x"],
)  # fmt: skip


def edit(random: np.random.Generator, path: Path, whole: bytes) -> bytes:
    """Return a file with one thing changed that its form allows."""
    if path.suffix == ".parquet":
        return _edit_table(random, whole)
    if path.name == NAME:
        lines = whole.splitlines(keepends=True)
        k = int(random.integers(len(lines)))
        text = _edit_document(random, lines[k].partition(b" ")[2])
        lines[k] = sum_text(text) + b" " + text + b"\n"
        return b"".join(lines)
    return _edit_document(random, whole)


def _edit_document(random: np.random.Generator, text: bytes) -> bytes:
    """Return a JSON document with a value of another kind in some place, or without it."""
    document = json.loads(text)
    here, places = document, []
    while isinstance(here, dict | list) and len(here):
        keys = list(here) if isinstance(here, dict) else range(len(here))
        key = keys[int(random.integers(len(keys)))]
        places.append((here, key))
        here = here[key]
    if not places:
        return b"[]"
    inner, key = places[int(random.integers(len(places)))]
    if random.random() < 0.25:
        del inner[key]
    else:
        inner[key] = _VALUES[int(random.integers(len(_VALUES)))]
    return json.dumps(document).encode()


def _edit_table(random: np.random.Generator, whole: bytes) -> bytes:
    """Return a table without a column, with one of another type, with other rows, or with missing values."""
    table = pq.read_table(io.BytesIO(whole))
    k, rows = int(random.integers(max(table.num_columns, 1))), table.num_rows
    ways: list[Callable[[], pa.Table]] = [
        lambda: table.remove_column(k),
        lambda: table.slice(0, rows // 2),
        lambda: table.slice(0, 0),
        lambda: pa.concat_tables([table, table]),
        lambda: table.replace_schema_metadata(None),
        lambda: table.replace_schema_metadata({"bench": json.dumps(_VALUES[int(random.integers(15))])}),
        lambda: table.set_column(k, table.schema.field(k).name, pa.array(["x"] * rows)),
        lambda: table.set_column(k, table.schema.field(k).name, pa.nulls(rows)),
        lambda: table.set_column(k, table.schema.field(k).name, pa.array([float("nan")] * rows)),
        lambda: table.set_column(k, table.schema.field(k).name, pa.array([-(2**62)] * rows)),
        lambda: table.rename_columns([f"{name}x" for name in table.column_names]),
    ]
    out = io.BytesIO()
    pq.write_table(ways[int(random.integers(len(ways)))](), out)
    return out.getvalue()


def _profile(folder: Path) -> str:
    path = folder / "short.toml"
    path.write_text(PROFILE, encoding="utf-8")
    return str(path)


def make_views(folder: Path) -> Made:
    """A results folder, shown as a report, as figures and in a comparison."""
    source = _profile(folder)
    for k in (1, 2):
        bench.write_result(bench.run(source, seed=k), folder / f"run-{k}", recording=False, report=False)

    def read(path: Path) -> object:
        result = bench.read_result(folder / "run-1")
        list(list_drawings(result))
        page.make_page("run", result)
        return bench.compare_results([folder / "run-1", folder / "run-2"])

    return sorted(p for p in (folder / "run-1").iterdir() if p.name != MARK), read, edit


def make_campaign(folder: Path) -> Made:
    """The folder of a campaign, shown, compared and gone on with."""
    source = _profile(folder)
    for k in (1, 2):
        bench.campaign(source, 3, seed=k, executor=SerialExecutor(), jobs=1, out=folder / f"campaign-{k}")

    def read(path: Path) -> object:
        result = bench.read_campaign(folder / "campaign-1")
        campaign_page.make_page("campaign", result)
        return bench.compare_results([folder / "campaign-1", folder / "campaign-2"])

    return (
        [folder / "campaign-1" / name for name in ("campaign.json", "runs.parquet", "epochs.parquet")],
        read,
        edit,
    )


def make_journal(folder: Path) -> Made:
    """The journal of a campaign that is gone on with."""
    source, out = _profile(folder), folder / "campaign"

    def read(path: Path) -> object:
        whole = path.read_bytes()
        try:
            return bench.campaign(source, 3, executor=SerialExecutor(), jobs=1, out=out, resume=True)
        finally:
            path.write_bytes(whole)

    bench.campaign(source, 3, executor=SerialExecutor(), jobs=1, out=out)
    return [out / NAME], read, edit


def make_part(folder: Path) -> Made:
    """A part of the journal of a campaign that is gone on with."""
    size, parts.ROWS = parts.ROWS, 2
    try:
        (line,), read, _ = make_journal(folder)
    finally:
        parts.ROWS = size
    (part,) = parts.list_parts(line.parent)
    lines = line.read_bytes()

    def read_both(path: Path) -> object:
        try:
            return read(path)
        finally:
            line.write_bytes(lines)  # without the runs that were repeated

    return [line.with_name(part)], read_both, edit


def make_cards(folder: Path) -> Made:
    """A card, shown and compared."""
    for k in (1, 2):
        results.write_json(folder / f"card-{k}.json", make_card(f"one-{k}").model_dump())

    def read(path: Path) -> object:
        first, second = read_card(folder / "card-1.json"), read_card(folder / "card-2.json")
        card_page.write_card(folder / "card.html", first)
        return list_differences(first, second), compare_cards(first, second)

    return [folder / "card-1.json"], read, edit


def make_baseline(folder: Path) -> Made:
    """A baseline, checked and compared."""
    source, place = _profile(folder), folder / "baselines"
    record_baselines([source], directory=place, estimators=["free-inertial"], runs=20)
    other = read_baseline(place / "short.json")

    def read(path: Path) -> object:
        one = read_baseline(path)
        compare(one, other, "short")
        return list(checking.check([source], directory=place, runs=20))

    return [place / "short.json"], read, edit


def make_study(folder: Path) -> Made:
    """The folder of a study, shown."""
    write_study(folder / "study", bench.study("requirements", jobs=1))

    def read(path: Path) -> object:
        return study_page.make_page(bench.read_study(folder / "study"))

    files = [p for p in (folder / "study").rglob("*") if p.suffix in (".json", ".parquet") and p.name != MARK]
    return sorted(files), read, edit


def make_saved(folder: Path) -> Made:
    """The state of a filter, taken up again."""
    profile = bench.read_profile(_profile(folder))
    sensed = bench.sense(profile, bench.fly(profile))
    filter_ = bench.open_filter("loose-15", sensed.initial)
    filter_.update(sensed.data)
    bench.write_filter(filter_, folder / "filter.npz")

    def read(path: Path) -> object:
        return bench.read_filter(path).current()

    return (
        [folder / "filter.npz"],
        read,
        lambda random, path, whole: whole[: int(random.integers(len(whole)))],
    )


FOLDERS: dict[str, Callable[[Path], Made]] = {
    "views": make_views,
    "campaign": make_campaign,
    "journal": make_journal,
    "part": make_part,
    "card": make_cards,
    "baseline": make_baseline,
    "study": make_study,
    "saved": make_saved,
}
