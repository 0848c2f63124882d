"""Trajectories of reference systems and data sets: TUM, EuRoC, KITTI and SBET, recognized by their content.

TUM: rows ``t x y z qx qy qz qw`` of cvg.cit.tum.de/data/datasets/rgbd-dataset/file_formats. EuRoC: the CSV of
state_groundtruth_estimate0 with its header. KITTI oxts: 30 values as in dataformat.txt of the raw data (roll
positive with the left side up, pitch with the front down, yaw counterclockwise from east). KITTI odometry:
twelve values, a matrix 3 x 4, of the left camera. SBET: 17 doubles per row, time to z angular rate; the true
heading is the platform heading minus the wander angle.
"""

from __future__ import annotations

from datetime import date
from pathlib import Path
from typing import NamedTuple

import numpy as np

from bench.core.files.file_checks import check_file
from bench.core.mathematics import earth, rotation
from bench.core.mathematics.arrays import FloatArray
from bench.core.words.exceptions import ConfigError
from bench.io.logs.file_kinds import HEAD, SBET, SBET_COLUMNS, is_kind
from bench.io.logs.formats.text import parse_row, read_lines, read_number_rows
from bench.io.logs.rows import MOST_ROWS, LogRows
from bench.io.logs.table_files import MOST_BYTES
from bench.simulation.signals.gps_time import gps_seconds, leap_seconds

GPS, WEEK_CLOCK, ANY = "gps", "week", ""
"""What the times of a file count: GPS seconds since 1980-01-06, seconds of a GPS week, or unknown."""
_TUM, _EUROC, _OXTS, _KITTI = "tum", "euroc", "oxts", "kitti"
_WIDTHS = {8: _TUM, 12: _KITTI, 30: _OXTS}
_FRAMES = {_TUM: "enu-flu", _EUROC: "enu-frd", _KITTI: "rdf-rdf"}
_TIMES = "timestamps.txt"
_LOOK = 5  # rows by which a text is recognized
_NORM_OFF = 1e-2  # of a unit quaternion or the rows of a rotation matrix [1]
_MATCH = (0.5, 0.05)  # velocity against the change of position: [m/s] plus a part of the speed [1]


class PoseRows(NamedTuple):
    """Rows of a trajectory; positions are ``lla`` or, in a local frame, ``pos_l``, ``vel_l`` and ``q_lb``."""

    rows: LogRows
    clock: str
    frame: str = ""  # of local positions, such as "enu-flu"; empty: geodetic
    origin: tuple[float, ...] = ()  # latitude, longitude [deg], height [m] of the local frame, if known


def recognizes(path: Path) -> bool:
    """Return whether the content of a file or folder is a trajectory that this module reads."""
    return bool(_identify(path))


def read(form: str, path: Path, kind: str, topic: str | None) -> LogRows:
    """Read geodetic positions of a trajectory as the rows of a receiver."""
    if kind != "gnss":
        use = "use it in [reference] of a log or in bench score"
        raise ConfigError(f"{path.name}: no {kind.upper()} is read from a trajectory; {use}")
    found = read_poses(path)
    if found.frame:
        raise ConfigError(
            f"{path.name}: positions in a local frame are no fixes; use them in [reference] or bench score"
        )
    return found.rows


def read_poses(path: Path) -> PoseRows:
    """Read a trajectory.

    Raises
    ------
    ConfigError
        If the file cannot be read, or is none of these formats: one line.
    """
    try:
        check_file(path, path.name, MOST_BYTES)
        kind = _identify(path)
        if kind == _OXTS:
            return _read_oxts(path)
        if kind == SBET:
            return _read_sbet(path)
    except OSError as error:
        raise ConfigError(f"{path.name}: {error.strerror or error}") from None
    if not kind:
        raise ConfigError(f"{path.name}: not a trajectory of TUM (t x y z qx qy qz qw), EuRoC, KITTI or SBET")
    numbers = read_number_rows(path)
    if kind == _KITTI:
        return _read_kitti(path, numbers)
    if numbers.shape[1] < 8:
        raise ConfigError(f"{path.name}: a pose has 8 numbers or more; rows have {numbers.shape[1]}")
    scale = 1e-9 if kind == _EUROC else 1.0
    q = numbers[:, 4:8]
    values = {"pos_l": numbers[:, 1:4], "q_lb": q if kind == _EUROC else rotation.from_scalar_last(q)}
    if numbers.shape[1] >= 11:
        values["vel_l"] = numbers[:, 8:11]
    frame, origin = _read_origin(path, _FRAMES[kind])
    return PoseRows(LogRows(numbers[:, 0] * scale, values), ANY, frame, origin)


# --- recognition --------------------------------------------------------------------------------------


def _identify(path: Path) -> str:
    """Return the kind of a trajectory, empty if it is none."""
    if path.is_dir():
        return _OXTS if _find_oxts(path) is not None else ""
    if not path.is_file():  # to open a pipe would wait for its writer
        return ""
    if is_kind(SBET, path):
        return SBET
    try:
        with path.open("rb") as file:
            head = file.read(HEAD)
        lines = head.decode("utf-8-sig").splitlines()
    except (OSError, UnicodeDecodeError):
        return ""
    if lines and "p_RS_R_x" in lines[0] and "q_RS_w" in lines[0]:
        return _EUROC
    if len(head) == HEAD:
        lines = lines[:-1]  # it may be incomplete
    try:
        rows = [
            parse_row(line) for line in lines if line.strip() and not line.lstrip().startswith(("#", "%"))
        ]
    except ValueError:
        return ""
    rows = rows[:_LOOK]
    if not rows or len({len(row) for row in rows}) > 1:
        return ""
    kind = _WIDTHS.get(len(rows[0]), "")
    return kind if kind and _fits(kind, np.array(rows)) else ""


@np.errstate(all="ignore")  # of damaged numbers
def _fits(kind: str, rows: FloatArray) -> bool:
    """Return whether rows of numbers can be of a kind."""
    if kind == _OXTS:
        return bool((np.abs(rows[:, :2]) <= [90.0, 180.0]).all() and (np.abs(rows[:, 3:6]) < 7.0).all())
    if kind == _TUM:
        return bool((np.abs(np.linalg.norm(rows[:, 4:], axis=1) - 1.0) < _NORM_OFF).all())
    C = rows.reshape(-1, 3, 4)[:, :, :3]
    return bool((np.abs(C @ C.transpose(0, 2, 1) - np.eye(3)) < _NORM_OFF).all())


def _find_oxts(folder: Path) -> Path | None:
    """Return the folder with the times of KITTI oxts: this one, or ``oxts`` in it."""
    places = (folder, folder / "oxts")
    return next((one for one in places if (one / _TIMES).is_file() and (one / "data").is_dir()), None)


def _read_origin(path: Path, frame: str) -> tuple[str, tuple[float, ...]]:
    """Return frame and origin by the first line, a comment as ``bench export --to tum`` writes it."""
    first = next(read_lines(path), "")
    words = dict(word.split("=", 1) for word in first.split() if "=" in word) if first.startswith("#") else {}
    try:
        origin = tuple(float(words[name]) for name in ("origin_lat_deg", "origin_lon_deg", "origin_alt_m"))
    except (KeyError, ValueError):
        return frame, ()
    return words.get("frame", frame), origin


# --- formats ------------------------------------------------------------------------------------------


def _read_kitti(path: Path, numbers: FloatArray) -> PoseRows:
    """Return poses of KITTI odometry with the times of a file beside them."""
    sequence = path.parent.parent / "sequences" / path.stem / "times.txt"
    places = (path.with_name(f"{path.stem}_times.txt"), path.with_name("times.txt"), sequence)
    times = next((place for place in places if place.is_file()), None)
    if times is None:
        raise ConfigError(
            f"{path.name}: poses of KITTI have no times; put times.txt, a second per row, beside the file"
        )
    t = read_number_rows(times)[:, 0]
    if len(t) != len(numbers):
        raise ConfigError(f"{times.name}: {len(t)} times for {len(numbers)} poses of {path.name}")
    T = numbers.reshape(-1, 3, 4)
    if not np.isfinite(T).all():
        raise ConfigError(f"{path.name}: a value is not a finite number")
    return PoseRows(
        LogRows(t, {"pos_l": T[:, :, 3], "q_lb": rotation.from_matrix(T[:, :, :3])}), ANY, _FRAMES[_KITTI]
    )


def _read_oxts(path: Path) -> PoseRows:
    """Return the rows of OXTS units in KITTI: a folder with a file per row, or all rows in one file."""
    folder = _find_oxts(path) if path.is_dir() else path.parent
    assert folder is not None
    if path.is_dir():
        files = sorted((folder / "data").glob("*.txt"))
        if len(files) > MOST_ROWS:
            raise ConfigError(f"{path.name}: more than {MOST_ROWS} rows")
        rows = [_read_one(file) for file in files]
        if not rows or len({len(row) for row in rows}) > 1:
            raise ConfigError(f"{path.name}: each file in data must have one row of 30 numbers")
        numbers = np.array(rows)
    else:
        numbers = read_number_rows(path)
    if not (folder / _TIMES).is_file():
        raise ConfigError(f"{path.name}: rows of KITTI oxts have no times; put {_TIMES} beside the file")
    t = np.array(
        [_parse_time(line, folder / _TIMES, k) for k, line in enumerate(read_lines(folder / _TIMES), 1)]
    )
    if len(t) != len(numbers):
        raise ConfigError(f"{_TIMES}: {len(t)} times for {len(numbers)} rows of {path.name}")
    if numbers.shape[1] != 30:
        raise ConfigError(f"{path.name}: rows of KITTI oxts have 30 numbers; these have {numbers.shape[1]}")
    roll, pitch, yaw = numbers[:, 3:6].T
    values = {
        "lla": np.column_stack([np.deg2rad(numbers[:, :2]), numbers[:, 2]]),
        "vel_n": np.column_stack([numbers[:, 6:8], -numbers[:, 10]]),
        "q_nb": rotation.from_euler(roll, -pitch, 0.5 * np.pi - yaw),
    }
    note = f"{path.name}: its times are taken as UTC; KITTI names no time zone"
    return PoseRows(LogRows(t, values, (note,)), GPS)


def _read_one(file: Path) -> list[float]:
    try:
        return parse_row(next(read_lines(file), ""))
    except ValueError:
        raise ConfigError(f"{file.name}: not a row of numbers") from None


def _parse_time(line: str, path: Path, row: int) -> float:
    """Return the GPS seconds of a date and time in UTC, such as 2011-09-26 13:02:25.964389445."""
    try:
        day, clock = line.split()
        at = date.fromisoformat(day)
        hours, minutes, seconds = (float(part) for part in clock.split(":"))
    except ValueError:
        raise ConfigError(f"{path.name}: row {row}: {line.strip()[:40]!r} is not a date and time") from None
    return gps_seconds(at.year, at.month, at.day, 3600.0 * hours + 60.0 * minutes + seconds) + leap_seconds(
        at
    )


def _read_sbet(path: Path) -> PoseRows:
    """Return the rows of an SBET; times are in seconds of the GPS week."""
    size = path.stat().st_size
    count, rest = divmod(size, 8 * SBET_COLUMNS)
    if count > MOST_ROWS:
        raise ConfigError(f"{path.name}: more than {MOST_ROWS} rows")
    rows = np.fromfile(path, "<f8", count * SBET_COLUMNS).astype(float).reshape(-1, SBET_COLUMNS)
    notes = [f"{path.name}: ends within a row, which is left out"] if rest else []
    with np.errstate(all="ignore"):  # damaged numbers are left out later
        good = np.isfinite(rows[:, :11]).all(axis=1) & (np.abs(rows[:, 1]) <= 0.5 * np.pi)
        good &= (np.abs(rows[:, 2]) <= 2.0 * np.pi) & (np.abs(rows[:, 3]) < 1e5)
        good &= (np.abs(rows[:, 4:11]) < 1e4).all(axis=1) & (rows[:, 0] >= 0.0) & (rows[:, 0] < 1e7)
    if not good.all():
        notes.append(
            f"{path.name}: {np.count_nonzero(~good)} of {count} rows left out: a value is impossible"
        )
        rows = rows[good]
    t, lla, wander = rows[:, 0], rows[:, 1:4], rows[:, 10]
    values = {"lla": lla}
    vel_n = _turn_velocity(t, lla, rows[:, 4:7], wander)
    if vel_n is None:
        notes.append(f"{path.name}: its velocities are not the change of its positions, and are not used")
    else:
        values["vel_n"] = vel_n
    if rows[:, 7:10].any():
        values["q_nb"] = rotation.from_euler(rows[:, 7], rows[:, 8], rows[:, 9] - wander)
    else:
        notes.append(f"{path.name}: roll, pitch and heading are 0 in all rows, and are not used")
    return PoseRows(LogRows(t, values, tuple(notes)), WEEK_CLOCK)


def _turn_velocity(t: FloatArray, lla: FloatArray, vel: FloatArray, wander: FloatArray) -> FloatArray | None:
    """Return velocities in the wander frame turned to n; None if they contradict the positions.

    The change of the positions shows whether y points right or left, and z down or up.
    """
    if len(t) < 2:
        return None
    step = np.diff(t)
    known = step > 0
    if not known.any():
        return None
    moved = -earth.difference_n(lla[:-1], lla[1:])[known] / step[known, None]
    most = _MATCH[0] + _MATCH[1] * float(np.median(np.linalg.norm(moved, axis=1)))
    cos, sin = np.cos(wander), np.sin(wander)
    for side, down in ((1.0, 1.0), (-1.0, -1.0), (1.0, -1.0)):
        x, y = vel[:, 0], side * vel[:, 1]
        vel_n = np.column_stack([x * cos + y * sin, y * cos - x * sin, down * vel[:, 2]])
        mean = 0.5 * (vel_n[1:] + vel_n[:-1])[known]
        if float(np.median(np.linalg.norm(mean - moved, axis=1))) < most:
            return vel_n
    return None
