"""Measurement-level GNSS: ranges, range rates and C/N0 of every satellite in view, and the fixes from them.

Visibility depends on the orbits, the attitude of the aircraft and its antenna: a banked turn loses
satellites. Every error has its own stream, ``gnss.sky.<term>``, and draws for all satellites at all epochs,
so that it does not change with other errors or masks. The receiver samples at the instants of the truth; its
clock error is in the pseudoranges.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from bench.arrays import BoolArray, FloatArray, IntArray
from bench.compiled import kernel
from bench.data import GLONASS, GnssFixes, GnssObservations, SkyView, Trajectory
from bench.sensors import faults
from bench.sensors.clock import simulate_receiver_clock
from bench.sensors.timing import find_epoch_rows, find_outage_rows
from bench.sensors.view import View, compute_view
from bench.signals import orbits, receiver
from bench.signals.delays import mapping_kernel, obliquity_kernel
from bench.signals.orbits import L1, C
from bench.specs import Fault, GnssSpec, SkySpec, stream

_CHIP = (C / 1.023e6, C / 0.511e6)  # length of a chip of the civil code, GPS and GLONASS [m], their ICDs
_DECIBEL = np.log(10.0) / 10.0
_MULTIPATH_DECAY = float(np.deg2rad(10.0))  # [rad], RTCA DO-229D, appendix J
_LEAST = (0.01, 1e-4)  # smallest assumed sd of range and range rate [m, m/s]


class ReceiverOutput(NamedTuple):
    """Output of the receiver."""

    observations: GnssObservations
    fixes: GnssFixes
    solution: receiver.ReceiverSolution  # a row per epoch with satellites, unsolved epochs included
    above: SkyView


@kernel
def _correlate_kernel(decay: FloatArray, noise: FloatArray) -> None:
    """Turn unit white noise (M, S) into stationary Gauss-Markov processes of unit sd, in place."""
    for m in range(1, noise.shape[0]):
        w = decay[m - 1]
        fresh = np.sqrt(1.0 - w * w)
        for s in range(noise.shape[1]):
            noise[m, s] = w * noise[m - 1, s] + fresh * noise[m, s]


@kernel
def _interpolate_kernel(
    t: FloatArray, knots: IntArray, values: FloatArray, epoch: IntArray, which: IntArray, out: FloatArray
) -> None:
    """Interpolate values (B, S) from epochs ``knots`` (B,) to epochs and satellites: fill out (K,)."""
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
    """Return the standard deviation of the thermal noise of the code loop [m] at C/N0 [dB-Hz].

    Notes
    -----
    Noncoherent early-minus-late power discriminator, wide front end: Kaplan and Hegarty, Understanding GPS,
    2nd ed. (2006), eq. 5.23: ``sqrt(B d / (2 C/N0) (1 + 2 / ((2 - d) T C/N0)))`` chips [m], with bandwidth B,
    spacing d and integration T of the spec.
    """
    ratio = np.exp(_DECIBEL * cn0)
    d = spec.dll_spacing
    loss = 1.0 + 2.0 / ((2.0 - d) * spec.integration * ratio)
    sd: FloatArray = chip * np.sqrt(spec.dll_bandwidth * d / (2.0 * ratio) * loss)
    return sd


def doppler_sd(cn0: FloatArray, frequency: FloatArray, spec: SkySpec) -> FloatArray:
    """Return the standard deviation of the thermal noise of the frequency loop as a range rate [m/s].

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
    scripted: Sequence[Fault] = (),
) -> ReceiverOutput:
    """Simulate the observations and fixes of a receiver, without epochs inside an outage.

    The parameters are those of `bench.sensors.gnss.measure`. The axis of the antenna points up, along -z of
    the body.

    Raises
    ------
    ValueError
        If ``spec`` has no sky, or its rate is above that of the truth.
    """
    sky = spec.sky
    if sky is None:
        raise ValueError(f"gnss {spec.name!r} is a position-level receiver: it has no [sky]")
    rows = find_epoch_rows("gnss", truth.t, spec.rate)
    t = truth.t[rows]

    def loss(system: IntArray, sat: IntArray) -> FloatArray:
        return faults.compute_loss(t, system, sat, scripted)

    everything = compute_view(truth, rows, sky, antenna_b, loss)
    offset = faults.compute_spoofing(t, scripted)
    spoofed: BoolArray = np.asarray(np.concatenate(offset, axis=1).any(axis=1))
    if spoofed.any():  # signals as received at the spoofed position
        everything = everything.replace_epochs(
            compute_view(truth, rows, sky, antenna_b, loss, offset), spoofed
        )
    v = everything.select_received()
    start = np.searchsorted(v.epoch, np.arange(len(t) + 1))
    seen = receiver.compute_look(
        v.pos_e,
        epoch_start=start,
        t=t[v.epoch] + sky.gps_t0,
        sat_pos_e=np.ascontiguousarray(v.sat_pos_e),
        frequency=orbits.carrier_frequencies(v.system[v.which], v.channel[v.which])[:, 0].copy(),
        klobuchar=np.array(sky.klobuchar),
    )
    clock, drift = simulate_receiver_clock(truth, rows, sky, seed, run)
    clock = clock + faults.compute_clock_offset(t, scripted)
    errors = _Errors(t, v.epoch, v.which, len(v.sat), seed, run)
    observations = _make_observations(t, start, spec.latency, sky, seen, clock, drift, v, errors, scripted)
    out = faults.find_reported_rows(t, scripted, "gnss", seed, run)
    out = out.keep((np.diff(start) > 0)[out.content] & ~find_outage_rows(truth.t, rows, outages)[out.tag])
    content, tag, late = out
    if not np.array_equal(content, np.arange(len(t))) or late.any():
        observations, seen = _select_epochs(observations, seen, content, t[tag], t[tag] + spec.latency + late)
    # a tracking receiver predicts its position; the prediction moves its fix by a centimetre at most
    solution = receiver.solve_fixes(observations, make_processing(sky), near=seen)
    solved = np.isfinite(solution.fixes.lla).all(axis=1) & np.isfinite(solution.fixes.vel_n).all(axis=1)
    columns = {name: getattr(solution.fixes, name)[solved] for name in GnssFixes.__slots__}
    for name in ("cov_pos_n", "cov_vel_n"):
        columns[name] = columns[name] / spec.optimism**2
    fixes = GnssFixes(**columns)
    now = np.repeat(content == tag, np.diff(observations.epoch_start))  # not frozen
    used = np.zeros(len(v.epoch), bool)
    used[_select_rows(start, content)[now & solution.used]] = True
    reported = np.zeros(len(t), bool)
    reported[tag] = True
    return ReceiverOutput(observations, fixes, solution, _make_sky_view(t, everything, reported, used))


def _make_sky_view(t: FloatArray, v: View, reported: BoolArray, used: BoolArray) -> SkyView:
    """Return all satellites above the mask; ``reported`` marks epochs (M,), ``used`` marks received rows."""
    of_all = np.zeros(len(v.epoch), bool)
    of_all[v.received] = used
    return SkyView(
        t=t[v.epoch],
        system=v.system[v.which],
        sat=v.sat[v.which],
        azimuth=v.azimuth,
        elevation=np.arcsin(v.sin_el),
        cn0=np.where(v.received & reported[v.epoch], v.cn0, np.nan),
        used=of_all,
    )


def make_processing(sky: SkySpec) -> receiver.Processing:
    """Return the settings by which the receiver computes its fixes."""
    return receiver.Processing(
        systems=sky.systems,  # type: ignore[arg-type]
        ionosphere="free" if sky.bands == 2 else "klobuchar",
        mask=sky.elevation_mask,
        false_alarm=sky.false_alarm,
    )


class _Errors:
    """Random errors of one run: drawn for all satellites at all epochs, returned for the received rows."""

    def __init__(
        self, t: FloatArray, epoch: IntArray, which: IntArray, satellites: int, seed: int, run: int
    ) -> None:
        self._t, self._epoch, self._which, self._satellites = t, epoch, which, satellites
        self._flat = epoch * satellites + which
        self._seed, self._run = seed, run

    def _stream(self, name: str) -> np.random.Generator:
        return stream(self._seed, self._run, f"gnss.sky.{name}")

    def draw_constant(self, name: str) -> float:
        """Draw a standard normal number."""
        return float(self._stream(name).standard_normal())

    def draw_white(self, name: str) -> FloatArray:
        """Draw unit white noise (K,)."""
        noise = self._stream(name).standard_normal(len(self._t) * self._satellites)
        rows: FloatArray = noise[self._flat]
        return rows

    def draw_bursts(self, scripted: Sequence[Fault], part: str) -> FloatArray | None:
        """Draw noise bursts (K,) as multiples of the white noise; None if there is no burst."""
        noise = faults.draw_bursts(self._t, scripted, "gnss", part, self._satellites, self._seed, self._run)
        return None if noise is None else noise[self._epoch, self._which]

    def draw_markov(self, name: str, correlation: float, *, common: bool = False) -> FloatArray:
        """Draw unit Gauss-Markov processes (K,), one for each satellite or one for all.

        The step is a fortieth of the correlation time but not below the epochs, with linear interpolation,
        which lowers the sd by at most 0.6 %.
        """
        t = self._t
        pace = (t[-1] - t[0]) / max(len(t) - 1, 1)
        stride = max(1, int(correlation / 40.0 / pace)) if pace > 0 else 1
        knots = np.append(np.arange(0, len(t) - 1, stride), len(t) - 1)
        columns = 1 if common else self._satellites
        noise = self._stream(name).standard_normal((len(knots), columns))
        _correlate_kernel(np.exp(-np.diff(t[knots]) / correlation), noise)
        out = np.empty(len(self._epoch))
        _interpolate_kernel(
            t, knots, noise, self._epoch, np.zeros_like(self._which) if common else self._which, out
        )
        return out


def _make_observations(
    t: FloatArray, start: IntArray, latency: float, sky: SkySpec, seen: receiver.Look,
    clock: FloatArray, drift: FloatArray, v: View, errors: _Errors, scripted: Sequence[Fault],
) -> GnssObservations:  # fmt: skip
    """Return the observations of the received satellites, with their errors."""
    epoch, which = v.epoch, v.which
    count, bands = len(epoch), sky.bands
    row_system, row_sat = v.system[which], v.sat[which]
    frequency = orbits.carrier_frequencies(row_system, v.channel[which])[:, :bands]
    geometric, rate, cn0 = v.distance, v.rate, v.cn0
    el = seen.el
    obliquity, mapping = np.empty(count), np.empty(count)
    _slant_kernel(v.sin_el.copy(), el, obliquity, mapping)
    ionosphere, troposphere = seen.ionosphere, seen.troposphere  # on the first carrier
    if sky.ionosphere_sd > 0:
        residual = errors.draw_markov("ionosphere", sky.ionosphere_correlation)
        ionosphere = ionosphere + sky.ionosphere_sd * residual * obliquity * (L1 / frequency[:, 0]) ** 2
    common = geometric + troposphere + clock[epoch] - v.clock
    if sky.glonass_offset_sd > 0:
        common += sky.glonass_offset_sd * errors.draw_constant("glonass_offset") * (row_system == GLONASS)
    if sky.troposphere_sd > 0:
        residual = errors.draw_markov("troposphere", sky.troposphere_correlation, common=True)
        common += sky.troposphere_sd * residual * mapping
    if sky.gps_space_sd > 0 or sky.glonass_space_sd > 0:
        space = np.array([sky.gps_space_sd, sky.glonass_space_sd])[row_system]
        common += space * errors.draw_markov("space", sky.space_correlation)
    added, added_rate = faults.compute_range_errors(t[epoch], row_system, row_sat, scripted)
    common += added
    rate = rate + added_rate
    shadow = sky.multipath_zenith_sd + sky.multipath_horizon_sd * np.exp(-el / _MULTIPATH_DECAY)
    chip = np.array(_CHIP)[row_system]
    pseudorange, range_rate, strength = np.empty((3, count, bands))
    tracking = np.empty((2, count))
    for band in range(bands):
        strength[:, band] = cn0 - band * sky.second_band_loss
        pseudorange[:, band] = common + ionosphere * (frequency[:, 0] / frequency[:, band]) ** 2
        noise = code_sd(strength[:, band], chip, sky)
        doppler = doppler_sd(strength[:, band], frequency[:, band], sky)
        if sky.dll_bandwidth > 0:
            pseudorange[:, band] += noise * errors.draw_white(f"code.{band + 1}")
        burst = errors.draw_bursts(scripted, f"code.{band + 1}")
        if burst is not None:
            pseudorange[:, band] += noise * burst
        if sky.multipath_zenith_sd > 0 or sky.multipath_horizon_sd > 0:
            slow = errors.draw_markov(f"multipath.{band + 1}", sky.multipath_correlation)
            pseudorange[:, band] += shadow * slow
        range_rate[:, band] = rate + drift[epoch] - v.clock_rate
        if sky.fll_bandwidth > 0:
            range_rate[:, band] += doppler * errors.draw_white(f"doppler.{band + 1}")
        burst = errors.draw_bursts(scripted, f"doppler.{band + 1}")
        if burst is not None:
            range_rate[:, band] += doppler * burst
        if band == 0:
            tracking[:] = noise, doppler
    # the receiver computes the time of transmission from its pseudorange, with the errors of that
    late = (pseudorange[:, 0] - geometric - clock[epoch] + v.clock) / C
    budget = receiver.ErrorBudget(
        signal_in_space=sky.gps_space_sd,
        signal_in_space_glonass=sky.glonass_space_sd,
        zenith_ionosphere=sky.ionosphere_sd,
        zenith_troposphere=sky.troposphere_sd,
        multipath_zenith=sky.multipath_zenith_sd,
        multipath_horizon=sky.multipath_horizon_sd,
        glonass=1.0,  # the code noise is given for each row
        second_band=float(10.0 ** (sky.second_band_loss / 20.0)),
    )
    mode = make_processing(sky).ionosphere
    assumed = receiver.pseudorange_sd(el, row_system, frequency[:, 0].copy(), tracking[0], budget, mode)
    return GnssObservations(
        t=t[epoch],
        t_arrival=t[epoch] + latency,
        sat=row_sat,
        system=row_system,
        frequency=frequency,
        pseudorange=pseudorange,
        range_rate=range_rate,
        cn0=strength,
        sat_pos_e=v.sat_pos_e - v.sat_vel_e * late[:, None],
        sat_vel_e=v.sat_vel_e,
        sat_clock=v.clock,
        sat_clock_rate=v.clock_rate,
        group_delay=np.zeros(count),
        sd_pseudorange=np.maximum(assumed, _LEAST[0]),
        sd_range_rate=np.maximum(tracking[1], _LEAST[1]),
        epoch_start=start,
        klobuchar=np.array(sky.klobuchar),
        gps_t0=sky.gps_t0,
    )


def _select_epochs(
    o: GnssObservations, seen: receiver.Look, content: IntArray, t: FloatArray, t_arrival: FloatArray
) -> tuple[GnssObservations, receiver.Look]:
    """Return the epochs ``content`` (M,) of observations and look, with new times (M,)."""
    counts = np.diff(o.epoch_start)[content]
    rows = _select_rows(o.epoch_start, content)
    columns = {name: getattr(o, name) for name in GnssObservations.__slots__}
    whole = ("epoch_start", "klobuchar", "gps_t0")
    columns |= {name: column[rows] for name, column in columns.items() if name not in whole}
    columns["epoch_start"] = np.concatenate([[0], np.cumsum(counts)])
    columns |= {"t": np.repeat(t, counts), "t_arrival": np.repeat(t_arrival, counts)}
    left = receiver.Look(seen.pos_e[content], seen.lla[content], *(column[rows] for column in seen[2:]))
    return GnssObservations(**columns), left


def _select_rows(start: IntArray, epochs: IntArray) -> IntArray:
    """Return the rows of the given epochs (M,) in their order; ``start`` as in `GnssObservations`."""
    counts = np.diff(start)[epochs]
    first = np.repeat(start[:-1][epochs] - np.concatenate([[0], np.cumsum(counts)[:-1]]), counts)
    rows: IntArray = first + np.arange(len(first))
    return rows
