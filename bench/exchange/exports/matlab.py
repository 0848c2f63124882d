"""One MATLAB file with a structure per table; the fields are the columns of the CSV tables."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from bench.exchange.exports.column_files import describe_table
from bench.exchange.exports.outgoing import ExportData

FORMATS = {"mat": "one MATLAB file, a structure per sensor"}
FILE = "run.mat"


def write(folder: Path, out: ExportData, kind: str) -> str:
    """Write ``run.mat``; return what the README says of it."""
    from scipy.io import savemat

    tables = out.tables()
    found: dict[str, Any] = {}
    for name, (record, layout) in tables.items():
        fields = {}
        for field, columns in layout.items():
            rows = np.reshape(getattr(record, field), (-1, len(columns.names)))
            fields.update({n: rows[:, k].astype(float) for k, n in enumerate(columns.names)})
        found[_name_variable(name)] = fields
    found["start"] = _to_matlab(out.start)
    savemat(folder / FILE, found, long_field_names=True, oned_as="column", do_compression=True)
    said = "\n".join(
        describe_table(name, layout, _name_variable(name)) for name, (_, layout) in tables.items()
    )
    return (
        f"`load('{FILE}')` gives a structure for each section below, a field per column, and `start`: "
        f"what an "
        "estimator is told beside the measurements, in SI and radians: `initial` (with `cov`, 9 x 9: "
        "position "
        "north, east, down, velocity, attitude), `antenna_b_m`, and `assumed`, the datasheets. What "
        "is empty is "
        f"not there.\n\n{said}"
    )


def _name_variable(name: str) -> str:
    return "".join(c if c.isalnum() else "_" for c in name)[
        :63
    ]  # the longest name MATLAB takes: namelengthmax


def _to_matlab(value: Any) -> Any:
    """Return an object of JSON as MATLAB has it: nothing becomes an empty array."""
    if value is None:
        return np.empty((0, 0))
    if isinstance(value, Mapping):
        return {key: _to_matlab(inner) for key, inner in value.items()}
    if isinstance(value, list | tuple):
        numbers = all(isinstance(inner, int | float) for inner in value)
        return np.array(value, float) if numbers else np.array([_to_matlab(inner) for inner in value], float)
    return value
