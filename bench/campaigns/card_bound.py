"""What the best linear causal filter achieves on a flight of the suite: the bound for the errors."""

from __future__ import annotations

import numpy as np

from bench import pipeline
from bench.errors import ConfigError
from bench.evaluation.linear.held import bound_flight, variance_of
from bench.evaluation.linear.terms import check_sensors
from bench.specs import Profile
from bench.units import SAME_INSTANT

_STATES = {"accuracy": (0, 1), "height": (2,), "velocity": (3, 4, 5), "tilt": (6, 7), "heading": (8,)}
"""Topic -> the states whose variances add up."""

_RATE = 1.0  # of the instants that are averaged [Hz]


def bound_errors_of(profile: Profile) -> tuple[dict[str, float], str]:
    """Return the least root mean square errors by topic [m, m/s, deg], or none and why there is no bound.

    The covariance is that of the flight and its sensors, the same in every draw of the noise.
    """
    on_board = profile.sensors
    if on_board.faults:
        return {}, "no bound: something breaks"
    if profile.document.get("alignment", {}).get("kind", "given") != "given":
        return {}, "no bound: the start is not told"
    if on_board.mag is not None:
        return {}, "no bound: it knows no magnetometer"
    try:
        check_sensors(on_board)
    except ConfigError as error:
        return {}, f"no bound: {error}"
    truth = pipeline.fly(profile)
    data = pipeline.sense(profile, truth, 0).data
    step = max(1, round(on_board.output_rate / _RATE))
    bound = bound_flight(truth, on_board, data, profile.seed, data.output_t[::step], smooth=False)
    variance = variance_of(bound, smooth=False)[bound.t >= profile.evaluation.begin - SAME_INSTANT]
    found = {}
    for topic, states in _STATES.items():
        least = float(np.sqrt(variance[:, states].sum(axis=1).mean()))
        found[topic] = float(np.rad2deg(least)) if states[0] >= 6 else least
    return found, ""
