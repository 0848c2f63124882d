"""Search for the clock offset, the axes and the unit of an IMU with which its motion fits the receiver's.

The coarse offset comes first, since `clock_search` needs no axes; then all assignments of axes are tried at
the most likely offset, and the best of them at every offset that is left. What is found replaces the
recording as it is only if the likelihood of the whole recording rises by far.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from bench.core.mathematics.arrays import FloatArray, IntArray
from bench.core.mathematics.rotation import list_signed_axes
from bench.evaluation.motion.clock_search import find_offsets
from bench.evaluation.motion.motion_fit import (
    GYRO_GAIN,
    MOTION_NOISE,
    PRIOR_SD,
    SHIFT,
    TURN,
    MotionFit,
    Stretches,
    find_stretches,
    fit_motion,
)
from bench.evaluation.motion.recorded_motion import RecordedMotion

_STRETCHES = 6  # tried in the first round: those in which the velocity changes most
_KEPT = 4  # candidates of the first round that are fitted in full
_EVIDENCE = 30.0  # by which the logarithm of the likelihood must rise: residuals count as independent in it
_SHARE = 0.3  # of the change of the velocity: what is left of it must be smaller, or noise is explained
_RISE = 0.15  # by which it must rise for each residual: they fall by this share at least
_TURNS = (25.0, 0.5)  # rms rate in rms rates of the course beyond which the unit of the gyros is in doubt
_RATES = (1.0, 0.01)  # the same for the rms rate itself [rad/s]
_STEPS = (-0.6, -0.3, 0.3, 0.6)  # to either side of an offset: a gait fits near every step, too [s]
_ROUNDS = 4  # from step to step
_HELD = 1e-4  # sd of a parameter that is held at 0, in its unit
_DEGREE = np.pi / 180.0
FIT_WELL = 0.1
"""No other axes are tried if no segment has a larger residual [m/s]."""


@dataclass(frozen=True, slots=True)
class Hypothesis:
    """Changes to a recording: columns of the IMU times matrices, and an offset added to its times.

    ``down`` is -1 if the vertical velocity of the receiver is reversed.
    """

    gyro: FloatArray  # (3, 3) signed axes
    accel: FloatArray  # (3, 3) signed axes
    unit: float = 1.0  # factor of the gyros
    offset: float = 0.0  # [s]
    down: float = 1.0


AS_GIVEN = Hypothesis(np.eye(3), np.eye(3))


@dataclass(frozen=True, slots=True)
class Explained:
    """A hypothesis, the stretches it is compared on, and the fit of what is left."""

    hypothesis: Hypothesis
    stretches: Stretches
    fit: MotionFit

    @property
    def free(self) -> IntArray:
        """Number (W,) of independent residuals in each segment."""
        return np.asarray(3 * np.diff(self.stretches.begin) - 6)

    @property
    def cost(self) -> float:
        """Negative logarithm of the likelihood of a residual, with an unknown noise in every segment."""
        return float(0.5 * self.free @ np.log(self.fit.rms**2 + MOTION_NOISE**2) / self.free.sum())


def explain(
    motion: RecordedMotion,
    antenna_b: FloatArray,
    one: Hypothesis,
    stretches: Stretches | None = None,
    iterations: int = 20,
    prior_sd: FloatArray = PRIOR_SD,
    start: FloatArray | None = None,
) -> Explained | None:
    """Return the fit under a hypothesis, on all stretches or on those given; None without any."""
    imu_t = motion.t + one.offset
    stretches = _find(motion, one.offset, one.down) if stretches is None else stretches
    if not len(stretches):
        return None
    near = stretches.find_near(imu_t)
    gyro = one.unit * motion.gyro[near] @ one.gyro.T
    accel = motion.accel[near] @ one.accel.T
    fit = fit_motion(stretches, imu_t[near], gyro, accel, antenna_b, iterations, prior_sd, start)
    return Explained(one, stretches, fit)


def explain_held(
    motion: RecordedMotion, antenna_b: FloatArray, one: Explained, held: Sequence[int]
) -> Explained:
    """Return the fit under the same hypothesis with some parameters, by number, held at 0."""
    prior_sd = PRIOR_SD.copy()
    prior_sd[list(held)] = _HELD
    found = explain(motion, antenna_b, one.hypothesis, one.stretches, prior_sd=prior_sd)
    assert found is not None
    return found


def explain_as_given(motion: RecordedMotion, antenna_b: FloatArray) -> Explained | None:
    """Return the better of two fits of a recording as it is; None without stretches.

    Where little turns, the fit may end at a turn between the triads and a gain of the gyros that are not the
    best. So if it is poor it starts once more, from that without them.
    """
    free = explain(motion, antenna_b, AS_GIVEN)
    if free is None or free.fit.rms.max() < FIT_WELL:
        return free
    start = explain_held(motion, antenna_b, free, [GYRO_GAIN, *TURN]).fit.values
    again = explain(motion, antenna_b, AS_GIVEN, free.stretches, start=start)
    assert again is not None
    return min(free, again, key=lambda one: one.cost)


def _find(motion: RecordedMotion, offset: float, down: float) -> Stretches:
    t, lla, vel_n = motion.take_velocities()
    return find_stretches(motion.t + offset, t, lla, vel_n * [1.0, 1.0, down])


def list_axes() -> list[tuple[FloatArray, FloatArray]]:
    """Return the 96 assignments of axes that differ by more than a common rotation; the given one first."""
    return [(gyro, sign * np.eye(3)) for sign in (1.0, -1.0) for gyro in list_signed_axes()]


def list_units(motion: RecordedMotion) -> list[float]:
    """Return the factors that the unit of the gyros may need: the given one first, another if in doubt."""
    t, _, vel_n = motion.take_velocities()
    course = np.unwrap(np.arctan2(vel_n[:, 1], vel_n[:, 0]))
    speed = np.hypot(vel_n[:, 0], vel_n[:, 1])
    moves = np.minimum(speed[1:], speed[:-1]) > 0.3 * speed.max()
    turn = float(np.sqrt(np.mean(np.square(np.diff(course) / np.diff(t))[moves])))
    rate = float(np.sqrt(np.mean(np.square(motion.gyro - motion.gyro.mean(axis=0)).sum(axis=1))))
    found = [1.0]
    if rate > min(_TURNS[0] * turn, _RATES[0]):
        found.append(_DEGREE)
    if rate < max(_TURNS[1] * turn, _RATES[1]):
        found.append(1.0 / _DEGREE)
    return found


def search(motion: RecordedMotion, antenna_b: FloatArray, plain: Explained) -> Explained:
    """Return the hypothesis that fits best; as given unless another fits far better."""
    offsets = find_offsets(motion) or [0.0]
    firsts = [0.0] if min(map(abs, offsets)) <= 1.0 else []
    firsts += [one for one in offsets if abs(one) > 1.0][:1]
    rough = [
        Hypothesis(gyro, accel, unit, first, down)
        for first in firsts
        for unit in list_units(motion)
        for gyro, accel in list_axes()
        for down in (1.0, -1.0)
    ]
    few = {
        (first, down): _find(motion, first, down).take_liveliest(_STRETCHES)
        for first in firsts
        for down in (1.0, -1.0)
    }
    tried = [explain(motion, antenna_b, one, few[one.offset, one.down], 1) for one in rough]
    ranked = sorted((one for one in tried if one is not None), key=lambda one: one.cost)
    best = plain
    moved = float(
        np.sqrt(
            np.mean([np.var(plain.stretches.vel_n[rows], axis=0).sum() for rows in plain.stretches.slices])
        )
    )
    enough = max(_RISE, _EVIDENCE / float(plain.free.sum()))

    def choose(best: Explained, one: Hypothesis) -> Explained:
        found = explain(motion, antenna_b, one)
        if found is None or found.cost >= min(best.cost, plain.cost - enough):
            return best
        return found if float(np.sqrt(np.mean(found.fit.rms**2))) < _SHARE * moved else best

    for one in ranked[:_KEPT]:
        for offset in sorted({*firsts, *offsets}):
            best = choose(best, replace(one.hypothesis, offset=offset))
    for _ in range(_ROUNDS):
        before, h = best, best.hypothesis
        near = h.offset + float(best.fit.values[SHIFT])
        for away in _STEPS:
            for down in (1.0, -1.0):
                best = choose(best, replace(h, offset=near + away, down=down))
        if best is before:
            break
    return best
