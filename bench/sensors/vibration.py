"""Shaking at the place of the IMU: by the engine, and by the structure that gusts excite.

It is motion, not an error of a sensor, so it goes through bandwidth, range and squares like any other motion.
It is not in the truth: its velocity and angle stay bounded.
"""

from __future__ import annotations

import numpy as np

from bench.arrays import FloatArray
from bench.compiled import kernel
from bench.data import AirData, Trajectory
from bench.sensors.imu_terms import Draw, oscillator
from bench.specs import VibrationSpec

_WINDOW = 10.0  # gusts are what the wind departs from its mean over this time [s]


def check(spec: VibrationSpec) -> None:
    """Raise ValueError where a figure needs another one."""
    if max(spec.engine_gyro, spec.engine_accel) > 0 and not spec.engine_reference > 0:
        raise ValueError("vibration: engine_gyro and engine_accel need an engine_reference above 0 rad/s")
    if max(spec.gust_gyro, spec.gust_accel) > 0 and not (
        spec.mode_frequency > 0 and 0 < spec.mode_damping < 1
    ):
        raise ValueError(
            "vibration: gust_gyro and gust_accel need a mode_frequency above 0 and a mode_damping in (0, 1)"
        )


def shake(truth: Trajectory, spec: VibrationSpec, draw: Draw) -> tuple[FloatArray, FloatArray]:
    """Return the increments of angle [rad] and velocity [m/s] of the shaken IMU, (K, 3) each, b.

    Parameters
    ----------
    truth : Trajectory
        Its increments, engine speed and wind; the increments themselves are returned when nothing shakes.
    spec : VibrationSpec
        What there is.
    draw : Draw
        Streams "engine", "shape" and "gust".

    Notes
    -----
    Engine: sines at ``engine_order`` times the engine speed, each axis with a phase of its own, amplitude as
    the square of the speed (unbalance), integrated exactly over each sample. Gusts: one structural mode, a
    band-pass process about ``mode_frequency``, shakes all axes together in a direction drawn once, in
    proportion to the rms of the gusts in the 10 s around.
    """
    engine = np.array([spec.engine_gyro, spec.engine_accel])
    gusts = np.array([spec.gust_gyro, spec.gust_accel])
    if not (engine.any() or gusts.any()):
        return truth.dtheta_b, truth.dvel_b
    t, air = truth.t, truth.air
    c, s, turned, place, strength = np.zeros((5, len(t)))
    cosines, sines, shape = np.zeros((3, 2, 3))
    if engine.any():
        phases = draw("engine").uniform(0.0, 2 * np.pi, (2, 3))
        size = np.sqrt(2) * engine / (spec.engine_order * spec.engine_reference) ** 2
        cosines, sines = -size[:, None] * np.cos(phases), size[:, None] * np.sin(phases)
        _turned_kernel(t, air.t, spec.engine_order * air.engine_speed, turned)
        c, s = np.cos(turned), np.sin(turned)
    if gusts.any():
        shape = draw("shape").standard_normal((2, 3))
        shape *= gusts[:, None] * np.sqrt(3) / np.linalg.norm(shape, axis=1, keepdims=True)
        _resampled_kernel(t, air.t, gust_rms(air), strength)
        place = _mode(t, spec, draw("gust").standard_normal((len(t), 2)))
    dtheta_b, dvel_b = np.empty_like(truth.dtheta_b), np.empty_like(truth.dvel_b)
    for triad, (true, out) in enumerate(((truth.dtheta_b, dtheta_b), (truth.dvel_b, dvel_b))):
        _shake_kernel(t, true, turned, c, s, cosines[triad], sines[triad], place, strength, shape[triad], out)
    return dtheta_b, dvel_b


@kernel
def _shake_kernel(
    t: FloatArray,
    true: FloatArray,
    turned: FloatArray,
    c: FloatArray,
    s: FloatArray,
    cosines: FloatArray,
    sines: FloatArray,
    place: FloatArray,
    strength: FloatArray,
    shape: FloatArray,
    out: FloatArray,
) -> None:
    """Add to (K, 3) true increments what the angle of the engine and the place of the mode, (K + 1,), change.

    The integral of a sine of amplitude w^2 and rate w is -w (cos 1 - cos 0).
    """
    for k in range(true.shape[0]):
        speed = (turned[k + 1] - turned[k]) / (t[k + 1] - t[k])
        dc, ds = speed * (c[k + 1] - c[k]), speed * (s[k + 1] - s[k])
        moved = 0.5 * (strength[k] + strength[k + 1]) * (place[k + 1] - place[k])
        for i in range(3):
            out[k, i] = true[k, i] + dc * cosines[i] + ds * sines[i] + moved * shape[i]


@kernel
def _resampled_kernel(t: FloatArray, at: FloatArray, values: FloatArray, out: FloatArray) -> None:
    """Fill out (N,) at t (N,) by lines through values (A,) at (A,), held at both ends; times increase."""
    j = 0
    for k in range(len(t)):
        while j < len(at) - 2 and at[j + 1] <= t[k]:
            j += 1
        share = (t[k] - at[j]) / (at[j + 1] - at[j]) if len(at) > 1 else 0.0
        share = min(max(share, 0.0), 1.0)
        out[k] = values[j] + share * (values[min(j + 1, len(at) - 1)] - values[j])


@kernel
def _turned_kernel(t: FloatArray, at: FloatArray, speed: FloatArray, turned: FloatArray) -> None:
    """Fill the angle (N,) turned since t[0] from the speed (A,) at (A,), linear in between; trapezoids."""
    _resampled_kernel(t, at, speed, turned)
    before, angle = turned[0], 0.0
    turned[0] = 0.0
    for k in range(1, len(t)):
        angle += 0.5 * (before + turned[k]) * (t[k] - t[k - 1])
        before, turned[k] = turned[k], angle


def gust_rms(air: AirData) -> FloatArray:
    """Return the rms of the gusts (A,), per axis, in the 10 s around each instant of the air data [m/s]."""
    interval = (air.t[-1] - air.t[0]) / max(len(air.t) - 1, 1)
    half = max(1, round(0.5 * _WINDOW / interval)) if interval > 0 else 1
    wind = air.wind_n - air.wind_n.mean(axis=0)
    sums = np.vstack([np.zeros(6), np.cumsum(np.hstack([wind, wind**2]), axis=0)])
    rows = np.arange(len(wind))
    first, stop = np.maximum(rows - half, 0), np.minimum(rows + half + 1, len(wind))
    mean = (sums[stop] - sums[first]) / (stop - first)[:, None]
    rms: FloatArray = np.sqrt(np.maximum(mean[:, 3:] - mean[:, :3] ** 2, 0.0).mean(axis=1))
    return rms


def _mode(t: FloatArray, spec: VibrationSpec, noise: FloatArray) -> FloatArray:
    """Return the place (N,) of a stationary mode whose rate has rms 1; unit noise (N, 2)."""
    w = 2 * np.pi * spec.mode_frequency
    step = oscillator(w, spec.mode_damping, (t[-1] - t[0]) / (len(t) - 1))
    spread = np.diag([1 / w**2, 1.0])  # of place and rate
    added = spread - step @ spread @ step.T
    root = np.zeros((2, 2))  # of ``added``, lower triangular
    root[0, 0] = np.sqrt(added[0, 0])
    root[1, 0] = added[1, 0] / root[0, 0]
    root[1, 1] = np.sqrt(added[1, 1] - root[1, 0] ** 2)
    place = np.empty(len(t))
    _mode_kernel(step, root, 1 / w, noise, place)
    return place


@kernel
def _mode_kernel(
    step: FloatArray, added: FloatArray, sd: float, noise: FloatArray, place: FloatArray
) -> None:
    x, v = sd * noise[0, 0], noise[0, 1]
    place[0] = x
    for k in range(1, len(place)):
        a, b = noise[k, 0], noise[k, 1]
        x, v = (
            step[0, 0] * x + step[0, 1] * v + added[0, 0] * a,
            step[1, 0] * x + step[1, 1] * v + added[1, 0] * a + added[1, 1] * b,
        )
        place[k] = x
