"""Vibration by the rotors of a multirotor: a rigid body that swings about its smooth motion.

Order n of rotor r is a force at its hub: at n = 1 (unbalance) it turns with the rotor, in the plane of the
rotors; at n = 2 (blades passing) and n = 4 it is along z. It grows with the square of the speed of the rotor,
so that displacement and angle of the body have constant amplitudes: for a force over mass A cos(n psi)
at the reference speed w,

    u = -A / (n w)^2 cos(n psi)          theta = -(r x A) / (n w k)^2 cos(n psi)

with the position r of the hub and the radii of gyration k. The angle psi of each rotor is the integral of its
speed, linear between the times of the truth, and every force has its own phase.

The attitude is C exp(theta x) and the position p + C u, with C and p of the truth: bounded, as the controller
holds them. An IMU reads, to the second order in theta,

    w + theta' - theta x theta' / 2 - theta x w          f + u'' + 2 w x u' - theta x (f + u'')

The means of the two products are what coning and sculling add: an attitude and a velocity computed from the
increments of the inner rate do not drift, computed from sums of increments they do. Left out are w x (w x u)
and w' x u, below 1e-3 of u'' up to 10 rad/s. Structure and isolators are rigid. What is slower than 2 Hz the
controller or the ground holds: u and theta have a factor w^2 / (w^2 + w0^2), 0 for a rotor that stands.
"""

from __future__ import annotations

import numpy as np

from bench.core.compilation.compiled import kernel
from bench.core.files import disk_arrays
from bench.core.mathematics.arrays import FloatArray
from bench.core.records.data import Trajectory
from bench.core.records.rotor_speeds import AHEAD, RIGHT, ROTORS, SENSES
from bench.core.records.sensor_specs import VibrationSpec
from bench.core.words.exceptions import ConfigError
from bench.simulation.sensors.draws import SensorDraws

ORDERS = (1, 2, 4)
"""Periods per revolution."""
NEEDED = ("rotor_forward", "rotor_right", "gyration_x", "gyration_y", "gyration_z")
"""Figures without which rotors shake nothing."""
_HELD = 2.0 * np.pi * 2.0  # w0 [rad/s]


class RotorTones:
    """Vibration of an IMU by rotors over a piece of a flight.

    Parameters
    ----------
    truth : Trajectory
        With the speeds of its rotors.
    spec : VibrationSpec
        Forces at the reference speed, positions, radii of gyration.
    draws : SensorDraws
        Has the stream "rotors", and the angles at the end of the piece before.

    Raises
    ------
    ConfigError
        If the truth has no rotors, or a position or a radius is missing.
    """

    def __init__(self, truth: Trajectory, spec: VibrationSpec, draws: SensorDraws) -> None:
        if not len(truth.rotors):
            raise ConfigError(
                "[vibration] rotor_accel needs the speeds of rotors, which this flight does not have"
            )
        if missing := list_missing(spec):
            raise ConfigError(f"[vibration] vibration by rotors needs {', '.join(missing)} above 0")
        shape = len(ROTORS), len(ORDERS)
        phases = draws.keep("rotor phases", lambda: draws.stream("rotors").uniform(0.0, 2 * np.pi, shape))
        self._turn, self._move = compute_amplitudes(spec, phases)
        self._t, self._speed = truth.t, truth.rotors.speed
        self._angle = disk_arrays.empty(self._speed.shape)
        turn_kernel(self._t, self._speed, draws.keep("turned", lambda: np.zeros(len(ROTORS))), self._angle)

    def add(
        self, rows: slice, dtheta_b: FloatArray, dvel_b: FloatArray, count: int
    ) -> tuple[FloatArray, FloatArray]:
        """Return dtheta_b and dvel_b (K count, 3) over the parts of samples, with the vibration.

        ``rows`` are the K samples, ``dtheta_b`` and ``dvel_b`` (K, 3) their smooth increments, of which each
        of the ``count`` parts of a sample has an equal share.
        """
        out = [disk_arrays.empty((len(dtheta_b) * count, 3)) for _ in range(2)]
        ends = slice(rows.start, rows.stop + 1)
        tones_kernel(
            self._t[ends], self._speed[ends], self._angle[ends], dtheta_b, dvel_b, np.array(ORDERS, float),
            self._turn, self._move, count, np.empty((2, 4, 3)), np.empty((3, len(ROTORS))), *out,
        )  # fmt: skip
        return out[0], out[1]


def list_missing(spec: VibrationSpec) -> list[str]:
    """Return the keys of positions and radii of gyration that are 0."""
    return [f"{name}_m" for name in NEEDED if getattr(spec, name) <= 0]


def compute_amplitudes(spec: VibrationSpec, phases: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the amplitudes of angle [rad] and displacement of the IMU [m], b.

    Parameters
    ----------
    spec : VibrationSpec
        Forces, positions, radii of gyration.
    phases : (4, 3) array
        Phase of each rotor and order [rad].

    Returns
    -------
    turn, move : (4, 3, 2, 3) arrays
        By rotor, order, cosine and sine of the angle of the rotor times the order, and axis.
    """
    rms = np.array([spec.rotor_accel_1, spec.rotor_accel_2, spec.rotor_accel_4])
    size = -np.sqrt(2.0) * rms / (np.array(ORDERS) * spec.rotor_reference) ** 2  # of the displacement [m]
    square = np.array([spec.gyration_x, spec.gyration_y, spec.gyration_z]) ** 2
    imu_b = np.array([spec.imu_forward, spec.imu_right, spec.imu_down])
    turn, move = np.zeros((2, len(ROTORS), len(ORDERS), 2, 3))
    for r, sense in enumerate(SENSES):
        hub_b = np.array([AHEAD[r] * spec.rotor_forward, RIGHT[r] * spec.rotor_right, -spec.rotor_up])
        for k in range(len(ORDERS)):
            c, s = np.cos(phases[r, k]), np.sin(phases[r, k])
            parts = [[c, sense * s, 0.0], [-s, sense * c, 0.0]] if k == 0 else [[0, 0, c], [0, 0, -s]]
            for part, along in enumerate(size[k] * np.array(parts)):
                turn[r, k, part] = np.cross(hub_b, along) / square
                move[r, k, part] = along + np.cross(turn[r, k, part], imu_b)
    return turn, move


@kernel
def turn_kernel(t: FloatArray, speed: FloatArray, turned: FloatArray, angle: FloatArray) -> None:
    """Fill angle (N, 4) from the speeds (N, 4) at times t (N,), linear in between.

    ``turned`` (4,) is the angle at t[0], and becomes the angle at the end.
    """
    for r in range(speed.shape[1]):
        angle[0, r] = turned[r]
        for k in range(1, len(t)):
            angle[k, r] = angle[k - 1, r] + 0.5 * (speed[k - 1, r] + speed[k, r]) * (t[k] - t[k - 1])
        turned[r] = angle[len(t) - 1, r]


@kernel
def swing_kernel(
    speed: FloatArray, angle: FloatArray, slope: FloatArray, orders: FloatArray, turn: FloatArray,
    move: FloatArray, out: FloatArray,
) -> None:  # fmt: skip
    """Fill out (4, 3) with theta, theta', u', u'' at speed, angle and slope of the speed (4,) of rotors."""
    for j in range(4):
        for i in range(3):
            out[j, i] = 0.0
    for r in range(speed.shape[0]):
        c, s = np.cos(angle[r]), np.sin(angle[r])
        free = speed[r] * speed[r] / (speed[r] * speed[r] + _HELD * _HELD)
        for k in range(orders.shape[0]):
            if k > 0:  # twice the order before
                c, s = c * c - s * s, 2.0 * c * s
            rate, bend = orders[k] * speed[r], orders[k] * slope[r]
            for i in range(3):
                a, b = free * turn[r, k, 0, i], free * turn[r, k, 1, i]
                out[0, i] += a * c + b * s
                out[1, i] += rate * (b * c - a * s)
                a, b = free * move[r, k, 0, i], free * move[r, k, 1, i]
                out[2, i] += rate * (b * c - a * s)
                out[3, i] += bend * (b * c - a * s) - rate * rate * (a * c + b * s)


@kernel
def tones_kernel(
    t: FloatArray, speed: FloatArray, angle: FloatArray, dtheta: FloatArray, dvel: FloatArray,
    orders: FloatArray, turn: FloatArray, move: FloatArray, count: int, swing: FloatArray, spin: FloatArray,
    out_theta: FloatArray, out_vel: FloatArray,
) -> None:  # fmt: skip
    """Fill out (K count, 3) with the increments of the parts of samples; t, speed, angle have K + 1 rows.

    theta and u' are differences of both ends; the products are integrated by trapezoids, which are exact in
    the mean. ``swing`` (2, 4, 3) and ``spin`` (3, 4) are memory.
    """
    w, psi, slope = spin[0], spin[1], spin[2]
    for k in range(dtheta.shape[0]):
        step = t[k + 1] - t[k]
        h = step / count
        for r in range(4):
            slope[r] = (speed[k + 1, r] - speed[k, r]) / step
        swing_kernel(speed[k], angle[k], slope, orders, turn, move, swing[0])
        for part in range(1, count + 1):
            old, new = swing[(part + 1) % 2], swing[part % 2]
            if part < count:
                since = part * h
                for r in range(4):
                    w[r] = speed[k, r] + slope[r] * since
                    psi[r] = angle[k, r] + (speed[k, r] + 0.5 * slope[r] * since) * since
                swing_kernel(w, psi, slope, orders, turn, move, new)
            else:
                swing_kernel(speed[k + 1], angle[k + 1], slope, orders, turn, move, new)
            row = k * count + part - 1
            for i in range(3):
                x, y = (i + 1) % 3, (i + 2) % 3
                p, q = dtheta[k, x] / count, dtheta[k, y] / count
                a, b = dvel[k, x] / count, dvel[k, y] / count
                tx, ty = 0.5 * (old[0, x] + new[0, x]), 0.5 * (old[0, y] + new[0, y])
                vx, vy = old[2, x] + new[2, x], old[2, y] + new[2, y]
                coning = _cross(old[0], old[1], x, y) + _cross(new[0], new[1], x, y)
                sculling = _cross(old[0], old[3], x, y) + _cross(new[0], new[3], x, y)
                out_theta[row, i] = dtheta[k, i] / count + new[0, i] - old[0, i]
                out_theta[row, i] -= 0.25 * h * coning + tx * q - ty * p
                out_vel[row, i] = dvel[k, i] / count + new[2, i] - old[2, i]
                out_vel[row, i] += p * vy - q * vx - (tx * b - ty * a) - 0.5 * h * sculling


@kernel
def _cross(one: FloatArray, other: FloatArray, x: int, y: int) -> float:
    """Return the component of the product of two vectors that is across axes x and y."""
    found: float = one[x] * other[y] - one[y] * other[x]
    return found
