"""Parquet and CSV files of records; the metadata of each column holds its unit and frame."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from pyarrow import csv

from bench.store.columns import Layout, flatten

DAMAGED = (
    pa.ArrowException,
    LookupError,
    TypeError,
    ValueError,
    ArithmeticError,
    AttributeError,
    MemoryError,
    RecursionError,
    OSError,
)
"""What reading raises if a file is damaged or was not written by bench."""


def write(path: Path, record: object, layout: Layout | None = None, **facts: Any) -> None:
    """Write a record, or the fields of it that a layout names, with ``facts`` as JSON metadata.

    Raises
    ------
    OSError
        If the file cannot be written.
    """
    rows, columns = (record, layout) if layout is not None else flatten(record)
    pq.write_table(to_table(rows, columns, facts), path, compression="zstd", use_dictionary=False)


def write_csv(path: Path, record: object, layout: Layout) -> None:
    """Write the fields of a record that a layout names as CSV, with a header and all digits of each number.

    Booleans are 1 and 0, missing values ``nan``. Errors as for `write`.
    """
    table = to_table(record, layout, {})
    for k, field in enumerate(table.schema):
        if field.type == pa.bool_():
            table = table.set_column(k, field.name, table.column(k).cast(pa.int8()))
    with path.open("wb") as file:
        file.write((",".join(table.column_names) + "\n").encode())
        csv.write_csv(table, file, csv.WriteOptions(include_header=False))


def write_frame(path: Path, columns: Mapping[str, Any]) -> None:
    """Write named columns of numbers (N,) without metadata; errors as for `write`."""
    pq.write_table(pa.table(dict(columns)), path, compression="zstd", use_dictionary=False)


def write_text(path: Path, rows: Any) -> None:
    """Write rows of numbers (N, k) as text: no header, separated by a space, with all digits.

    Errors as for `write`.
    """
    columns = [np.ascontiguousarray(column) for column in np.asarray(rows).T]
    table = pa.table(columns, names=[str(k) for k in range(len(columns))])
    with path.open("wb") as file:
        csv.write_csv(table, file, csv.WriteOptions(include_header=False, delimiter=" "))


def to_table(record: object, layout: Layout, facts: Mapping[str, Any]) -> pa.Table:
    """Return the fields of a record that a layout names as an Arrow table, with unit and frame metadata."""
    fields, arrays = [], []
    for name, columns in layout.items():
        value = getattr(record, name)
        flat: list[Any] = [value]
        if not isinstance(value, tuple):
            rows = np.reshape(value, (len(value), len(columns.names)))
            flat = [np.ascontiguousarray(column) for column in rows.T]
        for column, unit, data in zip(columns.names, columns.units, flat, strict=True):
            array = pa.array(data, type=pa.string() if isinstance(data, tuple) else None)
            metadata = {"unit": unit} | ({"frame": columns.frame} if columns.frame else {})
            fields.append(pa.field(column, array.type, nullable=False, metadata=metadata))
            arrays.append(array)
    return pa.Table.from_arrays(arrays, schema=pa.schema(fields, metadata={"bench": json.dumps(facts)}))


def read(path: Path, layout: Layout) -> dict[str, Any]:
    """Read the fields of a layout, by name, in the shapes that their record declares."""
    table = pq.read_table(path)
    return {name: _get_field(table, columns.names, columns.shape) for name, columns in layout.items()}


def read_names(path: Path) -> Sequence[str]:
    """Return the names of the columns of a file."""
    return pq.read_schema(path).names  # type: ignore[no-any-return]


def read_facts(path: Path) -> Mapping[str, Any]:
    """Return the facts that `write` stored beside the columns of a file."""
    return json.loads(pq.read_schema(path).metadata[b"bench"])  # type: ignore[no-any-return]


def _get_field(table: pa.Table, names: tuple[str, ...], shape: tuple[int | None, ...]) -> Any:
    if names and table.schema.field(names[0]).type == pa.string():
        return tuple(table.column(names[0]).to_pylist())
    columns = [table.column(name).to_numpy() for name in names]
    rows = np.column_stack(columns) if columns else np.empty((table.num_rows, 0))
    return rows.reshape(len(rows), *(n for n in shape if n is not None))
