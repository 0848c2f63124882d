"""Tables of a log as people have them: an export of the bench, fixes held at a high rate, names by key."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from scipy.io import savemat

import bench
from bench.config.log import load_log
from bench.exchange.log_records import read_records
from tests.exchange import drives
from tests.exchange.exported import INVALID, make_run

SHEETS = """
[sensors.assumed]
imu = "adis16475"
gnss = "l1-code"
"""


def test_an_export_of_the_bench_is_read_whole(tmp_path):
    """Increments and their intervals, flags, arrivals and covariances are those of the run."""
    _, sensed = make_run(tmp_path / "run")
    bench.export_run(tmp_path / "run", "csv", out=tmp_path / "out")
    log = '[imu]\nfile = "out/imu.csv"\n[gnss]\nfile = "out/gnss.csv"\n[baro]\nfile = "out/baro.csv"\n'
    (tmp_path / "log.toml").write_text(f'{log}{SHEETS}baro = "bmp388"\n')
    found = read_records(load_log(str(tmp_path / "log.toml")))
    data, origin = sensed.data, sensed.data.imu.t[0]
    assert (found.notes, found.reported) == ((), "standard deviation")
    assert_array_equal(found.imu.dt, data.imu.dt)
    assert_array_equal(found.imu.dtheta_b, data.imu.dtheta_b)
    assert_array_equal(np.flatnonzero(~found.fixes.valid), [INVALID])
    assert_allclose(found.fixes.t_arrival, data.fixes.t_arrival - origin, atol=1e-9)
    assert_allclose(found.fixes.cov_pos_n, data.fixes.cov_pos_n)
    assert_allclose(found.fixes.cov_vel_n, data.fixes.cov_vel_n)
    assert_array_equal(found.baro.sd, data.baro.sd)
    assert_array_equal(found.baro.alt_baro, data.baro.alt_baro)


def test_fixes_repeated_at_the_rate_of_the_imu_are_thinned_and_that_is_said(tmp_path):
    path = drives.write_log(tmp_path)
    made = drives.sensed()
    columns = drives.gnss_columns(made["gnss"])
    t = made["imu"]["t"]
    held = np.searchsorted(columns["t_s"], t + 1e-9, "right") - 1
    whole = read_records(load_log(str(path)))
    repeated = {name: values[held[held >= 0]] for name, values in columns.items()}
    drives.write_csv(tmp_path / "gnss.csv", repeated | {"t_s": t[held >= 0]})
    found = read_records(load_log(str(path)))
    assert_allclose(found.fixes.t, whole.fixes.t, atol=1e-9)
    assert_allclose(found.fixes.lla, whole.fixes.lla)
    assert [note for note in found.notes if "most rows repeat the fix before them" in note]


@pytest.mark.parametrize(("form", "more"), [("table", "columns"), ("navego", "topic")])
def test_structures_in_structures_are_named_by_key(tmp_path, form, more):
    """A table names a field with dots and a column of a matrix by its number, from 1; NaveGo a structure."""
    path = drives.write_log(tmp_path)
    imu = drives.sensed()["imu"]
    unit = {"t": imu["t"], "wb": imu["gyro"], "fb": imu["accel"]}
    savemat(tmp_path / "all.mat", {"flight": {"imu1": unit, "imu2": {"t": np.zeros(3)}}})
    names = {"t_s": "t"} | {f"gyro_{a}_rad_s": f"wb.{k}" for k, a in enumerate("xyz", 1)}
    names |= {f"accel_{a}_m_s2": f"fb.{k}" for k, a in enumerate("xyz", 1)}
    listed = ", ".join(f'{ours} = "flight.imu1.{theirs}"' for ours, theirs in names.items())
    told = {"columns": f"columns = {{ {listed} }}", "topic": 'topic = "flight.imu1"'}[more]
    plain = read_records(load_log(str(path)))
    path.write_text(drives.LOG.replace('file = "imu.csv"', f'file = "all.mat"\nformat = "{form}"\n{told}'))
    found = read_records(load_log(str(path)))
    assert_allclose(found.imu.dtheta_b, plain.imu.dtheta_b, atol=1e-11)
    assert_allclose(found.imu.dvel_b, plain.imu.dvel_b, atol=1e-10)
