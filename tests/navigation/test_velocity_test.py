"""Positions against velocities of a receiver: rare false alarms, and a slow ramp of the position is told."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import bench
from bench import pipeline
from bench.core.mathematics import earth
from bench.core.records.data import GnssFixes
from bench.core.records.sensor_specs import GnssSpec
from bench.core.words.exceptions import EstimatorError
from bench.evaluation.errors.error_series import error_series
from bench.navigation import built_in, estimator
from bench.navigation.engine.velocity_consistency import WINDOWS, MovedFixes
from bench.navigation.error_state_filter.aiding_sensors import fix_variance
from tests.builders import student

RECEIVER = GnssSpec(
    "test",
    rate=1.0,
    pos_h_white_sd=1.5,
    pos_v_white_sd=2.0,
    vel_white_sd=0.05,
    pos_h_markov_sd=3.0,
    pos_v_markov_sd=4.0,
    vel_markov_sd=0.05,
    pos_decay_time=1.0 / 600.0,
    vel_decay_time=1.0 / 100.0,
)
ALARM = 1e-5
START = 300.0  # of a fault [s]


def fixes(seed: int, seconds: float = 1500.0) -> GnssFixes:
    """Fixes of a vehicle that circles at 25 m/s and 0.2 rad/s, with the errors of the receiver."""
    g, random, dt = RECEIVER, np.random.default_rng(seed), 1.0 / RECEIVER.rate
    t = np.arange(0.0, seconds, dt)

    def wander(sd, decay):
        keep = np.exp(-decay * dt)
        steps = random.standard_normal((len(t), 3)) * sd
        steps[1:] *= np.sqrt(1.0 - keep**2)
        for k in range(1, len(t)):
            steps[k] += keep * steps[k - 1]
        return steps

    h = np.array([1.0, 1.0, 0.0]), np.array([0.0, 0.0, 1.0])
    pos = 125.0 * np.column_stack([np.sin(0.2 * t), 1.0 - np.cos(0.2 * t), 0.0 * t])
    pos += (g.pos_h_white_sd * h[0] + g.pos_v_white_sd * h[1]) * random.standard_normal((len(t), 3))
    pos += wander(g.pos_h_markov_sd * h[0] + g.pos_v_markov_sd * h[1], g.pos_decay_time)
    vel = 25.0 * np.column_stack([np.cos(0.2 * t), np.sin(0.2 * t), 0.0 * t])
    vel += g.vel_white_sd * random.standard_normal((len(t), 3)) + wander(g.vel_markov_sd, g.vel_decay_time)
    origin = np.tile([0.8, 0.2, 500.0], (len(t), 1))
    cov = np.zeros((len(t), 3, 3))
    sound = np.ones(len(t), np.bool_)
    return GnssFixes(t, t, sound, earth.displace(origin, pos), vel, cov, cov, 10 + 0 * t.astype(int))


def told(one: GnssFixes, g: GnssSpec = RECEIVER) -> np.ndarray:
    variance = np.tile(fix_variance(g, gnss_markov=True), (len(one), 1))
    return MovedFixes(g, ALARM).take(one, variance, last=True)[0]


def moved(one: GnssFixes, offset_n: np.ndarray) -> GnssFixes:
    return replace(one, lla=earth.displace(one.lla, offset_n))


def test_a_sound_receiver_is_told_as_rarely_as_asked_for_and_a_worse_one_is_not():
    """6000 fixes at 1e-5: more than 2 have a chance of 4e-5."""
    assert sum(told(fixes(seed)).sum() for seed in range(4)) <= 2
    better = replace(RECEIVER, pos_h_white_sd=0.5, pos_v_white_sd=0.6)  # than the one that is flown
    assert told(fixes(0), better).mean() > 0.01


def test_a_step_and_a_slow_ramp_are_told_until_they_end():
    one = fixes(1, 600.0)
    since = np.clip(one.t - START, 0.0, None) * (one.t < 400.0)
    during = (one.t >= START) & (one.t < 400.0)
    for offset, late in ((100.0 * during, 1.0), (1.0 * since, 25.0)):
        found = told(moved(one, np.column_stack([offset, 0.0 * offset, 0.0 * offset])))
        assert one.t[found].min() <= START + late
        assert found[(one.t >= START + late) & during].mean() > 0.95
        assert not found[~during].any()


def test_a_bad_first_fix_harms_no_other_and_a_gap_begins_anew():
    one = fixes(2, 200.0)
    off = np.zeros((len(one), 3))
    off[0, 1] = 200.0
    assert not told(moved(one, off)).any()
    after = one.t > 100.0
    apart = moved(one, 500.0 * after[:, None] * [1.0, 0.0, 0.0])  # another receiver after a pause
    assert told(apart)[after].all()
    assert not told(apart.take((one.t <= 100.0) | (one.t > 100.0 + WINDOWS[0]))).any()
    assert not told(replace(apart, vel_n=np.full_like(apart.vel_n, np.nan))).any()


def test_gnss_faults_are_detected_the_filter_recovers_and_is_honest_outside():
    """During faults detection and error are evaluated, after the last one recovery, before the first NEES."""
    profile = bench.read_profile("gnss-faults")
    truth = bench.fly(profile)
    one = built_in.load("loose-full", {"integrity": ["nis", "velocity"]})
    plain = built_in.load("loose-full", {})
    outside, led = [], []
    for run in range(6):
        sensed = bench.sense(profile, truth, run=run)
        solution = estimator.answer(one, "loose-full", sensed.data, sensed.initial)
        errors, found = pipeline.measure(profile, truth, solution)
        assert [found[f"fault_{k}_detected"] for k in range(1, 5)] == [1.0] * 4
        assert found["fault_4_delay_s"] < 20.0
        assert found["fault_4_max_h_m"] < 8.0  # of the 60 m it is pulled
        sound = (errors.t >= 60.0) & (errors.t < 80.0)
        outside.append(errors.nees[sound].mean())
        last = errors.t > 255.0
        assert np.hypot(*errors.pos_n[last, :2].T).max() < 5.0 * np.sqrt(solution.cov[last, 0, 0].max())
        other = estimator.answer(plain, "loose-full", sensed.data, sensed.initial)
        led.append(np.hypot(*error_series(truth, other).pos_n[errors.t < 240.0][-1, :2]))
    assert min(led) > 30.0  # without the test the filter follows
    spread = np.std(outside, ddof=1) / np.sqrt(len(outside))
    assert abs(np.mean(outside) - 9.0) < student(len(outside)) * spread


@pytest.mark.parametrize(
    ("use", "options"), [("tight", {}), ("loose-15", {"gnss": False}), ("classic-22", {})]
)
def test_a_filter_without_fixes_refuses_the_test(use, options):
    with pytest.raises((EstimatorError, ValueError), match="integrity = 'velocity'"):
        built_in.load(use, {"integrity": ["nis", "velocity"], **options})
