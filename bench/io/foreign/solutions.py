"""Read a solution from a table of time and position, velocity or attitude, and use it as a filter.

Column names give quantity, frame and unit (`COLUMNS`). Covariance is optional. Values that the table does not
give are NaN. `bench.evaluation.errors.resampling` says what lies between rows.
"""

from __future__ import annotations

import stat
from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import combinations
from pathlib import Path

import numpy as np

from bench.core.mathematics import earth, rotation
from bench.core.mathematics.arrays import FloatArray, IntArray
from bench.core.records.data import InitialState, NavSolution, SensorData
from bench.core.words.exceptions import ConfigError, EstimatorError
from bench.evaluation.errors.resampling import ForeignSolution, resample
from bench.io.foreign.solution_rows import NOWHERE, Placing, make_solution, read_foreign_rows, reject_placing
from bench.io.logs.formats.pose_files import WEEK_CLOCK, recognizes
from bench.io.logs.formats.text import read_kf_gins_solution
from bench.io.logs.table_files import (
    MOST_BYTES,
    TableColumns,
    check_times,
    find_first,
    group,
    list_columns,
    list_names,
    read_table,
)
from bench.io.trajectories.trajectory import KINDS, check_positions, normalize_quaternions

MOST_ROWS = 3_000_000
_MOST_VALUES = 60_000_000  # rows times columns: half a gigabyte
_LIMITS = (-0.5 * np.pi, 0.5 * np.pi), (-2 * np.pi, 2 * np.pi), (-np.inf, np.inf)
"""Of latitude, longitude, height."""
_RADII = (6e6, 1e8)  # from the center of the Earth [m]
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


def read_solution(path: Path, *, t_0: float = 0.0, placing: Placing = NOWHERE) -> ForeignSolution:
    """Read the solution in a file.

    Parameters
    ----------
    path : Path
        ``.csv``, ``.parquet`` or ``.mat`` with the columns of `COLUMNS`: time and at least one other kind;
        the ``.nav`` of KF-GINS, with its ``STD.txt`` if that is beside it; or a trajectory or the fixes of a
        receiver (`bench.io.foreign.solution_rows`).
    t_0 : float
        Time in the file at the start of the run [s].
    placing : Placing
        Where positions in a local frame are.

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
    if not stat.S_ISREG(kind) and not recognizes(path):
        raise ConfigError(f"{shown}: not a regular file")
    if (foreign := read_foreign_rows(path)) is not None:
        if not foreign.frame:
            reject_placing(shown, frame=placing.frame, origin=placing.origin)
        solution = make_solution(foreign, shown, placing)
        return replace(solution, t=solution.t - t_0)
    if path.suffix.lower() == ".nav":
        table = read_kf_gins_solution(path)
    else:
        aliases, structure = _find_names(path)
        table = read_table(path, _ALL, _OPTIONAL, MOST_ROWS, aliases, _MOST_VALUES, structure)
        table.check_groups(_ALL, shown)
        _check_deviations(table, shown)
    reject_placing(shown, frame=placing.frame, origin=placing.origin)
    clock = WEEK_CLOCK if path.suffix.lower() == ".nav" else ""
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
        clock=clock,
    )


_PYTHON_INS = {
    "time_s": "time", "lat_deg": "lat", "lon_deg": "lon", "alt_m": "alt", "vel_n_mps": "VN",
    "vel_e_mps": "VE", "vel_d_mps": "VD", "roll_deg": "roll", "pitch_deg": "pitch", "heading_deg": "heading",
}  # fmt: skip
_NAVEGO = {
    "time_s": "t", "lat_rad": "lat", "lon_rad": "lon", "alt_m": "h", "vel_n_mps": "vel.1",
    "vel_e_mps": "vel.2", "vel_d_mps": "vel.3", "roll_rad": "roll", "pitch_rad": "pitch", "yaw_rad": "yaw",
}  # fmt: skip


def _find_names(path: Path) -> tuple[Mapping[str, str], str | None]:
    """Return names of columns of python-ins or NaveGo, and the structure of a MATLAB file with a solution.

    Raises
    ------
    ConfigError
        If more than one structure of the file can be the solution.
    """
    if path.suffix.lower() not in (".parquet", ".mat") or path.stat().st_size > MOST_BYTES:
        return {}, None
    names = list_columns(path)
    if set(_PYTHON_INS.values()) <= set(names):
        return _PYTHON_INS, None
    fields: dict[str, set[str]] = {}
    for name in names:
        fields.setdefault(name.partition(".")[0], set()).add(name.partition(".")[2])
    for aliases, wanted in ((_NAVEGO, set(_NAVEGO.values())), ({}, {"t_s", "lat_rad", "q_nb_w"})):
        found = [name for name, those in fields.items() if wanted <= those]
        found = [name for name in found if name not in ("ref", "truth")] or found
        if len(found) > 1:
            raise ConfigError(f"{path.name}: more than one solution: {', '.join(found)[:200]}; export one")
        if found:
            return aliases, found[0]
    return {}, None


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


class FileEstimator:
    """A filter that returns the solution in a file: ``use = "file:solution.csv"``."""

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
