"""An export holds the run's own numbers: each format is read back by its own reader, or by the rules of the
tool it is for, and compared with the record; units and frames by what they mean, not by the code that wrote
them."""

from __future__ import annotations

import ast
import json
import re
import shutil
import subprocess
import sys
from dataclasses import replace
from datetime import datetime
from types import SimpleNamespace
from xml.etree import ElementTree as Xml

import numpy as np
import pyarrow.csv as pa_csv
import pyarrow.parquet as pq
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from bench.cli.command_line import main
from bench.core.mathematics import earth, rotation
from bench.core.records.data import InitialState
from bench.core.records.sensor_specs import GAUSS_MARKOV_PEAK
from bench.core.words.exceptions import ExportError
from bench.io import results
from bench.io.exports import FORMATS, gather, local, write
from tests.exchange.exported import ERROR, make_run, text_rows

SECOND = 4 * 86400 + 18.0  # 2026-01-01 is the fifth day of GPS week 2399, 18 s behind GPS time


@pytest.fixture
def export(run, tmp_path, capsys):
    def go(kind: str, *options: str):
        out = tmp_path / kind
        status = main(["export", str(run[0]), "--to", kind, "-o", str(out), *options])
        said, complaint = capsys.readouterr()
        assert (status, complaint) == (0, ""), complaint
        assert said.startswith(f"{out}: ") or str(out) in said.replace("\n", "")
        assert (out / "README.md").read_text().startswith(f"# Export of circle to {kind}\n")
        return out

    return go


def complaint(capsys, *arguments: str) -> str:
    status = main(arguments)
    out, err = capsys.readouterr()
    assert (status, out) == (2, ""), err
    assert err.count("\n") == 1
    return err


# --- tables -------------------------------------------------------------------------------------------


@pytest.mark.parametrize("kind", ["csv", "parquet"])
def test_tables_hold_every_bit_of_the_records(run, export, kind):
    _, truth, sensed = run
    out = export(kind, "--with", "truth", "--with", "solution:made")
    read = {"csv": pa_csv.read_csv, "parquet": pq.read_table}[kind]
    imu = read(out / f"imu.{kind}")
    assert imu.num_rows == len(sensed.data.imu)
    assert_array_equal(imu["t_s"].to_numpy(), sensed.data.imu.t)
    for k, axis in enumerate("xyz"):
        assert_array_equal(imu[f"dtheta_{axis}_rad"].to_numpy(), sensed.data.imu.dtheta_b[:, k])
        assert_array_equal(imu[f"dvel_{axis}_mps"].to_numpy(), sensed.data.imu.dvel_b[:, k])
    gnss = read(out / f"gnss.{kind}")
    assert_array_equal(gnss["lat_rad"].to_numpy(), sensed.data.fixes.lla[:, 0])
    assert_array_equal(gnss["cov_pos_d_pos_d"].to_numpy(), sensed.data.fixes.cov_pos_n[:, 2, 2])
    assert_array_equal(gnss["valid"].to_numpy().astype(bool), sensed.data.fixes.valid)
    assert_array_equal(read(out / f"truth.{kind}")["q_nb_z"].to_numpy(), truth.q_nb[:, 3])
    assert read(out / f"solution-made.{kind}").num_rows == 202
    start = json.loads((out / "start.json").read_text())
    assert_array_equal(start["initial"]["q_nb"], sensed.initial.q_nb)
    assert_array_equal(start["antenna_b_m"], sensed.data.antenna_b)
    assert start["assumed"]["imu"]["gyro"]["random_walk"] == sensed.data.specs.imu.gyro.random_walk


def test_truth_and_solutions_go_out_only_when_asked_for(export):
    names = {path.name for path in export("csv").iterdir()}
    assert names == {
        ".bench.json",
        "README.md",
        "start.json",
        "imu.csv",
        "gnss.csv",
        "baro.csv",
        "output.csv",
    }


def test_matlab_structures(run, export):
    from scipy.io import loadmat

    _, truth, sensed = run
    out = export("mat", "--with", "truth")
    read = loadmat(out / "run.mat", squeeze_me=True, struct_as_record=False)
    assert_array_equal(read["imu"].dvel_z_mps, sensed.data.imu.dvel_b[:, 2])
    assert_array_equal(read["truth"].alt_m, truth.lla[:, 2])
    assert_array_equal(read["start"].initial.cov, sensed.initial.cov)
    assert read["start"].assumed.baro.rate == sensed.data.specs.baro.rate


# --- filters ------------------------------------------------------------------------------------------


def test_kf_gins_text_has_the_rows_rates_units_and_values_of_the_run(run, export):
    _, truth, sensed = run
    data, initial = sensed.data, sensed.initial
    out = export("kf-gins", "--with", "truth")
    imu, gnss, nav = (text_rows(out / name) for name in ("imu.txt", "gnss.txt", "truth.nav"))
    assert imu.shape == (len(data.imu), 7)
    assert_allclose(np.diff(imu[:, 0]), 0.01, atol=1e-9)
    for row in (0, -1):
        assert_allclose(imu[row, 0] - SECOND, data.imu.t[row], atol=1e-9)
        assert_array_equal(imu[row, 1:], [*data.imu.dtheta_b[row], *data.imu.dvel_b[row]])
    good = data.fixes.valid
    assert gnss.shape == (good.sum(), 7)
    assert good.sum() == 17  # 20 fixes, two of them in the outage, one invalid
    for row in (0, -1):
        lla = data.fixes.lla[good][row]
        assert_allclose(gnss[row, 1:4], [np.rad2deg(lla[0]), np.rad2deg(lla[1]), lla[2]], rtol=1e-14)
        assert_allclose(gnss[row, 4:] ** 2, np.diag(data.fixes.cov_pos_n[good][row]), rtol=1e-12)
    assert nav.shape == (len(truth), 11)
    assert_array_equal(nav[:, 0], 2399)
    assert_array_equal(nav[:, 5:8], truth.vel_n)
    assert_allclose(nav[:, 8], np.rad2deg(0.65), atol=1e-9)  # the bank of the circle
    keys = configuration(out / "kf-gins.yaml")
    assert keys["imudatarate"] == 100
    assert keys["starttime"] == imu[0, 0]
    assert_allclose(keys["initposstd"], np.sqrt(np.diag(initial.cov))[:3], rtol=1e-9)
    assert_allclose(keys["antlever"], data.antenna_b)
    assert_allclose(keys["arw"], np.rad2deg(data.specs.imu.gyro.random_walk) * 60, rtol=1e-9)  # deg/sqrt(h)
    assert_allclose(keys["vrw"], data.specs.imu.accel.random_walk * 60, rtol=1e-9)  # m/s/sqrt(h)
    place = [np.deg2rad(keys["initpos"][0]), np.deg2rad(keys["initpos"][1]), keys["initpos"][2]]
    moved = earth.difference_n(np.array(place), truth.lla[1])  # the start is off by what it was told wrong
    told = earth.difference_n(initial.lla, truth.lla[0])
    assert_allclose(moved, told + 0.01 * (initial.vel_n - truth.vel_n[0]), atol=1e-4)
    q_nb = rotation.from_euler(*np.deg2rad(keys["initatt"]))
    turned = rotation.to_rotvec(rotation.multiply(q_nb, rotation.conjugate(truth.q_nb[1])))
    before = rotation.to_rotvec(rotation.multiply(initial.q_nb, rotation.conjugate(truth.q_nb[0])))
    assert_allclose(turned, before, atol=2e-4)
    assert (
        np.linalg.norm(
            rotation.to_rotvec(rotation.multiply(truth.q_nb[1], rotation.conjugate(truth.q_nb[0])))
        )
        > 2e-3
    )


def test_the_date_is_that_of_the_flight_and_of_its_receiver(run, tmp_path):
    whole = gather(run[0])
    assert str(whole.calendar) == "t = 0 is 2026-01-01 00:00:00 UTC, second 345618 of GPS week 2399"
    year = dict(whole.start) | {"date": 2012 + 60 / 366}  # 1 March, a leap year; 15 leap seconds
    old = replace(whole, start=year).calendar
    assert (old.utc, old.week, old.second) == (datetime(2012, 3, 1), 1677, 4 * 86400 + 15.0)
    sky = SimpleNamespace(gps_t0=43200.5)
    noon = replace(whole, start=year, observations=sky).calendar
    assert (noon.utc, noon.second) == (datetime(2012, 3, 1, 11, 59, 45, 500000), 4 * 86400 + 43200.5)


def unknown_start(whole):
    """The same run, the initial state left to the alignment on the move."""
    unknown, wide = np.full(3, np.nan), np.diag(np.full(9, np.inf))
    asked = InitialState(0.0, unknown, unknown, np.full(4, np.nan), wide, "course", 10.0, drift_sd=0.02)
    return replace(whole, start={**whole.start, "initial": results.write_initial_state(asked)})


def test_a_start_that_the_filters_find_is_exported_from_there_on(run, tmp_path):
    """Position, velocity and attitude of the first row are those of the truth within 5 sd."""
    _, truth, sensed = run
    whole = unknown_start(gather(run[0]))
    out, remark = whole.align()
    initial = results.read_initial_state(out.start)
    assert 9.0 < initial.t < 12.0
    lost = int((sensed.data.imu.t <= initial.t).sum())
    assert (len(whole.imu) - len(out.imu), out.fixes.t.min() > initial.t) == (lost, True)
    assert f"as the alignment 'course' finds it, is at t = {initial.t:.6g} s; {lost} rows" in remark
    lla, vel_n, q_nb, sd = out.start_at_first_row()
    k = int(np.searchsorted(truth.t, out.imu.t[0] - 1e-6))
    assert_allclose(earth.difference_n(lla, truth.lla[k]) / sd[:3], 0.0, atol=5.0)
    assert_allclose((vel_n - truth.vel_n[k]) / sd[3:6], 0.0, atol=5.0)
    turned = rotation.to_rotvec(rotation.multiply(q_nb, rotation.conjugate(truth.q_nb[k])))
    assert_allclose(turned / sd[6:], 0.0, atol=5.0)
    (tmp_path / "out").mkdir()
    write(tmp_path / "out", "kf-gins", whole, "circle")
    assert configuration(tmp_path / "out" / "kf-gins.yaml")["starttime"] == out.imu.t[0] + SECOND
    assert "is at t = " in (tmp_path / "out" / "README.md").read_text()
    with pytest.raises(ExportError, match="alignment = 'course' finds none: "):
        replace(whole, fixes=None).align()


def test_what_is_not_known_of_a_start_is_nan_in_matlab(run, tmp_path):
    """A file of the run says null."""
    from scipy.io import loadmat

    folder = shutil.copytree(run[0], tmp_path / "run")
    results.write_json(folder / results.START, dict(unknown_start(gather(folder)).start))
    (tmp_path / "out").mkdir()
    write(tmp_path / "out", "mat", gather(folder), "circle")
    read = loadmat(tmp_path / "out" / "run.mat", squeeze_me=True, struct_as_record=False)["start"].initial
    assert_array_equal(read.q_nb, np.full(4, np.nan))
    assert_array_equal(read.cov, np.where(np.eye(9), np.nan, 0.0))
    assert read.lat_rad.size == 0


def test_a_start_between_two_samples_is_exported_from_there_on(run):
    """4 ms into an interval of 10 ms; the rest of the interval moves it on to the first row."""
    _, truth, _ = run
    whole = gather(run[0])
    given = {**whole.start["initial"], "t_s": 5.004, "vel_n_mps": truth.vel_n[500]}
    out, remark = replace(whole, start={**whole.start, "initial": given}).align()
    assert_allclose([out.imu.t[0], out.imu.dt[0]], [5.01, 0.006], atol=1e-9)
    assert_allclose(out.imu.dvel_b[0], 0.6 * whole.imu.dvel_b[500], rtol=1e-9)
    assert "the alignment" not in remark
    assert len(out.imu) == len(whole.imu) - 500


def configuration(path):
    """The keys of a kf-gins.yaml; those of its table imunoise stand beside the others."""
    keys = {}
    for line in path.read_text().splitlines():
        key, _, value = line.partition(":")
        if value.strip():
            keys[key.strip()] = ast.literal_eval(value.strip())
    return keys


def test_navego_structures_have_the_rows_rates_units_and_values_of_the_run(run, export):
    from scipy.io import loadmat

    _, truth, sensed = run
    data = sensed.data
    read = loadmat(export("navego", "--with", "truth") / "navego.mat", struct_as_record=False)
    imu, gnss, ref = (read[name][0, 0] for name in ("imu", "gnss", "ref"))
    n = len(data.imu)
    assert (imu.t.shape, imu.wb.shape, imu.fb.shape) == ((n, 1), (n, 3), (n, 3))
    assert_allclose([imu.freq[0, 0], gnss.freq[0, 0]], [100, 1])
    for row in (0, -1):
        assert imu.t[row, 0] == data.imu.t[row]
        assert_allclose(imu.wb[row], data.imu.dtheta_b[row] / 0.01, rtol=1e-9)
        assert_allclose(imu.fb[row], data.imu.dvel_b[row] / 0.01, rtol=1e-9)
    assert_allclose(np.linalg.norm(imu.fb, axis=1).mean(), np.hypot(9.80, 25 * 0.3), rtol=0.01)  # m/s^2
    good = data.fixes.valid
    assert gnss.t.shape == (good.sum(), 1)
    for row in (0, -1):
        lla = data.fixes.lla[good][row]
        assert_array_equal([gnss.lat[row, 0], gnss.lon[row, 0], gnss.h[row, 0]], lla)
        assert_array_equal(gnss.vel[row], data.fixes.vel_n[good][row])
    assert_array_equal(gnss.larm, data.antenna_b[:, None])
    assert_allclose(gnss.std[0, 0] * 6.37e6, gnss.stdm[0, 0], rtol=0.01)
    assert_allclose(gnss.std[0, 1] * 6.39e6 * np.cos(0.82), gnss.stdm[0, 1], rtol=0.01)
    assert gnss.std[0, 2] == pytest.approx(gnss.stdm[0, 2])
    assert gnss.eps[0, 0] == pytest.approx(0.005)
    figures = data.specs.imu.gyro
    assert_allclose(imu.arw, np.full((1, 3), figures.random_walk))
    assert_allclose(imu.g_std, np.full((1, 3), figures.random_walk * 10))
    assert_allclose(imu.gb_psd * np.sqrt(imu.gb_corr), imu.gb_dyn)
    assert_allclose(ref.roll, 0.65, atol=1e-12)
    assert ref.yaw.shape == (len(truth), 1)
    assert_allclose(imu.ini_align[0], rotation.to_euler(sensed.initial.q_nb), atol=0.005)


def test_figures_of_the_datasheet_go_out_in_the_units_of_each_filter(run, tmp_path):
    """Gyros: 3 deg/h that wander in half an hour, 4 deg/h at the start; accelerometers 6 and 8 mGal."""
    from scipy.io import loadmat

    whole = gather(run[0])
    deg_h, mgal = np.deg2rad(1.0) / 3600.0, 1e-5
    figures = {
        "gyro": {"bias_instability": 3.0 * deg_h, "turn_on_bias_sd": 4.0 * deg_h, "bias_correlation": 1800.0,
                 "scale_factor_sd": 150e-6, "random_walk": 1e-4, "rate_random_walk": 2e-7},
        "accel": {"bias_instability": 6.0 * mgal, "turn_on_bias_sd": 8.0 * mgal, "bias_correlation": 7200.0,
                  "scale_factor_sd": 250e-6, "random_walk": 3e-3, "rate_random_walk": 4e-6},
    }  # fmt: skip
    for one in figures.values():
        one["bias_instability"] *= GAUSS_MARKOV_PEAK  # of the Allan deviation
    assumed = whole.start["assumed"]
    imu = {**assumed["imu"], **{triad: {**assumed["imu"][triad], **figures[triad]} for triad in figures}}
    told = replace(whole, start={**whole.start, "assumed": {**assumed, "imu": imu}})
    for kind in ("kf-gins", "navego", "python-ins"):
        (tmp_path / kind).mkdir()
        write(tmp_path / kind, kind, told, "circle")
    keys = configuration(tmp_path / "kf-gins" / "kf-gins.yaml")
    for name, value in {
        "gbstd": 3.0, "initbgstd": 5.0, "abstd": 6.0, "initbastd": 10.0, "gsstd": 150.0, "asstd": 250.0,
    }.items():  # fmt: skip
        assert_allclose(keys[name], [value] * 3, rtol=1e-9)
    assert keys["corrtime"] == 0.5
    sd = np.sqrt(np.diag(run[2].initial.cov))
    assert_allclose(keys["initvelstd"], sd[3:6], rtol=1e-9)
    assert_allclose(keys["initattstd"], np.rad2deg(sd[6:9]), rtol=1e-9)
    read = loadmat(tmp_path / "navego" / "navego.mat", struct_as_record=False)
    found, gnss = read["imu"][0, 0], read["gnss"][0, 0]
    for name, value in {
        "arw": 1e-4, "arrw": 2e-7, "gb_dyn": 3.0 * deg_h, "gb_corr": 1800.0, "g_std": 1e-3,
        "gb_psd": 3.0 * deg_h / 1800.0**0.5, "vrw": 3e-3, "vrrw": 4e-6, "ab_dyn": 6.0 * mgal, "a_std": 3e-2,
        "ab_corr": 7200.0, "ab_psd": 6.0 * mgal / 7200.0**0.5, "ab_sta": 0.0, "gb_sta": 0.0,
    }.items():  # fmt: skip
        assert_allclose(getattr(found, name), [[value] * 3], rtol=1e-9)
    assert_allclose(found.ini_align_err[0], sd[6:9])
    fixes = whole.select_fixes()
    assert_allclose(gnss.stdv[0] ** 2, np.median(fixes.cov_vel_n, axis=0).diagonal())
    assert_allclose(gnss.stdm[0] ** 2, np.median(fixes.cov_pos_n, axis=0).diagonal())
    models = re.findall(
        r"bias_sd=(\S+), noise=(\S+), bias_walk=(\S+)\)", (tmp_path / "python-ins" / "README.md").read_text()
    )
    expected = [
        [5.0 * deg_h, 1e-4, 3.0 * deg_h * (2.0 / 1800.0) ** 0.5],
        [10.0 * mgal, 3e-3, 6.0 * mgal * (2.0 / 7200.0) ** 0.5],
    ]
    assert_allclose(np.array(models, float), expected, rtol=1e-5)


def test_python_ins_frames_have_its_columns_its_degrees_and_the_sample_before_the_start(run, export):
    _, truth, sensed = run
    data, out = sensed.data, export("python-ins", "--with", "truth")
    imu, place, speed, track = (
        pq.read_table(out / f"{name}.parquet") for name in ("imu", "position", "velocity", "truth")
    )
    assert imu.column_names == ["time", "gyro_x", "gyro_y", "gyro_z", "accel_x", "accel_y", "accel_z"]
    assert_array_equal(imu["time"].to_numpy(), [0.0, *data.imu.t])
    assert_array_equal(imu["accel_z"].to_numpy()[1:], data.imu.dvel_b[:, 2])
    assert imu["gyro_y"][0] == imu["gyro_y"][1]
    good = data.fixes.valid
    assert_array_equal(place["time"].to_numpy(), data.fixes.t[good])
    assert_allclose(place["lon"].to_numpy(), np.rad2deg(data.fixes.lla[good, 1]), rtol=1e-14)
    assert_array_equal(place["alt"].to_numpy(), data.fixes.lla[good, 2])
    assert_array_equal(speed["VD"].to_numpy(), data.fixes.vel_n[good, 2])
    assert_allclose(track["roll"].to_numpy(), np.rad2deg(0.65))
    assert_allclose(track["heading"].to_numpy()[:100], np.rad2deg(0.7 + 0.3 * truth.t[:100]))
    (start,) = pq.read_table(out / "initial.parquet").to_pylist()
    assert start["VN"] == sensed.initial.vel_n[0]


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore:The copy keyword is deprecated")  # python-ins under pandas 3
@pytest.mark.filterwarnings("ignore:.*invalid escape sequence")  # python-ins where it is compiled at import
def test_python_ins_runs_on_what_its_readme_says(run, export, monkeypatch):
    _, truth, sensed = run
    out = export("python-ins", "--with", "truth")
    code = (out / "README.md").read_text().split("```python\n")[1].split("```")[0]
    monkeypatch.chdir(out)
    found: dict = {}
    exec(code, found)
    result = found["result"]
    used = sensed.data.fixes.valid & (sensed.data.fixes.t < truth.t[-1])  # it takes none at the last time
    assert len(result.innovations["Position"]) == used.sum() == 16
    end = result.trajectory.iloc[-1]
    lla = np.array([np.deg2rad(end["lat"]), np.deg2rad(end["lon"]), end["alt"]])
    # a receiver that wanders by meters and 20 s of it: a wrong unit, sign or frame is off by far more
    assert np.linalg.norm(earth.difference_n(lla, truth.lla[-1])) < 30
    assert abs(end["roll"] - np.rad2deg(0.65)) < 2
    frame = found["read"]("truth")
    assert_array_equal(frame["VN"].to_numpy(), truth.vel_n[:, 0])


# --- tracks -------------------------------------------------------------------------------------------


def test_nmea_sentences_check_and_say_where_the_fixes_are(run, export):
    _, _, sensed = run
    fixes = sensed.data.fixes
    out = export("nmea", "--with", "truth")
    lines = (out / "gnss.nmea").read_bytes().decode("ascii").split("\r\n")
    assert lines.pop() == ""
    assert len(lines) == 2 * len(fixes)
    for k, (gga, rmc) in enumerate(zip(lines[::2], lines[1::2], strict=True)):
        assert max(len(gga), len(rmc)) <= 80  # and the line end: 82, the longest of NMEA 0183
        place, motion = sentence(gga, "GPGGA", 15), sentence(rmc, "GPRMC", 13)
        t = fixes.t[k]
        assert place[1] == motion[1] == f"0000{int(t):02d}.{round(1000 * (t % 1)):03d}"
        assert motion[9] == "010126"
        if not fixes.valid[k]:
            assert (place[6], motion[2], place[2]) == ("0", "V", "")
            continue
        assert (place[6], motion[2], place[2:6]) == ("1", "A", motion[3:7])
        lla = np.array(
            [degrees(place[2], place[3]), degrees(place[4], place[5]), float(place[9]) + float(place[11])]
        )
        off = earth.difference_n(lla * [np.pi / 180, np.pi / 180, 1], fixes.lla[k])
        assert np.abs(off).max() < 1e-3
        course = np.deg2rad(float(motion[8]))
        north, east = float(motion[7]) * 1852 / 3600 * np.array([np.cos(course), np.sin(course)])
        assert_allclose([north, east], fixes.vel_n[k, :2], atol=1e-3)
    assert len((out / "truth.nmea").read_text().splitlines()) == 2 * 201


def sentence(line: str, kind: str, fields: int) -> list[str]:
    body, _, check = line.removeprefix("$").partition("*")
    total = 0
    for byte in body.encode():
        total ^= byte
    assert f"{total:02X}" == check
    parts = body.split(",")
    assert (parts[0], len(parts)) == (kind, fields)
    return parts


def degrees(angle: str, side: str) -> float:
    whole, minutes = angle[: angle.index(".") - 2], angle[angle.index(".") - 2 :]
    return (int(whole) + float(minutes) / 60) * (-1 if side in "SW" else 1)


def test_nmea_of_the_south_west_and_of_a_full_minute():
    from bench.io.exports.nmea import make_sentences

    lla = np.array([np.deg2rad(-33.9999999999), np.deg2rad(-0.5), 10.0])
    from bench.io.exports.outgoing import Calendar

    calendar = Calendar(2399, 18.0, datetime(2026, 1, 4))
    gga, rmc = make_sentences(calendar, 86399.9996, lla, np.array([-1.0, -1e-9, 0.0]), 7, valid=True)
    assert gga.startswith("$GPGGA,000000.000,3400.0000000,S,00030.0000000,W,1,07,,10.000,M,0.0,M,,*")
    assert rmc.startswith("$GPRMC,000000.000,A,3400.0000000,S,00030.0000000,W,1.944,180.000,050126,,,A*")


def test_kml_is_xml_with_a_point_for_each_fix(run, export):
    _, _, sensed = run
    root = Xml.parse(export("kml", "--with", "solution:made") / "tracks.kml").getroot()
    names = {"k": "http://www.opengis.net/kml/2.2", "gx": "http://www.google.com/kml/ext/2.2"}
    marks = root.findall(".//k:Placemark", names)
    assert [mark.findtext("k:name", namespaces=names) for mark in marks] == ["GNSS fixes", "solution-made"]
    points = [list(map(float, e.text.split())) for e in marks[0].findall(".//gx:coord", names)]
    when = [e.text for e in marks[0].findall(".//k:when", names)]
    good = sensed.data.fixes.valid
    assert len(points) == len(when) == good.sum()
    lat, lon, alt = sensed.data.fixes.lla[good].T
    assert_allclose(points, np.column_stack([np.rad2deg(lon), np.rad2deg(lat), alt]), atol=6e-4)
    assert_allclose(np.array(points)[:, 0], np.rad2deg(lon), atol=1e-9)
    assert when[0] == "2026-01-01T00:00:01.000Z"


def test_tum_poses_are_east_north_up_and_forward_left_up(run, export):
    _, truth, _ = run
    out = export("tum", "--with", "truth", "--with", "solution:made")
    t, x, y, z, *q = text_rows(out / "truth.tum").T
    assert_array_equal(t, truth.t)
    C = rotation.matrix(np.column_stack([q[3], q[0], q[1], q[2]]))  # to scalar first
    heading, bank = 0.7 + 0.3 * truth.t, 0.65
    forward = np.column_stack([np.sin(heading), np.cos(heading), np.zeros_like(t)])  # east, north, up
    assert_allclose(C[:, :, 0], forward, atol=2e-4)  # the plane of the origin, 80 m away: 1.3e-5 rad
    assert_allclose(C[:, 2, 1], np.sin(bank), atol=2e-4)  # in a right bank the left wing points up
    radius = 25.0 / 0.3
    assert_allclose(x, radius * (np.cos(0.7) - np.cos(heading)), atol=0.01)
    assert_allclose(y, radius * (np.sin(heading) - np.sin(0.7)), atol=0.01)
    assert_allclose(z, -(x**2 + y**2) / (2 * 6.38e6), atol=2e-5)  # the Earth falls off under the plane
    wrong = text_rows(out / "solution-made.tum")
    true = np.column_stack([x, y, z])[np.round(wrong[:, 0] * 100).astype(int)]
    assert_allclose(wrong[:, 1:4] - true, [[-2.0, 3.0, -1.0]] * 202, atol=2e-4)
    assert ERROR["pos_n"] == [3.0, -2.0, 1.0]


@pytest.mark.parametrize(("kind", "ending"), [("kf-gins", "nav"), ("tum", "tum")])
def test_instants_without_a_pose_are_left_out_of_texts_of_numbers(run, tmp_path, kind, ending):
    """A filter that aligns itself knows nothing before."""
    whole = gather(run[0], ["solution:made"])
    (track,) = whole.tracks.values()
    lla = np.where(np.arange(202)[:, None] < 5, np.nan, track.lla)
    out = replace(whole, tracks={"late": replace(track, lla=lla)})
    write(tmp_path, kind, out, "circle")
    assert len(text_rows(tmp_path / f"late.{ending}")) == 197
    assert "5 epochs without" in " ".join((tmp_path / "README.md").read_text().split())
    nothing = replace(whole, tracks={"none": replace(track, lla=np.full((202, 3), np.nan))})
    with pytest.raises(ExportError, match=f"none has no position with .*, which {kind} needs"):
        write(tmp_path, kind, nothing, "circle")


def test_local_axes():
    """East, north, up of a pose that looks north, wings level: forward is y, left is minus x, up is z."""
    origin = np.array([0.5, 1.0, 100.0])
    position, q = local.to_poses(origin[None], np.array([[1.0, 0.0, 0.0, 0.0]]), origin)
    assert_allclose(position, 0.0, atol=1e-9)
    assert_allclose(rotation.matrix(q)[0], [[0, -1, 0], [1, 0, 0], [0, 0, 1]], atol=1e-12)
    assert_array_equal(local.to_enu(np.array([1.0, 2.0, 3.0])), [2.0, 1.0, -3.0])


def test_rosbag2_is_read_back_by_rosbags(run, export):
    from rosbags.rosbag2 import Reader
    from rosbags.typesys import Stores, get_typestore

    _, truth, sensed = run
    data = sensed.data
    types = get_typestore(Stores.ROS2_HUMBLE)
    messages: dict[str, list] = {}
    with Reader(export("rosbag2", "--with", "truth") / "bag") as bag:
        for connection, stamp, raw in bag.messages():
            message = types.deserialize_cdr(raw, connection.msgtype)
            assert stamp == message.header.stamp.sec * 10**9 + message.header.stamp.nanosec
            messages.setdefault(connection.topic, []).append((stamp, message))
    counts = {topic: len(rows) for topic, rows in messages.items()}
    fixes = len(data.fixes)
    assert counts == {
        "/imu/data_raw": len(data.imu), "/gnss/fix": fixes, "/gnss/vel": fixes,
        "/baro/pressure": len(data.baro), "/truth": len(truth),
    }  # fmt: skip
    stamp, imu = messages["/imu/data_raw"][-1]
    assert stamp == 1767225600 * 10**9 + round(data.imu.t[-1] * 1e9)
    rate = imu.angular_velocity
    assert_allclose([rate.x, -rate.y, -rate.z], data.imu.dtheta_b[-1] / 0.01, rtol=1e-9)
    force = imu.linear_acceleration
    assert force.z > 9  # at rest an accelerometer of ROS reads +g along up
    assert_allclose([force.x, -force.y, -force.z], data.imu.dvel_b[-1] / 0.01, rtol=1e-9)
    assert imu.orientation_covariance[0] == -1
    _, fix = messages["/gnss/fix"][0]
    assert_allclose([fix.latitude, fix.longitude], np.rad2deg(data.fixes.lla[0, :2]), rtol=1e-14)
    assert_allclose(fix.position_covariance[8], data.fixes.cov_pos_n[0, 2, 2])
    assert [m.status.status for _, m in messages["/gnss/fix"]] == [0 if v else -1 for v in data.fixes.valid]
    _, velocity = messages["/gnss/vel"][0]
    linear = velocity.twist.twist.linear
    assert_allclose([linear.y, linear.x, -linear.z], data.fixes.vel_n[0])
    pressure = np.array([m.fluid_pressure for _, m in messages["/baro/pressure"]])
    altitude = 288.15 / 0.0065 * (1 - (pressure / 101325) ** (1 / 5.25588))
    assert_allclose(altitude, data.baro.alt_baro, atol=1e-6)
    assert_allclose(pressure[0], 87700, rtol=0.01)  # at 1200 m, the tables of the standard atmosphere
    _, pose = messages["/truth"][0]
    ahead = pose.twist.twist.linear
    assert_allclose([ahead.x, ahead.y, ahead.z], [25, 0, 0], atol=1e-9)


def test_without_rosbags_one_line_says_how_to_get_it(run, tmp_path):
    code = (
        "import sys; sys.modules['rosbags'] = None\n"
        "import importlib.util as u; real = u.find_spec\n"
        "u.find_spec = lambda name, *a: None if name == 'rosbags' else real(name, *a)\n"
        "from bench.cli.command_line import main\n"
        f"sys.exit(main(['export', {str(run[0])!r}, '--to', 'rosbag2', '-o', {str(tmp_path / 'bag')!r}]))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert done.returncode == 2
    assert done.stderr == "error: rosbag2 needs the package rosbags: pip install rosbags\n"
    assert list(tmp_path.iterdir()) == []


# --- the folder ---------------------------------------------------------------------------------------


def test_formats_are_listed_and_a_wrong_one_is_refused_with_the_nearest(run, tmp_path, capsys):
    assert main(["list", "exports", "--json"]) == 0
    (listed,) = json.loads(capsys.readouterr().out).values()
    assert [entry["name"] for entry in listed] == list(FORMATS)
    assert {"csv", "parquet", "mat", "kf-gins", "rosbag2"} <= set(FORMATS)
    assert main(["export", str(run[0]), "--to", "kfgins", "-o", str(tmp_path / "out")]) == 2
    first, known = capsys.readouterr().err.splitlines()
    assert first == "error: export format 'kfgins' is unknown. Did you mean 'kf-gins'?"
    assert known == f"  known formats: {', '.join(sorted(FORMATS))}"
    assert list(tmp_path.iterdir()) == []


def test_an_export_is_replaced_only_when_told_and_nothing_else_ever(run, tmp_path, capsys):
    out, to = str(tmp_path / "out"), ["export", str(run[0]), "--to", "nmea"]
    assert main([*to, "-o", out]) == 0
    capsys.readouterr()
    assert (
        complaint(capsys, *to, "-o", out)
        == f"error: {out}: the export exists; --force replaces it, -o names another\n"
    )
    assert main([*to, "-o", out, "--force"]) == 0
    capsys.readouterr()
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "README.md").write_text("# Mine\n")
    err = complaint(capsys, *to, "-o", str(tmp_path / "mine"), "--force")
    where = tmp_path / "mine"
    assert err == f"error: {where}: not replaced, bench did not write it (no .bench.json of bench in it)\n"
    err = complaint(capsys, *to, "-o", str(run[0]), "--force")
    assert "not replaced" in err
    assert results.read_result(run[0]).seed == 4


def test_the_default_folder_stands_beside_the_run(run, capsys):
    assert main(["export", str(run[0]), "--to", "nmea"]) == 0
    assert (run[0].parent / "circle-nmea" / "gnss.nmea").is_file()


def test_the_present_folder_is_a_run_like_another(run, monkeypatch):
    monkeypatch.chdir(run[0])
    assert main(["export", ".", "--to", "kml"]) == 0
    assert (run[0].parent / "circle-kml" / "tracks.kml").is_file()


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (("--to", "tum"), "tum contains poses, not sensors: add --with truth or --with solution:NAME"),
        (
            ("--to", "csv", "--with", "solution:../made"),
            "--with solution:../made: no such solution; there are made",
        ),
        (("--to", "csv", "--with", "thruth"), "--with thruth: must be truth or solution:NAME"),
    ],
)
def test_what_cannot_go_out_is_said_in_one_line(run, tmp_path, capsys, options, said):
    err = complaint(capsys, "export", str(run[0]), "-o", str(tmp_path / "out"), *options)
    assert err == f"error: {said}\n"
    assert list(tmp_path.iterdir()) == []


def test_a_folder_that_is_none_or_damaged_is_said_in_one_line(tmp_path, capsys):
    err = complaint(capsys, "export", str(tmp_path), "--to", "csv", "-o", str(tmp_path / "out"))
    assert (
        err
        == f"error: {tmp_path}: not a results folder, there is no result.json in it; 'bench run' writes one\n"
    )
    folder = tmp_path / "run"
    make_run(folder)
    (folder / "sensors-imu.parquet").write_bytes(b"PAR1" + bytes(100))
    err = complaint(capsys, "export", str(folder), "--to", "csv", "-o", str(tmp_path / "out"))
    assert err.startswith(f"error: {folder}: cannot be read: ")
    (folder / "sensors-imu.parquet").unlink()
    err = complaint(capsys, "export", str(folder), "--to", "csv", "-o", str(tmp_path / "out"))
    assert err == f"error: {folder}: no sensors-imu.parquet in it; 'bench run' writes a whole folder\n"
    other = tmp_path / "other"
    make_run(other)
    for start in ("[" * 100_000, "[]", "{}", '{"initial": 3, "date": Infinity}', "{"):
        (other / "sensors-start.json").write_text(start)
        err = complaint(capsys, "export", str(other), "--to", "csv")
        assert "cannot be read" in err
    (other / "sensors-start.json").write_text("{}")
    assert "' is missing" in complaint(capsys, "export", str(other), "--to", "csv")
    assert not (tmp_path / "out").exists()
