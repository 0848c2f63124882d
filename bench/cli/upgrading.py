"""The verb upgrade: rewrite files of an earlier format with the names of today."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path

from rich.console import Console

from bench.core.files import durable
from bench.core.files.file_checks import read_json
from bench.core.words.exceptions import ConfigError
from bench.core.words.renames import FORMAT, rename
from bench.io.results import RESULT

_MARKS = ("suite_hash", "truth", "provenance")
"""Keys by which a card, a baseline and a result are known."""
_BEGIN = re.compile(r'^(\s*\{)(\s*)(?:"format"\s*:\s*\d+\s*,\s*)?')
"""Begin of a file, with the number of an earlier format."""


def upgrade(paths: Sequence[Path], *, console: Console) -> None:
    """Rewrite baselines, cards, results folders and TOML files as text, so that no digit of a value changes.

    Raises
    ------
    ConfigError
        If a file is none of these. The files before it are rewritten.
    """
    for path in paths:
        file = path / RESULT if path.is_dir() else path
        known = {} if file.suffix == ".toml" else read_json(file)
        if file.suffix != ".toml" and not known.keys() & set(_MARKS):
            raise ConfigError(f"{file}: expected a baseline, a card or {RESULT}. Only these have a format")
        try:
            before = file.read_bytes().decode("utf-8")
        except (OSError, ValueError) as error:
            raise ConfigError(f"{file}: cannot be read: {error}") from None
        old = known.get("format") != FORMAT
        text = rename(before) if old else before
        if known and old:
            text = _BEGIN.sub(rf'\1\2"format": {FORMAT},\2', text, count=1)
        if text != before:
            durable.write(file, text)
        console.print(f"{file}: {'rewritten' if text != before else 'nothing to change'}", soft_wrap=True)
