"""How noisy the IMU of `tests/logs` is in the car: ``python -m tests.tools.driving_noise [FROM TO]``.

A strapdown without aiding starts every T seconds from the state of the smoother. How far its attitude and
velocity move from the smoother, over sqrt(T), is the noise of each axis. The smoother knows the tilt to
0.05 deg and the velocity to 0.02 m/s, so that only 10 s and more tell the noise of the IMU. Vertical velocity
alone shows the accelerometers; sideways and forward it is the tilt that counts.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np

from bench.core.mathematics import rotation
from bench.core.mathematics.units import STANDARD_GRAVITY
from bench.navigation.estimator import answer
from bench.navigation.mechanization import propagate
from bench.pipeline.log_pipeline import Session, find_start, read_log

LOG = Path(__file__).parents[1] / "logs" / "drive.toml"
SPANS = (10, 20)  # [s]


def growth(first: float, last: float, span: int) -> np.ndarray:
    """Return gyro noise, b [rad/sqrt(s)] (3), and that of the vertical accelerometer [m/s/sqrt(s)]."""
    sheet = LOG.with_name("icm-45686-on-the-roof.toml")
    log = read_log(LOG, estimators=["smoother"], overrides={"sensors.assumed.imu": str(sheet)})
    session = Session(log.spec, log.records, find_start(log.records, log.spec))
    data = session.make_data(np.ones(len(session.fixes), np.bool_), np.arange(first, last + 0.5))
    smooth = answer(log.estimators["smoother"], "smoother", data, session.initial)
    imu, errors = data.imu, []
    for i in range(0, len(smooth.t) - span, span):
        j = i + span
        rows = (imu.t > smooth.t[i] + 1e-6) & (imu.t < smooth.t[j] + 1e-6)
        dt = imu.dt[rows]
        dtheta = imu.dtheta_b[rows] - smooth.gyro_bias_b[i] * dt[:, None]
        dvel = imu.dvel_b[rows] - smooth.accel_bias_b[i] * dt[:, None]
        end = propagate(smooth.lla[i], smooth.vel_n[i], smooth.q_nb[i], dt, dtheta, dvel)[-1]
        turn = rotation.to_rotvec(rotation.multiply(rotation.conjugate(smooth.q_nb[j]), end[6:10]))
        errors.append([*turn, end[5] - smooth.vel_n[j, 2]])
    return np.asarray(np.sqrt(np.mean(np.square(errors), axis=0) / span))


if __name__ == "__main__":
    first, last = (float(word) for word in sys.argv[1:3] or ("70", "300"))
    for span in SPANS:
        found = growth(first, last, span)
        gyro = np.rad2deg([*found[:3], np.sqrt(np.mean(found[:3] ** 2))])
        axes = ", ".join(f"{sd:.3f}" for sd in gyro[:3])
        print(
            f"{first:g} to {last:g} s, over {span} s: gyros {axes} deg/s/sqrt(Hz), rms {gyro[3]:.3f}; "
            f"vertical accelerometer {1e6 * found[3] / STANDARD_GRAVITY:.0f} ug/sqrt(Hz)"
        )
