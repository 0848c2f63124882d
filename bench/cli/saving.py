"""Write a result into its folder: first what was computed, then what shows it."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from bench.core.files import durable
from bench.core.records.run_result import RunResult
from bench.core.words.exceptions import ConfigError, NothingToShowError, ViewsFailedError
from bench.core.words.wording import one_line
from bench.io import results


def write_result(
    result: RunResult,
    folder: str | Path,
    *,
    recording: bool = True,
    report: bool = True,
    force: bool = False,
    say: Callable[[str], object] = lambda text: None,
) -> Path:
    """Write a result and its records into a results folder, completely or not at all, and return the folder.

    Recording and report come after them: if one fails, the results are there, and so is the other.

    Parameters
    ----------
    result : RunResult
        From :func:`run`, `bench.navigate` or `bench.read_result`, which reads the folder back.
    recording, report : bool
        Also write ``flight.rrd``, ``report.html``.
    force : bool
        Replace an existing results folder.
    say : callable
        Called with the reason if there is no recording.

    Raises
    ------
    bench.ConfigError
        If the folder cannot be made or must not be replaced, or the result has no records.
    OSError
        If the results cannot be written; nothing is left behind.
    bench.core.words.exceptions.ViewsFailedError
        If the recording or the report failed; the results are written.
    """
    folder = Path(folder)
    if result.sensed is None:
        raise ConfigError("bench.write_result: the result has no sensor data")
    results.check_folder(folder, force=force)
    with results.make_folder(folder, force=force) as partial:
        results.save(partial, result)
    views: list[tuple[str, str, Callable[[], object]]] = []
    if recording:
        views.append(("recording", "record", lambda: _write_recording(folder, result, say)))
    if report:
        views.append(("report", "report", lambda: write_report(folder, result)))
    failed = []
    for what, verb, write in views:
        try:
            write()
        except Exception as error:  # whatever a library of pictures raises, the results are worth more
            reason = one_line(f"{type(error).__name__}: {error}")
            failed.append(f"the {what} failed, {reason[:300]}; bench {verb} {folder} makes it again")
    if failed:
        raise ViewsFailedError(f"{folder}: the results are written, but {'; '.join(failed)}")
    return folder


def _write_recording(folder: Path, result: RunResult, say: Callable[[str], object]) -> None:
    from bench.views import recording

    try:
        recording.write(folder / results.RECORDING, result.name or folder.name, result)
    except NothingToShowError as error:
        say(f"No recording: {error}.")
    else:
        results.add_to_mark(folder, results.RECORDING)


def write_report(folder: Path, result: RunResult) -> None:
    """Write the page of a run into its folder."""
    from bench.views.report import page

    durable.write(folder / results.REPORT, page.make_page(folder.name, result))
    results.add_to_mark(folder, results.REPORT)
