"""Measurement-level GNSS: ranges, range rates and C/N0 of every satellite in view, and the fixes from them.

What is in view follows from the orbits, the attitude of the aircraft and its antenna: a banked turn loses
satellites. Every error has its own stream, ``gnss.sky.<term>``, and draws for all satellites at all epochs,
so that neither another error nor another mask changes it. The receiver samples at the instants of the truth;
its clock is in the pseudoranges.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from bench import earth, rotation
from bench.arrays import BoolArray, FloatArray, IntArray
from bench.compiled import kernel
from bench.data import GLONASS, GPS, GnssFixes, GnssObservations, Trajectory
from bench.sensors.gnss import antenna
from bench.sensors.timing import epoch_rows, interval_rows
from bench.signals import orbits, receiver
from bench.signals.delays import mapping_kernel, obliquity_kernel, range_kernel, range_rate_kernel
from bench.signals.orbits import L1, RATE, C
from bench.specs import GnssSpec, SkySpec, stream

_CHIP = (C / 1.023e6, C / 0.511e6)  # length of a chip of the civil code, GPS and GLONASS [m], their ICDs
_DECIBEL = np.log(10.0) / 10.0
_MULTIPATH_DECAY = float(np.deg2rad(10.0))  # RTCA DO-229D, appendix J
_LEAST = (0.01, 1e-4)  # what a receiver claims at best, range and range rate [m, m/s]
_GEOMETRIC = 1e-3  # least elevation for which delays are computed [rad]
_RISE = 4e-4  # faster than any elevation changes [rad/s]: 3.9 km/s at 20 000 km, and an aircraft
_SETTLED = 5e-3  # a range that changed by less between two passes is right to 1e-8 m [m]
_RECEIVED = 12  # columns of the geometry kernel


class Sky(NamedTuple):
    """What the receiver measured and computed."""

    observations: GnssObservations
    fixes: GnssFixes
    solution: receiver.Solution  # a row per epoch with satellites, before unsolved ones are left out


@kernel
def _geometry_kernel(
    t: FloatArray, pos_e: FloatArray, vel_e: FloatArray, C_en: FloatArray, down_n: FloatArray,
    t_0: float, step: float, coefficients: FloatArray, gps_t0: float,
    sin_mask: float, sin_antenna: float, zenith: float, horizon: float, threshold: float, wait: float,
    since: FloatArray, asleep: FloatArray, travel: FloatArray, state: FloatArray,
    epoch: IntArray, sat: IntArray, out: FloatArray,
) -> int:  # fmt: skip
    """Fill rows of what is received; return their number.

    Columns of out: satellite position (3), velocity (3), clock, clock rate, range, range rate, C/N0,
    elevation's sine. ``since`` (S,) holds when each satellite came into view, NaN while it is not; ``asleep``
    until when it cannot rise; ``travel`` the travel time of its last signal.
    """
    k = 0
    for m in range(t.shape[0]):
        now = t[m] + gps_t0
        rx, ry, rz = pos_e[m, 0], pos_e[m, 1], pos_e[m, 2]
        ux, uy, uz = -C_en[m, 0, 2], -C_en[m, 1, 2], -C_en[m, 2, 2]
        for s in range(coefficients.shape[0]):
            if t[m] < asleep[s]:
                continue
            seen = True
            distance, ex, ey, ez = C * travel[s], 0.0, 0.0, 0.0
            for _ in range(4):
                before = distance
                orbits.track_kernel(t_0, step, coefficients, s, now - distance / C, False, state)
                distance, ex, ey, ez = range_kernel(state[0], state[1], state[2], rx, ry, rz, RATE)
                below = sin_mask - (ex * ux + ey * uy + ez * uz)
                if below > 1e-3:
                    asleep[s] = t[m] + below / _RISE
                    seen = False
                    break
                if abs(distance - before) < _SETTLED:
                    break
            travel[s] = distance / C
            cn0 = 0.0
            sin_el = ex * ux + ey * uy + ez * uz
            if seen and sin_el >= sin_mask:
                n = C_en[m, 0, 0] * ex + C_en[m, 1, 0] * ey + C_en[m, 2, 0] * ez
                e = C_en[m, 0, 1] * ex + C_en[m, 1, 1] * ey + C_en[m, 2, 1] * ez
                sin_body = -(n * down_n[m, 0] + e * down_n[m, 1] - sin_el * down_n[m, 2])
                cn0 = horizon + (zenith - horizon) * sin_body
                seen = sin_body >= sin_antenna and cn0 >= threshold
            else:
                seen = False
            if not seen:
                since[s] = np.nan
                continue
            if np.isnan(since[s]):
                since[s] = t[m] if m > 0 else -1e300
            if t[m] - since[s] < wait:
                continue
            orbits.track_kernel(t_0, step, coefficients, s, now - distance / C, True, state)
            a, b = range_rate_kernel(
                state[0], state[1], state[2], state[4], state[5], state[6],
                rx, ry, rz, ex, ey, ez, distance, RATE,
            )  # fmt: skip
            epoch[k], sat[k] = m, s
            for i in range(3):
                out[k, i], out[k, 3 + i] = state[i], state[4 + i]
            out[k, 6], out[k, 7] = state[3], state[7]
            out[k, 8] = distance
            out[k, 9] = (a - ex * vel_e[m, 0] - ey * vel_e[m, 1] - ez * vel_e[m, 2]) / b
            out[k, 10], out[k, 11] = cn0, sin_el
            k += 1
    return k


@kernel
def _remember_kernel(decay: FloatArray, noise: FloatArray) -> None:
    """Turn unit white noise (M, S) into stationary Gauss-Markov processes of unit sd, in place."""
    for m in range(1, noise.shape[0]):
        w = decay[m - 1]
        fresh = np.sqrt(1.0 - w * w)
        for s in range(noise.shape[1]):
            noise[m, s] = w * noise[m - 1, s] + fresh * noise[m, s]


@kernel
def _between_kernel(
    t: FloatArray, knots: IntArray, values: FloatArray, epoch: IntArray, which: IntArray, out: FloatArray
) -> None:
    """Fill out (K,) with values (B, S), given at epochs ``knots`` (B,), linear in between."""
    j = 0
    for k in range(out.shape[0]):
        m = epoch[k]
        while j + 2 < knots.shape[0] and knots[j + 1] <= m:
            j += 1
        if knots.shape[0] == 1:
            out[k] = values[0, which[k]]
        else:
            a, b = t[knots[j]], t[knots[j + 1]]
            f = (t[m] - a) / (b - a)
            out[k] = values[j, which[k]] + f * (values[j + 1, which[k]] - values[j, which[k]])


@kernel
def _slant_kernel(sin_el: FloatArray, el: FloatArray, obliquity: FloatArray, mapping: FloatArray) -> None:
    for k in range(sin_el.shape[0]):
        obliquity[k] = obliquity_kernel(el[k])
        mapping[k] = mapping_kernel(sin_el[k])


def code_sd(cn0: FloatArray, chip: FloatArray, spec: SkySpec) -> FloatArray:
    """Return the thermal noise of the code loop [m].

    Parameters
    ----------
    cn0 : array
        [dB-Hz].
    chip : array
        Length of a chip [m].
    spec : SkySpec
        ``dll_bandwidth``, ``dll_spacing`` d and ``integration`` T.

    Notes
    -----
    Noncoherent early-minus-late power discriminator, wide front end: Kaplan and Hegarty, Understanding GPS,
    2nd ed. (2006), eq. 5.23: ``sqrt(B d / (2 C/N0) (1 + 2 / ((2 - d) T C/N0)))`` chips.
    """
    ratio = np.exp(_DECIBEL * cn0)
    d = spec.dll_spacing
    loss = 1.0 + 2.0 / ((2.0 - d) * spec.integration * ratio)
    sd: FloatArray = chip * np.sqrt(spec.dll_bandwidth * d / (2.0 * ratio) * loss)
    return sd


def doppler_sd(cn0: FloatArray, frequency: FloatArray, spec: SkySpec) -> FloatArray:
    """Return the thermal noise of the frequency loop as a range rate [m/s].

    Notes
    -----
    Kaplan and Hegarty (2006), eq. 5.9, at high C/N0 (F = 1):
    ``wavelength / (2 pi T) sqrt(4 B / (C/N0) (1 + 1 / (T C/N0)))``.
    """
    ratio = np.exp(_DECIBEL * cn0)
    T = spec.integration
    noise = np.sqrt(4.0 * spec.fll_bandwidth / ratio * (1.0 + 1.0 / (T * ratio)))
    sd: FloatArray = C / frequency / (2.0 * np.pi * T) * noise
    return sd


def measure(
    truth: Trajectory,
    spec: GnssSpec,
    antenna_b: tuple[float, float, float],
    outages: tuple[tuple[float, float], ...],
    seed: int,
    run: int,
) -> Sky:
    """Return what the receiver measures and the fixes it computes, epochs inside an outage left out.

    Parameters
    ----------
    truth : Trajectory
        The motion of the IMU.
    spec : GnssSpec
        The receiver, with its ``sky``.
    antenna_b : (3,) tuple
        Antenna relative to the IMU [m], b; it looks up, along -down of the body.
    outages : tuple of (start, end)
        Without anything in [start, end) [s].
    seed, run : int
        Which draw of the errors.

    Raises
    ------
    ValueError
        When ``spec`` has no sky, or its rate is above that of the truth.
    """
    sky = spec.sky
    if sky is None:
        raise ValueError(f"gnss {spec.name!r} is a position-level receiver: it has no [sky]")
    rows = epoch_rows("gnss", truth.t, spec.rate)
    t = truth.t[rows]
    lla, vel_n = antenna(truth, rows, antenna_b)
    pos_e = earth.to_ecef(lla)
    C_en = np.ascontiguousarray(earth.matrix_en(lla[:, 0], lla[:, 1]))
    vel_e = np.einsum("mij,mj->mi", C_en, vel_n)
    down_n = rotation.rotate(truth.q_nb[rows], np.array([0.0, 0.0, 1.0]))
    sat, system, channel, track = _constellation(sky, t)
    S = len(sat)
    size = len(t) * S
    epoch, which, columns = np.empty(size, np.int64), np.empty(size, np.int64), np.empty((size, _RECEIVED))
    count = _geometry_kernel(
        t,
        pos_e,
        vel_e,
        C_en,
        down_n,
        track.t_0,
        track.step,
        track.coefficients,
        sky.gps_t0,
        float(np.sin(max(sky.elevation_mask, _GEOMETRIC))),
        float(np.sin(sky.antenna_mask)),
        sky.cn0_zenith,
        sky.cn0_horizon,
        sky.cn0_threshold,
        sky.reacquisition,
        np.full(S, np.nan),
        np.full(S, -np.inf),
        np.full(S, 0.075),
        np.empty(8),
        epoch,
        which,
        columns,
    )
    epoch, which, columns = epoch[:count], which[:count], columns[:count]

    errors = _Errors(t, epoch, which, S, seed, run)
    clock, drift = _clock(truth, rows, sky, seed, run)
    start = np.searchsorted(epoch, np.arange(len(t) + 1))
    seen = receiver.look(
        pos_e,
        epoch_start=start,
        t=t[epoch] + sky.gps_t0,
        sat_pos_e=np.ascontiguousarray(columns[:, :3]),
        frequency=orbits.frequencies(system[which], channel[which])[:, 0].copy(),
        klobuchar=np.array(sky.klobuchar),
    )
    observations = _observe(
        t, start, spec.latency, sky, seen, clock, drift, epoch, which, columns, sat, system, channel, errors
    )
    kept = np.diff(start) > 0
    for begin, end in outages:
        first, stop = interval_rows(truth.t, begin, end)
        kept &= (rows < first) | (rows >= stop)
    if not kept.all():
        observations, seen = _epochs(observations, seen, kept)
    # a receiver that tracks predicts where it is; the prediction moves its fix by a centimetre at most
    solution = receiver.solve(observations, processing(sky), near=seen)
    solved = np.isfinite(solution.fixes.lla).all(axis=1) & np.isfinite(solution.fixes.vel_n).all(axis=1)
    fixes = GnssFixes(*(getattr(solution.fixes, name)[solved] for name in GnssFixes.__slots__))
    return Sky(observations, fixes, solution)


def processing(sky: SkySpec) -> receiver.Processing:
    """Return how the receiver of a sky computes its fixes."""
    return receiver.Processing(
        systems=sky.systems,  # type: ignore[arg-type]
        ionosphere="free" if sky.bands == 2 else "klobuchar",
        mask=sky.elevation_mask,
        false_alarm=sky.false_alarm,
    )


def _constellation(sky: SkySpec, t: FloatArray) -> tuple[IntArray, IntArray, IntArray, orbits.Track]:
    """Return number, system and frequency channel (S,) of all satellites, and their track."""
    gps = orbits.nominal_gps() if sky.gps is None else sky.gps
    glonass = orbits.nominal_glonass() if sky.glonass is None else sky.glonass
    first, last = t[0] + sky.gps_t0 - 1.0, t[-1] + sky.gps_t0
    gps_sat, gps_track = orbits.track(gps, first, last)
    glonass_sat, glonass_track = orbits.track(glonass, first, last)
    if isinstance(glonass, orbits.GlonassSets):
        channel = np.array([glonass.channel[np.argmax(glonass.sat == s)] for s in glonass_sat], np.int64)
    else:  # antipodal satellites share a channel; four pairs to a plane of eight
        channel = (glonass_sat - 1) % 4 + 4 * ((glonass_sat - 1) // 8) - 7
    system = np.repeat([GPS, GLONASS], [len(gps_sat), len(glonass_sat)])
    coefficients = np.concatenate([gps_track.coefficients, glonass_track.coefficients])
    return (
        np.concatenate([gps_sat, glonass_sat]),
        system,
        np.concatenate([np.zeros(len(gps_sat), np.int64), channel]),
        gps_track._replace(coefficients=coefficients),
    )


class _Errors:
    """The errors of one run, drawn for all satellites at all epochs, handed out for the rows received."""

    def __init__(
        self, t: FloatArray, epoch: IntArray, which: IntArray, satellites: int, seed: int, run: int
    ) -> None:
        self._t, self._epoch, self._which, self._satellites = t, epoch, which, satellites
        self._flat = epoch * satellites + which
        self._seed, self._run = seed, run

    def _stream(self, name: str) -> np.random.Generator:
        return stream(self._seed, self._run, f"gnss.sky.{name}")

    def once(self, name: str) -> float:
        """Return a standard normal number."""
        return float(self._stream(name).standard_normal())

    def white(self, name: str) -> FloatArray:
        """Return unit white noise (K,)."""
        noise = self._stream(name).standard_normal(len(self._t) * self._satellites)
        rows: FloatArray = noise[self._flat]
        return rows

    def slow(self, name: str, correlation: float, *, common: bool = False) -> FloatArray:
        """Return unit Gauss-Markov processes (K,), one for each satellite or one for all.

        Stepped at a fortieth of the correlation time, no finer than the epochs, and linear in between:
        there the sd is at most 0.6 % low.
        """
        t = self._t
        pace = (t[-1] - t[0]) / max(len(t) - 1, 1)
        stride = max(1, int(correlation / 40.0 / pace)) if pace > 0 else 1
        knots = np.append(np.arange(0, len(t) - 1, stride), len(t) - 1)
        columns = 1 if common else self._satellites
        noise = self._stream(name).standard_normal((len(knots), columns))
        _remember_kernel(np.exp(-np.diff(t[knots]) / correlation), noise)
        out = np.empty(len(self._epoch))
        _between_kernel(
            t, knots, noise, self._epoch, np.zeros_like(self._which) if common else self._which, out
        )
        return out


def _clock(
    truth: Trajectory, rows: IntArray, sky: SkySpec, seed: int, run: int
) -> tuple[FloatArray, FloatArray]:
    """Return offset (M,) [m] and drift (M,) [m/s] of the receiver's clock.

    Notes
    -----
    Two-state model with the spectral densities ``c^2 h_0 / 2`` of the offset and ``2 pi^2 c^2 h_-2`` of the
    drift, discretized exactly; flicker of frequency is left out (Brown and Hwang, Introduction to Random
    Signals and Applied Kalman Filtering, 3rd ed., 10.3). Specific force along down bends the frequency.
    """
    t = truth.t[rows]
    offset, drift = np.zeros(len(t)), np.zeros(len(t))
    if sky.clock_offset_sd > 0:
        offset += sky.clock_offset_sd * stream(seed, run, "gnss.sky.clock.offset").standard_normal()
    if sky.clock_drift_sd > 0:
        constant = sky.clock_drift_sd * stream(seed, run, "gnss.sky.clock.drift").standard_normal()
        drift += constant
        offset += constant * (t - t[0])
    if sky.clock_h_0 > 0 or sky.clock_h_m2 > 0:
        white, walk = 0.5 * C**2 * sky.clock_h_0, 2 * np.pi**2 * C**2 * sky.clock_h_m2
        dt = np.diff(t)
        one, two = stream(seed, run, "gnss.sky.clock.noise").standard_normal((2, len(dt)))
        steps = np.sqrt(walk * dt) * one  # of the drift; the offset moves with them and by itself
        walked = np.concatenate([[0.0], np.cumsum(steps)])
        own = np.sqrt(white * dt + walk * dt**3 / 12) * two
        offset[1:] += np.cumsum(walked[:-1] * dt + 0.5 * steps * dt + own)
        drift += walked
    if sky.clock_g != 0:
        gain = C * sky.clock_g
        felt = np.add.reduceat(truth.dvel_b[:, 2], np.append(0, rows[:-1]))  # between epochs
        if rows[-1] < len(truth.dvel_b):
            felt[-1] -= truth.dvel_b[rows[-1] :, 2].sum()
        before, after = np.maximum(rows - 1, 0), np.minimum(rows, len(truth.dvel_b) - 1)
        rates = (truth.dvel_b[at, 2] / (truth.t[at + 1] - truth.t[at]) for at in (before, after))
        offset += gain * np.cumsum(felt)
        drift += gain * 0.5 * sum(rates)
    return offset, drift


def _observe(
    t: FloatArray, start: IntArray, latency: float, sky: SkySpec, seen: receiver.Look,
    clock: FloatArray, drift: FloatArray, epoch: IntArray, which: IntArray, columns: FloatArray,
    sat: IntArray, system: IntArray, channel: IntArray, errors: _Errors,
) -> GnssObservations:  # fmt: skip
    """Return the observations of what is received, with their errors."""
    count, bands = len(epoch), sky.bands
    row_system = system[which]
    frequency = orbits.frequencies(row_system, channel[which])[:, :bands]
    geometric, rate, cn0, sin_el = columns[:, 8], columns[:, 9], columns[:, 10], columns[:, 11]
    el = seen.el
    obliquity, mapping = np.empty(count), np.empty(count)
    _slant_kernel(sin_el, el, obliquity, mapping)
    ionosphere, troposphere = seen.ionosphere, seen.troposphere  # on the first carrier
    if sky.ionosphere_sd > 0:
        residual = errors.slow("ionosphere", sky.ionosphere_correlation)
        ionosphere = ionosphere + sky.ionosphere_sd * residual * obliquity * (L1 / frequency[:, 0]) ** 2
    common = geometric + troposphere + clock[epoch] - columns[:, 6]
    if sky.glonass_offset_sd > 0:
        common += sky.glonass_offset_sd * errors.once("glonass_offset") * (row_system == GLONASS)
    if sky.troposphere_sd > 0:
        residual = errors.slow("troposphere", sky.troposphere_correlation, common=True)
        common += sky.troposphere_sd * residual * mapping
    if sky.gps_space_sd > 0 or sky.glonass_space_sd > 0:
        space = np.array([sky.gps_space_sd, sky.glonass_space_sd])[row_system]
        common += space * errors.slow("space", sky.space_correlation)
    shadow = sky.multipath_zenith_sd + sky.multipath_horizon_sd * np.exp(-el / _MULTIPATH_DECAY)
    chip = np.array(_CHIP)[row_system]
    pseudorange, range_rate, strength = np.empty((3, count, bands))
    tracking = np.empty((2, count))
    for band in range(bands):
        strength[:, band] = cn0 - band * sky.second_band_loss
        pseudorange[:, band] = common + ionosphere * (frequency[:, 0] / frequency[:, band]) ** 2
        noise, doppler = (
            code_sd(strength[:, band], chip, sky),
            doppler_sd(strength[:, band], frequency[:, band], sky),
        )
        if sky.dll_bandwidth > 0:
            pseudorange[:, band] += noise * errors.white(f"code.{band + 1}")
        if sky.multipath_zenith_sd > 0 or sky.multipath_horizon_sd > 0:
            slow = errors.slow(f"multipath.{band + 1}", sky.multipath_correlation)
            pseudorange[:, band] += shadow * slow
        range_rate[:, band] = rate + drift[epoch] - columns[:, 7]
        if sky.fll_bandwidth > 0:
            range_rate[:, band] += doppler * errors.white(f"doppler.{band + 1}")
        if band == 0:
            tracking[:] = noise, doppler
    # the receiver takes the instant of transmission from its own pseudorange, wrong by the errors in it
    late = (pseudorange[:, 0] - geometric - clock[epoch] + columns[:, 6]) / C
    budget = receiver.ErrorBudget(
        signal_in_space=sky.gps_space_sd,
        signal_in_space_glonass=sky.glonass_space_sd,
        zenith_ionosphere=sky.ionosphere_sd,
        zenith_troposphere=sky.troposphere_sd,
        multipath_zenith=sky.multipath_zenith_sd,
        multipath_horizon=sky.multipath_horizon_sd,
        glonass=1.0,  # the code noise of each row is its own
        second_band=float(10.0 ** (sky.second_band_loss / 20.0)),
    )
    mode = processing(sky).ionosphere
    claimed = receiver.spread(el, row_system, frequency[:, 0].copy(), tracking[0], budget, mode)
    return GnssObservations(
        t=t[epoch],
        t_arrival=t[epoch] + latency,
        sat=sat[which],
        system=row_system,
        frequency=frequency,
        pseudorange=pseudorange,
        range_rate=range_rate,
        cn0=strength,
        sat_pos_e=columns[:, :3] - columns[:, 3:6] * late[:, None],
        sat_vel_e=columns[:, 3:6],
        sat_clock=columns[:, 6],
        sat_clock_rate=columns[:, 7],
        group_delay=np.zeros(count),
        sd_pseudorange=np.maximum(claimed, _LEAST[0]),
        sd_range_rate=np.maximum(tracking[1], _LEAST[1]),
        epoch_start=start,
        klobuchar=np.array(sky.klobuchar),
        gps_t0=sky.gps_t0,
    )


def _epochs(
    o: GnssObservations, seen: receiver.Look, kept: BoolArray
) -> tuple[GnssObservations, receiver.Look]:
    """Return the epochs that are kept (M,)."""
    counts = np.diff(o.epoch_start)
    rows = np.repeat(kept, counts)
    columns = {name: getattr(o, name) for name in GnssObservations.__slots__}
    whole = ("epoch_start", "klobuchar", "gps_t0")
    columns |= {name: column[rows] for name, column in columns.items() if name not in whole}
    columns["epoch_start"] = np.concatenate([[0], np.cumsum(counts[kept])])
    left = receiver.Look(seen.pos_e[kept], seen.lla[kept], *(column[rows] for column in seen[2:]))
    return GnssObservations(**columns), left
