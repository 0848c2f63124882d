"""Program in the process of a filter: builds the filter, passes sensors and initial state, sends answers.

`bench.io.foreign.filter_process` starts it and sends requests. This process contains no truth and no data of
the requesting process.
"""

from __future__ import annotations

import contextlib
import faulthandler
import fcntl
import gc
import os
import pickle
import resource
import select
import signal
import socket
import struct
import sys
import threading
import time
import traceback
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bench.core.files import disk_arrays
from bench.core.files.installed import find_class
from bench.core.files.places import PACKAGE
from bench.core.records.data import InitialState, NavSolution, SensorData
from bench.core.words.exceptions import EstimatorError, EstimatorFailedError
from bench.io.foreign.confinement import HINT, confine
from bench.io.foreign.record_messages import RecordMessage, read_message
from bench.navigation import built_in, estimator
from bench.navigation.engine.piecewise import InPieces, RunsInPieces

REQUEST = struct.Struct("<IQI")
"""Begin of a request: sizes of its text, of its body, and of the path of the file that holds the body."""

ANSWER = struct.Struct("<IQ")
"""Begin of an answer: sizes of its text and its body."""

_AWAKE = 1e-3  # [s]
_MOST_SAID = 200_000  # characters of a traceback
_SMALL = 1 << 16  # body that goes with its text [byte]

OFFERS = ("in_pieces", "check_sensors", "unmodeled_errors", "identity")
"""Methods of a filter that are optional."""


def serve(channel: int, life: int) -> None:
    """Answer requests from a socket until it is closed; then end this process.

    Parameters
    ----------
    channel, life : int
        Descriptors of the socket, and of a pipe whose other end is closed when the asking process ends.
    """
    for descriptor in (channel, life):
        os.set_inheritable(descriptor, False)  # the filter may start programs
    _end_with(life)
    faulthandler.enable()  # a crash, or the end at a limit, prints where the filter was
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    for stream in (sys.stdout, sys.stderr):
        stream.reconfigure(line_buffering=True, errors="backslashreplace")  # type: ignore[union-attr]
    server = _FilterServer()
    gc.freeze()  # what is here stays: it need not be looked through again and again
    poll = select.poll()
    poll.register(channel, select.POLLIN)
    with socket.socket(fileno=channel) as line:
        while (request := _receive(line, poll)) is not None:
            answer = server.answer(*request)
            for stream in (sys.stdout, sys.stderr):
                with contextlib.suppress(Exception):  # the filter may have closed or replaced it
                    stream.flush()
            head = ANSWER.pack(len(answer.text), answer.size) + answer.text
            small = answer.size < _SMALL
            for block in (b"".join([head, *answer.parts]),) if small else (head, *answer.parts):
                line.sendall(block)
    os._exit(0)  # threads that the filter left behind end here


def _end_with(life: int) -> None:
    """End this process and all that it started when the other end of a pipe is closed.

    The kernel of Linux sends SIGKILL by itself, whatever code of the filter runs; elsewhere a thread looks.
    """
    if hasattr(fcntl, "F_SETSIG"):
        fcntl.fcntl(life, fcntl.F_SETOWN, -os.getpgrp())
        fcntl.fcntl(life, fcntl.F_SETSIG, signal.SIGKILL)
        fcntl.fcntl(life, fcntl.F_SETFL, fcntl.fcntl(life, fcntl.F_GETFL) | os.O_ASYNC)
    else:
        threading.Thread(target=_wait_for, args=(life,), daemon=True).start()


def _wait_for(life: int) -> None:
    os.read(life, 1)
    os.killpg(0, signal.SIGKILL)


def watch(poll: select.poll) -> list[tuple[int, int]]:
    """Return the descriptors ready within `_AWAKE`, by polling: waking takes longer than a small answer."""
    end = time.perf_counter() + _AWAKE
    while not (ready := poll.poll(0)) and time.perf_counter() < end:
        os.sched_yield()
    return ready


def _receive(line: socket.socket, poll: select.poll) -> tuple[bytes, NDArray[np.uint8]] | None:
    """Return text and body of the next request; None if the other end is closed."""
    watch(poll)
    head = line.recv(REQUEST.size, socket.MSG_WAITALL)
    if len(head) < REQUEST.size:
        return None
    text_size, body_size, path_size = REQUEST.unpack(head)
    rest = line.recv(text_size + path_size + (0 if path_size else body_size), socket.MSG_WAITALL)
    begin = text_size + path_size
    if path_size:
        body = np.asarray(disk_arrays.map_file(Path(os.fsdecode(rest[text_size:begin]))))
    else:
        body = np.frombuffer(rest[begin:], np.uint8)  # of bytes: like a map it cannot be made writable
    return rest[:text_size], body


@dataclass
class _Served:
    """A requested filter, and its present instance."""

    use: str
    label: str
    options: Mapping[str, Any]
    one: estimator.Estimator
    used: bool = False

    def renew(self) -> estimator.Estimator:
        """Return a new instance that has not run."""
        if self.used:
            self.one = built_in.load(self.use, self.options)
        self.used = True
        return self.one


class _FilterServer:
    """The filters and passages of this process, by number."""

    def __init__(self) -> None:
        self._kept: dict[int, Any] = {}
        self._count = 0
        self._home = os.getcwd()
        self._before = set(sys.modules)
        self._specs: Any = None
        self._confined = False

    def answer(self, text: bytes, body: NDArray[np.uint8]) -> RecordMessage:
        """Execute a request; return the answer, or the reason why there is none."""
        request = read_message(text, body, self._specs)
        for number in request["forget"]:
            self._kept.pop(number, None)
        do, label = request["do"], request["label"]
        try:
            return RecordMessage({"done": getattr(self, do)(**request["with"])}, check=True)
        except EstimatorError as error:
            return RecordMessage({"refused": error.messages})
        except BaseException as error:  # of the filter, whatever it is
            own = isinstance(error, EstimatorFailedError)
            failure = error if own else estimator.make_failure(label, f"{do}()", error)
            if self._confined and isinstance(error.__cause__ or error, PermissionError | FileNotFoundError):
                failure = EstimatorFailedError(f"{failure} ({HINT})")
            said = "".join(traceback.format_exception(error.__cause__ or error))[-_MOST_SAID:]
            return RecordMessage({"failed": str(failure), "traceback": said})

    def assume(self, specs: NDArray[np.uint8]) -> None:
        """Store the datasheets of the next records."""
        self._specs = pickle.loads(specs.tobytes())

    def open(self, use: str, label: str, options: NDArray[np.uint8], home: str) -> dict[str, Any]:
        """Build a filter, confined if there is a folder for that; return its number and optional methods."""
        self._go_home()
        if home and not self._confined:
            self._confined = confine(find_class(use, built_in.BUILT_IN).partition(":")[0], Path(home))
        given = pickle.loads(options.tobytes())
        try:
            one = built_in.load(use, given)
        except (EstimatorError, EstimatorFailedError):
            raise
        except Exception as error:
            raise estimator.make_failure(use, "its module or constructor", error) from error
        return {
            "number": self._keep(_Served(use, label, given, one)),
            "needs": [str(need) for need in getattr(one, "needs", ())],
            "offers": [name for name in OFFERS if callable(getattr(one, name, None))],
            "finds_start": bool(getattr(one, "finds_start", False)),
            "files": self._list_files(),
            "confined": self._confined,
        }

    def run(self, number: int, sensors: SensorData, initial: InitialState) -> NavSolution:
        """Run a new instance of a filter; return its solution."""
        self._go_home()
        served: _Served = self._kept[number]
        try:
            return estimator.answer(served.renew(), served.label, sensors, initial)
        except EstimatorError as error:  # who asks puts the name before it
            raise EstimatorError(str(error.__cause__ or error)) from error

    def unmodeled_errors(self, number: int, specs: NDArray[np.uint8]) -> list[str]:
        """Return the errors of datasheets that a filter has no state for."""
        served: _Served = self._kept[number]
        found = estimator.list_unmodeled(served.one, served.label, pickle.loads(specs.tobytes()))
        return [str(name) for name in found or ()]

    def check_sensors(self, number: int, specs: NDArray[np.uint8]) -> str:
        """Return why a filter cannot be consistent with the sensors of datasheets, in words."""
        served: _Served = self._kept[number]
        return estimator.ask_refusal(served.one, served.label, pickle.loads(specs.tobytes()))

    def identity(self, number: int, sensors: SensorData) -> str:
        """Return the identity of a filter, on which its solution depends, in words."""
        return repr(self._kept[number].one.identity(sensors))

    def begin(
        self, number: int, first: SensorData, initial: InitialState, events: list[Any]
    ) -> dict[str, Any]:
        """Return the number of a passage before its first piece."""
        self._go_home()
        one: RunsInPieces = self._kept[number].one
        rows: Any = [tuple(row) for row in events]
        passage = one.in_pieces(first, initial, rows)
        return {"number": self._keep(passage), "end": float(passage.end)}

    def update(self, number: int, piece: SensorData, look_back: float, last: bool) -> dict[str, Any]:
        """Update a copy of a passage; return its solution, its number and its end."""
        passage = self._copy(number)
        solution = passage.update(piece, look_back, last=last)
        return {"solution": solution, "number": self._keep(passage), "end": float(passage.end)}

    def ask(self, number: int, head: SensorData) -> NavSolution:
        """Return the solution of a passage at its end."""
        return self._copy(number).current(head)

    def state(self, number: int) -> dict[str, Any]:
        """Return the state of a passage."""
        passage: InPieces = self._kept[number]
        return passage.state()

    def restore(self, number: int, state: dict[str, Any]) -> dict[str, Any]:
        """Restore a state into a copy of a passage; return its number and its end."""
        passage = self._copy(number)
        passage.restore(state)
        return {"number": self._keep(passage), "end": float(passage.end)}

    def _copy(self, number: int) -> InPieces:
        passage: InPieces = self._kept[number]
        return passage.copy()

    def _keep(self, one: Any) -> int:
        self._count += 1
        self._kept[self._count] = one
        return self._count

    def _go_home(self) -> None:
        """Change back to the initial folder of the process."""
        with contextlib.suppress(OSError):
            os.chdir(self._home)

    def _list_files(self) -> dict[str, int]:
        """Return the files of the user's modules, each with the time of its last change."""
        found = {}
        theirs = tuple(map(str, (sys.prefix, sys.base_prefix, PACKAGE)))
        for name in set(sys.modules) - self._before:
            path = getattr(sys.modules[name], "__file__", None)
            if isinstance(path, str) and not path.startswith(theirs):
                with contextlib.suppress(OSError):
                    found[path] = os.stat(path).st_mtime_ns
        return found
