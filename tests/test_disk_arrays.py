"""Large arrays lie on disk, and a flight four times as long takes hardly more memory."""

from __future__ import annotations

import gc
import os
import tracemalloc

import numpy as np
import psutil
import pytest
from numpy.testing import assert_array_equal

from bench.core.files import disk_arrays
from bench.core.records.specs import EvaluationWindow
from bench.evaluation.metrics import run_metrics
from bench.navigation import built_in
from bench.simulation import sensors
from tests.weaving import units, weaving

pytestmark = pytest.mark.skipif(not hasattr(os, "posix_fallocate"), reason="arrays lie in memory here")


def resident() -> int:
    """Return how much of this process is in memory [byte]."""
    return int(psutil.Process().memory_info().rss)


def test_what_is_released_leaves_memory_and_keeps_its_values(monkeypatch, tmp_path):
    monkeypatch.setenv("BENCH_CACHE", str(tmp_path))
    array = disk_arrays.zeros((400_000, 10))
    before = resident()
    array[:] = np.arange(10)
    disk_arrays.release()
    assert resident() - before > 30e6  # less than is worth it
    monkeypatch.setattr(disk_arrays, "SPARED", 0)
    disk_arrays.release()
    assert resident() - before < 3e6
    assert_array_equal(array.sum(axis=0), 400_000 * np.arange(10))
    assert list((tmp_path / "scratch").iterdir()) == []  # its file has no name
    del array
    gc.collect()
    assert resident() - before < 3e6


def test_small_arrays_and_those_without_a_place_on_disk_lie_in_memory(monkeypatch, tmp_path):
    (tmp_path / "file").touch()
    monkeypatch.setenv("BENCH_CACHE", str(tmp_path / "file"))
    for rows in (10, disk_arrays.LARGE // 8):
        array = disk_arrays.zeros(rows)
        assert array.base is None
        assert not array.any()


def test_taken_rows_are_those_of_the_array(monkeypatch):
    monkeypatch.setattr(disk_arrays, "ROWS", 7)
    array = np.random.default_rng(1).normal(size=(50, 3))
    rows = np.array([0, 0, 6, 7, 8, 30, 49])
    assert_array_equal(disk_arrays.take(array, rows), array[rows])


def test_a_longer_flight_takes_hardly_more_memory(monkeypatch):
    """To sense, navigate and evaluate it, with blocks of 4096 samples instead of 65,536.

    What grows with each sample is the biases that were drawn (56 B for every 2.5 samples), fixes (168 B for
    every 50), barometer (40 B for every 10), and some hundred B of errors and metrics for every 50:
    97 B in all. A filter that takes the record as a whole needs 700 B for each sample.
    """
    monkeypatch.setattr(disk_arrays, "ROWS", 4096)
    monkeypatch.setattr(disk_arrays, "LARGE", 1 << 17)
    spec = units()
    object.__setattr__(spec, "output_rate", 1.0)
    peaks = []
    for minutes in (6, 8, 32):  # the first compiles what the others use
        truth = weaving(60.0 * minutes, 50.0)
        if minutes > 6:
            tracemalloc.start()
        sensed = sensors.sense(truth, spec, 1, 0)
        solution = built_in.load("loose-15", {}).run(sensed.data, sensed.initial)
        run_metrics.measure(
            truth, solution, evaluation=EvaluationWindow(60.0), outages=(), assumed=spec.assumed
        )
        peaks.append(tracemalloc.get_traced_memory()[1])
        tracemalloc.stop()
    more = (peaks[2] - peaks[1]) / (60 * 24 * 50)
    assert more < 120, f"{more:.0f} B for each sample, {peaks[1] / 1e6:.1f} and {peaks[2] / 1e6:.1f} MB"
