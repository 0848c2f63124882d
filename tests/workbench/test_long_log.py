"""A long log is read, checked and navigated in blocks of rows: the bits of a whole in bounded memory."""

from __future__ import annotations

import tracemalloc
from dataclasses import fields

import numpy as np
import pytest
from numpy.testing import assert_array_equal

from bench.core.files import disk_arrays
from bench.core.mathematics import earth
from bench.core.records.flight_specs import TableSpec
from bench.evaluation.motion import motion_fit
from bench.io.logs import formats
from bench.io.results import join_pieces, parquet
from bench.io.trajectories.trajectory import read_trajectory
from bench.pipeline import log_pipeline
from bench.simulation import sensors
from tests.exchange import drives
from tests.weaving import units

LOG = """
[imu]
file = "imu.parquet"
time_offset_s = 0.003  # so that fixes and answers lie between samples
[gnss]
file = "gnss.parquet"
[baro]
file = "baro.parquet"
[sensors.assumed]
imu = "stim300"
gnss = "l1-code"
baro = "bmp388"
[alignment]
kind = "given"
roll_deg = 0.0
pitch_deg = 0.0
heading_deg = 0.0
[evaluation]
output_hz = 1.0
"""


@pytest.fixture
def in_blocks(monkeypatch):
    """Return a function after which a block has so many rows, and an array of 4 kB lies on disk."""

    def cut(rows: int) -> None:
        monkeypatch.setattr(disk_arrays, "ROWS", rows)
        monkeypatch.setattr(disk_arrays, "LARGE", 1 << 12)

    return cut


def circling(folder, seconds: float):
    """Return the truth at 50 Hz of circles of 500 m at 15 m/s, through a table of them."""
    t = np.arange(0.0, seconds + 0.05, 0.1)
    course = 0.03 * t
    around = 500.0 * np.column_stack([np.sin(course), 1.0 - np.cos(course), 0.0 * t])
    lla = earth.displace(drives.ORIGIN, around)
    rows = [t, np.rad2deg(lla[:, 0]), np.rad2deg(lla[:, 1]), lla[:, 2], 0.0 * t, 0.0 * t, np.rad2deg(course)]
    header = "t_s,lat_deg,lon_deg,alt_m,roll_deg,pitch_deg,heading_deg"
    np.savetxt(folder / "path.csv", np.column_stack(rows), delimiter=",", header=header, comments="")
    return join_pieces(read_trajectory(TableSpec("path", folder / "path.csv", 50.0, None)))


def columns(record) -> dict[str, np.ndarray]:
    return {f.name: getattr(record, f.name) for f in fields(record)}


@pytest.mark.parametrize("repeat", [False, True], ids=["fixes at 5 Hz", "fixes in every row"])
def test_a_log_read_in_blocks_has_the_bits_of_one_read_at_once(tmp_path, in_blocks, repeat):
    """Rates along other axes, two of them not numbers, times that go back, fixes between samples."""
    path = drives.write_log(tmp_path, mounting_deg=(0.0, 0.0, 30.0))
    found = drives.sensed(mounting_deg=(0.0, 0.0, 30.0))
    imu = drives.imu_columns(found["imu"])
    imu["t_s"] = imu["t_s"] + 0.003
    imu["t_s"][[500, 998, 999, 5000]] -= 0.011
    imu["gyro_x_rad_s"][[700, 1998]] = np.nan
    imu["accel_z_m_s2"][3000] = 1e9
    drives.write_csv(tmp_path / "imu.csv", imu)
    if repeat:
        last = np.maximum(np.arange(len(imu["t_s"])) // 20, 0).clip(max=len(found["gnss"]["t"]) - 1)
        gnss = {name: column[last] for name, column in drives.gnss_columns(found["gnss"]).items()}
        drives.write_csv(tmp_path / "gnss.csv", gnss | {"t_s": found["imu"]["t"]})
    text = path.read_text().replace("[sensors", '[baro]\nfile = "baro.csv"\n[sensors')
    text = text.replace("position_m = [1.0", "mounting_deg = [0.0, 0.0, 30.0]\nposition_m = [1.0")
    path.write_text(text.replace('gnss = "gnss.toml"', 'gnss = "gnss.toml"\nbaro = "baro.toml"'))

    def read():
        log = log_pipeline.read_log(path, tune_noise=True)
        session = log_pipeline.Session(log.spec, log.records, log_pipeline.find_start(log.records, log.spec))
        keep, _ = session.split_fixes()
        return log, session.make_data(keep, session.make_output_times())

    whole, data = read()
    assert len(data.imu) > len(whole.records.imu) == 15000
    assert np.count_nonzero(~whole.records.imu.valid) == 2
    in_blocks(999)
    pieces, cut = read()
    for a, b in ((whole.records, pieces.records), (data, cut)):
        for name in ("imu", "fixes"):
            for field, column in columns(getattr(a, name)).items():
                assert_array_equal(getattr(getattr(b, name), field), column, strict=True)
    for field, column in columns(whole.records.instruments["baro"]).items():
        assert_array_equal(getattr(pieces.records.instruments["baro"], field), column, strict=True)
        assert_array_equal(getattr(cut.baro, field), getattr(data.baro, field), strict=True)
    assert pieces.checks == whole.checks
    assert pieces.spec.assumed == whole.spec.assumed


def test_a_longer_log_takes_hardly_more_memory(tmp_path, monkeypatch):
    """To read, check, navigate and evaluate it: blocks of 4096 rows, not 65,536, 10 segments, not 150.

    What grows with each row: times and their steps in the checks, a few arrays of 8 B at a time, and some
    hundred B for each of the fixes and answers, every 50 rows. Read as a whole it is 150 B and more, and a
    filter that takes the record as a whole needs 700 B.
    """
    monkeypatch.setattr(disk_arrays, "ROWS", 4096)
    monkeypatch.setattr(disk_arrays, "LARGE", 1 << 17)
    monkeypatch.setattr(motion_fit, "MOST_SEGMENTS", 10)
    peaks = []
    for minutes in (2, 4, 14):  # the first compiles what the others use
        folder = tmp_path / str(minutes)
        folder.mkdir()
        data = sensors.sense(circling(folder, 60.0 * minutes), units(), 1, 0).data
        for name in ("imu", "baro"):
            parquet.write(folder / f"{name}.parquet", getattr(data, name))
        parquet.write(folder / "gnss.parquet", data.fixes)
        (folder / "log.toml").write_text(LOG)
        del data
        if minutes > 2:
            tracemalloc.start()
        log_pipeline.navigate(log_pipeline.read_log(folder / "log.toml"))
        peaks.append(tracemalloc.get_traced_memory()[1])
        tracemalloc.stop()
    more = (peaks[2] - peaks[1]) / (60 * 10 * 50)
    assert more < 60, f"{more:.0f} B for each row, {peaks[1] / 1e6:.1f} and {peaks[2] / 1e6:.1f} MB"


def test_a_text_file_read_in_blocks_is_that_read_at_once(tmp_path, in_blocks):
    numbers = np.random.default_rng(1).normal(size=(2500, 7))
    np.savetxt(tmp_path / "imu.txt", numbers, fmt="%.17g")
    in_blocks(999)
    rows = formats.read("kf-gins", tmp_path / "imu.txt", "imu", None)
    assert_array_equal(rows.t, numbers[:, 0], strict=True)
    assert_array_equal(np.hstack([rows.values["dtheta"], rows.values["dvel"]]), numbers[:, 1:], strict=True)
