"""Read columns of numbers from CSV, Parquet or MATLAB files of other people.

Column names give quantity, frame and unit, for example ``gyro_x_deg_s``. Nothing in a file is executed or
unpickled, and a file that is too large is rejected before it fills the memory.
"""

from __future__ import annotations

import csv
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from bench.core.files import disk_arrays
from bench.core.files.file_checks import check_file
from bench.core.mathematics.arrays import FloatArray
from bench.core.mathematics.units import FACTORS, split_unit
from bench.core.words.exceptions import ConfigError
from bench.io.logs.file_kinds import describe_unreadable
from bench.io.logs.mat_files.mat_file import Value, find_structure, get_vector, read_mat

MOST_BYTES = 2_000_000_000  # largest file that is read
_MOST_HEADER = 1_000_000  # longest line, the header included [byte]
_BRACKETS = re.compile(r"\([^()]*\)|\[[^\[\]]*\]")
_BLOCK = 1 << 20  # read at a time [byte]
_NAMELESS = "; name the columns in line 1"
_ABOVE = re.compile(r"\s*(#|%|//|sep=|[^,;\t]+:[,;\t])")  # lines above the header: comments, key: value

UNITS = {
    "time": ("s",),
    "clock": ("s", "ms", "us", "ns", "100us"),
    "angle": ("deg", "rad", "mrad", "deg_e7"),
    "length": ("m", "km", "mm", "cm", "dm"),
    "speed": ("m/s", "mm/s", "km/h"),
    "rate": ("rad/s", "deg/s", "deg/h"),
    "revolution": ("rad/s", "1/min"),
    "acceleration": ("m/s^2", "g", "mg"),
    "pressure": ("Pa", "hPa"),
    "field": ("uT", "nT", "T", "gauss", "mgauss"),
    "signal": ("dB-Hz",),
    "temperature": ("degC", "K"),
    "": ("",),
}
"""Dimension -> allowed units of its columns; messages name the first."""

Group = Mapping[str, str]
"""Columns that belong together: name without the unit -> dimension."""


def group(dimension: str, *stems: str) -> dict[str, str]:
    """Return a group of columns that share a dimension."""
    return dict.fromkeys(stems, dimension)


def list_names(groups: Sequence[Group]) -> str:
    """Return the allowed column names of a kind, as text."""
    return " or ".join(", ".join(_add_unit(stem, UNITS[d][0]) for stem, d in one.items()) for one in groups)


def find_first(bad: ArrayLike) -> int | None:
    """Return the index of the first true element, None if there is none."""
    return int(np.argmax(bad)) if np.any(bad) else None


def check_times(t: FloatArray, name: str, shown: str) -> None:
    """Raise ConfigError if there is no row, or a time is not finite or not after the one before it."""
    if not len(t):
        raise ConfigError(f"{shown}: no rows")
    if (k := find_first(~np.isfinite(t))) is not None:
        raise ConfigError(f"{shown}: row {k + 1}: {name} is not a finite number")
    back = np.diff(t) <= 0
    if (k := find_first(back)) is not None:
        more = f" ({np.count_nonzero(back)} such rows)" if np.count_nonzero(back) > 1 else ""
        raise ConfigError(f"{shown}: row {k + 2}: {name} = {t[k + 1]:.9g} is not after {t[k]:.9g}{more}")


@dataclass(frozen=True, slots=True)
class TableColumns:
    """The columns in use, in SI, by kind and in the order of their group; names of the unused columns."""

    columns: Mapping[str, FloatArray]  # kind -> (N, k)
    stems: Mapping[str, tuple[str, ...]]  # kind -> names without units
    names: Mapping[str, tuple[str, ...]]  # kind -> names with units
    unused: tuple[str, ...]

    def list_unused(self) -> str:
        """Return a remark that lists the columns that are not used, 20 at most."""
        more = f" and {len(self.unused) - 20} more" if len(self.unused) > 20 else ""
        return f"columns not used: {', '.join(self.unused[:20])[:400]}{more}"

    def check_groups(self, kinds: Mapping[str, Sequence[Group]], shown: str) -> None:
        """Raise ConfigError if only some columns of a kind are present."""
        unused = {split_unit(name)[0] for name in self.unused}
        for kind in kinds.keys() - self.columns.keys():
            best = max(kinds[kind], key=lambda one: len(unused.intersection(one)))
            there, missing = ([stem for stem in best if (stem in unused) is has] for has in (True, False))
            if there:
                others = [name for name in self.unused if split_unit(name)[0] not in there]
                text = f"without {', '.join(missing)}; other columns: {', '.join(others)[:300] or 'none'}"
                raise ConfigError(f"{shown}: {', '.join(there)} {text}")


def read_table(
    path: Path,
    kinds: Mapping[str, Sequence[Group]],
    optional: Sequence[str],
    most_rows: int,
    aliases: Mapping[str, str] | None = None,
    most_values: int | None = None,
    structure: str | None = None,
) -> TableColumns:
    """Read the columns of a file by kind.

    Parameters
    ----------
    path : Path
        ``.csv`` with a header (`_read_header`), ``.parquet``, or ``.mat`` with a vector per column.
    kinds : mapping
        Kind -> alternative groups of columns; the first complete one is used.
    optional : sequence of str
        Kinds that may be missing.
    most_rows : int
        Largest number of rows.
    aliases : mapping or None
        Name with unit -> name of the column in the file.
    most_values : int or None
        Largest number of rows times columns; None for no limit.
    structure : str or None
        The structure of a MATLAB file whose fields are the columns; None for those of the file.

    Raises
    ------
    ConfigError
        If the file cannot be read, is too large or lacks columns: one line.
    """
    shown, aliases, wanted = path.name, aliases or {}, list[str]()
    import pyarrow as pa

    try:
        check_file(path, shown, MOST_BYTES)
        names, batches = _open(path, most_rows, structure)
        chosen, unused = _choose(names, kinds, optional, shown, aliases)
        wanted = [aliases.get(name, name) for one in chosen.values() for name in one]
        if twice := [name for name in wanted if names.count(name) > 1]:
            raise ConfigError(f"{shown}: more than one column is named {twice[0]!r}; rename those not meant")
        columns = {kind: disk_arrays.Gathered(len(one)) for kind, one in chosen.items()}
        count = 0
        for batch in batches(wanted):
            count += len(batch[wanted[0]])
            if count > most_rows:
                raise ConfigError(f"{shown}: more than {most_rows} rows")
            if most_values is not None and count * len(wanted) > most_values:
                raise ConfigError(
                    f"{shown}: more than {most_values // len(wanted)} rows of {len(wanted)} columns"
                )
            for kind, one in chosen.items():
                columns[kind].add(_stack(batch, one, aliases))
    except FileNotFoundError:
        raise ConfigError(f"{shown}: no such file") from None
    except (pa.ArrowException, OSError, ValueError, csv.Error, MemoryError) as error:
        row = _find_bad_row(path, wanted) if isinstance(error, pa.ArrowException) else ""
        reason = " ".join(str(error).split())[:200] or type(error).__name__
        raise ConfigError(f"{shown}: {row or f'cannot be read: {reason}'}") from None
    return TableColumns(
        columns={kind: rows.join() for kind, rows in columns.items()},
        stems={kind: tuple(split_unit(n)[0] for n in one) for kind, one in chosen.items()},
        names=chosen,
        unused=unused,
    )


def _stack(batch: Mapping[str, FloatArray], names: Sequence[str], aliases: Mapping[str, str]) -> FloatArray:
    """Return columns of a block as rows (K, k), in SI."""
    found = (batch[aliases.get(name, name)] * FACTORS.get(split_unit(name)[1], 1.0) for name in names)
    return np.stack(list(found), axis=-1)


def list_columns(path: Path) -> list[str]:
    """Return the names of the columns of a table; raise ConfigError if it is not one."""
    return _open_table(path)[0]


def read_columns(path: Path, names: Sequence[str], most_rows: int) -> dict[str, FloatArray]:
    """Return columns of a table (N,) as they are, by name; N is at most ``most_rows``."""
    import pyarrow as pa

    parts: list[Mapping[str, FloatArray]] = []
    try:
        for batch in _open_table(path, most_rows)[1](names):
            parts.append(batch)
            if sum(len(part[names[0]]) for part in parts) >= most_rows:
                break
    except (pa.ArrowException, OSError, ValueError) as error:
        row = _find_bad_row(path, names) if isinstance(error, pa.ArrowException) else ""
        reason = f"cannot be read: {' '.join(str(error).split())[:200]}"
        raise ConfigError(f"{path.name}: {row or reason}") from None
    if not parts:
        raise ConfigError(f"{path.name}: no rows")
    return {name: np.concatenate([part[name] for part in parts])[:most_rows] for name in names}


def _open_table(path: Path, most_rows: int = 1) -> tuple[list[str], Batches]:
    import pyarrow as pa

    try:
        return _open(path, most_rows, None)
    except (pa.ArrowException, OSError, ValueError, csv.Error) as error:
        raise ConfigError(f"{path.name}: cannot be read: {' '.join(str(error).split())[:200]}") from None


Batches = Callable[[Sequence[str]], Iterator[Mapping[str, FloatArray]]]


class _TableHeader(NamedTuple):
    names: list[str]
    lines: int  # of the file to its end
    separator: str


def _read_header(path: Path) -> _TableHeader:
    """Return the header of a CSV file with columns separated by a comma, a semicolon or a tab.

    Empty lines, comments (#, %, //) and keys with a colon above it do not count; the last comment is the
    header if rows follow. A line of units in brackets below it belongs to it.
    """
    lines, comment, above = 0, "", False
    try:
        with path.open(encoding="utf-8-sig", newline="") as file:
            while line := file.readline(_MOST_HEADER):
                above = above or line.strip() == "FILE_INFO"  # of SensorConnect, to the line DATA_START
                if line.strip() and not (above or _ABOVE.match(line)):
                    break
                above = above and line.strip() != "DATA_START"
                lines, comment = lines + 1, line.strip() or comment
            below = file.readline(_MOST_HEADER)
    except UnicodeDecodeError:
        raise ConfigError(describe_unreadable(path, "not a text file in UTF-8")) from None
    last, separator = comment.lstrip("#%/"), _find_separator(line)
    cells, named = _split(line, separator), _split(last, _find_separator(last))
    if comment and len(cells) == len(named) and _count_numbers(named) < 0.5 <= _count_numbers(cells):
        return _TableHeader(named, lines, separator)
    units = _split(below, separator)
    if len(units) == len(cells) and all(_BRACKETS.fullmatch(unit) for unit in units):
        return _TableHeader(
            [f"{cell} {unit}" for cell, unit in zip(cells, units, strict=True)], lines + 2, separator
        )
    return _TableHeader(cells, lines + 1, separator)


def _count_numbers(cells: Sequence[str]) -> float:
    """Return the part of cells that are numbers."""
    return sum(map(is_number, cells)) / max(len(cells), 1)


def _find_separator(line: str) -> str:
    return next((mark for mark in (",", ";", "\t") if mark in line), ",")


def _split(line: str, separator: str) -> list[str]:
    return [cell.strip() for cell in next(csv.reader([line], delimiter=separator), [])]


def _open_csv(path: Path, most_rows: int) -> tuple[list[str], Batches]:
    """Return the names in the header, and a function that yields wanted columns block by block."""
    import pyarrow as pa
    from pyarrow import csv as pa_csv

    names, lines, separator = _read_header(path)

    def batches(wanted: Sequence[str]) -> Iterator[Mapping[str, FloatArray]]:
        reader = pa_csv.open_csv(
            path,
            read_options=pa_csv.ReadOptions(
                use_threads=False, block_size=_BLOCK, skip_rows=lines, column_names=names
            ),
            parse_options=pa_csv.ParseOptions(delimiter=separator),
            convert_options=pa_csv.ConvertOptions(
                include_columns=list(wanted), column_types=dict.fromkeys(wanted, pa.float64())
            ),
        )
        with reader:
            for batch in reader:
                yield _to_floats(batch, wanted)

    return names, batches


def _find_bad_row(path: Path, wanted: Sequence[str]) -> str:
    """Return a message on the first row of a CSV file without a number in a wanted column, or ""."""
    if path.suffix.lower() in (".parquet", ".mat"):
        return ""
    from pyarrow import csv as pa_csv

    names, lines, separator = _read_header(path)
    empty = set(pa_csv.ConvertOptions().null_values)
    with path.open(encoding="utf-8-sig", errors="replace", newline="") as file:
        for _ in range(lines):
            file.readline(_MOST_HEADER)
        row = 0
        while line := file.readline(_MOST_HEADER):
            try:
                cells = next(csv.reader([line.replace("\0", "?")], delimiter=separator), [])
            except csv.Error as error:
                return f"row {row + 1}: {error}"
            if not cells:
                continue
            row += 1
            if len(cells) != len(names):
                return f"row {row}: {len(cells)} columns, the header has {len(names)}"
            for name, cell in zip(names, cells, strict=True):
                if name in wanted and cell not in empty and not is_number(cell):
                    return f"row {row}: {name} = {cell[:40]!r} is not a number"
    return "" if row else "no rows"


def is_number(cell: str) -> bool:
    """Return whether a cell of a text table is a number."""
    try:
        float(cell or "nan")
    except ValueError:
        return False
    return cell.isascii() and "_" not in cell  # unlike for Python


def _open_parquet(path: Path, most_rows: int) -> tuple[list[str], Batches]:
    """As ``_open_csv``, for a Parquet file; its number of rows is checked before it is read."""
    import pyarrow as pa
    from pyarrow import parquet as pq

    def batches(wanted: Sequence[str]) -> Iterator[Mapping[str, FloatArray]]:
        with pq.ParquetFile(path, buffer_size=_BLOCK) as file:  # else whole columns of a group
            facts, schema = file.metadata, file.schema_arrow
            if facts.num_rows > most_rows:
                raise ConfigError(f"{path.name}: more than {most_rows} rows")
            for name in wanted:
                kind = schema.field(name).type
                types = (pa.types.is_floating, pa.types.is_integer, pa.types.is_boolean)
                if not any(fits(kind) for fits in types):
                    raise ConfigError(f"{path.name}: column {name!r} holds {kind}, not numbers")
            for batch in file.iter_batches(
                batch_size=disk_arrays.ROWS, columns=list(wanted), use_threads=False
            ):
                yield _to_floats(batch, wanted)

    with pq.ParquetFile(path) as file:
        return list(file.schema_arrow.names), batches


def _to_floats(batch: Any, wanted: Sequence[str]) -> dict[str, FloatArray]:
    """Return columns of a block; nanoseconds since 1970 are rounded to 256 ns."""
    import pyarrow as pa

    return {
        name: np.asarray(batch.column(name).cast(pa.float64(), safe=False).to_numpy(zero_copy_only=False))
        for name in wanted
    }


def _open_mat(path: Path, structure: str | None) -> tuple[list[str], Batches]:
    content: Mapping[str, Value] = read_mat(path)
    if structure is not None:
        content = find_structure(content, structure, path.name)
    variables = dict(_flatten(content))

    def batches(wanted: Sequence[str]) -> Iterator[Mapping[str, FloatArray]]:
        columns = {name: get_vector(variables[name], name, path.name) for name in wanted}
        lengths = {name: len(column) for name, column in columns.items()}
        if len(set(lengths.values())) > 1:
            listed = ", ".join(f"{name} {length}" for name, length in lengths.items())
            raise ConfigError(f"{path.name}: columns differ in length: {listed[:200]}")
        yield columns

    return list(variables), batches


def _flatten(variables: Mapping[str, Value], place: str = "") -> Iterator[tuple[str, Value]]:
    """Yield the arrays in structures by name, ``data.imu.t``; columns of a matrix have numbers, ``wb.1``."""
    for name, value in variables.items():
        if isinstance(value, Mapping):
            yield from _flatten(value, f"{place}{name}.")
        elif isinstance(value, np.ndarray) and value.ndim == 2:
            yield from ((f"{place}{name}.{k + 1}", column) for k, column in enumerate(value.T))
        else:
            yield f"{place}{name}", value


def _open(path: Path, most_rows: int, structure: str | None) -> tuple[list[str], Batches]:
    """Open a table by its ending; a structure is of a MATLAB file."""
    ending = path.suffix.lower()
    if ending == ".mat":
        return _open_mat(path, structure)
    return (_open_parquet if ending == ".parquet" else _open_csv)(path, most_rows)


def _rename_columns(names: Sequence[str], aliases: Mapping[str, str], shown: str) -> list[str]:
    """Return the column names of a file after the aliases have been applied."""
    missing = [name for name in aliases.values() if name not in names]
    if missing:
        there = ", ".join(names[:30])[:300]
        raise ConfigError(f"{shown}: no column {missing[0]!r}; there are {there or 'none'}")
    return [*(name for name in names if name not in aliases.values()), *aliases]


def _choose(
    names: Sequence[str],
    kinds: Mapping[str, Sequence[Group]],
    optional: Sequence[str],
    shown: str,
    aliases: Mapping[str, str],
) -> tuple[dict[str, tuple[str, ...]], tuple[str, ...]]:
    """Return the columns of each kind, from its first complete group, and the unused columns.

    A column that the log names (``aliases``) goes before one that happens to have the name.
    """
    names, by_stem = _rename_columns(names, aliases, shown), dict[str, list[str]]()
    for name in names:
        by_stem.setdefault(split_unit(name)[0], []).append(name)
    for name in aliases:
        by_stem[split_unit(name)[0]] = [name]
    chosen: dict[str, tuple[str, ...]] = {}
    for kind, groups in kinds.items():
        found = next((one for one in groups if all(stem in by_stem for stem in one)), None)
        if found is None:
            if kind in optional:
                continue
            there = f"{', '.join(names[:30])[:300] or 'none'}{_NAMELESS * all(map(is_number, names))}"
            raise ConfigError(f"{shown}: no columns for {kind}: {list_names(groups)}; there are {there}")
        for stem, dimension in found.items():
            if len(by_stem[stem]) > 1:
                same = " and ".join(map(repr, by_stem[stem]))
                raise ConfigError(f"{shown}: {same} are the same quantity. give one of them")
            unit = split_unit(by_stem[stem][0])[1]
            if unit not in UNITS[dimension]:
                raise ConfigError(
                    f"{shown}: column {by_stem[stem][0]!r} must end in its unit: "
                    f"{' or '.join(_add_unit(stem, u) for u in UNITS[dimension]) or stem}"
                )
        chosen[kind] = tuple(by_stem[stem][0] for stem in found)
    used = {name for one in chosen.values() for name in one}
    return chosen, tuple(name for name in names if name not in used)


def _add_unit(stem: str, unit: str) -> str:
    ending = unit.replace("1/min", "rpm").replace("m/s^2", "m_s2").replace("m/s", "mps")
    return f"{stem}_{ending.replace('/', '_').replace('-', '').lower()}".rstrip("_")
