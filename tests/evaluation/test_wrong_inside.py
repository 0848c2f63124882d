"""A filter that is wrong inside is in no wrong convention: nothing is said of it."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import partial

import numpy as np
import pytest

from bench.core.mathematics import rotation
from bench.core.records.data import NavSolution
from bench.core.records.run_records import Sensed
from bench.evaluation.conventions.convention_search import find_mistakes
from bench.navigation import built_in
from tests.evaluation import mistaken

Wrong = Callable[[Sensed], NavSolution]


def answer(sensed: Sensed, **changes) -> NavSolution:
    """What the filter answers to other data than there are."""
    return built_in.load(mistaken.USE, {}).run(replace(sensed.data, **changes), sensed.initial)


def put_antenna(far: float, sensed: Sensed) -> NavSolution:
    return answer(sensed, antenna_b=sensed.data.antenna_b + far * np.array([1.0, 0.5, 0.0]))


def stamp_fixes(early: float, sensed: Sensed) -> NavSolution:
    return answer(sensed, fixes=replace(sensed.data.fixes, t=sensed.data.fixes.t - early))


def turn_gyros(deg: float, sensed: Sensed) -> NavSolution:
    turned = np.eye(3)
    turned[[0, 2, 1], [1, 0, 2]] = np.deg2rad(deg) * np.array([1.0, 1.0, -1.0])
    return answer(sensed, imu=replace(sensed.data.imu, dtheta_b=sensed.data.imu.dtheta_b @ turned.T))


def scale(triad: str, by: float, sensed: Sensed) -> NavSolution:
    imu = sensed.data.imu
    return answer(sensed, imu=replace(imu, **{triad: getattr(imu, triad) * (1.0 + by)}))


def divide_claim(by: float, sensed: Sensed) -> NavSolution:
    found = answer(sensed)
    return replace(found, cov=found.cov / by)


def divide_noise(by: float, sensed: Sensed) -> NavSolution:
    fixes = sensed.data.fixes
    return answer(
        sensed, fixes=replace(fixes, cov_pos_n=fixes.cov_pos_n / by, cov_vel_n=fixes.cov_vel_n / by)
    )


def swing_heading(deg: float, sensed: Sensed) -> NavSolution:
    found = answer(sensed)
    down = np.outer(np.deg2rad(deg) * np.sin(found.t / 30.0), [0.0, 0.0, 1.0])
    return replace(found, q_nb=rotation.multiply(rotation.from_rotvec(down), found.q_nb))


INSIDE: Mapping[str, Wrong] = {
    "lever arm 1 m": partial(put_antenna, 1.0),
    "gyros turned 1 deg": partial(turn_gyros, 1.0),
    "P/100": partial(divide_claim, 100.0),
    "lever arm 0.3 m": partial(put_antenna, 0.3),
    "lever arm 2 m": partial(put_antenna, 2.0),
    "fixes 0.05 s early": partial(stamp_fixes, 0.05),
    "fixes 0.15 s early": partial(stamp_fixes, 0.15),
    "fixes 0.5 s early": partial(stamp_fixes, 0.5),
    "gyros 0.5 % off": partial(scale, "dtheta_b", 0.005),
    "gyros 2 % off": partial(scale, "dtheta_b", 0.02),
    "accelerometers 1 % off": partial(scale, "dvel_b", 0.01),
    "P/4": partial(divide_claim, 4.0),
    "P/25": partial(divide_claim, 25.0),
    "R/10": partial(divide_noise, 10.0),
    "R/100": partial(divide_noise, 100.0),
    "heading swings 5 deg": partial(swing_heading, 5.0),
}
"""The first four fit the covariance of another convention, or angles in another unit, nearly as well."""


@pytest.mark.parametrize(
    ("name", "runs"),
    [
        *((name, 1) for name in list(INSIDE)[:4]),
        *(pytest.param(name, 3, marks=pytest.mark.long) for name in INSIDE),
    ],
)
def test_nothing_is_said_of_a_filter_that_is_wrong_inside(name, runs):
    profile, truth = mistaken.fly()
    for run in range(runs):
        sensed = mistaken.sense("s-turns", run)
        solution = INSIDE[name](sensed)
        begin = profile.evaluation.begin
        assert find_mistakes([truth], [solution], sensed.data.antenna_b, begin) == {}
