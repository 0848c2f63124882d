"""Figures of a measured Allan curve, and how they are shown, by hand."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.stats import chi2

from bench.core.records.sensor_specs import AxisFigures, ImuSpec, TriadSpec
from bench.evaluation.motion import noise_curves
from bench.evaluation.motion.noise_curves import (
    AllanCurve,
    AllanResult,
    format_noise_figures,
    measure_model,
    measure_record,
)


def make_curve(tau, measured, low=0.0, high=np.inf):
    size = np.ones(len(tau))
    return AllanCurve("gyro", tau, measured, 50.0 * size, low * size, high * size, np.nan * size)


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


def test_white_noise_of_a_model_is_that_of_its_datasheet_at_all_averaging_times():
    """Up to 8 s by 200 Hz, from there on by 1 Hz up to a sixteenth of 65,536 s; N / sqrt(T) is expected."""
    spec = ImuSpec("white", TriadSpec(random_walk=2e-4), TriadSpec(random_walk=3e-3))
    curves = measure_model(spec, 5)
    assert [one.triad for one in curves] == ["gyro", "accel"]
    for one, N in zip(curves, (2e-4, 3e-3), strict=True):
        fast, slow = 2.0 ** np.arange(11) / 200.0, 2.0 ** np.arange(3, 13)
        assert_allclose(one.tau, np.concatenate([fast, slow]))
        assert_allclose(one.expected, N / np.sqrt(one.tau), rtol=1e-6)
        assert list(one.terms) == ["white noise"] or len(one.terms) == 1
        for edge, p in ((one.low, 0.0005), (one.high, 0.9995)):
            assert_allclose(edge, one.expected * np.sqrt(chi2.ppf(p, one.edf) / one.edf), rtol=1e-6)
        assert_allclose(one.measured[:5], one.expected[:5], rtol=0.02)
        assert one.outside == 0
        assert 3.0 * 16 * 0.8 < one.edf[-1] < 3.0 * 16 * 2.0


def test_a_record_is_compared_with_its_datasheet_or_with_itself():
    t = 100.0 + np.arange(4097) / 50.0
    white = np.random.default_rng(2).standard_normal((4097, 3)) * [1.0, 2.0, 3.0]
    spec = ImuSpec("white", TriadSpec(random_walk=0.3), TriadSpec())
    for sheet in (spec, None):
        (one,) = measure_record(t, {"gyro": white}, sheet)
        assert_allclose(one.tau, 2.0 ** np.arange(9) / 50.0)
        assert one.measured[0] == pytest.approx(np.sqrt(np.mean(np.diff(white, axis=0) ** 2) / 2.0))
        means = white[:4096].reshape(-1, 256, 3).mean(axis=1)
        assert one.measured[-1] == pytest.approx(np.sqrt(np.mean(np.diff(means, axis=0) ** 2) / 2.0), rel=0.3)
        center = 0.3 / np.sqrt(one.tau) if sheet else one.measured
        assert_allclose(one.high, center * np.sqrt(chi2.ppf(0.9995, one.edf) / one.edf), rtol=1e-6)
        assert np.isnan(one.expected).all() == (sheet is None)
    skewed = replace(spec, gyro=replace(spec.gyro, axes=(AxisFigures("random_walk", 0.1, 0.2, 0.3),)))
    (alone,) = measure_record(t, {"gyro": white}, skewed)
    assert_allclose(3.0 * alone.edf, one.edf, rtol=1e-6)


def test_the_model_rests_with_one_g_at_25_degrees():
    truth = noise_curves.make_resting_truth(200.0, 3.0)
    assert_allclose(truth.t, np.arange(601) / 200.0)
    assert_allclose(truth.dvel_b, np.tile([0.0, 0.0, -9.80665 / 200.0], (600, 1)))
    assert_allclose(truth.q_nb, np.tile([1.0, 0.0, 0.0, 0.0], (601, 1)))
    assert not any(one.any() for one in (truth.dtheta_b, truth.vel_n, truth.lla))
    assert truth.air.t.tolist() == [0.0, 3.0]
    assert [column.tolist() for column in (truth.air.pressure, truth.air.temperature)] == [
        [101325.0] * 2, [298.15] * 2,
    ]  # fmt: skip
