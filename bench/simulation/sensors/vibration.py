"""Vibration at the IMU: by the engine, by a structural mode that gusts excite, and by rotors.

It is motion and not an error of a sensor, so bandwidth, range and nonlinear errors act on it. It is not
part of the truth, because its velocity and angle stay bounded.
"""

from __future__ import annotations

import numpy as np

from bench.core.compilation.compiled import kernel
from bench.core.files import disk_arrays
from bench.core.mathematics.arrays import FloatArray
from bench.core.records.data import AirData, Trajectory
from bench.core.records.sensor_specs import VibrationSpec
from bench.simulation.sensors.draws import SensorDraws
from bench.simulation.sensors.imu_terms import compute_oscillator_step
from bench.simulation.sensors.rotor_vibration import RotorTones

_WINDOW = 10.0  # a gust is the deviation of the wind from its mean over this time [s]


def shake(truth: Trajectory, spec: VibrationSpec, draws: SensorDraws) -> tuple[FloatArray, FloatArray]:
    """Add vibration to the true increments; return dtheta_b (K, 3) [rad] and dvel_b (K, 3) [m/s], b.

    Vibration by rotors is that of an IMU that measures a sample as a whole. Parameters and errors: see
    `shake_by_engine` and `rotor_vibration.RotorTones`.
    """
    shaken = shake_by_engine(truth, spec, draws)
    if not spec.by_rotors:
        return shaken
    return RotorTones(truth, spec, draws).add(slice(0, len(truth.t) - 1), *shaken, 1)


def shake_by_engine(
    truth: Trajectory, spec: VibrationSpec, draws: SensorDraws
) -> tuple[FloatArray, FloatArray]:
    """Add vibration by the engine and by gusts to the true increments; return dtheta_b and dvel_b (K, 3).

    Parameters
    ----------
    truth : Trajectory
        For increments, engine speed and wind. Its own increments are returned if there is no vibration.
    spec : VibrationSpec
        Sources of vibration.
    draws : SensorDraws
        Has the streams "engine", "shape" and "gust".

    Notes
    -----
    Engine: a sine at ``engine_order`` times the engine speed, with its own phase for each axis and an
    amplitude proportional to the square of the speed (unbalance), integrated exactly over each sample. Gusts:
    one structural mode, a band-pass process at ``mode_frequency``, along a direction drawn once, in
    proportion to the rms of the gusts of the last 10 s.
    """
    if not spec.by_engine:
        return truth.dtheta_b, truth.dvel_b
    gusts = find_gusts(truth.air, spec, draws)
    return shake_parts(truth.t, truth.dtheta_b, truth.dvel_b, truth.air, gusts, spec, draws)


def find_gusts(air: AirData, spec: VibrationSpec, draws: SensorDraws) -> FloatArray:
    """Return the rms of the gusts (A,) of a piece of a flight [m/s]; empty if they shake nothing."""
    return compute_gust_rms(air, draws) if max(spec.gust_gyro, spec.gust_accel) > 0 else np.empty(0)


def shake_parts(
    t: FloatArray, dtheta_b: FloatArray, dvel_b: FloatArray, air: AirData, gust_rms: FloatArray,
    spec: VibrationSpec, draws: SensorDraws,
) -> tuple[FloatArray, FloatArray]:  # fmt: skip
    """Add vibration by engine and gusts to increments (K, 3) between t (K + 1,) [s], of a part of a flight.

    The part continues the part before, of any length. ``gust_rms`` (A,) [m/s] comes from `find_gusts`.
    """
    engine = np.array([spec.engine_gyro, spec.engine_accel])
    gusts = np.array([spec.gust_gyro, spec.gust_accel])
    c, s, angle, displacement, strength = (disk_arrays.zeros(len(t)) for _ in range(5))
    cosines, sines, shape = np.zeros((3, 2, 3))
    if engine.any():
        phases = draws.keep("phases", lambda: draws.stream("engine").uniform(0.0, 2 * np.pi, (2, 3)))
        size = np.sqrt(2) * engine / (spec.engine_order * spec.engine_reference) ** 2
        cosines, sines = -size[:, None] * np.cos(phases), size[:, None] * np.sin(phases)
        turned = draws.keep("angle", lambda: np.zeros(1))
        engine_angle_kernel(t, air.t, spec.engine_order * air.engine_speed, turned, angle)
        np.cos(angle, out=c)
        np.sin(angle, out=s)
    if gusts.any():
        shape = draws.constant("shape", 2, 3)
        shape = shape * gusts[:, None] * np.sqrt(3) / np.linalg.norm(shape, axis=1, keepdims=True)
        interpolate_kernel(t, air.t, gust_rms, strength)
        simulate_mode(t, spec, draws, displacement)
    shaken = disk_arrays.empty(dtheta_b.shape), disk_arrays.empty(dvel_b.shape)
    for triad, (true, out) in enumerate(zip((dtheta_b, dvel_b), shaken, strict=True)):
        for rows in disk_arrays.blocks(len(out)):
            at = slice(rows.start, None)  # epochs at both ends of the samples
            shake_kernel(
                t[at], true[rows], angle[at], c[at], s[at], cosines[triad], sines[triad],
                displacement[at], strength[at], shape[triad], out[rows],
            )  # fmt: skip
    return shaken


@kernel
def shake_kernel(
    t: FloatArray, true: FloatArray, angle: FloatArray, c: FloatArray, s: FloatArray,
    cosines: FloatArray, sines: FloatArray, displacement: FloatArray, strength: FloatArray,
    shape: FloatArray, out: FloatArray,
) -> None:  # fmt: skip
    """Add vibration by engine angle and displacement of the mode, (K + 1,), to true increments (K, 3).

    The integral of a sine of amplitude w^2 and rate w is -w (cos 1 - cos 0).
    """
    for k in range(true.shape[0]):
        speed = (angle[k + 1] - angle[k]) / (t[k + 1] - t[k])
        dc, ds = speed * (c[k + 1] - c[k]), speed * (s[k + 1] - s[k])
        moved = 0.5 * (strength[k] + strength[k + 1]) * (displacement[k + 1] - displacement[k])
        for i in range(3):
            out[k, i] = true[k, i] + dc * cosines[i] + ds * sines[i] + moved * shape[i]


@kernel
def interpolate_kernel(t: FloatArray, at: FloatArray, values: FloatArray, out: FloatArray) -> None:
    """Fill out (N,) with values (A,) at times ``at`` (A,), interpolated to t (N,), constant beyond."""
    j = 0
    for k in range(len(t)):
        while j < len(at) - 1 and at[j + 1] <= t[k]:
            j += 1
        fraction = (t[k] - at[j]) / (at[j + 1] - at[j]) if j < len(at) - 1 else 0.0
        fraction = min(max(fraction, 0.0), 1.0)
        out[k] = values[j] + fraction * (values[min(j + 1, len(at) - 1)] - values[j])


@kernel
def engine_angle_kernel(
    t: FloatArray, at: FloatArray, speed: FloatArray, turned: FloatArray, angles: FloatArray
) -> None:
    """Fill angles (N,) from the speed (A,) at times ``at`` (A,), linear in between; trapezoids.

    ``turned`` (1,) is the angle at t[0], and becomes that at the end.
    """
    interpolate_kernel(t, at, speed, angles)
    before, angle = angles[0], turned[0]
    angles[0] = angle
    for k in range(1, len(t)):
        angle += 0.5 * (before + angles[k]) * (t[k] - t[k - 1])
        before, angles[k] = angles[k], angle
    turned[0] = angle


def compute_gust_rms(air: AirData, draws: SensorDraws) -> FloatArray:
    """Return the rms of the gusts per axis (A,) in the 10 s before each time of the air data [m/s].

    ``draws`` keeps what the next piece needs, which begins with the last epoch of this one.
    """
    begun = draws.keep("wind", lambda: [air.wind_n[0], np.zeros((1, 6)), 0.0])
    origin, sums, last = begun
    repeated = len(sums) > 1  # the first row was in the piece before
    interval = (air.t[-1] - air.t[0]) / max(len(air.t) - 1, 1)
    rows = max(2, round(_WINDOW / interval)) if interval > 0 else 2
    wind = air.wind_n[repeated:] - origin
    added = np.concatenate([sums[-1:], np.hstack([wind, wind**2])])
    sums = np.concatenate([sums[:-1], np.cumsum(added, axis=0)])
    stop = np.arange(len(sums) - len(wind), len(sums))
    first = np.maximum(stop - rows, 0)
    mean = (sums[stop] - sums[first]) / (stop - first)[:, None]
    rms = np.sqrt(np.maximum(mean[:, 3:] - mean[:, :3] ** 2, 0.0).mean(axis=1))
    begun[1:] = [sums[-rows - 1 :], rms[-1] if len(rms) else last]
    return np.concatenate([[last], rms]) if repeated else rms


def simulate_mode(t: FloatArray, spec: VibrationSpec, draws: SensorDraws, displacement: FloatArray) -> None:
    """Fill the displacement (N,) of a stationary mode with a rate of rms 1."""
    w = 2 * np.pi * spec.mode_frequency
    interval = draws.keep("interval", lambda: float(t[1] - t[0]))
    step = compute_oscillator_step(w, spec.mode_damping, interval)
    spread = np.diag([1 / w**2, 1.0])  # of displacement and rate
    added = spread - step @ spread @ step.T
    root = np.zeros((2, 2))  # of ``added``, lower triangular
    root[0, 0] = np.sqrt(added[0, 0])
    root[1, 0] = added[1, 0] / root[0, 0]
    root[1, 1] = np.sqrt(added[1, 1] - root[1, 0] ** 2)
    state = draws.keep("mode", lambda: draws.stream("gust").standard_normal(2) * [1 / w, 1.0])
    displacement[0] = state[0]
    for rows in disk_arrays.blocks(len(t) - 1):
        noise = draws.stream("gust").standard_normal((rows.stop - rows.start, 2))
        mode_kernel(step, root, noise, state, displacement[rows.start + 1 : rows.stop + 1])


@kernel
def mode_kernel(
    step: FloatArray, added: FloatArray, noise: FloatArray, state: FloatArray, out: FloatArray
) -> None:
    """Fill out (K,) with the displacement; ``state`` (2,), displacement and rate, is updated."""
    x, v = state[0], state[1]
    for k in range(len(out)):
        a, b = noise[k, 0], noise[k, 1]
        x, v = (
            step[0, 0] * x + step[0, 1] * v + added[0, 0] * a,
            step[1, 0] * x + step[1, 1] * v + added[1, 0] * a + added[1, 1] * b,
        )
        out[k] = x
    state[0], state[1] = x, v
