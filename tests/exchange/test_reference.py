"""A reference evaluates a log like a truth: in its own units, axes and clock, and no filter sees it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.spatial.transform import Rotation

import bench
from bench.cli.command_line import main
from bench.core.mathematics import earth, rotation
from bench.core.records.data import GnssFixes
from bench.core.records.run_records import Reference
from bench.core.words.exceptions import ConfigError
from bench.evaluation.errors.error_series import select_epochs
from bench.io.config.log import ReferenceSpec, SourceSpec, load_log
from bench.io.logs.log_start import find_start
from bench.io.logs.reference import check_reference, make_covariance, read_reference
from bench.pipeline.log_pipeline import Session
from tests.builders import assert_same_solution
from tests.evaluation.solutions import wrong_solution
from tests.exchange import drives
from tests.synthetic import turning

POINT = np.array([1.5, -0.4, -1.0])  # of the other unit, from the point that the log counts from [m]
MOUNTING = (2.0, -3.0, 90.0)  # of its axes: roll, pitch, yaw in those of the vehicle [deg]
LATE = 12.5  # its clock is behind [s]
IMU_AT = np.array([1.0, 0.0, -0.5])
REFERENCE = f"""
[reference]
file = "{{file}}"
position_m = {POINT.tolist()}
mounting_deg = {list(MOUNTING)}
time_offset_s = {LATE}
"""
SD = {"n": 0.02, "e": 0.02, "d": 0.02}


def motion(rate: float = 20.0):
    """The true motion of the other unit, in its own axes: columns by name."""
    flown = drives.truth()
    step = round(drives.RATE / rate)
    at = np.arange(step, len(flown), step)
    C_nb = rotation.matrix(flown.q_nb[at])
    arm = POINT - IMU_AT
    rate_b = drives.RATE * flown.dtheta_b[at - 1]
    lla = earth.displace(flown.lla[at], C_nb @ arm)
    vel_n = flown.vel_n[at] + np.einsum("kij,kj->ki", C_nb, np.cross(rate_b, arm))
    q = rotation.multiply(flown.q_nb[at], rotation.from_euler(*np.deg2rad(MOUNTING)))
    columns = {"t_s": flown.t[at] - LATE, "lat_deg": np.rad2deg(lla[:, 0])}
    columns |= {"lon_deg": np.rad2deg(lla[:, 1]), "alt_m": lla[:, 2]}
    columns |= {f"vel_{a}_mps": vel_n[:, k] for k, a in enumerate("ned")}
    angles = np.rad2deg(np.column_stack(rotation.to_euler(q)))
    return columns | {f"{name}_deg": angles[:, k] for k, name in enumerate(("roll", "pitch", "heading"))}


def navigate(folder, columns, text=REFERENCE, **how):
    """Navigate the drive with a reference of these columns."""
    drives.write_csv(folder / "other.csv", columns)
    path = drives.write_log(folder, drives.LOG + text.format(file="other.csv"), **how)
    return bench.navigate(path)


def test_the_errors_are_those_to_the_truth_whatever_the_point_the_axes_and_the_clock(tmp_path):
    result = navigate(tmp_path, motion())
    errors, found = result.errors["loose-15"], result.metrics["loose-15"]
    solution, flown = result.solutions["loose-15"], drives.truth()
    row = np.rint((solution.t + result.more["log"]["origin_s"]) * drives.RATE).astype(int)
    own = rotation.to_rotvec(rotation.multiply(solution.q_nb, rotation.conjugate(flown.q_nb[row])))
    direct = earth.difference_n(solution.lla, flown.lla[row])
    at, late = np.searchsorted(solution.t, errors.t), errors.t > 40.0
    lever = np.linalg.norm(errors.phi_n[late], axis=1).max() * np.linalg.norm(POINT - IMU_AT)
    assert errors.states == 9
    # the reference is a cubic over its 0.05 s, and turns evenly between its rows
    assert np.abs(errors.phi_n - own[at])[late].max() < 2e-4
    assert np.abs(errors.pos_n - direct[at])[late].max() < 1e-3 + lever
    assert found["verdict"] == "consistent"
    assert found["heading_rmse_deg"] < 3.0
    assert found["reference_epochs"] == len(errors)
    assert "withheld_fixes" not in found
    assert len(result.records["withheld"]) == 0  # every fix is used


@pytest.mark.parametrize(
    ("change", "metric"),
    [
        (lambda c: c | {"t_s": c["t_s"] + 0.2}, "vel_rmse_3d_mps"),
        (lambda c: c | {"roll_deg": c["roll_deg"] + 3.0}, "tilt_rmse_deg"),
        (lambda c: c | {"alt_m": c["alt_m"] + 5.0}, "pos_rmse_d_m"),
    ],
)
def test_a_wrong_reference_shows_and_no_filter_sees_it(tmp_path, change, metric):
    right = navigate(tmp_path, motion())
    wrong = navigate(tmp_path, change(motion()))
    assert_same_solution(wrong.solutions["loose-15"], right.solutions["loose-15"])
    assert wrong.metrics["loose-15"][metric] > 3.0 * right.metrics["loose-15"][metric]
    assert wrong.metrics["loose-15"]["verdict"] == "overconfident"


def test_a_gap_and_a_class_of_rows_left_out_are_not_judged(tmp_path):
    columns = motion(5.0) | {"quality": np.ones(len(motion(5.0)["t_s"]))}
    del columns["roll_deg"], columns["pitch_deg"], columns["heading_deg"]
    columns["quality"][400:425] = 2.0  # 80 to 85 s, with positions far off
    columns["alt_m"][400:425] += 30.0
    kept = np.abs(columns["t_s"] + LATE - 110.0) > 5.0
    columns = {name: values[kept] for name, values in columns.items()}
    result = navigate(tmp_path, columns, REFERENCE + "quality = [1]\n")
    t = result.errors["loose-15"].t + result.more["log"]["origin_s"]
    assert result.errors["loose-15"].states == 6
    assert result.metrics["loose-15"]["verdict"] == "consistent"
    assert result.metrics["loose-15"]["pos_rmse_d_m"] < 0.2
    assert not ((t > 80.21) & (t < 85.19)).any()
    assert not ((t > 105.01) & (t < 114.99)).any()
    assert "heading_rmse_deg" not in result.metrics["loose-15"]


def test_a_solution_of_rtklib_and_one_of_kf_gins_are_references(tmp_path):
    columns = motion(5.0)
    week = columns["t_s"] + LATE
    place = [columns[name] for name in ("lat_deg", "lon_deg", "alt_m")]
    vel = [columns[f"vel_{a}_mps"] for a in "ned"]
    angles = [columns[f"{name}_deg"] for name in ("roll", "pitch", "heading")]
    nav = np.column_stack([0.0 * week + 2300, week, *place, *vel, *angles])
    np.savetxt(tmp_path / "other.nav", nav, fmt="%.10f")
    with (tmp_path / "other.pos").open("w") as file:
        file.write(
            "%  GPST          latitude(deg) longitude(deg)  height(m)   Q  ns   sdn(m)   sde(m)   sdu(m)\n"
        )
        for t, *row in zip(week, *place, strict=True):
            file.write("0 {:.3f} {:.10f} {:.10f} {:.5f} 1 12 0.02 0.02 0.02\n".format(t, *row))
    for file, states in (("other.nav", 9), ("other.pos", 3)):
        text = REFERENCE.replace(f"time_offset_s = {LATE}", "").format(file=file)
        result = bench.navigate(drives.write_log(tmp_path, drives.LOG + text))
        assert result.metrics["loose-15"]["nees_states"] == states
        assert result.metrics["loose-15"]["verdict"] == "consistent"


def pose_rows(columns):
    """Times, positions east, north, up of the first row, and attitudes, of the other unit."""
    lla = np.column_stack([np.deg2rad(columns["lat_deg"]), np.deg2rad(columns["lon_deg"]), columns["alt_m"]])
    turn = [columns[f"{name}_deg"] for name in ("heading", "pitch", "roll")]
    to_ned = Rotation.from_euler("ZYX", np.column_stack(turn), degrees=True)
    to_enu = Rotation.from_matrix([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])
    return lla, to_enu.apply(earth.local_ned(lla, lla[0])), to_enu * to_ned


@pytest.mark.parametrize("kind", ["yaw", "se3"])
def test_poses_in_a_local_frame_are_a_reference_once_they_are_aligned(tmp_path, kind):
    columns = motion(5.0)
    _, position, attitude = pose_rows(columns)
    turn = Rotation.from_euler("z", 50.0, degrees=True)
    flu = Rotation.from_euler("x", 180.0, degrees=True)
    rows = np.column_stack(
        [
            columns["t_s"],
            turn.apply(position) + np.array([30.0, -20.0, 5.0]),
            (turn * attitude * flu).as_quat(),
        ]
    )
    np.savetxt(tmp_path / "other.txt", rows, fmt="%.9f")
    text = REFERENCE.format(file="other.txt") + f"align = '{kind}'\n"
    result = bench.navigate(drives.write_log(tmp_path, drives.LOG + text))
    found = result.metrics["loose-15"]
    direct = navigate(tmp_path, columns).metrics["loose-15"]
    assert "nees_mean" not in found
    assert found["heading_rmse_deg"] == pytest.approx(direct["heading_rmse_deg"], abs=0.2)
    assert found["pos_rmse_h_m"] == pytest.approx(direct["pos_rmse_h_m"], abs=0.05)
    assert "degrees of freedom are taken away" in str(result.more)
    with pytest.raises(ConfigError, match="local frame"):
        bench.navigate(drives.write_log(tmp_path, drives.LOG + text.replace(kind, "none")))


def local_reference(folder, first, **how):
    """Read a straight line of TUM, from ``first`` on its clock on, for a log that begins at 5000 s."""
    t = np.arange(20.0)
    line = np.column_stack([first + t, 10.0 * t, t**2, 0.0 * t, *[0.0 * t] * 3, 0.0 * t + 1.0])
    np.savetxt(folder / "poses.tum", line, fmt="%.9f")
    source = SourceSpec(folder / "poses.tum", "poses", time_offset=2.0, origin=how.pop("origin", None))
    n = how.pop("fixes", 20)
    lla = np.tile([0.8, 0.2, 500.0], (n, 1)) + np.column_stack([1e-6 * t[:n], 1e-6 * t[:n] ** 2, t[:n]])
    sd = np.tile(np.eye(3), (n, 1, 1))
    valid, count = np.ones(n, np.bool_), np.zeros(n, np.int64)
    fixes = GnssFixes(t[:n], t[:n], valid, lla, np.zeros((n, 3)), sd, sd, count)
    spec = ReferenceSpec(source, (0.0, 0.0, 0.0), (0.0, 0.0, 0.0), (), **how)
    return read_reference(spec, 5000.0, 30.0, fixes, np.zeros(3))


def test_a_reference_in_a_local_frame_tells_its_clock(tmp_path):
    reference, checks = local_reference(tmp_path, 5001.0)
    assert_allclose(reference.track.t[0], 3.0)
    assert [one.name for one in checks] == ["reference_clock_s", "reference_alignment_m"]
    assert checks[0].text == "reference: its clock is the IMU; t = 0 of the run is 5000 s"
    reference, checks = local_reference(tmp_path, 0.0)
    assert_allclose(reference.track.t[0], 2.0)
    assert [one.name for one in checks] == ["reference_alignment_m"]


def test_the_times_of_a_reference_beside_the_log_are_those_of_its_file(tmp_path):
    with pytest.raises(
        ConfigError, match=r"its times, 7002 to 7021 s, do not overlap with the IMU, 5000 to 5030 s"
    ):
        local_reference(tmp_path, 7000.0)


def test_no_fix_aligns_no_reference(tmp_path):
    with pytest.raises(ConfigError, match="0 epochs in common with the run; an alignment needs 3"):
        local_reference(tmp_path, 0.0, fixes=0, origin=(47.0, 11.0, 500.0), align="yaw")


@pytest.mark.parametrize("how", [{"frame": "ned-frd"}, {"origin": (47.0, 11.0, 5.0)}, {"align": "se3"}])
def test_keys_for_a_local_frame_are_rejected_for_a_table(tmp_path, how):
    drives.write_csv(tmp_path / "other.csv", motion())
    align = how.pop("align", None)
    source = SourceSpec(tmp_path / "other.csv", **how)
    spec = ReferenceSpec(source, (0.0, 0.0, 0.0), (0.0, 0.0, 0.0), (), align)
    fixes = GnssFixes(*[np.zeros(0)] * 2, np.zeros(0, np.bool_), *[np.zeros((0, 3))] * 2,
                      *[np.zeros((0, 3, 3))] * 2, np.zeros(0, np.int64))  # fmt: skip
    with pytest.raises(ConfigError, match=r"^other\.csv: .* local"):
        read_reference(spec, 0.0, 150.0, fixes, np.zeros(3))


@pytest.mark.parametrize(
    ("value", "good"),
    [("[47, 11, 5]", True), ("[47, 11, 5, 30]", True), ("[91, 11, 5]", False), ("[47, 11]", False)],
)
def test_an_origin_has_limits(tmp_path, value, good):
    text = f"{drives.LOG}\n[reference]\nfile = 'other.csv'\norigin = {value}\n"
    drives.write_csv(tmp_path / "other.csv", motion())
    path = drives.write_log(tmp_path, text)
    if good:
        assert load_log(str(path)).reference.source.origin[:2] == (47.0, 11.0)
        return
    with pytest.raises(ConfigError, match=r"\[reference\] origin.*must be latitude, longitude"):
        load_log(str(path))


def test_an_sbet_is_a_reference(tmp_path):
    columns = motion(5.0)
    lla, _, _ = pose_rows(columns)
    turn = [np.deg2rad(columns[f"{name}_deg"]) for name in ("roll", "pitch", "heading")]
    vel = [columns[f"vel_{a}_mps"] for a in "ned"]
    rows = np.column_stack([columns["t_s"], lla, *vel, *turn, np.zeros((len(lla), 7))])
    rows = rows[columns["t_s"] >= 0.0]
    rows.astype("<f8").tofile(tmp_path / "mission.out")
    result = bench.navigate(drives.write_log(tmp_path, drives.LOG + REFERENCE.format(file="mission.out")))
    assert result.metrics["loose-15"]["nees_states"] == 9
    assert result.metrics["loose-15"]["verdict"] == "consistent"


@pytest.mark.parametrize(
    ("text", "columns", "said"),
    [
        ("file = 'none.csv'", {}, "no such file beside the log"),
        ("file = 'other.csv'\nquality = [1]", {}, "quality is set, but the file has no column quality"),
        ("file = 'other.csv'\ntime_offset_s = 1e6", {}, "do not overlap with the IMU"),
        ("file = 'other.csv'", {"lat_deg": None}, "no columns for position"),
        ("file = 'other.csv'", {"valid": 0.0}, "0 of 750 rows are usable; at least 3 are needed"),
        (
            "file = 'other.csv'\nposition_m = [0, 200, 0]",
            {},
            "position_m[1] = 200 m is outside -100 to 100 m",
        ),
        ("file = 'other.csv'\n[evaluation]\nwithhold = 5", {}, "withhold is for a log without"),
    ],
)
def test_a_wrong_reference_is_one_line(tmp_path, capsys, text, columns, said):
    table = motion(5.0)
    table |= {name: np.full(len(table["t_s"]), value or 0.0) for name, value in columns.items()}
    table = {name: values for name, values in table.items() if columns.get(name, 0.0) is not None}
    drives.write_csv(tmp_path / "other.csv", table)
    log = drives.LOG.replace("[evaluation]\nfrom_s = 40.0\n", "")
    path = drives.write_log(tmp_path, f"{log}[reference]\n{text}\n")
    assert main(["navigate", str(path), "-o", str(tmp_path / "out")]) == 2
    err = capsys.readouterr().err
    assert said in " ".join(err.split())
    assert err.count("\n") == 1


def test_a_reference_of_another_drive_is_told(tmp_path):
    columns = motion()
    drives.write_csv(tmp_path / "other.csv", columns | {"lat_deg": columns["lat_deg"] + 0.01})
    log = bench.read_log(drives.write_log(tmp_path, drives.LOG + REFERENCE.format(file="other.csv")))
    (check,) = [c for c in log.checks if c.name == "reference_to_fixes_m"]
    assert not check.good
    assert "is it of this drive" in check.text


@pytest.mark.parametrize("rate", [20.0, 1.0])
def test_cuts_of_gnss_are_judged_by_the_reference(tmp_path, rate):
    """Every fix lies 10 m too far north: the fixes cannot show it, the reference does, of any rate."""
    drives.write_csv(tmp_path / "other.csv", motion(rate))
    path = drives.write_log(tmp_path, drives.LOG + REFERENCE.format(file="other.csv"))
    fixes = drives.sensed()["gnss"]
    fixes["lla"][:, 0] += 10.0 / 6.37e6
    drives.write_csv(tmp_path / "gnss.csv", drives.gnss_columns(fixes))
    log = bench.read_log(path)
    origin, start = log.records.origin, find_start(log.records, log.spec)
    flown, one = drives.truth(), log.estimators["loose-15"]
    session = Session(log.spec, log.records, start, log.reference)
    cuts = session.run_outages(one, "x", 10.0, 3)
    for cut in cuts:
        end, t = cut.start + cut.duration, session.fixes.t
        assert cut.duration == pytest.approx(10.0, abs=1.0 / rate)
        data = session.make_data((t <= cut.start) | (t > cut.start + 10.1), np.array([end]))
        solution = one.run(data, start)
        true = flown.lla[np.searchsorted(flown.t, end + origin - 1e-6)]
        off = earth.difference_n(solution.lla[0], true)
        assert cut.drift == pytest.approx(np.hypot(*off[:2]), abs=0.1)  # of a heading 2 deg off at the lever
        assert cut.claimed < 5.0
    assert min(cut.drift for cut in cuts) > 5.0
    missing = replace(log.reference, track=select_epochs(log.reference.track, np.arange(10)))
    with pytest.raises(ConfigError, match="ends with an epoch of"):
        Session(log.spec, log.records, start, missing).run_outages(one, "x", 10.0, 2)


@pytest.mark.parametrize("by", ["reference", "withheld"])
def test_a_navigated_log_is_exported_and_its_solution_scores_what_it_scored(tmp_path, by):
    """A folder of a log keeps what evaluates it, and the epochs that were asked for."""
    run, out = tmp_path / "run", tmp_path / "out"
    known = drives.LOG.replace("[gnss]", "time_offset_s = 0.0\n[gnss]")  # a file has no state of the clock
    alone = drives.write_log(tmp_path, known) if by == "withheld" else None
    result = navigate(tmp_path, motion()) if alone is None else bench.navigate(alone)
    bench.write_result(result, run, recording=False, report=False)
    bench.export_run(run, "csv", out=out, include=["solution:loose-15"])
    with (out / "output.csv").open() as file:
        assert file.readline() == "t_s\n"
        assert_allclose(np.loadtxt(file), result.solutions["loose-15"].t, atol=1e-9)
    assert "## output.csv" in (out / "README.md").read_text()
    own = result.metrics["loose-15"]
    score = bench.score_solution(out / "solution-loose-15.csv", run, label="again", out=tmp_path / "both")
    numbers = [name for name, value in own.items() if isinstance(value, float)]
    names = [name for name in numbers if name.startswith(("pos_", "vel_", "nees_"))]
    assert len(names) > 10
    assert_allclose([score.metrics[n] for n in names], [own[n] for n in names], rtol=1e-4)
    assert score.metrics["verdict"] == own["verdict"]
    both = bench.read_result(tmp_path / "both")
    assert set(both.solutions) == {"loose-15", "again"}
    assert by in both.records


def test_a_reference_tells_its_accuracy_and_its_distance_from_the_fixes():
    """Rows 3 m north and 4 m east of fixes; of 5 m sd each, 5 of their sd of 0.5 m are no limit, 20 m are."""
    truth = turning(12.0, 10.0)
    cov = np.diag([16.0, 34.0, 1.0, *range(6)]).astype(float)
    track = wrong_solution(truth, pos_n=[3.0, 4.0, 7.0], cov=cov)
    t = np.array([2.05, 1.0, 30.0, 3.0])  # not in order, one between rows, one after the last
    n = len(t)
    lla = truth.lla[np.minimum((10 * t).round().astype(int), len(truth) - 1)]
    lla[0] = 0.5 * (truth.lla[20] + truth.lla[21])
    lla[1, 0] += 1.0  # that of a fix that is not valid
    sd = np.tile(np.diag([0.09, 0.16, 400.0]), (n, 1, 1))
    fixes = GnssFixes(t, t, t != 1.0, lla, np.zeros((n, 3)), sd, sd, np.zeros(n, np.int64))
    found = check_reference(Reference(track, np.zeros(3)), fixes)
    assert found.value == pytest.approx(5.0, abs=0.1)
    assert found.good
    assert found.text == (
        "reference: 13 rows, 0.00 to 12.00 s, position, velocity, attitude, known to 5 m; "
        f"{found.value:.3g} m from the fixes in the median"
    )
    for scale, factor, good in ((7.0, 1.0, False), (7.0, 15.0, True), (3.9, 1.0, True), (7.0, 13.0, False)):
        far = wrong_solution(truth, pos_n=scale * np.array([3.0, 4.0, 0.0]), cov=0 * cov)
        far = replace(far, q_nb=np.full((13, 4), np.nan))
        found = check_reference(Reference(far, np.zeros(3)), replace(fixes, cov_pos_n=factor**2 * sd))
        assert found.good == good
        assert "s, position, velocity, taken as exact; " in found.text
        assert found.text.endswith(": is it of this drive, and time_offset_s of its clock?") != good
    late = check_reference(Reference(track, np.zeros(3)), fixes.take(t == 30.0))
    assert (late.value, late.good) == (None, True)
    assert late.text.endswith("known to 5 m; no fix at its times to compare it with")


def test_the_claims_of_a_reference_are_where_they_belong():
    """Negative and missing ones count as exact; a covariance stands before a standard deviation."""
    whole = np.arange(1.0, 10.0)
    values = {
        "cov_pos": whole[None],
        "sd_pos": np.full((1, 3), 99.0),
        "sd_vel": np.array([[2.0, -3.0, np.nan]]),
    }
    (cov,) = make_covariance(values, np.array([[0.1, 0.2, -1.0]]), 1)
    expected = np.zeros((9, 9))
    expected[:3, :3] = whole.reshape(3, 3)
    expected[3, 3], expected[6, 6], expected[7, 7] = 4.0, 0.01, 0.04
    assert_allclose(cov, expected)
    assert_allclose(make_covariance({}, None, 2), np.zeros((2, 9, 9)))
