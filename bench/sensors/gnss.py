"""Position-level GNSS: position and velocity of the antenna with white and Markov errors (A-5.2.1/2)."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from bench import disk_arrays, earth, rotation
from bench.arrays import BoolArray, FloatArray, IntArray
from bench.data import GnssFixes, Trajectory
from bench.sensors import faults
from bench.sensors.processes import simulate_gauss_markov
from bench.sensors.timing import find_epoch_rows, find_outage_rows
from bench.specs import Fault, GnssSpec, stream

_MASK = float(np.deg2rad(5.0))  # elevation mask of the satellites in use [rad]

SATELLITES_UNKNOWN = -1
"""Value of ``GnssFixes.satellites``: a position-level receiver has no satellites to count."""


def measure(
    truth: Trajectory,
    spec: GnssSpec,
    antenna_b: tuple[float, float, float],
    outages: tuple[tuple[float, float], ...],
    seed: int,
    run: int,
    scripted: Sequence[Fault] = (),
) -> GnssFixes:
    """Simulate the fixes of a receiver, without those inside an outage.

    Parameters
    ----------
    truth : Trajectory
        The motion of the IMU.
    spec : GnssSpec
        The receiver. Its Markov errors are in metres, stationary from the first epoch, and continue through
        outages, so that an outage changes no fix outside of it.
    antenna_b : (3,) tuple
        Antenna relative to the IMU [m], b.
    outages : tuple of (start, end)
        No fixes in [start, end) [s].
    seed, run : int
        Select the draw of the errors.
    scripted : sequence of Fault
        Scripted faults.

    Returns
    -------
    fixes : GnssFixes
        At t = 1/rate, 2/rate, ... The reported covariance is that of white and Markov errors, with standard
        deviations divided by ``optimism``. It does not include the jumps.

    Raises
    ------
    ValueError
        If the rate is above that of the truth.
    """
    rows = find_epoch_rows("gnss", truth.t, spec.rate)
    t = truth.t[rows]
    lla, vel_n = compute_antenna_motion(truth, rows, antenna_b)
    pos_white_sd = np.array(spec.pos_white_sd_n)
    pos_markov_sd = np.array([spec.pos_h_markov_sd, spec.pos_h_markov_sd, spec.pos_v_markov_sd])
    vel_white_sd = np.array(spec.vel_white_sd_n)
    vel_markov_sd = np.full(3, spec.vel_markov_sd)
    ground_speed = np.hypot(truth.vel_n[rows, 0], truth.vel_n[rows, 1])
    pos_decay = spec.pos_decay_distance * ground_speed + spec.pos_decay_time
    vel_decay = np.full(len(t), spec.vel_decay_time)

    pos_err_n = _draw_white("gnss.position.white", len(t), pos_white_sd, seed, run)
    pos_err_n += _draw_markov("gnss.position.markov", t, pos_decay, pos_markov_sd, seed, run)
    vel_err_n = _draw_white("gnss.velocity.white", len(t), vel_white_sd, seed, run)
    vel_err_n += _draw_markov("gnss.velocity.markov", t, vel_decay, vel_markov_sd, seed, run)
    pos_err_n += _draw_jumps("gnss.position", spec, t, lla, pos_decay, seed, run)
    vel_err_n += _draw_jumps("gnss.velocity", spec, t, lla, vel_decay, seed, run)
    if scripted:
        pos_added, vel_added = faults.compute_fix_errors(t, spec, scripted, seed, run)
        pos_err_n, vel_err_n = pos_err_n + pos_added, vel_err_n + vel_added

    count = len(t)
    fixes = GnssFixes(
        t=t,
        t_arrival=t + spec.latency,
        valid=np.ones(count, bool),
        lla=earth.displace(lla, pos_err_n),
        vel_n=vel_n + vel_err_n,
        cov_pos_n=np.tile(np.diag(pos_white_sd**2 + pos_markov_sd**2) / spec.optimism**2, (count, 1, 1)),
        cov_vel_n=np.tile(np.diag(vel_white_sd**2 + vel_markov_sd**2) / spec.optimism**2, (count, 1, 1)),
        satellites=np.full(count, SATELLITES_UNKNOWN),
    )
    out = faults.find_reported_rows(t, scripted, "gnss", seed, run)
    return faults.select_output(fixes, out.keep(~find_outage_rows(truth.t, rows, outages)[out.tag]))


def compute_antenna_motion(
    truth: Trajectory, rows: IntArray, antenna_b: tuple[float, float, float]
) -> tuple[FloatArray, FloatArray]:
    """Return the true position (M, 3) [rad, rad, m] and velocity (M, 3) [m/s, n] of the antenna.

    Notes
    -----
    ``v + C_nb (w_eb_b x l)``. The rate at an instant is the mean of the rates in the intervals before and
    after it; its error is dt^2 / 6 times the second derivative. At the last instant it is the rate in the
    interval before, with an error of dt / 2 times the first derivative. The rotation of n between IMU and
    antenna, l / R, is neglected.
    """
    q_nb, lla = disk_arrays.take(truth.q_nb, rows), disk_arrays.take(truth.lla, rows)
    lever_n = rotation.rotate(q_nb, np.array(antenna_b))
    before, after = np.maximum(rows - 1, 0), np.minimum(rows, len(truth.dtheta_b) - 1)
    rate_before, rate_after = (
        disk_arrays.take(truth.dtheta_b, at) / (truth.t[at + 1] - truth.t[at])[:, None]
        for at in (before, after)
    )
    w_ib_n = rotation.rotate(q_nb, 0.5 * (rate_before + rate_after))
    lat = lla[:, 0]
    w_ie_n = earth.EARTH_RATE * np.column_stack([np.cos(lat), np.zeros_like(lat), -np.sin(lat)])
    vel_n = disk_arrays.take(truth.vel_n, rows) + np.cross(w_ib_n - w_ie_n, lever_n)
    return earth.displace(lla, lever_n), vel_n


def _draw_white(name: str, count: int, sd: FloatArray, seed: int, run: int) -> FloatArray:
    if not sd.any():
        return np.zeros((count, 3))
    return sd * stream(seed, run, name).standard_normal((count, 3))


def _draw_markov(
    name: str, t: FloatArray, rate: FloatArray, sd: FloatArray, seed: int, run: int
) -> FloatArray:
    """Draw a Gauss-Markov error (M, 3) with decay ``rate`` (M,) [1/s] in the interval before each epoch."""
    if not sd.any():
        return np.zeros((len(t), 3))
    one = np.ones(1)
    return sd * simulate_gauss_markov(rate[1:] * np.diff(t), one, one, stream(seed, run, name))


def _draw_jumps(
    name: str, spec: GnssSpec, t: FloatArray, lla: FloatArray, rate: FloatArray, seed: int, run: int
) -> FloatArray:
    """Draw the jumps (M, 3) of A-5.2.1 and A-5.2.2, mu = 1: a part for one epoch, a part that decays."""
    if name == "gnss.position":
        passing = np.array([spec.pos_h_jump_sd, spec.pos_h_jump_sd, spec.pos_v_jump_sd])
        lasting = np.array([spec.pos_h_jump_markov_sd, spec.pos_h_jump_markov_sd, spec.pos_v_jump_markov_sd])
    else:
        passing, lasting = np.full(3, spec.vel_jump_sd), np.full(3, spec.vel_jump_markov_sd)
    error = np.zeros((len(t), 3))
    if not (passing.any() or lasting.any()):
        return error
    at = np.flatnonzero(find_constellation_changes(t, lla))
    error[at] += _draw_white(f"{name}.jump", len(at), passing, seed, run)
    forgotten = np.concatenate([[0.0], np.cumsum(rate[1:] * np.diff(t))])
    for k, jump in zip(at, _draw_white(f"{name}.jump.markov", len(at), lasting, seed, run), strict=True):
        error[k:] += np.exp(forgotten[k] - forgotten[k:])[:, None] * jump
    return error


def find_constellation_changes(t: FloatArray, lla: FloatArray) -> BoolArray:
    """Return a mask (M,) of the epochs t (M,) at which the satellites in use differ from the epoch before.

    The satellites in use are those of the nominal GPS constellation (A-2.1.2), with t = 0 at midnight GPS
    time, that are more than 5 deg above the horizon at ``lla`` (M, 3). They change a hundred times a day.
    """
    from bench.signals import orbits

    sets = orbits.make_nominal_gps()
    pos_e = earth.to_ecef(lla)
    up_e = -earth.matrix_en(lla[:, 0], lla[:, 1])[:, :, 2]
    changed = np.zeros(len(t), bool)
    for satellite in range(len(sets)):
        away = orbits.compute_states(sets, np.full(len(t), satellite), t).pos_e - pos_e
        up = np.einsum("mi,mi->m", away, up_e) > np.sin(_MASK) * np.linalg.norm(away, axis=1)
        changed[1:] |= up[1:] != up[:-1]
    return changed
