"""The yardstick of `tests/perf`: what a filter of 21 states costs that does not use its structure.

An epoch of it is three products of dense 21 x 21 matrices, i-k-j, out of place: Phi P Phi' and one more. The
source is fixed and shares nothing with ``bench``: a figure in its unit is comparable between versions.
"""

from __future__ import annotations

import time
from collections.abc import Callable

import numpy as np
from numba import njit

STATES = 21
EPOCHS = 40_000  # in one slice: a third of a second

_rng = np.random.default_rng(1)
_Phi, _P, _T = _rng.random((STATES, STATES)), _rng.random((STATES, STATES)), np.zeros((STATES, STATES))


@njit
def _multiply(Phi, P, T, epochs):
    m = P.shape[0]
    for _ in range(epochs):
        for _ in range(3):
            for i in range(m):
                for j in range(m):
                    T[i, j] = 0.0
                for k in range(m):
                    a = Phi[i, k]
                    for j in range(m):
                        T[i, j] += a * P[k, j]


def dense() -> None:
    """Do the work of one slice."""
    _multiply(_Phi, _P, _T, EPOCHS)


def epoch_costs(works: dict[str, tuple[Callable[[], object], int]], slices: int = 9) -> dict[str, float]:
    """Return the CPU time of an epoch of ``dense`` and of each work [s], the least of interleaved slices.

    A work is a function and the number of epochs it does in a call.
    """
    every = {"dense": (dense, EPOCHS), **works}
    for work, _ in every.values():  # compiled and warm
        work()
    costs = dict.fromkeys(every, np.inf)
    for _ in range(slices):
        for name, (work, epochs) in every.items():
            begun = time.process_time()
            work()
            costs[name] = min(costs[name], (time.process_time() - begun) / epochs)
    return costs
