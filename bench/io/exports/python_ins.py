"""python-ins: DataFrames indexed by time, as Parquet files.

Names and units: pyins.util (GYRO_COLS, ACCEL_COLS, LLA_COLS, VEL_COLS, RPH_COLS) and
pyins.strapdown.compute_increments_from_imu of python-ins 1.0: angles of position and attitude in degrees.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from bench.core.mathematics import rotation
from bench.core.mathematics.arrays import FloatArray
from bench.io.exports.outgoing import ExportData
from bench.io.results import parquet

FORMATS = {"python-ins": "the DataFrames of python-ins in Parquet, and the Python that runs it on them"}
NEEDS_START = True
_LLA, _VEL, _RPH = ("lat", "lon", "alt"), ("VN", "VE", "VD"), ("roll", "pitch", "heading")
_IMU = ("gyro_x", "gyro_y", "gyro_z", "accel_x", "accel_y", "accel_z")


def write(folder: Path, out: ExportData, kind: str) -> str:
    """Write the DataFrames; return their description for the README."""
    fixes = out.select_fixes()
    lla, vel_n, q_nb, sd = out.complete_start()
    start = float(out.start["initial"]["t_s"])
    increments = np.hstack([out.imu.dtheta_b, out.imu.dvel_b])
    frames: dict[str, Mapping[str, Any]] = {
        "imu": _make_frame(np.append(start, out.imu.t), _IMU, np.vstack([increments[:1], increments])),
        "position": _make_frame(fixes.t, _LLA, _to_degrees(fixes.lla)),
        "velocity": _make_frame(fixes.t, _VEL, fixes.vel_n),
        "initial": _make_trajectory(np.array([start]), lla[None], vel_n[None], q_nb[None]),
    }
    frames |= {
        name: _make_trajectory(track.t, track.lla, track.vel_n, track.q_nb)
        for name, track in out.tracks.items()
    }
    for name, frame in frames.items():
        parquet.write_frame(folder / f"{name}.parquet", frame)
    reported = np.sqrt(np.median(np.einsum("mii->mi", fixes.cov_pos_n), axis=0))
    speed = np.sqrt(np.median(np.einsum("mii->mi", fixes.cov_vel_n), axis=0))
    arm = ", ".join(f"{value:.6g}" for value in out.start["antenna_b_m"])
    tracks = "".join(
        f"- `{name}.parquet`: lat, lon [deg], alt [m], VN, VE, VD [m/s], roll, pitch, heading [deg] "
        "of the IMU.\n"
        for name in out.tracks
    )
    return f"""For python-ins (pyins):

```python
import pandas as pd
from pyins import filters, inertial_sensor, measurements, strapdown

read = lambda name: pd.read_parquet(f"{{name}}.parquet").set_index("time")
increments = strapdown.compute_increments_from_imu(read("imu"), "increment")
fixes = [
    measurements.Position(read("position"), {reported[0]:.6g}, [{arm}]),
    measurements.NedVelocity(read("velocity"), {speed[0]:.6g}, [{arm}]),
]
result = filters.run_feedback_filter(
    read("initial").iloc[0], {sd[0]:.6g}, {sd[3]:.6g}, {np.rad2deg(sd[6]):.6g}, {np.rad2deg(sd[8]):.6g},
    increments, {_format_model(out, "gyro")}, {_format_model(out, "accel")}, fixes,
)
```

- `imu.parquet`, {len(out.imu)} rows at {out.rate:g} Hz after a first one at the start: gyro_x ... [rad],
  accel_x ... [m/s], increments over the interval that ends at the index, forward, right, down. The first row
  repeats the second: python-ins uses it as the sample before the start.
- `position.parquet`, {len(fixes)} rows: lat, lon [deg], alt [m] of the antenna. `velocity.parquet`: VN, VE,
  VD [m/s]. {out.count_left_out(fixes)} rows that the receiver marks as invalid are left out.
- `initial.parquet`: one row, the initial state of the filters of the bench.
{tracks}"""


def _format_model(out: ExportData, triad: str) -> str:
    """Return the Python call that builds the sensor model of python-ins from the assumed datasheet, in SI."""
    figures = out.assumed(triad)
    from bench.core.records.sensor_specs import GAUSS_MARKOV_PEAK

    sd, time = figures["bias_instability"] / GAUSS_MARKOV_PEAK, figures["bias_correlation"]
    walk = sd * np.sqrt(2.0 / time) if time else 0.0
    bias = np.hypot(figures["turn_on_bias_sd"], sd)
    return (
        f"inertial_sensor.EstimationModel(bias_sd={bias:.6g}, noise={figures['random_walk']:.6g}, "
        f"bias_walk={walk:.6g})"
    )


def _make_frame(t: FloatArray, names: tuple[str, ...], rows: FloatArray) -> dict[str, Any]:
    return {"time": t} | {name: np.ascontiguousarray(rows[:, k]) for k, name in enumerate(names)}


def _to_degrees(lla: FloatArray) -> FloatArray:
    return np.column_stack([np.rad2deg(lla[:, :2]), lla[:, 2]])


def _make_trajectory(t: FloatArray, lla: FloatArray, vel_n: FloatArray, q_nb: FloatArray) -> dict[str, Any]:
    angles = np.rad2deg(np.column_stack(rotation.to_euler(q_nb)))
    return _make_frame(t, (*_LLA, *_VEL, *_RPH), np.hstack([_to_degrees(lla), vel_n, angles]))
