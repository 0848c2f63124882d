"""The verb fixes: solve the files of a receiver, print what was found, write fixes, report and recording.

It imports little: a day of a station is solved in less time than the rest of bench takes to load.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from rich.console import Console

from bench.cli.verbs.printing import MOST_ROWS, print_findings
from bench.core.records.findings import FindingTable
from bench.core.words.exceptions import ConfigError
from bench.io.results import check_file
from bench.plugins.receiver import rinex_fixes
from bench.plugins.receiver.receiver_settings import solve_rinex
from bench.plugins.receiver.receiver_streams.rtcm import has_observations
from bench.plugins.receiver.receiver_streams.sbf import has_ranges
from bench.plugins.receiver.rinex.lines import find_kind

_STREAMS = {"rtcm": has_observations, "sbf": has_ranges}  # that may have ephemerides alone
_MOST = 8  # satellites on the screen; all are in the report


def solve_fixes(
    files: Sequence[Path],
    *,
    console: Console,
    datum: str,
    out: Path | None,
    report: Path | None,
    recording: Path | None,
    force: bool,
    **options: Any,
) -> dict[str, Any]:
    """Solve receiver files, print and return the figures, and write fixes, report and recording.

    ``options`` are those of `bench.solve_rinex`; ``datum`` is that of the positions in ``out``.
    """
    if out is not None:
        check_file(out, force=force)
    if report is not None:
        from bench.plugins.receiver import fixes_page
        from bench.views.report import page

        page.check_page(report, force=force)
    if recording is not None:
        from bench.views.recording import check_recording

        check_recording(recording, force=force)
    kinds = {file: find_kind(file, str(file)) for file in files}
    observations = [file for file, kind in kinds.items() if kind in ("observations", "ubx", "gnsslogger")]
    streams = [file for file in files if kinds[file] in _STREAMS]
    observations += [file for file in streams if _STREAMS[kinds[file]](file, str(file))]
    navigation = [file for file, kind in kinds.items() if file not in observations]
    navigation = navigation or [file for file in observations if kinds[file] in ("ubx", *_STREAMS)]
    other = "; give the RINEX navigation file of the day, too"
    for found, words, more in (
        (observations, "observation", "; give one, such as RINEX, UBX or SBF"),
        (navigation, "navigation", other),
    ):
        if not found:
            raise ConfigError(f"{', '.join(map(str, files))}: no {words} file{more}")
    solved = solve_rinex(observations, navigation, **options)
    figures = solved.figures()
    title = f"{solved.name}: {solved.day}, {len(solved.fixes)} epochs"
    summary = FindingTable("fixes", title, {"figure": list(figures), "value": list(figures.values())})
    tables = [*_tabulate_satellites(solved), summary]
    _, verdict = solved.judge()
    sentences = [*solved.notes, *([verdict] if verdict else [])]
    try:
        if recording is not None:
            from bench.plugins.receiver import fixes_recording

            fixes_recording.find_shown(solved)  # rejected before anything is written
        if out is not None:
            solved.write_csv(out, datum)
            sentences.append(f"fixes in {datum}: {out}")
        if report is not None:
            from bench.core.files import durable

            durable.write(report, fixes_page.make_page(solved))
            sentences.append(f"Report: {report}")
        if recording is not None:
            fixes_recording.write_fixes(recording, solved)
            sentences.append(f"Recording: {recording}; look at it with: bench view {recording}")
    finally:
        print_findings(console, sentences, tables, MOST_ROWS)
    return figures | {"no_fix": solved.count_lost(), "verdict": verdict}


def _tabulate_satellites(solved: rinex_fixes.RinexFixes) -> list[FindingTable]:
    """Return how often the satellites with the largest residuals were used and left out, if any were."""
    all_of_them = solved.list_satellites()
    if not all_of_them:
        return []
    worst = sorted(all_of_them, key=lambda one: (-one.excluded, -one.residual_rms))[:_MOST]
    title = f"The {len(worst)} of {len(all_of_them)} satellites left out most often or with most residual"
    return [rinex_fixes.tabulate_satellites(worst, title)]
