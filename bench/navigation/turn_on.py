"""A large turn-on bias of the gyros, learnt over the first seconds before a linear filter takes it.

In straight flight no measurement shows the heading. A bias of degrees per second turns it by tens of degrees
until the first turn, and a linear filter is then lost. So the mean rate over a stretch in which the course
stays is taken for the bias: the attitude of a vehicle that flies or drives straight changes little. At rest
it does not change at all. The filter begins again at the start with what is left of the bias; until the end
of the stretch its answers are those without this knowledge.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, fields, replace

import numpy as np

from bench import rotation
from bench.arrays import FloatArray
from bench.data import EventRow, Events, ImuData, InitialState, NavSolution, SensorData
from bench.navigation import standstill, timeline
from bench.navigation.course import LEAST_SPEED
from bench.navigation.hypotheses import Settled
from bench.navigation.standstill import StandstillDetector
from bench.navigation.waiting import take_rows

LARGE = float(np.deg2rad(0.5))  # sd of a bias that turns the heading by 10 deg in 20 s [rad/s]
LONGEST, SHORTEST = 20.0, 5.0  # stretch [s]
STRAIGHT = float(np.deg2rad(10.0))  # largest change of the course in it [rad]
TURNED_SD = float(np.deg2rad(5.0))  # of the change of each angle that the course does not show [rad]
STILL = 0.5  # largest speed over ground at rest, by fixes [m/s]
STILL_SD = float(np.deg2rad(0.1))  # of the change of an angle at rest, with the Earth's turn [rad]

Run = Callable[[SensorData, InitialState, float | None], NavSolution]


@dataclass(frozen=True, slots=True)
class TurnOn:
    """A bias of the gyros, and how well it is known."""

    bias_b: FloatArray  # (3,) [rad/s], b
    sd: float  # [rad/s]
    until: float  # end of the stretch that it comes from [s]


def run_from_turn_on(run: Run, sensors: SensorData, initial: InitialState) -> NavSolution:
    """Return the solution of a filter that gets a large bias of the gyros taken off its increments.

    Parameters
    ----------
    run : callable
        The filter: record, start and sd of what is left of the bias [rad/s], None for that of the datasheet.
    sensors, initial : SensorData, InitialState
        Record and start.
    """
    found = find_turn_on(sensors, initial)
    if found is None:
        return run(sensors, initial, None)
    imu, rows = sensors.imu, ~(sensors.imu.t > found.until)
    cut = ImuData(**{f.name: getattr(imu, f.name)[rows] for f in fields(imu)})
    begun = sensors.output_t[sensors.output_t <= found.until]
    early = run(replace(sensors, imu=cut, output_t=begun), initial, None)
    late = _run_without(found, run, sensors, initial)
    return Settled(initial, early, True, late.events.rows()[0]).join(late)


def smooth_from_turn_on(run: Run, sensors: SensorData, initial: InitialState) -> NavSolution:
    """Return what `run_from_turn_on` does of a smoother: it knows the stretch from its first answer on."""
    found = find_turn_on(sensors, initial)
    return run(sensors, initial, None) if found is None else _run_without(found, run, sensors, initial)


def _run_without(found: TurnOn, run: Run, sensors: SensorData, initial: InitialState) -> NavSolution:
    """Return the solution of a filter that gets a bias taken off its increments, the event first."""
    imu = sensors.imu
    less = replace(imu, dtheta_b=imu.dtheta_b - found.bias_b * imu.dt[:, None])
    solution = run(replace(sensors, imu=less), initial, found.sd)
    extra = solution.extra.copy()
    extra[:, :3] += found.bias_b
    text = f"turn-on bias of the gyros by their mean rate, left {np.rad2deg(found.sd):.2g} deg/s"
    event: EventRow = (initial.t, found.until, "alignment", text)
    return replace(
        solution,
        gyro_bias_b=solution.gyro_bias_b + found.bias_b,
        extra=extra,
        events=Events.from_rows([event, *solution.events.rows()]),
    )


def find_turn_on(sensors: SensorData, initial: InitialState) -> TurnOn | None:
    """Return the bias of the gyros by a stretch at the start; None if it is small or there is no stretch.

    The attitude at the start has to be given.
    """
    fixes, spec = sensors.fixes, sensors.specs.imu
    if spec.gyro.turn_on_bias_sd < LARGE or fixes is None or initial.alignment != "given":
        return None
    used, _, _ = timeline.fix_rows(fixes, sensors.imu.t, initial.t)
    used = used[(fixes.t_arrival[used] <= initial.t + LONGEST) & np.isfinite(fixes.vel_n[used]).all(axis=1)]
    t, vel_n = fixes.t[used], fixes.vel_n[used]
    speed = np.hypot(vel_n[:, 0], vel_n[:, 1])
    rows, _, _ = timeline.imu_rows(sensors.imu, initial.t, spec)
    if not len(t):
        return None
    if (speed < STILL).all():
        inside = rows[sensors.imu.t[rows] <= initial.t + LONGEST]
        ends, rate_b, _ = StandstillDetector(initial.t, spec).take(take_rows(sensors.imu, inside))
        span = len(ends) * standstill.WINDOW
        if span < SHORTEST:
            return None
        return TurnOn(rate_b.mean(axis=0), STILL_SD / span, float(ends[-1]))
    course = np.unwrap(np.arctan2(vel_n[:, 1], vel_n[:, 0]))
    straight = (np.abs(course - course[0]) < STRAIGHT) & (speed > LEAST_SPEED)
    count = len(t) if straight.all() else int(np.argmin(straight))
    if count < 2 or t[count - 1] - t[0] < SHORTEST:
        return None
    first, end = float(t[0]), float(t[count - 1])
    inside = rows[(sensors.imu.t[rows] > first) & (sensors.imu.t[rows] <= end)]
    span = float(sensors.imu.dt[inside].sum())
    turn_n = np.array([0.0, 0.0, (course[count - 1] - course[0]) / span])
    turn_b = rotation.rotate(rotation.conjugate(initial.q_nb), turn_n)
    mean = sensors.imu.dtheta_b[inside].sum(axis=0) / span
    return TurnOn(mean - turn_b, TURNED_SD / span, float(fixes.t_arrival[used[count - 1]]))
