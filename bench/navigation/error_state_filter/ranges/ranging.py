"""Pseudorange and range rate of a satellite: prediction, corrections and rows of H.

    z_range = |r_sat - r_ant| + troposphere + ionosphere + clock + offset - (pseudorange + satellite clock)
    z_rate  = d/dt |r_sat - r_ant| + drift - (range rate + satellite clock rate)

(B-12, B-14b) with the offset of the systems beside GPS only. Both depend on the errors of the antenna along
the line of sight. The delays are computed at the position of the filter, so that any number of satellites
will do. H neglects their change with that position: 3e-4 m per meter of height at the zenith, 3e-3 at 5 deg.

What wanders in a range has states (`range_states.RANGE_ERRORS`), each times the size that the datasheet gives
at this elevation, and is no part of R. Satellites share those of the ionosphere (`ionosphere_anchors`).
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from typing import Any, NamedTuple

import numpy as np

from bench.core.compilation.compiled import KernelTypes, find_addresses, inner, make_caller, types_of
from bench.core.mathematics.arrays import FloatArray, IntArray
from bench.core.mathematics.earth import WGS84, radii_kernel
from bench.core.records.data import GnssObservations
from bench.core.records.sky_spec import SkySpec
from bench.navigation.engine.session import Growing, require, require_rows
from bench.navigation.error_state_filter.antenna_rows import antenna_rows_kernel
from bench.navigation.error_state_filter.measurement_rows import (
    PSEUDORANGE,
    RANGE_RATE,
    ROWS,
    SATELLITE_ROWS,
)
from bench.navigation.error_state_filter.propagation import FilterState, Pending, Site
from bench.navigation.error_state_filter.ranges.ionosphere_anchors import (
    ANCHORS,
    ionosphere_kernel,
    whiten_anchors,
)
from bench.navigation.error_state_filter.ranges.range_states import multipath_sd
from bench.navigation.error_state_filter.ranges.satellite_states import Channels
from bench.navigation.error_state_filter.state_blocks import FIRST_OFFSET, FIRST_RANGE, Index
from bench.simulation.signals import receiver_solution
from bench.simulation.signals.delays import (
    klobuchar_kernel,
    mapping_kernel,
    obliquity_kernel,
    range_kernel,
    range_rate_kernel,
    zenith_troposphere,
)
from bench.simulation.signals.orbits import GPS_EARTH_RATE, L1
from bench.simulation.signals.processing import GROUND, Processing

_E2 = WGS84.e2
_LAYER = 50.0  # step of the table of vertical delays: linear in between to 1e-5 m [m]
_TOP = 12_000.0  # the vertical delay above this height is taken as at this height [m]
_PART = 1e-3  # least share of the variance of a range that is white
_NONE, _TAKEN = -1, -2
_MULTIPATH_DECAY = GROUND.multipath_decay  # [rad]


class SkyRows(NamedTuple):
    """Corrected observations, one row per satellite and epoch."""

    epoch_start: Growing[IntArray]  # (M + 1,)
    values: FloatArray  # (K, 2) range [m] and rate [m/s], corrected for everything but the atmosphere
    variance: FloatArray  # (K, 2)
    sat: FloatArray  # (K, 6) position and velocity, e at transmission
    t: FloatArray  # (K,) time of the GPS day [s]
    ionosphere: FloatArray  # (K,) ionospheric delay over that on L1; 0 with two frequencies [1]
    combined: FloatArray  # (K,) multipath of the range in use over that of one carrier [1]
    which: IntArray  # (K, 5) system, channels of range and rate, state of its own (-1: none), does it begin
    zenith: FloatArray  # (L,) vertical delay of the troposphere by height [m]
    klobuchar: FloatArray  # (8,)
    sin_mask: float
    # (9,) sds [m]: satellites by system, troposphere, ionosphere, its share of the delay [1], multipath at
    # the zenith, and added at the horizon
    sizes: FloatArray
    anchors: FloatArray  # (A, 2) `ionosphere_anchors`
    whiten: FloatArray  # (A, A) the same
    decay: float  # of the correlation of the ionosphere [m]


def empty_sky() -> SkyRows:
    """Return a sky without satellites."""
    none, pairs, which = np.empty(0), np.empty((0, 2)), np.empty((0, 5), np.int64)
    first = np.zeros(1, np.int64)
    return SkyRows(
        first, pairs, pairs, np.empty((0, 6)), none, none, none, which, none, none, 0.0, np.zeros(9),
        np.zeros(ANCHORS.shape), np.zeros((len(ANCHORS), len(ANCHORS))), 1.0,
    )  # fmt: skip


def check_sky(sky: SkyRows) -> None:
    """Check the shapes of a sky that comes from a file, and its epochs.

    Raises
    ------
    ValueError
        With the name of what is wrong.
    """
    count, epochs = len(sky.t), len(sky.epoch_start) - 1
    require_rows("sky", sky, SkyRows._fields[1:8], count)
    require(not count or sky.klobuchar.shape == (8,), "sky/klobuchar", "must have shape (8,)")
    start = sky.epoch_start
    whole = epochs >= 0 and start[0] == 0 and start[-1] == count and bool((np.diff(start) >= 0).all())
    require(whole, "sky/epoch_start", f"must rise from 0 to {count}")
    require(not count or len(sky.zenith) > 1, "sky/zenith", "must be a table")


def correct_observations(o: GnssObservations, sky: SkySpec) -> tuple[FloatArray, FloatArray]:
    """Return range and rate (K, 2) corrected for satellite clock and group delay, and their variances (K, 2).

    With two bands assumed the range is the ionosphere-free combination (B-11).
    """
    processing = Processing(ionosphere="free" if sky.bands == 2 else "klobuchar")
    values = np.column_stack(
        [receiver_solution.correct_pseudoranges(o, processing), o.range_rate[:, 0] + o.sat_clock_rate]
    )
    return values, np.column_stack([o.sd_pseudorange, o.sd_range_rate]) ** 2


def make_sky(
    o: GnssObservations,
    sky: SkySpec,
    values: FloatArray,
    variance: FloatArray,
    rows: IntArray,
    epochs: IntArray,
    count: int,
    lat: float,
    channels: Channels,
) -> SkyRows:
    """Return the rows of a record that are used, as the kernel takes them.

    Parameters
    ----------
    values, variance : (K, 2) arrays
        Range and rate of the rows used and their variances, of :func:`correct_observations`.
    rows, epochs : (K,) arrays of int
        Rows that are used, and the epoch of each, 0 to ``count`` - 1 in ascending order.
    lat : float
        Latitude of the table of vertical delays [rad]; 500 km north or south they differ by 1 mm.
    """
    channel = channels.of_satellites(o)[rows]
    own, fresh = channels.give_states(o, rows)
    free = sky.bands == 2
    return SkyRows(
        epoch_start=np.searchsorted(epochs, np.arange(count + 1)).astype(np.int64),
        values=values,
        variance=variance,
        sat=np.hstack([o.sat_pos_e, o.sat_vel_e])[rows],
        t=o.t[rows] + o.gps_t0,
        ionosphere=np.zeros(len(rows)) if free else (L1 / o.frequency[rows, 0]) ** 2,
        combined=_combine(o.frequency[rows]) if free else np.ones(len(rows)),
        which=np.column_stack([o.system[rows], channel, channel + 1, own, fresh]),
        zenith=zenith_troposphere(lat, np.arange(0.0, _TOP + _LAYER, _LAYER)),
        klobuchar=o.klobuchar.copy(),
        sin_mask=float(np.sin(sky.elevation_mask)),
        sizes=np.array(
            [*sky.space_sd, sky.troposphere_sd, sky.ionosphere_sd, sky.ionosphere_share, *multipath_sd(sky)]
        ),
        anchors=ANCHORS.copy(),
        whiten=whiten_anchors(sky.ionosphere_decay),
        decay=sky.ionosphere_decay,
    )


def _combine(frequency: FloatArray) -> FloatArray:
    """Return the error factor (K,) of the ionosphere-free combination of two carriers (K, 2) (B-11)."""
    gamma = (frequency[:, 1] / frequency[:, 0]) ** 2
    return np.asarray(np.sqrt(1.0 + gamma**2) / (1.0 - gamma))


def join_skies(first: SkyRows, second: SkyRows) -> SkyRows:
    """Return the epochs of two skies of one receiver, in order."""
    end = first.epoch_start[-1]
    start = np.concatenate([first.epoch_start, end + second.epoch_start[1:]])
    both = (np.concatenate(pair) for pair in zip(_by_row(first), _by_row(second), strict=True))
    return _with_rows(second, start, *both)


def take_epochs(sky: SkyRows, epochs: IntArray) -> SkyRows:
    """Return some epochs of a sky, in order."""
    count = np.diff(sky.epoch_start)
    chosen = np.zeros(len(count), np.bool_)
    chosen[epochs] = True
    rows = np.repeat(chosen, count)
    start = np.concatenate([[0], np.cumsum(count[epochs])]).astype(np.int64)
    return _with_rows(sky, start, *(column[rows] for column in _by_row(sky)))


def _by_row(sky: SkyRows) -> tuple[Any, ...]:
    return sky.values, sky.variance, sky.sat, sky.t, sky.ionosphere, sky.combined, sky.which


def _with_rows(sky: SkyRows, *columns: Any) -> SkyRows:
    return SkyRows(*columns, *sky[len(columns) :])


def place_fillers(
    kinds: Iterable[int],
    site: Site,
    sky: SkyRows,
    others: Sequence[tuple[Callable[..., object], KernelTypes]] = (),
) -> IntArray:
    """Return, for each kind of record, the address of the function that fills its rows; 0 for others.

    The addresses of ``others``, each a kernel and its types, come last.
    """
    wanted: dict[int, tuple[Callable[..., object], KernelTypes]] = {}
    for kind in kinds:
        if kind == SATELLITE_ROWS:
            wanted[kind] = satellites_kernel, types_of(0, 0, site, sky)
        else:
            wanted[kind] = ROWS[kind], types_of(0, 0, site)
    wanted |= dict(enumerate(others, max(ROWS) + 1))
    at = np.zeros(max(ROWS) + 1 + len(others), np.int64)
    at[list(wanted)] = find_addresses(list(wanted.values()))
    return at


@inner
def range_state_kernel(k: int, sky: SkyRows, index: Index) -> int:
    """Return the state of the range error of row k; `_NONE`: no range has one, `_TAKEN`: all are taken."""
    first, own = index[FIRST_RANGE + sky.which[k, 0]], sky.which[k, 3]
    if first < 0:
        return _NONE
    return first + own if own >= 0 else _TAKEN


@inner
def renew_kernel(
    epoch: int, now: FilterState, Phi: FloatArray, index: Index, pending: Pending, sky: SkyRows
) -> None:
    """Reset states that are given to other satellites at an epoch; ``Phi`` (n, n) is for a smoother.

    Rows that wait take the error of the satellite before as white.
    """
    P, n = now.P, now.P.shape[0]
    for k in range(sky.epoch_start[epoch], sky.epoch_start[epoch + 1]):
        own: int = range_state_kernel(k, sky, index)
        if own < 0 or sky.which[k, 4] == 0:
            continue
        for a in range(pending.H.shape[0]):
            pending.r[a] += pending.H[a, own] * pending.H[a, own] * P[own, own]
            pending.H[a, own] = 0.0
        for i in range(n):
            P[own, i], P[i, own], Phi[own, i] = 0.0, 0.0, 0.0
        P[own, own], now.state[own + 1] = 1.0, 0.0


@inner
def satellites_kernel(epoch: int, first: int, site: Site, sky: SkyRows) -> int:
    """Fill two rows, range and rate, for each satellite of an epoch above the mask; return their number."""
    now, data, index, pending, _ = site
    state, H, z = now.state, pending.H, pending.z
    n, at = now.P.shape[0], index.clock_offset
    # the last six rows of the slot hold position and velocity of the antenna
    last = first + pending.width - 6
    for j in range(last, last + 6):
        for i in range(n):
            H[j, i] = 0.0
    arm = z[last : last + 6]
    antenna_rows_kernel(site, data.antenna_b, state[:3], state[3:6], H[last : last + 6], arm)
    s, c = np.sin(state[0]), np.cos(state[0])
    sl, cl = np.sin(state[1]), np.cos(state[1])
    _, prime = radii_kernel(s)
    across = (prime + state[2]) * c
    # C_en: north (-s cl, -s sl, c), east (-sl, cl, 0), down (-c cl, -c sl, -s)
    rx = across * cl - s * cl * arm[0] - sl * arm[1] - c * cl * arm[2]
    ry = across * sl - s * sl * arm[0] + cl * arm[1] - c * sl * arm[2]
    rz = (prime * (1.0 - _E2) + state[2]) * s + c * arm[0] - s * arm[2]
    v_n, v_e, v_d = state[3] + arm[3], state[4] + arm[4], state[5] + arm[5]
    vx = -s * cl * v_n - sl * v_e - c * cl * v_d
    vy = -s * sl * v_n + cl * v_e - c * sl * v_d
    vz = c * v_n - s * v_d
    layer = min(max(state[2], 0.0) / _LAYER, float(sky.zenith.shape[0]) - 1.001)
    low = int(layer)
    zenith = sky.zenith[low] + (layer - float(low)) * (sky.zenith[low + 1] - sky.zenith[low])
    row = first
    for k in range(sky.epoch_start[epoch], sky.epoch_start[epoch + 1]):
        sx, sy, sz = sky.sat[k, 0], sky.sat[k, 1], sky.sat[k, 2]
        wx, wy, wz = sky.sat[k, 3], sky.sat[k, 4], sky.sat[k, 5]
        distance, ex, ey, ez = range_kernel(sx, sy, sz, rx, ry, rz, GPS_EARTH_RATE)
        e_n = -s * cl * ex - s * sl * ey + c * ez
        e_e = -sl * ex + cl * ey
        e_d = -c * cl * ex - c * sl * ey - s * ez
        own: int = range_state_kernel(k, sky, index)
        if own == _TAKEN or not -e_d >= sky.sin_mask:
            continue
        a, b = range_rate_kernel(sx, sy, sz, wx, wy, wz, rx, ry, rz, ex, ey, ez, distance, GPS_EARTH_RATE)
        flat, mapping = np.sqrt(e_n * e_n + e_e * e_e), mapping_kernel(-e_d)
        el, delay, broadcast = np.arctan2(-e_d, flat), zenith * mapping, 0.0
        if sky.ionosphere[k] > 0.0 and flat > 0.0:
            broadcast = klobuchar_kernel(
                state[0], state[1], el, e_e / flat, e_n / flat, sky.t[k], sky.klobuchar
            )
            delay += sky.ionosphere[k] * broadcast
        z[row] = distance + delay + state[at + 1] - sky.values[k, 0]
        z[row + 1] = (a - ex * vx - ey * vy - ez * vz) / b + state[at + 2] - sky.values[k, 1]
        # the line of sight turns as the antenna moves across it
        ux, uy, uz = wx - vx, wy - vy, wz - vz
        along = ux * ex + uy * ey + uz * ez
        ux, uy, uz = (ux - along * ex) / distance, (uy - along * ey) / distance, (uz - along * ez) / distance
        u_n = -s * cl * ux - s * sl * uy + c * uz
        u_e = -sl * ux + cl * uy
        u_d = -c * cl * ux - c * sl * uy - s * uz
        for i in range(n):
            p, q, r = H[last, i], H[last + 1, i], H[last + 2, i]
            H[row, i] = -(e_n * p + e_e * q + e_d * r)
            H[row + 1, i] = -(e_n * H[last + 3, i] + e_e * H[last + 4, i] + e_d * H[last + 5, i]) / b - (
                u_n * p + u_e * q + u_d * r
            )
        H[row, at], H[row + 1, at + 1] = 1.0, 1.0
        offset: int = index[FIRST_OFFSET + sky.which[k, 0]]
        if offset >= 0:
            H[row, offset] = 1.0
            z[row] += state[offset + 1]
        pending.r[row], pending.r[row + 1] = sky.variance[k, 0], sky.variance[k, 1]
        left, shared = 0.0, 0
        if index.ionosphere_1 >= 0:
            slant, share = obliquity_kernel(el), sky.sizes[6] * broadcast
            above = np.sqrt(sky.sizes[5] * sky.sizes[5] * slant * slant + share * share) * sky.ionosphere[k]
            shared = sky.anchors.shape[0]
            columns = H[row, index.ionosphere_1 : index.ionosphere_1 + shared]
            left = ionosphere_kernel(el, e_n, e_e, flat, above, sky.anchors, sky.whiten, sky.decay, columns)
        if own >= 0:
            space = sky.sizes[sky.which[k, 0]]
            near = sky.combined[k] * (sky.sizes[7] + sky.sizes[8] * np.exp(-el / _MULTIPATH_DECAY))
            H[row, own] = np.sqrt(left + space * space + near * near)
        if index.troposphere >= 0:
            H[row, index.troposphere] = sky.sizes[4] * mapping
        for j in range(shared + 2):
            i = index.ionosphere_1 + j
            if j == shared:
                i = own
            elif j == shared + 1:
                i = index.troposphere
            if i >= 0:
                z[row] += H[row, i] * state[i + 1]
                pending.r[row] -= H[row, i] * H[row, i]
        pending.r[row] = max(pending.r[row], _PART * sky.variance[k, 0])
        for i in range(2):
            pending.tags[row + i, 0] = PSEUDORANGE if i == 0 else RANGE_RATE
            pending.tags[row + i, 1] = sky.which[k, 1 + i]
            pending.tags[row + i, 2], pending.tags[row + i, 3] = 0, 1
        row += 2
    return row - first


call_satellites = make_caller([satellites_kernel])
"""Call it by its address."""
