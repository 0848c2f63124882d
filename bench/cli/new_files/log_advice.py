"""Apply the advice of the checks of a log: keys are changed, and kept only if the advised checks pass."""

from __future__ import annotations

import secrets
import stat
import tomllib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from rich.console import Console

from bench.cli.new_files.log_changes import list_changes, write_changes
from bench.core.files import durable
from bench.core.words.exceptions import BenchError, ConfigError
from bench.core.words.wording import format_value
from bench.pipeline import log_pipeline

_ROUNDS = 3  # a second mistake may show only after the first is gone


def apply_advice(name: str, console: Console, **log_options: Any) -> log_pipeline.RecordedLog:
    """Change a log as its checks advise, and return the log read again.

    Raises
    ------
    ConfigError
        If the log cannot be read, or has no line of its own for a table that is to be changed.
    """

    def say(line: str) -> None:
        console.print(line, soft_wrap=True, markup=False)

    path = Path(name)
    log = log_pipeline.read_log(name, **log_options)
    for _ in range(_ROUNDS):
        advised = [check for check in log.checks if not check.good and check.advice]
        text = _read(path)
        changed = list_changes(tomllib.loads(text), [check.advice for check in advised], path.parent)
        if not changed:
            break
        lines = [f"[{table}] {key} = {format_value(value)}" for (table, key), value in changed.items()]
        try:
            after = write_changes(text, changed)
        except ValueError as error:
            raise ConfigError(f"{name}: {error}: set by hand {'; '.join(lines)}, or remove --apply") from None
        try:
            still = _try(path, after, log_options)
            mended = len(still) < len(_list_wrong(log)) or still.isdisjoint(one.name for one in advised)
            why = "" if mended else f"these checks fail: {', '.join(sorted(still))}"
        except ConfigError as error:
            why = error.messages[0]
        if why:
            say(f"{name} is not changed: with the advice {why}")
            break
        _replace(path, text, after)
        log = log_pipeline.read_log(name, **log_options)
        for line in lines:
            say(f"{name}: {line}")
    return log


def _try(path: Path, text: str, log_options: Mapping[str, Any]) -> set[str]:
    """Return the names of the checks that fail with another text of a log, in a temporary file beside it."""
    trial = path.with_name(f"{path.stem}.{secrets.token_hex(8)}.toml")
    try:
        durable.write(trial, text)
        return _list_wrong(log_pipeline.read_log(str(trial), **log_options))
    except BenchError as error:
        raise ConfigError(error.messages[0].replace(trial.stem, path.stem)) from None
    finally:
        trial.unlink(missing_ok=True)


def _replace(path: Path, before: str, after: str) -> None:
    """Write another text of a log, unless its owner protects it or has changed it in the meantime."""
    path = path.resolve()  # a link stays a link
    mode = path.stat().st_mode
    if not mode & stat.S_IWUSR:
        raise ConfigError(f"{path.name}: is read-only: allow to write it, or remove --apply")
    if _read(path) != before:
        raise ConfigError(f"{path.name}: was changed in the meantime: run the command again")
    durable.write(path, after)
    path.chmod(mode)


def _read(path: Path) -> str:
    """Return the text of a log with its own line ends."""
    return path.read_bytes().decode("utf-8")


def _list_wrong(log: log_pipeline.RecordedLog) -> set[str]:
    return {check.name for check in log.checks if not check.good}
