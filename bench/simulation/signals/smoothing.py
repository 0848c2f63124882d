"""Carrier-smoothed code: the Hatch filter, restarted after a loss of the cycle count.

Hatch, The Synergism of GPS Code and Carrier Measurements, Proc. 3rd Int. Geodetic Symposium on Satellite
Doppler Positioning, 1982.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from bench.core.mathematics.arrays import BoolArray, FloatArray, IntArray
from bench.simulation.signals.orbits import C

_GAP = 3.5  # longest step over the usual one [1]: a few lost epochs do not end an arc; assumed
_JUMP = 5.0  # range minus smoothed range that is no noise [m]; multipath and code noise are below; assumed
_SLIP = 0.5  # change of the phase against the Doppler, beyond what it may turn by in a step [m]; assumed
_TURN = 1.0  # most that the Doppler of a receiver changes, taken over half of a step [m/s^2]; assumed


class Smoothed(NamedTuple):
    """Ranges of one carrier, smoothed."""

    pseudorange: FloatArray  # (K,) [m]
    noise: FloatArray  # (K,) noise over that of a range that is not smoothed [1]
    begun: BoolArray  # (K,) an arc begins here


def smooth_ranges(
    t: FloatArray,
    satellite: IntArray,
    pseudorange: FloatArray,
    phase: FloatArray,
    doppler: FloatArray,
    slipped: BoolArray,
    frequency: FloatArray,
    window: float,
) -> Smoothed:
    """Smooth the ranges of one carrier with its phase.

    Parameters
    ----------
    t : (K,) array
        Time of each row [s]; rows are in order of time.
    satellite : (K,) array of int
        A number for each satellite.
    pseudorange, phase, doppler : (K,) arrays
        [m], [cycles], [Hz] positive when approaching; NaN where missing.
    slipped : (K,) array of bool
        The receiver says that the count of cycles began anew.
    frequency : (K,) array
        Carrier [Hz].
    window : float
        Longest average [s].

    Notes
    -----
    The ionosphere moves code and phase apart: an average over 100 s is late by twice the rate of the delay
    times 100 s, decimeters in a storm. An arc ends at a gap, where the receiver says so, where phase and
    Doppler disagree, and where the range is `_JUMP` off the smoothed one. With gain 1 / n the variance of
    white noise becomes 1 / n of it, and settles at 1 / (2 n - 1) as n stays.
    """
    smoothed, noise, begun = pseudorange.copy(), np.ones(len(t)), np.ones(len(t), bool)
    wave = C / frequency
    carrier, rate = wave * phase, -wave * doppler
    usual = float(np.median(np.diff(np.unique(t)))) if len(np.unique(t)) > 1 else 0.0
    most = max(int(window / usual), 1) if usual > 0 else 1
    for one in np.unique(satellite):
        count, before, variance = 0, -1, 1.0
        for k in np.flatnonzero(satellite == one).tolist():
            if not (np.isfinite(carrier[k]) and np.isfinite(pseudorange[k])):
                before = -1
                continue
            if before >= 0:
                dt, moved = t[k] - t[before], carrier[k] - carrier[before]
                expected = 0.5 * (rate[k] + rate[before]) * dt
                allowed = _SLIP + 0.25 * _TURN * dt * dt
                whole = dt <= _GAP * usual and not slipped[k]
                whole &= not abs(moved - expected) > allowed  # NaN without a Doppler
                guess = smoothed[before] + moved
                if whole and abs(pseudorange[k] - guess) < _JUMP:
                    count = min(count + 1, most)
                    gain = 1.0 / count
                    smoothed[k] = guess + gain * (pseudorange[k] - guess)
                    variance = (1.0 - gain) ** 2 * variance + gain * gain
                    noise[k], begun[k] = np.sqrt(variance), False
                    before = k
                    continue
            count, before, variance = 1, k, 1.0
    return Smoothed(smoothed, noise, begun)
