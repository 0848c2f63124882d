"""The columns of the files: declared by a record class, or with a number that depends on the record."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from types import SimpleNamespace

import numpy as np

from bench.core.mathematics.units import unit_of
from bench.core.records.data import (
    STATES,
    TIME_OFFSET,
    GnssObservations,
    Innovations,
    NavSolution,
    Trajectory,
)
from bench.core.records.fields import Column, columns_of
from bench.core.records.instruments import INSTRUMENTS
from bench.core.records.run_records import SensorTruth

Layout = Mapping[str, Column]
"""Field of a record -> its columns."""

_CODED = columns_of(Innovations)
_SENSOR = {"code": ("sensor", replace(_CODED["code"], kind=str))}
INNOVATIONS: Layout = dict(_SENSOR.get(name, (name, column)) for name, column in _CODED.items())
"""Innovations in a file: each row holds the name of the sensor instead of its code."""
TRUTH: Layout = columns_of(Trajectory)
MOTION: Layout = {name: TRUTH[name] for name in ("t", "lla", "vel_n", "q_nb")}

_BETWEEN = ("dtheta_b", "dvel_b")
"""Columns of the truth with a row for each interval between two epochs."""

_BANDED = {"frequency": "hz", "pseudorange": "m", "range_rate": "mps", "cn0": "dbhz"}


def layout_of(record: object) -> Layout:
    """Return the layout of the columns of a record."""
    if isinstance(record, SensorTruth):
        return drawn_layout(tuple(record.bias))
    if isinstance(record, Innovations):
        return INNOVATIONS
    if isinstance(record, GnssObservations):
        return observation_layout(record.pseudorange.shape[1])
    if isinstance(record, NavSolution):
        return solution_layout(record.extra_names)
    return columns_of(type(record))


def flatten(record: object) -> tuple[object, Layout]:
    """Return an object with one field for each column of a record, and the layout of these columns."""
    layout = layout_of(record)
    if not isinstance(record, Trajectory | SensorTruth | Innovations):
        return record, layout
    return take_block(record, layout, slice(0, None)), layout


def take_block(record: object, layout: Layout, rows: slice) -> object:
    """Return an object with some rows of each column of a record; ``rows`` has a start."""
    block: dict[str, object] = {}
    for name in layout:
        if isinstance(record, Innovations) and name == "sensor":
            block[name] = tuple(record.sensor[code] for code in record.code[rows])
        elif isinstance(record, SensorTruth) and name in record.bias:
            block[name] = record.bias[name][rows]
        elif isinstance(record, Trajectory) and name in _BETWEEN:
            stop = None if rows.stop is None else rows.stop - 1
            increments = getattr(record, name)[max(rows.start - 1, 0) : stop]
            none = np.full((1, 3), np.nan)  # the first epoch ends no interval
            block[name] = increments if rows.start else np.vstack([none, increments])
        else:
            block[name] = getattr(record, name)[rows]
    return SimpleNamespace(**block)


def observation_layout(bands: int) -> Layout:
    """Return the layout of GNSS observations on one or more carriers."""
    layout = dict(columns_of(GnssObservations))
    for stem, unit in _BANDED.items():
        names = [f"{stem}_{band + 1}_{unit}" for band in range(bands)]
        layout[stem] = _rename_columns(layout[stem], names, names)
    return layout


def drawn_layout(on_board: Sequence[str]) -> Layout:
    """Return the layout of the drawn sensor errors, with the biases of the instruments on board."""
    return {**columns_of(SensorTruth)} | {name: INSTRUMENTS[name].bias for name in on_board}


def solution_layout(extra_names: Sequence[str]) -> Layout:
    """Return the layout of a solution with the given states beyond position, velocity, attitude."""
    layout = dict(columns_of(NavSolution))
    for field, stem in (("extra", "state"), ("extra_sd", "sd")):
        layout[field] = _rename_columns(
            layout[field], [f"{stem}_{name}" for name in extra_names], extra_names
        )
    if TIME_OFFSET in extra_names:
        names, units = zip(*STATES, strict=True)
        named = tuple(f"cov_time_offset_{name}" for name in names)
        layout["offset_cov"] = Column(named, tuple(f"s {unit}" for unit in units), "n", (9,), float)
    return layout


def _rename_columns(column: Column, names: Sequence[str], with_unit: Sequence[str]) -> Column:
    """Return a column under new names; names in ``with_unit`` end in their unit."""
    units = tuple(unit_of(name) or "1" for name in with_unit)
    return replace(column, names=tuple(names), units=units, shape=(len(names),))
