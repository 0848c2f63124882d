"""What JSBSim does with any model, step by step, and truth made of it.

The recipe is that of the bench's own aircraft (`bench.flight.increments`): position,
velocity and attitude of every step, nothing else. Two things are different with models
of others:

- Their centre of gravity moves while tanks empty, and JSBSim reports the motion of that
  point. Truth is the motion of a fixed point of the body, the centre of gravity at the
  start or the IMU beside it: with the offset l from the present centre to it, C l is added to
  the position and its derivative to the velocity. A jump of the centre (a load is dropped) does not
  move the body: the offset of such a step is left out.
- Their integrators are their own. Position is the velocity integrated by the trapezoid,
  so that the increments replay it exactly; it stays within the integration error of JSBSim.
"""

from __future__ import annotations

import math
from array import array
from collections.abc import Callable, Iterator
from dataclasses import fields, replace
from typing import Any, TypeVar

import numpy as np

from bench.arrays import FloatArray
from bench.data import AirData, Controls, Events, Trajectory, no_air, no_controls
from bench.earth import matrix_en, to_geodetic
from bench.errors import FlightError
from bench.flight.increments import (
    Motion,
    derivative,
    earth_relative,
    from_states,
    step_increments,
    true_integrals,
)
from bench.flight.shaping import GUIDANCE_RATE
from bench.flight.units import FT, KT, PSF, RANKINE
from bench.rotation import conjugate, continuous, from_matrix, multiply, rotate

INCH = 0.0254  # [m]
_Record = TypeVar("_Record", AirData, Controls)
MOTION = (
    *(f"position/eci-{axis}-ft" for axis in "xyz"),
    *(f"velocities/eci-{axis}-fps" for axis in "xyz"),
    *(f"attitude/{angle}-rad" for angle in ("phi", "theta", "psi")),
    "position/lat-geod-rad",
    "position/long-gc-rad",
    "position/epa-rad",
)
"""What truth is made of, per step."""
AIR = (
    ("atmosphere/P-psf", PSF),
    ("atmosphere/T-R", RANKINE),
    ("velocities/vt-fps", FT),
    ("velocities/vc-kts", KT),
    ("aero/alpha-rad", 1.0),
    ("aero/beta-rad", 1.0),
    *((f"atmosphere/total-wind-{axis}-fps", FT) for axis in ("north", "east", "down")),
)
"""Air data at 20 Hz, with the factor to SI."""
_STATES = (*MOTION, *(f"inertia/cg-{axis}-in" for axis in "xyz"))
_SLOW = (  # at 20 Hz, with the factor to SI; what a model does not have is 0
    *AIR,
    *((f"fcs/{name}-cmd-norm", 1.0) for name in ("aileron", "elevator", "rudder", "throttle")),
    ("position/h-agl-ft", FT),
    ("velocities/v-down-fps", FT),
)
_AGL, _DOWN = 13, 14
_SPEEDS = ("propulsion/engine/propeller-rpm", "propulsion/engine/engine-rpm")
_RPM = math.pi / 30.0  # [rad/s]
_DROP = 1e-4  # the centre of gravity jumped when it moved further in one step [m]
_UNITS = 40  # gear legs and other contact points looked at


class Tape:
    """Keeps the states of every step and, at 20 Hz, air data, controls and ground contacts."""

    def __init__(self, fdm: Any, dt: float) -> None:
        manager = fdm.get_property_manager()

        def reader(name: str) -> Callable[[], float]:
            node = manager.get_node(name)
            return (lambda: 0.0) if node is None else node.get_double_value

        def contacts(kind: str) -> list[Callable[[], float]]:
            names = (f"{kind}/unit[{n}]/WOW" for n in range(_UNITS))
            return [manager.get_node(name).get_double_value for name in names if manager.get_node(name)]

        self.dt = dt
        self._motion = [reader(name) for name in _STATES]
        self._slow = [reader(name) for name, _ in _SLOW]
        self._speed = reader(next((name for name in _SPEEDS if manager.get_node(name)), "none"))
        self._wheels, self._structure = contacts("gear"), contacts("contact")
        self._states, self._ticks = array("d"), array("d")

    def step(self) -> None:
        """Keep the present state."""
        self._states.extend([read() for read in self._motion])

    def tick(self) -> None:
        """Keep the present air data, controls and contacts.

        Raises
        ------
        FlightError
            When the motion is no longer finite.
        """
        if not all(map(math.isfinite, self._states[-len(_STATES) :])):
            raise FlightError(f"the motion is no longer finite at {len(self) * self.dt:.2f} s")
        wheels = float(any(read() for read in self._wheels))
        structure = float(any(read() for read in self._structure))
        self._ticks.extend([*(read() for read in self._slow), self._speed(), wheels, structure])

    def __len__(self) -> int:
        """Return the number of steps kept after the first state."""
        return max(0, len(self._states) // len(_STATES) - 1)

    def columns(self) -> FloatArray:
        """Return the states, (K, 15) in the units of JSBSim."""
        return np.array(self._states).reshape(-1, len(_STATES))

    def ticks(self) -> Ticks:
        """Return what was kept at 20 Hz, in SI."""
        return Ticks(np.array(self._ticks).reshape(-1, len(_SLOW) + 3) * _FACTORS)


_FACTORS = np.array([*(unit for _, unit in _SLOW), _RPM, 1.0, 1.0])


class Ticks:
    """Air data, controls and ground contacts at 20 Hz, rows (A, 18) in SI."""

    def __init__(self, rows: FloatArray) -> None:
        self.rows = rows
        self.agl, self.sink = rows[:, _AGL], rows[:, _DOWN]
        self.wheels, self.structure = rows[:, -2] > 0, rows[:, -1] > 0

    def between(self, first: int, end: int) -> Ticks:
        """Return the rows [first, end)."""
        return Ticks(self.rows[first:end])

    def air(self) -> tuple[AirData, Controls]:
        """Return the records of truth, from t = 0; what is not finite is 0, and reported by sanity."""
        t = np.arange(len(self.rows)) / GUIDANCE_RATE
        rows = np.where(np.isfinite(self.rows), self.rows, 0.0)
        return air_data(t, rows, rows[:, 15]), Controls(t, *rows[:, 9:13].T)


def air_data(t: FloatArray, rows: FloatArray, engine_speed: FloatArray) -> AirData:
    """Return the air data of rows that begin with those of ``AIR``, in SI."""
    pressure, temperature, true, calibrated, attack, slip = rows[:, :6].T
    return AirData(
        t=t,
        pressure=pressure,
        temperature=temperature,
        airspeed_true=true,
        airspeed_calibrated=calibrated,
        alpha=attack,
        beta=slip,
        wind_n=rows[:, 6:9],
        engine_speed=engine_speed,
    )


def motion_of_cg(dt: float, columns: FloatArray) -> Motion:
    """Return the motion JSBSim reports, of the centre of gravity, from columns that begin with ``MOTION``."""
    return from_states(
        dt,
        epa=columns[:, 11],
        pos_i=FT * columns[:, 0:3],
        vel_i=FT * columns[:, 3:6],
        euler=columns[:, 6:9],
        lat_lon=columns[:, 9:11],
    )


def motion_of(dt: float, columns: FloatArray, imu_b: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> Motion:
    """Return the motion of a fixed point of the body: the IMU, by its place at the start.

    Parameters
    ----------
    dt : float
        Step [s].
    columns : (K, 15) array
        States as `Tape.columns` returns them: one continuous flight.
    imu_b : tuple
        The IMU relative to the centre of gravity at the start [m], b.

    Returns
    -------
    motion : Motion
        Without the last two rows, whose velocity would need two more.
    """
    motion = motion_of_cg(dt, columns)
    arm_i = rotate(motion.q_ib, imu_b + _offset(columns[:, 12:15]))
    vel_i = motion.vel_i[:-2] + derivative(arm_i, dt)
    pos_i = np.empty_like(vel_i)
    pos_i[0] = motion.pos_i[0] + arm_i[0]
    np.cumsum(0.5 * dt * (vel_i[1:] + vel_i[:-1]), axis=0, out=pos_i[1:])
    pos_i[1:] += pos_i[0]
    lat, lon, _ = np.moveaxis(to_geodetic(pos_i), -1, 0)  # longitude from the axis x of i
    q_ib = motion.q_ib[:-2]
    q_nb = continuous(multiply(conjugate(from_matrix(matrix_en(lat, lon))), q_ib))
    return Motion(dt, motion.epa[:-2], pos_i, vel_i, q_nb, q_ib)


def _offset(cg_in: FloatArray) -> FloatArray:
    """Return the offset (K, 3) from the present to the first centre of gravity [m], b.

    The structural frame of JSBSim has x aft, y right, z up, in inches.
    """
    moved = np.diff(INCH * cg_in, axis=0)
    moved[np.linalg.norm(moved, axis=1) > _DROP] = 0.0
    offset_b = np.zeros((len(cg_in), 3))
    np.cumsum(moved * [1.0, -1.0, 1.0], axis=0, out=offset_b[1:])  # minus the motion of the centre
    return offset_b


def truth_of(motion: Motion, substeps: int, events: list[tuple[float, float, str, str]]) -> Trajectory:
    """Return truth at every substeps-th step of a motion, without air data and controls."""
    alpha, beta = true_integrals(*step_increments(motion))
    n = len(alpha) // substeps
    at = slice(0, n * substeps + 1, substeps)
    lla, vel_n = earth_relative(motion.epa[at], motion.pos_i[at], motion.vel_i[at])
    return Trajectory(
        t=np.arange(n + 1) / round(1.0 / (motion.dt * substeps)),
        lla=lla,
        vel_n=vel_n,
        q_nb=motion.q_nb[at],
        dtheta_b=alpha[: n * substeps].reshape(n, substeps, 3).sum(axis=1),
        dvel_b=beta[: n * substeps].reshape(n, substeps, 3).sum(axis=1),
        air=no_air(),
        controls=no_controls(),
        events=Events.from_rows(events),
    )


def with_air(truth: Trajectory, ticks: Ticks) -> Trajectory:
    """Return truth with the air data and controls of its own duration."""
    last = math.floor(truth.t[-1] * GUIDANCE_RATE + 1e-9)
    air, controls = ticks.between(0, last + 1).air()
    return replace(truth, air=air, controls=controls)


def pieces(truth: Trajectory, seconds: float) -> Iterator[Trajectory]:
    """Yield a truth from t = 0 in pieces, as `bench.flight.recorder.fly_pieces` does."""
    end = len(truth) - 1
    length = max(1, round(min(seconds, truth.t[-1]) / truth.t[1]))
    taken = 0
    for start in range(0, max(end, 1), length):
        stop = min(start + length, end)
        ready = len(truth.air.t) if stop == end else int(np.searchsorted(truth.air.t, truth.t[stop], "right"))
        yield Trajectory(
            t=truth.t[start : stop + 1],
            lla=truth.lla[start : stop + 1],
            vel_n=truth.vel_n[start : stop + 1],
            q_nb=truth.q_nb[start : stop + 1],
            dtheta_b=truth.dtheta_b[start:stop],
            dvel_b=truth.dvel_b[start:stop],
            air=_rows(truth.air, taken, ready),
            controls=_rows(truth.controls, taken, ready),
            events=truth.events if stop == end else Events.from_rows([]),
        )
        taken = ready


def _rows(record: _Record, first: int, end: int) -> _Record:
    return type(record)(*(getattr(record, field.name)[first:end] for field in fields(record)))
