"""The verb compare: finished results side by side."""

from __future__ import annotations

import time
from collections.abc import Sequence
from pathlib import Path

from rich import box
from rich.console import Console
from rich.table import Table
from rich.text import Text

from bench import api, store
from bench.baselines.comparing import ONE_DRAW, Compared, compare_results
from bench.baselines.verdict_rows import Verdict
from bench.errors import ConfigError
from bench.evaluation.key_figures import format_number, is_key_figure
from bench.plots.overlay import merge_results
from bench.workbench.check_verb import STYLES
from bench.workbench.flight_verbs import print_end


def compare(folders: Sequence[Path], *, console: Console, out: Path | None, force: bool) -> list[Compared]:
    """Compare the first folder with the others and print it; ``out`` gets all of them as one result."""
    if out is not None:
        store.check_folder(out, force=force)
    compared = compare_results(folders)
    for one in compared:
        _print_compared(console, one)
    if out is not None:
        _write_overlay(folders, out, force=force, console=console)
    return compared


def _print_compared(console: Console, one: Compared) -> None:
    console.print(Text(f"{one.first} beside {one.other}", "bold"), soft_wrap=True)
    for text in one.differences:
        console.print(f"  differs: {text}", soft_wrap=True)
    shown = [row for row in one.verdicts if is_key_figure(row.metric)]
    for profile, estimator in dict.fromkeys((row.profile, row.estimator) for row in shown):
        rows = [row for row in shown if (row.profile, row.estimator) == (profile, estimator)]
        console.print(_make_table(f"{estimator}, {profile}", one, rows))
    for sentence in one.sentences:
        console.print(sentence, soft_wrap=True)
    if all(row.note == ONE_DRAW for row in one.verdicts):
        return
    worse = sum(row.word == "worse" for row in one.verdicts)
    better = sum(row.word == "better" for row in one.verdicts)
    console.print(
        f"Of {len(one.verdicts)} metrics of {one.other}, {better} are better and {worse} worse, with 99 % "
        "confidence over all of them.",
        soft_wrap=True,
    )


def _make_table(title: str, one: Compared, rows: Sequence[Verdict]) -> Table:
    table = Table(
        title=title, title_justify="left", box=box.SIMPLE_HEAD, padding=(0, 1, 0, 0), pad_edge=False
    )
    table.add_column("", no_wrap=True)
    for name in (one.first, one.other):
        table.add_column(Text(name), justify="right", overflow="fold")
    single = all(row.note == ONE_DRAW for row in rows)
    for name in () if single else ("verdict", "change, + is worse"):
        table.add_column(name)
    for row in rows:
        numbers = (format_number(value) for value in (row.old, row.new))
        words = () if single else (Text(row.word, STYLES[row.word]), row.format_change() or row.note)
        table.add_row(row.metric, *numbers, *words)
    return table


def _write_overlay(folders: Sequence[Path], out: Path, *, force: bool, console: Console) -> None:
    """Write a results folder with the estimators of all."""
    begun = time.perf_counter()
    if any((folder / store.CAMPAIGN_RESULT).is_file() for folder in folders):
        raise ConfigError(
            f"{out}: only results folders are drawn over each other, not campaigns; leave -o out"
        )
    names = [folder.resolve().name for folder in folders]
    if len(set(names)) < len(names):
        names = [str(folder) for folder in folders]
    merged = merge_results({name: store.load(folder) for name, folder in zip(names, folders, strict=True)})
    api.save(merged, out, force=force, say=console.print)
    print_end(console, out, begun)
