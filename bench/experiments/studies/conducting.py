"""Run a study by its name."""

from __future__ import annotations

import shlex
import time
from pathlib import Path
from typing import Any

from bench.core.records.findings import Findings, StudyResult
from bench.core.words.exceptions import ConfigError
from bench.core.words.wording import suggest
from bench.experiments.campaigns.pools import count_processors
from bench.experiments.studies import StudyEntry, find_studies, import_study
from bench.experiments.studies.study import Progress, StudyOptions, StudyWorkers, make_command, read_options
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
    progress: Progress = lambda what, done, of: None,
    **options: Any,
) -> StudyResult:
    """Run a study and return what it found.

    Parameters
    ----------
    name : str
        One of ``bench list studies``.
    jobs : int or None
        Number of processes; None takes one for each processor.
    out : str, Path or None
        Folder for tables, figures and ``study.json``; None leaves nothing behind.
    force : bool
        Replace the study in the folder.
    progress : callable
        Called with what is being done, how many parts are done, and of how many.
    **options
        Those of the study; ``bench study NAME --help`` lists them.

    Raises
    ------
    bench.ConfigError
        If there is no such study, an option is wrong, or the folder cannot be made.
    """
    entry, module = find_study(name)
    chosen = read_options(name, module.Options, options)
    if out is not None:
        results.check_folder(Path(out), force=force, kind=results.STUDY)
    begun = time.perf_counter()
    with StudyWorkers(jobs or count_processors(), progress) as work:
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
