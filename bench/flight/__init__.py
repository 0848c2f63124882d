"""From a flight plan to truth: the only place that knows JSBSim, its names and its feet."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING

from bench.data import Trajectory
from bench.flight import recorder
from bench.flight.child_process import fly_in_child
from bench.flight.summary import Summary, summarise
from bench.moved import moved_from
from bench.specs import FlightSpec, ScriptSpec

__all__ = ["Summary", "fly", "fly_pieces", "summarise"]


def fly(spec: FlightSpec | ScriptSpec, progress: Callable[[float], None] | None = None) -> Trajectory:
    """Fly a plan or a script; the same spec gives the same bits in any process.

    Parameters
    ----------
    spec : FlightSpec or ScriptSpec
        What is flown; its rate is a multiple of 20 Hz.
    progress : callable, optional
        Called with the time flown so far [s].

    Returns
    -------
    Trajectory
        Truth at spec.rate from t = 0, legs as events of kind "leg". What was not made for the bench
        flies in a process of its own and has a sanity report, events of kind "sanity".

    Raises
    ------
    FlightError
        When it cannot be loaded, trimmed, or flown as planned.
    """
    (whole,) = fly_pieces(spec, progress, math.inf)
    return whole


def fly_pieces(
    spec: FlightSpec | ScriptSpec,
    progress: Callable[[float], None] | None = None,
    seconds: float = recorder.PIECE,
) -> Iterator[Trajectory]:
    """Fly and yield the truth in pieces of so many seconds, as `bench.flight.recorder.fly_pieces` says.

    Parameters and errors as for :func:`fly`.
    """
    if isinstance(spec, ScriptSpec):
        return fly_in_child(spec, f"script {spec.name}", progress, seconds)
    if spec.aircraft.foreign is not None:
        return fly_in_child(spec, f"aircraft {spec.aircraft.name}", progress, seconds)
    return recorder.fly_pieces(spec, progress, seconds)


if not TYPE_CHECKING:
    __getattr__ = moved_from(__name__)
