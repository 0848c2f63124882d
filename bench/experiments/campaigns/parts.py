"""Parts of a journal: up to a thousand finished runs each, a Parquet file with a column for each value.

The key of a run is its cell and its number. The ``shape`` of a row numbers the columns that it has, so that a
row is read back as it was. Parts are found by their keys alone; the other columns are read when rows are.
"""

from __future__ import annotations

import json
import re
from base64 import b64decode, b64encode
from collections import OrderedDict
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from bench.core.files import durable
from bench.core.mathematics.arrays import BoolArray, IntArray
from bench.core.words.exceptions import ConfigError
from bench.io.results.parquet import damages

if TYPE_CHECKING:
    import pyarrow as pa
    import pyarrow.parquet as pq

ROWS = 1000
"""Most runs of a part."""

Row = dict[str, Any]
"""A finished run, as a worker returns it."""

_NAME = re.compile(r"journal-(\d{5,9})\.parquet")
_INDEX = ("cell", "run", "shape")
_INSTANTS, _JSON = b"instants", b"json"  # what a column of another kind than its type holds
_OPEN = 4  # parts whose rows are in memory
_LARGEST = 1 << 29  # part in memory [byte]
_MOST_COLUMNS = 50_000
_PLACE = np.dtype([("run", "i8"), ("part", "i4"), ("row", "i4"), ("failed", "?")])


def list_parts(folder: Path) -> list[str]:
    """Return the names of the parts in a folder, in the order in which they were written."""
    found = (path.name for path in folder.glob("journal-*.parquet") if _NAME.fullmatch(path.name))
    return sorted(found, key=lambda name: (len(name), name))


def split_key(key: str) -> tuple[str, int]:
    """Return the cell and the number of a run from its key; -1 for a key without a number."""
    cell, dash, number = key.rpartition("-")
    if dash and len(number) < 18 and number.isdecimal() and number.isascii() and str(int(number)) == number:
        return cell, int(number)
    return key, -1


def _join_key(cell: str, run: int) -> str:
    return cell if run < 0 else f"{cell}-{run}"


def write_part(path: Path, rows: Sequence[Row]) -> None:
    """Write rows with their ``key`` as a part, completely or not at all.

    Raises
    ------
    OSError
        If the file cannot be written.
    """
    write_table(path, make_table(rows))


def make_table(rows: Sequence[Row]) -> pa.Table:
    """Return rows with their ``key`` as the table of a part."""
    import pyarrow as pa

    shapes: dict[tuple[tuple[str, ...], ...], int] = {}
    columns: dict[tuple[str, ...], list[Any]] = {}
    cells, runs = zip(*(split_key(row["key"]) for row in rows), strict=True)
    numbers = []
    for k, row in enumerate(rows):
        leaves = dict(_flatten({name: value for name, value in row.items() if name != "key"}))
        numbers.append(shapes.setdefault(tuple(leaves), len(shapes)))
        for name, value in leaves.items():
            columns.setdefault(name, [None] * len(rows))[k] = value
    arrays = [pa.array(cells, pa.string()), pa.array(runs, pa.int64()), pa.array(numbers, pa.int32())]
    fields = [pa.field(name, array.type) for name, array in zip(_INDEX, arrays, strict=True)]
    for name, values in columns.items():
        array, kind = _to_arrow(name, values)
        words = "/".join(word.replace("~", "~0").replace("/", "~1") for word in name)
        fields.append(pa.field(words, array.type, metadata={"kind": kind} if kind else None))
        arrays.append(array)
    order = {name: k for k, name in enumerate(columns)}
    facts = {"columns": list(columns), "shapes": [[order[name] for name in shape] for shape in shapes]}
    metadata = {"journal": json.dumps(facts, separators=(",", ":"))}
    return pa.Table.from_arrays(arrays, schema=pa.schema(fields, metadata=metadata))


def write_table(path: Path, table: pa.Table) -> None:
    """Write the table of a part, with checksums; errors as for `write_part`."""
    import pyarrow.parquet as pq

    kinds = {field.name: str(field.type) for field in table.schema}
    real = [name + _leaf(kind) for name, kind in kinds.items() if "float" in kind or "double" in kind]
    words = [name for name, kind in kinds.items() if kind in ("string", "bool")]
    with durable.open_binary(path) as file:
        pq.write_table(
            table, file, compression="zstd", use_dictionary=words, use_byte_stream_split=real,
            write_statistics=False, write_page_checksum=True,
        )  # fmt: skip


def _leaf(kind: str) -> str:
    return ".list.element" if kind.startswith("list") else ""


def _flatten(row: Mapping[str, Any], above: tuple[str, ...] = ()) -> Iterator[tuple[tuple[str, ...], Any]]:
    """Yield the values of a row, each with the names that lead to it."""
    for name, value in row.items():
        if isinstance(value, dict) and value:
            yield from _flatten(value, (*above, name))
        else:
            yield (*above, name), value


def _to_arrow(name: tuple[str, ...], values: list[Any]) -> tuple[pa.Array, bytes]:
    """Return a column, and its kind if that does not follow from its type."""
    import pyarrow as pa

    if name[0] == "estimators" and name[2:] == ("instants",):
        known = [None if one is None else np.frombuffer(b64decode(one), "<f4") for one in values]
        return pa.array(known, pa.list_(pa.float32())), _INSTANTS
    kinds = {type(value) for value in values} - {type(None)}
    of_floats = kinds == {list} and all({type(one) for one in value} == {float} for value in values if value)
    try:
        if kinds <= {float} or kinds in ({int}, {bool}, {str}):
            return pa.array(values, pa.float64() if kinds <= {float} else None), b""
        if of_floats and [] not in values:
            return pa.array(values, pa.list_(pa.float64())), b""
    except (OverflowError, pa.ArrowException):  # an integer of more than 64 bits, half a character
        pass
    return pa.array([None if one is None else json.dumps(one) for one in values], pa.string()), _JSON


def read_rows(path: Path) -> list[Row]:
    """Return all rows of a part; errors of `damages` if it is damaged."""
    with _open(path) as file:
        table = file.read()
    table.validate(full=True)
    facts = json.loads(table.schema.metadata[b"journal"])
    names = [tuple(map(str, name)) for name in facts["columns"]]
    columns = [_to_python(table.column(k + len(_INDEX))) for k in range(len(names))]
    for k in range(len(names)):
        kind = (table.schema.field(k + len(_INDEX)).metadata or {}).get(b"kind")
        if kind == _INSTANTS:
            columns[k] = [_encode(one) for one in columns[k]]
        elif kind == _JSON:
            columns[k] = [None if one is None else json.loads(one) for one in columns[k]]
    below = []  # of each shape: names that lead to a dictionary -> its values
    for shape in facts["shapes"]:
        found: dict[tuple[str, ...], dict[str, list[Any]]] = {}
        for k in shape:
            found.setdefault(names[k][:-1], {})[names[k][-1]] = columns[k]
        below.append(found)
    rows = []
    cells, runs, shapes = (table.column(name).to_pylist() for name in _INDEX)
    for k, (cell, run, number) in enumerate(zip(cells, runs, shapes, strict=True)):
        row: Row = {"key": _join_key(cell, run)}
        for above, values in below[number].items():
            place = row
            for name in above:
                place = place.setdefault(name, {})
            place.update({name: column[k] for name, column in values.items()})
        rows.append(row)
    return rows


def _to_python(column: pa.ChunkedArray) -> list[Any]:
    found: list[Any] = column.to_numpy().tolist() if _is_plain(column) else column.to_pylist()
    return found


def _is_plain(column: pa.ChunkedArray) -> bool:
    return str(column.type) in ("double", "int64") and not column.null_count


def _encode(values: Any) -> str | None:
    with np.errstate(all="ignore"):
        return None if values is None else b64encode(np.asarray(values, "<f4").tobytes()).decode()


def _open(path: Path) -> pq.ParquetFile:
    """Open a part; ValueError if it is larger than a part can be."""
    import pyarrow.parquet as pq

    file = pq.ParquetFile(path, page_checksum_verification=True)
    found = file.metadata
    size = sum(found.row_group(k).total_byte_size for k in range(found.num_row_groups))
    if found.num_rows > ROWS or found.num_columns > _MOST_COLUMNS or size > _LARGEST:
        file.close()
        raise ValueError("is larger than a part")
    return file


class Parts:
    """The parts of a journal: where the row of a key is; if a run is in several, the last one counts.

    Parameters
    ----------
    folder : Path
        Its parts that cannot be read count as ``damaged``: their runs are made again.
    check : callable
        Raises ValueError for a row that no run writes.
    """

    def __init__(self, folder: Path, check: Callable[[Row], None]) -> None:
        self._folder, self._check = folder, check
        self._names: list[str] = []
        self._labels: list[list[frozenset[str]]] = []  # of each part: the filters of each shape
        self._places: dict[str, list[np.ndarray[Any, Any]]] = {}
        self._shapes: list[IntArray] = []
        self._rows: OrderedDict[int, list[Row]] = OrderedDict()
        self.labels: tuple[str, ...] = ()  # of the first run that did not fail completely
        self.damaged = 0
        for name in list_parts(folder):
            try:
                self._add(name)
            except damages():
                self.damaged += 1

    def __len__(self) -> int:
        return len(self._names)

    def _add(self, name: str) -> None:
        """Add the keys of a part to the index."""
        with _open(self._folder / name) as file:
            facts = json.loads(file.schema_arrow.metadata[b"journal"])
            table = file.read(list(_INDEX))
        if [str(one.type) for one in table.schema] != ["string", "int64", "int32"]:
            raise TypeError("has no keys of runs")
        names = [[tuple(map(str, facts["columns"][k])) for k in shape] for shape in facts["shapes"]]
        failed = np.array([("error",) in shape for shape in names], np.bool_)
        labels = [
            dict.fromkeys(one[1] for one in shape if one[0] == "estimators" and one[1:]) for shape in names
        ]
        cells = table.column("cell").combine_chunks().dictionary_encode()
        runs, shapes = (np.asarray(table.column(one).to_numpy(), np.int64) for one in _INDEX[1:])
        places = np.zeros(len(runs), _PLACE)
        places["run"], places["part"] = runs, len(self._names)
        places["row"], places["failed"] = np.arange(len(runs)), failed[shapes]
        places = places[order := np.argsort(runs, kind="stable")]
        which = cells.indices.to_numpy()[order]
        for k, cell in enumerate(cells.dictionary.to_pylist()):
            self._places.setdefault(str(cell), []).append(places[which == k])
        if not self.labels:
            self.labels = next((tuple(labels[k]) for k in shapes if labels[k]), ())
        self._names.append(name)
        self._labels.append([frozenset(one) for one in labels])
        self._shapes.append(shapes.astype(np.int32))

    def write(self, rows: Sequence[Row], before: Callable[[str], None]) -> None:
        """Write a part; ``before`` gets its name. Errors as for `write_part`."""
        last = max((int(name[8:-8]) for name in list_parts(self._folder)), default=0)
        name = f"journal-{last + 1:05d}.parquet"
        before(name)
        write_part(self._folder / name, rows)
        self._add(name)

    def _find(self, cell: str) -> Any:
        """Return the places of the runs of a cell, by the number of the run."""
        found = self._places.get(cell)
        if found is None:
            return np.empty(0, _PLACE)
        if len(found) > 1:
            every = np.concatenate(found)
            every = every[np.argsort(every["run"], kind="stable")]
            last = np.append(np.diff(every["run"]) != 0, True)
            self._places[cell] = found = [every[last]]
        return found[0]

    def _locate(self, key: str) -> Any:
        cell, run = split_key(key)
        places = self._find(cell)
        at = int(np.searchsorted(places["run"], run))
        return places[at] if at < len(places) and places["run"][at] == run else None

    def find_finished(self, cell: str, runs: IntArray) -> BoolArray:
        """Return for each number of a run whether it is here and did not fail as a whole."""
        places = self._find(cell)
        return np.isin(runs, places["run"][~places["failed"]])

    def __contains__(self, key: object) -> bool:
        return isinstance(key, str) and self._locate(key) is not None

    def __getitem__(self, key: str) -> Row:
        """Return a row; ConfigError if its part is damaged."""
        place = self._locate(key)
        if place is None:
            raise KeyError(key)
        part = int(place["part"])
        if part not in self._rows:
            while len(self._rows) >= _OPEN:
                self._rows.popitem(last=False)
            path = self._folder / self._names[part]
            try:
                rows = read_rows(path)
                for row in rows:
                    self._check(row)
            except damages() as error:
                why = f"{path}: damaged; remove it, and --resume repeats its runs"
                raise ConfigError(why) from error
            self._rows[part] = rows
        self._rows.move_to_end(part)
        return self._rows[part][int(place["row"])]

    def list_last(self) -> set[str]:
        """Return the keys of the last part."""
        last = len(self._names) - 1
        return {
            _join_key(cell, int(run))
            for cell in self._places
            for run in self._find(cell)["run"][self._find(cell)["part"] == last]
        }

    def keep_runs_of(self, labels: frozenset[str]) -> int:
        """Forget the runs of other estimators and return their number."""
        other = [np.array([bool(one) and one != labels for one in part]) for part in self._labels]
        if not any(one.any() for one in other):
            return 0
        forgotten = 0
        for cell in self._places:
            places = self._find(cell)
            kept = [not other[part][self._shapes[part][row]] for _, part, row, _ in places]
            forgotten += len(kept) - sum(kept)
            self._places[cell] = [places[np.array(kept, np.bool_)]]
        return forgotten
