"""Register #30: a receiver goes over from the antenna on the nose to that on the tail."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

import bench
from bench.core.words.exceptions import EstimatorError
from bench.evaluation.consistency.chi_square import MeanNis, mean_nis, nis_by_sensor
from bench.simulation import sensors
from tests.builders import assert_same_solution
from tests.navigation.test_pieces import drawn_satellites, joined
from tests.weaving import GNSS, units, weaving

NOSE, TAIL = (2.0, 0.3, -0.4), (-9.0, 0.0, -1.5)  # antennas [m], b
AT = 61.0  # of the change, where the turn begins again [s]
DRAWS = 10


@cache
def records(draw):
    """Start, and the same flight with the same errors as either antenna gives it; fixes 0.2 s late."""
    spec = units(gnss=replace(GNSS, latency=0.2))
    flown = weaving(75.0, 50.0)
    nose, tail = (sensors.sense(flown, replace(spec, antenna_b=at), 1, draw) for at in (NOSE, TAIL))
    return nose.initial, nose.data, tail.data


def go_over(draw, told, look_back=1.0):
    """Fly on the nose until AT, then on the tail, which the filter takes to be where it is ``told``."""
    initial, nose, tail = records(draw)
    filter_ = bench.open_filter("loose-15", initial, look_back=look_back)
    found = [filter_.update(bench.slice_sensors(nose, -1.0, AT))]
    tail = replace(tail, antenna_b=np.array(told))
    found += [filter_.update(bench.slice_sensors(tail, AT, np.inf)), filter_.finish()]
    return joined(found)


def nis_after(told) -> dict[str, MeanNis]:
    """Mean NIS by sensor of the fixes in the 10 s after the change, with its 99.9 % band, over runs."""
    rows: dict[str, list[tuple[np.ndarray, np.ndarray]]] = {"gnss_position": [], "gnss_velocity": []}
    for draw in range(DRAWS):
        found = nis_by_sensor(go_over(draw, told).innovations)
        for name, parts in rows.items():
            inside = (found[name].t > AT) & (found[name].t < AT + 10.0)
            parts.append((found[name].nis[inside], found[name].dof[inside]))
    return {
        name: mean_nis(*(np.concatenate(column) for column in zip(*parts, strict=True)), probability=0.999)
        for name, parts in rows.items()
    }


def test_30_no_innovation_steps_where_the_antenna_changes():
    """The mean NIS of the fixes after it is in its band; above it for a filter that keeps the first arm."""
    for name, one in nis_after(TAIL).items():
        assert one.low < one.mean < one.high, name
    for name, one in nis_after(NOSE).items():
        assert one.mean > one.high, name


def test_a_fix_that_waits_keeps_its_antenna():
    """However many fixes of the nose wait while those of the tail come, the bits are the same."""
    assert_same_solution(go_over(0, TAIL, look_back=5.0), go_over(0, TAIL, look_back=0.3))


def test_who_cannot_go_over_to_another_antenna_says_so():
    initial, nose, _ = records(0)
    satellites = drawn_satellites()
    for use, options, (start, data), words in (
        (
            "loose-15",
            {"lever_arm_sd": 0.1},
            (initial, nose),
            "lever_arm_sd = 0.1 estimates the position of one antenna",
        ),
        ("loose-15", {}, (replace(initial, alignment="course"), nose), "before its alignment has ended"),
        ("tight", {}, satellites, "'tight' cannot change to another antenna"),
    ):
        filter_ = bench.open_filter(use, start, options)
        filter_.update(bench.slice_sensors(data, -1.0, 3.0))
        piece = bench.slice_sensors(data, 3.0, 6.0)
        with pytest.raises(EstimatorError, match=words):
            filter_.update(replace(piece, antenna_b=np.array(TAIL)))
        filter_.update(piece)
