"""The autopilot's own estimate as a filter, the truth of a simulator, and starts that logs allow."""

from __future__ import annotations

import shutil
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from numpy.testing import assert_allclose

import bench
from bench.cli.command_line import main
from bench.core.mathematics import earth, rotation
from bench.core.records.instruments import BaroData, RadarData
from bench.core.words.exceptions import WRONG, ConfigError
from bench.evaluation.errors import used_fixes
from bench.io.config.log import SourceSpec, load_log
from bench.io.logs import log_start, own_estimate
from bench.io.logs.log_contents import tell_innovations, turn_quaternion
from bench.io.logs.log_heights import find_ground, set_altimeter
from bench.io.logs.log_records import read_records
from bench.io.logs.log_start import choose_stretch, find_magnetic_heading, find_start
from bench.navigation.error_state_filter.rough_heading import UNKNOWN_HEADING_SD
from bench.navigation.start.alignment import UNKNOWN_SPEED_SD
from bench.pipeline import log_pipeline
from bench.simulation.signals.magnetic import field_n
from tests.evaluation.solutions import wrong_solution
from tests.plugins.autopilots import flown
from tests.plugins.autopilots.flash import write_flash
from tests.plugins.autopilots.test_dataflash import FLIGHTS
from tests.synthetic import turning

LOG = """
file = "flight.bin"
date = 2024-02-07
[imu]
[gnss]
position_m = [-0.6, 0.3, -1.0]
{more}
[sensors.assumed]
imu = "mpu-9250"
gnss = "rtk-fixed"
mag = "hmc5883l"
[mag]
[alignment]
{start}
[evaluation]
from_s = 40.0
[[estimator]]
use = "loose-15"
[[estimator]]
use = "autopilot"
"""


def write_log(folder: Path, more: str = "", start: str = 'kind = "course"', **how) -> Path:
    flown.write_flight(folder / "flight.bin", **how)
    (folder / "flight.toml").write_text(LOG.format(more=more, start=start))
    return folder / "flight.toml"


@pytest.fixture(scope="module")
def judged(tmp_path_factory):
    """The flight of a simulator, evaluated by the truth in its own log."""
    return bench.navigate(write_log(tmp_path_factory.mktemp("sim"), "[reference]"))


def test_the_truth_in_a_log_judges_both_in_one_table(judged):
    own, ours = judged.metrics["autopilot"], judged.metrics["loose-15"]
    assert own["pos_rmse_h_m"] == pytest.approx(np.sqrt(2.6**2 + 1.0), abs=0.2)  # 2 m, 3 m from 80 s on
    assert own["pos_rmse_d_m"] == pytest.approx(0.5, abs=0.02)
    assert own["vel_rmse_3d_mps"] < 0.01
    assert own["heading_rmse_deg"] < 0.01
    assert ours["pos_rmse_h_m"] < 0.1
    assert ours["heading_rmse_deg"] < 1.0
    assert {"reference_epochs", "nees_mean"} <= own.keys() & ours.keys()


def test_an_error_is_that_of_the_core_that_flew(judged):
    errors = judged.errors["autopilot"]
    assert_allclose(np.nanmean(errors.pos_n[errors.t < 79.8][:, :2], axis=0), flown.OFF_N[:2], atol=0.01)
    assert_allclose(errors.pos_n[errors.t > 80.3][:, 0], flown.OFF_N[0] + 1.0, atol=0.03)
    claimed = np.sqrt(np.einsum("kii->ki", judged.solutions["autopilot"].cov[:, :3, :3]))
    assert_allclose(claimed[-1], flown.SD, rtol=1e-6)
    assert_allclose(judged.solutions["autopilot"].gyro_bias_b[-1], [np.deg2rad(0.1), 0.0, 0.0])


def test_changes_of_lane_and_resets_are_events(judged):
    kinds = {
        row[2]: row for row in judged.solutions["autopilot"].events.rows() if row[2] in ("lane", "reset")
    }
    assert kinds["lane"][0] == pytest.approx(80.0, abs=0.11)
    assert kinds["lane"][3] == "core 1 after 0"
    assert kinds["reset"][3] == "EKF3 lane switch 1"


def test_variances_of_innovations_follow_from_test_ratios(judged):
    """XKF4.SV is the root of sum z^2 over gate^2 sum S: NIS = n (SV gate)^2, whatever the innovations."""
    values = judged.metrics["autopilot"]
    assert values["nis_mean_gnss_position"] == pytest.approx(2 * (0.2 * 5.0) ** 2, rel=1e-3)
    table = judged.solutions["autopilot"].innovations
    first = table.code == table.sensor.index("gnss_position")
    z = table.z[first].reshape(-1, 2)
    assert_allclose(
        table.S[first].reshape(-1, 2).sum(axis=1) * (0.2 * 5.0) ** 2, (z**2).sum(axis=1), rtol=1e-5
    )


def test_without_a_truth_no_fix_judges_it(tmp_path):
    """Its fixes are not withheld: it has used them. An outage that happened tells its drift."""
    log = log_pipeline.read_log(write_log(tmp_path, truth=False, silent=(90.05, 110.05)))
    result = log_pipeline.navigate(log)
    values = result.metrics["autopilot"]
    assert "pos_rmse_h_m" not in values
    assert values["verdict"] == "not evaluated"
    assert "has used every fix" in values["verdict_text"]
    assert result.metrics["loose-15"]["withheld_fixes"] > 50
    (row,) = [one for one in result.more["outages"] if one["estimator"] == "autopilot"]
    assert row["duration_s"] == pytest.approx(20.2, abs=0.01)
    assert row["rms_h_m"] == pytest.approx(
        np.hypot(3.0, 1.0), abs=0.2
    )  # 0.02 m of the fix, 2 m/s late by 10 ms
    assert row["reported_median_h_m"] == pytest.approx(1.1774 * 1.5, rel=1e-3)


def test_cuts_are_for_filters_that_run_here(tmp_path):
    result = log_pipeline.navigate(log_pipeline.read_log(write_log(tmp_path, truth=False)), outages=None)
    assert {row["estimator"] for row in result.more["outages"]} == {"loose-15"}
    assert [row["duration_s"] for row in result.more["outages"]] == [10.0, 30.0]
    assert [row["places"] for row in result.more["outages"]] == [10, 3]


def test_an_instance_by_its_number(tmp_path):
    path = flown.write_flight(tmp_path / "flight.bin")
    source = SourceSpec(path, "dataflash")
    zero, one = (own_estimate.read_estimate(source, k).motion for k in (0, 1))
    assert_allclose((one.lla - zero.lla)[:, 0] * 6.36e6, 1.0, rtol=0.01)
    with pytest.raises(ConfigError, match=r"flight\.bin: .*no records XKF1:2"):
        own_estimate.read_estimate(source, 2)
    with pytest.raises(ConfigError, match="must be a number"):
        own_estimate.build("autopilot:primary", source, 0.0)


def test_the_name_is_for_logs_of_autopilots(tmp_path, capsys):
    assert main(["run", "static", "-e", "autopilot"]) == WRONG
    assert "for the log of an autopilot: bench navigate" in capsys.readouterr().err
    shutil.copy(Path(__file__).parents[2] / "logs" / "drive.toml", tmp_path)
    drive = Path(__file__).parents[2] / "logs" / "drive.toml"
    with pytest.raises(ConfigError, match=r"imu\.parquet is not a log of an autopilot"):
        log_pipeline.read_log(drive, estimators=["autopilot"])


def test_a_real_estimate_agrees_with_the_receiver_that_it_used(tmp_path):
    """The EKF of the copter keeps within its meters of the fixes, its heading with its magnetometer."""
    shutil.copy(FLIGHTS / "copter.bin", tmp_path)
    assert main(["new", "log", str(tmp_path / "copter.bin")]) == 0
    spec = load_log(str(tmp_path / "copter.toml"))
    records = read_records(spec)
    own = own_estimate.build("autopilot", spec.imu, records.origin)
    session = log_pipeline.Session(spec, records, find_start(records, spec))
    data = session.make_data(np.ones(len(session.fixes), np.bool_), session.fixes.t[::5])
    solution = own.run(data, session.initial)
    off = np.hypot(*bench.core.mathematics.earth.difference_n(solution.lla, session.fixes.lla[::5])[:, :2].T)
    assert np.median(off) < 1.0
    assert np.max(off) < 4.0


# --- starts -------------------------------------------------------------------------------------------


AT = np.array([0.8, 0.2, 500.0])
ARM = np.array([1.0, 2.0, 3.0])  # of the antenna [m]


def begin(heading_from="", own=None, still=5, **more):
    """The start of a record with a fix each second and an IMU at 10 Hz; ``still``: fixes with a velocity."""
    t, n = np.arange(12.0), np.arange(12)
    ones = np.ones((12, 1, 1))
    fixes = bench.core.records.data.GnssFixes(
        t, t, t != 2.0, earth.displace(np.tile(AT, (12, 1)), np.outer(t, [1.0, 0.0, 0.0])),
        np.where(n[:, None] < still, np.nan, np.outer(t, [0.6, 0.8, 0.0])), ones * np.diag([0.5, 0.6, 0.7]),
        ones * np.diag([0.02, 0.1, 0.2]), n,
    )  # fmt: skip
    at = np.arange(1, 121) / 10.0
    force = rotation.rotate(rotation.conjugate(rotation.from_euler(0.1, -0.2, 0.0)), [0.0, 0.0, -0.98])
    shaken = np.where(at[:, None] > 5.05, 1.0, -1.0) * [0.05, 0.02, 0.01]
    felt = np.where((at[:, None] > 3.05) & (at[:, None] < 7.05), force + shaken, [0.3, 0.3, 0.3])
    imu = bench.core.records.data.ImuData(
        at, np.full(120, 0.1), np.ones(120, np.bool_), np.zeros((120, 3)), felt
    )
    start = {"at": 1.5, "align_for": 4.0, "attitude": (0.0, 0.0, np.pi / 2), "tilt_sd": 0.02}
    start |= {"heading_sd": 0.3, "heading_from": heading_from, "drift_sd": 0.0} | more
    assumed = SimpleNamespace(imu=SimpleNamespace(accel=None))
    spec = SimpleNamespace(
        name="x", gnss="l1-code", antenna_b=ARM, start=SimpleNamespace(**start), assumed=assumed
    )
    return find_start(SimpleNamespace(fixes=fixes, imu=imu, instruments={}), spec, own)


@pytest.mark.parametrize("still", [5, 12])
def test_a_given_start_is_that_of_the_imu_at_the_first_fix_with_a_velocity(still):
    """Its nose is east: forward is east, right is south. Without a velocity anywhere the first fix counts."""
    found = begin(alignment="given", still=still)
    assert found.t == (5.0 if still == 5 else 3.0)
    there = earth.displace(AT, np.array([found.t, 0.0, 0.0]))
    assert_allclose(earth.difference_n(found.lla, there), [2.0, -1.0, -3.0], atol=1e-5)
    assert_allclose(found.vel_n, [3.0, 4.0, 0.0] if still == 5 else 0.0)
    vel = [0.02, 0.1, 0.2] if still == 5 else [UNKNOWN_SPEED_SD**2] * 3
    assert_allclose(np.diag(found.cov), [0.5, 0.6, 0.7, *vel, 4e-4, 4e-4, 0.09])


def test_a_level_start_is_at_the_antenna_and_has_the_tilt_of_the_force_after_it():
    found = begin(alignment="level")
    assert found.t == 3.0
    assert_allclose(np.diag(found.cov), [14.5, 14.6, 14.7, *[np.inf] * 6])
    assert np.isnan(found.q_nb).all()
    turned = rotation.from_euler(0.4, 0.3, 1.2)
    found = begin("autopilot", lambda t: turned if t == 3.0 else None, alignment="level")
    assert_allclose(rotation.to_euler(found.q_nb), (0.1, -0.2, 1.2), atol=1e-12)
    assert_allclose(np.diag(found.cov)[6:], [np.inf, np.inf, 0.09])
    assert_allclose(earth.difference_n(found.lla, AT), [3.0, 0.0, 0.0], atol=1e-5)


@pytest.mark.parametrize("known", [False, True])
def test_a_start_in_the_air_claims_what_it_does_not_know(known, monkeypatch):
    """It speeds up by 1 m/s^2, a tilt if the heading is not known; 0.3 m/s^2 of bias, 0.2 of noise."""
    monkeypatch.setattr(log_start, "bias_sd", lambda accel, g: 0.3)
    turned = rotation.from_euler(0.4, 0.3, 1.2)
    how = ("autopilot", lambda t: turned if t == 7.0 else None) if known else ()
    found = begin(*how, alignment="hover", still=0)
    assert found.t == 7.0
    g = np.linalg.norm(earth.gravity_n(AT[0], AT[2]))
    noise = np.sqrt(2 * 0.32) / 4.0
    tilt = np.deg2rad(1.0) ** 2 + (0.3**2 + noise**2 + (0.0 if known else 1.0)) / g**2
    heading = 0.3 if known else UNKNOWN_HEADING_SD
    pos = np.array([0.5, 0.6, 0.7]) + (0.0 if known else 14.0)
    expected = [*pos, 1.42, 1.5, 1.6, tilt, tilt, heading**2]
    assert_allclose(np.diag(found.cov), expected, rtol=1e-6)
    arm_n = rotation.rotate(found.q_nb, ARM) if known else np.zeros(3)
    assert_allclose(earth.difference_n(found.lla, AT), [7.0, 0.0, 0.0] - arm_n, atol=1e-4)
    assert_allclose(found.vel_n, [4.2, 5.6, 0.0])
    if not known:
        assert_allclose(rotation.to_euler(found.q_nb), (0.1, -0.2, 0.0), atol=1e-12)


def test_the_stretch_of_a_start_in_the_air_is_where_the_velocity_changes_least():
    """Over 4 s: least from 3 s on; from 8 s on less, but that is too late, or a fix is not valid."""
    t = np.arange(14.0)
    north = np.array([0.0, 9.0, 5.0, 1.0, 8.0, 30.0, 40.0, 2.0, 50.0, 70.0, 90.0, 99.0, 50.0, 80.0])
    fixes = replace(make_fixes(t, 0 * t), vel_n=np.column_stack([north, -2 * north, north**2]))
    assert choose_stretch(fixes, 0.0, 11.0) == 3.0
    assert choose_stretch(fixes, 0.0, 13.0) == 8.0
    assert choose_stretch(fixes, 4.0, 7.5) == 4.0  # too short
    assert choose_stretch(replace(fixes, valid=t != 12.0), 0.0, 13.0) == 3.0


def test_a_magnetic_heading_is_exact_without_errors():
    """Any attitude below 80 deg of tilt, any acceleration of half a g, by rotation matrices."""
    rng = np.random.default_rng(3)
    g_n = np.array([0.0, 0.0, 9.81])
    for _ in range(50):
        roll, pitch, heading = rng.uniform([-1.2, -1.0, -np.pi], [1.2, 1.0, np.pi])
        C_nb = rotation.matrix(rotation.from_euler(roll, pitch, heading))
        felt_n = rng.uniform(-2.0, 2.0, 3) - g_n
        m_n = np.array([20.0, 1.5, 43.0])
        found = find_magnetic_heading(C_nb.T @ felt_n, felt_n, C_nb.T @ m_n, np.arctan2(1.5, 20.0))
        assert abs(np.angle(np.exp(1j * (found - heading)))) < 1e-3


@pytest.mark.parametrize("at", [25.0, 60.0, 100.0])
@pytest.mark.parametrize("heading", ["magnetometer", "autopilot"])
def test_a_start_in_motion_finds_the_attitude(tmp_path, at, heading):
    """While the car winds and accelerates; the truth is that of the drive."""
    start = f'kind = "hover"\nheading = "{heading}"\nat_s = {at}'
    log = log_pipeline.read_log(write_log(tmp_path, "[reference]", start))
    own = own_estimate.build("autopilot", log.spec.imu, log.records.origin)
    initial = find_start(log.records, log.spec, own.attitude)
    true = flown.drives.truth()
    k = int(np.argmin(np.abs(true.t - log.records.origin - initial.t)))
    off = rotation.to_rotvec(rotation.multiply(initial.q_nb, rotation.conjugate(true.q_nb[k])))
    assert np.abs(off[:2]).max() < 3 * np.sqrt(initial.cov[6, 6])
    assert np.rad2deg(abs(off[2])) < 3.0
    assert_allclose(initial.lla[2], true.lla[k, 2], atol=0.2)


def test_without_a_heading_several_are_tried(tmp_path):
    log = write_log(tmp_path, "[reference]", 'kind = "hover"\nat_s = 22.0')
    values = bench.navigate(bench.read_log(log, estimators=["loose-15"])).metrics["loose-15"]
    assert values["converged"]
    assert values["heading_rmse_deg_all"] is not None


def test_a_real_start_has_the_attitude_of_the_autopilot(tmp_path):
    """Tilt within 3 deg and heading within 5 of an attitude by another filter on board, motors running."""
    shutil.copy(FLIGHTS / "quad.px4log", tmp_path)
    assert main(["new", "log", str(tmp_path / "quad.px4log")]) == 0
    spec = load_log(str(tmp_path / "quad.toml"))
    assert spec.start.heading_from == "magnetometer"
    records = read_records(spec)
    own = own_estimate.build("autopilot", spec.imu, records.origin)
    for at in (1.0, 6.0, 12.0, 20.0):
        initial = find_start(records, replace(spec, start=replace(spec.start, at=at)))
        theirs = own.attitude(initial.t)
        off = np.rad2deg(rotation.to_rotvec(rotation.multiply(initial.q_nb, rotation.conjugate(theirs))))
        assert np.abs(off[:2]).max() < 3.0
        assert abs(off[2]) < 5.0


@pytest.mark.parametrize(
    ("start", "says"),
    [
        ('kind = "course"\nheading = "magnetometer"', "heading is for kind = 'level' or 'hover'"),
        ('kind = "hover"\nat_s = 1000.0', "no usable fix from there on"),
    ],
)
def test_a_start_that_cannot_be(tmp_path, start, says):
    with pytest.raises(ConfigError, match=says):
        bench.navigate(write_log(tmp_path, start=start))


# --- parts --------------------------------------------------------------------------------------------


def test_variances_of_a_quaternion_become_those_of_angles():
    """Monte Carlo, 200 000 draws of the elements: a variance is known to 0.32 %, 99.9 % band 1.1 %."""
    rng = np.random.default_rng(7)
    q = rotation.from_euler(0.3, -0.5, 2.0)
    diagonal = np.array([1e-6, 4e-6, 2e-6, 8e-6])
    dq = rng.normal(size=(200_000, 4)) * np.sqrt(diagonal)
    phi = 2.0 * rotation.multiply(dq, np.broadcast_to(rotation.conjugate(q), dq.shape))[:, 1:]
    assert_allclose(turn_quaternion(diagonal[None], q[None])[0], phi.var(axis=0), rtol=0.011)


def test_the_gate_of_a_test_ratio_is_that_of_the_parameters(tmp_path):
    """EK3_POS_I_GATE in percent of a standard deviation; without it, as for the velocity, 5."""
    kinds = {name: flown.KINDS[name] for name in ("PARM", "XKF1", "XKF3", "XKF4")}
    rows = [("PARM", (1, "AHRS_EKF_TYPE", 3.0)), ("PARM", (1, "EK3_POS_I_GATE", 300.0))]
    for k in range(3):
        t = 1_000_000 + 100_000 * k
        rows.append(("XKF1", (t, 0, *[0.0] * 14)))
        rows.append(("XKF3", (t, 0, 0.3, 0.0, 0.4, 1.0 + 0.1 * k, 0.0, 2.0)))
        rows.append(("XKF4", (t, 0, 0.1, 0.2, 0.1, 0)))
    path = write_flash(tmp_path / "x.bin", kinds, rows)
    table = own_estimate.read_estimate(SourceSpec(path, "dataflash"), None).innovations
    by_name = {name: table.nis[table.code == code] for code, name in enumerate(table.sensor)}
    assert_allclose(by_name["gnss_position"], 2 * (0.2 * 3.0) ** 2, rtol=1e-6)
    assert_allclose(by_name["gnss_velocity"], 3 * (0.1 * 5.0) ** 2, rtol=1e-6)


def test_a_core_flies_from_the_record_on_that_says_so(tmp_path):
    kinds = {name: flown.KINDS[name] for name in ("XKF1", "XKF4", "ORGN")}
    rows = [("ORGN", (1, 0, 50.0, 30.0, 100.0))]
    for k in range(10):
        t = 1_000_000 + 100_000 * k
        for core in (0, 1):
            rows.append(("XKF1", (t, core, 0, 0, 0, 10.0 + core, *[0.0] * 10)))
            rows.append(("XKF4", (t, core, 0.1, 0.2, 0.1, 0 if k < 4 else 1)))
    path = write_flash(tmp_path / "x.bin", kinds, rows)
    own = own_estimate.read_estimate(SourceSpec(path, "dataflash"), None)
    assert own.motion.vel_n[:, 0].tolist() == [10.0] * 4 + [11.0] * 6
    assert [(row[0], row[2]) for row in own.events] == [(pytest.approx(1.4), "lane")]


def test_a_repeated_innovation_is_one(tmp_path):
    t = np.arange(6.0)
    z = np.array([[1.0], [1.0], [2.0], [2.0], [0.0], [3.0]])
    S = np.array([[4.0], [4.0], [4.0], [4.0], [4.0], [np.nan]])
    table = tell_innovations({"baro": (t, z, S)})
    assert table.t.tolist() == [0.0, 2.0]
    assert_allclose(table.nis, [0.25, 1.0])


def make_fixes(t: np.ndarray, heights: np.ndarray) -> bench.core.records.data.GnssFixes:
    n = len(t)
    lla = np.column_stack([np.zeros((n, 2)), heights])
    return bench.core.records.data.GnssFixes(
        t, t, np.ones(n, np.bool_), lla, np.zeros((n, 3)), np.zeros((n, 3, 3)), np.zeros((n, 3, 3)),
        np.zeros(n, np.int64),
    )  # fmt: skip


def test_a_barometer_is_set_to_the_fixes_of_the_first_ten_seconds():
    """It reads 100 m too much: a fix that is off, and those before and after, do not count."""
    t = np.arange(0.0, 60.0)
    climb = 500.0 + 2.0 * t
    heights = np.where((t < 20.0) | (t > 30.0), climb + 70.0, climb)
    heights[25] += 40.0
    baro = BaroData(t, t, np.ones(60, np.bool_), climb + 100.0, np.ones(60))
    assert_allclose(set_altimeter(baro, make_fixes(t, heights), 20.0, 60.0).alt_baro, climb)
    assert set_altimeter(baro, make_fixes(t[:5], heights[:5]), 20.0, 60.0) is baro


def test_fixes_that_judge_do_not_set_the_altimeter():
    """Withheld are some from `from_s` on: 30 m more in these move nothing, unless there are no others."""
    t = np.arange(0.0, 60.0)
    baro = BaroData(t=t, t_arrival=t, valid=np.ones(60, bool), alt_baro=np.full(60, 5.0), sd=np.ones(60))
    late = np.where(t < 24.0, 100.0, 130.0)
    assert_allclose(set_altimeter(baro, make_fixes(t, late), 20.0, 24.0).alt_baro, 100.0)
    assert_allclose(set_altimeter(baro, make_fixes(t, late), 24.0, 24.0).alt_baro, 130.0)


def test_the_ground_below_a_radar_is_where_it_first_looked_on_it():
    """30 m below the fix nearest in time: rows that are not valid, before and nearer, do not count."""
    t = np.array([2.0, 5.2, 9.0])
    radar = RadarData(t=t, t_arrival=t, valid=t > 3.0, height=np.array([1.0, 30.0, 41.0]), sd=np.ones(3))
    fixes = make_fixes(np.array([0.0, 5.0, 5.1, 6.0, 9.0]), np.array([500.0, 247.0, 900.0, 260.0, 270.0]))
    fixes = replace(fixes, valid=fixes.t != 5.1)
    log, looked = SimpleNamespace(ground_alt=None), {"radar": radar}
    assert find_ground(log, looked, fixes) == 217.0
    assert find_ground(SimpleNamespace(ground_alt=88.0), looked, fixes) == 88.0
    blind = {"radar": replace(radar, valid=np.zeros(3, np.bool_))}
    lost = replace(fixes, valid=np.zeros(5, np.bool_))
    for there, by in (({}, fixes), (blind, fixes), (looked, lost)):
        assert find_ground(log, there, by) == 0.0


@pytest.mark.parametrize(("step", "longest"), [(0.2, 2.0), (1.0, 5.0)])
def test_only_long_silences_are_outages(step, longest):
    """Longer than five usual intervals, and than 2 s."""
    steps = np.full(60, step)
    steps[[20, 40]] = 0.99 * longest, 1.01 * longest
    t = np.cumsum(steps)
    assert used_fixes.find_outages(make_fixes(t, np.zeros(60))) == [(t[39], t[40])]
    assert used_fixes.find_outages(make_fixes(t[:1], np.zeros(1))) == []


def test_an_outage_is_judged_by_the_fix_that_ends_it():
    """Wrong by (3, 4, -12) m there and 1 m down before; it reports a variance of 2 and 14 m^2 there."""
    truth = turning(12.0, 10.0)
    t = np.array([1.0, 2.0, 3.0, 10.0, 11.0])
    wrong = np.tile([0.0, 0.0, 1.0], (13, 1))
    wrong[10] = 3.0, 4.0, -12.0
    wrong[11] = np.nan
    cov = np.tile(np.eye(9), (13, 1, 1))
    cov[10] = np.diag([2.0, 14.0, 50.0, *range(3, 9)])
    made = wrong_solution(truth, pos_n=wrong, cov=cov)
    fixes = replace(make_fixes(t, np.zeros(5)), lla=truth.lla[(10 * t).astype(int)])
    still = np.zeros((len(truth), 3))
    imu = bench.core.records.data.ImuData(
        truth.t, np.full(len(truth), 0.1), np.ones(len(truth), np.bool_), still, still
    )
    data = SimpleNamespace(antenna_b=np.zeros(3), imu=imu)
    outages = [*used_fixes.find_outages(fixes), (10.0, 11.0), (3.0, 10.5)]  # no answer at the end, no fix
    (drift,) = used_fixes.measure_outages(made, fixes, data, outages)
    assert (drift.start, drift.duration) == (3.0, 7.0)
    assert (drift.drift, drift.drift_v) == pytest.approx((5.0, 12.0), rel=1e-5)
    assert drift.claimed == pytest.approx(np.sqrt(8.0))


def test_a_declination_of_the_day_counts():
    there = np.array([[np.deg2rad(-35.4), np.deg2rad(149.2), 600.0]])
    north, east, _ = field_n(there, 2015.9)[0]
    assert np.rad2deg(np.arctan2(east, north)) == pytest.approx(12.2, abs=0.5)  # Canberra


def test_a_log_without_imu_is_refused_in_a_line(tmp_path, capsys):
    kinds = {name: flown.KINDS[name] for name in ("GPS", "XKF1")}
    rows = [
        ("GPS", (int(2e5 * k), 0, 3, 1000, 2300, 9, 1.0, 47.0, 11.0, 600.0, 1.0, 0.0, 0.0)) for k in range(20)
    ]
    path = write_flash(tmp_path / "x.bin", kinds, rows)
    assert main(["navigate", str(path)]) == WRONG
    said = capsys.readouterr().err
    assert said.count("\n") == 1
    assert "x.bin: no records RISI or IMU; it has GPS" in said
    assert not path.with_suffix(".toml").exists()


def angles_of(motion):
    return np.rad2deg(np.column_stack(rotation.to_euler(motion.q_nb)))


def test_a_core_of_ekf2_has_records_of_its_own_five_numbers_on(tmp_path):
    labels = "TimeUS,Roll,Pitch,Yaw,VN,VE,VD,PN,PE,PD,GX,GY,GZ"
    kinds = {
        "PARM": ("QNf", "TimeUS,Name,Value"),
        "ORGN": flown.KINDS["ORGN"],
        **{f"NKF{k}": ("Q" + "f" * 12, labels) for k in (1, 6)},
        "NKF8": ("Qffffff", "TimeUS,IVN,IVE,IVD,IPN,IPE,IPD"),
        "NKF9": ("Qfff", "TimeUS,SV,SP,SH"),
    }
    rows = [("PARM", (1, "AHRS_EKF_TYPE", 2.0)), ("PARM", (1, "EK2_VEL_I_GATE", 250.0))]
    rows += [("ORGN", (k, k, 50.0 + k, 30.0 + k, 100.0 + k)) for k in (1, 0)]  # type 0 is that of the filter
    for k in range(3):
        t = 1_000_000 + 100_000 * k
        rows.append(("NKF1", (t, *[0.0] * 12)))
        rows.append(("NKF6", (t, 3.0, -4.0, 50.0, 1.0, 2.0, -0.5, 20.0, -30.0, -7.0, 0.1, -0.2, 0.3)))
        rows.append(("NKF8", (t, 0.3, 0.1, 0.4, 1.0 + 0.1 * k, 0.5, 2.0)))
        rows.append(("NKF9", (t - 15_000, 0.5, 0.6, 0.7)))  # of the step before
        rows.append(("NKF9", (t + 4_000, 0.1 + 0.01 * k, 0.2, 0.1)))
    path = write_flash(tmp_path / "x.bin", kinds, rows)
    own = own_estimate.read_estimate(SourceSpec(path, "dataflash"), 1)
    assert_allclose(angles_of(own.motion)[0], [3.0, -4.0, 50.0], rtol=1e-5)
    home = np.array([np.deg2rad(50.0), np.deg2rad(30.0), 100.0])
    ned = bench.core.mathematics.earth.difference_n(own.motion.lla, np.broadcast_to(home, (3, 3)))
    assert_allclose(ned, [[20.0, -30.0, -7.0]] * 3, atol=1e-3)
    assert_allclose(own.motion.vel_n[0], [1.0, 2.0, -0.5])
    assert_allclose(own.biases[1][0, :3], np.deg2rad([0.1, -0.2, 0.3]), rtol=1e-6)
    assert np.isnan(own.biases[1][:, 3:]).all()
    table = own.innovations
    velocity = table.nis[(table.code == table.sensor.index("gnss_velocity")) & (table.component == 0)]
    assert_allclose(velocity, 3 * (2.5 * 0.1) ** 2, rtol=1e-6)  # once: it stays as it is
    position = table.nis[(table.code == table.sensor.index("gnss_position")) & (table.component == 0)]
    assert_allclose(position, [2 * (5.0 * 0.2) ** 2] * 3, rtol=1e-6)


def test_before_ekf2_positions_count_from_home_and_gates_are_numbers(tmp_path):
    kinds = {
        "PARM": ("QNf", "TimeUS,Name,Value"),
        "CMD": ("QHLLf", "TimeUS,CNum,Lat,Lng,Alt"),
        "EKF1": ("Q" + "f" * 12, "TimeUS,Roll,Pitch,Yaw,VN,VE,VD,PN,PE,PD,GX,GY,GZ"),
        "EKF3": ("Qffffff", "TimeUS,IVN,IVE,IVD,IPN,IPE,IPD"),
        "EKF4": ("Qfff", "TimeUS,SV,SP,SH"),
    }
    rows = [("PARM", (1, "EKF_POS_GATE", 4.0))]
    rows += [("CMD", (1, k, lat, 30.0, 100.0)) for k, lat in ((1, 20.0), (0, 0.0), (0, 50.0))]
    rows.append(("EKF1", (2_000_000, 3.0, -4.0, 50.0, 1.0, 2.0, -0.5, 20.0, -30.0, -7.0, 0.1, -0.2, 0.3)))
    rows.append(("EKF3", (2_000_000, 0.3, 0.1, 0.4, 1.0, 0.5, 2.0)))
    rows.append(("EKF4", (2_004_000, 0.1, 0.2, 0.3)))
    path = write_flash(tmp_path / "x.bin", kinds, rows)
    own = own_estimate.read_estimate(SourceSpec(path, "dataflash"), None)
    home = np.array([[np.deg2rad(50.0), np.deg2rad(30.0), 100.0]])
    assert_allclose(
        bench.core.mathematics.earth.difference_n(own.motion.lla, home), [[20.0, -30.0, -7.0]], atol=1e-3
    )
    found = {
        name: own.innovations.nis[own.innovations.code == k][0]
        for k, name in enumerate(own.innovations.sensor)
    }
    expected = {"gnss_velocity": 3 * 0.5**2, "gnss_position": 2 * 0.8**2, "baro": 1.5**2}
    assert found == pytest.approx(expected, rel=1e-6)


def test_the_estimate_of_px4_before_2017(tmp_path):
    """Angles in radians; the height of the first fix in three dimensions is that of the first row."""
    kinds = {
        "TIME": ("Q", "StartTime"),
        "GPS": ("QBffLLffffB", "GPSTime,Fix,EPH,EPV,Lat,Lon,Alt,VelN,VelE,VelD,nSat"),
        "LPOS": ("ffffffLLff", "X,Y,Z,VX,VY,VZ,RLat,RLon,EPH,EPV"),
        "ATT": ("fff", "Roll,Pitch,Yaw"),
    }
    rows = []
    for k, (fixed, alt) in enumerate(((1, 900.0), (3, 500.0), (4, 700.0))):
        rows.append(("TIME", (2_000_000 + 300_000 * k,)))
        rows.append(("GPS", (1, fixed, 1.0, 1.0, 47.0, 8.0, alt, 0.0, 0.0, 0.0, 9)))
        ref = (0.0, 0.0) if k == 2 else (47.0, 8.0)  # none
        rows.append(("LPOS", (20.0, -30.0, -7.0 - 5 * k, 1.0, 2.0, -0.5, *ref, 2.0, 3.0)))
        rows.append(("ATT", (0.1, -0.2, 0.9)))
    path = write_flash(tmp_path / "x.px4log", kinds, rows)
    own = own_estimate.read_estimate(SourceSpec(path, "dataflash"), None)
    home = np.array([np.deg2rad(47.0), np.deg2rad(8.0), 493.0])
    ned = bench.core.mathematics.earth.difference_n(own.motion.lla[:2], np.broadcast_to(home, (2, 3)))
    assert_allclose(ned, [[20.0, -30.0, -7.0], [20.0, -30.0, -12.0]], atol=1e-3)
    assert np.isnan(own.motion.lla[2]).all()
    assert_allclose(own.motion.vel_n[0], [1.0, 2.0, -0.5])
    assert_allclose(np.deg2rad(angles_of(own.motion)[0]), [0.1, -0.2, 0.9], rtol=1e-5)
    assert_allclose(own.variances[1][0, :3], [2.0, 2.0, 9.0])
