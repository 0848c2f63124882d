"""Does the truth hold together: its increments, put through an error-free strapdown, against its own columns.

The strapdown is the one of the filters (`bench.navigation.mechanization`), with coning and sculling
corrections from two intervals. What it does not give back, no filter on the bench can.
"""

from __future__ import annotations

import numpy as np

from bench import earth, rotation
from bench.data import Trajectory
from bench.navigation.mechanization import propagate

STRETCH = 600.0
"""A replay begins anew after so long, because a vertical error grows e-fold in 10 minutes [s]."""


class Replay:
    """The largest difference of a replay from the truth over any 10 minutes, from the pieces of the truth."""

    def __init__(self) -> None:
        self.position = 0.0  # [m]
        self.attitude = 0.0  # [rad]
        self._state = np.zeros(3), np.zeros(3), np.zeros(4)  # where the replay is: lla, vel_n, q_nb
        self._before = np.zeros(7)  # dtheta_b, dvel_b and the length of the interval before
        self._until = -np.inf  # [s]

    def add(self, piece: Trajectory) -> None:
        """Take in the next piece, which begins with the instant at which the last one ended."""
        start, end = 0, len(piece) - 1
        dt = np.diff(piece.t)
        while start < end:
            if piece.t[start] > self._until - dt[start] / 2:
                self._state = piece.lla[start], piece.vel_n[start], piece.q_nb[start]
                self._until = piece.t[start] + STRETCH
            stop = min(end, int(np.searchsorted(piece.t, self._until - dt[start] / 2)))
            of = slice(start, stop)
            found = propagate(*self._state, dt[of], piece.dtheta_b[of], piece.dvel_b[of], self._before)
            self._state = found[-1, :3], found[-1, 3:6], found[-1, 6:]
            at = slice(start, stop + 1)
            off = np.linalg.norm(earth.difference_n(found[:, :3], piece.lla[at]), axis=1)
            turned = rotation.to_rotvec(rotation.multiply(rotation.conjugate(piece.q_nb[at]), found[:, 6:]))
            self.position = max(self.position, float(off.max()))
            self.attitude = max(self.attitude, float(np.linalg.norm(turned, axis=1).max()))
            start = stop

    def result(self) -> dict[str, float]:
        """Return the figures so far, the unit in each key."""
        return {"replay_position_m": self.position, "replay_attitude_rad": self.attitude}
