"""State that guidance and legs use: the truth, or the estimate of a navigation filter.

``held``: truth plus the error of the last estimate, estimate minus truth at its validity. An ideal filter
changes nothing. ``state``: the last estimate itself, late and in steps, like the output of a navigation
system without extrapolation. Both move from one estimate to the next within 50 ms, because a step between two
samples would put a corner into the truth that no sensor record can follow. The body rates are measured: truth
plus the error of the gyro bias.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from bench.core.mathematics import rotation
from bench.core.mathematics.arrays import FloatArray
from bench.core.mathematics.earth import matrix_en, to_ecef, to_geodetic
from bench.core.mathematics.units import SAME_INSTANT
from bench.core.records.data import NavSolution, Trajectory
from bench.simulation.flight.executive import find_property
from bench.simulation.flight.guidance.shaping import GUIDANCE_RATE, smoothstep
from bench.simulation.flight.jsbsim_units import FT

Mode = Literal["held", "state"]

_NAVIGATION = {  # what is estimated, the property of the truth, its factor to SI
    "roll-rad": ("attitude/phi-rad", 1.0),
    "pitch-rad": ("attitude/theta-rad", 1.0),
    "heading-rad": ("attitude/psi-rad", 1.0),
    "altitude-ft": ("position/geod-alt-ft", FT),
    "down-fps": ("velocities/v-down-fps", FT),
    **{f"{axis}-rad_sec": (f"velocities/{axis}-rad_sec", 1.0) for axis in "pqr"},
}
_PLACE = (  # legs alone read it
    *((f"position/ecef-{axis}-ft", FT) for axis in "xyz"),
    *((f"velocities/ecef-{axis}-fps", FT) for axis in "xyz"),
)
_ANGLES = slice(0, 3)
_RATES = slice(5, 8)
_POSITION, _VELOCITY = slice(8, 11), slice(11, 14)


@dataclass(frozen=True, slots=True)
class NavEstimate:
    """An estimate of the motion of the IMU at a time, and the truth of it."""

    t: float  # of validity [s]
    true: Trajectory  # the piece that ends there
    solution: NavSolution  # one row
    gyro_bias_b: FloatArray  # (3,) true bias of the gyros [rad/s]


class Belief:
    """Estimated quantities during a flight, in SI; initially the truth.

    Parameters
    ----------
    mode : "held" or "state"
        See the module.
    latency : float
        Time from the validity of an estimate until guidance begins to go over to it [s]; 0.05 or more.
    """

    def __init__(self, mode: Mode, latency: float) -> None:
        self.mode, self._latency = mode, latency
        self._due: deque[tuple[float, FloatArray]] = deque()
        self._radar: float | None = None  # error of the height above ground that it measured last [m]
        self._share = 1.0
        self.values = self._goal = self._from = np.zeros(14)
        self._imu_b = np.zeros(3)
        self._write: list[tuple[Callable[[float], None], float]] = []
        self._read: list[tuple[Callable[[], float], float]] = []

    def board(self, fdm: Any, imu_b: tuple[float, float, float]) -> None:
        """Store the aircraft that this estimate guides."""
        self._imu_b = np.array(imu_b)
        for name, (_, unit) in _NAVIGATION.items():
            write = find_property(fdm, f"guidance/believed-{name}").set_double_value
            self._write.append((write, 1.0 / unit))
        truths = [*_NAVIGATION.values(), *_PLACE]
        self._read = [(find_property(fdm, name).get_double_value, unit) for name, unit in truths]
        self._write_share = find_property(fdm, "guidance/nav-share").set_double_value

    # --- what navigation says

    def take(self, estimate: NavEstimate) -> None:
        """Store an estimate; the guidance begins to blend to it after its latency."""
        self._due.append((estimate.t + self._latency, self._find_values(estimate)))

    def take_radar(self, error: float | None) -> None:
        """Store the error of the measured radar height [m]; None: no echo."""
        self._radar = error

    def _find_values(self, estimate: NavEstimate) -> FloatArray:
        """Return the offsets to add to ``share`` times the truth."""
        one, true = estimate.solution, estimate.true
        believed = self._locate(one.lla[0], one.vel_n[0], one.q_nb[0])
        if self.mode == "held":
            believed = believed - self._locate(true.lla[-1], true.vel_n[-1], true.q_nb[-1])
            for axis in range(3):
                believed[axis] = math.remainder(believed[axis], math.tau)
        bias = one.gyro_bias_b[0] - estimate.gyro_bias_b
        believed[_RATES] = -np.where(np.isfinite(bias), bias, 0.0)
        return believed

    def _locate(self, lla: FloatArray, vel_n: FloatArray, q_nb: FloatArray) -> FloatArray:
        """Return the values of a state of the IMU, with the position of the center of gravity.

        The velocities of the two differ by millimeters a second per error of the attitude, which is left out.
        """
        C_en = matrix_en(lla[0], lla[1])
        pos_e = to_ecef(lla) - C_en @ rotation.rotate(q_nb, self._imu_b)
        roll, pitch, heading = (float(angle) for angle in rotation.to_euler(q_nb))
        alt = float(to_geodetic(pos_e)[2])
        return np.array([roll, pitch, heading, alt, vel_n[2], 0.0, 0.0, 0.0, *pos_e, *(C_en @ vel_n)])

    # --- what the flight reads

    def begin_tick(self, t: float) -> None:
        """Begin an interval of 50 ms at a time [s]."""
        self._from = self.values
        while self._due and self._due[0][0] <= t + SAME_INSTANT:
            goal = self._due.popleft()[1]
            if self.mode == "state":
                if self._share == 1.0:  # so far it was the truth
                    self._share = 0.0
                    self._write_share(0.0)
                    self._from = self.values + np.array([unit * read() for read, unit in self._read])
                    self._from[_RATES] = self.values[_RATES]
                goal = goal.copy()
                for axis in range(3):
                    before = self._from[axis]
                    goal[axis] = before + math.remainder(goal[axis] - before, math.tau)
            self._goal = goal

    def step(self, share: float) -> None:
        """Write the estimated values after a fraction, 0 to 1, of the interval."""
        if self._goal is self._from:
            return
        if share >= 1.0:
            self.values = self._goal
        else:
            self.values = self._from + smoothstep(share) * (self._goal - self._from)
        for (write, unit), value in zip(self._write, self.values.tolist(), strict=False):
            write(unit * value)

    def believe(self, name: str, read: Callable[[], float], factor: float = 1.0) -> Callable[[], float]:
        """Return a function that reads the estimated value of a property, in the unit of the property.

        ``name`` is that in guidance, or the property of a place; ``read`` reads the truth.
        """
        place = [*_NAVIGATION, *(name for name, _ in _PLACE)].index(name)
        rate = _RATES.start <= place < _RATES.stop

        def believed() -> float:
            return (1.0 if rate else self._share) * read() + float(self.values[place]) / factor

        return believed

    def height(self, true: float, believed_rise: float) -> float:
        """Return the estimated height above ground [m], from the radar altimeter or from the altitude.

        ``true`` is the true one, ``believed_rise`` what the estimated altitude is above the true one [m].
        """
        return true + (believed_rise if self._radar is None else self._radar)


SMOOTHED = 1.0 / GUIDANCE_RATE
"""How long going over to another estimate takes [s]."""
