"""Gains that are found for an aircraft of JSBSim: the poles they place, and what a flight is accepted by."""

import time
from dataclasses import replace
from itertools import count, pairwise
from math import pi, radians
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from numpy.testing import assert_allclose

from bench.cli.command_line import main
from bench.cli.new_files import new_aircraft
from bench.cli.new_files.new_aircraft import BANK_BAND, equip, measure_acceptance
from bench.core.mathematics import rotation
from bench.core.mathematics.rotation import to_euler
from bench.core.records.data import Events
from bench.core.words.exceptions import FlightError
from bench.io.config import read_profile
from bench.io.config.library import read_jsbsim_aircraft
from bench.io.config.listing import PROFILES
from bench.simulation.flight import fly
from bench.simulation.flight.executive import load_aircraft
from bench.simulation.flight.guidance import gain_design
from bench.simulation.flight.guidance.gain_design import (
    BANK,
    attempts,
    design_gains,
    find_stubs,
    place_loops,
    plan_acceptance,
    prepare_aircraft,
    set_properties,
)
from bench.simulation.flight.trimming import (
    Trim,
    TrimCondition,
    move_surfaces,
    place,
    present_accelerations,
    run_engines,
    start_engines,
    trim_aircraft,
)
from tests.flight.plans import fly_here

TRIM = Trim(0.05, 0.0, 0.0, 0.05, 0.0, 0.0, 0.5, 1e-6)
FOUND = {
    "roll per aileron": 8.0,
    "pitch per elevator": -6.0,
    "yaw per rudder": -2.0,
    "roll damping": -2.5,
    "pitch damping": -1.5,
    "pitch stiffness": -4.0,
    "thrust per throttle": 3.0,
    "dynamic pressure": 50.0,
}


def test_the_roll_loops_have_the_poles_they_are_placed_at():
    """p' = L_p p + L_a a with a = k (b (phi_c - phi) - p): the rate at -3 rad/s, bank with it well damped."""
    gains, _ = place_loops(FOUND, 60.0, TRIM, 1.0)
    k, b = gains["roll-rate-gain"], gains["bank-gain"]
    assert_allclose(-2.5 - 8.0 * k, -3.0, atol=1e-9)
    poles = np.linalg.eigvals([[0.0, 1.0], [-8.0 * k * b, -2.5 - 8.0 * k]])
    assert_allclose(np.sort(poles.real), [-2.02, -0.98], atol=0.01)
    assert_allclose(poles.imag, 0.0, atol=1e-9)


def test_the_loops_of_a_glider_have_the_poles_they_are_placed_at():
    """q' = M_q q + M_e k (b e - q); r' = N_b beta + N_r r + rudder, beta' = -r; V' = -g theta."""
    found = {
        **FOUND,
        "yaw per aileron": -0.6,
        "yaw per sideslip": 0.5,
        "yaw damping": -0.3,
        "pitch damping": -1.0,
    }
    gains, _ = place_loops(found, 25.0, TRIM, 1.0, glides=True)
    k, b = gains["pitch-rate-gain"], gains["pitch-gain"]
    w = 1.5 * np.sqrt(4.0)
    assert_allclose(np.poly([[0.0, 1.0], [-6.0 * k * b, -1.0 - 6.0 * k]]), [1.0, 1.6 * w, w**2])
    side, rate = gains["sideslip-gain"], gains["yaw-rate-gain"]
    nose = [[0.0, -1.0], [0.5 + 2.0 * side, -0.3 - 2.0 * rate]]
    assert_allclose(np.poly(nose), [1.0, 1.4 * 1.4, 1.4**2])
    assert_allclose(-0.6 + 2.0 * gains["rudder-aileron-gain"], 0.0, atol=1e-12)
    p, i = 9.81 * gains["glide-gain"], 9.81 * gains["glide-integral-gain"]
    assert_allclose(np.roots([1.0, p, i]).real, -0.15, atol=1e-9)
    assert not {"climb-gain", "speed-gain"} & set(gains)


@pytest.mark.parametrize("damping", [-2.5, -28.0])
def test_bank_follows_as_fast_whatever_the_wing_damps(damping):
    """The slow pole of bank is between 0.6 and 3.3 rad/s, though a light wing rolls at 28 rad/s."""
    gains, _ = place_loops({**FOUND, "roll damping": damping}, 60.0, TRIM, 1.0)
    k, b = gains["roll-rate-gain"], gains["bank-gain"]
    slow = np.linalg.eigvals([[0.0, 1.0], [-8.0 * k * b, damping - 8.0 * k]]).real.max()
    assert -3.3 < slow < -0.6


def test_a_mixture_that_was_asked_for_survives_the_start_of_the_engine():
    """JSBSim makes it full rich; what nobody asked for stays so."""
    fdm = load_aircraft(set_properties(bare("c172p"), {"fcs/mixture-cmd-norm": 0.8}, ()), 0.0025)
    start_engines(fdm)
    assert fdm["fcs/mixture-cmd-norm"] == 0.8
    fdm["fcs/mixture-cmd-norm"] = 0.0
    start_engines(fdm)
    assert fdm["fcs/mixture-cmd-norm"] == 1.0


@pytest.mark.parametrize(("name", "pulls"), [("C130", False), ("c172p", True)])
def test_engines_that_do_not_pull_are_the_reason(monkeypatch, name, pulls):
    """The turbines of the C130 give a thrust to propellers that expect a power."""

    def find_none(*_, **__):
        raise FlightError("no steady flight found")

    monkeypatch.setattr(gain_design, "trim_aircraft", find_none)
    reason = (
        "no steady flight"
        if pulls
        else r"its engines do not pull: full throttle adds 0\.0\d m/s\^2 at 97 m/s"
    )
    with pytest.raises(FlightError, match=reason):
        design_gains(prepare_aircraft(bare(name)), 0.4, 1.0)


def test_a_glider_circles_both_ways_and_is_not_asked_for_height():
    edges = (0.0, 30.0, 110.0, 130.0, 150.0, 170.0, 190.0, 240.0)
    truth = flown()
    both = to_euler(truth.q_nb)[0] - BANK * ((truth.t > edges[3]) & (truth.t < edges[4]))
    truth.q_nb = rotation.from_euler(both, 0 * truth.t, 0 * truth.t)
    truth.lla[:, 2] -= truth.t
    assert measure_acceptance(truth, DESIGN, glides=True).failures() == []
    assert [words[:6] for words in measure_acceptance(truth, DESIGN).failures()] == ["height"]
    wrong = flown()  # straight where it circles to the left
    assert [words[:4] for words in measure_acceptance(wrong, DESIGN, glides=True).failures()] == ["bank"]


@pytest.mark.slow
def test_a_glider_of_the_wheel_gets_gains_and_flies_with_them(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert main(["new", "aircraft", "jsbsim:SGS"]) == 0
    assert "bank within" in capsys.readouterr().out
    glider = read_jsbsim_aircraft("jsbsim:SGS", None, tmp_path)
    assert glider.glides
    assert glider.min_speed < glider.trims[0][1] < glider.max_speed


def flown(seconds=240.0, **wrong):
    """A flight that does what its legs ask for, but for what is wrong."""
    t = np.arange(round(seconds * 100) + 1) / 100.0
    edges = (0.0, 30.0, 110.0, 130.0, 150.0, 170.0, 190.0, 240.0)
    turning = (t > 30.0) & (t < 110.0)
    roll = np.where(turning, BANK, 0.0) + wrong.get("bank", 0.0) * (t > 60.0) * (t < 90.0)
    roll = roll + wrong.get("swing", 0.0) * np.sin(2 * pi * t / 3.0) * (t < 30.0)
    alt = np.full(len(t), 1000.0) + wrong.get("height", 0.0) * (t > 70.0) * (t < 72.0)
    air_t = np.arange(round(seconds * 20) + 1) / 20.0
    speed = np.where(air_t >= 190.0, 63.6, 60.0) * (
        1 + wrong.get("speed", 0.0) * (air_t > 140) * (air_t < 142)
    )
    load = np.where(turning, 1 / np.cos(BANK), 1.0) + wrong.get("load", 0.0) * (t > 80.0) * (t < 81.0)
    events = [(a, b, "leg", str(k)) for k, (a, b) in enumerate(pairwise(edges))]
    return SimpleNamespace(
        t=t,
        q_nb=rotation.from_euler(roll, 0 * t, 0 * t),
        lla=np.column_stack([0 * t, 0 * t, alt]),
        dvel_b=np.column_stack([0 * t, 0 * t, -9.80665 * load * 0.01])[1:],
        air=SimpleNamespace(t=air_t, airspeed_true=speed),
        events=Events.from_rows(events),
    )


DESIGN = SimpleNamespace(alt=1000.0, speed=60.0)


def test_a_flight_as_asked_is_accepted():
    assert measure_acceptance(flown(), DESIGN).failures() == []


@pytest.mark.parametrize(
    ("name", "inside", "outside"),
    [
        ("bank", radians(3.5), radians(4.5)),
        ("height", -14.0, 16.0),
        ("speed", 0.045, -0.055),
        ("load", 0.3, -0.45),
        ("swing", radians(0.6), radians(0.9)),
    ],
)
def test_each_band_is_where_it_is_stated(name, inside, outside):
    """Bank 4 deg, height 15 m, airspeed 5 %, load 0.65 to 1.4, swing 0.5 deg (sd)."""
    assert measure_acceptance(flown(**{name: inside}), DESIGN).failures() == []
    failures = measure_acceptance(flown(**{name: outside}), DESIGN).failures()
    assert [words.split()[0].rstrip("s") for words in failures] == [
        {"speed": "airspeed"}.get(name, name).rstrip("s")
    ]


def bare(name):
    """An aircraft of the wheel as a design begins with it."""
    pattern = read_jsbsim_aircraft("jsbsim:c172x", None, Path())
    folder = pattern.foreign.root / "aircraft" / name
    return set_properties(replace(pattern, name=name, folder=folder, runway=None, gains={}), {}, ())


def test_a_turboprop_with_a_governor_is_trimmed():
    """Its thrust is the same when it is asked again, and stays as it runs on; JSBSim's search swings."""
    craft = set_properties(bare("pc7"), {"propulsion/cutoff_cmd": 0.0, "gear/gear-cmd-norm": 0.0}, ())
    fdm = load_aircraft(craft, 0.0025)
    here = TrimCondition(radians(47.0), radians(11.0), 1200.0, 0.5, 74.0)
    trim = trim_aircraft(fdm, here, guided=False)
    assert trim.residual < 1e-6
    felt = []
    for _ in range(2):
        place(fdm, here, trim.alpha, trim.beta, trim.roll, trim.aileron, trim.elevator, trim.throttle)
        move_surfaces(fdm, trim.aileron, trim.elevator)
        run_engines(fdm)
        felt.append(present_accelerations(fdm)[0])
    assert abs(felt[0] - felt[1]) < 1e-6
    thrust = fdm["propulsion/engine/thrust-lbs"]
    for _ in range(400):
        fdm.run()
    assert_allclose(fdm["propulsion/engine/thrust-lbs"], thrust, rtol=0.02)


def test_a_property_that_a_model_reads_and_does_not_have_is_found_and_declared():
    craft = bare("L17")
    with pytest.raises(FlightError, match=r"fcs/flaps-pos-deg does not exist"):
        load_aircraft(craft, 0.0025)
    stubs = find_stubs(craft)
    assert stubs == ("fcs/flaps-pos-deg",)
    assert load_aircraft(set_properties(craft, {}, stubs), 0.0025)["fcs/flaps-pos-deg"] == 0.0
    with pytest.raises(FlightError, match=r"stubs 'a b' is not a property"):
        load_aircraft(set_properties(craft, {}, ("a b",)), 0.0025)


@pytest.mark.slow
def test_an_aircraft_that_turns_roll_is_held_by_the_last_attempt():
    """The A4 in its circle, whose yaw rolls it: beyond the band where the integral is as usual."""
    craft = prepare_aircraft(bare("A4"))
    *_, (lift, pace, hold) = attempts()
    last, found = design_gains(craft, lift, pace, hold), []
    for slower in (hold, 1.0):
        gains = {**last.gains, "bank-integral-gain": last.gains["bank-integral-gain"] / slower}
        spec = plan_acceptance(equip(craft, replace(last, gains=gains)), last)
        found.append(measure_acceptance(fly_here(replace(spec, legs=spec.legs[:3])), last))
    assert [len(one.failures()) for one in found] == [1, 0]
    assert found[0].bank > BANK_BAND > found[1].bank


@pytest.mark.long
def test_an_aircraft_of_the_wheel_gets_gains_and_flies_with_them(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert main(["new", "aircraft", "jsbsim:c172p"]) == 0
    assert "bank within" in capsys.readouterr().out
    aircraft = read_jsbsim_aircraft("jsbsim:c172p", None, tmp_path)
    assert aircraft.min_speed < aircraft.trims[0][1] < aircraft.max_speed
    assert main(["new", "aircraft", "c172p"]) == 2
    assert "exists already" in capsys.readouterr().err


@pytest.mark.slow
def test_a_folder_of_ones_own_gets_its_gains_and_flies(tmp_path, monkeypatch, capsys):
    """The model of a wheel's aircraft under another name, with an output that must not be written."""
    root = read_jsbsim_aircraft("jsbsim:c172x", None, Path()).foreign.root
    folder = tmp_path / "aircraft" / "mine"
    folder.mkdir(parents=True)
    model = (root / "aircraft" / "T37" / "T37.xml").read_text(encoding="latin-1")
    spying = '<output name="leak.csv" type="CSV" rate="10"/></fdm_config>'
    (folder / "mine.xml").write_text(model.replace("</fdm_config>", spying), encoding="latin-1")
    monkeypatch.chdir(tmp_path)
    assert main(["new", "aircraft", "aircraft/mine"]) == 0
    said = f'Next: a profile beside {folder.parent} with aircraft = "mine"'
    assert said in " ".join(capsys.readouterr().out.split())
    assert sorted(path.name for path in tmp_path.rglob("*.*")) == ["aircraft.toml", "mine.xml"]
    changes = {"aircraft": "mine", "start.speed_mps": 80.0, "start.alt_m": 1200.0}
    legs = [{"kind": "straight", "duration_s": 5.0}]
    (tmp_path / "own.toml").write_text((PROFILES / "s-turns.toml").read_text())
    spec = read_profile(tmp_path / "own.toml", {**changes, "leg": legs}).flight
    assert spec.aircraft.folder == folder
    assert abs(fly(spec).lla[-1, 2] - 1200.0) < 2.0


@pytest.mark.parametrize(
    ("made", "asked", "said"),
    [
        ("a b/a b.xml", "./a b", "must be letters, digits"),
        ("mine/other.xml", "./mine", "mine/mine.xml: no such file; the model of a folder has its name"),
        ("mine/mine.xml", "./mine", "it has the guidance system of the bench"),
        ("mine/aircraft.toml", "./mine", "exists already and is not replaced"),
        ("../mine/mine.xml", "../mine", "must lie in a folder of yours that is named aircraft"),
        ("mine/mine.xml", "mine", "'jsbsim:mine' is not in the wheel; the folder is ./mine"),
    ],
)
def test_a_folder_that_cannot_be_used_says_why(tmp_path, monkeypatch, capsys, made, asked, said):
    (tmp_path / "aircraft").mkdir()
    monkeypatch.chdir(tmp_path / "aircraft")
    path = Path(made)
    path.parent.mkdir()
    system = "" if "aircraft" in made or ".." in made else "<system file='guidance'/>"
    path.write_text(f"<fdm_config>{system}</fdm_config>")
    if path.suffix == ".toml":
        (path.parent / "mine.xml").write_text("<fdm_config/>")
    assert main(["new", "aircraft", asked]) == 2
    assert said in " ".join(capsys.readouterr().err.split())


def test_a_model_that_cannot_be_loaded_is_tried_once(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    folder = tmp_path / "aircraft" / "mine"
    folder.mkdir(parents=True)
    (folder / "mine.xml").write_text("<fdm_config name='mine'><metrics></fdm_config>")
    assert main(["new", "aircraft", "aircraft/mine"]) == 3
    told = capsys.readouterr()
    assert (told.out + told.err).count("mine.xml") == 1, told
    assert list(folder.iterdir()) == [folder / "mine.xml"]


def test_what_is_no_aircraft_is_named(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert main(["new", "aircraft", "c173p"]) == 2
    assert "c172p" in capsys.readouterr().err
    assert not (tmp_path / "aircraft").exists()


@pytest.mark.parametrize("gain_s", [1e-3, 0.0])
def test_a_design_is_timed_by_its_cpu_and_not_by_the_clock_of_a_busy_machine(monkeypatch, gain_s):
    """A child that gets a hundredth of a processor has a hundred times as long; one that hangs has not."""
    looks = count(1)
    monkeypatch.setattr(new_aircraft, "PATIENCE", 0.2)
    monkeypatch.setattr(new_aircraft, "LOOK", 0.05)
    monkeypatch.setattr(new_aircraft, "measure_cpu", lambda _: gain_s * next(looks))
    if gain_s:
        assert new_aircraft.run_in_child("c310", "trimmed", time.sleep, 0.4) is None
    else:
        with pytest.raises(FlightError, match=r"^aircraft c310: not trimmed within 0\.2 s of CPU time$"):
            new_aircraft.run_in_child("c310", "trimmed", time.sleep, 60.0)
