"""Rows of values by name, nested, as Parquet files with a column for each value: the parts of a journal.

The key of a row is a cell and the number of a run. The ``shape`` of a row numbers the columns that it has, so
that a row is read back as it was. pyarrow is imported by the functions that use it.
"""

from __future__ import annotations

import json
from base64 import b64decode, b64encode
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from bench.core.files import durable, file_checks
from bench.core.mathematics.arrays import IntArray

if TYPE_CHECKING:
    import pyarrow as pa
    import pyarrow.parquet as pq

Row = dict[str, Any]
"""A row with its ``key``; values may be dictionaries."""

Name = tuple[str, ...]
"""The names that lead to a value."""

_INDEX = ("cell", "run", "shape")
_INSTANTS, _JSON = b"instants", b"json"  # what a column of another kind than its type holds
_LARGEST = 1 << 29  # part in memory [byte]
_MOST_COLUMNS = 50_000


def split_key(key: str) -> tuple[str, int]:
    """Return the cell and the number of a run from its key; -1 for a key without a number."""
    cell, dash, number = key.rpartition("-")
    if dash and len(number) < 18 and number.isdecimal() and number.isascii() and str(int(number)) == number:
        return cell, int(number)
    return key, -1


def join_key(cell: str, run: int) -> str:
    """Return the key of a run."""
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

    shapes: dict[tuple[Name, ...], int] = {}
    columns: dict[Name, list[Any]] = {}
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


def _flatten(row: Mapping[str, Any], above: Name = ()) -> Iterator[tuple[Name, Any]]:
    """Yield the values of a row, each with the names that lead to it."""
    for name, value in row.items():
        if isinstance(value, dict) and value:
            yield from _flatten(value, (*above, name))
        else:
            yield (*above, name), value


def _to_arrow(name: Name, values: list[Any]) -> tuple[pa.Array, bytes]:
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


def read_rows(path: Path, most: int) -> list[Row]:
    """Return all rows of a part of at most so many; errors of `damages` if it is damaged."""
    with _open(path, most) as file:
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
        found: dict[Name, dict[str, list[Any]]] = {}
        for k in shape:
            found.setdefault(names[k][:-1], {})[names[k][-1]] = columns[k]
        below.append(found)
    rows = []
    cells, runs, shapes = (table.column(name).to_pylist() for name in _INDEX)
    for k, (cell, run, number) in enumerate(zip(cells, runs, shapes, strict=True)):
        row: Row = {"key": join_key(cell, run)}
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


def _open(path: Path, most: int) -> pq.ParquetFile:
    """Open a part; ConfigError if it is no file, ValueError if it is larger than a part can be."""
    import pyarrow.parquet as pq

    file_checks.check_file(path, str(path), _LARGEST)
    file = pq.ParquetFile(path, page_checksum_verification=True)
    found = file.metadata
    size = sum(found.row_group(k).total_byte_size for k in range(found.num_row_groups))
    if found.num_rows > most or found.num_columns > _MOST_COLUMNS or size > _LARGEST:
        file.close()
        raise ValueError("is larger than a part")
    return file


def read_index(path: Path, most: int) -> tuple[IntArray, list[str], IntArray, IntArray, list[list[Name]]]:
    """Return what finds the rows of a part; errors as for `read_rows`.

    Returns
    -------
    which, cells
        Number of the cell of each row (R,), and the cells.
    runs, shapes
        Number of the run and of the shape of each row (R,).
    names
        The columns of each shape.
    """
    with _open(path, most) as file:
        facts = json.loads(file.schema_arrow.metadata[b"journal"])
        table = file.read(list(_INDEX))
    if [str(one.type) for one in table.schema] != ["string", "int64", "int32"]:
        raise TypeError("has no keys of runs")
    names = [[tuple(map(str, facts["columns"][k])) for k in shape] for shape in facts["shapes"]]
    cells = table.column("cell").combine_chunks().dictionary_encode()
    runs, shapes = (np.asarray(table.column(one).to_numpy(), np.int64) for one in _INDEX[1:])
    which = np.asarray(cells.indices.to_numpy(), np.int64)
    return which, list(map(str, cells.dictionary.to_pylist())), runs, shapes, names


def stack_rows(rows: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """Return rows of a table as Arrow columns; a column that contains texts has only texts."""
    import pyarrow as pa

    names = dict.fromkeys(name for row in rows for name in row)
    return {name: pa.array(unite([row.get(name) for row in rows])) for name in names}


def join_blocks(blocks: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """Return the columns of successive blocks, each of the type that all its values together have."""
    import pyarrow as pa

    if len(blocks) == 1:
        return dict(blocks[0])
    sizes = [len(next(iter(block.values()), [])) for block in blocks]
    columns: dict[str, Any] = {}
    for name in dict.fromkeys(name for block in blocks for name in block):
        found = [block.get(name, pa.nulls(size)) for block, size in zip(blocks, sizes, strict=True)]
        kinds = {str(one.type) for one in found} - {"null"}
        if len(kinds) > 1 and "string" in kinds:
            found = [pa.array(unite([*one.to_pylist(), ""])[:-1], pa.string()) for one in found]
        kind = next((one.type for one in found if str(one.type) == "double"), None)
        kind = kind or next((one.type for one in found if str(one.type) != "null"), pa.null())
        columns[name] = pa.chunked_array([one.cast(kind) for one in found])
    return columns


def unite(column: list[Any]) -> list[Any]:
    """Return a column of one type; if it contains texts, numbers become texts."""
    if any(isinstance(value, str) for value in column):
        return [value if value is None or isinstance(value, str) else str(value) for value in column]
    return column
