"""The white noise of an IMU where it is mounted, from the standstills of a recording.

What shakes it, an engine or the wind, is no error of a bias, so no state of a filter takes it: it has to be
assumed as noise. While the vehicle moves there is more of it, which standstills do not show.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from bench.core.files import disk_arrays
from bench.core.mathematics.arrays import FloatArray, IntArray
from bench.core.records.data import ImuData
from bench.core.records.sensor_specs import ImuSpec, TriadSpec
from bench.evaluation.motion.noise_curves import format_noise_figures
from bench.evaluation.motion.recorded_motion import Check

TAU = 1.0
"""Averaging time of the Allan deviation [s]: a bias changes little within it."""
LEAST = 10.0
"""Shortest time at rest that tells a noise [s]: it is then known to a third or better."""
WINDOW = 1.0
"""Length of the segments whose noise is compared [s]."""
_SHAKEN = 0.9  # quantile of the noise of the segments: the median of the noisiest fifth
_MARGIN = 0.5  # to the ends of a standstill [s]
_STEPS = 8  # averages begin this often in each averaging time
_MAD = 1.4826  # standard deviation over median absolute deviation of a normal distribution


def measure_rest_noise(
    imu: ImuData, standstills: Sequence[tuple[float, float]]
) -> tuple[float, float] | None:
    """Return the noise of gyros [rad/sqrt(s)] and accelerometers [m/s/sqrt(s)], root mean square of the axes.

    By the Allan deviation at `TAU`; a median in place of a mean, so that a step into the car or a door does
    not count. None if the vehicle rests for less than `LEAST` seconds.
    """
    rows = np.flatnonzero(imu.valid)
    sums, t = _sum_up(imu, rows), imu.t[rows]
    length, apart = 0.0, list[FloatArray]()
    for start, end in standstills:
        at = np.arange(start + _MARGIN, end - _MARGIN, TAU / _STEPS)
        if len(at) > 2 * _STEPS:
            way = np.stack([np.interp(at, t, column) for column in sums.T], axis=-1)
            apart.append(way[2 * _STEPS :] - 2.0 * way[_STEPS:-_STEPS] + way[: -2 * _STEPS])
            length += float(at[-1] - at[0])
    if length < LEAST:
        return None
    noise = _MAD * np.median(np.abs(np.concatenate(apart)), axis=0) / np.sqrt(2.0 * TAU)
    gyro, accel = (float(np.sqrt(np.mean(np.square(part)))) for part in (noise[:3], noise[3:]))
    return gyro, accel


def measure_vibration(imu: ImuData) -> tuple[FloatArray, FloatArray]:
    """Return the noise of gyros [rad/sqrt(s)] and accelerometers [m/s/sqrt(s)] (3,) while it shakes most.

    Second differences of neighboring rates have sqrt(6) times the standard deviation of white noise, and
    hardly contain slow motion. The figure is the median of the noisiest fifth of the seconds, because an
    engine runs in the flight, not before it.
    """
    rows = np.flatnonzero(imu.valid)
    dt = float(np.median(imu.dt[rows]))
    many = max(round(WINDOW / dt), 3)
    noise = []
    for increments in (imu.dtheta_b, imu.dvel_b):
        rate = increments[rows] / imu.dt[rows, None]
        bend = rate[2:] - 2.0 * rate[1:-1] + rate[:-2]
        count = len(bend) // many
        if not count:
            noise.append(np.zeros(3))
            continue
        power = np.square(bend[: count * many]).reshape(count, many, 3).mean(axis=1)
        noise.append(np.sqrt(np.quantile(power, _SHAKEN, axis=0) / 6.0 * dt))
    return noise[0], noise[1]


def assume_vibration(spec: ImuSpec, imu: ImuData) -> tuple[ImuSpec, Check]:
    """Return a datasheet with the larger of its noise and the recorded noise, and a check with a message."""
    gyro, accel = (float(np.sqrt(np.mean(np.square(axes)))) for axes in measure_vibration(imu))
    return assume_noise(spec, (gyro, accel), "vibration_ratio", "noise from sample to sample")


def _sum_up(imu: ImuData, rows: IntArray) -> FloatArray:
    """Return the sums (K, 6) of the increments of rows (K,) up to each: angle [rad], velocity [m/s]."""
    reached = np.zeros((1, 6))
    sums = disk_arrays.empty((len(rows), 6))
    for block in disk_arrays.blocks(len(rows)):
        steps = np.hstack([imu.dtheta_b[rows[block]], imu.dvel_b[rows[block]]])
        sums[block] = np.cumsum(np.vstack([reached, steps]), axis=0)[1:]
        reached = sums[block.stop - 1 : block.stop].copy()
    return sums


def assume_rest_noise(
    spec: ImuSpec, imu: ImuData, standstills: Sequence[tuple[float, float]]
) -> tuple[ImuSpec, Check]:
    """Return a datasheet with the larger of its noise and the noise at rest, and a check with a message."""
    found = measure_rest_noise(imu, standstills)
    if found is None:
        text = f"imu: at rest for less than {LEAST:g} s; the assumed noise is from {spec.name}"
        return spec, Check("rest_noise_ratio", None, text, True)
    return assume_noise(
        spec, found, "rest_noise_ratio", "noise at rest", "; while it moves there may be more"
    )


def assume_noise(
    spec: ImuSpec, found: tuple[float, float], name: str, what: str, more: str = ""
) -> tuple[ImuSpec, Check]:
    """Return a datasheet with the larger of its noise and the measured noise, and a check with a message.

    The message begins with ``what``, the kind of noise, and ends with ``more``; the check is called ``name``.
    """
    words, triads, ratios = [], dict[str, TriadSpec](), list[float]()
    for kind, noise in zip(("gyro", "accel"), found, strict=True):
        triad = getattr(spec, kind).averaged()
        shown = format_noise_figures(kind, replace(triad, random_walk=noise))["white noise"]
        ratio = noise / triad.random_walk if triad.random_walk > 0 else np.inf
        taken = "assumed" if ratio > 1.0 else f"less than in {spec.name}, which is assumed"
        words.append(f"{kind} {shown}, {ratio:.3g} times {spec.name}: {taken}")
        triads[kind] = replace(triad, random_walk=max(noise, triad.random_walk))
        ratios.append(ratio)
    text = f"imu: {what}: {'; '.join(words)}{more}"
    told = Check(name, max(ratios), text, True)
    return replace(spec, gyro=triads["gyro"], accel=triads["accel"]), told
