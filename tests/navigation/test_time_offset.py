"""The offset of the clock of fixes: found, reported as it is, without loss elsewhere, and on a real drive.

H is held against the filter's own prediction in `test_linearization`.
"""

from __future__ import annotations

import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from scipy import stats

from bench.core.words.exceptions import EstimatorError
from bench.evaluation.errors.error_series import error_series
from bench.evaluation.errors.fixes import antenna_errors
from bench.io.config.log import load_log
from bench.io.logs.log_records import read_records
from bench.navigation.built_in import load
from bench.navigation.error_state_filter.state_blocks import CLOCK_WALK
from bench.pipeline.log_pipeline import OFFSET_SD, Session, find_start, navigate, read_log
from bench.simulation import sensors
from tests.builders import put
from tests.exchange import drives
from tests.weaving import GNSS, units, weaving

SD = 0.1
DRIVE = Path(__file__).parent.parent / "logs" / "drive.toml"
DRAWS = 24


@pytest.fixture(scope="module")
def truth():
    return weaving(60.0, rate=50.0)


def draw(truth, run, sd=SD, receiver=GNSS):
    """Return records whose fixes show the motion at their times plus an offset, and that offset [s]."""
    drawn = sensors.sense(truth, replace(units(gnss=receiver), output_rate=1.0), 11, run)
    random, fixes = np.random.default_rng([5, run]), drawn.data.fixes
    steps = np.sqrt(np.diff(fixes.t, prepend=0.0)) * random.standard_normal(len(fixes))
    offset = sd * random.standard_normal() + CLOCK_WALK * np.cumsum(steps)
    told = fixes.t - offset
    late = put(fixes, slice(None), t=told, t_arrival=np.maximum(told, fixes.t_arrival))
    return replace(drawn, data=replace(drawn.data, fixes=late)), offset[-1]


def measure(truth, options, runs, use="loose-15"):
    """Return the sums of squared errors by their covariance at the end: of the offset, of the nine others."""
    offsets, nees, sd = 0.0, 0.0, []
    for run in range(runs):
        drawn, offset = draw(truth, run)
        solution = load(use, options).run(drawn.data, drawn.initial)
        nees += error_series(truth, solution).nees[-1]
        if options:
            at = solution.extra_names.index("time_offset_s")
            offsets += ((solution.extra[-1, at] - offset) / solution.extra_sd[-1, at]) ** 2
            sd.append(solution.extra_sd[-1, at])
    return offsets, nees, sd


@pytest.mark.parametrize("use", ["loose-15", "loose-full"])
def test_the_offset_and_all_else_are_as_claimed(truth, use):
    """Chi-squared, two-sided 99.9 %; the offset becomes known to milliseconds."""
    offsets, nees, sd = measure(truth, {"time_offset_sd": SD}, DRAWS, use)
    assert stats.chi2.isf(0.9995, DRAWS) < offsets < stats.chi2.isf(0.0005, DRAWS)
    assert stats.chi2.isf(0.9995, 9 * DRAWS) < nees < stats.chi2.isf(0.0005, 9 * DRAWS)
    assert max(sd) < 0.015


def test_without_the_state_the_same_fixes_make_a_filter_wrong(truth):
    _, nees, _ = measure(truth, {}, 6)
    assert nees > 3 * stats.chi2.isf(0.0005, 9 * 6)


PRECISE = replace(GNSS, pos_h_white_sd=0.05, pos_v_white_sd=0.08)
"""A receiver whose noise hides no error of the clock: 10 ms are 0.25 m at 25 m/s."""


@pytest.mark.parametrize(("use", "gone"), [("loose-15", 1), ("loose-15", 10), ("smoother", 1)])
def test_withheld_fixes_are_compared_at_the_time_that_the_filter_estimates(truth, use, gone):
    """Of ``gone`` withheld fixes the last: chi-squared, two-sided 99.9 %; along the course by itself.

    There the error of the offset is the largest part of the position's, and none of what is compared.
    """
    total, along = 0.0, 0.0
    for run in range(DRAWS):
        drawn, _ = draw(truth, run, receiver=PRECISE)
        fixes, last = drawn.data.fixes, len(drawn.data.fixes) - 10
        kept = np.ones(len(fixes), np.bool_)
        kept[last + 1 - gone : last + 1] = False
        data = replace(drawn.data, fixes=fixes.take(kept), output_t=np.append(fixes.t[last], 59.0))
        solution = load(use, {"time_offset_sd": SD}).run(data, drawn.initial)
        errors, moved = antenna_errors(solution, fixes.take(np.arange(len(fixes)) == last), drawn.data)
        course = solution.vel_n[0] / np.linalg.norm(solution.vel_n[0])
        total += errors.nees[0]
        along += (errors.pos_n[0] @ course) ** 2 / (course @ moved.cov[0, :3, :3] @ course)
    assert stats.chi2.isf(0.9995, DRAWS) < along < stats.chi2.isf(0.0005, DRAWS)
    assert stats.chi2.isf(0.9995, 6 * DRAWS) < total < stats.chi2.isf(0.0005, 6 * DRAWS)


def test_without_acceleration_its_sigma_stays_at_the_prior():
    """A start by fixes is as late as the fixes: at 25 m/s it shows no offset. 5 %: the walk adds 0.5 %."""
    straight = weaving(60.0, rate=50.0, straight_from=0.0)
    for run in range(4):
        drawn = sensors.sense(straight, replace(units(), output_rate=1.0), 11, run)
        start = replace(drawn.initial, alignment="course", align_for=10.0, drift_sd=np.deg2rad(2.0))
        solution = load("loose-15", {"time_offset_sd": SD}).run(drawn.data, start)
        at = solution.extra_names.index("time_offset_s")
        np.testing.assert_allclose(solution.extra_sd[20:, at], SD, rtol=0.05)
        assert (np.abs(solution.extra[20:, at]) < 3.3 * SD).all()


def sds_of(path, **how):
    return {
        label: getattr(getattr(one, "options", None), "time_offset_sd", None)
        for label, one in read_log(path, **how).estimators.items()
    }


def test_logs_estimate_the_clock_unless_it_is_given(tmp_path):
    """By every filter that can; a sigma that is given counts, and a reference may have either clock."""
    uses = ["loose-full", "smoother", "free-inertial", "gnss-only"]
    rows = "".join(f'[[estimator]]\nuse = "{use}"\n' for use in uses)
    path = drives.write_log(tmp_path, drives.LOG + rows)
    assert sds_of(path) == {
        "loose-full": OFFSET_SD, "smoother": OFFSET_SD, "free-inertial": 0.0, "gnss-only": None
    }  # fmt: skip
    (told,) = [one for one in read_log(path).checks if one.name == "time_offset_sd_s"]
    assert told.good
    assert "clock offset of its fixes, sigma 0.1 s at the start; time_offset_s in [imu]" in told.text
    for key in ("imu.time_offset_s", "gnss.time_offset_s"):
        given = {"overrides": {key: 0.0}}
        assert set(sds_of(path, **given).values()) == {0.0, None}
        assert "time_offset_sd_s" not in {one.name for one in read_log(path, **given).checks}
    for sd in (0.0, 0.02):
        assert sds_of(path, overrides={"estimator.1.options.time_offset_sd": sd})["loose-full"] == sd


@pytest.fixture(scope="module")
def typed():
    """Errors at the end of cuts of the shipped drive, its clock as the log gives it."""
    return cut(read_log(str(DRIVE), estimators=["loose-15"]))


def cut(log):
    """Return root mean square and 95 % of the drift [m] by length of the cut [s]."""
    rows = navigate(log, outages=[10.0, 30.0, 60.0]).more["outages"]
    return {row["duration_s"]: np.array([row["rms_h_m"], row["p95_h_m"]]) for row in rows}


@pytest.mark.slow
@pytest.mark.parametrize("late", [0.02, 0.073, 0.15])
def test_a_drive_whose_clock_is_wrong_drifts_no_more_than_with_the_clock_given(typed, tmp_path, late):
    """Within 5 %, as the log without any clock and fixes that are told later. The cuts move with the fixes.

    It may drift less: the clocks of the drive drift apart by 0.09 s, which a fixed offset does not follow.
    """
    for name, shift in (("imu", -0.2), ("gnss", late)):
        table = pq.read_table(DRIVE.parent / f"{name}.parquet")
        t = pa.array(table["t_us"].to_numpy() + round(1e6 * shift))
        table = table.set_column(table.column_names.index("t_us"), "t_us", t)
        pq.write_table(table, tmp_path / f"{name}.parquet")
    text = DRIVE.read_text(encoding="utf-8").replace("time_offset_s = -0.2\n", "")
    text = text.replace("from_s = 70.0", f"from_s = {70.0 + late}")
    (tmp_path / "drive.toml").write_text(text, encoding="utf-8")
    shutil.copy(DRIVE.parent / "icm-45686-driving.toml", tmp_path)
    log = read_log(str(tmp_path / "drive.toml"), estimators=["loose-15"])
    for duration, drift in cut(log).items():
        assert (drift < 1.05 * typed[duration]).all(), duration


def test_it_needs_fixes():
    for use, more in (("tight", {}), ("baro-inertial", {})):
        with pytest.raises(EstimatorError, match=r"time_offset_sd = 0\.1 needs fixes"):
            load(use, {"time_offset_sd": 0.1, **more})


@pytest.fixture(scope="module")
def at_once():
    """How far the state of the shipped drive moves, by how much later the fixes are told [s]."""

    def estimate(late):
        spec = load_log(str(DRIVE), overrides={"gnss.time_offset_s": late})
        recorded = read_records(spec)
        session = Session(spec, recorded, find_start(recorded, spec))
        keep, _ = session.split_fixes()
        data = session.make_data(keep & (session.fixes.t < 240.0), np.array([120.0, 180.0, 239.0]))
        one = load("loose-15", {"fix_accuracy": "reported", "time_offset_sd": 0.3})
        solution = one.run(data, session.initial)
        return solution.extra[:, solution.extra_names.index("time_offset_s")]

    usual = estimate(0.0)
    return lambda late: estimate(late) - usual


@pytest.mark.parametrize("late", [0.073, 0.247])
def test_fixes_of_a_real_drive_that_are_told_later_are_found_later(at_once, late):
    """Two clocks that drift apart, an IMU shaken by the roof: three quarters of the shift, or more."""
    moved = -at_once(late)
    assert (moved > 0.65 * late).all()
    assert (moved < 1.1 * late).all()
