"""Aircraft nobody made for the bench fly its legs: of the jsbsim wheel, of another root, of a folder.

Their models are read, stripped and flown in a process that can be ended.
"""

from __future__ import annotations

import re
import shutil
import signal
from dataclasses import replace
from math import cos, radians, sin
from pathlib import Path

import jsbsim
import numpy as np
import pytest

from bench.cli.command_line import main
from bench.core.mathematics.earth import difference_n, displace
from bench.core.mathematics.rotation import rotate, to_euler
from bench.core.records.data import Trajectory
from bench.core.records.flight_specs import AircraftSpec, FlightSpec, Gust, Leg, Runway, ScriptSpec, WindLayer
from bench.core.words.exceptions import ConfigError, FlightError
from bench.io.config import list_aircraft, read_profile
from bench.io.results.truth_cache import truth_key
from bench.simulation.flight import child_process, fly, fly_pieces, recorder, trimming
from bench.simulation.flight.executive import load_aircraft
from bench.simulation.flight.legs.landing import Approach, Flare, LandingRoll
from bench.simulation.flight.legs.level import Straight
from bench.simulation.flight.legs.runway import Static, TakeOff
from bench.simulation.flight.model_files import copy_aircraft
from bench.simulation.flight.trimming import TrimCondition, move_surfaces, place, run_engines, trim_aircraft
from tests.flight.inertial import replay
from tests.flight.plans import FIGURE_EIGHT, fly_here

WHEEL = Path(jsbsim.get_default_root_dir())
ROOT = Path(__file__).parents[2]
MM, UM = 1e-3, 1e-6  # [m], and [rad] for microradians

PROFILE = """
aircraft = "{name}"
rate_hz = 100
duration_s = {duration}
[start]
lat_deg = 47.0
lon_deg = 11.0
alt_m = {alt}
heading_deg = 85.0
speed_mps = {speed}
[wind]
from_deg = 270.0
speed_mps = 5.0
turbulence = {turbulence}
[[leg]]
kind = "straight"
duration_s = 10.0
[[leg]]
kind = "turn"
by_deg = 30.0
bank_deg = 20.0
[[leg]]
kind = "straight"
duration_s = 5.0
[sensors]
imu = "adis16475"
[[estimator]]
use = "free-inertial"
[evaluation]
from_s = 0
"""
CESSNA = {"name": "jsbsim:c172x", "alt": 1200.0, "speed": 55.0, "duration": 60.0, "turbulence": 0}
BOEING = {"name": "jsbsim:737", "alt": 6000.0, "speed": 200.0, "duration": 90.0, "turbulence": 0}


@pytest.fixture(autouse=True)
def _elsewhere(tmp_path, monkeypatch):
    """Models that fly in this process write into the scratch folder, if at all."""
    monkeypatch.chdir(tmp_path)


@pytest.fixture
def soon_steady(monkeypatch):
    """Engines get 4 s of 20 to become steady in a trim: thrust is off by 0.3 %, which these flights bear."""
    monkeypatch.setattr(trimming, "ENGINE_RUN", 4.0)


@pytest.fixture(scope="module")
def seven_seconds(tmp_path_factory) -> Trajectory:
    """The Cessna of the wheel straight on, flown in this process."""
    return fly_here(straight(plan(tmp_path_factory.mktemp("wheel"))))


def straight(spec: FlightSpec) -> FlightSpec:
    return replace(spec, legs=(Straight(7.0),), duration=None)


def written(folder: Path, **values: object) -> Path:
    (folder / "mine.toml").write_text(PROFILE.format(**CESSNA | values))
    return folder / "mine.toml"


def profile(folder: Path, **values: object):
    return read_profile(str(written(folder, **values)))


def plan(folder: Path, **values: object) -> FlightSpec:
    return profile(folder, **values).flight


@pytest.mark.usefixtures("soon_steady")
@pytest.mark.parametrize(("values", "alt_off"), [(CESSNA, 12.0), (BOEING, 8.0)])
@pytest.mark.parametrize("turbulence", [0, pytest.param(4, marks=pytest.mark.slow)])
def test_an_aircraft_of_the_wheel_flies_its_legs(tmp_path, values, alt_off, turbulence):
    """Calm it holds altitude and speed; at severity 4 within what such aircraft were measured to do."""
    truth = fly_here(plan(tmp_path, **values | {"turbulence": turbulence}))
    assert [text for *_, text in truth.events.select("leg")][1] == "2 turn: 30 deg right, bank 20 deg"
    if turbulence == 0:
        roll, _, heading = to_euler(truth.q_nb)
        assert np.rad2deg(np.abs(roll[:900]).max()) < 1.0  # straight before the turn
        assert np.rad2deg(roll.max()) == pytest.approx(20.0, abs=2.5)
        assert np.rad2deg(heading[-1]) == pytest.approx(115.0, abs=2.0)
        distance, angle = replay(truth, 100.0)
        assert distance < 1 * MM
        assert angle < 1 * UM
        assert truth.events.select("sanity") == []
    wide = 1 if turbulence == 0 else 6
    assert np.abs(truth.lla[:, 2] - values["alt"]).max() < alt_off * wide
    assert np.abs(truth.air.airspeed_true - values["speed"]).max() < (2.0 if turbulence == 0 else 15.0)
    assert truth.controls.throttle.max() <= 1.0
    assert truth.controls.throttle.min() > 0.1  # the engines carry it


def on_runway(folder: Path, name: str, *legs: Leg, **changes: object) -> FlightSpec:
    """Legs from rest on a runway at 600 m, heading 85 deg, or towards it."""
    spec = plan(folder, name=name, alt=1200.0)
    ground = Runway(spec.lat, spec.lon, 600.0, spec.heading)
    start = {"on_ground": True, "alt": 600.0, "speed": 46.0, "duration": None, "runway": ground}
    return replace(spec, legs=legs, **start | changes)


def aside(truth: Trajectory, spec: FlightSpec) -> np.ndarray:
    """Distance off the centerline of its runway, to the right [m]."""
    assert spec.runway is not None
    origin = np.array([spec.runway.lat, spec.runway.lon, spec.runway.alt])
    north, east = difference_n(truth.lla, origin)[:, :2].T
    return east * np.cos(spec.runway.heading) - north * np.sin(spec.runway.heading)


@pytest.mark.usefixtures("soon_steady")
def test_an_aircraft_of_the_wheel_stands_and_takes_off_from_its_runway(tmp_path):
    """At rest with its engine idling, then off the ground within 5 m of the centerline, in wind."""
    wind = {"wind_from": radians(60.0), "wind_speed": 3.0}
    spec = on_runway(tmp_path, "jsbsim:c172x", Static(5.0), TakeOff(40.0, 2.5, 46.0), **wind)
    truth = fly_here(spec)
    assert spec.aircraft.runway is not None
    still = truth.t < 5.0
    assert np.abs(truth.vel_n[still]).max() < 1e-4
    assert truth.lla[still, 2] - 600.0 == pytest.approx(spec.aircraft.runway.height, abs=0.01)
    assert truth.air.engine_speed[:90].min() > 50.0  # rad/s: it idles
    rolling = truth.lla[:, 2] < 601.5
    assert np.abs(aside(truth, spec)[rolling]).max() < 5.0
    assert truth.lla[-1, 2] == pytest.approx(640.0, abs=3.0)
    assert truth.events.select("sanity") == []


@pytest.mark.usefixtures("soon_steady")
@pytest.mark.slow
def test_an_aircraft_of_the_wheel_lands(tmp_path):
    spec = on_runway(tmp_path, "jsbsim:c172x")
    back = [-2700 * cos(spec.heading), -2700 * sin(spec.heading), 0.0]
    lat, lon, _ = displace([spec.lat, spec.lon, 600.0], back)
    start = {"on_ground": False, "wind_speed": 0.0, "lat": float(lat), "lon": float(lon), "alt": 720.0}
    spec = replace(spec, legs=(Approach(radians(3.5), 60.0), Flare(), LandingRoll(10.0)), **start)
    truth = fly_here(spec)
    text = truth.events.select("leg")[1][2]
    assert float(text.split("touch-down at ")[1].split()[0]) < 1.5
    touch = round(truth.events.select("leg")[1][1] * 100)
    assert np.abs(aside(truth, spec)[touch:]).max() < 5.0
    assert np.linalg.norm(truth.vel_n[-1]) < 1e-3


def test_an_aircraft_without_figures_for_a_runway_is_refused_before_the_flight(tmp_path):
    legs = {"start.on_ground": True, "leg.1.kind": "static", "duration_s": 60}
    with pytest.raises(ConfigError, match=r"on_ground = true: the 737 has no \[runway\] in"):
        read_profile(str(written(tmp_path, **BOEING)), legs)


@pytest.mark.usefixtures("soon_steady")
def test_wind_by_altitude_and_gusts_blow_on_an_aircraft_of_the_wheel_too(tmp_path):
    layers = (WindLayer(1000.0, 0.0, 5.0), WindLayer(1400.0, 0.0, 9.0))
    gust = Gust(start=2.0, rise=1.0, hold=2.0, fall=1.0, air_n=(0.0, 4.0, 0.0))
    spec = replace(plan(tmp_path), legs=(Straight(8.0),), duration=None, wind_layers=layers, gusts=(gust,))
    wind_n = fly_here(spec).air.wind_n
    assert wind_n[0] == pytest.approx([-7.0, 0.0, 0.0], abs=0.2)
    assert wind_n[80, 1] == pytest.approx(4.0, abs=0.2)
    assert wind_n[-1, 1] == pytest.approx(0.0, abs=0.2)


def test_the_trim_leaves_nothing_and_comes_back_to_the_same_whatever_was_before(tmp_path):
    """The actuators of the c172x have a play of 3 deg: coming from another side must not move the trim."""
    spec = plan(tmp_path)
    fdm = load_aircraft(spec.aircraft, 1 / 400)
    here = TrimCondition(spec.lat, spec.lon, spec.alt, spec.heading, spec.speed)
    first = trim_aircraft(fdm, here, guided=False)
    assert first.residual < 1e-6
    place(fdm, replace(here, speed=48.0), 0.1, 0.0, 0.1, 0.3, -0.6, 0.4)
    move_surfaces(fdm, 0.3, -0.6)
    run_engines(fdm)
    again = trim_aircraft(fdm, here, guided=False)
    assert (again.alpha, again.elevator, again.throttle) == pytest.approx(
        (first.alpha, first.elevator, first.throttle), abs=1e-5
    )


@pytest.mark.usefixtures("soon_steady")
def test_gains_and_properties_of_its_file_have_their_effect(tmp_path):
    slow = tmp_path / "aircraft" / "jsbsim"
    slow.mkdir(parents=True)
    shipped = (ROOT / "aircraft/jsbsim/c172x.toml").read_text()
    (slow / "c172x.toml").write_text(shipped)
    spec = plan(tmp_path)
    (slow / "c172x.toml").write_text(
        shipped.replace("[properties]", '[properties]\n"fcs/flap-cmd-norm" = 0.3')
    )
    pitch = []
    for one in (spec, plan(tmp_path)):
        truth = fly_here(replace(one, legs=(Straight(0.5),), duration=None))
        pitch.append(float(to_euler(truth.q_nb)[1][0]))
    assert pitch[1] < pitch[0] - radians(1.0)  # flaps lower the nose; what was read before has none


@pytest.mark.usefixtures("soon_steady")
def test_an_imu_beside_the_center_of_gravity_is_where_truth_is(tmp_path):
    spec = plan(tmp_path)
    spec = replace(spec, legs=spec.legs[:2], duration=None)
    at_cg = fly_here(spec)
    off = fly_here(replace(spec, aircraft=replace(spec.aircraft, imu_b=(2.0, 0.0, -0.5))))
    between = rotate(at_cg.q_nb * [1, -1, -1, -1], difference_n(off.lla, at_cg.lla))
    np.testing.assert_allclose(between, np.tile([2.0, 0.0, -0.5], (len(off), 1)), atol=0.05 * MM)
    distance, angle = replay(off, 100.0)
    assert distance < 1 * MM
    assert angle < 1 * UM


def test_its_name_and_gains_are_looked_up_and_what_is_missing_is_said(tmp_path):
    assert ("jsbsim:737", "Boeing 737 of the jsbsim wheel, two turbofans") in [r[:2] for r in list_aircraft()]
    with pytest.raises(ConfigError, match=r"aircraft = 'jsbsim:c17x' is not in .*Did you mean 'c17"):
        profile(tmp_path, name="jsbsim:c17x")
    with pytest.raises(ConfigError, match=r"write aircraft/jsbsim/A320.toml beside the profile.*737, c172x$"):
        profile(tmp_path, name="jsbsim:A320")
    with pytest.raises(ConfigError, match=r"'jsbsim:../c172x' is not in"):
        profile(tmp_path, name="jsbsim:../c172x")


def own_root(folder: Path) -> Path:
    """A JSBSim root of the user's own, with the Cessna of the wheel under another name."""
    root = folder / "root"
    for name in ("engine", "systems"):
        shutil.copytree(WHEEL / name, root / name)
    shutil.copytree(WHEEL / "aircraft/c172x", root / "aircraft/mine")
    (root / "aircraft/mine/c172x.xml").rename(root / "aircraft/mine/mine.xml")
    gains = folder / "aircraft/jsbsim"
    gains.mkdir(parents=True)
    shutil.copy(ROOT / "aircraft/jsbsim/c172x.toml", gains / "mine.toml")
    return root


def test_an_aircraft_of_another_root_flies_and_its_files_count_in_the_cache(tmp_path, seven_seconds):
    """In a process of its own, the same bits as that of the wheel in this one."""
    root = own_root(tmp_path)
    (tmp_path / "mine.toml").write_text(
        'jsbsim_root = "root"\n' + PROFILE.format(**CESSNA | {"name": "jsbsim:mine"})
    )
    spec = read_profile(str(tmp_path / "mine.toml")).flight
    np.testing.assert_array_equal(fly(straight(spec)).dvel_b, seven_seconds.dvel_b)
    key = truth_key(spec)
    engine = root / "engine/eng_io320.xml"
    engine.write_text(engine.read_text() + "\n")
    assert truth_key(spec) != key
    (tmp_path / "mine.toml").write_text('jsbsim_root = "engine"\n' + PROFILE.format(**CESSNA))
    with pytest.raises(
        ConfigError, match="jsbsim_root = 'engine' has no folder aircraft and no folder engine"
    ):
        read_profile(str(tmp_path / "mine.toml"))
    (tmp_path / "mine.toml").write_text(
        'jsbsim_root = "root"\n'
        + PROFILE.format(**CESSNA | {"name": "aerosonde", "alt": 900.0, "speed": 25.0})
    )
    with pytest.raises(ConfigError, match="jsbsim_root is for aircraft = 'jsbsim:NAME'"):
        read_profile(str(tmp_path / "mine.toml"))


def test_a_copy_of_an_aircraft_of_the_bench_flies_the_same_bits(tmp_path):
    shutil.copytree(ROOT / "aircraft/aerosonde", tmp_path / "aircraft/aerosonde")
    (tmp_path / "mine.toml").write_text(
        PROFILE.format(**CESSNA | {"name": "aerosonde", "alt": 900.0, "speed": 25.0, "duration": 30.0})
    )
    mine = read_profile(str(tmp_path / "mine.toml")).flight
    assert mine.aircraft.folder.parent == tmp_path / "aircraft"
    ours = replace(mine, aircraft=FIGURE_EIGHT.aircraft)
    np.testing.assert_array_equal(fly(mine).dvel_b, fly(ours).dvel_b)


OUTPUT = '<output name="{out}" type="CSV" rate="10"><property> position/h-sl-ft </property></output>'


def spoiled(folder: Path, old: str, new: str) -> AircraftSpec:
    """The Cessna as a folder of the user's own with one text of its model exchanged."""
    mine = folder / "aircraft/mine"
    shutil.copytree(WHEEL / "aircraft/c172x", mine)
    (mine / "c172x.xml").unlink()
    text = (WHEEL / "aircraft/c172x/c172x.xml").read_text()
    assert old in text
    (mine / "mine.xml").write_text(text.replace(old, new, 1))
    shutil.copy(ROOT / "aircraft/jsbsim/c172x.toml", mine / "aircraft.toml")
    return mine


def test_a_folder_of_the_users_own_flies_and_writes_no_file_and_opens_no_port_and_says_nothing(
    tmp_path, monkeypatch, capfd, seven_seconds
):
    """With guidance added, and its outputs taken away, it flies as the one of the wheel."""
    here = tmp_path / "here"
    here.mkdir()
    monkeypatch.chdir(here)
    unwanted = OUTPUT.format(out=tmp_path / "written.csv") + '<input port="5137"/></fdm_config>'
    spoiled(tmp_path, "</fdm_config>", unwanted)
    spec = plan(tmp_path, name="mine")
    np.testing.assert_array_equal(fly(straight(spec)).dvel_b, seven_seconds.dvel_b)
    assert not (tmp_path / "written.csv").exists()
    assert list(here.iterdir()) == []
    assert capfd.readouterr() == ("", "")
    model = copy_aircraft("mine", spec.aircraft.folder, tmp_path / "copy")
    assert not [child.tag for child in model if child.tag in ("input", "output")]


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("</fdm_config>", "", "mine/mine.xml: not well-formed XML"),
        ('unit="FT2"', 'unit="BANANA"', "aircraft mine: .*BANANA"),
        ('<engine file="eng_io320">', '<engine file="nothing">', "aircraft mine: .*nothing"),
        ("<flight_control", "<flight_control_", "mine/mine.xml: not well-formed"),
    ],
)
def test_a_broken_model_is_one_line(tmp_path, old, new, message):
    spoiled(tmp_path, old, new)
    with pytest.raises((FlightError, ConfigError), match=message) as caught:
        fly(plan(tmp_path, name="mine"))
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ('<engine file="eng_io320">', '<engine file="../../../etc/eng">', "<engine file='../../../etc/eng'>"),
        ('<engine file="eng_io320">', '<engine file="/etc/eng">', "<engine file='/etc/eng'>"),
        ("</fdm_config>", '<system file="Systems/../../x"/></fdm_config>', "<system file='Systems/../../x'>"),
        ("</fdm_config>", '<child name="../c310" mated="true"/></fdm_config>', "<child name='../c310'>"),
        ("</fdm_config>", f"{'<a>' * 200}{'</a>' * 200}</fdm_config>", "more than 100 elements"),
    ],
)
def test_a_model_names_no_file_outside_of_its_folder_and_is_not_too_deep(tmp_path, old, new, message):
    with pytest.raises(FlightError, match=f"^aircraft mine/mine.xml: {message}") as caught:
        copy_aircraft("mine", spoiled(tmp_path, old, new), tmp_path / "copy")
    assert "\n" not in str(caught.value)


def test_a_flight_in_a_child_comes_in_pieces(tmp_path, seven_seconds):
    """Put together they are the whole, bit for bit, with an event list in the last one only."""
    whole, found = seven_seconds, list(fly_pieces(straight(plan(tmp_path)), seconds=2.0))
    assert [piece.t[-1] for piece in found] == [2.0, 4.0, 6.0, 7.0]
    assert [len(piece.events) for piece in found] == [0, 0, 0, 1]
    for name in ("lla", "q_nb"):
        rows = [getattr(piece, name)[k > 0 :] for k, piece in enumerate(found)]
        np.testing.assert_array_equal(np.concatenate(rows), getattr(whole, name))
    np.testing.assert_array_equal(np.concatenate([piece.dvel_b for piece in found]), whole.dvel_b)
    np.testing.assert_array_equal(np.concatenate([piece.air.wind_n for piece in found]), whole.air.wind_n)
    np.testing.assert_array_equal(np.concatenate([piece.controls.t for piece in found]), whole.controls.t)


def test_what_hangs_is_ended_and_what_dies_is_said(tmp_path, monkeypatch):
    """A child that has little of the CPU is slow and does not hang: its own time counts, not the clock's."""
    folder = tmp_path / "flown.py"
    folder.write_text(
        "import os, time\n"
        "def waits(spec, progress, seconds, say):\n    progress(1.0)\n    time.sleep(600)\n"
        "def spins(spec, progress, seconds, say):\n    say('trimming')\n    while True: pass\n"
        "def slow(spec, progress, seconds, say):\n"
        "    for _ in range(30):\n"
        "        end = time.thread_time() + 0.01\n"
        "        while time.thread_time() < end: pass\n"
        "        time.sleep(0.15)\n"
        "    return iter(())\n"
        "def dies(spec, progress, seconds, say):\n    os.kill(os.getpid(), 11)\n"
        "def fails(spec, progress, seconds, say):\n    raise OSError('no room')\n"
    )
    monkeypatch.syspath_prepend(tmp_path)
    start = child_process._START

    def fly_with(function: str, *options: object) -> None:
        instead = start.replace(
            "from bench.simulation.flight.recorder import fly_pieces",
            f"import flown; fly_pieces = flown.{function}",
        )
        monkeypatch.setattr(child_process, "_START", instead)
        list(child_process.fly_in_child(FIGURE_EIGHT, "aircraft x", *options))

    seen: list[float] = []
    hung = r"^aircraft x: JSBSim hung for 4 s while {}; it was ended$"
    with pytest.raises(FlightError, match=hung.format("flying at 1 s")):
        fly_with("waits", seen.append, 30.0, 4.0)
    assert seen == [1.0]
    with pytest.raises(FlightError, match=hung.format("trimming")):
        fly_with("spins", None, 30.0, 4.0)
    fly_with("slow", None, 30.0, 4.0)
    with pytest.raises(
        FlightError, match=rf"^aircraft x: JSBSim ended its process with status -{int(signal.SIGSEGV)}"
    ):
        fly_with("dies")
    with pytest.raises(
        FlightError, match=r"^aircraft x: JSBSim ended its process with status 1: OSError: no room$"
    ):
        fly_with("fails")


@pytest.mark.usefixtures("soon_steady")
def test_all_that_takes_long_is_said_before_and_after_the_flight(tmp_path):
    """Each state of the trim, each segment of the truth: a child that works is heard."""
    said: list[str] = []
    spec = replace(plan(tmp_path), legs=(Straight(1.0),), duration=None)
    assert len(list(recorder.fly_pieces(spec, say=said.append))) == 1
    assert said[0] == "loading"
    assert said.count("trimming") > 20
    script = ScriptSpec("c1724", WHEEL / "scripts/c1724.xml", WHEEL, "c172x", 100.0, 6.0, 1, "light")
    said.clear()
    assert len(list(recorder.fly_pieces(script, seconds=2.0, say=said.append))) == 3
    assert [said.count(word) for word in ("looking at its motion", "making its truth")] == [2, 3]


def test_bench_fly_says_in_one_line_what_cannot_fly(tmp_path, monkeypatch, capsys):
    monkeypatch.setenv("BENCH_CACHE", str(tmp_path / "cache"))
    spoiled(tmp_path, 'unit="FT2"', 'unit="BANANA"')
    assert main(["fly", str(written(tmp_path, name="mine"))]) == 3
    assert re.fullmatch(r"error: aircraft mine: .*BANANA.*\n", capsys.readouterr().err)


@pytest.mark.usefixtures("soon_steady")
def test_where_an_aircraft_of_the_wheel_cannot_hold_its_height_the_search_ends(tmp_path, monkeypatch):
    """Far above where a Cessna flies; one beginning of the search of three."""
    monkeypatch.setattr(trimming, "FOREIGN", (trimming.FOREIGN[0][:1], *trimming.FOREIGN[1:]))
    with pytest.raises(FlightError, match=r"no steady flight found for c172x at 55 m/s, 15000 m: 0\.7"):
        fly_here(plan(tmp_path, alt=15_000.0))
