"""Over a long gap in the IMU record a filter with fixes coasts on them, and then starts again.

Over seconds without IMU the tilt may be anything, and the linear error model of a filter breaks: it would
come back metres off and claim decimetres. So it stops at the last sample before the gap. From there on
position and velocity come from the fixes alone (`bench.navigation.gnss_only`); the attitude is held and its
covariance grows. When the samples are back, the alignment at rest or on the move finds the attitude
(`bench.navigation.alignment`), and the filter starts again. Its IMU biases are kept, each with its variance;
all other states begin as at the first start.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, fields, replace
from typing import Any, NamedTuple

import numpy as np

from bench import disk_arrays, earth, rotation
from bench.arrays import BoolArray, FloatArray, IntArray
from bench.data import (
    EventRow,
    Events,
    ImuData,
    InitialState,
    Innovations,
    NavSolution,
    SensorData,
    no_innovations,
)
from bench.errors import EstimatorError
from bench.navigation import alignment, timeline
from bench.navigation.blocks import WIND_SD, assumed
from bench.navigation.course import LEAST_SPEED
from bench.navigation.gnss_only import SENSORS as FIX_SENSORS
from bench.navigation.gnss_only import FixTrack, unknown_arm
from bench.navigation.imu_range import find_beyond
from bench.navigation.measurements import fix_variance, weigh_fixes
from bench.navigation.options import FixAccuracy, GnssOnlyOptions
from bench.navigation.rough_heading import UNKNOWN_HEADING_SD
from bench.navigation.waiting import join_rows, take_observations, take_rows
from bench.specs import AxisFigures, ImuSpec, TriadSpec

_ALIGN_FOR = 10.0  # of a stretch that gives the course, or of a standstill [s]
_TILT_SD = 0.5  # of an aircraft whose attitude is not known: banks of 30 deg are usual [rad]
_STILL = 0.3  # speed below which an aircraft stood before a gap [m/s]
_SIGMAS = 5.0  # by which it may seem to have moved in it
_WIDTHS = {"lla": 3, "vel_n": 3, "q_nb": 4, "gyro_bias_b": 3, "accel_bias_b": 3, "extra": 0, "extra_sd": 0}

Run = Callable[[SensorData, InitialState], NavSolution]


@dataclass(frozen=True, slots=True)
class _Biases:
    """Biases of the IMU that are taken off its increments, and how well they are known; none before a gap."""

    gyro: FloatArray  # (3,) [rad/s], b
    accel: FloatArray  # (3,) [m/s^2], b
    gyro_sd: FloatArray  # (3,) [rad/s]; inf: what the datasheet says
    accel_sd: FloatArray  # (3,) [m/s^2]

    def taken_off(self, imu: ImuData) -> ImuData:
        """Return a record less the biases."""
        dt = imu.dt[:, None]
        return replace(imu, dtheta_b=imu.dtheta_b - self.gyro * dt, dvel_b=imu.dvel_b - self.accel * dt)

    def known(self, spec: ImuSpec) -> ImuSpec:
        """Return the datasheet of the unit less its biases: what is left of the turn-on biases."""
        return replace(
            spec, gyro=_less_turn_on(spec.gyro, self.gyro_sd), accel=_less_turn_on(spec.accel, self.accel_sd)
        )


class _End(NamedTuple):
    """A solution at one instant."""

    t: float  # [s]
    lla: FloatArray  # (3,)
    vel_n: FloatArray  # (3,)
    q_nb: FloatArray  # (4,)
    cov: FloatArray  # (9, 9)


def run_between_gaps(
    run: Run, sensors: SensorData, initial: InitialState, accuracy: FixAccuracy | None
) -> NavSolution:
    """Return the solution of a filter, started again after each long gap in the IMU record.

    Parameters
    ----------
    run : callable
        The filter, for a record without gaps longer than `timeline.LONGEST_BRIDGE`.
    sensors, initial : SensorData, InitialState
        Record and start. Without a long gap ``run`` gets them as they are.
    accuracy : str or None
        How the filter weighs fixes; None: it uses none, and has nothing to start again from.

    Returns
    -------
    NavSolution
        With an event "restart" for every long gap.

    Raises
    ------
    bench.errors.EstimatorError
        If the record does not allow the alignment asked for at the start.
    """
    if accuracy is None or sensors.fixes is None or not _has_long_gap(sensors, initial.t):
        return run(sensors, initial)
    start, aligned = alignment.complete(sensors, initial)
    gaps, rows = _long_gaps(sensors, start.t)
    imu, joined = sensors.imu, _Joined(sensors.output_t, aligned)
    ends = np.append(start.t, imu.t[rows])  # of the samples, the start before the first
    biases = _Biases(np.zeros(3), np.zeros(3), np.full(3, np.inf), np.full(3, np.inf))
    end = _End(start.t, start.lla, start.vel_n, start.q_nb, start.cov)
    coast: _Coast | None = None
    for first, behind in zip([0, *gaps], [*gaps, len(rows)], strict=True):
        if first == behind:  # a gap right at the start
            continue
        last = float(ends[behind])
        begin = float(imu.t[rows[first]] - imu.dt[rows[first]])
        left = slice(rows[first] if first in gaps else 0, rows[behind] if behind < len(rows) else None)
        piece = _cut(sensors, left, begin if first in gaps else start.t, last, biases)
        if first in gaps:
            if coast is None:
                coast = _Coast(sensors, end, accuracy)
            silent = (float(ends[first]), begin)
            joined.take_coast(coast, begin)
            found, text = _start_again(piece, begin, coast)
            until = last if found is None else found.t
            joined.take_coast(coast, until)
            length = f"{begin - silent[0]:.6g} s"
            joined.events.append((*silent, "timeline", f"imu: gap of {length}", "imu"))
            lost = slice(rows[first - 1] + 1 if first else 0, rows[first])
            because = _name_ranges(take_rows(imu, lost), sensors.specs.imu)
            text = f"IMU silent for {length}{because}: {text}"
            joined.events.append((silent[0], until, "restart", text, "imu"))
            if found is None:
                continue
            joined.coasts += [coast.track.take_innovations()] if coast.track else []
            coast, start = None, found
        solution = run(piece, start)
        joined.take_piece(solution, biases)
        end, biases = _at_end(solution, sensors.specs.imu, biases)
    return joined.solution()


def _long_gaps(sensors: SensorData, start: float) -> tuple[list[int], IntArray]:
    """Return which samples in use come after a long gap, and the rows in use."""
    rows, span, events = timeline.imu_rows(sensors.imu, start, sensors.specs.imu)
    if not events:
        return [], rows
    gaps = np.flatnonzero(span - sensors.imu.dt[rows] > timeline.LONGEST_BRIDGE)
    return gaps.tolist(), rows


def _name_ranges(lost: ImuData, spec: ImuSpec) -> str:
    """Return how many of the samples without use are at the end of a range, in words; "" if none is."""
    counts = [(int(rows.sum()), why) for why, rows in find_beyond(lost, spec)]
    listed = " and ".join(f"{count} of {len(lost)} samples have the {why}" for count, why in counts if count)
    return f" ({listed})" if listed else ""


def _has_long_gap(sensors: SensorData, start: float) -> bool:
    """Return whether any sample in use comes after a long gap."""
    intake, imu, spec = timeline.ImuIntake(start), sensors.imu, sensors.specs.imu
    waiting = take_rows(imu, slice(0))
    for block in disk_arrays.blocks(len(imu)):
        samples = take_rows(imu, block)
        if len(waiting):
            samples = join_rows(waiting, samples)
        rows, span, events, again = intake.take(samples, spec, last=block.stop == len(imu))
        if events and (span - samples.dt[rows] > timeline.LONGEST_BRIDGE).any():
            return True
        waiting = take_rows(samples, again)
    return False


def _start_again(piece: SensorData, begin: float, coast: _Coast) -> tuple[InitialState | None, str]:
    """Return the state that an alignment finds in a stretch, None if there is none, and what was done."""
    lla, vel_n, cov = coast.at(begin)
    before, unknown = coast.end, np.full(4, np.nan)
    wide = np.diag(np.full(9, np.inf))
    ways = [
        InitialState(
            begin, unknown[:3], unknown[:3], unknown, wide, "course", _ALIGN_FOR,
            drift_sd=float(np.arctan2(WIND_SD, max(np.hypot(*vel_n[:2]), LEAST_SPEED))),
        )
    ]  # fmt: skip
    if np.isfinite(lla).all():
        wide = wide.copy()
        wide[:3, :3] = cov[:3, :3]
        moved = np.linalg.norm(earth.difference_n(lla, before.lla)) > _SIGMAS * np.sqrt(np.trace(cov[:3, :3]))
        if np.linalg.norm(before.vel_n) < _STILL and not moved:  # the nose points where it did
            unknown, wide[8, 8] = before.q_nb, before.cov[8, 8]
        ways.insert(0, InitialState(begin, lla, np.full(3, np.nan), unknown, wide, "level", _ALIGN_FOR))
    why = []
    for way in ways:
        try:
            found, ((_, _, _, text, *_),) = alignment.complete(piece, way)
        except EstimatorError as error:
            why.append(str(error))
        else:
            return found, f"position and velocity by the fixes alone until {found.t:.6g} s; {text}"
    return None, f"position and velocity by the fixes alone; not started again: {'; '.join(why)}"


class _Coast:
    """Position and velocity by the fixes alone, and an attitude that is held."""

    def __init__(self, sensors: SensorData, end: _End, accuracy: FixAccuracy) -> None:
        assert sensors.fixes is not None
        self.fixes, self.end, self.reached = sensors.fixes, end, end.t
        white = fix_variance(assumed(sensors.specs, "gnss"), gnss_markov=False)
        self.r = weigh_fixes(sensors.fixes, white, accuracy)
        self.arm = unknown_arm(sensors.antenna_b)  # it follows the antenna
        rows, _, _ = timeline.fix_rows(self.fixes, np.array([np.inf]), end.t)
        self.waiting = iter(rows.tolist())
        self.next = next(self.waiting, None)
        self.track: FixTrack | None = None
        if np.isfinite(np.concatenate([end.lla, end.vel_n, end.q_nb, end.cov[:6, :6].ravel()])).all():
            antenna = earth.displace(end.lla, rotation.rotate(end.q_nb, sensors.antenna_b))
            self.track = FixTrack(GnssOnlyOptions(), end.t, antenna, end.vel_n, end.cov[:6, :6])

    def at(self, t: float) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return position (3,), velocity (3,) and covariance (9, 9) at an instant, in order of time."""
        fixes = self.fixes
        while self.next is not None and fixes.t_arrival[self.next] <= t + timeline.TIME_TOLERANCE:
            lla, vel_n, valid = fixes.lla[self.next], fixes.vel_n[self.next], float(fixes.t[self.next])
            r = self.r[self.next]
            if self.track is None:
                self.track = FixTrack.begin(GnssOnlyOptions(), valid, lla, vel_n, r)
            else:
                row, at = np.array([self.next]), np.zeros(1, np.int64)
                self.track.run(fixes, row, self.r, at, np.empty(0))
            self.next = next(self.waiting, None)
        cov = np.full((9, 9), np.nan)
        if self.track is None:
            return np.full(3, np.nan), np.full(3, np.nan), cov
        ((state,), (P,)) = self.track.at([t])
        cov[:6, :6], cov[:6, 6:], cov[6:, :6] = P[:6, :6] + np.diag(self.arm), 0.0, 0.0
        elapsed = np.array([t - self.end.t])
        turned = timeline.bridge_variance(elapsed, np.zeros((1, 2)))[0, 1]
        most = np.square([_TILT_SD, _TILT_SD, UNKNOWN_HEADING_SD])
        held = np.diag(self.end.cov)[6:]
        cov[6:, 6:] = np.diag(np.maximum(held, np.minimum(held + turned, most)))
        return state[:3], state[3:6], cov


class _Joined:
    """A solution put together from pieces."""

    def __init__(self, t: FloatArray, events: list[EventRow]) -> None:
        m = len(t)
        self.t, self.events = t, list(events)
        self.columns = {name: np.full((m, width), np.nan) for name, width in _WIDTHS.items()}
        self.columns["cov"] = np.full((m, 9, 9), np.nan)
        self.extra_names: tuple[str, ...] = ()
        self.sensor: tuple[str, ...] = FIX_SENSORS
        self.tables: list[Innovations] = []
        self.coasts: list[Innovations] = []

    def take_piece(self, solution: NavSolution, biases: _Biases) -> None:
        """Take the answers of a filter, the biases that were taken off its increments given back."""
        columns = {name: getattr(solution, name).copy() for name in self.columns if name != "extra"}
        columns["extra"], columns["extra_sd"] = solution.extra.copy(), solution.extra_sd
        both = np.concatenate([biases.gyro, biases.accel])
        columns["gyro_bias_b"] += biases.gyro
        columns["accel_bias_b"] += biases.accel
        columns["extra"][:, :6] += both
        if not self.extra_names:
            self.extra_names = solution.extra_names
            for name in ("extra", "extra_sd"):
                self.columns[name] = np.full((len(self.t), len(self.extra_names)), np.nan)
        answered = np.isfinite(solution.cov).any(axis=(1, 2))
        rows = np.searchsorted(self.t, solution.t)
        answered &= np.isin(solution.t, self.t)
        for name, column in columns.items():
            self.columns[name][rows[answered]] = column[answered]
        if len(solution.innovations.t):  # a piece without any names no sensors
            self.sensor = solution.innovations.sensor
            self.tables.append(solution.innovations)
        self.events += solution.events.rows()

    def take_coast(self, coast: _Coast, until: float) -> None:
        """Take the answers of the fixes alone, from where they were taken last."""
        begin, end = np.searchsorted(self.t, np.array([coast.reached, until]) + timeline.TIME_TOLERANCE)
        for k in range(begin, end):
            now = coast.at(float(self.t[k]))
            for name, value in zip(("lla", "vel_n", "cov"), now, strict=True):
                self.columns[name][k] = value
            self.columns["q_nb"][k] = coast.end.q_nb
        coast.reached = until
        held = max(begin - 1, 0)
        for name in ("gyro_bias_b", "accel_bias_b", "extra", "extra_sd"):
            self.columns[name][begin:end] = self.columns[name][held]

    def solution(self) -> NavSolution:
        """Return what was taken."""
        number = np.array([self.sensor.index(name) for name in FIX_SENSORS])
        coasts = [replace(own, sensor=self.sensor, code=number[own.code]) for own in self.coasts]
        tables = [*self.tables, *coasts, no_innovations()]
        order = np.argsort(np.concatenate([table.t for table in tables]), kind="stable")
        names = [f.name for f in fields(Innovations) if f.name != "sensor"]
        whole = {name: np.concatenate([getattr(table, name) for table in tables])[order] for name in names}
        return NavSolution(
            t=self.t,
            extra_names=self.extra_names,
            innovations=Innovations(sensor=self.sensor, **whole),
            events=Events.from_rows(self.events),
            **self.columns,
        )


def _at_end(solution: NavSolution, spec: ImuSpec, biases: _Biases) -> tuple[_End, _Biases]:
    """Return the last answer of a piece, and the biases to take off the increments from there on."""
    end = _End(*(getattr(solution, name)[-1] for name in _End._fields))
    found = np.concatenate([solution.gyro_bias_b[-1], solution.accel_bias_b[-1], solution.extra_sd[-1, :6]])
    if not np.isfinite(found).all():
        return end, biases
    kept = []
    for triad, before, part in (
        (spec.gyro, biases.gyro, slice(0, 3)),
        (spec.accel, biases.accel, slice(3, 6)),
    ):
        if triad.turn_on_bias_sd > 0:
            kept.append((before + found[part], found[6:][part]))
        else:  # a process that forgets itself begins as at the first start
            kept.append((np.zeros(3), np.full(3, np.inf)))
    (gyro, gyro_sd), (accel, accel_sd) = kept
    return end, _Biases(gyro, accel, gyro_sd, accel_sd)


def _less_turn_on(triad: TriadSpec, sd: FloatArray) -> TriadSpec:
    """Return a triad whose biases are known to ``sd`` (3,), no better than its instability."""
    left = np.sqrt(np.maximum(sd**2 - triad.instability_by_axis**2, (1e-3 * sd) ** 2))
    left = np.minimum(triad.by_axis("turn_on_bias_sd"), left)
    axes = tuple(one for one in triad.axes or () if one.name != "turn_on_bias_sd")
    own = AxisFigures("turn_on_bias_sd", *left.tolist())
    return replace(triad, turn_on_bias_sd=float(left.max()), axes=(*axes, own))


def _cut(sensors: SensorData, rows: slice, begin: float, last: float, biases: _Biases) -> SensorData:
    """Return the rows of the IMU and what arrives while they do, with an answer at the last sample."""
    imu = biases.taken_off(take_rows(sensors.imu, rows))
    inside = (sensors.output_t >= begin - timeline.TIME_TOLERANCE) & (sensors.output_t <= last)
    records = {"fixes": sensors.fixes} | sensors.instruments
    cut = {
        name: take_rows(record, _arrived(record, begin, last)) for name, record in records.items() if record
    }
    if sensors.observations is not None:
        cut["observations"] = take_observations(
            sensors.observations, _arrived(sensors.observations, begin, last)
        )
    return replace(
        sensors,
        imu=imu,
        specs=replace(sensors.specs, imu=biases.known(sensors.specs.imu)),
        output_t=np.union1d(sensors.output_t[inside], last),
        **cut,
    )


def _arrived(record: Any, begin: float, last: float) -> BoolArray:
    inside: BoolArray = (record.t_arrival > begin) & (record.t_arrival <= last + timeline.TIME_TOLERANCE)
    return inside
