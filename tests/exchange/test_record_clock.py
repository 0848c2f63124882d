"""A clock that goes back: seconds of a week go on at its end; rows that other clocks lose are counted."""

from datetime import datetime

import numpy as np
import pytest
from numpy.testing import assert_allclose

from bench.cli.command_line import main
from bench.core.words.exceptions import ConfigError
from bench.evaluation.motion.validity import check_recording
from bench.io.config.log import load_log
from bench.io.logs.log_records import read_records
from bench.io.logs.record_clock import find_week, meet_week, unwrap_week
from bench.io.logs.rows import LogRows
from bench.pipeline import log_pipeline
from tests.exchange import drives

WEEK = 604800.0


@pytest.fixture
def drive(tmp_path):
    """The drive of the tests, its rows until 50 s; a function writes it with other times."""
    drives.write_log(tmp_path)
    made = drives.sensed()
    made = {
        kind: {key: column[made[kind]["t"] < 50.0] for key, column in made[kind].items()} for kind in made
    }

    def write(change_imu, change_gnss=None, gnss_rows=slice(None)):
        imu, gnss = made["imu"], {key: column[gnss_rows] for key, column in made["gnss"].items()}
        imu = {**imu, "t": change_imu(imu["t"])}
        gnss = {**gnss, "t": (change_gnss or change_imu)(gnss["t"])}
        drives.write_csv(tmp_path / "imu.csv", drives.imu_columns(imu))
        drives.write_csv(tmp_path / "gnss.csv", drives.gnss_columns(gnss))
        return tmp_path / "drive.toml"

    return write


def test_seconds_of_a_week_go_on_where_it_ends(drive, capsys, monkeypatch):
    plain = read_records(load_log(str(drive(lambda t: t))))
    path = drive(lambda t: to_week(t, 30.0))
    found = read_records(load_log(str(path)))
    assert found.week_ends
    assert not plain.week_ends
    assert_allclose(found.imu.t, plain.imu.t, atol=1e-6)
    assert_allclose(found.fixes.t, plain.fixes.t, atol=1e-6)
    assert "imu.csv: seconds of a week that ends before row 3000; times go on there" in found.notes

    def stop(*_, **__):
        raise ConfigError("that is enough")

    monkeypatch.setattr(log_pipeline, "navigate", stop)
    assert main(["navigate", str(path), "-o", str(path.parent / "out")]) == 2
    said = " ".join(capsys.readouterr().out.split())
    assert "t = 0 is 604770.01 s on the clock of the files, seconds of a week that ends in them" in said


def to_week(t, end):
    """Return seconds of a week that ends at a time [s]."""
    return (t + WEEK - end) % WEEK


def test_a_receiver_may_begin_after_the_end_of_a_week(drive):
    path = drive(lambda t: to_week(t, 30.0), gnss_rows=slice(149, None))
    fixes = read_records(load_log(str(path))).fixes
    assert fixes.t[0] == pytest.approx(29.99)
    assert (np.diff(fixes.t) > 0).all()


def test_a_receiver_may_begin_in_the_week_before_that_of_the_imu(drive):
    path = drive(lambda t: t, lambda t: to_week(t, 5.0))
    fixes = read_records(load_log(str(path))).fixes
    assert fixes.t[0] == pytest.approx(-4.81)
    assert (np.diff(fixes.t) > 0).all()
    path = drive(lambda t: t + 1.0, lambda t: to_week(t, 5.0), slice(0, 2))
    with pytest.raises(ConfigError, match="do not overlap"):  # it ends before the IMU begins
        read_records(load_log(str(path)))


def test_a_late_row_at_the_end_of_a_week_is_not_another_week():
    t = np.array([604799.7, 604799.9, 0.0, 604799.8, 0.1, 604799.95, 0.2])
    rows = unwrap_week(LogRows(t, {"arrival": t + 0.03}), "a.csv")
    assert_allclose(rows.t, t + WEEK * (t < 1.0))
    assert_allclose(rows.values["arrival"], t + 0.03 + WEEK * (t < 1.0))
    for other in (t - 1.0, t + 1.0, t[:2], t / 2.0, np.empty(0)):  # of no week, of one, or of another clock
        rows = LogRows(other, {})
        assert unwrap_week(rows, "a.csv") is rows


@pytest.mark.parametrize(
    ("t", "week"),
    [
        ([5.0, 300.0], WEEK),
        ([604790.0, 604799.0], 0.0),
        ([1e6, 2e6], 0.0),
        ([-5.0, 300.0], 0.0),  # no second of a week
        ([604600.0, 604900.0], 0.0),
        ([2e5, 3e5], 0.0),
    ],
)
def test_the_week_of_other_rows_is_that_in_which_they_meet_the_imu(t, week):
    assert find_week(np.array(t), 604700.0, 605100.0) == week


def restart(at):
    """Return times of a recorder that begins anew."""
    return lambda t: np.where(t < at, t, t - at)


def test_rows_that_are_lost_are_counted(drive):
    """From 20 s on the clock begins anew: the rows of 20 s come to times that are there already."""
    path = drive(restart(20.0))
    spec = load_log(str(path))
    records = read_records(spec)
    found = check_recording(records.imu, records.fixes, {}, drives.ARM)
    (lost,) = (check for check in found if check.name == "imu_unordered_rows")
    newest = np.maximum.accumulate(records.imu.t)
    assert lost.value == np.sum(records.imu.t[1:] <= newest[:-1]) == 2000
    assert "imu: 2000 of 4999 rows repeat a time or go back and are left out, first row 2000" in lost.text


def test_a_record_of_which_most_is_lost_is_refused(drive, capsys):
    path = drive(lambda t: restart(20.0)(t) + 900.0 * (t < 20.0))
    assert main(["navigate", str(path), "-o", str(path.parent / "out")]) == 2
    said = " ".join(capsys.readouterr().err.split())
    assert (
        "imu.csv: row 2000: the clock goes back from 919.99 to 0 s, and 3000 of 4999 rows are earlier than"
        in said
    )
    assert "give each part of the file a log of its own" in said


@pytest.mark.parametrize(("year", "ahead"), [(1995, 10), (2011, 15), (2026, 18)])
def test_fixes_in_gps_time_meet_an_imu_that_counts_from_1970(year, ahead):
    gps = (datetime(year, 3, 1) - datetime(1980, 1, 6)).total_seconds()
    unix = (datetime(year, 3, 1) - datetime(1970, 1, 1)).total_seconds()
    rows = LogRows(np.array([gps + 2.0, gps + 90.0]) + ahead, {})
    assert_allclose(meet_week(rows, unix, unix + 100.0).t, [unix + 2.0, unix + 90.0])
    assert meet_week(rows, unix + 1e6, unix + 1e6 + 100.0) is rows
    assert meet_week(rows, gps, gps + 200.0) is rows
