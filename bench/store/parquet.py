"""Records in Parquet files, with the unit and frame of each column in its metadata; the door to pyarrow."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from bench.store.columns import Layout


def write(path: Path, record: object, layout: Layout, **facts: Any) -> None:
    """Write the fields of a record that a layout names, one column each, with facts as JSON metadata.

    Raises
    ------
    OSError
        When the disk does not take it.
    """
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
    schema = pa.schema(fields, metadata={"bench": json.dumps(facts)})
    table = pa.Table.from_arrays(arrays, schema=schema)
    pq.write_table(table, path, compression="zstd", use_dictionary=False)


def read(path: Path, layout: Layout) -> dict[str, Any]:
    """Return the fields of a layout, by name, in the shapes of their record."""
    table = pq.read_table(path)
    return {name: _field(table, columns.names, columns.shape) for name, columns in layout.items()}


def facts(path: Path) -> Mapping[str, Any]:
    """Return what a file says of itself beside its columns."""
    return json.loads(pq.read_schema(path).metadata[b"bench"])  # type: ignore[no-any-return]


def _field(table: pa.Table, names: tuple[str, ...], shape: tuple[int, ...]) -> Any:
    if names and table.schema.field(names[0]).type == pa.string():
        return tuple(table.column(names[0]).to_pylist())
    columns = [table.column(name).to_numpy() for name in names]
    rows = np.column_stack(columns) if columns else np.empty((table.num_rows, 0))
    return rows.reshape(len(rows), *shape)
