"""The white noise of an IMU while it moves: the floor of the spectrum of its samples above the motion.

A vehicle moves as a whole below some hertz; what its engine and structure shake has lines and peaks. What a
filter integrates is the floor beside them near those hertz: a line comes back to where it was.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from bench.core.mathematics.arrays import FloatArray
from bench.core.records.data import ImuData
from bench.core.records.sensor_specs import ImuSpec
from bench.evaluation.motion.recorded_motion import Check
from bench.evaluation.motion.rest_noise import assume_noise

SEGMENT = 4.0
"""Length of the segments whose spectra are averaged [s]."""
LEAST = 40.0
"""Shortest time in motion that tells a noise [s]: ten spectra of eight frequencies in a band or more."""
BANDS = ((3.0, 5.0), (5.0, 7.0), (7.0, 10.0))
"""Above the motion of a vehicle as a whole, and low enough to count as what is integrated [Hz]."""
_SPARE = 0.9  # of the highest frequency that samples show


def measure_motion_noise(
    imu: ImuData, standstills: Sequence[tuple[float, float]]
) -> tuple[float, float] | None:
    """Return the noise of gyros [rad/sqrt(s)] and accelerometers [m/s/sqrt(s)], root mean square of the axes.

    Spectra of whole segments of `SEGMENT` without a standstill, a Hann window each, averaged; of each axis
    the median of `BANDS`, so that no peak in one of them counts. None if it moves for less than `LEAST`
    seconds or is sampled too slowly.
    """
    rows = np.flatnonzero(imu.valid)
    if len(rows) < 2:
        return None
    t, dt = imu.t[rows], float(np.median(imu.dt[rows]))
    count = round(SEGMENT / dt)
    usable = [(low, high) for low, high in BANDS if high <= _SPARE * 0.5 / dt]
    if not usable:
        return None
    window = np.hanning(count + 1)[:count, None]
    frequency = np.fft.rfftfreq(count, dt)
    inside = [(frequency >= low) & (frequency < high) for low, high in usable]
    total, segments = np.zeros((len(usable), 6)), 0
    for first in range(0, len(rows) - count + 1, count):
        begin, end = t[first] - dt, t[first + count - 1]
        gap = abs(end - begin - count * dt) > 0.5 * dt
        if gap or any(a < end and begin < b for a, b in standstills):
            continue
        part = rows[first : first + count]
        rate = np.hstack([imu.dtheta_b[part], imu.dvel_b[part]]) / imu.dt[part, None]
        power = spectrum(rate, window, dt)
        total += np.stack([power[rows_of].mean(axis=0) for rows_of in inside])
        segments += 1
    if segments * SEGMENT < LEAST:
        return None
    floor = np.sqrt(np.median(total / segments, axis=0))
    gyro, accel = (float(np.sqrt(np.mean(np.square(part)))) for part in (floor[:3], floor[3:]))
    return gyro, accel


def spectrum(rate: FloatArray, window: FloatArray, dt: float) -> FloatArray:
    """Return the power density (F, 6), two-sided, of samples (N, 6) less their trend."""
    line = np.linspace(-1.0, 1.0, len(rate))[:, None]
    level = rate - rate.mean(axis=0) - line * (line.T @ rate / np.sum(line**2))
    found = np.abs(np.fft.rfft(level * window, axis=0)) ** 2 * dt / np.sum(window**2)
    return np.asarray(found, np.float64)


def assume_motion_noise(
    spec: ImuSpec, imu: ImuData, standstills: Sequence[tuple[float, float]]
) -> tuple[ImuSpec, Check]:
    """Return a datasheet with the larger of its noise and the noise in motion, and a check with a message."""
    found = measure_motion_noise(imu, standstills)
    if found is None:
        text = f"imu: less than {LEAST:g} s of whole motion; the assumed noise is from {spec.name}"
        return spec, Check("motion_noise_ratio", None, text, True)
    low, high = BANDS[0][0], BANDS[-1][1]
    return assume_noise(spec, found, "motion_noise_ratio", f"noise in motion, {low:g} to {high:g} Hz")
