"""Display of a result in a notebook: sentences, and tables of at most a screen, as HTML without scripts."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from html import escape
from importlib import import_module
from typing import Any, NamedTuple

from bench.core.words.exceptions import BenchError
from bench.core.words.wording import format_number

MOST_ROWS = 30
"""Rows of a table that a notebook shows."""


class ShownFigure(NamedTuple):
    """A figure for display."""

    text: str
    bounds: str = ""  # or interval
    outside: bool = False  # of its bounds

    def __str__(self) -> str:
        """Return the text, a mark if it is outside of its bounds, and these."""
        return f"{self.text}{' !' if self.outside else ''}{f' ({self.bounds})' if self.bounds else ''}"


class ShownText(NamedTuple):
    """A text for display, with the class of a verdict, a tip and a link."""

    text: str
    kind: str = ""  # class of a verdict
    tip: str = ""  # shown below the pointer
    link: str = ""  # the page it leads to
    code: bool = False  # a command

    def __str__(self) -> str:
        """Return the text."""
        return self.text


def write_sentences(texts: Iterable[str]) -> str:
    """Return a paragraph for each text that is not empty."""
    return "".join(f"<p>{escape(text)}</p>" for text in texts if text)


def write_table(caption: str, columns: Mapping[str, Sequence[Any]]) -> str:
    """Return columns as a table with its caption; a line counts the rows left out.

    Numbers have four digits, None is a dash, and a :class:`ShownFigure` outside of its bounds is red.
    """
    rows = list(zip(*columns.values(), strict=True))
    lines = ["".join(f"<th>{escape(name)}</th>" for name in columns)]
    lines += ["".join(_write_cell(value) for value in row) for row in rows[:MOST_ROWS]]
    body = "".join(f"<tr>{line}</tr>" for line in lines)
    left = len(rows) - MOST_ROWS
    more = f"<p>{left} more rows</p>" if left > 0 else ""
    return f"<table><caption>{escape(caption)}</caption>{body}</table>{more}"


def _write_cell(value: object) -> str:
    style = ' style="color:red"' if isinstance(value, ShownFigure) and value.outside else ""
    return f"<td{style}>{escape(format_cell(value))}</td>"


def format_cell(value: object) -> str:
    """Return a number with four digits, None as a dash, anything else as it is."""
    return format_number(value) if isinstance(value, float) or value is None else str(value)


def make_frame(columns: Mapping[str, Any]) -> Any:
    """Return columns as a pandas.DataFrame; raise a `BenchError` if pandas is not installed."""
    return load_pandas().DataFrame(dict(columns))


def load_pandas() -> Any:
    """Return the module pandas, which bench does not install; raise `BenchError` if it is missing."""
    try:
        return import_module("pandas")
    except ImportError:
        raise BenchError("a frame needs pandas: pip install pandas") from None


_drawers: list[Callable[..., Any]] = []


def set_drawer(drawer: Callable[..., Any]) -> None:
    """Set the function that draws results; `bench.views` does it."""
    _drawers[:] = [drawer]


def draw(result: Any, *chosen: Any, **look: Any) -> Any:
    """Draw a result, as `bench.views.report.paper.plot_result` does.

    Raises
    ------
    RuntimeError
        If `bench.views` was not imported.
    """
    if not _drawers:
        raise RuntimeError("import bench.views: it draws results")
    return _drawers[0](result, *chosen, **look)
