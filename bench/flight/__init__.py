"""From a flight plan to truth: the only place that knows JSBSim, its names and its feet."""

from bench.flight.model import FlightError
from bench.flight.recorder import fly, fly_pieces
from bench.flight.summary import Summary, summarise

__all__ = ["FlightError", "Summary", "fly", "fly_pieces", "summarise"]
