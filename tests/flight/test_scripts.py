"""A JSBSim script is flown as it is: truth by the usual recipe, with a report of what does not fly.

The replay is `inertial.py`; the motion of JSBSim's own loop over the same script is the second witness.
"""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path

import jsbsim
import numpy as np
import pytest

from bench.cli.command_line import main
from bench.core.mathematics.earth import to_ecef
from bench.core.records.data import Trajectory
from bench.core.records.flight_specs import ScriptSpec
from bench.core.words.exceptions import ConfigError, FlightError
from bench.io.config import read_profile
from bench.io.results.truth_cache import truth_key
from bench.simulation.flight import fly, recorder
from bench.simulation.flight.executive import silent_log
from bench.simulation.flight.increments import from_states
from bench.simulation.flight.jsbsim_units import FT
from bench.simulation.flight.model_files import class_of, script_facts
from tests.flight.inertial import replay
from tests.flight.plans import fly_here

WHEEL = Path(jsbsim.get_default_root_dir())
MM, UM = 1e-3, 1e-6  # [m], and [rad] for microradians


def profile(folder: Path, text: str, **overrides: object):
    (folder / "mine.toml").write_text(text)
    return read_profile(str(folder / "mine.toml"), overrides)


def sanity(truth: Trajectory) -> str:
    return "\n".join(text for _, _, text in truth.events.select("sanity"))


@pytest.fixture(scope="module")
def take_off(tmp_path_factory) -> Trajectory:
    """The script c1723 of the wheel: a Cessna takes off, climbs and turns."""
    return fly_here(profile(tmp_path_factory.mktemp("c1723"), 'script = "c1723"').flight)


def test_a_profile_of_one_line_flies_a_script_to_its_end(take_off):
    truth = take_off
    assert truth.t[-1] == pytest.approx(200.0, abs=0.01)
    assert np.ptp(truth.lla[:, 2]) > 400.0  # the Cessna has taken off
    assert truth.air.engine_speed.max() > 200.0  # rad/s: 1900 rpm
    assert truth.events.select("leg") == [(0.0, truth.t[-1], "script c1723")]
    assert sanity(truth) == ""


def test_its_increments_bring_it_back_within_a_millimeter_and_a_microradian(take_off):
    distance, angle = replay(take_off, 200.0)
    assert distance < 1 * MM
    assert angle < 1 * UM


def own_loop(name: str, dt: float, steps: int) -> np.ndarray:
    """States and centers of gravity [in] of JSBSim's own loop, without any of the bench's copies."""
    log = silent_log()
    jsbsim.set_logger(log)
    fdm = jsbsim.FGFDMExec(None)
    fdm.set_debug_level(0)
    assert fdm.load_script(str(WHEEL / "scripts" / f"{name}.xml"), dt)
    fdm.disable_output()
    fdm.run_ic()
    names = [
        *(f"position/ecef-{axis}-ft" for axis in "xyz"),
        *(f"inertia/cg-{axis}-in" for axis in "xyz"),
        *(f"attitude/{angle}-rad" for angle in ("phi", "theta", "psi")),
        "position/lat-geod-rad",
        "position/long-gc-rad",
        "position/epa-rad",
        *(f"position/eci-{axis}-ft" for axis in "xyz"),
        *(f"velocities/eci-{axis}-fps" for axis in "xyz"),
    ]
    nodes = [fdm.get_property_manager().get_node(name) for name in names]
    rows = [[node.get_double_value() for node in nodes]]
    for _ in range(steps):
        fdm.run()
        rows.append([node.get_double_value() for node in nodes])
    return np.array(rows)


def test_truth_is_a_fixed_point_of_the_body_while_the_tanks_empty(take_off, tmp_path, monkeypatch):
    """Without the offset the truth would follow the center of gravity, 1.0 mm lower after 200 s."""
    monkeypatch.chdir(tmp_path)
    rows = own_loop("c1723", 1 / 400, 79_998)
    travel = 0.0254 * (rows[:, 3:6] - rows[0, 3:6])
    assert np.linalg.norm(travel[-1]) > 1.0 * MM
    motion = from_states(
        1 / 400, rows[:, 11], FT * rows[:, 12:15], FT * rows[:, 15:18], rows[:, 6:9], rows[:, 9:11]
    )
    from bench.core.mathematics.earth import matrix_en
    from bench.core.mathematics.rotation import rotate

    lever_b = travel * [1.0, -1.0, 1.0]
    lever_n = rotate(motion.q_nb, lever_b)
    C_en = matrix_en(rows[:, 9], rows[:, 10])
    point = FT * rows[:, :3] + np.einsum("kij,kj->ki", C_en, lever_n)
    off = np.linalg.norm(to_ecef(take_off.lla) - point[::2][: len(take_off)], axis=1)
    assert off.max() < 0.2 * MM  # JSBSim integrates position and velocity by different rules
    center = np.linalg.norm(to_ecef(take_off.lla) - FT * rows[::2, :3][: len(take_off)], axis=1)
    assert center.max() > 0.8 * MM


@pytest.mark.parametrize(
    ("name", "least", "said"),
    [
        (
            "c172_elevator_doublet",
            18.9,
            "the motion jumps at 1.00 s, 20.00 s (by up to 5660 m): truth is its flight from 1.00 to 20.00 s",
        ),
        (
            "737_cruise_steady_turn",
            94.8,
            "the motion jumps at 5.10 s (by up to 2014 m): truth is its flight from 5.10 to 100.00 s",
        ),
    ],
)
def test_a_script_that_trims_on_the_way_is_flown_from_trim_to_trim_and_says_so(tmp_path, name, least, said):
    category = "light" if name.startswith("c172") else "transport"
    truth = fly_here(profile(tmp_path, f'script = "{name}"\nclass = "{category}"').flight)
    assert truth.t[-1] >= least
    assert said in sanity(truth)
    distance, angle = replay(truth, 200.0)
    assert distance < 1 * MM
    assert angle < 1 * UM
    if name == "c172_elevator_doublet":
        assert -truth.dvel_b[:, 2].min() * 200 / 9.80665 > 5.0  # g, between 5 and 7 s of the script


def test_the_doublet_is_beyond_a_transport_which_the_report_says(tmp_path):
    text = 'script = "c172_elevator_doublet"\nclass = "transport"\nduration_s = 15\n[evaluation]\nfrom_s = 0'
    said = sanity(fly_here(profile(tmp_path, text).flight))
    wanted = r"load factor -2\.\d\d to 5\.\d\d is beyond -1 to 2\.5 of the class transport \(14 CFR 25\.337\)"
    assert re.search(wanted, said)
    assert "angular rate 71 deg/s is beyond 60 of the class transport" in said


DIVE = """<?xml version="1.0"?>
<runscript name="into the ground">
  <use aircraft="c172x" initialize="reset01"/>
  <output name="{out}" type="CSV" rate="10"><property> position/h-sl-ft </property></output>
  <run start="0.0" end="120" dt="0.01">
    <output name="{out}" type="CSV" rate="10"><property> position/h-sl-ft </property></output>
    <event name="push">
      <condition> simulation/sim-time-sec ge 0.5 </condition>
      <set name="fcs/elevator-cmd-norm" value="1.0"/>
      <notify><property> position/h-sl-ft </property></notify>
    </event>
    {more}
  </run>
</runscript>
"""


def own_script(folder: Path, more: str = "", **changes: str) -> Path:
    text = DIVE.format(out=folder / "written.csv", more=more)
    for old, new in changes.items():
        text = text.replace(old, new)
    (folder / "dive.xml").write_text(text)
    return folder / "dive.xml"


def test_a_script_that_flies_into_the_ground_is_reported_and_writes_nothing(tmp_path, capfd):
    own_script(tmp_path)
    truth = fly(profile(tmp_path, 'script = "dive.xml"').flight)
    said = sanity(truth)
    assert "is beyond -3 to 6 of the class light (14 CFR 23.337, acrobatic category)" in said
    assert "touch the ground" in said or "hit the ground" in said or "under the ground" in said
    assert not (tmp_path / "written.csv").exists()
    assert capfd.readouterr() == ("", "")


AFTER_2_S = """<event><condition> simulation/sim-time-sec ge 2 </condition>
  <set name="{name}" value="1"/></event>"""
HEIGHT = """<event continuous="true"><condition> simulation/sim-time-sec ge 0 </condition>
  <set name="position/h-sl-ft"><function><product>
    <value>{rate}</value><property>simulation/sim-time-sec</property>
  </product></function></set></event>"""


@pytest.mark.parametrize(
    ("more", "message"),
    [
        (AFTER_2_S.format(name="simulation/reset"), "own time"),
        (AFTER_2_S.format(name="no/such"), "no/such"),
        (HEIGHT.format(rate=90_000), "the motion jumps"),
        (HEIGHT.format(rate=900), "the motion is no longer finite at"),
    ],
)
def test_a_script_no_truth_can_be_made_of_fails_with_one_line(tmp_path, more, message):
    own_script(tmp_path, more)
    with pytest.raises(FlightError, match=f"^script dive: .*{message}") as caught:
        fly_here(profile(tmp_path, 'script = "dive.xml"').flight)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"c172x": "../c172x"}, "aircraft '../c172x' must have letters"),
        ({"reset01": "../../reset01"}, "initialize '../../reset01' must be the name"),
        ({'end="120"': 'end="x"'}, "start, end and dt of <run> must be numbers"),
        ({"c172x": "kite"}, "flies 'kite', which is not found"),
        ({"<run ": "<ran "}, "not well-formed XML"),
        ({"runscript": "script"}, "no <runscript> with <use> and <run>"),
    ],
)
def test_a_script_that_is_none_is_one_line_before_the_flight(tmp_path, changes, message):
    own_script(tmp_path, **changes)
    with pytest.raises(ConfigError, match=message):
        profile(tmp_path, 'script = "dive.xml"')


def test_a_wrong_name_says_what_would_be_right(tmp_path):
    with pytest.raises(ConfigError, match=r"script = 'c172' is not in .*scripts.*Did you mean 'c172"):
        profile(tmp_path, 'script = "c172"')
    with pytest.raises(ConfigError, match="no such file beside the profile"):
        profile(tmp_path, 'script = "mine.xml"')
    with pytest.raises(ConfigError, match="unknown key 'start'"):
        profile(tmp_path, 'script = "c1723"\n[start]\nlat_deg = 1')


def test_a_script_too_long_asks_for_a_duration_and_a_duration_stops_it(tmp_path):
    own_script(tmp_path, **{'end="120"': 'end="1e9"'})
    with pytest.raises(
        FlightError, match=r"script dive: it runs for 1e\+09 s, longer than 14400 s; duration_s stops"
    ):
        fly_here(profile(tmp_path, 'script = "dive.xml"').flight)
    truth = fly_here(
        profile(tmp_path, 'script = "dive.xml"\nduration_s = 3\n[evaluation]\nfrom_s = 0').flight
    )
    assert truth.t[-1] == pytest.approx(3.0, abs=0.01)
    own_script(tmp_path)
    with pytest.raises(FlightError, match="it ends at 120 s; duration is 300 s"):
        fly_here(profile(tmp_path, 'script = "dive.xml"\nduration_s = 300').flight)


def test_the_same_script_gives_the_same_bits_in_another_process_and_another_key_after_a_change(tmp_path):
    own_script(tmp_path)
    text = 'script = "dive.xml"\nduration_s = 3\n[evaluation]\nfrom_s = 0'
    first = profile(tmp_path, text)
    code = (
        "import sys; from bench.io.config import read_profile; from bench.simulation.flight import fly;"
        "sys.stdout.buffer.write(fly(read_profile(sys.argv[1]).flight).dvel_b.tobytes())"
    )
    root = Path(__file__).parents[2]
    env = os.environ | {"PYTHONPATH": str(root)}
    other = subprocess.run(
        [sys.executable, "-c", code, tmp_path / "mine.toml"], env=env, capture_output=True, check=True
    )
    assert fly(first.flight).dvel_b.tobytes() == other.stdout
    key = truth_key(first.flight)
    own_script(tmp_path, **{'value="1.0"': 'value="0.9"'})
    assert truth_key(profile(tmp_path, text).flight) != key


def test_bench_run_shows_the_report_and_keeps_it_in_the_results(tmp_path, monkeypatch, capsys):
    monkeypatch.setenv("BENCH_CACHE", str(tmp_path / "cache"))
    monkeypatch.chdir(tmp_path)
    (tmp_path / "mine.toml").write_text(
        'script = "c172_elevator_doublet"\nduration_s = 12\n[evaluation]\nfrom_s = 2\n'
    )
    assert main(["run", "mine.toml"]) in (0, 1)
    out = " ".join(capsys.readouterr().out.split())
    assert "sanity, 0.0 s: script c172_elevator_doublet: the motion jumps at 1.00 s" in out
    from bench.io.results import load_truth

    assert "motion jumps" in sanity(load_truth(tmp_path / "runs/mine-0"))
    assert not list(tmp_path.glob("*.csv"))


def test_a_script_is_flown_at_least_at_its_own_step(monkeypatch):
    """The L410 of the wheel asks for 1 ms; nothing is flown more coarsely than the bench does."""
    assert recorder.simulation_step(200.0, 0.001) == (5, 0.001)
    assert recorder.simulation_step(200.0, 1 / 120) == (2, 0.0025)
    path = WHEEL / "scripts" / "L410.xml"
    asked = script_facts(path).step
    assert asked < 0.0025

    def stop(spec, what, dt, progress):
        raise FlightError(f"{dt:g}")

    monkeypatch.setattr(recorder, "run_script", stop)
    spec = ScriptSpec("L410", path, WHEEL, "L410", 200.0, 1.0, 0, "light")
    with pytest.raises(FlightError) as step:
        list(recorder.record_script(spec))
    assert 0.5 * asked < float(str(step.value)) <= asked


@pytest.mark.parametrize(
    ("name", "kind"),
    [
        ("paraglider", "uav"),  # 99 kg with its pilot
        ("c172x", "light"),
        ("L410", "light"),  # of the commuter category
        ("737", "transport"),
        ("Concorde", "transport"),  # it has afterburners
        ("f16", "fighter"),
        ("F4N", "fighter"),  # above 19,000 lb
    ],
)
def test_the_class_of_a_script_follows_from_mass_and_engines(name, kind):
    assert class_of(name, WHEEL) == kind


@pytest.mark.parametrize(
    ("masses", "kind"),
    [
        ('<emptywt unit="KG">149</emptywt>', "uav"),
        ('<emptywt unit="KG">149</emptywt><pointmass><weight unit="LBS">3</weight></pointmass>', "light"),
        ('<emptywt unit="LBS">18999</emptywt>', "light"),
        ("<emptywt>19001</emptywt>", "transport"),  # JSBSim takes pounds
        ('<emptywt unit="STONE">30</emptywt>', "light"),
        ("", "light"),
    ],
)
def test_masses_of_a_script_are_added_in_their_units(tmp_path, masses, kind):
    folder = tmp_path / "aircraft" / "mine"
    folder.mkdir(parents=True)
    text = f"<fdm_config><mass_balance>{masses}</mass_balance></fdm_config>"
    (folder / "mine.xml").write_text(text)
    assert class_of("mine", tmp_path) == kind


def test_a_class_that_is_said_is_kept(tmp_path):
    assert profile(tmp_path, 'script = "c1723"\nclass = "transport"').flight.category == "transport"
    assert profile(tmp_path, 'script = "c1723"').flight.category == "light"
