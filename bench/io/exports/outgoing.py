"""The exported data of a run: sensors, initial state and datasheets of the filters, requested tracks."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from datetime import date, datetime, timedelta
from pathlib import Path
from typing import Any

import numpy as np

from bench.core.mathematics.arrays import FloatArray
from bench.core.mathematics.units import SAME_INSTANT
from bench.core.records.data import GnssFixes, GnssObservations, ImuData, NavSolution, Trajectory
from bench.core.words.exceptions import EstimatorError, ExportError
from bench.io.results import make_sensor_data, read_initial_state, write_initial_state
from bench.io.results.columns import MOTION, Layout, flatten
from bench.navigation.engine.kept_rows import take_rows
from bench.simulation.signals.gps_time import leap_seconds

_GPS_ZERO = datetime(1980, 1, 6)
_WEEK = 604800.0  # [s]

FRAMES = (
    "Body axes b are the IMU axes: forward, right, down. n is north, east, down at the current position. "
    "Heights are above the WGS 84 ellipsoid."
)

Track = Trajectory | NavSolution
"""Position, velocity and attitude of the IMU, column by column."""


@dataclass(frozen=True, slots=True)
class Calendar:
    """The date and time of t = 0."""

    week: int  # GPS week
    second: float  # of that week, GPS time [s]
    utc: datetime  # without time zone

    def at(self, t: float) -> datetime:
        """Return time t [s] as UTC, rounded to the millisecond."""
        return self.utc + timedelta(milliseconds=round(1e3 * float(t)))

    def nanoseconds(self, t: float) -> int:
        """Return time t [s] as nanoseconds since 1970-01-01 00:00:00 UTC."""
        whole = round((self.utc - datetime(1970, 1, 1)) / timedelta(microseconds=1))
        return whole * 1000 + round(float(t) * 1e9)

    def __str__(self) -> str:
        return (
            f"t = 0 is {self.utc.isoformat(' ', 'milliseconds').removesuffix('.000')} UTC, second "
            f"{self.second:.9g} of GPS week {self.week}"
        )


def make_calendar(year: float, gps_t0: float | None) -> Calendar:
    """Return the calendar of a flight in a decimal year, with t = 0 ``gps_t0`` [s] into its day."""
    first = int(year)
    days = (date(first + 1, 1, 1) - date(first, 1, 1)).days
    day = date(first, 1, 1) + timedelta(days=round((year - first) * days))
    ahead = leap_seconds(day)
    gps = datetime(day.year, day.month, day.day) + timedelta(seconds=ahead if gps_t0 is None else gps_t0)
    week, second = divmod((gps - _GPS_ZERO).total_seconds(), _WEEK)
    return Calendar(int(week), second, gps - timedelta(seconds=ahead))


@dataclass(frozen=True, slots=True)
class ExportData:
    """The exported data of a run."""

    imu: ImuData
    fixes: GnssFixes | None
    observations: GnssObservations | None
    instruments: Mapping[str, Any]  # on board, by name
    start: Mapping[str, Any]  # as `bench.io.results.make_start_document` makes it
    output_t: FloatArray = field(default_factory=lambda: np.empty(0))  # epochs of a solution [s]
    tracks: Mapping[str, Track] = field(default_factory=dict)  # by name: "truth", "solution-loose-15"
    like: Path | None = None  # a file whose definitions the export takes

    @property
    def calendar(self) -> Calendar:
        """Time of t = 0: from the observations of the receiver, else the start of the flight's day in UTC."""
        return make_calendar(
            self.start["date"], None if self.observations is None else self.observations.gps_t0
        )

    @property
    def rate(self) -> float:
        """Rate of the IMU [Hz]."""
        return float(1.0 / np.median(self.imu.dt))

    def rates(self) -> tuple[FloatArray, FloatArray]:
        """Return the mean angular rate [rad/s] and specific force [m/s^2] of each interval (N, 3), b."""
        dt = self.imu.dt[:, None]
        return self.imu.dtheta_b / dt, self.imu.dvel_b / dt

    def select_fixes(self) -> GnssFixes:
        """Return the fixes that are finite and marked as valid by the receiver.

        Raises
        ------
        ExportError
            If there is no such fix.
        """
        if self.fixes is None:
            raise ExportError("the run has no GNSS receiver, which this format needs")
        finite = np.isfinite(self.fixes.lla).all(axis=1) & np.isfinite(self.fixes.t)
        kept = self.fixes.valid & finite
        if not kept.any():
            raise ExportError("no GNSS fix of the run is valid")
        return self.fixes.take(kept)

    def count_left_out(self, fixes: GnssFixes) -> int:
        """Return the number of fixes that `select_fixes` has left out."""
        return 0 if self.fixes is None else len(self.fixes) - len(fixes)

    def tables(self) -> dict[str, tuple[object, Layout]]:
        """Return every record and its columns, by the name of its table."""
        sensors = {"imu": self.imu, "gnss": self.fixes, "observations": self.observations, **self.instruments}
        found = {name: flatten(record) for name, record in sensors.items() if record is not None}
        for name, track in self.tracks.items():
            found[name] = (track, MOTION) if isinstance(track, Trajectory) else flatten(track)
        return found

    def assumed(self, triad: str) -> Mapping[str, Any]:
        """Return the figures of "gyro" or "accel" that filters assume, as `sensor_specs.TriadSpec`."""
        figures: Mapping[str, Any] = self.start["assumed"]["imu"][triad]
        return figures

    def align(self) -> tuple[ExportData, str]:
        """Return the data from a complete initial state on, and a sentence on the data left out before it.

        A state that the filters have to find is that of their initial alignment: no later data, no truth.

        Raises
        ------
        ExportError
            If the record does not allow the alignment.
        """
        from bench.navigation.start import alignment  # kernels: not for who lists the formats

        asked = read_initial_state(self.start)
        data = make_sensor_data(
            self.start, self.imu, self.fixes, self.instruments, self.output_t, self.observations
        )
        try:
            initial, _ = alignment.complete(data, asked)
        except EstimatorError as error:
            found = f"alignment = {asked.alignment!r} finds none: {error}"
            raise ExportError(f"this format needs a complete initial state, and {found}") from None
        fixes, imu = self.fixes, take_rows(self.imu, self.imu.t > initial.t + SAME_INSTANT)
        if not len(imu):
            raise ExportError(f"no row of the IMU comes after the initial state at {initial.t:.6g} s")
        if len(imu) == len(self.imu):
            return self, ""
        imu = _cut_first(imu, initial.t)
        if fixes is not None:
            fixes = fixes.take(fixes.t > initial.t)
        found = "" if asked.alignment == "given" else f", as the alignment {asked.alignment!r} finds it,"
        lost = 0 if self.fixes is None or fixes is None else len(self.fixes) - len(fixes)
        left_out = f"{len(self.imu) - len(imu)} rows of the IMU and {lost} fixes before it are left out"
        remark = f"The initial state{found} is at t = {initial.t:.6g} s; {left_out}."
        start = {**self.start, "initial": write_initial_state(initial)}
        return replace(self, imu=imu, fixes=fixes, start=start), remark

    def complete_start(self) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
        """Return lla (3,) [rad, rad, m], vel_n (3,) [m/s], q_nb (4,) and their sd (9,) at the start.

        They are finite after `align`.
        """
        initial = read_initial_state(self.start)
        return initial.lla, initial.vel_n, initial.q_nb, np.sqrt(np.diag(initial.cov))

    def start_at_first_row(self) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
        """Return the values of `complete_start`, propagated to the end of the first IMU interval.

        For tools that take the first row as the start, not as the end of an interval.
        """
        from bench.core.mathematics import earth, rotation

        lla, vel_n, q_nb, sd = self.complete_start()
        t_0 = float(self.start["initial"]["t_s"])
        dt = float(self.imu.t[0]) - t_0
        moved = vel_n + rotation.rotate(q_nb, self.imu.dvel_b[0]) + dt * earth.gravity_n(lla[0], lla[2])
        turned = rotation.multiply(q_nb, rotation.from_rotvec(self.imu.dtheta_b[0]))
        return earth.displace(lla, 0.5 * dt * (vel_n + moved)), moved, turned, sd


def _cut_first(imu: ImuData, begin: float) -> ImuData:
    """Return a record with its first interval cut to begin no earlier than a time, in proportion to time."""
    dt, dtheta_b, dvel_b = imu.dt.copy(), imu.dtheta_b.copy(), imu.dvel_b.copy()
    dt[0] = min(dt[0], imu.t[0] - begin)
    dtheta_b[0] *= dt[0] / imu.dt[0]
    dvel_b[0] *= dt[0] / imu.dt[0]
    return replace(imu, dt=dt, dtheta_b=dtheta_b, dvel_b=dvel_b)


def thin(t: FloatArray, rate: float) -> np.ndarray[Any, np.dtype[np.intp]]:
    """Return the indices of every n-th row, so that about ``rate`` [Hz] are left."""
    step = float(np.median(np.diff(t))) if len(t) > 1 else 1.0
    return np.arange(0, len(t), max(1, round(1.0 / (rate * step))))
