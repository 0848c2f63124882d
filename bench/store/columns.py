"""The columns of files: those that records declare, and those of which a record itself gives the number."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

from bench.data import (
    AirData,
    Controls,
    ErrorSeries,
    Events,
    GnssFixes,
    GnssObservations,
    ImuData,
    Innovations,
    NavSolution,
    SensorTruth,
    SkyView,
    Trajectory,
)
from bench.fields import Column, columns_of
from bench.instruments import INSTRUMENTS
from bench.units import unit_of

Layout = Mapping[str, Column]
"""Field of a record -> its columns."""

_TRUTH = columns_of(Trajectory)
MOTION: Layout = {name: _TRUTH[name] for name in ("t", "lla", "vel_n", "q_nb")}
INCREMENTS: Layout = {name: _TRUTH[name] for name in ("dtheta_b", "dvel_b")}
AIR: Layout = columns_of(AirData)
CONTROLS: Layout = columns_of(Controls)
EVENTS: Layout = columns_of(Events)
IMU: Layout = columns_of(ImuData)
GNSS: Layout = columns_of(GnssFixes)
SKY: Layout = columns_of(SkyView)
ERRORS: Layout = columns_of(ErrorSeries)
_CODED = columns_of(Innovations)
INNOVATIONS: Layout = {"sensor" if name == "code" else name: told for name, told in _CODED.items()}
"""With the name of the sensor in each row, instead of its code."""

_BANDED = {"frequency": "hz", "pseudorange": "m", "range_rate": "mps", "cn0": "dbhz"}


def observations(bands: int) -> Layout:
    """Return the layout of GNSS observations on one or more carriers."""
    layout = columns_of(GnssObservations)
    for stem, unit in _BANDED.items():
        names = [f"{stem}_{band + 1}_{unit}" for band in range(bands)]
        layout[stem] = _numbered(layout[stem], names, names)
    return layout


def drawn(on_board: Sequence[str]) -> Layout:
    """Return the layout of what was drawn, the errors of some instruments by their names."""
    return columns_of(SensorTruth) | {name: INSTRUMENTS[name].bias for name in on_board}


def solution(extra_names: Sequence[str]) -> Layout:
    """Return the layout of a solution with the given states beyond position, velocity, attitude."""
    layout = columns_of(NavSolution)
    for field, stem in (("extra", "state"), ("extra_sd", "sd")):
        layout[field] = _numbered(layout[field], [f"{stem}_{name}" for name in extra_names], extra_names)
    return layout


def _numbered(told: Column, names: Sequence[str], measured: Sequence[str]) -> Column:
    """Return a column whose names the record gives, with the units that others end in."""
    units = tuple(unit_of(name) or "1" for name in measured)
    return replace(told, names=tuple(names), units=units, shape=(len(names),))
