"""Profiles that start in a hover: what the filters get, what they find, and what is refused."""

from __future__ import annotations

import numpy as np
import pytest

import bench
from bench import pipeline
from bench.core.records.rotor_speeds import ROTORS
from bench.core.words.exceptions import ConfigError
from bench.io.config import read_profile
from bench.navigation.error_state_filter.rough_heading import UNKNOWN_HEADING_SD
from bench.views.plots.content import gather_content
from bench.views.plots.tabs.flight_data import FLIGHT

SHORT = {
    "leg": [
        {"kind": "hover", "duration_s": 20.0},
        {"kind": "goto", "north_m": 20.0, "east_m": 5.0, "speed_mps": 6.0},
        {"kind": "goto", "north_m": 0.0, "east_m": 0.0, "speed_mps": 6.0},
        {"kind": "hover", "duration_s": 5.0},
    ],
    "fault": [],
    "sensors.gnss": "l1-code",
    "alignment.kind": "hover",
    "evaluation.from_s": 30.0,
}


def test_the_filters_get_nothing_but_the_time():
    profile = read_profile("inspection", SHORT)
    initial = bench.sense(profile, bench.fly(profile)).initial
    assert (initial.alignment, initial.align_for, initial.drift_sd) == ("motion", 4.0, UNKNOWN_HEADING_SD)
    assert np.isnan(np.concatenate([initial.lla, initial.vel_n, initial.q_nb])).all()
    assert np.isinf(np.diag(initial.cov)).all()


def test_the_heading_is_found_by_the_first_accelerations_or_at_once_by_a_magnetometer():
    """Before it, the sd without one says that it may be any."""
    found = bench.run(read_profile("inspection", SHORT))
    rows = found.solutions
    t = rows["loose-full"].t
    sd_deg = {label: np.rad2deg(np.sqrt(one.cov[:, 8, 8])) for label, one in rows.items()}
    waiting = (t > 10.0) & (t < 18.0)
    assert sd_deg["loose-full"][waiting].min() > 20.0
    assert sd_deg["with-mag"][waiting].max() < 10.0
    for label, one in found.errors.items():
        error_deg = np.rad2deg(np.abs(one.phi_n[-1, 2]))
        assert error_deg < 3.0 * sd_deg[label][-1]
        assert sd_deg[label][-1] < 8.0
    shown = {plot.path[-1]: plot for row in FLIGHT.plots(gather_content(found))[""] for plot in row}
    speeds = found.truth.rotors.speed * 30.0 / np.pi
    assert [line.names for line in shown["engine"].series] == [(place.replace("_", " "),) for place in ROTORS]
    for line, speed in zip(shown["engine"].series, speeds.T, strict=True):
        assert np.abs(line.values[:, 0] - np.interp(line.t, found.truth.t, speed)).max() < 1e-9


WRONG = [
    ({"alignment.kind": "course"}, "the course of a multirotor gives no heading; use 'hover'"),
    ({"alignment.drift_deg": 5.0}, "drift_deg is for kind = 'course', not for kind = 'hover'"),
    ({"alignment.duration_s": 40.0}, "duration_s = 40 s must not go beyond [evaluation] from_s = 30 s"),
    ({"start.speed_mps": 3.0}, "speed_mps = 3 m/s is not used: the hummingbird is a multirotor"),
    (
        {"guidance": {"navigation": "loose-15"}},
        "[guidance]: fixed-wing aircraft fly by an estimate or commands",
    ),
]


@pytest.mark.parametrize(("change", "message"), WRONG)
def test_what_a_hover_cannot_have_is_said_in_one_line(change, message):
    with pytest.raises(ConfigError) as caught:
        read_profile("inspection", {**SHORT, **change})
    assert [line for line in caught.value.messages if message in line], caught.value.messages


def test_a_runway_is_shown_to_wings_only():
    shown = {name: pipeline._describe_scene(read_profile(name))["runway"] for name in ("delivery", "circuit")}
    assert shown["delivery"] is None
    assert shown["circuit"] is not None
