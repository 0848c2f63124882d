"""Run a study by its name."""

from __future__ import annotations

import shlex
import time
from pathlib import Path
from typing import Any

from bench.core.records.findings import Findings, StudyResult
from bench.core.words.exceptions import ConfigError
from bench.core.words.stages import Progress, Stage
from bench.core.words.wording import suggest
from bench.experiments.campaigns.pools import count_processors
from bench.experiments.studies import StudyEntry, find_studies, import_study
from bench.experiments.studies.study import StudyOptions, StudyWorkers, make_command, read_options
from bench.io import results
from bench.io.results.study_folder import write_study


def find_study(name: str) -> tuple[StudyEntry, Any]:
    """Return the entry and the module of a study.

    Raises
    ------
    ConfigError
        If there is none of this name, or another package gives what is no study.
    """
    known = find_studies()
    if name not in known:
        raise ConfigError(f"study {name!r} is unknown{suggest(name, known, 'studies')}")
    module = import_study(name)
    options = getattr(module, "Options", None)
    if not (isinstance(options, type) and issubclass(options, StudyOptions)):
        raise ConfigError(f"study {name!r} {known[name].question}: its module has no Options, a StudyOptions")
    return known[name], module


def study(
    name: str,
    *,
    jobs: int | None = None,
    out: str | Path | None = None,
    force: bool = False,
    progress: Progress | None = None,
    **options: Any,
) -> StudyResult:
    """Run a study and return its answer.

    Parameters
    ----------
    name : str
        Name of a study; see `bench.list_studies`.
    jobs : int, optional
        Number of processes. Default: the number of processors.
    out : str or Path, optional
        Folder for tables, figures and ``study.json``. Default: none.
    force : bool, optional
        Replace the study in the folder.
    progress : callable, optional
        Called with a `Stage`: activity, finished parts, number of parts.
    **options
        Options of the study; ``bench study NAME --help`` prints them.

    Returns
    -------
    StudyResult
        ``findings`` with ``verdicts``, tables and figures; ``frame(table)`` is a DataFrame.

    Raises
    ------
    bench.ConfigError
        If the name or an option is wrong, or the folder cannot be made.

    Examples
    --------
    >>> import bench
    >>> bench.study("requirements").findings.verdicts[0].startswith("For 5 m, 60 s without GNSS allow")
    True
    """
    entry, module = find_study(name)
    chosen = read_options(name, module.Options, options)
    if out is not None:
        results.check_folder(Path(out), force=force, kind=results.STUDY)
    begun = time.perf_counter()

    def show(what: str, done: int, of: int) -> None:
        if progress:
            progress(Stage(what, done, of, "parts"))

    with StudyWorkers(jobs or count_processors(), show) as work:
        findings = module.run(chosen, work)
    if not isinstance(findings, Findings):
        what = type(findings).__name__
        raise ConfigError(f"study {name!r} {entry.question}: run gives no Findings, but {what}")
    result = StudyResult(
        name,
        entry.question,
        shlex.join(make_command(name, chosen)),
        chosen.model_dump(),
        findings,
        results.provenance(),
        time.perf_counter() - begun,
    )
    if out is not None:
        write_study(Path(out), result, force=force)
    return result
