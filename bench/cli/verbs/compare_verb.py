"""The verb compare: finished results side by side."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.text import Text

from bench.cli.saving import write_result
from bench.cli.verbs.check_verb import tabulate_verdicts
from bench.cli.verbs.flight_verbs import print_end
from bench.cli.verbs.printing import print_findings, print_table
from bench.core.files import durable
from bench.core.records.findings.looks import find_look
from bench.core.words.exceptions import ConfigError
from bench.core.words.stages import Progress
from bench.core.words.wording import format_number
from bench.evaluation.ensembles.ensemble import qualify
from bench.evaluation.metrics.key_figures import is_key_figure
from bench.evaluation.metrics.metric_words import name_metric
from bench.experiments.baselines.comparing import ONE_DRAW, Compared, compare_results
from bench.experiments.campaigns.merging import merge_campaigns
from bench.experiments.campaigns.stored import read_campaign
from bench.io import results
from bench.views.plots.overlay import merge_results
from bench.views.report import campaign_page

_MAIN = ("pos_rmse_h_m", "pos_rmse_d_m", "vel_rmse_3d_mps", "heading_rmse_deg", "nees_mean")
"""Metrics that are printed without being asked for."""


def compare(
    folders: Sequence[Path], *, console: Console, out: Path | None, force: bool, whole: bool = False
) -> list[Compared]:
    """Compare the first folder with the others and print the comparison; ``out`` gets all as one result.

    All key figures are printed of the ``whole``, else the main ones.
    """
    if out is not None:
        results.check_folder(out, force=force)
    begun = time.perf_counter()
    compared = compare_results(folders)
    notes: list[str] = []
    if out is not None:
        _write_overlay(folders, compared, out, force=force, progress=lambda now: notes.append(str(now)))
    for one in compared:
        _print_compared(console, one, whole)
    print_findings(console, notes)
    if out is not None:
        print_end(console, out, begun)
    return compared


def _print_compared(console: Console, one: Compared, whole: bool) -> None:
    console.print(Text(f"{one.first} beside {one.other}", "bold"), soft_wrap=True)
    for text in one.differences:
        console.print(f"  differs: {text}", soft_wrap=True)
    shown = [row for row in one.verdicts if (is_key_figure(row.metric) if whole else row.metric in _MAIN)]
    for profile, estimator in dict.fromkeys((row.profile, row.estimator) for row in shown):
        rows = [
            replace(row, metric=name_metric(row.metric))
            for row in shown
            if (row.profile, row.estimator) == (profile, estimator)
        ]
        own = len({one.first, one.other, "metric", "verdict"}) == 4
        heads = (one.first, one.other) if own else ("first", "second")
        print_table(console, tabulate_verdicts(rows, f"{estimator}, {profile}", heads))
    print_findings(console, one.sentences)
    if not whole:
        console.print("All key figures: --table")
    if all(row.note == ONE_DRAW for row in one.verdicts):
        return
    worse = sum(row.word == "worse" for row in one.verdicts)
    better = sum(row.word == "better" for row in one.verdicts)
    console.print(
        f"Of {len(one.verdicts)} metrics of {one.other}, {better} are better and {worse} worse, with 99 % "
        "confidence over all of them.",
        soft_wrap=True,
    )


def _write_overlay(
    folders: Sequence[Path],
    compared: Sequence[Compared],
    out: Path,
    *,
    force: bool,
    progress: Progress,
) -> None:
    """Write a results folder with the filters of all; of campaigns, a folder with the report alone."""
    names = [folder.resolve().name for folder in folders]
    if len(set(names)) < len(names):
        names = [str(folder) for folder in folders]
    by_name = dict(zip(names, folders, strict=True))
    tables = [_describe_comparison(one) for one in compared]
    of_campaigns = {(folder / results.CAMPAIGN_RESULT).is_file() for folder in folders}
    if of_campaigns == {True}:
        merged = merge_campaigns({name: read_campaign(folder) for name, folder in by_name.items()})
        with results.make_folder(out, force=force) as partial:
            text = campaign_page.make_page(" and ".join(names), merged, tables)
            durable.write(partial / results.REPORT, text)
    elif of_campaigns == {False}:
        result = merge_results({name: results.read_result(folder) for name, folder in by_name.items()})
        result = replace(result, more={**result.more, "comparisons": tables})
        write_result(result, out, force=force, progress=progress)
    else:
        raise ConfigError(f"{out}: a campaign and a single run are not drawn over each other; leave -o out")


def _describe_comparison(one: Compared) -> dict[str, Any]:
    """Return a comparison as the report shows it: sentences, and the rows of a table."""
    single = all(row.note == ONE_DRAW for row in one.verdicts)
    return {
        "first": one.first,
        "other": one.other,
        "sentences": list(one.sentences),
        "differences": list(one.differences),
        "single": single,
        "meaning": "One run each: no interval, so chance is not separated from a difference"
        if single
        else "Pooled over the runs. Change: of the second from the first, with its interval; above 0 is "
        f"worse. 99 % confidence over all rows{qualify(min((row.draws for row in one.verdicts), default=0))}",
        "rows": [
            {
                "estimator": row.estimator,
                "metric": name_metric(row.metric),
                "name": row.metric,
                "old": format_number(row.old),
                "new": format_number(row.new),
                "word": row.told,
                "kind": find_look(row.word).kind,
                "change": row.format_change() or row.note,
            }
            for row in one.verdicts
            if is_key_figure(row.metric)
        ],
    }
