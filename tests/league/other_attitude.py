"""VQF (https://vqf.readthedocs.io) and Fusion of x-io (https://github.com/xioTechnologies/Fusion)."""

import numpy as np

from tests.league.attitude_records import (
    ENU,
    GRAVITY,
    AttitudeFilter,
    declination,
    fields,
    make_solution,
    rates,
)


class Vqf(AttitudeFilter):
    """VQF with its default parameters (``VQFParams``); it cannot be told an initial attitude.

    Sampling times: those of the IMU and the magnetometer, "updateGyr", "updateAcc", "updateMag" of its
    documentation.
    """

    frame, name = ENU, "VQF"

    def begin(self, sensors, initial, q):
        import vqf

        step = float(np.median(sensors.imu.dt))
        mag_step = step if sensors.mag is None else float(np.median(np.diff(sensors.mag.t)))
        self.with_mag = sensors.mag is not None
        self.filter = getattr(vqf, self.name)(step, magTs=mag_step, **self.values)
        return q

    def step(self, q, w, f, m, dt):
        self.filter.updateGyr(w)
        self.filter.updateAcc(f)
        if m is not None:
            self.filter.updateMag(m * 1e6)
        return self.filter.getQuat9D() if self.with_mag else self.filter.getQuat6D()


class BasicVqf(Vqf):
    """BasicVQF: without estimation of biases, rest detection and rejection of magnetic disturbances."""

    name = "BasicVQF"


class OfflineVqf:
    """``offlineVQF`` with its default parameters: a smoother, which uses the whole record.

    It needs a field with each sample: those between two measurements are interpolated.
    """

    def run(self, sensors, initial):
        from vqf import offlineVQF

        gyro, accel = rates(sensors.imu)
        field, turn = fields(sensors), declination(sensors, initial)
        known = np.isfinite(field[:, 0])
        mag = np.stack(
            [np.interp(sensors.imu.t, sensors.imu.t[known], one[known]) for one in field.T], axis=1
        )
        step = float(np.median(sensors.imu.dt))
        one = [np.ascontiguousarray(each) for each in (gyro, accel, 1e6 * mag)]
        return make_solution(sensors, initial, offlineVQF(*one, step)["quat9D"], ENU, turn)


class Fusion(AttitudeFilter):
    """AHRS of x-io with the settings and the bias algorithm of its example.

    Examples/Python/complete_example.py: NWU, gain 0.5, range 2000 deg/s, rejections 10 deg, timeout 5 s.
    Without a field, a zero vector, as FusionAhrs.c has it. The convention must stay NWU: the constructor of
    imufusion 1.3.3 takes another one and keeps NWU.
    """

    def begin(self, sensors, initial, q):
        import imufusion

        rate = 1.0 / float(np.median(sensors.imu.dt))
        self.filter, self.bias = imufusion.Ahrs(), imufusion.Bias()
        self.filter.set_settings(
            imufusion.AhrsSettings(
                rate, imufusion.CONVENTION_NWU, self.values.get("gain", 0.5), 2000.0, 10.0, 10.0, 5.0
            )
        )
        self.bias.set_settings(imufusion.BiasSettings(rate))
        self.filter.skip_startup()
        self.filter.set_quaternion(q)
        return q

    def step(self, q, w, f, m, dt):
        self.filter.set_sample_period(dt)
        gyro = self.bias.update(np.rad2deg(w))
        self.filter.update(gyro, f / GRAVITY, np.zeros(3) if m is None else m * 1e6)
        return self.filter.get_quaternion()
