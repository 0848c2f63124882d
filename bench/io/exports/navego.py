"""NaveGo: the structures imu, gnss and ref in one MATLAB file.

Fields and units: ins-gnss/ins_gnss.m and conversions/imu_si_errors.m of github.com/rodralez/NaveGo.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from bench.core.files import durable
from bench.core.mathematics import earth, rotation
from bench.core.records.data import GnssFixes
from bench.core.records.sensor_specs import GAUSS_MARKOV_PEAK
from bench.io.exports.outgoing import ExportData, Track

FORMATS = {"navego": "the structures imu, gnss and ref of NaveGo"}
NEEDS_START = True
FILE = "navego.mat"


def write(folder: Path, out: ExportData, kind: str) -> str:
    """Write ``navego.mat``; return its description for the README."""
    from scipy.io import savemat

    fixes = out.select_fixes()
    found: dict[str, Any] = {"imu": _make_imu(out), "gnss": _make_gnss(out, fixes)}
    names = {
        name: "ref" if name == "truth" else name.replace("-", "_").replace(".", "_") for name in out.tracks
    }
    found |= {names[name]: _make_reference(track) for name, track in out.tracks.items()}
    with durable.open_binary(folder / FILE) as file:
        savemat(file, found, long_field_names=True, oned_as="column", do_compression=True)
    listed = "".join(f"- `{variable}`: {_REF}.\n" for variable in names.values())
    return f"""For NaveGo, in MATLAB or Octave:

    load('{FILE}');
    nav_e = ins_gnss(imu, gnss, 'quaternion');

- `imu`, {len(out.imu)} rows at {out.rate:g} Hz: t [s]; wb [rad/s] and fb [m/s^2], the mean rate and specific
  force over the interval that ends at t, forward, right, down; the noise figures of the assumed datasheet in
  SI, named as in imu_si_errors.m; gb_sta, ab_sta are zero, because the turn-on bias of a real unit is not
  known. ini_align: roll, pitch, yaw [rad] at the first row, as the filters of the bench get them;
  ini_align_err: their standard deviations.
- `gnss`, {len(fixes)} rows: t [s]; lat, lon [rad], h [m], vel [m/s] north, east, down, of the antenna; stdm,
  stdv: the medians of the standard deviations that the receiver reports, since NaveGo takes one value per
  axis; larm [m]. zupt_th is 0: no zero-velocity update. {out.count_left_out(fixes)} rows that the receiver
  marks as invalid are left out.
{listed}
NaveGo starts at the first fix with its velocity, not at the initial state of the filters of the bench."""


_REF = "t [s]; lat, lon [rad], h [m], vel [m/s] north, east, down; roll, pitch, yaw [rad]; of the IMU"


def _make_imu(out: ExportData) -> dict[str, Any]:
    wb, fb = out.rates()
    _, _, q_nb, sd = out.start_at_first_row()
    found: dict[str, Any] = {"t": out.imu.t, "wb": wb, "fb": fb, "freq": out.rate}
    interval = 1.0 / out.rate
    for triad, walk, rate_walk, letter in (("gyro", "arw", "arrw", "g"), ("accel", "vrw", "vrrw", "a")):
        figures = out.assumed(triad)
        bias, time = figures["bias_instability"] / GAUSS_MARKOV_PEAK, figures["bias_correlation"] or np.inf
        found |= {
            walk: _make_row(figures["random_walk"]),
            rate_walk: _make_row(figures["rate_random_walk"]),
            f"{letter}_std": _make_row(figures["random_walk"] / np.sqrt(interval)),
            f"{letter}b_sta": _make_row(0.0),
            f"{letter}b_dyn": _make_row(bias),
            f"{letter}b_corr": _make_row(time),
            f"{letter}b_psd": _make_row(bias if np.isinf(time) else bias / np.sqrt(time)),
        }
    found["ini_align"] = np.array([rotation.to_euler(q_nb)])
    found["ini_align_err"] = sd[None, 6:9]
    return found


def _make_gnss(out: ExportData, fixes: GnssFixes) -> dict[str, Any]:
    lla, t = fixes.lla, fixes.t
    stdm = np.sqrt(np.median(np.einsum("mii->mi", fixes.cov_pos_n), axis=0))
    stdv = np.sqrt(np.median(np.einsum("mii->mi", fixes.cov_vel_n), axis=0))
    moved = earth.displace(lla[0], stdm * [1.0, 1.0, -1.0]) - lla[0]
    return {
        "t": t,
        "lat": lla[:, 0],
        "lon": lla[:, 1],
        "h": lla[:, 2],
        "vel": fixes.vel_n,
        "std": moved[None],
        "stdm": stdm[None],
        "stdv": stdv[None],
        "larm": np.array(out.start["antenna_b_m"], float)[:, None],
        "freq": 1.0 / float(np.median(np.diff(t))) if len(t) > 1 else 1.0,
        "zupt_th": 0.0,
        "zupt_win": 1.0,
        "eps": 0.5 / out.rate,  # half an interval: each fix matches one row of the IMU
    }


def _make_row(value: float) -> Any:
    return np.full((1, 3), value)


def _make_reference(track: Track) -> dict[str, Any]:
    roll, pitch, yaw = rotation.to_euler(track.q_nb)
    lat, lon, h = track.lla.T
    step = float(np.median(np.diff(track.t))) if len(track.t) > 1 else 1.0
    return {
        "t": track.t, "lat": lat, "lon": lon, "h": h, "vel": track.vel_n,
        "roll": roll, "pitch": pitch, "yaw": yaw,
        "freq": 1.0 / step,
    }  # fmt: skip
