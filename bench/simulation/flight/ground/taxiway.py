"""Taxiways that an aircraft has been led along."""

from __future__ import annotations

import numpy as np

from bench.core.mathematics.arrays import FloatArray


class Taxiway:
    """A taxiway of one width.

    Parameters
    ----------
    points : (N, 2) array
        Its centerline at short steps, north and east of the threshold of the runway [m].
    width : float
        Its width [m].
    """

    def __init__(self, points: FloatArray, width: float) -> None:
        self._points, self.edge = points, 0.5 * width

    def beyond(self, pos: FloatArray) -> FloatArray:
        """Return how far places (N, 2) are beyond its edge (N,) [m]; negative: they are on the taxiway."""
        return np.array([np.hypot(*(self._points - place).T).min() for place in pos]) - self.edge
