"""What a run is doing at the moment, for whoever waits for it."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

FLYING = "flying"


class Stage(NamedTuple):
    """What is going on."""

    words: str
    done: float = 0.0  # of the flight [s]
    total: float | None = None  # length of the flight [s]; None: of what has no length
    compiling: bool = False

    def __str__(self) -> str:
        text = self.words
        if self.total:
            text += f", {self.done:.0f} of {self.total:.0f} s"
        return f"{text} (compiling, once)" if self.compiling else text


Watcher = Callable[[Stage], object]
"""Called with every change of what is going on."""


class Stages:
    """Tells a watcher what is going on."""

    def __init__(self, watcher: Watcher | None) -> None:
        self._watcher, self._now = watcher or (lambda stage: None), Stage("")

    @property
    def flies(self) -> bool:
        """Whether a flight goes on."""
        return self._now.words == FLYING

    def begin(self, words: str, total: float | None = None) -> None:
        """Tell that something begins, which may last so many seconds of flight."""
        self._tell(Stage(words, 0.0, total))

    def move(self, done: float) -> None:
        """Tell how far it is [s]."""
        self._tell(self._now._replace(done=done))

    def compile(self, busy: bool) -> None:
        """Tell that it compiles, or no longer."""
        self._tell(self._now._replace(compiling=busy))

    def _tell(self, stage: Stage) -> None:
        self._now = stage
        self._watcher(stage)
