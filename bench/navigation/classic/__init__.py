"""The source's 22-state filter, step by step in the order and the symbols of the equation register.

East, north, up; heading clockwise; body axes forward, up, right; attitude as the matrix B from body to east,
north, up. Errors are computed minus true, and alpha turns the true triad into the computed one:
``B_computed = (I - [alpha x]) B`` (equations 1.4). Position errors are in reduced coordinates,
``dR_E = R3 dlon`` and ``dR_N = R3 dlat`` on a sphere of fixed radius R3 (equations 1.5), so ``reduced`` says
how many of them make a metre. The state (A-5.4.1):

    0-2   dR_E, dR_N [m, reduced], dh [m]           9-11  gyro errors eps [rad/s], body
    3-5   dV_E, dV_N, dV_h [m/s]                    12-14 accelerometer errors da [m/s^2], body
    6-8   alpha_E, alpha_N, alpha_h [rad]           15    barometer bias [m]
    16-18 Markov part of the GNSS position [m, 16 and 17 reduced], 19-21 of its velocity [m/s]

In one respect each the filter goes beyond the source, as the register decides: the radii of the ellipsoid and
Somigliana's gravity in place of a sphere (A-5.1.10, A-5.1.4g), seven measurements in place of eight
(A-5.4.8R), coning and sculling of the previous interval, and the lever arm of the GNSS antenna (section 10).

It shares with the compiled filters the datasheets, the Earth and the choice of rows of a record; Joseph's
covariance is `filterpy`'s, and everything else is its own, so that one can be held against the other.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from bench.arrays import FloatArray
from bench.data import EventRow, Events, InitialState, Innovations, NavSolution, SensorData
from bench.navigation import alignment, timeline
from bench.navigation.blocks import GNSS_MARKOV
from bench.navigation.classic.filter_loop import SENSORS, FilterLoop
from bench.navigation.classic.navigator import FRD_OF_FUR
from bench.navigation.error_state import StateLayout
from bench.navigation.measurements import BARO, FIXES, unmodelled
from bench.navigation.options import ClassicOptions, read_options
from bench.navigation.restart import run_between_gaps
from bench.specs import AssumedSpecs


class Classic22:
    """The 22-state filter of the source, slow and readable: the oracle of `loose-22`.

    It follows the register step by step: 5.1.2 to 5.1.4 at every IMU sample, (5.4.4) at the covariance rate
    and at every measurement and output, then the seven rows of (5.4.3) that have arrived, tested sub-vector
    by sub-vector, (5.4.5) with what passed, and the correction (5.4.8) to (5.4.11) or none. Outputs are
    corrected by what the filter knows and has not fed back. A fix is used with the barometer reading of the
    same IMU sample.

    Options: `bench.navigation.options.ClassicOptions`.
    """

    needs = ("fixes",)
    model: type[ClassicOptions] = ClassicOptions

    def __init__(self, **options: Any) -> None:
        self.options: ClassicOptions = read_options(self.model, options)

    def run(self, sensors: SensorData, initial: InitialState) -> NavSolution:
        """Estimate position, velocity, attitude, sensor errors and their covariance."""
        for record, name in ((sensors.baro, "baro"), (sensors.fixes, "gnss")):
            if record is not None and getattr(sensors.specs, name) is None:
                raise ValueError(f"the record holds {name} data, but sensors.assumed names no {name} unit")
        return run_between_gaps(self._run, sensors, initial, "datasheet")

    def _run(self, sensors: SensorData, initial: InitialState) -> NavSolution:
        initial, aligned = alignment.complete(sensors, initial)
        rows, span, events = timeline.imu_rows(sensors.imu, initial.t, sensors.specs.imu)
        events += aligned
        nowhere = np.empty(0)
        steps = timeline.steps(sensors.imu, rows, span, initial.t, nowhere, nowhere)
        t = steps.t
        arrived: dict[int, list[tuple[int | None, int | None]]] = {}
        fixes, baro = sensors.fixes, sensors.baro
        if fixes is not None:
            used, at, left = timeline.fix_rows(fixes, t, initial.t)
            events += left
            for row, k in zip(used.tolist(), at.tolist(), strict=True):
                arrived.setdefault(k, []).append((row, None))
        if baro is not None:
            used, at, left = timeline.aiding_rows(baro, baro.alt_baro[:, None], "baro", t, initial.t)
            events += left
            for row, k in zip(used.tolist(), at.tolist(), strict=True):
                waiting = arrived.setdefault(k, [])
                if waiting and waiting[-1][1] is None:
                    waiting[-1] = (waiting[-1][0], row)
                else:
                    waiting.append((None, row))

        share = steps.share[:, None]
        dtheta = (steps.dtheta_b[steps.row] * share @ FRD_OF_FUR).tolist()
        dvel = (steps.dvel_b[steps.row] * share @ FRD_OF_FUR).tolist()
        interval = (1.0 - 1e-6) / self.options.covariance_hz
        wanted = sensors.output_t
        served = wanted >= initial.t - timeline.TIME_TOLERANCE
        served &= wanted <= (t[-1] if len(t) else initial.t) + timeline.TIME_TOLERANCE
        output_at = np.searchsorted(t, wanted[served] - timeline.TIME_TOLERANCE)
        output_at[wanted[served] < initial.t + timeline.TIME_TOLERANCE] = -1
        outputs: dict[int, int] = {}
        for k in output_at.tolist():
            outputs[k] = outputs.get(k, 0) + 1

        flight = self.make_loop(sensors, initial)
        if len(t):  # what is measured at the start sees the rate of the first sample
            flight.w_b = np.array(dtheta[0]) / steps.span[0]
        for fix_row, baro_row in arrived.get(-1, ()):
            flight.update(initial.t, fix_row, baro_row)
        answers = [flight.answer(initial.t)] * outputs.get(-1, 0)
        for k, (now, dt) in enumerate(zip(t.tolist(), steps.span.tolist(), strict=True)):
            flight.advance(dt, dtheta[k], dvel[k], steps.unknown[k])
            if k in arrived or k in outputs or flight.elapsed >= interval:
                flight.predict()
            for fix_row, baro_row in arrived.get(k, ()):
                flight.update(now, fix_row, baro_row)
            if k in outputs:
                answers += [flight.answer(now)] * outputs[k]
        return _solution(sensors, served, answers, flight, events)

    def make_loop(self, sensors: SensorData, initial: InitialState) -> FilterLoop:
        """Return navigator and filter at the start of a record."""
        return FilterLoop(self.options, sensors, initial)

    def unmodelled(self, specs: AssumedSpecs) -> tuple[str, ...]:
        """Return the errors of these sensors that the estimator has no state for, in words."""
        found = unmodelled(specs, (FIXES, BARO), GNSS_MARKOV.takes)
        for name, triad in (("gyro", specs.imu.gyro), ("accelerometer", specs.imu.accel)):
            if triad.bias_instability > 0 and triad.turn_on_bias_sd == 0 and triad.bias_model != "flicker":
                found += (f"{name} bias instability that fades (taken as a random walk)",)
        return found


def _solution(
    sensors: SensorData,
    served: Any,
    answers: list[tuple[FloatArray, ...]],
    flight: FilterLoop,
    events: list[EventRow],
) -> NavSolution:
    for name in list(flight.refused):
        flight.close(name)
    m = len(sensors.output_t)
    columns = [np.full((m, *shape), np.nan) for shape in ((3,), (3,), (4,), (13,), (13,), (9, 9))]
    for column, values in zip(columns, zip(*answers, strict=True), strict=False):
        column[served] = np.array(values)
    lla, vel_n, q_nb, states, sd, cov = columns
    layout = StateLayout(("baro_bias", "m", 1), ("gnss_pos", "m", 3), ("gnss_vel", "m_s", 3))
    return NavSolution(
        t=sensors.output_t,
        lla=lla,
        vel_n=vel_n,
        q_nb=q_nb,
        gyro_bias_b=states[:, :3],
        accel_bias_b=states[:, 3:6],
        cov=cov,
        extra_names=layout.labels(),
        extra=states,
        extra_sd=sd,
        innovations=Innovations.from_rows(SENSORS, flight.innovations),
        events=Events.from_rows(events + flight.events),
    )
