"""Heading from two antennas: angular offset, multipath, white noise, limit of slope."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from bench.core.mathematics import rotation
from bench.core.mathematics.arrays import FloatArray
from bench.core.records.data import Trajectory
from bench.core.records.instruments import HeadingData, HeadingSpec
from bench.core.records.sensor_specs import SensorsSpec
from bench.simulation.sensors.draws import SensorDraws
from bench.simulation.sensors.sampling import Sampler


def report(truth: Trajectory, on_board: SensorsSpec, draws: SensorDraws) -> tuple[HeadingData, FloatArray]:
    """Simulate the antennas on board; return their record and the offset of their line (M,) [rad].

    The multipath is no part of it: a filter has a state of its own for that.
    """
    assert on_board.heading is not None  # otherwise `sense` does not call this
    record, parts = measure(truth, on_board.heading, draws)
    return record, parts[:, 0]


def measure(truth: Trajectory, spec: HeadingSpec, draws: SensorDraws) -> tuple[HeadingData, FloatArray]:
    """Simulate a heading from -180 to 180 deg; return its record, and offset and multipath (M, 2) [rad].

    A sample with the forward axis steeper than ``max_slope`` is not valid. The parameters are those of
    `Sampler`.
    """
    samples = Sampler("heading", truth, spec, draws)
    ahead_n = rotation.rotate(truth.q_nb[samples.rows], np.array([1.0, 0.0, 0.0]))
    parts = np.zeros((len(samples.t), 2))
    parts[:, 0] = samples.draw("bias", spec.bias_sd)
    if spec.wander_sd > 0:
        correlation, sd = np.array([spec.wander_time]), np.array([spec.wander_sd])
        parts[:, 1] = samples.draws.markov("wander", samples.steps, correlation, sd)[:, 0]
    level = np.abs(ahead_n[:, 2]) <= np.sin(spec.max_slope)
    heading = np.arctan2(ahead_n[:, 1], ahead_n[:, 0]) + parts.sum(axis=1)
    record: HeadingData = samples.report(heading, level)
    wrapped = record.heading - 2.0 * np.pi * np.rint(record.heading / (2.0 * np.pi))
    return replace(record, heading=wrapped), parts
