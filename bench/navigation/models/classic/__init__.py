"""The source's 22-state filter, step by step in the order and the symbols of the equation register.

East, north, up; heading clockwise; body axes forward, up, right; attitude as the matrix B from body to east,
north, up. Errors are computed minus true, and alpha turns the true triad into the computed one:
``B_computed = (I - [alpha x]) B`` (equations 1.4). Position errors are in reduced coordinates,
``dR_E = R3 dlon`` and ``dR_N = R3 dlat`` on a sphere of fixed radius R3 (equations 1.5), so ``reduced`` says
how many of them make a meter. The state (A-5.4.1):

    0-2   dR_E, dR_N [m, reduced], dh [m]           9-11  gyro errors eps [rad/s], body
    3-5   dV_E, dV_N, dV_h [m/s]                    12-14 accelerometer errors da [m/s^2], body
    6-8   alpha_E, alpha_N, alpha_h [rad]           15    barometer bias [m]
    16-18 Markov part of the GNSS position [m, 16 and 17 reduced], 19-21 of its velocity [m/s]

In one respect each the filter goes beyond the source, as the register decides: the radii of the ellipsoid and
Somigliana's gravity in place of a sphere (A-5.1.10, A-5.1.4g), seven measurements in place of eight
(A-5.4.8R), coning and sculling of the previous interval, the lever arm of the GNSS antenna (equations 10).

It shares with the compiled filters the datasheets, the Earth and the choice of rows of a record; Joseph's
covariance is `filterpy`'s, and everything else is its own, so that one can be held against the other.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from bench.core.mathematics.arrays import FloatArray
from bench.core.records.data import EventRow, GnssFixes, InitialState, NavSolution, SensorData
from bench.core.records.sensor_specs import AssumedSpecs
from bench.navigation.engine.piecewise import InPieces
from bench.navigation.error_state_filter.aiding_sensors import BARO, FIXES, unmodeled
from bench.navigation.error_state_filter.error_state import StateLayout
from bench.navigation.error_state_filter.schedule import Schedule
from bench.navigation.error_state_filter.state_blocks import GNSS_MARKOV
from bench.navigation.error_state_filter.state_processes import assumed
from bench.navigation.models.classic.filter_loop import FilterLoop
from bench.navigation.models.stepped_filters import SteppedPassage
from bench.navigation.options import ClassicOptions, read_options
from bench.navigation.start import alignment
from bench.navigation.start.restart import between_gaps


def _read_fixes(fixes: GnssFixes, *_: object) -> tuple[FloatArray, FloatArray]:
    return np.column_stack([fixes.lla, fixes.vel_n, fixes.satellites]), np.zeros(6)


_AIDING = replace(FIXES, read=_read_fixes), BARO


class Classic22:
    """The 22-state filter of the source, slow and readable: the oracle of `loose-22`.

    It follows the register step by step: A-5.1.2 to A-5.1.4 at every IMU sample, A-5.4.4 at the covariance
    rate and at every measurement and output, then the seven rows of A-5.4.3 that have arrived, tested
    sub-vector by sub-vector, A-5.4.5 with what passed, and the correction A-5.4.8 to A-5.4.11 or none.
    Outputs are corrected by what the filter knows and has not fed back. A fix is used with the barometer
    reading of the same IMU sample.

    Options: `bench.navigation.options.ClassicOptions`.
    """

    needs = ("fixes",)
    model: type[ClassicOptions] = ClassicOptions

    def __init__(self, **options: Any) -> None:
        self.options: ClassicOptions = read_options(self.model, options)

    def run(self, sensors: SensorData, initial: InitialState) -> NavSolution:
        """Estimate position, velocity, attitude, sensor errors and their covariance."""
        for record, name in ((sensors.baro, "baro"), (sensors.fixes, "gnss")):
            if record is not None:
                assumed(sensors.specs, name)
        initial, events = alignment.complete(sensors, initial)
        return self.in_pieces(sensors, initial, events).update(sensors, 0.0, last=True)

    def in_pieces(self, first: SensorData, initial: InitialState, events: list[EventRow]) -> InPieces:
        """Return the filter before its first piece (`piecewise.RunsInPieces`)."""
        return between_gaps(self._passage, first, initial, events, "datasheet")

    def _passage(self, first: SensorData, initial: InitialState, events: list[EventRow]) -> SteppedPassage:
        used = [sensor for sensor in _AIDING if getattr(first, sensor.record) is not None]
        schedule = Schedule(initial.t, first.specs.imu, compensate=False, as_sampled=True)
        schedule.events += events
        flight = self.make_loop(first, initial)
        return SteppedPassage(flight, schedule, used, first, initial, StateLayout())

    def make_loop(self, sensors: SensorData, initial: InitialState) -> FilterLoop:
        """Return navigator and filter at the start of a record."""
        return FilterLoop(self.options, sensors, initial)

    def unmodeled_errors(self, specs: AssumedSpecs) -> tuple[str, ...]:
        """Return the errors of these sensors that the filter has no state for, in words."""
        found = unmodeled(specs, (FIXES, BARO), GNSS_MARKOV.takes)
        for name, triad in (("gyro", specs.imu.gyro), ("accelerometer", specs.imu.accel)):
            if triad.bias_instability > 0 and triad.turn_on_bias_sd == 0 and triad.bias_model != "flicker":
                found += (f"{name} bias instability that fades (taken as a random walk)",)
        return found
