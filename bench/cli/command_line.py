"""The command line: parse arguments, run a verb, return the exit status. Heavy imports wait for the verb."""

from __future__ import annotations

import _thread
import gc
import signal
import sys
import threading
import traceback
from collections.abc import Callable, Sequence
from types import FrameType
from typing import Any

import click

from bench.cli import campaigning, flights, recorded_data, starting, studying
from bench.cli.group import commands
from bench.core.words.exceptions import BUG, DONE, INTERRUPTED, MACHINE, WRONG, BenchError
from bench.core.words.wording import replace_control

# each module adds verbs
__all__ = [
    "campaigning",
    "commands",
    "flights",
    "main",
    "recorded_data",
    "starting",
    "studying",
]


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one command line and return its exit status; a bug prints its traceback.

    SIGINT, SIGTERM and SIGHUP interrupt it. Whatever exception follows an interruption, the status says
    interrupted: code in C may print KeyboardInterrupt and turn it into an exception of its own.

    Parameters
    ----------
    arguments : sequence of str or None
        The arguments behind ``bench``; None takes those of this process.
    """
    interrupted, over = threading.Event(), threading.Event()

    def interrupt(number: int, frame: FrameType | None) -> None:
        interrupted.set()
        if not over.is_set():
            raise KeyboardInterrupt

    names = ("SIGINT", "SIGTERM", "SIGHUP")  # Windows lacks the last
    numbers = [getattr(signal, name) for name in names if hasattr(signal, name)]
    numbers = [number for number in numbers if signal.getsignal(number) != signal.SIG_IGN]
    before = {number: signal.signal(number, interrupt) for number in numbers}
    hook, printer, threshold = sys.unraisablehook, sys.excepthook, gc.get_threshold()
    sys.unraisablehook = lambda event: _raise_again(event, hook)
    sys.excepthook = lambda kind, *rest: None if kind is KeyboardInterrupt else printer(kind, *rest)
    gc.set_threshold(1_000_000, 9, 9)  # collecting during imports takes a tenth of a run and frees nothing
    status = DONE
    try:
        status = _run(arguments, interrupted)
        over.set()
    except KeyboardInterrupt:  # in the last line of `_run`
        over.set()
    finally:
        over.set()
        if arguments is None:
            gc.freeze()  # the process ends: nothing of it is worth a last collection
        gc.set_threshold(*threshold)
        sys.unraisablehook, sys.excepthook = hook, printer
        for number, handler in before.items():
            signal.signal(number, handler)
    if interrupted.is_set() and status != INTERRUPTED:
        return _fail(INTERRUPTED, "interrupted")
    return status


def _run(arguments: Sequence[str] | None, interrupted: threading.Event) -> int:
    """Run one command line and return its exit status."""
    try:
        return int(commands.main(arguments, "bench", standalone_mode=False) or DONE)
    except click.UsageError as error:
        path = error.ctx.command_path if error.ctx else "bench"
        return _fail(WRONG, f"{error.format_message()} ('{path} --help' says more)")
    except BaseException as error:
        if interrupted.is_set() or isinstance(error, click.Abort | KeyboardInterrupt):
            return _fail(INTERRUPTED, "interrupted")
        if not isinstance(error, Exception):
            raise
        if isinstance(error, BenchError) and error.status != BUG:
            return _fail(error.status, "\nerror: ".join(error.lines))
        if isinstance(error, OSError) and not isinstance(error, FileNotFoundError):
            place = f"{error.filename}: " if error.filename else ""
            return _fail(MACHINE, f"{place}{error.strerror or error}")
        click.echo(replace_control(traceback.format_exc()), err=True, nl=False)
        return BUG


def _raise_again(event: Any, hook: Callable[[Any], object]) -> None:
    """Interrupt the main thread again if Python dropped the interrupt, as in ``__del__``."""
    if issubclass(event.exc_type, KeyboardInterrupt):
        if sys.platform == "win32":
            threading.Timer(0.01, _thread.interrupt_main).start()
            return
        main_thread = threading.main_thread().ident or 0
        threading.Timer(0.01, signal.pthread_kill, (main_thread, signal.SIGINT)).start()
    else:
        hook(event)


def _fail(status: int, message: str) -> int:
    click.echo(f"error: {replace_control(message)}", err=True)  # it may quote a file
    return status
