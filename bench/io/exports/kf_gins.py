"""KF-GINS and OB_GINS: text files of increments and fixes, and the configuration file.

Columns and units: README.md, section 2.2, and src/fileio/*.h of github.com/i2Nav-WHU/KF-GINS; keys and
units of the configuration: dataset/kf-gins.yaml there.
"""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np

from bench.core.files import durable
from bench.core.mathematics import rotation
from bench.core.records.sensor_specs import GAUSS_MARKOV_PEAK
from bench.core.words.exceptions import ExportError
from bench.io.exports.outgoing import ExportData
from bench.io.results import parquet

FORMATS = {
    "kf-gins": "text for KF-GINS and OB_GINS: increments, fixes, .nav of solutions, a kf-gins.yaml that runs"
}
NEEDS_START = True
IMU, GNSS, CONFIGURATION = "imu.txt", "gnss.txt", "kf-gins.yaml"
_DEG_H = np.rad2deg(1.0) * 3600.0  # rad/s to deg/h
_MGAL = 1e5  # m/s^2 to mGal
_DEFAULT_CORRELATION = 1.0  # if the datasheet has none; 0 would be a division by 0 [h]


def write(folder: Path, out: ExportData, kind: str) -> str:
    """Write the text files and the configuration; return their description for the README."""
    imu, fixes, calendar = out.imu, out.select_fixes(), out.calendar
    parquet.write_rows(folder / IMU, np.column_stack([imu.t + calendar.second, imu.dtheta_b, imu.dvel_b]))
    sd = np.sqrt(np.einsum("mii->mi", fixes.cov_pos_n))
    place = np.rad2deg(fixes.lla[:, :2])
    columns = [fixes.t + calendar.second, place, fixes.lla[:, 2], sd]
    parquet.write_rows(folder / GNSS, np.column_stack(columns))
    navs = ""
    for name, track in out.tracks.items():
        angles = np.rad2deg(np.column_stack(rotation.to_euler(track.q_nb)))
        week = np.full(len(track.t), float(calendar.week))
        place = np.rad2deg(track.lla[:, :2])
        columns = [week, track.t + calendar.second, place, track.lla[:, 2], track.vel_n, angles]
        rows = np.column_stack(columns)
        known = np.isfinite(rows).all(axis=1)
        if not known.any():
            raise ExportError(f"{name} has no position with velocity and attitude, which kf-gins needs")
        parquet.write_rows(folder / f"{name}.nav", rows[known])
        lost = len(rows) - np.count_nonzero(known)
        remark = f"; {lost} epochs without them are left out" if lost else ""
        navs += f"- `{name}.nav`: GNSS week, {_NAV}{remark}.\n"
    durable.write(folder / CONFIGURATION, _make_configuration(out))
    return f"""For KF-GINS and OB_GINS: text, columns separated by a space, times in GPS seconds of week.

- `{IMU}`, {len(imu)} rows at {out.rate:g} Hz: second of week [s]; increments of angle forward, right, down
  [rad]; increments of velocity [m/s]. Each interval ends at the time of its row.
- `{GNSS}`, {len(fixes)} rows: second of week [s]; latitude, longitude [deg], height [m] of the antenna;
  standard deviations north, east, down [m], as the receiver reports them.
  {out.count_left_out(fixes)} rows that the receiver marks as invalid are left out. The format has no columns
  for velocity and latency.
{navs}- `{CONFIGURATION}`: run `KF-GINS {CONFIGURATION}` in this folder; its results appear here. The initial
  state is the initial state of the filters, propagated to the first row. IMU noise is from the assumed
  datasheet: `gbstd`, `abstd` are the standard deviations of the bias process; `initbgstd`, `initbastd` also
  include the turn-on bias; `corrtime` is that of the gyros.

`bench score` reads `KF_GINS_Navresult.nav`, and the standard deviations in `KF_GINS_STD.txt` beside it. Its
t = 0 of the run is second {calendar.second:.9g} of the week."""


_NAV = (
    "second of week [s]; latitude, longitude [deg], height [m]; velocity north, east, down [m/s]; "
    "roll, pitch, yaw [deg]; of the IMU"
)


def _make_configuration(out: ExportData) -> str:
    lla, vel_n, q_nb, sd = out.start_at_first_row()
    gyro, accel = out.assumed("gyro"), out.assumed("accel")
    process = {
        name: figures["bias_instability"] / GAUSS_MARKOV_PEAK for name, figures in (("g", gyro), ("a", accel))
    }
    hours = gyro["bias_correlation"] / 3600.0 or _DEFAULT_CORRELATION
    values: dict[str, Any] = {
        "initpos": [*np.rad2deg(lla[:2]), lla[2]],
        "initvel": vel_n,
        "initatt": np.rad2deg(rotation.to_euler(q_nb)),
        "initgyrbias": [0.0] * 3,
        "initaccbias": [0.0] * 3,
        "initgyrscale": [0.0] * 3,
        "initaccscale": [0.0] * 3,
        "initposstd": sd[0:3],
        "initvelstd": sd[3:6],
        "initattstd": np.rad2deg(sd[6:9]),
        "initbgstd": [_DEG_H * np.hypot(process["g"], gyro["turn_on_bias_sd"])] * 3,
        "initbastd": [_MGAL * np.hypot(process["a"], accel["turn_on_bias_sd"])] * 3,
        "antlever": out.start["antenna_b_m"],
    }
    noise: dict[str, Any] = {
        "arw": [np.rad2deg(gyro["random_walk"]) * 60.0] * 3,
        "vrw": [accel["random_walk"] * 60.0] * 3,
        "gbstd": [_DEG_H * process["g"]] * 3,
        "abstd": [_MGAL * process["a"]] * 3,
        "gsstd": [1e6 * gyro["scale_factor_sd"]] * 3,
        "asstd": [1e6 * accel["scale_factor_sd"]] * 3,
    }

    def listed(numbers: Iterable[float]) -> str:
        return f"[ {', '.join(f'{number:.12g}' for number in numbers)} ]"

    lines = [
        f'imupath: "./{IMU}"',
        f'gnsspath: "./{GNSS}"',
        'outputpath: "."',
        "imudatalen: 7",
        f"imudatarate: {round(out.rate)}",
        f"starttime: {float(out.imu.t[0]) + out.calendar.second:.9f}",
        "endtime: -1",
        *(f"{key}: {listed(numbers)}" for key, numbers in values.items()),
        "imunoise:",
        *(f"  {key}: {listed(numbers)}" for key, numbers in noise.items()),
        f"  corrtime: {hours:.12g}",
    ]
    return "\n".join(lines) + "\n"
