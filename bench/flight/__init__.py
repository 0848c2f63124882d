"""From a flight plan to truth: the only place that knows JSBSim, its names and its feet."""

from bench.flight.model import FlightError
from bench.flight.recorder import fly
from bench.flight.summary import summarise

__all__ = ["FlightError", "fly", "summarise"]
