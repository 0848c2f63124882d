"""Compile the large kernels into the cache before the tests: each worker would compile them again."""

from __future__ import annotations

from dataclasses import replace

from bench import pipeline
from bench.io.config import read_profile
from bench.navigation import built_in
from bench.simulation.flight.legs.level import Straight


def main() -> None:
    """Run every sensor and a filter over ten seconds of flight."""
    profile = read_profile("all-sensors")
    profile = replace(profile, flight=replace(profile.flight, legs=(Straight(10.0),), duration=None))
    sensed = pipeline.sense(profile, pipeline.fly(profile, cache=False))
    built_in.load("loose-15", {}).run(sensed.data, sensed.initial)


if __name__ == "__main__":
    main()
