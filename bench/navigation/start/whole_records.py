"""Filters that process only whole records, restarted after each long IMU gap."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

from bench.core.files import disk_arrays
from bench.core.mathematics.arrays import FloatArray
from bench.core.records.data import EventRow, Events, InitialState, NavSolution, SensorData
from bench.navigation.engine import timeline
from bench.navigation.engine.kept_rows import join_rows, take_rows
from bench.navigation.options import FixAccuracy
from bench.navigation.start import alignment
from bench.navigation.start.restart import BetweenGaps

Run = Callable[[SensorData, InitialState, float | None], NavSolution]
Errors = Callable[[], tuple[FloatArray, FloatArray]]


def run_between_gaps(
    run: Run,
    sensors: SensorData,
    initial: InitialState,
    accuracy: FixAccuracy | None,
    steady_errors: Errors | None = None,
) -> NavSolution:
    """Return the solution of a filter for whole records, restarted after each long IMU gap.

    Parameters
    ----------
    run : callable
        The filter, for a record without gaps longer than `timeline.LONGEST_BRIDGE`. After one it gets the sd
        of what is left of the errors of the gyros [rad/s], where ``steady_errors`` tells it, else None.
    sensors, initial : SensorData, InitialState
        Record and start. Without a long gap ``run`` gets them as they are.
    accuracy : str or None
        How the filter weighs fixes; None: it uses none, and has nothing to start again from.
    steady_errors : callable or None
        Tells after a run what `piecewise.KnowsImuErrors` does at its end.

    Returns
    -------
    NavSolution
        With an event "restart" for every long gap.

    Raises
    ------
    bench.EstimatorError
        If the record does not allow the alignment asked for at the start.
    """
    if accuracy is None or sensors.fixes is None or not _has_long_gap(sensors, initial.t):
        return run(sensors, initial, None)
    start, events = alignment.complete(sensors, initial)

    def begin(
        _: SensorData, start: InitialState, events: list[EventRow], gyro_sd: float | None = None
    ) -> Any:
        return _WholeRun(run, start, events, gyro_sd, steady_errors)

    between = BetweenGaps(begin, sensors, start, events, accuracy, whole=steady_errors is not None)
    return between.update(sensors, 0.0, last=True)


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


@dataclass
class _WholeRun:
    """Adapter that runs a filter for whole records as if it took pieces."""

    run: Run
    start: InitialState
    events: list[EventRow]
    gyro_sd: float | None
    steady_errors: Errors | None

    def update(self, piece: SensorData, look_back: float, *, last: bool) -> NavSolution:
        assert last
        solution = self.run(piece, self.start, self.gyro_sd)
        return replace(solution, events=Events.from_rows([*self.events, *solution.events.rows()]))
