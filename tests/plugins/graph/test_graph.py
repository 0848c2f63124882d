"""The filters in an Earth-fixed Cartesian frame: answers with fixes and without; the cost of flatness."""

from __future__ import annotations

import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose

from bench.core.mathematics import earth, rotation
from bench.core.words.exceptions import EstimatorError
from bench.evaluation.errors.error_series import error_series
from bench.navigation.built_in import load
from bench.navigation.engine.gate import InnovationGate
from bench.navigation.engine.integrity import nis
from bench.navigation.error_state_filter.measurement_rows import SENSORS
from bench.navigation.estimator import check_needs
from bench.navigation.models.flat_frame import FlatFrame, load_gtsam
from bench.plugins.graph import factor_graph
from bench.plugins.graph.graph_options import GraphOptions
from bench.simulation import sensors
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
    """There and back at a place 50 km from the origin, to a nanometer."""
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
    """A minute without fixes: within what integration costs; over a flat, resting Earth meters are lost."""
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
    """NEES of nine states in the middle of 40 s, on the mean of 8 runs: within its 99.9 % band."""
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


def falling(imu, *, dt, unknown=(0.0, 0.0)):
    """A chain over a flat Earth with one link of free fall and no turn, and what the IMU measured in it."""
    initial = replace(sensors.sense(weaving(1.0), units(), 1, 0).initial, bias_cov=np.zeros((9, 6)))
    data = sensors.sense(weaving(1.0), units(imu), 1, 0).data
    chain = factor_graph.Chain(load_gtsam(), GraphOptions(flat=True), data, initial)
    none = np.zeros((len(dt), 3))
    chain.links.append(factor_graph.Link(np.array(dt), none, none, np.array(unknown)))
    return chain, chain.preintegrate(0)


def test_white_noise_of_the_imu_is_what_its_integral_is():
    """Attitude n T, velocity n T, position n T^3 / 3, whatever the steps; a gap adds what it is said to."""
    pytest.importorskip("gtsam", reason=MISSING)
    gyro, accel = replace(IMU.gyro, random_walk=2e-3), replace(IMU.accel, random_walk=0.05)
    imu, T = replace(IMU, gyro=gyro, accel=accel), 2.0
    for dt in ([T], [0.5] * 4):
        P = falling(imu, dt=dt)[1].preintMeasCov()
        assert_allclose(np.diag(P), np.repeat([4e-6 * T, 25e-4 * T**3 / 3.0, 25e-4 * T], 3), rtol=1e-9)
        assert_allclose(np.diag(P[3:6, 6:9]), 25e-4 * T**2 / 2.0, rtol=1e-9)
    P = falling(imu, dt=[0.5] * 4, unknown=(0.3, 0.007))[1].preintMeasCov()
    assert_allclose(np.diag(P)[:3], 4e-6 * T + 0.007, rtol=1e-9)
    assert_allclose(np.diag(P)[6:], 25e-4 * T + 0.3, rtol=1e-9)


@pytest.mark.parametrize("tau", [np.inf, 5.0])
def test_biases_move_on_along_a_link_as_their_process_does(tau):
    """A walk and a Gauss-Markov process over 2 s: what becomes of a bias, and of velocity and attitude by it.

    A walk of density q gives velocity q T^3 / 3 and with it the bias -q T^2 / 2.
    """
    pytest.importorskip("gtsam", reason=MISSING)
    T, biases = 2.0, {"bias_instability": 3.0, "bias_correlation": min(tau, 1e6), "turn_on_bias_sd": 0.0}
    if tau == np.inf:
        biases["turn_on_bias_sd"] = 0.5
    imu = replace(
        IMU,
        gyro=replace(IMU.gyro, random_walk=1e-4, **biases),
        accel=replace(IMU.accel, random_walk=1e-3, **biases),
    )
    chain, measured = falling(imu, dt=[0.5] * 4)
    sd = imu.gyro.instability_sd
    left, new = chain.biases.over(T)
    kept = np.exp(-T / tau)
    assert_allclose(left, kept, rtol=1e-12)
    q = 2.0 * sd**2 / biases["bias_correlation"]
    assert_allclose(new**2, q * T if tau == np.inf else sd**2 * (1.0 - kept**2), rtol=1e-12)
    assert_allclose(chain.biases.sd, np.hypot(biases["turn_on_bias_sd"], sd), rtol=1e-12)
    chain.bias[0] = np.array([0.1, -0.2, 0.3, 0.0, 0.0, 0.0])
    prior = np.column_stack([chain.R0, np.arange(15.0)])
    chain.join(0, measured, prior, first=True)
    assert_allclose(chain.bias[1], kept * chain.bias[0], rtol=1e-12)
    moved = np.array([0.2, 0.1, -0.1, 0.03, -0.01, 0.02])
    chain.bias[1] = chain.bias[1] + moved
    A = chain.join(0, measured, prior, first=False)
    assert_allclose(A[15:], np.column_stack([chain.R0, np.zeros((15, 15)), np.arange(15.0)]))
    root = np.linalg.inv(A[:15, 15:30])
    F, Q, step = -root @ A[:15, :15], root @ root.T, root @ A[:15, 30]
    assert_allclose(step, np.append(np.zeros(9), -moved), atol=1e-9)
    assert_allclose(F[9:, 9:], kept * np.eye(6), atol=1e-9)
    on_the_way = T if tau == np.inf else tau * (1.0 - kept)
    for rows, bias, noise in ((slice(6, 9), slice(9, 12), 1e-6), (slice(3), slice(12, 15), 1e-8)):
        assert_allclose(F[rows, rows], np.eye(3), atol=1e-9)
        assert_allclose(F[rows, bias], -on_the_way * np.eye(3), rtol=0.02, atol=1e-9)
        if tau == np.inf:
            assert_allclose(Q[rows, rows], (noise * T + q * T**3 / 3.0) * np.eye(3), rtol=1e-6, atol=1e-12)
            assert_allclose(Q[rows, bias], -q * T**2 / 2.0 * np.eye(3), rtol=1e-6, atol=1e-12)
            assert_allclose(Q[bias, rows], Q[rows, bias].T, rtol=1e-9, atol=1e-15)
        assert_allclose(Q[bias, bias], new[0] ** 2 * np.eye(3), rtol=1e-6, atol=1e-12)
    assert_allclose(F[3:6, 6:9], T * np.eye(3), atol=1e-9)


def test_the_rows_of_a_fix_are_those_of_finite_differences():
    """Of the innovation by attitude, position and velocity along the body axes, antenna beside the IMU."""
    pytest.importorskip("gtsam", reason=MISSING)
    chain, _ = falling(IMU, dt=[0.5])
    chain.antenna_b = np.array([0.8, -0.3, 0.5])
    chain.bias[0] = np.array([0.0, 0.0, 0.0, 0.1, -0.2, 0.3])
    fix = np.concatenate([weaving(1.0).lla[0], [1.0, 2.0, 3.0]])
    state = chain.states[0]
    for one in chain.read_fix(0.0, fix, np.ones(6), np.array([0.4, -0.3, 0.7])):
        H, columns = chain.compare(0, one)[0], []
        for x in np.eye(9) * 1e-4:
            ends = []
            for sign in (1.0, -1.0):
                chain.states[0] = state.retract(sign * x)
                ends.append(chain.compare(0, one)[1])
            columns.append((ends[1] - ends[0]) / 2e-4)
            chain.states[0] = state
        assert_allclose(H[:, :9], np.transpose(columns), atol=1e-5)
        assert not H[:, 9:].any()


def test_a_place_that_is_refused_long_enough_opens_the_position():
    """300 m off along the third axis: three rejections, then P grows until it is expected."""
    pytest.importorskip("gtsam", reason=MISSING)
    chain, _ = falling(IMU, dt=[0.5])
    chain.gate = InnovationGate(SENSORS, 0.0, 1e-5, 0.0)
    far, none = earth.displace(weaving(1.0).lla[0], np.array([0.0, 0.0, 300.0])), np.zeros(3)
    (fix, _) = chain.read_fix(1.0, np.append(far, none), np.ones(6), none)
    prior = np.column_stack([chain.R0, np.arange(15.0)])
    H, y = chain.compare(0, fix)
    for t in (1.0, 2.0, 3.0):
        chain.gate.see_position()
        assert chain.test(fix._replace(t=t), H, y, prior) is None
    chain.gate.see_position()
    grown = chain.test(fix._replace(t=4.0), H, y, prior)
    assert_allclose(grown[:, 15], prior[:, 15])
    assert not np.tril(grown[:, :15], -1).any()
    roots = (np.linalg.inv(R[:, :15]) for R in (prior, grown))
    before, after = (root @ root.T for root in roots)
    more = H @ (after - before) @ H.T
    R = fix.C_tn @ np.diag(fix.r) @ fix.C_tn.T
    assert more[2, 2] >= 300.0**2
    assert nis(y, H @ after @ H.T + R) < 3.0
    assert_allclose(after[9:], before[9:], rtol=1e-6, atol=1e-15)
    found = chain.gate.take(last=True)[0]
    assert found.accepted.tolist() == [False] * 9 + [True] * 3
    assert_allclose(found.z[-1], 300.0, atol=10.0)  # the start is off by meters, too
    S = H @ before @ H.T + R
    assert_allclose(found.S[-3:], np.diag(fix.C_tn.T @ S @ fix.C_tn), rtol=1e-6)  # along n


def test_what_has_no_noise_has_a_little():
    """An IMU, a start and fixes without noise are as good as the least that keeps the graph regular."""
    pytest.importorskip("gtsam", reason=MISSING)
    silent = {"random_walk": 0.0, "bias_instability": 0.0, "turn_on_bias_sd": 0.0}
    imu = replace(IMU, gyro=replace(IMU.gyro, **silent), accel=replace(IMU.accel, **silent))
    chain, measured = falling(imu, dt=[0.5, 0.5])
    assert_allclose(np.diag(measured.preintMeasCov())[[0, 6]], [1e-14, 1e-12], rtol=1e-9)
    assert_allclose(chain.biases.sd, np.repeat([1e-8, 1e-10], 3), rtol=1e-12)
    assert_allclose(chain.biases.over(1.0)[1], 1e-6 * chain.biases.sd, rtol=1e-12)
    lla = weaving(1.0).lla[0]
    for one in chain.read_fix(0.0, np.append(lla, np.zeros(3)), np.zeros(6), np.zeros(3)):
        assert_allclose(one.r, 1e-12, rtol=1e-12)
    start = replace(sensors.sense(weaving(1.0), units(), 1, 0).initial, cov=np.zeros((9, 9)))
    data = sensors.sense(weaving(1.0), units(imu), 1, 0).data
    exact = factor_graph.Chain(load_gtsam(), GraphOptions(), data, start)
    assert_allclose(np.diag(exact.R0), np.repeat([1e6, 1e8, 1e10], [9, 3, 3]), rtol=1e-9)


def test_the_factor_graph_refuses_fixes_that_wander(sensed):
    """Before the flight and in a run; white ones it takes, and a record without fixes."""
    wandering = replace(GNSS, pos_h_markov_sd=3.0)
    specs, one = replace(sensed.data.specs, gnss=wandering), load("graph-smoother", {})
    line = (
        "it assumes white errors of fixes, but the errors of 'weaving-gnss' last for minutes; 'smoother' has"
    )
    with pytest.raises(EstimatorError, match=f"^filter 'graph-smoother': {line}"):
        check_needs(one, "graph-smoother", {"fixes"}, specs=specs)
    with pytest.raises(EstimatorError, match=line):
        one.run(replace(sensed.data, specs=specs), sensed.initial)
    check_needs(one, "graph-smoother", {"fixes"}, specs=sensed.data.specs)
    assert one.check_sensors(replace(specs, gnss=None)) == ""


def test_without_gtsam_one_line_says_what_to_install(sensed, monkeypatch):
    monkeypatch.setattr("bench.navigation.models.flat_frame.find_spec", lambda name: None)
    with pytest.raises(EstimatorError, match=r"pip install gtsam"):
        load("graph-smoother", {}).run(sensed.data, sensed.initial)


def test_gtsam_is_imported_by_a_run_alone():
    """One door: neither the list of filters nor their construction pays for the import."""
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
    said = load("invariant-ekf", {}).unmodeled_errors(replace(UNITS.assumed, gnss=gnss, imu=imu))
    assert set(said) == {
        *("gyro scale factor", "GNSS latency"),
        *("time-correlated GNSS position error", "time-correlated GNSS velocity error"),
    }
    assert load("invariant-ekf", {}).unmodeled_errors(replace(UNITS.assumed, imu=FINE)) == ()
