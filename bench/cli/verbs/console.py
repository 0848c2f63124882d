"""The terminal: all verbs print through this console, which removes control characters."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterable, Iterator
from typing import Any

from rich.console import Console, ConsoleOptions, RenderableType
from rich.segment import Segment

from bench.core.words.wording import replace_control

_WIDTH = 80  # of a screen that does not say how wide it is


class PlainConsole(Console):
    """A console for texts of other people: without markup, and without control and bidirectional characters.

    Titles, names and messages may come from a file. Whatever they hold, they cannot move the cursor, change
    the colors or turn the direction of writing.
    """

    def __init__(self, *, stderr: bool = False, **options: Any) -> None:
        super().__init__(stderr=stderr, markup=False, emoji=False, highlight=False, **options)
        if self.width < 1:  # by COLUMNS=0, which says that nobody knows
            self.width = _WIDTH

    def render(self, renderable: RenderableType, options: ConsoleOptions | None = None) -> Iterable[Segment]:
        """Yield the pieces of text of a renderable, cleaned; styles and cursor movements are rich's own."""
        for piece in super().render(renderable, options):
            text = piece.text if piece.control else replace_control(piece.text)
            yield piece if text == piece.text else Segment(text, piece.style)


@contextlib.contextmanager
def show_bar(waiting: str, *, timed: bool = False) -> Iterator[Callable[..., None]]:
    """Provide a function that shows the progress on a terminal: activity, amount done, total, and a text.

    What was ``found`` stays above it. Elsewhere it shows nothing. If it is ``timed``, the time since the
    begin stands in the place of the text.
    """
    screen = PlainConsole(stderr=True)
    if not screen.is_interactive:
        yield lambda *_, **__: None
        return
    from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

    columns = (TextColumn("{task.description}", markup=False), BarColumn())
    last = TimeElapsedColumn() if timed else TextColumn("{task.fields[text]}", markup=False)
    with Progress(*columns, last, console=screen, transient=True) as bar:
        task = bar.add_task(waiting, total=None, text="")

        def show(what: str, done: float, of: float | None, text: str = "", found: str = "") -> None:
            if found:
                screen.print(found)
            bar.update(task, description=what, completed=done, total=of, text=text)

        yield show
