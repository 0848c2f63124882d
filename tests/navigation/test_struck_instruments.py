"""Every aiding instrument is struck by every kind of fault, in every family of filters that uses it.

Matched units: afterwards a filter says how wrong it is. NEES of position, velocity and attitude, 70 s after
the end of the fault, is chi-square; a family passes with the largest of its cases in the 99.9 % band. The
faults begin in swift motion: an output that freezes while little moves is no different from a sound one.
"""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from scipy import stats

from bench.core.records.data import AirData
from bench.core.records.instruments import (
    INSTRUMENTS,
    AirspeedSpec,
    HeadingSpec,
    MagSpec,
    OdometerSpec,
    RadarSpec,
)
from bench.core.records.sensor_specs import Fault
from bench.evaluation.errors.error_series import error_series
from bench.navigation.built_in import load
from bench.navigation.error_state_filter.aiding_sensors import AIDING, SATELLITES
from bench.simulation import sensors
from tests.weaving import BARO, units, weaving

START, END, LAST = 70.0, 110.0, 180.0
UNITS = {
    "baro": BARO,
    "airspeed": AirspeedSpec("pitot", 10.0, white_sd=0.3),
    "mag": MagSpec("compass", 10.0, white_sd=2e-7, hard_iron_sd=5e-7, misalignment_sd=0.01),
    "radar": RadarSpec("radar", 10.0, white_sd=0.3, range=2000.0, bias_sd=0.5),
    "odometer": OdometerSpec("wheel", 10.0, white_sd=0.05, scale_factor_sd=0.02),
    "heading": HeadingSpec("two", 5.0, white_sd=0.003, wander_sd=0.002, wander_time=20.0, bias_sd=0.01),
}
KINDS = {
    "frozen": {},
    "noise-burst": {"times": 20.0},
    "latency": {"delay": 2.0},
    "dropped": {"share": 0.7},
    "repeated": {"share": 0.7},
}
OPTIONS = {sensor.record: sensor.option for sensor in AIDING if sensor is not SATELLITES}


def list_faults(sensor):
    """Yield a fault of each kind that a sensor can have."""
    for kind, keys in KINDS.items():
        yield Fault(kind, sensor, START, END, kind, **keys)
    if sensor == "gnss":
        yield Fault("spoofing", sensor, START, END, "spoofing", step=(60.0, -40.0, 20.0), ramp=(0.0,) * 3)
    elif INSTRUMENTS[sensor].step:
        step = 0.2 if INSTRUMENTS[sensor].unit == "rad" else 60.0
        yield Fault(f"{sensor}-step", sensor, START, END, "step", step=(step,), ramp=(0.0,))


@cache
def flight():
    """The truth, in still air."""
    truth = weaving(LAST, rate=50.0)
    t = np.arange(0.0, LAST + 0.01, 0.05)
    one, speed = np.ones(len(t)), np.interp(t, truth.t, np.linalg.norm(truth.vel_n, axis=1))
    air = AirData(t, 9e4 * one, 283.0 * one, speed, speed, 0 * one, 0 * one, np.zeros((len(t), 3)), one)
    return replace(truth, air=air)


def struck(sensor, fault, run):
    """Records of fixes and of a sensor, struck."""
    more = {} if sensor == "gnss" else {sensor: UNITS[sensor]}
    spec = replace(units(baro=None), **more, faults=(fault,), ground_alt=700.0, output_rate=1.0)
    spec = replace(spec, assumed=replace(spec.assumed, **more))
    return sensors.sense(flight(), spec, 17, run)


def judge(use, options, sensor, fault, runs):
    """Return the NEES at the end, of all blocks that the filter gives, and their states."""
    switch = {} if sensor in ("gnss", "baro") else {OPTIONS[sensor]: True}
    found = []
    for run in range(runs):
        drawn = struck(sensor, fault, run)
        solution = load(use, options | switch).run(drawn.data, drawn.initial)
        series = error_series(flight(), solution)
        assert np.abs(series.pos_n[-1]).max() < 50.0
        found.append(series.nees[-1])
    return np.mean(found)


FAMILIES = [
    # filter, options, states of its NEES, runs, sensors, kinds of faults
    ("loose-15", {}, 9, 4, ("gnss", *UNITS), (*KINDS, "step")),
    ("loose-full", {}, 9, 1, ("gnss", *UNITS), ("frozen", "step")),
    ("ukf", {"covariance_hz": 2.0}, 9, 1, ("gnss", *UNITS), ("step",)),
    ("classic-22", {"covariance_hz": 2.0}, 9, 1, ("gnss", "baro"), ("frozen", "step")),
    ("gnss-only", {}, 6, 4, ("gnss",), (*KINDS, "step")),
]


def choose_faults(sensor, kinds):
    """Return the faults of some kinds; a frozen output where a sensor has none of them."""
    every = list(list_faults(sensor))
    found = [one for one in every if one.kind in kinds or ("step" in kinds and one.kind not in KINDS)]
    return found or every[:1]


@pytest.mark.parametrize(
    ("use", "options", "states", "runs", "instruments", "kinds"), FAMILIES, ids=[one[0] for one in FAMILIES]
)
def test_a_filter_is_honest_after_every_fault(use, options, states, runs, instruments, kinds):
    """The largest mean NEES of all cases, each of ``runs`` runs, below the 99.9 % bound of the largest."""
    found = {
        (sensor, fault.kind): judge(use, options, sensor, fault, runs)
        for sensor in instruments
        for fault in choose_faults(sensor, kinds)
    }
    print({name: round(float(value), 1) for name, value in found.items()})
    bound = stats.chi2.isf(0.001 / len(found), states * runs) / runs
    assert max(found.values()) < bound, found
    assert len({sensor for sensor, _ in found}) == len(instruments)


def test_every_aiding_instrument_is_struck():
    assert {sensor.spec for sensor in AIDING} == {"gnss", *UNITS}
