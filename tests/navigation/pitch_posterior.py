"""Posterior of the pitch in a straight stop-and-go, by Rao-Blackwellised importance sampling.

A vehicle drives north with its wings level: motion north and down and pitch are all there is. The constants
of the unit (turn-on biases, scale factors, nonlinearity, misalignments, g-sensitivity) are drawn from a
Student proposal, fitted to the posterior. Given these, a Kalman filter of 13 states about its own estimate
gives likelihood and pitch: what is left to it are noise, wandering biases, lasting errors of fixes and the
bias of z, which acts linearly. Nothing here is of the filters of bench: only datasheets, data and gravity.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.special import ndtr

from bench.core.compilation.compiled import kernel
from bench.core.mathematics import earth
from bench.core.mathematics.arrays import FloatArray, IntArray
from bench.core.records.data import InitialState, SensorData
from bench.core.records.sensor_specs import GnssSpec, ImuSpec, TriadSpec

STEP = 10
"""Samples of the IMU that make one step."""
STATES = (
    13  # x, its rate, z, its rate, pitch, biases that wander (3), lasting errors of fixes (2, 2), bias of z
)
CONSTANTS = 15
DEGREES = 20.0  # of freedom of the proposal
AIR_SD = 10.0  # of the air temperature about the standard atmosphere [K]
REST_VARIANCE = 0.01**2  # of a velocity at rest [m^2/s^2]
_SMALL = 0.02  # step of the derivatives [sd]


@dataclass(frozen=True)
class Record:
    """The data of a planar record, and what the datasheets state.

    Attributes
    ----------
    start : ndarray, (2,)
        Mean specific force at rest, forward and down [m/s^2], that levels the unit.
    motion : ndarray, (K, 3)
        Mean rate about y [rad/s], specific force along x and z [m/s^2] of each step of `dt` [s].
    fix_at : ndarray, (K + 1,)
        Row of the fix at the start and at the end of each step, or -1.
    fixes : ndarray, (M, 4)
        Position north [m] and its rate [m/s], position down and its rate, relative to the start.
    sd : ndarray, (15,)
        Of the constants; their order is that of :func:`correct_kernel`, the last is noise of the leveling.
    """

    t: FloatArray  # (K,) ends of the steps [s]
    dt: float
    start: FloatArray
    motion: FloatArray
    fix_at: IntArray
    fixes: FloatArray
    sd: FloatArray
    ranges: FloatArray  # (2,) of gyro [rad/s] and accelerometer [m/s^2]
    gravity: FloatArray  # (2,) north and down [m/s^2]
    radius: float  # of the meridian [m]
    P0: FloatArray  # (13,) variances of the states at the start
    walk: FloatArray  # (13,) variance that a step adds
    kept: FloatArray  # (13,) what a step leaves of a state
    R: FloatArray  # (4,) white variances of a fix

    def until(self, t: float) -> int:
        """Return the number of steps that end before a time [s]."""
        return int(np.searchsorted(self.t, t, "right"))


@dataclass(frozen=True)
class Posterior:
    """Pitch at one time, given the data until then."""

    mean: float  # [rad]
    sd: float  # [rad]
    effective: float  # effective sample size
    means: FloatArray  # (n,) of the samples
    variances: FloatArray  # (n,)
    weights: FloatArray  # (n,), sum 1

    def rank(self, pitch: float) -> float:
        """Return the probability below a pitch [rad]."""
        return float(self.weights @ ndtr((pitch - self.means) / np.sqrt(self.variances)))


@kernel
def correct_kernel(p: FloatArray, ranges: FloatArray, motion: FloatArray, out: FloatArray) -> None:
    """Fill out (3,) with the motion (3,) that a unit of constants p (15,) measures as ``motion``.

    Constants: of the gyro bias, scale factor, nonlinearity, sensitivity to force along x and z; of the
    accelerometers x and z each bias, scale factor, nonlinearity and cross-axis; rotation of their triad.
    """
    w, x, z = motion[0], motion[1], motion[2]
    for _ in range(4):
        u, v = x / ranges[1], z / ranges[1]
        ex = p[5] + p[6] * x + p[7] * x * (4.0 * u * u - 3.0) + (p[8] - p[13]) * z
        ez = p[9] + p[10] * z + p[11] * z * (4.0 * v * v - 3.0) + (p[12] + p[13]) * x
        x, z = motion[1] - ex, motion[2] - ez
    for _ in range(4):
        u = w / ranges[0]
        w = motion[0] - (p[0] + p[1] * w + p[2] * w * (4.0 * u * u - 3.0) + p[3] * x + p[4] * z)
    out[0], out[1], out[2] = w, x, z


@kernel
def likelihood_kernel(
    p: FloatArray, start: FloatArray, dt: float, motion: FloatArray, fix_at: IntArray, fixes: FloatArray,
    ranges: FloatArray, gravity: FloatArray, radius: float, P0: FloatArray, walk: FloatArray,
    kept: FloatArray, R: FloatArray, memory: FloatArray, innovations: FloatArray, out: FloatArray,
) -> None:  # fmt: skip
    """Fill out (3,) with pitch [rad], its variance and log-likelihood, less a constant, of constants p (15,).

    ``innovations`` (M, 4) become those of the fixes over their sd; ``memory`` (16, 13) is work memory.
    """
    n = P0.shape[0]
    x, P, true, vector = memory[0], memory[1 : n + 1], memory[n + 1], memory[n + 2]
    for i in range(n):
        x[i] = 0.0
        for j in range(n):
            P[i, j] = P0[i] if i == j else 0.0
    vector[0], vector[1], vector[2] = 0.0, start[0], start[1]
    correct_kernel(p, ranges, vector[:3], true)
    x[4] = np.arctan2(true[1], -true[2]) + p[14]
    by_bias = -true[1] / (true[1] * true[1] + true[2] * true[2])
    P[4, 4] += by_bias * by_bias * P[12, 12]
    P[4, 12] = P[12, 4] = by_bias * P[12, 12]
    out[2] = 0.0
    for k in range(fix_at.shape[0]):
        if k > 0:
            for i in range(3):
                vector[i] = motion[k - 1, i] - x[5 + i]
            vector[2] -= x[12]
            correct_kernel(p, ranges, vector[:3], true)
            turn = (true[0] + x[1] / radius) * dt
            s, c = np.sin(x[4] + 0.5 * turn), np.cos(x[4] + 0.5 * turn)
            ahead, down = c * true[1] + s * true[2], c * true[2] - s * true[1]
            x[0] += dt * (x[1] + 0.5 * dt * (ahead + gravity[0]))
            x[2] += dt * (x[3] + 0.5 * dt * (down + gravity[1]))
            x[1] += dt * (ahead + gravity[0])
            x[3] += dt * (down + gravity[1])
            x[4] += turn
            for _ in range(2):  # F P, then P F' by its transpose
                for j in range(n):
                    z = P[7, j] + P[12, j]
                    tilt = P[4, j] - 0.5 * dt * P[5, j]
                    more_x = dt * (down * tilt - c * P[6, j] - s * z)
                    more_z = dt * (s * P[6, j] - c * z - ahead * tilt)
                    P[0, j] += dt * (P[1, j] + 0.5 * more_x)
                    P[2, j] += dt * (P[3, j] + 0.5 * more_z)
                    P[1, j] += more_x
                    P[3, j] += more_z
                    P[4, j] -= dt * P[5, j]
                    for i in range(5, n):
                        P[i, j] *= kept[i]
                for i in range(n):
                    for j in range(i):
                        P[i, j], P[j, i] = P[j, i], P[i, j]
            for i in range(n):
                P[i, i] += walk[i]
                x[i] *= kept[i]
        row = fix_at[k]
        if row >= 0:
            for m in range(4):
                b = 8 + m
                S = P[m, m] + 2.0 * P[m, b] + P[b, b] + R[m]
                nu = fixes[row, m] - x[m] - x[b]
                innovations[row, m] = nu / np.sqrt(S)
                out[2] -= 0.5 * (nu * nu / S + np.log(S / R[m]))
                for i in range(n):
                    vector[i] = P[i, m] + P[i, b]
                for i in range(n):
                    x[i] += vector[i] * nu / S
                    for j in range(n):
                        P[i, j] -= vector[i] * vector[j] / S
    out[0], out[1] = x[4], P[4, 4]


def _sizes(imu: ImuSpec, warmth: float, start_sd: float) -> FloatArray:
    """Return the sd (15,) of the constants of a unit that is ``warmth`` above its reference [K]."""
    gyro, accel = imu.gyro, imu.accel
    heat = np.hypot(warmth, AIR_SD)

    def bias(triad: TriadSpec) -> float:
        return float(np.hypot(triad.turn_on_bias_sd, triad.temperature_sd * heat))

    along = [bias(accel), accel.scale_factor_sd, accel.nonlinearity_sd, accel.misalignment_sd]
    turn = [bias(gyro), gyro.scale_factor_sd, gyro.nonlinearity_sd, *[gyro.g_sensitivity_sd] * 2]
    return np.array([*turn, *along, *along, accel.alignment_sd, start_sd])


def make_record(data: SensorData, initial: InitialState, rest: float) -> Record:
    """Return the planar record of a unit that is at rest until ``rest`` [s], whole seconds, and then driven.

    The vehicle heads north with its wings level. The position at the start is that of ``initial``.
    """
    imu, spec, gnss = data.imu, data.specs.imu, data.specs.gnss
    assert gnss is not None
    assert data.fixes is not None
    assert spec.accel.nonorthogonality_sd == 0.0
    dt, before = STEP * float(imu.dt[0]), int(np.searchsorted(imu.t, rest - 1e-6)) + 1
    count = (len(imu.t) - before) // STEP
    columns = np.column_stack([imu.dtheta_b[:, 1], imu.dvel_b[:, 0], imu.dvel_b[:, 2]])
    motion = columns[before : before + STEP * count].reshape(count, STEP, 3).sum(axis=1) / dt
    t = rest + dt * np.arange(1, count + 1)
    used = data.fixes.t > rest - 1e-6
    at = np.rint((data.fixes.t[used] - rest) / dt).astype(int)
    fix_at = np.full(count + 1, -1)
    fix_at[at[at <= count]] = np.flatnonzero(at <= count)
    lla, vel_n = data.fixes.lla[used], data.fixes.vel_n[used]
    radius = float(earth.radii(initial.lla[0])[0]) + float(initial.lla[2])
    north, down = radius * (lla[:, 0] - initial.lla[0]), initial.lla[2] - lla[:, 2]
    g_n = earth.gravity_n(initial.lla[0], initial.lla[2])
    warmth = 288.15 - 0.0065 * float(initial.lla[2]) + spec.thermal.self_heating - spec.thermal.reference
    sizes = _sizes(spec, warmth, spec.accel.random_walk / np.sqrt(rest) / float(g_n[2]))
    bias_z, sizes[9] = float(sizes[9]), 0.0
    return Record(
        t, dt, columns[:before, 1:].sum(axis=0) / rest, motion, fix_at,
        np.column_stack([north, vel_n[:, 0], down, vel_n[:, 2]]), sizes,
        np.array([spec.gyro.range or 1e3, spec.accel.range or 1e6]), g_n[[0, 2]], radius,
        *_processes(spec, gnss, initial, dt, bias_z),
    )  # fmt: skip


def _processes(
    imu: ImuSpec, gnss: GnssSpec, initial: InitialState, dt: float, bias_z: float
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Return variances at the start (13,), added by a step (13,), the part kept (13,), and of a fix (4,)."""
    gyro, accel = imu.gyro, imu.accel
    wander = [gyro.instability_sd, accel.instability_sd, accel.instability_sd]
    times = [gyro.bias_correlation, accel.bias_correlation, accel.bias_correlation]
    wander += [gnss.pos_h_markov_sd, gnss.vel_markov_sd, gnss.pos_v_markov_sd, gnss.vel_markov_sd]
    times += [1.0 / x if x > 0.0 else 0.0 for x in (gnss.pos_decay_time, gnss.vel_decay_time) * 2]
    variance = np.square(wander)
    kept = np.exp(-dt / np.where(np.array(times) > 0.0, times, np.inf))
    P0 = np.concatenate([[initial.cov[0, 0], REST_VARIANCE, initial.cov[2, 2], REST_VARIANCE, 0.0], variance])
    walk = np.concatenate([np.zeros(5), variance * (1.0 - kept**2)])
    walk[[1, 3, 4]] = np.square([accel.random_walk, accel.random_walk, gyro.random_walk]) * dt
    white = np.square([gnss.pos_h_white_sd, gnss.vel_white_sd, gnss.pos_v_white_sd, gnss.vel_white_sd])
    return np.append(P0, bias_z**2), np.append(walk, 0.0), np.concatenate([np.ones(5), kept, [1.0]]), white


def evaluate(record: Record, u: FloatArray, steps: int) -> tuple[FloatArray, FloatArray]:
    """Return pitch, variance and log-likelihood (n, 3) of constants u (n, 15) over their sd, and innovations.

    Only the first steps of the record are used. The innovations (n, 4 M) are over their sd.
    """
    used = record.fix_at[: steps + 1].max() + 1
    out, innovations = np.empty((len(u), 3)), np.zeros((len(u), used, 4))
    memory = np.empty((STATES + 3, STATES))
    for one, series, row in zip(u * record.sd, innovations, out, strict=True):
        likelihood_kernel(
            one, record.start, record.dt, record.motion[:steps], record.fix_at[: steps + 1], record.fixes,
            record.ranges, record.gravity, record.radius, record.P0, record.walk, record.kept, record.R,
            memory, series, row,
        )  # fmt: skip
    return out, innovations.reshape(len(u), -1)


def differentiate(
    record: Record, u: FloatArray, steps: int
) -> tuple[FloatArray, FloatArray, FloatArray, float]:
    """Return at constants u (15,) the innovations, their and the pitch's derivatives, and its variance."""
    some = np.flatnonzero(record.sd > 0.0)
    each = np.zeros((2 * len(some), len(u)))
    each[np.arange(len(some)), some], each[len(some) + np.arange(len(some)), some] = _SMALL, -_SMALL
    out, series = evaluate(record, np.vstack([u, u + each]), steps)
    J, g = np.zeros((series.shape[1], len(u))), np.zeros(len(u))
    J[:, some] = ((series[1 : len(some) + 1] - series[len(some) + 1 :]) / (2.0 * _SMALL)).T
    g[some] = (out[1 : len(some) + 1, 0] - out[len(some) + 1 :, 0]) / (2.0 * _SMALL)
    return series[0], J, g, float(out[0, 1])


def find_posterior(record: Record, steps: int, count: int, r: np.random.Generator) -> Posterior:
    """Return the posterior of the pitch after so many steps, by ``count`` samples of the constants."""
    u, prior = np.zeros(CONSTANTS), np.eye(CONSTANTS)
    for _ in range(8):
        nu, J, _, _ = differentiate(record, u, steps)
        information = J.T @ J + prior
        change = np.linalg.solve(information, J.T @ nu + u)
        u = u - change
        if np.abs(change).max() < 1e-3:
            break
    cov = np.linalg.inv(information)
    for size in (
        count // 2,
        count // 2,
        count // 2,
        count,
    ):  # a proposal is fitted to the samples of the one before
        root = np.linalg.cholesky(cov)
        z = r.standard_normal((size, CONSTANTS)) / np.sqrt(r.chisquare(DEGREES, (size, 1)) / DEGREES)
        samples = u + z @ root.T
        out, _ = evaluate(record, samples, steps)
        log = out[:, 2] - 0.5 * np.square(samples).sum(axis=1)
        log += 0.5 * (DEGREES + CONSTANTS) * np.log1p(np.square(z).sum(axis=1) / DEGREES)
        weights = np.exp(log - log.max())
        weights /= weights.sum()
        u, cov = weights @ samples, np.cov(samples.T, aweights=np.minimum(weights, 20.0 / size))
    mean = float(weights @ out[:, 0])
    variance = float(weights @ (out[:, 1] + (out[:, 0] - mean) ** 2))
    return Posterior(mean, variance**0.5, 1.0 / float(weights @ weights), out[:, 0], out[:, 1], weights)
