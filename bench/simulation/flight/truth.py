"""Computation of the truth from a motion in segments: exact increments at the truth rate."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass

import numpy as np

from bench.core.mathematics.arrays import FloatArray
from bench.core.records.data import AirData, Controls, EventRow, Events, Trajectory
from bench.core.records.rotor_speeds import Rotors, no_rotors
from bench.simulation.flight.guidance.shaping import GUIDANCE_RATE
from bench.simulation.flight.increments import Motion, earth_relative, step_increments, true_integrals

NO_AIR, NO_GROUND = np.empty((0, 14)), np.empty((0, 4))


@dataclass(frozen=True, slots=True)
class Stretch:
    """A segment of a flight: motion at every step, air data, controls and ground contacts at 20 Hz.

    The increments of a step depend on its neighbors: the motion goes one step beyond the segment, and
    begins one step before it, unless it is the first. The time at which two segments meet is a row of
    the motion of both; air data, controls and contacts of it are in the earlier one.
    """

    first: int  # the step at which it begins; 0 is t = 0
    motion: Motion
    air: FloatArray  # (A, 14): the columns of AirData and Controls but t
    ground: FloatArray  # (A, 4): height above it [m], sink rate [m/s], wheels touch, others touch
    events: list[EventRow] | None = None  # of the whole flight, with its last segment
    rotors: FloatArray | None = None  # (K, 4): speed of each rotor at the rows of the motion [rad/s]

    @property
    def before(self) -> int:
        """Steps of the motion before the segment."""
        return 1 if self.first else 0

    @property
    def t_air(self) -> FloatArray:
        """Times of air data, controls and contacts, (A,) [s]."""
        tick = round(self.first * self.motion.dt * GUIDANCE_RATE) + self.before
        t: FloatArray = (tick + np.arange(len(self.air))) / GUIDANCE_RATE
        return t


def make_truth(stretches: Iterable[Stretch], rate: float) -> Iterator[Trajectory]:
    """Yield the truth of each segment of a flight; joined, the pieces equal one segment, bit for bit.

    Parameters
    ----------
    stretches : iterable of Stretch
        In order and without a gap, each a whole number of samples long; of the last the whole samples count.
    rate : float
        Truth samples per second; JSBSim or a spline was stepped at a multiple of it.

    Yields
    ------
    Trajectory
        A piece begins with the time at which the one before ends; air data and controls of that time
        are in the earlier one, all events in the last.
    """
    q_nb = None  # at the end of the last segment
    for stretch in stretches:
        motion, before = stretch.motion, stretch.before
        substeps = round(1.0 / (rate * motion.dt))
        alpha, beta = (column[before:] for column in true_integrals(*step_increments(motion)))
        n = len(alpha) // substeps
        at = slice(before, before + n * substeps + 1, substeps)
        lla, vel_n = earth_relative(motion.epa[at], motion.pos_i[at], motion.vel_i[at])
        sign = 1.0 if q_nb is None else np.copysign(1.0, motion.q_nb[before] @ q_nb)
        q_nb = sign * motion.q_nb[at]
        row = stretch.first // substeps
        t = np.arange(row, row + n + 1) / rate
        t_air = stretch.t_air
        known = t_air <= t[-1] + 1e-9
        air = stretch.air[known]
        air = np.where(np.isfinite(air), air, 0.0)  # the sanity report says so
        columns = air.T.copy()
        pressure, temperature, true, calibrated, attack, slip = columns[:6]
        wind_n, engine = air[:, 6:9], columns[9]
        yield Trajectory(
            t=t,
            lla=lla,
            vel_n=vel_n,
            q_nb=q_nb,
            dtheta_b=alpha[: n * substeps].reshape(n, substeps, 3).sum(axis=1),
            dvel_b=beta[: n * substeps].reshape(n, substeps, 3).sum(axis=1),
            air=AirData(t_air[known], pressure, temperature, true, calibrated, attack, slip, wind_n, engine),
            controls=Controls(t_air[known], *columns[10:]),
            events=Events.from_rows(stretch.events or []),
            rotors=no_rotors() if stretch.rotors is None else Rotors(t, stretch.rotors[at]),
        )
        q_nb = q_nb[-1]
