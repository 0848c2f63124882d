"""Fit of what an IMU measured to the velocities of a receiver, with no assumption on how the vehicle moves.

Over a segment of some seconds the gyros give the attitude C_sb relative to that at its start, s; with it the
accelerometers give the velocity gained, u. In an inertial frame i, Earth-fixed at the start of the segment,
the receiver gives the same velocity, Y, from its own velocities and gravity:

    Y(t) = v_0 + C_is (u(t - shift) + C_sb(t) (w x arm))

v_0 and C_is are free in every segment: C_is by Wahba's problem (Markley and Crassidis, Fundamentals of
Spacecraft Attitude Determination and Control, 2014, section 5.4). Biases and gains of both triads, a rotation
between them, the shift of the clocks and the arm are common to all segments: Gauss-Newton, with the
derivatives of u integrated along with it.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.special import ndtri, stdtrit

from bench.core.compilation.compiled import kernel
from bench.core.mathematics.arrays import FloatArray, IntArray
from bench.core.mathematics.earth import EARTH_RATE, gravity_n, matrix_en
from bench.core.mathematics.rotation import fit_vectors, from_rotvec, matrix, skew
from bench.core.mathematics.units import STANDARD_GRAVITY

NAMES = (
    *("gyro_bias_x", "gyro_bias_y", "gyro_bias_z"),  # [rad/s]
    "gyro_gain",  # logarithm of measured by true
    *("accel_bias_x", "accel_bias_y", "accel_bias_z"),  # [m/s^2]
    "accel_gain",
    *("turn_x", "turn_y", "turn_z"),  # of the accelerometers against the gyros [rad]
    "shift",  # to add to the times of the IMU [s]
    *("arm_x", "arm_y", "arm_z"),  # of the antenna, beyond the one given [m]
)
# what is known before: no more than that the units are about right and the arm was measured, not guessed
PRIOR_SD = np.array([0.1] * 3 + [1.0] + [1.0] * 3 + [1.0] + [1.0] * 3 + [1.0] + [0.5] * 3)
_LONGEST = 2.0  # step of an iteration, in these standard deviations: a wrong unit is far from linear
_KERNEL = 11  # parameters whose derivatives are integrated
GYRO_GAIN, _ACCEL_GAIN, TURN, SHIFT, _ARM = 3, 7, (8, 9, 10), 11, slice(12, 15)
LENGTH = 20.0  # of a segment [s]
_FEWEST = 8  # fixes in a segment
MOST_SEGMENTS = 150  # segments; those in which the velocity changes most are used
_GAP = 0.5  # of the IMU inside a segment [s]
_HALF = 0.05  # step of the derivative by time [s]
_MARGIN = 1.0  # to the ends of the IMU record [s]: clocks may differ
_FREE = 7  # steps that are taken even if the fit is worse after them
_SHORTER = 0.3  # factor of a later step after which it is worse
_ENOUGH = 0.01  # decrease of the cost after which an iteration is the last
MOTION_NOISE = 0.05  # of the velocities of a receiver [m/s]: segments that fit better than this count alike


@kernel
def _integrate_kernel(
    t: FloatArray,
    gyro: FloatArray,
    accel: FloatArray,
    first: IntArray,
    begin: IntArray,
    cuts: FloatArray,
    u: FloatArray,
    U: FloatArray,
    C_sb: FloatArray,
    rate: FloatArray,
    square: FloatArray,
    psi: FloatArray,
    f: FloatArray,
) -> None:
    """Fill u (K, 3), its derivatives U (K, 3, 11), C_sb (K, 3, 3) and the rate (K, 3) at the cuts (K,).

    Stretch w has the cuts begin[w] to begin[w + 1]; its first cut lies in the interval first[w]. The rates
    (N, 3) hold over the intervals that end at t (N,). ``square`` (3, 3, 3), ``psi`` (3, 4) and ``f`` (3,) are
    work memory.
    """
    C, M, E = square[0], square[1], square[2]
    for w in range(len(begin) - 1):
        row, time = first[w], cuts[begin[w]]
        for a in range(3):
            for b in range(3):
                C[a, b] = 1.0 if a == b else 0.0
                psi[a, b] = 0.0
            psi[a, 3] = 0.0
        for k in range(begin[w], begin[w + 1]):
            before = max(k - 1, begin[w])
            for a in range(3):
                u[k, a] = u[before, a] if k > before else 0.0
                for p in range(11):
                    U[k, a, p] = U[before, a, p] if k > before else 0.0
            while time < cuts[k]:
                end = min(t[row], cuts[k])
                h = 0.5 * (end - time)
                x, y, z = gyro[row, 0], gyro[row, 1], gyro[row, 2]
                size = np.sqrt(x * x + y * y + z * z)
                s, c = h, 0.5 * h * h
                if size * h > 1e-4:
                    s, c = np.sin(size * h) / size, (1.0 - np.cos(size * h)) / (size * size)
                E[0, 0], E[0, 1], E[0, 2] = 1.0 - c * (y * y + z * z), c * x * y - s * z, c * x * z + s * y
                E[1, 0], E[1, 1], E[1, 2] = c * x * y + s * z, 1.0 - c * (x * x + z * z), c * y * z - s * x
                E[2, 0], E[2, 1], E[2, 2] = c * x * z - s * y, c * y * z + s * x, 1.0 - c * (x * x + y * y)
                for half in range(2):  # the force turns with the attitude in the middle
                    for a in range(3):
                        for b in range(3):
                            M[a, b] = C[a, 0] * E[0, b] + C[a, 1] * E[1, b] + C[a, 2] * E[2, b]
                    for a in range(3):
                        for b in range(3):
                            C[a, b] = M[a, b]
                            psi[a, b] += h * M[a, b]
                        psi[a, 3] += h * (M[a, 0] * x + M[a, 1] * y + M[a, 2] * z)
                    if half == 1:
                        continue
                    for a in range(3):
                        f[a] = C[a, 0] * accel[row, 0] + C[a, 1] * accel[row, 1] + C[a, 2] * accel[row, 2]
                    for a in range(3):
                        i, j = (a + 1) % 3, (a + 2) % 3
                        u[k, a] += 2.0 * h * f[a]
                        U[k, a, 7] += 2.0 * h * f[a]
                        for p in range(4):
                            U[k, a, p] += 2.0 * h * (psi[i, p] * f[j] - psi[j, p] * f[i])
                        for p in range(3):
                            q, r = (p + 1) % 3, (p + 2) % 3
                            U[k, a, 4 + p] += 2.0 * h * C[a, p]
                            U[k, a, 8 + p] += 2.0 * h * (C[a, r] * accel[row, q] - C[a, q] * accel[row, r])
                time = end
                if time >= t[row]:
                    row += 1
            for a in range(3):
                for b in range(3):
                    C_sb[k, a, b] = C[a, b]
                rate[k, a] = gyro[row, a]


@dataclass(frozen=True, slots=True)
class Stretches:
    """Stretches of a recording in which IMU and receiver can be compared."""

    begin: IntArray  # (W + 1,) first fix of each among those below
    fix_t: FloatArray  # (K,) [s]
    gained: FloatArray  # (K, 3) velocity of the receiver without gravity, in i of each segment [m/s]
    vel_n: FloatArray  # (K, 3)
    C_in: FloatArray  # (K, 3, 3)
    change: FloatArray  # (W,) of the velocity between fixes [m/s]

    def __len__(self) -> int:
        return len(self.begin) - 1

    @property
    def slices(self) -> list[slice]:
        """The rows of each segment."""
        return [slice(a, b) for a, b in zip(self.begin[:-1], self.begin[1:], strict=True)]

    def find_near(self, t: FloatArray) -> IntArray:
        """Return the rows of an IMU with times (N,) in these segments, and a margin to either side.

        Where the IMU is silent at the end of a segment, the last interval ends with the row after it.
        """
        first = np.searchsorted(t, self.fix_t[self.begin[:-1]] - 2.0 * _MARGIN)
        last = np.searchsorted(t, self.fix_t[self.begin[1:] - 1] + 2.0 * _MARGIN)
        inside = np.zeros(len(t) + 1, np.int64)
        np.add.at(inside, first, 1)
        np.add.at(inside, np.minimum(last + 1, len(t)), -1)
        return np.flatnonzero(np.cumsum(inside)[:-1])

    def take_liveliest(self, count: int) -> Stretches:
        """Return the segments in which the velocity changes most, in order of time."""
        return self.take(np.sort(np.argsort(-self.change, kind="stable")[:count]))

    def take(self, kept: IntArray) -> Stretches:
        """Return some of the segments, by their numbers in order of time."""
        rows = np.concatenate([np.empty(0, np.int64), *(np.arange(*self.begin[k : k + 2]) for k in kept)])
        begin = np.concatenate([[0], np.cumsum(np.diff(self.begin)[kept])])
        return Stretches(
            begin, self.fix_t[rows], self.gained[rows], self.vel_n[rows], self.C_in[rows], self.change[kept]
        )


def find_stretches(
    imu_t: FloatArray, t: FloatArray, lla: FloatArray, vel_n: FloatArray, *, most: int | None = None
) -> Stretches:
    """Return the segments of an IMU with times (N,) and a receiver with times (M,) and velocities, n.

    ``most``: the number of segments, default `MOST_SEGMENTS`; those in which the velocity changes most.
    """
    if len(t) < _FEWEST or len(imu_t) < 2:
        return Stretches(
            np.zeros(1, np.int64), t[:0], np.empty((0, 3)), vel_n[:0], np.empty((0, 3, 3)), t[:0]
        )
    gaps = imu_t[1:][np.diff(imu_t) > _GAP]
    blocks = np.floor((t - t[0]) / max(LENGTH, 1.5 * _FEWEST * float(np.median(np.diff(t))))).astype(int)
    blocks = blocks * (len(gaps) + 1) + np.searchsorted(gaps, t)
    blocks[(t < imu_t[0] + _MARGIN) | (t > imu_t[-1] - _MARGIN)] = -1
    C_en = matrix_en(lla[:, 0], lla[:, 1])
    vel_e = np.einsum("kij,kj->ki", C_en, vel_n)
    spin = np.array([0.0, 0.0, EARTH_RATE])
    gravity = np.einsum("kij,kj->ki", C_en, gravity_n(lla[:, 0], lla[:, 2]))
    found = []
    for rows in np.split(np.arange(len(t)), np.flatnonzero(np.diff(blocks)) + 1):
        if len(rows) < _FEWEST or blocks[rows[0]] < 0:
            continue
        since = t[rows] - t[rows[0]]
        C_ie = matrix(from_rotvec(since[:, None] * spin))
        extra = gravity[rows] - 2.0 * np.cross(spin, vel_e[rows])
        middle = 0.5 * (extra[1:] + extra[:-1]) * np.diff(since)[:, None]
        steps = np.diff(vel_e[rows], axis=0) - middle
        halfway = matrix(from_rotvec(0.5 * (since[1:] + since[:-1])[:, None] * spin))
        gained = np.vstack([np.zeros(3), np.cumsum(np.einsum("kij,kj->ki", halfway, steps), axis=0)])
        change = float(np.std(np.diff(vel_n[rows], axis=0)))
        found.append((change, rows, gained, C_ie @ C_en[rows]))
    rows = np.concatenate([np.empty(0, np.int64), *(one[1] for one in found)])
    return Stretches(
        np.concatenate([[0], np.cumsum([len(one[1]) for one in found])]).astype(np.int64),
        t[rows],
        np.vstack([np.empty((0, 3)), *(one[2] for one in found)]),
        vel_n[rows],
        np.vstack([np.empty((0, 3, 3)), *(one[3] for one in found)]),
        np.array([one[0] for one in found]),
    ).take_liveliest(MOST_SEGMENTS if most is None else most)


@dataclass(frozen=True, slots=True)
class MotionFit:
    """The fitted parameters, in the order of `NAMES`, and how well each segment fits."""

    values: FloatArray  # (15,)
    cov: FloatArray  # (15, 15)
    rms: FloatArray  # (W,) residuals of each segment [m/s]
    C_nb: FloatArray  # (K, 3, 3) at the fixes
    heading_sd: FloatArray  # (W,) of C_nb [rad]


def fit_motion(
    stretches: Stretches,
    t: FloatArray,
    gyro: FloatArray,
    accel: FloatArray,
    arm_b: FloatArray,
    iterations: int = 20,
    prior_sd: FloatArray = PRIOR_SD,
    start: FloatArray | None = None,
) -> MotionFit:
    """Fit all parameters.

    Parameters
    ----------
    stretches : Stretches
        What the receiver says.
    t, gyro, accel : (N,), (N, 3), (N, 3) arrays
        Ends of the intervals [s], mean rates [rad/s] and specific forces [m/s^2], b.
    arm_b : (3,) array
        Antenna relative to the IMU as assumed [m], b.
    iterations : int
        Most Gauss-Newton steps; late ones after which the fit is worse are shortened.
    prior_sd : (15,) array
        Standard deviations of the parameters before, around 0.
    start : (15,) array, optional
        Values of the parameters to start with.
    """
    if start is None:
        start = np.zeros(len(NAMES))
        start[_ACCEL_GAIN] = guess_gain(accel)
    prior = np.diag(prior_sd**-2)

    def try_values(values: FloatArray) -> _FitAt:
        return _compare(stretches, integrate(stretches, t, gyro, accel, values), arm_b, prior_sd, values)

    best = here = try_values(start)
    factor = 1.0
    for k in range(iterations):
        weights = 1.0 / (np.square(here.rms) + MOTION_NOISE**2)
        pull = np.einsum("w,wi->i", weights, here.scores) - here.values / prior_sd**2
        normal = prior + np.einsum("w,wij->ij", weights, here.normals)
        step = np.clip(np.linalg.inv(normal) @ pull, -_LONGEST * prior_sd, _LONGEST * prior_sd)
        values = here.values + factor * step
        values[SHIFT] = np.clip(values[SHIFT], _HALF - _MARGIN, _MARGIN - _HALF)  # within the record
        trial = try_values(values)
        gained, best = best.cost - trial.cost, min(best, trial, key=lambda one: one.cost)
        if factor == 1.0 and 0.0 <= gained < _ENOUGH:
            break
        here = (
            trial if k < _FREE else best
        )  # the heading of the start may be that of noise: steps go on first
        factor = 1.0 if k < _FREE or gained > 0.0 else _SHORTER * factor
    weights = 1.0 / (np.square(best.rms) + MOTION_NOISE**2)
    inverse = np.linalg.inv(prior + np.einsum("w,wij->ij", weights, best.normals))
    spread = weights[:, None] * best.scores
    cov = inverse @ (_spread_factor(len(spread)) * spread.T @ spread + prior) @ inverse
    cov[np.diag_indices(len(cov))] = np.maximum(np.diag(cov), np.diag(inverse))
    return MotionFit(best.values, cov, best.rms, best.C_nb, best.heading_sd)


def _spread_factor(count: int) -> float:
    """Return the factor on the scatter of segments that allows for a small number of them.

    The squared ratio of the 99 % quantiles of Student's and the normal distribution.
    """
    free = max(count - 1, 1)
    return float(count / free * (stdtrit(free, 0.995) / ndtri(0.995)) ** 2)


class _FitAt(NamedTuple):
    """Values, and how well each segment fits with them."""

    values: FloatArray  # (15,)
    normals: FloatArray  # (W, 15, 15)
    scores: FloatArray  # (W, 15)
    rms: FloatArray  # (W,) [m/s]
    C_nb: FloatArray  # (K, 3, 3)
    heading_sd: FloatArray  # (W,) [rad]
    cost: float  # negative logarithm of the likelihood


def _compare(
    stretches: Stretches,
    motion: tuple[FloatArray, ...],
    arm_b: FloatArray,
    prior_sd: FloatArray,
    values: FloatArray,
) -> _FitAt:
    """Return the residuals of all segments with the motion that `integrate` makes, and their derivatives."""
    u, U, C_sb, rate, u_dot = motion
    swing = np.einsum("kij,kj->ki", C_sb, np.cross(rate, arm_b + values[_ARM]))
    normals, scores, rms, C_nb, heading_sd = [], [], [], np.empty((len(u), 3, 3)), []
    for rows in stretches.slices:
        x, y = u[rows] + swing[rows], stretches.gained[rows]
        a, b = x - x.mean(axis=0), y - y.mean(axis=0)
        C_is = fit_vectors(a, b)[0]
        turned = a @ C_is.T
        residual = (b - turned).ravel()
        J = np.empty((len(x), 3, len(NAMES)))
        J[..., :_KERNEL] = C_is @ U[rows]
        J[..., :8] *= -1.0
        J[..., SHIFT] = -u_dot[rows] @ C_is.T
        J[..., _ARM] = C_is @ C_sb[rows] @ _cross_matrices(rate[rows])
        J = (J - J.mean(axis=0)).reshape(-1, len(NAMES))
        Q = np.linalg.qr(_cross_matrices(-turned).reshape(-1, 3))[0]  # what another C_is would change
        J, residual = J - Q @ (Q.T @ J), residual - Q @ (Q.T @ residual)
        rms.append(np.sqrt(residual @ residual / (len(residual) - 6)))
        normals.append(J.T @ J)
        scores.append(J.T @ residual)
        C_nb[rows] = np.swapaxes(stretches.C_in[rows], 1, 2) @ C_is @ C_sb[rows]
        level = stretches.C_in[rows][0][:, 2]
        heading_sd.append(
            np.hypot(rms[-1], MOTION_NOISE) / max(np.linalg.norm(np.cross(level, turned)), 1e-9)
        )
    free = 3 * np.diff(stretches.begin) - 6
    cost = 0.5 * float(free @ np.log(np.square(rms) + MOTION_NOISE**2)) + 0.5 * float(
        np.sum((values / prior_sd) ** 2)
    )
    return _FitAt(
        values,
        np.reshape(normals, (-1, len(NAMES), len(NAMES))),
        np.reshape(scores, (-1, len(NAMES))),
        np.array(rms),
        C_nb,
        np.array(heading_sd),
        cost,
    )


_CROSS = np.stack([skew(axis) for axis in np.eye(3)]).reshape(3, 9)


def _cross_matrices(v: FloatArray) -> FloatArray:
    """Return the matrices (K, 3, 3) of the cross products with vectors (K, 3)."""
    return np.asarray((v @ _CROSS).reshape(-1, 3, 3))


def guess_gain(accel: FloatArray) -> float:
    """Return where to start with the gain of the accelerometers: far from 0 only if a unit is wrong."""
    ratio = float(np.median(np.linalg.norm(accel, axis=1))) / STANDARD_GRAVITY
    return 0.0 if 0.5 < ratio < 2.0 or ratio == 0.0 else float(np.log(ratio))


def integrate(
    stretches: Stretches, t: FloatArray, gyro: FloatArray, accel: FloatArray, values: FloatArray
) -> tuple[FloatArray, ...]:
    """Return u, U, C_sb, the rate at the fixes and the derivative of u by time, for some parameters."""
    w = gyro * np.exp(-values[GYRO_GAIN]) - values[:3]
    f = (accel * np.exp(-values[_ACCEL_GAIN]) - values[4:7]) @ matrix(from_rotvec(values[8:11])).T
    at = stretches.fix_t - values[SHIFT]
    half = min(_HALF, 0.5 * float(np.diff(at).min(initial=np.inf)))
    cuts = (at[:, None] + [-half, 0.0, half]).ravel()
    begin = 3 * stretches.begin
    u, U = np.empty((len(cuts), 3)), np.empty((len(cuts), 3, _KERNEL))
    C_sb, rate = np.empty((len(cuts), 3, 3)), np.empty((len(cuts), 3))
    first = np.searchsorted(t, cuts[begin[:-1]], "right")
    work = np.empty((3, 3, 3)), np.empty((3, 4)), np.empty(3)
    _integrate_kernel(t, w, f, first, begin, cuts, u, U, C_sb, rate, *work)
    return u[1::3], U[1::3], C_sb[1::3], rate[1::3], (u[2::3] - u[::3]) / (2.0 * half)
