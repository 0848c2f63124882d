"""What aircraft.toml of every shipped aircraft says is what its model does; found by glob."""

from __future__ import annotations

from math import radians
from pathlib import Path

import numpy as np
import pytest

from bench.core.records.flight_specs import MULTIROTOR, AircraftSpec
from bench.io.config.library import read_aircraft, read_jsbsim_aircraft
from bench.io.config.listing import list_aircraft
from bench.simulation.flight.executive import load_aircraft
from bench.simulation.flight.hover_trim import trim_hover
from bench.simulation.flight.model_files import rotor_figures
from bench.simulation.flight.trimming import TrimCondition, trim_aircraft

AIRCRAFT = Path(__file__).parents[2] / "aircraft"
OWN = {path.parent.name: read_aircraft(path.parent, AIRCRAFT) for path in AIRCRAFT.glob("*/aircraft.toml")}
FOREIGN = {
    path.stem: read_jsbsim_aircraft(path.stem, None, AIRCRAFT) for path in AIRCRAFT.glob("jsbsim/*.toml")
}


def flights(spec: AircraftSpec) -> list[TrimCondition]:
    """The trimmed flights of a file, in the middle latitudes."""
    return [TrimCondition(radians(47.0), radians(11.0), alt, 1.0, speed) for alt, speed in spec.trims]


WINGS = [name for name, spec in OWN.items() if not spec.hovers]
ROTORS = [name for name, spec in OWN.items() if spec.hovers]


@pytest.mark.parametrize("name", ROTORS)
@pytest.mark.parametrize("wind", [0.0, 8.0])
def test_what_hovers_does_so_in_still_air_and_in_wind(name, wind):
    """Nothing is left of six accelerations, with a tenth of the speed of every rotor or more to spare."""
    spec = OWN[name]
    fdm = load_aircraft(spec, 1 / 400)
    for alt in (100.0, 2000.0):
        condition = TrimCondition(radians(47.0), radians(11.0), alt, 1.0, 0.0, wind_n=(0.0, wind, 0.0))
        found = trim_hover(fdm, condition, spec.max_bank)
        assert found.residual < 1e-9
        if spec.kind == MULTIROTOR:
            share = np.array(found.commands) / fdm["rotor/most-rad_sec"]
            assert (share > 0.1).all()
            assert (share < 0.9).all()
        else:  # blades and flapping, far from where they stop
            assert np.abs(found.commands).max() < 0.2
        assert (abs(found.roll) + abs(found.pitch) > radians(2.5)) == (wind > 0.0)


@pytest.mark.parametrize("name", WINGS)
def test_an_own_aircraft_is_trimmed_where_its_file_says(name):
    """Nothing is left of six accelerations, with a tenth of the travel of every control to spare."""
    spec = OWN[name]
    assert len(spec.trims) > 1
    fdm = load_aircraft(spec, 1 / 400)
    for condition in flights(spec):
        found = trim_aircraft(fdm, condition, glides=spec.glides)
        assert found.residual < 1e-9
        assert found.throttle == 0.0 if spec.glides else 0.02 < found.throttle < 0.9
        assert max(abs(found.elevator), abs(found.aileron)) < 0.9


@pytest.mark.parametrize("name", FOREIGN)
def test_an_aircraft_of_the_wheel_is_trimmed_where_its_file_says(name):
    spec = FOREIGN[name]
    assert spec.trims
    fdm = load_aircraft(spec, 1 / 400)
    for condition in flights(spec):
        found = trim_aircraft(fdm, condition, guided=False)
        assert found.residual < 1e-3
        assert 0.02 < found.throttle < 0.95


def test_every_file_names_its_sources_and_one_imu_is_off_the_center_of_gravity():
    listed = {row.name: row.note for row in list_aircraft()}
    for name, spec in OWN.items():
        assert "source: " in listed[name]
        assert "assumed: " in listed[name]
        assert (spec.folder / "README.md").is_file()
        assert ("IMU off" in listed[name]) == any(spec.imu_b)
        assert (spec.rest_height is None) == ("in the air only" in listed[name])
        assert (spec.kind == "glider" and spec.rest_height is not None) == ("on a winch" in listed[name])
    assert any(any(spec.imu_b) for spec in OWN.values())


MODEL = """<fdm_config><mass_balance>
<ixx unit="SLUG*FT2"> 0.02 </ixx><iyy unit="KG*M2"> 0.09 </iyy><izz> {izz} </izz>
<emptywt> {weight} </emptywt>{more}</mass_balance><system name="guidance">
<property value="0.25"> rotor/arm-forward-m </property>
<property value="{right}"> rotor/arm-right-m </property>
<sum><property> rotor/arm-forward-m </property></sum></system></fdm_config>"""


@pytest.mark.parametrize(
    ("changes", "lacks"),
    [
        ({}, set()),
        ({"right": "wide"}, {"rotor_right"}),
        ({"izz": "-1"}, {"gyration_z"}),
        ({"weight": "0"}, {"gyration_x", "gyration_y", "gyration_z"}),
        ({"more": '<pointmass name="load"/>'}, {"gyration_x", "gyration_y", "gyration_z"}),
    ],
)
def test_arms_and_radii_of_a_model_are_si_and_what_it_does_not_declare_is_left_out(tmp_path, changes, lacks):
    """By hand: 0.02 slug ft^2 = 0.0271164 kg m^2, 2 lb = 0.907185 kg."""
    values = {"izz": "0.04", "weight": "2.0", "right": "0.3", "more": ""} | changes
    (tmp_path / "own.xml").write_text(MODEL.format(**values))
    expected = {
        "rotor_forward": 0.25,
        "rotor_right": 0.3,
        "gyration_x": (0.0271164 / 0.907185) ** 0.5,
        "gyration_y": (0.09 / 0.907185) ** 0.5,
        "gyration_z": (2 * 0.0271164 / 0.907185) ** 0.5,
    }
    found = rotor_figures(tmp_path / "own.xml")
    assert found == pytest.approx({name: expected[name] for name in expected.keys() - lacks}, rel=1e-5)
