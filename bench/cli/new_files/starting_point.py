"""A loosely coupled INS/GNSS filter in plain NumPy, as a starting point for your own.

Fifteen error states, estimate minus truth: position [m], velocity [m/s] and attitude phi [rad] along north,
east, down; gyro bias [rad/s] and accelerometer bias [m/s^2] along the body axes. From one fix or output to
the next, a compiled strapdown propagates the navigation state, and one step propagates the covariance. A fix
measures position and velocity; the estimated errors are fed back at once: the tilt first, then the heading,
with which the axes of the tilts in P turn. The barometer is not used.
"""

import numpy as np

from bench.core.mathematics import earth, rotation
from bench.core.mathematics.arrays import FloatArray
from bench.core.records.data import Events, InitialState, Innovations, NavSolution, SensorData
from bench.core.records.sensor_specs import AssumedSpecs
from bench.navigation.engine import timeline
from bench.navigation.error_state_filter.error_state import dynamics
from bench.navigation.mechanization import propagate
from bench.navigation.start import alignment

SENSORS = ("gnss_position", "gnss_velocity")
BIASES = (("gyro_bias", "rad_s"), ("accel_bias", "m_s2"))
EXTRA = tuple(f"{name}_{axis}_{unit}" for name, unit in BIASES for axis in "xyz")


class StartingPoint:
    """IMU and GNSS fixes, closed loop.

    Parameters
    ----------
    gate : float
        Largest NIS of an accepted position or velocity; chi-square with 3 degrees of freedom.
    """

    def __init__(self, *, gate: float = 25.9) -> None:
        if not gate > 0:
            raise ValueError(f"gate = {gate!r} must be positive")
        self.gate = gate

    def run(self, sensors: SensorData, initial: InitialState) -> NavSolution:
        """Estimate position, velocity, attitude and biases at ``sensors.output_t``."""
        initial, aligned = alignment.complete(sensors, initial)
        rows, span, events = timeline.imu_rows(sensors.imu, initial.t, sensors.specs.imu)
        events += aligned
        t = sensors.imu.t[rows]
        stretch = (span / sensors.imu.dt[rows])[:, None]  # bridges missing rows
        dtheta, dvel = sensors.imu.dtheta_b[rows] * stretch, sensors.imu.dvel_b[rows] * stretch
        fix_rows, fix_at = np.empty(0, np.int64), np.empty(0, np.int64)
        R = np.zeros((6, 6))
        if sensors.fixes is not None:
            R = _make_fix_covariance(sensors.specs)
            fix_rows, fix_at, left_out = timeline.fix_rows(sensors.fixes, t, initial.t)
            events += left_out
        fixes = dict(zip(fix_at.tolist(), fix_rows.tolist(), strict=True))  # by IMU sample
        end = t[-1] if len(t) else initial.t
        slack = timeline.TIME_TOLERANCE
        served = (sensors.output_t >= initial.t - slack) & (sensors.output_t <= end + slack)
        output_at = np.searchsorted(t, sensors.output_t - slack)
        output_at[sensors.output_t < initial.t + slack] = -1  # the start itself
        outputs = {int(k): row for row, k in enumerate(output_at) if served[row]}

        nav = np.concatenate([initial.lla, initial.vel_n, initial.q_nb])
        gyro_bias, accel_bias = np.zeros(3), np.zeros(3)
        P, q = _make_start(initial, sensors.specs)
        before = np.zeros(7)
        out = np.full((len(sensors.output_t), 16), np.nan)
        out_P = np.full((len(sensors.output_t), 15, 15), np.nan)
        innovations: list[tuple[float, int, int, float, float, float, bool]] = []
        turn, dt, done = dtheta[:1], span[:1], -1
        for k in sorted({*fixes, *outputs}):
            if k > done:
                part = slice(done + 1, k + 1)
                dt = span[part]
                turn, push = dtheta[part] - gyro_bias * dt[:, None], dvel[part] - accel_bias * dt[:, None]
                states = propagate(nav[:3], nav[3:6], nav[6:], dt, turn, push, before)
                T = dt.sum()
                C = rotation.matrix(states[len(states) // 2, 6:])
                F = np.zeros((15, 15))
                F[:9] = dynamics(nav, C, C @ push.sum(axis=0) / T)
                Phi = np.eye(15) + F * T + F @ F * (0.5 * T * T)
                P = Phi @ P @ Phi.T + np.diag(q * T)
                nav, done = states[-1], k
            if k in fixes and sensors.fixes is not None:
                row = fixes[k]
                z, H = _place_antenna(nav, sensors.antenna_b, turn[-1] / dt[-1])
                z[:3] += earth.difference_n(nav[:3], sensors.fixes.lla[row])
                z[3:] += nav[3:6] - sensors.fixes.vel_n[row]
                x = np.zeros(15)
                for code in (0, 1) if np.isfinite(z[3:]).all() else (0,):  # a fix may have no velocity
                    use = slice(3 * code, 3 * code + 3)
                    y = z[use] - H[use] @ x
                    S = H[use] @ P @ H[use].T + R[use, use]
                    nis = float(y @ np.linalg.solve(S, y))
                    now = t[k] if k >= 0 else initial.t
                    innovations += [(now, code, i, -y[i], S[i, i], nis, nis <= self.gate) for i in range(3)]
                    if nis <= self.gate:
                        K = np.linalg.solve(S, H[use] @ P).T
                        x += K @ y
                        J = np.eye(15) - K @ H[use]
                        P = J @ P @ J.T + K @ R[use, use] @ K.T
                nav[:3] = earth.displace(nav[:3], -x[:3])
                nav[3:6] -= x[3:6]
                level = rotation.multiply(rotation.from_rotvec([-x[6], -x[7], 0.0]), nav[6:])
                heading = rotation.from_rotvec([0.0, 0.0, -x[8]])
                nav[6:] = rotation.multiply(heading, level)
                axes = np.eye(15)
                axes[6:9, 6:9] = rotation.matrix(heading)
                P = axes @ P @ axes.T
                gyro_bias, accel_bias = gyro_bias - x[9:12], accel_bias - x[12:]
            if k in outputs:
                out[outputs[k]] = np.concatenate([nav, gyro_bias, accel_bias])
                out_P[outputs[k]] = 0.5 * (P + P.T)
        return NavSolution(
            t=sensors.output_t,
            lla=out[:, :3],
            vel_n=out[:, 3:6],
            q_nb=out[:, 6:10],
            gyro_bias_b=out[:, 10:13],
            accel_bias_b=out[:, 13:],
            cov=out_P[:, :9, :9],
            extra_names=EXTRA,
            extra=out[:, 10:],
            extra_sd=np.sqrt(np.einsum("kii->ki", out_P)[:, 9:]),
            innovations=Innovations.from_rows(SENSORS, innovations),
            events=Events.from_rows(events),
        )


def _make_start(initial: InitialState, specs: AssumedSpecs) -> tuple[FloatArray, FloatArray]:
    """Return the initial P (15, 15) and the noise densities q (15,), from the datasheets."""
    P, q = np.zeros((15, 15)), np.zeros(15)
    P[:9, :9] = initial.cov
    P[:9, 9:], P[9:, :9] = (
        initial.bias_cov,
        initial.bias_cov.T,
    )  # tilt from a biased accelerometer is correlated with the bias
    gyro, accel = specs.imu.gyro, specs.imu.accel
    q[3:6], q[6:9] = accel.random_walk**2, gyro.random_walk**2
    for rows, triad in ((slice(9, 12), gyro), (slice(12, 15), accel)):
        P[rows, rows] = np.eye(3) * (triad.turn_on_bias_sd**2 + triad.instability_sd**2)
        if triad.instability_sd > 0:
            q[rows] = 2 * triad.instability_sd**2 / triad.bias_correlation
    return P, q


def _make_fix_covariance(specs: AssumedSpecs) -> FloatArray:
    """Return R (6, 6) of a fix; its time-correlated part is taken as white."""
    gnss = specs.gnss
    if gnss is None:
        raise ValueError("the record holds gnss data, but sensors.assumed names no gnss unit")
    h = gnss.pos_h_white_sd**2 + gnss.pos_h_markov_sd**2
    v = gnss.pos_v_white_sd**2 + gnss.pos_v_markov_sd**2
    s = np.square(gnss.vel_white_sd_n) + gnss.vel_markov_sd**2
    return np.diag([h, h, v, *s])


def _place_antenna(
    nav: FloatArray, antenna_b: FloatArray, w_ib_b: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return position and velocity (6,) of the antenna relative to the IMU, and H (6, 15)."""
    C = rotation.matrix(nav[6:])
    earth_n = earth.EARTH_RATE * np.array([np.cos(nav[0]), 0.0, -np.sin(nav[0])])
    swept = np.cross(w_ib_b - C.T @ earth_n, antenna_b)
    H = np.eye(6, 15)
    H[:3, 6:9] = -rotation.skew(C @ antenna_b)
    H[3:, 6:9] = -rotation.skew(C @ swept)
    H[3:, 9:12] = C @ rotation.skew(antenna_b)
    return np.concatenate([C @ antenna_b, C @ swept]), H
