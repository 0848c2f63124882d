"""A recording somebody made: read as it is, checked against itself, navigated, evaluated by withheld fixes.

The recording is that of `tests/exchange/drives.py`, whose truth and errors are known.
"""

from __future__ import annotations

import json
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pyarrow as pa
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from pyarrow import parquet
from scipy.io import savemat
from scipy.stats import chi2

import bench
from bench.cli.command_line import main
from bench.core.mathematics import rotation
from bench.core.mathematics.earth import difference_n
from bench.core.records.data import ImuData
from bench.core.words.exceptions import ConfigError
from bench.evaluation.errors.fixes import measure_by_fixes
from bench.evaluation.linear.drift_laws import drift_sd
from bench.evaluation.motion import validity
from bench.io import results
from bench.io.config.log import load_log
from bench.io.logs.log_records import read_records
from bench.io.logs.log_start import find_start
from bench.navigation import built_in, estimator
from bench.navigation.models.loose_tight import Loose
from bench.pipeline.log_pipeline import Session, read_log
from bench.views.recording import column
from tests.exchange import drives

LOGS = Path(__file__).parents[1] / "logs"


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    path = tmp_path_factory.mktemp("drive")
    drives.write_log(path)
    return path


def checks(path):
    spec = load_log(str(path))
    recorded = read_records(spec)
    found = validity.check_recording(
        recorded.imu, recorded.fixes, recorded.instruments, np.array(spec.antenna_b)
    )
    return {c.name: c for c in found}


def rewritten(folder, tmp_path, *changes: tuple[str, str]) -> Path:
    """A copy of a log, its text changed; the tables stay where they are."""
    text = drives.LOG
    for name in ("imu.csv", "gnss.csv", "imu.toml", "gnss.toml", "baro.csv", "baro.toml"):
        (tmp_path / name).symlink_to(folder / name)
    for old, new in changes:
        assert old in text
        text = text.replace(old, new)
    path = tmp_path / "drive.toml"
    path.write_text(text)
    return path


def test_a_log_that_does_not_fit_into_the_memory_is_refused_before_it_is_read(folder, tmp_path):
    """3 GB hold 2.7 million rows; the file has 3 million."""
    rows = np.zeros(3_000_000)
    names = ("t_s", *drives.imu_columns(drives.sensed()["imu"]))
    parquet.write_table(pa.table(dict.fromkeys(names, rows)), tmp_path / "imu.parquet")
    log = rewritten(folder, tmp_path, ('"imu.csv"', '"imu.parquet"'))
    code = (
        "import resource, sys; resource.setrlimit(resource.RLIMIT_AS, (3 * 10**9, 3 * 10**9)); "
        f"from bench.cli.command_line import main; sys.exit(main(['navigate', {str(log)!r}, '-o', 'out']))"
    )
    ended = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=120)
    assert (ended.returncode, ended.stderr) == (2, "error: imu.parquet: more than 2727272 rows\n")


def test_rates_that_overflow_warn_nobody(folder, tmp_path, recwarn):
    columns = drives.imu_columns(drives.sensed()["imu"])
    drives.write_csv(tmp_path / "wild.csv", columns | {"gyro_x_rad_s": 1e308 * columns["gyro_x_rad_s"]})
    found = checks(rewritten(folder, tmp_path, ("imu.csv", "wild.csv")))
    assert not found["gyro_max_deg_s"].good
    assert all(len(check.text) < 300 for check in found.values())
    assert not recwarn.list


class Breaks(Loose):
    """Fails without fixes for more than 10 s."""

    def run(self, sensors, initial):
        if np.diff(sensors.fixes.t).max() > 10.0:
            raise ZeroDivisionError("no fix")
        return super().run(sensors, initial)


@pytest.mark.parametrize("withhold", [0, 5])
def test_an_estimator_that_fails_in_an_outage_of_a_log_has_failed(folder, tmp_path, capsys, withhold):
    log = rewritten(folder, tmp_path, ("from_s = 40.0", f"from_s = 40.0\nwithhold = {withhold}"))
    uses = ["-e", f"{__name__}:Breaks", "-e", "loose-15", "--outages", "20", "--places", "2"]
    assert main(["navigate", str(log), *uses, "--no-rrd", "-o", str(tmp_path / "out")]) == 70
    assert "ZeroDivisionError: no fix" in capsys.readouterr().err
    result = json.loads((tmp_path / "out/result.json").read_text())
    assert result["metrics"]["Breaks"]["verdict_text"] == (
        "Breaks failed: run() raised ZeroDivisionError: no fix"
    )
    assert result["metrics"]["loose-15"]["converged"]
    assert [row["estimator"] for row in result["outages"]] == ["loose-15"]


def test_an_estimator_that_cannot_start_on_a_log_has_failed_where_another_can(folder, tmp_path, capsys):
    log = str(rewritten(folder, tmp_path, ('kind = "course"', 'kind = "course"\nduration_s = 600.0')))
    options = ["--no-rrd", "-o", str(tmp_path / "out"), "--force", "-e", "loose-15"]
    assert main(["navigate", log, *options, "-e", "gnss-only"]) == 1
    metrics = json.loads((tmp_path / "out/result.json").read_text())["metrics"]
    assert metrics["loose-15"]["verdict_text"].startswith("loose-15 failed: alignment course needs 250 s")
    assert metrics["gnss-only"]["converged"]
    capsys.readouterr()
    assert main(["navigate", log, *options]) == 2
    assert capsys.readouterr().err.startswith("error: filter 'loose-15': alignment course needs 250 s")


# --- reading ------------------------------------------------------------------------------------------


def test_rates_and_increments_in_csv_parquet_and_mat_are_one_recording(folder, tmp_path):
    imu = drives.sensed()["imu"]
    first = read_records(load_log(str(folder / "drive.toml"))).imu
    columns = drives.imu_columns(imu)
    parquet.write_table(pa.table(columns), tmp_path / "imu.parquet")
    savemat(
        tmp_path / "imu.mat", {name: values[:, None] for name, values in columns.items()}, do_compression=True
    )
    dt = 1.0 / drives.RATE
    increments = {"time_ms": 1e3 * imu["t"]}
    increments |= {f"dtheta_{a}_deg": np.rad2deg(imu["gyro"][:, k]) * dt for k, a in enumerate("xyz")}
    increments |= {f"dvel_{a}_m_s": imu["accel"][:, k] * dt for k, a in enumerate("xyz")}
    drives.write_csv(tmp_path / "increments.csv", increments)
    odd = {f"c{k}": values for k, values in enumerate(columns.values())}
    odd |= {f"c{k}": np.rad2deg(odd[f"c{k}"]) for k in (1, 2, 3)} | {
        f"c{k}": odd[f"c{k}"] / 9.80665 for k in (4, 5, 6)
    }
    drives.write_csv(tmp_path / "odd.csv", odd)
    names = ["t_s", *(f"gyro_{a}_deg_s" for a in "xyz"), *(f"accel_{a}_g" for a in "xyz")]
    told = "columns = { " + ", ".join(f'{name} = "c{k}"' for k, name in enumerate(names)) + " }"
    path = rewritten(folder, tmp_path)
    for file, more in (("imu.parquet", ""), ("imu.mat", ""), ("increments.csv", ""), ("odd.csv", told)):
        path.write_text(drives.LOG.replace('file = "imu.csv"', f'file = "{file}"\n{more}'))
        found = read_records(load_log(str(path))).imu
        assert_allclose(found.t, first.t, atol=1e-9)
        assert_allclose(found.dtheta_b, first.dtheta_b, atol=1e-11)
        assert_allclose(found.dvel_b, first.dvel_b, atol=1e-10)


def test_mounting_and_misalignment_turn_the_axes_of_the_imu_into_those_of_the_body(folder, tmp_path):
    """scipy turned the vectors of the body into the axes of the IMU; the log has to turn them back."""
    plain = read_records(load_log(str(folder / "drive.toml"))).imu
    turned = drives.write_log(tmp_path, mounting_deg=(170.0, 20.0, -100.0))
    text = drives.LOG.replace("[imu]", "[imu]\nmounting_deg = [170.0, 20.0, -100.0]")
    turned.write_text(text)
    found = read_records(load_log(str(turned))).imu
    assert_allclose(found.dtheta_b, plain.dtheta_b, atol=1e-11)
    assert_allclose(found.dvel_b, plain.dvel_b, atol=1e-10)
    turned.write_text(text.replace("[imu]", "[imu]\nmisalignment_deg = [0.0, 0.0, 90.0]"))
    found = read_records(load_log(str(turned))).imu  # what pointed forward points right
    assert_allclose(found.dvel_b[:, 1], plain.dvel_b[:, 0], atol=1e-10)


@pytest.mark.parametrize(("vehicle", "told"), [("car", True), ("multirotor", False)])
def test_what_flies_sideways_is_not_told_that_its_forward_axis_is_wrong(folder, tmp_path, vehicle, told):
    across = rewritten(
        folder, tmp_path,
        ("[imu]", "[imu]\nmisalignment_deg = [0.0, 0.0, 15.0]"),
        ('kind = "course"', 'kind = "hover"'),
        ('title = "A drive of the tests"', f'title = "Across"\nvehicle = "{vehicle}"'),
    )  # fmt: skip
    bad = {check.name for check in bench.read_log(across).checks if not check.good}
    assert ("forward_yaw_deg" in bad) == told


def test_velocities_are_taken_to_the_times_of_their_fixes(tmp_path):
    path = drives.write_log(tmp_path, velocity_late=0.1)
    late = checks(path)["velocity_shift_s"]
    assert late.value == pytest.approx(-0.1, abs=0.01)
    assert not late.good
    assert "velocity_offset_s" in late.text
    path.write_text(drives.LOG.replace("[gnss]", "[gnss]\nvelocity_offset_s = -0.1"))
    now = checks(path)["velocity_shift_s"]
    assert now.good
    assert now.value == pytest.approx(0.0, abs=0.01)


# --- what is wrong with a recording -------------------------------------------------------------------


def test_a_sound_recording_is_said_to_be_sound(folder):
    found = checks(folder / "drive.toml")
    assert all(check.good for check in found.values()), [c.text for c in found.values() if not c.good]
    assert found["imu_shift_s"].value == pytest.approx(0.0, abs=0.01)
    assert found["gravity_ratio"].value == pytest.approx(1.0, abs=0.005)
    assert found["turn_gain"].value == pytest.approx(1.0, abs=0.02)
    assert found["forward_yaw_deg"].value == pytest.approx(0.0, abs=3.0)
    assert found["imu_rate_hz"].value == pytest.approx(100.0)


YAWED = rotation.matrix(rotation.from_euler(0.0, 0.0, 0.6))


@pytest.mark.parametrize(
    ("change", "name", "words"),
    [
        (("gyro", lambda v: np.rad2deg(v)), "turn_gain", "deg/s in a column of rad/s"),
        (("gyro", lambda v: np.deg2rad(v)), "turn_gain", "rad/s in a column of deg/s"),
        (("accel", lambda v: v / 9.80665), "gravity_ratio", "g in a column of m/s^2"),
        (("accel", lambda v: v * 1.05), "gravity_ratio", "the scale"),
        (("accel", lambda v: -v), "imu_axes", "show gravity, not specific force"),
        (("accel", lambda v: v @ YAWED), "triads_deg", "their axes are not the same"),
        (
            ("gyro", lambda v: v * [1.0, 1.0, -1.0]),
            "imu_axes",
            "gyros fit the motion with their axes x, y, z taken from x, y, -z",
        ),
        (("t", lambda v: v + 0.07), "imu_shift_s", "time_offset_s"),
        (("t", lambda v: v + 0.5 * (v > 60.0)), "imu_gaps", "1 gap, of 0.51 s"),
        (("t", lambda v: v + 2e3 * (v > 60.0)), "imu_gaps", "1 gap, of 2000 s"),
        (("t", lambda v: v - 0.5 * ((v > 60.0) & (v < 60.205))), "imu_unordered_rows", "go back"),
    ],
)
def test_a_defect_of_a_recording_is_said(tmp_path, change, name, words):
    """Each defect alone; the value a user needs to mend it stands in the line."""
    path = drives.write_log(tmp_path)
    imu = drives.sensed()["imu"]
    key, spoil = change
    drives.write_csv(tmp_path / "imu.csv", drives.imu_columns({**imu, key: spoil(imu[key])}))
    found = checks(path)[name]
    assert not found.good
    assert words in found.text
    if key == "t" and name == "imu_shift_s":
        assert found.value == pytest.approx(-0.07, abs=0.005)


def test_the_standard_deviation_of_the_clock_shift_is_honest():
    """Of 20 recordings the shift is unbiased and scatters no more than reported (99.95 % of chi-square)."""
    found = []
    for seed in range(20):
        made = drives.sensed(seed)
        imu, gnss = made["imu"], made["gnss"]
        n = len(imu["t"])
        angles, speeds = 0.01 * imu["gyro"], 0.01 * imu["accel"]
        record = ImuData(imu["t"], np.full(n, 0.01), np.ones(n, bool), angles, speeds)
        found_now = validity.check_recording(record, fixes_of(gnss), {}, drives.ARM)
        shift = next(c for c in found_now if c.name == "imu_shift_s")
        sd = float(shift.text.rpartition("sd ")[2].partition(" ")[0])
        found.append((shift.value, sd))
    shifts, sds = np.array(found).T
    ratio = np.var(shifts, ddof=1) / np.mean(np.square(sds))
    assert 0.1 < ratio < chi2.ppf(0.9995, 19) / 19  # the covariance is up to three times too careful
    assert abs(np.mean(shifts)) < 3.3 * np.std(shifts) / np.sqrt(20) + 5e-4  # and level arms are assumed


def fixes_of(gnss):
    from bench.core.records.data import GnssFixes

    m = len(gnss["t"])
    cov = np.tile(np.eye(3), (m, 1, 1))
    return GnssFixes(
        gnss["t"], gnss["t"], np.ones(m, bool), gnss["lla"], gnss["vel_n"], cov, cov, np.zeros(m, np.int64)
    )


# --- navigating ---------------------------------------------------------------------------------------


def test_a_recording_is_navigated_and_judged_like_a_run(folder, tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    out = tmp_path / "out"
    arguments = [
        "navigate",
        str(folder / "drive.toml"),
        "-e",
        "loose-15",
        "--outages",
        "5,20",
        "--places",
        "4",
    ]
    assert main([*arguments, "-o", str(out), "--json"]) == 0
    printed = json.loads(capsys.readouterr().out)
    metrics = printed["metrics"]["loose-15"]
    assert metrics["converged"]
    # estimate minus withheld fix: the noise of the fix and what the filter adds to it
    assert 0.028 < metrics["pos_rmse_h_m"] < 0.045
    assert metrics["nees_mean"] == pytest.approx(6.0, abs=1.5)
    rows = {row["duration_s"]: row for row in printed["outages"]}
    assert rows[5.0]["median_h_m"] < rows[20.0]["median_h_m"]
    assert rows[20.0]["median_h_m"] < 10 * rows[20.0]["predicted_median_h_m"]
    result = results.read_result(out)
    assert set(result.solutions) == {"loose-15"}
    error = result.errors["loose-15"]
    assert np.isfinite(error.pos_n[error.t > 40.0]).all()
    assert not (out / "truth.parquet").exists()
    assert json.loads((out / "result.json").read_text())["validity"][0]["name"] == "imu_rate_hz"
    t, shown = column(out / "flight.rrd", "/estimators/loose-15/position/north/error", "Scalars:scalars")
    assert_allclose(t, error.t)
    assert_allclose(shown[:, 0], error.pos_n[:, 0])
    assert main([*arguments, "-o", str(out)]) == 2  # it exists
    assert "--force" in capsys.readouterr().err


def test_a_fix_that_contradicts_the_imu_evaluates_no_filter(folder):
    """Of two fixes with a glitch of 40 m/s one would be withheld; both go to the filter."""
    spec = load_log(str(folder / "drive.toml"))
    recorded = read_records(spec)
    start = find_start(recorded, spec)
    plain = Session(spec, recorded, start)
    wrong = [plain.spec.withhold * 40 - 1, plain.spec.withhold * 40 + 1]
    vel_n = recorded.fixes.vel_n.copy()
    vel_n[np.isin(recorded.fixes.t, plain.fixes.t[wrong])] += [40.0, 0.0, 0.0]
    session = Session(spec, replace(recorded, fixes=replace(recorded.fixes, vel_n=vel_n)), start)
    assert np.flatnonzero(~session.sound).tolist() == wrong
    keep, withheld = session.split_fixes()
    expected = plain.split_fixes()[0].copy()
    assert not expected[wrong[0]]
    expected[wrong] = True
    assert_array_equal(keep, expected)
    assert_array_equal(withheld.t, session.fixes.t[~keep])


def test_the_withheld_fixes_never_reach_the_filter(folder):
    """Other values in them leave the solution as it is, bit by bit."""
    spec = load_log(str(folder / "drive.toml"))
    recorded = read_records(spec)
    session = Session(spec, recorded, find_start(recorded, spec))
    keep, withheld = session.split_fixes()
    assert len(withheld) == len(session.fixes) // 5
    data = session.make_data(keep, session.make_output_times())
    assert not np.isin(data.fixes.t, withheld.t).any()
    hidden = np.isin(recorded.fixes.t, withheld.t)
    spoiled = replace(
        recorded, fixes=replace(recorded.fixes, lla=np.where(hidden[:, None], 0.5, recorded.fixes.lla))
    )
    other = Session(spec, spoiled, session.initial).make_data(keep, session.make_output_times())
    one = built_in.load("loose-15", {})
    assert_array_equal(
        estimator.answer(one, "x", data, session.initial).lla,
        estimator.answer(one, "x", other, session.initial).lla,
    )


def test_the_drift_over_an_outage_is_that_of_the_known_truth(folder):
    """The error against the last fix cut out is that against the truth, to the noise of the fix."""
    spec = load_log(str(folder / "drive.toml"))
    recorded = read_records(spec)
    session = Session(spec, recorded, find_start(recorded, spec))
    one = built_in.load("loose-15", {})
    flown = drives.truth()
    t = session.fixes.t
    for cut in session.run_outages(one, "x", 20.0, 3):
        assert cut.duration == pytest.approx(20.0)
        end = cut.start + cut.duration
        data = session.make_data((t <= cut.start) | (t > end + 1e-6), np.array([end]))
        solution = estimator.answer(one, "x", data, session.initial)
        true = flown.lla[np.searchsorted(flown.t, end + recorded.origin - 1e-6)]
        off = difference_n(solution.lla[0], true)
        assert cut.drift == pytest.approx(np.hypot(*off[:2]), abs=0.1)  # 3.5 sigma of a fix


KIND = 'kind = "course"'
GIVEN = 'kind = "given"\nat_s = 30.0\nroll_deg = 1.0\npitch_deg = 3.0\nheading_deg = 30.0'
GATED = '[[estimator]]\nuse = "loose-15"\noptions = { gate_probability = 0.01 }\n[evaluation]'
SETTINGS = [
    ("mounting_deg", ("[imu]", "[imu]\nmounting_deg = [0.0, 0.0, 1.0]")),
    ("misalignment_deg", ("[imu]", "[imu]\nmisalignment_deg = [0.5, 0.0, 0.0]")),
    ("imu time_offset_s", ("[imu]", "[imu]\ntime_offset_s = 0.02")),
    ("imu position_m", ("[1.0, 0.0, -0.5]", "[1.5, 0.0, -0.5]")),
    ("gnss position_m", ("[0.4, 0.3, -1.5]", "[0.4, 0.6, -1.5]")),
    ("gnss time_offset_s", ("[gnss]", "[gnss]\ntime_offset_s = 0.02")),
    ("velocity_offset_s", ("[gnss]", "[gnss]\nvelocity_offset_s = 0.05")),
    ("velocity_sd_mps", ("[gnss]", "[gnss]\nvelocity_sd_mps = 0.5")),
    ("assumed imu", ('imu = "imu.toml"', 'imu = "icm-42688-p"')),
    ("assumed gnss", ('gnss = "gnss.toml"', 'gnss = "rtk-fixed"')),
    ("baro", ("[sensors.assumed]", '[baro]\nfile = "baro.csv"\n[sensors.assumed]\nbaro = "baro.toml"')),
    ("withhold", ("from_s = 40.0", "from_s = 40.0\nwithhold = 3")),
    ("output_hz", ("from_s = 40.0", "from_s = 40.0\noutput_hz = 7.0")),
    ("from_s", ("from_s = 40.0", "from_s = 60.0")),
    ("at_s", (KIND, f"{KIND}\nat_s = 26.0")),
    ("duration_s", (KIND, f"{KIND}\nduration_s = 5.0")),
    ("drift_deg", (KIND, f"{KIND}\ndrift_deg = 8.0")),
    ("given", (KIND, GIVEN)),
    ("tilt_sd_deg", (KIND, GIVEN + "\ntilt_sd_deg = 5.0")),
    ("heading_sd_deg", (KIND, GIVEN + "\nheading_sd_deg = 1.0")),
    ("level", (KIND, 'kind = "level"')),
    ("options", ("[evaluation]", GATED)),
]


@pytest.fixture(scope="module")
def usual(folder, tmp_path_factory):
    return outcome(folder / "drive.toml")


def outcome(path):
    """Everything a log comes to, of its first estimator."""
    spec = load_log(str(path))
    recorded = read_records(spec)
    session = Session(spec, recorded, find_start(recorded, spec))
    keep, withheld = session.split_fixes()
    data = session.make_data(keep, np.concatenate([session.make_output_times(), withheld.t]))
    one = built_in.load(spec.estimators[0].use, spec.estimators[0].options)
    solution = estimator.answer(one, "x", data, session.initial)
    _, metrics = measure_by_fixes(solution, withheld, data, spec.evaluation)
    return json.dumps({k: v for k, v in metrics.items() if k != "reason"}), len(solution)


@pytest.mark.parametrize("change", [change for _, change in SETTINGS], ids=[name for name, _ in SETTINGS])
def test_each_setting_moves_the_result(folder, usual, tmp_path, change):
    assert outcome(rewritten(folder, tmp_path, change)) != usual


def test_quality_leaves_fixes_out(tmp_path):
    path = drives.write_log(tmp_path)
    columns = drives.gnss_columns(drives.sensed()["gnss"])
    columns["quality"] = np.where(np.arange(len(columns["t_s"])) % 3, 1.0, 5.0)
    drives.write_csv(tmp_path / "gnss.csv", columns)
    every = read_records(load_log(str(path))).fixes.valid
    path.write_text(drives.LOG.replace("[gnss]", "[gnss]\nquality = [1, 2]"))
    some = read_records(load_log(str(path))).fixes.valid
    assert every.all()
    assert_array_equal(some, columns["quality"] == 1.0)
    assert "0.02 m horizontally, the same for all" in read_log(path).checks[-1].text
    path.write_text(drives.LOG.replace("[gnss]", "[gnss]\nquality = [3]"))
    assert "fix_accuracy_m" not in {check.name for check in read_log(path).checks}


@pytest.mark.parametrize("kind", ["given", "course"])
def test_the_start_is_where_the_car_is(folder, tmp_path, kind):
    """What is told is the position of the IMU, not of its antenna; what a filter finds is near the truth."""
    flown = drives.truth()
    k = int(np.searchsorted(flown.t, 30.0 - 1e-6))
    angles = np.rad2deg(rotation.to_euler(flown.q_nb[k]))
    told = 'kind = "given"\nat_s = 29.99\n' + "\n".join(
        f"{name}_deg = {angle:.6f}" for name, angle in zip(("roll", "pitch", "heading"), angles, strict=True)
    )
    path = rewritten(folder, tmp_path, (KIND, told if kind == "given" else KIND))
    spec = load_log(str(path))
    recorded = read_records(spec)
    initial = find_start(recorded, spec)
    assert initial.alignment == kind
    if kind == "given":
        assert initial.t + recorded.origin == pytest.approx(30.0)
        off = np.abs(difference_n(initial.lla, flown.lla[k]))
        assert (off < 4 * drives.POS_SD).all()  # the arm is 1.2 m
        return
    session = Session(spec, recorded, initial)
    keep, _ = session.split_fixes()
    solution = estimator.answer(
        built_in.load("loose-15", {}), "x", session.make_data(keep, session.make_output_times()), initial
    )
    ((_, end, _),) = solution.events.select("alignment")
    k = int(np.searchsorted(solution.t, end))
    at = int(np.searchsorted(flown.t, solution.t[k] + recorded.origin - 1e-6))
    off = rotation.to_rotvec(rotation.multiply(solution.q_nb[k], rotation.conjugate(flown.q_nb[at])))
    assert (np.abs(off) < 4 * np.sqrt(np.diag(solution.cov[k])[6:])).all()


@pytest.mark.parametrize("lacking", ["every", "some"])
def test_a_table_without_velocities_is_navigated_by_its_positions(tmp_path, capsys, lacking):
    """No columns, or NaN in every third row: the withheld fixes then judge positions alone."""
    near = GIVEN.replace("heading_deg = 30.0", "heading_deg = 8.0")  # it is 7.3 deg
    path = drives.write_log(tmp_path, drives.LOG.replace(KIND, near))
    columns = drives.gnss_columns(drives.sensed()["gnss"])
    if lacking == "every":
        columns = {name: values for name, values in columns.items() if "mps" not in name}
    else:
        columns["vel_e_mps"] = np.where(np.arange(len(columns["t_s"])) % 3, columns["vel_e_mps"], np.nan)
    drives.write_csv(tmp_path / "gnss.csv", columns)
    for log in (path.read_text(), drives.LOG):
        path.write_text(log)
        arguments = ["navigate", str(path), "-o", str(tmp_path / "out"), "--no-rrd", "--force", "--json"]
        assert main(arguments) == 0
        metrics = json.loads(capsys.readouterr().out)["metrics"]["loose-15"]
        assert metrics["pos_rmse_h_m"] < 0.05
        assert metrics["nees_states"] == 3
        assert 2.0 < metrics["nees_mean"] < 4.0
        assert metrics.get("vel_rmse_3d_mps") is None
        assert ("nis_mean_gnss_velocity" in metrics) == (lacking == "some")
    events = results.read_result(tmp_path / "out").solutions["loose-15"].events.select("timeline")
    assert sum("fixes without velocity" in text for _, _, text in events) == 1


def test_a_solution_of_a_file_is_judged_beside_the_built_in_filters(folder, tmp_path, capsys):
    """What loose-15 said, written as a table: the same errors where the table has the same epochs."""
    first, known = tmp_path / "first", ["--set", "gnss.time_offset_s=0"]  # a file has no state of the clock
    assert main(["navigate", str(folder / "drive.toml"), *known, "-o", str(first), "--no-rrd"]) == 0
    solution = results.read_result(first).solutions["loose-15"]
    angles = np.rad2deg(np.column_stack(rotation.to_euler(solution.q_nb)))
    good = np.isfinite(angles).all(axis=1)
    columns = {"t_s": solution.t, "lat_deg": np.rad2deg(solution.lla[:, 0])}
    columns |= {"lon_deg": np.rad2deg(solution.lla[:, 1]), "alt_m": solution.lla[:, 2]}
    columns |= {f"vel_{a}_mps": solution.vel_n[:, k] for k, a in enumerate("ned")}
    columns |= {f"{name}_deg": angles[:, k] for k, name in enumerate(("roll", "pitch", "heading"))}
    rows = np.column_stack([values[good] for values in columns.values()])
    table = tmp_path / "mine.csv"
    np.savetxt(table, rows, delimiter=",", header=",".join(columns), comments="", fmt="%.14g")
    arguments = ["navigate", str(folder / "drive.toml"), *known, "-e", "loose-15", "-e", f"file:{table}"]
    main([*arguments, "-o", str(tmp_path / "out"), "--no-rrd"])
    errors = results.read_result(tmp_path / "out").errors
    late = errors["loose-15"].t > 40.0
    assert_allclose(errors["mine"].pos_n[late], errors["loose-15"].pos_n[late], atol=1e-3)


def test_a_log_without_any_attitude_has_results_and_no_recording(folder, tmp_path, capsys):
    out = tmp_path / "out"
    main(["navigate", str(folder / "drive.toml"), "-e", "gnss-only", "-o", str(out)])
    said, err = capsys.readouterr()
    assert err == ""
    assert "No recording: no filter has position, velocity and attitude" in said
    assert (out / "result.json").is_file()
    assert not (out / "flight.rrd").exists()
    page = (out / "report.html").read_text(encoding="utf-8")
    assert "a log without truth" in page
    assert "Estimate minus the fixes that were kept from the filters" in page
    assert "minus truth" not in page
    assert page.count('<svg class="plot"') > 3


def test_results_of_a_log_go_out_and_have_no_truth(folder, tmp_path, capsys):
    """A course alignment tells no place: the map of the bag begins at the first fix."""
    out, bag = tmp_path / "out", tmp_path / "bag"
    main(["navigate", str(folder / "drive.toml"), "-e", "loose-15", "-o", str(out), "--no-rrd"])
    with_solution = ["--with", "solution:loose-15"]
    assert main(["export", str(out), "--to", "rosbag2", "-o", str(bag), *with_solution]) == 0
    fixes = results.load_sensors(out)[1]
    first = np.rad2deg(fixes.lla[fixes.valid][0, 0])
    assert f"{first:.9f}" in (bag / "README.md").read_text()
    capsys.readouterr()
    assert main(["export", str(out), "--to", "csv", "--with", "truth"]) == 2
    assert "has no truth" in capsys.readouterr().err


def test_a_figure_of_the_assumed_datasheet_is_replaced(folder):
    path = str(folder / "drive.toml")
    plain = load_log(path)
    changed = load_log(path, overrides={"sensors.assumed.imu.gyro.noise_deg_sqrt_h": 1.5})
    assert changed.assumed.imu.gyro.random_walk == pytest.approx(np.deg2rad(1.5) / 60)
    assert changed.assumed.imu.accel == plain.assumed.imu.accel
    assert changed.document["sensors"]["assumed"]["imu"] == "imu.toml, modified"
    assert load_log(path, overrides={"evaluation.withhold": 3}).withhold == 3
    with pytest.raises(ConfigError, match="no imu is on board"):
        load_log(path, overrides={"sensors.imu.gyro.noise_deg_sqrt_h": 1.5})


# --- statistics and the law ---------------------------------------------------------------------------


def test_the_closed_form_is_the_spread_of_integrated_noise_and_biases(folder):
    """Euler sums of white noise and constants, 4000 runs: the variance within its 99.9 % band."""
    imu = load_log(str(folder / "drive.toml")).assumed.imu
    imu = replace(
        imu,
        gyro=replace(imu.gyro, random_walk=1e-3, bias_instability=2e-4),
        accel=replace(imu.accel, random_walk=1e-2, bias_instability=3e-3),
    )
    T, dt, draws = 20.0, 0.05, 4000
    random, n = np.random.default_rng(9), round(T / dt)
    rate = 1e-3 * random.standard_normal((draws, n)) / np.sqrt(dt) + 2e-4 * random.standard_normal((draws, 1))
    force = 1e-2 * random.standard_normal((draws, n)) / np.sqrt(dt) + 3e-3 * random.standard_normal(
        (draws, 1)
    )
    tilt = np.cumsum(rate, axis=1) * dt
    position = np.cumsum(np.cumsum(force + 9.80665 * tilt, axis=1), axis=1)[:, -1] * dt**2
    expected = drift_sd(T, imu)
    band = 3.3 * np.sqrt(2.0 / draws) + 3 * dt / T  # and the step of the sums
    assert abs(np.var(position) / expected**2 - 1.0) < band


def test_an_outage_that_does_not_fit_is_refused(folder, capsys, tmp_path):
    assert main(["navigate", str(folder / "drive.toml"), "--outages", "500", "-o", str(tmp_path / "o")]) == 2
    assert "500 s do not fit" in capsys.readouterr().err
    assert not (tmp_path / "o").exists()


def test_fixes_that_are_far_apart_have_no_short_outage_unless_asked_for(folder, tmp_path, capsys):
    """With 6 s between fixes none is near the end of 10 s."""
    text = (folder / "gnss.csv").read_text().splitlines()
    log = rewritten(folder, tmp_path)
    (tmp_path / "gnss.csv").unlink()
    every = round(6.0 / np.median(np.diff([float(row.partition(",")[0]) for row in text[1:]])))
    (tmp_path / "gnss.csv").write_text("\n".join([text[0], *text[1::every]]) + "\n")
    out = ["-o", str(tmp_path / "o"), "--no-rrd"]
    assert main(["navigate", str(log), *out]) == 0
    durations = {row["duration_s"] for row in json.loads((tmp_path / "o/result.json").read_text())["outages"]}
    assert 10.0 not in durations
    assert main(["navigate", str(log), *out, "--outages", "10", "--force"]) == 2
    assert "ends with a GNSS fix that fits the motion" in capsys.readouterr().err


# --- what a file cannot be ----------------------------------------------------------------------------


def broken(folder, tmp_path, name, content):
    path = rewritten(folder, tmp_path)
    (tmp_path / name).unlink()
    (tmp_path / name).write_bytes(content)
    return path


HEADER = b"t_s,gyro_x_rad_s,gyro_y_rad_s,gyro_z_rad_s,accel_x_m_s2,accel_y_m_s2,accel_z_m_s2\n"
ROW = b"0.%d,0,0,0,0,0,-9.8\n"


@pytest.mark.parametrize(
    ("name", "content", "words"),
    [
        ("imu.csv", b"", "imu.csv: no columns for time"),
        ("imu.csv", HEADER, "imu.csv: no rows"),
        ("imu.csv", HEADER + ROW % 1, "one row"),
        ("imu.csv", HEADER + ROW % 1 + b"0.2,0,zero,0,0,0,-9.8\n", "imu.csv: row 2: "),
        ("imu.csv", HEADER + ROW % 1 + b"0.2,0,0\n", "imu.csv: row 2: "),
        ("imu.csv", HEADER + ROW % 1 + ROW % 1, "its times never increase"),
        ("imu.csv", HEADER + ROW % 1 + ROW % 5, "has 2.5 rows of an IMU a second, too few"),
        ("imu.csv", HEADER + ROW % 1 + b"nan,0,0,0,0,0,-9.8\n", "row 2: its time is not a finite number"),
        ("imu.csv", HEADER.replace(b"gyro_x_rad_s", b"gyro_x_m") + ROW % 1, "must end in its unit"),
        ("imu.csv", b"\xff\xfe" + bytes(range(256)) * 10, "imu.csv: not a text file in UTF-8"),
        ("gnss.csv", b"t_s,lat_deg,lon_deg,alt_m\n1,47,11,600\n2,91,11,600\n", "row 2: latitude 91 deg"),
        ("gnss.csv", b"t_s,lat_rad,lon_rad,alt_m\n1,47,11,600\n", "row 1: latitude"),
        ("gnss.csv", b"t_s,lat_deg,lon_deg,alt_m\n1,47,11,600000\n", "row 1: height"),
        ("gnss.csv", b"t_s,lat_deg,lon_deg,alt_m\n1e9,47,11,600\n", "both files must use one clock"),
        ("imu.toml", b"source = 1\n", "imu.toml"),
    ],
)
def test_a_file_that_cannot_be_gets_one_line_and_nothing_is_written(
    folder, tmp_path, capsys, name, content, words
):
    path = broken(folder, tmp_path, name, content)
    assert main(["navigate", str(path), "-o", str(tmp_path / "out")]) == 2
    said = capsys.readouterr().err.strip()
    assert said.startswith("error: ")
    assert words in said
    assert len(said.splitlines()) <= 2
    assert not (tmp_path / "out").exists()


def test_mat_files_that_pickle_bomb_or_are_of_another_kind_are_refused(folder, tmp_path, monkeypatch):
    path = rewritten(folder, tmp_path, ('"imu.csv"', '"imu.mat"'))
    mat = tmp_path / "imu.mat"

    def said():
        with pytest.raises(ConfigError) as caught:
            read_records(load_log(str(path)))
        return str(caught.value)

    mat.write_bytes(b"\x89HDF\r\n\x1a\n" + bytes(200))
    assert said().startswith(("imu.mat: cannot be read", "imu.mat: a MATLAB file of version 7.3 needs"))
    mat.write_bytes(b"hello")
    assert "not a MATLAB file" in said()
    columns = drives.imu_columns(drives.sensed()["imu"])
    savemat(mat, columns)
    whole = mat.read_bytes()
    mat.write_bytes(whole[: len(whole) // 2])
    assert "imu.mat: " in said()
    savemat(mat, {**columns, "gyro_x_rad_s": np.array(["text"], object)})
    assert "vector of numbers" in said()
    savemat(mat, {**columns, "gyro_x_rad_s": columns["t_s"][:-1]})
    assert "differ in length" in said()
    savemat(mat, {"zeros": np.zeros(3_000_000)}, do_compression=True)
    assert mat.stat().st_size < 100_000
    monkeypatch.setattr("bench.io.logs.mat_files.mat_file.MOST_BYTES", 10_000_000)
    assert "larger than 10 MB when unpacked" in said()


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (('file = "imu.csv"', 'file = "drive.toml"'), "its ending does not show the format"),
        (('file = "imu.csv"', 'file = "imu.csv"\nformat = "kf"'), "format = 'kf' must be 'table'"),
        (('file = "imu.csv"', 'file = "drive.toml"\nformat = "table"'), "a table ends in"),
        (
            ('file = "imu.csv"', 'file = "imu.csv"\ntopic = "a"'),
            "topic is for dataflash, ",
        ),
        (('file = "imu.csv"', 'file = "none.csv"'), "no such file"),
        (('file = "imu.csv"', 'file = "imu.csv"\ncolumns = { gyro_x_rad_s = "wx" }'), "no column 'wx'"),
        (('gnss = "gnss.toml"', ""), "gnss is missing"),
        (('imu = "imu.toml"', 'imu = "icm"'), "is not in the catalog"),
        ((KIND, 'kind = "given"'), "roll_deg is missing"),
        ((KIND, f"{KIND}\nroll_deg = 1.0"), "roll_deg is for kind = 'given'"),
        ((KIND, 'kind = "level"\ndrift_deg = 1.0'), "drift_deg is for kind = 'course'"),
        ((KIND, f"{GIVEN}\nduration_s = 5.0"), "duration_s has no effect"),
        (("[imu]", 'vehicle = "person"\n[imu]'), "the course of a person gives no heading; use 'hover'"),
        (("[imu]", 'vehicle = "train"\n[imu]'), "vehicle = 'train' must be"),
        ((KIND, f"{GIVEN}\n".replace("30.0", "500.0", 1)), "no usable fix from there on"),
        ((KIND, 'kind = "level"\nat_s = 60.0'), "needs a standstill"),
        (("from_s = 40.0", "from_s = 25.0"), None),
        (
            ("[evaluation]", '[[estimator]]\nuse = "command:touch {sensors}"\n[evaluation]'),
            "--allow-code",
        ),
        (("[evaluation]", '[[estimator]]\nuse = "loos-15"\n[evaluation]'), "Did you mean 'loose-15'"),
        (("from_s = 40.0", "from_s = 400.0"), "outside the recording"),
        (("[imu]", "[imu]\nmount_deg = [0.0, 0.0, 0.0]"), "Did you mean 'mounting_deg'"),
        (("[gnss]", "[gnss]\nvelocity_offset_s = 20.0"), "is outside -10 to 10 s"),
    ],
)
def test_a_log_that_cannot_be_says_what_would_be_right(folder, tmp_path, capsys, change, words):
    path = rewritten(folder, tmp_path, change)
    status = main(["navigate", str(path), "-o", str(tmp_path / "out"), "--no-rrd"])
    if words is None:  # a result, but one that says it cannot be evaluated
        assert status == 1
        assert "metrics begin at 25 s" in " ".join(capsys.readouterr().out.split())
        return
    assert status == 2
    assert words in capsys.readouterr().err


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ([], "Missing argument 'LOG.toml|FILE'"),
        (
            ["--observations", "a", "--navigation=b", "--mask-deg", "5"],
            "error: bench navigate takes a LOG.toml; for RINEX files use: bench fixes OBSERVATIONS NAV",
        ),
        (["x.toml", "--outages", "5,no"], "must be seconds"),
        (["x.toml"], "x.toml: no such file"),
    ],
)
def test_options_that_would_not_be_read_are_refused(arguments, words, capsys):
    assert main(["navigate", *arguments]) == 2
    assert words in capsys.readouterr().err


# --- data nobody simulated ----------------------------------------------------------------------------


def real(tmp_path, *changes):
    """Return the log of the drive in tests/logs with some lines changed."""
    for path in (*LOGS.glob("*.parquet"), *LOGS.glob("icm*.toml")):
        (tmp_path / path.name).symlink_to(path)
    text = (LOGS / "drive.toml").read_text()
    for old, new in changes:
        assert old in text
        text = text.replace(old, new)
    (tmp_path / "drive.toml").write_text(text)
    return tmp_path / "drive.toml"


def test_the_clocks_of_the_drive_are_where_the_motion_says(tmp_path):
    """The velocity of this receiver is that of the middle of its epoch of 0.25 s."""
    said = checks(real(tmp_path, ("velocity_offset_s = -0.125\n", "")))
    assert said["velocity_shift_s"].value == pytest.approx(-0.125, abs=0.01)
    assert not said["velocity_shift_s"].good
    (tmp_path / "sound").mkdir()
    said = checks(real(tmp_path / "sound"))
    assert abs(said["velocity_shift_s"].value) < 0.01
    assert abs(said["imu_shift_s"].value) < 0.03  # its sd is 0.006
    assert [c.name for c in said.values() if not c.good] == ["gnss_invalid_rows"]  # of no fixed ambiguities


def test_the_drive_is_navigated_as_well_as_the_guide_says(tmp_path):
    """The command of the guide, but for its folder. The intervals are those that the places allow.

    With wheels the drift is below that of another open program on 16 cuts of this drive, 1.6, 9.8 and 28 m.
    """
    arguments = ["navigate", str(real(tmp_path)), "--set", "evaluation.from_s=300", "--outages", "10,30,60"]
    assert main([*arguments, "--places", "16", "-o", str(tmp_path / "out"), "--no-rrd"]) == 0
    result = json.loads((tmp_path / "out" / "result.json").read_text())
    for metrics in result["metrics"].values():
        assert metrics["withheld_fixes"] > 150
        assert metrics["rejected_gnss_position"] < 15
        assert metrics["cep95_m"] < 0.05
    medians = {
        "loose-15": {10.0: (1.1, 3.5), 30.0: (15.0, 37.0), 60.0: (71.0, 195.0)},
        "wheels": {10.0: (0.8, 1.6), 30.0: (1.5, 8.7), 60.0: (4.1, 14.6)},
    }
    for row in result["outages"]:
        low, high = medians[row["estimator"]][row["duration_s"]]
        assert row["places"] == 16
        assert low < row["median_h_m"] < high
        assert row["median_h_low_m"] < row["reported_median_h_m"] < 1.2 * row["median_h_high_m"]
    assert "nis_mean_nonholonomic" in result["metrics"]["wheels"]


def test_the_publishers_clock_offset_is_worse_on_the_drive(tmp_path):
    """What the motion says and what the filter says agree: the offset of the log halves the error."""
    found = []
    other = ("time_offset_s = -0.2", "time_offset_s = -0.125")
    for name, changes in (("a", ()), ("b", (other,))):
        (tmp_path / name).mkdir()
        spec = load_log(str(real(tmp_path / name, *changes)))
        recorded = read_records(spec)
        session = Session(spec, recorded, find_start(recorded, spec))
        keep, withheld = session.split_fixes()
        data = session.make_data(keep, withheld.t)
        solution = estimator.answer(built_in.load("loose-15", {}), "x", data, session.initial)
        found.append(measure_by_fixes(solution, withheld, data, spec.evaluation)[1]["pos_rmse_h_m"])
    assert found[0] < 0.5 * found[1]


@pytest.mark.parametrize(
    ("vehicle", "kind", "drift_deg"),
    [(None, "course", 2.0), ("car", "course", 2.0), ("boat", "course", 10.0), ("fixed-wing", "course", 15.0),
     ("multirotor", "hover", 2.0), ("person", "hover", 2.0)],
)  # fmt: skip
def test_a_vehicle_chooses_how_its_log_starts(folder, tmp_path, vehicle, kind, drift_deg):
    head = f'vehicle = "{vehicle}"\n[imu]' if vehicle else "[imu]"
    start = load_log(rewritten(folder, tmp_path, ("[imu]", head), (KIND, ""))).start
    assert (start.alignment, pytest.approx(np.rad2deg(start.drift_sd))) == (kind, drift_deg)


@pytest.mark.parametrize(("option", "right"), [("nonholonomic", "car"), ("coordinated", "fixed-wing")])
def test_a_rule_of_a_vehicle_holds_for_no_other(folder, tmp_path, option, right):
    for vehicle in ("multirotor", "fixed-wing", "car", "boat"):
        more = (
            f'vehicle = "{vehicle}"\n[[estimator]]\nuse = "loose-15"\noptions = {{ {option} = true }}\n[imu]'
        )
        (tmp_path / vehicle).mkdir()
        path = rewritten(folder, tmp_path / vehicle, ("[imu]", more), (KIND, ""))
        if vehicle == right:
            assert load_log(path).estimators[0].options[option]
        else:
            with pytest.raises(ConfigError, match=f"{option} = true holds for vehicle = '{right}', not for"):
                load_log(path)
