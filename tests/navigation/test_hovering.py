"""What hovers is slow and may turn; what stands is slow and does not: consumer units know their heading."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from bench.evaluation.errors.error_series import error_series
from bench.io.config import read_profile
from bench.navigation.built_in import load
from bench.simulation import sensors
from tests.builders import band
from tests.hovering import hovering
from tests.weaving import units

UNITS = ("icm-20948", "icm-42688-p", "icm-45686", "bmi088", "lsm6dsl", "mpu-6050", "mpu-9250")
MOTIONS = {
    "turns slowly": {"turn_deg_s": 0.6},
    "turns": {"turn_deg_s": 2.0},
    "hovers": {},
    "stands": {"jitter_deg": 0.0},
}
STILL, AFTER = 36.0, 44.0  # [s]


def mean_nees(motion: str, unit: str, runs: int) -> list[float]:
    """Return the NEES of each run of `loose-full` at the end, with fixes of 1 Hz."""
    truth = hovering(STILL + AFTER, 50.0, still_s=STILL, **MOTIONS[motion])
    catalog = read_profile("figure-eight", {"sensors.imu": unit, "sensors.gnss": "l1-code"}).sensors
    spec = replace(units(catalog.imu, catalog.gnss, catalog.baro), output_rate=1.0)
    found = []
    for run in range(runs):
        drawn = sensors.sense(truth, spec, 7, run)
        data = replace(drawn.data, output_t=np.array([STILL + AFTER]))
        found.append(float(error_series(truth, load("loose-full", {}).run(data, drawn.initial)).nees[-1]))
    return found


@pytest.mark.parametrize("motion", MOTIONS)
def test_a_consumer_unit_knows_its_errors_after_a_hover(motion):
    """One run of each: 63 degrees of freedom. With the heading of the start held it is 180 and more."""
    found = [mean_nees(motion, unit, 1)[0] for unit in UNITS]
    assert np.mean(found) < 9 * band(9 * len(UNITS))[1], dict(zip(UNITS, found, strict=True))


@pytest.mark.long
@pytest.mark.parametrize("unit", UNITS)
@pytest.mark.parametrize("motion", MOTIONS)
def test_no_consumer_unit_is_lost_after_a_hover(motion, unit):
    found = mean_nees(motion, unit, 20)
    assert np.mean(found) < 9 * band(9 * 20)[1], (np.mean(found), max(found))
