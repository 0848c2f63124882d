"""The argument of ``progress``: the activity of a call, and how much is done."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

FLYING = "flying"


@dataclass(frozen=True, slots=True)
class Stage:
    """Activity and progress of a call; ``str(stage)`` is a line to show.

    Attributes
    ----------
    words : str
        The activity, such as "flying", or the name of the profile or experiment.
    done, total : float, float or None
        How much is done, and of how much, in ``unit``; None if the end is unknown.
    unit : str
        Unit of both: "s" of flight, or "runs", "parts".
    compiling : bool
        Whether numba compiles a kernel, once for this machine.
    found : str
        What has just become known, such as "loose-full: consistent, 6.0 m"; empty for most stages.

    Examples
    --------
    >>> str(Stage("flying", 12.0, 600.0))
    'flying, 12 of 600 s'
    """

    words: str
    done: float = 0.0
    total: float | None = None
    unit: str = "s"
    compiling: bool = False
    found: str = ""

    def __str__(self) -> str:
        text = self.words
        if self.total:
            text += f", {self.done:.0f} of {self.total:.0f} {self.unit}"
        return f"{text} (compiling, once)" if self.compiling else text


Progress = Callable[[Stage], object]
"""Called with each change of the stage."""


def ignore(stage: Stage) -> None:
    """Show no progress."""


class Stages:
    """Passes the changes of a stage to ``progress``."""

    def __init__(self, progress: Progress | None) -> None:
        self._progress, self._now = progress or ignore, Stage("")

    @property
    def flies(self) -> bool:
        """Return whether a flight is being simulated."""
        return self._now.words == FLYING

    def begin(self, words: str, total: float | None = None) -> None:
        """Begin an activity of a length [s of flight]."""
        self._show(Stage(words, 0.0, total))

    def move(self, done: float) -> None:
        """Set how much of the flight is done [s]."""
        self._show(replace(self._now, done=done))

    def compile(self, busy: bool) -> None:
        """Mark the start or the end of a compilation."""
        self._show(replace(self._now, compiling=busy))

    def find(self, found: str) -> None:
        """Report a result that is known before the end of the call."""
        self._progress(replace(self._now, found=found))

    def _show(self, stage: Stage) -> None:
        self._now = stage
        self._progress(stage)
