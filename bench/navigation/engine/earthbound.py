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

    left: Kept[float]  # time of the first impossible state [s]; inf before

    def __init__(self) -> None:
        self.left = np.inf

    def end_answers(
        self, t: FloatArray, state: FloatArray, *others: FloatArray, every: bool = False
    ) -> list[EventRow]:
        """Set all rows from the first impossible one on to NaN, in place; return the event of this end.

        Parameters
        ----------
        t : (M,) array
            Epochs [s].
        state : (M, 6 or more) array
            Latitude, longitude [rad], height [m] and velocity [m/s]. They must be finite.
        *others : (M, ...) arrays
            Set to NaN with the state. If the first is a covariance (M, n, n) with n of at least 6, its
            first six variances must be finite and above 0.
        every : bool
            If False, a row whose six values are all NaN is an epoch without a solution and ends nothing.

        Returns
        -------
        events : list
            One "ended" event; empty if no row is impossible or the filter has ended before.
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
