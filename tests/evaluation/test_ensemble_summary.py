"""What a list of results says as a whole is what its arrays say one by one, on a real flight."""

from dataclasses import astuple

import numpy as np
import pytest

import bench
from bench.core.records.specs import EvaluationWindow
from bench.evaluation.ensembles import ensemble
from bench.evaluation.ensembles.ensemble_summary import compare_estimators, summarize_runs

FROM_S = 10.0
WINDOW = EvaluationWindow(FROM_S)
SHORT = {
    "duration_s": 40.0,
    "evaluation.from_s": FROM_S,
    "gnss_outage": [{"start_s": 20.0, "duration_s": 12.0}],
    "leg": [{"kind": "straight", "duration_s": 5.0}],
    "sensors.imu": "matched-mems",
    "sensors.gnss": "matched-white",
}


@pytest.fixture(scope="module")
def results():
    profile = bench.read_profile("figure-eight", SHORT, seed=3, estimators=["loose-15", "gnss-only"])
    truth = bench.fly(profile)
    return [bench.pipeline.run(profile, run=k, truth=truth) for k in range(6)]


def test_the_summary_holds_the_statistics_of_the_runs(results):
    found = summarize_runs(results, "loose-15", WINDOW)
    squares = np.array([one.metrics["loose-15"]["pos_rmse_h_m"] ** 2 for one in results])
    assert astuple(found.rmse["pos_h_m"]) == pytest.approx(astuple(ensemble.pool_rmse(squares)))
    for name, metric in {
        "pos_d_m": "pos_rmse_d_m",
        "vel_3d_mps": "vel_rmse_3d_mps",
        "tilt_deg": "tilt_rmse_deg",
        "heading_deg": "heading_rmse_deg",
    }.items():
        rmse = np.array([one.metrics["loose-15"][metric] for one in results])
        assert found.rmse[name].value == pytest.approx(np.sqrt(np.mean(rmse**2))), name
    assert found.converged == ensemble.estimate_rate(6, 6)
    inside = np.mean(
        [[one.metrics["loose-15"][f"coverage_3sigma_pos_{k}"] for k in "ned"] for one in results]
    )
    assert found.coverage["pos"].value == pytest.approx(inside)
    nees = np.mean([one.metrics["loose-15"]["nees_mean"] for one in results])
    assert found.anees.mean.mean() == pytest.approx(nees)
    assert found.nis["gnss_position"].updates == 6 * results[0].metrics["loose-15"]["updates_gnss_position"]
    assert {sensor for sensor, _ in found.whiteness} == {"baro"}  # GNSS has too few updates
    assert found.cep50_m.value < found.sep50_m.value < found.r95_m.value * 2
    assert found.consistency is None  # 6 runs
    assert found.diverged == found.failed == ensemble.estimate_rate(0, 6)


def test_growth_by_duration_of_an_outage_ends_with_its_metric(results):
    found = summarize_runs(results, "loose-15", WINDOW).growth
    grown = np.array([one.metrics["loose-15"]["outage_1_growth_h_m"] for one in results])
    assert set(found) == {"1"}
    assert [row.elapsed for row in found["1"]] == [1.0, 3.0, 10.0, 12.0]
    assert astuple(found["1"][-1].rms) == pytest.approx(astuple(ensemble.pool_rmse(grown**2)))
    assert found["1"][0].rms.value < found["1"][-1].rms.value


def test_nis_along_the_run_is_its_mean_in_parts(results):
    summary = summarize_runs(results, "loose-15", WINDOW)
    course = summary.nis_course["gnss_position"]
    silent = (course.t > 21.0) & (course.t < 31.0)  # the outage
    assert np.isnan(course.mean[silent]).all()
    assert np.isfinite(course.mean[~silent]).sum() >= 10
    table = np.concatenate([one.solutions["loose-15"].innovations.t for one in results])
    assert table.max() > 39.0
    baro = summary.nis_course["baro"]
    assert np.mean(baro.mean) == pytest.approx(summary.nis["baro"].mean, rel=0.02)  # as many in each part
    assert ((baro.low < baro.mean) & (baro.mean < baro.high)).mean() > 0.9


def test_runs_that_failed_and_runs_that_diverged_have_their_rates(results):
    marks = [{"converged": False, "failed": True}, {"converged": False}, {"converged": False}]
    others = [
        replace_metrics(one, {"loose-15": one.metrics["loose-15"] | mark})
        for one, mark in zip(results, [*marks, {}, {}, {}], strict=True)
    ]
    found = summarize_runs(others, "loose-15", WINDOW)
    assert found.runs == 6
    for rate, count in ((found.converged, 3), (found.diverged, 2), (found.failed, 1)):
        assert rate == ensemble.estimate_rate(count, 6)


def replace_metrics(result, metrics):
    fields = {name: getattr(result, name) for name in result.__slots__}
    return bench.pipeline.RunResult(**{**fields, "metrics": metrics})


def test_an_estimator_without_attitude_has_no_attitude(results):
    found = summarize_runs(results, "gnss-only", WINDOW)
    assert set(found.rmse) == {"pos_h_m", "pos_d_m", "vel_3d_mps"}
    assert set(found.coverage) == {"pos", "vel"}


def test_two_estimators_of_the_same_runs(results):
    found = compare_estimators(results, ("gnss-only", "loose-15"))
    assert found.runs == 6
    assert found.sentence.startswith(
        ("loose-15 is better than gnss-only by", "gnss-only and loose-15: undecided in")
    )


def test_runs_that_did_not_converge_leave_too_few(results):
    broken = [replace_metrics(one, {"loose-15": {"converged": False}}) for one in results]
    with pytest.raises(ValueError, match="loose-15: 0 of 6 runs converged; at least 2 are needed"):
        summarize_runs(broken, "loose-15", WINDOW)
