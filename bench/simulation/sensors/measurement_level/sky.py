"""Measurement-level GNSS: ranges, range rates and C/N0 of every satellite in view, and the fixes from them.

Visibility depends on the orbits, the attitude of the aircraft and its antenna: a banked turn loses
satellites. Every error has its own stream, ``gnss.sky.<term>``, and draws for all satellites at all epochs,
so that it does not change with other errors or masks. The receiver samples at the epochs of the truth; its
clock error is in the pseudoranges.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from bench.core.compilation.compiled import kernel
from bench.core.mathematics.arrays import BoolArray, FloatArray, IntArray
from bench.core.records.data import GnssFixes, GnssObservations, Trajectory
from bench.core.records.orbit_sets import SYSTEM_NAMES
from bench.core.records.run_records import SkyView
from bench.core.records.sensor_specs import Fault, GnssSpec
from bench.core.records.sky_spec import SkySpec
from bench.simulation.sensors import faults
from bench.simulation.sensors.draws import SensorDraws
from bench.simulation.sensors.gnss import find_lag
from bench.simulation.sensors.measurement_level.clock import simulate_receiver_clock
from bench.simulation.sensors.measurement_level.ionosphere_field import (
    WAVES,
    draw_waves,
    field_kernel,
    locate_pierce_points,
)
from bench.simulation.sensors.measurement_level.loops import make_processing, track_bands
from bench.simulation.sensors.measurement_level.view import View, compute_view
from bench.simulation.sensors.timing import find_outage_rows
from bench.simulation.signals import orbits, receiver_solution
from bench.simulation.signals.delays import mapping_kernel
from bench.simulation.signals.look import Look, compute_look, estimate_range_sd, share_errors
from bench.simulation.signals.orbits import C

_LEAST = (0.01, 1e-4)  # smallest assumed sd of range and range rate [m, m/s]


class ReceiverOutput(NamedTuple):
    """Output of the receiver."""

    observations: GnssObservations
    fixes: GnssFixes
    solution: receiver_solution.ReceiverSolution  # a row per epoch with satellites, unsolved epochs included
    above: SkyView


@kernel
def _correlate_kernel(decay: float, noise: FloatArray) -> None:
    """Turn unit white noise (M, S) into Gauss-Markov processes of unit sd that begin with row 0, in place."""
    fresh = np.sqrt(1.0 - decay * decay)
    for m in range(1, noise.shape[0]):
        for s in range(noise.shape[1]):
            noise[m, s] = decay * noise[m - 1, s] + fresh * noise[m, s]


@kernel
def _interpolate_kernel(
    first: int, stride: int, values: FloatArray, epoch: IntArray, which: IntArray, out: FloatArray
) -> None:
    """Interpolate values (B, S), one every ``stride`` epochs, to epochs and satellites: fill out (K,).

    ``first`` is the number of epochs from the first of the values to the epoch 0.
    """
    for k in range(out.shape[0]):
        j, rest = divmod(first + epoch[k], stride)
        before = values[j, which[k]]
        out[k] = before + rest / stride * (values[j + 1, which[k]] - before)


@kernel
def _map_kernel(sin_el: FloatArray, mapping: FloatArray) -> None:
    for k in range(sin_el.shape[0]):
        mapping[k] = mapping_kernel(sin_el[k])


def measure(
    truth: Trajectory,
    spec: GnssSpec,
    antenna_b: tuple[float, float, float],
    outages: tuple[tuple[float, float], ...],
    draws: SensorDraws,
    scripted: Sequence[Fault] = (),
) -> ReceiverOutput:
    """Simulate the observations and fixes of a receiver, without epochs inside an outage.

    The parameters are those of `gnss.measure`. The axis of the antenna points up, along -z of
    the body.

    Raises
    ------
    ValueError
        If ``spec`` has no sky, or its rate is above that of the truth.
    """
    sky = spec.sky
    if sky is None:
        raise ValueError(f"gnss {spec.name!r} is a position-level receiver: it has no [sky]")
    root, draws = draws, draws.part("gnss.sky")
    rows, steps = draws.epochs("gnss", truth.t, spec.rate)
    t = truth.t[rows]
    clock, drift = simulate_receiver_clock(truth, rows, steps, sky, draws.part("clock"))

    def loss(system: IntArray, sat: IntArray) -> FloatArray:
        return faults.compute_loss(t, system, sat, scripted)

    everything = compute_view(truth, rows, sky, antenna_b, loss, draws.part("view"))
    if any(faults.select_faults(scripted, "gnss", "spoofing")):  # signals as received at the spoofed position
        offset = faults.compute_spoofing(t, scripted)
        spoofed: BoolArray = np.asarray(np.concatenate(offset, axis=1).any(axis=1))
        there = compute_view(truth, rows, sky, antenna_b, loss, draws.part("spoofed"), offset)
        everything = everything.replace_epochs(there, spoofed)
    v = everything.select_received()
    start = np.searchsorted(v.epoch, np.arange(len(t) + 1))
    seen = compute_look(
        v.pos_e,
        epoch_start=start,
        t=t[v.epoch] + sky.gps_t0,
        sat_pos_e=np.ascontiguousarray(v.sat_pos_e),
        frequency=orbits.carrier_frequencies(v.system[v.which], v.channel[v.which])[:, 0].copy(),
        klobuchar=np.array(sky.klobuchar),
        processing=replace(make_processing(sky), ionosphere="klobuchar"),  # there with two carriers, too
    )
    if spec.tracking_bandwidth > 0:
        behind, falling = (
            np.einsum("ki,ki->k", seen.los_n, lag[v.epoch])
            for lag in find_lag(truth, rows, spec.tracking_bandwidth, antenna_b, draws.part("lag"))
        )
        v = v._replace(distance=v.distance + behind, rate=v.rate + falling)
    clock = clock + faults.compute_clock_offset(t, scripted)
    errors = SkyErrors(t, v.epoch, v.which, len(v.sat), spec.rate, root)
    observations = _make_observations(t, start, spec.latency, sky, seen, clock, drift, v, errors, scripted)
    held = draws.keep("gnss", faults.HeldRows, "held")
    out, frozen = faults.find_reported_rows(t, scripted, "gnss", root, held)
    out = out.keep(_hears(out.content, start, held) & ~find_outage_rows(truth.t, rows, outages)[out.tag])
    content, tag, late = out
    own = observations, seen

    def take(epoch: int) -> tuple[GnssObservations, Look]:
        if epoch < 0:
            found: tuple[GnssObservations, Look] = held.rows[epoch]
            return found
        at = np.array([epoch])
        return _select_epochs(*own, at, t[at], t[at])

    if not np.array_equal(content, np.arange(len(t))) or late.any():
        before = len(held.rows) if (content < 0).any() else 0
        joined = _join_epochs([*held.rows[:before], own])
        observations, seen = _select_epochs(*joined, content + before, t[tag], t[tag] + spec.latency + late)
    if any(faults.select_faults(scripted, "gnss", "frozen")):
        held.go_on(frozen, len(t), take)
    # a tracking receiver predicts its position; the prediction moves its fix by a centimeter at most
    solution = receiver_solution.solve_fixes(observations, make_processing(sky), near=seen)
    fixes = _claim(solution.fixes, spec.optimism)
    now = np.repeat(content == tag, np.diff(observations.epoch_start))  # not frozen
    used = np.zeros(len(v.epoch), bool)
    used[_select_rows(start, content[content == tag])] = solution.used[now]
    reported = np.zeros(len(t), bool)
    reported[tag] = True
    return ReceiverOutput(observations, fixes, solution, _make_sky_view(t, everything, reported, used))


def _claim(fixes: GnssFixes, optimism: float) -> GnssFixes:
    """Return the solved fixes with the covariances that the receiver reports."""
    solved = np.isfinite(fixes.lla).all(axis=1) & np.isfinite(fixes.vel_n).all(axis=1)
    columns = {name: getattr(fixes, name)[solved] for name in GnssFixes.__slots__}
    for name in ("cov_pos_n", "cov_vel_n"):
        columns[name] = columns[name] / optimism**2
    return GnssFixes(**columns)


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


class SkyErrors:
    """Random errors of one run: drawn for all satellites at all epochs, returned for the received rows."""

    def __init__(
        self, t: FloatArray, epoch: IntArray, which: IntArray, satellites: int, rate: float, root: SensorDraws
    ) -> None:
        self._t, self._epoch, self._which, self._satellites = t, epoch, which, satellites
        self._flat = epoch * satellites + which
        self._rate, self._root, self._draws = rate, root, root.part("gnss.sky")
        counted = self._draws.keep("epochs before", lambda: [0])
        self._first = counted[0]  # number of the first epoch of this piece
        counted[0] += len(t)

    def draw_constant(self, name: str) -> float:
        """Draw a standard normal number."""
        return float(self._draws.constant(name))

    def draw_white(self, name: str) -> FloatArray:
        """Draw unit white noise (K,)."""
        noise = self._draws.stream(name).standard_normal(len(self._t) * self._satellites)
        rows: FloatArray = noise[self._flat]
        return rows

    def draw_bursts(self, scripted: Sequence[Fault], part: str) -> FloatArray | None:
        """Draw noise bursts (K,) as multiples of the white noise; None if there is no burst."""
        noise = faults.draw_bursts(self._t, scripted, "gnss", part, self._satellites, self._root)
        return None if noise is None else noise[self._epoch, self._which]

    def draw_markov(self, name: str, correlation: float, *, common: bool = False) -> FloatArray:
        """Draw unit Gauss-Markov processes (K,), one for each satellite or one for all.

        The step is a fortieth of the correlation time but not below the epochs, with linear interpolation,
        which lowers the sd by at most 0.6 %. The step that an epoch is in is drawn to its end.
        """
        columns = 1 if common else self._satellites
        out = np.empty(len(self._epoch))
        if len(self._t):
            which = np.zeros_like(self._which) if common else self._which
            _interpolate_kernel(*self._go_on(name, correlation, columns), self._epoch, which, out)
        return out

    def draw_field(self, seen: Look, correlation: float, decay: float) -> FloatArray:
        """Draw the ionosphere error (K,) of unit variance at pierce points, in the steps of `draw_markov`."""
        waves = draw_waves(self._draws.constant("ionosphere.waves", WAVES, 4), decay)
        out = np.empty(len(self._epoch))
        if len(self._t):
            knots = self._go_on("ionosphere", correlation, 2 * WAVES)
            field_kernel(*knots, waves, locate_pierce_points(seen, self._epoch), self._epoch, out)
        return out

    def _go_on(self, name: str, correlation: float, columns: int) -> tuple[int, int, FloatArray]:
        """Continue unit Gauss-Markov processes; return epochs before 0, epochs per step, values (B, S)."""
        stride = max(1, int(correlation / 40.0 * self._rate))
        noise = self._draws.stream(name)
        kept: list[Any] = self._draws.keep(name, lambda: [0, noise.standard_normal((1, columns))], "knots")
        begin, values = kept
        last = self._first + len(self._t) - 1  # epoch
        fresh = noise.standard_normal((last // stride + 2 - begin - len(values), columns))
        fresh = np.concatenate([values[-1:], fresh])
        _correlate_kernel(float(np.exp(-stride / (self._rate * correlation))), fresh)
        values = np.concatenate([values, fresh[1:]])
        kept[:] = [last // stride, values[last // stride - begin :]]
        return self._first - begin * stride, stride, values


def _make_observations(
    t: FloatArray, start: IntArray, latency: float, sky: SkySpec, seen: Look,
    clock: FloatArray, drift: FloatArray, v: View, errors: SkyErrors, scripted: Sequence[Fault],
) -> GnssObservations:  # fmt: skip
    """Return the observations of the received satellites, with their errors."""
    epoch, which = v.epoch, v.which
    count, bands = len(epoch), sky.bands
    row_system, row_sat = v.system[which], v.sat[which]
    frequency = orbits.carrier_frequencies(row_system, v.channel[which])[:, :bands]
    geometric, rate = v.distance, v.rate
    el = seen.el
    mapping = np.empty(count)
    _map_kernel(v.sin_el.copy(), mapping)
    ionosphere, troposphere = seen.ionosphere, seen.troposphere  # on the first carrier
    modeled = replace(make_processing(sky), ionosphere="klobuchar")  # there with two carriers, too
    if sky.ionosphere_left:
        residual = errors.draw_field(seen, sky.ionosphere_correlation, sky.ionosphere_decay)
        ionosphere = ionosphere + residual * share_errors(seen, frequency[:, 0], modeled).ionosphere
    common = geometric + troposphere + clock[epoch] - v.clock
    for system, sd in enumerate(sky.offset_sd):
        if sd > 0:
            name = f"{SYSTEM_NAMES[system].lower()}_offset"
            common += sd * errors.draw_constant(name) * (row_system == system)
    if sky.troposphere_sd > 0:
        residual = errors.draw_markov("troposphere", sky.troposphere_correlation, common=True)
        common += sky.troposphere_sd * residual * mapping
    space = np.array(sky.space_sd)[row_system]
    if max(sky.space_sd) > 0:
        common += space * errors.draw_markov("space", sky.space_correlation)
    added, added_rate = faults.compute_range_errors(t[epoch], row_system, row_sat, scripted)
    common += added
    rate = rate + added_rate
    rate = rate + drift[epoch] - v.clock_rate
    pseudorange, range_rate, strength, tracking = track_bands(
        common, ionosphere, rate, v.cn0, el, row_system, frequency, sky, errors, scripted
    )
    # the receiver computes the time of transmission from its pseudorange, with the errors of that
    late = (pseudorange[:, 0] - geometric - clock[epoch] + v.clock) / C
    processing = make_processing(sky)
    own = estimate_range_sd(el, frequency, tracking[0], space, processing.budget, bands == 2)
    shared = share_errors(seen, frequency[:, 0], processing)
    assumed = np.sqrt(own**2 + shared.ionosphere**2 + shared.troposphere**2)
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


def _hears(content: IntArray, start: IntArray, held: faults.HeldRows) -> BoolArray:
    """Return a mask of the epochs ``content`` (M,), of this piece or stored, that have a satellite."""
    older = [len(observations.t) > 0 for observations, _ in held.rows]
    known = np.concatenate([np.array(older, bool), np.diff(start) > 0])
    heard: BoolArray = known[content + len(older)]
    return heard


def _join_epochs(
    parts: Sequence[tuple[GnssObservations, Look]],
) -> tuple[GnssObservations, Look]:
    """Return the observations and looks of several parts as one."""
    observations, looks = zip(*parts, strict=True)
    whole = ("epoch_start", "klobuchar", "gps_t0")
    columns: dict[str, Any] = {name: getattr(observations[-1], name) for name in GnssObservations.__slots__}
    for name in columns:
        if name not in whole:
            columns[name] = np.concatenate([getattr(one, name) for one in observations])
    counts = np.concatenate([np.diff(one.epoch_start) for one in observations])
    columns["epoch_start"] = np.concatenate([[0], np.cumsum(counts)])
    joined = (np.concatenate(column) for column in zip(*looks, strict=True))
    return GnssObservations(**columns), Look(*joined)


def _select_epochs(
    o: GnssObservations, seen: Look, content: IntArray, t: FloatArray, t_arrival: FloatArray
) -> tuple[GnssObservations, Look]:
    """Return the epochs ``content`` (M,) of observations and look, with new times (M,)."""
    counts = np.diff(o.epoch_start)[content]
    rows = _select_rows(o.epoch_start, content)
    columns = {name: getattr(o, name) for name in GnssObservations.__slots__}
    whole = ("epoch_start", "klobuchar", "gps_t0")
    columns |= {name: column[rows] for name, column in columns.items() if name not in whole}
    columns["epoch_start"] = np.concatenate([[0], np.cumsum(counts)])
    columns |= {"t": np.repeat(t, counts), "t_arrival": np.repeat(t_arrival, counts)}
    left = Look(seen.pos_e[content], seen.lla[content], *(column[rows] for column in seen[2:]))
    return GnssObservations(**columns), left


def _select_rows(start: IntArray, epochs: IntArray) -> IntArray:
    """Return the rows of the given epochs (M,) in their order; ``start`` as in `GnssObservations`."""
    counts = np.diff(start)[epochs]
    first = np.repeat(start[:-1][epochs] - np.concatenate([[0], np.cumsum(counts)[:-1]]), counts)
    rows: IntArray = first + np.arange(len(first))
    return rows
