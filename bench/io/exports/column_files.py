"""CSV and Parquet: one file per table; column names give quantity, frame and unit."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from bench.core.files import durable
from bench.core.records.instruments import INSTRUMENTS
from bench.io.exports.outgoing import ExportData
from bench.io.results import parquet, write_json
from bench.io.results.columns import Layout

FORMATS = {
    "csv": "CSV: a table per sensor, every digit; output: the epochs asked for; start.json: the start",
    "parquet": "the same in Parquet, with units and frames in its metadata",
}
START = "start.json"

_WHAT = {
    "imu": "output of the IMU: increments (not rates) over the interval of length dt_s that ends at t_s",
    "gnss": "fixes of the GNSS antenna; t_s: time of validity, t_arrival_s: arrival at the filter",
    "observations": "measurements of the receiver, one row per satellite and epoch",
    **{name: row.contents for name, row in INSTRUMENTS.items()},
    "truth": "the true motion of the IMU",
}


def write(folder: Path, out: ExportData, kind: str) -> str:
    """Write one file per table, and ``start.json``; return their description for the README."""
    tables = out.tables()
    for name, (record, layout) in tables.items():
        if kind == "csv":
            parquet.write_csv(folder / f"{name}.csv", record, layout)
        else:
            parquet.write(folder / f"{name}.parquet", record, layout)
    if len(out.output_t):
        if kind == "csv":
            with durable.open_text(folder / "output.csv") as file:
                np.savetxt(file, out.output_t, fmt="%.9f", header="t_s", comments="")
        else:
            parquet.write_frame(folder / "output.parquet", {"t_s": out.output_t})
    write_json(folder / START, out.start)
    described = [describe_table(name, layout, f"{name}.{kind}") for name, (_, layout) in tables.items()]
    if len(out.output_t):
        described.append(_OUTPUT.format(kind=kind))
    return "\n".join(described) + _START


_OUTPUT = """## output.{kind}

`t_s` [s]: the epochs at which the filters of the run were asked for a solution.
"""
_START = f"""
## {START}

What a filter gets besides the measurements, in SI and radians. `initial`: time, position, velocity and
attitude of the IMU at the start, and `cov`, the covariance (9 x 9) of their errors: position north, east,
down [m], velocity [m/s], attitude phi [rad] (`C_nb_estimate = exp([phi x]) C_nb_true`). `antenna_b_m`: the
GNSS antenna relative to the IMU. `ground_alt_m`: ellipsoidal height of the runway. `assumed`: the datasheets
of the sensors: random walks per sqrt(s), biases per s, times in s. `date`: date of the flight as a decimal
year.
"""


def describe_table(name: str, layout: Layout, title: str) -> str:
    """Return the columns of a table with their units and frames, as Markdown."""
    content = _WHAT.get(name, "the solution of a filter, with the covariance it reports")
    lines = [
        f"## {title}\n",
        f"{content[0].upper()}{content[1:]}.\n",
        "| column | unit | frame |",
        "|---|---|---|",
    ]
    for columns in layout.values():
        names, units = columns.names, columns.units
        if len(names) > 9:
            lines.append(
                f"| {names[0]} ... {names[-1]}, {len(names)} columns | by their names | {columns.frame} |"
            )
            continue
        lines += [f"| {n} | {u} | {columns.frame} |" for n, u in zip(names, units, strict=True)]
    return "\n".join(lines) + "\n"
