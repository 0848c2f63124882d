"""Orbits and clocks of satellites: Keplerian sets, GLONASS state vectors, nominal constellations.

Times are GPS time in seconds since an origin that the caller chooses (a GPS midnight, or the start of the
run), because small numbers keep their precision. Positions are Earth-fixed at the instant of transmission;
:mod:`bench.signals.delays` rotates them to the instant of reception.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from bench.arrays import FloatArray, IntArray
from bench.compiled import kernel
from bench.orbit_sets import KEPLER, GlonassSets, KeplerSets

C = 299792458.0  # speed of light [m/s], exact
WEEK, DAY = 604800.0, 86400.0  # [s]
GPS_EARTH_RATE = 7.2921151467e-5  # rotation rate of the Earth [rad/s], IS-GPS-200, table 20-IV
_GM_GPS = 3.986005e14  # [m^3/s^2], IS-GPS-200, table 20-IV
_RELATIVITY = -4.442807633e-10  # F of the eccentric clock term [s/sqrt(m)], IS-GPS-200, 20.3.3.3.3.1
_GM_PZ = 3.986004418e14  # [m^3/s^2], PZ-90.11 reference document, 2014
_A_PZ = 6378136.0  # [m], the same
_J2_PZ = 1.08262575e-3  # [1], the same
_RATE_PZ = 7.292115e-5  # [rad/s], the same
_STEP_PZ = 60.0  # longest Runge-Kutta step [s]; error below 1 mm after 15 min

L1, L2 = 1575.42e6, 1227.60e6  # GPS [Hz], IS-GPS-200
_G1, _G1_STEP = 1602.0e6, 562.5e3  # GLONASS L1 and its channel spacing [Hz], GLONASS ICD
_G2, _G2_STEP = 1246.0e6, 437.5e3  # GLONASS L2 [Hz]


class SatelliteStates(NamedTuple):
    """States of satellites at their instants of transmission."""

    pos_e: FloatArray  # (K, 3) [m], e at transmission
    vel_e: FloatArray  # (K, 3) [m/s], e
    clock: FloatArray  # (K,) polynomial of the clock, without relativity [s]
    clock_rate: FloatArray  # (K,) with relativity [s/s]
    relativity: FloatArray  # (K,) eccentric term of the clock [s]


def carrier_frequencies(system: IntArray, channel: IntArray) -> FloatArray:
    """Return the frequencies of both carriers (K, 2) [Hz] of GPS (0) and GLONASS (1) satellites.

    Examples
    --------
    >>> carrier_frequencies(np.array([0, 1]), np.array([0, -7]))
    array([[1.5754200e+09, 1.2276000e+09],
           [1.5980625e+09, 1.2429375e+09]])
    """
    first = np.where(system == 0, L1, _G1 + _G1_STEP * channel)
    second = np.where(system == 0, L2, _G2 + _G2_STEP * channel)
    return np.column_stack([first, second])


@kernel
def _kepler_kernel(
    elements: FloatArray, rows: IntArray, t: FloatArray,
    pos: FloatArray, vel: FloatArray, clock: FloatArray, clock_rate: FloatArray, relativity: FloatArray,
) -> None:  # fmt: skip
    """Fill the states (K, ...) of sets ``rows`` (K,) at ``t`` (K,); IS-GPS-200, tables 20-IV and 30-II."""
    for k in range(t.shape[0]):
        q = elements[rows[k]]
        dt = t[k] - q[0]
        a = q[3] * q[3]
        e = q[4]
        n = np.sqrt(_GM_GPS / a) / a + q[11]
        mean = q[10] + n * dt
        anomaly = mean
        for _ in range(20):
            step = (mean - anomaly + e * np.sin(anomaly)) / (1.0 - e * np.cos(anomaly))
            anomaly += step
            if abs(step) < 1e-14:
                break
        sin_a, cos_a = np.sin(anomaly), np.cos(anomaly)
        p = 1.0 - e * cos_a
        anomaly_rate = n / p
        root = np.sqrt(1.0 - e * e)
        phi = np.arctan2(root * sin_a, cos_a - e) + q[9]
        phi_rate = root * anomaly_rate / p
        s2, c2 = np.sin(2.0 * phi), np.cos(2.0 * phi)
        u = phi + q[13] * s2 + q[12] * c2
        r = a * p + q[15] * s2 + q[14] * c2
        incl = q[5] + q[17] * s2 + q[16] * c2 + q[6] * dt
        u_rate = phi_rate * (1.0 + 2.0 * (q[13] * c2 - q[12] * s2))
        r_rate = a * e * sin_a * anomaly_rate + 2.0 * phi_rate * (q[15] * c2 - q[14] * s2)
        incl_rate = q[6] + 2.0 * phi_rate * (q[17] * c2 - q[16] * s2)
        node_rate = q[8] - GPS_EARTH_RATE
        node = q[7] + node_rate * dt - GPS_EARTH_RATE * q[1]
        su, cu, si, ci, sn, cn = np.sin(u), np.cos(u), np.sin(incl), np.cos(incl), np.sin(node), np.cos(node)
        x, y = r * cu, r * su
        vx, vy = r_rate * cu - y * u_rate, r_rate * su + x * u_rate
        pos[k, 0] = x * cn - y * ci * sn
        pos[k, 1] = x * sn + y * ci * cn
        pos[k, 2] = y * si
        across = vy * ci - y * si * incl_rate
        vel[k, 0] = vx * cn - across * sn - pos[k, 1] * node_rate
        vel[k, 1] = vx * sn + across * cn + pos[k, 0] * node_rate
        vel[k, 2] = vy * si + y * ci * incl_rate
        since = t[k] - q[2]
        clock[k] = q[18] + since * (q[19] + since * q[20])
        relativity[k] = _RELATIVITY * e * q[3] * sin_a
        clock_rate[k] = q[19] + 2.0 * since * q[20] + _RELATIVITY * e * q[3] * cos_a * anomaly_rate


@kernel
def _acceleration_kernel(s: FloatArray, sun_moon: FloatArray, out: FloatArray) -> None:
    """Fill out (6,) with the rate of the Earth-fixed state s (6,): GLONASS ICD 5.1, A.3.1.2."""
    r2 = s[0] * s[0] + s[1] * s[1] + s[2] * s[2]
    central = -_GM_PZ / (r2 * np.sqrt(r2))
    flat = 1.5 * _J2_PZ * _A_PZ * _A_PZ / r2
    z2 = 5.0 * s[2] * s[2] / r2
    across = central * (1.0 + flat * (1.0 - z2)) + _RATE_PZ * _RATE_PZ
    out[0], out[1], out[2] = s[3], s[4], s[5]
    out[3] = across * s[0] + 2.0 * _RATE_PZ * s[4] + sun_moon[0]
    out[4] = across * s[1] - 2.0 * _RATE_PZ * s[3] + sun_moon[1]
    out[5] = central * (1.0 + flat * (3.0 - z2)) * s[2] + sun_moon[2]


@kernel
def _move_kernel(s: FloatArray, h: float, rate: FloatArray, out: FloatArray) -> None:
    """Fill out (6,) with s (6,) moved by a rate (6,) for h [s]."""
    for i in range(6):
        out[i] = s[i] + h * rate[i]


@kernel
def _glonass_kernel(
    state: FloatArray, rows: IntArray, t: FloatArray, longest: float, work: FloatArray,
    pos: FloatArray, vel: FloatArray, clock: FloatArray, clock_rate: FloatArray,
) -> None:  # fmt: skip
    """Integrate sets ``rows`` (K,) to ``t`` (K,) with fourth-order Runge-Kutta; work (6, 6)."""
    s, probe = work[0], work[1]
    for k in range(t.shape[0]):
        q = state[rows[k]]
        span = t[k] - q[0]
        for i in range(6):
            s[i] = q[1 + i]
        steps = int(np.ceil(abs(span) / longest))
        h = span / steps if steps > 0 else 0.0
        for _ in range(steps):
            _acceleration_kernel(s, q[7:10], work[2])
            _move_kernel(s, 0.5 * h, work[2], probe)
            _acceleration_kernel(probe, q[7:10], work[3])
            _move_kernel(s, 0.5 * h, work[3], probe)
            _acceleration_kernel(probe, q[7:10], work[4])
            _move_kernel(s, h, work[4], probe)
            _acceleration_kernel(probe, q[7:10], work[5])
            for i in range(6):
                s[i] += h / 6.0 * (work[2, i] + 2.0 * work[3, i] + 2.0 * work[4, i] + work[5, i])
        for i in range(3):
            pos[k, i], vel[k, i] = s[i], s[3 + i]
        clock[k] = q[10] + q[11] * span
        clock_rate[k] = q[11]


def compute_states(sets: KeplerSets | GlonassSets, rows: IntArray, t: FloatArray) -> SatelliteStates:
    """Compute the states of satellites at given instants.

    Parameters
    ----------
    sets : KeplerSets or GlonassSets
        Ephemerides.
    rows : (K,) array of int
        Row of the set to use at each instant.
    t : (K,) array
        Instants of transmission, GPS time since the origin of ``sets`` [s].

    Notes
    -----
    Kepler sets: IS-GPS-200, table 20-IV, velocity by its derivative. GLONASS: Earth-fixed equations of motion
    with J2 and the broadcast luni-solar acceleration, Runge-Kutta of fourth order with steps up to 60 s;
    PZ-90.11 and WGS 84 agree to centimetres, so its axes are taken for e.
    """
    t = np.ascontiguousarray(t, float)
    rows = np.ascontiguousarray(rows, np.int64)
    count = len(t)
    pos, vel = np.empty((count, 3)), np.empty((count, 3))
    clock, rate, relativity = np.empty(count), np.empty(count), np.zeros(count)
    if isinstance(sets, KeplerSets):
        _kepler_kernel(sets.elements, rows, t, pos, vel, clock, rate, relativity)
    else:
        _glonass_kernel(sets.state, rows, t, _STEP_PZ, np.empty((6, 6)), pos, vel, clock, rate)
    return SatelliteStates(pos, vel, clock, rate, relativity)


def find_nearest(sets: KeplerSets | GlonassSets, sat: IntArray, t: FloatArray, oldest: float) -> IntArray:
    """Return the row (K,) of the healthy set nearest in time for each satellite (K,) and instant t (K,) [s].

    It is -1 if no reference time is within ``oldest`` [s]. The sets may be in any order.
    """
    found = np.full(len(t), -1, np.int64)
    for number in np.unique(sat):
        own = np.flatnonzero((sets.sat == number) & sets.healthy)
        if len(own) == 0:
            continue
        own = own[np.argsort(sets.t[own], kind="stable")]
        rows = np.flatnonzero(sat == number)
        after = np.clip(np.searchsorted(sets.t[own], t[rows]), 1, len(own) - 1) if len(own) > 1 else 0
        later = own[after]
        before = own[np.maximum(np.asarray(after) - 1, 0)]
        closer = np.abs(sets.t[before] - t[rows]) <= np.abs(sets.t[later] - t[rows])
        best = np.where(closer, before, later)
        found[rows] = np.where(np.abs(sets.t[best] - t[rows]) <= oldest, best, -1)
    return found


def find_transmission(
    sets: KeplerSets | GlonassSets, rows: IntArray, t: FloatArray, pseudorange: FloatArray
) -> tuple[FloatArray, SatelliteStates]:
    """Compute the instants of transmission (K,) [s] and the satellites there, from measurements alone.

    Parameters
    ----------
    sets, rows : KeplerSets or GlonassSets, (K,) array of int
        The ephemerides to use.
    t : (K,) array
        Time of reception by the receiver's clock [s].
    pseudorange : (K,) array
        [m]; ``t - pseudorange / c`` is the reading of the satellite's clock, for any error of the receiver's.
    """
    shown = t - pseudorange / C
    first = compute_states(sets, rows, shown)
    t_sent = shown - (first.clock + first.relativity)
    return t_sent, compute_states(sets, rows, t_sent)


def make_walker(
    planes: int, per_plane: int, phasing: int, *, semi_axis: float, inclination: float, node_0: float = 0.0
) -> KeplerSets:
    """Make a Walker constellation T/P/F: evenly spaced circular orbits with perfect clocks, at t = 0.

    ``T = planes * per_plane``, F is the phasing; the angles are in rad, ``semi_axis`` in m, ``node_0`` is the
    longitude of the first node at t = 0.
    """
    total = planes * per_plane
    elements = np.zeros((total, len(KEPLER)))
    plane, place = np.divmod(np.arange(total), per_plane)
    elements[:, KEPLER.index("sqrt_a")] = np.sqrt(semi_axis)
    elements[:, KEPLER.index("i_0")] = inclination
    elements[:, KEPLER.index("node_0")] = node_0 + 2 * np.pi * plane / planes
    elements[:, KEPLER.index("mean_anomaly")] = 2 * np.pi * (place / per_plane + phasing * plane / total)
    return KeplerSets(np.arange(1, total + 1), np.ones(total, bool), elements)


def make_nominal_gps() -> KeplerSets:
    """Return 24 satellites in 6 planes at 55 deg, 26 560 km (A-2.1.2)."""
    return make_walker(6, 4, 1, semi_axis=26.56e6, inclination=np.deg2rad(55.0))


def make_nominal_glonass() -> KeplerSets:
    """Return 24 satellites in 3 planes at 64.8 deg, 19 100 km high (A-2.1.2)."""
    return make_walker(3, 8, 1, semi_axis=_A_PZ + 19.1e6, inclination=np.deg2rad(64.8))


class Track(NamedTuple):
    """Positions and clocks of satellites over a span of time as polynomials."""

    t_0: float  # start of the first interval [s]
    step: float  # length of an interval [s]
    coefficients: FloatArray  # (S, I, 8, 4) of x, y, z [m], clock [m], in u from -1 to 1 over each interval


_NODES = 8  # per interval: the next term of an orbit is below 1e-8 m over five minutes
TRACK_STEP = 300.0  # [s]


def fit_track(sets: KeplerSets | GlonassSets, t_0: float, t_1: float) -> tuple[IntArray, Track]:
    """Fit polynomials to the satellites of ``sets`` over a span of time.

    Parameters
    ----------
    sets : KeplerSets or GlonassSets
        Ephemerides; each interval of five minutes uses the set with the nearest reference time.
    t_0, t_1 : float
        Start and end of the span [s].

    Returns
    -------
    sat : (S,) array of int
        Healthy satellites.
    track : Track
        Their positions, and their clocks with relativity.
    """
    intervals = max(1, int(np.ceil((t_1 - t_0) / TRACK_STEP)))
    middle = t_0 + TRACK_STEP * (np.arange(intervals) + 0.5)
    numbers = np.unique(sets.sat[sets.healthy])
    if len(numbers) == len(sets):
        rows = np.repeat(np.argsort(sets.sat), intervals)
    else:
        rows = find_nearest(sets, np.repeat(numbers, intervals), np.tile(middle, len(numbers)), np.inf)
    u = np.cos(np.pi * (np.arange(_NODES) + 0.5) / _NODES)
    t = np.tile(middle, len(numbers))[:, None] + 0.5 * TRACK_STEP * u
    found = compute_states(sets, np.repeat(rows, _NODES), t.ravel())
    values = np.column_stack([found.pos_e, C * (found.clock + found.relativity)])
    values = values.reshape(len(rows), _NODES, 4)
    powers = np.linalg.inv(np.vander(u, increasing=True))
    coefficients = np.einsum("pn,rnc->rpc", powers, values)
    shape = (len(numbers), intervals, _NODES, 4)
    return numbers, Track(t_0, TRACK_STEP, np.ascontiguousarray(coefficients.reshape(shape)))


@kernel
def track_kernel(
    t_0: float, step: float, coefficients: FloatArray, s: int, t: float, rates: bool, out: FloatArray
) -> None:
    """Fill out (8,) with x, y, z, clock [m] of satellite s at t and, with ``rates``, their rates [m/s]."""
    last = coefficients.shape[1] - 1
    i = min(max(int((t - t_0) / step), 0), last)
    u = 2.0 * (t - t_0 - i * step) / step - 1.0
    top = coefficients.shape[2] - 1
    if rates:
        for c in range(4):
            value, rate = coefficients[s, i, top, c], 0.0
            for p in range(top - 1, -1, -1):
                rate = rate * u + value
                value = value * u + coefficients[s, i, p, c]
            out[c], out[4 + c] = value, rate * 2.0 / step
    else:
        x, y, z = coefficients[s, i, top, 0], coefficients[s, i, top, 1], coefficients[s, i, top, 2]
        for p in range(top - 1, -1, -1):
            x = x * u + coefficients[s, i, p, 0]
            y = y * u + coefficients[s, i, p, 1]
            z = z * u + coefficients[s, i, p, 2]
        out[0], out[1], out[2] = x, y, z
