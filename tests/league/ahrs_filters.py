"""Filters of the package ahrs 0.4 (https://ahrs.readthedocs.io), with the defaults of their constructors.

All are told the initial attitude (``q0``), the World Magnetic Model at the start and each sample at its time.
Samples without a new field go to ``updateIMU``, as the documentation of each class has it.
"""

import numpy as np

from bench.core.mathematics import rotation
from tests.league.attitude_records import ENU, NED, AttitudeFilter, reference_field


class _ByUpdates(AttitudeFilter):
    """A class of ahrs with ``updateMARG`` and ``updateIMU``."""

    def begin(self, sensors, initial, q):
        self.filter = self.make()
        return q

    def step(self, q, w, f, m, dt):
        if m is None:
            return self.filter.updateIMU(q, w, f, dt=dt)
        return self.filter.updateMARG(q, w, f, 1e6 * m, dt=dt)


class Madgwick(_ByUpdates):
    """Madgwick's gradient descent; gain 0.041 with a magnetometer: ahrs/filters/madgwick.py, "gain"."""

    def make(self):
        from ahrs.filters import Madgwick as Theirs

        return Theirs(gain=self.values.get("gain", Theirs().gain_marg))


class Mahony(_ByUpdates):
    """Mahony's complementary filter; k_P 1.0 and k_I 0.3: ahrs/filters/mahony.py, "Parameters".

    Its reference of the field lies along y, so its frame is ENU.
    """

    frame = ENU

    def make(self):
        from ahrs.filters import Mahony as Theirs

        return Theirs(**self.values)


class Aqua(_ByUpdates):
    """AQUA of Valenti; alpha and beta 0.01, threshold 0.9: ahrs/filters/aqua.py, "Parameters".

    Its quaternion takes vectors from the Earth to the sensor, so it is turned round at both ends.
    """

    def make(self):
        from ahrs.filters import AQUA

        return AQUA(**self.values)

    def step(self, q, w, f, m, dt):
        return rotation.conjugate(super().step(rotation.conjugate(q), w, f, m, dt))


class AhrsEkf(AttitudeFilter):
    """EKF of ahrs in NED; variances 0.3^2, 0.5^2, 0.8^2: ahrs/filters/ekf.py, "Parameters".

    Its reference of gravity points down, so it gets gravity, the negative specific force. ``magnetic_ref`` is
    the field of the World Magnetic Model, with its declination.
    """

    frame, magnetic = NED, False

    def begin(self, sensors, initial, q):
        from ahrs.filters import EKF

        field = reference_field(sensors, initial).tolist()
        self.filter = EKF(frame="NED", magnetic_ref=field, **self.values)
        return q

    def step(self, q, w, f, m, dt):
        self.filter.mag = None if m is None else m * 1e6  # its h(q) asks this attribute whether there is one
        q = self.filter.update(q, w, -f, self.filter.mag, dt=dt)
        return q / np.linalg.norm(q)
