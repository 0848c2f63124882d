"""Errors of a solution: estimate minus truth in frame n at the solution's times, their NEES, convergence."""

from __future__ import annotations

from collections.abc import Collection, Iterator
from dataclasses import fields, replace
from itertools import chain
from typing import Any, TypeVar

import numpy as np

from bench.core.compilation.compiled import kernel
from bench.core.files import disk_arrays
from bench.core.mathematics import earth, rotation
from bench.core.mathematics.arrays import BoolArray, FloatArray, IntArray, read_only
from bench.core.mathematics.units import SAME_INSTANT
from bench.core.records.data import NavSolution, Trajectory
from bench.core.records.run_records import ErrorSeries

_Series = TypeVar("_Series", NavSolution, ErrorSeries)

BLOCKS = {"pos": slice(0, 3), "vel": slice(3, 6), "phi": slice(6, 9)}
"""Block of states -> its rows of ``NavSolution.cov``."""

VALUES = {"pos": "lla", "vel": "vel_n", "phi": "q_nb"}
"""Block of states -> its field in a solution."""

TITLES = {"pos": "position", "vel": "velocity", "phi": "attitude"}
"""Block of states -> its name in words."""

AXIS_TITLES = {
    "pos_d": "height",
    "pos_n": "north",
    "pos_e": "east",
    "vel_n": "north velocity",
    "vel_e": "east velocity",
    "vel_d": "vertical velocity",
    "phi_d": "heading",
    "phi_n": "tilt about north",
    "phi_e": "tilt about east",
}
"""Axis of a block -> its name in words, the most informative axis of each block first."""

NOT_COVERED = "not_covered"
"""Kind of the events of an interval without a solution."""

DIVERGED_SIGMAS = 10.0
"""An error above so many sigma [1] and its limit means divergence; without a covariance, its limit alone."""

DIVERGED_HORIZONTAL, DIVERGED_HEIGHT, DIVERGED_VELOCITY = 1000.0, 300.0, 15.0  # [m], [m], [m/s]
DIVERGED_TILT, DIVERGED_HEADING = 30.0, 60.0  # [deg]
DIVERGED_SHARE = 0.1  # of the epochs may be beyond a limit where nothing is reported, as in an outage


def error_series(truth: Trajectory, solution: NavSolution) -> ErrorSeries:
    """Return the errors of a solution and their NEES.

    Parameters
    ----------
    truth : Trajectory
        The motion as flown.
    solution : NavSolution
        The estimate; a block that is not estimated is NaN.

    Returns
    -------
    errors : ErrorSeries
        Estimate minus truth: pos_n [m] (first order, :func:`bench.core.mathematics.earth.difference_n`),
        vel_n [m/s], phi_n [rad] with ``C_nb_est = exp([phi_n x]) C_nb_true``.

    Raises
    ------
    ValueError
        If a time of the solution lies outside the truth.
    """
    present = claimed_blocks(solution)
    counted = np.repeat([name in present for name in BLOCKS], 3)
    pos_n, vel_error_n, phi_n = (disk_arrays.empty((len(solution), 3)) for _ in BLOCKS)
    heading, nees = np.empty(len(solution)), np.empty(len(solution))
    for rows in disk_arrays.blocks(len(solution)):
        lla, vel_n, q_nb = interpolate_truth(truth, solution.t[rows])
        estimate, cov = solution.q_nb[rows], solution.cov[rows]
        with np.errstate(over="ignore", invalid="ignore"):  # a diverged solution is a result, not a warning
            pos_n[rows] = earth.difference_n(solution.lla[rows], lla)
            vel_error_n[rows] = solution.vel_n[rows] - vel_n
            phi_n[rows] = rotation.to_rotvec(rotation.multiply(estimate, rotation.conjugate(q_nb)))
            difference = rotation.to_heading(estimate) - rotation.to_heading(q_nb)
            heading[rows] = np.pi - np.mod(np.pi - difference, 2 * np.pi)
            error = np.hstack([pos_n[rows], vel_error_n[rows], phi_n[rows]])
            if not counted.all():
                error, cov = error[:, counted], cov[:, counted][:, :, counted]
            nees[rows] = normalized_squares(error, cov)
    return ErrorSeries(
        t=solution.t,
        pos_n=pos_n,
        vel_n=vel_error_n,
        phi_n=phi_n,
        heading=heading,
        nees=nees,
        states=int(counted.sum()),
    )


def variances(solution: NavSolution) -> FloatArray:
    """Return the variances (M, 9) of a solution, the diagonal of its covariance."""
    return disk_arrays.fill((len(solution), 9), lambda rows: np.einsum("kii->ki", solution.cov[rows]))


def estimated_blocks(solution: NavSolution) -> tuple[str, ...]:
    """Return the names of the blocks that have any number, as values or on the diagonal of cov."""
    return tuple(
        name
        for name, rows in BLOCKS.items()
        if _has_number(getattr(solution, VALUES[name])) or _claims(solution, rows)
    )


def claimed_blocks(solution: NavSolution) -> tuple[str, ...]:
    """Return the estimated blocks with a reported accuracy: any number on the diagonal of cov."""
    return tuple(name for name in estimated_blocks(solution) if _claims(solution, BLOCKS[name]))


def _claims(solution: NavSolution, rows: slice) -> bool:
    """Return whether the covariance has any number on its diagonal in some rows."""
    first = np.einsum("kii->ki", solution.cov[:1])
    return _has_number(first[:, rows]) or _has_number(variances(solution)[:, rows])


def _has_number(values: FloatArray) -> bool:
    """Return whether any value (M, ...) is not NaN; checks the first row first."""
    return not (np.isnan(values[:1]).all() and np.isnan(values).all())


def interpolate_truth(truth: Trajectory, t: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return lla (M, 3), vel_n (M, 3), q_nb (M, 4) of the truth at times t (M,).

    At a sample time the row of that sample is returned. Between samples, position is the cubic that
    matches position and velocity at both ends, velocity is linear and the attitude rate is constant.

    Raises
    ------
    ValueError
        If a time is not finite or lies outside the truth.
    """
    first, last = float(truth.t[0]), float(truth.t[-1])
    slack = SAME_INSTANT * ((last - first) / max(len(truth) - 1, 1))
    inside = (t >= first - slack) & (t <= last + slack)
    if not inside.all():
        k = int(np.argmin(inside))
        raise ValueError(
            f"NavSolution.t: row {k} has {t[k]:.9g} s; the truth covers {first:.9g} to {last:.9g} s"
        )
    after = np.minimum(np.searchsorted(truth.t, t), len(truth) - 1)
    before = np.maximum(after - 1, 0)
    row = np.where(t - truth.t[before] < truth.t[after] - t, before, after)
    lla, vel_n, q_nb = (column.take(row, axis=0) for column in (truth.lla, truth.vel_n, truth.q_nb))
    between = np.flatnonzero(np.abs(truth.t[row] - t) > slack)
    if len(between):
        lla[between], vel_n[between], q_nb[between] = _interpolate_rows(truth, before[between], t[between])
    return lla, vel_n, q_nb


def _interpolate_rows(
    truth: Trajectory, k: IntArray, t: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return lla, vel_n, q_nb at times t inside the intervals (t[k], t[k + 1])."""
    h = (truth.t[k + 1] - truth.t[k])[:, None]
    s = (t - truth.t[k])[:, None] / h
    lla_0, lla_1 = truth.lla[k], truth.lla[k + 1]
    step = lla_1 - lla_0
    step[:, 1] -= 2 * np.pi * np.round(step[:, 1] / (2 * np.pi))  # across the date line
    rate_0, rate_1 = _lla_rate(lla_0, truth.vel_n[k]), _lla_rate(lla_1, truth.vel_n[k + 1])
    lla = lla_0 + s * s * (3 - 2 * s) * step + h * s * (1 - s) * ((1 - s) * rate_0 - s * rate_1)
    vel_n = truth.vel_n[k] + s * (truth.vel_n[k + 1] - truth.vel_n[k])
    turn_b = rotation.to_rotvec(rotation.multiply(rotation.conjugate(truth.q_nb[k]), truth.q_nb[k + 1]))
    q_nb = rotation.multiply(truth.q_nb[k], rotation.from_rotvec(s * turn_b))
    return lla, vel_n, q_nb


def _lla_rate(lla: FloatArray, vel_n: FloatArray) -> FloatArray:
    """Return the rates of latitude, longitude [rad/s] and height [m/s]."""
    return earth.displace(lla, vel_n) - lla


def normalized_squares(error: FloatArray, cov: FloatArray) -> FloatArray:
    """Return e' P^-1 e (M,) of errors (M, n) with covariances (M, n, n).

    Computed from the Cholesky factor of ``D^-1 P D^-1``, ``D = sqrt(diag P)``, because meters and radians
    differ in scale. NaN where that matrix is not positive definite or not finite.
    """
    nees = np.full(len(error), np.nan)
    if error.shape[1]:
        e, P = (read_only(np.ascontiguousarray(rows)) for rows in (error, cov))
        _nees_kernel(e, P, np.zeros(cov.shape[1:]), np.zeros((2, error.shape[1])), nees)
    return nees


def positive_definite(cov: FloatArray) -> BoolArray:
    """Return a mask (M,) of the covariances (M, n, n) that are finite and positive definite.

    Each is scaled by its own standard deviations first.
    """
    return ~np.isnan(normalized_squares(np.zeros(cov.shape[:2]), cov))


@kernel
def _nees_kernel(
    error: FloatArray, cov: FloatArray, L: FloatArray, rows: FloatArray, nees: FloatArray
) -> None:
    """Fill nees (M,) of errors (M, n) with covariances (M, n, n); L (n, n) and rows (2, n) are memory.

    L is the Cholesky factor with the reciprocals of its diagonal: the square root of what is not positive is
    NaN or 0, and what follows from it is not finite. Above the diagonal it counts only whether a number is
    finite.
    """
    n, y, scale = L.shape[0], rows[0], rows[1]
    for k in range(error.shape[0]):
        P, total = cov[k], 0.0
        for i in range(n):
            scale[i] = 1.0 / np.sqrt(P[i, i])
        for i in range(n):
            y[i] = error[k, i] * scale[i]
            for j in range(i + 1):
                value = P[i, j] * scale[i] * scale[j]
                for m in range(j):
                    value -= L[i, m] * L[j, m]
                L[i, j] = 1.0 / np.sqrt(value) if i == j else value * L[j, j]
            for j in range(i):
                y[i] -= L[i, j] * y[j]
                total += 0.0 * P[j, i]
            y[i] *= L[i, i]
            total += y[i] * y[i]
        nees[k] = total if np.isfinite(total) else np.nan


def heading_sd(solution: NavSolution) -> FloatArray:
    """Return the standard deviation of the heading (M,) from the covariance of phi_n [rad].

    ``d heading = phi_D + tan(pitch) (phi_N cos(heading) + phi_E sin(heading))`` to first order: the rotation
    of the horizontal part of the forward axis ``C_nb e_1``.
    """
    sd = np.empty(len(solution))
    for rows in disk_arrays.blocks(len(solution)):
        with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
            w, x, y, z = solution.q_nb[rows].T
            up = 2.0 * (w * y - x * z)  # of the forward axis, the sine of the pitch
            slope = up / (1.0 - up * up)
            a, b = slope * (w * w + x * x - y * y - z * z), slope * 2.0 * (x * y + w * z)
            P = solution.cov[rows, BLOCKS["phi"], BLOCKS["phi"]].transpose(1, 2, 0)
            variance = a * a * P[0, 0] + b * b * P[1, 1] + P[2, 2]
            sd[rows] = np.sqrt(variance + 2.0 * (a * b * P[0, 1] + a * P[0, 2] + b * P[1, 2]))
    return sd


def check_convergence(
    errors: ErrorSeries, solution: NavSolution, *, factored: bool = False
) -> tuple[bool, str | None]:
    """Return whether a solution converged, and the reason if it did not.

    It did not converge if a state or covariance is not finite, the covariance is not positive definite, or an
    error exceeds both `DIVERGED_SIGMAS` of what is reported (of a vector the root of the sum of its
    variances) and the limit of its kind at some epoch. A block that is NaN throughout, values and covariance,
    is not estimated and is not checked. One without a covariance is held against its limit alone, which it
    may exceed at `DIVERGED_SHARE` of the epochs. ``factored`` says that NEES comes from the covariance of the
    solution; then it is finite where that is positive definite.
    """
    blocks = estimated_blocks(solution)
    if not blocks:
        return False, "no finite position, velocity or attitude at any epoch"
    columns = {TITLES[name]: getattr(solution, VALUES[name]) for name in blocks}
    biases = {"gyro bias": solution.gyro_bias_b, "accelerometer bias": solution.accel_bias_b}
    columns |= {title: bias_b for title, bias_b in biases.items() if not np.isnan(bias_b).all()}
    if not (np.isfinite(solution.extra).all() and np.isfinite(solution.extra_sd).all()):
        for values, of in ((solution.extra, ""), (solution.extra_sd, "standard deviation of ")):
            columns |= {f"{of}{name}": values[:, k] for k, name in enumerate(solution.extra_names)}
    for title, column in columns.items():
        if not np.isfinite(column).all():
            return False, f"{title} is not finite at {_describe_epochs(solution, _not_finite(column))}"
    claimed = claimed_blocks(solution)
    if claimed and not (factored and np.isfinite(errors.nees).all()):
        counted = np.hstack([np.arange(9)[BLOCKS[name]] for name in claimed])
        cov = solution.cov[:, counted][:, :, counted]
        bad = _not_finite(cov)
        if bad.any():
            return False, f"covariance is not finite at {_describe_epochs(solution, bad)}"
        bad = ~positive_definite(cov)
        if bad.any():
            return False, f"covariance is not positive definite at {_describe_epochs(solution, bad)}"
    disk_arrays.release()
    for what, unit, limit, size, sigma in list_sizes(errors, solution, blocks):
        bad = (size > limit) & ~(size <= DIVERGED_SIGMAS * sigma)
        unclaimed = bad & np.isnan(sigma)
        if unclaimed.mean() <= DIVERGED_SHARE:
            bad &= ~unclaimed
        if bad.any():
            k = int(np.argmax(bad))
            shown = f"{size[k]:.0f}" if size[k] < 1e9 else f"{size[k]:.3g}"
            text = f"{what} is {shown} {unit} at {_describe_epochs(solution, bad)}, more than "
            if np.isnan(sigma[k]):
                return False, f"{text}{limit:g} {unit}"
            return False, f"{text}{DIVERGED_SIGMAS:g} sigma of {sigma[k]:.1f} {unit}"
    return True, None


def list_sizes(
    errors: ErrorSeries, solution: NavSolution, blocks: Collection[str]
) -> Iterator[tuple[str, str, float, FloatArray, FloatArray]]:
    """Yield name, unit, limit, size (M,) and reported sigma (M,) of each kind of error."""
    variance = variances(solution)
    with np.errstate(invalid="ignore"):
        if "pos" in blocks:
            size, sigma = np.hypot(*errors.pos_n[:, :2].T), np.sqrt(variance[:, :2].sum(axis=1))
            yield "horizontal error", "m", DIVERGED_HORIZONTAL, size, sigma
            size, sigma = np.abs(errors.pos_n[:, 2]), np.sqrt(variance[:, 2])
            yield "height error", "m", DIVERGED_HEIGHT, size, sigma
        if "vel" in blocks:
            size = np.sqrt(np.einsum("ki,ki->k", errors.vel_n, errors.vel_n))
            sigma = np.sqrt(variance[:, BLOCKS["vel"]].sum(axis=1))
            yield "velocity error", "m/s", DIVERGED_VELOCITY, size, sigma
        if "phi" in blocks:
            size, sigma = np.hypot(*errors.phi_n[:, :2].T), np.sqrt(variance[:, 6:8].sum(axis=1))
            yield "tilt", "deg", DIVERGED_TILT, np.rad2deg(size), np.rad2deg(sigma)
            size, sigma = np.abs(errors.heading), heading_sd(solution)
            yield "heading error", "deg", DIVERGED_HEADING, np.rad2deg(size), np.rad2deg(sigma)


def count_aligning_epochs(solution: NavSolution, until: float) -> int:
    """Count the epochs at the start of a solution, before ``until`` [s], that are NaN throughout."""
    for rows in chain([slice(0, 1)], disk_arrays.blocks(len(solution))):  # most begin with the first
        started = solution.t[rows] >= until
        for column in (*(getattr(solution, name) for name in VALUES.values()), solution.cov):
            started |= ~np.isnan(column[rows].reshape(len(started), -1)).all(axis=1)
        if started.any():
            return int(rows.start + np.argmax(started))
    return 0


def find_covered_epochs(solution: NavSolution) -> BoolArray:
    """Return a mask (M,) of the epochs to evaluate: outside all `NOT_COVERED` events, with any number.

    Epochs before the first answer that are NaN throughout are among them: they belong to an alignment. It is
    all epochs if none would be left.
    """
    answered = find_answered_epochs(solution)
    rows = answered.copy()
    rows[: np.argmax(answered)] = True
    rows &= ~_find_uncovered(solution)
    return rows if rows.any() else ~rows


def find_answered_epochs(solution: NavSolution) -> BoolArray:
    """Return a mask (M,) of the epochs with any number and outside all `NOT_COVERED` events."""
    rows = np.zeros(len(solution), np.bool_)
    columns = [*(getattr(solution, name) for name in VALUES.values()), solution.cov]
    for block in disk_arrays.blocks(len(solution)):
        for column in columns:
            if rows[block].all():
                break
            rows[block] |= ~np.isnan(column[block].reshape(len(rows[block]), -1)).all(axis=1)
    return rows & ~_find_uncovered(solution)


def _find_uncovered(solution: NavSolution) -> BoolArray:
    rows = np.zeros(len(solution), np.bool_)
    for start, end, _ in solution.events.select(NOT_COVERED):
        rows[(solution.t >= start) & (solution.t <= end)] = True
    return rows


def select_epochs(record: _Series, rows: BoolArray | IntArray | slice) -> _Series:
    """Return the given epochs of a solution or error series; all innovations and events are kept."""
    taken = as_slice(rows)
    if isinstance(taken, slice) and taken == slice(0, None):
        return record
    columns: dict[str, Any] = {f.name: getattr(record, f.name) for f in fields(record)}
    numbers = taken if isinstance(taken, slice) else np.arange(len(record))[taken]
    selected: dict[str, Any] = {}
    for name, column in columns.items():
        if isinstance(column, np.ndarray):
            picked = column[numbers] if isinstance(numbers, slice) else disk_arrays.take(column, numbers)
            selected[name] = picked
    return replace(record, **selected)


def as_slice(rows: BoolArray | IntArray | slice) -> BoolArray | IntArray | slice:
    """Return a slice if a mask selects all rows from some row on, so that no copy is made; else the mask."""
    if isinstance(rows, np.ndarray) and rows.dtype == np.bool_ and len(rows):
        first = int(np.argmax(rows))
        return slice(first, None) if rows[first:].all() else rows
    return rows


def _not_finite(values: FloatArray) -> BoolArray:
    """Return a mask (M,) of the rows of values (M, ...) that contain NaN or infinity."""
    return np.array(~np.isfinite(values.reshape(len(values), -1)).all(axis=1))


def _describe_epochs(solution: NavSolution, bad: BoolArray) -> str:
    """Return the first bad epoch and the number of bad epochs, in words."""
    return f"t = {solution.t[int(np.argmax(bad))]:g} s ({int(bad.sum())} of {len(solution)} epochs)"
