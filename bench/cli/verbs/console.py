"""The terminal: the one door through which verbs print, which lets no control characters pass."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

from rich.console import Console, ConsoleOptions, RenderableType
from rich.segment import Segment

from bench.core.words.wording import replace_control

_WIDTH = 80  # of a screen that does not say how wide it is


class PlainConsole(Console):
    """A console for texts of other people: without markup, and without control and bidirectional characters.

    Titles, names and messages may come from a file. Whatever they hold, they cannot move the cursor, change
    the colours or turn the direction of writing.
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
