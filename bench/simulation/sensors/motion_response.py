"""Response of the triads of an IMU to the motion, before noise and biases: at its output rate or inside it.

An IMU with an inner rate samples vibration by rotors in equal parts of its output interval. Positions of the
accelerometers, delay, bandwidth, dead zone, errors that follow the motion and the range act on each part; the
output is the sum, without a coning or sculling correction. White noise, biases and M act on the sum, and so
does quantization: its remainder is carried, so it makes no difference.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from bench.core.compilation.compiled import kernel
from bench.core.files import disk_arrays
from bench.core.mathematics.arrays import BoolArray, FloatArray
from bench.core.records.data import Trajectory
from bench.core.records.sensor_specs import ImuSpec, TriadSpec
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
    part = draws.part("vibration")
    if not (spec.vibration.by_rotors and spec.vibration.inner_rate):
        return _respond(truth.t, *vibration.shake(truth, spec.vibration, part), spec, draws)
    dtheta_b, dvel_b = vibration.shake_by_engine(truth, spec.vibration, part)
    tones = RotorTones(truth, spec.vibration, part)
    count = part.keep("parts", lambda: count_parts(truth.t[1] - truth.t[0], spec.vibration.inner_rate))
    share = np.arange(count) / count
    found = [disk_arrays.empty(dtheta_b.shape) for _ in range(2)]
    errors: list[FloatArray] = []
    width = max(1, _PARTS // count)
    for first in range(0, len(dtheta_b), width):
        rows = slice(first, min(first + width, len(dtheta_b)))
        ends = truth.t[rows.start : rows.stop + 1]
        t = np.append((ends[:-1, None] + np.diff(ends)[:, None] * share).ravel(), ends[-1])
        responses = _respond(t, *tones.add(rows, dtheta_b[rows], dvel_b[rows], count), spec, draws)
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
