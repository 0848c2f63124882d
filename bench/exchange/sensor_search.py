"""Find what each sensor measured in the tables and texts of other people, by names and by values."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from bench.arrays import FloatArray
from bench.errors import ConfigError
from bench.exchange import imports
from bench.exchange.imports.navego_structures import list_sensors
from bench.exchange.rows import MOST_ROWS
from bench.exchange.table_files import list_columns, read_columns
from bench.units import ENDINGS, split_unit

_TABLES = (".csv", ".parquet", ".mat")
TEXT = ".txt"
"""Ending of the texts of KF-GINS: increments and fixes, numbers without names."""
_FORCES = (5.0, 20.0)  # that the median specific force is between [m/s^2]
_UNKNOWN = -1.0  # that receivers write for a standard deviation they do not know
_FASTEST = 10.0  # median angular rate of no vehicle [rad/s]
_IMU_STEP, _OTHER_STEP = 0.5, 2.0  # longest step of the times of an IMU, of another sensor [s]
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


class _SensorQuantity(NamedTuple):
    """Columns that belong together: names of the bench, patterns of others, and their unit by the values."""

    stems: tuple[str, ...]
    patterns: tuple[str, ...]
    guess: Callable[[FloatArray], str]
    needed: bool = True


def _name_axes(stem: str, words: str, guess: Callable[[FloatArray], str]) -> _SensorQuantity:
    patterns = tuple(rf"(.*{words})(_?{axis}|\.{k})" for k, axis in enumerate("xyz", 1))  # .1: of a matrix
    return _SensorQuantity(tuple(f"{stem}_{axis}" for axis in "xyz"), patterns, guess)


_TIME = _SensorQuantity(("t",), (r"t|time|timestamp|.*_time|i?tow|sec(onds?)?(_elapsed)?",), _guess_time)
_INCREMENTS = (
    _TIME,
    _name_axes("dtheta", "d(elta_?)?theta", _guess_turn),
    _name_axes("dvel", "d(elta_?)?v(el|elocity)?", lambda _: "m_s"),
)
_VELOCITY = r"(.*_)?v(el|elocity)?_?({})"


def _name_velocity(third: str, word: str) -> _SensorQuantity:
    patterns = tuple(_VELOCITY.format(words) for words in ("n|north", "e|east", f"{third}|{word}"))
    return _SensorQuantity(("vel_n", "vel_e", f"vel_{third}"), patterns, lambda _: "mps", needed=False)


_ACCURACY = re.compile(r"(.*_)?(sd|std|stddev|sigma|var|cov|accuracy)(_.*)?")
_RATES = (
    _TIME,
    _name_axes("gyro", r"gyr(o(scope)?)?s?|w|omega|rate|angular_(velocity|rate)", _guess_rate),
    _name_axes("accel", r"acc(el|eleration|elerometer)?|(?<![a-z])a|(?<![a-z])f|force", _guess_force),
)
_FIX = (
    _TIME,
    _SensorQuantity(("lat", "lon"), (r"(.*_)?lat(itude)?", r"(.*_)?(lon|lng|long|longitude)"), _guess_angle),
    _SensorQuantity(("alt",), (r"(.*_)?(alt|altitude|height|hgt|h)",), lambda _: "m"),
    _name_velocity("d", "down"),
    _name_velocity("u", "up"),
)
_HEIGHT = (_TIME, _SensorQuantity(("alt_baro",), (r"alt_?baro|baro_?alt(itude)?",), lambda _: "m"))
_KINDS: Mapping[str, tuple[tuple[_SensorQuantity, ...], ...]] = {
    "imu": (_RATES, _INCREMENTS),
    "gnss": (_FIX,),
    "baro": (_HEIGHT,),
}
"""The sets of columns of each sensor, one of which a table has."""


class FoundSensor(NamedTuple):
    """A file, or a structure in it, with what a sensor measured."""

    path: Path
    columns: Mapping[str, str]  # name of the bench -> name in the file
    guessed: tuple[str, ...]  # what the values, not the names, say of units
    structure: str = ""  # of a MATLAB file
    others: tuple[str, ...] = ()  # structures alike
    form: str = ""  # where the ending does not tell the format
    turns: bool = False  # it has an attitude too, as no receiver measures it


def find_tables(path: Path) -> dict[str, FoundSensor]:
    """Return the table of each sensor: the file itself if it has the columns, else one beside it.

    Raises
    ------
    ConfigError
        If there is no IMU in the file, no receiver in any, or a unit cannot be told.
    """
    beside = sorted(p for p in path.parent.iterdir() if p.suffix.lower() in _TABLES and p != path)
    found: dict[str, FoundSensor] = {}
    wrong: list[ConfigError] = []
    for kind in _KINDS:
        matches: list[FoundSensor] = []
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


def find_texts(path: Path) -> dict[str, FoundSensor]:
    """Return the files of increments and fixes of KF-GINS; numbers without names are told by their values.

    Raises
    ------
    ConfigError
        If the file has no increments, or no file beside it the fixes; it says why.
    """
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
    for place in sorted(one for one in path.parent.iterdir() if one.suffix.lower() == TEXT and one != path):
        if not (fault := _find_fault(place, imu.t)):
            files = {"imu": path, "gnss": place}
            return {kind: FoundSensor(file, {}, (), form="kf-gins") for kind, file in files.items()}
        faults.append(fault)
    raise ConfigError(
        f"{path.name}: no fixes beside it, as KF-GINS has them: a {TEXT} with second of week, latitude, "
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
    below = ((sd < 0) & (sd != _UNKNOWN)).any(axis=1)  # as an increment may be
    wrong = (lat > 0.5 * np.pi) | (lon > 2 * np.pi) | below
    if wrong.any():
        return f"{path.name}: row {int(np.argmax(wrong)) + 1} holds no fix"
    return ""


def _find_sensor(path: Path, kind: str, longest: float) -> FoundSensor | None:
    """Return the columns of a sensor in a table, or its structure in a MATLAB file; None if it has none.

    ``longest``: step of the times of the table [s].
    """
    names, structures = list_columns(path), [""]
    if path.suffix.lower() == ".mat":
        if whole := list_sensors(path, kind):
            return FoundSensor(path, {}, (), whole[0], tuple(whole[1:]))
        dots = {name[: dot.start() + 1] for name in names for dot in re.finditer(r"\.", name)}
        longest = _IMU_STEP if kind == "imu" else _OTHER_STEP  # a structure has times of its own
        structures = [*sorted(dots, key=lambda prefix: (prefix.count("."), prefix)), ""]
    found: list[FoundSensor] = []
    for prefix in structures:
        ways = (_match_columns(path, names, prefix, q, longest) for q in _KINDS[kind])
        found += [way for way in ways if way is not None][:1]
    if not found:
        return None
    found.sort(key=lambda match: match.turns)
    return found[0]._replace(others=tuple(one.structure for one in found[1:] if one.structure))


def _match_columns(
    path: Path, names: Sequence[str], prefix: str, quantities: tuple[_SensorQuantity, ...], longest: float
) -> FoundSensor | None:
    """Return the columns of a sensor among the names with a prefix; None if one that it needs is missing."""
    inside = [name.removeprefix(prefix) for name in names if name.startswith(prefix)]
    plain = {name: _split_name(name) for name in inside}
    columns: dict[str, str] = {}
    guessed: list[str] = []
    for quantity in quantities:
        if any(split_unit(name)[0] in quantity.stems for name in columns):
            continue  # the velocity down, and up as well
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
    return FoundSensor(path, columns, tuple(guessed), prefix.removesuffix("."), turns=turns)


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
    """Return the shortest name that fits a pattern, is not taken, and is not that of an accuracy."""
    fitting = [
        name
        for name, (stem, _) in plain.items()
        if re.fullmatch(pattern, stem) and not _ACCURACY.fullmatch(stem) and name not in taken.values()
    ]
    return min(fitting, key=len, default=None)
