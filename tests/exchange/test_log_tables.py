"""Tables of a log as people have them: an export of the bench, fixes held at a high rate, names by key."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from scipy.io import savemat

import bench
from bench.core.records.data import ImuData
from bench.core.records.instruments import INSTRUMENTS
from bench.core.words.exceptions import ConfigError
from bench.experiments.baselines.baseline_draws import open_experiment
from bench.io.config.log import load_log
from bench.io.config.log_tables import LogAssumedTable, LogTable
from bench.io.logs.log_records import divide_intervals, read_records
from bench.io.logs.rows import INSTRUMENT_ROWS
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
    assert_array_equal(found.instruments["baro"].sd, data.baro.sd)
    assert_array_equal(found.instruments["baro"].alt_baro, data.baro.alt_baro)


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
    assert [note for note in found.notes if "most rows repeat a fix or have none" in note]


@pytest.mark.parametrize("nothing", [np.nan, 0.0, None])
def test_rows_without_a_fix_between_those_with_one_are_left_out(tmp_path, nothing):
    """Empty or zeros at the rate of the IMU, with velocities at each row; None: the position is held."""
    path = drives.write_log(tmp_path)
    made = drives.sensed()
    t, columns = made["imu"]["t"], drives.gnss_columns(made["gnss"])
    held = np.searchsorted(columns["t_s"], t + 1e-9, "right") - 1
    new = (np.diff(held, prepend=-1) != 0) & (held >= 0)
    rows = {name: values[np.maximum(held, 0)] for name, values in columns.items()}
    for name in ("lat_deg", "lon_deg", "alt_m"):
        rows[name] = np.where(new if nothing is not None else held >= 0, rows[name], nothing or 0.0)
    for name in ("vel_n_mps", "vel_e_mps", "vel_d_mps"):
        rows[name] = np.interp(t, columns["t_s"], columns[name])
    whole = read_records(load_log(str(path)))
    drives.write_csv(tmp_path / "gnss.csv", rows | {"t_s": t})
    found = read_records(load_log(str(path)))
    assert_allclose(found.fixes.t, whole.fixes.t, atol=1e-9)
    assert_allclose(found.fixes.lla, whole.fixes.lla)
    assert found.fixes.valid.all()
    assert [f"the {len(whole.fixes)} of {len(t)} that are new" in note for note in found.notes] == [True]


def test_rows_of_a_receiver_among_those_of_the_imu_take_no_time_from_it(tmp_path):
    """A table of both, in the order of time; a row that the IMU missed stays one."""
    path = drives.write_log(tmp_path)
    imu, gnss = (make(drives.sensed()[kind]) for kind, make in MAKERS.items())
    for name in list(imu)[1:]:
        imu[name][7005] = np.nan
    gnss["t_s"] = gnss["t_s"] + 0.003
    t = np.concatenate([imu.pop("t_s"), gnss.pop("t_s")])
    order = np.argsort(t)
    both = {name: np.append(values, np.full(len(t) - len(values), np.nan)) for name, values in imu.items()}
    both |= {name: np.append(np.full(len(t) - len(values), np.nan), values) for name, values in gnss.items()}
    whole = read_records(load_log(str(path)))
    drives.write_csv(tmp_path / "all.csv", {name: rows[order] for name, rows in ({"t_s": t} | both).items()})
    path.write_text(path.read_text().replace("imu.csv", "all.csv").replace("gnss.csv", "all.csv"))
    found = read_records(load_log(str(path)))
    assert_allclose(found.imu.t, whole.imu.t)
    assert_allclose(found.imu.dt, whole.imu.dt)
    assert_array_equal(np.flatnonzero(~found.imu.valid), [7005])
    assert_allclose(found.fixes.lla, whole.fixes.lla)
    assert ["750 rows in the table of the IMU" in note for note in found.notes].count(True) == 1


MAKERS = {"imu": drives.imu_columns, "gnss": drives.gnss_columns}


def write_structures(folder, *units):
    """Write a MATLAB file with structures of NaveGo within structures; return the drive they were made of."""
    made = drives.sensed()
    imu, gnss = made["imu"], made["gnss"]
    unit = {"t": imu["t"], "wb": imu["gyro"], "fb": imu["accel"]}
    lat, lon, h = gnss["lla"].T
    fixes = {"t": gnss["t"], "lat": lat, "lon": lon, "h": h, "vel": gnss["vel_n"]}
    flight = {"gnss1": fixes, **dict.fromkeys(units, unit)}
    savemat(folder / "all.mat", {"flight": flight, "spare": {"imu2": unit}}, oned_as="column")
    return made


COLUMNS = {"t_s": "t"}
COLUMNS |= {f"gyro_{axis}_rad_s": f"wb.{k}" for k, axis in enumerate("xyz", 1)}
COLUMNS |= {f"accel_{axis}_m_s2": f"fb.{k}" for k, axis in enumerate("xyz", 1)}
"""The columns of a table -> their names in a structure."""


@pytest.mark.parametrize(
    "told", ['topic = "imu1"', 'topic = "flight.imu1"', "table", "table by topic", "top of the log"]
)
def test_structures_in_structures_are_named_by_key(tmp_path, told):
    """NaveGo's structure by its own or its whole name, by columns of a table, and at the top of the log.

    Columns count as they are named: here its rates are called degrees."""
    path = drives.write_log(tmp_path)
    plain = read_records(load_log(str(path)))
    write_structures(tmp_path, "imu1", "imu2")
    inside = "" if told == "table by topic" else "flight.imu1."
    listed = ", ".join(f'{ours} = "{inside}{theirs}"' for ours, theirs in COLUMNS.items())
    told = {
        "table": f"columns = {{ {listed} }}",
        "table by topic": f'topic = "imu1"\ncolumns = {{ {listed.replace("rad_s", "deg_s")} }}',
    }.get(told, told)
    if told == "top of the log":
        text = f'file = "all.mat"\nimu = "imu1"\n[gnss]\ntopic = "gnss1"\n{SHEETS}'
    else:
        text = drives.LOG.replace('file = "imu.csv"', f'file = "all.mat"\n{told}')
    path.write_text(text)
    found = read_records(load_log(str(path)))
    unit = np.deg2rad(1.0) if "deg_s" in told else 1.0
    assert_allclose(found.imu.dtheta_b, unit * plain.imu.dtheta_b, atol=1e-11)
    assert_allclose(found.imu.dvel_b, plain.imu.dvel_b, atol=1e-10)
    assert_allclose(found.fixes.lla, plain.fixes.lla, atol=1e-11)


def test_a_log_with_one_file_at_its_top_is_changed_and_checked_like_another(tmp_path):
    """Another file or name by --set, and a baseline of it by `bench check`."""
    drives.write_log(tmp_path)
    write_structures(tmp_path, "imu1", "imu2")
    path = tmp_path / "log.toml"
    path.write_text(f'file = "none.mat"\nimu = "imu1"\ngnss = "gnss1"\n{SHEETS}')
    given = {"file": str(tmp_path / "all.mat"), "imu": "flight.imu2", "gnss.topic": "flight.gnss1"}
    log = load_log(str(path), overrides=given)
    assert {log.imu.path, log.gnss.path} == {tmp_path / "all.mat"}
    assert (log.imu.topic, log.gnss.topic) == ("flight.imu2", "flight.gnss1")
    path.write_text(path.read_text().replace("none.mat", "all.mat"))
    assert open_experiment(str(path)).labels == ["loose-15"]


def test_a_structure_that_is_not_there_or_not_alone_is_said_with_those_that_are(tmp_path):
    write_structures(tmp_path, "imu1", "imu2")
    path = tmp_path / "log.toml"
    for name, said in (
        ("imu3", "no structure 'imu3'; there are flight.gnss1, flight.imu1, flight.imu2, spare.imu2"),
        ("imu2", "more than one structure 'imu2': flight.imu2, spare.imu2; name one in full"),
    ):
        path.write_text(f'file = "all.mat"\nimu = "{name}"\ngnss = "gnss1"\n{SHEETS}')
        with pytest.raises(ConfigError) as caught:
            read_records(load_log(str(path)))
        assert list(caught.value.messages) == [f"all.mat: {said}"]
    path.write_text(f'imu = "imu1"\ngnss = "gnss1"\n{SHEETS}')
    with pytest.raises(ConfigError, match="imu = 'imu1' is a name in a file; say file = "):
        load_log(str(path))
    for tables in ("", '[imu]\nfile = "imu.csv"\n'):
        path.write_text(f'file = "all.mat"\n{tables}{SHEETS}')
        with pytest.raises(ConfigError, match="file at the top is for the sensors in that file, and none"):
            load_log(str(path))


def test_every_instrument_has_columns_and_a_table_in_a_log():
    """An instrument that is added is one that a log may have."""
    assert set(INSTRUMENT_ROWS) == set(INSTRUMENTS)
    assert set(INSTRUMENTS) <= set(LogTable.model_fields) & set(LogAssumedTable.model_fields)
    for name, row in INSTRUMENTS.items():
        values = {group: len(columns[0]) for group, columns in INSTRUMENT_ROWS[name].items()}
        assert row.width in values.values()


def test_an_interval_divided_at_a_fix_keeps_its_increments_and_its_rates():
    random = np.random.default_rng(3)
    t = np.array([0.01, 0.02, 0.03, 0.03, 0.025, 0.08, 0.09])  # one repeated, one going back, one gap
    imu = ImuData(
        t, np.full(7, 0.01), np.ones(7, bool), random.normal(size=(7, 3)), random.normal(size=(7, 3))
    )
    cuts = np.array([0.0125, 0.0175, 0.02, 0.05, 0.0825, 0.2, 0.0825])
    found = divide_intervals(imu, cuts)
    assert_allclose(found.t, [0.01, 0.0125, 0.0175, 0.02, 0.03, 0.03, 0.025, 0.08, 0.0825, 0.09])
    assert_allclose(
        found.dt, [0.01, 0.0025, 0.005, 0.0025, 0.01, 0.01, 0.01, 0.01, 0.0025, 0.0075], atol=1e-15
    )
    assert_allclose(found.dtheta_b.sum(axis=0), imu.dtheta_b.sum(axis=0), rtol=1e-14)
    assert_allclose(
        found.dvel_b[1:4] / found.dt[1:4, None], np.tile(imu.dvel_b[1] / 0.01, (3, 1)), rtol=1e-12
    )
