"""Logs of an IMU and a magnetometer alone: attitude, with a reference or without."""

from __future__ import annotations

import numpy as np
import pytest

import bench
from bench.cli.command_line import main
from bench.core.mathematics import rotation
from bench.core.words.exceptions import ConfigError, EstimatorError
from bench.io.results.result_folder import load_solution
from bench.simulation import sensors
from bench.views.report import page
from tests.builders import at_rest
from tests.navigation.test_ahrs import COMPASS, LLA, on_board
from tests.weaving import DEG

LOG = """
title = "On a table"
{place}
date = 2025-07-01
[imu]
file = "imu.csv"
[mag]
file = "mag.csv"
[sensors.assumed]
imu = "adis16475"
mag = "hmc5883l"
"""
PLACE = "place = [47.0, 11.0, 500.0]"
REFERENCE = '[reference]\nfile = "ref.csv"\n'
Q_NB = rotation.from_euler(3 * DEG, -5 * DEG, 0.7)


def write(path, header, *columns):
    np.savetxt(path, np.column_stack(columns), delimiter=",", header=header, comments="")


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Ninety seconds at rest, tilted."""
    place = tmp_path_factory.mktemp("table")
    truth = at_rest(90.0, 50.0, LLA, 3 * DEG, -5 * DEG, 0.7)
    data = sensors.sense(truth, on_board(mag=COMPASS), 7, 0).data
    names = [f"{of}_{axis}_{unit}" for of, unit in (("gyro", "rad_s"), ("accel", "m_s2")) for axis in "xyz"]
    write(
        place / "imu.csv", ",".join(["t_s", *names]), data.imu.t, data.imu.dtheta_b * 50, data.imu.dvel_b * 50
    )
    field = "t_s,field_x_ut,field_y_ut,field_z_ut"
    write(place / "mag.csv", field, data.mag.t, data.mag.field_b * 1e6)
    t = np.arange(0.0, 90.0, 0.2)
    rows = np.tile([*np.rad2deg(LLA[:2]), LLA[2], 3.0, -5.0, np.rad2deg(0.7)], (len(t), 1))
    write(place / "ref.csv", "t_s,lat_deg,lon_deg,alt_m,roll_deg,pitch_deg,heading_deg", t, rows)
    return place


def log(folder, name, *tables, place=PLACE):
    path = folder / f"{name}.toml"
    path.write_text(LOG.format(place=place) + "".join(tables))
    return path


def test_without_a_reference_the_innovations_alone_evaluate(folder):
    """By default the filter is ahrs; it levels at rest, and the magnetometer gives the heading."""
    result = bench.navigate(log(folder, "alone"))
    solution = result.solutions["ahrs"]
    assert result.records["sensed"].data.fixes is None
    found = rotation.multiply(solution.q_nb[-1], rotation.conjugate(Q_NB))
    assert np.linalg.norm(rotation.to_rotvec(found)) < 2.0 * DEG
    assert np.isnan(solution.lla).all()
    metrics = result.metrics["ahrs"]
    assert "tilt_rmse_deg" not in metrics
    assert metrics["nis_mean_magnetometer"] > 0


def test_a_reference_evaluates_tilt_and_heading(folder):
    metrics = bench.navigate(log(folder, "judged", REFERENCE)).metrics["ahrs"]
    assert 0 < metrics["tilt_rmse_deg"] < 1.0
    assert metrics["heading_rmse_deg"] < 2.0
    assert metrics["nees_states"] == 3
    assert metrics["nees_mean"] > 0


def test_a_heading_that_the_log_does_not_tell_is_no_divergence(folder):
    """Without a magnetometer any heading is as good; the filter says so by its sigma."""
    rows = np.loadtxt(folder / "ref.csv", delimiter=",", skiprows=1)
    for further in (-150.0, 0.0, 150.0):
        head = "t_s,roll_deg,pitch_deg,heading_deg"
        write(folder / "far.csv", head, rows[:, [0, 4, 5, 6]] + [0, 0, 0, further])
        path = log(folder, "far", REFERENCE.replace("ref.csv", "far.csv"))
        text = path.read_text().replace('[mag]\nfile = "mag.csv"\n', "")
        path.write_text(text.replace('mag = "hmc5883l"', ""))
        metrics = bench.navigate(path).metrics["ahrs"]
        assert metrics["converged"], metrics["reason"]
        assert metrics["verdict"] != "diverged"
        assert metrics["tilt_rmse_deg"] < 1.0


def test_a_reference_needs_no_position(folder):
    """Angles alone, as a motion capture has them, give the same figures; without angles nothing is left."""
    rows = np.loadtxt(folder / "ref.csv", delimiter=",", skiprows=1)
    write(folder / "angles.csv", "t_s,roll_deg,pitch_deg,heading_deg", rows[:, [0, 4, 5, 6]])
    write(folder / "times.csv", "t_s,sd_roll_deg", rows[:, [0, 4]])
    angles, whole = (
        bench.navigate(log(folder, "judged", REFERENCE.replace("ref.csv", name))).metrics["ahrs"]
        for name in ("angles.csv", "ref.csv")
    )
    assert angles["reference_epochs"] == whole["reference_epochs"] > 400
    for name in ("tilt_rmse_deg", "heading_rmse_deg"):
        assert angles[name] == pytest.approx(whole[name], rel=1e-9)
    rows[:, 6] = np.nan
    write(folder / "angles.csv", "t_s,roll_deg,pitch_deg,heading_deg", rows[:, [0, 4, 5, 6]])
    with pytest.raises(
        ConfigError, match=r"angles\.csv: no row has all angles \(roll_deg, pitch_deg, heading"
    ):
        bench.read_log(log(folder, "judged", REFERENCE.replace("ref.csv", "angles.csv")))
    with pytest.raises(ConfigError, match=r"times\.csv: no columns for attitude \(roll_deg, .* or position"):
        bench.read_log(log(folder, "judged", REFERENCE.replace("ref.csv", "times.csv")))


@pytest.fixture(scope="module")
def turned(tmp_path_factory):
    """An IMU of 2000 deg/s that is turned by hand, for a minute, at up to 300 deg/s about x."""
    place = tmp_path_factory.mktemp("turned")
    t = np.arange(1, 6001) / 100.0
    begun = np.clip(t - 40.0, 0.0, None)
    roll = 1.0 * np.sin(5.2 * begun) * (begun < 2 * np.pi / 5.2 * 3)
    rate = np.gradient(roll, t)
    force = np.column_stack([0 * t, -np.sin(roll), -np.cos(roll)]) * 9.80665
    noise = np.random.default_rng(2).normal(size=(2, 6000, 3)) * [[[3e-4]], [[0.01]]]
    names = [f"{of}_{axis}_{unit}" for of, unit in (("gyro", "rad_s"), ("accel", "m_s2")) for axis in "xyz"]
    gyro = np.column_stack([rate, 0 * t, 0 * t]) + noise[0]
    write(place / "imu.csv", ",".join(["t_s", *names]), t, gyro, force + noise[1])
    text = LOG.format(place=PLACE).replace('mag = "hmc5883l"', "")
    text = text.replace('[mag]\nfile = "mag.csv"\n', "")
    (place / "log.toml").write_text(
        text + '[alignment]\nkind = "level"\nduration_s = 30.0\n[evaluation]\nfrom_s = 31.0\n'
    )
    return place


def test_a_record_beyond_the_range_of_the_assumed_imu_is_used_and_said(turned):
    """The range of the ADIS16475-1 is 125 deg/s. Its samples beyond are not lost: the roll comes back."""
    read = bench.read_log(turned / "log.toml")
    (found,) = [one for one in read.checks if one.name == "imu_range"]
    assert not found.good
    assert found.text.startswith("imu: not the assumed adis16475: gyro up to 29")
    said = "beyond the 125 deg/s of the datasheet, which is not used; name your IMU in [sensors.assumed]"
    assert found.text.endswith(said)
    assert (read.spec.assumed.imu.gyro.range, read.spec.assumed.imu.accel.range > 0) == (0.0, True)
    solution = bench.navigate(read).solutions["ahrs"]
    roll = np.rad2deg(rotation.to_euler(solution.q_nb)[0])
    assert np.abs(roll[solution.t > 45.0]).max() < 2.0
    assert np.nanmax(roll) > 50.0
    fits = bench.read_log(turned / "log.toml", overrides={"sensors.assumed.imu": "icm-42688-p"})
    assert [one.name for one in fits.checks if one.name == "imu_range"] == []
    assert fits.spec.assumed.imu.gyro.range > 0


def test_a_slow_reference_is_compared_at_its_own_rows(turned):
    """Between its rows, 1 s apart, the roll goes to 57 deg and back, so no line connects them."""
    (turned / "judged.toml").write_text((turned / "log.toml").read_text() + REFERENCE)
    t = np.arange(0.0, 60.0, 0.2)
    begun = np.clip(t - 40.0, 0.0, None)
    roll = np.rad2deg(np.sin(5.2 * begun) * (begun < 2 * np.pi / 5.2 * 3))
    for every, epochs in ((1, 140), (5, 28)):
        rows = np.column_stack([t, roll, 0 * t, 0 * t])[::every]
        write(turned / "ref.csv", "t_s,roll_deg,pitch_deg,heading_deg", rows)
        metrics = bench.navigate(turned / "judged.toml").metrics["ahrs"]
        assert metrics["tilt_rmse_deg"] < 1.5
        assert epochs <= metrics["reference_epochs"] <= 2.2 * epochs


def test_the_turn_of_missing_increments_is_bridged_as_that_of_rates(tmp_path):
    """At 0.2 rad/s for 60 s, with every fiftieth row missing: 12 rad from increments as from rates."""
    t = np.arange(1, 6001) / 100.0
    kept = np.arange(6000) % 50 != 25
    for names, scale in (("gyro_{}_rad_s accel_{}_m_s2", 1.0), ("dtheta_{}_rad dvel_{}_mps", 0.01)):
        heads = ["t_s", *(name.format(axis) for name in names.split() for axis in "xyz")]
        turn = np.full((6000, 3), [0.0, 0.0, 0.2 * scale])
        push = np.full((6000, 3), [0.0, 0.0, -9.8 * scale])
        write(tmp_path / "imu.csv", ",".join(heads), np.column_stack([t, turn, push])[kept])
        text = LOG.format(place=PLACE).replace('mag = "hmc5883l"', "")
        (tmp_path / "log.toml").write_text(text.replace('[mag]\nfile = "mag.csv"\n', ""))
        imu = bench.read_log(tmp_path / "log.toml").records.imu
        assert np.abs(imu.dtheta_b.sum(axis=0) - [0, 0, 12.0]) == pytest.approx(0.0, abs=0.01)
        assert imu.dvel_b[:, 2] / imu.dt == pytest.approx(-9.8, rel=1e-9)


def test_four_damaged_samples_are_no_other_imu(turned, tmp_path):
    for name in ("imu.csv", "log.toml"):
        (tmp_path / name).write_text((turned / name).read_text())
    rows = np.loadtxt(tmp_path / "imu.csv", delimiter=",", skiprows=1)[:3500]
    rows[[100, 900, 1700, 2500], 1] = 50.0
    head = (tmp_path / "imu.csv").read_text().splitlines()[0]
    write(tmp_path / "imu.csv", head, rows)
    read = bench.read_log(tmp_path / "log.toml")
    assert [one.name for one in read.checks if one.name == "imu_range"] == []
    assert read.spec.assumed.imu.gyro.range > 0


def test_the_report_shows_the_attitude_and_the_assumed_imu(turned):
    result = bench.navigate(turned / "log.toml")
    html = page.make_page("turned", result)
    for shown in ("Roll and pitch [deg]", "Heading [deg]", "gyro bias x", "NIS of gravity", "IMU: adis16475"):
        assert shown in html
    assert "a log without receiver and reference" in html
    assert "There is no track to draw." in html
    assert "fixes that were kept" not in html
    assert "Altitude [m]" not in html


def test_a_filter_that_needs_fixes_is_refused_in_a_line(folder):
    with pytest.raises(EstimatorError, match=r"filter 'loose-15' needs a gnss; there is none in alone\.toml"):
        bench.read_log(log(folder, "alone"), estimators=["loose-15"])


@pytest.mark.parametrize(
    ("place", "tables", "message"),
    [
        ("", "", r"\[gnss\] is missing: for filters without fixes, such as 'ahrs', give place = \[lat"),
        (
            PLACE,
            '[alignment]\nkind = "course"\n',
            r"without \[gnss\]: kind 'level' or 'given' .*not 'course'",
        ),
        ("place = [97.0, 11.0, 500.0]", "", r"place = \[97, 11, 500\] must be latitude, longitude"),
    ],
)
def test_what_is_missing_or_wrong_is_said(folder, place, tables, message):
    with pytest.raises(ConfigError, match=message):
        bench.read_log(log(folder, "wrong", tables, place=place))


def test_a_place_beside_a_receiver_has_no_effect(folder):
    (folder / "fix.csv").write_text("t_s,lat_deg,lon_deg,alt_m\n1,47,11,500\n2,47,11,500\n")
    receiver = '[gnss]\nfile = "fix.csv"\n'
    path = log(folder, "both", receiver)
    path.write_text(path.read_text().replace("[sensors.assumed]", '[sensors.assumed]\ngnss = "l1-code"'))
    with pytest.raises(ConfigError, match=r"place has no effect with \[gnss\]"):
        bench.read_log(path)


def test_nothing_can_be_lost_or_withheld_without_a_receiver(folder, capsys):
    alone = log(folder, "alone")
    assert main(["navigate", str(alone), "--outages", "10", "-o", str(folder / "out")]) == 2
    assert "--outages: without [gnss] there is nothing to lose" in " ".join(capsys.readouterr().err.split())
    assert not (folder / "out").exists()
    held = log(folder, "held", "[evaluation]\nwithhold = 5\n")
    with pytest.raises(ConfigError, match=r"withhold has no effect without \[gnss\]"):
        bench.read_log(held)


def test_a_table_of_an_imu_alone_is_navigated(folder, tmp_path, capsys):
    """Its place is unknown: a line of the log asks for it. A table beside it named like fixes is an error."""
    (tmp_path / "imu.csv").write_text((folder / "imu.csv").read_text())
    (tmp_path / "fixes_gnss.csv").write_text("a,b\n1,2\n")
    assert main(["navigate", str(tmp_path / "imu.csv"), "-o", str(tmp_path / "out")]) == 2
    said = capsys.readouterr().err
    assert "no columns found for gnss" in said
    assert "but fixes_gnss of fixes_gnss.csv looks like one" in said
    (tmp_path / "fixes_gnss.csv").unlink()
    text = (
        (folder / "imu.csv").read_text().replace("gyro_", "angular_velocity_").replace("t_s", "gps_time_s", 1)
    )
    (tmp_path / "imu.csv").write_text(text)  # names of the IMU that have words of a receiver
    assert main(["navigate", str(tmp_path / "imu.csv"), "-o", str(tmp_path / "out"), "--no-report"]) == 0
    said = capsys.readouterr().out
    assert "No columns of a GNSS receiver: only attitude is estimated." in said
    assert "ahrs" in said
    assert "place = [45.0, 0.0, 0.0]  # where was it?" in (tmp_path / "imu.toml").read_text()
    solution = load_solution(tmp_path / "out", "ahrs")
    roll, pitch, _ = np.rad2deg(rotation.to_euler(solution.q_nb[-1]))
    assert abs(roll - 3.0) < 0.5
    assert abs(pitch + 5.0) < 0.5


def test_a_recording_too_short_to_start_says_its_length_and_leaves_nothing(folder, tmp_path, capsys):
    lines = (folder / "imu.csv").read_text().splitlines(keepends=True)
    (tmp_path / "five.csv").write_text("".join(lines[:6]))
    assert main(["navigate", str(tmp_path / "five.csv")]) == 2
    said = capsys.readouterr().err
    assert "five: the recording is 0.0" in said
    assert "s long; a start at rest needs 10 s" in said
    assert [path.name for path in tmp_path.iterdir()] == ["five.csv"]
