"""Dilution of precision (A-2.1.3), and the choice of the satellite systems by it."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from bench.core.mathematics.arrays import BoolArray, FloatArray, IntArray
from bench.core.records.orbit_sets import LETTERS
from bench.simulation.signals.least_squares import invert

_SYSTEMS = len(LETTERS)


class Dop(NamedTuple):
    """Dilution of precision, a row per epoch; NaN if there are too few satellites."""

    h: FloatArray  # horizontal
    v: FloatArray  # vertical
    p: FloatArray  # position
    t: FloatArray  # time
    g: FloatArray  # geometric


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
        Code of `bench.core.records.orbit_sets`: a clock offset for each system present; TDOP is that of the
        first.
    use : (K,) array of bool or None
        Rows to use; None: all.
    """
    M, n = len(epoch_start) - 1, 3 + _SYSTEMS
    used = np.isfinite(los_n[:, 0]) if use is None else use & np.isfinite(los_n[:, 0])
    epoch = np.repeat(np.arange(M), np.diff(epoch_start))[used]
    G = np.zeros((len(epoch), n))
    G[:, :3] = -los_n[used]
    G[np.arange(len(epoch)), 3 + system[used]] = 1.0
    N = np.zeros((M, n, n))
    for i in range(n):
        for j in range(i + 1 if i < 3 else 3):
            N[:, i, j] = N[:, j, i] = np.bincount(epoch, G[:, i] * G[:, j], M)
    seen = np.stack([np.bincount(epoch, G[:, 3 + k], M) for k in range(_SYSTEMS)], axis=-1)
    clocks = np.arange(3, n)
    N[:, clocks, clocks] = np.maximum(seen, 1.0)  # a system without satellites takes no part
    enough = seen.sum(axis=1) >= 3 + (seen > 0).sum(axis=1)
    inverse, regular = invert(N)
    spread = np.einsum("mii->mi", inverse).copy()
    spread[~(enough & regular)] = np.nan
    h, p = spread[:, 0] + spread[:, 1], spread[:, :3].sum(axis=1)
    of_clocks = np.where(seen > 0, spread[:, 3:], 0.0)
    first = np.take_along_axis(of_clocks, (seen > 0).argmax(axis=1)[:, None], axis=1)[:, 0]
    first[np.isnan(p)] = np.nan
    return Dop(*(np.sqrt(one) for one in (h, spread[:, 2], p, first, p + of_clocks.sum(axis=1))))


def choose_satellites(
    epoch_start: IntArray, los_n: FloatArray, system: IntArray, sd: FloatArray, use: BoolArray
) -> tuple[BoolArray, IntArray]:
    """Choose one system or all for every epoch: smallest PDOP times RMS of the sds (equations #28).

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
        Code of the system, 4 all, -1 if no set gives a position.
    """
    M = len(epoch_start) - 1
    epoch = np.repeat(np.arange(M), np.diff(epoch_start))
    sets = [*(use & (system == k) for k in range(_SYSTEMS)), use]
    figure = np.full((len(sets), M), np.inf)
    for k, rows in enumerate(sets):
        if not rows.any():
            continue
        squares = np.bincount(epoch[rows], sd[rows] ** 2, M)
        count = np.maximum(np.bincount(epoch[rows], minlength=M), 1)
        p = compute_dop(epoch_start, los_n, system, rows).p
        figure[k] = np.where(np.isnan(p), np.inf, p * np.sqrt(squares / count))
    chosen = np.where(np.isfinite(figure).any(axis=0), np.argmin(figure, axis=0), -1)
    of_row = chosen[epoch]
    return use & ((of_row == _SYSTEMS) | (of_row == system)), chosen
