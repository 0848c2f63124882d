"""Each package reproduces the figure that its authors publish: a row of the league counts only then."""

from itertools import pairwise

import numpy as np
import pytest
from scipy.optimize import least_squares


@pytest.fixture(scope="module")
def turning():
    """Rates, attitudes and field as tests/test_estimators.py of ahrs makes them: noise of 0.01."""
    ahrs = pytest.importorskip("ahrs", reason="ahrs is not installed (extra 'league')")
    rng = np.random.default_rng(5)
    rates = np.zeros((1000, 3))
    for axis in range(3):
        for _ in range(3):
            first, last = np.sort(rng.integers(0, 1000, 2))
            rates[first:last, axis] = rng.uniform(-np.pi, np.pi)
    smooth = np.hanning(50) / np.hanning(50).sum()
    rates = np.stack([np.convolve(one, smooth, "same") for one in rates.T], axis=1)
    q = ahrs.QuaternionArray(ahrs.filters.AngularRate(rates).Q)
    return ahrs, rng, rates, q, q.to_DCM()


def measure(turning, vector):
    _, rng, _, _, C = turning
    return np.einsum("kji,j->ki", C, vector) + 0.01 * rng.standard_normal((len(C), 3))


@pytest.mark.parametrize(("name", "enu"), [("Mahony", True), ("EKF", False)])
def test_ahrs_stays_below_the_error_of_its_own_tests(turning, name, enu):
    """tests/test_estimators.py, TestMahony.test_marg and TestEKF.test_gyr_acc_mag: mean QAD below 0.1."""
    ahrs, rng, rates, q, _ = turning
    wmm = ahrs.utils.WMM(
        latitude=ahrs.MUNICH_LATITUDE, longitude=ahrs.MUNICH_LONGITUDE, height=ahrs.MUNICH_HEIGHT
    )
    field = np.array([wmm.Y, wmm.X, -wmm.Z] if enu else [wmm.X, wmm.Y, wmm.Z])
    gyro = rates + 0.01 * rng.standard_normal(rates.shape)
    accel, mag = measure(turning, np.array([0.0, 0.0, 9.8])), measure(turning, field)
    found = getattr(ahrs.filters, name)(gyr=gyro, acc=accel, mag=mag).Q
    assert np.nanmean(ahrs.utils.metrics.qad(q, found)) < 0.1
    wrong = found * [1.0, -1.0, -1.0, -1.0]
    assert np.nanmean(ahrs.utils.metrics.qad(q, wrong)) > 0.1


@pytest.mark.parametrize("name", ["Madgwick", "AQUA"])
def test_ahrs_finds_the_level_of_a_resting_sensor(name):
    """The documentation of both: with the sensor at rest, the estimate converges to the measured gravity."""
    ahrs = pytest.importorskip("ahrs", reason="ahrs is not installed (extra 'league')")
    C = ahrs.Quaternion([0.98, 0.15, -0.1, 0.0]).to_DCM()
    accel = np.tile(9.8 * C.T @ [0.0, 0.0, 1.0], (6000, 1))
    gyro, start = np.full((6000, 3), 1e-9), np.array([1.0, 0.0, 0.0, 0.0])
    q = getattr(ahrs.filters, name)(gyr=gyro, acc=accel, q0=start).Q[-1]
    R = ahrs.Quaternion(q).to_DCM()
    up = R.T @ [0.0, 0.0, 1.0] if name == "Madgwick" else R @ [0.0, 0.0, 1.0]
    np.testing.assert_allclose(up, accel[0] / 9.8, atol=2e-3)


def test_vqf_equals_its_reference_in_python():
    """tests/test_implementation_comparison.py of vqf: both implementations agree to 7 decimals."""
    vqf = pytest.importorskip("vqf", reason="vqf is not installed (extra 'league')")
    rng = np.random.default_rng(3)
    gyro = np.concatenate([np.zeros((300, 3)), np.repeat(rng.normal(size=(4, 3)), 100, axis=0)])
    gyro = gyro + 0.01 * rng.normal(size=gyro.shape)
    accel = np.tile([0.3, 0.2, 9.8], (700, 1)) + 0.05 * rng.normal(size=gyro.shape)
    mag = np.tile([5.0, 20.0, -40.0], (700, 1)) + 0.2 * rng.normal(size=gyro.shape)
    out, ref = (make(0.01).updateBatch(gyro, accel, mag) for make in (vqf.VQF, vqf.PyVQF))
    for name in ("quat6D", "quat9D", "bias", "restDetected"):
        np.testing.assert_almost_equal(out[name], ref[name])
    assert out["restDetected"].any()


def test_fusion_at_rest_has_the_heading_of_its_compass():
    """Examples/Python/compass_vs_ahrs.py of Fusion: without disturbance both headings agree."""
    imufusion = pytest.importorskip("imufusion", reason="imufusion is not installed (extra 'league')")
    accel, mag = np.array([0.1, -0.2, 0.97]), np.array([15.0, 8.0, -40.0])
    filter_ = imufusion.Ahrs()
    for _ in range(3000):
        filter_.update(np.zeros(3), accel, mag)
    heading = imufusion.quaternion_to_euler(filter_.get_quaternion())[2]
    assert abs(heading - imufusion.compass(accel, mag)) < 0.01


POSES = [
    (0.995821, 0.0231012, 0.0300001), (1.49284, 0.0457247, 0.045), (1.98981, 0.0758879, 0.06),
    (2.48627, 0.113502, 0.075), (2.98211, 0.158558, 0.09), (3.47722, 0.211047, 0.105),
    (3.97149, 0.270956, 0.12), (4.4648, 0.338272, 0.135), (4.95705, 0.41298, 0.15),
    (5.44812, 0.495063, 0.165), (5.9379, 0.584503, 0.18),
]  # fmt: skip
"""Poses of FixedLagSmootherExample.cpp, as python/gtsam/tests/test_FixedLagSmootherExample.py has them."""


def relate(a, b):
    """Return b relative to a, poses (x, y, angle)."""
    (c, s), d = (np.cos(a[2]), np.sin(a[2])), b[:2] - a[:2]
    return np.array([c * d[0] + s * d[1], c * d[1] - s * d[0], b[2] - a[2]])


def take_logarithm(pose):
    """Return the coordinates (3,) of a pose near the identity: the log map of SE(2)."""
    half = 0.5 * pose[2]
    k = half / np.tan(half) if half else 1.0
    return np.array([k * pose[0] + half * pose[1], k * pose[1] - half * pose[0], pose[2]])


ODOMETRY = (((0.61, -0.08, 0.02), 0.1), ((0.47, 0.03, 0.01), 0.05))


def find_residuals(x):
    """Return the residuals of the example after two steps."""
    poses = x.reshape(-1, 3)
    found = [take_logarithm(poses[0]) / [0.3, 0.3, 0.1]]
    for a, b in pairwise(poses):
        for pose, noise in ODOMETRY:
            found.append(take_logarithm(relate(np.array(pose), relate(a, b))) / [noise, noise, 0.05])
    return np.concatenate(found)


def test_gtsam_gives_the_poses_of_its_example():
    """Within 3 mm: the published poses are not the minimum, which the first pose is, by a second solution."""
    gtsam = pytest.importorskip("gtsam", reason="gtsam is not installed (extra 'league')")
    settings, sd = gtsam.ISAM2Params(), gtsam.noiseModel.Diagonal.Sigmas
    settings.setRelinearizeThreshold(0.0)
    settings.relinearizeSkip = 1
    smoother = gtsam.IncrementalFixedLagSmoother(2.0, settings)
    graph, values, times = gtsam.NonlinearFactorGraph(), gtsam.Values(), {0: 0.0}
    graph.push_back(gtsam.PriorFactorPose2(0, gtsam.Pose2(), sd(np.array([0.3, 0.3, 0.1]))))
    values.insert(0, gtsam.Pose2())
    found = []
    for k in range(1, 13):
        values.insert(k, gtsam.Pose2(0.5 * k, 0.0, 0.0))
        times[k] = 0.25 * k
        for pose, noise in ODOMETRY:
            model = sd(np.array([noise, noise, 0.05]))
            graph.push_back(gtsam.BetweenFactorPose2(k - 1, k, gtsam.Pose2(*pose), model))
        if k > 1:
            smoother.update(graph, values, times)
            smoother.update()
            pose = smoother.calculateEstimatePose2(k)
            found.append((pose.x(), pose.y(), pose.theta()))
            graph, values, times = gtsam.NonlinearFactorGraph(), gtsam.Values(), {}
    np.testing.assert_allclose(found, POSES, atol=3e-3)
    best = least_squares(find_residuals, np.zeros(9), xtol=1e-14, ftol=1e-14, gtol=1e-14).x
    np.testing.assert_allclose(found[0], best[-3:], atol=1e-6)


def test_the_ekf_of_gtsam_integrates_constant_motion_exactly():
    """Gal3ImuEKF.cpp: Dynamics is exact for constant rate and specific force over the interval."""
    gtsam = pytest.importorskip("gtsam", reason="gtsam is not installed (extra 'league')")
    params = gtsam.PreintegrationParams(np.array([0.0, 0.0, 9.81]))
    ekf = gtsam.Gal3ImuEKF(gtsam.Gal3(), 1e-4 * np.eye(10), params)
    for _ in range(200):
        ekf.predict(np.zeros(3), np.array([1.0, 0.0, -9.81]), 0.01)
    X = ekf.state()
    np.testing.assert_allclose(X.translation(), [2.0, 0.0, 0.0], atol=1e-9)
    np.testing.assert_allclose(X.velocity(), [2.0, 0.0, 0.0], atol=1e-9)


@pytest.mark.long
@pytest.mark.filterwarnings("ignore")
def test_python_ins_passes_the_figures_of_its_own_test():
    """pyins/tests/test_filters.py in the wheel: RMS of error over sigma below 1.5 for all nine errors."""
    tests = pytest.importorskip("pyins.tests.test_filters", reason="python-ins is not installed")
    tests.test_run_feedback_filter(True)
