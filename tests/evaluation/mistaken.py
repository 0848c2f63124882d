"""Correct solutions given in another convention by mistake, ten of them, and the search for it.

    python -m tests.evaluation.mistaken --runs 3 --honest 200     # what is said of each, and of consistent
    ones

Attitudes are turned by scipy, not by bench.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from bench import pipeline
from bench.core.records.data import NavSolution, Trajectory
from bench.core.records.run_records import Sensed
from bench.core.records.specs import Profile
from bench.evaluation.consistency.verdict import BROKEN, add_verdict
from bench.evaluation.conventions.convention_search import find_mistakes
from bench.io import config
from bench.navigation import built_in, estimator

USE = "loose-15"
MATCHED = {"sensors.imu": "matched-mems", "sensors.gnss": "matched-white", "sensors.baro": "matched-walk"}
LATE = 0.1  # [s]
ARM = np.array([0.8, -0.36, 0.48])  # 1 m [m], b
GEOID = 30.0  # [m]
TURN = np.deg2rad(2.0) * np.array([0.6, 0.48, 0.64])  # [rad], b
RADIUS = 6.37e6  # of the Earth, right to 0.4 % [m]
ENU = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])
FLU = np.diag([1.0, -1.0, -1.0])


def turns(solution: NavSolution) -> Rotation:
    return Rotation.from_quat(np.roll(solution.q_nb, -1, axis=1))


def with_attitude(solution: NavSolution, attitude: Rotation) -> NavSolution:
    return replace(solution, q_nb=np.roll(attitude.as_quat(), 1, axis=1))


def put_to_antenna(solution: NavSolution, data: Any) -> NavSolution:
    """The motion of a point: its rate is that of the gyros, means over five samples."""
    rate = np.column_stack(
        [
            np.interp(solution.t, data.imu.t, np.convolve(column / data.imu.dt, np.ones(5) / 5.0, "same"))
            for column in data.imu.dtheta_b.T
        ]
    )
    moved, swing = (turns(solution).apply(v) for v in (np.tile(ARM, (len(solution), 1)), np.cross(rate, ARM)))
    lat = solution.lla[:, 0]
    step = np.column_stack([moved[:, 0] / RADIUS, moved[:, 1] / (RADIUS * np.cos(lat)), -moved[:, 2]])
    return replace(solution, lla=solution.lla + step, vel_n=solution.vel_n + swing)


def square_deviations(solution: NavSolution) -> NavSolution:
    """Variances in the columns of standard deviations."""
    sd = np.sqrt(np.einsum("kii->ki", solution.cov))
    return replace(solution, cov=solution.cov * sd[:, :, None] * sd[:, None, :])


def in_degrees(solution: NavSolution) -> NavSolution:
    """Angles of degrees in columns of radians."""
    return with_attitude(solution, Rotation.from_euler("ZYX", turns(solution).as_euler("ZYX", degrees=True)))


MISTAKES: Mapping[str, tuple[Callable[[NavSolution, Any], NavSolution], str]] = {
    "0.1 s late": (lambda solution, _: solution, "time offset"),  # made by `give`
    "lever arm of 1 m": (put_to_antenna, "lever arm"),
    "turned by 2 deg": (
        lambda solution, _: with_attitude(solution, turns(solution) * Rotation.from_rotvec(TURN)),
        "rotation of the body",
    ),
    "heights over the geoid": (
        lambda solution, _: replace(solution, lla=solution.lla - np.array([0.0, 0.0, GEOID])),
        "height",
    ),
    "velocities ENU": (
        lambda solution, _: replace(solution, vel_n=solution.vel_n @ ENU.T),
        "velocities east, north, up",
    ),
    "attitude ENU": (
        lambda solution, _: with_attitude(solution, Rotation.from_matrix(ENU) * turns(solution)),
        "an attitude in east, north, up",
    ),
    "attitude FLU": (
        lambda solution, _: with_attitude(solution, turns(solution) * Rotation.from_matrix(FLU)),
        "an attitude of axes forward, left, up",
    ),
    "conjugate": (
        lambda solution, _: with_attitude(solution, turns(solution).inv()),
        "an attitude from level to body, the conjugate quaternion",
    ),
    "degrees as radians": (
        lambda solution, _: in_degrees(solution),
        "attitude angles in degrees read as radians",
    ),
    "variances as deviations": (
        lambda solution, _: square_deviations(solution),
        "variances given as standard deviations",
    ),
}
"""Mistake -> how it is made, and the convention that is to be named."""


@cache
def fly(name: str = "s-turns") -> tuple[Profile, Trajectory]:
    """Return a flight with sensors that have no error but those that the filter models."""
    profile = config.read_profile(name, MATCHED, estimators=[USE])
    return profile, pipeline.fly(profile)


@cache
def sense(name: str, run: int) -> Sensed:
    profile, truth = fly(name)
    return pipeline.sense(profile, truth, run)


def give(mistake: str, run: int, name: str = "s-turns") -> tuple[NavSolution, Sensed]:
    """Return a correct solution of a run, given by mistake in another convention; "" for none."""
    sensed = sense(name, run)
    data = sensed.data
    if mistake == "0.1 s late":  # what the filter answers for t - 0.1 s is said to be of t
        data = replace(data, output_t=data.output_t[5:] - LATE)
    solution = estimator.answer(built_in.load(USE, {}), USE, data, sensed.initial)
    if mistake == "0.1 s late":
        solution = replace(solution, t=solution.t + LATE)
    return MISTAKES[mistake][0](solution, data) if mistake else solution, sensed


def ask(mistake: str, run: int, name: str = "s-turns") -> dict[str, Any]:
    """Return the verdict of such a solution, and what it looks like if its covariance is broken."""
    profile, truth = fly(name)
    solution, sensed = give(mistake, run, name)
    _, values = pipeline.measure(profile, truth, solution, sensed.truth)
    found = add_verdict(USE, values)
    if found["verdict"] not in BROKEN:
        return found
    return found | find_mistakes([truth], [solution], sensed.data.antenna_b, profile.evaluation.begin)


def main() -> None:
    """Print what is said of each mistake, and of how many consistent solutions anything."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--runs", type=int, default=1)
    parser.add_argument("--honest", type=int, default=0)
    parser.add_argument("--profile", default="s-turns")
    given = parser.parse_args()
    for mistake, (_, right) in MISTAKES.items():
        for run in range(given.runs):
            found = ask(mistake, run, given.profile)
            named = [row["convention"] for row in found.get("looks_like", ())]
            mark = "  " if named == [right] else "! "
            print(f"{mark}{mistake} {run}: {found['verdict']}: {found.get('why_text', '-')}", flush=True)
    said = [ask("", 1000 + run, given.profile) for run in range(given.honest)]
    if said:
        print(f"consistent: {sum('looks_like' in one for one in said)} of {len(said)} look like anything,")
        print(f"{sum(one['verdict'] in BROKEN for one in said)} are said to be broken")


if __name__ == "__main__":
    main()
