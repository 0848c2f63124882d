"""What the studies by linear covariance share: a profile and its flight, draws of it, figures of errors."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any

import numpy as np
from scipy.special import gammaincinv

from bench import pipeline, sensors
from bench.arrays import FloatArray
from bench.config import load_profile
from bench.data import Trajectory
from bench.errors import ConfigError
from bench.evaluation.error_series import error_series
from bench.evaluation.linear.switching import sense_alone
from bench.evaluation.linear.terms import check_sensors, list_sources
from bench.navigation import estimator
from bench.navigation.fusion import Fusion
from bench.navigation.measurements import BARO, FIXES
from bench.specs import EstimatorChoice, Profile
from bench.units import DEG

INTERVAL = 1.0
"""Between the instants of a study [s]."""
LEVEL = 0.999
"""Probability of an interval."""


@dataclass(frozen=True, slots=True)
class Quantity:
    """A figure of the errors of position, velocity and attitude: the root of a sum of variances."""

    name: str  # as in columns, with its unit
    title: str
    unit: str
    states: tuple[int, ...]
    scale: float = 1.0  # SI over unit

    def sd(self, variance: FloatArray) -> FloatArray:
        """Return the figure of variances (..., 9)."""
        return np.asarray(np.sqrt(variance[..., self.states].sum(axis=-1)) / self.scale)


QUANTITIES = (
    Quantity("horizontal_m", "horizontal position", "m", (0, 1)),
    Quantity("height_m", "height", "m", (2,)),
    Quantity("velocity_mps", "horizontal velocity", "m/s", (3, 4)),
    Quantity("tilt_deg", "tilt", "deg", (6, 7), DEG),
    Quantity("heading_deg", "heading", "deg", (8,), DEG),
)


@dataclass(frozen=True, slots=True)
class Flight:
    """A profile with one IMU, by names: what a worker makes the rest from."""

    profile: str
    imu: str | None = None
    estimators: tuple[str, ...] | None = None

    def load(self) -> tuple[Profile, Trajectory]:
        """Return the profile and its truth, flown at most once in a process."""
        return _load(self)


@lru_cache(maxsize=2)
def _load(flight: Flight) -> tuple[Profile, Trajectory]:
    overrides = {} if flight.imu is None else {"sensors.imu": flight.imu}
    profile = load_profile(flight.profile, overrides, None, flight.estimators)
    check_sensors(profile.sensors)
    truth = pipeline.fly(profile)
    pipeline.check_times(profile, float(truth.t[-1]))
    return profile, truth


def output_times(truth: Trajectory, profile: Profile) -> FloatArray:
    """Return the instants of a study: every second, and the last before and after each outage."""
    whole = np.arange(truth.t[0], truth.t[-1] + 1e-9, INTERVAL)
    ends = [stop - INTERVAL for _, stop in profile.sensors.gnss_outages if stop - INTERVAL > truth.t[0]]
    return np.union1d(np.round(whole, 6), np.round(ends, 6))


@dataclass(frozen=True, slots=True)
class Draws:
    """Runs of one estimator, with all errors or with one source of them."""

    flight: Flight
    label: str  # of the estimator
    first: int  # number of the first draw
    count: int
    source: str | None = None


def draw_errors(draws: Draws) -> FloatArray:
    """Return the errors (count, M, 9) of position [m], velocity [m/s], attitude [rad], n; NaN: failed."""
    profile, truth = draws.flight.load()
    choice = find_choice(profile, draws.label)
    one = pipeline.build_estimator(choice)
    t = output_times(truth, profile)
    found = []
    for run in range(draws.first, draws.first + draws.count):
        if draws.source is None:
            sensed = sensors.sense(truth, profile.sensors, profile.seed, run)
        else:
            source = next(source for source in list_sources() if source.name == draws.source)
            sensed = sense_alone(truth, profile.sensors, source, profile.seed, run)
        data = replace(sensed.data, output_t=t)
        solution = estimator.answer(one, choice.label, data, sensed.initial)
        errors = error_series(truth, solution)
        found.append(np.hstack([errors.pos_n, errors.vel_n, errors.phi_n]))
    return np.array(found)


def find_choice(profile: Profile, label: str) -> EstimatorChoice:
    """Return the choice of an estimator of a profile by its label."""
    return next(choice for choice in profile.estimators if choice.label == label)


def check_aiding(choice: EstimatorChoice) -> None:
    """Raise ConfigError if an estimator uses more than IMU, fixes and barometer."""
    one = pipeline.build_estimator(choice)
    one = getattr(one, "filter", one)  # of a smoother
    if not isinstance(one, Fusion):
        return
    options = one.options
    more = [sensor.option for sensor in one.aiding() if sensor not in (FIXES, BARO)]
    more += [name for name in ("standstill", "nonholonomic", "coordinated") if getattr(options, name)]
    if more:
        raise ConfigError(
            f"{choice.label}: the linear model knows IMU, fixes and barometer, not {', '.join(more)}; "
            "leave the option out"
        )


def split_draws(draws: int, parts: int) -> Iterator[tuple[int, int]]:
    """Yield first and count of the parts that draws are split into."""
    edges = np.linspace(0, draws, min(parts, draws) + 1).astype(int)
    for first, last in zip(edges[:-1].tolist(), edges[1:].tolist(), strict=True):
        yield first, last - first


def root_mean_interval(rms: Any, freedom: float) -> tuple[Any, Any]:
    """Return the `LEVEL` interval of a standard deviation whose estimate is ``rms``.

    ``freedom`` is that of the chi-square variable behind it, such as the number of draws.
    """
    tail = 0.5 * (1.0 - LEVEL)
    low, high = (2.0 * float(gammaincinv(0.5 * freedom, p)) / freedom for p in (tail, 1.0 - tail))
    return rms / high**0.5, rms / low**0.5


def key_instants(t: FloatArray, profile: Profile) -> dict[str, int]:
    """Return the rows of t where a flight is looked at: the end of each outage, and of the flight."""
    found = {
        f"{stop:g} s, end of the outage": int(np.argmin(np.abs(t - (stop - INTERVAL))))
        for _, stop in profile.sensors.gnss_outages
    }
    return found | {f"{t[-1]:g} s, end of the flight": len(t) - 1}


def join_words(words: Sequence[str]) -> str:
    """Return words as a list in a sentence."""
    return ", ".join(words[:-1]) + " and " + words[-1] if len(words) > 1 else "".join(words)
