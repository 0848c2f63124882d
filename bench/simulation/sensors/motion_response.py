"""Response of the triads of an IMU to the motion, before noise and biases: at its output rate or inside it.

An IMU with an inner rate samples vibration in equal parts of its output interval; beside rotors, vibration by
the engine and by gusts is spread evenly over the parts. Positions of the accelerometers, delay, bandwidth,
dead zone, errors that follow the motion and the range act on each part; the output is the sum, without a
coning or sculling correction. White noise, biases and M act on the sum, and so does quantization: its
remainder is carried, so it makes no difference. An imperfect clock tags the sums.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from bench.core.compilation.compiled import kernel
from bench.core.files import disk_arrays
from bench.core.mathematics.arrays import BoolArray, FloatArray
from bench.core.records.data import Trajectory
from bench.core.records.sensor_specs import ImuSpec, SampleClockSpec, TriadSpec
from bench.core.words.exceptions import ConfigError
from bench.simulation.sensors import imu_terms, vibration
from bench.simulation.sensors.draws import SensorDraws
from bench.simulation.sensors.rotor_vibration import RotorTones

_PARTS = 1 << 14  # parts of samples that are made at a time


class Response(NamedTuple):
    """Increments of a triad, and its errors that follow the motion."""

    increment: FloatArray  # (K, 3) [unit], along the axes of the sensors
    errors: FloatArray  # (K, 3) [unit]; no rows if there are none


def respond(
    truth: Trajectory, spec: ImuSpec, draws: SensorDraws, valid: BoolArray
) -> tuple[Response, Response]:
    """Return what gyros and accelerometers make of the motion and the vibration of a piece.

    Parameters
    ----------
    truth : Trajectory
        The motion at N epochs, air and rotors.
    spec : ImuSpec
        The IMU.
    draws : SensorDraws
        The errors of the IMU in this run.
    valid : (N - 1,) array
        Cleared for samples of which a part is beyond the range.

    Raises
    ------
    ConfigError
        If there are no rotors, or the inner rate is not a multiple of the output rate.
    """
    part, shaken = draws.part("vibration"), spec.vibration
    if not ((shaken.by_rotors or shaken.by_engine) and shaken.inner_rate):
        return _respond(truth.t, *vibration.shake(truth, shaken, part), spec, draws)
    if shaken.by_rotors:
        dtheta_b, dvel_b = vibration.shake_by_engine(truth, shaken, part)
        tones = RotorTones(truth, shaken, part)
    else:
        dtheta_b, dvel_b = truth.dtheta_b, truth.dvel_b
        gusts = vibration.find_gusts(truth.air, shaken, part)
    count = part.keep("parts", lambda: count_parts(truth.t[1] - truth.t[0], spec.vibration.inner_rate))
    share = np.arange(count) / count
    found = [disk_arrays.empty(dtheta_b.shape) for _ in range(2)]
    errors: list[FloatArray] = []
    width = max(1, _PARTS // count)
    for first in range(0, len(dtheta_b), width):
        rows = slice(first, min(first + width, len(dtheta_b)))
        ends = truth.t[rows.start : rows.stop + 1]
        t = np.append((ends[:-1, None] + np.diff(ends)[:, None] * share).ravel(), ends[-1])
        if shaken.by_rotors:
            moved = tones.add(rows, dtheta_b[rows], dvel_b[rows], count)
        else:
            turned, pushed = (np.repeat(true[rows] / count, count, axis=0) for true in (dtheta_b, dvel_b))
            moved = vibration.shake_parts(t, turned, pushed, truth.air, gusts, shaken, part)
        responses = _respond(t, *moved, spec, draws)
        if not errors:
            errors = [disk_arrays.empty(dtheta_b.shape if len(one.errors) else (0, 3)) for one in responses]
        for triad, response, out, wrong in zip(
            (spec.gyro, spec.accel), responses, found, errors, strict=True
        ):
            sum_kernel(t, *response, count, triad.range, out[rows], wrong[rows], valid[rows])
    return Response(found[0], errors[0]), Response(found[1], errors[1])


def count_parts(interval: float, inner_rate: float) -> int:
    """Return the parts of an output interval [s] at an inner rate [Hz].

    Raises
    ------
    ConfigError
        If the inner rate is not a multiple of the output rate.

    Examples
    --------
    >>> count_parts(0.005, 4000.0)
    20
    """
    count = round(interval * inner_rate)
    if count < 1 or abs(count / interval - inner_rate) > 1e-6 * inner_rate:
        raise ConfigError(
            f"[vibration] inner_rate_hz = {inner_rate:g} Hz must be a multiple of the output rate, "
            f"{1.0 / interval:g} Hz"
        )
    return count


def _respond(
    t: FloatArray, dtheta_b: FloatArray, dvel_b: FloatArray, spec: ImuSpec, draws: SensorDraws
) -> tuple[Response, Response]:
    """Return the responses to increments (K, 3) between the epochs t (K + 1,)."""
    force = dvel_b
    if spec.accel_cone > 0 or spec.accel_arms:
        N = imu_terms.cone_axes(spec.accel_cone) if spec.accel_cone > 0 else np.eye(3)
        arms = np.array(spec.accel_arms) if spec.accel_arms else None
        force = imu_terms.resolve_along_axes(dtheta_b, dvel_b, t[1:] - t[:-1], arms, N, draws)

    def find(motion: FloatArray, triad: TriadSpec, part: SensorDraws) -> Response:
        increment = imu_terms.apply_response(t, motion, triad, part)
        return Response(increment, imu_terms.draw_motion_errors(t, increment, dvel_b, triad, part))

    return find(dtheta_b, spec.gyro, draws.part("gyro")), find(force, spec.accel, draws.part("accel"))


@kernel
def sum_kernel(
    t: FloatArray, increment: FloatArray, error: FloatArray, count: int, limit: float,
    out: FloatArray, wrong: FloatArray, valid: BoolArray,
) -> None:  # fmt: skip
    """Fill out and wrong (K, 3) with sums of ``count`` increments and errors (K count, 3) at times t.

    Where both together are a rate beyond ``limit`` (0: no limit), the increment is clipped and the row of
    ``valid`` cleared.
    """
    moving = error.shape[0] > 0
    for k in range(out.shape[0]):
        for i in range(3):
            out[k, i] = 0.0
            if moving:
                wrong[k, i] = 0.0
        for row in range(k * count, (k + 1) * count):
            most = limit * (t[row + 1] - t[row])
            for i in range(3):
                follows = error[row, i] if moving else 0.0
                value = increment[row, i] + follows
                if limit > 0.0 and abs(value) > most:
                    value = np.copysign(most, value)
                    valid[k] = False
                out[k, i] += value - follows
                if moving:
                    wrong[k, i] += follows


# --- clock --------------------------------------------------------------------------------------------------


def tag_responses(
    t: FloatArray, responses: Sequence[Response], spec: SampleClockSpec, draws: SensorDraws
) -> tuple[Response, Response]:
    """Return the responses (K, 3) of both triads as the clock of the IMU tags them, see `tag_samples`."""
    parts = [part for response in responses for part in response if len(part)]
    tagged = tag_samples(t, np.hstack(parts), spec, draws)
    columns = iter(np.hsplit(tagged, len(parts)))
    found = [[np.ascontiguousarray(next(columns)) if len(part) else part for part in r] for r in responses]
    return Response(*found[0]), Response(*found[1])


def tag_samples(t: FloatArray, columns: FloatArray, spec: SampleClockSpec, draws: SensorDraws) -> FloatArray:
    """Return the increments (K, n) of samples that an imperfect clock tags with t (K + 1,).

    Parameters
    ----------
    t : (K + 1,) array
        Time tags at the ends of the samples [s].
    columns : (K, n) array
        Increments over the intervals between them.
    spec : SampleClockSpec
        The clock: a sample tagged t was taken at ``t - drift (t - t_0) - jitter``.
    draws : SensorDraws
        Has the stream "jitter", and the increments that later samples need.

    Returns
    -------
    tagged : (K, n) array
        Mean rate between two samples times the interval between their tags, as of a unit that measures rates.

    Raises
    ------
    ValueError
        If the samples differ in length, or the jitter is above 0.9 of it: samples would change their order.
    """
    interval = draws.keep("interval", lambda: float(t[1] - t[0]))
    if imu_terms.find_largest_deviation(t, interval) > 1e-6 * interval:
        raise ValueError("[clock] needs samples of equal length")
    if spec.jitter > 0.9 * interval:
        raise ValueError(
            f"[clock] jitter_us = {1e6 * spec.jitter:g} us must be at most 0.9 of the sampling interval, "
            f"{1e6 * interval:g} us"
        )
    begin = draws.keep("begin", lambda: float(t[0]))
    ends, before = draws.keep("held", lambda: (t[:1], columns[:0]))
    late = spec.drift * (t[1:] - begin)
    if spec.jitter > 0:
        late = late + spec.jitter * draws.stream("jitter").random(len(late))
    taken = np.concatenate([draws.keep("taken", lambda: t[:1].copy()), t[1:] - late])
    ends, rows = np.concatenate([ends, t[1:]]), np.concatenate([before, columns])
    out = disk_arrays.empty(columns.shape)
    tag_kernel(ends, rows, taken, t, out)
    kept = max(0, int(np.searchsorted(ends, taken[-1], side="right")) - 2)
    draws.put("held", (ends[kept:].copy(), rows[kept:].copy()))
    draws.put("taken", taken[-1:].copy())
    return out


@kernel
def tag_kernel(t: FloatArray, rows: FloatArray, taken: FloatArray, tags: FloatArray, out: FloatArray) -> None:
    """Fill out (K, n) from rows (H, n) between t (H + 1,), for samples taken and tagged at (K + 1,) times.

    Within a row the rate is linear, so that this row and the one before have their increments.
    """
    j = 0
    for k in range(out.shape[0]):
        while t[j + 1] <= taken[k]:
            j += 1
        last = j
        while t[last + 1] < taken[k + 1]:
            last += 1
        scale = (tags[k + 1] - tags[k]) / (taken[k + 1] - taken[k])
        begin = (taken[k] - t[j]) / (t[j + 1] - t[j])
        end = (taken[k + 1] - t[last]) / (t[last + 1] - t[last])
        for i in range(out.shape[1]):
            before, after = rows[max(j - 1, 0), i], rows[max(last - 1, 0), i]
            total = end * rows[last, i] - 0.5 * end * (1.0 - end) * (rows[last, i] - after)
            total -= begin * rows[j, i] - 0.5 * begin * (1.0 - begin) * (rows[j, i] - before)
            for row in range(j, last):
                total += rows[row, i]
            out[k, i] = scale * total
