"""The verb new log: look at a recorded file and write a first LOG.toml."""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from rich.console import Console

from bench.arrays import FloatArray
from bench.config.log import load_log
from bench.errors import ConfigError
from bench.exchange import imports
from bench.exchange.exports.column_files import START
from bench.exchange.imports.navego_structures import list_sensors
from bench.exchange.log_records import read_records
from bench.exchange.mat_file import list_structures, read_mat
from bench.exchange.rows import MOST_ROWS
from bench.exchange.table_files import list_columns, read_columns
from bench.files import check_file, read_json
from bench.units import split_unit

_TABLES = (".csv", ".parquet", ".mat")
_TEXT = ".txt"  # of numbers without names: increments and fixes of KF-GINS
_CONFIGURATIONS = "*.yaml"  # of KF-GINS
_SEVERAL = (".ulg", ".bag", ".db3", ".mcap")  # hold several sensors and name their own columns
_DATASHEETS = {"imu": "adis16475", "gnss": "l1-code", "baro": "bmp388"}
_FORCES = (5.0, 20.0)  # that the median specific force is between [m/s^2]
_MOST_CONFIGURATION = 1_000_000  # [byte]
_SHARE = 0.25  # of a short record that passes before it is judged


def _guess_time(t: FloatArray) -> str:
    step = float(np.nanmedian(np.abs(np.diff(t[:, 0])))) if len(t) > 1 else 1.0
    return next((unit for most, unit in ((2.0, "s"), (2e3, "ms"), (2e6, "us")) if step < most), "ns")


def _guess_rate(rate: FloatArray) -> str:
    return "deg_s" if float(np.nanquantile(np.abs(rate), 0.99)) > 3.5 else "rad_s"


def _guess_turn(dtheta: FloatArray) -> str:
    return "deg" if float(np.nanquantile(np.abs(dtheta), 0.99)) > 0.2 else "rad"


def _guess_force(force: FloatArray) -> str:
    size = float(np.nanmedian(np.linalg.norm(force, axis=1)))
    return "g" if size < 3.0 else "m_s2" if size < 100.0 else "mg"


def _guess_angle(angle: FloatArray) -> str:
    return "deg" if float(np.nanmax(np.abs(angle), initial=0.0)) > np.pi else "rad"


class _Quantity(NamedTuple):
    """Columns that belong together: names of the bench, patterns of others, and their unit by the values."""

    stems: tuple[str, ...]
    patterns: tuple[str, ...]
    guess: Callable[[FloatArray], str]
    needed: bool = True


def _name_axes(stem: str, words: str, guess: Callable[[FloatArray], str]) -> _Quantity:
    patterns = tuple(rf"(.*{words})(_?{axis}|\.{k})" for k, axis in enumerate("xyz", 1))  # .1: of a matrix
    return _Quantity(tuple(f"{stem}_{axis}" for axis in "xyz"), patterns, guess)


_TIME = _Quantity(("t",), (r"t|time|timestamp|.*_time|tow|sec(onds?)?",), _guess_time)
_INCREMENTS = (
    _TIME,
    _name_axes("dtheta", "d(elta_?)?theta", _guess_turn),
    _name_axes("dvel", "d(elta_?)?v(el|elocity)?", lambda _: "m_s"),
)
_VELOCITY = r"(.*_)?v(el|elocity)?_?({})"
_RATES = (
    _TIME,
    _name_axes("gyro", r"gyro?s?|w|omega|rate|angular_(velocity|rate)", _guess_rate),
    _name_axes("accel", r"acc(el|eleration|elerometer)?|(?<![a-z])a|(?<![a-z])f|force", _guess_force),
)
_FIX = (
    _TIME,
    _Quantity(("lat", "lon"), (r"(.*_)?lat(itude)?", r"(.*_)?(lon|lng|long|longitude)"), _guess_angle),
    _Quantity(("alt",), (r"(.*_)?(alt|altitude|height|hgt|h)",), lambda _: "m"),
    _Quantity(
        ("vel_n", "vel_e", "vel_d"),
        tuple(_VELOCITY.format(word) for word in ("n|north", "e|east", "d|down")),
        lambda _: "mps",
        needed=False,
    ),
)
_HEIGHT = (_TIME, _Quantity(("alt_baro",), (r"alt_?baro|baro_?alt(itude)?",), lambda _: "m"))
_KINDS: Mapping[str, tuple[tuple[_Quantity, ...], ...]] = {
    "imu": (_RATES, _INCREMENTS),
    "gnss": (_FIX,),
    "baro": (_HEIGHT,),
}
"""The sets of columns of each sensor, one of which a table has."""


class _Found(NamedTuple):
    """A file, or a structure in it, with what a sensor measured."""

    path: Path
    columns: Mapping[str, str]  # name of the bench -> name in the file
    guessed: tuple[str, ...]  # what the values, not the names, say of units
    structure: str = ""  # of a MATLAB file
    others: tuple[str, ...] = ()  # structures alike
    form: str = ""  # where the ending does not tell the format


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
    if path.is_dir():
        raise ConfigError(f"{path}: a folder; name the file in it with the IMU")
    log = path.with_suffix(".toml")
    if log.exists() or log.is_symlink():
        raise ConfigError(f"{log}: exists already and is not replaced")
    if not path.exists():
        raise ConfigError(f"{path}: no such file")
    if path.suffix.lower() in _SEVERAL:
        found = {kind: _Found(path, {}, ()) for kind in ("imu", "gnss")}
    elif path.suffix.lower() == _TEXT:
        found = _find_texts(path)
    else:
        found = _find_tables(path)
    text = _write_log(path.stem, found, _read_antenna(found["gnss"]))
    try:
        log.write_text(text, encoding="utf-8")
        last = float(read_records(load_log(str(log))).imu.t.max())
        if last <= 60.0 / (1.0 - _SHARE):  # the default of from_s is late in it, or after it
            log.write_text(f"{text}\n[evaluation]\nfrom_s = {_SHARE * last:.1f}\n", encoding="utf-8")
    except BaseException:
        log.unlink(missing_ok=True)
        raise
    for kind, one in found.items():
        named = ", ".join(f"{ours} from {theirs}" for ours, theirs in one.columns.items() if ours != theirs)
        within = f", structure {one.structure}" if one.structure else ""
        console.print(f"{kind}: {one.path.name}{within}{': ' if named else ''}{named}", soft_wrap=True)
        for line in one.guessed:
            console.print(f"  {line}", soft_wrap=True)
    console.print(f"Wrote {log}. Lines with a question are for you.")
    console.print(f"Next: bench navigate {log}")


def _find_tables(path: Path) -> dict[str, _Found]:
    """Return the table of each sensor: the file itself if it has the columns, else one beside it."""
    beside = sorted(p for p in path.parent.iterdir() if p.suffix.lower() in _TABLES and p != path)
    found: dict[str, _Found] = {}
    for kind in _KINDS:
        for place in (path, *beside) if kind != "imu" else (path,):
            try:
                match = _find_sensor(place, kind)
            except ConfigError:
                if place == path:
                    raise
                continue  # another file that is not a table
            if match is not None:
                found[kind] = match
                break
    if missing := [kind for kind in ("imu", "gnss") if kind not in found]:
        there = ", ".join(list_columns(path)[:30])[:300]
        where = ", there or in a table beside it" if missing[0] == "gnss" else ""
        raise ConfigError(
            f"{path.name}: no columns that look like those of {missing[0]}{where}; it has {there or 'none'}; "
            "name them in a log of your own: bench guide own-log"
        )
    return found


def _find_texts(path: Path) -> dict[str, _Found]:
    """Return the files of increments and fixes of KF-GINS; numbers without names are told by their values."""
    imu = imports.read("kf-gins", path, "imu", None)
    force = np.linalg.norm(imu.values["dvel"][1:], axis=1) / np.diff(imu.t)
    if not _FORCES[0] < np.median(force) < _FORCES[1]:
        raise ConfigError(
            f"{path.name}: no increments of an IMU as KF-GINS has them: second of week, angles [rad] and "
            "velocities [m/s] forward, right, down"
        )
    for place in sorted(path.parent.glob(f"*{_TEXT}")):
        if place != path and _has_fixes(place, imu.t):
            files = {"imu": path, "gnss": place}
            return {kind: _Found(file, {}, (), form="kf-gins") for kind, file in files.items()}
    raise ConfigError(
        f"{path.name}: no fixes beside it, as KF-GINS has them: a {_TEXT} with second of week, latitude, "
        "longitude [deg], height and three standard deviations [m]"
    )


def _has_fixes(path: Path, imu_t: FloatArray) -> bool:
    """Tell whether a text holds fixes of the time of an IMU; where increments are negative, no sd is."""
    try:
        fixes = imports.read("kf-gins", path, "gnss", None)
    except ConfigError:
        return False
    lat, lon, _ = np.abs(fixes.values["lla"]).max(axis=0)
    together = fixes.t[0] <= imu_t[-1] and imu_t[0] <= fixes.t[-1]
    return bool(together and lat <= 0.5 * np.pi and lon <= 2 * np.pi and (fixes.values["sd_pos"] >= 0).all())


def _find_sensor(path: Path, kind: str) -> _Found | None:
    """Return the columns of a sensor in a table, or its structure in a MATLAB file; None if it has none."""
    names, structures = list_columns(path), [""]
    if path.suffix.lower() == ".mat":
        if whole := list_sensors(path, kind):
            return _Found(path, {}, (), whole[0], tuple(whole[1:]))
        dots = {name[: dot.start() + 1] for name in names for dot in re.finditer(r"\.", name)}
        structures = [*sorted(dots, key=lambda prefix: (prefix.count("."), prefix)), ""]
    matches = [
        next((way for q in _KINDS[kind] if (way := _match_columns(path, names, prefix, q)) is not None), None)
        for prefix in structures
    ]
    found = [match for match in matches if match is not None]
    if not found:
        return None
    return found[0]._replace(others=tuple(one.structure for one in found[1:] if one.structure))


def _match_columns(
    path: Path, names: Sequence[str], prefix: str, quantities: tuple[_Quantity, ...]
) -> _Found | None:
    """Return the columns of a sensor among the names with a prefix; None if one that it needs is missing."""
    inside = [name.removeprefix(prefix) for name in names if name.startswith(prefix)]
    plain = {
        name: split_unit(re.sub(r"[\[(].*", "", name).strip().lower().replace(" ", "_")) for name in inside
    }
    columns: dict[str, str] = {}
    guessed: list[str] = []
    for quantity in quantities:
        theirs = [_find_name(pattern, plain, columns) for pattern in quantity.patterns]
        known = [name for name in theirs if name is not None]
        if len(known) < len(theirs):
            if quantity.needed:
                return None
            continue
        units = {plain[name][1] for name in known}
        if "" in units:
            whole = [f"{prefix}{name}" for name in known]
            unit = quantity.guess(np.column_stack(list(read_columns(path, whole, MOST_ROWS).values())))
            guessed.append(f"{', '.join(known)}: taken as {unit} by the values")
            columns |= {f"{stem}_{unit}": name for stem, name in zip(quantity.stems, known, strict=True)}
        else:
            for stem, name in zip(quantity.stems, known, strict=True):
                lowered = name.lower()
                ending = lowered[len(plain[name][0]) :]
                columns[f"{stem}{ending}"] = name
    return _Found(path, columns, tuple(guessed), prefix.removesuffix("."))


def _find_name(pattern: str, plain: Mapping[str, tuple[str, str]], taken: Mapping[str, str]) -> str | None:
    """Return the shortest name that fits a pattern and is not taken."""
    fitting = [
        name
        for name, (stem, _) in plain.items()
        if re.fullmatch(pattern, stem) and name not in taken.values()
    ]
    return min(fitting, key=len, default=None)


def _read_antenna(fixes: _Found) -> tuple[list[float], str] | None:
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
    except (ConfigError, KeyError, StopIteration, TypeError, ValueError):
        return None
    return ([x, y, z], says) if np.isfinite([x, y, z]).all() else None


def _list_levers(folder: Path) -> Iterator[tuple[str, list[str]]]:
    """Yield the configurations of KF-GINS in a folder, and where they say the antenna is."""
    for path in sorted(folder.glob(_CONFIGURATIONS)):
        check_file(path, path.name, _MOST_CONFIGURATION)
        line = re.search(r"^antlever:\s*\[(.*?)\]", path.read_text(encoding="utf-8"), re.MULTILINE)
        if line is not None:
            yield path.name, line[1].split(",")


def _write_log(title: str, found: Mapping[str, _Found], antenna: tuple[list[float], str] | None) -> str:
    """Return the text of the log; what a file cannot say is a comment that asks."""
    lines = [f"title = {json.dumps(title)}"]
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
        asked["gnss"] = [f"position_m = {json.dumps(place)}  # by {says}"]
    for kind, one in found.items():
        lines += ["", f"[{kind}]", f"file = {json.dumps(one.path.name)}"]
        if one.form:
            lines.append(f"format = {json.dumps(one.form)}")
        if one.structure:
            lines.append(f"topic = {json.dumps(one.structure)}")
        lines += [f"# or topic = {json.dumps(other)}?" for other in one.others]
        aliases = {ours: theirs for ours, theirs in one.columns.items() if ours != theirs}
        if aliases:
            listed = ", ".join(f"{ours} = {json.dumps(theirs)}" for ours, theirs in aliases.items())
            lines.append(f"columns = {{ {listed} }}")
        lines += [f"# {line}: right?" for line in one.guessed] + asked[kind]
    lines += ["", "[sensors.assumed]  # which units? bench list sensors"]
    lines += [f'{kind} = "{_DATASHEETS[kind]}"' for kind in found]
    lines += ["", "[alignment]", 'kind = "course"  # "level" if it stands for a minute before it moves?']
    return "\n".join(lines) + "\n"
