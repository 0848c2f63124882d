"""Export a run in the formats of other tools, each with a README that describes the files.

A format is a module of this folder with ``FORMATS`` (name -> title) and ``write(folder, outgoing, name)``,
which returns the text of the README; or one that an entry of ``bench.exports`` names. With
``NEEDS_START = True`` it gets the data from a complete initial state on, with ``NEEDS_LIKE = True`` a file
whose definitions it takes. It is listed nowhere else.
"""

from __future__ import annotations

import pkgutil
from collections.abc import Callable, Iterator, Mapping
from importlib import import_module
from pathlib import Path
from textwrap import fill
from typing import NamedTuple

from bench.core.files import durable
from bench.core.files.installed import find_installed, find_own, import_installed
from bench.core.words.exceptions import ConfigError
from bench.core.words.wording import suggest
from bench.io.exports.gather import gather
from bench.io.exports.outgoing import FRAMES, ExportData


class Format(NamedTuple):
    """A format in which a run can be exported."""

    title: str
    write: Callable[[Path, ExportData, str], str]  # (folder, data, name of the format) -> text of the README
    needs_start: bool
    needs_like: bool = False


def _find_formats() -> Iterator[tuple[str, Format]]:
    places = [f"{__name__}.{entry.name}" for entry in pkgutil.iter_modules(__path__)]
    for place in dict.fromkeys([*places, *find_own("exports").values()]):
        module = import_module(place)
        for name, title in getattr(module, "FORMATS", {}).items():
            yield (
                name,
                Format(
                    title,
                    module.write,
                    getattr(module, "NEEDS_START", False),
                    getattr(module, "NEEDS_LIKE", False),
                ),
            )


FORMATS: Mapping[str, Format] = dict(_find_formats())
"""Name of a format of bench -> the format."""


def list_formats() -> dict[str, str]:
    """Return the titles of the formats by name, formats of packages last; no package is imported."""
    added = find_installed("exports", FORMATS)
    return {name: one.title for name, one in FORMATS.items()} | {
        name: f"{one.place} of {one.package}" for name, one in added.items()
    }


def find_format(kind: str) -> Format:
    """Return a format by name.

    Raises
    ------
    ConfigError
        If there is none, or that of an installed package has no function ``write``.
    """
    if kind in FORMATS:
        return FORMATS[kind]
    added = find_installed("exports", FORMATS)
    if kind not in added:
        raise ConfigError(f"export format {kind!r} is unknown{suggest(kind, list_formats(), 'formats')}")
    module = import_installed("export format", added[kind], "write")
    title = getattr(module, "FORMATS", {}).get(kind, added[kind].place)
    needs = (bool(getattr(module, name, False)) for name in ("NEEDS_START", "NEEDS_LIKE"))
    return Format(title, module.write, *needs)


README = "README.md"
_WIDTH = 110


def write(folder: Path, kind: str, outgoing: ExportData, name: str) -> None:
    """Write a run in a format of `list_formats` into an empty folder, with a README that describes the files.

    Raises
    ------
    ExportError
        If the format cannot hold what was requested, or needs data that the run does not have.
    OSError
        If the file cannot be written.
    """
    begun, form = "", find_format(kind)
    if form.needs_start:
        outgoing, begun = outgoing.align()
    description = f"{form.write(folder, outgoing, kind).strip()}\n\n{begun}"
    clock = f"Time t is in seconds since the start of the run; where a date is needed, {outgoing.calendar}."
    text = _fill_paragraphs(f"# Export of {name} to {kind}\n\n{description.strip()}\n\n{clock} {FRAMES}\n")
    durable.write(folder / README, text)


def _fill_paragraphs(text: str) -> str:
    """Return Markdown with paragraphs and list items wrapped; headings, tables and code stay unchanged."""
    lines: list[str] = []
    open_text, code = False, False
    for line in text.splitlines():
        fence = line.startswith("```")
        as_it_is = code or fence or not line or line.startswith(("#", "|", "    "))
        code ^= fence
        if open_text and not as_it_is and not line.startswith("- "):
            lines[-1] += f" {line.strip()}"
        else:
            lines.append(line)
        open_text = not as_it_is
    return "".join(f"{_wrap_line(line)}\n" for line in lines)


def _wrap_line(line: str) -> str:
    if line.startswith(("#", "|", "    ")) or len(line) <= _WIDTH:
        return line
    hanging = "  " if line.startswith("- ") else ""
    return fill(line, _WIDTH, subsequent_indent=hanging, break_long_words=False, break_on_hyphens=False)


__all__ = [
    "FORMATS",
    "README",
    "ExportData",
    "Format",
    "find_format",
    "gather",
    "list_formats",
    "write",
]
