"""Radar altimeter: height above the ground with bias, white noise and limits of height and tilt."""

from __future__ import annotations

import numpy as np

from bench.core.mathematics import rotation
from bench.core.mathematics.arrays import BoolArray, FloatArray
from bench.core.records.data import Trajectory
from bench.core.records.flight_specs import TerrainSpec
from bench.core.records.instruments import RadarData, RadarSpec
from bench.core.records.sensor_specs import SensorsSpec
from bench.simulation.sensors.draws import SensorDraws
from bench.simulation.sensors.sampling import Sampler
from bench.simulation.signals.terrain import ground_at


def report(truth: Trajectory, on_board: SensorsSpec, draws: SensorDraws) -> tuple[RadarData, FloatArray]:
    """Simulate the radar altimeter on board; return its record and its slowly varying error."""
    assert on_board.radar is not None  # otherwise `sense` does not call this
    return measure(truth, on_board.radar, on_board.ground_alt, draws, on_board.terrain)


def measure(
    truth: Trajectory,
    spec: RadarSpec,
    ground_alt: float,
    draws: SensorDraws,
    terrain: TerrainSpec | None = None,
) -> tuple[RadarData, FloatArray]:
    """Simulate a radar altimeter at the IMU; return its record and its bias (M,) [m].

    Its beam is wide enough to include the vertical, and it tells the height above the point below. A sample
    below the smallest or above the largest height, or tilted beyond ``max_tilt``, is not valid. The other
    parameters and errors are those of `Sampler`.

    Parameters
    ----------
    ground_alt : float
        Ellipsoidal height of the flat ground [m].
    terrain : TerrainSpec, optional
        The ground instead of flat one; a sample where it has no height is not valid.
    """
    samples = Sampler("radar", truth, spec, draws)
    lat, lon, alt = truth.lla[samples.rows].T
    height = alt - (ground_alt if terrain is None else ground_at(terrain, lat, lon))
    bias = np.full(len(height), samples.draw("bias", spec.bias_sd))
    down_n = rotation.rotate(truth.q_nb[samples.rows], np.array([0.0, 0.0, 1.0]))
    seen: BoolArray = (height >= spec.min_height) & (height <= spec.range)
    return samples.report(np.nan_to_num(height) + bias, seen & (down_n[:, 2] >= np.cos(spec.max_tilt))), bias
