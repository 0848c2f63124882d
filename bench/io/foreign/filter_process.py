"""Client side of a filter process: requests, answers, limits, and the end of the process.

What `bench.io.foreign.filter_server` sends is plain arrays and JSON, of which nothing is run. The other way a
large record goes by a file that the filter can only read.
"""

from __future__ import annotations

import contextlib
import math
import os
import pickle
import select
import signal
import socket
import subprocess
import sys
import threading
import time
import weakref
from collections import OrderedDict
from typing import Any, NoReturn

import numpy as np
from numpy.typing import NDArray

from bench.core.files import disk_arrays
from bench.core.files.scratch import make_scratch
from bench.core.files.spawned import (
    LOOK,
    PATIENCE,
    Printed,
    Watch,
    describe_end,
    describe_output,
    end_group,
    measure_cpu,
)
from bench.core.records.sensor_specs import AssumedSpecs
from bench.core.records.specs import EstimatorChoice, Guard
from bench.core.words.exceptions import (
    EstimatorError,
    EstimatorFailedError,
    EstimatorStoppedError,
    FilterTraceback,
)
from bench.io.foreign.confinement import make_place
from bench.io.foreign.filter_server import ANSWER, REQUEST, watch
from bench.io.foreign.record_messages import RecordMessage, read_message
from bench.navigation.engine.record_cuts import without_orbits

_START = """import sys
sys.path[:] = {path!r}
from bench.io.foreign.filter_server import serve
serve({channel}, {life})"""
_INLINE = 1 << 19  # a larger body goes by a file that is mapped [byte]
_BLOCK, _BLOCKS = 1 << 16, 16  # that are read [byte], and how many before the next look
MOST_KEPT = 8  # processes of a thread that wait for their next run


class FilterProcess:
    """A process with a filter: it gets one request at a time, and ends when it is closed or collected.

    Parameters
    ----------
    guard : Guard
        What it may take.
    """

    def __init__(self, guard: Guard) -> None:
        self._guard = guard
        self.forgotten: list[int] = []  # numbers that nobody asks for any more
        self._assumed: object = None
        self.files: dict[str, int] = {}
        self.printed = Printed()
        self.lock = threading.RLock()
        self.waiting = False  # for an answer
        self._cpu_s = 0.0
        ours, theirs = socket.socketpair()
        ends, life = os.pipe()
        self._place = contextlib.ExitStack()
        self.home = self._place.enter_context(make_scratch()) if guard.confined else None
        work, environment = make_place(self.home) if self.home else (None, None)
        path = [os.path.abspath(one) if self.home else str(one) for one in sys.path]
        code = _START.format(path=path, channel=theirs.fileno(), life=ends)
        with theirs, os.fdopen(ends, "rb"):
            self._child = subprocess.Popen(
                [sys.executable, "-c", code],
                stdin=subprocess.DEVNULL,
                stdout=subprocess.PIPE,
                stderr=subprocess.STDOUT,
                pass_fds=(theirs.fileno(), ends),
                start_new_session=True,
                cwd=work,
                env=environment,
            )
        assert self._child.stdout is not None
        self._line, self._stream = ours, self._child.stdout
        self._line.setblocking(False)
        os.set_blocking(self._stream.fileno(), False)
        self._label, self._files, self._memory = "", contextlib.ExitStack(), guard.choose_memory()
        self._watch = Watch(self.pid, math.inf, math.inf)
        self._number, self._printing = self._line.fileno(), False
        self._poll = select.poll()
        for place in (self._line, self._stream):
            self._poll.register(place, select.POLLIN)
        self._close = weakref.finalize(self, _end, self._child, self._line, self._stream, life, self._place)

    @property
    def usable(self) -> bool:
        """Return whether the process is alive, owes no answer, and has unchanged source files."""
        return self._close.alive and not self.waiting and self._child.poll() is None and self._is_current()

    @property
    def pid(self) -> int:
        """Number of the process."""
        return self._child.pid

    @property
    def cpu_s(self) -> float:
        """CPU time of the process until now, or until it was ended [s]."""
        if self._child.returncode is None:
            self._cpu_s = measure_cpu(self.pid)
        return self._cpu_s

    def close(self) -> None:
        """End the process and all that it has started."""
        self._close()

    def ask(self, label: str, do: str, seconds: float, /, **given: Any) -> Any:
        """Send a request and return its answer; parameters and errors as for :meth:`post` and `collect`."""
        with self.lock:
            self.post(label, do, seconds, **given)
            return self.collect()

    def assume(self, label: str, seconds: float, specs: AssumedSpecs) -> None:
        """Send the datasheets of the next records to the filter, unless it has them."""
        if self._assumed is not specs:
            self.ask(label, "assume", seconds, specs=pack_specs(specs))
            self._assumed = specs

    def post(self, label: str, do: str, seconds: float, /, **given: Any) -> None:
        """Send a request; collect its answer before the next request.

        Parameters
        ----------
        label : str
            How messages call the filter.
        do : str
            Method of `bench.io.foreign.filter_server`.
        seconds : float
            Wall time until the answer [s].
        given : object
            Its arguments: records, arrays, words and numbers.
        """
        if not self._close.alive:
            raise EstimatorStoppedError(f"filter {label!r}: its process has ended")
        forgotten, self.forgotten = self.forgotten, []
        message = RecordMessage({"do": do, "label": label, "with": given, "forget": forgotten})
        self._label, self._watch, self.waiting = label, Watch(self.pid, seconds, self._memory), True
        try:
            path, parts = b"", message.parts
            if message.size > _INLINE:
                file = self._files.enter_context(make_scratch(self.home)) / "record.npy"
                message.write(file)
                path, parts = os.fsencode(file), []
            head = REQUEST.pack(len(message.text), message.size, len(path))
            with contextlib.suppress(ConnectionError, TimeoutError):  # told by `collect`
                self._send(b"".join([head, message.text, path, *parts]), seconds)
        except BaseException:
            self._give_up()
            raise

    def collect(self) -> Any:
        """Return the answer to the last request.

        Raises
        ------
        EstimatorError
            If the filter rejects: an option, or the record.
        EstimatorFailedError
            If it raised; the cause holds its traceback.
        EstimatorStoppedError
            If the process ended or was ended at a limit.
        """
        try:
            answer = read_message(*self._receive())
            while self._printing:
                self._drain(_BLOCKS)
            self._files.close()
        except BaseException:
            self._give_up()
            raise
        self.waiting = False
        if "refused" in answer:
            raise EstimatorError(*answer["refused"])
        if "failed" in answer:
            raise EstimatorFailedError(answer["failed"]) from FilterTraceback(answer["traceback"])
        return answer["done"]

    def _send(self, data: bytes, seconds: float) -> None:
        try:
            sent = self._line.send(data)
        except BlockingIOError:
            sent = 0
        if sent < len(data):
            self._line.settimeout(seconds)
            self._line.sendall(memoryview(data)[sent:])
            self._line.setblocking(False)

    def _receive(self) -> tuple[bytes, NDArray[np.uint8]]:
        """Return text and body of the answer, the body on disk if it is large."""
        self._wait()  # it is never there at once
        block = self._take_block()
        while len(block) < ANSWER.size:
            block += self._take_block()
        text_size, body_size = ANSWER.unpack_from(block)
        if body_size > self._guard.output:
            self._stop(describe_output(self._guard.output))
        begin = ANSWER.size + text_size
        if len(block) == begin + body_size:
            return block[ANSWER.size : begin], np.frombuffer(block[begin:], np.uint8)
        text, body = bytearray(text_size), disk_arrays.empty(body_size, np.uint8)
        rest = memoryview(block)[ANSWER.size :]
        for room in (memoryview(text), body.data):
            count = min(len(rest), len(room))
            room[:count] = rest[:count]
            rest = rest[count:]
            self._fill(room[count:])
        body.flags.writeable = False
        return bytes(text), body

    def _fill(self, room: memoryview) -> None:
        """Receive as many bytes as there is room for."""
        while room:
            block = self._take_block(len(room))
            room[: len(block)] = block
            room = room[len(block) :]

    def _take_block(self, most: int = _BLOCK) -> bytes:
        """Receive the next bytes, at least one."""
        while True:
            try:
                block = self._line.recv(min(most, _BLOCK))
            except BlockingIOError:
                self._wait()
                continue
            except ConnectionError:
                block = b""
            if not block:
                self._tell_end()
            return block

    def _wait(self) -> None:
        """Wait briefly for data; store printed output, and check the limits."""
        ready = watch(self._poll) or self._poll.poll(1e3 * LOOK)
        if len(ready) != 1 or ready[0][0] != self._number:  # not the line alone
            self._drain(_BLOCKS)
            if not ready and self._child.poll() is not None:  # what it has started may hold its line open
                self._tell_end()
        if reason := self._watch.look():
            self._stop(reason)

    def _drain(self, blocks: int) -> None:
        """Read printed output, up to a number of blocks."""
        self._printing = True
        for _ in range(blocks):
            try:
                block = os.read(self._stream.fileno(), _BLOCK)
            except BlockingIOError:
                self._printing = False
                return
            if not block:
                with contextlib.suppress(KeyError):  # it is closed, and known to be
                    self._poll.unregister(self._stream)
                self._printing = False
                return
            self.printed.add(block)

    def _tell_end(self) -> NoReturn:
        """Return the reason why the process ended by itself."""
        with contextlib.suppress(subprocess.TimeoutExpired):
            self._child.wait(PATIENCE)
        self._drain(_BLOCKS)
        status = self._child.returncode
        how = "closed its line" if status is None else describe_end(status)
        raise EstimatorStoppedError(f"filter {self._label!r}: its process {how}")

    def _stop(self, reason: str) -> NoReturn:
        """Have the process print its stack, end it, and raise an error with the reason."""
        with contextlib.suppress(ProcessLookupError):
            os.kill(self.pid, signal.SIGABRT)
        end = time.monotonic() + PATIENCE
        while self._child.poll() is None and time.monotonic() < end:
            self._drain(_BLOCKS)
            time.sleep(0.1 * LOOK)
        self._drain(_BLOCKS)
        raise EstimatorStoppedError(f"filter {self._label!r}: {reason}")

    def _give_up(self) -> None:
        self._cpu_s = self.cpu_s
        self.close()
        self._files.close()

    def _is_current(self) -> bool:
        """Return whether the files of the filter are as they were when it was imported."""
        for path, changed in self.files.items():
            try:
                if os.stat(path).st_mtime_ns != changed:
                    return False
            except OSError:
                return False
        return True


def pack_specs(specs: AssumedSpecs) -> NDArray[np.uint8]:
    """Pack datasheets for a filter, without orbits; data from its process are never unpacked this way."""
    return np.frombuffer(pickle.dumps(without_orbits(specs)), np.uint8)


def _end(child: subprocess.Popen[bytes], line: socket.socket, stream: Any, life: int, place: Any) -> None:
    """End a process, which may have ended already."""
    line.close()
    end_group(child, signal.SIGKILL)
    stream.close()
    os.close(life)
    place.close()


class _Kept(threading.local):
    """Idle processes of a thread by the filter they run, the most recently used last."""

    def __init__(self) -> None:
        self.processes: OrderedDict[object, FilterProcess] = OrderedDict()


_kept = _Kept()


def take_process(choice: EstimatorChoice, options: bytes) -> FilterProcess:
    """Return the process of a filter; start a process if no usable one is kept."""
    key = (choice.use, choice.label, choice.guard, options, tuple(sys.path), os.getcwd())
    found = _kept.processes.pop(key, None)
    if found is not None and not found.usable:
        found.close()
        found = None
    _kept.processes[key] = found = found or FilterProcess(choice.guard)
    while len(_kept.processes) > MOST_KEPT:
        _kept.processes.popitem(last=False)  # it ends when no filter holds it any more
    return found
