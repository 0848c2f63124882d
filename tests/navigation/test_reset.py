"""A filter that has rejected sound fixes for long is reset, and no receiver that errs makes it so.

A start that is wrong by far more than it reports knocks the filter off while GNSS is good.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import bench
from bench.core.mathematics import earth, rotation
from bench.core.records.sensor_specs import Fault
from bench.evaluation.errors.error_series import error_series
from bench.navigation.built_in import load
from bench.simulation import sensors
from tests.builders import band
from tests.navigation.test_pieces import assert_same_solution, joined, pieces
from tests.weaving import units, weaving

RUNS = 8
JUDGED = (40, 60, 80, 100, 120)  # [s]; the filter starts anew at 32


@pytest.fixture(scope="module")
def truth():
    return weaving(121.0, rate=50.0, wind_n=[5.0, -4.0, 0.0])


def knocked(truth, run, turn_deg=90.0, off=200.0, **changes):
    """A run whose start is off by a heading and a distance north [m], and reports the usual."""
    drawn = sensors.sense(truth, replace(units(), **changes), 31, run)
    start = drawn.initial
    q_nb = rotation.multiply(rotation.from_euler(0.0, 0.0, np.deg2rad(turn_deg)), start.q_nb)
    return drawn.data, replace(start, lla=earth.displace(start.lla, np.array([off, 0.0, 0.0])), q_nb=q_nb)


@pytest.mark.parametrize("use", ["loose-15", "loose-full"])
def test_a_filter_that_is_lost_starts_anew_and_is_honest(truth, use):
    """Mean NEES of the runs at five epochs in the band. Without a reset it is 9,000, 220 and 270.

    With the biases that it learnt while it was lost it is 3,000, 150 and 87.
    """
    found = []
    for run in range(RUNS):
        data, start = knocked(truth, run)
        solution = load(use, {}).run(data, start)
        ((begin, end, text),) = solution.events.select("reset")
        assert 20.0 <= begin <= 25.0
        assert end <= 28.0
        assert text.startswith(
            "fixes rejected for 75% of 20 s that agree with their velocities: position and velocity"
        )
        assert "leveled by the velocity gained in 2 s" in text
        errors = error_series(truth, solution)
        found.append(errors.nees[np.searchsorted(errors.t, JUDGED)])
        between = (errors.t > begin) & (errors.t < end)
        assert errors.nees[between].max() < 40.0  # nothing is taken over of the attitude
    low, high = 9 * np.array(band(9 * RUNS * len(JUDGED)))
    assert low < np.mean(found) < high


def test_a_small_knock_needs_no_reset(truth):
    """200 m alone: the gate re-admits the fixes after its ten seconds."""
    data, start = knocked(truth, 0, turn_deg=0.0)
    solution = load("loose-full", {}).run(data, start)
    assert not len(solution.events.select("reset"))
    assert error_series(truth, solution).nees[-1] < 40.0


def test_in_pieces_and_saved_it_has_the_bits_of_the_whole(truth, tmp_path):
    """Cut before, in and after the rejections and the alignment; saved and gone on with at every cut."""
    data, start = knocked(truth, 1)
    whole = load("loose-15", {}).run(data, start)
    filter_ = bench.open_filter("loose-15", start, {}, look_back=0.5)
    found = []
    for piece in pieces(data, [0.5, 9.0, 14.03, 21.0, 21.6, 25.0, 32.0, 33.3, 80.0]):
        found.append(filter_.update(piece))
        filter_.current()
        filter_ = bench.read_filter(bench.write_filter(filter_, tmp_path / "filter.npz"))
    found.append(filter_.finish())
    assert_same_solution(joined(found), whole)
    assert sum(len(one.events.select("reset")) for one in found) == 1


def spoofed(**keys):
    return Fault(
        "spoofing", "gnss", 40.0, 110.0, "spoofed", **{"step": (0.0,) * 3, "ramp": (0.0,) * 3, **keys}
    )


@pytest.mark.parametrize(
    "fault",
    [
        spoofed(ramp=(0.0, 1.0, 0.0), coherent=False),
        spoofed(ramp=(3.0, 0.0, 1.0), coherent=False),
        spoofed(step=(100.0, 0.0, 0.0)),
        spoofed(step=(2000.0, 0.0, 300.0)),
        Fault("frozen", "gnss", 40.0, 110.0, "frozen"),
        Fault("noise-burst", "gnss", 40.0, 110.0, "burst", times=20.0),
        Fault("latency", "gnss", 40.0, 110.0, "late", delay=2.0),
    ],
    ids=["slow ramp", "ramp", "jump", "large jump", "frozen", "burst", "late"],
)
@pytest.mark.parametrize("use", ["loose-15", "loose-full"])
def test_no_receiver_that_errs_resets_a_sound_filter(truth, use, fault):
    """Seventy seconds of each fault, and of the fixes after it."""
    for run in range(2):
        drawn = sensors.sense(truth, replace(units(), faults=(fault,)), 17, run)
        solution = load(use, {}).run(drawn.data, drawn.initial)
        assert not len(solution.events.select("reset"))


def test_a_frozen_receiver_does_not_reset_a_filter_that_is_lost(truth):
    """It is reset when the fixes move again."""
    frozen = Fault("frozen", "gnss", 10.0, 60.0, "frozen")
    data, start = knocked(truth, 2, faults=(frozen,))
    ((begin, _, _),) = load("loose-full", {}).run(data, start).events.select("reset")
    assert begin > 60.0
