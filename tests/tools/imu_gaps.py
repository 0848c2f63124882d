"""Consistency in and after a gap of the IMU: ``python -m tests.tools.imu_gaps [DRAWS [NAME...]]``.

`figure-eight` from 200 s on without its IMU for 5, 15 or 60 s, with its own unit and with a consumer one.
Mean NEES of nine states over all runs and epochs, in the gap and in the 12 s after the filter has started
again; of a smoother in the same seconds.
"""

from __future__ import annotations

import sys
from typing import Any

import numpy as np

from bench import pipeline
from bench.cli.api import fly
from bench.evaluation.errors.error_series import error_series
from bench.io.config import read_profile
from bench.navigation.built_in import load

START, LENGTHS, AFTER = 200.0, (5.0, 15.0, 60.0), 12.0  # [s]
UNITS = ("own", "mpu-9250")
FILTERS = ("loose-full", "smoother")
AGAIN = 13.0  # after the end of a gap, where no event tells when the filter has started again [s]


def judge(unit: str, length: float, use: str, draws: int) -> tuple[list[float], list[float]]:
    """Return the mean NEES of each run in the gap and after it."""
    gap = {"kind": "dropped", "sensor": "imu", "start_s": START, "duration_s": length}
    changes: dict[str, Any] = {"rate_hz": 100, "fault": [gap], "evaluation.output_hz": 1.0}
    if unit != "own":
        changes["sensors.imu"] = unit
    profile = read_profile("figure-eight", changes)
    truth, inside, after = fly(read_profile("figure-eight", {"rate_hz": 100})), list[float](), list[float]()
    for draw in range(draws):
        drawn = pipeline.sense(profile, truth, draw)
        solution = load(use, {}).run(drawn.data, drawn.initial)
        errors = error_series(truth, solution)
        ends = [end for _, end, _ in solution.events.select("restart")]
        begun = ends[0] if ends else START + length + AGAIN
        inside.append(float(errors.nees[(errors.t > START) & (errors.t <= START + length)].mean()))
        after.append(float(errors.nees[(errors.t > begun) & (errors.t <= begun + AFTER)].mean()))
    return inside, after


def main() -> None:
    """Print a row of the table of the guide for each filter, unit and gap."""
    draws = int(sys.argv[1]) if len(sys.argv) > 1 else 10
    print(f"| filter | unit | gap | NEES in it | in the {AFTER:g} s after |\n|---|---|---|---|---|")
    for use in sys.argv[2:] or FILTERS:
        for unit in UNITS:
            for length in LENGTHS:
                cells = [
                    f"{np.mean(part):.1f} ± {np.std(part, ddof=1) / np.sqrt(draws):.1f}"
                    for part in judge(unit, length, use, draws)
                ]
                print(f"| `{use}` | {unit} | {length:g} s | " + " | ".join(cells) + " |", flush=True)


if __name__ == "__main__":
    main()
