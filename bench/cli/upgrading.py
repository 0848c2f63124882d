"""The verb upgrade: rewrite files of an earlier format with the names of today."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from rich.console import Console

from bench.core.files import durable
from bench.core.files.file_checks import read_json
from bench.core.words.exceptions import ConfigError
from bench.core.words.renames import FORMAT, rename, rename_all
from bench.experiments.baselines.baseline_file import to_text
from bench.io.results import RESULT, to_json

_MARKS = {"suite_hash": to_json, "truth": to_text, "provenance": to_json}
"""Key that a card, a baseline or a result has -> how its file is written."""


def upgrade(paths: Sequence[Path], *, console: Console) -> None:
    """Rewrite baselines, cards, results folders and TOML files; print what changed in each.

    Raises
    ------
    ConfigError
        If a file is none of these. The files before it are rewritten.
    """
    for path in paths:
        file = path / RESULT if path.is_dir() else path
        if file.suffix == ".toml":
            try:
                before = file.read_text(encoding="utf-8")
            except (OSError, ValueError) as error:
                raise ConfigError(f"{file}: cannot be read: {error}") from None
            text = rename(before)
        else:
            before, text = _upgrade_json(file)
        if text != before:
            durable.write(file, text)
        console.print(f"{file}: {'rewritten' if text != before else 'nothing to change'}", soft_wrap=True)


def _upgrade_json(file: Path) -> tuple[str, str]:
    """Return the text of a JSON file, and that of today."""
    document = read_json(file)
    write = next((write for mark, write in _MARKS.items() if mark in document), None)
    if write is None:
        raise ConfigError(f"{file}: expected a baseline, a card or {RESULT}. Only these have a format")
    before = file.read_text(encoding="utf-8")
    if document.get("format", 1) == FORMAT:
        return before, before
    return before, write({"format": FORMAT, **rename_all({**document, "format": FORMAT})})
