"""End of a filter with an impossible position: later solutions are blanked."""

from __future__ import annotations

import numpy as np

from bench.core.mathematics.arrays import FloatArray
from bench.core.records.data import EventRow
from bench.navigation.engine.session import Kept, SessionState

HIGHEST, FASTEST = 1e7, 1e5
"""No aircraft is so high [m], above or below the ellipsoid, or so fast [m/s]."""


class Earthbound(SessionState):
    """Blanks the solution from the first impossible position on, in all pieces of a record."""

    left: Kept[float]  # time of that answer [s]

    def __init__(self) -> None:
        self.left = np.inf

    def end_answers(self, t: FloatArray, state: FloatArray, *others: FloatArray) -> list[EventRow]:
        """Blank states (M, 6 or more: latitude, longitude, height, velocity) and others (M, ...) in place.

        Returns an event where the filter ends.
        """
        events = list[EventRow]()
        height, speed = np.abs(state[:, 2]), np.abs(state[:, 3:6]).max(axis=1, initial=0.0)
        beyond = np.flatnonzero((height > HIGHEST) | (speed > FASTEST) | (np.abs(state[:, 0]) > 0.5 * np.pi))
        if len(beyond) and t[beyond[0]] < self.left:
            k = int(beyond[0])
            self.left = float(t[k])
            text = f"the state has left the Earth: {state[k, 2] / 1e3:.3g} km high, {speed[k]:.3g} m/s"
            events.append((self.left, self.left, "ended", f"{text}; the filter has stopped", "imu"))
        for one in (state, *others):
            one[t >= self.left] = np.nan
        return events
