"""Visibility and reception of satellites by orbits, attitude of the aircraft and antenna."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from bench.core.compilation.compiled import kernel
from bench.core.mathematics import earth, rotation
from bench.core.mathematics.arrays import BoolArray, FloatArray, IntArray
from bench.core.records.data import Trajectory
from bench.core.records.orbit_sets import GLONASS, GlonassSets, KeplerSets
from bench.core.records.sky_spec import SkySpec
from bench.simulation.sensors.draws import SensorDraws
from bench.simulation.sensors.gnss import compute_antenna_motion
from bench.simulation.signals import orbits
from bench.simulation.signals.delays import range_kernel, range_rate_kernel
from bench.simulation.signals.orbits import GPS_EARTH_RATE, C

_RISE = 4e-4  # upper limit of the rate of elevation [rad/s]: 3.9 km/s at 20 000 km, and an aircraft
_SETTLED = 5e-3  # a range that changes by less between two iterations is accurate to 1e-8 m [m]
AHEAD = 14_400.0  # orbits are fitted for so long at a time [s]
_COLUMNS = 14  # number of columns of the geometry kernel

Offset = tuple[FloatArray, FloatArray]
ComputeLoss = Callable[[IntArray, IntArray], FloatArray]


class View(NamedTuple):
    """Satellites above the elevation mask, a row per epoch and satellite.

    The columns from ``sat_pos_e`` to ``rate`` are filled for received satellites only.
    """

    pos_e: FloatArray  # (M, 3) of the antenna [m], e
    sat: IntArray  # (S,) number within its system
    system: IntArray  # (S,)
    channel: IntArray  # (S,)
    epoch: IntArray  # (K,) of each row
    which: IntArray  # (K,) index of the satellite, 0 to S - 1
    received: BoolArray  # (K,)
    sat_pos_e: FloatArray  # (K, 3) at transmission [m], e
    sat_vel_e: FloatArray  # (K, 3) [m/s]
    clock: FloatArray  # (K,) of the satellite [m]
    clock_rate: FloatArray  # (K,) [m/s]
    distance: FloatArray  # (K,) [m]
    rate: FloatArray  # (K,) of the distance [m/s]
    cn0: FloatArray  # (K,) on the first carrier [dB-Hz]
    sin_el: FloatArray  # (K,)
    azimuth: FloatArray  # (K,) [rad]

    def select_received(self) -> View:
        """Return the rows of received satellites."""
        return self._replace(**{name: getattr(self, name)[self.received] for name in self._fields[4:]})

    def replace_epochs(self, other: View, epochs: BoolArray) -> View:
        """Return this view with the epochs marked in ``epochs`` (M,) copied from another view."""
        own, others = ~epochs[self.epoch], epochs[other.epoch]
        order = np.argsort(np.concatenate([self.epoch[own], other.epoch[others]]), kind="stable")
        columns = {
            name: np.concatenate([getattr(self, name)[own], getattr(other, name)[others]])[order]
            for name in self._fields[4:]
        }
        return self._replace(pos_e=np.where(epochs[:, None], other.pos_e, self.pos_e), **columns)


@kernel
def geometry_kernel(
    t: FloatArray, pos_e: FloatArray, vel_e: FloatArray, C_en: FloatArray, down_n: FloatArray,
    t_0: float, step: float, coefficients: FloatArray, gps_t0: float,
    sin_mask: float, sin_antenna: float, zenith: float, horizon: float, threshold: float, wait: float,
    loss: FloatArray, begun: bool, since: FloatArray, asleep: FloatArray, travel: FloatArray,
    state: FloatArray, epoch: IntArray, sat: IntArray, received: BoolArray, out: FloatArray,
) -> int:  # fmt: skip
    """Fill a row for each satellite above the elevation mask, received or not; return the number of rows.

    Columns of out: satellite position (3), velocity (3), clock, clock rate, range, range rate, C/N0, sine of
    the elevation, direction north and east; only the last four if it is not received. ``loss`` (M, S) of C/N0
    may have no rows. ``since`` (S,) is the time at which a satellite came into view (NaN if it is not in
    view), ``asleep`` (S,) the time until which it cannot rise, ``travel`` (S,) the travel time of its last
    signal. Unless the receiver has ``begun``, it has had all satellites in view for long.
    """
    k = 0
    for m in range(t.shape[0]):
        now = t[m] + gps_t0
        rx, ry, rz = pos_e[m, 0], pos_e[m, 1], pos_e[m, 2]
        ux, uy, uz = -C_en[m, 0, 2], -C_en[m, 1, 2], -C_en[m, 2, 2]
        for s in range(coefficients.shape[0]):
            if t[m] < asleep[s]:
                continue
            distance, ex, ey, ez = C * travel[s], 0.0, 0.0, 0.0
            for _ in range(4):
                before = distance
                orbits.track_kernel(t_0, step, coefficients, s, now - distance / C, False, state)
                distance, ex, ey, ez = range_kernel(state[0], state[1], state[2], rx, ry, rz, GPS_EARTH_RATE)
                below = sin_mask - (ex * ux + ey * uy + ez * uz)
                if below > 1e-3:
                    asleep[s] = t[m] + below / _RISE
                    break
                if abs(distance - before) < _SETTLED:
                    break
            travel[s] = distance / C
            sin_el = ex * ux + ey * uy + ez * uz
            if sin_el < sin_mask:
                since[s] = np.nan
                continue
            n = C_en[m, 0, 0] * ex + C_en[m, 1, 0] * ey + C_en[m, 2, 0] * ez
            e = C_en[m, 0, 1] * ex + C_en[m, 1, 1] * ey  # east is level: it has no z
            sin_body = -(n * down_n[m, 0] + e * down_n[m, 1] - sin_el * down_n[m, 2])
            cn0 = horizon + (zenith - horizon) * sin_body
            if loss.shape[0] > 0:
                cn0 -= loss[m, s]
            if sin_body < sin_antenna or cn0 < threshold:
                since[s] = np.nan
            elif np.isnan(since[s]):
                since[s] = t[m] if m > 0 or begun else -1e300
            epoch[k], sat[k] = m, s
            out[k, 10], out[k, 11], out[k, 12], out[k, 13] = cn0, sin_el, n, e
            received[k] = t[m] - since[s] >= wait  # False for NaN
            if not received[k]:
                k += 1
                continue
            orbits.track_kernel(t_0, step, coefficients, s, now - distance / C, True, state)
            a, b = range_rate_kernel(
                state[0], state[1], state[2], state[4], state[5], state[6],
                rx, ry, rz, ex, ey, ez, distance, GPS_EARTH_RATE,
            )  # fmt: skip
            for i in range(3):
                out[k, i], out[k, 3 + i] = state[i], state[4 + i]
            out[k, 6], out[k, 7] = state[3], state[7]
            out[k, 8] = distance
            out[k, 9] = (a - ex * vel_e[m, 0] - ey * vel_e[m, 1] - ez * vel_e[m, 2]) / b
            k += 1
    return k


def compute_view(
    truth: Trajectory,
    rows: IntArray,
    sky: SkySpec,
    antenna_b: tuple[float, float, float],
    loss: ComputeLoss,
    draws: SensorDraws,
    offset: Offset | None = None,
) -> View:
    """Compute which satellites are above the mask and received at some epochs of the truth.

    Parameters
    ----------
    truth, rows, antenna_b
        Motion of the IMU; the epochs (M,), rows of it; antenna relative to the IMU (3,) [m], b. The axis of
        the antenna points up, along -z of the body.
    sky : SkySpec
        Satellites, masks and reception.
    loss : callable
        Returns the loss of C/N0 [dB], (M, S) or (0, S), of the satellites ``(system, sat)``.
    draws : SensorDraws
        Keeps what is known of the satellites for the next piece; its names are those of this view.
    offset : (M, 3) arrays or None
        Added to position [m] and velocity [m/s] of the antenna, n.
    """
    t = truth.t[rows]
    lla, vel_n = compute_antenna_motion(truth, rows, antenna_b, draws)
    if offset is not None:
        lla, vel_n = earth.displace(lla, offset[0]), vel_n + offset[1]
    pos_e = earth.to_ecef(lla)
    C_en = np.ascontiguousarray(earth.matrix_en(lla[:, 0], lla[:, 1]))
    vel_e = np.einsum("mij,mj->mi", C_en, vel_n)
    down_n = rotation.rotate(truth.q_nb[rows], np.array([0.0, 0.0, 1.0]))
    sat, system, channel, track = find_track(sky, truth.t, draws)
    S = len(sat)
    size = len(t) * S
    epoch, which, received = np.empty(size, np.int64), np.empty(size, np.int64), np.empty(size, np.bool_)
    columns = np.empty((size, _COLUMNS))
    sines = float(np.sin(sky.elevation_mask)), float(np.sin(sky.antenna_mask))
    states = draws.keep("satellites", lambda: (np.full(S, np.nan), np.full(S, -np.inf), np.full(S, 0.075)))
    begun = bool(draws.keep("begun", list[bool]))
    if len(t):
        draws.put("begun", [True])
    count = geometry_kernel(
        t, pos_e, vel_e, C_en, down_n, *track, sky.gps_t0, *sines, sky.cn0_zenith, sky.cn0_horizon,
        sky.cn0_threshold, sky.reacquisition, loss(system, sat), begun, *states, np.empty(8),
        epoch, which, received, columns,
    )  # fmt: skip
    names = ("clock", "clock_rate", "distance", "rate", "cn0", "sin_el")
    return View(
        pos_e=pos_e,
        sat=sat,
        system=system,
        channel=channel,
        epoch=epoch[:count],
        which=which[:count],
        received=received[:count],
        sat_pos_e=columns[:count, :3],
        sat_vel_e=columns[:count, 3:6],
        azimuth=np.arctan2(columns[:count, 13], columns[:count, 12]),
        **{name: columns[:count, 6 + k] for k, name in enumerate(names)},
    )


def find_track(
    sky: SkySpec, t: FloatArray, draws: SensorDraws
) -> tuple[IntArray, IntArray, IntArray, orbits.Track]:
    """Return :func:`track_constellation` over times t with a margin; computed only for the first piece."""
    kept = draws.keep("track", list[Any])
    if not kept or t[-1] > kept[1]:
        begin = kept[0] if kept else float(t[0])
        end = begin + AHEAD * (1 + int((t[-1] - begin) / AHEAD))
        kept[:] = [begin, end, track_constellation(sky, np.array([begin, end]))]
    found: tuple[IntArray, IntArray, IntArray, orbits.Track] = kept[2]
    return found


def track_constellation(sky: SkySpec, t: FloatArray) -> tuple[IntArray, IntArray, IntArray, orbits.Track]:
    """Return number, system and frequency channel (S,) of all satellites, and their track over times t."""
    first, last = t[0] + sky.gps_t0 - 1.0, t[-1] + sky.gps_t0
    numbers, systems, channels, coefficients = [], [], [], []
    for system in sky.constellations:
        sets = find_orbits(sky, system)
        sat, track = orbits.fit_track(sets, first, last)
        numbers.append(sat)
        systems.append(np.full(len(sat), system))
        channels.append(find_channels(sets, sat))
        coefficients.append(track.coefficients)
    sat, system_of, channel = (np.concatenate(column) for column in (numbers, systems, channels))
    return sat, system_of, channel, track._replace(coefficients=np.concatenate(coefficients))


def find_orbits(sky: SkySpec, system: int) -> KeplerSets | GlonassSets:
    """Return the true orbits of a constellation: from the datasheet, else nominal orbits."""
    return (sky.orbits or {}).get(system) or orbits.make_nominal(system)


def find_channels(sets: KeplerSets | GlonassSets, sat: IntArray) -> IntArray:
    """Return the frequency channels (S,) of satellites; 0 but for GLONASS."""
    if isinstance(sets, GlonassSets):
        return np.array([sets.channel[np.argmax(sets.sat == s)] for s in sat], np.int64)
    if sets.system == GLONASS:  # antipodal satellites share a channel; four pairs to a plane of eight
        return np.asarray((sat - 1) % 4 + 4 * ((sat - 1) // 8) - 7)
    return np.zeros(len(sat), np.int64)
