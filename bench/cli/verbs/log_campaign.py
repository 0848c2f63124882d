"""The verb campaign over logs: write missing logs of recordings, then run the study of logs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any

from rich.console import Console

from bench.cli.new_files.new_log import RECORDINGS, new_log
from bench.cli.verbs.flight_verbs import find_own_estimators
from bench.cli.verbs.study_verb import run_study
from bench.core.records.findings import StudyResult
from bench.core.words.exceptions import ConfigError
from bench.io.config.listing import PROFILES
from bench.io.config.log import is_datasheet, is_log


def are_logs(sources: Sequence[str]) -> bool:
    """Return whether a campaign runs over logs instead of a profile.

    Raises
    ------
    ConfigError
        If several sources are given and one is no log.
    """
    if len(sources) == 1 and (PROFILES / f"{sources[0]}.toml").is_file():
        return False
    logs = [
        path.is_dir()
        or path.suffix.lower() in RECORDINGS
        or (path.suffix == ".toml" and (is_log(path) or (len(sources) > 1 and is_datasheet(path))))
        for path in map(Path, sources)
    ]
    if len(sources) > 1 and not all(logs):
        other = sources[logs.index(False)]
        raise ConfigError(
            f"campaign: {other} is not a log. Put several profiles into CAMPAIGN.toml (bench guide campaigns)"
        )
    return all(logs)


_TAKEN = ("allow_code", "sources", "out", "jobs", "force", "report", "estimators", "overrides", "as_json")
"""Options of the verb that logs have, too."""


def run_logs(
    sources: Sequence[str],
    given: Sequence[tuple[str, str]],
    *,
    console: Console,
    out: Path | None,
    jobs: int | None,
    force: bool,
    report: bool,
    estimators: Sequence[str] | None,
    overrides: Mapping[str, Any],
    allow_code: bool,
    **others: Any,
) -> StudyResult:
    """Run filters on logs, print and return what was found; a recording without a log gets one first.

    ``given`` are name and flag of what was typed; ``others`` are options of profiles.

    Raises
    ------
    ConfigError
        If one of those is given, or no folder.
    """
    wrong = [flag for name, flag in given if name not in _TAKEN]
    if wrong:
        raise ConfigError(f"campaign: {wrong[0]} is for profiles, not for logs")
    if out is None:
        raise ConfigError("campaign: name the folder for the results of logs: -o DIR")
    find_own_estimators()
    found = [Path(source) for source in sources if not is_datasheet(Path(source))]
    logs = [str(path) for source in found for path in list_recordings(source, console)]
    if not logs:
        raise ConfigError(f"campaign: no LOG.toml in this folder, nor a recording: {sources[0]}")
    filters: dict[str, Any] = {"estimators": tuple(estimators)} if estimators else {}
    return run_study(
        "logs", console=console, out=out, report=report, jobs=jobs, force=force, logs=tuple(logs),
        allow_code=allow_code, overrides=overrides, **filters,
    )  # fmt: skip


def list_recordings(path: Path, console: Console) -> list[Path]:
    """Return the logs of a source, or of a folder; write the log of a recording if it does not exist.

    A recording that cannot be read, and so has no log, is returned itself.
    """
    if path.is_dir():
        held = sorted(one for one in path.iterdir() if one.suffix.lower() in RECORDINGS and one.is_file())
        for one, other in pairwise(held):
            if one.stem == other.stem:
                raise ConfigError(f"{one} and {other} would share {one.stem}.toml; rename one")
        logs = {log: None for one in held for log in list_recordings(one, console)}
        return list(logs | {one: None for one in sorted(path.glob("*.toml")) if is_log(one)})
    if path.suffix == ".toml":
        return [path]
    log = path.with_suffix(".toml")
    if not log.exists():
        try:
            new_log(str(path), console=console)
        except ConfigError as error:
            console.print(f"no log: {error}", style="yellow", soft_wrap=True)
            return [path]
    return [log]
