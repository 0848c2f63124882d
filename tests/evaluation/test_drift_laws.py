"""Drift laws against the Schuler pendulum integrated step by step, and the verdict on a measured drift."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy import stats
from scipy.integrate import solve_ivp

from bench import pipeline
from bench.core.mathematics import rotation
from bench.core.mathematics.units import DEG, STANDARD_GRAVITY
from bench.core.records.sensor_specs import AssumedSpecs
from bench.evaluation.linear import drift_laws
from bench.evaluation.linear.drift_laws import RADIUS, RAYLEIGH_MEDIAN, drift_sd
from bench.evaluation.metrics.outages import OutageDrift, describe_drift, make_drift_row, place_outages
from bench.evaluation.metrics.run_metrics import measure
from bench.experiments.campaigns.worker import fly, get_truth
from bench.experiments.studies.outage_study.outage_drift import Options, make_profile
from bench.io import results
from tests.weaving import GNSS, IMU

QUIET = replace(
    IMU,
    gyro=replace(IMU.gyro, random_walk=0.0, bias_instability=0.0, turn_on_bias_sd=0.0),
    accel=replace(IMU.accel, random_walk=0.0, bias_instability=0.0, turn_on_bias_sd=0.0),
)


def unit(triad, **figures):
    return replace(QUIET, **{triad: replace(getattr(QUIET, triad), **figures)})


def pendulum(T, *, accel=0.0, gyro=0.0, velocity=0.0, tilt=0.0, turn=0.0):
    """Horizontal channels of an INS: p' = v, v' = a + g phi, phi' = b - v / R, the biases turning with it."""

    def rates(t, x):
        _, v, phi = np.split(x, 3)
        b = np.array([np.cos(turn * t), np.sin(turn * t)])
        return np.concatenate([v, accel * b + STANDARD_GRAVITY * phi, gyro * b - v / RADIUS])

    start = np.array([0.0, 0.0, velocity, 0.0, tilt, 0.0])
    found = solve_ivp(rates, (0.0, T), start, rtol=1e-10, atol=1e-12)
    return float(np.hypot(*found.y[:2, -1]))


@pytest.mark.parametrize("T", [30.0, 600.0, 5064.0])
def test_each_law_is_the_answer_of_the_pendulum(T):
    b_a, b_g = 1e-3 * STANDARD_GRAVITY, 10.0 * DEG / 3600
    assert drift_sd(T, unit("accel", bias_instability=b_a)) == pytest.approx(pendulum(T, accel=b_a), abs=1e-3)
    assert drift_sd(T, unit("gyro", bias_instability=b_g)) == pytest.approx(pendulum(T, gyro=b_g), rel=1e-5)
    assert drift_sd(T, QUIET, velocity=0.2) == pytest.approx(pendulum(T, velocity=0.2), abs=1e-3)
    assert drift_sd(T, QUIET, tilt=1e-3) == pytest.approx(pendulum(T, tilt=1e-3), abs=1e-3)


def test_short_drifts_grow_with_the_second_and_third_power_of_time():
    accel, gyro = unit("accel", bias_instability=1e-2), unit("gyro", bias_instability=1e-4)
    assert drift_sd(10.0, accel) == pytest.approx(0.5 * 1e-2 * 10.0**2, rel=1e-4)
    assert drift_sd(10.0, gyro) == pytest.approx(STANDARD_GRAVITY * 1e-4 * 10.0**3 / 6.0, rel=1e-4)
    assert drift_sd(20.0, accel) / drift_sd(10.0, accel) == pytest.approx(4.0, rel=1e-3)
    assert drift_sd(20.0, gyro) / drift_sd(10.0, gyro) == pytest.approx(8.0, rel=1e-3)
    assert drift_sd(10.0, unit("accel", random_walk=1e-2)) == pytest.approx(1e-2 * np.sqrt(1e3 / 3), rel=1e-3)
    expected = STANDARD_GRAVITY * 1e-4 * np.sqrt(1e5 / 20)
    assert drift_sd(10.0, unit("gyro", random_walk=1e-4)) == pytest.approx(expected, rel=1e-3)


def test_the_pendulum_bounds_an_accelerometer_bias_but_not_a_gyro_bias():
    """A-2.4.4: at most 2 b R / g; A-2.4.7: R b T on average."""
    b = 1e-3 * STANDARD_GRAVITY
    times = np.arange(60.0, 20_000.0, 60.0)
    drifts = [drift_sd(float(T), unit("accel", bias_instability=b)) for T in times]
    assert max(drifts) == pytest.approx(2e-3 * RADIUS, rel=1e-3)
    period = 2 * np.pi * np.sqrt(RADIUS / STANDARD_GRAVITY)
    assert period / 60.0 == pytest.approx(84.4, abs=0.1)
    slow = drift_sd(period, unit("gyro", bias_instability=1e-6))
    assert slow == pytest.approx(RADIUS * 1e-6 * period, rel=1e-6)


def test_a_bias_that_turns_with_the_vehicle_is_integrated_along_its_headings():
    T, turn, b_g = 300.0, 2 * np.pi / 60.0, 1e-4
    heading = turn * np.linspace(0.0, T, 3001)
    circling = drift_sd(T, unit("gyro", turn_on_bias_sd=b_g), heading=heading, calibrated=False)
    assert circling == pytest.approx(pendulum(T, gyro=b_g, turn=turn), rel=1e-3)
    straight = drift_sd(T, unit("gyro", turn_on_bias_sd=b_g), calibrated=False)
    assert circling < 0.2 * straight
    slow = 2 * np.pi / 900.0
    turned = drift_sd(
        900.0, unit("accel", bias_instability=1e-2), heading=slow * np.linspace(0.0, 900.0, 901)
    )
    assert turned == pytest.approx(pendulum(900.0, accel=1e-2, turn=slow), rel=1e-3)
    assert drift_sd(T, unit("gyro", turn_on_bias_sd=b_g)) == 0.0  # calibrated: no turn-on bias is left


def case(T=60.0, nis=(), cov=None, sd=400.0, assumed=True):
    """A run at rest in position, its heading 0.1 rad/s times time, answers twice a second."""
    t = np.arange(0.0, T + 0.1, 0.5)
    q_nb = rotation.from_euler(0.0 * t, 0.0 * t, 0.01 * t)
    specs = AssumedSpecs(IMU, replace(GNSS, vel_markov_sd=0.3)) if assumed else None
    start = SimpleNamespace(t=t[:1], cov=np.array([np.diag(np.full(9, np.nan) if cov is None else cov)]))
    return SimpleNamespace(
        t=t, assumed=specs, nis=dict.fromkeys(nis), outages=((1, 10.0, 40.0), (2, 100.0, 110.0)),
        solution=SimpleNamespace(q_nb=q_nb), start=start, sd=np.full((len(t), 9), sd),
        pos_n=np.eye(len(t), 1, 1 - len(t)) * [30.0, 40.0, 5.0],
    )  # fmt: skip


def test_headings_are_taken_once_a_second():
    one = case()
    assert_allclose(drift_laws.headings(one, 4, 16), 0.01 * np.arange(2.0, 8.5))
    assert_allclose(drift_laws.headings(one, 4, 5), 0.01 * np.array([2.0, 2.5]))
    one.solution.q_nb[10] = np.nan
    assert drift_laws.headings(one, 4, 16) is None


def test_the_law_of_an_outage_is_that_of_a_calibrated_imu_and_the_wander_of_the_receiver():
    """From the first epoch in it to the last, 29.5 s; of two axes, rms and the 95 % radius."""
    sd = drift_sd(29.5, IMU, heading=0.01 * np.linspace(10.0, 39.5, 31), velocity=0.3)
    fixed = case(nis=("gnss_position",))
    assert drift_laws.outage_law("rms", fixed) == {"1": pytest.approx(np.sqrt(2.0) * sd, rel=1e-4)}
    assert drift_laws.outage_law("95", fixed) == {
        "1": pytest.approx(np.sqrt(2.0 * np.log(20.0)) * sd, rel=1e-4)
    }
    bare = replace(fixed.assumed, gnss=None)
    fixed.assumed = bare
    sd = drift_sd(29.5, IMU, heading=0.01 * np.linspace(10.0, 39.5, 31))
    assert drift_laws.outage_law("rms", fixed) == {"1": pytest.approx(np.sqrt(2.0) * sd, rel=1e-4)}
    assert drift_laws.outage_law("rms", case(nis=("baro",))) == {}
    assert drift_laws.outage_law("rms", case(nis=("gnss_position",), assumed=False)) == {}


def test_the_law_of_an_outage_is_what_the_filter_reports_if_that_is_more():
    """Growth of the mean variance of two axes from the first epoch in the outage to the last; NaN is none."""
    law = drift_laws.outage_law("rms", case(nis=("gnss_position",)))["1"]
    for last, expected in (((50.0, 70.0), np.hypot(50.0, 70.0)), ((np.nan, 70.0), law), ((3.1, 3.1), law)):
        one = case(nis=("gnss_position",), sd=3.0)
        one.sd[79, :2] = last
        expected = expected if expected == law else np.sqrt(expected**2 - 2.0 * 3.0**2)
        assert drift_laws.outage_law("rms", one) == {"1": pytest.approx(expected)}
        limit = drift_laws.outage_law("95", one)["1"]
        assert limit == pytest.approx(np.sqrt(np.log(20.0)) * expected)


@pytest.mark.slow
@pytest.mark.parametrize("phase", ["straight", "turn"])
def test_drifts_after_fixes_of_satellites_stay_below_their_limit(phase):
    """200 runs with `[sky]`: not more beyond the 95 % limit than a binomial gives once in 1000 times."""
    options = Options(units=("adis16475",), phases=(phase,), gnss="sky-l1")
    profile = make_profile(options, "adis16475", phase, 30.0)
    fly(profile)
    truth, beyond = get_truth(results.truth_key(profile.flight), profile), 0
    told = {"evaluation": profile.evaluation, "outages": profile.sensors.gnss_outages}
    for run in range(200):
        sensed = pipeline.sense(profile, truth, run)
        solution = pipeline.navigate(profile.estimators[0], sensed.data, sensed.initial)
        assumed = profile.sensors.assumed
        _, values = measure(truth, solution, data=sensed.data, assumed=assumed, **told)
        beyond += values["outage_1_growth_h_m"] > values["outage_1_predicted_95_h_m"]
    assert beyond <= stats.binom.ppf(0.999, 200, 0.05)


def test_the_law_of_a_run_without_fixes_begins_with_what_is_claimed():
    """Of two axes each the root of the mean square; a covariance of less than a fifth of the law is aided."""
    cov = np.square([3.0, 4.0, 9.0, 0.1, 0.3, 9.0, 0.01, 0.03, 9.0])
    start = [float(np.sqrt(np.mean(cov[k : k + 2]))) for k in (0, 3, 6)]
    heading = 0.01 * np.linspace(0.0, 60.0, 61)
    known = dict(zip(("position", "velocity", "tilt"), start, strict=True))
    sd = drift_sd(60.0, IMU, heading=heading, calibrated=False, **known)
    law = drift_laws.inertial_law(case(nis=("baro",), cov=cov))
    assert law == {
        "rms": pytest.approx(np.sqrt(2.0) * sd),
        "95": pytest.approx(np.sqrt(2.0 * np.log(20.0)) * sd),
    }
    unknown = drift_sd(60.0, IMU, heading=heading, calibrated=False)
    assert drift_laws.inertial_law(case())["rms"] == pytest.approx(np.sqrt(2.0) * unknown)
    for share, there in ((0.19, False), (0.21, True)):
        one = case(cov=cov, sd=share * sd / np.sqrt(2.0))
        one.sd[:-1] = 0.0  # what is reported at the end counts
        assert bool(drift_laws.inertial_law(one)) == there
        assert drift_laws.inertial_end(one) == ({"": pytest.approx(50.0)} if there else {})
    assert drift_laws.inertial_law(case(nis=("gnss_velocity",))) == {}
    assert drift_laws.inertial_law(case(assumed=False)) == {}


def test_a_heading_that_stays_is_that_of_none():
    """Whatever it is; of one that turns round once a second biases cancel."""
    straight, along = (drift_laws.split_drift(300.0, IMU, heading=one) for one in (None, np.full(3001, 2.0)))
    assert along == pytest.approx(straight, rel=1e-5)
    around = drift_laws.split_drift(300.0, IMU, heading=2.0 * np.pi * np.linspace(0.0, 300.0, 3001))
    for name in ("accelerometer bias", "gyro bias"):
        assert around[name] < 0.01 * straight[name]


def test_the_sources_of_a_drift_are_told_apart():
    parts = drift_laws.split_drift(300.0, IMU, calibrated=False, position=3.0, velocity=-0.2, tilt=1e-3)
    assert parts["position"] == 3.0
    assert parts["velocity"] == pytest.approx(pendulum(300.0, velocity=0.2), rel=1e-6)
    assert parts["tilt"] == pytest.approx(pendulum(300.0, tilt=1e-3), rel=1e-5)
    for triad in ("accel", "gyro"):
        one = getattr(IMU, triad)
        bias = np.hypot(one.bias_instability, one.turn_on_bias_sd)
        words = "accelerometer" if triad == "accel" else "gyro"
        assert parts[f"{words} bias"] == pytest.approx(pendulum(300.0, **{triad: bias}), rel=1e-5)
        noise = drift_sd(300.0, unit(triad, random_walk=one.random_walk))
        assert parts[f"{words} noise"] == pytest.approx(noise)


def test_outages_are_spread_from_the_first_place_to_the_last():
    assert_allclose(place_outages(100.0, 400.0, 60.0, 4), [100.0, 180.0, 260.0, 340.0])
    assert_allclose(place_outages(100.0, 160.0, 60.0, 2), [100.0, 100.0])
    with pytest.raises(ValueError, match="an outage of 60 s does not fit between 100 and 159 s"):
        place_outages(100.0, 159.0, 60.0, 2)


def test_a_row_of_drifts_has_the_quantiles_of_a_vector_of_two_axes():
    """Of s on each axis, half of the lengths are below s sqrt(2 ln 2), and 95 % below s sqrt(2 ln 20)."""
    drifts = [OutageDrift(0.0, 60.0, drift, 1.0, 2.0) for drift in (3.0, 4.0, 5.0)]
    row = make_drift_row("x", 60.0, drifts, IMU)
    expected = drift_sd(60.0, IMU)
    assert row["predicted_median_h_m"] == pytest.approx(expected * np.sqrt(2.0 * np.log(2.0)), rel=1e-4)
    assert row["predicted_p95_h_m"] == pytest.approx(expected * np.sqrt(2.0 * np.log(20.0)), rel=1e-4)
    assert row["reported_median_h_m"] == pytest.approx(2.0 * np.sqrt(2.0 * np.log(2.0)), rel=1e-4)
    assert (row["places"], row["median_h_m"]) == (3, 4.0)
    assert row["rms_h_m"] == pytest.approx(np.sqrt(50.0 / 3.0))
    assert "noise of the fixes" not in describe_drift(row)


def test_the_drift_by_a_fix_has_the_accuracy_of_the_fix():
    """Filter 3 m and fix 4 m by axis: 5 m reported; 8 m of error are mostly the fix."""
    both, fix = np.diag([41.0, 9.0, 1.0]), np.diag([28.0, 4.0, 1.0])
    one = OutageDrift.measure(10.0, 11.0, np.array([8.0, 0.0, -2.0]), both, fix)
    assert (one.duration, one.drift, one.drift_v, one.claimed, one.fix_sd) == (1.0, 8.0, 2.0, 5.0, 4.0)
    row = make_drift_row("x", 1.0, [one], IMU)
    assert row["reported_median_h_m"] == pytest.approx(5.0 * RAYLEIGH_MEDIAN)
    assert row["predicted_median_h_m"] == pytest.approx(RAYLEIGH_MEDIAN * np.hypot(drift_sd(1.0, IMU), 4.0))
    assert describe_drift(row).endswith("; noise of the fixes alone: 4.71 m")
    for drift, said in ((9.3, True), (9.5, False)):  # 4.71 m are half of 9.42 m
        far = replace(one, drift=drift)
        assert ("fixes alone" in describe_drift(make_drift_row("x", 1.0, [far], IMU))) == said
