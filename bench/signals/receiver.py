"""A GNSS receiver: satellites from its own pseudoranges, corrections, position, velocity, fault exclusion.

Simulated observations and those of a RINEX file take the same path: :func:`make_observations` (files only)
computes the satellites, :func:`solve_fixes` the fixes.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, NamedTuple

import numpy as np

from bench import earth
from bench.arrays import BoolArray, FloatArray, IntArray
from bench.compiled import kernel
from bench.data import GLONASS, GPS, GnssFixes, GnssObservations
from bench.orbit_sets import KEPLER, GlonassSets, KeplerSets
from bench.signals import dilution, least_squares, orbits
from bench.signals.delays import (
    Troposphere,
    ionosphere_free,
    klobuchar_kernel,
    mapping_kernel,
    obliquity_kernel,
    range_kernel,
    zenith_troposphere,
)
from bench.signals.orbits import GPS_EARTH_RATE, L1, C

CORRECTIONS = ("sagnac", "relativity", "group-delay", "troposphere", "ionosphere", "clocks")
"""Corrections that ``Processing.without`` may leave out; "clocks" is the separate clock offset of GLONASS."""

Ionosphere = Literal["klobuchar", "free"]
Systems = Literal["gps", "glonass", "both", "auto"]

_OLDEST = (7200.0, 1800.0)
"""Largest age of an ephemeris, GPS and GLONASS [s]: half of the 4 h fit interval of IS-GPS-200, 20.3.4.4;
twice the 15 min validity of a GLONASS broadcast, because a station misses some."""

_GAMMA = (orbits.L2 / L1) ** 2  # 0.607; 0.605 for GLONASS
_ROUGH = 1e3  # last step of a rough position [m]; its error is below 0.1 m, enough for elevations and delays


class ErrorBudget(NamedTuple):
    """Standard deviations for the weights of ranges; defaults for a single-frequency receiver.

    [45] RTKLIB, rtkpos.c and rtkcmn.c. [46] RTCA DO-229D, appendix J, as in GPSTk ComputeMOPSWeights.cpp.
    [47] Groves, Principles of GNSS, Inertial, and Multisensor Integrated Navigation Systems, 2nd ed. (2013),
    values of its examples. Montenbruck, Steigenberger, Hauschild, Multi-GNSS signal-in-space range error
    assessment - methodology and results, Advances in Space Research 61 (2018) 3020-3038, abstract: global
    average RMS of 2017, 0.6 m for GPS and 2 m for GLONASS.
    """

    signal_in_space: float = 0.6  # GPS, ephemeris and satellite clock [m], Montenbruck et al. 2018
    signal_in_space_glonass: float = 2.0  # GLONASS [m], the same
    zenith_ionosphere: float = 2.0  # residual of the Klobuchar model [m], [47]
    zenith_troposphere: float = 0.2  # residual of the model [m], [47]
    code: float = 0.5  # noise of the code, first band [m]: RTCA DO-229D class 1, [46]
    multipath_zenith: float = 0.13  # [m], [46]: 0.13 + 0.53 exp(-el / 10 deg)
    multipath_horizon: float = 0.53  # [m]
    multipath_decay: float = float(np.deg2rad(10.0))  # [rad]
    doppler: float = 0.05  # range rate [m/s], [47], example of a filter without INS
    glonass: float = 1.5  # ratio of the code noise of GLONASS to GPS [1], [45]
    second_band: float = 1.0  # ratio of the code noise of the second band to the first [1]


GROUND = ErrorBudget()


@dataclass(frozen=True, slots=True)
class Processing:
    """How a receiver computes its fixes."""

    systems: Systems = "both"
    ionosphere: Ionosphere = "klobuchar"
    troposphere: Troposphere = "saastamoinen"
    mask: float = float(np.deg2rad(10.0))  # lowest elevation used [rad]
    false_alarm: float = 1e-3  # probability of the residual test of one epoch [1]; 0: no fault exclusion
    without: frozenset[str] = frozenset()  # of CORRECTIONS


class ReceiverSolution(NamedTuple):
    """Fixes with the clock, the satellites used and the residuals."""

    fixes: GnssFixes  # a row per epoch; NaN and not valid without solution
    clock: FloatArray  # (M, 2) offset of the receiver's clock against GPS and GLONASS [m]
    drift: FloatArray  # (M,) of the receiver's clock [m/s]
    los_n: FloatArray  # (K, 3) receiver to satellite, n; NaN without a position
    used: BoolArray  # (K,) used for the position
    residual: FloatArray  # (K,) [m]; NaN if not used


class Look(NamedTuple):
    """Directions and atmospheric delays of satellites from an assumed position of the receiver."""

    pos_e: FloatArray  # (M, 3) [m], e
    lla: FloatArray  # (M, 3) [rad, rad, m]
    los_n: FloatArray  # (K, 3) receiver to satellite, n
    el: FloatArray  # (K,) elevation [rad]
    ionosphere: FloatArray  # (K,) delay by the broadcast model on the row's carrier [m]
    troposphere: FloatArray  # (K,) [m]


@kernel
def _look_kernel(
    epoch_start: IntArray, sat: FloatArray, pos: FloatArray, C_en: FloatArray, rate: float, los_n: FloatArray
) -> None:
    """Fill los_n (K, 3) with unit vectors from each epoch's position to its satellites."""
    for m in range(epoch_start.shape[0] - 1):
        for k in range(epoch_start[m], epoch_start[m + 1]):
            _, x, y, z = range_kernel(
                sat[k, 0], sat[k, 1], sat[k, 2], pos[m, 0], pos[m, 1], pos[m, 2], rate
            )  # fmt: skip
            for i in range(3):
                los_n[k, i] = C_en[m, 0, i] * x + C_en[m, 1, i] * y + C_en[m, 2, i] * z


@kernel
def _atmosphere_kernel(
    epoch_start: IntArray, t: FloatArray, lla: FloatArray, zenith: FloatArray, los_n: FloatArray,
    frequency: FloatArray, model: FloatArray, el: FloatArray, ionosphere: FloatArray, troposphere: FloatArray,
) -> None:  # fmt: skip
    """Fill elevation [rad] and the delays [m] on each row's carrier; t (K,) of the GPS day."""
    for m in range(epoch_start.shape[0] - 1):
        for k in range(epoch_start[m], epoch_start[m + 1]):
            sin_el = -los_n[k, 2]
            across = np.sqrt(los_n[k, 0] * los_n[k, 0] + los_n[k, 1] * los_n[k, 1])
            el[k] = np.arctan2(sin_el, across)
            ionosphere[k] = 0.0
            troposphere[k] = zenith[m] * mapping_kernel(sin_el)
            if el[k] > 0.0 and across > 0.0:
                delay = klobuchar_kernel(
                    lla[m, 0], lla[m, 1], el[k], los_n[k, 1] / across, los_n[k, 0] / across, t[k], model
                )  # fmt: skip
                ionosphere[k] = delay * (L1 / frequency[k]) ** 2


@kernel
def _pseudorange_sd_kernel(
    el: FloatArray, system: IntArray, frequency: FloatArray, code: FloatArray, budget: FloatArray, free: bool,
    out: FloatArray,
) -> None:  # fmt: skip
    """Fill out (K,) with the sd of corrected pseudoranges; ``code`` (K,) is the noise of the receiver."""
    for k in range(out.shape[0]):
        if not el[k] > 0.0:
            out[k] = np.nan
            continue
        multipath = budget[5] + budget[6] * np.exp(-el[k] / budget[7])
        tracking = code[k] * code[k] + multipath * multipath
        zenith = budget[2] * obliquity_kernel(el[k]) * (L1 / frequency[k]) ** 2
        if free:  # noise of the ionosphere-free combination, B-11
            second = _GAMMA * budget[10]
            tracking *= (1.0 + second * second) / (1.0 - _GAMMA) ** 2
            zenith = 0.0
        satellite = budget[0]
        if system[k] == 1:
            satellite = budget[1]
            tracking *= budget[9] * budget[9]
        troposphere = budget[3] * mapping_kernel(np.sin(el[k]))
        out[k] = np.sqrt(satellite * satellite + tracking + zenith * zenith + troposphere * troposphere)


@kernel
def _to_n_kernel(
    C_en: FloatArray, vel_e: FloatArray, cov_pos_e: FloatArray, cov_vel_e: FloatArray,
    vel_n: FloatArray, cov_pos_n: FloatArray, cov_vel_n: FloatArray,
) -> None:  # fmt: skip
    """Resolve velocities (M, 3) and covariances (M, 3, 3) from e to n."""
    for m in range(vel_e.shape[0]):
        C = C_en[m]
        for a in range(3):
            vel_n[m, a] = C[0, a] * vel_e[m, 0] + C[1, a] * vel_e[m, 1] + C[2, a] * vel_e[m, 2]
            for b in range(3):
                pos, vel = 0.0, 0.0
                for i in range(3):
                    for j in range(3):
                        pos += C[i, a] * cov_pos_e[m, i, j] * C[j, b]
                        vel += C[i, a] * cov_vel_e[m, i, j] * C[j, b]
                cov_pos_n[m, a, b], cov_vel_n[m, a, b] = pos, vel


def pseudorange_sd(
    el: FloatArray,
    system: IntArray,
    frequency: FloatArray,
    code: FloatArray,
    budget: ErrorBudget,
    ionosphere: Ionosphere,
) -> FloatArray:
    """Return the standard deviation of corrected pseudoranges (K,) [m].

    Each row (K,) has an elevation [rad], a system, a first carrier [Hz] and the noise of the receiver's code
    measurement [m]; the budget holds all other errors. The two-frequency combination ("free") has no
    ionosphere and three times the noise.
    """
    out = np.empty(len(el))
    _pseudorange_sd_kernel(el, system, frequency, code, np.array(budget, float), ionosphere == "free", out)
    return out


def compute_look(
    pos_e: FloatArray,
    *,
    epoch_start: IntArray,
    t: FloatArray,
    sat_pos_e: FloatArray,
    frequency: FloatArray,
    klobuchar: FloatArray,
    troposphere: Troposphere = "saastamoinen",
    sagnac: bool = True,
) -> Look:
    """Compute directions and atmospheric delays of satellites.

    Parameters
    ----------
    pos_e : (M, 3) array
        Receiver at each epoch [m]; rows with NaN give NaN.
    epoch_start : (M + 1,) array of int
        First row of each epoch.
    t : (K,) array
        GPS time of day [s].
    sat_pos_e : (K, 3) array
        [m], e at transmission.
    frequency : (K,) array
        Carrier [Hz].
    klobuchar : (8,) array
        Broadcast ionosphere.
    troposphere : str
        Model of the vertical delay, :func:`bench.signals.delays.zenith_troposphere`.
    sagnac : bool
        Turn the satellites with the Earth during the travel time.
    """
    K = len(t)
    lla = earth.to_geodetic(pos_e)
    C_en = np.ascontiguousarray(earth.matrix_en(lla[:, 0], lla[:, 1]))
    zenith = zenith_troposphere(lla[:, 0], lla[:, 2], troposphere)
    seen = Look(pos_e, lla, np.empty((K, 3)), np.empty(K), np.empty(K), np.empty(K))
    _look_kernel(epoch_start, sat_pos_e, pos_e, C_en, GPS_EARTH_RATE if sagnac else 0.0, seen.los_n)
    _atmosphere_kernel(epoch_start, t, lla, zenith, seen.los_n, frequency, klobuchar, *seen[3:])
    return seen


def _look_around(o: GnssObservations, pos_e: FloatArray, processing: Processing) -> Look:
    return compute_look(
        pos_e,
        epoch_start=o.epoch_start,
        t=o.t + o.gps_t0,
        sat_pos_e=o.sat_pos_e,
        frequency=o.frequency[:, 0].copy(),
        klobuchar=o.klobuchar,
        troposphere=processing.troposphere,
        sagnac="sagnac" not in processing.without,
    )


def make_observations(
    *,
    t: FloatArray,
    epoch_start: IntArray,
    sat: IntArray,
    system: IntArray,
    pseudorange: FloatArray,
    doppler: FloatArray,
    cn0: FloatArray,
    kepler: KeplerSets,
    glonass: GlonassSets,
    klobuchar: FloatArray | None,
    processing: Processing,
    budget: ErrorBudget = GROUND,
) -> GnssObservations:
    """Compute the satellites of raw observations as a receiver does.

    Parameters
    ----------
    t : (M,) array
        Time tags by the receiver's clock, GPS time since a GPS midnight [s].
    epoch_start : (M + 1,) array of int
        First row of each epoch.
    sat, system : (K,) arrays of int
        Satellites.
    pseudorange, doppler, cn0 : (K, 2) arrays
        [m], [Hz] positive when approaching, [dB-Hz]; NaN where missing.
    kepler, glonass : KeplerSets, GlonassSets
        Ephemerides, times since the same midnight.
    klobuchar : (8,) array or None
        Broadcast ionosphere; None counts as no delay.
    processing : Processing
        Corrections of the satellite clocks to leave out, and the method for the ionosphere.
    budget : ErrorBudget
        For the assumed standard deviations.

    Returns
    -------
    observations : GnssObservations
        Satellites without a recent, healthy ephemeris are NaN.
    """
    K = len(sat)
    tag = np.repeat(t, np.diff(epoch_start))
    code = np.where(np.isfinite(pseudorange[:, 0]), pseudorange[:, 0], pseudorange[:, 1])
    pos, vel = np.full((K, 3), np.nan), np.full((K, 3), np.nan)
    clock, clock_rate, group_delay = np.full(K, np.nan), np.full(K, np.nan), np.zeros(K)
    channel = np.zeros(K, np.int64)
    for which, sets in ((GPS, kepler), (GLONASS, glonass)):
        rows = np.flatnonzero((system == which) & np.isfinite(code))
        if len(sets) == 0 or len(rows) == 0:
            continue
        serving = orbits.find_nearest(sets, sat[rows], tag[rows], _OLDEST[which])
        rows, serving = rows[serving >= 0], serving[serving >= 0]
        _, found = orbits.find_transmission(sets, serving, tag[rows], code[rows])
        pos[rows], vel[rows] = found.pos_e, found.vel_e
        relativity = 0.0 if "relativity" in processing.without else found.relativity
        clock[rows] = C * (found.clock + relativity)
        clock_rate[rows] = C * found.clock_rate
        if isinstance(sets, GlonassSets):
            channel[rows] = sets.channel[serving]
        elif "group-delay" not in processing.without:
            group_delay[rows] = C * sets.elements[serving, KEPLER.index("group_delay")]
    frequency = orbits.carrier_frequencies(system, channel)
    model = np.zeros(8) if klobuchar is None else klobuchar
    raw = GnssObservations(
        t=tag,
        t_arrival=tag,
        sat=sat,
        system=system,
        frequency=frequency,
        pseudorange=pseudorange,
        range_rate=-doppler * C / frequency,
        cn0=cn0,
        sat_pos_e=pos,
        sat_vel_e=vel,
        sat_clock=clock,
        sat_clock_rate=clock_rate,
        group_delay=group_delay,
        sd_pseudorange=np.ones(K),
        sd_range_rate=np.full(K, budget.doppler),
        epoch_start=epoch_start,
        klobuchar=model,
        gps_t0=0.0,
    )
    ranges = correct_pseudoranges(raw, processing)
    rough = least_squares.solve_positions(epoch_start, pos, ranges, raw.sd_pseudorange, system, close=_ROUGH)
    el = _look_around(raw, rough.pos_e, processing).el
    sd = pseudorange_sd(
        el, system, frequency[:, 0].copy(), np.full(K, budget.code), budget, processing.ionosphere
    )
    columns = {name: getattr(raw, name) for name in GnssObservations.__slots__}
    return GnssObservations(**columns | {"sd_pseudorange": np.where(np.isfinite(sd), sd, 1e3)})


def correct_pseudoranges(observations: GnssObservations, processing: Processing) -> FloatArray:
    """Return pseudoranges (K,) [m] corrected for satellite clock and group delay, not for the atmosphere.

    With ``ionosphere = "free"`` it is the two-frequency combination, NaN if a band is missing.
    """
    ranges = observations.pseudorange
    if processing.ionosphere == "free":
        f = observations.frequency
        return ionosphere_free(ranges[:, 0], ranges[:, 1], f[:, 0], f[:, 1]) + observations.sat_clock
    return ranges[:, 0] + observations.sat_clock - observations.group_delay


def solve_fixes(
    observations: GnssObservations, processing: Processing, near: Look | None = None
) -> ReceiverSolution:
    """Compute the fix of every epoch.

    Parameters
    ----------
    observations : GnssObservations
        Measurements of the receiver, with the satellites.
    processing : Processing
        Settings.
    near : Look or None
        Directions and delays from a predicted position, accurate to about 10 m. None: a first rough position
        gives elevations and delays, a second one the height for the troposphere.

    Notes
    -----
    Satellites below the mask are not used. While the residuals are too large, the worst satellite is
    excluded.
    """
    o, without = observations, processing.without
    start, system = o.epoch_start, o.system
    sagnac, one_clock = "sagnac" not in without, "clocks" in without
    ranges = correct_pseudoranges(o, processing)
    wanted = np.ones(len(o), bool)
    if processing.systems in ("gps", "glonass"):
        wanted = system == (GPS if processing.systems == "gps" else GLONASS)
    for _ in range(2 if near is None else 0):
        rough, use, delayed = None, wanted, ranges
        if near is not None:
            rough, use = near.pos_e, wanted & (near.el > processing.mask)
            delayed = _subtract_delays(ranges, near, processing)
        pos_e = least_squares.solve_positions(
            start, o.sat_pos_e, delayed, o.sd_pseudorange, system,
            use=use, start_e=rough, close=_ROUGH, one_clock=one_clock, sagnac=sagnac,
        ).pos_e  # fmt: skip
        near = _look_around(o, pos_e, processing)
    assert near is not None
    ranges = _subtract_delays(ranges, near, processing)
    use = wanted & (near.el > processing.mask) & np.isfinite(ranges)
    if processing.systems == "auto":
        use, _ = dilution.choose_satellites(start, near.los_n, system, o.sd_pseudorange, use)
    bounds = least_squares.compute_thresholds(processing.false_alarm) if processing.false_alarm > 0 else None
    fix = least_squares.solve_positions(
        start, o.sat_pos_e, ranges, o.sd_pseudorange, system,
        use=use, start_e=near.pos_e, threshold=bounds, one_clock=one_clock, sagnac=sagnac,
    )  # fmt: skip
    range_rate = o.range_rate[:, 0] + o.sat_clock_rate
    speed = least_squares.solve_velocities(
        start, o.sat_pos_e, o.sat_vel_e, range_rate, o.sd_range_rate, fix.used, fix.pos_e, sagnac=sagnac
    )
    lla = earth.to_geodetic(fix.pos_e)
    C_en = earth.matrix_en(lla[:, 0], lla[:, 1])
    vel_n = np.empty_like(speed.vel_e)
    cov_pos_n, cov_vel_n = np.empty_like(fix.cov_e), np.empty_like(fix.cov_e)
    _to_n_kernel(np.ascontiguousarray(C_en), speed.vel_e, fix.cov_e, speed.cov_e, vel_n, cov_pos_n, cov_vel_n)
    count = np.add.reduceat(np.append(fix.used, False).astype(np.int64), start[:-1])
    count = np.where(np.diff(start) > 0, count, 0)
    fixes = GnssFixes(
        t=_take_first_rows(o.t, start),
        t_arrival=_take_first_rows(o.t_arrival, start),
        valid=fix.passed,
        lla=lla,
        vel_n=vel_n,
        cov_pos_n=cov_pos_n,
        cov_vel_n=cov_vel_n,
        satellites=count,
    )
    return ReceiverSolution(fixes, fix.clock, speed.drift, near.los_n, fix.used, fix.residual)


def _subtract_delays(ranges: FloatArray, near: Look, processing: Processing) -> FloatArray:
    """Subtract the delays of the atmosphere from ranges (K,) [m]."""
    if "ionosphere" not in processing.without and processing.ionosphere == "klobuchar":
        ranges = ranges - near.ionosphere
    return ranges if "troposphere" in processing.without else ranges - near.troposphere


def _take_first_rows(column: FloatArray, start: IntArray) -> FloatArray:
    """Return the value in the first row of each epoch; NaN for an epoch without rows."""
    return np.where(np.diff(start) > 0, np.append(column, np.nan)[start[:-1]], np.nan)
