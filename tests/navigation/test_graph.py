"""The estimators in an Earth-fixed Cartesian frame: answers with fixes and without; the cost of flatness."""

from __future__ import annotations

import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose

from bench import earth, rotation, sensors
from bench.errors import EstimatorError
from bench.evaluation.error_series import error_series
from bench.navigation.built_in import load
from bench.navigation.estimator import check_needs
from bench.navigation.models.graph.flat_frame import FlatFrame
from tests.builders import band, ensemble
from tests.weaving import DEG, GNSS, IMU, units, weaving

FINE = replace(
    IMU,
    gyro=replace(IMU.gyro, random_walk=1e-7, bias_instability=0.0, turn_on_bias_sd=0.0),
    accel=replace(IMU.accel, random_walk=1e-6, bias_instability=0.0, turn_on_bias_sd=0.0),
)
RESTLESS = replace(
    IMU,
    gyro=replace(
        IMU.gyro,
        random_walk=2 * DEG / 60,
        turn_on_bias_sd=0.0,
        bias_instability=200 * DEG / 3600,
        bias_correlation=20.0,
    ),
    accel=replace(
        IMU.accel, random_walk=1 / 60, turn_on_bias_sd=0.0, bias_instability=0.05, bias_correlation=20.0
    ),
)
TACTICAL = replace(
    IMU,
    gyro=replace(IMU.gyro, random_walk=2e-3 * DEG / 60, bias_instability=0.0, turn_on_bias_sd=5e-8),
    accel=replace(IMU.accel, random_walk=2e-3 / 60, bias_instability=0.0, turn_on_bias_sd=2e-4),
)
MISSING = "the extra 'graph' is not installed"


def test_the_frame_keeps_place_velocity_and_covariance():
    """There and back at a place 50 km from the origin, to a nanometre."""
    frame = FlatFrame.at(np.array([0.83, 0.2, 400.0]), supply=True)
    rng = np.random.default_rng(1)
    A = rng.standard_normal((9, 9))
    truth = weaving(1.0)
    start = sensors.sense(truth, units(), 1, 0).initial
    start = replace(start, lla=np.array([0.838, 0.201, 900.0]), cov=A @ A.T)
    C_tb, p_t, v_t, P = frame.begin(start)
    state, cov = frame.answer(C_tb, p_t, v_t, P)
    assert_allclose(earth.difference_n(state[:3], start.lla), 0.0, atol=2e-8)
    assert_allclose(state[3:6], start.vel_n, atol=1e-12)
    assert_allclose(rotation.matrix(state[6:]), rotation.matrix(start.q_nb), atol=1e-12)
    assert_allclose(cov, start.cov, atol=1e-12)
    assert np.linalg.norm(frame.gravity(p_t) - frame.g_t) > 0.05  # 50 km: the vertical has turned by 8 mrad


@pytest.mark.parametrize(("name", "within"), [("invariant-ekf", 0.5), ("graph-smoother", 0.05)])
def test_earth_and_gravity_are_supplied(name, within):
    """A minute without fixes: within what integration costs; over a flat, resting Earth metres are lost."""
    spec = replace(
        units(FINE), initial_pos_sd=(1e-6,) * 3, initial_vel_sd=(1e-6,) * 3, initial_tilt_sd=1e-9,
        initial_heading_sd=1e-9, output_rate=1.0,
    )  # fmt: skip
    truth = weaving(60.0, rate=100.0)
    sensed = sensors.sense(truth, spec, 1, 0)
    data = replace(sensed.data, fixes=None, baro=None)
    ours, flat = (
        error_series(truth, load(name, {"flat": flat}).run(data, sensed.initial)).pos_n[-1]
        for flat in (False, True)
    )
    assert np.linalg.norm(ours) < within  # the noise of the unit, and one rate a sample without coning
    assert np.linalg.norm(flat) > 10 * np.linalg.norm(ours)


@pytest.mark.parametrize("name", ["invariant-ekf", "graph-smoother"])
def test_they_fly_with_fixes(name):
    """Two minutes of the weaving unit: no more than twice the NEES of nine states, 15 m and 3 deg."""
    truth = weaving(120.0, rate=50.0)
    spec = replace(units(), output_rate=1.0)
    for run in range(2):
        sensed = sensors.sense(truth, spec, 3, run)
        found = error_series(truth, load(name, {}).run(sensed.data, sensed.initial))
        late = found.t > 30.0
        assert found.nees[late].mean() < 20.0
        assert np.linalg.norm(found.pos_n[late], axis=1).max() < 15.0
        assert np.abs(found.phi_n[late]).max() < 3 * DEG


def test_the_factor_graph_knows_its_errors():
    """NEES of nine states in the middle of 40 s, on the mean of 8 draws: within its 99.9 % band."""
    pytest.importorskip("gtsam", reason=MISSING)
    truth, spec = weaving(40.0, rate=50.0), replace(units(), output_rate=1.0)
    found = ensemble(load("graph-smoother", {}), truth, lambda k: sensors.sense(truth, spec, 7, k), 8, 20.0)
    low, high = band(8, states=9)
    assert low < np.mean([nees[0] for nees in found.nees]) < high


@pytest.mark.parametrize(
    "imu", [IMU, RESTLESS, FINE, TACTICAL], ids=["walk", "gauss-markov", "white", "tactical"]
)
def test_the_factor_graph_is_the_smoother(imu):
    """Two ways to one answer: deviations to 2 %, values to a fifth of one, the biases too."""
    pytest.importorskip("gtsam", reason=MISSING)
    truth, spec = weaving(40.0, rate=50.0), replace(units(imu, baro=None), output_rate=1.0)
    sensed = sensors.sense(truth, spec, 7, 0)
    both = load("graph-smoother", {}), load("smoother", {"over": "loose-15"})
    ours, other = (one.run(sensed.data, sensed.initial) for one in both)
    sd, same = (np.sqrt(np.diagonal(one.cov, axis1=1, axis2=2))[5:] for one in (ours, other))
    assert_allclose(sd, same, rtol=0.02)
    apart = error_series(truth, ours), error_series(truth, other)
    for name, part in (("pos_n", slice(0, 3)), ("vel_n", slice(3, 6)), ("phi_n", slice(6, 9))):
        values, others = (getattr(one, name)[5:] for one in apart)
        assert np.abs((values - others) / same[:, part]).max() < 0.2, name
    if imu is not FINE:
        assert_allclose(ours.extra_sd[5:], other.extra_sd[5:, :6], rtol=0.02)
        assert np.abs((ours.extra - other.extra[:, :6]) / other.extra_sd[:, :6])[5:].max() < 0.2


def test_the_factor_graph_refuses_fixes_that_wander(sensed):
    """Before the flight and in a run; white ones it takes, and a record without fixes."""
    wandering = replace(GNSS, pos_h_markov_sd=3.0)
    specs, one = replace(sensed.data.specs, gnss=wandering), load("graph-smoother", {})
    line = (
        "it takes the errors of fixes for white, but those of 'weaving-gnss' last for minutes; 'smoother' has"
    )
    with pytest.raises(EstimatorError, match=f"^estimator 'graph-smoother': {line}"):
        check_needs(one, "graph-smoother", {"fixes"}, specs=specs)
    with pytest.raises(EstimatorError, match=line):
        one.run(replace(sensed.data, specs=specs), sensed.initial)
    check_needs(one, "graph-smoother", {"fixes"}, specs=sensed.data.specs)
    assert one.refuses(replace(specs, gnss=None)) == ""


def test_without_gtsam_one_line_says_what_to_install(sensed, monkeypatch):
    monkeypatch.setattr("bench.navigation.models.graph.flat_frame.find_spec", lambda name: None)
    with pytest.raises(EstimatorError, match=r"pip install 'ins-gnss-bench\[graph\]'"):
        load("graph-smoother", {}).run(sensed.data, sensed.initial)


def test_gtsam_is_imported_by_a_run_alone():
    """One door: neither the list of estimators nor their construction pays for the import."""
    code = (
        "import sys\nfrom bench.navigation.built_in import BUILT_IN, load\n"
        "[load(name, {}) for name in BUILT_IN]\nsys.exit('gtsam' in sys.modules)"
    )
    subprocess.run([sys.executable, "-c", code], check=True, timeout=120)


FLIGHT, UNITS = (5.0,), units()


def test_the_invariant_filter_names_all_that_it_takes_for_white():
    """Each other error of the unit, and what wanders in the fixes, late as they are."""
    gnss = replace(UNITS.assumed.gnss, pos_h_markov_sd=3.0, vel_markov_sd=0.05, latency=0.1)
    imu = replace(IMU, gyro=replace(IMU.gyro, scale_factor_sd=0.01))
    said = load("invariant-ekf", {}).unmodelled(replace(UNITS.assumed, gnss=gnss, imu=imu))
    assert set(said) == {
        *("gyro scale factor", "GNSS latency"),
        *("time-correlated GNSS position error", "time-correlated GNSS velocity error"),
    }
    assert load("invariant-ekf", {}).unmodelled(replace(UNITS.assumed, imu=FINE)) == ()
