"""Satellites from tables of precise orbits and clocks: interpolation in time."""

from __future__ import annotations

import numpy as np

from bench.core.mathematics.arrays import FloatArray, IntArray
from bench.core.records.orbit_sets import OrbitTable
from bench.simulation.signals.orbits import EARTH_RATES, GRAVITY, C, SatelliteStates

NODES = 10
"""Epochs to a polynomial, order 9: with epochs every 15 min it follows an orbit of 12 h within 0.1 mm in the
middle, and within 1 cm in the first and last interval of a table."""


def find_rows(table: OrbitTable, sat: IntArray, t: FloatArray) -> IntArray:
    """Return the row (K,) of each satellite (K,) if it can be interpolated at t (K,) [s], else -1."""
    rows = np.full(len(t), -1, np.int64)
    if len(table.t) < NODES:
        return rows
    order = np.argsort(table.sat, kind="stable")
    place = np.searchsorted(table.sat[order], sat).clip(0, len(order) - 1)
    row = order[place]
    inside = (table.sat[row] == sat) & (t >= table.t[0]) & (t <= table.t[-1])
    interval, first = _place(table, t)
    whole = np.cumsum(np.pad(table.joined[:, :, 0], [(0, 0), (1, 0)]), axis=1)
    whole_orbit = whole[row, first + NODES - 1] - whole[row, first] == NODES - 1
    inside &= whole_orbit & table.joined[row, interval, 1]
    return np.where(inside, row, rows)


def _place(table: OrbitTable, t: FloatArray) -> tuple[IntArray, IntArray]:
    """Return the interval between two epochs (K,) that contains t, and the first node of the polynomial."""
    last = len(table.t) - 2
    interval = np.clip(np.searchsorted(table.t, t, side="right") - 1, 0, last)
    return interval, np.clip(interval - NODES // 2 + 1, 0, len(table.t) - NODES)


def compute_states(table: OrbitTable, rows: IntArray, t: FloatArray) -> SatelliteStates:
    """Compute the states of satellites ``rows`` (K,) of a table at t (K,) [s], found by `find_rows`.

    Positions by Neville's polynomial through ten epochs, in axes that do not turn and are e at t; velocity
    is its derivative. Clocks are linear between two epochs; their eccentric term, -2 r . v / c^2, is left
    out of the files for every system (IGS; IS-GPS-200, 20.3.3.3.3.1).
    """
    rate = EARTH_RATES[table.system]
    interval, first = _place(table, t)
    nodes = first[:, None] + np.arange(NODES)
    away = table.t[nodes] - t[:, None]  # (K, NODES)
    place = table.pos_e[rows[:, None], nodes]
    s, c = np.sin(rate * away), np.cos(rate * away)
    x, y = place[..., 0], place[..., 1]
    value = np.stack([c * x - s * y, s * x + c * y, place[..., 2]], axis=-1)
    slope = np.zeros_like(value)
    for m in range(1, NODES):
        low, high = away[:, :-m, None], away[:, m:, None]
        span = high - low
        left, right = value[:, :-1], value[:, 1:]
        slope = (high * slope[:, :-1] - low * slope[:, 1:] - left + right) / span
        value = (high * left - low * right) / span
    pos, inertial = value[:, 0], slope[:, 0]
    vel = inertial + rate * np.column_stack([pos[:, 1], -pos[:, 0], np.zeros(len(t))])
    before, after = table.t[interval], table.t[interval + 1]
    one, two = table.clock[rows, interval], table.clock[rows, interval + 1]
    clock_rate = (two - one) / (after - before)
    fall = np.einsum("ki,ki->k", inertial, inertial) - GRAVITY[table.system] / np.linalg.norm(pos, axis=1)
    return SatelliteStates(
        pos_e=pos,
        vel_e=vel,
        clock=one + clock_rate * (t - before),
        clock_rate=clock_rate - 2.0 * fall / C**2,
        relativity=-2.0 * np.einsum("ki,ki->k", pos, inertial) / C**2,
    )


def find_stated_sd(table: OrbitTable, rows: IntArray, t: FloatArray) -> FloatArray:
    """Return the accuracy (K,) [m] in the file for satellites ``rows`` (K,) at t (K,) [s]."""
    interval, _ = _place(table, t)
    return np.asarray(np.maximum(table.sd[rows, interval], table.sd[rows, interval + 1]))
