"""Initial alignment: what an estimator does before it can start where it was not told all of its state.

``level``, at rest: roll and pitch from the mean specific force, heading from the mean rate of the gyros
(gyrocompassing). With db the accelerometer and dw the gyro error, resolved in n,

    phi_N = -db_E / g      phi_E = db_N / g      phi_D = -dw_E / (w_ie cos lat) - phi_N tan lat

(section 10: heading sd 0.59 deg for 0.1 deg/h at 50 deg). ``course``, moving: heading is the course of the
last fix of a stretch, roll and pitch are those that make the strapdown gain the velocity the fixes gained
(fixes without velocity: the mean velocity between two of them, at both ends of the stretch);
with F the mean specific force in n and e the error of the gain over its time,

    phi_E = (e_N + phi_D F_E) / F_D      phi_N = (phi_D F_N - e_E) / F_D

The covariances hold the datasheet's biases, noise and misalignments, ``bias_cov`` what an attitude has in
common with the biases that made it: a filter told of both as strangers would halve the variance of the tilt
as soon as it sees the aircraft stand, and the tilt would not have moved. Where the heading is unknown the two
stay strangers all the same: what they have in common along n would not turn with the heading that is found.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from bench import earth, rotation
from bench.arrays import BoolArray, FloatArray, IntArray
from bench.data import GnssFixes, InitialState, SensorData
from bench.errors import EstimatorError
from bench.navigation import timeline
from bench.navigation.blocks import assumed
from bench.navigation.measurements import fix_variance
from bench.navigation.mechanization import propagate
from bench.specs import TriadSpec

WINDOW = 1.0  # means that are compared to see the aircraft move [s]
LEAST_REST = 10.0  # of a standstill that is used [s]
REST_FORCE = 0.05  # change of the mean specific force an aircraft on its wheels may show [m/s^2]
REST_RATE = np.deg2rad(0.5)  # the same of the rate: wind and engine rock it [rad/s]
REST_SPEED_SD = 0.01  # of a standstill: 0.6 m in a minute would show as a change of place [m/s]
LEAST_SPEED = 5.0  # over ground, for a course [m/s]
SIGMAS = 5.0  # noise a standstill may show
SHARE = 1.0 / 3.0  # of a stretch without velocities, at each end, whose positions give its velocity [1]
UNKNOWN_SPEED_SD = 300.0  # of a velocity that may be any, each axis: above the airspeed of airliners [m/s]
FLICKER_KEPT = 0.5  # share of the variance of a flicker bias that it has in common with its mean [1]
UNKNOWN_HEADING_SD = np.pi / np.sqrt(3.0)  # of a heading that may be anything [rad]

Rows = list[tuple[float, float, str, str]]


def complete(sensors: SensorData, initial: InitialState) -> tuple[InitialState, Rows]:
    """Return a start that says all of position, velocity and attitude, and what was done to get it.

    Parameters
    ----------
    sensors : SensorData
        The record; only what has arrived by the end of the alignment is used. That a standstill is over shows
        in the window or the fix that follows: the first second is that of a filter that waits for them.
    initial : InitialState
        ``alignment`` says what is to be found; "given" is returned as it is.

    Returns
    -------
    initial : InitialState
        At the end of the alignment.
    events : list of (t, t_end, kind, text)
        One "alignment" event, none when all was given.

    Raises
    ------
    EstimatorError
        When the record does not allow it, in one line.
    """
    if initial.alignment == "given":
        return initial, []
    if initial.alignment == "level":
        return _level(sensors, initial)
    if initial.alignment == "course":
        return _course(sensors, initial)
    raise EstimatorError(f"alignment = {initial.alignment!r} must be 'given', 'level' or 'course'")


# --- at rest -------------------------------------------------------------------------------------------


def _level(sensors: SensorData, initial: InitialState) -> tuple[InitialState, Rows]:
    rows, span, _ = timeline.imu_rows(sensors.imu, initial.t)
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
    force_sd, rate_sd = _mean_sd(sensors, T, g)
    e_rate = earth.RATE * np.cos(lat)
    J = np.zeros((3, 3))  # phi by db_N, db_E, dw_E
    J[0, 1], J[1, 0] = -1 / g, 1 / g
    J[2] = -np.tan(lat) * J[0]
    J[2, 2] = -1 / e_rate
    phi_cov = J @ np.diag(np.square([force_sd, force_sd, rate_sd])) @ J.T
    q_nb = rotation.multiply(plumb, rotation.from_euler(roll, pitch, heading))
    accel, gyro = sensors.specs.imu.accel, sensors.specs.imu.gyro
    C = rotation.matrix(q_nb)
    bias_cov = np.zeros((9, 6))  # of an error of the bias: estimate, zero, less truth
    bias_cov[6:, 3:] = -_common(accel, T) * J[:, :2] @ C[:2]
    bias_cov[6:, :3] = -_common(gyro, T) * J[:, 2:] @ C[1:2]
    heading_sd = float(np.sqrt(phi_cov[2, 2]))
    text = f"levelled at rest, {T:.0f} s: tilt sd {np.rad2deg(np.sqrt(phi_cov[0, 0])):.2g} deg each axis; "
    if heading_sd < UNKNOWN_HEADING_SD:
        text += f"heading gyrocompassed, sd {np.rad2deg(heading_sd):.2g} deg"
    else:
        phi_cov[2], phi_cov[:, 2] = 0.0, 0.0
        phi_cov[2, 2] = UNKNOWN_HEADING_SD**2
        bias_cov[:] = 0.0
        text += (
            f"heading is unknown: gyros of {np.rad2deg(rate_sd) * 3600:.2g} deg/h cannot gyrocompass by "
            f"{np.rad2deg(e_rate) * 3600:.2g} deg/h of Earth rate; a course finds it"
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
    """Return the number of IMU samples before the aircraft moves, whole windows, and what ends them."""
    imu, specs = sensors.imu, sensors.specs.imu
    last = initial.t + initial.align_for + timeline.TIME_TOLERANCE
    why, until = "the time of the alignment is over", last
    if sensors.fixes is not None and sensors.specs.gnss is not None:
        sd = np.sqrt(fix_variance(sensors.specs.gnss, gnss_markov=False)[3])
        speed = np.linalg.norm(sensors.fixes.vel_n, axis=1)
        moving = sensors.fixes.valid & (speed > REST_SPEED_SD + SIGMAS * sd) & (sensors.fixes.t >= initial.t)
        if moving.any():
            k = int(np.argmax(moving))
            until, why = min(last, float(sensors.fixes.t[k])), f"GNSS reports {speed[k]:.2g} m/s"
    ends = np.searchsorted(t, np.arange(initial.t + WINDOW, until, WINDOW) - timeline.TIME_TOLERANCE) + 1
    ends = ends[ends <= len(t)]
    if not len(ends):
        return 0, why if until < last else "the record of the imu ends"
    means = [
        np.add.reduceat(column[rows[: ends[-1]]] * stretch[: ends[-1]], np.append(0, ends[:-1]))
        / np.add.reduceat(span[: ends[-1]], np.append(0, ends[:-1]))[:, None]
        for column in (imu.dvel_b, imu.dtheta_b)
    ]
    g = float(earth.gravity_n(initial.lla[0], initial.lla[2])[2])
    whole = SIGMAS * np.hypot(_bias_sd(specs.accel, g), specs.accel.random_walk)
    limits = [
        REST_FORCE + SIGMAS * np.sqrt(2.0) * specs.accel.random_walk / np.sqrt(WINDOW),
        REST_RATE + SIGMAS * np.sqrt(2.0) * specs.gyro.random_walk / np.sqrt(WINDOW),
    ]
    change = [np.abs(mean - mean[0]).max(axis=1) for mean in means]
    moves = {
        "the specific force changes": change[0] > limits[0],
        "it turns": change[1] > limits[1],
        "it does not feel gravity alone": np.abs(np.linalg.norm(means[0], axis=1) - g) > REST_FORCE + whole,
    }
    for text, rows_moving in moves.items():
        if rows_moving.any() and rows_moving.argmax() < len(ends):
            ends, why = ends[: int(rows_moving.argmax())], text
    if not len(ends):
        return 0, why
    return int(ends[-1]), why if until < last or len(t) > ends[-1] else "the record of the imu ends"


def _mean_sd(sensors: SensorData, T: float, g: float) -> tuple[float, float]:
    """Return the standard deviations of a mean of T seconds at rest: specific force, rate; each axis."""
    accel, gyro = sensors.specs.imu.accel, sensors.specs.imu.gyro
    by_g = np.hypot(g * gyro.g_sensitivity_sd, g * g * gyro.g2_sensitivity_sd)
    return (
        float(np.hypot(_bias_sd(accel, g), accel.random_walk / np.sqrt(T))),
        float(np.linalg.norm([_bias_sd(gyro, 0.0), by_g, gyro.random_walk / np.sqrt(T)])),
    )


def _bias_sd(triad: TriadSpec, along: float) -> float:
    """Return the standard deviation of the bias of a mean, with the part of a rate ``along`` another axis."""
    turned = along**2 * (triad.misalignment_sd**2 + triad.nonorthogonality_sd**2 + triad.alignment_sd**2)
    return float(np.sqrt(triad.turn_on_bias_sd**2 + triad.instability_sd**2 + turned))


def _common(triad: TriadSpec, T: float) -> float:
    """Return the covariance of a bias with its mean over the T seconds before.

    A Gauss-Markov process has what its autocorrelation says. Flicker noise, as `bench.sensors.processes`
    makes it, parts from its mean over a minute or two by 2.4 to 2.8 times the square of its instability,
    about the variance its state is given: a half is left. Over less time more would be.
    """
    kept = FLICKER_KEPT
    if triad.instability_sd > 0.0 and triad.bias_model == "gauss-markov":
        u = T / triad.bias_correlation
        kept = -np.expm1(-u) / u
    return float(triad.turn_on_bias_sd**2 + kept * triad.instability_sd**2)


# --- moving --------------------------------------------------------------------------------------------


def _course(sensors: SensorData, initial: InitialState) -> tuple[InitialState, Rows]:
    fixes, specs = sensors.fixes, sensors.specs
    if fixes is None:
        raise EstimatorError("alignment course needs GNSS fixes; the record has none")
    gnss = assumed(specs, "gnss")
    rows, span, _ = timeline.imu_rows(sensors.imu, initial.t)
    t = np.concatenate([[initial.t], sensors.imu.t[rows]])
    usable, arrival, _ = timeline.fix_rows(fixes, t[1:], initial.t)
    inside = fixes.t[usable] > initial.t - timeline.TIME_TOLERANCE
    moving: BoolArray = np.asarray(np.isfinite(fixes.vel_n[usable]).all(axis=1))
    by_velocity = bool(2 * np.count_nonzero(moving) >= len(moving))
    if by_velocity:
        inside &= moving
    usable, arrival = usable[inside], arrival[inside]
    speed = np.hypot(*fixes.vel_n[usable, :2].T) if by_velocity else _speeds(fixes, usable)
    first, last = _moving(fixes.t[usable], speed, initial.align_for)
    i, j = usable[first], usable[last]
    ends: tuple[int, ...] = (int(i), int(j)) if by_velocity else _quartet(fixes, usable[first : last + 1])
    samples = [int(np.argmin(np.abs(t - fixes.t[k]))) for k in ends]  # next to them
    a, b = samples[0], samples[-1]
    stop = min(int(arrival[last]) + 2, len(t) - 1)  # after it has arrived, so that nobody uses it again
    scale = (span / sensors.imu.dt[rows])[:, None]
    dtheta, dvel = sensors.imu.dtheta_b[rows] * scale, sensors.imu.dvel_b[rows] * scale
    match = _matched if by_velocity else _followed
    states, F = match(sensors, ends, [k - a for k in samples], span[a:b], dtheta[a:b], dvel[a:b])
    end = states[-1]
    T = float(span[a:b].sum())

    r = fix_variance(gnss, gnss_markov=False)
    r_first, r_last = r[3:], r[3:]
    share, common = 0.0, np.zeros(3)
    T_gain = T  # over which the velocity is gained
    if not by_velocity:
        # mean velocities of the ends; what slow errors cancel between two fixes is not counted
        early, late = fixes.t[ends[1]] - fixes.t[i], fixes.t[j] - fixes.t[ends[2]]
        r_first, r_last = 2.0 * r[:3] / early**2, 2.0 * r[:3] / late**2
        T_gain = T - 0.5 * float(early + late)
        share = 0.5 * float(late) / T_gain  # of the error of the gain, from the middle of the end to its last
        common = fix_variance(gnss, gnss_markov=True)[:3] / late  # by the last fix
    g = float(earth.gravity_n(end[0], end[2])[2])
    speed = float(np.hypot(end[3], end[4]))
    across = np.array([-end[4], end[3]]) / speed**2
    force_sd, _ = _mean_sd(sensors, T, g)
    gyro = specs.imu.gyro
    tilt_sd = np.hypot(_bias_sd(gyro, 0.0) * T / 2, gyro.random_walk * np.sqrt(T / 3))
    # phi by: velocity of the first fix and of the last, nose against course, db, tilt by the gyros
    V = np.zeros((2, 9))  # the velocity at the end by the same
    V[:, :2], V[:, 2:4] = -share * np.eye(2), (1.0 + share) * np.eye(2)
    J = np.zeros((3, 9))
    J[2, :4], J[2, 4] = across @ V[:, :4], 1.0
    e = np.zeros((2, 9))
    e[:, :2], e[:, 2:4], e[:, 5:7] = -np.eye(2) / T_gain, np.eye(2) / T_gain, -np.eye(2)
    J[1] = (e[0] + J[2] * F[1]) / F[2]
    J[0] = (J[2] * F[0] - e[1]) / F[2]
    J[:2, 7:] = np.eye(2)
    noise = np.array(
        [*r_first[:2], *r_last[:2], initial.drift_sd**2, force_sd**2, force_sd**2, *[tilt_sd**2] * 2]
    )
    cov = np.diag(np.concatenate([r, np.zeros(3)]))
    cov[6:, 6:] = J @ np.diag(noise) @ J.T
    cov[3:5, 6:] = (V * noise) @ J.T
    if not by_velocity:
        cov[3:5, 3:5] = (V * noise) @ V.T
        cov[5, 5] = (1.0 + share) ** 2 * r_last[2] + share**2 * r_first[2]
        cov[:2, 3:5], cov[2, 5] = common[:2, None] * V[:, 2:4], (1.0 + share) * common[2]
        cov[:2, 6:] = common[:2, None] * J[:, 2:4].T
        cov[3:6, :3] = cov[:3, 3:6].T
        cov[6:, :3] = cov[:3, 6:].T
    cov[6:, 3:5] = cov[3:5, 6:].T
    C = rotation.matrix(states[:, 6:]).mean(axis=0)  # a bias turned with the aircraft while it was felt
    bias_cov = np.zeros((9, 6))
    bias_cov[6:, 3:] = -_common(specs.imu.accel, T) * J[:, 5:7] @ C[:2]
    bias_cov[6:, :3] = -_common(gyro, T) * T / 2 * J[:, 7:] @ C[:2]
    rest = propagate(end[:3], end[3:6], end[6:], span[b:stop], dtheta[b:stop], dvel[b:stop])[-1]
    sd = np.rad2deg(np.sqrt(np.diag(cov)[6:]))
    text = (
        f"heading by the course of {T:.3g} s at {speed:.3g} m/s, sd {sd[2]:.2g} deg, "
        f"{np.rad2deg(initial.drift_sd):.2g} deg of it wind and sideslip; tilt sd {max(sd[:2]):.2g} deg"
    )
    found = replace(
        initial,
        t=float(t[stop]),
        lla=rest[:3],
        vel_n=rest[3:6],
        q_nb=rest[6:],
        cov=cov,
        bias_cov=bias_cov,
        alignment="given",
    )
    return found, [(float(fixes.t[i]), found.t, "alignment", text)]


def _moving(t: FloatArray, speed: FloatArray, length: float) -> tuple[int, int]:
    """Return the first and last fix of the first stretch of a length [s] that moves throughout."""
    start = 0
    for k in range(len(t)):
        if speed[k] < LEAST_SPEED:
            start = k + 1
        elif t[k] - t[start] >= length - timeline.TIME_TOLERANCE:
            return start, k
    fastest = (
        f"the fastest of {len(t)} fixes has {speed.max():.3g} m/s" if len(t) else "there is no sound fix"
    )
    raise EstimatorError(
        f"alignment course needs {length:g} s of fixes above {LEAST_SPEED:g} m/s over ground; {fastest}"
    )


def _speeds(fixes: GnssFixes, rows: IntArray) -> FloatArray:
    """Return the speed (K,) over ground between each fix and the place a window before it [m/s]."""
    t = fixes.t[rows]
    if len(t) == 0:
        return np.empty(0)
    place = earth.difference_n(fixes.lla[rows], fixes.lla[rows[0]])
    before = np.maximum(t - WINDOW, t[0])
    way = np.hypot(*(place[:, k] - np.interp(before, t, place[:, k]) for k in range(2)))
    passed = t - before
    return np.asarray(np.where(passed > 0, way / np.where(passed > 0, passed, 1.0), 0.0))


def _quartet(fixes: GnssFixes, rows: IntArray) -> tuple[int, int, int, int]:
    """Return the first and last fix of a stretch, between them those a share of it away from each."""
    t = fixes.t[rows]
    away = SHARE * (t[-1] - t[0])
    after = max(int(np.searchsorted(t, t[0] + away + timeline.TIME_TOLERANCE)) - 1, 1)
    before = min(int(np.searchsorted(t, t[-1] - away - timeline.TIME_TOLERANCE)), len(t) - 2)
    if before < after:
        raise EstimatorError(
            f"alignment course by fixes without velocity needs more than the {len(t)} there are in "
            f"{t[-1] - t[0]:.3g} s; a longer [alignment] duration_s has more"
        )
    return int(rows[0]), int(rows[after]), int(rows[before]), int(rows[-1])


def _followed(
    sensors: SensorData,
    ends: tuple[int, ...],
    samples: Sequence[int],
    dt: FloatArray,
    dtheta: FloatArray,
    dvel: FloatArray,
) -> tuple[FloatArray, FloatArray]:
    """Return what :func:`_matched` does, of four fixes without velocity.

    The strapdown gains the velocity by which the mean between the last two exceeds that between the first.
    """
    assert sensors.fixes is not None
    lla, arm_b = sensors.fixes.lla[list(ends)], sensors.antenna_b
    span = np.concatenate([[0.0], np.cumsum(dt)])[list(samples)]
    early, late = span[1], span[3] - span[2]
    gain_time = span[3] - 0.5 * (early + late)
    vel = earth.difference_n(lla[1], lla[0]) / early
    q = rotation.from_euler(0.0, 0.0, np.arctan2(vel[1], vel[0]))
    for _ in range(30):
        states = propagate(earth.displace(lla[0], -rotation.rotate(q, arm_b)), vel, q, dt, dtheta, dvel)
        at = states[list(samples)]
        off = earth.difference_n(earth.displace(at[:, :3], rotation.rotate(at[:, 6:], arm_b)), lla)
        first, last = (off[1] - off[0]) / early, (off[3] - off[2]) / late  # of the mean velocities
        end = at[3]
        wanted = end[3:6] - last - (last - first) / gain_time * (0.5 * late)
        F = (end[3:6] - vel) / span[3] - earth.gravity_n(end[0], end[2])
        e = (last - first) / gain_time
        turn = rotation.to_euler(end[6:])[2] - np.arctan2(wanted[1], wanted[0])
        down = np.pi - np.mod(np.pi - turn, 2 * np.pi)
        phi = np.array([(down * F[0] - e[1]) / F[2], (e[0] + down * F[1]) / F[2], down])
        q = rotation.multiply(rotation.from_rotvec(-phi), q)
        vel = vel - first + 0.5 * early * e
        if np.abs(phi).max() < 1e-9:
            states[-1, :3] = earth.displace(lla[3], -rotation.rotate(end[6:], arm_b))
            states[-1, 3:6] = wanted
            return states, F
    raise EstimatorError(
        "alignment course: no attitude makes the inertial path follow the fixes; do they belong together?"
    )


def _matched(
    sensors: SensorData,
    ends: tuple[int, ...],
    _samples: Sequence[int],
    dt: FloatArray,
    dtheta: FloatArray,
    dvel: FloatArray,
) -> tuple[FloatArray, FloatArray]:
    """Return the strapdown between two fixes that gains their velocity and ends along their course, and F.

    Newton's iteration on the attitude at the start; the antenna's lever arm is taken off both fixes.
    """
    assert sensors.fixes is not None
    v_1, v_2 = sensors.fixes.vel_n[list(ends)]
    T = float(dt.sum())
    q = rotation.from_euler(0.0, 0.0, np.arctan2(v_1[1], v_1[0]))
    lla = sensors.fixes.lla[ends[0]]
    for _ in range(30):
        swept = _swept(sensors.antenna_b, q, dtheta[0] / dt[0], lla[0])
        place = earth.displace(lla, -rotation.rotate(q, sensors.antenna_b))
        states = propagate(place, v_1 - swept, q, dt, dtheta, dvel)
        end = states[-1]
        wanted = v_2 - _swept(sensors.antenna_b, end[6:], dtheta[-1] / dt[-1], end[0])
        F = (end[3:6] - states[0, 3:6]) / T - earth.gravity_n(end[0], end[2])
        e = (end[3:6] - wanted) / T
        turn = rotation.to_euler(end[6:])[2] - np.arctan2(wanted[1], wanted[0])
        down = np.pi - np.mod(np.pi - turn, 2 * np.pi)
        phi = np.array([(down * F[0] - e[1]) / F[2], (e[0] + down * F[1]) / F[2], down])
        q = rotation.multiply(rotation.from_rotvec(-phi), q)
        if np.abs(phi).max() < 1e-9:
            last = earth.displace(sensors.fixes.lla[ends[1]], -rotation.rotate(end[6:], sensors.antenna_b))
            states[-1, :3], states[-1, 3:6] = last, wanted
            return states, F
    raise EstimatorError(
        "alignment course: no attitude makes the inertial velocity follow the fixes; do they belong together?"
    )


def _swept(antenna_b: FloatArray, q_nb: FloatArray, w_ib_b: FloatArray, lat: float) -> FloatArray:
    """Return the velocity (3,) of the antenna against the IMU, n."""
    earth_n = earth.RATE * np.array([np.cos(lat), 0.0, -np.sin(lat)])
    w_eb_b = w_ib_b - rotation.rotate(rotation.conjugate(q_nb), earth_n)
    swept: FloatArray = rotation.rotate(q_nb, np.cross(w_eb_b, antenna_b))
    return swept
