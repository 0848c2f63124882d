"""Parquet and CSV files of records; the metadata of each column contains its unit and frame.

pyarrow is imported by the functions that use it, so that a program without such files does not wait.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from bench.core.files import disk_arrays, durable
from bench.core.records.fields import Column
from bench.io.results.columns import Layout, layout_of, take_block

if TYPE_CHECKING:
    import pyarrow as pa

GROUP = 1 << 21  # values of a table that are written and read at a time


def damages() -> tuple[type[Exception], ...]:
    """Return the exceptions of reading a file that is damaged or was not written by bench."""
    from pyarrow import ArrowException

    return (
        ArrowException,
        LookupError,
        TypeError,
        ValueError,
        ArithmeticError,
        AttributeError,
        MemoryError,
        RecursionError,
        OSError,
    )


def write(path: Path, record: object, layout: Layout | None = None, **facts: Any) -> None:
    """Write a record, or the fields of it that a layout names, with ``facts`` as JSON metadata.

    Raises
    ------
    OSError
        If the file cannot be written.
    """
    import pyarrow.parquet as pq

    columns = layout_of(record) if layout is None else layout
    tables = _cut_tables(record, columns, facts)
    table = next(tables)
    with (
        durable.open_binary(path) as out,
        pq.ParquetWriter(out, table.schema, compression="zstd", use_dictionary=False) as file,
    ):
        for one in chain([table], tables):
            file.write_table(one)


def _cut_tables(record: object, columns: Layout, facts: Mapping[str, Any]) -> Iterator[pa.Table]:
    """Yield a record as successive tables of a few MB, at least one."""
    count = len(getattr(record, next(iter(columns))))
    step = max(1, GROUP // max(1, sum(len(one.names) for one in columns.values())))
    for first in range(0, max(count, 1), step):
        if first:
            disk_arrays.release()
        yield to_table(take_block(record, columns, slice(first, first + step)), columns, facts)


def write_csv(path: Path, record: object, layout: Layout) -> None:
    """Write the fields of a record that a layout names as CSV, with a header and all digits of each number.

    Booleans are 1 and 0, missing values ``nan``. Errors as for `write`.
    """
    import pyarrow as pa
    from pyarrow import csv

    names = [name for one in layout.values() for name in one.names]
    with durable.open_binary(path) as file:
        file.write((",".join(names) + "\n").encode())
        for table in _cut_tables(record, layout, {}):
            for k, field in enumerate(table.schema):
                if field.type == pa.bool_():
                    table = table.set_column(k, field.name, table.column(k).cast(pa.int8()))
            csv.write_csv(table, file, csv.WriteOptions(include_header=False))


def write_frame(path: Path, columns: Mapping[str, Any]) -> None:
    """Write named columns of numbers (N,) without metadata; errors as for `write`."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    with durable.open_binary(path) as file:
        pq.write_table(pa.table(dict(columns)), file, compression="zstd", use_dictionary=False)


def write_rows(path: Path, rows: Any, above: str = "") -> None:
    """Write rows of numbers (N, k) as text: no header, separated by a space, with all digits.

    ``above`` is a line before them.

    Errors as for `write`.
    """
    import pyarrow as pa
    from pyarrow import csv

    columns = [np.ascontiguousarray(column) for column in np.asarray(rows).T]
    table = pa.table(columns, names=[str(k) for k in range(len(columns))])
    with durable.open_binary(path) as file:
        file.write(above.encode())
        csv.write_csv(table, file, csv.WriteOptions(include_header=False, delimiter=" "))


def to_table(record: object, layout: Layout, facts: Mapping[str, Any]) -> pa.Table:
    """Return the fields of a record that a layout names as an Arrow table, with unit and frame metadata."""
    import pyarrow as pa

    fields, arrays = [], []
    for name, columns in layout.items():
        value = getattr(record, name)
        flat: list[Any] = [value]
        if not isinstance(value, tuple):
            rows = np.reshape(value, (len(value), len(columns.names)))
            flat = [np.ascontiguousarray(column) for column in rows.T]
        for column, unit, data in zip(columns.names, columns.units, flat, strict=True):
            array = _to_arrow(data)
            metadata = {"unit": unit} | ({"frame": columns.frame} if columns.frame else {})
            fields.append(pa.field(column, array.type, nullable=False, metadata=metadata))
            arrays.append(array)
    return pa.Table.from_arrays(arrays, schema=pa.schema(fields, metadata={"bench": json.dumps(facts)}))


def _to_arrow(data: Any) -> pa.Array:
    """Return an array or words as an Arrow array without ``pa.array``, which imports pandas."""
    import pyarrow as pa

    if isinstance(data, tuple):
        words = [word.encode() for word in data]
        ends = pa.py_buffer(np.cumsum([0, *map(len, words)], dtype=np.int32))
        return pa.Array.from_buffers(pa.string(), len(words), [None, ends, pa.py_buffer(b"".join(words))])
    if data.dtype == np.bool_:
        bits = pa.py_buffer(np.packbits(data, bitorder="little"))
        return pa.Array.from_buffers(pa.bool_(), len(data), [None, bits])
    return pa.Array.from_buffers(pa.from_numpy_dtype(data.dtype), len(data), [None, pa.py_buffer(data)])


_NUMBERS = {"double": np.float64, "int64": np.int64, "bool": np.bool_}
"""Type in a file -> type in memory."""


def _to_numpy(column: pa.ChunkedArray) -> Any:
    """Return a column of a table as an array without its ``to_numpy``, which imports pandas."""
    kind = _NUMBERS.get(str(column.type))
    if column.null_count or kind is None:
        return column.to_numpy()
    parts: list[Any] = []
    for chunk in column.chunks:
        first, last, memory = chunk.offset, chunk.offset + len(chunk), chunk.buffers()[1]
        if kind is np.bool_:
            bits = np.unpackbits(np.frombuffer(memory, np.uint8), count=last, bitorder="little")
            parts.append(bits[first:].astype(np.bool_))
        else:
            parts.append(np.frombuffer(memory, kind)[first:last])
    return np.concatenate(parts) if parts else np.empty(0, kind)


def read(path: Path, layout: Layout) -> dict[str, Any]:
    """Read the fields of a layout, by name, in the shapes that their record declares."""
    import pyarrow.parquet as pq

    found: dict[str, Any] = {}
    with pq.ParquetFile(path) as file:
        count = file.metadata.num_rows
        if file.num_row_groups == 1:
            table = file.read()
            return {name: _get_field(table, one) for name, one in layout.items()}
        filled = 0
        for group in range(file.num_row_groups):
            table = file.read_row_group(group)
            for name, one in layout.items():
                rows = _get_field(table, one)
                if isinstance(rows, tuple):
                    found[name] = found.get(name, ()) + rows
                    continue
                if name not in found:
                    found[name] = disk_arrays.empty((count, *rows.shape[1:]), rows.dtype.type)
                found[name][filled : filled + len(rows)] = rows
            filled += table.num_rows
            disk_arrays.release()
    return found


def read_names(path: Path) -> Sequence[str]:
    """Return the names of the columns of a file."""
    import pyarrow.parquet as pq

    return pq.read_schema(path).names  # type: ignore[no-any-return]


def read_facts(path: Path) -> Mapping[str, Any]:
    """Return the facts that `write` stored beside the columns of a file."""
    import pyarrow.parquet as pq

    return json.loads(pq.read_schema(path).metadata[b"bench"])  # type: ignore[no-any-return]


def _get_field(table: pa.Table, one: Column) -> Any:
    names, shape = one.names, one.shape
    for name in names:
        if (str(table.schema.field(name).type) == "string") != (one.kind is str):
            raise TypeError(f"column {name!r} must hold {'text' if one.kind is str else 'numbers'}")
    if one.kind is str:
        return tuple(table.column(names[0]).cast("string").fill_null("").to_pylist())
    columns = [_to_numpy(table.column(name)) for name in names]
    rows = np.column_stack(columns) if columns else np.empty((table.num_rows, 0))
    return rows.reshape(len(rows), *(n for n in shape if n is not None))


def write_table(path: Path, columns: Mapping[str, Any], units: Mapping[str, str], **facts: Any) -> None:
    """Write named columns (N,), of numbers, of lists with None for missing values or of Arrow, atomically.

    Parameters
    ----------
    units : mapping
        Column -> its unit, in the metadata of the column.
    facts : object
        JSON metadata of the table.
    """
    import pyarrow as pa
    import pyarrow.parquet as pq

    arrays = [
        column if isinstance(column, pa.Array | pa.ChunkedArray) else pa.array(column)
        for column in columns.values()
    ]
    fields = [
        pa.field(name, array.type, metadata={"unit": units[name]} if name in units else None)
        for name, array in zip(columns, arrays, strict=True)
    ]
    schema = pa.schema(fields, metadata={"bench": json.dumps(facts)})
    with durable.open_binary(path) as file:
        pq.write_table(pa.Table.from_arrays(arrays, schema=schema), file, compression="zstd")


def read_table(path: Path) -> pa.Table:
    """Read a file of :func:`write_table`."""
    import pyarrow.parquet as pq

    table = pq.read_table(path)
    table.validate(full=True)  # words are words
    return table
