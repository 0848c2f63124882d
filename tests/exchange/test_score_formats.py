"""Solutions in the formats of receivers, reference systems and data sets score what their motion is, in its
units, signs and clocks; the writers here follow the published layouts and share nothing with the readers."""

from __future__ import annotations

import json
import struct
from datetime import datetime, timedelta
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.spatial.transform import Rotation

import bench
from bench.cli.command_line import main
from bench.core.mathematics import earth, rotation
from bench.core.words.exceptions import ConfigError
from bench.io.foreign.local_frames import fit_rotation, read_frame
from bench.io.foreign.run_clock import RunClock
from bench.io.foreign.solution_rows import Placing
from bench.io.foreign.solutions import read_solution

START = datetime(2026, 1, 1)  # t = 0 of the run [UTC]
AHEAD = 18.0  # GPS time minus UTC in 2026 [s]
GPS = (START - datetime(1980, 1, 6)).total_seconds() + AHEAD
UNIX = (START - datetime(1970, 1, 1)).total_seconds()
NED_ENU = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])
FRD_FLU = np.diag([1.0, -1.0, -1.0])


def body_to_ned(truth, k: int) -> np.ndarray:
    """C_nb by scipy, from a quaternion whose scalar is first."""
    return Rotation.from_quat(np.roll(truth.q_nb[k], -1)).as_matrix()


def local(truth, k: int) -> tuple[np.ndarray, np.ndarray]:
    """Position east, north, up of the first row [m], and the attitude from forward, left, up, flat."""
    return NED_ENU @ earth.local_ned(truth.lla[k], truth.lla[0]), NED_ENU @ body_to_ned(truth, k) @ FRD_FLU


def write_tum(folder: Path, truth, rows, clock: float = 0.0) -> Path:
    lines = []
    for k in rows:
        p, C = local(truth, k)
        q = Rotation.from_matrix(C).as_quat()
        lines.append(" ".join(f"{x:.9f}" for x in (clock + truth.t[k], *p, *q)))
    (folder / "poses.txt").write_text("# timestamp tx ty tz qx qy qz qw\n" + "\n".join(lines) + "\n")
    return folder / "poses.txt"


def write_euroc(folder: Path, truth, rows, clock: float = UNIX) -> Path:
    lines = [
        "#timestamp, p_RS_R_x [m], p_RS_R_y [m], p_RS_R_z [m], q_RS_w [], q_RS_x [], q_RS_y [], q_RS_z [], "
        "v_RS_R_x [m s^-1], v_RS_R_y [m s^-1], v_RS_R_z [m s^-1]"
    ]
    for k in rows:
        p, C = local(truth, k)
        x, y, z, w = Rotation.from_matrix(C @ FRD_FLU).as_quat()  # the axes of the IMU, which are those of b
        v = NED_ENU @ truth.vel_n[k]
        stamp = round((clock + truth.t[k]) * 1e3) * 1_000_000
        lines.append(",".join([str(stamp), *(repr(float(u)) for u in (*p, w, x, y, z, *v))]))
    (folder / "data.csv").write_text("\n".join(lines) + "\n")
    return folder / "data.csv"


def write_kitti(folder: Path, truth, rows) -> Path:
    camera = np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])  # right, down, forward to b
    C_0 = body_to_ned(truth, 0) @ camera
    lines = []
    for k in rows:
        T = np.column_stack([C_0.T @ body_to_ned(truth, k) @ camera,
                             C_0.T @ earth.local_ned(truth.lla[k], truth.lla[0])])  # fmt: skip
        lines.append(" ".join(f"{x:.9e}" for x in T.ravel()))
    (folder / "00.txt").write_text("\n".join(lines) + "\n")
    np.savetxt(folder / "times.txt", truth.t[rows])
    return folder / "00.txt"


def write_oxts(folder: Path, truth, rows) -> Path:
    (folder / "oxts" / "data").mkdir(parents=True)
    stamps = []
    for n, k in enumerate(rows):
        yaw, pitch, roll = Rotation.from_matrix(body_to_ned(truth, k)).as_euler("ZYX")
        lat, lon, alt = truth.lla[k]
        vn, ve, vd = truth.vel_n[k]
        values = [np.rad2deg(lat), np.rad2deg(lon), alt, roll, -pitch, np.pi / 2 - yaw, vn, ve, 0, 0, -vd]
        text = " ".join(f"{x:.13g}" for x in [*values, *[0.0] * 19])
        (folder / "oxts" / "data" / f"{n:010d}.txt").write_text(text + "\n")
        stamps.append(f"{START + timedelta(seconds=float(truth.t[k])):%Y-%m-%d %H:%M:%S.%f}000")
    (folder / "oxts" / "timestamps.txt").write_text("\n".join(stamps) + "\n")
    return folder / "oxts"


def write_sbet(folder: Path, truth, rows, side: float = 1.0) -> Path:
    """With a wander angle; y right and z down, or y left and z up (``side`` = -1)."""
    wander, data = 0.4, b""
    for k in rows:
        yaw, pitch, roll = Rotation.from_matrix(body_to_ned(truth, k)).as_euler("ZYX")
        north, east, down = truth.vel_n[k]
        x = north * np.cos(wander) - east * np.sin(wander)
        y = side * (north * np.sin(wander) + east * np.cos(wander))
        row = (
            (GPS + truth.t[k]) % 604800.0,
            *truth.lla[k],
            x,
            y,
            side * down,
            roll,
            pitch,
            yaw + wander,
            wander,
        )
        data += struct.pack("<17d", *row, *[0.0] * 6)
    (folder / "sbet_mission.out").write_bytes(data)
    return folder / "sbet_mission.out"


def write_rtklib(folder: Path, truth, rows) -> Path:
    head = "%  GPST   latitude(deg) longitude(deg)  height(m)   Q  ns   sdn(m)   sde(m)   sdu(m)\n"
    lines = []
    for k in rows:
        lat, lon = np.rad2deg(truth.lla[k, :2])
        when = START + timedelta(seconds=AHEAD + float(truth.t[k]))
        place = f"{lat:.11f} {lon:.11f} {truth.lla[k, 2]:.5f}"
        lines.append(f"{when:%Y/%m/%d %H:%M:%S.%f} {place} 1 12 0.3 0.3 0.5")
    (folder / "rover.pos").write_text(head + "\n".join(lines) + "\n")
    return folder / "rover.pos"


def nmea(body: str) -> str:
    check = 0
    for byte in body.encode():
        check ^= byte
    return f"${body}*{check:02X}\r\n"


def write_nmea(folder: Path, truth, rows, begin: datetime = START) -> Path:
    """GGA before RMC, a geoid separation of 48 m, and satellites of GSV between."""
    text = ""
    for k in rows:
        clock = f"{begin + timedelta(seconds=float(truth.t[k])):%H%M%S.%f}"[:9]
        day = f"{begin + timedelta(seconds=float(truth.t[k])):%d%m%y}"
        lat, lon = np.rad2deg(truth.lla[k, :2])
        place = f"{int(lat):02d}{60 * (lat % 1):011.8f},N,{int(lon):03d}{60 * (lon % 1):011.8f},E"
        north, east, _ = truth.vel_n[k]
        motion = f"{np.hypot(north, east) * 3600 / 1852:.6f},{np.rad2deg(np.arctan2(east, north)) % 360:.6f}"
        text += nmea(f"GNGGA,{clock},{place},4,12,0.8,{truth.lla[k, 2] - 48.0:.4f},M,48.0,M,1.0,0001")
        text += nmea("GPGSV,1,1,01,05,45,120,44")
        text += nmea(f"GNRMC,{clock},A,{place},{motion},{day},,,R")
    (folder / "log.nmea").write_text(text, newline="")
    return folder / "log.nmea"


WRITERS = {
    "tum": write_tum, "euroc": write_euroc, "kitti": write_kitti, "oxts": write_oxts,
    "sbet": write_sbet, "rtklib": write_rtklib, "nmea": write_nmea,
}  # fmt: skip
LOCAL = ("tum", "euroc", "kitti")


def rows_of(truth):
    return np.arange(0, len(truth), 10)


@pytest.mark.parametrize("name", WRITERS)
def test_a_file_of_the_truth_has_no_error_without_an_option(run, tmp_path, name):
    folder, truth, _ = run
    path = WRITERS[name](tmp_path, truth, rows_of(truth))
    how = {"align": "se3"} if name == "kitti" else {}
    score = bench.score_solution(path, folder, **how)
    found = score.metrics
    assert score.coverage == 1.0
    assert found["pos_rmse_h_m"] < 2e-3  # digits of the file, and the radius of the Earth over 200 m
    assert found["pos_rmse_d_m"] < 2e-3
    if name not in ("rtklib", "nmea"):
        assert found["tilt_rmse_deg"] < 3e-3
        assert found["heading_rmse_deg"] < 3e-3
    if name in ("euroc", "oxts", "sbet"):
        assert found["vel_rmse_3d_mps"] < 5e-3
    said = [text for _, _, text in score.solution.events.select("table")]
    assert (name in LOCAL) == any("degrees of freedom are taken away" in text for text in said)
    if name == "rtklib":
        assert found["nees_states"] == 3
    elif name in LOCAL:
        assert found.get("nees_mean") is None


def test_values_units_signs_and_times_are_those_that_were_written(run, tmp_path):
    _, truth, _ = run
    rows = rows_of(truth)[:20]
    found = read_solution(write_sbet(tmp_path, truth, rows), t_0=GPS % 604800.0)
    assert_allclose(found.t, truth.t[rows], atol=1e-6)
    assert_allclose(found.lla, truth.lla[rows], rtol=0, atol=1e-12)
    assert_allclose(found.vel_n, truth.vel_n[rows], atol=1e-9)
    turned = rotation.to_rotvec(rotation.multiply(rotation.conjugate(found.q_nb), truth.q_nb[rows]))
    assert np.abs(turned).max() < 1e-9
    other = read_solution(write_sbet(tmp_path, truth, rows, -1.0))
    assert_allclose(other.vel_n, truth.vel_n[rows], atol=1e-9)
    found = read_solution(write_nmea(tmp_path, truth, rows), t_0=GPS)
    assert_allclose(found.t, truth.t[rows], atol=1e-6)
    assert_allclose(found.lla[:, 2], truth.lla[rows, 2], atol=1e-4)
    late = read_solution(write_nmea(tmp_path, truth, rows, datetime(2025, 12, 31, 23, 59, 59)), t_0=GPS - 1.0)
    assert_allclose(late.t, truth.t[rows], atol=1e-6)  # over midnight


@pytest.mark.parametrize("clock", [0.0, UNIX, GPS, GPS % 604800.0])
def test_a_clock_is_found(run, tmp_path, clock):
    folder, truth, _ = run
    score = bench.score_solution(write_tum(tmp_path, truth, rows_of(truth), clock), folder)
    assert score.metrics["pos_rmse_h_m"] < 2e-3
    said = [text for _, _, text in score.solution.events.select("table") if "t = 0 of the run" in text]
    assert len(said) == (clock > 0)


def test_a_clock_that_is_of_no_use_is_told_with_the_offset(run, tmp_path, capsys):
    folder, truth, _ = run
    path = write_tum(tmp_path, truth, rows_of(truth), 5000.0)
    assert main(["score", str(path), str(folder)]) == 2
    err = capsys.readouterr().err
    assert err.count("\n") == 1
    assert "5000 to 5020 s, do not overlap with the run, 0 to 20 s; --t0 5000 puts" in err
    assert main(["score", str(path), str(folder), "--t0", "5000", "--json"]) in (0, 1)
    assert json.loads(capsys.readouterr().out)["pos_rmse_h_m"] < 2e-3


def test_the_clocks_of_a_log():
    t = np.array([10.0, 20.0])
    seconds = RunClock.of_log(0.0, 100.0, 345_600.0)
    assert seconds.find_start(t + 345_600.0, "")[0] == 345_600.0
    assert seconds.find_start(t + 2000 * 604_800.0 + 345_600.0, "gps")[0] == 2000 * 604_800.0 + 345_600.0
    unix = RunClock.of_log(0.0, 100.0, UNIX)
    assert unix.find_start(t + GPS, "gps")[0] == GPS
    assert unix.find_start(t + UNIX, "")[0] == UNIX
    assert RunClock.of_log(0.0, 100.0, GPS).find_start(t + UNIX, "")[0] == UNIX


@pytest.mark.parametrize(("year", "ahead"), [(1996, 11.0), (2011, 15.0), (2014, 16.0)])
def test_a_log_before_2017_may_count_from_1970_or_from_1980(year, ahead):
    """KITTI and EuRoC count from 1970; the same number of seconds since 1980 is ten years later."""
    t, start = np.array([10.0, 20.0]), datetime(year, 5, 1)
    unix = (start - datetime(1970, 1, 1)).total_seconds()
    gps = (start - datetime(1980, 1, 6)).total_seconds() + ahead
    shown = {"gps": gps, "week": gps % 604_800.0, "": unix}
    for origin in (unix, gps):
        for declared, there in shown.items():
            assert RunClock.of_log(0.0, 100.0, origin).find_start(t + there, declared)[0] == there
    assert RunClock.of_log(0.0, 100.0, 1.4e18).find_start(t + 1.4e18, "")[0] == 1.4e18


def test_options_for_a_local_frame_are_rejected_for_other_files(run, tmp_path, capsys):
    folder, truth, _ = run
    rows = rows_of(truth)
    table = tmp_path / "table.csv"
    np.savetxt(table, np.column_stack([truth.t[rows], truth.vel_n[rows]]), delimiter=",", comments="",
               header="t_s,vel_n_mps,vel_e_mps,vel_d_mps")  # fmt: skip
    for path in (table, write_sbet(tmp_path, truth, rows)):
        for option in (["--frame", "ned-frd"], ["--origin", "47,11,500"]):
            assert main(["score", str(path), str(folder), *option]) == 2
            said = " ".join(capsys.readouterr().err.split())
            assert f"{path.name}: {option[0][2:]}: only for positions in a local frame" in said
    damaged = write_kitti(tmp_path, truth, rows)
    damaged.write_bytes(damaged.read_bytes()[5:])
    assert main(["score", str(damaged), str(folder), "--frame", "ned-frd"]) == 2
    assert "frame" not in capsys.readouterr().err  # what is wrong with the file comes first
    for origin in ("91,11,500", "47,11", "47,11,500,0,0", "47,nan,500"):
        assert main(["score", str(write_tum(tmp_path, truth, rows)), str(folder), "--origin", origin]) == 2
        assert "--origin must be LAT,LON,HEIGHT" in capsys.readouterr().err


# --- what bench exports ---------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("kind", "file"),
    [
        ("csv", "solution-made.csv"),
        ("parquet", "solution-made.parquet"),
        ("tum", "solution-made.tum"),
        ("nmea", "solution-made.nmea"),
        ("kf-gins", "solution-made.nav"),
        ("python-ins", "solution-made.parquet"),
        ("mat", "run.mat"),
        ("navego", "navego.mat"),
    ],
)
def test_an_export_of_a_solution_scores_what_it_scored(run, tmp_path, kind, file):
    folder = run[0]
    written = bench.export_run(folder, kind, include=["truth", "solution:made"], out=tmp_path / kind)
    found = bench.score_solution(written / file, folder, label="again").metrics
    expected = bench.read_result(folder).metrics["made"]
    assert found["pos_rmse_h_m"] == pytest.approx(expected["pos_rmse_h_m"], abs=2e-3)
    assert found["pos_rmse_d_m"] == pytest.approx(expected["pos_rmse_d_m"], abs=2e-3)
    if kind != "nmea":
        assert found["heading_rmse_deg"] == pytest.approx(expected["heading_rmse_deg"], abs=1e-5)


# --- local frames and alignment -------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["enu-flu", "ned-frd", "nwu-flu", "rdf-rdf", "wsu-bru"])
def test_axes_are_those_of_their_letters(name):
    ways = {"n": (0, 1), "e": (1, 1), "d": (2, 1), "s": (0, -1), "w": (1, -1), "u": (2, -1)}
    ways |= {"f": (0, 1), "r": (1, 1), "b": (0, -1), "l": (1, -1)}
    for C, word in zip(read_frame(name), name.split("-"), strict=True):
        for k, letter in enumerate(word):
            axis, sign = ways[letter]
            assert C[axis, k] == sign
        assert np.linalg.det(C) == pytest.approx(1.0)


@pytest.mark.parametrize("name", ["", "enu", "neu-frd", "enu-ful", "enn-flu", "xyz-flu", "enu-flu-frd"])
def test_axes_that_are_none_are_one_line(name):
    with pytest.raises(ConfigError, match="expected the axes x, y, z") as caught:
        read_frame(name)
    assert "\n" not in str(caught.value)


def test_an_alignment_is_the_best_rotation_by_another_formula():
    rng = np.random.default_rng(5)
    for _ in range(20):
        here = rng.normal(size=(40, 3)) * rng.uniform(1.0, 1e3, 3)
        there = Rotation.random(rng=rng).apply(here) + rng.normal(size=(40, 3))
        C, _ = fit_rotation("se3", here, there)
        best = Rotation.align_vectors(there, here)[0].as_matrix()
        assert_allclose(C, best, atol=1e-9)
        # the heading: the best of a fine grid of turns about the vertical
        C, _ = fit_rotation("yaw", here, there)
        own = np.sum((here @ C.T - there) ** 2)
        turns = Rotation.from_euler("z", np.linspace(0.0, 2 * np.pi, 721)[:, None])
        assert own <= min(np.sum((turn.apply(here) - there) ** 2) for turn in turns) * (1.0 + 1e-12)
        assert_allclose(C[2], [0.0, 0.0, 1.0], atol=1e-15)


def test_a_mirror_image_is_not_aligned_by_a_reflection():
    here = np.random.default_rng(2).normal(size=(30, 3))
    C, _ = fit_rotation("se3", here, here * [1.0, 1.0, -1.0])
    assert np.linalg.det(C) == pytest.approx(1.0)


def turned(path: Path, angle: Rotation, shift) -> Path:
    """Move and turn the frame of a file of TUM."""
    rows = np.loadtxt(path)
    rows[:, 1:4] = angle.apply(rows[:, 1:4]) + shift
    rows[:, 4:] = (angle * Rotation.from_quat(rows[:, 4:])).as_quat()
    np.savetxt(path, rows, "%.9f")
    return path


def test_an_alignment_takes_away_its_freedom_and_no_more(run, tmp_path):
    folder, truth, _ = run
    heading = Rotation.from_euler("z", 70.0, degrees=True)
    tilt = Rotation.from_euler("ZYX", [40.0, 10.0, -5.0], degrees=True)
    path = turned(write_tum(tmp_path, truth, rows_of(truth)), heading, [100.0, -50.0, 7.0])
    score = bench.score_solution(path, folder, align="yaw")
    assert score.metrics["pos_rmse_h_m"] < 2e-3
    assert score.metrics["heading_rmse_deg"] < 3e-3
    (said,) = [text for _, _, text in score.solution.events.select("table") if "aligned" in text]
    assert "aligned (yaw) by 202 epochs: turned by 70 deg" in said
    assert "4 degrees of freedom" in said
    path = turned(write_tum(tmp_path, truth, rows_of(truth)), tilt, [100.0, -50.0, 7.0])
    assert bench.score_solution(path, folder, align="yaw").metrics["pos_rmse_d_m"] > 1.0
    three = bench.score_solution(path, folder, align="se3").metrics
    assert three["pos_rmse_d_m"] < 2e-3
    assert three["tilt_rmse_deg"] < 3e-3


def test_a_frame_with_its_origin_is_not_aligned(run, tmp_path, capsys):
    folder, truth, _ = run
    path = turned(
        write_tum(tmp_path, truth, rows_of(truth)), Rotation.from_euler("z", 30.0, degrees=True), [0, 0, 2]
    )
    lat, lon = np.rad2deg(truth.lla[0, :2])
    place = [lat, lon, truth.lla[0, 2]]
    found = bench.score_solution(path, folder, origin=[*place, 30.0]).metrics
    assert found["pos_rmse_h_m"] < 2e-3
    assert found["pos_rmse_d_m"] == pytest.approx(2.0, abs=1e-3)
    assert found["heading_rmse_deg"] < 3e-3
    assert main(["score", str(path), str(folder), "--align", "none"]) == 2
    assert "its local frame has no known place" in capsys.readouterr().err
    for wrong in ("1,2", "a,b,c", "95,0,0", "1,2,nan"):
        assert main(["score", str(path), str(folder), "--origin", wrong]) == 2
        assert "--origin must be LAT,LON,HEIGHT" in capsys.readouterr().err


def test_a_straight_line_does_not_determine_three_angles(tmp_path):
    line = np.linspace(0.0, 1.0, 20)[:, None] * [100.0, 20.0, 3.0]
    assert fit_rotation("se3", line - line.mean(axis=0), line - line.mean(axis=0))[1] < 1e-3


@pytest.mark.parametrize("size", [1e-4, 1.0, 1e4])
def test_a_heading_is_determined_alike_at_any_size(size):
    """By positions that move as far as those of the run; not by a point, or by one that stands still."""
    here = size * np.random.default_rng(8).normal(size=(20, 3))
    assert fit_rotation("yaw", here, here)[1] == 1.0
    for still in (1e-5 * here, here * [0.0, 0.0, 1.0]):
        assert fit_rotation("yaw", still, here)[1] < 1e-3
        assert fit_rotation("yaw", here, still)[1] < 1e-3
    assert fit_rotation("yaw", here * [0.0, 0.0, 1.0], here * [0.0, 0.0, 1.0])[1] == 0.0


# --- damaged files --------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", WRITERS)
def test_a_damaged_file_is_read_or_is_one_line(run, tmp_path, name):
    _, truth, _ = run
    path = WRITERS[name](tmp_path, truth, rows_of(truth)[:40])
    if path.is_dir():
        path = path / "timestamps.txt"
    data, rng = path.read_bytes(), np.random.default_rng(11)
    placing = Placing(near=truth.lla[0])
    for k in range(70):
        broken = bytearray(data[: rng.integers(len(data))] if k < 20 else data)
        if k >= 20:
            for at in rng.integers(len(data), size=rng.integers(1, 6)):
                broken[at] ^= 1 << rng.integers(8)
        path.write_bytes(broken)
        try:
            read_solution(path.parent if name == "oxts" else path, placing=placing)
        except ConfigError as error:
            lines = str(error).splitlines()
        else:
            lines = [""]
        assert len(lines) == 1
