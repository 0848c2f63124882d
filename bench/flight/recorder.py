"""Fly a plan in JSBSim and record truth.

JSBSim steps at the smallest multiple of the truth rate that is at least 400 Hz. Each
step gives position, velocity and attitude, nothing else: the rates and accelerations
JSBSim reports lag or lead them and are not used. Air data, controls and the
sequencer run at 20 Hz.
"""

from __future__ import annotations

import math
from array import array
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from bench.arrays import FloatArray
from bench.data import AirData, Controls, Events, Trajectory
from bench.flight.increments import Motion, earth_relative, from_states, step_increments, true_integrals
from bench.flight.model import Condition, FlightError, load, node, settle, trim
from bench.flight.sequencer import RATE as TICK_RATE
from bench.flight.sequencer import Cockpit, FlownLeg, engage, fly_legs
from bench.flight.units import FT, KT, PSF, RANKINE
from bench.flight.wind import air_velocity, start_turbulence
from bench.specs import FlightSpec

_LEAST_RATE = 400.0  # of JSBSim [Hz]
_MOTION = (  # what truth is made of, per step
    "position/eci-x-ft",
    "position/eci-y-ft",
    "position/eci-z-ft",
    "velocities/eci-x-fps",
    "velocities/eci-y-fps",
    "velocities/eci-z-fps",
    "attitude/phi-rad",
    "attitude/theta-rad",
    "attitude/psi-rad",
    "position/lat-geod-rad",
    "position/long-gc-rad",
    "position/epa-rad",
)
_SLOW = (  # at 20 Hz, with the factor to SI
    ("atmosphere/P-psf", PSF),
    ("atmosphere/T-R", RANKINE),
    ("velocities/vt-fps", FT),
    ("velocities/vc-kts", KT),
    ("aero/alpha-rad", 1.0),
    ("aero/beta-rad", 1.0),
    ("atmosphere/total-wind-north-fps", FT),
    ("atmosphere/total-wind-east-fps", FT),
    ("atmosphere/total-wind-down-fps", FT),
    ("motor/speed-rad_sec", 1.0),
    ("fcs/aileron-cmd-norm", 1.0),
    ("fcs/elevator-cmd-norm", 1.0),
    ("fcs/rudder-cmd-norm", 1.0),
    ("guidance/throttle-cmd-norm", 1.0),
)


def fly(spec: FlightSpec, progress: Callable[[float], None] | None = None) -> Trajectory:
    """Fly a plan; the same plan gives the same bits in any process.

    Parameters
    ----------
    spec : FlightSpec
        The plan; its rate is a multiple of 20 Hz.
    progress : callable, optional
        Called with the time flown so far [s], once per second of flight.

    Returns
    -------
    Trajectory
        Truth at spec.rate from t = 0, the flown legs as events of kind "leg".

    Raises
    ------
    FlightError
        When the aircraft cannot be loaded, trimmed, or flown as planned.
    """
    return to_trajectory(record(spec, progress))


@dataclass(frozen=True, slots=True)
class Recording:
    """What JSBSim did: motion at every step and one step beyond, air data and controls at 20 Hz."""

    rate: float  # of truth [Hz]
    motion: Motion
    substeps: int  # steps per truth sample
    slow: FloatArray  # (A, 14) air data and controls, SI
    legs: tuple[FlownLeg, ...]


def record(spec: FlightSpec, progress: Callable[[float], None] | None = None) -> Recording:
    """Fly a plan and keep the states of every step; parameters and errors as for :func:`fly`."""
    substeps, dt = simulation_step(spec.rate)
    fdm, cockpit = prepare(spec, dt)
    read_motion = [node(fdm, name).get_double_value for name in _MOTION]
    read_slow = [node(fdm, name).get_double_value for name, _ in _SLOW]
    steps, run = range(round(1.0 / (TICK_RATE * dt))), fdm.run
    flown: list[FlownLeg] = []
    states, slow = array("d"), array("d")
    keep = states.extend
    keep([read() for read in read_motion])
    for t in fly_legs(cockpit, spec, flown):
        slow.extend([read() for read in read_slow])
        for _ in steps:
            run()
            keep([read() for read in read_motion])
        if progress is not None and t % 1.0 == 0.0:
            progress(t)
    slow.extend([read() for read in read_slow])
    run()  # one more: the last increment needs its neighbour
    keep([read() for read in read_motion])
    columns = np.array(states).reshape(-1, len(_MOTION))
    motion = from_states(
        dt,
        epa=columns[:, 11],
        pos_i=FT * columns[:, 0:3],
        vel_i=FT * columns[:, 3:6],
        euler=columns[:, 6:9],
        lat_lon=columns[:, 9:11],
    )
    si = np.array(slow).reshape(-1, len(_SLOW)) * [unit for _, unit in _SLOW]
    return Recording(spec.rate, motion, substeps, si, tuple(flown))


def to_trajectory(recording: Recording) -> Trajectory:
    """Return truth with the exact increments of a recording, summed to the truth rate."""
    motion, substeps, slow = recording.motion, recording.substeps, recording.slow
    alpha, beta = true_integrals(*step_increments(motion))
    at = slice(0, len(alpha) + 1, substeps)
    lla, vel_n = earth_relative(motion.epa[at], motion.pos_i[at], motion.vel_i[at])
    t_slow = np.arange(len(slow)) / TICK_RATE
    pressure, temperature, true, calibrated, attack, slip = slow[:, :6].T
    return Trajectory(
        t=np.arange(len(lla)) / recording.rate,
        lla=lla,
        vel_n=vel_n,
        q_nb=motion.q_nb[at],
        dtheta_b=alpha.reshape(-1, substeps, 3).sum(axis=1),
        dvel_b=beta.reshape(-1, substeps, 3).sum(axis=1),
        air=AirData(
            t=t_slow,
            pressure=pressure,
            temperature=temperature,
            airspeed_true=true,
            airspeed_calibrated=calibrated,
            alpha=attack,
            beta=slip,
            wind_n=slow[:, 6:9],
            engine_speed=slow[:, 9],
        ),
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
    if rate <= 0 or rate % TICK_RATE:
        raise FlightError(f"a truth rate of {rate:g} Hz is not a multiple of {TICK_RATE:g} Hz")
    substeps = max(1, math.ceil(_LEAST_RATE / rate))
    return substeps, 1.0 / (rate * substeps)


def prepare(spec: FlightSpec, dt: float) -> tuple[Any, Cockpit]:
    """Return the model, trimmed at the start of the plan in its wind, and its engaged guidance."""
    fdm = load(spec.aircraft, dt)
    north, east, down = (float(v) for v in air_velocity(spec.wind_from, spec.wind_speed))
    condition = Condition(spec.lat, spec.lon, spec.alt, spec.heading, spec.speed, wind_n=(north, east, down))
    trimmed = trim(fdm, condition)
    settle(fdm)
    cockpit = engage(fdm, spec, trimmed)
    start_turbulence(fdm, spec.severity, spec.turbulence_seed)
    return fdm, cockpit
