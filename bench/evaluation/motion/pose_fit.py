"""Scale factor, misalignment and bias of an IMU from a record that rests in six poses or more.

The specific force at rest is as large as gravity in every pose, and a turn between two poses, as the gyros
measure it, rotates one direction of gravity into the other (Tedaldi, Pretto and Menegatti, ICRA 2014,
calibrate by the same two facts). The result is relative to the axes of the accelerometers, made orthogonal.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import least_squares
from scipy.stats import norm, t

from bench.core.mathematics import rotation
from bench.core.mathematics.arrays import BoolArray, FloatArray, IntArray
from bench.core.mathematics.earth import EARTH_RATE
from bench.core.mathematics.units import STANDARD_GRAVITY

FEWEST_POSES = 6
_USUAL_ANGLE = np.deg2rad(1.0)  # sigma of the angles between accelerometers before the fit
_FEWEST_TURNS = 6
_LONGEST_TURN = 30.0  # [s]
_APART = np.deg2rad(20.0)  # between two poses that count as two
_BLOCK, _SHORTEST = 0.5, 2.0  # of the search for rests, and shortest rest [s]
_QUIET = 3.0  # times the scatter of a quiet block
_SURE = 6.0  # standard errors of a block within which it does not move
_DRIFTS = {"gyro": 1e-3, "accel": 2e-3}
"""What a bias may drift in a rest [rad/s; m/s^2]; more is motion."""
_NONE: IntArray = np.empty(0, np.int64)
_FEWEST_SPARE = 3  # equations more than unknowns from which their residuals give the interval
_USELESS = 0.1  # half interval of a scale factor of an accelerometer that poses do not determine
_ONE_AXIS = "scale factors and biases not determined: turn each axis up and down"
_VAGUE = 0.02  # half interval of a scale factor beyond which the turns do not fit
_NO_ANGLES = (
    "misalignments not determined, so gyros not fitted: record nine poses or more, some tilted by 45 deg"
)


@dataclass(frozen=True, slots=True)
class PoseFit:
    """Deterministic errors of a triad with half of their 95 % intervals; the reading is (I + M) x + bias."""

    triad: str
    scale: FloatArray  # (3,) diagonal of M [1]
    scale_half: FloatArray
    angles: (
        FloatArray  # (A,) [rad]; accel: yz, zx, xy between two axes; gyro: M_xy, xz, yx, yz, zx, zy; or none
    )
    angles_half: FloatArray
    bias: FloatArray  # (3,) [unit]
    bias_half: FloatArray
    count: int  # poses, or turns
    missing: str = ""  # what was not determined, and why

    @property
    def determined(self) -> bool:
        """Return whether the intervals of the scale factors are of use."""
        return bool(self.scale_half.max() < _USELESS)


def find_rests(triads: Mapping[str, FloatArray], step: float) -> list[slice]:
    """Return the rows of each rest, shortened by a block at both ends where the record goes on.

    Parameters
    ----------
    triads : mapping of str to array (N, 3)
        Readings of "gyro" [rad/s] and "accel" [m/s^2], or one of them.
    step : float
        Interval of the samples [s].
    """
    many = max(4, round(_BLOCK / step))
    count = len(next(iter(triads.values()))) // many
    quiet: BoolArray = np.ones(count, np.bool_)
    means, errors = dict[str, FloatArray](), dict[str, FloatArray]()
    for name, rates in triads.items():
        blocks = rates[: count * many].reshape(count, many, 3)
        scatter = np.sqrt(blocks.var(axis=1).sum(axis=1))
        quiet &= scatter <= _QUIET * np.quantile(scatter, 0.2)
        means[name], errors[name] = blocks.mean(axis=1), _SURE * scatter / np.sqrt(many)
    if "accel" in means:
        change = np.linalg.norm(np.diff(means["accel"], axis=0), axis=1)
        turned = change > _DRIFTS["accel"] + np.sqrt(2.0) * errors["accel"][1:]
        quiet[1:] &= ~turned
        quiet[:-1] &= ~turned
    for _ in range(3):  # what a slow turn adds up to shows beside the middle of its rest
        for first, last in _list_runs(quiet):
            rest = slice(first, last)
            for name, mean in means.items():
                away = np.linalg.norm(mean[rest] - np.median(mean[rest], axis=0), axis=1)
                quiet[rest] &= away < _DRIFTS[name] + errors[name][rest]
    found = []
    for first, last in _list_runs(quiet):
        start, stop = first + (first > 0), last - (last < count)
        if (stop - start) * many * step >= _SHORTEST:
            found.append(slice(int(start) * many, int(stop) * many))
    return found


def _list_runs(quiet: BoolArray) -> list[tuple[int, int]]:
    """Return the first block of each run of quiet blocks, and the block after it."""
    edges = np.diff(np.concatenate(([0], quiet.astype(np.int64), [0])))
    return list(zip(np.flatnonzero(edges > 0).tolist(), np.flatnonzero(edges < 0).tolist(), strict=True))


def count_poses(forces: Iterable[FloatArray]) -> int:
    """Return the number of poses: specific forces (3,) at least 20 deg apart."""
    kept: list[FloatArray] = []
    for one in (force / np.linalg.norm(force) for force in forces):
        if all(one @ other < np.cos(_APART) for other in kept):
            kept.append(one)
    return len(kept)


def fit_poses(
    triads: Mapping[str, FloatArray],
    rests: Sequence[slice],
    step: float,
    gravity: float | None = None,
    gaps: IntArray = _NONE,
) -> list[PoseFit]:
    """Return the errors of the accelerometers and, from the turns between the rests, of the gyros.

    Parameters
    ----------
    triads : mapping of str to array (N, 3)
        Readings of "accel" [m/s^2] and, if known, "gyro" [rad/s].
    rests : sequence of slice
        Rows of the rests (:func:`find_rests`), in at least `FEWEST_POSES` poses.
    step : float
        Interval of the samples [s].
    gravity : float or None
        Gravity at the place [m/s^2]; None takes the standard gravity.
    gaps : (K,) array
        Rows before which samples are missing; turns with a gap are not used.
    """
    accel = triads["accel"]
    means = np.array([accel[one].mean(axis=0) for one in rests])
    errors = np.array([_find_error(accel[one], mean, step) for one, mean in zip(rests, means, strict=True)])
    found, matrix = _fit_accel(means, errors, gravity or STANDARD_GRAVITY)
    if not found.determined:
        return [replace(found, missing=_ONE_AXIS)]
    force = np.asarray(np.linalg.solve(matrix, (means - found.bias).T).T)
    if not len(found.angles):
        return [replace(found, missing=_NO_ANGLES)]
    if "gyro" not in triads:
        return [found]
    gyro = _fit_gyro(triads["gyro"], rests, force, step, gaps)
    return [replace(found, missing=gyro)] if isinstance(gyro, str) else [gyro, found]


def _find_error(rates: FloatArray, mean: FloatArray, step: float) -> float:
    """Return the standard error of the magnitude of the mean (3,) of a rest."""
    many = max(1, min(round(_BLOCK / step), len(rates) // 4))
    sizes = (
        (rates[: len(rates) // many * many] @ (mean / np.linalg.norm(mean))).reshape(-1, many).mean(axis=1)
    )
    return max(float(sizes.std(ddof=1) / np.sqrt(len(sizes))), 1e-9)


def _fit_accel(means: FloatArray, errors: FloatArray, gravity: float) -> tuple[PoseFit, FloatArray]:
    def make_matrix(x: FloatArray) -> FloatArray:
        yz, zx, xy = 0.5 * x[6:]
        matrix: FloatArray = np.diag(1.0 + x[3:6])
        matrix += [[0, xy, zx], [xy, 0, yz], [zx, yz, 0]]
        return matrix

    def miss(x: FloatArray) -> FloatArray:
        force = np.linalg.solve(make_matrix(x), (means - x[:3] * gravity).T).T
        sizes = (np.linalg.norm(force, axis=1) - gravity) / errors
        return np.concatenate([sizes, x[6:] / _USUAL_ANGLE])

    best = least_squares(miss, np.zeros(9), xtol=1e-14, ftol=1e-14)
    half = _find_half(best.jac, best.fun, len(means) - 9)
    bias, x = best.x[:3] * gravity, best.x
    known = 3 if half[6:].max() < _USUAL_ANGLE else 0
    angles = x[6:][:known], half[6:][:known]
    fit = PoseFit("accel", x[3:6], half[3:6], *angles, bias, half[:3] * gravity, count_poses(means))
    return fit, make_matrix(x)


def _find_half(jacobian: FloatArray, residuals: FloatArray, spare: int) -> FloatArray:
    """Return half of the 95 % intervals; three redundant equations or more scale them by the residuals."""
    sd = np.sqrt(np.diag(np.linalg.pinv(jacobian.T @ jacobian)))
    if spare < _FEWEST_SPARE:
        return np.asarray(norm.ppf(0.975) * sd)
    return np.asarray(t.ppf(0.975, spare) * sd * max(1.0, np.sqrt(residuals @ residuals / spare)))


def _fit_gyro(
    gyro: FloatArray, rests: Sequence[slice], force: FloatArray, step: float, gaps: IntArray
) -> PoseFit | str:
    """Return the errors of the gyros, or why the turns do not determine them."""
    down = force / np.linalg.norm(force, axis=1, keepdims=True)
    means = np.array([gyro[one].mean(axis=0) for one in rests])
    weights = np.array([one.stop - one.start for one in rests], float)
    bias = weights @ means / weights.sum()
    turns = [
        k
        for k, (one, other) in enumerate(itertools.pairwise(rests))
        if (other.start - one.stop) * step <= _LONGEST_TURN
        and down[k] @ down[k + 1] < np.cos(_APART)
        and not ((gaps >= one.stop) & (gaps <= other.start)).any()
    ]
    spare = 2 * len(turns) - 9
    if len(turns) < _FEWEST_TURNS:
        return (
            f"gyros not fitted: {len(turns)} usable turns, {_FEWEST_TURNS} needed; turn by 20 deg or more "
            f"within {_LONGEST_TURN:g} s, without missing samples"
        )
    x = np.zeros(9)
    for _ in range(5):
        parts = [
            _turn(gyro[rests[k].stop : rests[k + 1].start], 0.5 * (means[k] + means[k + 1]), x, step)
            for k in turns
        ]
        ends = np.array([R @ down[k + 1] for (R, _), k in zip(parts, turns, strict=True)])
        misses = (ends - down[turns]).reshape(-1)
        # a column of the turn, times the rate, tilts the end
        slopes = np.concatenate(
            [
                np.cross(np.moveaxis(-A, 0, -1), end).reshape(9, 3).T
                for (_, A), end in zip(parts, ends, strict=True)
            ]
        )
        x = x - np.linalg.lstsq(slopes, misses, rcond=None)[0]
    scatter = max(float(misses @ misses) / spare, 1e-14)
    half = t.ppf(0.975, spare) * np.sqrt(np.diag(np.linalg.pinv(slopes.T @ slopes)) * scatter)
    if not half.max() < _VAGUE:
        return (
            f"gyros not fitted: {len(turns)} turns do not rotate gravity from pose to pose; check sign, unit "
            "and order of their axes, and saturation"
        )
    matrix, halves, off = x.reshape(3, 3), half.reshape(3, 3), ~np.eye(3, dtype=bool)
    scatter_bias = means.std(axis=0, ddof=1) / np.sqrt(len(means)) * t.ppf(0.975, len(means) - 1)
    scatter_bias += EARTH_RATE  # it is in the means, alike in poses that are turned about one axis
    diagonals = np.diag(matrix), np.diag(halves)
    return PoseFit("gyro", *diagonals, matrix[off], halves[off], bias, scatter_bias, len(turns))


def _turn(rates: FloatArray, bias: FloatArray, x: FloatArray, step: float) -> tuple[FloatArray, FloatArray]:
    """Return the rotation (3, 3) over the rows, and its derivative A (3, 3, 3): axis, row and column of M."""
    true = np.linalg.solve(np.eye(3) + x.reshape(3, 3), (rates - bias).T).T
    q = rotation.from_rotvec(true * step)
    span = 1
    while span < len(q):  # products of all rotations before
        q[span:] = rotation.multiply(q[:-span], q[span:])
        span *= 2
    R = rotation.matrix(q)
    return R[-1], np.einsum("nai,nj->aij", R, true) * step
