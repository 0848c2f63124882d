"""Fixes without velocity: what is left is what a plain filter says that never looks at velocities.

The twin shares with the compiled filter what tests/twin.py says; the velocity of a fix is one `if` in it.
"""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest

from bench.cli.command_line import main
from bench.core.mathematics import earth, rotation
from bench.core.records.sensor_specs import ImuSpec, TriadSpec
from bench.core.words.exceptions import EstimatorError
from bench.evaluation.consistency.chi_square import mean_nis, nis_by_sensor
from bench.evaluation.errors.error_series import error_series
from bench.io.config.log import load_log
from bench.io.logs.log_records import read_records
from bench.io.logs.log_start import find_start
from bench.navigation.built_in import BUILT_IN, load
from bench.navigation.models.loose_tight import Loose
from bench.navigation.start import alignment
from bench.simulation import sensors
from tests import twin
from tests.builders import band, student
from tests.exchange import drives, test_log_formats
from tests.navigation import test_alignment, test_twin
from tests.weaving import units, weaving

FLIGHT, UNITS = (40.0, 100.0), units()


def without(data, rows=slice(None), axes=slice(None)):
    """A record whose fixes lack the velocity in some rows."""
    vel_n, cov = data.fixes.vel_n.copy(), data.fixes.cov_vel_n.copy()
    vel_n[rows, axes], cov[rows] = np.nan, np.nan
    return replace(data, fixes=replace(data.fixes, vel_n=vel_n, cov_vel_n=cov))


# --- filters ------------------------------------------------------------------------------------------


@pytest.mark.parametrize("rows", [slice(None), slice(None, None, 3)], ids=["all", "every third"])
def test_the_compiled_filter_says_what_a_plain_one_without_those_updates_says(sensed, rows):
    data = without(sensed.data, rows)
    solution = Loose(covariance_hz=None).run(data, sensed.initial)
    test_twin.assert_same(twin.navigate(data, sensed.initial), solution)
    lacking = len(data.fixes.t[rows])
    codes = solution.innovations.code[solution.innovations.component == 0]
    assert np.sum(codes == 0) == len(data.fixes)
    assert np.sum(codes == 1) == len(data.fixes) - lacking
    assert f"gnss: {lacking} fixes without velocity" in [
        text for _, _, text in solution.events.select("timeline")
    ]


def test_a_velocity_in_part_is_none_and_said(sensed):
    """The other components, however wrong, change nothing."""
    data = without(sensed.data, slice(5, 9), 1)
    vel_n = data.fixes.vel_n.copy()
    vel_n[5:9, 0] += 1e3
    other = replace(data, fixes=replace(data.fixes, vel_n=vel_n))
    for name in ("loose-15", "gnss-only", "ukf", "classic-22"):
        one, two = (load(name, {}).run(d, sensed.initial) for d in (data, other))
        np.testing.assert_array_equal(one.cov, two.cov)
        np.testing.assert_array_equal(one.vel_n, two.vel_n)
        said = [text for _, _, text in one.events.select("timeline")]
        assert said == [
            "gnss: 4 fixes without velocity",
            "gnss: 4 velocities finite in some components alone, left out",
        ]


@pytest.mark.parametrize(
    "name", ["loose-15", "loose-22", "loose-mems", "smoother", "gnss-only", "ukf", "classic-22"]
)
def test_every_filter_of_fixes_navigates_by_positions_and_says_how_well(sensed, name):
    """Within 5 of its own sigma of the same filter with velocities, which is surer of its velocity."""
    assert name in BUILT_IN
    data = without(sensed.data)
    solution, full = (load(name, {}).run(d, sensed.initial) for d in (data, sensed.data))
    late = solution.t > 10.0
    sd, better = (np.sqrt(np.einsum("kii->ki", s.cov))[late] for s in (solution, full))
    assert (np.abs(earth.difference_n(solution.lla, full.lla)[late]) < 5.0 * sd[:, :3]).all()
    assert (np.abs(solution.vel_n - full.vel_n)[late] < 5.0 * sd[:, 3:6]).all()
    assert (better[:, 3:6] < sd[:, 3:6]).all()


def test_classic_22_takes_positions_as_its_compiled_twin_does(sensed):
    """Two codes, 22 states: 5 % of sigma."""
    data = without(sensed.data)
    classic, compiled = (load(name, {}).run(data, sensed.initial) for name in ("classic-22", "loose-22"))
    sd = np.sqrt(np.einsum("kii->ki", compiled.cov))
    assert np.abs((classic.vel_n - compiled.vel_n) / sd[:, 3:6]).max() < 0.05
    assert np.abs(earth.difference_n(classic.lla, compiled.lla) / sd[:, :3]).max() < 0.05


def test_nis_and_nees_of_a_matched_filter_are_inside_their_bands():
    """30 runs of 60 s; with receivers twice as noisy as assumed NIS is not."""
    truth, nis, nees, wrong = weaving(60.0, rate=50.0), [], [], []
    believed = units()
    noisy = replace(believed.gnss, pos_h_white_sd=2 * believed.gnss.pos_h_white_sd, pos_v_white_sd=2 * 2.5)
    for run in range(30):
        for spec, into in ((believed, nis), (replace(believed, gnss=noisy), wrong)):
            made = sensors.sense(truth, spec, 3, run)
            solution = Loose(covariance_hz=10.0).run(without(made.data), made.initial)
            assert set(solution.innovations.code) == {0, 2}
            into.append(nis_by_sensor(solution.innovations, 0.0)["gnss_position"])
            if into is nis:
                errors = error_series(truth, solution)
                nees.append(errors.nees[errors.t > 20.0].mean())
    good, bad = (
        mean_nis(*(np.concatenate([getattr(s, k) for s in x]) for k in ("nis", "dof"))) for x in (nis, wrong)
    )
    assert good.low < good.mean < good.high
    assert bad.mean > bad.high
    assert abs(np.mean(nees) - 9.0) < student(30) * np.std(nees, ddof=1) / np.sqrt(30)


def test_gnss_only_finds_its_velocity_by_itself_and_is_consistent():
    """Without a start: at first it may have any velocity, after ten seconds errors are as reported."""
    spec = replace(units(baro=None), antenna_b=(0.0, 0.0, 0.0), alignment="level")
    truth = weaving(60.0, rate=50.0)
    worst = []
    for run in range(20):
        made = sensors.sense(truth, spec, 5, run)
        data = without(made.data)
        solution = load("gnss-only", {}).run(data, made.initial)
        first = np.flatnonzero(np.isfinite(solution.lla[:, 0]))[0]
        assert solution.cov[first, 3, 3] >= alignment.UNKNOWN_SPEED_SD**2
        row = np.searchsorted(truth.t, solution.t - 1e-6)
        sd = np.sqrt(np.einsum("kii->ki", solution.cov)[:, 3:6])
        score = ((solution.vel_n - truth.vel_n[row]) / sd)[solution.t > 10.0]
        worst.append(np.mean(score**2))
        assert solution.events.select("alignment")[0][2].startswith("position of the first fix")
    assert np.mean(worst) < 1.5  # Singer's 3 m/s^2 is more than this aircraft does
    assert np.mean(worst) > 0.02


# --- alignment ----------------------------------------------------------------------------------------


def test_without_errors_course_returns_the_attitude():
    """Pitch and thrust weave; strapdown and fixes are exact, to the tolerance of fixes with velocity."""
    perfect = ImuSpec("perfect", TriadSpec(), TriadSpec())
    quiet = replace(units().gnss, pos_h_white_sd=0.0, pos_v_white_sd=0.0, vel_white_sd=0.0)
    spec = test_alignment.course(perfect)
    spec = replace(spec, gnss=quiet, assumed=replace(spec.assumed, gnss=quiet))
    truth = test_alignment.straight()
    made = sensors.sense(truth, spec, 1, 0)
    found, _ = alignment.complete(without(made.data), made.initial)
    k = int(np.argmin(np.abs(truth.t - found.t)))
    turn = rotation.multiply(found.q_nb, rotation.conjugate(truth.q_nb[k]))
    assert np.abs(rotation.to_rotvec(turn)).max() < 2e-5
    assert np.abs(earth.difference_n(found.lla, truth.lla[k])).max() < 1e-3
    assert np.abs(found.vel_n - truth.vel_n[k]).max() < 1e-3


def test_course_errors_are_what_the_covariance_says():
    """200 runs, crab angles as reported; positions assumed half as noisy fail."""
    truth, runs = test_alignment.straight(15.0), 200
    drift, nees, tight = 4 * test_alignment.DEG, [], []
    turned = np.random.default_rng(3).normal(scale=drift, size=runs)
    spec = test_alignment.course(drift=drift)
    half = replace(spec.gnss, pos_h_white_sd=spec.gnss.pos_h_white_sd / 2, pos_v_white_sd=1.25)
    for run in range(runs):
        crab = test_alignment.crabbing(truth, turned[run])
        made = sensors.sense(crab, spec, 1, run)
        for specs, into in ((spec.assumed, nees), (replace(spec.assumed, gnss=half), tight)):
            found, _ = alignment.complete(without(replace(made.data, specs=specs)), made.initial)
            k = int(np.argmin(np.abs(crab.t - found.t)))
            turn = rotation.to_rotvec(rotation.multiply(found.q_nb, rotation.conjugate(crab.q_nb[k])))
            place = earth.difference_n(found.lla, crab.lla[k])
            error = np.concatenate([place, found.vel_n - crab.vel_n[k], turn])
            into.append(error @ np.linalg.solve(found.cov, error))
    low, high = band(runs, states=9)
    assert low < np.mean(nees) < high
    assert np.mean(tight) > high


def test_too_few_positions_for_a_course_are_refused_in_one_line():
    made = sensors.sense(test_alignment.straight(15.0), test_alignment.course(align_for=1.0), 1, 0)
    with pytest.raises(
        EstimatorError, match=r"needs more than the 2 there are in 1 s; a longer \[alignment\]"
    ):
        alignment.complete(without(made.data), made.initial)


def test_level_needs_no_velocity():
    made = sensors.sense(test_alignment.standing(16.0), test_alignment.level(test_alignment.FINE), 1, 0)
    one, _ = alignment.complete(made.data, made.initial)
    other, _ = alignment.complete(without(made.data), made.initial)
    np.testing.assert_array_equal(one.q_nb, other.q_nb)
    np.testing.assert_array_equal(one.cov, other.cov)


# --- recordings ---------------------------------------------------------------------------------------


def navigated(folder, text, capsys, *more):
    for name, sheet in (("imu", drives.IMU_SHEET), ("gnss", drives.GNSS_SHEET), ("baro", drives.BARO_SHEET)):
        (folder / f"{name}.toml").write_text(sheet)
    (folder / "drive.toml").write_text(text)
    out = folder / "out"
    code = main(["navigate", "--table", str(folder / "drive.toml"), "-o", str(out), *more])
    said = capsys.readouterr()
    assert code == 0, said.err
    assert "shows no standstill" not in said.err + said.out
    return json.loads((out / "result.json").read_text())


def check_metrics(result, names):
    for name in names:
        metrics = result["metrics"][name]
        assert metrics["converged"], metrics["reason"]
        assert metrics["pos_rmse_h_m"] < 0.2 if name == "gnss-only" else metrics["pos_rmse_h_m"] < 0.06
        assert metrics["nees_states"] == 3
        assert metrics["nees_mean"] < 4.5
        assert not [key for key in metrics if key.startswith("vel")]


def test_kf_gins_of_seven_columns_is_navigated_recorded_and_cut(tmp_path, capsys):
    made = drives.sensed()
    test_log_formats.kf_gins(tmp_path, made, velocity=False)
    text = drives.LOG.replace('"imu.csv"', '"imu.txt"\nformat = "kf-gins"')
    text = text.replace('"gnss.csv"', '"gnss.txt"\nformat = "kf-gins"')
    names = ("loose-15", "smoother", "gnss-only")
    chosen = [word for name in names for word in ("-e", name)]
    result = navigated(tmp_path, text, capsys, *chosen, "--outages", "5,10", "--places", "3")
    check_metrics(result, names)
    assert len(result["outages"]) == 6
    assert all(np.isfinite(row["median_h_m"]) for row in result["outages"])
    assert (tmp_path / "out" / "flight.rrd").stat().st_size > 10_000


def test_a_bag_of_nav_sat_fixes_alone_is_navigated(tmp_path, capsys):
    """Heading, tilt and place at rest are told; the velocity is not."""
    made = drives.sensed()
    test_log_formats.rosbag(tmp_path / "bag", made, twist=False)
    text = drives.LOG.replace('"imu.csv"', '"bag"\nmounting_deg = [180.0, 0.0, 0.0]')
    text = text.replace('"gnss.csv"', '"bag"')
    roll, pitch, heading = np.rad2deg(rotation.to_euler(drives.truth().q_nb[0]))
    told = f"roll_deg = {roll}\npitch_deg = {pitch}\nheading_deg = {heading}\n"
    text = text.replace('kind = "course"', f'kind = "given"\n{told}')
    check_metrics(navigated(tmp_path, text, capsys, "--no-rrd"), ["loose-15"])
    spec = load_log(str(tmp_path / "drive.toml"))
    begun = find_start(read_records(spec), spec)
    assert begun.cov[3, 3] == alignment.UNKNOWN_SPEED_SD**2
    assert not begun.vel_n.any()
