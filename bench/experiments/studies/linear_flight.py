"""Covariances of the 22-state filter along a course, linear, without any run: the flight of equations 7.1.

200 m/s at 50 deg north and 9 km, held there; course 0.8 rad at the start; every 600 s, from 240 s on, one
S-turn of 120 s whose rate is a sine of 3 deg/s, banked so that no force is felt sideways; fixes and barometer
at 1 Hz; the set of satellites changes every 900 s; GNSS lost at 1800 s, the barometer kept. Steps are 1 s,
Phi = I + F + F^2 / 2 in the middle of the step. Biases walk by 1e-3 of their sigma per root second. At first
30 m and 0.1 m/s by axis, and the tilt and heading that are given.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Literal

import numpy as np

from bench.core.mathematics import rotation
from bench.core.mathematics.arrays import FloatArray
from bench.core.mathematics.units import DEG, HOUR, STANDARD_GRAVITY
from bench.navigation.models.classic import navigator, observation_model, process_model
from bench.navigation.models.classic.error_dynamics import dynamics_matrix
from bench.navigation.models.classic.navigator import FRD_OF_FUR, NED_OF_ENU, Earth, Nav
from bench.navigation.models.classic.process_model import Sigmas

Phase = Literal["s-turns", "straight", "turn", "climb"]
"""What is flown once GNSS is lost; before, S-turns."""

LOST = 1800
"""When GNSS is lost [s]."""

_FIRST, _EVERY, _LENGTH, _RATE = 240.0, 600.0, 120.0, 3.0 * DEG  # of the S-turns [s], [rad/s]
STEADY = 1.5 * DEG  # of the steady turn [rad/s]
CLIMB = 10.0  # [m/s]
_JUMPS = 900  # between changes of the set of satellites [s]
_WALK = 1e-3  # of a bias, over its sigma [1/sqrt(s)]


def make_sigmas(arw: float, vrw: float, drift: float, bias: float) -> Sigmas:
    """Return the parameters of a grade, with receiver and barometer from the middle of A-5.2 and A-5.3.

    Parameters
    ----------
    arw, vrw : float
        Angular [deg/sqrt(h)] and velocity random walk [m/s/sqrt(h)].
    drift, bias : float
        Standard deviations of gyro [deg/h] and accelerometer errors [ug].
    """
    eps, da = drift * DEG / HOUR, bias * 1e-6 * STANDARD_GRAVITY
    return Sigmas(
        gyro=arw * DEG / 60.0,
        accel=vrw / 60.0,
        eps_walk=_WALK * eps,
        da_walk=_WALK * da,
        eps=eps,
        da=da,
        h=0.75,
        xi=0.03,
        bb=4.0,
        white=(2.0, 2.75, 0.03),
        markov=(6.0, 8.5, 0.1),
        lambda_s=4e-6,
        lambda_st=5e-4,
        lambda_v=0.01,
        jump_markov=(3.5, 5.0, 0.015),
    )


@dataclass(frozen=True)
class Grade:
    """A class of IMU, with its initial errors after alignment."""

    sigmas: Sigmas
    tilt: float = 0.1 * DEG  # standard deviation by axis at the start [rad]
    heading: float = 0.5 * DEG  # [rad]


GRADES: Mapping[str, Grade] = {
    "grade-1": Grade(make_sigmas(0.0005, 0.009, 0.005, 10.0)),
    "grade-2": Grade(make_sigmas(0.001, 0.01, 0.01, 50.0)),
    "grade-3": Grade(make_sigmas(0.01, 0.02, 0.1, 100.0)),
    "MEMS": Grade(make_sigmas(0.3, 0.1, 10.0, 5000.0), 1.0 * DEG, 3.0 * DEG),
}
"""The three grades of A-T2.4.1 and A-T2.4.2, and the MEMS grade that equations 7.1 adds."""


@dataclass(frozen=True)
class LinearFlight:
    """A course and its seven measurements."""

    phase: Phase = "s-turns"  # once GNSS is lost
    turns: bool = True  # before
    lat: float = 50.0 * DEG  # [rad]
    height: float = 9000.0  # [m]
    speed: float = 200.0  # [m/s]
    course: float = 0.8  # at the start [rad]

    @cached_property
    def earth(self) -> Earth:
        """Radii and gravity."""
        return navigator.ellipsoid(self.lat, self.height)

    @cached_property
    def reduced(self) -> tuple[float, float]:
        """Reduced coordinates per meter east and north (equations 1.5)."""
        return navigator.reduced(self.place(0.0)[0], self.earth)

    def place(self, t: float) -> tuple[Nav, FloatArray]:
        """Return the navigator and the specific force (3,), east, north, up [m/s^2], at a time [s]."""
        course, rate, climb = self._steer(t)
        flat = math.sqrt(self.speed**2 - climb**2)
        s, c = math.sin(course), math.cos(course)
        bank, pitch = math.atan2(flat * rate, self.earth.g), math.asin(climb / self.speed)
        C_nb = rotation.matrix(rotation.from_euler(bank, pitch, course))
        nav = Nav(
            self.lat, 0.0, self.height, np.array([flat * s, flat * c, climb]), NED_OF_ENU @ C_nb @ FRD_OF_FUR
        )
        return nav, np.array([flat * rate * c, -flat * rate * s, self.earth.g])

    def _steer(self, t: float) -> tuple[float, float, float]:
        """Return course [rad], its rate [rad/s] and the rate of climb [m/s]."""
        if t >= LOST and self.phase != "s-turns":
            rate = STEADY if self.phase == "turn" else 0.0
            return self.course + rate * (t - LOST), rate, CLIMB if self.phase == "climb" else 0.0
        phase = t % _EVERY - _FIRST
        if not self.turns or not 0.0 <= phase < _LENGTH:
            return self.course, 0.0, 0.0
        w = 2.0 * math.pi / _LENGTH
        return self.course + _RATE / w * (1.0 - math.cos(w * phase)), _RATE * math.sin(w * phase), 0.0

    def start(self, grade: Grade) -> FloatArray:
        """Return P (22, 22) at the start."""
        sig, (east, north) = grade.sigmas, self.reduced
        r, h, v = sig.markov
        sd = [30.0 * east, 30.0 * north, 30.0, 0.1, 0.1, 0.1, grade.tilt, grade.tilt, grade.heading]
        sd += [sig.eps] * 3 + [sig.da] * 3 + [sig.bb, r * east, r * north, h, v, v, v]
        return np.diag(np.square(sd))

    def move(self, sig: Sigmas, k: int) -> tuple[FloatArray, FloatArray]:
        """Return Phi (22, 22) and G (22, 28) of the second that ends at k."""
        nav, a = self.place(k - 0.5)
        Phi, G = process_model.model(nav, self.earth, a, sig, 1.0, jump=k % _JUMPS == 0)
        F = dynamics_matrix(nav, a, self.earth)
        Phi[:15, :15] += 0.5 * F @ F
        return Phi, G

    def measure(self, sig: Sigmas, k: int) -> tuple[FloatArray, FloatArray]:
        """Return H and R of the seven rows at second k, or of the barometer row alone without GNSS."""
        rows = list(range(7)) if k <= LOST else [0]
        Q = observation_model.measurement_noise(sig, *self.reduced, k % _JUMPS == 0)
        return observation_model.measurement_matrix()[rows], (Q @ Q.T)[np.ix_(rows, rows)]

    def predict_sd(self, grade: Grade, seconds: int) -> FloatArray:
        """Return standard deviations (seconds + 1, 22) after every second, SI, the first two in meters."""
        covariances = [self.start(grade), *self.carry(grade, self.start(grade), 0, seconds)]
        return self.take_sd(covariances)

    def carry(self, grade: Grade, P: FloatArray, after: int, to: int) -> Iterator[FloatArray]:
        """Yield P (22, 22) after every second between two times, starting from P at the first time."""
        for k in range(after + 1, to + 1):
            Phi, G = self.move(grade.sigmas, k)
            P = Phi @ P @ Phi.T + G @ G.T
            P = update(P, *self.measure(grade.sigmas, k))[2]
            yield P

    def take_sd(self, covariances: Sequence[FloatArray]) -> FloatArray:
        """Return standard deviations (N, 22), SI, the first two in meters."""
        unit = np.ones(process_model.SIZE)
        unit[:2] = self.reduced
        return np.array([np.sqrt(np.diag(P)) / unit for P in covariances])


def update(P: FloatArray, H: FloatArray, R: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return the gain, S and Joseph's P (A-5.4.5)."""
    S = H @ P @ H.T + R
    K = np.asarray(np.linalg.solve(S, H @ P).T, np.float64)
    J = np.eye(len(P)) - K @ H
    return K, S, J @ P @ J.T + K @ R @ K.T
