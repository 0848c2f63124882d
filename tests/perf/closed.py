"""What a flight by a filter costs, and a filter that is asked every 50 ms: CPU times of this process.

    python -m tests.perf.closed

The least of three rounds counts, after one that compiles: what else the machine does only adds to it.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from itertools import pairwise

import numpy as np

import bench
from bench import pipeline
from bench.core.records.run_records import Sensed
from bench.core.words.stages import Stage
from bench.io import config
from bench.pipeline import closed_loop
from bench.plugins.hil.flight_client import FlightClient
from bench.plugins.hil.serving import serve

ROUNDS = 3
PIECE = 0.05  # [s]
APPROACHES, CORES = 200, 2


def least(work: Callable[[], object]) -> float:
    """Return the least CPU time of some work [s], threads of this process included."""
    work()
    costs = []
    for _ in range(ROUNDS):
        begun = time.process_time()
        work()
        costs.append(time.process_time() - begun)
    return min(costs)


def feed_and_answer(sensed: Sensed) -> float:
    """Return the cost of a piece of 50 ms and of an answer after it [s]."""
    edges = [-np.inf, *np.arange(1.0, 41.0, PIECE)]
    pieces = [bench.slice_sensors(sensed.data, *ends) for ends in pairwise(edges)]

    def work() -> None:
        filter_ = bench.open_filter("loose-15", sensed.initial)
        for piece in pieces:
            filter_.update(piece)
            filter_.current()

    return least(work) / len(pieces)


def fly(rate: float) -> tuple[float, float]:
    """Return the cost of an approach by ``loose-15`` with so many answers a second, and its length [s]."""
    profile = config.read_profile("approach-closed", {"guidance.period_s": 1.0 / rate})
    flown = []
    return least(lambda: flown.append(closed_loop.fly(profile).truth.t[-1])), float(flown[-1])


def serve_straight() -> tuple[float, float]:
    """Return the cost of a flight with a client that is told all and gives the start [s], and its length."""
    flown = []

    def work() -> None:
        heard = threading.Event()
        told = list[str]()

        def say(stage: Stage) -> None:
            told.append(str(stage))
            heard.set()

        def fly_there() -> None:
            heard.wait()
            with FlightClient(int(told[0].partition(";")[0].rpartition(":")[2])) as flight:
                for _ in flight.turns():
                    pass

        client = threading.Thread(target=fly_there, daemon=True)
        client.start()
        changes = {"guidance.period_s": PIECE}
        served = serve("approach-closed", overrides=changes, address="127.0.0.1:0", progress=say)
        client.join()
        flown.append(served.flown)

    return least(work), flown[-1]


def measure() -> list[tuple[str, float, float, str, bool]]:
    """Return the rows of `tests.perf.ratios`: what, value, limit, unit, whether higher is better."""
    profile = config.read_profile("figure-eight")
    sensed = pipeline.sense(profile, pipeline.fly(profile))
    (slow, length), (fast, _), (served, flown) = fly(5.0), fly(20.0), serve_straight()
    hour = 3600.0 / length
    turns = "bench serve with evaluation, 20 turns a second: flight time over CPU time"
    whole = APPROACHES * slow / CORES / 60.0
    return [
        ("loose-15, 50 ms fed and answered", 1e3 * feed_and_answer(sensed), 0.4, "ms CPU", False),
        ("an hour flown by loose-15, 5 answers a second", slow * hour, 70.0, "s CPU", False),
        ("an hour flown by loose-15, 20 answers a second", fast * hour, 180.0, "s CPU", False),
        (turns, flown / served, 30.0, "x", True),
        (f"{APPROACHES} approaches flown by loose-15, {CORES} processors", whole, 10.0, "min CPU", False),
    ]


if __name__ == "__main__":
    for what, value, limit, unit, higher in measure():
        print(f"{what:75} {value:.3g} {unit} ({'>=' if higher else '<='} {limit:g})")
