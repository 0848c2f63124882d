"""Sample epochs of the truth for epochs of an instrument, outages and output times."""

from __future__ import annotations

import numpy as np

from bench.core.mathematics.arrays import BoolArray, FloatArray, IntArray
from bench.core.mathematics.units import SAME_INSTANT


def find_epoch_rows(name: str, t: FloatArray, rate: float) -> IntArray:
    """Return the rows of t (N,) [s] at t[0] + k / rate [Hz], k = 1, 2, ..., as `find_rows` does.

    Raises
    ------
    ValueError
        If two epochs fall on the same sample time, or no epoch is within the truth.
    """
    count = check_duration(name, t, rate)
    return find_rows(name, t, t[0] + np.arange(1, count + 1) / rate)


def check_duration(name: str, t: FloatArray, rate: float) -> int:
    """Return how many epochs at a rate [Hz] are within t (N,) [s]; raise ValueError if there is none."""
    duration = t[-1] - t[0]
    count = int((duration + SAME_INSTANT) * rate)
    if count == 0:
        raise ValueError(f"{name}: no epoch at {rate:g} Hz within {duration:g} s of truth")
    return count


def find_rows(name: str, t: FloatArray, wanted: FloatArray) -> IntArray:
    """Return the first row of t (N,) at or after each time wanted (M,) [s]; ``name`` is for messages.

    A row that lies before an epoch could not be told from the samples until then.

    Raises
    ------
    ValueError
        If two of them fall on the same sample time.
    """
    rows: IntArray = np.searchsorted(t, wanted - SAME_INSTANT)
    if not (rows[1:] > rows[:-1]).all():
        rate, truth_rate = 1.0 / (wanted[1] - wanted[0]), (len(t) - 1) / (t[-1] - t[0])
        raise ValueError(f"{name}: rate {rate:g} Hz is above the {truth_rate:g} Hz of the truth")
    return rows


def find_interval_rows(t: FloatArray, start: float, end: float) -> tuple[int, int]:
    """Return the first row of t inside [start, end) and the row after the last."""
    first, stop = np.searchsorted(t, [start - SAME_INSTANT, end - SAME_INSTANT])
    return int(first), int(stop)


def find_outage_rows(t: FloatArray, rows: IntArray, outages: tuple[tuple[float, float], ...]) -> BoolArray:
    """Return a mask (M,) of the given rows of t that lie in an outage [start, end)."""
    lost = np.zeros(len(rows), bool)
    for start, end in outages:
        first, stop = find_interval_rows(t, start, end)
        lost |= (rows >= first) & (rows < stop)
    return lost


def select_output_times(t: FloatArray, rate: float, outages: tuple[tuple[float, float], ...]) -> FloatArray:
    """Return the epochs of the solutions (M,) [s], increasing.

    Of the epochs t (N,) of the truth: the first and the last, one every 1 / rate [Hz], and the first and
    last of each GNSS outage [start, end).
    """
    rows = [0, len(t) - 1]
    for start, end in outages:
        first, stop = find_interval_rows(t, start, end)
        if first < stop:
            rows += [first, stop - 1]
    chosen = np.sort(np.concatenate([find_epoch_rows("output", t, rate), rows]))
    instants: FloatArray = t[chosen[np.diff(chosen, prepend=-1) > 0]]
    return instants
