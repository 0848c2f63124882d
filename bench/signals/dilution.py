"""Dilution of precision (A-2.1.3), and the choice of the satellite systems by it."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from bench.arrays import BoolArray, FloatArray, IntArray
from bench.compiled import kernel
from bench.signals.least_squares import count_kernel, inverse_kernel


class Dop(NamedTuple):
    """Dilution of precision, a row per epoch; NaN if there are too few satellites."""

    h: FloatArray  # horizontal
    v: FloatArray  # vertical
    p: FloatArray  # position
    t: FloatArray  # time
    g: FloatArray  # geometric


@kernel
def _dop_kernel(
    epoch_start: IntArray, los_n: FloatArray, system: IntArray, used: BoolArray, N: FloatArray,
    inverse: FloatArray, out: FloatArray, h: FloatArray,
) -> None:  # fmt: skip
    for m in range(epoch_start.shape[0] - 1):
        N[:] = 0.0
        count, first, second = count_kernel(epoch_start[m], epoch_start[m + 1], system, used, False)
        n = 3 + first + second
        if count < n:
            continue
        for k in range(epoch_start[m], epoch_start[m + 1]):
            if not used[k]:
                continue
            for i in range(3):
                h[i] = -los_n[k, i]
            h[3], h[4] = 0.0, 0.0
            h[4 if first and system[k] != 0 else 3] = 1.0
            for i in range(n):
                for j in range(i + 1):
                    N[i, j] += h[i] * h[j]
        if not inverse_kernel(N, n, inverse):
            continue
        horizontal, vertical = inverse[0, 0] + inverse[1, 1], inverse[2, 2]
        position, clocks = horizontal + vertical, 0.0
        for i in range(3, n):
            clocks += inverse[i, i]
        out[m, 0], out[m, 1], out[m, 2] = np.sqrt(horizontal), np.sqrt(vertical), np.sqrt(position)
        out[m, 3], out[m, 4] = np.sqrt(inverse[3, 3]), np.sqrt(position + clocks)


def compute_dop(
    epoch_start: IntArray, los_n: FloatArray, system: IntArray, use: BoolArray | None = None
) -> Dop:
    """Return the dilution of precision of every epoch (A-2.1.3).

    Parameters
    ----------
    epoch_start : (M + 1,) array of int
        First row of each epoch.
    los_n : (K, 3) array
        Unit vectors receiver to satellite, n.
    system : (K,) array of int
        0 GPS, 1 GLONASS: a clock offset for each system present; TDOP is that of the first.
    use : (K,) array of bool or None
        Rows to use; None: all.
    """
    out = np.full((len(epoch_start) - 1, 5), np.nan)
    used = np.ones(len(los_n), bool) if use is None else np.ascontiguousarray(use)
    epochs, systems = (np.ascontiguousarray(a, np.int64) for a in (epoch_start, system))
    N, inverse = np.empty((5, 5)), np.empty((5, 5))
    _dop_kernel(epochs, np.ascontiguousarray(los_n), systems, used, N, inverse, out, np.zeros(5))
    return Dop(*out.T)


def choose_satellites(
    epoch_start: IntArray, los_n: FloatArray, system: IntArray, sd: FloatArray, use: BoolArray
) -> tuple[BoolArray, IntArray]:
    """Choose GPS, GLONASS or both for every epoch: smallest PDOP times RMS of the sds (equations #28).

    Parameters
    ----------
    epoch_start, los_n, system, use
        As in :func:`compute_dop`.
    sd : (K,) array
        Standard deviation of each range [m].

    Returns
    -------
    use : (K,) array of bool
        Rows of the chosen set.
    chosen : (M,) array of int
        0 GPS, 1 GLONASS, 2 both, -1 if no set gives a position.
    """
    M = len(epoch_start) - 1
    epoch = np.repeat(np.arange(M), np.diff(epoch_start))
    sets = [use & (system == 0), use & (system == 1), use]
    figure = np.full((3, M), np.inf)
    for k, rows in enumerate(sets):
        squares = np.bincount(epoch[rows], sd[rows] ** 2, M)
        count = np.maximum(np.bincount(epoch[rows], minlength=M), 1)
        p = compute_dop(epoch_start, los_n, system, rows).p
        figure[k] = np.where(np.isnan(p), np.inf, p * np.sqrt(squares / count))
    chosen = np.where(np.isfinite(figure).any(axis=0), np.argmin(figure, axis=0), -1)
    of_row = chosen[epoch]
    return use & ((of_row == 2) | (of_row == system)), chosen
