"""Position-level GNSS: position and velocity of the antenna with white and Markov errors (A-5.2.1/2)."""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import cache

import numpy as np

from bench.core.compilation.compiled import kernel
from bench.core.files import disk_arrays
from bench.core.mathematics import earth, rotation
from bench.core.mathematics.arrays import BoolArray, FloatArray, IntArray
from bench.core.records.data import GnssFixes, Trajectory
from bench.core.records.orbit_sets import GPS
from bench.core.records.sensor_specs import Fault, GnssSpec
from bench.simulation.sensors import faults
from bench.simulation.sensors.draws import SensorDraws
from bench.simulation.sensors.timing import find_outage_rows

_MASK = float(np.deg2rad(5.0))  # elevation mask of the satellites in use [rad]

SATELLITES_UNKNOWN = -1
"""Value of ``GnssFixes.satellites``: a position-level receiver has no satellites to count."""


def measure(
    truth: Trajectory,
    spec: GnssSpec,
    antenna_b: tuple[float, float, float],
    outages: tuple[tuple[float, float], ...],
    draws: SensorDraws,
    scripted: Sequence[Fault] = (),
) -> GnssFixes:
    """Simulate the fixes of a receiver, without those inside an outage.

    Parameters
    ----------
    truth : Trajectory
        The motion of the IMU, or a piece of it.
    spec : GnssSpec
        The receiver. Its Markov errors are in meters, stationary from the first epoch, and continue through
        outages, so that an outage changes no fix outside of it.
    antenna_b : (3,) tuple
        Antenna relative to the IMU [m], b.
    outages : tuple of (start, end)
        No fixes in [start, end) [s].
    draws : SensorDraws
        The errors of the run.
    scripted : sequence of Fault
        Scripted faults.

    Returns
    -------
    fixes : GnssFixes
        At t = 1/rate, 2/rate, ... The reported covariance contains white, Markov and smoothed errors, with
        standard deviations divided by ``optimism``. It does not include the jumps, nor the lag of `find_lag`.

    Raises
    ------
    ValueError
        If the rate is above that of the truth.
    """
    root, draws = draws, draws.part("gnss")
    rows, steps = draws.epochs("gnss", truth.t, spec.rate)
    t = truth.t[rows]
    lla, vel_n = compute_antenna_motion(truth, rows, antenna_b, draws)
    if not (len(rows) or spec.tracking_bandwidth > 0):
        return _no_fixes()
    pos_white_sd = np.array(spec.pos_white_sd_n)
    pos_markov_sd = np.array([spec.pos_h_markov_sd, spec.pos_h_markov_sd, spec.pos_v_markov_sd])
    vel_white_sd = np.array(spec.vel_white_sd_n)
    vel_markov_sd = np.full(3, spec.vel_markov_sd)
    ground_speed = np.hypot(truth.vel_n[rows, 0], truth.vel_n[rows, 1])
    pos_decayed = (spec.pos_decay_distance * ground_speed + spec.pos_decay_time) * steps
    vel_decayed = spec.vel_decay_time * steps

    of_pos, of_vel = draws.part("position"), draws.part("velocity")
    pos_err_n = _draw_white("white", len(t), pos_white_sd, of_pos)
    pos_err_n += _draw_markov(pos_decayed, pos_markov_sd, of_pos)
    pos_smooth_sd = np.array([spec.pos_h_smooth_sd, spec.pos_h_smooth_sd, spec.pos_v_smooth_sd])
    if pos_smooth_sd.any():
        pos_err_n += _draw_markov(steps / spec.smooth_time, pos_smooth_sd, of_pos.part("smooth"))
    vel_err_n = _draw_white("white", len(t), vel_white_sd, of_vel)
    vel_err_n += _draw_markov(vel_decayed, vel_markov_sd, of_vel)
    if spec.jumps:
        changes = np.flatnonzero(find_constellation_changes(t, lla, draws.keep("above", list[BoolArray])))
        passing = [spec.pos_h_jump_sd, spec.pos_h_jump_sd, spec.pos_v_jump_sd]
        lasting = [spec.pos_h_jump_markov_sd, spec.pos_h_jump_markov_sd, spec.pos_v_jump_markov_sd]
        pos_err_n += _draw_jumps(np.array(passing), np.array(lasting), changes, pos_decayed, of_pos)
        vel_jumps = np.full(3, spec.vel_jump_sd), np.full(3, spec.vel_jump_markov_sd)
        vel_err_n += _draw_jumps(*vel_jumps, changes, vel_decayed, of_vel)
    if spec.tracking_bandwidth > 0:
        behind, falling = find_lag(truth, rows, spec.tracking_bandwidth, antenna_b, draws.part("lag"))
        pos_err_n, vel_err_n = pos_err_n - behind, vel_err_n - falling
    if scripted:
        pos_added, vel_added = faults.compute_fix_errors(t, spec, scripted, root)
        pos_err_n, vel_err_n = pos_err_n + pos_added, vel_err_n + vel_added

    count, pos_var = len(t), pos_white_sd**2 + pos_markov_sd**2 + pos_smooth_sd**2
    fixes = GnssFixes(
        t=t + spec.time_tag_error if spec.time_tag_error else t,
        t_arrival=_find_arrival(t, spec, draws),
        valid=np.ones(count, bool),
        lla=earth.displace(lla, pos_err_n),
        vel_n=vel_n + vel_err_n,
        cov_pos_n=np.tile(np.diag(pos_var) / spec.optimism**2, (count, 1, 1)),
        cov_vel_n=np.tile(np.diag(vel_white_sd**2 + vel_markov_sd**2) / spec.optimism**2, (count, 1, 1)),
        satellites=np.full(count, SATELLITES_UNKNOWN),
    )
    lost = find_outage_rows(truth.t, rows, outages)
    return faults.report(fixes, scripted, "gnss", root, ~lost)


@cache
def _no_fixes() -> GnssFixes:
    none, three, square = np.empty(0), np.empty((0, 3)), np.empty((0, 3, 3))
    return GnssFixes(none, none, np.empty(0, bool), three, three, square, square, np.empty(0, int))


def compute_antenna_motion(
    truth: Trajectory, rows: IntArray, antenna_b: tuple[float, float, float], draws: SensorDraws
) -> tuple[FloatArray, FloatArray]:
    """Return the true position (M, 3) [rad, rad, m] and velocity (M, 3) [m/s, n] of the antenna.

    ``draws`` keeps the last intervals for the next piece.

    Notes
    -----
    ``v + C_nb (w_eb_b x l)``. The rotation of n between IMU and antenna, l / R, is neglected.
    """
    w_ib_b = rate_at("turn", truth.t, truth.dtheta_b, rows, draws)
    if not len(rows):
        return w_ib_b, w_ib_b
    q_nb, lla = disk_arrays.take(truth.q_nb, rows), disk_arrays.take(truth.lla, rows)
    lever_n = rotation.rotate(q_nb, np.array(antenna_b))
    w_ib_n = rotation.rotate(q_nb, w_ib_b)
    lat = lla[:, 0]
    w_ie_n = earth.EARTH_RATE * np.column_stack([np.cos(lat), np.zeros_like(lat), -np.sin(lat)])
    vel_n = disk_arrays.take(truth.vel_n, rows) + rotation.cross(w_ib_n - w_ie_n, lever_n)
    return earth.displace(lla, lever_n), vel_n


def rate_at(
    name: str, t: FloatArray, increment: FloatArray, rows: IntArray, draws: SensorDraws
) -> FloatArray:
    """Return the rate (M, k) at some rows of t (N,), from earlier increments (N - 1, k) only.

    The straight line through the mean rates of the last two intervals, carried on to the time; its error
    is dt^2 / 3 times the second derivative. Where there is one interval only, its mean.

    ``draws`` keeps the last intervals under ``name`` for the next piece.
    """
    before = draws.keep(name, lambda: np.empty((0, increment.shape[1])))
    width = draws.keep(f"{name} step", lambda: np.empty(0))

    def mean(at: IntArray) -> tuple[FloatArray, FloatArray]:
        """Return mean rate and length of intervals; negative intervals are of the piece before."""
        own = np.maximum(at, 0)
        dt = t[own + 1] - t[own]
        found = disk_arrays.take(increment, own)
        if len(before) and (at < 0).any():
            dt, old = np.where(at < 0, width[np.minimum(at, -1)], dt), (at < 0)[:, None]
            found = np.where(old, before[np.minimum(at, -1)], found)
        return found / dt[:, None], dt

    newest = t[-3:]  # two, where the piece is one sample
    draws.put(name, np.concatenate([before, increment[-2:]])[-2:])
    draws.put(f"{name} step", np.concatenate([width, newest[1:] - newest[:-1]])[-2:])
    if not len(rows):
        return np.empty((0, increment.shape[1]))
    last, dt = mean(rows - 1)
    earlier, dt_earlier = mean(np.maximum(rows - 2, -len(before)))
    slope = dt / (dt + dt_earlier)
    rate: FloatArray = last + slope[:, None] * (last - earlier)
    return rate


def find_lag(
    truth: Trajectory,
    rows: IntArray,
    bandwidth: float,
    antenna_b: tuple[float, float, float],
    draws: SensorDraws,
) -> tuple[FloatArray, FloatArray]:
    """Return the lag of the tracked antenna position (M, 3) [m], and the rate of the lag [m/s], n.

    ``draws`` keeps the state of the loops for the next piece.

    Notes
    -----
    Second-order loops with damping 1 / sqrt(2) and noise bandwidth B [Hz], natural frequency w = B / 0.53
    [rad/s]: the lag d follows ``d'' + sqrt(2) w d' + w^2 d = a``, so that it is a / w^2 under a steady
    acceleration a (Kaplan and Hegarty, Understanding GPS, 2nd ed. (2006), section 5.6, table 5.6). The
    acceleration is constant over an interval of the truth. The rotation of n is neglected.
    """
    _, vel_n = compute_antenna_motion(truth, np.arange(len(truth.t)), antenna_b, draws)
    lag = np.zeros((len(truth.t), 2, 3))
    lag[0] = draws.keep("state", lambda: np.zeros((2, 3)))
    damped = bandwidth * 4.0 / 3.0  # w / sqrt(2), with B = w 3 sqrt(2) / 8
    _lag_kernel(np.diff(truth.t), np.diff(vel_n, axis=0), damped, lag)
    draws.put("state", lag[-1].copy())
    return lag[rows, 0], lag[rows, 1]


@kernel
def _lag_kernel(dt: FloatArray, dvel: FloatArray, damped: float, lag: FloatArray) -> None:
    """Carry lag and rate (N, 2, 3) from row to row by the closed form for a constant acceleration."""
    for k in range(len(dt)):
        decay = math.exp(-damped * dt[k])
        c, s = decay * math.cos(damped * dt[k]), decay * math.sin(damped * dt[k])
        for i in range(3):
            steady = dvel[k, i] / dt[k] / (2.0 * damped * damped)
            off, rate = lag[k, 0, i] - steady, lag[k, 1, i]
            lag[k + 1, 0, i] = steady + off * (c + s) + rate / damped * s
            lag[k + 1, 1, i] = rate * (c - s) - 2.0 * damped * off * s


def _find_arrival(t: FloatArray, spec: GnssSpec, draws: SensorDraws) -> FloatArray:
    """Return when the fixes at t (M,) arrive [s]: after the latency, in order, and not before their tags."""
    arrival = t + spec.latency
    if spec.latency_jitter > 0:
        newest = draws.keep("arrived", lambda: np.full(1, -np.inf))
        arrival = arrival + spec.latency_jitter * draws.stream("latency").random(len(t))
        arrival = np.maximum.accumulate(np.concatenate([newest, arrival]))[1:]
        newest[:] = arrival[-1:] if len(arrival) else newest
    return np.maximum(arrival, t + spec.time_tag_error) if spec.time_tag_error > 0 else arrival


def _draw_white(name: str, count: int, sd: FloatArray, draws: SensorDraws) -> FloatArray:
    if not sd.any():
        return np.zeros((count, 3))
    return sd * draws.stream(name).standard_normal((count, 3))


def _draw_markov(decayed: FloatArray, sd: FloatArray, draws: SensorDraws) -> FloatArray:
    """Draw a Markov error (M, 3) with decay exp(-decayed) (M,) in the interval before each epoch."""
    if not sd.any():
        return np.zeros((len(decayed), 3))
    return sd * draws.markov("markov", decayed, np.ones(1), np.ones(1))


def _draw_jumps(
    passing: FloatArray, lasting: FloatArray, at: IntArray, decayed: FloatArray, draws: SensorDraws
) -> FloatArray:
    """Draw the jumps (M, 3) of A-5.2.1 and A-5.2.2 (mu = 1), one part for a single epoch, one that decays."""
    error = np.zeros((len(decayed), 3))
    if not (passing.any() or lasting.any()):
        return error
    error[at] += _draw_white("jump", len(at), passing, draws)
    forgotten = draws.accumulate("forgotten", decayed)
    lasted = draws.keep("jumps", list[tuple[float, FloatArray]])
    for begun, jump in lasted:
        error += np.exp(begun - forgotten)[:, None] * jump
    for k, jump in zip(at, _draw_white("jump.markov", len(at), lasting, draws), strict=True):
        error[k:] += np.exp(forgotten[k] - forgotten[k:])[:, None] * jump
        lasted.append((float(forgotten[k]), jump))
    return error


def find_constellation_changes(
    t: FloatArray, lla: FloatArray, before: list[BoolArray] | None = None
) -> BoolArray:
    """Return a mask (M,) of the epochs t (M,) at which the satellites in use differ from the epoch before.

    The satellites in use are those of the nominal GPS constellation (A-2.1.2), with t = 0 at midnight GPS
    time, that are more than 5 deg above the horizon at ``lla`` (M, 3). They change a hundred times a day.
    ``before`` holds those at the epoch before the first, if there is one, and then those at the last.
    """
    from bench.simulation.signals import orbits

    if not len(t):
        return np.zeros(0, bool)
    sets = orbits.make_nominal(GPS)
    pos_e = earth.to_ecef(lla)
    up_e = -earth.matrix_en(lla[:, 0], lla[:, 1])[:, :, 2]
    above = np.zeros((len(t), len(sets)), bool)
    for satellite in range(len(sets)):
        away = orbits.compute_states(sets, np.full(len(t), satellite), t).pos_e - pos_e
        up = np.einsum("mi,mi->m", away, up_e)
        above[:, satellite] = up > np.sin(_MASK) * np.linalg.norm(away, axis=1)
    earlier = np.concatenate([before[0][None] if before else above[:1], above[:-1]])
    if before is not None:
        before[:] = [above[-1]]
    changed: BoolArray = (above != earlier).any(axis=1)
    return changed
