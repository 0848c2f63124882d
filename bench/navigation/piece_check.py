"""Check that an estimator gives the same bits in pieces as on the whole record."""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from bench.data import InitialState, NavSolution, SensorData
from bench.navigation.engine.piecewise import RunsInPieces
from bench.navigation.engine.record_cuts import longest_wait, take_head, take_piece

_ENDS = (0.3, 0.31, 0.8)  # of the pieces, as parts of the samples


def check_pieces(estimator: object, sensors: SensorData, initial: InitialState, whole: NavSolution) -> None:
    """Raise AssertionError if the answers of an estimator in pieces differ from those on the whole record.

    The start is given.
    """
    if not isinstance(estimator, RunsInPieces):
        return
    wait, head = longest_wait(sensors), take_head(sensors)
    filter_ = estimator.in_pieces(head, initial, [])
    found = []
    for begin, end in pairwise([-np.inf, *np.nanquantile(sensors.imu.t, _ENDS), np.inf]):
        found.append(filter_.feed(take_piece(sensors, begin, end), wait, last=end == np.inf))
        if end < np.inf:
            filter_.copy().answer(head)
    for name in ("t", "lla", "vel_n", "q_nb", "cov"):
        joined = np.concatenate([getattr(one, name) for one in found])
        same = np.array_equal(joined, getattr(whole, name), equal_nan=True)
        assert same, f"in pieces it gives other bits: {name} differs"
