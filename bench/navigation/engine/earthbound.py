"""End of a filter with an impossible state or covariance: later solutions are blanked."""

from __future__ import annotations

import numpy as np

from bench.core.mathematics.arrays import BoolArray, FloatArray
from bench.core.records.data import EventRow
from bench.navigation.engine.session import Kept, SessionState

HIGHEST, FASTEST = 1e7, 1e5
"""No aircraft is so high [m], above or below the ellipsoid, or so fast [m/s]."""


class Earthbound(SessionState):
    """Blanks the solution from the first impossible state on, in all pieces of a record."""

    left: Kept[float]  # time of that answer [s]

    def __init__(self) -> None:
        self.left = np.inf

    def end_answers(
        self, t: FloatArray, state: FloatArray, *others: FloatArray, every: bool = False
    ) -> list[EventRow]:
        """Blank states (M, 6 or more: latitude, longitude, height, velocity) and others (M, ...) in place.

        The first of the others may be their covariance (M, n, n). A row that is NaN throughout is no answer,
        unless ``every`` row is one. Returns an event where the filter ends.
        """
        events = list[EventRow]()
        height, speed = np.abs(state[:, 2]), np.abs(state[:, 3:6]).max(axis=1, initial=0.0)
        beyond: BoolArray = np.asarray(
            (height > HIGHEST) | (speed > FASTEST) | (np.abs(state[:, 0]) > 0.5 * np.pi)
        )
        broken: BoolArray = np.asarray(~np.isfinite(state[:, :6]).all(axis=1))
        broken &= every | ~np.isnan(state[:, :6]).all(axis=1)
        negative: BoolArray = np.zeros(len(t), np.bool_)
        if others and others[0].ndim == 3:
            variance = np.einsum("kii->ki", others[0])[:, :6]
            negative = np.asarray(~(np.isfinite(variance) & (variance > 0.0)).all(axis=1))
            negative &= ~np.isnan(state[:, 0])
        bad = np.flatnonzero(beyond | broken | negative)
        if len(bad) and t[bad[0]] < self.left:
            k = int(bad[0])
            self.left = float(t[k])
            text = f"the state has left the Earth: {state[k, 2] / 1e3:.3g} km high, {speed[k]:.3g} m/s"
            if not beyond[k]:
                text = "the state is not finite" if broken[k] else "a variance is not finite or not above 0"
            events.append((self.left, self.left, "ended", f"{text}; the filter has stopped", "imu"))
        for one in (state, *others):
            one[t >= self.left] = np.nan
        return events
