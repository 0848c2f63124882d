"""What a list of results says as a whole is what its arrays say one by one, on a real flight."""

from dataclasses import astuple

import numpy as np
import pytest

import bench
from bench.evaluation import ensemble
from bench.evaluation.ensemble_summary import compare_estimators, summarize_runs

FROM_S = 10.0
SHORT = {
    "duration_s": 40.0,
    "evaluation.from_s": FROM_S,
    "gnss_outage": [],
    "leg": [{"kind": "straight", "duration_s": 5.0}],
    "sensors.imu": "matched-mems",
    "sensors.gnss": "matched-white",
}


@pytest.fixture(scope="module")
def results():
    profile = bench.load_profile("figure-eight", SHORT, seed=3, estimators=["loose-15", "gnss-only"])
    truth = bench.fly(profile)
    return [bench.pipeline.run(profile, run=k, truth=truth) for k in range(6)]


def test_the_summary_holds_the_statistics_of_the_runs(results):
    found = summarize_runs(results, "loose-15", FROM_S)
    squares = np.array([one.metrics["loose-15"]["pos_rmse_h_m"] ** 2 for one in results])
    assert astuple(found.rmse["pos_h_m"]) == pytest.approx(astuple(ensemble.pool_rmse(squares)))
    heading = np.array([one.metrics["loose-15"]["heading_rmse_deg"] for one in results])
    assert found.rmse["heading_deg"].value == pytest.approx(np.sqrt(np.mean(heading**2)))
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


def test_an_estimator_without_attitude_has_no_attitude(results):
    found = summarize_runs(results, "gnss-only", FROM_S)
    assert set(found.rmse) == {"pos_h_m", "pos_d_m", "vel_3d_mps"}
    assert set(found.coverage) == {"pos", "vel"}


def test_two_estimators_of_the_same_runs(results):
    found = compare_estimators(results, ("gnss-only", "loose-15"))
    assert found.runs == 6
    assert found.sentence.startswith(("loose-15 is better by", "gnss-only and loose-15 do not differ"))


def test_runs_that_did_not_converge_leave_too_few(results):
    broken = [bench.pipeline.RunResult(**{**{n: getattr(one, n) for n in one.__slots__},
              "metrics": {"loose-15": {"converged": False}}}) for one in results]  # fmt: skip
    with pytest.raises(ValueError, match="loose-15: 0 of 6 runs converged; at least 2 are needed"):
        summarize_runs(broken, "loose-15", FROM_S)
