"""Fly a plan in JSBSim and record truth.

JSBSim steps at the smallest multiple of the truth rate that is at least 400 Hz. Each
step gives position, velocity and attitude, nothing else: the rates and accelerations
JSBSim reports lag or lead them and are not used. Truth is the motion of the IMU; JSBSim
moves the centre of gravity. Air data, controls and the sequencer run at 20 Hz.
"""

from __future__ import annotations

import math
from array import array
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from bench.arrays import FloatArray
from bench.data import Controls, Events, Trajectory
from bench.errors import FlightError
from bench.flight.increments import (
    Motion,
    at_point,
    earth_relative,
    step_increments,
    true_integrals,
)
from bench.flight.model import Condition, Trim, load, node, settle, trim
from bench.flight.sequencer import Cockpit, FlownLeg, engage, fly_legs
from bench.flight.shaping import GUIDANCE_RATE
from bench.flight.standing import stand
from bench.flight.tape import AIR, MOTION, air_data, motion_of_cg
from bench.flight.units import FT
from bench.flight.wind import Weather, start_turbulence
from bench.specs import FlightSpec

PIECE = 30.0
"""How much of a flight is kept in memory at a time [s]."""

_LEAST_RATE = 400.0  # of JSBSim [Hz]
_NEIGHBOURS = 3  # steps on either side of a stretch that its truth depends on: 2 by velocity, 1 by increments
_CLEAR = 50.0  # wheels off the ground for the trim of a flight that starts on it [m]
_SLOW = (  # at 20 Hz, with the factor to SI
    *AIR,
    ("motor/speed-rad_sec", 1.0),
    ("fcs/aileron-cmd-norm", 1.0),
    ("fcs/elevator-cmd-norm", 1.0),
    ("fcs/rudder-cmd-norm", 1.0),
    ("guidance/throttle-cmd-norm", 1.0),
)


def fly_pieces(
    spec: FlightSpec, progress: Callable[[float], None] | None = None, seconds: float = PIECE
) -> Iterator[Trajectory]:
    """Fly a plan and yield the truth in pieces, so that a long flight needs no more memory than a short one.

    A piece begins with the instant at which the one before ends; air data and controls of that
    instant are in the earlier one, the legs in the last. Put together the pieces are one of
    infinitely many seconds, bit for bit; the same plan gives the same bits in any process.

    Parameters
    ----------
    spec : FlightSpec
        The plan; its rate is a multiple of 20 Hz.
    progress : callable, optional
        Called with the time flown so far [s], once per second of flight.
    seconds : float
        Length of a piece [s].

    Yields
    ------
    Trajectory
        Truth at spec.rate from t = 0, of the IMU; air data and controls of the aircraft; the flown
        legs as events of kind "leg".

    Raises
    ------
    FlightError
        When the aircraft cannot be loaded, trimmed, or flown as planned.
    """
    return map(to_trajectory, record(spec, progress, seconds=seconds))


@dataclass(frozen=True, slots=True)
class Recording:
    """What JSBSim did, a stretch of it: motion at every step, air data and controls at 20 Hz."""

    rate: float  # of truth [Hz]
    substeps: int  # steps per truth sample
    first: int  # the tick of 20 Hz at which the stretch begins
    motion: Motion  # of the IMU, one step beyond the stretch, and from one before it on (unless first is 0)
    slow: FloatArray  # (A, 14) air data and controls, SI; the first instant only of the first stretch
    legs: tuple[FlownLeg, ...]  # of the whole flight, with its last stretch


def record(
    spec: FlightSpec, progress: Callable[[float], None] | None = None, *, seconds: float = PIECE
) -> Iterator[Recording]:
    """Fly a plan and yield the states of every step, in stretches of so many seconds.

    Parameters and errors as for :func:`fly_pieces`.
    """
    substeps, dt = simulation_step(spec.rate)
    fdm, cockpit = prepare(spec, dt)
    read_motion = [node(fdm, name).get_double_value for name in MOTION]
    read_slow = [node(fdm, name).get_double_value for name, _ in _SLOW]
    per_tick, run = round(1.0 / (GUIDANCE_RATE * dt)), fdm.run
    steps = range(per_tick)
    stretch = seconds * GUIDANCE_RATE
    flown: list[FlownLeg] = []
    states, slow = array("d"), array("d")  # not yet handed out
    keep = states.extend
    begun = tick = 0  # where the present stretch begins, and the present instant [1 / 20 Hz]
    q_nb = None  # at the end of the last stretch

    def cut(end: int) -> Recording:
        """Take the stretch from ``begun`` to the tick ``end`` out of ``states`` and ``slow``."""
        nonlocal begun, q_nb
        first, before = begun, _NEIGHBOURS if begun else 0
        rows = before + (end - first) * per_tick + 1 + _NEIGHBOURS
        slow_rows = end - first if first else end + 1
        motion = _motion(spec.aircraft.imu_b, dt, _table(states, rows, MOTION), before, q_nb)
        si = _table(slow, slow_rows, _SLOW) * [unit for _, unit in _SLOW]
        del states[: (rows - 2 * _NEIGHBOURS - 1) * len(MOTION)]
        del slow[: slow_rows * len(_SLOW)]
        begun, q_nb = end, motion.q_nb[-2]
        return Recording(spec.rate, substeps, first, motion, si, tuple(flown) if end == tick else ())

    keep([read() for read in read_motion])
    for t in fly_legs(cockpit, spec, flown, Weather(fdm, spec)):
        slow.extend([read() for read in read_slow])
        for _ in steps:
            run()
            keep([read() for read in read_motion])
        tick += 1
        if tick - begun > stretch:  # one more than it takes: its last steps need their neighbours
            yield cut(tick - 1)
        if progress is not None and t % 1.0 == 0.0:
            progress(t)
    slow.extend([read() for read in read_slow])
    for _ in range(_NEIGHBOURS):
        run()
        keep([read() for read in read_motion])
    yield cut(tick)


def _table(values: array[float], rows: int, names: Sequence[object]) -> FloatArray:
    columns = len(names)
    return np.array(values[: rows * columns]).reshape(rows, columns)


def _motion(
    imu_b: tuple[float, float, float], dt: float, states: FloatArray, before: int, q_nb: FloatArray | None
) -> Motion:
    """Return the motion of the IMU of states (K, 12) that begin so many steps before the stretch.

    The stretch itself and one step on either side; its attitude goes on from q_nb (4,) without a change
    of sign.
    """
    motion = at_point(motion_of_cg(dt, states), imu_b)
    if q_nb is None:
        return motion
    kept = slice(before - 1, None)
    sign = np.copysign(1.0, motion.q_nb[before] @ q_nb)
    return Motion(
        dt,
        motion.epa[kept],
        motion.pos_i[kept],
        motion.vel_i[kept],
        sign * motion.q_nb[kept],
        motion.q_ib[kept],
    )


def to_trajectory(recording: Recording) -> Trajectory:
    """Return truth with the exact increments of a recording, summed to the truth rate."""
    motion, substeps, slow = recording.motion, recording.substeps, recording.slow
    before = 1 if recording.first else 0
    alpha, beta = (column[before:] for column in true_integrals(*step_increments(motion)))
    at = slice(before, before + len(alpha) + 1, substeps)
    lla, vel_n = earth_relative(motion.epa[at], motion.pos_i[at], motion.vel_i[at])
    row = round(recording.first * recording.rate / GUIDANCE_RATE)
    t_slow = (recording.first + before + np.arange(len(slow))) / GUIDANCE_RATE
    return Trajectory(
        t=np.arange(row, row + len(lla)) / recording.rate,
        lla=lla,
        vel_n=vel_n,
        q_nb=motion.q_nb[at],
        dtheta_b=alpha.reshape(-1, substeps, 3).sum(axis=1),
        dvel_b=beta.reshape(-1, substeps, 3).sum(axis=1),
        air=air_data(t_slow, slow, slow[:, 9]),
        controls=Controls(t_slow, *slow[:, 10:].T),
        events=Events.from_rows([(leg.start, leg.end, "leg", leg.text) for leg in recording.legs]),
    )


def simulation_step(rate: float) -> tuple[int, float]:
    """Return the steps per truth sample and the step [s]: the least multiple of rate from 400 Hz on.

    Examples
    --------
    >>> simulation_step(200.0)
    (2, 0.0025)

    Raises
    ------
    FlightError
        When rate is not a multiple of 20 Hz, the rate of set-points and air data.
    """
    if rate <= 0 or rate % GUIDANCE_RATE:
        raise FlightError(f"a truth rate of {rate:g} Hz is not a multiple of {GUIDANCE_RATE:g} Hz")
    substeps = max(1, math.ceil(_LEAST_RATE / rate))
    return substeps, 1.0 / (rate * substeps)


def prepare(spec: FlightSpec, dt: float) -> tuple[Any, Cockpit]:
    """Return the model at the start of the plan in its wind, trimmed or standing, and its guidance."""
    fdm = load(spec.aircraft, dt)
    return fdm, begin(fdm, spec, trim)


def begin(
    fdm: Any,
    spec: FlightSpec,
    trim: Callable[[Any, Condition], Trim],
    idle: Callable[[Any], None] = lambda fdm: None,
) -> Cockpit:
    """Put a model at the start of the plan, by a way to trim it and one to let its engines idle."""
    if spec.runway is not None:
        fdm["ic/terrain-elevation-ft"] = spec.runway.alt / FT
    north, east, down = (float(v) for v in Weather(fdm, spec).wind_at(spec.alt))
    condition = Condition(spec.lat, spec.lon, spec.alt, spec.heading, spec.speed, wind_n=(north, east, down))
    if spec.on_ground:
        trimmed = trim(fdm, replace(condition, alt=spec.alt + _CLEAR))  # of the climb to come
        stand(fdm, condition, idle)
    else:
        trimmed = trim(fdm, condition)
        settle(fdm)
    cockpit = engage(fdm, spec, trimmed)
    start_turbulence(fdm, spec.severity, spec.turbulence_seed, spec.turbulence_model)
    return cockpit
