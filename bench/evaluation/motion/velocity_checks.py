"""Compare the velocities of a receiver with its own positions: axes, unit, and the time they belong to."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.interpolate import Akima1DInterpolator

from bench.core.mathematics.arrays import FloatArray, IntArray
from bench.core.mathematics.earth import matrix_en, to_ecef
from bench.evaluation.motion.motion_checks import SHIFT_OFF, SIGMAS
from bench.evaluation.motion.recorded_motion import Check, RecordedMotion
from bench.evaluation.motion.velocity_frame import UNITS, find_frame

GAIN_OFF = 0.2
"""Allowed relative difference of heights and velocities by two instruments [1]."""
_MOVED, _SLOWEST = 8.0, 0.5  # a velocity is compared if its rms exceeds its noise this much, and [m/s]
_SHORT = 0.6  # over which the rates of positions and velocities are compared in time, at least two fixes [s]
_SPAN = 1.0  # over which velocities are compared with positions [s]
_SEARCH = 1.0  # largest time shift that is tried, either way [s]
_ROUGH, _STEP = 0.02, 0.01  # half a step of the first search, and a step of the second [s]
_LAGS = 12  # fixes over which the residuals of differences are correlated
_BLOCKS = 12  # of a record, whose sums count as independent
_FEWEST = 20  # smallest number of fixes for a correlation


def check_velocity(motion: RecordedMotion) -> tuple[list[Check], RecordedMotion]:
    """Compare the velocity of the receiver with its positions: late, in another unit, or with other axes.

    Returns the checks, and the motion with the velocity that fits its positions.
    """
    good = np.asarray(np.isfinite(motion.vel_n).all(axis=1))
    if 2 * good.sum() < len(good) or good.sum() < _FEWEST + 2:
        text = "gnss: no velocity; its positions alone are compared with the IMU"
        return [Check("velocity_shift_s", None, text, True)], motion
    t, lla, vel_n = motion.fix_t[good], motion.lla[good], motion.vel_n[good]
    usual = float(np.median(np.diff(t)))
    found = []
    many = max(2, round(_SPAN / usual))
    first = np.flatnonzero(t[many:] - t[:-many] < 1.25 * many * usual)
    if len(first) >= _FEWEST:
        frame = find_frame(*_compare(t, lla, vel_n, first, many))
        if frame.text:
            vel_n = vel_n @ frame.matrix.T
            motion = replace(motion, vel_n=motion.vel_n @ frame.matrix.T)
            found.append(Check("velocity_axes", None, frame.text, False, {"gnss.velocity": frame.matrix}))
        pairs = np.flatnonzero(t[2:] - t[:-2] < 2.5 * usual)
        found += check_ratios(*_compare(t, lla, vel_n, pairs, 2))
    step = max(2, round(_SHORT / usual))
    middle = np.flatnonzero(t[step:] - t[:-step] < (step + 0.5) * usual)
    if len(middle) < _FEWEST:
        text = "gnss: too few velocities in a row to compare them with its positions"
        return [*found, Check("velocity_shift_s", None, text, True)], motion
    path, velocity = _make_paths(t, lla, vel_n)
    early, late = t[middle], t[middle + step]
    seen = (path[middle + step] - path[middle]) / (late - early)[:, None]
    shift, sd = fit_shift(t, velocity, early, late, seen)
    text = f"gnss: its velocity fits its positions with {shift:+.3f} s added to its time (sd {sd:.3f} s)"
    bad = abs(shift) > max(SHIFT_OFF, SIGMAS * sd)
    if not np.isfinite(shift) or (not bad and sd > SHIFT_OFF):
        text = "gnss: the motion does not show whether its velocities are on time"
        left, late_sd = (shift, sd) if np.isfinite(shift) and np.isfinite(sd) else (0.0, np.inf)
        motion = replace(motion, velocity_shift_left=left, velocity_shift_sd=late_sd)
        return [*found, Check("velocity_shift_s", None, text, True)], motion
    text += f": add {shift:+.3f} to [gnss] velocity_offset_s" if bad else ""
    advice = {"gnss.velocity_offset_s": shift} if bad else {}
    found.append(Check("velocity_shift_s", shift, text, not bad, advice))
    taken, left = (shift, 0.0) if bad else (0.0, shift)
    return found, replace(motion, velocity_shift=taken, velocity_shift_left=left, velocity_shift_sd=sd)


def _make_paths(t: FloatArray, lla: FloatArray, vel_n: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return positions and integrated velocities (M, 3), e [m]."""
    velocity = np.einsum("kij,kj->ki", matrix_en(lla[:, 0], lla[:, 1]), vel_n)
    between = 0.5 * (velocity[1:] + velocity[:-1]) * np.diff(t)[:, None]
    return to_ecef(lla), np.concatenate([np.zeros((1, 3)), np.cumsum(between, axis=0)])


def _compare(
    t: FloatArray, lla: FloatArray, vel_n: FloatArray, first: IntArray, many: int
) -> tuple[FloatArray, FloatArray]:
    """Return mean velocities (K, 3) over ``many`` intervals by positions and by velocities, n [m/s]."""
    span = (t[first + many] - t[first])[:, None]
    turned = np.swapaxes(matrix_en(lla[first, 0], lla[first, 1]), 1, 2)
    path = to_ecef(lla)
    by_position = np.einsum("kij,kj->ki", turned, path[first + many] - path[first]) / span
    between = 0.5 * (vel_n[1:] + vel_n[:-1]) * np.diff(t)[:, None]
    traveled = np.concatenate([np.zeros((1, 3)), np.cumsum(between, axis=0)])
    return by_position, (traveled[first + many] - traveled[first]) / span


def check_ratios(by_position: FloatArray, by_velocity: FloatArray) -> list[Check]:
    """Compare the size of mean velocities (M, 3) with the positions, axis by axis."""
    found = []
    for axis, reference, value in zip(("north", "east", "down"), by_position.T, by_velocity.T, strict=True):
        jitter = float(np.std(np.diff(value, 2))) / np.sqrt(6.0)  # its noise, if it is white
        if float(np.sqrt(np.mean(value**2))) < max(_MOVED * jitter, _SLOWEST):
            continue
        ratio, sd = fit_ratio(value, reference)
        other = 1.0 / fit_ratio(reference, value)[0]  # by noise of the velocity a ratio is small, this large
        low, high = sorted((ratio - 1.0, other - 1.0))
        if low <= 0.0 <= high or min(abs(low), abs(high)) <= max(GAIN_OFF, SIGMAS * sd):
            continue
        off, unit = min((abs(ratio * factor - 1.0), unit) for unit, factor in UNITS.items())
        guess = f"are these {unit}?" if off < 0.1 else "the unit or a sign looks wrong"
        text = f"gnss: {axis}, its positions move {ratio:.3f} of its velocity: {guess}"
        found.append(Check(f"velocity_ratio_{axis}", ratio, text, False))
    return found


def fit_ratio(x: FloatArray, y: FloatArray) -> tuple[float, float]:
    """Return the ratio of y to x (N,) and its standard deviation, with residuals that are correlated."""
    power = float(x @ x)
    if power == 0.0:
        return 1.0, np.inf
    ratio = float(x @ y) / power
    return ratio, float(np.sqrt(variance_of_sum(x * (y - ratio * x)))) / power


def mean_rate(t: FloatArray, integral: FloatArray, early: FloatArray, late: FloatArray) -> FloatArray:
    """Return the mean rates (M, k) between epochs (M,) of integrals (N, k), less their average.

    Between the rows the integrals are smooth: straight lines would favor shifts of half a row.
    """
    smooth = Akima1DInterpolator(t, integral)
    rates = (smooth(np.clip(late, t[0], t[-1])) - smooth(np.clip(early, t[0], t[-1]))) / (late - early)[
        :, None
    ]
    return np.asarray(rates - rates.mean(axis=0))


def fit_shift(
    t: FloatArray, integral: FloatArray, early: FloatArray, late: FloatArray, seen: FloatArray
) -> tuple[float, float]:
    """Return the time to add to t that fits the reference rates [s], and its standard deviation.

    The shift maximizes the correlation between the mean rates of the integral from ``early`` to ``late`` and
    the reference ``seen``. Its standard deviation is that of a linear least squares fit with correlated
    residuals: neighboring central differences share half their time.
    """
    inside = (early > t[0] + _SEARCH) & (late < t[-1] - _SEARCH)
    early, late, seen = early[inside], late[inside], seen[inside]
    if len(seen) < _FEWEST:
        return np.nan, np.nan
    seen = seen - seen.mean(axis=0)

    def rate(shift: float) -> FloatArray:
        return mean_rate(t, integral, early - shift, late - shift)

    def score(shifts: FloatArray) -> FloatArray:
        return np.abs([np.vdot(own, seen) / np.linalg.norm(own) for own in map(rate, shifts)])

    rough = np.arange(-_SEARCH, _SEARCH + _ROUGH, 2 * _ROUGH)
    middle = float(rough[np.argmax(score(rough))])
    shifts = np.arange(middle - 2 * _ROUGH, middle + 2 * _ROUGH + 0.5 * _STEP, _STEP)
    scores = score(shifts)
    k = int(np.clip(np.argmax(scores), 1, len(shifts) - 2))
    a, b, c = scores[k - 1 : k + 2]
    bend = a - 2 * b + c
    best = float(shifts[k] + (0.5 * _STEP * (a - c) / bend if bend < 0 else 0.0))
    own = rate(best)
    slope = (rate(best - _STEP) - rate(best + _STEP)) / (2 * _STEP)
    product = float(np.vdot(own, seen))
    if not product * product > 0.0:  # nothing moves
        return np.nan, np.nan
    gain, inverse = product / float(np.vdot(seen, seen)), product / float(np.vdot(own, own))
    noises = own - gain * seen, own - seen / inverse  # either may be the noisy one
    pulls = [np.sum(slope * noise, axis=1) for noise in noises]
    return best, float(np.sqrt(max(map(variance_of_sum, pulls))) / np.vdot(slope, slope))


def variance_of_sum(values: FloatArray) -> float:
    """Return the variance (above 0) of the sum of values that are correlated, over a few rows or longer.

    The larger of two estimates: by products of rows up to `_LAGS` apart, and by the sums of `_BLOCKS` blocks.
    """
    products = [np.dot(values[lag:], values[:-lag]) for lag in range(1, min(_LAGS, len(values) - 1) + 1)]
    alone = float(np.dot(values, values))
    near = alone + 2.0 * float(np.sum(products))
    sums = np.array([block.sum() for block in np.array_split(values, _BLOCKS)])
    far = float(sums @ sums) * _BLOCKS / (_BLOCKS - 1) if len(values) >= 2 * _BLOCKS else 0.0
    return max(near, far, 0.01 * alone)
