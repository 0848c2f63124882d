"""Fly foreign scripts and models in a separate process that bench can end.

JSBSim runs foreign models as native code: a trim may never return, a bad table may end the process, and both
print as they like. The child has no standard output and a scratch folder as its working directory. It says
what it does, and must go on to something else within a minute of its own CPU time: on a busy machine that may
be long. A child that waits without using the CPU at all has a minute of the clock.
"""

from __future__ import annotations

import contextlib
import math
import os
import pickle
import selectors
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import IO

from bench.core.files.scratch import make_scratch
from bench.core.files.spawned import count_work, find_last_line, measure_cpu
from bench.core.records.data import Trajectory
from bench.core.records.flight_specs import FlightSpec, ScriptSpec
from bench.core.words.exceptions import FlightError

PATIENCE = 60.0
"""CPU time that a child may use, or time that it may idle, before it does something else [s]."""
_POLL = 0.5  # time between two looks at a silent child [s]

_START = """import sys
sys.path[:] = {path!r}
from bench.simulation.flight.child_process import answer
from bench.simulation.flight.recorder import fly_pieces
answer(fly_pieces)"""
_BLOCK = 1 << 16


def fly_in_child(
    spec: FlightSpec | ScriptSpec,
    what: str,
    progress: Callable[[float], None] | None = None,
    seconds: float = math.inf,
    patience: float = PATIENCE,
) -> Iterator[Trajectory]:
    """Yield the pieces of `bench.simulation.flight.recorder.fly_pieces`, run in a child.

    They come from a file when the child has ended: this process holds one at a time.

    Parameters
    ----------
    spec, progress, seconds
        As for `bench.simulation.flight.recorder.fly_pieces`.
    what : str
        How messages call it: "aircraft c310".
    patience : float, optional
        CPU time that the child may use, or time that it may idle, before it does something else [s].

    Raises
    ------
    FlightError
        What the child raised, or that it ended or hung.
    """
    with make_scratch() as scratch:
        answer_file, trouble = scratch / "answer", scratch / "trouble"
        command = [sys.executable, "-c", _START.format(path=sys.path)]
        with (
            trouble.open("wb") as stderr,
            subprocess.Popen(
                command, cwd=scratch, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=stderr
            ) as child,
        ):
            assert child.stdin is not None
            assert child.stdout is not None
            try:
                with contextlib.suppress(BrokenPipeError):  # it has ended; its status says so below
                    child.stdin.write(pickle.dumps((spec, seconds, str(answer_file))))
                    child.stdin.close()
                if (doing := _listen(child, child.stdout, progress, patience)) is not None:
                    raise FlightError(f"{what}: JSBSim hung for {patience:g} s while {doing}; it was ended")
                status = child.wait()
            finally:
                child.kill()
        if status or not answer_file.is_file():
            raise FlightError(f"{what}: JSBSim ended its process{_last_line(trouble, status)}")
        with answer_file.open("rb") as answered:
            while (piece := pickle.load(answered)) is not None:
                if isinstance(piece, str):
                    raise FlightError(piece)
                yield piece


def answer(fly: Callable[..., Iterator[Trajectory]]) -> None:
    """Fly in this child process: read the spec from stdin, write progress to stdout, the truth to a file."""
    spec, seconds, answer_file = pickle.loads(sys.stdin.buffer.read())
    tempfile.tempdir = str(Path.cwd())  # the parent deletes what a model leaves that ends this process
    speak = os.fdopen(os.dup(1), "w", buffering=1)
    quiet = os.open(os.devnull, os.O_WRONLY)
    os.dup2(quiet, 1)
    last, before, flown = 0.0, "", 0.0

    def say(doing: str) -> None:
        nonlocal last, before
        if doing != before or time.monotonic() - last > 0.1:
            last, before = time.monotonic(), doing
            speak.write(f"{flown:g} {doing}\n")

    def progress(t: float) -> None:
        nonlocal flown
        flown = t
        say("flying")

    part = Path(f"{answer_file}.part")
    with part.open("wb") as file:
        try:
            for piece in fly(spec, progress, seconds, say):
                say("writing its truth")
                pickle.dump(piece, file, protocol=pickle.HIGHEST_PROTOCOL)
        except FlightError as error:
            file.seek(0)  # what was flown until then is no truth
            pickle.dump(str(error), file)
        pickle.dump(None, file)
    part.replace(answer_file)
    speak.close()
    os._exit(0)  # the destructor of a broken model may throw


def _listen(
    child: subprocess.Popen[bytes], said: IO[bytes], progress: Callable[[float], None] | None, patience: float
) -> str | None:
    """Pass on the progress of a child; return None when it ended, or its last activity if it hangs.

    A look at a silent child counts as the CPU time it has used since the last one; if that is none, as the
    time between them.
    """
    rest, doing, silent, used = b"", "starting", 0.0, measure_cpu(child.pid)
    with selectors.DefaultSelector() as selector:
        selector.register(said, selectors.EVENT_READ)
        while silent < patience:
            if selector.select(_POLL):
                block = os.read(said.fileno(), _BLOCK)
                if not block:
                    return None
                *lines, rest = (rest + block).split(b"\n")
                if lines:
                    t, _, doing = lines[-1].decode().partition(" ")
                    silent, used = 0.0, measure_cpu(child.pid)
                    if progress is not None and doing == "flying":
                        progress(float(t))
                        doing = f"flying at {t} s"
            else:
                before, used = used, measure_cpu(child.pid)
                silent += count_work(before, used, _POLL)
    return doing


def _last_line(trouble: Path, status: int) -> str:
    text = trouble.read_text(encoding="utf-8", errors="replace") if trouble.is_file() else ""
    said = find_last_line(text)[:200]
    return f" with status {status}" + (f": {said}" if said else "")
