"""python-ins 1.0 (https://pyins.readthedocs.io), a filter over a whole record."""

from dataclasses import replace

import numpy as np

from bench.core.mathematics import rotation
from bench.navigation.filter_adapters import nothing_known
from tests.league.position_records import bias_model, causal_fixes

_RPH = ["roll", "pitch", "heading"]


class PythonIns:
    """``run_feedback_filter`` of python-ins with a covariance at 1 Hz, as in pyins/tests/test_filters.py.

    Biases of the IMU by the datasheet ("EstimationModel"); of the fixes, the median of the reported
    variances. It reports standard deviations only, so the covariance here is diagonal, in roll, pitch and
    heading turned to the axes of the errors.
    """

    needs = ("fixes",)

    def run(self, sensors, initial):
        import pandas as pd
        from pyins import filters, inertial_sensor, measurements, strapdown

        imu, fixes = sensors.imu, causal_fixes(sensors)
        t = np.array([imu.t[row] for row, *_ in fixes])
        lla = np.array([one[1] for one in fixes]) * [180 / np.pi, 180 / np.pi, 1.0]
        vel = np.array([one[2] for one in fixes])
        sd_pos, sd_vel = (np.sqrt(np.median([one[k] for one in fixes], axis=0)) for k in (3, 4))
        roll, pitch, heading = np.rad2deg(rotation.to_euler(initial.q_nb))
        names = ["lat", "lon", "alt", "VN", "VE", "VD", *_RPH]
        start = [*np.rad2deg(initial.lla[:2]), initial.lla[2], *initial.vel_n, roll, pitch, heading]
        values = np.hstack([imu.dtheta_b, imu.dvel_b])
        record = pd.DataFrame(
            np.vstack([values[:1], values]), index=[initial.t, *imu.t],
            columns=["gyro_x", "gyro_y", "gyro_z", "accel_x", "accel_y", "accel_z"],
        )  # fmt: skip
        sd = np.sqrt(np.diag(initial.cov))
        models = []
        for triad in (sensors.specs.imu.gyro, sensors.specs.imu.accel):
            bias, noise, walk = bias_model(triad)
            models.append(inertial_sensor.EstimationModel(bias_sd=bias, noise=noise, bias_walk=walk))
        arm = sensors.antenna_b
        result = filters.run_feedback_filter(
            pd.Series(start, index=names, name=initial.t), sd[0], sd[3], np.rad2deg(sd[6]), np.rad2deg(sd[8]),
            strapdown.compute_increments_from_imu(record, "increment"), *models,
            [
                measurements.Position(pd.DataFrame(lla, index=t, columns=names[:3]), sd_pos, arm),
                measurements.NedVelocity(pd.DataFrame(vel, index=t, columns=names[3:6]), sd_vel, arm),
            ],
            time_step=1.0,
        )  # fmt: skip
        return self.answer(sensors, result)

    def answer(self, sensors, result):
        rows = np.searchsorted(result.trajectory.index, sensors.output_t + 1e-9) - 1
        state = result.trajectory.to_numpy()[np.maximum(rows, 0)]
        t_sd = result.trajectory_sd.index.to_numpy()
        sd = result.trajectory_sd.to_numpy()[np.searchsorted(t_sd, sensors.output_t + 1e-9) - 1]
        roll, pitch, heading = np.deg2rad(state[:, 6:9]).T
        cov = np.zeros((len(state), 9, 9))
        for k, one in enumerate(sd):
            c, s, cp = np.cos(heading[k]), np.sin(heading[k]), np.cos(pitch[k])
            E = np.array([[c * cp, -s, 0.0], [s * cp, c, 0.0], [-np.sin(pitch[k]), 0.0, 1.0]])
            cov[k, :6, :6] = np.diag(one[:6] ** 2)
            cov[k, 6:, 6:] = E @ np.diag(np.deg2rad(one[6:9]) ** 2) @ E.T
        return replace(
            nothing_known(sensors.output_t),
            lla=state[:, :3] * [np.pi / 180, np.pi / 180, 1.0], vel_n=state[:, 3:6],
            q_nb=rotation.from_euler(roll, pitch, heading), cov=cov,
        )  # fmt: skip
