"""Flights of one study aligned in time: turbulence changes their length, and some crash."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from bench.core.mathematics.arrays import BoolArray, FloatArray


@dataclass(frozen=True, slots=True)
class WatchedFlight:
    """Errors, protection levels and alarms of one run of M epochs."""

    t: FloatArray  # (M,) [s]
    error: FloatArray  # (M, 2) horizontal, vertical [m]
    level: FloatArray  # (M, 2)
    alarm: BoolArray  # (M,)
    across: FloatArray  # (M,) error across track, to the right [m]; NaN without a track
    off: FloatArray  # (M,) flight technical error [m]; NaN without a track
    crashed: bool = False  # at the last of the epochs


def align_flights(watches: Sequence[WatchedFlight]) -> list[WatchedFlight]:
    """Return flights cut to equal length, because turbulence changes their length a little.

    A crash shortens no other flight: from there on, and at the last epoch at least, its own has no solution
    and is infinitely far off.
    """
    whole = [len(one.t) for one in watches if not one.crashed]
    length = min(whole) if whole else max(len(one.t) for one in watches)
    return [_fit(one, length) for one in watches]


def _fit(one: WatchedFlight, length: int) -> WatchedFlight:
    kept = min(len(one.t), length - one.crashed)
    rows = np.minimum(np.arange(length), max(kept - 1, 0))
    lost = np.arange(length) >= kept
    return replace(
        one,
        t=one.t[rows],
        error=np.where(lost[:, None], np.nan, one.error[rows]),
        level=one.level[rows],
        alarm=one.alarm[rows],
        across=one.across[rows],
        off=np.where(lost, np.inf, one.off[rows]),
    )


def tell_crashes(watches: Sequence[WatchedFlight]) -> Iterator[str]:
    """Yield the number of crashed flights, if any crashed."""
    if lost := [one for one in watches if one.crashed]:
        first = min(float(one.t[-1]) for one in lost)
        yield (
            f"{len(lost)} of {len(watches)} flights crashed, the first at {first:.0f} s: from there on they "
            "have no solution and are infinitely far off."
        )
