"""Common parts of the studies by linear covariance: profile, flight, runs, error metrics."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np

from bench import pipeline
from bench.core.mathematics.arrays import FloatArray
from bench.core.mathematics.units import SAME_INSTANT
from bench.core.records.data import Trajectory
from bench.core.records.specs import EstimatorChoice, Profile
from bench.evaluation.errors.error_series import error_series
from bench.evaluation.linear.switching import sense_alone
from bench.evaluation.linear.terms import check_sensors, list_sources
from bench.experiments.studies.study import read_settings
from bench.io.config import read_profile
from bench.navigation import estimator
from bench.simulation import sensors

INTERVAL = 1.0
"""Between the epochs of a study [s]."""


@dataclass(frozen=True, slots=True)
class UnitFlight:
    """A profile with one IMU by name, and the replaced values, from which a worker loads the flight."""

    profile: str
    imu: str | None = None
    estimators: tuple[str, ...] | None = None
    overrides: tuple[str, ...] = ()  # KEY=VALUE of the profile
    seed: int | None = None  # of the profile if None

    def read(self) -> Profile:
        """Return the profile; ConfigError if it or its sensors have no linear model. Nothing is flown."""
        overrides = read_settings(self.overrides)
        if self.imu is not None:
            overrides["sensors.imu"] = self.imu
        profile = read_profile(self.profile, overrides, self.seed, self.estimators)
        check_sensors(profile.sensors)
        return profile

    def load(self) -> tuple[Profile, Trajectory]:
        """Return the profile and its truth, flown at most once in a process."""
        return _load(self)


@lru_cache(maxsize=2)
def _load(flight: UnitFlight) -> tuple[Profile, Trajectory]:
    profile = flight.read()
    truth = pipeline.fly(profile)
    pipeline.check_times(profile, float(truth.t[-1]))
    return profile, truth


def output_times(truth: Trajectory, profile: Profile) -> FloatArray:
    """Return the epochs of a study: every second, and the last before and after each outage."""
    whole = np.arange(truth.t[0], truth.t[-1] + SAME_INSTANT, INTERVAL)
    ends = [stop - INTERVAL for _, stop in profile.sensors.gnss_outages if stop - INTERVAL > truth.t[0]]
    return np.union1d(np.round(whole, 6), np.round(ends, 6))


@dataclass(frozen=True, slots=True)
class Draws:
    """Runs of one filter, with all errors or with one source of them."""

    flight: UnitFlight
    label: str  # of the filter
    first: int  # number of the first run
    count: int
    source: str | None = None


def draw_errors(runs: Draws) -> FloatArray:
    """Return the errors (count, M, 9) of position [m], velocity [m/s], attitude [rad], n; NaN: failed."""
    profile, truth = runs.flight.load()
    choice = find_choice(profile, runs.label)
    one = pipeline.build_estimator(choice)
    t = output_times(truth, profile)
    found = []
    for run in range(runs.first, runs.first + runs.count):
        if runs.source is None:
            sensed = sensors.sense(truth, profile.sensors, profile.seed, run)
        else:
            source = next(source for source in list_sources() if source.name == runs.source)
            sensed = sense_alone(truth, profile.sensors, source, profile.seed, run)
        data = replace(sensed.data, output_t=t)
        solution = estimator.answer(one, choice.label, data, sensed.initial)
        errors = error_series(truth, solution)
        found.append(np.hstack([errors.pos_n, errors.vel_n, errors.phi_n]))
    return np.array(found)


def find_choice(profile: Profile, label: str) -> EstimatorChoice:
    """Return the choice of a filter of a profile by its label."""
    return next(choice for choice in profile.estimators if choice.label == label)


def split_draws(runs: int, parts: int) -> Iterator[tuple[int, int]]:
    """Yield the first run and the number of runs of each part."""
    edges = np.linspace(0, runs, min(parts, runs) + 1).astype(int)
    for first, last in zip(edges[:-1].tolist(), edges[1:].tolist(), strict=True):
        yield first, last - first


def key_instants(t: FloatArray, profile: Profile) -> dict[str, int]:
    """Return the rows of t that are reported: the end of each outage, and of the flight."""
    found = {
        f"{stop:g} s, end of the outage": int(np.argmin(np.abs(t - (stop - INTERVAL))))
        for _, stop in profile.sensors.gnss_outages
    }
    return found | {f"{t[-1]:g} s, end of the flight": len(t) - 1}


def join_words(words: Sequence[str]) -> str:
    """Return words as a list in a sentence."""
    return ", ".join(words[:-1]) + " and " + words[-1] if len(words) > 1 else "".join(words)
