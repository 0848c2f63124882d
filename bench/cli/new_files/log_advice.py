"""Apply the advice of the checks of a log: keys are changed, and kept only if the advised checks pass."""

from __future__ import annotations

import tomllib
from pathlib import Path
from typing import Any

from rich.console import Console

from bench.cli.new_files.log_changes import list_changes, write_changes
from bench.core.files import durable
from bench.core.words.exceptions import ConfigError
from bench.pipeline import log_pipeline

_ROUNDS = 3  # a second mistake may show only after the first is gone


def apply_advice(name: str, console: Console, **log_options: Any) -> log_pipeline.RecordedLog:
    """Change a log as its checks advise, and return the log read again.

    Raises
    ------
    ConfigError
        If the log cannot be read, or has no line of its own for a table that is to be changed.
    """
    path = Path(name)
    log = log_pipeline.read_log(name, **log_options)
    for _ in range(_ROUNDS):
        advice = [check.advice for check in log.checks if not check.good and check.advice]
        text = path.read_text(encoding="utf-8")
        changed = list_changes(tomllib.loads(text), advice)
        if not changed:
            break
        try:
            after = write_changes(text, changed)
        except ValueError as error:
            raise ConfigError(f"{name}: {error}: change the keys by hand, or remove --apply") from None
        trial = path.with_name(f"{path.stem}.applied.toml")
        try:
            durable.write(trial, after)
            new = log_pipeline.read_log(str(trial), **log_options)
            before, still = _list_wrong(log), _list_wrong(new)
            if len(still) >= len(before) and still & {one.name for one in log.checks if one.advice}:
                console.print(f"{name} is not changed: with the advice applied as many checks fail.")
                break
            durable.write(path, after)
        finally:
            trial.unlink(missing_ok=True)
        log = log_pipeline.read_log(name, **log_options)
        for (table, key), value in changed.items():
            console.print(f"{name}: [{table}] {key} = {value}", soft_wrap=True, markup=False)
    return log


def _list_wrong(log: log_pipeline.RecordedLog) -> set[str]:
    return {check.name for check in log.checks if not check.good}
