"""What an estimator is told beside the measurements: the start, the antenna, the assumed datasheets."""

from __future__ import annotations

import dataclasses
import json
import os
from collections.abc import Mapping
from datetime import date
from pathlib import Path
from types import UnionType
from typing import Any, get_args, get_origin, get_type_hints

import numpy as np

from bench.data import InitialState, SensorData
from bench.specs import AssumedSpecs

START = "sensors-start.json"
_ORBITS = ("gps", "glonass")  # of a sky: what of them a receiver knows is in its observations


def make_start_document(data: SensorData, initial: InitialState) -> dict[str, Any]:
    """Return what an estimator is told, in SI and radians, as an object of JSON.

    ``initial``: time, position, velocity, attitude and their covariance (9, 9) of (pos_n m, vel_n m/s,
    phi_n rad) errors; null is not known. ``antenna_b_m``: GNSS antenna from the IMU, forward, right, down.
    ``ground_alt_m``: ellipsoidal height of the runway. ``assumed``: the datasheets, fields as in
    `bench.specs`, by kind of sensor. ``date``: decimal year.
    """
    lat, lon, alt = initial.lla
    assumed = dataclasses.asdict(data.specs)
    if assumed["gnss"] and assumed["gnss"]["sky"]:
        for system in _ORBITS:
            del assumed["gnss"]["sky"][system]
        assumed["gnss"]["sky"]["day"] = assumed["gnss"]["sky"]["day"].isoformat()
    return {
        "initial": {
            "t_s": initial.t,
            "lat_rad": lat,
            "lon_rad": lon,
            "alt_m": alt,
            "vel_n_mps": initial.vel_n,
            "q_nb": initial.q_nb,
            "cov": initial.cov,
            "alignment": initial.alignment,
            "align_for_s": initial.align_for,
            "drift_sd_rad": initial.drift_sd,
        },
        "date": data.date,
        "antenna_b_m": data.antenna_b,
        "ground_alt_m": data.ground_alt,
        "assumed": assumed,
    }


def load_start(folder: str | os.PathLike[str]) -> Mapping[str, Any]:
    """Read what the estimators of a results folder were told, as `make_start_document` makes it.

    Raises
    ------
    FileNotFoundError
        When the folder has no such file.
    """
    document: Mapping[str, Any] = json.loads((Path(folder) / START).read_text(encoding="utf-8"))
    return document


def read_initial_state(document: Mapping[str, Any]) -> InitialState:
    """Return the start of a `make_start_document`; what is not known is NaN with infinite variance."""
    told = document["initial"]
    cov = np.array(told["cov"], float)
    return InitialState(
        t=told["t_s"],
        lla=np.array([told["lat_rad"], told["lon_rad"], told["alt_m"]], float),
        vel_n=np.array(told["vel_n_mps"], float),
        q_nb=np.array(told["q_nb"], float),
        cov=np.where(np.isnan(cov), np.inf, cov),
        alignment=told["alignment"],
        align_for=told["align_for_s"],
        drift_sd=told["drift_sd_rad"],
    )


def read_assumed_specs(document: Mapping[str, Any]) -> AssumedSpecs:
    """Return the datasheets of a `make_start_document`; the orbits of a sky are not in it."""
    specs: AssumedSpecs = _convert(AssumedSpecs, document["assumed"])
    return specs


def _convert(kind: Any, value: Any) -> Any:
    """Return a value of JSON as what a field of a spec is declared to be; a field that is missing is None."""
    if value is None:
        return None
    if isinstance(kind, UnionType):
        kind = get_args(kind)[0]  # "or None"
    if dataclasses.is_dataclass(kind):
        hints = get_type_hints(kind, localns=_NOT_STORED)
        missing = {f.name: None for f in dataclasses.fields(kind) if f.name not in value}
        given = {name: _convert(hints[name], inner) for name, inner in value.items()}
        return kind(**missing, **given)  # type: ignore[operator]
    if get_origin(kind) is tuple:
        return tuple(_convert(get_args(kind)[0], inner) for inner in value)
    return date.fromisoformat(value) if kind is date else value


_NOT_STORED = {"KeplerSets": object, "GlonassSets": object}
"""Types of the orbits of a sky."""
