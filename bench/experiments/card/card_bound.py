"""Errors of the best linear causal filter on a flight of the suite: the bound for the errors."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from bench import pipeline
from bench.core.mathematics.units import SAME_INSTANT
from bench.core.records.instruments import INSTRUMENTS
from bench.core.records.specs import Profile
from bench.core.words.exceptions import ConfigError
from bench.evaluation.linear.held import bound_in_range, variance_of
from bench.evaluation.linear.terms import check_sensors

_STATES = {"accuracy": (0, 1), "height": (2,), "velocity": (3, 4, 5), "tilt": (6, 7), "heading": (8,)}
"""Topic -> the states whose variances add up."""

_RATE = 1.0  # of the epochs that are averaged [Hz]
_STILL = 0.2  # speed of what stands [m/s]
_UNKNOWN = ("airspeed", "odometer", "radar")
"""Instruments that the linear model lacks."""


def pool_bounds(profiles: Sequence[Profile]) -> tuple[dict[str, float], str]:
    """Return the smallest possible RMS errors over the runs of a flight, or why there are none.

    Each run has its own truth. A topic without a bound in one run has none.
    """
    found = list(map(bound_errors_of, profiles))
    if without := next((text for errors, text in found if not errors), ""):
        return {}, without
    topics = [topic for topic in found[0][0] if all(topic in errors for errors, _ in found)]
    squares = {topic: [errors[topic] ** 2 for errors, _ in found] for topic in topics}
    return {topic: float(np.sqrt(np.mean(values))) for topic, values in squares.items()}, found[0][1]


def bound_errors_of(profile: Profile) -> tuple[dict[str, float], str]:
    """Return the smallest possible RMS errors by topic [m, m/s, deg], or the reason why there are none.

    The covariance follows from the flight and its sensors. Everything outside the linear model counts as
    known, because knowledge can only make errors smaller: faults do not happen, and the initial state is
    given. The attitude has no error if it is beyond the linear range, found from the course, or observed by
    an instrument. A flight with a standstill has no bound, because a filter may assume the standstill.
    """
    on_board = profile.sensors
    if lacks := [name for name in _UNKNOWN if getattr(on_board, name) is not None]:
        return {}, f"no bound: it knows no {lacks[0]}"
    known = ["sensors without faults"] if on_board.faults else []
    known += ["a given start"] if on_board.alignment != "given" else []
    sound = replace(profile, sensors=replace(on_board, faults=(), alignment="given"))
    try:
        check_sensors(sound.sensors)
    except ConfigError as error:
        return {}, f"no bound: {error}"
    truth = pipeline.fly(profile)
    if (np.linalg.norm(truth.vel_n[truth.t >= profile.evaluation.begin], axis=1) < _STILL).any():
        return {}, "no bound: it stands still, and a filter may know that"
    data = pipeline.sense(sound, truth, 0).data
    step = max(1, round(on_board.output_rate / _RATE))
    told = on_board.alignment != "given" or any(
        row.of_attitude and getattr(on_board, name) is not None for name, row in INSTRUMENTS.items()
    )
    bound = bound_in_range(
        truth, sound.sensors, data, profile.seed, data.output_t[::step], smooth=False, attitude_known=told
    )
    variance = variance_of(bound, smooth=False)[bound.t >= profile.evaluation.begin - SAME_INSTANT]
    known += ["a known attitude"] if np.isnan(variance).any() else []
    found = {}
    for topic, states in _STATES.items():
        least = float(np.sqrt(variance[:, states].sum(axis=1).mean()))
        if np.isfinite(least):
            found[topic] = float(np.rad2deg(least)) if states[0] >= 6 else least
    return found, f"the bound holds for {' and '.join(known)}" if known else ""
