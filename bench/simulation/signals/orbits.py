"""Orbits and clocks of satellites: Keplerian sets, GLONASS state vectors, nominal constellations.

Times are GPS time in seconds since an origin that the caller chooses (a GPS midnight, or the start of the
run), because small numbers keep their precision. Positions are Earth-fixed at the time of transmission;
:mod:`bench.simulation.signals.delays` rotates them to the time of reception.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from bench.core.compilation.compiled import kernel
from bench.core.mathematics.arrays import BoolArray, FloatArray, IntArray
from bench.core.records.orbit_sets import BEIDOU, GALILEO, GLONASS, GPS, KEPLER, GlonassSets, KeplerSets

C = 299792458.0  # speed of light [m/s], exact
WEEK, DAY = 604800.0, 86400.0  # [s]
GPS_EARTH_RATE = 7.2921151467e-5  # rotation rate of the Earth [rad/s], IS-GPS-200, table 20-IV
_GM_PZ = 3.986004418e14  # [m^3/s^2], PZ-90.11 reference document, 2014
_A_PZ = 6378136.0  # [m], the same
_J2_PZ = 1.08262575e-3  # [1], the same
_RATE_PZ = 7.292115e-5  # [rad/s], the same
STEP_PZ = 60.0  # longest Runge-Kutta step [s]; error below 1 mm after 15 min
GRAVITY = {GPS: 3.986005e14, GALILEO: 3.986004418e14, BEIDOU: 3.986004418e14, GLONASS: _GM_PZ}
"""[m^3/s^2]: IS-GPS-200, table 20-IV; Galileo OS SIS ICD 2.0, table 67; BDS-SIS-ICD-B1I-3.0, 5.2.4.12."""
EARTH_RATES = {GPS: GPS_EARTH_RATE, GALILEO: GPS_EARTH_RATE, BEIDOU: 7.292115e-5, GLONASS: _RATE_PZ}
"""Rotation of the Earth [rad/s], the same sources."""
_INCLINED = float(np.deg2rad(-5.0))  # of the frame of geostationary orbits [rad], BDS-SIS-ICD-B1I-3.0
INCLINED = np.array(
    [
        [1.0, 0.0, 0.0],
        [0.0, np.cos(_INCLINED), np.sin(_INCLINED)],
        [0.0, -np.sin(_INCLINED), np.cos(_INCLINED)],
    ]
)
"""Turns vectors (3,) from the frame of geostationary orbits to e at their reference time."""

L1, L2 = 1575.42e6, 1227.60e6  # GPS [Hz], IS-GPS-200
_CARRIERS = np.full((4, 10), np.nan)
"""Carrier [Hz] by system and RINEX band digit: RINEX 3.05, tables 11 to 17; GLONASS at channel 0."""
for _system, _bands in (
    (GPS, {1: L1, 2: L2, 5: 1176.45e6}),
    (GLONASS, {1: 1602.0e6, 2: 1246.0e6, 3: 1202.025e6, 4: 1600.995e6, 6: 1248.06e6}),
    (GALILEO, {1: L1, 5: 1176.45e6, 6: 1278.75e6, 7: 1207.14e6, 8: 1191.795e6}),
    (BEIDOU, {1: L1, 2: 1561.098e6, 5: 1176.45e6, 6: 1268.52e6, 7: 1207.14e6, 8: 1191.795e6}),
):
    _CARRIERS[_system, list(_bands)] = list(_bands.values())
_IGSO = float(np.deg2rad(118.0))  # where nominal inclined geosynchronous satellites cross the equator [rad]
_SET_COLUMNS = ("sat", "healthy", "elements")
_STEPS = np.zeros((4, 10))
_STEPS[GLONASS, [1, 2]] = 562.5e3, 437.5e3  # channel spacing of G1 and G2 [Hz], GLONASS ICD


class SatelliteStates(NamedTuple):
    """States of satellites at their epochs of transmission."""

    pos_e: FloatArray  # (K, 3) [m], e at transmission
    vel_e: FloatArray  # (K, 3) [m/s], e
    clock: FloatArray  # (K,) polynomial of the clock, without relativity [s]
    clock_rate: FloatArray  # (K,) with relativity [s/s]
    relativity: FloatArray  # (K,) eccentric term of the clock [s]


def find_frequency(system: IntArray, band: IntArray, channel: IntArray) -> FloatArray:
    """Return the carrier [Hz] of a system, a RINEX band digit and, for GLONASS, a channel; NaN if none.

    Examples
    --------
    >>> find_frequency(np.array([0, 1, 3]), np.array([1, 1, 2]), np.array([0, -7, 0])).tolist()
    [1575420000.0, 1598062500.0, 1561098000.0]
    """
    found: FloatArray = _CARRIERS[system, band] + _STEPS[system, band] * channel
    return found


def carrier_frequencies(system: IntArray, channel: IntArray) -> FloatArray:
    """Return the frequencies (K, 2) [Hz] of the two carriers that a receiver of two bands uses.

    GPS L1 and L2, GLONASS G1 and G2, Galileo E1 and E5a, BeiDou B1I and B3I.

    Examples
    --------
    >>> carrier_frequencies(np.array([0, 1]), np.array([0, -7]))
    array([[1.5754200e+09, 1.2276000e+09],
           [1.5980625e+09, 1.2429375e+09]])
    """
    pair = np.array([(1, 2), (1, 2), (1, 5), (2, 6)])[system]
    return np.column_stack([find_frequency(system, pair[:, k], channel) for k in range(2)])


def is_geostationary(sets: KeplerSets) -> BoolArray:
    """Return which sets (E,) are of geostationary satellites of BeiDou: C01 to C05, C59 and above.

    BDS-SIS-ICD-B1I-3.0 (2019), 5.2.4.12, has other formulas for these; the numbers are those of RTKLIB.
    """
    return (sets.system == BEIDOU) & ((sets.sat <= 5) | (sets.sat >= 59))


def _compute_kepler(sets: KeplerSets, rows: IntArray, t: FloatArray) -> SatelliteStates:
    """Return the states (K, ...) of sets ``rows`` (K,) at ``t`` (K,); IS-GPS-200, tables 20-IV and 30-II."""
    q = dict(zip(KEPLER, sets.elements[rows].T, strict=True))
    gm, rate = GRAVITY[sets.system], EARTH_RATES[sets.system]
    relativity = -2.0 * np.sqrt(gm) / C**2  # F of IS-GPS-200, 20.3.3.3.3.1 [s/sqrt(m)]
    dt, a, e = t - q["t_oe"], q["sqrt_a"] ** 2, q["e"]
    n = np.sqrt(gm / a) / a + q["delta_n"]
    mean = q["mean_anomaly"] + n * dt
    anomaly, going = mean, np.ones(len(t), bool)
    for _ in range(20):  # no bit depends on the other epochs
        step = np.where(going, (mean - anomaly + e * np.sin(anomaly)) / (1.0 - e * np.cos(anomaly)), 0.0)
        anomaly = anomaly + step
        going = np.abs(step) >= 1e-14
        if not going.any():
            break
    sin_a, cos_a = np.sin(anomaly), np.cos(anomaly)
    p = 1.0 - e * cos_a
    anomaly_rate = n / p
    root = np.sqrt(1.0 - e * e)
    phi = np.arctan2(root * sin_a, cos_a - e) + q["perigee"]
    phi_rate = root * anomaly_rate / p
    s2, c2 = np.sin(2.0 * phi), np.cos(2.0 * phi)
    u = phi + q["c_us"] * s2 + q["c_uc"] * c2
    r = a * p + q["c_rs"] * s2 + q["c_rc"] * c2
    incl = q["i_0"] + q["c_is"] * s2 + q["c_ic"] * c2 + q["i_rate"] * dt
    u_rate = phi_rate * (1.0 + 2.0 * (q["c_us"] * c2 - q["c_uc"] * s2))
    r_rate = a * e * sin_a * anomaly_rate + 2.0 * phi_rate * (q["c_rs"] * c2 - q["c_rc"] * s2)
    incl_rate = q["i_rate"] + 2.0 * phi_rate * (q["c_is"] * c2 - q["c_ic"] * s2)
    fixed = is_geostationary(sets)[rows]
    node_rate = q["node_rate"] - np.where(fixed, 0.0, rate)
    node = q["node_0"] + node_rate * dt - rate * q["t_oe_week"]
    su, cu, si, ci, sn, cn = np.sin(u), np.cos(u), np.sin(incl), np.cos(incl), np.sin(node), np.cos(node)
    x, y = r * cu, r * su
    vx, vy = r_rate * cu - y * u_rate, r_rate * su + x * u_rate
    pos = np.column_stack([x * cn - y * ci * sn, x * sn + y * ci * cn, y * si])
    across = vy * ci - y * si * incl_rate
    vel = np.column_stack(
        [
            vx * cn - across * sn - pos[:, 1] * node_rate,
            vx * sn + across * cn + pos[:, 0] * node_rate,
            vy * si + y * ci * incl_rate,
        ]
    )
    if fixed.any():
        pos[fixed], vel[fixed] = _turn_geostationary(pos[fixed], vel[fixed], rate, dt[fixed])
    since = t - q["t_oc"]
    return SatelliteStates(
        pos_e=pos,
        vel_e=vel,
        clock=q["af_0"] + since * (q["af_1"] + since * q["af_2"]),
        clock_rate=q["af_1"] + 2.0 * since * q["af_2"] + relativity * e * q["sqrt_a"] * cos_a * anomaly_rate,
        relativity=relativity * e * q["sqrt_a"] * sin_a,
    )


def _turn_geostationary(
    pos: FloatArray, vel: FloatArray, rate: float, dt: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return states (K, 3) of geostationary BeiDou satellites, Earth-fixed: R_z(rate dt) R_x(-5 deg).

    BDS-SIS-ICD-B1I-3.0 (2019), 5.2.4.12: their orbits are given in a frame that is inclined by 5 deg.
    """
    (px, py, pz), (vx, vy, vz) = INCLINED @ pos.T, INCLINED @ vel.T
    s, c = np.sin(rate * dt), np.cos(rate * dt)
    x, y = c * px + s * py, -s * px + c * py
    return (
        np.column_stack([x, y, pz]),
        np.column_stack([c * vx + s * vy + rate * y, -s * vx + c * vy - rate * x, vz]),
    )


def _accelerate(s: FloatArray, sun_moon: FloatArray) -> FloatArray:
    """Return the rate (6, K) of Earth-fixed states s (6, K): GLONASS ICD 5.1, A.3.1.2."""
    r2 = s[0] * s[0] + s[1] * s[1] + s[2] * s[2]
    central = -_GM_PZ / (r2 * np.sqrt(r2))
    flat = 1.5 * _J2_PZ * _A_PZ * _A_PZ / r2
    z2 = 5.0 * s[2] * s[2] / r2
    across = central * (1.0 + flat * (1.0 - z2)) + _RATE_PZ * _RATE_PZ
    out = np.empty_like(s)
    out[:3] = s[3:]
    out[3] = across * s[0] + 2.0 * _RATE_PZ * s[4] + sun_moon[0]
    out[4] = across * s[1] - 2.0 * _RATE_PZ * s[3] + sun_moon[1]
    out[5] = central * (1.0 + flat * (3.0 - z2)) * s[2] + sun_moon[2]
    return out


def _compute_glonass(sets: GlonassSets, rows: IntArray, t: FloatArray) -> SatelliteStates:
    """Integrate sets ``rows`` (K,) to ``t`` (K,) with fourth-order Runge-Kutta."""
    q = np.ascontiguousarray(sets.state[rows].T)
    span = t - q[0]
    steps = np.ceil(np.abs(span) / STEP_PZ)
    h = span / np.maximum(steps, 1.0)
    s = q[1:7].copy()
    order = np.argsort(-steps, kind="stable")  # what needs most steps comes first, and the rest drops off
    s, sun_moon, h, steps = s[:, order], q[7:10, order], h[order], steps[order]
    for step in range(int(steps.max(initial=0.0))):
        now = int(np.searchsorted(-steps, -step, side="left"))
        x, light, d = s[:, :now], sun_moon[:, :now], h[:now]
        k_1 = _accelerate(x, light)
        k_2 = _accelerate(x + 0.5 * d * k_1, light)
        k_3 = _accelerate(x + 0.5 * d * k_2, light)
        k_4 = _accelerate(x + d * k_3, light)
        x += d / 6.0 * (k_1 + 2.0 * k_2 + 2.0 * k_3 + k_4)
    state = np.empty_like(s)
    state[:, order] = s
    return SatelliteStates(
        pos_e=np.ascontiguousarray(state[:3].T),
        vel_e=np.ascontiguousarray(state[3:].T),
        clock=q[10] + q[11] * span,
        clock_rate=q[11],
        relativity=np.zeros(len(t)),
    )


def compute_states(sets: KeplerSets | GlonassSets, rows: IntArray, t: FloatArray) -> SatelliteStates:
    """Compute the states of satellites at given epochs.

    Parameters
    ----------
    sets : KeplerSets or GlonassSets
        Ephemerides.
    rows : (K,) array of int
        Row of the set to use at each time.
    t : (K,) array
        Epochs of transmission, GPS time since the origin of ``sets`` [s].

    Notes
    -----
    Kepler sets: IS-GPS-200, table 20-IV, velocity by its derivative; Galileo OS SIS ICD and BDS-SIS-ICD-B1I
    have the same formulas with their own constants. GLONASS: Earth-fixed equations of motion
    with J2 and the broadcast luni-solar acceleration, Runge-Kutta of fourth order with steps up to 60 s;
    PZ-90.11 and WGS 84 agree to centimeters, so its axes are taken for e.
    """
    t, rows = np.asarray(t, float), np.asarray(rows, np.int64)
    if isinstance(sets, KeplerSets):
        return _compute_kepler(sets, rows, t)
    return _compute_glonass(sets, rows, t)


def find_nearest(sets: KeplerSets | GlonassSets, sat: IntArray, t: FloatArray, oldest: float) -> IntArray:
    """Return the row (K,) of the healthy set nearest in time for each satellite (K,) and time t (K,) [s].

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
    """Compute the epochs of transmission (K,) [s] and the satellite states there, from measurements alone.

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
    return step_back(shown, compute_states(sets, rows, shown))


def step_back(shown: FloatArray, found: SatelliteStates) -> tuple[FloatArray, SatelliteStates]:
    """Return the epochs (K,) [s] at which clocks show ``shown`` (K,), and the states at these epochs."""
    late = found.clock + found.relativity  # below 1 ms: what curves in it moves the satellite by 1e-6 m
    return shown - late, found._replace(
        pos_e=found.pos_e - found.vel_e * late[:, None], clock=found.clock - found.clock_rate * late
    )


def make_walker(
    planes: int,
    per_plane: int,
    phasing: int,
    *,
    semi_axis: float,
    inclination: float,
    node_0: float = 0.0,
    system: int = GPS,
    first: int = 1,
) -> KeplerSets:
    """Make a Walker constellation T/P/F: evenly spaced circular orbits with perfect clocks, at t = 0.

    ``T = planes * per_plane``, F is the phasing; the angles are in rad, ``semi_axis`` in m, ``node_0`` is the
    longitude of the first node at t = 0, ``first`` the number of the first satellite.
    """
    total = planes * per_plane
    elements = np.zeros((total, len(KEPLER)))
    plane, place = np.divmod(np.arange(total), per_plane)
    elements[:, KEPLER.index("sqrt_a")] = np.sqrt(semi_axis)
    elements[:, KEPLER.index("i_0")] = inclination
    elements[:, KEPLER.index("node_0")] = node_0 + 2 * np.pi * plane / planes
    elements[:, KEPLER.index("mean_anomaly")] = 2 * np.pi * (place / per_plane + phasing * plane / total)
    return KeplerSets(np.arange(first, first + total), np.ones(total, bool), elements, system)


def make_nominal(system: int) -> KeplerSets:
    """Return the nominal constellation of a system at t = 0, circular orbits with perfect clocks.

    GPS: 24 satellites in 6 planes at 55 deg, 26 560 km (A-2.1.2). GLONASS: 24 in 3 planes at 64.8 deg,
    19 100 km high (A-2.1.2). Galileo: 24/3/1 at 56 deg, 29 600 km (Galileo OS SDD 1.3, 2021, table 1).
    BeiDou-3: 24/3/1 at 55 deg, 21 528 km high, from C19 on; in 24 h three more at 55 deg, C38 to C40 in
    reality and C43 to C45 here, and C59 to C61 above 80, 110.5 and 140 deg E (BDS-SIS-ICD-B1I-3.0, 3.1).
    """
    if system == GPS:
        return make_walker(6, 4, 1, semi_axis=26.56e6, inclination=np.deg2rad(55.0))
    if system == GLONASS:
        return make_walker(3, 8, 1, semi_axis=_A_PZ + 19.1e6, inclination=np.deg2rad(64.8), system=GLONASS)
    if system == GALILEO:
        return make_walker(3, 8, 1, semi_axis=29.6e6, inclination=np.deg2rad(56.0), system=GALILEO)
    return _make_nominal_beidou()


def _make_nominal_beidou() -> KeplerSets:
    high = float(np.cbrt(GRAVITY[BEIDOU] / EARTH_RATES[BEIDOU] ** 2))  # turns with the Earth
    parts = [
        make_walker(3, 8, 1, semi_axis=6.378137e6 + 21.528e6, inclination=np.deg2rad(55.0), first=19),
        make_walker(3, 1, 2, semi_axis=high, inclination=np.deg2rad(55.0), node_0=_IGSO, first=43),
        make_walker(3, 1, 0, semi_axis=high, inclination=0.0, first=59),
    ]
    fixed = parts[2].elements
    # the frame of their elements is inclined about its x axis; in it their plane is, too, and is the equator
    fixed[:, KEPLER.index("i_0")] = _INCLINED
    fixed[:, KEPLER.index("node_0")] = 0.0
    fixed[:, KEPLER.index("mean_anomaly")] = np.deg2rad([80.0, 110.5, 140.0])
    sat, healthy, elements = (np.concatenate([getattr(one, name) for one in parts]) for name in _SET_COLUMNS)
    return KeplerSets(sat, healthy, elements, BEIDOU)


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
