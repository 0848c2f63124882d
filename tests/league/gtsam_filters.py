"""Filters of gtsam 4.3 (https://gtsam.org): its map is flat, so flights stay within 10 km of the start.

The map has the axes north, east, down of the start, a constant gravity and no Earth rate, as gtsam has it.
"""

from dataclasses import replace

import numpy as np
from scipy.linalg import block_diag

from bench.navigation.filter_adapters import nothing_known
from bench.navigation.models.flat_frame import FlatFrame
from tests.league.position_records import bias_model, causal_fixes, output_rows

_INTEGRATION = 1e-8  # variance of integration: CombinedImuFactorsExample.cpp, "integration_error_cov"
_LAG = 8.0  # [s], eight fixes a second apart: FixedLagSmootherExample.cpp keeps eight nodes
_EYE = np.eye(3)


def _make_solution(sensors, found):
    """Return the solution of states and covariances that `FlatFrame.answer` returned, one per output."""
    out = np.stack([state for state, _ in found])
    return replace(
        nothing_known(sensors.output_t),
        lla=out[:, :3], vel_n=out[:, 3:6], q_nb=out[:, 6:10], cov=np.stack([cov for _, cov in found]),
    )  # fmt: skip


def _set_noise(params, imu):
    params.setGyroscopeCovariance(_EYE * bias_model(imu.gyro)[1] ** 2)
    params.setAccelerometerCovariance(_EYE * bias_model(imu.accel)[1] ** 2)
    params.setIntegrationCovariance(_EYE * _INTEGRATION)
    return params


class GtsamFixedLag:
    """IncrementalFixedLagSmoother over 8 s with CombinedImuFactor, and a node at each fix.

    Noise of the IMU and of its biases by the datasheet; of a fix as reported. Errors of fixes that last, the
    scale factors of the IMU and outliers have no model.
    """

    needs = ("fixes",)

    def run(self, sensors, initial):
        import gtsam

        self.gtsam, self.frame, self.sensors = gtsam, FlatFrame.at(initial.lla, False), sensors
        self.begin(initial)
        fixes, outputs = causal_fixes(sensors), output_rows(sensors)
        imu, found, j, k = sensors.imu, [], 0, 0
        for row in range(-1, len(imu.t)):
            if row >= 0:
                dt = float(imu.dt[row])
                if np.isfinite(imu.dvel_b[row]).all() and np.isfinite(imu.dtheta_b[row]).all():
                    self.sums.integrateMeasurement(imu.dvel_b[row] / dt, imu.dtheta_b[row] / dt, dt)
            while j < len(fixes) and fixes[j][0] <= row:
                if fixes[j][0] == row:
                    self.add_fix(fixes[j], float(imu.t[row]), imu.dtheta_b[row] / imu.dt[row])
                j += 1
            while k < len(outputs) and outputs[k] <= row:
                found.append(self.answer())
                k += 1
        return _make_solution(sensors, found)

    def begin(self, initial):
        gtsam, imu = self.gtsam, self.sensors.specs.imu
        params = gtsam.PreintegrationCombinedParams(self.frame.g_t)
        _set_noise(params, imu)
        accel, gyro = bias_model(imu.accel), bias_model(imu.gyro)
        params.setBiasAccCovariance(_EYE * max(accel[2], 1e-9) ** 2)
        params.setBiasOmegaCovariance(_EYE * max(gyro[2], 1e-12) ** 2)
        C_tb, p_t, v_t, P = self.frame.begin(initial)
        sd = np.maximum(np.repeat([accel[0], gyro[0]], 3), 1e-9)
        self.state, self.bias = gtsam.NavState(gtsam.Rot3(C_tb), p_t, v_t), gtsam.imuBias.ConstantBias()
        self.P = block_diag(P, np.diag(sd**2))
        self.sums = gtsam.PreintegratedCombinedMeasurements(params, self.bias)
        settings = gtsam.ISAM2Params()
        settings.setRelinearizeThreshold(0.0)  # this and the next: FixedLagSmootherExample.cpp
        settings.relinearizeSkip = 1
        settings.setFactorization("QR")  # Cholesky finds biases in SI units indeterminate
        self.smoother = gtsam.IncrementalFixedLagSmoother(_LAG, settings)
        noise, (x, v, b) = gtsam.noiseModel, self.keys(0)
        graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
        graph.push_back(gtsam.PriorFactorPose3(x, self.state.pose(), noise.Gaussian.Covariance(P[:6, :6])))
        graph.push_back(gtsam.PriorFactorVector(v, v_t, noise.Gaussian.Covariance(C_tb @ P[6:, 6:] @ C_tb.T)))
        graph.push_back(gtsam.PriorFactorConstantBias(b, self.bias, noise.Diagonal.Sigmas(sd)))
        self.insert(values, (x, v, b), self.state)
        self.smoother.update(graph, values, dict.fromkeys((x, v, b), initial.t))
        self.node = 0

    def keys(self, node):
        return tuple(self.gtsam.symbol(letter, node) for letter in "xvb")

    def insert(self, values, keys, state):
        values.insert(keys[0], state.pose())
        values.insert(keys[1], state.velocity())
        values.insert(keys[2], self.bias)

    def add_fix(self, fix, t, rate):
        """Close the preintegration with a node at a fix, and smooth."""
        gtsam, noise = self.gtsam, self.gtsam.noiseModel
        _, lla, vel_n, r_pos, r_vel = fix
        p_t, C_tn = self.frame.locate(lla)
        of_pos, of_vel = (noise.Gaussian.Covariance(C_tn @ np.diag(r) @ C_tn.T) for r in (r_pos, r_vel))
        before, (x, v, b) = self.keys(self.node), self.keys(self.node + 1)
        ahead = self.sums.predict(self.state, self.bias)
        w_b, arm_b = rate - self.bias.gyroscope(), self.sensors.antenna_b
        v_t = C_tn @ vel_n - ahead.attitude().matrix() @ np.cross(w_b, arm_b)
        graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
        graph.push_back(gtsam.CombinedImuFactor(*before[:2], x, v, before[2], b, self.sums))
        graph.push_back(gtsam.GPSFactorArm(x, p_t, arm_b, of_pos))
        graph.push_back(gtsam.PriorFactorVector(v, v_t, of_vel))
        self.insert(values, (x, v, b), ahead)
        self.smoother.update(graph, values, dict.fromkeys((x, v, b), t))
        best = self.smoother.calculateEstimate()
        self.state = gtsam.NavState(best.atPose3(x), best.atVector(v))
        self.bias, self.node = best.atConstantBias(b), self.node + 1
        turn = block_diag(np.eye(6), self.state.attitude().matrix().T, np.eye(6))
        self.P = turn @ self.covariance(best, (x, v, b)) @ turn.T
        self.sums.resetIntegrationAndSetBias(self.bias)

    def covariance(self, best, last):
        """Return the joint covariance (15, 15) of a node, by QR of the factors: `Marginals` has no QR."""
        ordering = self.gtsam.Ordering()
        for key in [key for key in best.keys() if key not in last] + list(last):  # noqa: SIM118
            ordering.push_back(key)
        A, _ = self.smoother.getFactors().linearize(best).jacobian(ordering)
        root = np.linalg.inv(np.linalg.qr(A, mode="r")[-15:, -15:])
        return root @ root.T

    def answer(self):
        """Return state and covariance predicted from the last node."""
        F, G = np.zeros((9, 9), order="F"), np.zeros((9, 6), order="F")
        now, both, Q = self.state, np.eye(9, 15), np.zeros((9, 9))
        if self.sums.deltaTij() > 0.0:
            now = self.sums.predict(self.state, self.bias, F, G)
            both = np.hstack([F, G])
            C = self.sums.deltaRij().matrix().T
            turn = block_diag(_EYE, C, C)
            Q = turn @ self.sums.preintMeasCov()[:9, :9] @ turn.T
        P = both @ self.P @ both.T + Q
        return self.frame.answer(now.attitude().matrix(), now.position(), now.velocity(), P)


class GtsamGal3Ekf:
    """Gal3ImuEKF, mode TRACK_TIME_NO_COVARIANCE (its default): no states for biases.

    Noise of the IMU by the datasheet; a fix updates position and velocity with its reported covariance.
    """

    needs = ("fixes",)

    def run(self, sensors, initial):
        import gtsam

        frame, imu = FlatFrame.at(initial.lla, False), sensors.imu
        C_tb, p_t, v_t, P = frame.begin(initial)
        order = np.r_[0:3, 6:9, 3:6]  # attitude, velocity, position: Gal3ImuEKF.cpp
        P0 = np.zeros((10, 10))
        P0[:9, :9] = P[np.ix_(order, order)]
        params = _set_noise(gtsam.PreintegrationParams(frame.g_t), sensors.specs.imu)
        ekf = gtsam.Gal3ImuEKF(gtsam.Gal3(gtsam.Rot3(C_tb), p_t, v_t, initial.t), P0, params)
        fixes, outputs = causal_fixes(sensors), output_rows(sensors)
        found, j, k = [], 0, 0
        for row in range(-1, len(imu.t)):
            if row >= 0 and np.isfinite(imu.dvel_b[row]).all() and np.isfinite(imu.dtheta_b[row]).all():
                dt = float(imu.dt[row])
                ekf.predict(imu.dtheta_b[row] / dt, imu.dvel_b[row] / dt, dt)
            while j < len(fixes) and fixes[j][0] <= row:
                if fixes[j][0] == row:
                    self.update(ekf, frame, fixes[j], sensors.antenna_b, imu.dtheta_b[row] / imu.dt[row])
                j += 1
            while k < len(outputs) and outputs[k] <= row:
                X, J = ekf.state(), self.differentiate(ekf.state(), self.difference)
                P9 = J @ ekf.covariance() @ J.T
                found.append(frame.answer(X.rotation().matrix(), X.translation(), X.velocity(), P9))
                k += 1
        return _make_solution(sensors, found)

    def update(self, ekf, frame, fix, arm_b, w_b):
        _, lla, vel_n, r_pos, r_vel = fix
        p_t, C_tn = frame.locate(lla)

        def measure(_, X):
            C = X.rotation().matrix()
            return np.concatenate([X.translation() + C @ arm_b, X.velocity() + C @ np.cross(w_b, arm_b)])

        X = ekf.state()
        R = block_diag(C_tn @ np.diag(r_pos) @ C_tn.T, C_tn @ np.diag(r_vel) @ C_tn.T)
        z, H = np.concatenate([p_t, C_tn @ vel_n]), self.differentiate(X, measure)
        ekf.updateWithVector(measure(X, X), H, z, R)

    @staticmethod
    def difference(X, other):
        """Return the error (9,) that `FlatFrame.answer` takes: attitude, position, velocity, body axes."""
        C = X.rotation().matrix()
        turn = X.rotation().logmap(other.rotation())
        moved = [C.T @ (other.translation() - X.translation()), C.T @ (other.velocity() - X.velocity())]
        return np.concatenate([turn, *moved])

    @staticmethod
    def differentiate(X, function, step=1e-5):
        """Return the derivative of function(X, X') with respect to the ten coordinates of X'."""
        moves = step * np.eye(10)
        rises = [function(X, X.retract(one)) - function(X, X.retract(-one)) for one in moves]
        return np.stack(rises, axis=1) / (2.0 * step)
