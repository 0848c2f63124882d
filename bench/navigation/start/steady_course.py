"""Heading from a steady course, for gyros with a large bias.

In straight flight no measurement shows the heading, and where the gyros are known to a tenth of a degree per
second it is lost within minutes. But what flies or drives straight keeps its nose where it was: between
heading and course is an angle that the wind makes, and that changes as the wind does. It is a state,

    yaw(C) - course - offset = 0

from the first fix on until the course leaves it for the first time; at rest the course is that of the start.
What hovers is as slow as what stands, and turns: the gyros have to show a standstill.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from bench.core.mathematics.arrays import FloatArray
from bench.core.mathematics.units import STANDARD_GRAVITY
from bench.core.records.data import GnssFixes, ImuData, InitialState, SensorData
from bench.core.records.sensor_specs import ImuSpec
from bench.navigation.engine.session import Kept, Replaced, SessionState, require
from bench.navigation.error_state_filter.imu_states import thermal_figures
from bench.navigation.error_state_filter.rough_heading import UNKNOWN_HEADING_SD
from bench.navigation.error_state_filter.standstill import (
    STILL_SD,
    WINDOW,
    StandstillDetector,
    count_steady,
)
from bench.navigation.error_state_filter.state_blocks import WIND_WALK
from bench.navigation.error_state_filter.state_processes import Block, States
from bench.navigation.start.course import LEAST_SPEED

LARGE = float(np.deg2rad(15.0)) / 600.0  # sd of a bias that turns the heading out of what is linear [rad/s]
FIRST = 20.0  # segment at the start that tells the bias alone (`turn_on`) [s]
INTERVAL = 10.0  # after it, in which what moves nose and course apart is another [s]
STRAIGHT = float(np.deg2rad(10.0))  # largest change of the course [rad]
TURNED_SD = float(np.deg2rad(5.0))  # of the change of an angle that the course does not show [rad]
STILL = 0.5  # largest speed over ground at rest, by fixes [m/s]
STANDS = 0.5  # least part of the time in which the gyros show a standstill of what stands


class Gyros(NamedTuple):
    """Knowledge of the gyros beyond their datasheet."""

    sd: float | None = None  # how well their errors are known at the start as a whole [rad/s]
    steady: bool = False  # they lose the heading, and a steady course keeps it


AS_SPECIFIED = Gyros()


def gyro_error_sd(spec: ImuSpec, initial: InitialState) -> float:
    """Return the sd of the error of a gyro at the start by its datasheet [rad/s]."""
    gyro, warm = spec.gyro, thermal_figures(initial.t, float(initial.lla[2]), spec)[0]
    parts = (gyro.turn_on_bias_sd, gyro.temperature_sd * warm, gyro.g_sensitivity_sd * STANDARD_GRAVITY)
    return math.hypot(*parts)


def warming_sd(span: float, height: FloatArray, spec: ImuSpec, initial: InitialState) -> float:
    """Return a bound of the bias change due to warming over a span [s] at heights [m], 1 sigma."""
    begun, ground, lapse, time_constant = thermal_figures(initial.t, float(initial.lla[2]), spec)
    change = float(np.nanmax(np.abs(ground + lapse * height - begun), initial=0.0))
    if time_constant > 0.0:
        change *= -math.expm1(-span / time_constant)
    return float(spec.gyro.temperature_sd * change)


def has_large_bias(sensors: SensorData) -> bool:
    """Return whether gyros lose the heading within ten minutes, and fixes show the course."""
    return bool(sensors.specs.imu.gyro.turn_on_bias_sd >= LARGE and sensors.fixes is not None)


class SteadyCourse(SessionState):
    """Measures the course over ground from fixes, once per interval, until it changes.

    ``steady``: the gyros lose the heading; else there is nothing to measure.
    """

    newest: Kept[float]  # arrival of the newest fix taken [s]
    first: Kept[float]  # course of the first fix, 0 at rest [rad]
    moving: Kept[bool]
    over: Kept[bool]  # the course has left
    detector: Kept[StandstillDetector]
    stood: Replaced[FloatArray]  # (W,) ends of windows of a standstill after ``measured`` [s]
    rates: Replaced[FloatArray]  # (W, 3) mean rates of the gyros in them [rad/s]
    usual: Replaced[FloatArray | None]  # (3,) their mean before ``measured``
    measured: Kept[float]  # arrival of the last fix that gave an angle [s]

    def __init__(self, initial: InitialState, imu: ImuSpec, *, steady: bool) -> None:
        self.start, self.newest, self.first = initial.t, -math.inf, math.nan
        self.detector = StandstillDetector(initial.t, imu, gyro_sd=gyro_error_sd(imu, initial))
        self.stood, self.rates, self.usual, self.measured = np.empty(0), np.empty((0, 3)), None, -math.inf
        self.gyro = imu.gyro
        self.warming = warming_sd(2.0 * INTERVAL, initial.lla[2:], imu, initial)
        self.speed = float(np.nan_to_num(np.hypot(*initial.vel_n[:2])))
        self.moving, self.over, self.steady = False, not steady, steady

    def blocks(self) -> list[Block]:
        """Return the state of the angle from course to heading: unknown at the start, changed by the wind."""
        walk = WIND_WALK / self.speed if self.speed > LEAST_SPEED else 0.0
        states = (States("course_offset", "rad", 1, UNKNOWN_HEADING_SD**2, walk**2),)
        return [Block("every_error", lambda _: states)] if self.steady else []

    def take(self, record: SensorData, samples: ImuData) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Process the fixes and the IMU samples in use of the next piece.

        Returns
        -------
        t : (M,) array
            When they arrived [s].
        course : (M, 1) array
            [rad]
        variance : (6,) array
            [rad^2]
        """
        fixes, nothing = record.fixes, (np.empty(0), np.empty((0, 1)), np.zeros(6))
        if self.over or fixes is None:
            return nothing
        ends, motion_b, _ = self.detector.take(samples)
        self.stood = np.append(self.stood, ends)
        self.rates = np.vstack([self.rates, motion_b[:, :3].reshape(len(ends), 3)])
        t, course, speed = _courses(fixes)
        fresh = t > max(self.newest, self.start)
        t, course, speed = t[fresh], course[fresh], speed[fresh]
        if not len(t):
            return nothing
        if math.isnan(self.first):
            self.moving = bool(speed[0] >= STILL)
            self.first = float(course[0]) if self.moving else 0.0
        if self.moving:
            apart = np.mod(course - self.first + np.pi, 2.0 * np.pi) - np.pi
            stays = (np.abs(apart) < STRAIGHT) & (speed > LEAST_SPEED)
        else:
            course, stays = np.zeros(len(t)), speed < STILL
        if not stays.all():
            count, self.over = int(np.argmin(stays)), True
            t, course = t[:count], course[:count]
        began = np.append(self.newest, t)
        number = np.floor((np.maximum(began, self.start) - self.start) / INTERVAL)
        used = (np.diff(number) > 0) & (number[1:] > FIRST / INTERVAL) | np.isinf(began[:-1])
        if len(t):
            self.newest = float(t[-1])
        t, course = t[used], course[used]
        for k, now in enumerate(t.tolist()):
            if not self.moving and not self._has_stood(now):
                t, course, self.over = t[:k], course[:k], True
                break
            done = 0 if math.isinf(self.measured) else int(np.searchsorted(self.stood, now, "right"))
            if done:  # as long as the interval that it is held against
                self.usual = self.rates[:done].mean(axis=0)
            self.stood, self.rates, self.measured = self.stood[done:], self.rates[done:], now
        sd = TURNED_SD if self.moving else STILL_SD
        return t, course[:, None], np.full(6, sd**2)

    def _has_stood(self, now: float) -> bool:
        """Return whether the gyros show a standstill from the last measured angle until a time [s]."""
        count, span = int(np.searchsorted(self.stood, now, "right")), now - self.measured
        if count_steady(self.rates[:count], self.usual, self.gyro, self.warming) < count:
            return False
        return math.isinf(span) or count * WINDOW >= STANDS * (span - WINDOW)

    def check(self) -> None:
        """Check that the filter has a state for the measured angle."""
        require(self.over or self.steady, "over", "must be true of gyros that keep the heading")


def _courses(fixes: GnssFixes) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return arrival [s], course [rad] and speed over ground [m/s] of the fixes with a velocity."""
    used = fixes.valid & np.isfinite(fixes.t_arrival) & np.isfinite(fixes.vel_n).all(axis=1)
    north, east = fixes.vel_n[used, 0], fixes.vel_n[used, 1]
    return fixes.t_arrival[used], np.arctan2(east, north), np.hypot(north, east)
