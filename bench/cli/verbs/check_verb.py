"""The verb check: compare with baselines, or record them."""

from __future__ import annotations

import contextlib
import os
from collections import Counter
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, get_args

from rich.console import Console
from rich.text import Text

from bench.cli.new_files.new_log import RECORDINGS
from bench.cli.verbs.console import PlainConsole
from bench.cli.verbs.flight_verbs import find_own_estimators
from bench.cli.verbs.log_campaign import list_recordings
from bench.cli.verbs.printing import print_findings, print_table
from bench.core.records.findings import FindingTable
from bench.core.words.exceptions import ConfigError
from bench.core.words.stages import Progress, Stage
from bench.experiments.baselines import checking
from bench.experiments.baselines.annotations import MOVED, annotate
from bench.experiments.baselines.comparing import ONE_DRAW
from bench.experiments.baselines.junit import write_junit
from bench.experiments.baselines.verdict_rows import LOOKS, MATCHES, OTHER_TRUTH, Verdict, Word
from bench.experiments.campaigns.pools import count_processors
from bench.io.config.listing import PROFILES
from bench.io.config.log import is_datasheet

_MOST_NAMES = 8  # of metrics that are undecided
_WORDS = (*get_args(Word)[::-1], "within tolerance")


def list_sources(sources: Sequence[str], console: Console) -> list[str]:
    """Return the profiles and logs among files, and the logs of recordings and folders, written if missing.

    Datasheets are left out, which lie beside logs; a recording that cannot be read is, too, with a line.

    Raises
    ------
    ConfigError
        If a folder holds neither a log nor a recording that can be read.
    """
    found: dict[str, None] = {}
    for source in sources:
        path = Path(source)
        shipped = (PROFILES / f"{source}.toml").is_file()
        if not shipped and (path.is_dir() or path.suffix.lower() in RECORDINGS):
            logs = [one for one in list_recordings(path, console) if one.suffix == ".toml"]
            if not logs:
                raise ConfigError(f"{source}: no LOG.toml here, nor a recording that can be read")
            found |= dict.fromkeys(map(str, logs))
        elif path.suffix != ".toml" or not is_datasheet(path):
            found[source] = None
    return list(found)


def record(profiles: Sequence[str], *, console: Console, jobs: int | None = None, **options: Any) -> None:
    """Measure profiles and write their baselines; options as for `checking.record_baselines`.

    If ``jobs`` is None there is a process for each processor.
    """
    find_own_estimators()
    with _show_runs(console) as progress:
        paths = checking.record_baselines(
            list_sources(profiles, console),
            progress=progress,
            jobs=jobs or count_processors(),
            **options,
        )
    for path in paths:
        console.print(f"Wrote {path}.")
    console.print(f"See {paths[0].parent / checking.CHANGES} for what moved.")


def check(
    profiles: Sequence[str],
    *,
    console: Console,
    junit: Path | None,
    strict: bool,
    jobs: int | None = None,
    **options: Any,
) -> list[Verdict]:
    """Check profiles, print and return the verdicts; options as for `bench.check` and :func:`record`."""
    find_own_estimators()
    with _show_runs(console) as progress:
        verdicts = checking.check(
            list_sources(profiles, console), progress=progress, jobs=jobs or count_processors(), **options
        )
    if junit is not None:
        write_junit(junit, verdicts, strict=strict)
    print_verdicts(console, verdicts)
    for line in annotate(verdicts, Path(options["directory"]), os.environ, strict=strict):
        console.file.write(f"{line}\n")  # as it is: no wrapping, no style
    return verdicts


@contextlib.contextmanager
def _show_runs(console: Console) -> Iterator[Progress]:
    """Provide a function that shows the current run of a profile, and prints remarks."""
    with PlainConsole(stderr=True).status("") as status:

        def show(now: Stage) -> None:
            if now.total is None:
                console.print(now.words)
            else:
                status.update(Text(f"{now.words}: run {min(now.done + 1, now.total):.0f} of {now.total:.0f}"))

        yield show


def print_verdicts(console: Console, verdicts: Sequence[Verdict]) -> None:
    """Print a table of the metrics that are better or worse for each filter; name the undecided."""
    groups = dict.fromkeys((row.profile, row.estimator) for row in verdicts)
    for profile, estimator in groups:
        rows = [row for row in verdicts if (row.profile, row.estimator) == (profile, estimator)]
        proven = [row for row in rows if row.word in ("better", "worse")]
        undecided = [row.metric for row in rows if row.word == "undecided"]
        counts = Counter[str](row.told for row in rows)
        words = ", ".join(f"{counts[word]} {word}" for word in _WORDS if counts[word])
        draws = max(row.draws for row in rows)
        how = next((f"; {match}" for match in MATCHES if any(row.note.endswith(match) for row in rows)), "")
        console.print(f"{profile}, {estimator}: {words} ({draws} runs{how})", soft_wrap=True)
        rare = max((row.rare for row in proven), default="")
        if proven:
            print_table(console, tabulate_verdicts(proven))
        if rare:
            console.print(f"Intervals of RMSEs hold{rare.removeprefix(',')}.", style="dim")
        if undecided:
            more = len(undecided) - _MOST_NAMES
            rest = f" and {more} more (--json has their intervals)" if more > 0 else ""
            console.print(f"undecided: {', '.join(undecided[:_MOST_NAMES])}{rest}", soft_wrap=True)
    for profile in dict.fromkeys(row.profile for row in verdicts if row.note.endswith(OTHER_TRUTH)):
        console.print(MOVED.format(profile), style="yellow", soft_wrap=True)
    if any(row.word == "undecided" and row.draws < LOOKS[-1] for row in verdicts):
        console.print(f"Baselines of {LOOKS[-1]} runs would decide more: --record with the code of before.")
    worse = [row for row in verdicts if row.word == "worse"]
    print_findings(console, [row.sentence for row in worse[:5]])
    if len(worse) > 5:
        console.print(f"{len(worse) - 5} more are worse.")
    profiles = list(dict.fromkeys(row.profile for row in verdicts))
    if len(profiles) > 1:
        console.print(_count_profiles(verdicts, profiles), soft_wrap=True)


def _count_profiles(verdicts: Sequence[Verdict], profiles: Sequence[str]) -> str:
    """Return the numbers and names of the profiles or logs with a worse, better or undecided metric."""
    parts = []
    for word in ("worse", "better", "undecided"):
        names = list(dict.fromkeys(row.profile for row in verdicts if row.word == word))
        if names:
            more = f" and {len(names) - _MOST_NAMES} more" if len(names) > _MOST_NAMES else ""
            parts.append(
                f"{word} on {len(names)} of {len(profiles)} ({', '.join(names[:_MOST_NAMES])}{more})"
            )
    whole = "the same" if all(row.told == "same" for row in verdicts) else "within tolerance"
    return "; ".join(parts) or f"{whole} on all {len(profiles)}"


def tabulate_verdicts(
    rows: Sequence[Verdict], title: str = "", heads: tuple[str, str] = ("before", "now")
) -> FindingTable:
    """Return a table of verdicts; without verdict words for single runs."""
    columns: dict[str, Sequence[Any]] = {
        "metric": [row.metric for row in rows],
        heads[0]: [row.old for row in rows],
        heads[1]: [row.new for row in rows],
    }
    if any(row.note != ONE_DRAW for row in rows):
        notes = ["" if row.note in MATCHES else row.note for row in rows]
        columns["verdict"] = [row.word for row in rows]
        columns["change, + is worse"] = [
            "; ".join(filter(None, [row.format_change(), note]))
            for row, note in zip(rows, notes, strict=True)
        ]
    return FindingTable("verdicts", title, columns)
