"""Write a result into its folder: first what was computed, then what shows it."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from bench.core.files import durable
from bench.core.records.run_result import RunResult
from bench.core.words.exceptions import ConfigError, NothingToShowError, ViewsFailedError
from bench.core.words.stages import Progress, Stage, ignore
from bench.core.words.wording import one_line
from bench.io import results


def write_result(
    result: RunResult,
    folder: str | Path,
    *,
    recording: bool = True,
    report: bool = True,
    force: bool = False,
    progress: Progress | None = None,
) -> Path:
    """Write a result into a results folder, completely or not at all.

    Recording and report are written afterwards; if one fails, the results and the other one remain.

    Parameters
    ----------
    result : RunResult
        Result from `bench.run`, `bench.navigate` or `bench.read_result`.
    folder : str or Path
        Folder to write; `bench.read_result` reads it.
    recording, report : bool, optional
        Also write ``flight.rrd``, ``report.html``. Default: yes.
    force : bool, optional
        Replace an existing results folder.
    progress : callable, optional
        Called with a `Stage` that gives the reason if there is no recording.

    Returns
    -------
    Path
        The folder.

    Raises
    ------
    bench.ConfigError
        If the folder cannot be made or replaced, or the result has no records.
    OSError
        If the results cannot be written; nothing is left behind.
    bench.core.words.exceptions.ViewsFailedError
        If recording or report failed; the results are written.

    Examples
    --------
    >>> import bench, tempfile
    >>> result = bench.run("approach", estimators=["loose-15"], causes=False)
    >>> with tempfile.TemporaryDirectory() as place:
    ...     folder = bench.write_result(result, place + "/a", recording=False, report=False)
    ...     (folder / "result.json").is_file()
    True
    """
    folder = Path(folder)
    if result.sensed is None:
        raise ConfigError("bench.write_result: the result has no sensor data")
    results.check_folder(folder, force=force)
    with results.make_folder(folder, force=force) as partial:
        results.save(partial, result)
    views: list[tuple[str, str, Callable[[], object]]] = []
    if recording:
        views.append(("recording", "record", lambda: _write_recording(folder, result, progress or ignore)))
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


def _write_recording(folder: Path, result: RunResult, progress: Progress) -> None:
    from bench.views import recording

    try:
        recording.write(folder / results.RECORDING, result.name or folder.name, result)
    except NothingToShowError as error:
        progress(Stage(f"No recording: {error}."))
    else:
        results.add_to_mark(folder, results.RECORDING)


def write_report(folder: Path, result: RunResult) -> None:
    """Write the page of a run into its folder."""
    from bench.views.report import page

    durable.write(folder / results.REPORT, page.make_page(folder.name, result))
    results.add_to_mark(folder, results.REPORT)
