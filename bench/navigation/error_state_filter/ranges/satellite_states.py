"""Assignment of channels and states to satellites, and a filter without states never assigned."""

from __future__ import annotations

import numpy as np

from bench.core.compilation.compiled import kernel
from bench.core.compilation.wide_rows import widened
from bench.core.mathematics.arrays import BoolArray, FloatArray, IntArray
from bench.core.records.data import GnssObservations
from bench.core.records.orbit_sets import name_satellite
from bench.navigation.engine.session import Replaced, SessionState, fork
from bench.navigation.error_state_filter.measurement_rows import SENSORS
from bench.navigation.error_state_filter.measurement_update import Gate
from bench.navigation.error_state_filter.propagation import FilterState, Pending
from bench.navigation.error_state_filter.ranges.range_states import RANGES
from bench.navigation.error_state_filter.state_blocks import FIRST_OFFSET, FIRST_RANGE, Index

GONE = 60.0  # after which a satellite that is not seen gives up its state [s]
PLACES = np.column_stack([np.cumsum(RANGES) - RANGES, np.cumsum(RANGES)])  # by system: first, and end


def name_satellites(o: GnssObservations) -> tuple[list[str], IntArray]:
    """Return the satellites of a record (as G05 and R07) and the index of each row among them."""
    numbers, which = np.unique(_number(o), return_inverse=True)
    return [name_satellite(*divmod(n, 1000)) for n in numbers.tolist()], which.astype(np.int64)


def _number(o: GnssObservations) -> IntArray:
    return 1000 * o.system + o.sat


class Channels(SessionState):
    """Channels of the gate for the range and rate of each satellite, and the state of each satellite.

    The channels follow the channels of the sensors, in the order in which satellites appear. The states of a
    constellation are few: a rising satellite gets the state of the satellite that has been gone for the
    longest time, `GONE` at least; it is not used before.
    """

    names: Replaced[list[str]]
    held: Replaced[IntArray]  # (states,) number of the satellite that has each state
    seen: Replaced[FloatArray]  # (states,) when it was seen last [s]

    def __init__(self) -> None:
        self.names = list(SENSORS)
        self.held = np.full(sum(RANGES), -1)
        self.seen = np.full(len(self.held), -1e9)

    def of_satellites(self, o: GnssObservations) -> IntArray:
        """Return the channel (K,) of the range of each row of a record; new satellites get one."""
        satellites, which = name_satellites(o)
        for one in satellites:
            if f"{one} range" not in self.names:
                self.names = [*self.names, f"{one} range", f"{one} rate"]
        return np.array([self.names.index(f"{one} range") for one in satellites], np.int64)[which]

    def give_states(self, o: GnssObservations, rows: IntArray) -> tuple[IntArray, IntArray]:
        """Return the state of each row, by its place in its constellation, and whether it begins there."""
        own, fresh = np.full(len(rows), -1), np.zeros(len(rows), np.int64)
        held, seen = self.held.copy(), self.seen.copy()
        _give_kernel(_number(o)[rows], o.t[rows], PLACES, GONE, held, seen, own, fresh)
        self.held, self.seen = held, seen
        return own, fresh

    def used(self, index: Index, n: int) -> IntArray:
        """Return the states in use, out of n: all except those never assigned to a satellite."""
        used = np.ones(n, np.bool_)
        places = index[FIRST_RANGE:FIRST_OFFSET]
        for first, held in zip(places, np.split(self.held, np.cumsum(RANGES)[:-1]), strict=True):
            if first >= 0:
                used[first : first + len(held)] = held >= 0
        return np.flatnonzero(used)


@kernel
def _give_kernel(
    number: IntArray,
    t: FloatArray,
    places: IntArray,
    gone: float,
    held: IntArray,
    seen: FloatArray,
    own: IntArray,
    fresh: IntArray,
) -> None:
    """Fill own and fresh (K,) as :meth:`Channels.give_states` returns them; update ``held`` and ``seen``."""
    for k in range(number.shape[0]):
        begin, end = places[number[k] // 1000]
        free, place = begin, -1
        for j in range(begin, end):
            if held[j] == number[k]:
                place = j
            if seen[j] < seen[free]:
                free = j
        if place < 0 and t[k] - seen[free] >= gone:
            place = free
            fresh[k] = 1
            held[free] = number[k]
        if place >= 0:
            seen[place] = max(seen[place], t[k])
            own[k] = place - begin


def narrow(
    used: IntArray, now: FilterState, pending: Pending, gate: Gate
) -> tuple[FilterState, Pending, Gate]:
    """Return filter, measurements and gate with only the ``used`` states, which include the first nine."""
    state = np.concatenate([now.state[:10], now.state[used[9:] + 1]])
    P = widened(now.P[np.ix_(used, used)])
    return (
        FilterState(state, P, now.dx[used]),
        pending._replace(H=np.take(pending.H, used, axis=1)),
        gate._replace(opens=np.take(gate.opens, used, axis=1)),
    )


def widen(
    used: IntArray, now: FilterState, pending: Pending, gate: Gate, before: FilterState, opens: BoolArray
) -> tuple[FilterState, Pending, Gate]:
    """Undo :func:`narrow`; the states that are not used are as ``before``."""
    whole, n = fork(before), len(before.dx)
    whole.state[:10], whole.state[used[9:] + 1] = now.state[:10], now.state[10:]
    whole.P[np.ix_(used, used)] = now.P[:, : len(used)]
    H = np.zeros((len(pending.H), n))
    H[:, used] = pending.H
    return whole, pending._replace(H=H), gate._replace(opens=opens)
