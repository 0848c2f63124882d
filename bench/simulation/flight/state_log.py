"""Motion of a JSBSim model, step by step.

Each step gives position, velocity and attitude, nothing else: the rates and accelerations JSBSim reports lag
or lead them and are not used. JSBSim moves the center of gravity, truth is the motion of the IMU. Two things
are different with models that were not made for the bench:

- Their center of gravity moves while tanks empty. The IMU is a fixed point of the body, given from the center
  of gravity at the start: with the offset l from the present center to it, C l is added to the position
  and its derivative to the velocity. A jump of the center (a load is dropped) does not move the body:
  the offset of such a step is left out.
- Their integrators are their own. Position is the velocity integrated by the trapezoid,
  so that the increments replay it exactly; it stays within the integration error of JSBSim.
"""

from __future__ import annotations

import math
from array import array
from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import Any

import numpy as np

from bench.core.mathematics.arrays import FloatArray, split_last
from bench.core.mathematics.earth import matrix_en, to_geodetic
from bench.core.mathematics.rotation import conjugate, continuous, from_matrix, multiply, rotate
from bench.core.records.data import EventRow
from bench.core.records.rotor_speeds import ROTORS
from bench.core.words.exceptions import FlightError
from bench.simulation.flight.executive import find_property
from bench.simulation.flight.guidance.shaping import GUIDANCE_RATE
from bench.simulation.flight.increments import Motion, at_point, derivative, from_states
from bench.simulation.flight.jsbsim_units import FT, INCH, KT, PSF, RANKINE, RPM
from bench.simulation.flight.truth import Stretch

NEIGHBORS = 3
"""Steps on either side of a segment that its truth depends on: 2 by velocity, 1 by increments."""

_MOTION = (  # per step
    *(f"position/eci-{axis}-ft" for axis in "xyz"),
    *(f"velocities/eci-{axis}-fps" for axis in "xyz"),
    *(f"attitude/{angle}-rad" for angle in ("phi", "theta", "psi")),
    "position/lat-geod-rad",
    "position/long-gc-rad",
    "position/epa-rad",
)
_CENTER = tuple(f"inertia/cg-{axis}-in" for axis in "xyz")
_ROTORS = tuple(f"rotor/speed{k}-rad_sec" for k in range(len(ROTORS)))
_AIR = (  # at 20 Hz, with the factor to SI
    ("atmosphere/P-psf", PSF),
    ("atmosphere/T-R", RANKINE),
    ("velocities/vt-fps", FT),
    ("velocities/vc-kts", KT),
    ("aero/alpha-rad", 1.0),
    ("aero/beta-rad", 1.0),
    *((f"atmosphere/total-wind-{axis}-fps", FT) for axis in ("north", "east", "down")),
)
_TRUE_SPEED, _ANGLES = 2, slice(4, 6)  # in the rows of _AIR
_FLOWS = 3.0  # airspeed below which the flow round what hovers has no direction to speak of [m/s]
_SURFACES = tuple((f"fcs/{name}-cmd-norm", 1.0) for name in ("aileron", "elevator", "rudder"))
_OWN = (*_AIR, ("motor/speed-rad_sec", 1.0), *_SURFACES, ("guidance/throttle-cmd-norm", 1.0))
_UNPOWERED = (*_AIR, ("guidance/thr-mode", 0.0), *_SURFACES, ("guidance/throttle-cmd-norm", 1.0))
_ENGINES = ("propulsion/engine/propeller-rpm", "propulsion/engine/engine-rpm")
_GROUND = (("position/h-agl-ft", FT), ("velocities/v-down-fps", FT))
_CONTACTS = 40  # gear legs and other contact points looked at
_PART = 12_000  # steps looked at at a time
_JUMP = 1e-4  # the center of gravity jumped when it moved further in one step [m]


class StateLog:
    """Log of the states at every step, and at 20 Hz of air data, controls and contacts.

    Parameters
    ----------
    fdm : FGFDMExec
        The model.
    dt : float
        Its step [s]; 20 Hz are a multiple of it.
    what : str
        How messages call it: "aircraft c310".
    imu_b : tuple
        The IMU relative to the center of gravity at the start [m], b.
    guided : bool
        Whether the model was made for the bench. Of others what they do not have is 0.
    hovers : bool
        Whether it flies without airspeed: angle of attack and sideslip of an airspeed below 3 m/s are then 0.
    glides : bool
        Whether it has no engine: the speed of one is then 0.
    four_rotors : bool
        Whether it has four rotors, whose speeds are stored.

    Raises
    ------
    FlightError
        When a model of the bench lacks a property.
    """

    def __init__(
        self,
        fdm: Any,
        dt: float,
        what: str,
        imu_b: tuple[float, float, float] = (0.0, 0.0, 0.0),
        *,
        guided: bool = False,
        hovers: bool = False,
        glides: bool = False,
        four_rotors: bool = False,
    ) -> None:
        manager = fdm.get_property_manager()

        def read(name: str) -> Callable[[], float]:
            node = find_property(fdm, name) if guided else manager.get_node(name)
            return (lambda: 0.0) if node is None else node.get_double_value

        def touch(kind: str) -> Callable[[], float]:
            nodes = (manager.get_node(f"{kind}/unit[{n}]/WOW") for n in range(_CONTACTS))
            reads = [node.get_double_value for node in nodes if node is not None]
            return lambda: float(any(read() for read in reads))

        engine = next((name for name in _ENGINES if manager.get_node(name)), "none")
        foreign = (*_AIR, (engine, RPM), *_SURFACES, ("fcs/throttle-cmd-norm", 1.0))
        own = _UNPOWERED if glides else _OWN
        slow = (*(own if guided else foreign), *_GROUND)
        names = (*_MOTION, *(_ROTORS if four_rotors else ())) if guided else (*_MOTION, *_CENTER)
        self.dt, self.per_tick = dt, round(1.0 / (GUIDANCE_RATE * dt))
        self._what, self._imu_b, self._guided, self._hovers = what, imu_b, guided, hovers
        self._four_rotors = four_rotors
        self._read_state = [read(name) for name in names]
        contacts = [touch("gear"), touch("contact")]
        self._read_slow = [*(read(name) for name, _ in slow), *contacts]
        self._units = np.array([*(unit for _, unit in slow), *(1.0 for _ in contacts)])
        self._states, self._slow = array("d"), array("d")  # of them the next segment is made
        self._extend = self._states.extend  # looked up once, not at every step
        self._given = 0  # rows of states that were handed out and are still there
        self._begun = 0  # the tick at which the next segment begins
        self._offset_b = np.zeros(3)  # from the present center of gravity to the first one [m]
        self._origin_i = self._moved_i = np.zeros(3)  # position of the IMU: at t = 0, and since then [m]

    def keep_state(self) -> None:
        """Store the state of this step."""
        self._extend([read() for read in self._read_state])

    def keep_air(self) -> None:
        """Store air data, controls and contacts of the last stored state, 20 times a second.

        Raises
        ------
        FlightError
            When the motion, or of a model of the bench the air data, is no longer finite.
        """
        values = [read() for read in self._read_slow]
        state = self._states[-len(self._read_state) :]
        if not math.isfinite(sum(state) + (sum(values) if self._guided else 0.0)):
            t = self._begun / GUIDANCE_RATE + (self._left() + NEIGHBORS) * self.dt
            raise FlightError(f"{self._what}: the motion is no longer finite at {t:.2f} s")
        if self._hovers and values[_TRUE_SPEED] * FT < _FLOWS:
            values[_ANGLES] = (0.0, 0.0)
        self._slow.extend(values)

    def count_steps(self) -> int:
        """Return the number of steps after the first stored state."""
        return max(0, len(self._states) // len(self._read_state) - 1)

    def motions_of_center(self) -> Iterator[Motion]:
        """Yield the motion of the center of gravity in parts that share their first and last rows."""
        for first in range(0, self.count_steps(), _PART):
            yield self._motion_of_center(self._table(first, first + _PART + 1))

    def leave_out(self, first: int, end: int) -> None:
        """Drop all data before the tick ``first``, the new t = 0, and from the step ``end`` on."""
        columns, slow = len(self._read_state), len(self._read_slow)
        del self._states[end * columns :], self._states[: first * self.per_tick * columns]
        del self._slow[((end - 1) // self.per_tick + 1) * slow :], self._slow[: first * slow]

    def cut(self, seconds: float, kept: int = 1) -> Iterator[Stretch]:
        """Yield segments of a length [s], while at least some more ticks are left."""
        ticks = max(1.0, round(seconds * GUIDANCE_RATE, 6))
        while self._left() >= (ticks + kept) * self.per_tick:
            yield self._cut(math.floor(ticks))

    def cut_rest(self, events: list[EventRow]) -> Stretch:
        """Return the rest of the flight, with the events of the whole flight."""
        return replace(self._cut(None), events=events)

    def _left(self) -> int:
        """Return the usable steps that are not yet returned in a segment."""
        return self.count_steps() - self._given - self._before() - NEIGHBORS

    def _before(self) -> int:
        return NEIGHBORS if self._begun else 0

    def _cut(self, ticks: int | None) -> Stretch:
        before, begun = self._before(), self._begun
        steps = self._left() + NEIGHBORS if ticks is None else ticks * self.per_tick + NEIGHBORS
        slow_end = len(self._slow) if ticks is None else (ticks + (not begun)) * len(self._read_slow)
        states = self._table(self._given, self._given + before + 1 + steps)
        slow = np.array(self._slow[:slow_end]).reshape(-1, len(self._read_slow)) * self._units
        motion = self._motion_of_imu(states, before)
        rotors = states[max(0, before - 1) :, len(_MOTION) :] if self._four_rotors else None
        self._given += len(states) - 2 * NEIGHBORS - 1
        if 2 * self._given > self.count_steps():
            del self._states[: self._given * len(self._read_state)]
            self._given = 0
        del self._slow[:slow_end]
        self._begun += ticks or 0
        return Stretch(begun * self.per_tick, motion, slow[:, :14], slow[:, 14:], rotors=rotors)

    def _table(self, first: int, end: int) -> FloatArray:
        columns = len(self._read_state)
        return np.array(self._states[first * columns : end * columns]).reshape(-1, columns)

    def _motion_of_center(self, states: FloatArray) -> Motion:
        """Return the motion that JSBSim reports, from states (K, 12 or more columns)."""
        pos_i, vel_i = FT * states[:, 0:3], FT * states[:, 3:6]
        return from_states(self.dt, states[:, 11], pos_i, vel_i, states[:, 6:9], states[:, 9:11])

    def _motion_of_imu(self, states: FloatArray, before: int) -> Motion:
        """Return the motion of the IMU from states that begin some steps before the segment.

        From one step before the segment to all but the last two rows, whose velocity would need two more.
        """
        center = self._motion_of_center(states)
        begin = max(0, before - 1)
        if self._guided:
            return at_point(center, self._imu_b).select(slice(begin, None))
        kept = center.select(slice(begin, -2))
        moved = np.diff(INCH * states[:, 12:15], axis=0)  # x aft, y right, z up
        moved[np.linalg.norm(moved, axis=1) > _JUMP] = 0.0
        offset_b = np.cumsum(np.vstack([self._offset_b, moved * [1.0, -1.0, 1.0]]), axis=0)
        arm_i = rotate(center.q_ib, self._imu_b + offset_b)
        vel_i = kept.vel_i + derivative(arm_i, self.dt)[begin:]
        steps = 0.5 * self.dt * (vel_i[1:] + vel_i[:-1])
        moved_i = np.cumsum(np.vstack([self._moved_i, steps]), axis=0)
        if not before:
            self._origin_i = center.pos_i[0] + arm_i[0]
        pos_i = self._origin_i + moved_i
        # where the states of the next segment begin, and where its motion does
        self._offset_b, self._moved_i = offset_b[-2 * NEIGHBORS - 1], moved_i[-3]
        lat, lon, _ = split_last(to_geodetic(pos_i))  # longitude from the axis x of i
        q_nb = continuous(multiply(conjugate(from_matrix(matrix_en(lat, lon))), kept.q_ib))
        return replace(kept, pos_i=pos_i, vel_i=vel_i, q_nb=q_nb)
