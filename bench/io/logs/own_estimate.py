"""The log of an autopilot: its contents, the truth of its simulator, and its own estimate as a filter.

``use = "autopilot"`` is the estimate that flew, ``"autopilot:1"`` the second instance or core. An autopilot
has used every fix, so no fix can be withheld from it: it is evaluated by a reference, by the fixes that end
real outages, and by its own innovations.
"""

from __future__ import annotations

from dataclasses import fields, replace
from importlib import import_module
from pathlib import Path
from typing import TypeVar

import numpy as np

from bench.core.mathematics.arrays import BoolArray, FloatArray, find_later
from bench.core.records.data import EventRow, Events, InitialState, Innovations, NavSolution, SensorData
from bench.core.records.specs import AUTOPILOT
from bench.core.words.exceptions import ConfigError, EstimatorError
from bench.evaluation.errors.resampling import ForeignSolution, resample
from bench.io.config.log import SourceSpec
from bench.io.log_formats import find_format
from bench.io.logs.formats.unreadable import explain_missing
from bench.io.logs.log_contents import Contents, OwnEstimate, OwnMotion, split_instance

_Answer = TypeVar("_Answer")

NEAR = 0.5
"""Longest interval between rows of an estimate that is bridged [s]: loggers write 8 to 100 a second."""


def look(form: str, path: Path) -> Contents:
    """Return the contents of the log of an autopilot.

    Raises
    ------
    ConfigError
        If it cannot be read.
    """
    return _ask(form, path, "a message of it", "look", Contents)


def read_truth(source: SourceSpec) -> OwnMotion:
    """Return the truth of a simulator in a log.

    Raises
    ------
    ConfigError
        If it has none.
    """
    return _ask(source.format, source.path, "its truth", "read_truth", OwnMotion)


def read_estimate(source: SourceSpec, instance: int | None) -> OwnEstimate:
    """Return the estimate of the autopilot in a log; None: of the instance that flew.

    Raises
    ------
    ConfigError
        If it has none.
    """
    path = source.path
    if not find_format(source.format).knows:
        raise ConfigError(f"filter {AUTOPILOT!r}: {path.name} is not a log of an autopilot")
    try:
        return _ask(source.format, path, "its estimate", "read_estimate", OwnEstimate, instance)
    except ConfigError as error:
        if str(error).startswith(f"{path.name}: "):
            raise
        raise ConfigError(f"{path.name}: {error}") from None


def _ask(form: str, path: Path, what: str, function: str, kind: type[_Answer], *given: object) -> _Answer:
    """Return the result of a reader function for a file; name ``what`` if a field is missing."""
    known = find_format(form)
    try:
        with explain_missing(known.package, path):
            found = getattr(import_module(known.module), function, lambda *_: None)(path, *given)
    except KeyError as error:
        raise ConfigError(f"{path.name}: {what} has no field {error.args[0]!r}") from None
    if not isinstance(found, kind):
        gives = f"{function} gives no {kind.__name__}, but {type(found).__name__}"
        raise ConfigError(f"{path.name}: log format {form!r} of {known.brought_by}: {gives}")
    return found


class AutopilotEstimator:
    """Estimate of the autopilot in flight, at the requested epochs.

    Parameters
    ----------
    source : SourceSpec
        The log.
    origin : float
        Time of t = 0 on the clock of the log [s].
    instance : int or None
        None: what flew.
    """

    def __init__(self, source: SourceSpec, origin: float, instance: int | None = None) -> None:
        self.shown = source.path.name
        self._own = read_estimate(source, instance)
        self._shift = source.time_offset - origin

    def attitude(self, t: float) -> FloatArray:
        """Return its attitude (4,) at a time [s]; NaN where it has none."""
        moment = np.full(1, t)
        motion = self._own.motion
        times = motion.attitude_t + self._shift
        return np.asarray(_sample(self.shown, times, None, None, motion.q_nb, moment).q_nb[0])

    def run(self, sensors: SensorData, initial: InitialState) -> NavSolution:
        """Return its solution at ``sensors.output_t``; NaN at times that it does not cover."""
        own, t, shift = self._own, sensors.output_t, self._shift
        motion, last = own.motion, float(sensors.imu.t.max())
        if not np.isfinite(motion.lla).all(axis=1).any():
            raise EstimatorError(f"{self.shown}: its autopilot has no position in this log")
        moved = _sample(self.shown, motion.t + shift, motion.lla, motion.vel_n, None, t)
        turned = _sample(self.shown, motion.attitude_t + shift, None, None, motion.q_nb, t)
        variance = _interpolate(own.variances[0] + shift, own.variances[1], t)
        cov = np.zeros((len(t), 9, 9))
        cov[:, range(9), range(9)] = variance
        for block in (slice(0, 3), slice(3, 6), slice(6, 9)):
            unknown = np.isnan(variance[:, block]).any(axis=1)
            cov[unknown, block, :] = np.nan
            cov[unknown, :, block] = np.nan
        bias = _interpolate(own.biases[0] + shift, own.biases[1], t)
        measured = own.innovations.t + shift
        inside = (measured >= initial.t) & (measured <= last)
        events: list[EventRow] = [
            (row[0] + shift, row[1] + shift, *row[2:])
            for row in own.events
            if initial.t <= row[0] + shift <= last
        ]
        return replace(
            moved,
            q_nb=turned.q_nb,
            cov=cov,
            gyro_bias_b=bias[:, :3],
            accel_bias_b=bias[:, 3:],
            innovations=_take(own.innovations, inside, shift),
            events=Events.from_rows(sorted([*moved.events.rows(), *events])),
        )


def build(use: str, source: SourceSpec, origin: float) -> AutopilotEstimator:
    """Build the filter that a log names ``autopilot`` or ``autopilot:INSTANCE``.

    Raises
    ------
    ConfigError
        If the log has no such estimate.
    """
    return AutopilotEstimator(source, origin, split_instance(use)[1])


def _sample(
    shown: str,
    t: FloatArray,
    lla: FloatArray | None,
    vel_n: FloatArray | None,
    q_nb: FloatArray | None,
    at: FloatArray,
) -> NavSolution:
    """Return a part of the motion at other times, without extrapolation."""
    given = np.hstack([x for x in (lla, vel_n, q_nb) if x is not None])
    rows = np.flatnonzero(np.isfinite(given).all(axis=1) & find_later(t))
    unknown = np.full((max(len(rows), 1), 4), np.nan)

    def pick(x: FloatArray | None, width: int) -> FloatArray:
        return unknown[:, :width] if x is None or not len(rows) else x[rows]

    own = ForeignSolution(
        shown=shown,
        rows=rows + 1,
        t=t[rows] if len(rows) else np.array([-np.inf]),
        lla=pick(lla, 3),
        vel_n=pick(vel_n, 3),
        q_nb=pick(q_nb, 4),
        gyro_bias_b=unknown[:, :3],
        accel_bias_b=unknown[:, :3],
        cov=None,
        remarks=(),
    )
    return resample(own, at, NEAR)


def _interpolate(t: FloatArray, values: FloatArray, at: FloatArray) -> FloatArray:
    """Return columns at other times, the nearest row beyond both ends; NaN without rows."""
    if not len(t):
        return np.full((len(at), values.shape[1]), np.nan)
    return np.column_stack([np.interp(at, t, column) for column in values.T])


def _take(table: Innovations, rows: BoolArray, shift: float) -> Innovations:
    columns = {one.name: getattr(table, one.name) for one in fields(Innovations)}
    taken = {name: value if name == "sensor" else value[rows] for name, value in columns.items()}
    return Innovations(**{**taken, "t": taken["t"] + shift})
