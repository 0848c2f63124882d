"""A solution resampled at other epochs.

Between rows of a file, position is a cubic with the velocities at both ends (linear without velocities);
velocity, biases and covariance are linear; attitude turns at a constant rate. There is no solution before the
first row, after the last row, and in a gap. The rows of a program that runs are carried on instead: what lies
between two of them must not follow from the later one.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bench.core.mathematics import earth, rotation
from bench.core.mathematics.arrays import BoolArray, FloatArray, IntArray
from bench.core.mathematics.units import SAME_INSTANT
from bench.core.records.data import Events, NavSolution, no_innovations
from bench.evaluation.errors.error_series import NOT_COVERED
from bench.evaluation.errors.failures import FAILED
from bench.evaluation.metrics.coverage import carry_positions

INTERPOLATED, CARRIED = "interpolated", "carried_on"
"""Kinds of events: epochs between rows, and what is taken there."""

_SLOWER = 1.5  # intervals of the epochs between two rows of a table that has a rate of its own [1]
_GAPS, _LONGEST = 2.0, 2.0  # longest interpolated interval: median intervals, and [s]


@dataclass(frozen=True, slots=True)
class ForeignSolution:
    """A solution as read from a file; a block that the file does not have is NaN."""

    shown: str
    rows: IntArray  # (N,) number of each row in the file, from 1
    t: FloatArray  # (N,) [s]
    lla: FloatArray  # (N, 3) [rad, rad, m]
    vel_n: FloatArray  # (N, 3) [m/s]
    q_nb: FloatArray  # (N, 4)
    gyro_bias_b: FloatArray  # (N, 3) [rad/s]
    accel_bias_b: FloatArray  # (N, 3) [m/s^2]
    cov: FloatArray | None  # (N, 9, 9); None if the file has none
    remarks: tuple[str, ...]
    clock: str = ""  # that its times count, if the format defines it
    placed: bool = True  # false if its positions are in a local frame whose place is unknown

    def __len__(self) -> int:
        return len(self.t)


def resample(solution: ForeignSolution, t: FloatArray, longest: float | None = None) -> NavSolution:
    """Return a solution at other times, without extrapolation.

    Parameters
    ----------
    solution : ForeignSolution
        The solution as read.
    t : (M,) array
        Output times [s].
    longest : float or None
        Longest interval between rows that is interpolated [s]; default twice the median, at most 2 s.

    Returns
    -------
    solution : NavSolution
        NaN at times that it does not cover, which events of kind "not_covered" list; an event of kind
        "failed" if it covers none.
    """
    most = _choose_longest(solution, longest)
    before = np.searchsorted(solution.t, t + SAME_INSTANT, "right") - 1  # the last row not after t
    inside = before >= 0
    before = np.maximum(before, 0)
    after = np.minimum(before + 1, len(solution) - 1)
    on_row = inside & (np.abs(t - solution.t[before]) <= SAME_INSTANT)
    width = solution.t[after] - solution.t[before]
    covered = on_row | (inside & (after > before) & (width <= most + SAME_INSTANT))
    s = np.where(on_row | (width <= 0), 0.0, (t - solution.t[before]) / np.where(width > 0, width, 1.0))[
        :, None
    ]

    def interpolate(values: FloatArray) -> FloatArray:
        weight = s.reshape((-1,) + (1,) * (values.ndim - 1))
        between: FloatArray = values[before] + weight * (values[after] - values[before])
        return _blank_uncovered(np.where(weight > 0, between, values[before]), covered)

    q_0, q_1 = solution.q_nb[before], solution.q_nb[after]
    turn = rotation.to_rotvec(rotation.multiply(rotation.conjugate(q_0), q_1))
    q_nb = np.where(s > 0, rotation.multiply(q_0, rotation.from_rotvec(s * turn)), q_0)
    cov = np.full((len(t), 9, 9), np.nan) if solution.cov is None else interpolate(solution.cov)
    return NavSolution(
        t=t,
        lla=_blank_uncovered(_interpolate_position(solution, before, after, s, width), covered),
        vel_n=interpolate(solution.vel_n),
        q_nb=_blank_uncovered(q_nb, covered),
        gyro_bias_b=interpolate(solution.gyro_bias_b),
        accel_bias_b=interpolate(solution.accel_bias_b),
        cov=cov,
        extra_names=(),
        extra=np.empty((len(t), 0)),
        extra_sd=np.empty((len(t), 0)),
        innovations=no_innovations(),
        events=_list_events(solution, t, covered, np.where(on_row, 0.0, width), most, INTERPOLATED),
    )


def _choose_longest(solution: ForeignSolution, longest: float | None) -> float:
    """Return the longest interval that is bridged [s]."""
    median = float(np.median(np.diff(solution.t))) if len(solution) > 1 else 0.0
    return min(_GAPS * median, _LONGEST) if longest is None else longest


def carry_rows(solution: ForeignSolution, t: FloatArray, longest: float | None = None) -> NavSolution:
    """Return a solution at other times, with each row extrapolated until the next row by its velocity.

    Parameters as for :func:`resample`; ``longest`` is the longest time that a row is extrapolated [s]. By
    default, if the rows are farther apart than the times ``t``, each row counts once, at the first time that
    is not before its own: the table is evaluated at its own rate.
    """
    most = _choose_longest(solution, longest)
    if longest is None and len(t) > 1 and len(solution) > 1:
        step = float(np.median(np.diff(t)))
        if np.median(np.diff(solution.t)) > _SLOWER * step:
            most = step - 2.0 * SAME_INSTANT
    row = np.searchsorted(solution.t, t + SAME_INSTANT, "right") - 1  # the last row not after t
    begun = row >= 0
    row = np.maximum(row, 0)
    age = np.maximum(t - solution.t[row], 0.0)
    age[age <= SAME_INSTANT] = 0.0
    covered = begun & (age <= most + SAME_INSTANT)
    later = np.flatnonzero(age > 0.0)
    lla = solution.lla[row]
    lla[later] = carry_positions(solution.t, solution.lla, solution.vel_n, row[later], t[later])
    cov = np.full((len(t), 9, 9), np.nan) if solution.cov is None else solution.cov[row]
    rest = (solution.vel_n, solution.q_nb, solution.gyro_bias_b, solution.accel_bias_b)
    values = (lla, *(one[row] for one in rest), cov)
    nothing = np.empty((len(t), 0))
    events = _list_events(solution, t, covered, age, most, CARRIED)
    lla, vel_n, q_nb, gyro_bias_b, accel_bias_b, cov = (_blank_uncovered(one, covered) for one in values)
    return NavSolution(
        t=t,
        lla=lla,
        vel_n=vel_n,
        q_nb=q_nb,
        gyro_bias_b=gyro_bias_b,
        accel_bias_b=accel_bias_b,
        cov=cov,
        extra_names=(),
        extra=nothing,
        extra_sd=nothing,
        innovations=no_innovations(),
        events=events,
    )


def _interpolate_position(
    solution: ForeignSolution, before: IntArray, after: IntArray, s: FloatArray, width: FloatArray
) -> FloatArray:
    lla_0, lla_1 = solution.lla[before], solution.lla[after]
    step = lla_1 - lla_0
    step[:, 1] -= 2 * np.pi * np.round(step[:, 1] / (2 * np.pi))  # across the date line
    if np.isnan(solution.vel_n).all():
        lla = lla_0 + s * step
    else:
        rate_0 = earth.displace(lla_0, solution.vel_n[before]) - lla_0
        rate_1 = earth.displace(lla_1, solution.vel_n[after]) - lla_1
        h = width[:, None]
        lla = lla_0 + s * s * (3 - 2 * s) * step + h * s * (1 - s) * ((1 - s) * rate_0 - s * rate_1)
    found: FloatArray = np.where(s > 0, lla, lla_0)
    return found


def _blank_uncovered(values: FloatArray, covered: BoolArray) -> FloatArray:
    values = np.array(values)
    values[~covered] = np.nan
    return values


def _list_events(
    solution: ForeignSolution, t: FloatArray, covered: BoolArray, width: FloatArray, most: float, how: str
) -> Events:
    found = [(0.0, 0.0, "table", text) for text in solution.remarks]
    between = covered & (width > 0)
    if between.any():
        count = f"{int(between.sum())} of {len(t)}"
        apart = "apart" if how == INTERPOLATED else "after the one before"
        words = f"{count} epochs lie between rows, up to {width[between].max():.3g} s {apart}"
        found.append((float(t[between][0]), float(t[between][-1]), how, words))
    edges = np.flatnonzero(np.diff(np.concatenate([[False], ~covered, [False]]).astype(np.int8)))
    found += [
        (float(t[a]), float(t[b - 1]), NOT_COVERED, f"no rows, or more than {most:.3g} s apart")
        for a, b in zip(edges[::2], edges[1::2], strict=True)
    ]
    if not covered.any():
        span = f"{solution.t[0]:g} to {solution.t[-1]:g} s"
        run = f"{t[0]:g} to {t[-1]:g} s" if len(t) else "no time"
        found.append((0.0, 0.0, FAILED, f"{solution.shown} covers {span}, nothing of the run, {run}"))
    return Events.from_rows(found)
