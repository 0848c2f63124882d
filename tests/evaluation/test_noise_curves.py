"""Figures of a measured Allan curve, and how they are shown, by hand."""

from __future__ import annotations

import numpy as np
import pytest

from bench.evaluation.noise_curves import AllanCurve, AllanResult, fit_noise, format_noise_figures
from bench.sensor_specs import TriadSpec


def make_curve(tau, measured, low=0.0, high=np.inf):
    size = np.ones(len(tau))
    return AllanCurve("gyro", tau, measured, 50.0 * size, low * size, high * size, np.nan * size)


def test_the_parts_of_a_curve_are_those_it_was_made_of():
    """N^2 / T + B^2 + K^2 T / 3; of the quantization, 3 Q^2 / T^2, nothing is left in them."""
    tau = 2.0 ** np.arange(-4, 12)
    made = np.sqrt(3.0 * 0.01**2 / tau**2 + 0.3**2 / tau + 0.02**2 + 0.001**2 * tau / 3.0)
    assert fit_noise(make_curve(tau, made)) == pytest.approx({"N": 0.3, "B": 0.02, "K": 0.001}, rel=1e-6)


def test_figures_are_in_the_units_of_datasheets():
    """1 deg/sqrt(h), 2 deg/h, 3 deg/h/sqrt(h); 0.5 m/s/sqrt(h), 40 ug, 6 ug/sqrt(h)."""
    deg, micro = np.pi / 180.0, 9.80665e-6
    gyro = TriadSpec(
        quantization=1e-6, random_walk=deg / 60.0, bias_instability=2.0 * deg / 3600.0,
        rate_random_walk=3.0 * deg / 3600.0 / 60.0,
    )  # fmt: skip
    accel = TriadSpec(
        quantization=2e-4, random_walk=0.5 / 60.0, bias_instability=40.0 * micro,
        rate_random_walk=6.0 * micro / 60.0,
    )  # fmt: skip
    assert list(format_noise_figures("gyro", gyro).values()) == [
        "1e-06 rad", "1 deg/sqrt(h)", "2 deg/h", "3 deg/h/sqrt(h)",
    ]  # fmt: skip
    assert list(format_noise_figures("accel", accel).values()) == [
        "0.0002 m/s", "0.5 m/s/sqrt(h)", "40 ug", "6 ug/sqrt(h)",
    ]  # fmt: skip


def test_one_value_in_a_hundred_may_lie_outside_its_band():
    tau = np.arange(1.0, 101.0)
    values = np.ones(100)
    values[[3, 7]] = 0.4, 2.1
    two = make_curve(tau, values, 0.5, 2.0)
    sound = make_curve(tau, np.ones(100), 0.5, 2.0)
    assert (two.outside, sound.outside) == (2, 0)
    assert not AllanResult("made", (two,), None, simulated=True).held
    assert AllanResult("made", (two,), None, simulated=False).held
    both = AllanResult("made", (two, sound), None, simulated=True)
    assert (both.points, both.outside, both.held) == (200, 2, True)
