"""Which sample instants of the truth an instrument, an outage or a wanted output falls on."""

from __future__ import annotations

import numpy as np

from bench.arrays import BoolArray, FloatArray, IntArray
from bench.units import SAME_INSTANT


def epoch_rows(name: str, t: FloatArray, rate: float) -> IntArray:
    """Return the rows of t nearest to t[0] + k / rate, k = 1, 2, ..., to the end.

    Parameters
    ----------
    name : str
        Who asks, for the message.
    t : (N,) array
        Sample instants [s].
    rate : float
        Wanted rate [Hz].

    Raises
    ------
    ValueError
        When two epochs fall on one sample instant, or none falls within the truth.
    """
    duration = t[-1] - t[0]
    count = int((duration + SAME_INSTANT) * rate)
    if count == 0:
        raise ValueError(f"{name}: no epoch at {rate:g} Hz within {duration:g} s of truth")
    wanted = t[0] + np.arange(1, count + 1) / rate
    after = np.clip(np.searchsorted(t, wanted), 1, len(t) - 1)
    nearer_before = wanted - t[after - 1] < t[after] - wanted
    rows: IntArray = np.where(nearer_before, after - 1, after)
    if not (np.diff(rows) > 0).all():
        truth_rate = (len(t) - 1) / duration
        raise ValueError(f"{name}: rate {rate:g} Hz is above the {truth_rate:g} Hz of the truth")
    return rows


def interval_rows(t: FloatArray, start: float, end: float) -> tuple[int, int]:
    """Return (first, stop) of the rows of t inside [start, end)."""
    first, stop = np.searchsorted(t, [start - SAME_INSTANT, end - SAME_INSTANT])
    return int(first), int(stop)


def in_outage(t: FloatArray, rows: IntArray, outages: tuple[tuple[float, float], ...]) -> BoolArray:
    """Return which rows (M,) of t lie in an outage [start, end)."""
    lost = np.zeros(len(rows), bool)
    for start, end in outages:
        first, stop = interval_rows(t, start, end)
        lost |= (rows >= first) & (rows < stop)
    return lost


def output_times(t: FloatArray, rate: float, outages: tuple[tuple[float, float], ...]) -> FloatArray:
    """Return the instants at which a solution is wanted.

    Parameters
    ----------
    t : (N,) array
        Sample instants of the truth [s].
    rate : float
        Rate of the solutions [Hz].
    outages : tuple of (start, end)
        GNSS outages [s], half open.

    Returns
    -------
    output_t : (M,) array
        Start and end of the truth, every 1 / rate, and the first and last sample instant of each
        outage [s], increasing.
    """
    rows = [0, len(t) - 1]
    for start, end in outages:
        first, stop = interval_rows(t, start, end)
        if first < stop:
            rows += [first, stop - 1]
    return t[np.union1d(epoch_rows("output", t, rate), rows)]
