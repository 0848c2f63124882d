"""Random flights with alignment on the move, latency, a lever arm, IMU gaps: the filter is consistent."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from bench.evaluation.errors.error_series import error_series
from bench.navigation.built_in import load
from bench.simulation import sensors
from tests.builders import steered, take
from tests.weaving import DEG, GNSS, units

LENGTH = 120.0

FLIGHTS = st.fixed_dictionaries(
    {
        "heading": st.floats(0.0, 2 * np.pi),
        "lat": st.floats(-70.0, 70.0),
        "speed": st.floats(20.0, 80.0),
        "turn": st.floats(0.5, 3.0),  # [deg/s]
        "period": st.floats(20.0, 60.0),
        "push": st.floats(0.0, 0.5),
        "climb": st.floats(-3.0, 3.0),
        "latency": st.sampled_from([0.0, 0.1, 0.35]),
        "arm": st.tuples(*[st.floats(-2.0, 2.0)] * 3),
        "gap": st.sampled_from([None, (47.0, 0.2), (55.0, 0.45), (50.0, 3.0), (42.0, 10.0)]),
        "seed": st.integers(0, 10_000),
    }
)


def check(estimator, flight):
    """No error beyond 6 sigma, a mean NEES below three times its number of states."""
    f = flight
    truth = steered(
        LENGTH, 50.0, (f["lat"] * DEG, 0.3, 1500.0), f["heading"], f["speed"],
        turn=lambda t: f["turn"] * DEG * np.sin(2 * np.pi * t / f["period"]),
        push=lambda t: f["push"] * np.cos(2 * np.pi * t / 45.0),
        climb=lambda t: f["climb"] * (1 - np.exp(-t / 5.0)),
    )  # fmt: skip
    spec = units(gnss=replace(GNSS, latency=f["latency"]))
    spec = replace(spec, alignment="course", align_for=10.0, antenna_b=f["arm"], output_rate=2.0)
    sensed = sensors.sense(truth, spec, f["seed"], 0)
    data = sensed.data
    if f["gap"]:
        start, length = f["gap"]
        kept = (data.imu.t <= start + 1e-6) | (data.imu.t > start + length + 1e-6)
        data = replace(data, imu=take(data.imu, kept))
    solution = load(estimator, {}).run(data, sensed.initial)
    errors = error_series(truth, solution)
    late = errors.t > 85.0  # aligned again after the longest gap
    sd = np.sqrt(np.einsum("kii->ki", solution.cov))[late]
    ratio = np.abs(np.hstack([errors.pos_n, errors.vel_n, errors.phi_n])[late]) / sd
    assert np.isfinite(ratio).all()
    assert ratio.max() < 6.0
    assert errors.nees[late].mean() < 3 * 9


@settings(max_examples=12, derandomize=True, deadline=None, database=None)
@given(FLIGHTS)
def test_loose_stays_honest(flight):
    check("loose-15", flight)


@pytest.mark.long
@pytest.mark.parametrize("estimator", ["loose-15", "loose-22", "loose-mems"])
@settings(max_examples=150, derandomize=True, deadline=None, database=None)
@given(flight=FLIGHTS)
def test_many_stay_honest(estimator, flight):
    check(estimator, flight)
