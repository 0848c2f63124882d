"""Simulation of an IMU: measured increments from the exact increments of the truth.

For each triad: motion at the sensors and their response (`motion_response.respond`), then
``(I + M) increment + bias dt + white noise`` and the errors of `imu_terms.draw_motion_errors` (A-5.1.8),
clipping to the range, then quantization with the remainder carried to the next sample, or rounding of the
rate without it. M holds scale factor errors on its diagonal and misalignments off it. Every random term has
its own stream, ``imu.<triad>.<term>``; a term that is off draws nothing.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from bench.core.compilation.compiled import kernel
from bench.core.files import disk_arrays
from bench.core.mathematics.arrays import BoolArray, FloatArray, IntArray
from bench.core.records.data import ImuData, Trajectory
from bench.core.records.sensor_specs import ImuSpec, SampleClockSpec, TriadSpec
from bench.simulation.sensors import imu_terms, motion_response
from bench.simulation.sensors.draws import SensorDraws
from bench.simulation.sensors.processes import choose_bias_stages

BIAS_STEP = 0.05  # step of bias processes slower than _FAST, with linear interpolation [s]
_FAST = 1.0  # a bias stage with a shorter correlation time has a step at every sample [s]


class ImuBias(NamedTuple):
    """The applied biases, linear between epochs that include the first and the last of the truth."""

    t: FloatArray  # (B,) [s]
    gyro_b: FloatArray  # (B, 3) [rad/s], b
    accel_b: FloatArray  # (B, 3) [m/s^2], b


@kernel
def measure_kernel(
    t: FloatArray, first: int, increment: FloatArray, M: FloatArray, knots: IntArray, bias: FloatArray,
    white: FloatArray, random_walk: FloatArray, lsb: float, resolution: float,
    motion_errors: FloatArray, limit: float, rest: FloatArray, out: FloatArray, valid: BoolArray,
) -> None:  # fmt: skip
    """Fill out (K, 3) from the increments (K, 3) that begin at row ``first`` of t (N,).

    ``bias`` (B, 3) is that at rows knots (B,) of t. ``random_walk`` (3,) is by axis. ``white`` and
    ``motion_errors`` (K, 3) have no rows if the triad has no such errors. The bias is linear between knots,
    so its value in the middle of a sample, times dt, is its integral. A rate beyond ``limit`` (0: no limit)
    is clipped and its row of ``valid`` cleared. ``rest`` (3,) is what rounding to ``lsb`` leaves for the next
    sample; what rounding of the rate to ``resolution`` leaves is lost.
    """
    noisy, moving = white.shape[0] > 0, motion_errors.shape[0] > 0
    j = 0
    for k in range(increment.shape[0]):
        row = first + k
        while knots[j + 1] <= row:
            j += 1
        begin, end = t[row], t[row + 1]
        dt = end - begin
        t0, t1 = t[knots[j]], t[knots[j + 1]]
        s = (0.5 * (begin + end) - t0) / (t1 - t0)
        x, y, z = increment[k, 0], increment[k, 1], increment[k, 2]
        root, most = np.sqrt(dt), limit * dt
        for i in range(3):
            drift = bias[j, i] + s * (bias[j + 1, i] - bias[j, i])
            error = M[i, 0] * x + M[i, 1] * y + M[i, 2] * z + drift * dt
            if noisy:
                error += random_walk[i] * root * white[k, i]
            if moving:
                error += motion_errors[k, i]
            value = increment[k, i] + error
            if limit > 0.0 and abs(value) > most:
                value = np.copysign(most, value)
                valid[k] = False
            if lsb > 0.0:
                wanted = value + rest[i]
                value = lsb * np.rint(wanted / lsb)
                rest[i] = wanted - value
            if resolution > 0.0:
                value = resolution * dt * np.rint(value / (resolution * dt))
            out[k, i] = value


def measure(truth: Trajectory, spec: ImuSpec, draws: SensorDraws) -> tuple[ImuData, ImuBias]:
    """Simulate an IMU over a piece of a flight; return its record and its biases.

    Parameters
    ----------
    truth : Trajectory
        The motion at N epochs, and the air for temperature and vibration.
    spec : ImuSpec
        The IMU; with all errors 0 the record equals the true increments.
    draws : SensorDraws
        The errors of the run, and what the IMU carries from the pieces before.

    Returns
    -------
    imu : ImuData
        N - 1 samples; a sample with a sensor beyond its range is not valid.
    bias : ImuBias
        Sum of turn-on bias and transient, bias instability, rate random walk and temperature bias, at 20 Hz.

    Raises
    ------
    ValueError
        If a figure requires another one that is missing, or a model is unknown.
    """
    draws = draws.part("imu")
    if wrong := draws.keep("checked", lambda: imu_terms.check_imu(spec)):
        raise ValueError("; ".join(wrong))
    t = truth.t
    dt = disk_arrays.empty(len(t) - 1)
    np.subtract(t[1:], t[:-1], out=dt)
    valid = np.ones(len(t) - 1, bool)
    responses = motion_response.respond(truth, spec, draws, valid)
    if spec.clock != SampleClockSpec():
        responses = motion_response.tag_responses(t, responses, spec.clock, draws.part("clock"))
    slow_rows = select_knots(t, BIAS_STEP)
    warmth = np.empty((0, 3))  # as `imu_terms.list_warmth` returns it
    if spec.warms:
        before = draws.keep("temperature", list[float])
        temperature = imu_terms.compute_temperature(truth, slow_rows, spec.thermal, before)
        warmth = imu_terms.list_warmth(temperature, spec.thermal, draws)
    measured, biases = [], []
    for part, response, triad in zip(("gyro", "accel"), responses, (spec.gyro, spec.accel), strict=True):
        increment, bias = _measure_triad(t, response, triad, slow_rows, warmth, draws.part(part), valid)
        measured.append(increment)
        biases.append(bias)
    if spec.accel_cone > 0:
        back: FloatArray = np.linalg.inv(imu_terms.cone_axes(spec.accel_cone)).astype(float)
        measured[1], biases[1] = (imu_terms.rotate_rows(back, rows) for rows in (measured[1], biases[1]))
    imu = ImuData(t=t[1:], dt=dt, valid=valid, dtheta_b=measured[0], dvel_b=measured[1])
    return imu, ImuBias(t[slow_rows], biases[0], biases[1])


def _measure_triad(
    t: FloatArray, response: motion_response.Response, spec: TriadSpec,
    slow_rows: IntArray, warmth: FloatArray, draws: SensorDraws, valid: BoolArray,
) -> tuple[FloatArray, FloatArray]:  # fmt: skip
    """Return the measured increments (N-1, 3) and the bias at ``slow_rows``; clear ``valid`` if clipped."""
    M = draws.keep("M", lambda: draw_matrix(spec, draws))
    knots, bias = draw_bias(t, spec, slow_rows, warmth, draws)
    increment, motion_errors = response
    out, rest = disk_arrays.empty(increment.shape), draws.keep("rest", lambda: np.zeros(3))
    noisy, interval = spec.random_walk > 0, float(t[1] - t[0])
    memory = np.empty((min(len(out), disk_arrays.ROWS) if noisy else 0, 3))
    random_walk = spec.by_axis("random_walk")
    for rows in disk_arrays.blocks(len(out)):
        white = memory[: len(out[rows])]
        if noisy:
            fill_noise(spec, interval, draws, white)
        measure_kernel(
            t, rows.start, increment[rows], M, knots, bias, white, random_walk,
            spec.quantization, spec.resolution, motion_errors[rows], spec.range, rest, out[rows], valid[rows],
        )  # fmt: skip
    return out, bias if knots is slow_rows else bias[slow_rows]  # else a knot is at every row


def draw_matrix(spec: TriadSpec, draws: SensorDraws) -> FloatArray:
    """Draw the matrix M (3, 3) of scale factors and misalignments."""
    M = np.zeros((3, 3))
    if spec.scale_factor_sd > 0:
        np.fill_diagonal(M, spec.by_axis("scale_factor_sd") * draws.constant("scale_factor", 3))
    if spec.misalignment_sd > 0:
        M[~np.eye(3, dtype=bool)] = spec.misalignment_sd * draws.constant("misalignment", 6)
    return M + imu_terms.draw_cross_axis(spec, draws)


def draw_bias(
    t: FloatArray, spec: TriadSpec, slow_rows: IntArray, warmth: FloatArray, draws: SensorDraws
) -> tuple[IntArray, FloatArray]:
    """Draw the bias of a triad; return rows of t that include ``slow_rows``, and the bias (B, 3) there.

    Rate random walk, temperature bias and transient are computed at ``slow_rows`` and interpolated to faster
    rows. Those at the first row of a further piece are the last of the piece before.
    """
    knots = slow_rows
    last = draws.keep("last", list[FloatArray])
    new = len(last) > 0  # rows that the piece before had, too
    stages = draws.keep("stages", lambda: choose_bias_stages(spec) if spec.bias_instability > 0 else None)
    if stages is not None and stages[0].min() < _FAST:
        knots = np.arange(len(t))
    bias = np.zeros((len(knots) - new, 3))
    if stages is not None:
        steps = _intervals(t[knots], new)
        bias = draws.markov("instability", steps, *stages)
        bias *= spec.by_axis("bias_instability") / spec.bias_instability
    if spec.turn_on_bias_sd > 0:
        bias += spec.by_axis("turn_on_bias_sd") * draws.constant("turn_on", 3)
    slow = np.zeros((len(slow_rows), 3))
    if spec.rate_random_walk > 0:
        root = np.sqrt(_intervals(t[slow_rows], new))[:, None]
        walk = root * draws.stream("rate_walk").standard_normal((len(root), 3))
        density, before = spec.by_axis("rate_random_walk"), last[1:2] if new else []
        slow[new:] = density * draws.accumulate("rate_walk", walk)
        slow[: len(before)] = before[0] if before else 0.0
        walked = slow[-1].copy()
    else:
        walked = np.zeros(3)
    for k, name in enumerate(("temperature", "temperature2", "hysteresis")):
        if getattr(spec, f"{name}_sd") > 0:
            slow += warmth[:, k, None] * (spec.by_axis(f"{name}_sd") * draws.constant(name, 3))
    if spec.transient_sd > 0:
        since = t[slow_rows, None] - draws.keep("switched on", lambda: float(t[0]))
        size = spec.by_axis("transient_sd") * draws.constant("transient", 3)
        slow += np.exp(-since / spec.transient_time) * size
    if spec.has_slow_terms:
        if len(knots) > len(slow_rows):
            for axis, column in enumerate(slow.T):
                bias[:, axis] += np.interp(t[knots[new:]], t[slow_rows], column)
        else:
            bias += slow[new:]
    if new:
        bias = np.concatenate([last[0][None], bias])
    last[:] = [bias[-1].copy(), walked]
    return knots, bias


def _intervals(t: FloatArray, new: bool) -> FloatArray:
    """Return the step to each epoch t (B,) [s]; 0 at the first epoch, which is left out unless ``new``."""
    return t[1:] - t[:-1] if new else np.diff(t, prepend=t[0])


def choose_bias_step(spec: TriadSpec, interval: float) -> float:
    """Return the interval between the epochs of the simulated biases of a triad [s]."""
    fast = spec.bias_instability > 0 and choose_bias_stages(spec)[0].min() < _FAST
    return interval if fast else max(1, round(BIAS_STEP / interval)) * interval


def select_knots(t: FloatArray, step: float) -> IntArray:
    """Return rows of t about ``step`` seconds apart, with the first and the last."""
    stride = max(1, round(step / (t[1] - t[0])))
    rows = np.arange(0, len(t) - 1 + stride, stride)
    rows[-1] = len(t) - 1
    return rows


# --- noise through the filter of the bandwidth -------------------------------------------------------------


class NoiseFilter(NamedTuple):
    """White noise of density 1 through the filter of the bandwidth, from sample to sample."""

    step: FloatArray  # (2, 2) transition of output and its rate over a sample
    root: FloatArray  # (3, 3) root of the covariance of what a sample adds to both, and of its white noise
    start: FloatArray  # (2,) standard deviations of output and its rate
    cutoff: float  # [rad/s]
    gain: float  # from a mean or value to white noise that has a variance of 1 at low frequencies


def make_noise_filter(cutoff: float, interval: float, *, averaged: bool) -> NoiseFilter:
    """Return the filter of the noise for a cutoff [rad/s] and a sampling interval [s].

    Notes
    -----
    The motion passes the same filter, ``y'' = w^2 (u - y) - sqrt(2) w y'``. Its discretization is exact:
    P = diag(w, w^3) / sqrt(8) is stationary, a sample adds P - step P step', and white noise W over a sample
    has the covariance (1 - step) (1, 0)' with it. A mean of a sample is W less what the filter still holds.
    The spectrum of the output is the sum of all aliases of the filtered noise. The aliases of a mean are 0 at
    zero frequency; the aliases of a sampled value raise its density there, and ``gain`` takes this back.

    Examples
    --------
    >>> wide = make_noise_filter(2 * np.pi * 1e4, 0.01, averaged=True)
    >>> print(wide.root.round(4)[2].dot(wide.root[2]).round(4))  # variance of W
    0.01
    """
    step = imu_terms.compute_oscillator_step(cutoff, float(np.sqrt(0.5)), interval)
    start = np.sqrt(np.array([cutoff, cutoff**3]) / np.sqrt(8.0))
    P = np.diag(start**2)
    added = np.full((3, 3), interval)
    added[:2, :2] = P - step @ P @ step.T
    added[2, :2] = added[:2, 2] = (np.eye(2) - step)[:, 0]
    size = np.sqrt(np.diag(added))
    values, vectors = np.linalg.eigh(added / np.outer(size, size))
    root = size[:, None] * vectors * np.sqrt(np.maximum(values, 0.0))
    gain = 1.0 / np.sqrt(interval)
    if not averaged:
        lagged = step @ np.linalg.inv(np.eye(2) - step) @ P  # sum of the covariances at all lags
        gain *= interval / np.sqrt(interval * (P + 2.0 * lagged)[0, 0])
    return NoiseFilter(step, root, start, cutoff, float(gain))


def fill_noise(spec: TriadSpec, interval: float, draws: SensorDraws, out: FloatArray) -> None:
    """Fill out (K, 3) with the noise of K samples over ``random_walk sqrt(interval)``."""
    stream = draws.stream("white")
    if spec.noise_shape == "white":
        stream.standard_normal(out=out)
        return
    averaged = spec.noise_shape == "averaged"
    cutoff = 2.0 * np.pi * spec.bandwidth
    shape = draws.keep("noise filter", lambda: make_noise_filter(cutoff, interval, averaged=averaged))
    state = draws.keep("noise", lambda: shape.start[:, None] * stream.standard_normal((2, 3)))
    drive = stream.standard_normal((len(out), 3, 3))
    shape_kernel(shape.step, shape.root, drive, shape.cutoff, shape.gain, averaged, state, out)


@kernel
def shape_kernel(
    step: FloatArray, root: FloatArray, drive: FloatArray, cutoff: float, gain: float, averaged: bool,
    state: FloatArray, out: FloatArray,
) -> None:  # fmt: skip
    """Fill out (K, 3) from unit noise ``drive`` (K, 3, 3); ``state`` (2, 3) is carried on."""
    for axis in range(3):
        y, dy = state[0, axis], state[1, axis]
        for k in range(out.shape[0]):
            a, b, c = drive[k, 0, axis], drive[k, 1, axis], drive[k, 2, axis]
            y0, dy0 = y, dy
            y = step[0, 0] * y0 + step[0, 1] * dy0 + root[0, 0] * a + root[0, 1] * b + root[0, 2] * c
            dy = step[1, 0] * y0 + step[1, 1] * dy0 + root[1, 0] * a + root[1, 1] * b + root[1, 2] * c
            if averaged:
                white = root[2, 0] * a + root[2, 1] * b + root[2, 2] * c
                out[k, axis] = gain * (white - ((dy - dy0) / cutoff + np.sqrt(2.0) * (y - y0)) / cutoff)
            else:
                out[k, axis] = gain * y
        state[0, axis], state[1, axis] = y, dy
