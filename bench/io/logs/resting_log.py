"""Read the log of an IMU at rest, in one pose or in several, to measure its errors."""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from bench.core.mathematics.arrays import FloatArray, IntArray
from bench.core.mathematics.units import STANDARD_GRAVITY, split_unit
from bench.core.words.exceptions import ConfigError
from bench.evaluation.motion.noise_curves import INDEPENDENT
from bench.evaluation.motion.pose_fit import FEWEST_POSES, count_poses, find_rests
from bench.io.config.log import load_log
from bench.io.logs.log_records import MISSING, read_rows
from bench.io.logs.table_files import find_first, group, list_columns, read_table

FEWEST = 2 * INDEPENDENT
"""Fewest rows: the shortest averaging time needs them."""
MOST_ROWS = 20_000_000
"""Most rows: 55 hours at 100 Hz."""
_TRIADS = {
    "gyro": (group("rate", "gyro_x", "gyro_y", "gyro_z"),),
    "accel": (group("acceleration", "accel_x", "accel_y", "accel_z"),),
}
_MOVED = {"gyro": (0.05, "rad/s"), "accel": (0.5, "m/s^2")}
"""Standard deviation of 1 s means of an axis above which an IMU was not at rest."""
_LONGEST_STEP = 1.0  # [s]
_SHORTEST_PIECE = 1.0  # of a rest between gaps, where there are several poses [s]
_UNEVEN, _SHARE = 0.25, 0.2  # steps that differ by this from the usual one, and part of them
_PIECE = 0.1  # part of a record in one pose that has to be without a gap
_STUCK = 0.1  # part of a record in which an axis does not change
_FINE = 0.58  # scatter over step of a rounded axis: where its noise is half a step, noise and rounding add up
_MANY, _CLIPPED = 50, 0.005  # distinct values, and part of them at an end, from which an axis is saturated
_FEW = 200  # distinct values below which an axis may be rounded
_OFF = 1.0  # of the mean specific force from gravity [m/s^2]
_NO_FORCE = 0.5  # of a record without gravity, whose noise can be measured in one pose [m/s^2]
_ONE = 0.1  # distance of the mean specific force from 1 within which it is in g
_TEMPERATURE = {"temperature": (group("temperature", "temperature"),)}
_Read = tuple[str, FloatArray, Mapping[str, FloatArray], FloatArray | None]


@dataclass(frozen=True, slots=True)
class RestingLog:
    """The samples of an IMU at rest, and of its turns between several rests."""

    t: FloatArray  # (N,) [s]
    triads: Mapping[str, FloatArray]  # rates (N, 3) of "gyro" and "accel" in SI
    temperature: FloatArray | None  # (N,) [degC]
    rests: tuple[slice, ...]  # rows of each rest, without a gap
    posed: bool  # it rests in several poses
    gaps: IntArray  # (K,) rows before which samples are missing


def read_resting_log(path: Path) -> RestingLog:
    """Return the samples of an IMU that rests in one pose, or in six poses or more.

    Parameters
    ----------
    path : Path
        Table with a header (CSV, Parquet or MATLAB): ``t_s`` and one or both triads, ``gyro_x_rad_s``,
        ``gyro_y_rad_s``, ``gyro_z_rad_s`` (or ``deg_s``, ``deg_h``), ``accel_x_m_s2`` ... (or ``g``, ``mg``):
        rates, not increments; and ``temperature_degc`` if the temperature is known. Other columns are not
        read. Or the ``.toml`` of a log, whose IMU is read.

    Raises
    ------
    ConfigError
        If the file is missing, is not such a table, has irregular times, is too short, seems to be in g, or
        the IMU moves and does not rest in six poses. The message names file and row; row 1 is the first
        below the header.
    """
    shown, t, triads, temperature = _read_log(path) if path.suffix == ".toml" else _read_columns(path)
    if not triads:
        raise ConfigError(f"{shown}: no column 'gyro_x_rad_s' or 'accel_x_m_s2' with its y and z")
    if len(t) < FEWEST:
        raise ConfigError(f"{shown}: {len(t)} samples; at least {FEWEST} are needed")
    for name, values in (("t_s", t[:, None]), *triads.items(), ("temperature", temperature)):
        bad = None if values is None else ~np.isfinite(values.reshape(len(t), -1)).all(axis=1)
        if bad is not None and (k := find_first(bad)) is not None:
            raise ConfigError(f"{shown}: row {k + 1}: a value of {name} is not finite; cut the record there")
    steps = np.diff(t)
    step = float(np.median(steps))
    if (k := find_first(steps <= 0.0)) is not None:
        raise ConfigError(
            f"{shown}: row {k + 2}: t_s does not increase, it steps by {steps[k]:.6g} s; cut the record there"
        )
    if step > _LONGEST_STEP:
        expected = f"expected above 0 to {_LONGEST_STEP:g} s: convert it to s"
        raise ConfigError(f"{shown}: steps of t_s are {step:g} s; {expected}")
    if np.mean(np.abs(steps - step) > _UNEVEN * step) > _SHARE:
        low, high = np.quantile(steps, [0.05, 0.95])
        raise ConfigError(f"{shown}: steps of t_s are uneven, {low:.3g} to {high:.3g} s; record at one rate")
    gaps = np.flatnonzero(np.abs(steps - step) > (MISSING - 1.0) * step) + 1
    rests = _find_rests(triads, step, shown)
    posed = len(rests) > 1
    pieces = [piece for rest in rests for piece in _divide(rest, gaps)]
    if posed:
        pieces = [one for one in pieces if _count(one) * step >= _SHORTEST_PIECE]
        found, needed = _count_poses(triads, pieces), FEWEST_POSES
        rest = f"{found} poses have {_SHORTEST_PIECE:g} s without a gap, {needed} are needed"
    else:
        pieces = [max(pieces, key=_count)]
        found, needed = _count(pieces[0]), max(FEWEST, round(_PIECE * len(t))) if len(gaps) else 0
        rest = f"the longest piece has {found} rows, {needed} are needed"
    if found < needed:
        raise ConfigError(
            f"{shown}: samples are missing before {len(gaps)} rows, the first is row {gaps[0] + 1}; {rest}; "
            "record again without gaps"
        )
    return RestingLog(t, triads, temperature, tuple(pieces), posed, gaps)


def _divide(rest: slice, gaps: IntArray) -> list[slice]:
    """Return the pieces of a rest between gaps."""
    ends = [rest.start, *gaps[(gaps > rest.start) & (gaps < rest.stop)].tolist(), rest.stop]
    return [slice(first, last) for first, last in itertools.pairwise(ends)]


def _count(rows: slice) -> int:
    return int(rows.stop - rows.start)


def _count_poses(triads: Mapping[str, FloatArray], rests: Sequence[slice]) -> int:
    return count_poses([triads["accel"][one].mean(axis=0) for one in rests if "accel" in triads])


def has_own_columns(path: Path) -> bool:
    """Return whether a table has the columns of `read_resting_log`; True for a missing file, reported later.

    Raises
    ------
    ConfigError
        If a file with the ending of a table cannot be read.
    """
    if path.suffix.lower() not in (".csv", ".parquet", ".mat") or not path.is_file():
        return not path.is_file()
    names = [split_unit(name)[0] for name in list_columns(path)]
    rates, increments = ("gyro_", "accel_"), ("dtheta_", "dvel_")
    own = [any(name.startswith(heads) for name in names) for heads in (rates, increments)]
    return "t" in names and own == [True, False]


def _read_columns(path: Path) -> _Read:
    """Return the name of a table, its times, its triads and its temperature if it has one."""
    kinds = {"time": (group("clock", "t"),), **_TRIADS, **_TEMPERATURE}
    table = read_table(path, kinds, (*_TRIADS, *_TEMPERATURE), MOST_ROWS)
    table.check_groups(_TRIADS, path.name)
    triads = {name: table.columns[name] for name in _TRIADS if name in table.columns}
    temperature = table.columns["temperature"][:, 0] if "temperature" in table.columns else None
    return path.name, table.columns["time"][:, 0], triads, temperature


def _read_log(path: Path) -> _Read:
    """Return name, times and triads of the IMU of a log, in its own axes."""
    spec = load_log(str(path))
    rows = read_rows(spec.imu, "imu")
    steps = np.diff(rows.t, prepend=2.0 * rows.t[0] - rows.t[1])[:, None]
    usual = float(np.median(steps))
    steps[steps > MISSING * usual] = usual  # an increment is of one sample, as in `read_records`
    triads = {
        name: rows.values[name] if name in rows.values else rows.values[increments] / steps
        for name, increments in (("gyro", "dtheta"), ("accel", "dvel"))
    }
    return spec.imu.path.name, rows.t, triads, None


def _find_rests(triads: Mapping[str, FloatArray], step: float, shown: str) -> tuple[slice, ...]:
    """Return the rows of each rest; ConfigError if the IMU moves in one pose, or seems to be in g."""
    for name, rates in triads.items():
        _check_values(name, rates, shown)
    count = max(1, round(1.0 / step))
    rests: tuple[slice, ...] = (slice(0, len(next(iter(triads.values())))),)
    for name, rates in triads.items():
        many = min(count, len(rates) // 8)
        means = rates[: len(rates) // many * many].reshape(-1, many, 3).mean(axis=1)
        most, unit = _MOVED[name]
        axis = int(np.argmax(means.std(axis=0)))
        if (sd := float(means[:, axis].std())) > most:
            rests = tuple(find_rests(triads, step))
            lacks = "" if "accel" in triads else ", without accelerometers"
            poses = _count_poses(triads, rests)
            if poses < FEWEST_POSES:
                raise ConfigError(
                    f"{shown}: {name}_{'xyz'[axis]} moves: its means over 1 s have a standard deviation of "
                    f"{sd:.2g} {unit}, expected {most:g} or less; record the IMU at rest, or for 5 s in each "
                    f"of {FEWEST_POSES} poses 20 deg apart (found: {poses}{lacks})"
                )
            break
    if "accel" in triads:
        force = float(np.mean([np.linalg.norm(triads["accel"][one].mean(axis=0)) for one in rests]))
        if abs(force - STANDARD_GRAVITY) > _OFF and (force > _NO_FORCE or len(rests) > 1):
            why = "if the values are in g, name the columns accel_x_g, y and z"
            if abs(force - 1.0) > _ONE:
                why = "name the columns by their unit, accel_x_m_s2 or accel_x_g, and leave gravity in them"
            raise ConfigError(
                f"{shown}: the mean specific force is {force:.3g} m/s^2, at rest it is 9.8: {why}"
            )
    return rests


def _check_values(name: str, rates: FloatArray, shown: str) -> None:
    """Raise ConfigError if an axis keeps a value for a large part of the record, or is rounded coarsely."""
    for axis, column in zip("xyz", rates.T, strict=True):
        changes = np.flatnonzero(np.diff(column) != 0.0)
        ends = np.concatenate(([-1], changes, [len(column) - 1]))
        longest = int(np.argmax(np.diff(ends)))
        first, last = int(ends[longest]) + 2, int(ends[longest + 1]) + 1
        if last - first + 1 > _STUCK * len(column):
            what = f"{name}_{axis} does not change from row {first} to {last}"
            raise ConfigError(f"{shown}: {what}; cut the record there, or leave the {name} columns out")
        values, counts = np.unique(column, return_counts=True)
        if len(values) > _MANY and max(counts[0], counts[-1]) > max(20, _CLIPPED * len(column)):
            k = 0 if counts[0] > counts[-1] else -1
            raise ConfigError(
                f"{shown}: {name}_{axis} has its {'largest' if k else 'smallest'} value, {values[k]:.6g} "
                f"{_MOVED[name][1]}, in {counts[k]} of {len(column)} rows, so it seems saturated; record "
                "with a larger range"
            )
        step = float(np.median(np.diff(values))) if len(values) < _FEW else 0.0
        if (sd := float(np.diff(column).std()) / np.sqrt(2.0)) < _FINE * step:
            what = f"{name}_{axis} has steps of {step:.3g}, and scatters by {sd:.2g} {_MOVED[name][1]} only"
            raise ConfigError(f"{shown}: {what}: rounding hides its noise; record more digits")
