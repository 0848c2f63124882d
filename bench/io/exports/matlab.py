"""One MATLAB file with one structure per table; the fields are the columns of the CSV tables."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from bench.core.files import durable
from bench.io.exports.column_files import describe_table
from bench.io.exports.outgoing import ExportData

FORMATS = {"mat": "one MATLAB file, a structure per sensor"}
FILE = "run.mat"


def write(folder: Path, out: ExportData, kind: str) -> str:
    """Write ``run.mat``; return its description for the README."""
    from scipy.io import savemat

    tables = out.tables()
    variables: dict[str, Any] = {}
    for name, (record, layout) in tables.items():
        fields = {}
        for field, columns in layout.items():
            value = getattr(record, field)
            rows = np.reshape(value, (len(value), len(columns.names)))
            fields.update({n: rows[:, k].astype(float) for k, n in enumerate(columns.names)})
        variables[_name_variable(name)] = fields
    variables["start"] = _to_matlab(out.start)
    with durable.open_binary(folder / FILE) as file:
        savemat(file, variables, long_field_names=True, oned_as="column", do_compression=True)
    columns_text = "\n".join(
        describe_table(name, layout, _name_variable(name)) for name, (_, layout) in tables.items()
    )
    return (
        f"`load('{FILE}')` gives a structure for each section below, with a field per column, and `start`: "
        "what a filter gets besides the measurements, in SI and radians: `initial` (with `cov`, 9 x 9: "
        "position north, east, down, velocity, attitude), `antenna_b_m`, and `assumed`, the datasheets. "
        f"A missing value is an empty array, in an array it is NaN.\n\n{columns_text}"
    )


def _name_variable(name: str) -> str:
    longest = 63  # namelengthmax of MATLAB
    return "".join(c if c.isalnum() else "_" for c in name)[:longest]


def _to_matlab(value: Any) -> Any:
    """Convert a JSON value for MATLAB; null becomes an empty array, in an array of numbers NaN."""
    if value is None:
        return np.empty((0, 0))
    if isinstance(value, Mapping):
        return {key: _to_matlab(inner) for key, inner in value.items()}
    if isinstance(value, list | tuple):
        return np.array(value, float)
    return value
