"""Read a solution from a table of time and position, velocity or attitude, and use it as an estimator.

Column names give quantity, frame and unit (`COLUMNS`). Covariance is optional. Values that the table does not
give are NaN. Between rows of a file, position is a cubic with the velocities at both ends (linear without
velocities); velocity, biases and covariance are linear; attitude turns at a constant rate. There is no
solution before the first row, after the last row, and in a gap. The rows of a program that runs are carried
on instead: what lies between two of them must not follow from the later one.
"""

from __future__ import annotations

import stat
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations
from pathlib import Path

import numpy as np

from bench.core.mathematics import earth, rotation
from bench.core.mathematics.arrays import BoolArray, FloatArray, IntArray
from bench.core.mathematics.units import SAME_INSTANT
from bench.core.records.data import Events, InitialState, NavSolution, SensorData, no_innovations
from bench.core.words.exceptions import ConfigError, EstimatorError
from bench.evaluation.errors.error_series import NOT_COVERED
from bench.evaluation.errors.failures import FAILED
from bench.evaluation.metrics.coverage import carry_positions
from bench.io.logs.formats.text import read_kf_gins_solution
from bench.io.logs.table_files import TableColumns, check_times, find_first, group, list_names, read_table
from bench.io.trajectories.trajectory import KINDS, check_positions, normalize_quaternions

INTERPOLATED, CARRIED = "interpolated", "carried_on"
"""Kinds of events: instants between rows, and what is taken there."""

MOST_ROWS = 3_000_000
_MOST_VALUES = 60_000_000  # rows times columns: half a gigabyte
_GAPS, _LONGEST = 2.0, 2.0  # longest interpolated interval: median intervals, and [s]
_LIMITS = (
    (-0.5 * np.pi, 0.5 * np.pi),
    (-2 * np.pi, 2 * np.pi),
    (-np.inf, np.inf),
)  # latitude, longitude, height
_RADII = (6e6, 1e8)  # from the centre of the Earth [m]
_NEAR, _FAST = 1e5, 1e3  # a start farther off than [m] plus [m/s] times the time is in another unit

_STATES = tuple(f"{block}_{axis}" for block in ("pos", "vel", "phi") for axis in "ned")
DEVIATIONS = {
    "sd_pos": (group("length", "sd_pos_n", "sd_pos_e", "sd_pos_d"),),
    "sd_vel": (group("speed", "sd_vel_n", "sd_vel_e", "sd_vel_d"),),
    "sd_phi": (group("angle", "sd_phi_n", "sd_phi_e", "sd_phi_d"),),
}
_BIASES = {
    "gyro_bias": (group("rate", "gyro_bias_x", "gyro_bias_y", "gyro_bias_z"),),
    "accel_bias": (group("acceleration", "accel_bias_x", "accel_bias_y", "accel_bias_z"),),
}
_COVARIANCES = {f"cov_{a}_{b}": (group("", f"cov_{a}_{b}"),) for a in _STATES for b in _STATES}
_ALL = {**KINDS, **DEVIATIONS, **_BIASES, **_COVARIANCES}
_OPTIONAL = tuple(kind for kind in _ALL if kind != "time")

COLUMNS = {kind: list_names(groups) for kind, groups in {**KINDS, **DEVIATIONS, **_BIASES}.items()}
"""Column names of a solution, by kind; angles also in rad or mrad, lengths in km, speeds as _m_s.

They are those of `trajectory.COLUMNS`, and the standard deviations of the errors along n; phi
is the attitude error, ``C_nb_estimate = exp([phi x]) C_nb_true``. Instead of standard deviations the table
may have covariances ``cov_pos_n_pos_n``, ``cov_pos_n_vel_e`` ... in SI and radians: the whole diagonal of
each block; other elements are optional and 0 by default.
"""


@dataclass(frozen=True, slots=True)
class ForeignSolution:
    """A solution as read from a file; a block that the file does not have is NaN."""

    shown: str
    rows: IntArray  # (N,) number of each row in the file, from 1
    t: FloatArray  # (N,) [s]
    lla: FloatArray  # (N, 3) [rad, rad, m]
    vel_n: FloatArray  # (N, 3) [m/s]
    q_nb: FloatArray  # (N, 4)
    gyro_bias_b: FloatArray  # (N, 3) [rad/s]
    accel_bias_b: FloatArray  # (N, 3) [m/s^2]
    cov: FloatArray | None  # (N, 9, 9); None if the file has none
    remarks: tuple[str, ...]

    def __len__(self) -> int:
        return len(self.t)


def read_solution(path: Path, *, t_0: float = 0.0) -> ForeignSolution:
    """Read the solution in a file.

    Parameters
    ----------
    path : Path
        ``.csv``, ``.parquet`` or ``.mat`` with the columns of `COLUMNS`: time and at least one other kind; or
        the ``.nav`` of KF-GINS, with its ``STD.txt`` if that is beside it.
    t_0 : float
        Time in the file at the start of the run [s].

    Raises
    ------
    ConfigError
        If the file cannot be read or is not a solution. One line names the row; 1 is the first below the
        header.
    """
    shown = path.name
    try:
        kind = path.stat().st_mode
    except OSError as error:
        raise ConfigError(f"{shown}: {error.strerror or error}") from None
    if not stat.S_ISREG(kind):
        raise ConfigError(f"{shown}: not a regular file")
    if path.suffix.lower() == ".nav":
        table = read_kf_gins_solution(path)
    else:
        table = read_table(path, _ALL, _OPTIONAL, MOST_ROWS, most_values=_MOST_VALUES)
        table.check_groups(_ALL, shown)
        _check_deviations(table, shown)
    t = table.columns["time"][:, 0]
    check_times(t, table.names["time"][0], shown)
    given = {kind: values for kind, values in table.columns.items() if not np.isnan(values).all()}
    blocks = [kind for kind in ("position", "velocity", "attitude") if kind in given]
    if not blocks:
        raise ConfigError(f"{shown}: it has no values of position, velocity or attitude")
    whole = np.all([np.isfinite(values).all(axis=1) for values in given.values()], axis=0)
    rows = np.flatnonzero(whole) + 1
    if not len(rows):
        raise ConfigError(f"{shown}: no row has a finite number in every column")
    given = {kind: values[whole] for kind, values in given.items()}
    n = len(rows)
    lla = _read_positions(table, given, rows, shown)
    q_en = rotation.from_matrix(earth.matrix_en(lla[:, 0], lla[:, 1]))
    remarks = [f"{len(t) - n} of {len(t)} rows left out: a value is not finite"] if n < len(t) else []
    remarks += [table.list_unused()] if table.unused else []
    return ForeignSolution(
        shown=shown,
        rows=rows,
        t=t[whole] - t_0,
        lla=lla,
        vel_n=_read_velocities(table, given, q_en, shown),
        q_nb=read_attitudes(table, given, q_en, rows, shown),
        gyro_bias_b=given.get("gyro_bias", np.full((n, 3), np.nan)),
        accel_bias_b=given.get("accel_bias", np.full((n, 3), np.nan)),
        cov=_read_covariance(given, blocks, rows, shown),
        remarks=tuple(remarks),
    )


# --- checking -----------------------------------------------------------------------------------------


def _check_deviations(table: TableColumns, shown: str) -> None:
    both = [kind for kind in DEVIATIONS if kind in table.columns]
    if both and any(name in table.columns for name in _COVARIANCES):
        raise ConfigError(f"{shown}: {both[0]}_n and covariances: give only one of them")


def _read_positions(
    table: TableColumns, given: Mapping[str, FloatArray], rows: IntArray, shown: str
) -> FloatArray:
    """Return lla (N, 3); NaN if there is no position."""
    if "position" not in given:
        return np.full((len(rows), 3), np.nan)
    position = given["position"]
    check_positions(table, position, rows, _LIMITS, _RADII, shown)
    return position if table.stems["position"][0] == "lat" else earth.to_geodetic(position)


def _read_velocities(
    table: TableColumns, given: Mapping[str, FloatArray], q_en: FloatArray, shown: str
) -> FloatArray:
    if "velocity" not in given:
        return np.full((len(q_en), 3), np.nan)
    if table.stems["velocity"][0] == "vel_n":
        return given["velocity"]
    if "position" not in given:
        raise ConfigError(f"{shown}: {table.names['velocity'][0]} needs a position column to find north")
    return rotation.rotate(rotation.conjugate(q_en), given["velocity"])


def read_attitudes(
    table: TableColumns, given: Mapping[str, FloatArray], q_en: FloatArray, rows: IntArray, shown: str
) -> FloatArray:
    """Return q_nb (N, 4) of the attitudes given, NaN without any, with ``q_en`` (N, 4) of the positions."""
    if "attitude" not in given:
        return np.full((len(q_en), 4), np.nan)
    attitude, stem = given["attitude"], table.stems["attitude"][0]
    if stem == "roll":
        return rotation.from_euler(*attitude.T)
    q = normalize_quaternions(attitude, rows, shown)
    if stem == "q_nb_w":
        return q
    if "position" not in given:
        raise ConfigError(f"{shown}: q_eb needs a position column to find north")
    return rotation.multiply(rotation.conjugate(q_en), q)


def _read_covariance(
    given: Mapping[str, FloatArray], blocks: Sequence[str], rows: IntArray, shown: str
) -> FloatArray | None:
    """Return the covariance (N, 9, 9), NaN in missing blocks; None if the file has none."""
    cov = np.full((len(rows), 9, 9), np.nan)
    claimed = np.zeros(9, np.bool_)
    for k, (kind, block) in enumerate(zip(DEVIATIONS, ("position", "velocity", "attitude"), strict=True)):
        here = range(3 * k, 3 * k + 3)
        diagonal = [f"cov_{_STATES[i]}_{_STATES[i]}" for i in here]
        there = [name for name in diagonal if name in given]
        if kind in given:
            if (first := find_first((given[kind] < 0).any(axis=1))) is not None:
                raise ConfigError(f"{shown}: row {rows[first]}: a standard deviation {kind}_* is negative")
            for i, column in zip(here, given[kind].T, strict=True):
                cov[:, i, i] = column**2
        elif there and len(there) < 3:
            missing = next(name for name in diagonal if name not in given)
            raise ConfigError(f"{shown}: {there[0]} without {missing}")
        elif there:
            for i, name in zip(here, diagonal, strict=True):
                cov[:, i, i] = given[name][:, 0]
        else:
            continue
        if block not in blocks:
            raise ConfigError(f"{shown}: standard deviations or covariances of {block}, but no {block}")
        claimed[list(here)] = True
    for i, j in combinations(np.flatnonzero(claimed).tolist(), 2):
        _fill_covariance(cov, i, j, given, rows, shown)
    return cov if claimed.any() else None


def _fill_covariance(
    cov: FloatArray, i: int, j: int, given: Mapping[str, FloatArray], rows: IntArray, shown: str
) -> None:
    """Fill in one off-diagonal element and its mirror image; 0 if the file does not give it."""
    names = (f"cov_{_STATES[i]}_{_STATES[j]}", f"cov_{_STATES[j]}_{_STATES[i]}")
    both = [given[name][:, 0] for name in names if name in given]
    cov[:, i, j] = cov[:, j, i] = both[0] if both else 0.0
    if len(both) == 2:
        scale = np.sqrt(np.abs(cov[:, i, i] * cov[:, j, j]))
        if (k := find_first(np.abs(both[0] - both[1]) > 1e-6 * scale)) is not None:
            raise ConfigError(f"{shown}: row {rows[k]}: {names[0]} and {names[1]} differ")


def check_unit(solution: ForeignSolution, t: float, lla: FloatArray) -> None:
    """Raise ConfigError if a solution starts so far from the run that a unit must be wrong."""
    first = solution.lla[0]
    if not (np.isfinite(first).all() and np.isfinite(lla).all()):
        return
    distance = float(np.linalg.norm(earth.to_ecef(first) - earth.to_ecef(lla)))
    if distance > _NEAR + _FAST * abs(float(solution.t[0]) - t):
        raise ConfigError(
            f"{solution.shown}: row {solution.rows[0]}: {distance / 1e3:.0f} km from the start of the run: "
            f"a solution of another flight, or a column whose unit is not that in its name"
        )


# --- on other times -----------------------------------------------------------------------------------


def resample(solution: ForeignSolution, t: FloatArray, longest: float | None = None) -> NavSolution:
    """Return a solution at other times, without extrapolation.

    Parameters
    ----------
    solution : ForeignSolution
        The solution as read.
    t : (M,) array
        Output times [s].
    longest : float or None
        Longest interval between rows that is interpolated [s]; default twice the median, at most 2 s.

    Returns
    -------
    solution : NavSolution
        NaN at times that it does not cover, which events of kind "not_covered" list; an event of kind
        "failed" if it covers none.
    """
    most = _choose_longest(solution, longest)
    before = np.searchsorted(solution.t, t + SAME_INSTANT, "right") - 1  # the last row not after t
    inside = before >= 0
    before = np.maximum(before, 0)
    after = np.minimum(before + 1, len(solution) - 1)
    on_row = inside & (np.abs(t - solution.t[before]) <= SAME_INSTANT)
    width = solution.t[after] - solution.t[before]
    covered = on_row | (inside & (after > before) & (width <= most + SAME_INSTANT))
    s = np.where(on_row | (width <= 0), 0.0, (t - solution.t[before]) / np.where(width > 0, width, 1.0))[
        :, None
    ]

    def interpolate(values: FloatArray) -> FloatArray:
        weight = s.reshape((-1,) + (1,) * (values.ndim - 1))
        between: FloatArray = values[before] + weight * (values[after] - values[before])
        return _blank_uncovered(np.where(weight > 0, between, values[before]), covered)

    q_0, q_1 = solution.q_nb[before], solution.q_nb[after]
    turn = rotation.to_rotvec(rotation.multiply(rotation.conjugate(q_0), q_1))
    q_nb = np.where(s > 0, rotation.multiply(q_0, rotation.from_rotvec(s * turn)), q_0)
    cov = np.full((len(t), 9, 9), np.nan) if solution.cov is None else interpolate(solution.cov)
    return NavSolution(
        t=t,
        lla=_blank_uncovered(_interpolate_position(solution, before, after, s, width), covered),
        vel_n=interpolate(solution.vel_n),
        q_nb=_blank_uncovered(q_nb, covered),
        gyro_bias_b=interpolate(solution.gyro_bias_b),
        accel_bias_b=interpolate(solution.accel_bias_b),
        cov=cov,
        extra_names=(),
        extra=np.empty((len(t), 0)),
        extra_sd=np.empty((len(t), 0)),
        innovations=no_innovations(),
        events=_list_events(solution, t, covered, np.where(on_row, 0.0, width), most, INTERPOLATED),
    )


def _choose_longest(solution: ForeignSolution, longest: float | None) -> float:
    """Return the longest interval that is bridged [s]."""
    median = float(np.median(np.diff(solution.t))) if len(solution) > 1 else 0.0
    return min(_GAPS * median, _LONGEST) if longest is None else longest


def carry_rows(solution: ForeignSolution, t: FloatArray, longest: float | None = None) -> NavSolution:
    """Return a solution at other times, each row carried on until the next: position by its velocity.

    Parameters as for :func:`resample`; ``longest`` is the longest time that a row is carried on [s].
    """
    most = _choose_longest(solution, longest)
    row = np.searchsorted(solution.t, t + SAME_INSTANT, "right") - 1  # the last row not after t
    begun = row >= 0
    row = np.maximum(row, 0)
    age = np.maximum(t - solution.t[row], 0.0)
    age[age <= SAME_INSTANT] = 0.0
    covered = begun & (age <= most + SAME_INSTANT)
    later = np.flatnonzero(age > 0.0)
    lla = solution.lla[row]
    lla[later] = carry_positions(solution.t, solution.lla, solution.vel_n, row[later], t[later])
    cov = np.full((len(t), 9, 9), np.nan) if solution.cov is None else solution.cov[row]
    rest = (solution.vel_n, solution.q_nb, solution.gyro_bias_b, solution.accel_bias_b)
    values = (lla, *(one[row] for one in rest), cov)
    nothing = np.empty((len(t), 0))
    events = _list_events(solution, t, covered, age, most, CARRIED)
    lla, vel_n, q_nb, gyro_bias_b, accel_bias_b, cov = (_blank_uncovered(one, covered) for one in values)
    return NavSolution(
        t=t,
        lla=lla,
        vel_n=vel_n,
        q_nb=q_nb,
        gyro_bias_b=gyro_bias_b,
        accel_bias_b=accel_bias_b,
        cov=cov,
        extra_names=(),
        extra=nothing,
        extra_sd=nothing,
        innovations=no_innovations(),
        events=events,
    )


def _interpolate_position(
    solution: ForeignSolution, before: IntArray, after: IntArray, s: FloatArray, width: FloatArray
) -> FloatArray:
    lla_0, lla_1 = solution.lla[before], solution.lla[after]
    step = lla_1 - lla_0
    step[:, 1] -= 2 * np.pi * np.round(step[:, 1] / (2 * np.pi))  # across the date line
    if np.isnan(solution.vel_n).all():
        lla = lla_0 + s * step
    else:
        rate_0 = earth.displace(lla_0, solution.vel_n[before]) - lla_0
        rate_1 = earth.displace(lla_1, solution.vel_n[after]) - lla_1
        h = width[:, None]
        lla = lla_0 + s * s * (3 - 2 * s) * step + h * s * (1 - s) * ((1 - s) * rate_0 - s * rate_1)
    found: FloatArray = np.where(s > 0, lla, lla_0)
    return found


def _blank_uncovered(values: FloatArray, covered: BoolArray) -> FloatArray:
    values = np.array(values)
    values[~covered] = np.nan
    return values


def _list_events(
    solution: ForeignSolution, t: FloatArray, covered: BoolArray, width: FloatArray, most: float, how: str
) -> Events:
    found = [(0.0, 0.0, "table", text) for text in solution.remarks]
    between = covered & (width > 0)
    if between.any():
        count = f"{int(between.sum())} of {len(t)}"
        apart = "apart" if how == INTERPOLATED else "after the one before"
        words = f"{count} instants lie between rows, up to {width[between].max():.3g} s {apart}"
        found.append((float(t[between][0]), float(t[between][-1]), how, words))
    edges = np.flatnonzero(np.diff(np.concatenate([[False], ~covered, [False]]).astype(np.int8)))
    found += [
        (float(t[a]), float(t[b - 1]), NOT_COVERED, f"no rows, or more than {most:.3g} s apart")
        for a, b in zip(edges[::2], edges[1::2], strict=True)
    ]
    if not covered.any():
        span = f"{solution.t[0]:g} to {solution.t[-1]:g} s"
        run = f"{t[0]:g} to {t[-1]:g} s" if len(t) else "no instant"
        found.append((0.0, 0.0, FAILED, f"{solution.shown} covers {span}, nothing of the run, {run}"))
    return Events.from_rows(found)


class FileEstimator:
    """An estimator that returns the solution in a file: ``use = "file:solution.csv"``."""

    def __init__(self, path: Path, *, t_0_s: float = 0.0, max_gap_s: float | None = None) -> None:
        for name, value in (("t_0_s", t_0_s), ("max_gap_s", 0.0 if max_gap_s is None else max_gap_s)):
            if not isinstance(value, int | float) or isinstance(value, bool) or not np.isfinite(value):
                raise EstimatorError(f"{name} = {value!r} must be a number [s]")
        if max_gap_s is not None and max_gap_s < 0:
            raise EstimatorError(f"max_gap_s = {max_gap_s!r} must not be negative")
        self._longest = max_gap_s
        self._solution = read_solution(path, t_0=t_0_s)

    def run(self, sensors: SensorData, initial: InitialState) -> NavSolution:
        """Return the solution at ``sensors.output_t``; NaN at times that it does not cover."""
        try:
            check_unit(self._solution, initial.t, initial.lla)
        except ConfigError as error:
            raise EstimatorError(str(error)) from None
        return resample(self._solution, sensors.output_t, self._longest)
