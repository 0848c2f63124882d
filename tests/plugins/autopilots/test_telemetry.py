"""Telemetry logs: what pymavlink wrote from known values comes back, damaged files are a line."""

from __future__ import annotations

import tracemalloc

import numpy as np
import pytest
from numpy.testing import assert_allclose

pytest.importorskip("pymavlink")

from bench.cli.command_line import main
from bench.core.mathematics.rotation import from_euler
from bench.core.words.exceptions import ConfigError
from bench.io.config.log import SourceSpec, load_log
from bench.io.logs import formats, own_estimate
from bench.io.logs.file_kinds import recognize
from bench.io.logs.log_records import read_records
from bench.io.logs.rows import ROW_MEMORY
from bench.plugins.autopilots import telemetry
from bench.simulation.signals.air import pressure_altitude
from tests.damage import spoil
from tests.plugins.autopilots.telemetry_writer import BEGIN, ELLIPSOID, motion, place, write_telemetry


def expect(t):
    """Positions that were written (N, 3)."""
    lat, lon = np.array([place(one) for one in t]).T
    return np.column_stack([np.deg2rad(1e-7 * lat), np.deg2rad(1e-7 * lon), np.full(len(t), ELLIPSOID)])


def test_every_sensor_comes_back_in_si(tmp_path):
    path = write_telemetry(tmp_path / "a.tlog")
    imu, gnss, baro, mag = (formats.read("tlog", path, kind, None) for kind in ("imu", "gnss", "baro", "mag"))
    assert_allclose(imu.t, 10.0 + np.arange(400) / 50.0)
    force, turn = (np.array(values) for values in zip(*map(motion, imu.t), strict=True))
    assert_allclose(imu.values["accel"], force, atol=5e-3)  # half a mg
    assert_allclose(imu.values["gyro"], turn, atol=5.1e-4)
    assert_allclose(mag.values["field_b"], np.tile([21e-6, 3e-6, -42e-6], (400, 1)))
    assert_allclose(baro.values["alt_baro"][:, 0], pressure_altitude(np.full(80, 95_000.0)), rtol=1e-6)
    assert_allclose(gnss.t, 10.0 + np.arange(40) / 5.0)
    assert_allclose(gnss.values["lla"], expect(gnss.t), rtol=1e-12)
    assert_allclose(gnss.values["vel_n"][:, :2], np.tile([3.0, -4.0], (40, 1)), atol=2e-3)
    assert np.isnan(gnss.values["vel_n"][:, 2]).all()
    assert_allclose(gnss.values["sd_pos"], np.tile([1.5 / np.sqrt(2), 1.5 / np.sqrt(2), 2.5], (40, 1)))
    assert set(gnss.values["satellites"]) == {14.0}


def test_the_estimate_is_over_the_ellipsoid(tmp_path):
    path = write_telemetry(tmp_path / "a.tlog")
    held = own_estimate.look("tlog", path)
    assert held.estimate
    assert held.sensors == ("imu", "gnss", "baro", "mag")
    assert str(held.date) == "2023-11-14"
    motion_ = own_estimate.read_estimate(SourceSpec(path, "tlog"), None).motion
    assert_allclose(motion_.lla, expect(motion_.t), rtol=1e-12)
    assert_allclose(motion_.vel_n, np.tile([3.0, -4.0, 0.5], (80, 1)))
    assert_allclose(motion_.q_nb, np.tile(from_euler(0.1, -0.05, 1.2), (80, 1)), atol=1e-7)


def test_fixes_in_unix_time_get_the_clock_of_the_autopilot(tmp_path):
    rows = formats.read("tlog", write_telemetry(tmp_path / "a.tlog", unix=True), "gnss", None)
    assert_allclose(rows.t, 10.0 + np.arange(40) / 5.0, atol=1e-6)
    assert BEGIN > 1e9


def test_a_gimbal_of_the_same_system_is_not_the_autopilot(tmp_path):
    plain, beside = (
        formats.read("tlog", write_telemetry(tmp_path / f"{one}.tlog", gimbal=one), "imu", None)
        for one in (False, True)
    )
    assert_allclose(beside.t, plain.t)
    assert_allclose(beside.values["accel"], plain.values["accel"])


def test_a_row_takes_no_more_than_its_numbers(tmp_path):
    path = write_telemetry(tmp_path / "a.tlog", count=20_000)
    tracemalloc.start()
    rows = formats.read("tlog", path, "imu", None)
    most = tracemalloc.get_traced_memory()[1] - path.stat().st_size
    tracemalloc.stop()
    assert len(rows.t) == 20_000
    assert most / len(rows.t) < ROW_MEMORY


def test_another_estimate_is_a_line_with_the_name_of_the_file(tmp_path):
    with pytest.raises(ConfigError, match=r"^a\.tlog: its only estimate is in"):
        telemetry.read_estimate(write_telemetry(tmp_path / "a.tlog"), 1)


def test_a_slow_imu_is_a_line_and_a_file_of_another_name_is_recognized(tmp_path, capsys):
    path = write_telemetry(tmp_path / "a.tlog", rate=4.0)
    assert main(["new", "log", str(path)]) == 2
    assert "RAW_IMU has 4 rows a second, too few to navigate (at least 20)" in capsys.readouterr().err
    kind = recognize(path.read_bytes()[:4096])
    assert kind is not None
    assert "MAVLink telemetry log" in kind.name


def test_new_log_writes_the_log_of_a_telemetry_log(tmp_path, capsys):
    path = write_telemetry(tmp_path / "a.tlog", count=3000)
    assert main(["new", "log", str(path)]) == 0, capsys.readouterr().err
    log = load_log(str(path.with_suffix(".toml")))
    assert len(read_records(log).imu) == 3000
    assert 'use = "autopilot"' in path.with_suffix(".toml").read_text()


def test_damage_is_skipped_or_a_line(tmp_path):
    whole = write_telemetry(tmp_path / "a.tlog").read_bytes()
    lines: list[str] = []
    for k, raw in enumerate([*spoil(whole, 3, bits=1), b"", b"\x00" * 4000]):
        path = tmp_path / f"{k}.tlog"
        path.write_bytes(raw)
        for kind in ("imu", "gnss"):
            try:
                rows = formats.read("tlog", path, kind, None)
            except ConfigError as error:
                lines.append(str(error))
            else:
                assert_allclose(rows.t, np.clip(rows.t, 9.9, 18.1))
    assert not [line for line in lines if "\n" in line or ".tlog: " not in line]
