"""What an estimator is told beside the measurements: the start, the antenna, the assumed datasheets."""

from __future__ import annotations

import dataclasses
import json
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from bench.arrays import FloatArray
from bench.data import InitialState, SensorData

START = "sensors-start.json"
_ORBITS = ("gps", "glonass")  # of a sky: what of them a receiver knows is in its observations


def start_document(data: SensorData, initial: InitialState) -> dict[str, Any]:
    """Return what an estimator is told, in SI and radians, as an object of JSON.

    ``initial``: time, position, velocity, attitude and their covariance (9, 9) of (pos_n m, vel_n m/s,
    phi_n rad) errors; null is not known. ``antenna_b_m``: GNSS antenna from the IMU, forward, right, down.
    ``assumed``: the datasheets, fields as in `bench.specs`, by kind of sensor. ``date``: decimal year.
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
        "assumed": assumed,
    }


def load_start(folder: str | os.PathLike[str]) -> Mapping[str, Any]:
    """Read what the estimators of a results folder were told, as `start_document` makes it.

    Raises
    ------
    FileNotFoundError
        When the folder has no such file.
    """
    document: Mapping[str, Any] = json.loads((Path(folder) / START).read_text(encoding="utf-8"))
    return document


def initial_state(document: Mapping[str, Any]) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Return lla (3,) [rad, rad, m], vel_n (3,) [m/s], q_nb (4,), sd (9,) of a start; NaN is not known."""
    told = document["initial"]
    lla = np.array([told["lat_rad"], told["lon_rad"], told["alt_m"]], float)
    variance = np.diag(np.array(told["cov"], float))
    return lla, np.array(told["vel_n_mps"], float), np.array(told["q_nb"], float), np.sqrt(variance)
