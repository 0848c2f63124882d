"""Check of the truth: integrate its increments with an error-free strapdown and compare with its motion.

The strapdown is the one of the filters (`bench.navigation.mechanization`), with coning and sculling
corrections from two intervals. Its error is the limit for every filter of the bench.
"""

from __future__ import annotations

import numpy as np

from bench.core.mathematics import earth, rotation
from bench.core.records.data import Trajectory
from bench.navigation.mechanization import propagate

STRETCH = 600.0
"""Interval after which a replay restarts from the truth [s]: a vertical error grows e-fold in 10 minutes."""


class Replay:
    """Largest difference between the replay and the truth over any 10 minutes; takes the truth in pieces."""

    def __init__(self) -> None:
        self.position = 0.0  # [m]
        self.attitude = 0.0  # [rad]
        self._state = np.zeros(3), np.zeros(3), np.zeros(4)  # of the replay: lla, vel_n, q_nb
        self._before = np.zeros(7)  # dtheta_b, dvel_b and length of the previous interval
        self._until = -np.inf  # [s]

    def add(self, piece: Trajectory) -> None:
        """Replay the next piece of the truth, which begins at the last epoch of the piece before."""
        start, end = 0, len(piece) - 1
        dt = np.diff(piece.t)
        while start < end:
            if piece.t[start] > self._until - dt[start] / 2:
                self._state = piece.lla[start], piece.vel_n[start], piece.q_nb[start]
                self._until = piece.t[start] + STRETCH
            stop = min(end, int(np.searchsorted(piece.t, self._until - dt[start] / 2)))
            steps, rows = slice(start, stop), slice(start, stop + 1)
            found = propagate(
                *self._state, dt[steps], piece.dtheta_b[steps], piece.dvel_b[steps], self._before
            )
            self._state = found[-1, :3], found[-1, 3:6], found[-1, 6:]
            position = np.linalg.norm(earth.difference_n(found[:, :3], piece.lla[rows]), axis=1)
            rotvec = rotation.to_rotvec(rotation.multiply(rotation.conjugate(piece.q_nb[rows]), found[:, 6:]))
            self.position = max(self.position, float(position.max()))
            self.attitude = max(self.attitude, float(np.linalg.norm(rotvec, axis=1).max()))
            start = stop

    def result(self) -> dict[str, float]:
        """Return the largest differences so far; each key ends in the unit."""
        return {"replay_position_m": self.position, "replay_attitude_rad": self.attitude}
