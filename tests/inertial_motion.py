"""A smooth, rich motion, integrated in the inertial frame by an ODE solver: a reference of mechanizations."""

import numpy as np
from scipy.integrate import solve_ivp

from bench.core.mathematics import earth, rotation


def body_rates(t):
    """A smooth, rich motion: w_ib_b [rad/s] and f_b [m/s^2]."""
    w = np.stack([0.5 * np.sin(0.9 * t), 0.2 * np.sin(0.5 * t + 1), 0.15 * np.cos(0.3 * t)])
    f = np.stack([1.0 * np.sin(0.4 * t), 2.0 * np.sin(0.7 * t + 0.3), -9.8 + 1.5 * np.cos(0.6 * t)])
    return w, f


def integrate_rates(t):
    """Exact integrals of :func:`body_rates` between the epochs t."""
    w = np.stack(
        [-0.5 / 0.9 * np.cos(0.9 * t), -0.2 / 0.5 * np.cos(0.5 * t + 1), 0.15 / 0.3 * np.sin(0.3 * t)], axis=1
    )
    f = np.stack(
        [
            -1.0 / 0.4 * np.cos(0.4 * t),
            -2.0 / 0.7 * np.cos(0.7 * t + 0.3),
            -9.8 * t + 1.5 / 0.6 * np.sin(0.6 * t),
        ],
        axis=1,
    )
    return np.diff(w, axis=0), np.diff(f, axis=0)


def inertial_solution(start, duration):
    """The same motion from (lla, vel_n, q_nb) by DOP853: position, velocity, attitude at the end."""
    lla, vel_n, q_nb = (np.array(x) for x in start)
    C_en = earth.matrix_en(lla[0], lla[1])
    r = earth.to_ecef(lla)
    rate = np.array([0.0, 0.0, earth.EARTH_RATE])
    v = C_en @ vel_n + np.cross(rate, r)
    q = rotation.multiply(rotation.from_matrix(C_en), q_nb)  # the frames e and i agree at t = 0

    def slope(t, x):
        turn = rotation.from_rotvec(-rate * t)  # i to e
        lla = earth.to_geodetic(rotation.rotate(turn, x[:3]))
        g_e = earth.matrix_en(lla[0], lla[1]) @ earth.gravity_n(lla[0], lla[2])
        gravity = rotation.rotate(rotation.conjugate(turn), g_e)
        gravitation = gravity + np.cross(rate, np.cross(rate, x[:3]))
        w, f = body_rates(t)
        return np.concatenate(
            [
                x[3:6],
                rotation.rotate(x[6:], f) + gravitation,
                0.5 * rotation.multiply(x[6:], np.concatenate([[0], w])),
            ]
        )

    end = solve_ivp(
        slope, (0, duration), np.concatenate([r, v, q]), method="DOP853", rtol=1e-13, atol=1e-9
    ).y[:, -1]
    turn = rotation.from_rotvec(-rate * duration)
    pos_e = rotation.rotate(turn, end[:3])
    lla = earth.to_geodetic(pos_e)
    C_en = earth.matrix_en(lla[0], lla[1])
    vel_n = C_en.T @ (rotation.rotate(turn, end[3:6]) - np.cross(rate, pos_e))
    q_eb = rotation.multiply(turn, end[6:] / np.linalg.norm(end[6:]))
    return lla, vel_n, rotation.multiply(rotation.conjugate(rotation.from_matrix(C_en)), q_eb)
