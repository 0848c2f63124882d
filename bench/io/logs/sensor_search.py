"""Find what each sensor measured in the tables and texts of other people, by names and by values."""

from __future__ import annotations

import re
from collections.abc import Callable, Collection, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from bench.core.mathematics.arrays import FloatArray
from bench.core.mathematics.units import FACTORS, STANDARD_GRAVITY, split_unit
from bench.core.words.exceptions import ConfigError
from bench.io.log_formats import FORMATS
from bench.io.logs.exporter_names import make_plain, match_exporter
from bench.io.logs.file_kinds import describe_unreadable
from bench.io.logs.finding.program_clocks import find_clocks
from bench.io.logs.finding.written_names import FOREIGN, IN_BRACKETS, find_name, split_name
from bench.io.logs.formats.navego_structures import list_sensors
from bench.io.logs.record_clock import find_week
from bench.io.logs.rows import BARO, GNSS, IMU, MOST_ROWS
from bench.io.logs.table_files import is_number, list_columns, read_columns

TABLES = (".csv", ".parquet", ".mat")
TEXT = ".txt"
"""Ending of the texts of KF-GINS, numbers without names, and of the tables of some programs."""
TEXTS = (TEXT, ".tsv")
_GRAVITY = {"g": 1.0, "m_s2": STANDARD_GRAVITY, "mg": 1000.0}
NEAR, _SAME_WAY = 0.25, 0.5  # how near gravity the median is, and how much of it stays along an axis [1]
IMU_STEP, _OTHER_STEP = 0.5, 2.0  # longest step of the times of an IMU, of another sensor [s]
_SAYS_PLACE = re.compile(
    r"(.*[^a-z])?(gps|gnss|fix|lat|lon|lng|latitude|longitude|alt|pos|position|vel|velocity)([^a-z].*)?"
)
_COUNTS = ("satellites", "hdop", "vdop")  # columns without a unit


def guess_time(t: FloatArray, longest: float = _OTHER_STEP) -> str:
    """Return the unit with which steps are shorter than ``longest`` [s]."""
    steps = np.abs(np.diff(t[:, 0]))
    step = float(np.nanmedian(steps)) / longest if np.isfinite(steps).any() else 0.0
    return next((unit for most, unit in ((1.0, "s"), (1e3, "ms"), (1e6, "us")) if step < most), "ns")


def guess_rate(rate: FloatArray) -> str:
    """Return the unit of angular rates by their size."""
    return "deg_s" if float(np.nanquantile(np.abs(rate), 0.99)) > 3.5 else "rad_s"


def guess_turn(dtheta: FloatArray) -> str:
    """Return the unit of angular increments by their size."""
    return "deg" if float(np.nanquantile(np.abs(dtheta), 0.99)) > 0.2 else "rad"


def guess_force(force: FloatArray) -> str:
    """Return the unit with which the median is gravity, along the same axis most of the time; else empty."""
    size = float(np.nanmedian(np.linalg.norm(force, axis=1)))
    if not np.linalg.norm(np.nanmedian(force, axis=0)) > _SAME_WAY * size:
        return ""  # without gravity
    return next((unit for unit, g in _GRAVITY.items() if abs(size / g - 1.0) < NEAR), "")


def guess_angle(angle: FloatArray) -> str:
    """Return the unit of latitudes and longitudes by their size."""
    largest = float(np.nanmax(np.abs(angle), initial=0.0))
    return "deg_e7" if largest > 1000.0 else "deg" if largest > np.pi else "rad"


def guess_length(value: FloatArray) -> str:
    """Return mm for integers, as receivers write them, else m."""
    return "mm" if np.array_equal(value, np.round(value)) and np.ptp(value) > 1.0 else "m"


class SensorQuantity(NamedTuple):
    """Columns that belong together: names of the bench, patterns of others, and their unit by the values."""

    stems: tuple[str, ...]
    patterns: tuple[str, ...]
    guess: Callable[[FloatArray], str]
    needed: bool = True
    hint: str = ""  # what is assumed of them


def _name_axes(stem: str, words: str, guess: Callable[[FloatArray], str]) -> SensorQuantity:
    patterns = tuple(rf"(.*{words})(_?{axis}|\.{k})" for k, axis in enumerate("xyz", 1))  # .1: of a matrix
    return SensorQuantity(tuple(f"{stem}_{axis}" for axis in "xyz"), patterns, guess)


TIME = SensorQuantity(("t",), (r"t|time|timestamp|.*_time|i?tow|sec(onds?)?(_elapsed)?",), guess_time)
_INCREMENTS = (
    TIME,
    _name_axes("dtheta", "d(elta_?)?theta", guess_turn),
    _name_axes("dvel", "d(elta_?)?v(el|elocity)?", lambda _: "m_s"),
)
_VELOCITY = r"(.*_)?v(el|elocity)?_?({})"


def _name_velocity(third: str, word: str) -> SensorQuantity:
    patterns = tuple(_VELOCITY.format(words) for words in ("n|north", "e|east", f"{third}|{word}"))
    return SensorQuantity(("vel_n", "vel_e", f"vel_{third}"), patterns, lambda _: "mps", needed=False)


_TURNS = ("gyro_", "dtheta_")
_MILLIMETERS = ("alt", "vel_n", "vel_e", "vel_d")
GYRO = _name_axes("gyro", r"gyr(o(scope)?)?s?|w|omega|rate|angular_(velocity|rate)", guess_rate)
ACCEL = _name_axes("accel", r"acc(el|eleration|elerometer)?|(?<![a-z])a|(?<![a-z])f|force", guess_force)
_RATES = (TIME, GYRO, ACCEL)
_FIX = (
    TIME,
    SensorQuantity(("lat", "lon"), (r"(.*_)?lat(itude)?", r"(.*_)?(lon|lng|long|longitude)"), guess_angle),
    SensorQuantity(("alt",), (r"(.*_)?(alt|altitude|height|hgt|h)",), lambda _: "m"),
    _name_velocity("d", "down"),
    _name_velocity("u", "up"),
)


def _name_local(letters: str, *words: str) -> tuple[SensorQuantity, ...]:
    """Return the columns of positions along three directions, such as east, north, up, and of a fix."""
    patterns = tuple(rf"p(os(ition)?)?_?({word[0]}|{word})|{word}" for word in words)
    if letters == "xyz":  # without a unit they are those of a phone
        patterns = tuple(rf"(p(os(ition)?)?_?)?{letter}_m" for letter in letters)
    hint = f"a local frame, {', '.join(words)}"
    stems = tuple(f"pos_{letter}" for letter in letters)
    return (TIME, SensorQuantity(stems, patterns, lambda _: "m", hint=hint), *_FIX[3:])


_LOCAL = (
    _name_local("enu", "east", "north", "up"),
    _name_local("ned", "north", "east", "down"),
    _name_local("xyz", "east", "north", "up"),
)
_HEIGHT = (TIME, SensorQuantity(("alt_baro",), (r"alt_?baro|baro_?alt(itude)?",), lambda _: "m"))
_KINDS: Mapping[str, tuple[tuple[SensorQuantity, ...], ...]] = {
    "imu": (_RATES, _INCREMENTS),
    "gnss": (_FIX, *_LOCAL),
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
    told: str = ""  # what is known of the unit of its gyros
    program: str = ""  # that wrote it
    axes: tuple[float, float, float] | None = None  # of an IMU, as the program has them [deg]
    sheet: str = ""  # file of the datasheet that was in it
    gyro_path: Path | None = None  # of gyros that have times of their own
    gyro_columns: Mapping[str, str] = {}
    sign: str = ""  # of its accelerometers, if the program is known for another than that of specific force
    offset: float = 0.0  # of its clock to the clock of the fixes [s]

    @property
    def all_columns(self) -> dict[str, str]:
        """Columns of the table and of the table of the gyros."""
        return {**self.columns, **self.gyro_columns}

    @property
    def turn_lines(self) -> tuple[str, ...]:
        """Lines of ``guessed`` on the unit of the gyros."""
        turns = {theirs for ours, theirs in self.all_columns.items() if ours.startswith(_TURNS)}
        head = f"{self.gyro_path.name}: " if self.gyro_path else ""

        def is_on_turns(line: str) -> bool:
            names = line.removeprefix(head).partition(": taken as ")[0].split(", ")
            return line.startswith(head) and not turns.isdisjoint(names)

        return tuple(line for line in self.guessed if is_on_turns(line))

    @property
    def doubtful(self) -> tuple[str, ...]:
        """Columns of gyros with a unit guessed from their values."""
        return tuple(ours for ours in self.all_columns if ours.startswith(_TURNS)) if self.turn_lines else ()

    def turn_unit(self) -> FoundSensor:
        """Return it with gyros in the other unit."""
        other = {"_rad_s": "_deg_s", "_deg_s": "_rad_s", "_rad": "_deg", "_deg": "_rad"}

        def swap(ours: str) -> str:
            end = next((one for one in other if ours.endswith(one)), "")
            return ours.removesuffix(end) + other[end] if ours in self.doubtful and end else ours

        columns, gyros = (
            {swap(ours): theirs for ours, theirs in one.items()} for one in (self.columns, self.gyro_columns)
        )
        return self._replace(columns=columns, gyro_columns=gyros)


def find_tables(path: Path) -> dict[str, FoundSensor]:
    """Return the table of each sensor: the file itself if it has the columns, else one beside it.

    Without a receiver, where no column of the IMU's table looks like one, there is no "gnss".

    Raises
    ------
    ConfigError
        If there is no IMU in the file, columns of a receiver in any are not usable, or a unit cannot be told.
    """
    endings = (*TABLES, *TEXTS) if path.suffix.lower() in TEXTS else TABLES
    beside = _list_beside(path, endings)
    return find_beside(find_sensor(path, "imu", IMU_STEP), path, beside)


def find_beside(imu: FoundSensor | None, path: Path, beside: Sequence[Path]) -> dict[str, FoundSensor]:
    """Return an IMU with the other sensors of its table and of tables beside it, preferably at its times.

    Raises
    ------
    ConfigError
        As `find_tables`.
    """
    found = {} if imu is None else {"imu": _name_form(imu)}
    wrong: list[ConfigError] = []
    for kind in [kind for kind in _KINDS if kind != "imu"]:
        matches: list[FoundSensor] = []
        apart: list[FoundSensor] = []
        for place in (path, *beside):
            try:
                match = find_sensor(place, kind, IMU_STEP if place == path else _OTHER_STEP)
                if match is not None and imu is not None and not _meet(imu, match):
                    apart.append(match)
                    continue
            except ConfigError as error:
                if place == path and imu is not None:
                    raise
                wrong.append(error)  # or another file that is not a table
                continue
            if match is not None:
                matches.append(match)
                if not match.turns:
                    break
        if matches or apart:
            found[kind] = _name_form(min(matches or apart, key=lambda match: match.turns))
    alone = [place for one in FORMATS.values() if one.fixes for place in _list_beside(path, one.endings)]
    if "imu" in found and "gnss" not in found and alone:
        found["gnss"] = FoundSensor(alone[0], {}, ())
    missing = [kind for kind in ("imu", "gnss") if kind not in found]
    placed = _find_placed(found["imu"], path, beside) if missing == ["gnss"] and not wrong else ""
    if missing == ["gnss"] and not wrong and not placed:
        return found
    if missing:
        if path.suffix.lower() != ".mat" and (message := describe_unreadable(path)):
            raise ConfigError(message)
        names = list_columns(path)
        if not names:
            raise ConfigError(f"{path.name}: is empty, or contains only comments")
        there = ", ".join(names[:30])[:300]
        if 2 * sum(map(is_number, names)) > len(names) or (len(names) == 1 and path.suffix not in TABLES[1:]):
            raise ConfigError(
                f"{path.name}: no line of column names; its first line is {there}. Write one, such as "
                "t_s,gyro_x_rad_s,...: bench guide log-format"
            )
        where = ""
        if missing[0] == "gnss":
            named = ", ".join(place.name for place in beside[:10])
            where = f", there or in a table beside it ({named or 'there is none'})"
            where += f", but {placed} looks like one" if placed else ""
        elif "gnss" in found and found["gnss"].columns:
            where = f", only fixes: {', '.join(found['gnss'].columns.values())}"
        because = f"; {wrong[0]}" if wrong else f"; {_list_ways(missing[0], found)}"
        raise ConfigError(f"{path.name}: no columns found for {missing[0]}{where}; it has {there}{because}")
    return found


def _find_placed(imu: FoundSensor, path: Path, beside: Sequence[Path]) -> str:
    """Return what looks like a receiver: a column, not of the IMU, or the name of a table; or ""."""
    for table in (path, *beside):
        if table.suffix.lower() == ".mat":
            return table.name
        used = set(imu.all_columns.values()) if table == path else set()
        names = [*([table.stem] if table != path else []), *(set(list_columns(table)) - used)]
        for name in sorted(names):
            if _SAYS_PLACE.fullmatch(name.lower()):
                return f"{name} of {table.name}"
    return ""


def _list_ways(missing: str, found: Mapping[str, FoundSensor]) -> str:
    """Return what to do about columns of a sensor that are not found."""
    if missing == "imu" and "gnss" in found:
        return "put it beside a table of the IMU, then: bench new log IMU.csv"
    beside = "put a table of the fixes beside it, or " if missing == "gnss" else ""
    return f"{beside}name them in a log of your own: bench guide log-format"


def _name_form(found: FoundSensor) -> FoundSensor:
    return found._replace(form="table") if found.path.suffix.lower() in TEXTS else found


def _list_beside(path: Path, endings: Collection[str]) -> list[Path]:
    return sorted(one for one in path.parent.iterdir() if one.suffix.lower() in endings and one != path)


def _meet(imu: FoundSensor, other: FoundSensor) -> bool:
    """Return whether the times of two tables overlap, or those of one are unknown."""
    spans = []
    for one in (imu, other):
        ours = next((name for name in one.columns if split_unit(name)[0] in ("t", "time")), None)
        if ours is None or one.path.suffix.lower() == ".mat":
            return True
        t = read_columns(one.path, [one.columns[ours]], MOST_ROWS)[one.columns[ours]]
        t = FACTORS[split_unit(ours)[1]] * t[np.isfinite(t)] + one.offset
        if not len(t):
            return True
        spans.append(t)
    first, last = float(spans[0].min()), float(spans[0].max())
    t = spans[1] + find_week(spans[1], first, last)
    return bool(t.min() <= last and t.max() >= first)


def find_sensor(path: Path, kind: str, longest: float) -> FoundSensor | None:
    """Return the columns of a sensor in a table, or its structure in a MATLAB file; None if it has none.

    ``longest``: step of the times of the table [s].
    """
    names, structures = list_columns(path), [""]
    if path.suffix.lower() == ".mat":
        if whole := list_sensors(path, kind):
            return FoundSensor(path, {}, (), whole[0], tuple(whole[1:]))
        dots = {name[: dot.start() + 1] for name in names for dot in re.finditer(r"\.", name)}
        longest = IMU_STEP if kind == "imu" else _OTHER_STEP  # a structure has times of its own
        structures = [*sorted(dots, key=lambda prefix: (prefix.count("."), prefix)), ""]
    found: list[FoundSensor] = []
    for prefix in structures:
        if not prefix and (known := _match_program(path, names, kind, longest)) is not None:
            found.append(known)
            continue
        ways = (match_columns(path, names, prefix, q, longest) for q in _KINDS[kind])
        found += [way for way in ways if way is not None][:1]
    if not found:
        return None
    found.sort(key=lambda match: match.turns)
    return found[0]._replace(others=tuple(one.structure for one in found[1:] if one.structure))


def _match_program(path: Path, names: Sequence[str], kind: str, longest: float) -> FoundSensor | None:
    """Return the columns of a sensor in the table of a program that is known; None if it is of no such."""
    sets = _KINDS[kind]
    needed = [[stem for one in way if one.needed and one is not TIME for stem in one.stems] for way in sets]
    matched = match_exporter(names, needed)
    if matched is None:
        return None
    program, theirs = matched
    groups = {"imu": IMU, "gnss": GNSS, "baro": BARO}[kind].values()
    stems = {stem for ways in groups for way in ways for stem in way}
    wanted = {ours: name for ours, name in theirs.items() if (ours in stems or split_unit(ours)[0] in stems)}
    motion = next((set(one) for one in needed if set(one) <= {_stem(ours, stems) for ours in wanted}), set())
    other = {stem for one in needed for stem in one} - motion
    columns: dict[str, str] = {}
    guessed: list[str] = []
    for ours, name in wanted.items():
        stem = _stem(ours, stems)
        if stem in other:
            continue
        written, known = split_name(name)[1], ours.removeprefix(stem)
        unit = written if IN_BRACKETS.search(name) and written else known or written
        unit = known if stem.startswith("accuracy") else unit  # phyphox writes degrees for meters
        if FOREIGN.fullmatch(unit.removeprefix("_")):
            raise ConfigError(f"{path.name}: {name!r} is in a unit that no column of a log has; convert it")
        if not unit and stem not in _COUNTS:
            unit = "_" + _guess_unit(path, stem, wanted, stems, longest, program.hints.get(ours, ""))
            if stem.startswith(_TURNS):
                guessed.append(name)
        columns[f"{stem}{unit}"] = name
    turns = any(re.fullmatch(r"pitch|qu?a?t?w", make_plain(name)) for name in names)
    unit = next(
        (o.removeprefix(s) for s in stems if s.startswith(_TURNS) for o in columns if o.startswith(s)), ""
    )
    asked = [f"{', '.join(guessed)}: taken as {unit[1:]} by the values"] if guessed else []
    asked += [f"{columns[ours]}: {program.hints[ours]}" for ours in columns if ours in program.hints]
    found = FoundSensor(path, columns, tuple(asked), turns=turns, program=program.title, axes=program.axes)
    return found._replace(**find_clocks(path, columns, names, program)) if kind == "imu" else found


def _stem(ours: str, stems: Collection[str]) -> str:
    return ours if ours in stems else split_unit(ours)[0]


def _guess_unit(
    path: Path, stem: str, columns: Mapping[str, str], stems: Collection[str], longest: float, hint: str
) -> str:
    """Return the unit of a column by its values and the values of the columns that belong to it.

    ``hint``: what to do if the values fit no unit.
    """
    quantities = [q for ways in _KINDS.values() for way in ways for q in way]
    quantity = next((q for q in quantities if stem in q.stems), TIME)
    names = [name for ours, name in columns.items() if _stem(ours, stems) in quantity.stems]
    values = np.column_stack(list(read_columns(path, names, MOST_ROWS).values()))
    if quantity is TIME:
        return guess_time(values, longest)
    if stem in _MILLIMETERS:
        return guess_length(values) + ("ps" if stem != "alt" else "")
    return quantity.guess(values) or _refuse_force(path, names, hint)


def _refuse_force(path: Path, names: Sequence[str], hint: str = "") -> str:
    hint = hint or "increments are dtheta_x_rad, dvel_x_mps ...: bench guide log-format"
    text = f"not gravity in m/s^2, g or mg, so not a specific force; {hint}"
    raise ConfigError(f"{path.name}: {', '.join(names)}: {text}")


def match_columns(
    path: Path, names: Sequence[str], prefix: str, quantities: tuple[SensorQuantity, ...], longest: float
) -> FoundSensor | None:
    """Return the columns of a sensor among the names with a prefix; None if a required column is missing."""
    inside = [name.removeprefix(prefix) for name in names if name.startswith(prefix)]
    plain = {name: split_name(name) for name in inside}
    if any(find_name(p, plain, {}) is None for one in quantities if one.needed for p in one.patterns):
        return None
    columns: dict[str, str] = {}
    guessed: list[str] = []
    for quantity in quantities:
        if any(split_unit(name)[0] in quantity.stems for name in columns):
            continue  # the velocity down, and up as well
        theirs = [find_name(pattern, plain, columns) for pattern in quantity.patterns]
        known = [name for name in theirs if name is not None]
        if len(known) < len(theirs):
            if quantity.needed:
                return None
            continue
        endings = [plain[name][1] for name in known]
        if foreign := next((name for name in known if FOREIGN.fullmatch(plain[name][1])), None):
            text = f"{foreign!r} is in a unit that no column of a log has; convert it: bench guide log-format"
            raise ConfigError(f"{path.name}: {text}")
        if "" in endings:
            whole = [f"{prefix}{name}" for name in known]
            values = np.column_stack(list(read_columns(path, whole, MOST_ROWS).values()))
            unit = guess_time(values, longest) if quantity is TIME else quantity.guess(values)
            if not unit:
                unit = _refuse_force(path, known)
            if not quantity.hint:
                guessed.append(f"{', '.join(known)}: taken as {unit} by the values")
            endings = [f"_{unit}"] * len(known)
        if quantity.hint:
            guessed.append(f"{', '.join(known)}: taken as {quantity.hint}")
        columns |= {
            f"{stem}{ending}": name for stem, ending, name in zip(quantity.stems, endings, known, strict=True)
        }
    turns = any(re.fullmatch(r"(.*_)?(pitch|q(_nb|_eb)?_?w)", stem) for stem, _ in plain.values())
    return FoundSensor(path, columns, tuple(guessed), prefix.removesuffix("."), turns=turns)
