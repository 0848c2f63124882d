"""Controls act from one sample to the next, and what is measured meanwhile is what is recorded."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from bench import pipeline
from bench.core.words.exceptions import ConfigError
from bench.evaluation.errors.replay import Replay
from bench.io import config
from bench.io.results import join_pieces
from bench.plugins.hil import serving
from bench.plugins.hil.actuator_channels import ActuatorChannels
from bench.simulation.flight.guidance.steering import Commands, SurfaceCommand
from bench.simulation.sampled.imu_samples import SampledImu
from bench.simulation.sampled.sample_flight import SampleFlight
from bench.simulation.sensors.draws import SensorDraws
from tests.plugins.hil.test_serve import write_straight

AS_IT_IS = """
source = "by hand"
[gyro]
noise_deg_sqrt_h = 0.3
noise_shape = "averaged"
bandwidth_hz = 80.0
transient_sd_deg_h = 100.0
transient_time_s = 2.0
hysteresis_sd_deg_h = 40.0
temperature2_sd_deg_h_k2 = 1.0
[accel]
noise_ug_sqrt_hz = 100.0
noise_shape = "sampled"
bandwidth_hz = 50.0
resolution_mg = 0.1
[thermal]
self_heating_k = 10.0
time_constant_s = 3.0
[clock]
drift_ppm = 100.0
jitter_us = 500.0
"""
LEVEL = SurfaceCommand(0.0, 0.0, 0.0, 0.5)


def fly(profile, duration, give, rate=400.0, every=0):
    """Fly by a command for each sample, and measure the IMU; return motions, samples and the truth."""
    commands, sensors = Commands(), profile.sensors
    flight = SampleFlight(replace(profile.flight, rate=rate), duration, commands)
    imu = SampledImu(sensors.imu, sensors.faults, SensorDraws(profile.seed, 0), rate)
    samples = flight.fly()
    first = next(samples)
    imu.begin(*first)
    motions, measured = [first[0]], []
    for k, (motion, air) in enumerate(samples, 1):
        motions.append(motion)
        measured.append(imu.measure(motion, air))
        commands.wanted = give(k)
        if every and k % every == 0:
            flight.cut()
    return motions, measured, join_pieces(flight.finish(""))


def stack(rows, name):
    return np.array([getattr(row, name) for row in rows])


@pytest.mark.parametrize("rate", [250.0, 400.0])
def test_a_command_moves_the_aircraft_before_the_next_but_one_sample(rate):
    """Two flights, equal to the bit until one of them rolls at sample 40: they differ from sample 41 on.

    The surface of this aircraft has no lag; a lag of guidance of 50 ms would show after 20 ms only 0.33.
    """
    profile = config.read_profile("s-turns")
    rolled = replace(LEVEL, aileron=0.1)
    one, _, _ = fly(profile, 0.5, lambda k: LEVEL, rate)
    other, _, truth = fly(profile, 0.5, lambda k: rolled if k >= 40 else LEVEL, rate)
    p, q = (stack(motions[1:], "dtheta_b") * rate for motions in (one, other))
    apart = q[:, 0] - p[:, 0]
    assert_array_equal(apart[:40], 0.0)  # samples 1 to 40
    assert apart[40] > 0.0  # of the sample that follows the command, its last step
    assert (np.diff(apart[39:60]) > 0.0).all()
    full = apart[60] - apart[58]  # the acceleration in roll, before damping by p
    assert apart[43] - apart[41] > 0.9 * full
    assert_allclose(truth.controls.aileron[41:], 0.1, atol=1e-12)


@pytest.mark.parametrize(
    ("changes", "rate", "held"),
    [
        ({}, 250.0, 1e-11),
        ({"aircraft": "navion", "start.speed_mps": 60.0}, 400.0, 1e-11),  # the IMU is off the center
        (
            {"sensors.imu": "icm-42688-p", "wind.turbulence": "moderate"},
            400.0,
            1e-8,
        ),  # its temperature drifts
        ({"sensors.imu": "AS_IT_IS"}, 400.0, 1e-8),
    ],
)
def test_what_is_measured_sample_by_sample_is_what_is_recorded(changes, rate, held, tmp_path):
    if "AS_IT_IS" in changes.values():
        (tmp_path / "unit.toml").write_text(AS_IT_IS)
        changes = {"sensors.imu": str(tmp_path / "unit.toml")}
    changes = {"evaluation.from_s": 1.0, **changes}
    profile = config.read_profile(write_straight(tmp_path / "straight.toml", 20.0), changes)
    motions, measured, truth = fly(
        profile, 4.0, lambda k: replace(LEVEL, aileron=0.05 * np.sin(k / 30.0)), rate, 97
    )
    assert len(truth.t) == len(motions) == 4 * rate + 1
    assert_allclose(stack(motions, "lla"), truth.lla, rtol=1e-12, atol=3e-9)
    assert_allclose(stack(motions, "vel_n"), truth.vel_n, atol=1e-9)
    q_nb = stack(motions, "q_nb")
    assert_allclose(q_nb * np.sign(np.sum(q_nb * truth.q_nb, axis=1))[:, None], truth.q_nb, atol=1e-10)
    assert_allclose(stack(motions[4:], "dtheta_b"), truth.dtheta_b[3:], atol=1e-14)
    assert_allclose(stack(motions[4:], "dvel_b"), truth.dvel_b[3:], atol=1e-11)
    recorded = pipeline.sense(profile, truth).data.imu
    last = len(measured) - len(measured) % round(0.05 * rate)  # until the last whole interval of the bias
    for column in ("dtheta_b", "dvel_b", "valid"):
        told = np.concatenate([getattr(one, column) for one in measured])
        assert_allclose(told[3:last], getattr(recorded, column)[3:last], atol=held)
    replay = Replay()
    replay.add(truth)
    assert replay.result()["replay_position_m"] < 1e-3


def test_250_hz_is_for_autopilots():
    with pytest.raises(ConfigError, match="rate_hz = 250 Hz is for an autopilot of bench serve"):
        config.read_profile("s-turns", {"rate_hz": 250})
    with pytest.raises(ConfigError, match="rate_hz = 250 is for autopilots; turns need a multiple of 20"):
        serving.serve("s-turns", overrides={"rate_hz": 250, "duration_s": 100.0}, gives="commands")
    with pytest.raises(ConfigError, match="--undulation 200 must be within 110 m"):
        serving.serve("s-turns", mavlink=ActuatorChannels(), undulation=200.0)
