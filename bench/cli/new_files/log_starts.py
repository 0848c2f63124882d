"""Choice of the start and the evaluated part of a recording, for `bench new log`."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from bench.core.mathematics.arrays import FloatArray
from bench.core.records.specs import EvaluationWindow
from bench.core.words.exceptions import ConfigError, EstimatorError
from bench.evaluation.motion.recorded_motion import RecordedMotion
from bench.io.config.log import LogSpec
from bench.io.config.log_tables import StartSpec
from bench.io.logs.log_records import LogRecords
from bench.io.logs.log_start import HOVER, choose_stretch, find_start
from bench.navigation.start import alignment
from bench.navigation.start.leveling import LEAST_REST
from bench.pipeline.log_pipeline import Session

_SILENT = 0.5  # an IMU silent for longer is a new start [s]
_EARLY = 1.0 / 3.0  # part of a recording in which a start in the air is looked for [1]
_SETTLES, _SHARE = 60.0, 0.25  # time after a start that is not evaluated: most [s], of a short record [1]
_TUMBLES = 20.0  # angular rate of an impact [rad/s]
_LIES = 2.0  # ground speed that a wreck does not reach [m/s]
_WRECKED = 3.0  # time from an impact to rest [s]
_LONGEST_REST = 60.0  # [s]


@dataclass(frozen=True, slots=True)
class ChosenStart:
    """The tables [alignment] and [evaluation] of a log, in the units of the file."""

    kind: str  # "level" or "hover"
    at: float  # [s]
    duration: float  # [s]
    heading: str  # "magnetometer" or empty
    evaluated_from: float  # [s]
    until: float | None  # before an impact [s]


def choose_start(spec: LogSpec, records: LogRecords) -> ChosenStart | None:
    """Return a possible start of a record: at rest, else in steady flight; None if there is none.

    It lies in the longest segment that the IMU covers without a gap. The magnetometer gives the heading;
    without one the heading is unknown, and several are tried until the motion shows which fits.
    """
    begin, end = _find_covered(records)
    until = find_impact(records)
    end = end if until is None else min(end, until)
    heading = "magnetometer" if "mag" in records.instruments else ""
    rests = RecordedMotion.from_records(records.imu, records.fixes).find_standstills()
    for first, last in rests:
        first = max(first, begin)
        last = min(last, end - LEAST_REST)  # what is left of a record that never moves is evaluated
        if last - first > LEAST_REST + 1.0:
            rest = float(np.floor(min(last - first - 1.0, _LONGEST_REST)))
            if _holds(spec, records, "level", first, rest, heading):
                return _judge_from("level", first, rest, heading, end, until)
    for length in (HOVER, 0.5 * HOVER, 1.0):
        at = choose_stretch(records.fixes, begin, max(begin + _EARLY * (end - begin), begin + 2.0 * length))
        if _holds(spec, records, "hover", at, length, heading):
            return _judge_from("hover", at, length, heading, end, until)
    return None


def _find_covered(records: LogRecords) -> tuple[float, float]:
    """Return the longest segment without a gap of the IMU, between the first and the last fix [s]."""
    imu, fixes = records.imu, records.fixes
    t = imu.t[imu.valid]
    usable = fixes.t[fixes.valid & (fixes.t >= t[0]) & (fixes.t <= t[-1])]
    if not len(usable):
        return float(t[0]), float(t[-1])
    gaps = np.flatnonzero(np.diff(t) > _SILENT)
    begins, ends = np.append(t[0], t[gaps + 1]), np.append(t[gaps], t[-1])
    begins, ends = np.maximum(begins, usable[0]), np.minimum(ends, usable[-1])
    k = int(np.argmax(ends - begins))
    return float(begins[k]), float(ends[k])


def find_impact(records: LogRecords) -> float | None:
    """Return the time one second before an impact [s]; None without an impact.

    At an impact the IMU tumbles. After it, the fixes move no more or the recording ends.
    """
    imu, fixes = records.imu, records.fixes
    rate = np.linalg.norm(imu.dtheta_b, axis=1) / imu.dt
    speed: FloatArray = np.hypot(fixes.vel_n[:, 0], fixes.vel_n[:, 1])
    moved = float(fixes.t[fixes.valid & (speed > _LIES)].max(initial=-np.inf))
    wild = np.flatnonzero(imu.valid & (rate > _TUMBLES) & (imu.t >= moved - _WRECKED))
    if not len(wild):
        return None
    at = float(imu.t[wild[0]])
    lies = fixes.valid & (fixes.t > at + _WRECKED) & (speed <= _LIES)
    return at - 1.0 if lies.any() or imu.t.max() <= at + _WRECKED else None


def _holds(spec: LogSpec, records: LogRecords, kind: str, at: float, duration: float, heading: str) -> bool:
    """Return whether the filters can start in this way."""
    start = StartSpec(
        alignment=kind,
        at=at,
        align_for=duration,
        drift_sd=0.0,
        attitude=(0.0, 0.0, 0.0),
        tilt_sd=0.0,
        heading_sd=np.deg2rad(10.0),
        heading_from=heading,
    )
    tried = replace(spec, start=start, evaluation=EvaluationWindow(), until=np.inf)
    try:
        session = Session(tried, records, find_start(records, tried))
        data = session.make_data(np.ones(len(session.fixes), np.bool_), np.array([session.last]))
        alignment.complete(data, session.initial)
    except (ConfigError, EstimatorError):
        return False
    return True


def _judge_from(
    kind: str, at: float, duration: float, heading: str, end: float, until: float | None
) -> ChosenStart:
    """Return the start with the time that a filter gets to settle after it."""
    begun = at + duration
    settled = begun + min(_SETTLES, _SHARE * max(end - begun, 0.0))
    return ChosenStart(kind, round(at, 2), duration, heading, round(settled, 1), until)
