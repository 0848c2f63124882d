"""How fast does an antenna move that is away from the IMU, while the aircraft turns?

It moves by the angular rate times the arm; a filter that does not know the arm takes this for velocity.
"""

from typing import Annotated

import numpy as np
from pydantic import Field

import bench
from bench.core.records.findings import Findings, make_table
from bench.experiments.studies.study import FlightOptions, StudyWorkers


class Options(FlightOptions):
    """The options of the study."""

    profile: str
    """name of a shipped profile, or a .toml file of your own"""
    arm_m: Annotated[float, Field(gt=0)] = 1.0
    """length of the arm [m]"""


def run(options: Options, work: StudyWorkers) -> Findings:
    """Return what was found."""
    truth = bench.fly(options.profile, overrides=options.settings)
    rate = np.linalg.norm(truth.dtheta_b, axis=1) / np.diff(truth.t)
    rows = [(share, options.arm_m * float(np.quantile(rate, share / 100))) for share in (50, 95, 100)]
    text = f"An antenna {options.arm_m:g} m from the IMU moves by up to {rows[-1][1]:.2f} m/s against it."
    table = make_table("speeds", "Speed of the antenna", ("percent of the flight", "speed_mps"), rows)
    return Findings((text,), (table,), ())
