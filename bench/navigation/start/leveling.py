"""Initial alignment at rest: equations in `alignment`."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from bench.core.mathematics import earth, rotation
from bench.core.mathematics.arrays import FloatArray, IntArray
from bench.core.records.data import EventRow, InitialState, SensorData
from bench.core.records.sensor_specs import TriadSpec
from bench.core.words.exceptions import EstimatorError
from bench.navigation.engine import timeline
from bench.navigation.error_state_filter.aiding_sensors import fix_variance
from bench.navigation.error_state_filter.imu_states import thermal_figures
from bench.navigation.error_state_filter.rough_heading import UNKNOWN_HEADING_SD

WINDOW = 1.0  # length of the means that are compared to detect motion [s]
LEAST_REST = 10.0  # shortest standstill that is used [s]
REST_FORCE = 0.05  # largest change of the mean specific force of an aircraft on its wheels [m/s^2]
REST_RATE = np.deg2rad(0.5)  # the same of the mean rate: wind and engine rock it [rad/s]
REST_SPEED_SD = 0.01  # velocity of a standstill: more would show as a change of position [m/s]
SIGMAS = 5.0  # standard deviations of noise that a standstill may show
SPEED_SIGMAS = 6.5  # of the velocity of a fix: one of hundreds of fixes beyond it would end the standstill
FLICKER_KEPT = 0.5  # covariance of a flicker bias with its mean, over its variance [1]

Rows = list[EventRow]


def align_at_rest(sensors: SensorData, initial: InitialState) -> tuple[InitialState, Rows]:
    """Return the state at the end of a standstill, and what was done (`alignment.complete`)."""
    rows, span, _ = timeline.imu_rows(sensors.imu, initial.t, sensors.specs.imu)
    t = sensors.imu.t[rows]
    stretch = (span / sensors.imu.dt[rows])[:, None]
    end, why = _rest(sensors, initial, t, span, stretch, rows)
    T = float(t[end - 1] - initial.t) if end else 0.0
    wanted = min(LEAST_REST, initial.align_for)
    if end == 0 or t[end - 1] < initial.t + wanted - timeline.TIME_TOLERANCE:
        raise EstimatorError(
            f"alignment level needs a standstill of {wanted:g} s at the start; at {initial.t + T:g} s {why}"
        )
    used = rows[:end]
    f_b = (sensors.imu.dvel_b[used] * stretch[:end]).sum(axis=0) / T
    w_b = (sensors.imu.dtheta_b[used] * stretch[:end]).sum(axis=0) / T
    roll = np.arctan2(-f_b[1], -f_b[2])
    pitch = np.arctan2(f_b[0], np.hypot(f_b[1], f_b[2]))
    w_level = rotation.rotate(rotation.from_euler(roll, pitch, 0.0), w_b)
    heading = np.arctan2(-w_level[1], w_level[0])

    lat = initial.lla[0]
    g_n = earth.gravity_n(lat, initial.lla[2])
    g = float(g_n[2])
    plumb = rotation.from_rotvec([0.0, g_n[0] / g, 0.0])  # the plumb line bends with height
    warmth = float(thermal_figures(initial.t, float(initial.lla[2]), sensors.specs.imu)[0])
    force_sd, turn_sd = mean_sd(sensors, T, g, warmth)
    e_rate = earth.EARTH_RATE * np.cos(lat)
    J = np.zeros((3, 3))  # phi by db_N, db_E, dw_E
    J[0, 1], J[1, 0] = -1 / g, 1 / g
    J[2] = -np.tan(lat) * J[0]
    J[2, 2] = -1 / e_rate
    phi_cov = J @ np.diag(np.square([force_sd, force_sd, turn_sd])) @ J.T
    q_nb = rotation.multiply(plumb, rotation.from_euler(roll, pitch, heading))
    accel, gyro = sensors.specs.imu.accel, sensors.specs.imu.gyro
    C = rotation.matrix(q_nb)
    bias_cov = np.zeros((9, 6))  # of an error of the bias: estimate, zero, less truth
    bias_cov[6:, 3:] = -J[:, :2] @ C[:2] * common_variance(accel, T)
    heading_sd = float(np.sqrt(phi_cov[2, 2]))
    text = f"leveled at rest, {T:.0f} s: tilt sd {np.rad2deg(np.sqrt(phi_cov[0, 0])):.2g} deg each axis; "
    given_sd = float(np.sqrt(initial.cov[8, 8]))
    if np.isfinite(initial.q_nb).all() and given_sd < min(heading_sd, UNKNOWN_HEADING_SD):
        q_nb = rotation.multiply(plumb, rotation.from_euler(roll, pitch, rotation.to_euler(initial.q_nb)[2]))
        C = rotation.matrix(q_nb)
        phi_cov[2], phi_cov[:, 2] = 0.0, 0.0
        phi_cov[2, 2] = given_sd**2
        bias_cov[6:, 3:] = -np.vstack([J[:2, :2], np.zeros(2)]) @ C[:2] * common_variance(accel, T)
        bias_cov[8] = 0.0
        text += f"heading given, sd {np.rad2deg(given_sd):.2g} deg"
    elif heading_sd < UNKNOWN_HEADING_SD:
        bias_cov[6:, :3] = -J[:, 2:] @ C[1:2] * common_variance(gyro, T)
        text += f"heading gyrocompassed, sd {np.rad2deg(heading_sd):.2g} deg"
    else:
        phi_cov[2], phi_cov[:, 2], bias_cov[8] = 0.0, 0.0, 0.0
        phi_cov[2, 2] = UNKNOWN_HEADING_SD**2
        text += (
            f"heading is unknown: gyros of {np.rad2deg(turn_sd) * 3600:.2g} deg/h cannot gyrocompass with "
            f"{np.rad2deg(e_rate) * 3600:.2g} deg/h of Earth rate; motion makes it observable"
        )
    cov = np.zeros((9, 9))
    cov[:3, :3] = initial.cov[:3, :3]
    cov[3:6, 3:6] = REST_SPEED_SD**2 * np.eye(3)
    cov[6:, 6:] = phi_cov
    found = replace(
        initial,
        t=float(t[end - 1]),
        vel_n=np.zeros(3),
        q_nb=q_nb,
        cov=cov,
        bias_cov=bias_cov,
        alignment="given",
    )
    return found, [(initial.t, found.t, "alignment", text)]


def _rest(
    sensors: SensorData,
    initial: InitialState,
    t: FloatArray,
    span: FloatArray,
    stretch: FloatArray,
    rows: IntArray,
) -> tuple[int, str]:
    """Return the number of IMU samples of the standstill, in whole windows, and what ends it."""
    imu, specs = sensors.imu, sensors.specs.imu
    last = initial.t + initial.align_for + timeline.TIME_TOLERANCE
    why, until = "the time of the alignment is over", last
    if sensors.fixes is not None and sensors.specs.gnss is not None:
        sd = np.sqrt(fix_variance(sensors.specs.gnss, gnss_markov=False)[3:].max())
        speed = np.linalg.norm(sensors.fixes.vel_n, axis=1)
        moving = (
            sensors.fixes.valid & (speed > REST_SPEED_SD + SPEED_SIGMAS * sd) & (sensors.fixes.t >= initial.t)
        )
        if moving.any():
            k = int(np.argmax(moving))
            until, why = min(last, float(sensors.fixes.t[k])), f"GNSS reports {speed[k]:.2g} m/s"
    ends = np.searchsorted(t, np.arange(initial.t + WINDOW, until, WINDOW) - timeline.TIME_TOLERANCE) + 1
    if (ends > len(t)).any():
        ends, why = ends[ends <= len(t)], "the record of the imu ends"
    if not len(ends):
        return 0, why
    means = [
        np.add.reduceat(column[rows[: ends[-1]]] * stretch[: ends[-1]], np.append(0, ends[:-1]))
        / np.add.reduceat(span[: ends[-1]], np.append(0, ends[:-1]))[:, None]
        for column in (imu.dvel_b, imu.dtheta_b)
    ]
    g = float(earth.gravity_n(initial.lla[0], initial.lla[2])[2])
    whole = SIGMAS * np.hypot(bias_sd(specs.accel, g), specs.accel.random_walk)
    limits = [
        REST_FORCE + SIGMAS * np.sqrt(2.0) * specs.accel.random_walk / np.sqrt(WINDOW),
        REST_RATE + SIGMAS * np.sqrt(2.0) * specs.gyro.random_walk / np.sqrt(WINDOW),
    ]
    change, force = [np.abs(mean - mean[0]).max(axis=1) for mean in means], np.linalg.norm(means[0], axis=1)
    moves = {
        "the specific force changes": change[0] > limits[0],
        "it turns, or the unit of its gyros is wrong": change[1] > limits[1],
        f"the specific force is {force[0]:.3g} m/s^2, not gravity": np.abs(force - g) > REST_FORCE + whole,
    }
    for text, rows_moving in moves.items():
        if rows_moving.any() and rows_moving.argmax() < len(ends):
            ends, why = ends[: int(rows_moving.argmax())], text
    return int(ends[-1]) if len(ends) else 0, why


def mean_sd(sensors: SensorData, T: float, g: float, warmth: float) -> tuple[float, float]:
    """Return the standard deviations of the mean force and mean rate over T seconds at rest, each axis.

    ``warmth`` is the temperature of the IMU above its reference [K].
    """
    accel, gyro = sensors.specs.imu.accel, sensors.specs.imu.gyro
    return (
        float(np.hypot(bias_sd(accel, g, warmth), accel.random_walk / np.sqrt(T))),
        float(np.hypot(rate_sd(gyro, g, warmth), gyro.random_walk / np.sqrt(T))),
    )


def rate_sd(gyro: TriadSpec, g: float, warmth: float) -> float:
    """Return the standard deviation of the rate that a gyro shows at rest [rad/s]; see :func:`mean_sd`."""
    by_g = np.hypot(g * gyro.g_sensitivity_sd, g * g * gyro.g2_sensitivity_sd)
    return float(np.hypot(bias_sd(gyro, 0.0, warmth), by_g))


def bias_sd(triad: TriadSpec, along: float, warmth: float = 0.0) -> float:
    """Return the standard deviation of all errors that add to one axis.

    ``along`` is the force or rate on the others, ``warmth`` the temperature above the reference [K].
    """
    turned = along**2 * (triad.misalignment_sd**2 + triad.nonorthogonality_sd**2 + triad.alignment_sd**2)
    warm = (triad.temperature_sd * warmth) ** 2
    return float(np.sqrt(triad.turn_on_bias_sd**2 + triad.instability_sd**2 + turned + warm))


def common_variance(triad: TriadSpec, T: float) -> FloatArray:
    """Return the covariance (3,) of the bias of each axis with its mean over the last T seconds.

    For a Gauss-Markov process it follows from the autocorrelation. Flicker noise (`sensors.processes`)
    differs from its mean over a minute or two by a variance of 2.4 to 2.8 instability^2, about the variance
    of its state: half of it is in common. Over a shorter time it would be more.
    """
    kept = FLICKER_KEPT
    if triad.instability_sd > 0.0 and triad.bias_model == "gauss-markov":
        u = T / triad.bias_correlation
        kept = -np.expm1(-u) / u
    return np.asarray(triad.by_axis("turn_on_bias_sd") ** 2 + kept * triad.instability_by_axis**2)
