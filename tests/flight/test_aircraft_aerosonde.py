"""The Aerosonde in JSBSim is the published aircraft: its trim, its five modes, its signs; models load safely.

Reference: eigenvalues of the state matrices published with the table (aircraft/aerosonde/README.md), computed
at 25 m/s, density 1.2682 kg/m^3, CDp = 0 and Cnp = +0.069.
"""

import shutil
import tempfile
from dataclasses import replace
from math import cos, pi, radians, sin
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose

from bench.core.words.exceptions import FlightError
from bench.simulation.flight.executive import load_aircraft
from bench.simulation.flight.jsbsim_units import FT
from bench.simulation.flight.trimming import TrimCondition, place, trim_aircraft
from bench.simulation.flight.turbulence.wind import air_velocity, set_wind
from tests.flight import modes
from tests.flight.plans import AEROSONDE

DT = 1 / 400
DENSITY = 1.2682  # [kg/m^3]
LEVEL = TrimCondition(lat=radians(45.0), lon=0.0, alt=100.0, heading=radians(30.0), speed=25.0)
NEWTON_PER_LBF = 4.4482216152605
SLUG_FT3 = NEWTON_PER_LBF / FT**4  # [kg/m^3]
J = np.array([[0.8244, 0.0, -0.1204], [0.0, 1.135, 0.0], [-0.1204, 0.0, 1.759]])  # published [kg m^2]


@pytest.fixture
def published():
    """The model at the condition of the published matrices."""
    fdm = load_aircraft(AEROSONDE, DT)
    fdm["aero/CDp"], fdm["aero/Cnp"] = 0.0, 0.069
    fdm["atmosphere/override/density"] = DENSITY / SLUG_FT3
    return fdm


MODES = {
    "short period": -4.8786 + 9.8696j,
    "phugoid": -0.1041 + 0.4888j,
    "dutch roll": -1.1405 + 4.6551j,
    "roll": -22.4416,
    "spiral": 0.08936,
}


def test_the_five_modes_are_the_published_ones(published):
    """Fails on the aircraft as it flies: another sign of Cnp and another drag are other modes."""
    assert modes.beyond(modes.of_model(published, LEVEL), MODES) == {}
    flying = load_aircraft(AEROSONDE, DT)
    flying["atmosphere/override/density"] = DENSITY / SLUG_FT3
    twice = {mode: 2 * modes.BOUNDS[mode] for mode in ("phugoid", "dutch roll")}
    assert set(modes.beyond(modes.of_model(flying, LEVEL), MODES, twice)) == set(twice)


def test_trim_is_the_published_one(published):
    found = trim_aircraft(published, LEVEL)
    assert_allclose(found.alpha, 0.05001, rtol=5e-3)
    assert_allclose(found.elevator * pi / 6, -0.124778, rtol=5e-3)
    assert_allclose(found.throttle, 0.676752, rtol=5e-3)


def test_side_force_acts_along_the_body_axis(published):
    """dv'/dv is rho V S CYb / 2m; in JSBSim's wind axes the drag would add 5 %."""
    A = modes.linearize(published, LEVEL, trim_aircraft(published, LEVEL))
    assert_allclose(A[1, 1], DENSITY * 25.0 * 0.55 * -0.98 / (2 * 11.0), rtol=5e-3)


def through_air(alpha, beta, speed=12.0):
    """Lift, drag, roll and pitch coefficients of the flow from an angle, surfaces centered."""
    fdm = load_aircraft(AEROSONDE, DT)
    place(fdm, replace(LEVEL, speed=speed), radians(alpha), radians(beta), 0.0, 0.0, 0.0, 0.0, pitch=0.0)
    area, side, moment = fdm["aero/qbar-area"], 2.8956 / FT, 0.18994 / FT
    x, z = (fdm[f"forces/fb{axis}-aero-lbs"] / area for axis in "xz")
    c, s = cos(radians(alpha)), sin(radians(alpha))
    roll, pitch = fdm["moments/l-aero-lbsft"] / area / side, fdm["moments/m-aero-lbsft"] / area / moment
    return x * s - z * c, -x * c - z * s, roll, pitch


@pytest.mark.parametrize(("alpha", "beta"), [(0.0, 0.0), (10.0, -20.0), (-12.0, 26.0), (20.0, 5.0)])
def test_attached_flow_is_the_published_table(alpha, beta):
    """To 27 deg either way; the stall blend of the table takes 0.5 % of the lift at 20 deg."""
    a, b = radians(alpha), radians(beta)
    lift = 0.23 + 5.61 * a
    expected = lift, 0.043 + lift**2 / (pi * 0.9 * 2.8956**2 / 0.55), -0.13 * b, 0.0135 - 2.74 * a
    assert_allclose(through_air(alpha, beta), expected, rtol=5e-3, atol=1e-5)


def test_a_flow_from_the_side_lifts_and_tips_nothing():
    """Wing and tail live by the flow across their span; 12 m/s from the side lift no wheel of 11 kg."""
    lift, drag, roll, pitch = through_air(60.0, 89.0)
    assert max(abs(value) for value in (lift, drag, roll, pitch)) < 0.01
    for beta in (30.0, 50.0, 70.0):
        moment = abs(through_air(0.0, beta)[2]) * 0.5 * DENSITY * 12.0**2 * 0.55 * 2.8956
        assert moment < 0.25 * 11.0 * 9.81 * 0.35  # weight and half the track of its wheels


@pytest.mark.parametrize(("alpha", "most"), [(40.0, 1.0), (90.0, 2.1), (180.0, 0.3), (-120.0, 1.7)])
def test_the_drag_of_a_flow_from_below_or_behind_is_that_of_a_plate(alpha, most):
    """The parabola of attached flow would say 0.4, 2.0, 7.5 and 3.1: a plate has 2 sin^2(alpha)."""
    drag = through_air(alpha, 0.0)[1]
    assert 2 * sin(radians(alpha)) ** 2 - 0.25 < drag < most


@pytest.mark.parametrize(
    "condition",
    [
        LEVEL,
        replace(LEVEL, speed=21.0, alt=2000.0, wind_n=(0.0, 5.0, 0.0)),
        replace(LEVEL, climb_angle=0.1, wind_n=(3.0, -4.0, 0.0)),
    ],
)
def test_trimmed_flight_does_not_accelerate_and_is_where_it_was_wanted(condition):
    fdm = load_aircraft(AEROSONDE, DT)
    found = trim_aircraft(fdm, condition)
    assert found.residual < 1e-9
    assert_allclose(fdm["velocities/vt-fps"] * FT, condition.speed, rtol=1e-12)
    assert_allclose(
        -fdm["velocities/v-down-fps"] * FT, condition.speed * sin(condition.climb_angle), atol=1e-9
    )
    assert_allclose(fdm["position/geod-alt-ft"] * FT, condition.alt, atol=1e-6)
    assert_allclose(fdm["position/lat-geod-rad"], condition.lat, atol=1e-13)
    ground = np.array([fdm["velocities/v-north-fps"], fdm["velocities/v-east-fps"]]) * FT
    through_air = ground - condition.wind_n[:2]
    assert_allclose(np.hypot(*through_air), condition.speed * cos(condition.climb_angle), rtol=1e-9)


def test_a_roll_moment_turns_the_nose_as_the_published_product_of_inertia_says():
    """JSBSim negates a product of inertia unless told otherwise; the yaw response would change by 10 %."""
    fdm = load_aircraft(AEROSONDE, DT)
    at = trim_aircraft(fdm, LEVEL)

    def angular_acceleration(aileron):
        place(fdm, LEVEL, at.alpha, at.beta, at.roll, aileron, at.elevator, at.throttle)
        return np.array([fdm[f"accelerations/{axis}dot-rad_sec2"] for axis in "pqr"])

    change = angular_acceleration(at.aileron + 0.1) - angular_acceleration(at.aileron)
    rho = fdm["atmosphere/rho-slugs_ft3"] * SLUG_FT3
    moment = 0.5 * rho * 25.0**2 * 0.55 * 2.8956 * 0.1 * pi / 6 * np.array([0.17, 0.0, -0.011])
    assert_allclose(change, np.linalg.solve(J, moment), rtol=2e-4, atol=1e-9)  # JSBSim's kg m^2 is 1e-4 off
    negated = J * np.where(np.eye(3) > 0, 1.0, -1.0)
    assert abs(np.linalg.solve(negated, moment)[2] / change[2] - 1) > 0.05


def test_commands_have_the_senses_of_the_conventions():
    fdm = load_aircraft(AEROSONDE, DT)
    at = trim_aircraft(fdm, LEVEL)

    def response(command):
        place(fdm, LEVEL, at.alpha, at.beta, at.roll, at.aileron, at.elevator, at.throttle)
        fdm[command] += 0.1
        fdm.suspend_integration()
        fdm.run()
        fdm.resume_integration()
        return [fdm[f"accelerations/{axis}dot-rad_sec2"] for axis in "pqr"]

    assert response("fcs/aileron-cmd-norm")[0] > 1  # right roll
    assert response("fcs/elevator-cmd-norm")[1] < -1  # nose down
    assert response("fcs/rudder-cmd-norm")[2] < -1  # nose left


@pytest.mark.parametrize(("speed", "thrust"), [(0.01, 84.6), (25.0, 37.8)])
def test_propeller_pulls_as_published(published, speed, thrust):
    place(published, replace(LEVEL, speed=speed), 0.0, 0.0, 0.0, 0.0, 0.0, 1.0)
    assert_allclose(published["forces/fbx-external-lbs"] * NEWTON_PER_LBF, thrust, rtol=2e-3)


def test_wind_blows_from_where_it_is_said_to_and_never_stops_the_turbulence_turning():
    assert_allclose(air_velocity(radians(240.0), 4.0), [2.0, 4 * cos(radians(30.0)), 0.0], atol=1e-12)
    assert_allclose(air_velocity(radians(270.0), 5.0), [0.01 * FT, 5.0, 0.0], atol=1e-12)
    assert_allclose(air_velocity(radians(270.0), 0.0), [0.0, 0.0, 0.0])
    fdm = load_aircraft(AEROSONDE, DT)
    set_wind(fdm, air_velocity(radians(270.0), 5.0))
    fdm.run()
    assert_allclose(fdm["atmosphere/psiw-rad"], pi / 2, atol=1e-3)  # where the turbulence is turned to


# --- safe loading -------------------------------------------------------------------------------------


def changed(folder: Path, old: str, new: str):
    """A copy of the aircraft with one edit of its model."""
    shutil.copytree(AEROSONDE.folder, folder / "aerosonde")
    model = folder / "aerosonde" / "aerosonde.xml"
    text = model.read_text()
    assert old in text
    model.write_text(text.replace(old, new))
    return replace(AEROSONDE, folder=folder / "aerosonde")


def test_a_model_writes_no_files_opens_no_port_prints_nothing_and_leaves_no_scratch(
    tmp_path, capfd, monkeypatch
):
    scratch = tmp_path / "scratch"
    scratch.mkdir()
    monkeypatch.setattr(tempfile, "tempdir", str(scratch))
    monkeypatch.chdir(scratch)
    target = tmp_path / "written.csv"
    output = f'<output name="{target}" type="CSV" rate="10"><rates> ON </rates></output>'
    craft = changed(tmp_path, "</fdm_config>", f'{output}&more;<input port="55123"/></fdm_config>')
    model = craft.folder / "aerosonde.xml"
    hidden = f"<!DOCTYPE fdm_config [<!ENTITY more '{output}'>]>\n<fdm_config "
    model.write_text(model.read_text().replace("<fdm_config ", hidden, 1))
    fdm = load_aircraft(craft, DT)
    fdm.run_ic()
    for _ in range(200):
        fdm.run()
    assert not target.exists()
    assert list(scratch.iterdir()) == []
    assert capfd.readouterr() == ("", "")


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("</metrics>", "", r"aerosonde\.xml: not well-formed XML: mismatched tag: line \d+"),
        ('unit="KG*M2"', 'unit="STONE"', 'aircraft aerosonde: .*unit: "STONE" does not exist'),
        ("aero/ci2vel", "aero/nothing", "aircraft aerosonde: .*property aero/nothing does not exist"),
        ('<system file="guidance"/>', "", "aircraft aerosonde: .*guidance/throttle-cmd-norm does not exist"),
        ('file="guidance"', 'file="nothing"', "aircraft aerosonde: JSBSim cannot load it: .*file: nothing"),
        (
            "<fdm_config ",
            '<fdm_config xmlns="http://any.where" ',
            r"aerosonde\.xml is a <.*fdm_config>, not",
        ),
    ],
)
def test_a_broken_model_is_one_line_that_says_what(tmp_path, old, new, message):
    with pytest.raises(FlightError, match=message) as caught:
        load_aircraft(changed(tmp_path, old, new), DT)
    assert "\n" not in str(caught.value)


def test_an_aircraft_that_is_not_there_or_has_a_path_for_a_name_is_refused(tmp_path):
    with pytest.raises(FlightError, match=r"aerosonde\.xml is missing"):
        load_aircraft(replace(AEROSONDE, folder=tmp_path), DT)
    with pytest.raises(FlightError, match="a name has letters"):
        load_aircraft(replace(AEROSONDE, name="../aerosonde"), DT)
    with pytest.raises(FlightError, match="no property guidance/no-such-gain"):
        load_aircraft(replace(AEROSONDE, gains={"no-such-gain": 1.0}), DT)


def test_a_flight_the_aircraft_cannot_trim_is_refused(tmp_path):
    with pytest.raises(FlightError, match="no steady flight found for aerosonde at 60 m/s"):
        trim_aircraft(load_aircraft(AEROSONDE, DT), replace(LEVEL, speed=60.0))
    weak = changed(tmp_path, "<value> 44.4 </value>", "<value> 20 </value>")
    with pytest.raises(
        FlightError, match=r"no steady flight found for aerosonde at 25 m/s, 100 m: .* is left at throttle"
    ):
        trim_aircraft(load_aircraft(weak, DT), LEVEL)
