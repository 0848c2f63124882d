"""The workers of a campaign: processes on this machine, or workers of any executor."""

from __future__ import annotations

import contextlib
import multiprocessing
import os
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Executor, Future, ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from multiprocessing import connection
from multiprocessing.process import BaseProcess
from typing import Any

from bench.core.files.spawned import KILL
from bench.experiments.campaigns.heap import keep_freed_memory

THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS")
"""Environment variables for the number of threads of the libraries; each worker works alone."""

PATIENCE = 3.0  # between SIGTERM and SIGKILL [s]
_STOPPED = (-signal.SIGTERM, 128 + signal.SIGTERM)  # exit codes of a worker that was asked to end


class _LocalPool:
    """Workers that read the cache of the driver; the loss of all workers is always detected."""

    remote = False

    def check(self) -> None:
        """Do nothing: a worker that ends breaks its future."""

    def share(self, keys: Sequence[str]) -> None:
        """Do nothing: the workers find the truths themselves."""


class SerialExecutor(Executor):
    """Executor that calls functions immediately, in this process."""

    def submit(self, function: Callable[..., Any], /, *arguments: Any, **options: Any) -> Future[Any]:
        """Call a function and return its result or its exception."""
        future: Future[Any] = Future()
        try:
            future.set_result(function(*arguments, **options))
        except Exception as error:
            future.set_exception(error)
        return future


class ExecutorPool(_LocalPool):
    """Workers of an executor of the caller; the caller starts it, ends it and replaces its workers."""

    lost: tuple[type[BaseException], ...] = ()

    def __init__(self, executor: Executor, workers: int) -> None:
        self.workers = workers
        self._executor = executor

    def __enter__(self) -> ExecutorPool:
        return self

    def __exit__(self, *error: object) -> None:
        pass

    def submit(self, function: Callable[..., Any], *arguments: Any) -> Future[Any]:
        """Begin a call of a function in a worker."""
        return self._executor.submit(function, *arguments)

    def recover(self) -> tuple[str, bool]:
        """Do nothing; never called, because the end of a worker ends the whole work."""
        raise NotImplementedError


class ProcessPool(_LocalPool):
    """Processes on this machine that apply functions; leaving the context ends the processes.

    Each has one thread of linear algebra. Ctrl-C does not reach them; they end with the driver. They are
    spawned and import what they need: nothing is inherited but the environment and the import path. A script
    that uses them guards its own start by ``if __name__ == "__main__"``.
    """

    lost: tuple[type[BaseException], ...] = (BrokenProcessPool,)

    def __init__(self, workers: int) -> None:
        self.workers = workers
        self._executor: ProcessPoolExecutor | None = None
        self._own: dict[int, BaseProcess] = {}

    def __enter__(self) -> ProcessPool:
        return self

    def __exit__(self, *error: object) -> None:
        self._end(at_once=error[0] is not None)

    def submit(self, function: Callable[..., Any], *arguments: Any) -> Future[Any]:
        """Begin a call of a function in a worker."""
        with _quiet(), _one_thread():
            if self._executor is None:
                self._executor = ProcessPoolExecutor(
                    self.workers, multiprocessing.get_context("spawn"), prepare_worker, (list(sys.path),)
                )
            others = {child.pid for child in multiprocessing.active_children()} - set(self._own)
            try:
                future = self._executor.submit(function, *arguments)
            except BrokenProcessPool as error:  # a worker was lost since the last look
                future = Future()
                future.set_exception(error)
            started = {c.pid: c for c in multiprocessing.active_children() if c.pid not in others}
            self._own.update({pid: child for pid, child in started.items() if pid is not None})
        return future

    def recover(self) -> tuple[str, bool]:
        """End the executor with the worker that ended; return how that worker ended."""
        deadline = time.monotonic() + PATIENCE
        codes: list[int] = []
        while not codes and time.monotonic() < deadline:
            codes = [child.exitcode for child in self._own.values() if child.exitcode]
            time.sleep(0.01)
        first = next((code for code in codes if code not in _STOPPED), None)  # the pool stops the others
        self._end(at_once=True)
        return _describe_end(first), True

    def _end(self, *, at_once: bool) -> None:
        if self._executor is not None:
            self._executor.shutdown(wait=not at_once, cancel_futures=True)
        for number in (signal.SIGTERM, KILL) if at_once else ():
            for child in self._own.values():
                with contextlib.suppress(ProcessLookupError, ValueError):
                    if child.exitcode is None and child.pid is not None:
                        os.kill(child.pid, number)
            deadline = time.monotonic() + PATIENCE
            for child in self._own.values():
                child.join(max(0.0, deadline - time.monotonic()))
        self._executor = None
        self._own.clear()


def open_pool(jobs: int) -> ProcessPool | ExecutorPool:
    """Return a pool of processes on this machine; if ``jobs`` is 1, this process itself."""
    return ProcessPool(jobs) if jobs > 1 else ExecutorPool(SerialExecutor(), 1)


def count_processors() -> int:
    """Return the number of processors that this process may use."""
    return len(os.sched_getaffinity(0)) if sys.platform == "linux" else os.cpu_count() or 1


def _describe_end(code: int | None) -> str:
    if code is None:
        return "its worker process ended"
    if code < 0:
        return f"its worker process was ended by {signal.Signals(-code).name}"
    return f"its worker process ended with exit status {code}"


@contextlib.contextmanager
def _quiet() -> Iterator[None]:
    """Start processes that ignore interrupts from the terminal; the driver ends them."""
    if sys.platform == "win32":
        yield
        return
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT, signal.SIGHUP})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


@contextlib.contextmanager
def _one_thread() -> Iterator[None]:
    before = {name: os.environ.get(name) for name in THREADS}
    os.environ.update(dict.fromkeys(THREADS, "1"))
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                del os.environ[name]
            else:
                os.environ[name] = value


def prepare_worker(path: Sequence[str]) -> None:
    """Prepare a new worker: set the import path of the driver, and end the worker with the driver."""
    sys.path[:] = path
    keep_freed_memory()
    threading.Thread(target=_follow_parent, daemon=True).start()
    # last: until then SIGTERM ends it at once, without a traceback
    signal.signal(signal.SIGTERM, exit_on_signal)


def exit_on_signal(number: int, frame: object) -> None:
    """End this process with the exit status of SIGTERM."""
    raise SystemExit(128 + signal.SIGTERM)  # a filter that is a program ends its own processes


def _follow_parent() -> None:
    """End this process when the driver has ended in any way."""
    parent = multiprocessing.parent_process()
    if parent is not None:
        connection.wait([parent.sentinel])
        os._exit(1)
