"""A GNSS receiver: satellites from its own pseudoranges, corrections, position, velocity, fault exclusion.

Simulated observations and those of files take the same path: :func:`make_observations` (files only) computes
the satellites, :func:`solve_fixes` the fixes.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from bench.core.mathematics import earth
from bench.core.mathematics.arrays import BoolArray, FloatArray, IntArray
from bench.core.records.data import GnssFixes, GnssObservations
from bench.core.records.orbit_sets import (
    BEIDOU,
    GALILEO,
    GLONASS,
    GPS,
    GlonassSets,
    KeplerSets,
    OrbitTable,
    parse_systems,
)
from bench.simulation.signals import dilution, least_squares, orbit_tables, orbits
from bench.simulation.signals.delays import ionosphere_free
from bench.simulation.signals.look import Look, compute_look, estimate_range_sd, share_errors
from bench.simulation.signals.orbits import C
from bench.simulation.signals.processing import Processing, estimate_code_sd, estimate_space_sd

Loops = Callable[[IntArray, FloatArray, FloatArray], tuple[FloatArray, FloatArray]]
"""System (K,), C/N0 [dB-Hz] and carrier [Hz] -> sd of the code [m] and of the range rate [m/s]."""

Orbits = Mapping[int, Sequence[KeplerSets | GlonassSets | OrbitTable]]
"""Code of a system -> its orbits, in order of preference; beside a table the others give group delays."""

_OLDEST = {GPS: 7200.0, GLONASS: 1800.0, GALILEO: 7200.0, BEIDOU: 7200.0}
"""Largest age of an ephemeris [s]: half of the 4 h fit interval of IS-GPS-200, 20.3.4.4, for the others with
new sets every ten minutes to an hour, too; twice the 15 min validity of a GLONASS broadcast, because a
station misses some."""

_PRECISE_PAIRS = {GPS: (1, 2), GLONASS: (1, 2), GALILEO: (1, 5), BEIDOU: (2, 6)}
"""RINEX digits of the carriers whose combination the clocks of SP3 files are of."""

_ROUGH = 1e3  # last step of a rough position [m]; its error is below 0.1 m, enough for elevations and delays
_LEAST = 0.1  # least part of the assumed sd of a range that is its own [1]
_FAR = 1e3  # sd of a range whose satellite is not above the horizon [m]


class ReceiverSolution(NamedTuple):
    """Fixes with the clock, the satellites used and the residuals."""

    fixes: GnssFixes  # a row per epoch; NaN and not valid without solution
    clock: FloatArray  # (M, 4) offset of the receiver's clock against each system [m]
    drift: FloatArray  # (M,) of the receiver's clock [m/s]
    los_n: FloatArray  # (K, 3) receiver to satellite, n; NaN without a position
    used: BoolArray  # (K,) used for the position
    wanted: BoolArray  # (K,) could have been used: above the mask, with orbit and range
    residual: FloatArray  # (K,) [m]; NaN if not used
    normalized: FloatArray  # (K,) residual over its standard deviation, without sign; NaN if it says nothing


def look_around(o: GnssObservations, pos_e: FloatArray, processing: Processing) -> Look:
    """Return the directions of the observed satellites from a place (3,), e."""
    return compute_look(
        pos_e,
        epoch_start=o.epoch_start,
        t=o.t + o.gps_t0,
        sat_pos_e=o.sat_pos_e,
        frequency=o.frequency[:, 0],
        klobuchar=o.klobuchar,
        processing=processing,
    )


class _Satellites(NamedTuple):
    """Satellite data of each row from the ephemerides."""

    pos: FloatArray  # (K, 3)
    vel: FloatArray  # (K, 3)
    clock: FloatArray  # (K,) [m]
    clock_rate: FloatArray  # (K,) [m/s]
    delay: FloatArray  # (K,) [m]
    accuracy: FloatArray  # (K,) stated [m]
    channel: IntArray  # (K,)
    precise: FloatArray  # (K,) sd of precise orbit, clock and delay [m]; NaN: broadcast


def _find_satellites(
    tag: FloatArray,
    sat: IntArray,
    system: IntArray,
    code: FloatArray,
    band: IntArray,
    sets: Orbits,
    processing: Processing,
) -> _Satellites:
    K = len(sat)
    nan = np.full(K, np.nan)
    out = _Satellites(
        np.full((K, 3), np.nan), np.full((K, 3), np.nan), nan, nan.copy(), np.zeros(K), nan.copy(),
        np.zeros(K, np.int64), nan.copy(),
    )  # fmt: skip
    free = processing.ionosphere == "free"
    for which, given in sets.items():
        ours = (system == which) & np.isfinite(code)
        choices = _rank([one for one in given if not isinstance(one, OrbitTable)], free)
        tables = [one for one in given if isinstance(one, OrbitTable)]
        for table in tables:
            rows = np.flatnonzero(ours & np.isnan(out.clock))
            _take_precise(out, table, choices, rows, tag[rows], sat[rows], code[rows], band[rows], processing)
        for one in [] if tables else choices:
            rows = np.flatnonzero(ours & np.isnan(out.clock))
            if len(one) == 0 or len(rows) == 0:
                continue
            serving = orbits.find_nearest(one, sat[rows], tag[rows], _OLDEST[which])
            rows, serving = rows[serving >= 0], serving[serving >= 0]
            _, found = orbits.find_transmission(one, serving, tag[rows], code[rows])
            out.pos[rows], out.vel[rows] = found.pos_e, found.vel_e
            relativity = 0.0 if "relativity" in processing.without else found.relativity
            out.clock[rows] = C * (found.clock + relativity)
            out.clock_rate[rows] = C * found.clock_rate
            if isinstance(one, GlonassSets):
                out.channel[rows] = one.channel[serving]
                continue
            out.accuracy[rows] = one.get("accuracy")[serving]
            if "group-delay" not in processing.without:
                out.delay[rows] = C * find_group_delay(one, serving, band[rows], free)
    return out


def _take_precise(
    out: _Satellites,
    table: OrbitTable,
    messages: Sequence[KeplerSets | GlonassSets],
    rows: IntArray,
    tag: FloatArray,
    sat: IntArray,
    code: FloatArray,
    band: IntArray,
    processing: Processing,
) -> None:
    """Fill rows (K,) of one system from a table; messages give group delays and the channels of GLONASS.

    The clocks are those of L1 and L2 combined, G1 and G2, E1 and E5a, B1I and B3I (IGS).
    """
    system, free, budget = table.system, processing.ionosphere == "free", processing.budget
    place = orbit_tables.find_rows(table, sat, tag - code / C)
    pair = np.array(_PRECISE_PAIRS[system])
    delay, known = np.zeros(len(rows)), free & (band == pair).all(axis=1)
    tuned = np.full(len(rows), system != GLONASS)
    for one in messages:
        serving = orbits.find_nearest(one, sat, tag, np.inf)
        if isinstance(one, GlonassSets):
            tuned = serving >= 0
            out.channel[rows[tuned]] = one.channel[serving[tuned]]
            continue
        new = (serving >= 0) & ~known
        reference = find_group_delay(one, serving[new], np.tile(pair, (int(new.sum()), 1)), True)
        delay[new] = C * (find_group_delay(one, serving[new], band[new], free) - reference)
        known |= new
    good = (place >= 0) & tuned
    shown = (tag - code / C)[good]
    rows, place = rows[good], place[good]
    _, found = orbits.step_back(shown, orbit_tables.compute_states(table, place, shown))
    relativity = 0.0 if "relativity" in processing.without else found.relativity
    out.pos[rows], out.vel[rows] = found.pos_e, found.vel_e
    out.clock[rows], out.clock_rate[rows] = C * (found.clock + relativity), C * found.clock_rate
    out.delay[rows] = 0.0 if "group-delay" in processing.without else delay[good]
    lack = np.where(known[good], 0.0, budget.delays_unknown[system])
    stated = orbit_tables.find_stated_sd(table, place, shown)
    out.precise[rows] = np.hypot(np.maximum(budget.precise[system], stated), lack)


def _rank(choices: Sequence[KeplerSets | GlonassSets], free: bool) -> Sequence[KeplerSets | GlonassSets]:
    """Return orbits in order of preference: with E1 and E5a the F/NAV of Galileo comes first."""
    first = "F/NAV" if free else "I/NAV"
    return sorted(choices, key=lambda one: getattr(one, "message", first) not in (first, ""))


def find_group_delay(sets: KeplerSets, rows: IntArray, band: IntArray, free: bool) -> FloatArray:
    """Return the delay (K,) [s] of the range in use against the clock of the ephemerides.

    ``band`` (K, 2) has the RINEX digits of both carriers. The clock of GPS is that of L1 and L2 combined, of
    BeiDou that of B3I; of Galileo that of E1 and E5b (I/NAV) or of E1 and E5a (F/NAV): IS-GPS-200,
    20.3.3.3.3.2; BDS-SIS-ICD-B1I-3.0, 5.2.4.10; Galileo OS SIS ICD 2.0, 5.1.5.
    """
    one, two = sets.get("group_delay")[rows], sets.get("group_delay_2")[rows]
    first, system = one, np.full(len(rows), sets.system)
    zero = np.zeros(len(rows))
    second, other = zero, zero
    f_1, f_2 = (orbits.find_frequency(system, band[:, k], np.zeros_like(system)) for k in range(2))
    if sets.system == GPS:
        second = (f_1 / f_2) ** 2 * one
    elif sets.system == BEIDOU:
        second = np.where(band[:, 1] == 7, two, 0.0)
    elif sets.system == GALILEO:
        first = two if sets.message == "I/NAV" else one
        other = np.where(band[:, 1] == 5, one, two)  # of the pair that is received
        second = first + ((f_1 / f_2) ** 2 - 1.0) * other
    return np.asarray(ionosphere_free(first, second, f_1, f_2)) if free else first


def make_observations(
    *,
    t: FloatArray,
    epoch_start: IntArray,
    sat: IntArray,
    system: IntArray,
    band: IntArray,
    pseudorange: FloatArray,
    doppler: FloatArray,
    cn0: FloatArray,
    sets: Orbits,
    klobuchar: FloatArray | None,
    processing: Processing,
    noise: FloatArray | None = None,
    loops: Loops | None = None,
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
    band : (K, 2) array of int
        RINEX digits of the carriers; 0 where missing.
    pseudorange, doppler, cn0 : (K, 2) arrays
        [m], [Hz] positive when approaching, [dB-Hz]; NaN where missing.
    sets : mapping
        Orbits of each system, times since the same midnight.
    klobuchar : (8,) array or None
        Broadcast ionosphere; None counts as no delay.
    processing : Processing
        Corrections to leave out, the method for the ionosphere, and the error budget.
    noise : (K,) array or None
        Factor on the noise of the code, for ranges that are smoothed.
    loops : callable or None
        Noise of code and Doppler of the first carrier, if not that of the budget.

    Returns
    -------
    observations : GnssObservations
        Satellites without a recent, healthy ephemeris are NaN.
    """
    K, budget = len(sat), processing.budget
    tag = np.repeat(t, np.diff(epoch_start))
    code = np.where(np.isfinite(pseudorange[:, 0]), pseudorange[:, 0], pseudorange[:, 1])
    found = _find_satellites(tag, sat, system, code, band, sets, processing)
    frequency = np.column_stack([orbits.find_frequency(system, band[:, k], found.channel) for k in range(2)])
    columns: dict[str, Any] = {
        "t": tag,
        "t_arrival": tag,
        "sat": sat,
        "system": system,
        "frequency": frequency,
        "pseudorange": pseudorange,
        "range_rate": -doppler * C / frequency,
        "cn0": cn0,
        "sat_pos_e": found.pos,
        "sat_vel_e": found.vel,
        "sat_clock": found.clock,
        "sat_clock_rate": found.clock_rate,
        "group_delay": found.delay,
        "sd_pseudorange": np.ones(K),
        "sd_range_rate": np.full(K, budget.doppler),
        "epoch_start": epoch_start,
        "klobuchar": np.zeros(8) if klobuchar is None else klobuchar,
        "gps_t0": 0.0,
    }
    raw = GnssObservations(**columns)
    ranges = correct_pseudoranges(raw, processing)
    pos_e = least_squares.solve_positions(
        epoch_start, found.pos, ranges, raw.sd_pseudorange, system, close=_ROUGH, rough=True
    ).pos_e
    near = look_around(raw, pos_e, processing)
    space = estimate_space_sd(system, sat, found.accuracy, budget)
    space = np.where(np.isfinite(found.precise), found.precise, space)
    thermal = estimate_code_sd(system, cn0[:, 0], budget)
    if loops is not None:
        thermal, columns["sd_range_rate"] = loops(system, cn0[:, 0], frequency[:, 0])
    thermal = thermal * (1.0 if noise is None else noise)
    free = processing.ionosphere == "free"
    own = estimate_range_sd(near.el, frequency, thermal, space, budget, free)
    shared = share_errors(near, frequency[:, 0], processing)
    sd = np.sqrt(own**2 + shared.ionosphere**2 + shared.troposphere**2)
    return GnssObservations(**columns | {"sd_pseudorange": np.where(np.isfinite(sd), sd, _FAR)})


def correct_pseudoranges(observations: GnssObservations, processing: Processing) -> FloatArray:
    """Return pseudoranges (K,) [m] corrected for satellite clock and group delay, not for the atmosphere.

    With ``ionosphere = "free"`` it is the two-frequency combination, NaN if a band is missing.
    """
    ranges = observations.pseudorange[:, 0]
    if processing.ionosphere == "free":
        f = observations.frequency
        ranges = ionosphere_free(ranges, observations.pseudorange[:, 1], f[:, 0], f[:, 1])
    return ranges + observations.sat_clock - observations.group_delay


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
    Satellites below the mask are not used. The covariance of the ranges has what they share, the errors of
    ionosphere and troposphere; so have the weights, the tests and the covariance of the fixes.
    """
    o, without = observations, processing.without
    start, system = o.epoch_start, o.system
    sagnac, one_clock = "sagnac" not in without, "clocks" in without
    ranges = correct_pseudoranges(o, processing)
    chosen = parse_systems(processing.systems)
    wanted = np.isin(system, list(chosen)) & np.isfinite(ranges) & np.isfinite(o.sat_pos_e[:, 0])
    rough = None if near is None else near.pos_e
    for _ in range(2 if near is None else 0):
        use, delayed = wanted, ranges
        if near is not None:
            use = wanted & (near.el > processing.mask)
            delayed = subtract_delays(ranges, near, processing)
        rough = least_squares.solve_positions(
            start, o.sat_pos_e, delayed, o.sd_pseudorange, system,
            use=use, start_e=rough, close=_ROUGH, one_clock=one_clock, sagnac=sagnac, rough=True,
        ).pos_e  # fmt: skip
        near = look_around(o, rough, processing)
    assert near is not None
    ranges = subtract_delays(ranges, near, processing)
    wanted &= (near.el > processing.mask) & np.isfinite(ranges)
    use = wanted
    if processing.systems == "auto":
        use, _ = dilution.choose_satellites(start, near.los_n, system, o.sd_pseudorange, use)
    shared = share_errors(near, o.frequency[:, 0], processing)
    common = shared.ionosphere**2 + shared.troposphere**2
    own = np.sqrt(np.maximum(o.sd_pseudorange**2 - common, (_LEAST * o.sd_pseudorange) ** 2))
    fix = least_squares.solve_positions(
        start, o.sat_pos_e, ranges, own, system,
        use=use, start_e=near.pos_e, shared=shared, false_alarm=processing.false_alarm,
        robust=processing.robust, one_clock=one_clock, sagnac=sagnac,
    )  # fmt: skip
    range_rate = o.range_rate[:, 0] + o.sat_clock_rate
    speed = least_squares.solve_velocities(
        start, o.sat_pos_e, o.sat_vel_e, range_rate, o.sd_range_rate, fix.used, fix.pos_e, sagnac=sagnac
    )
    lla = earth.to_geodetic(fix.pos_e)
    C_en = earth.matrix_en(lla[:, 0], lla[:, 1])
    count = np.add.reduceat(np.append(fix.used, False).astype(np.int64), start[:-1])
    count = np.where(np.diff(start) > 0, count, 0)
    fixes = GnssFixes(
        t=_take_first_rows(o.t, start),
        t_arrival=_take_first_rows(o.t_arrival, start),
        valid=fix.passed,
        lla=lla,
        vel_n=np.einsum("mij,mi->mj", C_en, speed.vel_e),
        cov_pos_n=C_en.transpose(0, 2, 1) @ fix.cov_e @ C_en,
        cov_vel_n=C_en.transpose(0, 2, 1) @ speed.cov_e @ C_en,
        satellites=count,
    )
    return ReceiverSolution(
        fixes, fix.clock, speed.drift, near.los_n, fix.used, wanted, fix.residual, fix.normalized
    )


def subtract_delays(ranges: FloatArray, near: Look, processing: Processing) -> FloatArray:
    """Subtract the delays of the atmosphere from ranges (K,) [m]."""
    if "ionosphere" not in processing.without and processing.ionosphere != "free":
        ranges = ranges - near.ionosphere
    return ranges if "troposphere" in processing.without else ranges - near.troposphere


def _take_first_rows(column: FloatArray, start: IntArray) -> FloatArray:
    """Return the value in the first row of each epoch; NaN for an epoch without rows."""
    return np.where(np.diff(start) > 0, np.append(column, np.nan)[start[:-1]], np.nan)
