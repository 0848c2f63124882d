"""Failures that are no bugs: each has its messages and the exit status of the command line."""

from __future__ import annotations

DONE, NEGATIVE, WRONG, NOT_FLOWN, MACHINE, UNSEEN, UNDECIDED = 0, 1, 2, 3, 4, 5, 6
BUG, INTERRUPTED = 70, 130
"""Exit statuses."""

STATUSES = {
    DONE: "done",
    NEGATIVE: "a filter diverged, answered a part, could not start or was ended; a limit is broken, a "
    "metric worse; with --strict a filter is over- or underconfident",
    WRONG: "the command line, a file or the results folder is wrong",
    NOT_FLOWN: "the aircraft could not be loaded, trimmed or flown",
    MACHINE: "the machine failed: disk full, no viewer",
    UNSEEN: "the results are written, but not their recording or report",
    UNDECIDED: "a study cannot decide what was asked; the output gives what would",
    BUG: "a bug, or a filter that raised, with its traceback",
    INTERRUPTED: "interrupted",
}
"""Exit status -> what it means, as the help of every verb lists them."""


MOST_MESSAGES = 20
"""Messages of an error that are printed; the others are counted."""


class BenchError(Exception):
    """A failure that is not a bug. ``messages`` has one complete text for each problem.

    Attributes
    ----------
    messages : tuple of str
        The problems.
    status : int
        Exit status of the command line.

    Examples
    --------
    >>> import bench
    >>> try:
    ...     bench.run("figure-eight", run=-1)
    ... except bench.BenchError as error:
    ...     print(error.messages)
    ('bench.run: run = -1 must be a whole number, at least 0',)
    """

    status = WRONG
    """Exit status of the command line."""

    def __init__(self, *messages: str) -> None:
        super().__init__(*messages)
        self.messages = messages

    @property
    def lines(self) -> tuple[str, ...]:
        """The messages to print."""
        more = len(self.messages) - MOST_MESSAGES
        counted = (f"and {more} more error{'s' if more > 1 else ''}",) if more > 0 else ()
        return (*self.messages[:MOST_MESSAGES], *counted)

    def __str__(self) -> str:
        return "\n".join(self.lines)


class ConfigError(BenchError):
    """An argument, the command line or a file is wrong."""


class ExportError(BenchError):
    """A result cannot be written in the requested format."""


class NothingToShowError(BenchError):
    """A solution contains nothing that a recording could show."""


class EstimatorError(BenchError):
    """A filter cannot be built or cannot start."""


class EstimatorFailedError(BenchError):
    """A filter raised an exception, which is the cause, or its ``run`` returned no solution."""

    status = BUG


class EstimatorStoppedError(EstimatorFailedError):
    """The process of a filter ended without a result, or was ended at a limit."""

    status = NEGATIVE


class FilterTraceback(Exception):  # noqa: N818 - it is a text, and the cause of an error
    """The traceback of an exception of a filter in a separate process."""


class FlightError(BenchError):
    """An aircraft cannot be loaded, trimmed or flown."""

    status = NOT_FLOWN


class ViewsFailedError(BenchError):
    """The recording or the report of a result could not be made; the result itself is written."""

    status = UNSEEN


class ViewerError(BenchError):
    """The viewer cannot be started on this machine."""

    status = MACHINE


class WorkersLostError(BenchError):
    """The machines that should do the work are gone."""

    status = MACHINE
