"""Processes that bench starts: limits, printed output, and how they end."""

from __future__ import annotations

import contextlib
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import psutil

LOOK = 0.05
"""Interval between two looks at a process [s]."""

PATIENCE = 2.0
"""Time between a signal that asks a process to end and SIGKILL [s]."""

KILL: signal.Signals = getattr(signal, "SIGKILL", signal.SIGTERM)
"""Signal that ends a process at once; Windows has SIGTERM for that."""


def machine_memory() -> float:
    """Return the memory of this machine, or of the container this runs in [byte]."""
    whole = float(psutil.virtual_memory().total)
    with contextlib.suppress(OSError, ValueError):  # no container; "max" is no limit
        return min(whole, float(Path("/sys/fs/cgroup/memory.max").read_text(encoding="ascii")))
    return whole


def measure_memory(pid: int) -> int:
    """Return the resident memory of a process, on Linux without mapped files [byte]; 0 if it is gone."""
    with contextlib.suppress(psutil.Error):
        found = psutil.Process(pid).memory_info()
        return int(found.rss - getattr(found, "shared", 0))
    return 0


def measure_cpu(pid: int) -> float:
    """Return the CPU time of a process [s]; 0 if it is gone."""
    with contextlib.suppress(OSError, psutil.Error):
        if sys.platform == "linux":  # to the nanosecond, not the 10 ms of psutil: see clock_getcpuclockid(3)
            return time.clock_gettime((~pid << 3) | 2)
        used = psutil.Process(pid).cpu_times()
        return float(used.user + used.system)
    return 0.0


def count_work(before: float, now: float, look: float) -> float:
    """Return the part of the time limit of a process that an observation counts [s].

    The CPU time that it has used since the look before; if that is none, the time between the two.
    """
    return now - before if now > before else look


class Watch:
    """Limits on the remaining wall time [s] and the own memory [byte] of a process."""

    def __init__(self, pid: int, seconds: float, memory: float) -> None:
        self._pid, self._seconds, self._memory = pid, seconds, memory
        self._last = time.monotonic()
        self._end = self._last + seconds

    def look(self) -> str:
        """Return the reason to stop the process; empty if it keeps its limits, or was checked just before."""
        now = time.monotonic()
        if now < self._last + LOOK:
            return ""
        self._last = now
        if now > self._end:
            return f"stopped after {self._seconds:g} s (--timeout)"
        if (used := measure_memory(self._pid)) > self._memory:
            return f"stopped: {used / 1e9:.3g} GB of memory, more than {self._memory / 1e9:.3g} GB (--memory)"
        return ""


class Printed:
    """Output of a process, reduced to its begin and its end.

    Parameters
    ----------
    begin, end : int
        Size of the two parts [byte].
    """

    def __init__(self, begin: int = 500_000, end: int = 500_000) -> None:
        self._most_begin, self._most_end = begin, end
        self._begin, self._end, self._left_out = bytearray(), bytearray(), 0

    def add(self, block: bytes) -> None:
        """Add the next block of output."""
        room = self._most_begin - len(self._begin)
        self._begin += block[:room]
        self._end += block[room:]
        if len(self._end) > 2 * self._most_end:
            self._cut()

    def _cut(self) -> None:
        beyond = max(len(self._end) - self._most_end, 0)
        self._left_out += beyond
        del self._end[:beyond]

    @property
    def text(self) -> str:
        """The two parts, with the amount left out between them."""
        self._cut()
        gap = f"\n[{self._left_out} bytes left out]\n" if self._left_out and self._begin else ""
        parts = (bytes(part).decode("utf-8", errors="replace") for part in (self._begin, self._end))
        return gap.join(parts)


def describe_output(most: float) -> str:
    """Return why a process with a solution larger than ``most`` [byte] is stopped."""
    return f"stopped: its solution is larger than {most / 1e6:.4g} MB (--output)"


def describe_end(status: int) -> str:
    """Return how a process ended, by its exit status as `subprocess` gives it."""
    if status < 0:
        return f"ended by signal {signal.Signals(-status).name}"
    return f"ended with exit status {status}"


def find_last_line(text: str) -> str:
    """Return the last line of a text that is not blank; empty if there is none."""
    return next((line.strip() for line in reversed(text.splitlines()) if line.strip()), "")


def end_group(
    child: subprocess.Popen[bytes], first: signal.Signals = signal.SIGTERM, patience: float = PATIENCE
) -> None:
    """End a process that leads a group, and all of the group: by a first signal, then by SIGKILL.

    Windows has no groups: see `end_tree`.
    """
    if sys.platform == "win32":
        end_tree(child)
        return
    for number in (first, KILL):
        with contextlib.suppress(ProcessLookupError, PermissionError):
            os.killpg(child.pid, number)
        with contextlib.suppress(subprocess.TimeoutExpired):
            child.wait(patience)


def end_tree(child: subprocess.Popen[bytes]) -> None:
    """End a process and the processes that it has started, unless their parent has ended before."""
    with contextlib.suppress(psutil.Error):
        own = psutil.Process(child.pid)
        for one in (*own.children(recursive=True), own):
            with contextlib.suppress(psutil.Error):
                one.kill()
    with contextlib.suppress(subprocess.TimeoutExpired):
        child.wait(PATIENCE)
