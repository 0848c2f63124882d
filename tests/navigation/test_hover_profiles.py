"""Profiles that start in a hover: what the filters get, what they find, and what is refused."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import bench
from bench import pipeline
from bench.core.mathematics import rotation
from bench.core.records.rotor_speeds import ROTORS
from bench.core.words.exceptions import ConfigError
from bench.io.config import read_profile
from bench.navigation.error_state_filter.rough_heading import UNKNOWN_HEADING_SD
from bench.views.plots.content import gather_content
from bench.views.plots.tabs.flight_data import FLIGHT

SD = np.deg2rad(14.0)  # of a heading with which one filter starts [rad]
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


def test_a_hover_in_gusts_turns_no_heading():
    """The antenna stands while the IMU swings about it; its arm alone would turn the heading to the opposite.

    Two sigma off at the start, gyro noise of a consumer unit: a heading that nothing observes stays within
    four sigma, and its sigma grows.
    """
    hover = {"leg": [{"kind": "hover", "duration_s": 250.0}], "sensors.imu": "bmi088"}
    given = {"start.heading_deg": 30.0, "alignment.kind": "given"}
    profile = read_profile("inspection", {**SHORT, **hover, **given})
    truth = bench.fly(profile)
    for run, side in enumerate((-1.0, 1.0)):
        sensed = bench.sense(profile, truth, run=run)
        start = sensed.initial
        cov = start.cov.copy()
        cov[8, 8] = SD**2
        turned = rotation.multiply(rotation.from_rotvec([0.0, 0.0, 2.0 * SD * side]), truth.q_nb[0])
        solution = bench.run_filter("loose-full", sensed.data, replace(start, q_nb=turned, cov=cov))
        error = rotation.multiply(solution.q_nb[-1], rotation.conjugate(truth.q_nb[-1]))
        sd = np.sqrt(solution.cov[-1, 8, 8])
        assert abs(rotation.to_rotvec(error)[2]) < 4.0 * sd
        assert sd > 1.2 * SD
