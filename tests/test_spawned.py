"""What a process takes is measured on every system."""

from __future__ import annotations

import math
import os
import subprocess
import sys
import time
from types import SimpleNamespace

import numpy as np
import psutil
import pytest

from bench.core.files import spawned


@pytest.mark.parametrize("system", [sys.platform, "another"])
def test_the_time_of_a_process_is_told(monkeypatch, system):
    monkeypatch.setattr(sys, "platform", system)
    """Elsewhere than on Linux in 10 ms."""
    assert spawned.measure_cpu(os.getpid()) == pytest.approx(time.process_time(), abs=0.05)


def test_the_memory_of_a_process_is_told():
    before, until = spawned.measure_memory(os.getpid()), time.monotonic() + 10.0
    kept = np.ones(8_000_000)  # which some systems count late
    while (more := spawned.measure_memory(os.getpid()) - before) < 0.9 * kept.nbytes:
        assert time.monotonic() < until, more
        time.sleep(0.05)
    assert more < 1.5 * kept.nbytes


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
