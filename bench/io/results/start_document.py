"""Inputs of a filter besides the measurements: initial state, antenna, assumed datasheets."""

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

from bench.core.mathematics.arrays import FloatArray
from bench.core.records.data import GnssFixes, GnssObservations, ImuData, InitialState, SensorData
from bench.core.records.sensor_specs import AssumedSpecs

START = "sensors-start.json"


def make_start_document(data: SensorData, initial: InitialState) -> dict[str, Any]:
    """Return initial state, antenna and assumed datasheets as a JSON object, in SI and radians.

    ``initial``: time, position, velocity, attitude and their covariance (9, 9) of (pos_n m, vel_n m/s,
    phi_n rad) errors; null means not known. ``antenna_b_m``: GNSS antenna from the IMU, forward, right, down.
    ``ground_alt_m``: ellipsoidal height of the runway. ``assumed``: the datasheets by kind of sensor, with
    the fields of `bench.core.records.sensor_specs`. ``date``: decimal year.
    """
    return {
        "initial": write_initial_state(initial),
        "date": data.date,
        "antenna_b_m": data.antenna_b,
        "ground_alt_m": data.ground_alt,
        "assumed": assumed_document(data.specs),
    }


def write_initial_state(initial: InitialState) -> dict[str, Any]:
    """Return an initial state in the form of a start document; `read_initial_state` reads it."""
    lat, lon, alt = initial.lla
    return {
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
    }


def assumed_document(specs: AssumedSpecs) -> dict[str, Any]:
    """Return assumed datasheets as a JSON object, in SI and radians, without the true orbits of a sky."""
    assumed = dataclasses.asdict(specs)
    if assumed["gnss"] and assumed["gnss"]["sky"]:
        del assumed["gnss"]["sky"]["orbits"]  # the receiver knows only those in its observations
        assumed["gnss"]["sky"]["day"] = assumed["gnss"]["sky"]["day"].isoformat()
    return assumed


def load_start(folder: str | os.PathLike[str]) -> Mapping[str, Any]:
    """Read the document that `make_start_document` made for the filters of a results folder.

    Raises
    ------
    FileNotFoundError
        If the folder has no such file.
    """
    document: Mapping[str, Any] = json.loads((Path(folder) / START).read_text(encoding="utf-8"))
    return document


def read_initial_state(document: Mapping[str, Any]) -> InitialState:
    """Return the initial state in a start document; unknown values are NaN with infinite variance."""
    start = document["initial"]
    cov = np.array(start["cov"], float)
    return InitialState(
        t=start["t_s"],
        lla=np.array([start["lat_rad"], start["lon_rad"], start["alt_m"]], float),
        vel_n=np.array(start["vel_n_mps"], float),
        q_nb=np.array(start["q_nb"], float),
        cov=np.where(np.isnan(cov), np.inf, cov),
        alignment=start["alignment"],
        align_for=start["align_for_s"],
        drift_sd=start["drift_sd_rad"],
    )


def read_assumed_specs(document: Mapping[str, Any]) -> AssumedSpecs:
    """Return the assumed datasheets in a start document, without the orbits of a sky."""
    specs: AssumedSpecs = _convert(AssumedSpecs, document["assumed"])
    return specs


def make_sensor_data(
    document: Mapping[str, Any],
    imu: ImuData,
    fixes: GnssFixes | None,
    instruments: Mapping[str, Any],
    output_t: FloatArray,
    observations: GnssObservations | None,
) -> SensorData:
    """Return the input of a filter from its records and a start document."""
    return SensorData(
        imu=imu,
        fixes=fixes,
        **instruments,
        antenna_b=np.array(document["antenna_b_m"]),
        specs=read_assumed_specs(document),
        output_t=output_t,
        observations=observations,
        ground_alt=document["ground_alt_m"],
        date=document["date"],
    )


def _convert(kind: Any, value: Any) -> Any:
    """Convert a JSON value to the declared type of a spec field; missing fields become None."""
    if value is None:
        return None
    if isinstance(kind, UnionType):
        kind = get_args(kind)[0]  # "or None"
    if dataclasses.is_dataclass(kind):
        hints = get_type_hints(kind)
        missing = {f.name: None for f in dataclasses.fields(kind) if f.name not in value}
        present = {name: _convert(hints[name], inner) for name, inner in value.items()}
        return kind(**missing, **present)  # type: ignore[operator]
    if get_origin(kind) is tuple:
        return tuple(_convert(get_args(kind)[0], inner) for inner in value)
    return date.fromisoformat(value) if kind is date else value
