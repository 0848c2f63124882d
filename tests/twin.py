"""The loose filter a second time, plain and slow: what it says must be what the compiled one says.

It shares with ``bench``: the records that go in, the datasheet figures in them, and nothing else; filterpy
does the covariance and the updates. Of satellites it also shares the atmosphere of `signals.delays`
and the order in which their rows are used. It computes by itself: the WGS 84 Earth, the strapdown step
(attitude as a matrix), F as central differences of the continuous equations of navigation, Phi, P0, Q and R,
the antenna, gates, the ranges to satellites and their H by differences, and feedback as small rotations of
that matrix. What it takes over by design, not by code: both rates as lines over two intervals, midpoint
rules, and the order of Phi (``transition``).

    lat' = v_N / (R_M + h)      lon' = v_E / ((R_P + h) cos lat)      h' = -v_D       (A-5.1.2)
    C'   = C [w_ib_b x] - [(w_ie_n + w_en_n) x] C                                     (A-5.1.3)
    v'   = C f_b + g_n - (2 w_ie_n + w_en_n) x v                                      (A-5.1.4)

Errors are estimate minus truth: meters and m/s along n, a turn about the vertical and then a tilt,
C_est = exp([tilt x]) exp([heading x]) C_true, biases, baro bias. The twin takes records without faulty rows
only.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from filterpy.kalman import KalmanFilter
from scipy.integrate import quad
from scipy.stats import chi2

from bench.simulation.signals import delays

SEMI_MAJOR, FLATTENING, EARTH_RATE, EARTH_GM = 6378137.0, 1 / 298.257223563, 7.292115e-5, 3.986004418e14
LIGHT, GPS_L1 = 299792458.0, 1575.42e6
SEMI_MINOR = SEMI_MAJOR * (1 - FLATTENING)
GRAVITY_EQUATOR, GRAVITY_POLE = 9.7803253359, 9.8321849379  # NIMA TR8350.2 (2000)

STEP = np.repeat([300.0, 1.0, 1e-4, 1e-3, 1e-1], 3)
"""Half-width of the central differences: m, m/s, rad, rad/s, m/s^2."""


def vector(x, y, z):
    """Components (...) as vectors (..., 3)."""
    columns = np.array([x, y, z])
    return columns.transpose(*range(1, columns.ndim), 0)


# --- the Earth, for one place or many ------------------------------------------------------------------


def radii(lat):
    """Radii of curvature along the meridian and across it [m] (A-2.2.R)."""
    b2_a2 = (SEMI_MINOR / SEMI_MAJOR) ** 2
    denominator = np.cos(lat) ** 2 + b2_a2 * np.sin(lat) ** 2
    return SEMI_MAJOR * b2_a2 / denominator**1.5, SEMI_MAJOR / denominator**0.5


def gravity(lat, alt):
    """Normal gravity (..., 3) [m/s^2], n: Somigliana by its two ends, second order in height."""
    a, b, f = SEMI_MAJOR, SEMI_MINOR, FLATTENING
    c2, s2 = np.cos(lat) ** 2, np.sin(lat) ** 2
    surface = (a * GRAVITY_EQUATOR * c2 + b * GRAVITY_POLE * s2) / np.sqrt(a * a * c2 + b * b * s2)
    m = EARTH_RATE**2 * a * a * b / EARTH_GM
    down = surface * (1 - 2 / a * (1 + f + m - 2 * f * s2) * alt + 3 / a**2 * alt**2)
    return vector(-8.08e-9 * alt * np.sin(2 * lat), 0 * down, down)


def frame_rates(lat, alt, vel):
    """Rates (..., 3) of the Earth and of n over the Earth [rad/s], n."""
    meridian, prime = radii(lat)
    earth = EARTH_RATE * vector(np.cos(lat), 0 * lat, -np.sin(lat))
    east = vel[..., 1] / (prime + alt)
    return earth, vector(east, -vel[..., 0] / (meridian + alt), -east * np.tan(lat))


def meters(lla):
    """Meters north, east, down (..., 3) of one unit of lat, lon, height at a place."""
    meridian, prime = radii(lla[..., 0])
    alt = lla[..., 2]
    return vector(meridian + alt, (prime + alt) * np.cos(lla[..., 0]), 0 * alt - 1)


# --- rotations ----------------------------------------------------------------------------------------


def cross(a, b):
    """Vector product (..., 3)."""
    return vector(
        a[..., 1] * b[..., 2] - a[..., 2] * b[..., 1],
        a[..., 2] * b[..., 0] - a[..., 0] * b[..., 2],
        a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0],
    )


def cross_matrix(v):
    """[v x] (3, 3)."""
    return np.array([[0.0, -v[2], v[1]], [v[2], 0.0, -v[0]], [-v[1], v[0], 0.0]])


def rotation_matrix(v):
    """exp([v x]) (3, 3) by Rodrigues."""
    angle = np.sqrt(v @ v)
    if angle == 0.0:
        return np.eye(3)
    K = cross_matrix(v / angle)
    return np.eye(3) + np.sin(angle) * K + 2 * np.sin(angle / 2) ** 2 * (K @ K)


def quaternion_matrix(q):
    """C of a scalar-first Hamilton quaternion: (w^2 - v.v) I + 2 v v' + 2 w [v x]."""
    w, v = q[0], np.asarray(q[1:])
    return (w * w - v @ v) * np.eye(3) + 2 * np.outer(v, v) + 2 * w * cross_matrix(v)


# --- strapdown ----------------------------------------------------------------------------------------


def strapdown(lla, vel, C, dt, dtheta, dvel, before):
    """State after one interval, and the velocity increment in the body axes at its start.

    ``before`` is (dt, dtheta, dvel) of the interval before or None. Both rates are lines through the means
    of the two intervals; the midpoint of the interval serves for Coriolis, transport rate and gravity.
    """
    w, f = dtheta / dt, dvel / dt
    w_slope = f_slope = np.zeros(3)
    if before is not None:
        span = 0.5 * (dt + before[0])
        w_slope, f_slope = (w - before[1] / before[0]) / span, (f - before[2] / before[0]) / span
    turn = dtheta + dt**3 / 12 * cross(w, w_slope)
    K, angle = cross_matrix(turn), np.sqrt(turn @ turn)
    dvel_start = dvel + dt**3 / 12 * (cross(w, f_slope) + cross(f, w_slope))
    if angle > 0:
        K = K / angle
        dvel_start = (
            dvel_start
            + 2 * np.sin(angle / 2) ** 2 / angle * (K @ dvel)
            + (1 - np.sin(angle) / angle) * (K @ K @ dvel)
        )

    dvel_n = C @ dvel_start
    lla_middle = lla + 0.5 * dt * vel / meters(lla)
    g = gravity(lla_middle[0], lla_middle[2])
    earth, transport = frame_rates(lla_middle[0], lla_middle[2], vel)
    vel_middle = vel + 0.5 * (dvel_n + (g - cross(2 * earth + transport, vel)) * dt)
    earth, transport = frame_rates(lla_middle[0], lla_middle[2], vel_middle)
    turn_n = (earth + transport) * dt
    vel_end = vel + dvel_n - 0.5 * cross(turn_n, dvel_n) + dt * (g - cross(2 * earth + transport, vel_middle))
    lla_end = lla + 0.5 * dt * (vel + vel_end) / meters(lla_middle)
    return lla_end, vel_end, rotation_matrix(-turn_n) @ C @ rotation_matrix(turn), dvel_start


# --- linear dynamics by central differences -----------------------------------------------------------


def derivative(lla, vel, C, f_b, w_b):
    """Rates of change (..., 3) of lla and velocity, and the rate in n at which C turns."""
    lat, alt = lla[..., 0], lla[..., 2]
    earth, transport = frame_rates(lat, alt, vel)
    vel_rate = (C @ f_b[..., None])[..., 0] + gravity(lat, alt) - cross(2 * earth + transport, vel)
    return vel / meters(lla), vel_rate, (C @ w_b[..., None])[..., 0] - earth - transport


def jacobian(lla, vel, C, f_b, w_b):
    """F (S, 15, 15) at S states: how fast each error grows by each error."""
    d = np.concatenate([np.diag(STEP), -np.diag(STEP)])  # (30, 15)
    tilt = np.stack([rotation_matrix(row) for row in d[:, 6:9]])
    lla_rate, vel_rate, turn = derivative(lla, vel, C, f_b, w_b)
    per_unit = meters(lla)
    per_unit_rate = 0.5 * (meters(lla + lla_rate) - meters(lla - lla_rate))
    dlla = d[:, :3] / per_unit[:, None]
    est_lla_rate, est_vel_rate, est_turn = derivative(
        lla[:, None] + dlla,
        vel[:, None] + d[:, 3:6],
        tilt @ C[:, None],
        f_b[:, None] - d[:, 12:],
        w_b[:, None] - d[:, 9:12],
    )
    growth = np.zeros((len(lla), 30, 15))
    growth[..., :3] = per_unit[:, None] * (est_lla_rate - lla_rate[:, None]) + per_unit_rate[:, None] * dlla
    growth[..., 3:6] = est_vel_rate - vel_rate[:, None]
    growth[..., 6:9] = est_turn - (tilt @ turn[:, None, :, None])[..., 0]  # of exp([phi x]), to first order
    return np.swapaxes((growth[:, :15] - growth[:, 15:]) / (2 * STEP)[:, None], 1, 2)


def move_by_motion(F, lla, vel, C, f_b, variance):
    """Let an attitude error turn the horizontal force of the motion alone, in F (15, 15).

    Beyond the force of a steady flight that is what noise of a variance on each axis leaves: James and Stein.
    """
    earth, transport = frame_rates(lla[0], lla[2], vel)
    steady = cross(2 * earth + transport, vel)
    more = (C @ f_b - steady)[:2]
    north, east = steady[:2] + max(1 - 9 * variance / (more @ more), 0) * more
    F[3, 8], F[4, 8], F[5, 6], F[5, 7] = -east, north, east, -north


def bend_velocity(P, gain):
    """Add the second-order error of a velocity gained with a heading sd of 2 to 30 deg: psi^2 / 2 of it.

    3/4 sd^4 is the mean square of psi^2 / 2; the velocity gained before follows from P[3:5, 8] / P[8, 8].
    """
    if not np.deg2rad(2.0) ** 2 < P[8, 8] < np.deg2rad(30.0) ** 2:
        return
    old = np.array([P[4, 8], -P[3, 8]]) / P[8, 8]
    new = old + gain[:2]
    if new @ new > old @ old:
        P[3:5, 3:5] += 0.75 * P[8, 8] ** 2 * (1 - (old @ old) / (new @ new)) * np.outer(new, new)


def turn_tilts(P, drifted):
    """Add the tilt error by a heading drift of a variance [rad^2]: psi times the tilt, across it."""
    if drifted > 0.0 and P[8, 8] < np.deg2rad(30.0) ** 2:
        across = np.array([[0.0, -1.0], [1.0, 0.0]])
        P[6:8, 6:8] += drifted * across @ P[6:8, 6:8] @ across.T


# --- the datasheets -----------------------------------------------------------------------------------


def bias_process(triad):
    """Variance at the start, density and decay rate of a bias state."""
    sd = triad.bias_instability / 0.617
    if sd == 0:
        return triad.turn_on_bias_sd**2, 0.0, 0.0
    tau = triad.bias_correlation
    return triad.turn_on_bias_sd**2 + sd**2, 2 * sd**2 / tau, (triad.turn_on_bias_sd == 0) / tau


def fix_covariance(gnss):
    """R (6, 6) of a fix: white and Markov part together."""
    h = gnss.pos_h_white_sd**2 + gnss.pos_h_markov_sd**2
    v = gnss.pos_v_white_sd**2 + gnss.pos_v_markov_sd**2
    s = np.square(gnss.vel_white_sd_n) + gnss.vel_markov_sd**2
    return np.diag([h, h, v, *s])


# --- the filter ---------------------------------------------------------------------------------------


@dataclass
class Answer:
    """Solution at the output times, and every sub-vector used or rejected."""

    t: np.ndarray  # (M,)
    lla: np.ndarray  # (M, 3)
    vel_n: np.ndarray  # (M, 3)
    C_nb: np.ndarray  # (M, 3, 3)
    bias: np.ndarray  # (M, n - 9) gyro, accelerometer, baro
    cov: np.ndarray  # (M, n, n)
    nis: np.ndarray  # (K,)
    accepted: np.ndarray  # (K,)


def antenna(lla, vel, C, lever, w_b):
    """Position [lat, lon, height], velocity of the antenna, and the errors of both by the states (6, 15).

    As the filter declares it: the rate against the Earth is taken as known, but for the gyro bias in it.
    """
    earth, _ = frame_rates(lla[0], lla[2], vel)
    w_eb_b = w_b - C.T @ earth
    H = np.zeros((6, 15))
    H[:, :6] = np.eye(6)
    H[:3, 6:9] = -cross_matrix(C @ lever)
    H[3:, 6:9] = -cross_matrix(C @ cross(w_eb_b, lever))
    H[3:, 9:12] = C @ cross_matrix(lever)
    return lla + C @ lever / meters(lla), vel + C @ cross(w_eb_b, lever), H


def earth_fixed(lla, vector_n):
    """Place [m] and a vector of n, Earth-fixed."""
    s, c, sl, cl = np.sin(lla[0]), np.cos(lla[0]), np.sin(lla[1]), np.cos(lla[1])
    prime = radii(lla[0])[1]
    flat = (prime + lla[2]) * c
    place = np.array([flat * cl, flat * sl, (prime * (SEMI_MINOR / SEMI_MAJOR) ** 2 + lla[2]) * s])
    C_en = np.array([[-s * cl, -sl, -c * cl], [-s * sl, cl, -c * sl], [c, 0.0, -s]])
    return place, C_en @ vector_n, C_en


def range_and_rate(lla, vel, sat_pos, sat_vel):
    """Geometric range and its rate, and elevation and azimuth, of a satellite Earth-fixed at transmission."""
    place, speed, C_en = earth_fixed(lla, vel)
    spin = np.array([0.0, 0.0, EARTH_RATE])
    travel = 0.07
    for _ in range(6):
        turn = rotation_matrix(-spin * travel)
        line = turn @ sat_pos - place
        travel = np.sqrt(line @ line) / LIGHT
    e = line / np.sqrt(line @ line)
    sat = turn @ (sat_vel + cross(spin, sat_pos))
    rate = e @ (sat - speed - cross(spin, place)) / (1 + e @ sat / LIGHT)
    north, east, down = C_en.T @ e
    return travel * LIGHT, rate, np.arcsin(-down), np.arctan2(east, north)


def may_be_noise(w_b, variance):
    """Whether a rate may be the noise of a sample: an antenna shows no attitude by it."""
    return w_b @ w_b < 16.3 * variance


def satellite(lla, vel, C, bias, lever, w_b, slow, sat_pos, sat_vel, n, mask):
    """Range and rate, H (2, n) of both by differences, elevation and azimuth; nothing below the mask."""

    def measured(x):
        place, speed, tilted, _ = correct(lla, vel, C, bias, -x)
        antenna_lla, antenna_vel, _ = antenna(place, speed, tilted, lever, w_b - x[9:12])
        if slow:
            _, antenna_vel, _ = antenna(place, speed, C, lever, w_b - x[9:12])
        return np.array(range_and_rate(antenna_lla, antenna_vel, sat_pos, sat_vel))

    found = measured(np.zeros(n))
    if found[2] < mask:
        return None
    H = np.zeros((2, n))
    for k, size in enumerate(np.repeat([30.0, 1.0, 1e-3, 1e-3], 3)):
        x = np.zeros(n)
        x[k] = size
        H[:, k] = (measured(x) - measured(-x))[:2] / (2 * size)
    return found, H


def correct(lla, vel, C, bias, x):
    """State less an estimated error."""
    level = rotation_matrix(vector(-x[6], -x[7], 0.0)) @ C
    return (
        lla - x[:3] / meters(lla),
        vel - x[3:6],
        rotation_matrix(vector(0.0, 0.0, -x[8])) @ level,
        bias - x[9:],
    )


def feed_back(kf, lla, vel, C, bias):
    """State less the error of a filter, which becomes zero; tilts and biases are those of the turned unit.

    A tilt is an error about an axis that is fixed in the unit, however the unit is turned about the vertical;
    a bias that hides behind a tilt turns what is left of it by the tilt that it stands for.
    """
    x = kf.x[:, 0]
    turn = np.eye(len(x))
    turn[6:9, 6:9] = rotation_matrix(vector(0.0, 0.0, -x[8]))
    turn[12:15, 12:15] = rotation_matrix(cross(-C[2], x[12:15]) / 9.80665)
    kf.P, kf.x = turn @ kf.P @ turn.T, np.zeros((len(x), 1))
    return correct(lla, vel, C, bias, x)


def transition(F, T, decay):
    """Phi (n, n) over T: F T, its square along bias - tilt - velocity - position, the decay of the biases."""
    chain = np.zeros((15, 15))
    for row, column in ((0, 3), (3, 6), (3, 12), (6, 9)):
        block = np.s_[row : row + 3, column : column + 3]
        chain[block] = F[block] * T
    Phi = np.diag(decay)
    Phi[:9, :15] += (F * T + chain @ chain / 2)[:9]
    return Phi


OWN = {"position": [0, 1, 2], "velocity": [3, 4, 5], "baro": [15]}
"""States a sensor measures by itself; they grow when it is taken back."""


class Aiding:
    """Gate and use sub-vectors by filterpy; when each was rejected since the last use.

    After so many seconds of at least three rejections one that has states of its own is taken back.
    """

    def __init__(self, kf, gate_probability, readmit_after_s):
        self.kf, self.sound, self.readmit_after_s = kf, 1 - gate_probability, readmit_after_s
        self.now, self.refused, self.rows, self.jumped = 0.0, {}, [], False
        self.used = {"position": -np.inf, "velocity": -np.inf}

    def compare(self, z, H, R):
        """How a position and its velocity go together.

        The position is beyond the gate, and its velocity too, or what P makes of such a drift; and each is
        within the gate, but the velocity not once the position is used.
        """
        kf, sound = self.kf, chi2.ppf(self.sound, 3)
        e, P = np.asarray(z) - H @ kf.x[: H.shape[1], 0], kf.P[: H.shape[1], : H.shape[1]]
        S = H @ P @ H.T + R
        place, speed, both = (e[k] @ np.linalg.solve(S[k, k], e[k]) for k in map(slice, (0, 3, 0), (3, 6, 6)))
        apart = np.trace(S[:3, :3] - R[:3, :3]) > np.trace(R[:3, :3])
        drifted = place > sound and (speed > sound or (apart and both - place <= sound))
        return drifted, place <= sound and speed <= sound and both - place > sound

    def jumps(self, z, H, R, since):
        """Whether a fix is off by more than a filter that used one ``since`` [s] drifts in any attitude."""
        P = self.kf.P[: H.shape[1], : H.shape[1]]
        e, fall = np.reshape(z, (2, 3)), 2 * 9.80665 * since
        place, speed = (e**2 / np.diag(H @ P @ H.T + R).reshape(2, 3)).sum(axis=1) / chi2.ppf(self.sound, 3)
        off, change = np.linalg.norm(e, axis=1)
        if self.used["position"] == -np.inf:
            return False
        if speed > 1:
            return speed > 4 and change > fall
        return since >= 10 or (place > 4 and off > (change + fall / 2) * since)

    def use(self, name, z, H, R, drifted=False, contradicts=False):
        """Gate one sub-vector of predicted less measured values z (m,), then update error and P."""
        kf, column = self.kf, np.asarray(z).reshape(-1, 1)
        wide = np.zeros((len(z), kf.dim_x))
        wide[:, : H.shape[1]] = H
        innovation = column - wide @ kf.x
        S = wide @ kf.P @ wide.T + R
        nis = (innovation.T @ np.linalg.solve(S, innovation)).item()
        sound = nis <= chi2.ppf(self.sound, len(z)) and not contradicts
        before = self.refused.get(name, [])
        jumped = self.jumped and name in ("position", "velocity")
        late = len(before) > 2 and self.now - before[0] > self.readmit_after_s - 1e-6
        accepted = sound or drifted or (late and name in OWN)
        self.refused[name] = [] if accepted else [*before, self.now]
        self.rows.append((nis, accepted))
        if accepted and not sound:  # a step of its own, or an error P had too small
            refused = kf.P @ wide.T @ np.linalg.solve(S, innovation)
            if jumped or (name == "baro" and max(map(self.used.get, ("position", "velocity"))) > before[0]):
                refused[:] = 0.0  # the filter is where it should be: GNSS was used meanwhile, or jumped
            step = np.zeros(kf.dim_x)
            step[OWN[name]] = 0.0 if drifted else innovation[:, 0]
            kf.P = kf.P + refused @ refused.T + np.diag(step**2)
        if accepted:
            self.used[name] = self.now
            kf.update(column, R=R, H=wide)
            assert kf.x.shape == (kf.dim_x, 1)
        return accepted


def first_sample(imu_t, arrival):
    """Index of the first IMU sample at or after each arrival, as {sample: row}."""
    return {int(k): row for row, k in enumerate(np.searchsorted(imu_t, arrival - 1e-6)) if k < len(imu_t)}


def wandering(o, sky):
    """What wanders in ranges on one frequency, each satellite's error and the troposphere, and the rates."""
    if not (sky.ionosphere_sd or sky.gps_space_sd or sky.glonass_space_sd or sky.troposphere_sd):
        return [], np.zeros(0)
    names = [(system, sat, "range") for system, sat in sorted(set(zip(o.system, o.sat, strict=True)))]
    space = {0: sky.gps_space_sd, 1: sky.glonass_space_sd}
    # at 35 deg under 4 m of delay, and the part of it that satellites do not share
    above, rates = 1.6 * np.hypot(sky.ionosphere_sd, 4.0 * sky.ionosphere_share), []
    times = np.array([sky.space_correlation, sky.ionosphere_correlation, sky.multipath_correlation])
    for system, *_ in names:
        parts = np.array([space[system] ** 2, 0.15 * above**2, sky.multipath_zenith_sd**2])
        rates.append(parts.sum() / (parts @ times))
    shared = [("ionosphere", k) for k in range(5)]
    rates += 5 * [1 / sky.ionosphere_correlation]
    return [*names, *shared, "troposphere"], np.array([*rates, 1 / sky.troposphere_correlation])


def share_ionosphere(el, az, decay):
    """Square root of what a satellite shares with five places: rows of the inverse Cholesky factor times the
    correlations with them, exp(-d / decay), on a shell 350 km high."""
    places = 9e5 * np.array([[0, 0], [1, 0], [0, 1], [-1, 0], [0, -1]])
    radius = 6371e3
    away = (radius + 350e3) * (np.pi / 2 - el - np.arcsin(radius / (radius + 350e3) * np.cos(el)))
    here = away * np.array([np.cos(az), np.sin(az)])
    K = np.exp(-np.linalg.norm(places[:, None] - places, axis=2) / decay)
    return np.linalg.solve(np.linalg.cholesky(K), np.exp(-np.linalg.norm(places - here, axis=1) / decay))


def use_satellite(aiding, o, row, state, lever, w_b, slow, sky, wander):
    """Use one satellite of one frequency: range, then rate; ``wander`` are its states, from the first on."""
    lla, _, _, bias = state
    n = aiding.kf.dim_x
    mask = sky.elevation_mask
    seen = satellite(*state, lever, w_b, slow, o.sat_pos_e[row], o.sat_vel_e[row], n, mask)
    if seen is None:
        return
    (distance, rate, el, az), H = seen
    ionosphere = delays.klobuchar_kernel(
        lla[0], lla[1], el, np.sin(az), np.cos(az), o.t[row] + o.gps_t0, o.klobuchar
    )
    distance += ionosphere * (GPS_L1 / o.frequency[row, 0]) ** 2
    distance += delays.zenith_troposphere(lla[0], lla[2]).item() * delays.mapping_kernel(np.sin(el))
    H[0, n - 3], H[1, n - 2] = 1.0, 1.0
    if o.system[row] == 1:
        H[0, n - 1] = 1.0
        distance += bias[-1]
    name = (o.system[row], o.sat[row])
    slant = (1 + 16 * (0.53 - el / np.pi) ** 3) * (GPS_L1 / o.frequency[row, 0]) ** 2
    above = np.hypot(
        sky.ionosphere_sd * slant, sky.ionosphere_share * ionosphere * (GPS_L1 / o.frequency[row, 0]) ** 2
    )
    space = sky.glonass_space_sd if o.system[row] == 1 else sky.gps_space_sd
    near = sky.multipath_zenith_sd + sky.multipath_horizon_sd * np.exp(-el / np.deg2rad(10))
    shared = share_ionosphere(el, az, sky.ionosphere_decay)
    own = np.sqrt(above**2 * (1 - shared @ shared) + space**2 + near**2)
    left = o.sd_pseudorange[row] ** 2
    for which, size in (
        ((*name, "range"), own),
        *((("ionosphere", k), above * shared[k]) for k in range(5)),
        ("troposphere", sky.troposphere_sd * delays.mapping_kernel(np.sin(el))),
    ):
        if which not in wander:
            continue
        at = 9 + len(bias) - 3 - len(wander) + wander.index(which)
        H[0, at] = size
        distance += size * bias[at - 9]
        left -= size**2
    z = distance + bias[-3] - (o.pseudorange[row, 0] + o.sat_clock[row] - o.group_delay[row])
    aiding.use(("range", *name), [z], H[:1], np.array([[left]]))
    z = rate + bias[-2] - (o.range_rate[row, 0] + o.sat_clock_rate[row])
    aiding.use(("rate", *name), [z], H[1:], np.array([[o.sd_range_rate[row] ** 2]]))


def navigate(sensors, initial, gate_probability=1e-5, readmit_after_s=10.0, tight=False):
    """Run the twin over a record without faulty rows; ``tight`` takes satellites in place of fixes."""
    imu, specs = sensors.imu, sensors.specs
    o, sky = sensors.observations, specs.gnss and specs.gnss.sky
    wander, wander_rate = wandering(o, sky) if tight else ([], [])
    n = (15 if sensors.baro is None else 16) + len(wander) + 3 * tight
    kf = KalmanFilter(dim_x=n, dim_z=3)
    kf.P = np.zeros((n, n))
    kf.P[:9, :9] = initial.cov
    q, decay_rate = np.zeros(n), np.zeros(n)
    q[3:6], q[6:9] = specs.imu.accel.random_walk**2, specs.imu.gyro.random_walk**2
    for i, triad in ((9, specs.imu.gyro), (12, specs.imu.accel)):
        variance, q[i : i + 3], decay_rate[i : i + 3] = bias_process(triad)
        kf.P[i : i + 3, i : i + 3] = variance * np.eye(3)
    fixes_at, baro_at = {}, {}
    epochs_at, clock = {}, n - 3
    if tight:
        epochs_at = first_sample(imu.t, o.t_arrival[o.epoch_start[:-1]])
        at = slice(clock - len(wander), clock)
        kf.P[at, at], decay_rate[at], q[at] = np.eye(len(wander)), wander_rate, 2 * wander_rate
        for i, sd in enumerate((sky.clock_offset_sd, sky.clock_drift_sd, sky.glonass_offset_sd)):
            kf.P[clock + i, clock + i] = sd**2
        changes, _ = quad(
            lambda f: 2 * (1 - np.cos(2 * np.pi * f / specs.gnss.rate)) / f,
            0,
            0.5 / sky.integration,
            limit=500,
        )
        walk = LIGHT**2 * (2 * np.pi**2 * sky.clock_h_m2 + specs.gnss.rate * changes * sky.clock_h_m1)
        q[clock], q[clock + 1] = LIGHT**2 * sky.clock_h_0 / 2, walk
    elif sensors.fixes is not None:
        fixes_at, fix_R = first_sample(imu.t, sensors.fixes.t_arrival), fix_covariance(specs.gnss)
    if sensors.baro is not None:
        baro_at = first_sample(imu.t, sensors.baro.t_arrival)
        kf.P[15, 15], q[15] = specs.baro.bias_sd**2, specs.baro.bias_walk**2
    aiding = Aiding(kf, gate_probability, readmit_after_s)

    lla, vel, C = initial.lla, initial.vel_n, quaternion_matrix(initial.q_nb)
    bias = np.zeros(n - 9)
    wanted = list(sensors.output_t)
    out = []
    if wanted[0] < initial.t + 1e-6:
        out.append((lla, vel, C, bias, kf.P.copy()))
    before, points, now, used = None, [], initial.t, initial.t
    for k in range(len(imu)):
        dt, now = imu.t[k] - now, imu.t[k]
        dtheta, dvel = imu.dtheta_b[k] - bias[:3] * dt, imu.dvel_b[k] - bias[3:6] * dt
        start = (lla, vel, C)
        lla, vel, C, dvel_start = strapdown(lla, vel, C, dt, dtheta, dvel, before)
        before = (dt, dtheta, dvel)
        points.append((*start, dvel_start / dt, dtheta / dt, dt))
        bias = bias * np.exp(-decay_rate[9:] * dt)
        if tight:
            bias[-3] += dt * bias[-2]
        asked = len(out) < len(wanted) and wanted[len(out)] <= now + 1e-6
        if not (asked or k in fixes_at or k in baro_at or k in epochs_at):
            continue
        *states, spans = (np.array(column) for column in zip(*points, strict=True))
        for F, T, *at in zip(jacobian(*states), spans, *states[:4], strict=True):
            move_by_motion(F, *at, q[3] / T)
            Phi, Q = transition(F, T, np.exp(-decay_rate * T)), np.diag(q * T)
            if tight:
                Phi[clock, clock + 1] = T
                Q[clock, clock] += walk * T**3 / 3
                Q[clock, clock + 1] = Q[clock + 1, clock] = walk * T**2 / 2
            known = kf.P[8, 8]
            bend_velocity(kf.P, at[2] @ at[3] * T)
            kf.predict(F=Phi, Q=Q)
            turn_tilts(kf.P, kf.P[8, 8] - known)
        points, aiding.now = [], now
        w_b = dtheta / dt
        slow = may_be_noise(w_b, specs.imu.gyro.random_walk**2 / dt)
        if k in fixes_at:
            row = fixes_at[k]
            place, speed, H = antenna(lla, vel, C, sensors.antenna_b, w_b)
            if slow:
                H[3:, 6:9] = 0.0
            z = np.concatenate(
                [(place - sensors.fixes.lla[row]) * meters(lla), speed - sensors.fixes.vel_n[row]]
            )
            missed = aiding.refused.get("position", []) + aiding.refused.get("velocity", [])
            if not missed:
                aiding.jumped = aiding.jumps(z, H, fix_R, now - used)
            returns = now - used >= 10.0 and not missed
            drifted, contradicts = aiding.compare(z, H, fix_R) if returns or missed else (False, False)
            drifted = drifted and returns
            accepted = aiding.use("position", z[:3], H[:3], fix_R[:3, :3], drifted, contradicts)
            if np.isfinite(z).all():
                accepted |= aiding.use("velocity", z[3:], H[3:], fix_R[3:, 3:], drifted)
            used = now if accepted else used
            lla, vel, C, bias = feed_back(kf, lla, vel, C, bias)
        if k in epochs_at:
            epoch = epochs_at[k]
            for row in range(o.epoch_start[epoch], o.epoch_start[epoch + 1]):
                state = lla, vel, C, bias
                use_satellite(aiding, o, row, state, sensors.antenna_b, w_b, slow, sky, wander)
            lla, vel, C, bias = feed_back(kf, lla, vel, C, bias)
        if k in baro_at:
            H = np.zeros((1, 16))
            H[0, 2], H[0, 15] = -1.0, 1.0
            z = lla[2] + bias[6] - sensors.baro.alt_baro[baro_at[k]]
            aiding.use("baro", [z], H, np.array([[specs.baro.white_sd**2]]))
            lla, vel, C, bias = feed_back(kf, lla, vel, C, bias)
        if asked:
            out.append((lla, vel, C, bias, kf.P.copy()))
    columns = [np.array(column) for column in zip(*out, strict=True)]
    nis, accepted = zip(*aiding.rows, strict=True) if aiding.rows else ((), ())
    return Answer(np.array(wanted[: len(out)]), *columns, np.array(nis), np.array(accepted, bool))
