"""Numbers of the register that take a flight: what the filter's innovations say of it, over a few draws."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache
from typing import Any

import numpy as np

from bench import pipeline
from bench.config import load_profile
from bench.data import Trajectory
from bench.evaluation.consistency import MeanNis, mean_nis, nis_by_sensor
from bench.specs import Profile
from bench.studies.register_measures import RowFinding
from bench.units import STANDARD_GRAVITY

_STEP: Mapping[str, Any] = {  # a turn that pulls 2 g within a second, fixes at 10 Hz
    "leg": [
        {"kind": "straight", "duration_s": 30.0},
        {"kind": "wind-up-turn", "bank_deg": 60.0, "load_factor": 2.0, "rise_s": 1.0, "hold_s": 5.0},
        {"kind": "straight", "duration_s": 5.0},
    ],
    "sensors.imu": "matched-mems",
    "sensors.gnss": "matched-white",
    "sensors.gnss.rate_hz": 10.0,
    "estimator": [{"use": "loose-15", "options": {"compensate_latency": False}}],
}
_DRAWS = 4
_STEP_S = 12.0  # from the rise of the force on [s]


def load_step(**values: object) -> Profile:
    """Return the flight with a step of 2 g; errors as for `load_profile`."""
    return load_profile("high-dynamics", {**_STEP, **values}, None, None)


@cache
def fly_step() -> tuple[Trajectory, float]:
    """Return the flight with a step of 2 g, and when the force begins to rise [s]."""
    truth = pipeline.fly(load_step())
    force = np.linalg.norm(truth.dvel_b, axis=1) / np.diff(truth.t) / STANDARD_GRAVITY
    return truth, float(truth.t[np.argmax(force > 1.2)])


def measure_step(**values: object) -> dict[str, MeanNis]:
    """Return the mean NIS of loose-15 by sensor through the step, with its 99.9 % band, over draws."""
    profile = load_step(**values)
    truth, begin = fly_step()
    found: dict[str, list[Any]] = {}
    for draw in range(_DRAWS):
        sensed = pipeline.sense(profile, truth, draw)
        solution = pipeline.navigate(profile.estimators[0], sensed.data, sensed.initial)
        for name, one in nis_by_sensor(solution.innovations, begin).items():
            inside = one.t < begin + _STEP_S
            found.setdefault(name, []).append((one.nis[inside], one.dof[inside]))
    return {
        name: mean_nis(np.concatenate([one[0] for one in rows]), np.concatenate([one[1] for one in rows]))
        for name, rows in found.items()
    }


def step_of_2_g() -> RowFinding:
    """#31: NIS through a step of 2 g, and with a receiver whose loops of 1 Hz are behind by it."""
    whole, behind = measure_step(), measure_step(**{"sensors.gnss.tracking_bandwidth_hz": 1.0})
    texts = [f"{name.removeprefix('gnss_')} {one.mean:.2f} ({one.low:.2f} to {one.high:.2f})"
             for name, one in whole.items() if name.startswith("gnss_")]  # fmt: skip
    noticed = all(one.mean > one.high for name, one in behind.items() if name.startswith("gnss_"))
    text = f"{', '.join(texts)}; loops of 1 Hz {behind['gnss_position'].mean:.0f}"
    return RowFinding(text, noticed and all(one.inside for one in whole.values()))
