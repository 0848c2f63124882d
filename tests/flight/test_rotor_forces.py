"""Forces of the rotors: against the equations of a published model written anew, and against a flight log."""

from __future__ import annotations

from dataclasses import replace
from math import radians

import numpy as np
import pytest
from numpy.testing import assert_allclose

from bench.core.records.flight_specs import AircraftSpec
from bench.io.config.library import read_aircraft
from bench.simulation.flight.executive import load_aircraft
from bench.simulation.flight.hover_trim import trim_hover
from bench.simulation.flight.trimming import TrimCondition, place, wait
from tests.flight.test_aircraft_files import AIRCRAFT

POUND, FOOT_POUND = 4.4482216152605, 1.3558179483314003  # [N], [N m]
ALOFT = TrimCondition(radians(47.0), radians(11.0), 100.0, 0.0, 0.0)  # heading north
RHO = 1.225  # density at which the published figures hold [kg/m^3]


def loads(aircraft: AircraftSpec, speeds, wind_n, roll=0.0, pitch=0.0, density="rotor/density-ratio"):
    """Return forces (3,) [N] and moments (3,) [N m] at rest in a wind over a density, and the air [m/s]."""
    fdm = load_aircraft(aircraft, 1 / 400)
    here = replace(ALOFT, wind_n=tuple(wind_n))
    place(fdm, here, 0.0, 0.0, roll, 0.0, 0.0, 0.0, pitch=pitch, at_rest=True)
    for k, speed in enumerate(speeds):
        fdm[f"guidance/direct{k}-rad_sec"] = float(speed)
    wait(fdm, 600)
    force = POUND * np.array([fdm[f"forces/fb{axis}-total-lbs"] for axis in "xyz"])
    moment = FOOT_POUND * np.array([fdm[f"moments/{axis}-total-lbsft"] for axis in "lmn"])
    air = np.array([fdm[f"velocities/{axis}-aero-fps"] for axis in "uvw"]) * 0.3048
    return force / fdm[density], moment / fdm[density], air


def test_the_x500_has_the_mass_and_the_loads_of_its_source():
    """MulticopterMotorModel of gz-sim, forward, right, down: thrust k O^2, drag and moment against the motion
    in the plane of the rotor, reaction 0.016 m of the thrust; mass and inertia of five parts put together."""
    k, arm, reaction, drag, rolling = 8.54858e-6, 0.174, 0.016, 8.06428e-5, 1e-6
    body, rotor = 2.0, 0.016076923076923075
    mass = body + 4 * rotor
    shift = 4 * rotor * 0.06 / mass
    height = 0.06 - shift
    across = 0.02166666666666667 + body * shift**2 + 4 * rotor * (arm**2 + height**2)
    across += 2 * (3.8464910483993325e-07 + 2.6115851691700804e-05)
    upright = 0.04000000000000001 + 4 * (2 * rotor * arm**2 + 2.649858234714004e-05)

    x500 = read_aircraft(AIRCRAFT / "x500", AIRCRAFT)
    fdm = load_aircraft(x500, 1 / 400)
    assert fdm["inertia/mass-slugs"] * 14.593902937206364 == pytest.approx(mass, rel=1e-6)
    for axis, inertia in (("ixx", across), ("iyy", across), ("izz", upright)):
        found = fdm[f"inertia/{axis}-slugs_ft2"] * FOOT_POUND
        assert found == pytest.approx(inertia, rel=1e-4)  # the kg m^2 of JSBSim is 9e-5 off

    speeds = np.array([700.0, 760.0, 810.0, 730.0])
    force, moment, air = loads(x500, speeds, (-4.0, 6.0, 1.5), roll=0.3, pitch=-0.2)
    assert np.abs(air).min() > 0.3
    places = arm * np.array([[1, 1, 0], [1, -1, 0], [-1, -1, 0], [-1, 1, 0]]) - [0.0, 0.0, height]
    turns = np.array([1.0, -1.0, 1.0, -1.0])  # of the reaction, about down
    plane = air * [1.0, 1.0, 0.0]
    expected_force, expected_moment = np.zeros(3), np.zeros(3)
    for speed, where, turn in zip(speeds, places, turns, strict=True):
        thrust = np.array([0.0, 0.0, -k * speed**2])
        acting = thrust - drag * speed * plane
        expected_force += acting
        expected_moment += np.cross(where, acting) - rolling * speed * plane
        expected_moment += [0.0, 0.0, turn * reaction * k * speed**2]
    assert_allclose(force, expected_force, rtol=1e-5)
    assert_allclose(moment, expected_moment, rtol=1e-4, atol=1e-5)


# Means of three kinds of rows of the NeuroBEM data set (University of Zurich; a quadrotor of 0.772 kg in a
# hall), read in a public subset: andyska09/mrs-BEM, NeuroBEM/CMAES-dataset/subset_20k.csv, after 0, 2.5 and
# 8.9 million characters. Rows of a page that turn slower than 3.5 rad/s, without near-copies of each other.
# rows, motion in the plane of the rotors [m/s], rotor speed [rad/s], deceleration along that motion [m/s^2]
LOG = [(11, 2.57, 1123.0, 0.521), (24, 6.90, 1397.0, 2.133), (24, 8.77, 1933.0, 4.009)]
LOG_HOVER, LOG_FELT = 1136.8, 9.808  # eight rows of a hover: rotor speed [rad/s], specific force up [m/s^2]
LOG_MASS = 0.772  # [kg]
LOG_DRAG = 4.28e-5  # fitted to the first two kinds of rows, speed by speed [kg/rad]


@pytest.fixture
def flown(tmp_path) -> AircraftSpec:
    """The quadrotor of the log by the figures of its authors (params.h there), its drag fitted."""
    changes = {
        '"KG"> 0.5 <': f'"KG"> {LOG_MASS} <',
        "3.65e-3": "2.54e-3",
        "3.68e-3": "2.14e-3",
        "7.03e-3": "4.36e-3",
        '"5.57e-6"': '"1.562522e-6"',
        '"1.36e-7"': '"1.908873e-8"',
        '"1.19e-4"': f'"{LOG_DRAG}"',
        '"2.32e-4"': '"0"',
        'value="200.0"': 'value="30.3"',
        'value="1500.0"': 'value="3000.0"',
        '"0.005"': '"0"',
        '"0.01"': '"0"',
    }
    text = (AIRCRAFT / "hummingbird" / "hummingbird.xml").read_text()
    for old, new in changes.items():
        assert old in text
        text = text.replace(old, new)
    folder = tmp_path / "racer"
    folder.mkdir()
    (folder / "racer.xml").write_text(text.replace('name="hummingbird"', 'name="racer"'))
    (folder / "aircraft.toml").write_text((AIRCRAFT / "hummingbird" / "aircraft.toml").read_text())
    return read_aircraft(folder, AIRCRAFT)


def test_the_rotors_of_a_log_turn_as_its_airframe_by_the_model(flown):
    """3.2 % faster in the log: its rotors push 6 % less in flight than where they were measured."""
    found = trim_hover(load_aircraft(flown, 1 / 400), ALOFT, radians(45.0))
    fdm = load_aircraft(flown, 1 / 400)
    place(fdm, ALOFT, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, at_rest=True)
    density = fdm["atmosphere/rho-slugs_ft3"] * 515.378818 / RHO
    expected = np.mean(found.commands) * np.sqrt(density * LOG_FELT / 9.807)
    assert LOG_HOVER / expected == pytest.approx(1.032, abs=0.003)


def test_drag_of_rotors_is_their_speed_times_the_motion(flown):
    """Fitted at up to 10 m/s and 1400 rad/s, it is right at 1930 rad/s; a drag of the motion alone is not."""
    found = []
    for _, motion, speed, _ in LOG:
        force, _, _ = loads(flown, [speed] * 4, (-motion, 0.0, 0.0))
        found.append(-force[0] / LOG_MASS)
    ratios = np.array(found) / [row[3] for row in LOG]
    assert ratios[0] == pytest.approx(1.0, abs=0.25)  # 0.18 m/s^2 of spread among its rows
    assert ratios[1:] == pytest.approx(1.0, abs=0.1)
    by_motion_alone = LOG[1][3] / LOG[1][1] * LOG[2][1] / LOG[2][3]
    assert by_motion_alone < 0.7
