"""What a process takes is measured on every system."""

from __future__ import annotations

import math
import os
import subprocess
import sys
import time
from types import SimpleNamespace

import psutil
import pytest

from bench.core.files import spawned


@pytest.mark.parametrize("system", [sys.platform, "another"])
def test_the_time_of_a_process_is_told(monkeypatch, system):
    monkeypatch.setattr(sys, "platform", system)
    """Elsewhere than on Linux in 10 ms."""
    assert spawned.measure_cpu(os.getpid()) == pytest.approx(time.process_time(), abs=0.05)


def test_the_memory_of_a_process_is_measured():
    """A process of its own, because an idle one may lose pages to the system meanwhile."""
    code = (
        "import sys; sys.stdin.read(1); kept = b'1' * 64_000_000; print(len(kept), flush=True); "
        "sys.stdin.read(1)"
    )
    pipe = subprocess.PIPE
    with subprocess.Popen([sys.executable, "-c", code], stdin=pipe, stdout=pipe, bufsize=0) as child:
        assert child.stdin is not None
        assert child.stdout is not None
        while psutil.Process(child.pid).status() == psutil.STATUS_RUNNING:
            time.sleep(0.05)
        before = spawned.measure_memory(child.pid)
        child.stdin.write(b"a")
        size = int(child.stdout.readline())
        assert 0.9 * size < spawned.measure_memory(child.pid) - before < 1.5 * size
        child.stdin.write(b"b")


def test_one_that_has_ended_takes_nothing():
    child = subprocess.Popen([sys.executable, "-S", "-c", ""])
    child.wait()
    assert (spawned.measure_memory(child.pid), spawned.measure_cpu(child.pid)) == (0, 0.0)


def test_a_limit_holds_where_mapped_files_are_not_told_apart(monkeypatch):
    """As on macOS, where nothing lies in ``/proc``."""
    monkeypatch.setattr(psutil.Process, "memory_info", lambda _: SimpleNamespace(rss=3_000_000_000))
    monkeypatch.setattr(spawned, "LOOK", 0.0)
    stopped = "stopped: 3 GB of memory, more than 2 GB (--memory)"
    for memory, told in ((2e9, stopped), (4e9, "")):
        assert spawned.Watch(os.getpid(), math.inf, memory).look() == told
