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
from bench.units import ENDINGS, split_unit

_TABLES = (".csv", ".parquet", ".mat")
_TEXT = ".txt"  # of numbers without names: increments and fixes of KF-GINS
_CONFIGURATIONS = "*.yaml"  # of KF-GINS
_BAG = "metadata.yaml"  # in the folder of a ROS 2 bag
_SEVERAL = (".ulg", ".bag", ".db3", ".mcap")  # hold several sensors and name their own columns
_DATASHEETS = {"imu": "adis16475", "gnss": "l1-code", "baro": "bmp388"}
_FORCES = (5.0, 20.0)  # that the median specific force is between [m/s^2]
_UNKNOWN = -1.0  # that receivers write for a standard deviation they do not know
_FASTEST = 10.0  # median angular rate of no vehicle [rad/s]
_IMU_STEP, _OTHER_STEP = 0.5, 2.0  # longest step of the times of an IMU, of another sensor [s]
_REP_103 = (".bag", ".db3", ".mcap", "")  # whose axes are forward, left, up; a folder is a bag
_WRITTEN = {unit.symbol.replace("^", "").lower(): ending for ending, unit in ENDINGS.items()}
"""Unit in brackets behind a name -> ending."""
_FOREIGN = re.compile(r"f(oo|ee)?t(/s)?|km/?h|kph|kno?ts?|kn|mph|min|h|hours?")
"""Units that no column of a log has."""
_SPELLINGS = {
    "°": "deg",
    "degrees": "deg",
    "dps": "deg/s",
    "µ": "u",
    "μ": "u",
    "²": "2",
    "/s1": "/s",
    "sec": "s",
}
_MOST_CONFIGURATION = 1_000_000  # [byte]
_SHARE = 0.25  # of a short record that passes before it is judged


def _guess_time(t: FloatArray, longest: float = _OTHER_STEP) -> str:
    step = float(np.nanmedian(np.abs(np.diff(t[:, 0])))) / longest if len(t) > 1 else 0.0
    return next((unit for most, unit in ((1.0, "s"), (1e3, "ms"), (1e6, "us")) if step < most), "ns")


def _guess_rate(rate: FloatArray) -> str:
    return "deg_s" if float(np.nanquantile(np.abs(rate), 0.99)) > 3.5 else "rad_s"


def _guess_turn(dtheta: FloatArray) -> str:
    return "deg" if float(np.nanquantile(np.abs(dtheta), 0.99)) > 0.2 else "rad"


def _guess_force(force: FloatArray) -> str:
    size = float(np.nanmedian(np.linalg.norm(force, axis=1)))
    return "" if size < 0.3 else "g" if size < 3.0 else "m_s2" if size < 100.0 else "mg"


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


_TIME = _Quantity(("t",), (r"t|time|timestamp|.*_time|i?tow|sec(onds?)?(_elapsed)?",), _guess_time)
_INCREMENTS = (
    _TIME,
    _name_axes("dtheta", "d(elta_?)?theta", _guess_turn),
    _name_axes("dvel", "d(elta_?)?v(el|elocity)?", lambda _: "m_s"),
)
_VELOCITY = r"(.*_)?v(el|elocity)?_?({})"


def _name_velocity(third: str, word: str) -> _Quantity:
    patterns = tuple(_VELOCITY.format(words) for words in ("n|north", "e|east", f"{third}|{word}"))
    return _Quantity(("vel_n", "vel_e", f"vel_{third}"), patterns, lambda _: "mps", needed=False)


_RATES = (
    _TIME,
    _name_axes("gyro", r"gyr(o(scope)?)?s?|w|omega|rate|angular_(velocity|rate)", _guess_rate),
    _name_axes("accel", r"acc(el|eleration|elerometer)?|(?<![a-z])a|(?<![a-z])f|force", _guess_force),
)
_FIX = (
    _TIME,
    _Quantity(("lat", "lon"), (r"(.*_)?lat(itude)?", r"(.*_)?(lon|lng|long|longitude)"), _guess_angle),
    _Quantity(("alt",), (r"(.*_)?(alt|altitude|height|hgt|h)",), lambda _: "m"),
    _name_velocity("d", "down"),
    _name_velocity("u", "up"),
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
    turns: bool = False  # it has an attitude too, as no receiver measures it


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
    wrong: list[ConfigError] = []
    for kind in _KINDS:
        matches: list[_Found] = []
        for place in (path, *beside) if kind != "imu" else (path,):
            try:
                match = _find_sensor(place, kind, _IMU_STEP if place == path else _OTHER_STEP)
            except ConfigError as error:
                if place == path:
                    raise
                wrong.append(error)  # or another file that is not a table
                continue
            if match is not None:
                matches.append(match)
                if not match.turns:
                    break
        if matches:
            found[kind] = min(matches, key=lambda match: match.turns)
    if missing := [kind for kind in ("imu", "gnss") if kind not in found]:
        there = ", ".join(list_columns(path)[:30])[:300]
        where = ""
        if missing[0] == "gnss":
            named = ", ".join(place.name for place in beside[:10])
            where = f", there or in a table beside it ({named or 'there is none'})"
        because = f"; {wrong[0]}" if wrong else "; name them in a log of your own: bench guide own-log"
        raise ConfigError(
            f"{path.name}: no columns that look like those of {missing[0]}{where}; it has {there or 'none'}"
            f"{because}"
        )
    return found


def _find_texts(path: Path) -> dict[str, _Found]:
    """Return the files of increments and fixes of KF-GINS; numbers without names are told by their values."""
    imu = imports.read("kf-gins", path, "imu", None)
    steps = np.diff(imu.t, prepend=np.nan)
    forward = steps > 0
    rate, force = (
        float(np.nanmedian(np.linalg.norm(imu.values[name][forward], axis=1) / steps[forward]))
        if forward.any()
        else np.nan
        for name in ("dtheta", "dvel")
    )
    if not (_FORCES[0] < force < _FORCES[1] and rate < _FASTEST):
        raise ConfigError(
            f"{path.name}: no increments of an IMU as KF-GINS has them: second of week, angles [rad] and "
            "velocities [m/s] forward, right, down"
        )
    faults = []
    for place in sorted(one for one in path.parent.iterdir() if one.suffix.lower() == _TEXT and one != path):
        if not (fault := _find_fault(place, imu.t)):
            files = {"imu": path, "gnss": place}
            return {kind: _Found(file, {}, (), form="kf-gins") for kind, file in files.items()}
        faults.append(fault)
    raise ConfigError(
        f"{path.name}: no fixes beside it, as KF-GINS has them: a {_TEXT} with second of week, latitude, "
        f"longitude [deg], height, three standard deviations [m]; {'; '.join(faults[:3]) or 'there is none'}"
    )


def _find_fault(path: Path, imu_t: FloatArray) -> str:
    """Return why a text does not hold the fixes beside an IMU; empty if it does."""
    try:
        fixes = imports.read("kf-gins", path, "gnss", None)
    except ConfigError as error:
        return str(error)
    first, last = fixes.t.min(), fixes.t.max()
    if not (first <= imu_t.max() and imu_t.min() <= last):
        return f"{path.name}: its times, {first:.9g} to {last:.9g} s, do not overlap those of the IMU"
    lat, lon, _ = np.abs(fixes.values["lla"]).T
    sd = fixes.values["sd_pos"]
    wrong = (
        (lat > 0.5 * np.pi) | (lon > 2 * np.pi) | ((sd < 0) & (sd != _UNKNOWN)).any(axis=1)
    )  # an increment is
    if wrong.any():
        return f"{path.name}: row {int(np.argmax(wrong)) + 1} holds no fix"
    return ""


def _find_sensor(path: Path, kind: str, longest: float) -> _Found | None:
    """Return the columns of a sensor in a table, or its structure in a MATLAB file; None if it has none.

    ``longest``: step of the times of the table [s].
    """
    names, structures = list_columns(path), [""]
    if path.suffix.lower() == ".mat":
        if whole := list_sensors(path, kind):
            return _Found(path, {}, (), whole[0], tuple(whole[1:]))
        dots = {name[: dot.start() + 1] for name in names for dot in re.finditer(r"\.", name)}
        longest = _IMU_STEP if kind == "imu" else _OTHER_STEP  # a structure has times of its own
        structures = [*sorted(dots, key=lambda prefix: (prefix.count("."), prefix)), ""]
    found: list[_Found] = []
    for prefix in structures:
        ways = (_match_columns(path, names, prefix, q, longest) for q in _KINDS[kind])
        found += [way for way in ways if way is not None][:1]
    if not found:
        return None
    found.sort(key=lambda match: match.turns)
    return found[0]._replace(others=tuple(one.structure for one in found[1:] if one.structure))


def _match_columns(
    path: Path, names: Sequence[str], prefix: str, quantities: tuple[_Quantity, ...], longest: float
) -> _Found | None:
    """Return the columns of a sensor among the names with a prefix; None if one that it needs is missing."""
    inside = [name.removeprefix(prefix) for name in names if name.startswith(prefix)]
    plain = {name: _split_name(name) for name in inside}
    columns: dict[str, str] = {}
    guessed: list[str] = []
    for quantity in quantities:
        theirs = [_find_name(pattern, plain, columns) for pattern in quantity.patterns]
        known = [name for name in theirs if name is not None]
        if len(known) < len(theirs):
            if quantity.needed:
                return None
            continue
        endings = [plain[name][1] for name in known]
        if foreign := next((name for name in known if _FOREIGN.fullmatch(plain[name][1])), None):
            text = f"{foreign!r} is in a unit that no column of a log has; convert it: bench guide own-log"
            raise ConfigError(f"{path.name}: {text}")
        if "" in endings:
            whole = [f"{prefix}{name}" for name in known]
            values = np.column_stack(list(read_columns(path, whole, MOST_ROWS).values()))
            unit = _guess_time(values, longest) if quantity is _TIME else quantity.guess(values)
            if not unit:
                text = (
                    "too small for m/s^2, g or mg with gravity; increments are dtheta_x_rad, dvel_x_mps ..."
                )
                raise ConfigError(f"{path.name}: {', '.join(known)}: {text}: bench guide own-log")
            guessed.append(f"{', '.join(known)}: taken as {unit} by the values")
            endings = [f"_{unit}"] * len(known)
        columns |= {
            f"{stem}{ending}": name for stem, ending, name in zip(quantity.stems, endings, known, strict=True)
        }
    turns = any(re.fullmatch(r"(.*_)?(pitch|q(_nb|_eb)?_?w)", stem) for stem, _ in plain.values())
    return _Found(path, columns, tuple(guessed), prefix.removesuffix("."), turns=turns)


def _split_name(name: str) -> tuple[str, str]:
    """Return the words of a name, and the ending of its unit, which may stand in brackets behind them.

    A unit that no column of a log has is returned as it is; empty if there is none.
    """
    words, _, bracket = re.sub(r"[\])].*", "", name.lower().replace("[", "(")).partition("(")
    words = words.strip().lstrip("#").strip().replace(" ", "_")
    stem = split_unit(words)[0]
    if stem != words:
        return stem, words[len(stem) :]
    written = re.sub(r"[\s^]", "", re.sub(r"[ *·]+s\^?-", "/s", bracket.strip()))
    for theirs, ours in _SPELLINGS.items():
        written = written.replace(theirs, ours)
    return stem, written if _FOREIGN.fullmatch(written) else _WRITTEN.get(written, "")


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
    if found["imu"].path.suffix.lower() in _REP_103:
        text = "# its axes are those of REP 103, forward, left, up?          mounting_deg = [180.0, 0.0, 0.0]"
        asked["imu"][0] = text
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
