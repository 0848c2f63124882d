"""Flight plans to truth: the only package that uses JSBSim, with its property names and units."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator

from bench.core.records.data import Trajectory
from bench.core.records.flight_specs import FlightSpec, ScriptSpec
from bench.simulation.flight.guidance.belief import Belief
from bench.simulation.flight.summary import Summary, summarize

__all__ = ["Summary", "fly", "fly_pieces", "summarize"]


def fly(spec: FlightSpec | ScriptSpec, progress: Callable[[float], None] | None = None) -> Trajectory:
    """Fly a plan or a script and return the whole truth, as `recorder.fly_pieces` makes it.

    A script and an aircraft that was not made for the bench fly in a process of their own.
    """
    (whole,) = fly_pieces(spec, progress, math.inf)
    return whole


def fly_pieces(
    spec: FlightSpec | ScriptSpec,
    progress: Callable[[float], None] | None = None,
    seconds: float | None = None,
    belief: Belief | None = None,
) -> Iterator[Trajectory]:
    """Fly as :func:`fly` does, and yield the truth in pieces of a length [s]; None: `recorder.PIECE`.

    With a ``belief`` guidance and legs of a plan go by that, which whoever takes the pieces changes.
    """
    from bench.simulation.flight import recorder
    from bench.simulation.flight.child_process import fly_in_child

    seconds = recorder.PIECE if seconds is None else seconds
    if isinstance(spec, ScriptSpec):
        return fly_in_child(spec, f"script {spec.name}", progress, seconds)
    if spec.aircraft.foreign is not None:
        return fly_in_child(spec, f"aircraft {spec.aircraft.name}", progress, seconds)
    return recorder.fly_pieces(spec, progress, seconds, belief=belief)
