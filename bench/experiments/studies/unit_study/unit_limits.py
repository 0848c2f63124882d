"""Limiting factor of an IMU on a flight: the IMU, the receiver, another sensor, or the filter.

The error budget (`studies.budget`) divides the variance of the filter's error by the sensor that it
comes from; the best linear filter (`studies.bound`) says what another filter could gain. Both are
linear covariances of one flight: no run is needed.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from bench import pipeline
from bench.core.words.exceptions import ConfigError
from bench.core.words.wording import format_number
from bench.evaluation.linear.error_budget import split_errors
from bench.evaluation.linear.gains import record_gains
from bench.evaluation.linear.held import bound_flight, check_aiding, variance_of
from bench.evaluation.linear.terms import model_errors
from bench.experiments.studies.drawn_errors import UnitFlight, key_instants, output_times
from bench.navigation.models.loose_tight import Loose
from bench.simulation import sensors

_PARTS: Mapping[str, str] = {
    "gyro": "the IMU",
    "accel": "the IMU",
    "imu": "the IMU",
    "gnss": "the receiver",
    "baro": "the barometer",
    "initial": "the start",
}
_COSTLY = 1.5  # times the best linear error from which on the filter is what limits


@dataclass(frozen=True)
class VarianceShares:
    """Fractions of a horizontal variance by source, and the ratio of the filter to the best linear filter."""

    flight: str  # profile
    label: str  # of the filter
    when: str
    sd: float  # horizontal, of the filter [m]
    shares: Mapping[str, float]  # by part of `_PARTS`, largest first [1]
    over_best: float  # error of the filter over that of the best linear one [1]

    @property
    def limiting(self) -> str:
        """The filter, or the part with the largest share."""
        return "the filter" if self.over_best >= _COSTLY else next(iter(self.shares))

    def tell(self, unit: str) -> str:
        """Return the limiting factor in words."""
        parts = [f"{name} {100.0 * share:.0f} %" for name, share in self.shares.items() if share >= 0.005]
        return (
            f"What limits {self.label} with {unit} on {self.flight} at {self.when} is {self.limiting}: "
            f"of the variance {', '.join(parts)} (expected {format_number(self.sd, 3)} m RMS); the best "
            f"linear filter would have {100.0 / self.over_best:.0f} % of the error."
        )


def find_limit(flight: UnitFlight) -> VarianceShares | None:
    """Return the limiting factor of a flight, at the end of its longest outage or of the flight.

    None if flight or filter have no linear model: other aiding, faults, a start that is not given.
    """
    try:
        profile, truth = flight.load()
        (choice,) = profile.estimators
        label, one = choice.label, pipeline.build_estimator(choice)
        if not isinstance(one, Loose):
            return None
        check_aiding(label, one)
        t = output_times(truth, profile)
        sensed = sensors.sense(truth, profile.sensors, profile.seed, 0)
        gains = record_gains(one, sensed, truth, t)
    except ConfigError:
        return None
    model = model_errors(truth, profile.sensors, profile.seed, known_jumps=True)
    budget = split_errors(gains, model)
    bound = bound_flight(truth, profile.sensors, sensed.data, profile.seed, t, smooth=False)
    instants = key_instants(budget.t, profile)
    longest = max(profile.sensors.gnss_outages, key=lambda one: one[1] - one[0], default=None)
    when = next(
        (words for words in instants if longest and words.startswith(f"{longest[1]:g} s,")), [*instants][-1]
    )
    k = instants[when]
    by_source = budget.variance[k, :2].sum(axis=0)
    shares: dict[str, float] = {}
    for source, variance in zip(model.sources, by_source, strict=True):
        part = _PARTS[source.part]
        shares[part] = shares.get(part, 0.0) + float(variance / by_source.sum())
    best = float(variance_of(bound, smooth=False)[k, :2].sum())
    return VarianceShares(
        profile.name,
        label,
        when,
        float(np.sqrt(by_source.sum())),
        dict(sorted(shares.items(), key=lambda pair: -pair[1])),
        float(np.sqrt(by_source.sum() / best)),
    )
