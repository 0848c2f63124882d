"""Filters with a given gain: the methods with which the source compares the Kalman filter (A-4).

They correct the errors of `classic-22` by its seven measurements, and differ in the gain K alone. Joseph's
form of the update holds for any gain, so P stays what the 22-state model says of their errors: they are worse
than the Kalman filter and know it. Measurements are tested against that P as well.
"""

from __future__ import annotations

import math
from abc import abstractmethod

import numpy as np

from bench.core.mathematics.arrays import FloatArray
from bench.core.mathematics.units import STANDARD_GRAVITY
from bench.core.records.data import InitialState, SensorData
from bench.navigation.engine.session import Kept
from bench.navigation.models.classic import Classic22
from bench.navigation.models.classic.covariance_forms import WholeForm
from bench.navigation.models.classic.filter_loop import FilterLoop
from bench.navigation.models.classic.navigator import Nav, ellipsoid, reduced
from bench.navigation.models.classic.observation_model import measurement_matrix, measurement_noise
from bench.navigation.models.classic.process_model import SIZE, Sigmas, model_van_loan, per_axis
from bench.plugins.papers.given_gain_options import ComplementaryOptions, LeastSquaresOptions

ESTIMATORS = {
    "fixed-gain": {
        "title": "classic-22 with the steady-state gain of a Kalman filter, slow",
        "model": "ClassicOptions",
        "fixed": {"form": "joseph", "covariance_precision": "double", "rows": 7},
    },
    "complementary": {
        "title": "mutual compensation: subtracts the smoothed difference of INS and aid, slow",
        "model": "bench.plugins.papers.given_gain_options:ComplementaryOptions",
        "fixed": {"form": "joseph", "covariance_precision": "double", "rows": 7},
    },
    "least-squares": {
        "title": "least squares over the past with less weight for old measurements, slow",
        "model": "bench.plugins.papers.given_gain_options:LeastSquaresOptions",
        "fixed": {"form": "joseph", "covariance_precision": "double", "rows": 7},
    },
}
"""Name of a filter -> its row in `bench.navigation.built_in`."""

BIAS_TIME, SETTLED = 10.0, 300.0  # of the fixed gain: how long an error of the IMU lasts, and its flight [s]
_NORTHWARD = np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])  # B of level flight to the north
_MOTION, _IMU = range(3, 9), range(9, 15)  # states: velocity and attitude, errors of the IMU
_FITTED = 16  # states of the least squares: all but the Markov errors of GNSS
_BARO, _FIX = [0], [1, 2, 3, 4, 5, 6]  # rows of


class GivenGain(WholeForm):
    """x and P of a filter with a gain of its own; P is the covariance of the errors that it leaves."""

    def update(self, Y: FloatArray, H: FloatArray, R: FloatArray, rows: list[int], nav: Nav) -> None:
        """Use the measurements with the gain, P by Joseph's form."""
        K = self.find_gain(H, R, rows, nav)
        left = np.eye(len(K)) - K @ H
        self.x, self.P = self.x + K @ (Y - H @ self.x), left @ self.P @ left.T + K @ R @ K.T

    @abstractmethod
    def find_gain(self, H: FloatArray, R: FloatArray, rows: list[int], nav: Nav) -> FloatArray:
        """Return K (22, m) for some rows of (A-5.4.3)."""


class ConstantGain(GivenGain):
    """A gain (22, 7) for meters and for a flight to the north, turned with the heading."""

    def __init__(self, P: FloatArray, K: FloatArray) -> None:
        super().__init__(P)
        self.K = K

    def find_gain(self, H: FloatArray, R: FloatArray, rows: list[int], nav: Nav) -> FloatArray:
        """Return the columns of the gain, turned."""
        s, c = nav.B[0, 0], nav.B[1, 0]
        turn = np.array([[c, s], [-s, c]]) / (math.hypot(s, c) or 1.0)  # (right, forward) to (east, north)
        states, measured = np.eye(SIZE), np.eye(7)
        for first in (0, 3, 6, 16, 19):
            states[first : first + 2, first : first + 2] = turn
        for first in (1, 4):
            measured[first : first + 2, first : first + 2] = turn
        east, north = reduced(nav, ellipsoid(nav.lat, nav.h))
        K = states @ self.K @ measured.T
        K[[0, 16]] *= east
        K[[1, 17]] *= north
        return np.asarray((K / [1.0, east, north, 1.0, 1.0, 1.0, 1.0])[:, rows])


def settle_gain(P: FloatArray, nav: Nav, sig: Sigmas, rates: tuple[float, float]) -> FloatArray:
    """Return the settled gain (22, 7) of a Kalman filter in straight and level flight to the north.

    The errors of the IMU are noise to it, not states: white with the power of errors that last for
    :data:`BIAS_TIME`. With a constant gain for them a turning flight is unstable.

    Parameters
    ----------
    P : (22, 22) array
        Covariance at the start, in meters.
    nav : Nav
        Where it is; its ground speed is that of the flight.
    sig : Sigmas
        The figures of the filter.
    rates : tuple of float
        Of the fixes and of the barometer [Hz]; 0: there is none.
    """
    earth, speed = ellipsoid(nav.lat, nav.h), math.hypot(nav.V[0], nav.V[1])
    level = Nav(nav.lat, nav.lon, nav.h, np.array([0.0, speed, 0.0]), _NORTHWARD)
    T = 1.0 / (rates[0] or rates[1] or 1.0)
    Phi, Q = model_van_loan(level, earth, [0.0, 0.0, earth.g], sig, T)
    unit = np.ones(SIZE)
    unit[[0, 16]], unit[[1, 17]] = reduced(level, earth)
    Phi, Q, P = Phi * unit / unit[:, None], Q / np.outer(unit, unit), P.copy()
    for matrix in (P, Q):
        matrix[_IMU], matrix[:, _IMU] = 0.0, 0.0
    Q[_MOTION, _MOTION] += np.repeat(np.square([sig.da, sig.eps]), 3) * BIAS_TIME * T
    H, noise = measurement_matrix()[:7], measurement_noise(sig, 1.0, 1.0, False)[:7]
    R = noise @ noise.T
    readings = max(1, round(rates[1] * T))  # of the barometer between two fixes
    R[0, 0] /= readings
    K = np.zeros((SIZE, 7))
    for _ in range(math.ceil(SETTLED / T)):
        P = Phi @ P @ Phi.T + Q
        for rows, rate in zip((_FIX, _BARO), rates, strict=True):
            if rate > 0:
                h, noise = H[rows], R[np.ix_(rows, rows)]
                K[:, rows] = np.linalg.solve(h @ P @ h.T + noise, h @ P).T
                left = np.eye(SIZE) - K[:, rows] @ h
                P = left @ P @ left.T + K[:, rows] @ noise @ K[:, rows].T
    K[:, 0] /= readings
    return K


class CompensatedDifferences(GivenGain):
    """INS minus GNSS contains errors only: a slow filter removes them (mutual compensation).

    Each difference goes through a loop with both poles at exp(-T / time_constant): position by itself; a
    horizontal velocity and the tilt that bends it, k1 = 1 - z^2 and k2 = (1 - z)^2 / (g T); the vertical
    velocity and the error of the upward accelerometer; the height by the barometer, and the barometer bias
    against GNSS. No gyro bias and no heading.
    """

    def __init__(self, P: FloatArray, rates: tuple[float, float], time_constant: float) -> None:
        super().__init__(P)
        self.rates, self.time_constant = rates, time_constant

    def find_gain(self, H: FloatArray, R: FloatArray, rows: list[int], nav: Nav) -> FloatArray:
        """Return the gains of the loops."""
        K = np.zeros((SIZE, 7))
        if self.rates[1] > 0:
            K[2, 0] = 1.0 - math.exp(-1.0 / (self.rates[1] * self.time_constant))
        if self.rates[0] > 0:
            T = 1.0 / self.rates[0]
            z = math.exp(-T / self.time_constant)
            K[0, 1] = K[1, 2] = K[2, 3] = 1.0 - z
            K[15, 3] = (1.0 - z) * (self.rates[1] > 0)
            K[3, 4] = K[4, 5] = K[5, 6] = 1.0 - z * z
            slow = (1.0 - z) ** 2 / T
            K[7, 4], K[6, 5] = -slow / STANDARD_GRAVITY, slow / STANDARD_GRAVITY
            K[12:15, 6] = slow * nav.B[2]
        return K[:, rows]


class FadingFit(GivenGain):
    """Least squares over the past: every measurement once, its weight fading with its age.

    At each time the inertial errors and the bias of the barometer minimize

        sum_i exp(-(t - t_i) / memory) |Y_i - H_i Phi(t_i, t) x|^2 / R_i  +  |x|^2 / P0

    with the errors of GNSS taken as white and no process noise. P0 keeps its weight whatever the age
    (stabilized forgetting, R. Kulhavy, M. Zarrop, Int. J. Control 58 (4), 1993); the sum is carried on from
    measurement to measurement.
    """

    normal: Kept[FloatArray]  # inverse of the normal matrix
    age: Kept[float]  # since it was faded [s]

    def __init__(self, P: FloatArray, sig: Sigmas, memory: float) -> None:
        super().__init__(P)
        self.sig, self.memory, self.age = sig, memory, 0.0
        self.live = np.flatnonzero(np.diag(P)[:_FITTED] > 0)
        self.normal = P[np.ix_(self.live, self.live)].copy()
        self.normal[np.diag_indices(len(self.live))] *= (
            1.0 + 1e-9
        )  # a course is a velocity: P may be singular
        self.prior = _inverse(self.normal)

    def predict(self, Phi: FloatArray, Q: FloatArray, T: float) -> None:
        """Step x, P and the normal matrix, which has no process noise."""
        super().predict(Phi, Q, T)
        step = Phi[np.ix_(self.live, self.live)]
        self.normal = step @ self.normal @ step.T
        self.age += T

    def find_gain(self, H: FloatArray, R: FloatArray, rows: list[int], nav: Nav) -> FloatArray:
        """Fade what is known and return the gain of the rows."""
        kept, self.age = math.exp(-self.age / self.memory), 0.0
        if kept < 1.0:
            self.normal = _inverse(kept * _inverse(self.normal) + (1.0 - kept) * self.prior)
        east, north = reduced(nav, ellipsoid(nav.lat, nav.h))
        markov = np.concatenate([[0.0], per_axis(self.sig.markov) * [east, north, 1.0, 1.0, 1.0, 1.0]])
        h = H[:, self.live]
        white = R + np.diag(markov[rows] ** 2)
        gain = np.asarray(np.linalg.solve(h @ self.normal @ h.T + white, h @ self.normal).T, float)
        left = np.eye(len(self.live)) - gain @ h
        self.normal = left @ self.normal @ left.T + gain @ white @ gain.T
        K = np.zeros((SIZE, len(rows)))
        K[self.live] = gain
        return K


def _inverse(A: FloatArray) -> FloatArray:
    """Return the inverse of a covariance or a normal matrix, taken at unit diagonal."""
    scale = 1.0 / np.sqrt(np.diag(A))
    inverse = np.linalg.inv(A * np.outer(scale, scale)) * np.outer(scale, scale)
    return np.asarray(0.5 * (inverse + inverse.T))


def find_rates(sensors: SensorData) -> tuple[float, float]:
    """Return the rates of fixes and barometer by their datasheets [Hz], 0 where there is no record."""
    gnss, baro = sensors.specs.gnss, sensors.specs.baro
    return (
        gnss.rate if gnss and sensors.fixes is not None else 0.0,
        baro.rate if baro and sensors.baro is not None else 0.0,
    )


class FixedGain(Classic22):
    """The settled gain of a Kalman filter in straight flight, throughout (A-4, sub-optimal filter).

    Options: `bench.navigation.options.ClassicOptions`.
    """

    def make_loop(self, sensors: SensorData, initial: InitialState) -> FilterLoop:
        """Return the loop with the settled gain."""
        loop = FilterLoop(self.options, sensors, initial)
        P = loop.form.covariance
        unit = np.ones(SIZE)
        unit[[0, 16]], unit[[1, 17]] = reduced(loop.nav, ellipsoid(loop.nav.lat, loop.nav.h))
        metric = P / np.outer(unit, unit)
        K = settle_gain(metric, loop.nav, loop.sig, find_rates(sensors))
        loop.form = ConstantGain(P, K)
        return loop


class Complementary(Classic22):
    """Complementary filter with mutual compensation of INS, GNSS and barometer (A-4).

    Options: `bench.plugins.papers.given_gain_options.ComplementaryOptions`.
    """

    options: ComplementaryOptions
    model = ComplementaryOptions

    def make_loop(self, sensors: SensorData, initial: InitialState) -> FilterLoop:
        """Return the loop with the gains of the complementary filter."""
        loop = FilterLoop(self.options, sensors, initial)
        P, rates = loop.form.covariance, find_rates(sensors)
        loop.form = CompensatedDifferences(P, rates, self.options.time_constant)
        return loop


class LeastSquares(Classic22):
    """Batch least squares over the past, older measurements with less weight (A-4).

    Options: `bench.plugins.papers.given_gain_options.LeastSquaresOptions`.
    """

    options: LeastSquaresOptions
    model = LeastSquaresOptions

    def make_loop(self, sensors: SensorData, initial: InitialState) -> FilterLoop:
        """Return the loop that fits."""
        loop = FilterLoop(self.options, sensors, initial)
        loop.form = FadingFit(loop.form.covariance, loop.sig, self.options.memory)
        return loop
