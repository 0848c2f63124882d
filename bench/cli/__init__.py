"""The command line: parse arguments, run a verb, return the exit status. Heavy imports wait for the verb."""

from __future__ import annotations

import gc
import signal
import traceback
from collections.abc import Sequence
from types import FrameType

import click

from bench.cli import flights, records
from bench.cli.group import commands
from bench.errors import BUG, DONE, INTERRUPTED, MACHINE, WRONG, BenchError

__all__ = ["commands", "flights", "main", "records"]  # importing the modules adds their verbs


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one command line and return its exit status; a bug prints its traceback.

    Parameters
    ----------
    arguments : sequence of str or None
        The arguments behind ``bench``; None takes those of this process.
    """
    before = signal.signal(signal.SIGTERM, _interrupt)
    threshold = gc.get_threshold()
    gc.set_threshold(1_000_000, 9, 9)  # collecting during imports takes a tenth of a run and frees nothing
    try:
        return int(commands.main(arguments, "bench", standalone_mode=False) or DONE)
    except click.UsageError as error:
        path = error.ctx.command_path if error.ctx else "bench"
        return _fail(WRONG, f"{error.format_message()} ('{path} --help' says more)")
    except (click.Abort, KeyboardInterrupt):
        return _fail(INTERRUPTED, "interrupted")
    except Exception as error:
        if isinstance(error, BenchError) and error.status != BUG:
            return _fail(error.status, "\nerror: ".join(error.lines))
        if isinstance(error, OSError) and not isinstance(error, FileNotFoundError):
            place = f"{error.filename}: " if error.filename else ""
            return _fail(MACHINE, f"{place}{error.strerror or error}")
        traceback.print_exc()
        return BUG
    finally:
        gc.set_threshold(*threshold)
        signal.signal(signal.SIGTERM, before)


def _fail(status: int, message: str) -> int:
    printable = "".join(c if c == "\n" or c.isprintable() else "?" for c in message)  # may quote a file
    click.echo(f"error: {printable}", err=True)
    return status


def _interrupt(number: int, frame: FrameType | None) -> None:
    raise KeyboardInterrupt
