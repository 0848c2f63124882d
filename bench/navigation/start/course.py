"""Initial alignment on the move: equations in `alignment`."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from bench.core.mathematics import earth, rotation
from bench.core.mathematics.arrays import BoolArray, FloatArray, IntArray
from bench.core.records.data import GnssFixes, InitialState, SensorData
from bench.core.words.exceptions import EstimatorError
from bench.navigation.engine import timeline
from bench.navigation.error_state_filter.aiding_sensors import fix_variance
from bench.navigation.error_state_filter.imu_states import thermal_figures
from bench.navigation.error_state_filter.state_processes import assumed
from bench.navigation.mechanization import propagate
from bench.navigation.start.leveling import WINDOW, Rows, common_variance, mean_sd, rate_sd

LEAST_SPEED = 5.0  # over ground, for a course [m/s]
_ROLLS = 0.0, np.pi, 0.5 * np.pi, -0.5 * np.pi  # first guesses of the roll at the start [rad]
POSITIONS = 10.0  # least length of a segment whose fixes have no velocity, for "motion" [s]
SHORTEST = 1.0  # the gyro bias shortens no segment below this [s]
LINEAR_TURN = float(np.deg2rad(15.0))  # largest angle by the turn-on bias of a gyro in a segment [rad]
_CALM = 6.0  # largest acceleration of a calm segment: the tilt that it needs is nearly linear [m/s^2]
_FALLS = 3.0  # mean vertical acceleration that the fixes do not have: no error of an IMU is so large [m/s^2]
SHARE = 1.0 / 3.0  # of a segment without velocities, at each end, whose positions give its velocity [1]


def align_on_the_move(sensors: SensorData, initial: InitialState) -> tuple[InitialState, Rows]:
    """Return the state at the end of a segment in motion, and its event ("course" and "motion", `alignment`).

    Raises EstimatorError if the record has no such segment, or no attitude follows its fixes.
    """
    fixes, specs = sensors.fixes, sensors.specs
    name, any_way = initial.alignment, initial.alignment == "motion"
    if fixes is None:
        raise EstimatorError(f"alignment {name} needs GNSS fixes; the record has none")
    gnss = assumed(specs, "gnss")
    rows, span, _ = timeline.imu_rows(sensors.imu, initial.t, specs.imu)
    if not len(rows):
        raise EstimatorError(
            f"alignment {name} needs IMU samples; the record has no sound one after {initial.t:.6g} s"
        )
    t = np.concatenate([[initial.t], sensors.imu.t[rows]])
    usable, arrival, _ = timeline.fix_rows(fixes, t[1:], initial.t)
    inside = fixes.t[usable] > initial.t - timeline.TIME_TOLERANCE
    moving: BoolArray = np.asarray(np.isfinite(fixes.vel_n[usable]).all(axis=1))
    by_velocity = bool(2 * np.count_nonzero(moving) >= len(moving))
    if by_velocity:
        inside &= moving
    usable, arrival = usable[inside], arrival[inside]
    speed = np.hypot(*fixes.vel_n[usable, :2].T) if by_velocity else speeds(fixes, usable)
    long = np.flatnonzero(span - sensors.imu.dt[rows] > timeline.LONGEST_BRIDGE)
    edges = np.sort(np.concatenate([t[long], t[long + 1] - sensors.imu.dt[rows[long]]]))
    least = 0.0 if any_way else LEAST_SPEED
    length = max(initial.align_for, POSITIONS) if any_way and not by_velocity else initial.align_for
    length = min(length, max(SHORTEST, LINEAR_TURN / max(specs.imu.gyro.turn_on_bias_sd, 1e-9)))
    calm = 0
    if any_way and by_velocity:
        calm = find_calm(fixes.t[usable], fixes.vel_n[usable], length, edges)
    first, last = find_motion(fixes.t[usable][calm:], speed[calm:], length, edges, least)
    first, last = first + calm, last + calm
    i, j = usable[first], usable[last]
    ends: tuple[int, ...] = (int(i), int(j)) if by_velocity else quartet(fixes, usable[first : last + 1])
    samples = [int(np.argmin(np.abs(t - fixes.t[k]))) for k in ends]  # next to them
    a, b = samples[0], samples[-1]
    stop = min(int(arrival[last]) + 2, len(t) - 1)  # after it has arrived, so that nobody uses it again
    scale = (span / sensors.imu.dt[rows])[:, None]
    dtheta, dvel = sensors.imu.dtheta_b[rows] * scale, sensors.imu.dvel_b[rows] * scale
    paths = []
    for roll in _ROLLS:
        path = _find_path(
            sensors,
            ends,
            [k - a for k in samples],
            span[a:b],
            dtheta[a:b],
            dvel[a:b],
            roll,
            along=bool(speed[last] >= LEAST_SPEED),
            any_way=any_way,
        )
        paths += [path] if path is not None else []
        if paths and not any_way:
            break  # with the heading of the course, no other attitude fits
    if not paths:
        raise EstimatorError(
            f"alignment {name}: no attitude makes the inertial velocity follow the fixes; "
            "do they belong together?"
        )
    states, F, _ = min(paths, key=lambda path: path[2])
    end = states[-1]
    T = float(span[a:b].sum())

    r = fix_variance(gnss, gnss_markov=False)
    r_first, r_last = r[3:], r[3:]
    share, common, early, late = 0.0, np.zeros(3), 0.0, 0.0
    T_gain = T  # over which the velocity is gained
    if not by_velocity:
        # mean velocities of the ends; what slow errors cancel between two fixes is not counted
        early, late = float(fixes.t[ends[1]] - fixes.t[i]), float(fixes.t[j] - fixes.t[ends[2]])
        r_first, r_last = 2.0 * r[:3] / early**2, 2.0 * r[:3] / late**2
        T_gain = T - 0.5 * (early + late)
        share = 0.5 * late / T_gain  # of the error of the gain, from the middle of the end to its last
        common = fix_variance(gnss, gnss_markov=True)[:3] / late  # by the last fix
    arm = np.zeros((3, 3))
    if any_way:
        rates = [dtheta[k] / span[k] for k in (a, b - 1)]
        arm = _arm_variance(sensors.antenna_b, states[[k - a for k in samples]], rates, early, late)
        r_first, r_last = r_first + arm[1], r_last + arm[2]
    g = float(earth.gravity_n(end[0], end[2])[2])
    speed = float(np.hypot(end[3], end[4]))
    across = np.zeros(2) if any_way else np.array([-end[4], end[3]]) / speed**2
    warmth = float(thermal_figures(initial.t, float(end[2]), specs.imu)[0])
    force_sd, _ = mean_sd(sensors, T, g, warmth)
    gyro = specs.imu.gyro
    turned = 0.5 * np.linalg.norm(np.ptp(np.cumsum(dtheta[a:b], axis=0), axis=0))  # there and back [rad]
    by_turn = np.hypot(gyro.scale_factor_sd, gyro.misalignment_sd) * turned
    tilt_sd = np.linalg.norm([rate_sd(gyro, g, warmth) * T / 2, gyro.random_walk * np.sqrt(T / 3), by_turn])
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
    cov = np.diag(np.concatenate([r[:3] + arm[0], r_last, np.zeros(3)]))
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
    bias_cov[6:, 3:] = -J[:, 5:7] @ C[:2] * common_variance(specs.imu.accel, T)
    bias_cov[6:, :3] = -T / 2 * J[:, 7:] @ C[:2] * common_variance(gyro, T)
    rest = propagate(end[:3], end[3:6], end[6:], span[b:stop], dtheta[b:stop], dvel[b:stop])[-1]
    if not np.isfinite(cov).all():
        raise EstimatorError(f"alignment {name}: the covariance by the datasheets is not finite")
    text = _describe(initial, cov[6:, 6:], T, speed)
    found = replace(
        initial,
        t=float(t[stop]),
        lla=rest[:3],
        vel_n=rest[3:6],
        q_nb=rest[6:],
        cov=cov,
        bias_cov=bias_cov,
        fix_cov=(r - fix_variance(gnss, gnss_markov=True))[:3],
        alignment="given",
    )
    return found, [(float(fixes.t[i]), found.t, "alignment", text)]


def _describe(initial: InitialState, cov: FloatArray, T: float, speed: float) -> str:
    """Return the text of the event, with the sigmas of an attitude of covariance (3, 3)."""
    if initial.alignment == "motion":
        given_heading = cov[:2, :2] - np.outer(cov[:2, 2], cov[2, :2]) / cov[2, 2]
        sd_deg = np.rad2deg(np.sqrt(np.diag(given_heading).max()))
        return (
            f"leveled by the velocity gained in {T:.3g} s, tilt sd {sd_deg:.2g} deg at a given heading; "
            "heading is unknown"
        )
    sd = np.rad2deg(np.sqrt(np.diag(cov)))
    return (
        f"heading by the course of {T:.3g} s at {speed:.3g} m/s, sd {sd[2]:.2g} deg, "
        f"{np.rad2deg(initial.drift_sd):.2g} deg of it wind and sideslip; tilt sd {max(sd[:2]):.2g} deg"
    )


def find_motion(
    t: FloatArray, speed: FloatArray, length: float, edges: FloatArray, least: float = LEAST_SPEED
) -> tuple[int, int]:
    """Return the first and last fix of the first segment of a length [s] with motion throughout.

    Parameters
    ----------
    t, speed : (K,) arrays
        Validity of the fixes [s] and their speed over ground [m/s].
    length : float
        Least length of the segment [s].
    edges : (E,) array
        Beginnings and ends of long gaps of the IMU [s]: no segment contains one.
    least : float
        Least speed of each fix [m/s]; 0 for alignment "motion".

    Raises
    ------
    EstimatorError
        If there is no such segment.
    """
    start, passed = 0, np.searchsorted(edges, t)
    for k in range(len(t)):
        if passed[k] != passed[start]:
            start = k
        if speed[k] < least:
            start = k + 1
        elif t[k] - t[start] >= length - timeline.TIME_TOLERANCE:
            return start, k
    fastest = (
        f"the fastest of {len(t)} fixes has {speed.max():.3g} m/s" if len(t) else "there is no sound fix"
    )
    if least == 0.0:
        raise EstimatorError(
            f"alignment motion needs {length:.3g} s of fixes below {_CALM:g} m/s^2 without a gap of the IMU"
        )
    raise EstimatorError(
        f"alignment course needs {length:g} s of fixes above {least:g} m/s over ground; {fastest}"
    )


def find_calm(t: FloatArray, vel_n: FloatArray, length: float, edges: FloatArray) -> int:
    """Return the index of the first fix from which on a segment is calm, or K if there is none.

    A segment is calm if its mean acceleration is below 6 m/s^2: `headings.turn_heading` takes the tilt by a
    horizontal force as small, and in free fall no force levels the IMU.

    t (K,) is the validity of the fixes [s], vel_n (K, 3) their velocity [m/s], length that of a segment [s].
    ``edges`` are those of :func:`find_motion`.
    """
    end = np.searchsorted(t, t + length - timeline.TIME_TOLERANCE)
    (inside,) = np.nonzero(end < len(t))
    gain = np.linalg.norm(vel_n[end[inside]] - vel_n[inside], axis=1) / (t[end[inside]] - t[inside])
    passed = np.searchsorted(edges, t)
    calm = (gain < _CALM) & (passed[end[inside]] == passed[inside])
    return int(inside[np.argmax(calm)]) if calm.any() else len(t)


def speeds(fixes: GnssFixes, rows: IntArray) -> FloatArray:
    """Return the speed (K,) over ground between each fix and the place a window before it [m/s]."""
    t = fixes.t[rows]
    if len(t) == 0:
        return np.empty(0)
    place = earth.difference_n(fixes.lla[rows], fixes.lla[rows[0]])
    before = np.maximum(t - WINDOW, t[0])
    way = np.hypot(*(place[:, k] - np.interp(before, t, place[:, k]) for k in range(2)))
    passed = t - before
    return np.asarray(np.where(passed > 0, way / np.where(passed > 0, passed, 1.0), 0.0))


def quartet(fixes: GnssFixes, rows: IntArray) -> tuple[int, int, int, int]:
    """Return the first and last fix of a segment, and the two that lie ``SHARE`` of it inside."""
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


def _find_path(
    sensors: SensorData,
    ends: tuple[int, ...],
    samples: Sequence[int],
    dt: FloatArray,
    dtheta: FloatArray,
    dvel: FloatArray,
    roll: float,
    *,
    along: bool,
    any_way: bool,
) -> tuple[FloatArray, FloatArray, float] | None:
    """Return the strapdown (K, 10) along some fixes that matches their velocity change and final course.

    Also return its mean specific force F (3,), n, and its error of the mean vertical acceleration [m/s^2].

    Of two fixes the velocities are measured; of four without velocity, next to the IMU ``samples``, it gains
    that by which the mean between the last two exceeds that between the first. Newton's iteration on the
    attitude at the start, from a ``roll`` [rad] on; the lever arm is taken off the fixes. It looks at the
    horizontal velocity. The heading at the end is the course if ``along``, else north; where it may be
    ``any_way``, only the height of the arm is taken off. None if it does not converge, or if the vertical
    velocity disagrees: upside down.
    """
    assert sensors.fixes is not None
    lla, arm_b, moving = sensors.fixes.lla[list(ends)], sensors.antenna_b, len(ends) == 2
    span = np.concatenate([[0.0], np.cumsum(dt)])[list(samples)]
    if moving:
        (vel, last_vel), T = sensors.fixes.vel_n[list(ends)], float(dt.sum())
    else:
        early, late, T = span[1], span[3] - span[2], span[3]
        vel, gain_time = earth.difference_n(lla[1], lla[0]) / early, T - 0.5 * (early + late)
    known = np.array([0.0, 0.0, 1.0]) if any_way else np.ones(3)
    q, swept = rotation.from_euler(roll, 0.0, np.arctan2(vel[1], vel[0])), np.zeros(3)
    for _ in range(30):
        if moving:
            swept = known * _swept(arm_b, q, dtheta[0] / dt[0], lla[0, 0])
        place = earth.displace(lla[0], -known * rotation.rotate(q, arm_b))
        states = propagate(place, vel - swept, q, dt, dtheta, dvel)
        end = states[-1]
        if moving:
            wanted = last_vel - known * _swept(arm_b, end[6:], dtheta[-1] / dt[-1], end[0])
            e = (end[3:6] - wanted) / T
        else:
            at = states[list(samples)]
            arm_n = known * rotation.rotate(at[:, 6:], arm_b)
            off = earth.difference_n(earth.displace(at[:, :3], arm_n), lla)
            first, last = (off[1] - off[0]) / early, (off[3] - off[2]) / late  # of the mean velocities
            e = (last - first) / gain_time
            wanted = end[3:6] - last - e * (0.5 * late)
            vel = vel - first + 0.5 * early * e
        F = (end[3:6] - states[0, 3:6]) / T - earth.gravity_n(end[0], end[2])
        turn = rotation.to_euler(end[6:])[2] - (np.arctan2(wanted[1], wanted[0]) if along else 0.0)
        down = np.pi - np.mod(np.pi - turn, 2 * np.pi)
        phi = np.array([(down * F[0] - e[1]) / F[2], (e[0] + down * F[1]) / F[2], down])
        q = rotation.multiply(rotation.from_rotvec(-phi), q)
        if np.abs(phi).max() < 1e-9:
            states[-1, :3] = earth.displace(lla[-1], -known * rotation.rotate(end[6:], arm_b))
            states[-1, 3:6] = wanted
            return (states, F, abs(float(e[2]))) if abs(e[2]) < _FALLS else None
    return None


def _arm_variance(
    antenna_b: FloatArray, states: FloatArray, rates: Sequence[FloatArray], early: float, late: float
) -> FloatArray:
    """Return what a lever arm does to place, first and last velocity: variances (3, 3), n.

    Its horizontal part and that of its motion may point anywhere. Mean velocities over the times ``early``
    and ``late`` [s] have that of its change between two of the four ``states``.
    """
    arms = rotation.rotate(states[:, 6:], antenna_b)
    if len(states) == 2:
        moved = [
            _swept(antenna_b, state[6:], rate, state[0]) for state, rate in zip(states, rates, strict=True)
        ]
    else:
        moved = [(arms[1] - arms[0]) / early, (arms[3] - arms[2]) / late]
    square: FloatArray = np.square([arms[-1, :2], moved[0][:2], moved[1][:2]]).sum(axis=1)
    return 0.5 * square[:, None] * [1.0, 1.0, 0.0]


def _swept(antenna_b: FloatArray, q_nb: FloatArray, w_ib_b: FloatArray, lat: float) -> FloatArray:
    """Return the velocity (3,) of the antenna against the IMU, n."""
    earth_n = earth.EARTH_RATE * np.array([np.cos(lat), 0.0, -np.sin(lat)])
    w_eb_b = w_ib_b - rotation.rotate(rotation.conjugate(q_nb), earth_n)
    swept: FloatArray = rotation.rotate(q_nb, np.cross(w_eb_b, antenna_b))
    return swept
