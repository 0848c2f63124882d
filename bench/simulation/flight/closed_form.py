"""S-turns in closed form, and the increments of an error-free IMU in them, exact to rounding.

Course chi_0 + A (1 - cos w t), height h_0 + B (1 - cos w_h t), the bank of the turn, a nod in pitch.
The position is the integral of the velocity by an ODE solver (1e-13); rate and specific force are the
navigation equations solved for them, integrated over each sample by Gauss's rule with three nodes.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.integrate import solve_ivp

from bench.core.mathematics import rotation
from bench.core.mathematics.arrays import FloatArray
from bench.core.mathematics.earth import EARTH_RATE, gravity_n, radii
from bench.core.mathematics.units import STANDARD_GRAVITY

_DEG = np.pi / 180


@dataclass(frozen=True, slots=True)
class SwingingFlight:
    """A flight without aerodynamics, given by the motion of the IMU."""

    lat: float = 50.0 * _DEG  # [rad]
    lon: float = 30.0 * _DEG  # [rad]
    alt: float = 5000.0  # [m]
    speed: float = 245.0  # over ground [m/s]
    course: float = 40.0 * _DEG  # at the start [rad]
    turn_rate: float = 2.4 * _DEG  # largest [rad/s]
    period: float = 120.0  # of a left and a right turn [s]
    climb: float = 300.0  # half of what is climbed and lost again [m]
    climb_period: float = 200.0  # [s]
    bank: float = 1.0  # of that of a coordinated turn
    nod: float = 2.0 * _DEG  # pitch [rad]
    nod_period: float = 17.0  # [s]

    def fly(self, duration: float, rate: float) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return the motion (N + 1, 10) at a rate [Hz] for a duration [s], and dtheta_b and dvel_b (N, 3).

        A row of the motion is lat, lon [rad], height [m], velocity [m/s] north, east, down, q_nb.
        """
        n = round(duration * rate)
        nodes, weights = np.polynomial.legendre.leggauss(3)
        t = np.arange(n + 1) / rate
        within = (np.arange(n)[:, None] + 0.5 * (1.0 + nodes)) / rate
        every = np.unique(np.concatenate([t, within.ravel()]))
        found = solve_ivp(
            self._slope,
            (0.0, every[-1]),
            [self.lat, self.lon],
            method="DOP853",
            t_eval=every,
            rtol=1e-13,
            atol=1e-15,
            max_step=1.0,
        ).y
        lat, lon = found[:, np.searchsorted(every, t)]
        velocity, _, height, euler, _ = self._motion(t)
        nav = np.column_stack([lat, lon, height, velocity, rotation.from_euler(*euler.T)])
        w_b, f_b = self.sense(within.ravel(), found[0, np.searchsorted(every, within.ravel())])
        share = weights[:, None] / (2.0 * rate)
        return (
            nav,
            np.sum(w_b.reshape(n, 3, 3) * share, axis=1),
            np.sum(f_b.reshape(n, 3, 3) * share, axis=1),
        )

    def _slope(self, t: float, y: FloatArray) -> list[float]:
        velocity, _, height, _, _ = self._motion(np.array([t]))
        R_M, R_P = radii(y[0])
        north, east = velocity[0, :2]
        return [north / (R_M + height[0]), east / ((R_P + height[0]) * np.cos(y[0]))]

    def _motion(self, t: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray, FloatArray]:
        """Return velocity, its rate, height, Euler angles and their rates, (K, 3) but height (K,)."""
        w, w_h, w_p = (2.0 * np.pi / p for p in (self.period, self.climb_period, self.nod_period))
        course = self.course + self.turn_rate / w * (1.0 - np.cos(w * t))
        turn, turn_rate = self.turn_rate * np.sin(w * t), self.turn_rate * w * np.cos(w * t)
        height = self.alt + self.climb * (1.0 - np.cos(w_h * t))
        down = -self.climb * w_h * np.sin(w_h * t)
        down_rate = -self.climb * w_h**2 * np.cos(w_h * t)
        s, c, v = np.sin(course), np.cos(course), self.speed
        velocity = np.column_stack([v * c, v * s, down])
        velocity_rate = np.column_stack([-v * turn * s, v * turn * c, down_rate])
        lean = self.bank * v / STANDARD_GRAVITY
        bank, bank_rate = np.arctan(lean * turn), lean * turn_rate / (1.0 + (lean * turn) ** 2)
        pitch, pitch_rate = self.nod * np.sin(w_p * t), self.nod * w_p * np.cos(w_p * t)
        euler = np.column_stack([bank, pitch, course])
        return velocity, velocity_rate, height, euler, np.column_stack([bank_rate, pitch_rate, turn])

    def sense(self, t: FloatArray, lat: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return w_ib_b [rad/s] and f_b [m/s^2], (K, 3), at epochs (K,) and the latitudes (K,) there."""
        velocity, velocity_rate, height, euler, euler_rate = self._motion(t)
        R_M, R_P = radii(lat)
        s, c = np.sin(lat), np.cos(lat)
        lat_rate, lon_rate = velocity[:, 0] / (R_M + height), velocity[:, 1] / ((R_P + height) * c)
        earth = EARTH_RATE * np.column_stack([c, np.zeros_like(c), -s])
        over = np.column_stack([lon_rate * c, -lat_rate, -lon_rate * s])
        force = velocity_rate + np.cross(2.0 * earth + over, velocity) - gravity_n(lat, height)
        (roll, pitch, _), (p, q, r) = euler.T, euler_rate.T
        w_nb_b = np.column_stack(
            [
                p - r * np.sin(pitch),
                q * np.cos(roll) + r * np.sin(roll) * np.cos(pitch),
                -q * np.sin(roll) + r * np.cos(roll) * np.cos(pitch),
            ]
        )
        q_bn = rotation.conjugate(rotation.from_euler(*euler.T))
        return w_nb_b + rotation.rotate(q_bn, earth + over), rotation.rotate(q_bn, force)
