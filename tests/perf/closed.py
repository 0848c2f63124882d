"""What a flight by a filter costs beside JSBSim alone, and a filter that is asked every 50 ms.

python -m tests.perf.closed
"""

from __future__ import annotations

import threading
from itertools import pairwise

import numpy as np

import bench
from bench import pipeline
from bench.core.records.flight_specs import FlightSpec
from bench.core.records.run_records import Sensed
from bench.core.records.specs import Profile
from bench.core.words.stages import Stage
from bench.io import config
from bench.pipeline import closed_loop
from bench.plugins.hil.flight_client import FlightClient
from bench.plugins.hil.serving import serve
from bench.simulation.flight import recorder
from tests.perf.dense import EPOCHS, dense
from tests.perf.units import Costs, Figure, compare, cpu

PIECE, PIECES = 0.05, 800  # length [s] and number of pieces


def feed_and_answer(sensed: Sensed) -> Costs:
    """Return the cost of `PIECES` pieces of 50 ms, with an answer after each."""
    edges = [-np.inf, *(1.0 + PIECE * np.arange(PIECES))]
    pieces = [bench.slice_sensors(sensed.data, *ends) for ends in pairwise(edges)]

    def work() -> None:
        filter_ = bench.open_filter("loose-15", sensed.initial)
        for piece in pieces:
            filter_.update(piece)
            filter_.current()

    return cpu(work)


def fly(rate: float) -> Costs:
    """Return the cost of an approach by ``loose-15`` with so many answers a second."""
    profile = config.read_profile("approach-closed", {"guidance.period_s": 1.0 / rate})
    return cpu(lambda: closed_loop.fly(profile))


def step_alone(profile: Profile) -> Costs:
    """Return the cost of stepping the same aircraft in JSBSim as long as it flies the profile."""
    spec, length = profile.flight, float(closed_loop.fly(profile).truth.t[-1])
    assert isinstance(spec, FlightSpec)
    _, dt = recorder.simulation_step(spec.rate)

    def work() -> None:
        fdm, _ = recorder.prepare(spec, dt)
        for _ in range(round(length / dt)):
            fdm.run()

    return cpu(work)


def serve_straight() -> None:
    """Serve a flight to a client that is told all and leaves the steering to the bench."""
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
    serve("approach-closed", overrides={"guidance.period_s": PIECE}, address="127.0.0.1:0", progress=say)
    client.join()


def measure() -> list[Figure]:
    """Return the rows of `tests.perf.ratios`."""
    profile = config.read_profile("figure-eight")
    sensed = pipeline.sense(profile, pipeline.fly(profile))
    step = step_alone(config.read_profile("approach-closed"))
    return [
        compare(feed_and_answer(sensed), cpu(dense)).hold(
            "loose-15, 50 ms fed and answered / epochs of dense", 160.0, EPOCHS / PIECES
        ),
        compare(fly(5.0), step, 3).hold("approach flown by loose-15, 5 answers a second / stepping it", 12.0),
        compare(fly(20.0), step, 3).hold(
            "approach flown by loose-15, 20 answers a second / stepping it", 30.0
        ),
        compare(cpu(serve_straight), step, 3).hold("bench serve, 20 turns a second / stepping it", 18.0),
    ]


if __name__ == "__main__":
    for one in measure():
        print(f"{one.what:75} {one.value:.3g} (<= {one.limit:g})")
