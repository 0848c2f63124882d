"""The verb new log: look at a recorded file and write a first LOG.toml."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator, Mapping
from pathlib import Path

import numpy as np
from rich.console import Console

from bench import durable
from bench.config.log import LogSpec, load_log
from bench.errors import ConfigError
from bench.evaluation.motion_checks import SHIFT_OFF
from bench.evaluation.recorded_motion import RecordedMotion
from bench.evaluation.validity import check_recording
from bench.exchange.exports.column_files import START
from bench.exchange.log_records import LogRecords, read_records
from bench.exchange.mat_file import list_structures, read_mat
from bench.exchange.sensor_search import TEXT, Found, find_tables, find_texts
from bench.files import check_file, read_json
from bench.navigation.start.course import LEAST_SPEED
from bench.wording import one_line, quote_toml

_CONFIGURATIONS = "*.yaml"  # of KF-GINS
_BAG = "metadata.yaml"  # in the folder of a ROS 2 bag
_SEVERAL = (".ulg", ".bag", ".db3", ".mcap")  # hold several sensors and name their own columns
_DATASHEETS = {"imu": "adis16475", "gnss": "l1-code", "baro": "bmp388"}
_REP_103 = (".bag", ".db3", ".mcap", "")  # whose axes are forward, left, up; a folder is a bag
_MOST_CONFIGURATION = 1_000_000  # [byte]
_CLOCKS = (("gnss", "velocity_offset_s", "velocity_shift_s"), ("imu", "time_offset_s", "imu_shift_s"))
_ALIGNS = 10.0  # that an alignment takes [s]
_SHARE = 0.25  # of a short record that passes before it is judged


def new_log(name: str, *, console: Console) -> None:
    """Look at a recorded file and those beside it, and write a log that ``bench navigate`` accepts.

    Parameters
    ----------
    name : str
        A table with the columns of an IMU, whose fixes are in it or in a table beside it; the increments of
        KF-GINS, with its fixes beside them; or a ULog, a bag or an MCAP file. The log, ``FILE.toml``, is
        written beside it.

    Raises
    ------
    ConfigError
        If the log is there already, a sensor is not found, or what was guessed cannot be read; nothing is
        written then.
    """
    path = Path(name)
    if path.is_dir() and not any(path.glob(_BAG)):
        raise ConfigError(f"{path}: a folder; name the file in it with the IMU")
    log = path.with_suffix(".toml")
    if log.exists() or log.is_symlink():
        raise ConfigError(f"{log}: exists already and is not replaced")
    if not path.exists():
        raise ConfigError(f"{path}: no such file")
    if path.is_dir() or path.suffix.lower() in _SEVERAL:
        found = {kind: Found(path, {}, ()) for kind in ("imu", "gnss")}
    elif path.suffix.lower() == TEXT:
        found = find_texts(path)
    else:
        found = find_tables(path)
    antenna = _read_antenna(found["gnss"])
    clocks: dict[str, str] = {}
    try:
        records = _try_log(log, found, antenna, clocks)
        last = float(records.imu.t.max())
        rest = None if _gives_a_course(records) else min(max(_SHARE * last, _ALIGNS), 60.0)
        text = _write_log(path.stem, found, antenna, clocks, rest)
        if last <= 60.0 / (1.0 - _SHARE):  # the default of from_s is late in it, or after it
            text += f"\n[evaluation]\nfrom_s = {_SHARE * last if rest is None else rest + 3.0:.1f}\n"
        durable.write(log, text)
    except UnicodeEncodeError as error:  # a name of the disk that is not UTF-8
        wrong = one_line(error.object[error.start : error.end + 20])
        raise ConfigError(f"{path}: a log cannot name what is not UTF-8, {wrong!r}; rename it") from None
    except BaseException:
        log.unlink(missing_ok=True)
        raise
    for kind, one in found.items():
        named = ", ".join(f"{ours} from {theirs}" for ours, theirs in one.columns.items() if ours != theirs)
        within = f", structure {one.structure}" if one.structure else ""
        console.print(f"{kind}: {one.path.name}{within}{': ' if named else ''}{named}", soft_wrap=True)
        for line in one.guessed:
            console.print(f"  {line}", soft_wrap=True)
        if kind in clocks:
            console.print(f"  {clocks[kind]}", soft_wrap=True)
    console.print(f"Wrote {log}. Lines with a question are for you.")
    console.print(f"Next: bench navigate {log}")


def _try_log(
    log: Path, found: Mapping[str, Found], antenna: tuple[list[float], str] | None, clocks: dict[str, str]
) -> LogRecords:
    """Write the log and read what it names.

    Into ``clocks`` goes by how much the times of a sensor are wrong, as its line of the log, if the motion
    shows it: first those of velocities, by the positions, then those of the IMU, by the velocities.
    """
    spec, records = _read_back(log, _write_log(log.stem, found, antenna, clocks))
    for kind, key, name in _CLOCKS:
        checks = check_recording(records.imu, records.fixes, None, np.asarray(spec.antenna_b))
        off = next((one.value for one in checks if one.name == name and not one.good), None)
        if off is not None:
            clocks[kind] = f"{key} = {off:+.3f}  # by the motion: right?"
            spec, records = _read_back(log, _write_log(log.stem, found, antenna, clocks))
    return records


def _gives_a_course(records: LogRecords) -> bool:
    """Tell whether it moves fast enough for a course, for long enough."""
    t, _, vel_n = RecordedMotion.from_records(records.imu, records.fixes).take_velocities()
    moving = t[np.hypot(vel_n[:, 0], vel_n[:, 1]) > LEAST_SPEED]
    return bool(np.ptp(moving) > _ALIGNS) if len(moving) else False


def _read_back(log: Path, text: str) -> tuple[LogSpec, LogRecords]:
    """Write the log; return what it says, and the records it names."""
    durable.write(log, text)
    spec = load_log(str(log))
    return spec, read_records(spec)


def _read_antenna(fixes: Found) -> tuple[list[float], str] | None:
    """Return where the antenna is [m], b, and what says so: an export of the bench, or a file of NaveGo."""
    path, says = fixes.path, START
    try:
        if path.suffix.lower() == ".mat":
            structures = list_structures(read_mat(path))
            exported = "start" in structures
            holder, field = ("start", "antenna_b_m") if exported else (fixes.structure, "larm")
            says, place = f"{holder}.{field}", structures[holder][field]
        elif fixes.form:
            says, place = next(_list_levers(path.parent))
        else:
            place = read_json(path.parent / START)["antenna_b_m"]
        x, y, z = (float(value) for value in place)
    except (ConfigError, OSError, KeyError, StopIteration, TypeError, ValueError):
        return None
    return ([x, y, z], says) if np.isfinite([x, y, z]).all() else None


def _list_levers(folder: Path) -> Iterator[tuple[str, list[str]]]:
    """Yield the configurations of KF-GINS in a folder, and where they say the antenna is."""
    for path in sorted(one for one in folder.glob(_CONFIGURATIONS) if one.is_file()):
        check_file(path, path.name, _MOST_CONFIGURATION)
        line = re.search(r"^antlever:\s*\[(.*?)\]", path.read_text(encoding="utf-8"), re.MULTILINE)
        if line is not None:
            yield path.name, line[1].split(",")


def _write_log(
    title: str,
    found: Mapping[str, Found],
    antenna: tuple[list[float], str] | None,
    clocks: Mapping[str, str],
    rest: float | None = None,
) -> str:
    """Return the text of the log; what a file cannot say is a comment that asks.

    ``rest`` [s]: it does not move, and so much of it is for the alignment.
    """
    lines = [f"title = {quote_toml(title)}"]
    asked = {
        "imu": [
            "# roll, pitch, yaw of its axes against forward, right, down?  mounting_deg = [0.0, 0.0, 0.0]",
            "# from the same point as the antenna?                        position_m = [0.0, 0.0, 0.0]",
        ],
        "gnss": ["# where is its antenna: forward, right, down?  position_m = [0.0, 0.0, 0.0]"],
        "baro": [],
    }
    if antenna is not None:
        place, says = antenna
        asked["gnss"] = [f"position_m = {json.dumps(place)}  # by {one_line(says)}"]
    if found["imu"].path.suffix.lower() in _REP_103:
        text = "# its axes are those of REP 103, forward, left, up?          mounting_deg = [180.0, 0.0, 0.0]"
        asked["imu"][0] = text
    for kind, one in found.items():
        lines += ["", f"[{kind}]", f"file = {quote_toml(one.path.name)}"]
        if one.form:
            lines.append(f"format = {quote_toml(one.form)}")
        if one.structure:
            lines.append(f"topic = {quote_toml(one.structure)}")
        lines += [f"# or topic = {quote_toml(other)}?" for other in one.others]
        aliases = {ours: theirs for ours, theirs in one.columns.items() if ours != theirs}
        if aliases:
            listed = ", ".join(f"{ours} = {quote_toml(theirs)}" for ours, theirs in aliases.items())
            lines.append(f"columns = {{ {listed} }}")
        lines += [f"# {one_line(line)}: right?" for line in one.guessed] + asked[kind]
        lines += [clocks[kind]] if kind in clocks else []
    lines += ["", "[sensors.assumed]  # which units? bench list sensors"]
    lines += [f'{kind} = "{_DATASHEETS[kind]}"' for kind in found]
    lines += ["", "[alignment]"]
    if rest is None:
        lines += ['kind = "course"  # "level" if it stands for a minute before it moves?']
    else:
        lines += ['kind = "level"  # it does not move fast enough for a course', f"duration_s = {rest:.1f}"]
    if "imu" in clocks:  # what is left of it is a state
        options = f"{{ time_offset_sd = {SHIFT_OFF:g} }}"
        lines += [
            "",
            "[[estimator]]",
            'use = "loose-15"',
            f"options = {options}  # of that clock",
        ]
    return "\n".join(lines) + "\n"
