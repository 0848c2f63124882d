"""The verb new log: look at a recorded file and write a first LOG.toml."""

from __future__ import annotations

import datetime
import itertools
import json
from collections.abc import Mapping
from pathlib import Path

import numpy as np
from rich.console import Console

from bench.cli.new_files.log_changes import change_axes
from bench.cli.new_files.log_starts import ChosenStart, choose_start
from bench.cli.new_files.log_text import DATASHEETS, read_antenna, write_log
from bench.core.files import durable
from bench.core.mathematics.units import split_unit
from bench.core.words.exceptions import ConfigError
from bench.core.words.wording import one_line, quote_toml
from bench.evaluation.motion.recorded_motion import Check, RecordedMotion
from bench.evaluation.motion.rest_noise import assume_vibration
from bench.evaluation.motion.validity import check_recording
from bench.io.config.log import LogSpec, load_log
from bench.io.log_formats import FORMATS, find_format, guess_format
from bench.io.logs import formats, found_datasheets, own_estimate
from bench.io.logs.exporter_names import FORWARD_LEFT_UP
from bench.io.logs.finding.folder_search import find_sensors
from bench.io.logs.finding.text_search import find_texts, has_names
from bench.io.logs.log_contents import Contents
from bench.io.logs.log_records import LogRecords, read_records
from bench.io.logs.sensor_search import TEXT, FoundSensor
from bench.navigation.start.course import LEAST_SPEED
from bench.simulation.signals.magnetic import FIRST_YEAR, LAST_YEAR

_BAG = "metadata.yaml"  # in the folder of a ROS 2 bag
_BAGS = (".bag", ".db3", ".mcap")  # hold several sensors and name their own columns
RECORDINGS = (*_BAGS, *(ending for one in FORMATS.values() if one.knows for ending in one.endings))
"""Endings that only recordings have."""
_FLIGHT_IMU = "mpu-9250"  # of the class that autopilots carry
_SHAKES = 2.0  # noise of a recording over that of its datasheet that is worth believing [1]
_CLOCKS = (("gnss", "velocity_offset_s", "velocity_shift_s"), ("imu", "time_offset_s", "imu_shift_s"))
_SAME_UNIT = 0.25  # how far the scale of gyros in the right unit may be off [1]
_FASTEST = 15.0  # angular rate that no vehicle keeps for a hundredth of the time [rad/s]
_ALIGNS = 10.0  # that an alignment takes [s]
_LATE = 60.0  # a course that is found later is no start [s]
_SHARE = 0.25  # of a short record that passes before it is evaluated


def is_bag(path: Path) -> bool:
    """Return whether a path is the folder of a ROS 2 bag."""
    return path.is_dir() and any(path.glob(_BAG))


def name_log(path: Path) -> Path:
    """Return the path of the log of a recording: beside it, or in a folder of tables."""
    return (
        path / f"{path.resolve().name}.toml"
        if path.is_dir() and not is_bag(path)
        else path.with_suffix(".toml")
    )


def new_log(name: str, *, console: Console, rates: str | None = None) -> None:
    """Look at a recorded file and those beside it, and write a log that ``bench navigate`` accepts.

    Parameters
    ----------
    name : str
        A table with the columns of an IMU, whose fixes are in it or in a table beside it; the increments of
        KF-GINS, with its fixes beside them; the log of an autopilot (ULog, DataFlash); a bag or an MCAP file;
        a folder with a table for each sensor. The log, ``FILE.toml``, is written beside it, or in the folder.
    rates : str or None
        Unit of the gyros, "deg" or "rad", where neither a name nor the motion tells it.

    Raises
    ------
    ConfigError
        If the log is there already, a sensor is not found, or what was guessed cannot be read; nothing is
        written then.
    """
    path = Path(name)
    log = name_log(path)
    if log.exists() or log.is_symlink():
        raise ConfigError(f"{log}: exists already and is not replaced")
    if not path.exists():
        raise ConfigError(f"{path}: no such file")
    form = guess_format(path)
    if form is not None and find_format(form).knows:
        _write_flight(path, form, log, console)
        return
    if is_bag(path) or path.suffix.lower() in _BAGS:
        found = {kind: FoundSensor(path, {}, ()) for kind in ("imu", "gnss")}
    elif form is not None and form in FORMATS and (FORMATS[form].recognizes or FORMATS[form].fixes):
        asked = tuple(note for note in formats.read(form, path, "imu", None).notes if "topic = " in note)
        found = {"imu": FoundSensor(path, {}, asked, form=form), "gnss": FoundSensor(path, {}, (), form=form)}
    elif path.suffix.lower() == TEXT and not has_names(path):
        found = find_texts(path)
    else:
        found = find_sensors(path)
    antenna = read_antenna(found["gnss"]) if "gnss" in found else None
    clocks: dict[str, str] = {}
    made: list[Path] = []
    try:
        if found["imu"].structure:
            text = found_datasheets.read_imu_sheet(found["imu"].path, found["imu"].structure)
            found["imu"] = found["imu"]._replace(sheet=_write_sheet(path, "imu", text, made))
        records, found["imu"] = _try_log(log, found, antenna, clocks, rates)
        text = write_log(path.stem, found, antenna, clocks)
        durable.write(log, text + _choose_start(log, text, records))
    except UnicodeEncodeError as error:  # a name of the disk that is not UTF-8
        wrong = one_line(error.object[error.start : error.end + 20])
        raise ConfigError(f"{path}: a log cannot name what is not UTF-8, {wrong!r}; rename it") from None
    except BaseException:
        for part in (log, *made):
            part.unlink(missing_ok=True)
        raise
    for sheet in made:
        console.print(f"Wrote {sheet}: the noise of the IMU by {path.name}.", soft_wrap=True)
    for kind, one in found.items():
        named = ", ".join(
            f"{ours} from {theirs}"
            for ours, theirs in [*one.columns.items(), *one.gyro_columns.items()]
            if ours != theirs
        )
        within = f" and {one.gyro_path.name}" if one.gyro_path not in (None, one.path) else ""
        within += f", structure {one.structure}" if one.structure else ""
        within += f", by {one.program}" if one.program else ""
        console.print(f"{kind}: {one.path.name}{within}{': ' if named else ''}{named}", soft_wrap=True)
        for line in one.guessed:
            console.print(f"  {line}", soft_wrap=True)
        axes = clocks.get("axes", "").splitlines() if kind == "imu" else []
        for line in [one.told, clocks.get(kind, ""), *axes]:
            if line:
                console.print(f"  {line}", soft_wrap=True, markup=False)
    if "gnss" not in found:
        console.print("No columns of a GNSS receiver: only attitude is estimated.", soft_wrap=True)
    console.print(f"Wrote {log}. Check the lines with a question mark.")
    console.print(f"Next: bench navigate {log}")


def _write_flight(path: Path, form: str, log: Path, console: Console) -> None:
    """Write the log of an autopilot's recording, which knows its sensors, day and lever arms itself."""
    held = own_estimate.look(form, path)
    for kind in ("imu", "gnss"):
        if kind not in held.sensors:
            formats.read(form, path, kind, None)  # says why
            raise ConfigError(f"{path.name}: its {kind} has no usable row")
    sensors = [kind for kind in held.sensors if kind != "mag" or _has_field(held.date)]
    made: list[Path] = []
    try:
        clocks: dict[str, str] = {}
        units = {kind: _FLIGHT_IMU if kind == "imu" else DATASHEETS[kind] for kind in sensors}
        if "baro" in sensors and held.baro_sd is not None:
            text = found_datasheets.write_baro_sheet(path, *held.baro_sd, DATASHEETS["baro"])
            units["baro"] = _write_sheet(path, "baro", text, made)
        spec, records = _read_back(log, _tell_flight(path, held, units, clocks))
        for key in ("velocity_offset_s", "time_offset_s"):
            _add_clock(clocks, key, spec, records)
            spec, records = _read_back(log, _tell_flight(path, held, units, clocks))
        _, shaken = assume_vibration(spec.assumed.imu, records.imu)
        start = choose_start(spec, records)
        if start is None and not _gives_a_course(records):
            begin, end = float(records.imu.t[0]), float(records.imu.t.max())
            raise ConfigError(
                f"{path.name}: no filter can start between {begin:.2f} and {end:.2f} s: it needs fixes with "
                "velocities for a second, 10 s at rest, or 10 s above 5 m/s"
            )
        shakes = (shaken.value or 0.0) > _SHAKES
        text = _tell_flight(path, held, units, clocks, start, shakes=shakes)
        _read_back(log, text)
    except BaseException:
        for part in (log, *made):
            part.unlink(missing_ok=True)
        raise
    console.print(f"{path.name}: {', '.join(sensors)}" + _list_own(held), soft_wrap=True)
    if held.baro_sd is not None and made:
        sd, says = held.baro_sd
        console.print(f"Wrote {made[0]}: barometer with {sd:g} m by {says}.", soft_wrap=True)
    for line in clocks.values():
        console.print(f"  {line}", soft_wrap=True)
    if start is not None and start.until is not None:
        console.print(f"  it tumbles and lies still: evaluated until {start.until:.1f} s", soft_wrap=True)
    console.print(f"Wrote {log}. Check the lines with a question mark.", soft_wrap=True)
    console.print(f"Next: bench navigate {log}", soft_wrap=True)


def _write_sheet(path: Path, kind: str, text: str, made: list[Path]) -> str:
    """Write the datasheet of a recording, append its path to ``made`` and return its name, "" without a text.

    An existing datasheet is kept, because the user may have corrected it.
    """
    sheet = path.with_suffix(f".{kind}.toml")
    if text and not sheet.exists():
        durable.write(sheet, text)
        made.append(sheet)
    return sheet.name if text else ""


def _has_field(day: datetime.date | None) -> bool:
    return day is not None and FIRST_YEAR <= day.year < LAST_YEAR


def _list_own(held: Contents) -> str:
    own = [text for there, text in ((held.truth, "the truth"), (held.estimate, "its own estimate")) if there]
    return f"; {' and '.join(own)}" if own else ""


def _add_clock(clocks: dict[str, str], key: str, spec: LogSpec, records: LogRecords) -> None:
    """Add a line of [gnss] that puts the times of fixes or velocities right, where the motion shows it.

    All other sensors have the clock of the IMU.
    """
    name, sign = {"velocity_offset_s": ("velocity_shift_s", 1.0), "time_offset_s": ("imu_shift_s", -1.0)}[key]
    if not RecordedMotion.from_records(records.imu, records.fixes).moves:
        return
    off = next((one.value for one in _check(spec, records) if one.name == name and not one.good), None)
    if off is not None:
        clocks[key] = f"{key} = {sign * off:+.3f}  # by the motion: right?"


def _tell_flight(
    path: Path,
    held: Contents,
    units: Mapping[str, str],
    clocks: Mapping[str, str],
    start: ChosenStart | None = None,
    *,
    shakes: bool = False,
) -> str:
    """Return the text of the log of a flight; ``units`` are the datasheets of its sensors."""
    lines = [f"title = {quote_toml(path.stem)}", f"file = {quote_toml(path.name)}"]
    lines += [f"date = {held.date}"] if "mag" in units else []
    places = {"imu": held.imu, "gnss": held.antenna}
    known = held.imu is not None and held.antenna is not None and (any(held.imu) or any(held.antenna))
    for kind in units:
        lines += ["", f"[{kind}]"]
        if kind in places and known:
            lines.append(f"position_m = {json.dumps(places[kind])}  # by the parameters of the autopilot")
        elif kind == "gnss":
            lines.append("# where is its antenna: forward, right, down?  position_m = [0.0, 0.0, 0.0]")
        if kind == "imu" and shakes:
            lines.append("vibration = true  # its samples are noisier than its datasheet")
        lines += clocks.values() if kind == "gnss" else []
    lines += ["", "[reference]  # the truth of the simulator"] if held.truth else []
    lines += ["", "[sensors.assumed]  # which units? bench list sensors"]
    lines += [f"{kind} = {quote_toml(unit)}" for kind, unit in units.items()]
    lines += ["", "[alignment]"]
    if start is None:
        lines += ['kind = "course"']
    else:
        lines += _write_start(start)
    lines += ["", "[[estimator]]", 'use = "loose-full"']
    lines += ["", "[[estimator]]", 'use = "autopilot"'] if held.estimate else []
    return "\n".join(lines) + "\n"


def _write_start(start: ChosenStart) -> list[str]:
    """Return the lines below [alignment] of a chosen start, and the table [evaluation]."""
    lines = [f'kind = "{start.kind}"', f"at_s = {start.at:g}", f"duration_s = {start.duration:g}"]
    if start.heading:
        lines.append(f'heading = "{start.heading}"  # "autopilot": as it thought')
    lines += ["", "[evaluation]", f"from_s = {start.evaluated_from:.1f}"]
    if start.until is not None:
        lines.append(f"until_s = {start.until:.1f}  # it tumbles, and lies still")
    return lines


def _choose_start(log: Path, text: str, records: LogRecords) -> str:
    """Return [alignment] and [evaluation] of a log: the course if found early, else rest or flight."""
    last, head = float(records.imu.t.max()), "\n[alignment]\n"
    if not (course := _gives_a_course(records, _LATE)):
        spec, records = _read_back(log, text)
        moves = RecordedMotion.from_records(records.imu, records.fixes).moves
        if moves and (start := choose_start(spec, records)) is not None:
            return head + "\n".join(_write_start(start)) + "\n"
        course = _gives_a_course(records)
    if course:
        lines, begin = (
            'kind = "course"  # "level" if it stands for a minute before it moves?\n',
            _SHARE * last,
        )
    else:
        rest = min(max(_SHARE * last, _ALIGNS), 60.0)
        why = (
            "it does not move fast enough for a course" if len(records.fixes) else "is it at rest until then?"
        )
        lines = f'kind = "level"  # {why}\nduration_s = {rest:.1f}\n'
        begin = rest + 3.0
        if begin >= last and not len(records.fixes):
            raise ConfigError(
                f"{log.with_suffix('').name}: the recording is {last:.3g} s long; a start at rest needs "
                f"{_ALIGNS:g} s, and 3 s to evaluate after it"
            )
    if last <= 60.0 / (1.0 - _SHARE):  # the default of from_s is late in it, or after it
        lines += f"\n[evaluation]\nfrom_s = {begin:.1f}\n"
    return head + lines


def _try_log(
    log: Path,
    found: dict[str, FoundSensor],
    antenna: tuple[list[float], str] | None,
    clocks: dict[str, str],
    rates: str | None,
) -> tuple[LogRecords, FoundSensor]:
    """Write the log and read what it names; return the records, and the IMU in the units that motion shows.

    Into ``clocks`` goes how the axes of the IMU lie, and by how much the times of a sensor are wrong, as its
    line of the log, if the motion shows it: first those of velocities, by the positions, then those of the
    IMU, by the velocities.
    """
    spec, records = _read_back(log, write_log(log.stem, found, antenna, clocks))
    if found["imu"].form != "kf-gins" and (line := _tell_axes(spec, records, found["imu"])):
        clocks["axes"] = line
        spec, records = _read_back(log, write_log(log.stem, found, antenna, clocks))
    if found["imu"].doubtful:
        records = _settle_rates(log, found, antenna, clocks, rates)
    for kind, key, name in _CLOCKS:
        off = next((one.value for one in _check(spec, records) if one.name == name and not one.good), None)
        if off is not None:
            off += found["imu"].offset if kind == "imu" else 0.0
            clocks[kind] = f"{key} = {off:+.3f}  # by the motion: right?"
            spec, records = _read_back(log, write_log(log.stem, found, antenna, clocks))
    return records, found["imu"]


def _check(spec: LogSpec, records: LogRecords) -> list[Check]:
    return check_recording(records.imu, records.fixes, {}, np.asarray(spec.antenna_b))


def _tell_axes(spec: LogSpec, records: LogRecords, found: FoundSensor) -> str:
    """Return the lines of [imu] on its axes: by its program, by the motion or, without one, by gravity.

    Empty: they are forward, right, down.
    """
    imu = records.imu
    if found.axes != FORWARD_LEFT_UP and not found.doubtful:
        advice = [one.advice["imu.axes"] for one in _check(spec, records) if "imu.axes" in one.advice]
        keys = change_axes({}, *advice[0]) if advice else {}
        if keys:
            return "\n".join(
                f"{key} = {json.dumps(value)}  # by the motion: right?" for key, value in keys.items()
            )
    force = np.median(imu.dvel_b[imu.valid], axis=0)
    if not force[2] > 0.5 * np.linalg.norm(force):
        return ""
    says = (
        f"as {found.program} has them" if found.axes == FORWARD_LEFT_UP else "by gravity z points up: right?"
    )
    return f"mounting_deg = {json.dumps(list(FORWARD_LEFT_UP))}  # forward, left, up, {says}"


def _settle_rates(
    log: Path,
    found: dict[str, FoundSensor],
    antenna: tuple[list[float], str] | None,
    clocks: dict[str, str],
    rates: str | None,
) -> LogRecords:
    """Read the IMU in the gyro unit given by the option, shown by the motion, or the only possible unit.

    Raises
    ------
    ConfigError
        If nothing tells it.
    """
    given, read = found["imu"], {}
    for one in (given, given.turn_unit()):
        found["imu"] = one
        unit = "deg" if split_unit(one.doubtful[0])[1].startswith("deg") else "rad"
        spec, records = _read_back(log, write_log(log.stem, found, antenna, clocks))
        gain = next((check.value for check in _check(spec, records) if check.name == "turn_gain"), None)
        read[unit] = records, one
        if rates is None and gain is not None and abs(gain - 1.0) < _SAME_UNIT:
            rates, why = unit, "as the motion shows"
            break
    else:
        imu = read["rad"][0].imu
        most = float(np.nanquantile(np.linalg.norm(imu.dtheta_b, axis=1) / imu.dt, 0.99))
        why = "as --rates says" if rates else "no vehicle turns so fast in rad"
        rates = rates or ("deg" if most > _FASTEST else None)
    if rates is None:
        names = ", ".join(given.all_columns[name] for name in given.doubtful)
        raise ConfigError(
            f"{given.path.name}: {names}: rad or deg? Neither names nor motion show the unit. "
            "Pass --rates deg or --rates rad"
        )
    records, settled = read[rates]
    others = [line for line in given.guessed if line not in given.turn_lines]
    found["imu"] = settled._replace(guessed=tuple(others), told=f"gyros in {rates}, {why}")
    return records


def _gives_a_course(records: LogRecords, until: float = np.inf) -> bool:
    """Return whether the vehicle moves fast enough for a course, for long enough, until a time [s]."""
    t, _, vel_n = RecordedMotion.from_records(records.imu, records.fixes).take_velocities()
    slow = np.flatnonzero(np.hypot(vel_n[:, 0], vel_n[:, 1]) <= LEAST_SPEED)
    ends = np.concatenate(([-1], slow, [len(t)]))
    runs = [(t[a + 1], t[b - 1]) for a, b in itertools.pairwise(ends) if b - a > 1]
    return any(last - first > _ALIGNS and first + _ALIGNS < until for first, last in runs)


def _read_back(log: Path, text: str) -> tuple[LogSpec, LogRecords]:
    """Write the log; return its contents and the records that it names."""
    durable.write(log, text)
    spec = load_log(str(log))
    return spec, read_records(spec)
