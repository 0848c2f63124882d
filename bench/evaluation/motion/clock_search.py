"""Coarse offset between the clocks of IMU and receiver, found without knowing the axes of the IMU.

Neither the size of the specific force nor the size of the angular rate depends on the axes, signs or
handedness of the triads. They are compared with the size of the acceleration less gravity and with the rate
of turn of the course, both by the velocities of the receiver, at every offset up to `FARTHEST`: over half a
second and, where a gait repeats itself, over some seconds. Each comparison counts by the logarithm of the
likelihood of its correlation.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from bench.core.mathematics.arrays import FloatArray
from bench.core.mathematics.earth import gravity_n
from bench.evaluation.motion.recorded_motion import RecordedMotion

FARTHEST = 31.0
"""Largest offset that is tried, either way [s]: more than the leap seconds between UTC and GPS time."""
_STEP = 0.1  # of the offsets [s]
_SPANS = (0.5, 3.0)  # over which both are averaged: with and without the steps of a gait [s]
_SLOWEST = 1.5  # ground speed from which a course counts [m/s]
_FEWEST = 20  # intervals in a comparison
_ROWS = 6000  # intervals of a long recording, evenly spaced
_CLOSE = 12.0  # an offset counts if its logarithm of the likelihood is this close to the best
_MOST = 4  # offsets that are returned, to one second and beyond


def find_offsets(motion: RecordedMotion) -> list[float]:
    """Return offsets to add to the times of the IMU that fit best [s], the most likely first.

    Offsets beyond one second are among them only if they fit better than any within.
    """
    step = np.diff(motion.t, prepend=2 * motion.t[0] - motion.t[min(1, len(motion.t) - 1)])[:, None]
    sums = [np.cumsum(rates * step, axis=0) for rates in (motion.accel, motion.gyro)]
    offsets = np.asarray(_STEP * np.arange(-round(FARTHEST / _STEP), round(FARTHEST / _STEP) + 1))
    weighed = [_weigh(motion, sums, span, offsets) for span in _SPANS]
    gains = np.sum([one for one in weighed if one is not None] or [offsets[:0]], axis=0)
    inner = np.flatnonzero((gains[1:-1] >= gains[:-2]) & (gains[1:-1] > gains[2:])) + 1
    peaks = inner[np.argsort(-gains[inner], kind="stable")]
    close = [k for k in peaks if gains[k] > gains[peaks[0]] - _CLOSE]
    near = [k for k in close if abs(offsets[k]) <= 1.0]
    far = [k for k in close if abs(offsets[k]) > 1.0] if close and close[0] not in near else []
    return [float(offsets[k]) for k in near[:_MOST] + far[:_MOST]]


def _weigh(
    motion: RecordedMotion, sums: Sequence[FloatArray], span: float, offsets: FloatArray
) -> FloatArray | None:
    """Return the logarithm of the likelihood (K,) of each offset, by means over ``span`` [s].

    ``sums`` are the integrals (N, 3) of specific force and angular rate. None if no fixes are so far apart.
    """
    t, lla, vel_n = motion.take_velocities()
    usual = float(np.median(np.diff(t)))
    many = max(1, round(span / usual))
    early = np.arange(len(t) - many)
    early = early[t[early + many] - t[early] < 1.5 * many * usual]
    if not len(early):
        return None
    stride = -(-len(early) // _ROWS)
    early, shared = early[::stride], max(many / stride, 1.0)
    late = early + many
    lasts = t[late] - t[early]
    force = (vel_n[late] - vel_n[early]) / lasts[:, None] - gravity_n(lla[early, 0], lla[early, 2])
    a, b = vel_n[early], vel_n[late]
    course = np.arctan2(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0], np.sum(a[:, :2] * b[:, :2], axis=1))
    moves = np.minimum(np.hypot(*a[:, :2].T), np.hypot(*b[:, :2].T)) > _SLOWEST
    seen = [
        (np.linalg.norm(force, axis=1), np.ones(len(lasts), np.bool_)),
        (np.abs(course) / lasts, moves),
    ]

    def weigh(offset: float) -> float:
        begin, end = t[early] - offset, t[late] - offset
        inside = (begin >= motion.t[0]) & (end <= motion.t[-1])
        gain = 0.0
        for integral, (size, counts) in zip(sums, seen, strict=True):
            use = inside & counts
            if use.sum() < _FEWEST:
                continue
            own = np.linalg.norm(
                [np.interp(end[use], motion.t, x) - np.interp(begin[use], motion.t, x) for x in integral.T],
                axis=0,
            )
            gain -= 0.5 * use.sum() / shared * np.log1p(-(_correlate(own / lasts[use], size[use]) ** 2))
        return float(gain)

    return np.array([weigh(one) for one in offsets])


def _correlate(x: FloatArray, y: FloatArray) -> float:
    """Return the correlation of two series, 0 if it is negative or one does not vary."""
    x, y = x - x.mean(), y - y.mean()
    power = float(x @ x) * float(y @ y)
    return min(max(float(x @ y) / np.sqrt(power), 0.0), 0.999999) if power > 0 else 0.0
