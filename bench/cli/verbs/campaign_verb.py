"""The verbs campaign and card: progress while the runs go on, then figures and sentences."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.text import Text

from bench.cli.verbs.card_screen import print_card
from bench.cli.verbs.console import show_bar
from bench.cli.verbs.flight_verbs import find_own_estimators
from bench.cli.verbs.printing import print_findings, print_table, print_wrapped
from bench.core.records.findings import FindingTable
from bench.core.records.findings.looks import find_look
from bench.core.records.specs import Guard
from bench.core.words.notebook import ShownFigure
from bench.core.words.stages import Progress
from bench.evaluation.ensembles.ensemble import qualify
from bench.evaluation.metrics.metric_words import find_words, name_metric
from bench.experiments.baselines.junit import check_required, write_requirements
from bench.experiments.campaigns import plan, running
from bench.experiments.campaigns.outcome import RATIO, Campaign, Outcome, tabulate
from bench.experiments.card.card_comparison import ComparedLine, compare_cards, list_differences, name_cards
from bench.experiments.card.card_making import (
    Card,
    describe_suite,
    make_card,
    read_card,
    verify_card,
    write_suite,
)
from bench.io import results
from bench.io.config.profile import make_choice
from bench.views.report import card_page, page
from bench.views.report.writing import write_report

CAMPAIGNS, CARDS = Path("campaigns"), Path("cards")
"""Default folders for campaigns, and for the runs of cards."""

_IN_ROWS = ("pos_rmse_h_m", "heading_rmse_deg")  # of the table of conditions
_IN_WORDS = {"pos_rmse_h_m": "horizontal", "heading_rmse_deg": "heading"}
_MOST_FAILURES = 5  # that are printed


def run_campaign(
    profile: str,
    *,
    console: Console,
    out: Path | None,
    jobs: int | None,
    scheduler: str | None,
    force: bool,
    resume: bool,
    report: bool,
    junit: Path | None,
    **options: Any,
) -> Campaign:
    """Run a campaign, write its report and what is required to ``junit``, print and return it.

    The options are those of `bench.experiments.campaigns.plan.plan_runs`.
    If ``out`` is None the folder is ``campaigns/<profile>-<seed>``.
    """
    find_own_estimators()
    planned = plan.plan_runs(profile, **options)
    check_required(junit, any(cell.profile.document.get("requirement") for cell in planned.cells))
    folder = out or CAMPAIGNS / f"{planned.name}-{planned.cells[0].profile.seed}"
    with _show_progress(planned.name) as progress:
        result = running.run_campaign(
            planned,
            jobs=jobs,
            scheduler=scheduler,
            folder=folder,
            force=force,
            resume=resume,
            progress=progress,
        )
    if report:
        write_report(folder)
    if junit is not None and not result.interrupted:
        write_requirements(junit, Path(profile).stem, result.requirements)
    print_campaign(console, result)
    if (folder / running.PRINTED).is_file():
        console.print(f"Output of filters: {folder / running.PRINTED}", soft_wrap=True)
    if report:
        console.print(f"         {folder / results.REPORT}  report, one file to share", soft_wrap=True)
    return result


@contextlib.contextmanager
def _show_progress(name: str) -> Iterator[Progress]:
    """Provide a function that shows how far a campaign is, on a terminal."""
    with show_bar(f"flying {name}") as show:
        yield lambda now: show(name, now.done, now.total, str(now))


def print_campaign(console: Console, result: Campaign, *, table: bool = False) -> None:
    """Print the statistics, as a full table if requested, the sentences and the paths of the files."""
    several = len({one.condition for one in result.outcomes}) > 1
    if result.outcomes and (several or table):
        print_table(console, _tabulate(result, several=several))
    if result.outcomes and not (several or table):
        print_table(console, _summarize(result.outcomes))
    if result.outcomes:
        note = f"Pooled over all runs that converged; 95 % intervals (NEES 98 %){qualify(result.fewest)}"
        print_wrapped(console, f"{note}.", "dim")
    sentences = [one.sentence for one in result.requirements] if several else result.sentences
    lost = [f"{one.condition}: {one.sentences[0]}" for one in result.outcomes if one.lost] if several else []
    if several:
        console.print(
            f"{results.CAMPAIGN_RESULT} has the verdicts and large runs of each condition.", style="dim"
        )
    if table and not several:
        sentences = (
            *sentences,
            *(f"{one.label}, {text}" for one in result.outcomes for text in one.scatter[1:]),
        )
    print_findings(console, sentences)
    _print_failures(console, lost, f"conditions have such runs; {results.CAMPAIGN_RESULT} says why.")
    failures = [f"failed: {reason}; {command}" for command, reason in result.failed.items()]
    _print_failures(console, failures, "failed.")
    if result.damaged:
        console.print(f"Journal, damaged lines and parts: {result.damaged}. Their runs were repeated.")
    missing = result.planned - result.finished
    done = f"{result.finished} of {result.planned} runs" if missing else f"{result.finished} runs"
    if not table:
        console.print(f"Results  {result.folder}: {done} ({result.timing['wall_s']:.1f} s)", soft_wrap=True)
        console.print(f"Next     bench show {result.folder}  all metrics", soft_wrap=True)
    if missing:
        console.print("Continue with the same command and --resume.")


def _tabulate(result: Campaign, *, several: bool) -> FindingTable:
    """Return a column for each filter, or a row for each condition and estimator."""
    ran = result.outcomes
    found = _IN_ROWS if several else dict.fromkeys(name for one in ran for name in one.errors)
    names = {name_metric(name): name for name in found}
    if several or any(one.consistency for one in ran):
        names[RATIO] = RATIO
    if several:
        return tabulate(ran, names)
    columns = {one.label: [one.show(name) for name in names.values()] for one in ran}
    return FindingTable("estimators", "", {"": list(names), **columns})


def _summarize(outcomes: Sequence[Outcome]) -> FindingTable:
    """Return the main errors of each filter, their intervals and the verdict."""
    columns: dict[str, list[Any]] = {
        "filter": [one.label for one in outcomes],
        "converged": [ShownFigure(f"{one.converged_runs}/{one.runs}") for one in outcomes],
    }
    for metric, words in _IN_WORDS.items():
        shown = [one.show(metric, 3) for one in outcomes]
        if any(shown):
            columns[f"{words}\nRMS [{find_words(metric).unit}]"] = [
                ShownFigure(
                    "-"
                    if each is None
                    else f"{each.text} ({each.bounds})"
                    if metric == "pos_rmse_h_m"
                    else each.text
                )
                for each in shown
            ]
    found = [one.consistency.word if one.consistency else "" for one in outcomes]
    if any(found):
        ratios = [one.show(RATIO, 3) for one in outcomes]
        columns["NEES\n/ideal"] = [ShownFigure(one.text if one else "-") for one in ratios]
        columns["verdict"] = [f"{find_look(word).mark} {word}" if word else "–" for word in found]
    return FindingTable("filters", "", columns)


def run_card(
    estimator: str,
    *,
    console: Console,
    out: Path | None,
    html: Path | None,
    junit: Path | None,
    force: bool,
    runs: Path | None,
    resume: bool,
    table: bool = False,
    **options: Any,
) -> Card:
    """Make the card of a filter, print it and write it; for ``options`` see `bench.make_card`.

    ``table`` prints every line of the card.
    Runs are kept in ``cards/<label>-<extent>`` or in ``runs``; only ``resume`` takes those that are there.
    """
    find_own_estimators()
    seed = options["seed"]
    words = [options["label"] or make_choice(estimator).label, "quick" if options["quick"] else "full"]
    kept = runs or CARDS / "-".join([*words, *([] if seed is None else [str(seed)])])
    if out is not None:
        results.check_file(out, force=force)
    if html is not None:
        page.check_page(html, force=force)
    check_required(junit, options["requirements"])
    with _show_progress(f"card of {estimator}") as progress:
        try:
            card = make_card(estimator, runs=kept, resume=resume, progress=progress, **options)
        except KeyboardInterrupt:
            console.print(f"{kept} has the finished runs; the same command with --resume continues.")
            raise
    if out is not None:
        results.write_json(out, card.model_dump())
    if html is not None:
        card_page.write_card(html, card)
    if junit is not None:
        write_requirements(junit, card.estimator, card.findings)
    print_card(console, card)
    if table:
        print_findings(console, card.sentences)
    for path in (out, html):
        if path is not None:
            console.print(f"Wrote {path}.")
    return card


def _print_failures(console: Console, texts: Sequence[str], rest: str) -> None:
    """Print the first of some failures, and how many more there are."""
    print_findings(console, [Text(text, "red") for text in texts[:_MOST_FAILURES]])
    if len(texts) > _MOST_FAILURES:
        console.print(f"{len(texts) - _MOST_FAILURES} more {rest}")


def check_card(path: Path, guard: Guard, jobs: int | None, *, console: Console) -> list[str]:
    """Repeat drawn runs of the card in a file; print and return what differs."""
    find_own_estimators()
    card = read_card(path)
    with _show_progress(f"card of {card.estimator}") as progress:
        found = verify_card(card, guard=guard, jobs=jobs, progress=progress)
    print_findings(
        console,
        [Text(one, "red") for one in found] or [f"{path}: the repeated runs equal the card."],
    )
    return found


def write_sensors(folder: Path, *, quick: bool, console: Console) -> None:
    """Write the sensor data of the suite, and print the next step."""
    write_suite(folder, quick=quick)
    written = f"Wrote {folder}: a folder for each run, with its tables in sensors/."
    extent = " --quick" if quick else ""
    print_findings(
        console, [written, f"Next: solution.csv into each, then bench card -e file:{folder}{extent}"]
    )


def print_comparison(paths: tuple[Path, Path], *, console: Console) -> list[ComparedLine]:
    """Print and return how the cards in two files differ."""
    first, second = (read_card(path) for path in paths)
    names = name_cards((first, second), [str(path) for path in paths])
    found = compare_cards(first, second, names)
    different = list_differences(first, second)
    versions = Text(f"Made with other versions: {', '.join(different)}.", "yellow")
    head = f"{names[0]} and {names[1]}: {describe_suite(first)}"
    print_findings(console, [head, *([versions] if different else []), *(one.sentence for one in found)])
    return found
