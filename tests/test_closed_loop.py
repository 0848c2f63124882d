"""The filter flies: without error no bit changes, a recorded flight repeats its answers, a crash counts."""

from __future__ import annotations

from dataclasses import replace
from importlib.resources import files

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from bench import pipeline
from bench.cli.command_line import main
from bench.core.records.data import NavSolution
from bench.core.records.flight_specs import FlightSpec
from bench.core.words.exceptions import ConfigError, EstimatorError
from bench.io import config, results
from bench.io.config.listing import list_profiles
from bench.navigation.open_filters import PieceFilter
from bench.pipeline import closed_loop
from bench.simulation.flight import fly_pieces
from bench.simulation.flight.guidance.belief import Belief, NavEstimate
from bench.simulation.flight.legs.level import Straight
from bench.simulation.flight.legs.taxi import Taxi
from tests.flight.plans import plan, short_plan
from tests.flight.test_legs_ground import KINDS, standing

PROFILE = """
title = "A minute that an estimate flies"
aircraft = "aerosonde"
rate_hz = 100
seed = 4

[start]
lat_deg = 47.26
lon_deg = 11.34
alt_m = 1200.0
heading_deg = 85.0
speed_mps = 25.0

[[leg]]
kind = "straight"
duration_s = 10.0

[[leg]]
kind = "turn"
by_deg = 90.0
bank_deg = 25.0

[[leg]]
kind = "straight"
duration_s = 15.0

[sensors]
imu = "adis16475"
gnss = "zed-f9p"
baro = "bmp388"
mag = "rm3100"

[evaluation]
from_s = 10.0

[guidance]
navigation = "loose-15"

[[estimator]]
use = "loose-15"
"""
COLUMNS = ("t", "lla", "vel_n", "q_nb", "dtheta_b", "dvel_b")


@pytest.fixture
def profile(tmp_path):
    path = tmp_path / "closed.toml"
    path.write_text(PROFILE)
    return path


def same_bits(one, other, names=COLUMNS):
    for name in names:
        assert_array_equal(getattr(one, name), getattr(other, name), err_msg=name)


def perfect(piece):
    """An estimate without error at the end of a piece."""
    nothing = np.zeros((1, 9, 9))
    solution = NavSolution(
        piece.t[-1:], piece.lla[-1:], piece.vel_n[-1:], piece.q_nb[-1:], np.zeros((1, 3)), np.zeros((1, 3)),
        nothing, (), np.zeros((1, 0)), np.zeros((1, 0)),
    )  # fmt: skip
    return NavEstimate(float(piece.t[-1]), piece, solution, np.zeros(3))


def fly_by_truth(spec, mode="held", seconds=0.05, latency=0.05):
    belief, flown = Belief(mode, latency), []
    for piece in fly_pieces(spec, None, seconds, belief):
        flown.append(piece)
        belief.take(perfect(piece))
    return results.join_pieces(flown)


def test_an_estimate_without_error_flies_the_same_bits():
    same_bits(fly_by_truth(short_plan()), results.join_pieces(fly_pieces(short_plan())))


@pytest.mark.long
@pytest.mark.parametrize("name", [one.name for one in list_profiles()])
def test_an_estimate_without_error_flies_the_same_bits_on_every_profile(name):
    spec = config.read_profile(name).flight
    assert isinstance(spec, FlightSpec)
    same_bits(fly_by_truth(spec, seconds=1.0), results.join_pieces(fly_pieces(spec)))


def test_the_last_estimate_itself_is_late_and_flies_all_the_same():
    """In a turn a heading that is 0.25 s late is behind: another flight, which ends on the same heading."""
    exact, late = results.join_pieces(fly_pieces(short_plan())), fly_by_truth(short_plan(), "state", 0.2)
    assert np.abs(late.lla - exact.lla)[-1, :2].max() > 1e-8
    assert_allclose(late.q_nb[-1], exact.q_nb[-1], atol=0.02)


def test_a_recorded_flight_gives_the_answers_that_flew_it(profile):
    """Sensed and navigated again: the same bits; `navigate` on the whole record ends on the last of them."""
    loaded = config.read_profile(profile)
    flown = closed_loop.fly(loaded, run=2)
    again = closed_loop.replay(loaded, flown.truth, run=2)
    same_bits(again, flown.answers, ("t", "lla", "vel_n", "q_nb", "gyro_bias_b", "accel_bias_b", "cov"))
    assert len(again) == np.ceil(flown.truth.t[-1] / 0.2)
    sensed = pipeline.sense(loaded, flown.truth, 2)
    final = pipeline.navigate(loaded.estimators[0], sensed.data, sensed.initial)
    same_bits(closed_loop.fly(loaded, run=2).truth, flown.truth)
    assert_array_equal(final.lla[-1], flown.answers.lla[-1])
    other = closed_loop.fly(loaded, run=3).truth
    assert not np.array_equal(other.lla[-1], flown.truth.lla[-1])


def test_what_the_filter_refused_in_flight_is_told_as_of_the_whole_record(profile):
    """Each innovation once, and an alarm that stands at the end of the flight."""
    fault = """
[[fault]]
kind = "spoofing"
start_s = 20.0
duration_s = 600.0
step_m = [30.0, 0.0, 0.0]
"""
    profile.write_text(profile.read_text() + fault)
    loaded = config.read_profile(profile)
    flown = closed_loop.fly(loaded)
    sensed = pipeline.sense(loaded, flown.truth)
    final = pipeline.navigate(loaded.estimators[0], sensed.data, sensed.initial)
    columns = ("t", "code", "component", "z", "S", "nis", "accepted")
    same_bits(flown.answers.innovations, final.innovations, columns)
    assert flown.answers.events.rows() == final.events.rows()
    assert not final.innovations.accepted.all()


def test_a_filter_that_dies_as_it_answers_has_told_each_innovation_once(profile, monkeypatch):
    answer = PieceFilter.current

    def fail(self):
        if self.t > 8.0:
            raise EstimatorError("no more")
        return answer(self)

    monkeypatch.setattr(PieceFilter, "current", fail)
    flown = closed_loop.fly(config.read_profile(profile))
    table = flown.answers.innovations
    told = np.stack([table.t, table.code, table.component], axis=1)
    assert len(np.unique(told, axis=0)) == len(told) > 0
    assert flown.answers.t[-1] < 8.1 < flown.truth.t[-1]


CATALOG = {
    kind: sorted(one.stem for one in (files("bench") / "catalog" / kind).iterdir())
    for kind in ("imu", "gnss", "baro", "mag", "airspeed", "radar", "heading")
}
UNITS = [  # on each flight the next of every kind, until all have flown
    {"rate_hz": 200, **{f"sensors.{kind}": names[k % len(names)] for kind, names in CATALOG.items()}}
    for k in range(max(map(len, CATALOG.values())))
]
COMPILED = ("loose-22", "loose-mems", "loose-full", "tight", "baro-inertial", "free-inertial")


@pytest.mark.long
@pytest.mark.parametrize(
    "change",
    UNITS + [{"guidance.navigation": use, "sensors.gnss": "sky-l1"} for use in COMPILED],
    ids=lambda change: "-".join(map(str, change.values())),
)
def test_a_flight_gives_its_answers_again_with_every_unit_and_compiled_filter(change, profile):
    loaded = config.read_profile(profile, change)
    flown = closed_loop.fly(loaded, run=1)
    again = closed_loop.replay(loaded, flown.truth, run=1)
    same_bits(again, flown.answers, ("t", "lla", "vel_n", "q_nb", "gyro_bias_b", "accel_bias_b", "cov"))
    assert np.isfinite(flown.answers.lla).all()
    sensed = pipeline.sense(loaded, flown.truth, 1)
    assert loaded.guidance is not None
    final = pipeline.navigate(loaded.guidance.navigation, sensed.data, sensed.initial)
    assert_array_equal(final.lla[-1], flown.answers.lla[-1])


def test_what_is_believed_moves_the_flight():
    """Believing to be 40 m higher than it is, it flies 40 m lower; a crash ends the truth, and is told."""
    spec = plan(Straight(60.0), alt=100.0)

    def flown(alt_error):
        belief, pieces = Belief("held", 0.05), []
        for piece in fly_pieces(spec, None, 0.2, belief):
            pieces.append(piece)
            estimate = perfect(piece)
            lla = piece.lla[-1:] + np.array([0.0, 0.0, alt_error])
            belief.take(replace(estimate, solution=replace(estimate.solution, lla=lla)))
        return results.join_pieces(pieces)

    lower = flown(40.0)
    assert_allclose(lower.lla[-1, 2], 100.0 - 40.0, atol=1.0)
    crashed = flown(200.0)
    (t, _, text) = crashed.events.select("crash")[0]
    assert "flew into the ground" in text
    assert 0 < crashed.lla[-1, 2] < 20.0
    assert_allclose(crashed.t[-1], t, atol=1e-9)
    assert crashed.events.select("leg")[-1][2].endswith("not flown to its end")


def test_wheels_tell_that_it_stands():
    """An estimate that is 0.5 m/s off does not keep an aircraft rolling on the ground."""
    kind = KINDS["aerosonde"]
    spec = standing(Taxi(40.0, 5.0, stops=1, stop=3.0), aircraft=kind.aircraft, speed=kind.climb[1])
    belief, pieces = Belief("held", 0.05), []
    for piece in fly_pieces(spec, None, 0.2, belief):
        pieces.append(piece)
        estimate = perfect(piece)
        vel_n = piece.vel_n[-1:] + np.array([0.5, 0.0, 0.0])
        belief.take(replace(estimate, solution=replace(estimate.solution, vel_n=vel_n)))
    flown = results.join_pieces(pieces)
    assert len(flown.events.select("crash")) == 0
    assert np.abs(flown.vel_n[-1]).max() < 0.05


def test_run_shows_the_answers_that_steered(profile, tmp_path, capsys):
    assert main(["run", str(profile), "-o", str(tmp_path / "out"), "--no-rrd", "--no-report"]) in (0, 1)
    assert "in-flight" in capsys.readouterr().out


BROKEN = """
from bench.navigation.built_in import load

class Mine:
    def __init__(self, *, until):
        self.one, self.until = load("loose-15", {}), until

    def run(self, sensors, initial):
        return self.one.run(sensors, initial)

    def in_pieces(self, first, initial, events):
        return Passage(self.one.in_pieces(first, initial, events), self.until)

class Passage:
    def __init__(self, one, until):
        self.one, self.until = one, until

    end = property(lambda self: self.one.end)

    def update(self, piece, look_back, *, last):
        if piece.imu.t[-1] > self.until:
            return self.one.a_name_misspelt
        return self.one.update(piece, look_back, last=last)

    def current(self, head):
        return self.one.current(head)

    def copy(self):
        return Passage(self.one.copy(), self.until)
"""


@pytest.mark.parametrize("until", [8.0, -1.0], ids=["in flight", "before its first answer"])
def test_a_bug_in_the_filter_that_flies_keeps_its_traceback(until, profile, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "broken_filter.py").write_text(BROKEN)
    text = profile.read_text()
    profile.write_text(
        text.replace('navigation = "loose-15"', f'navigation = "broken_filter:Mine"\noptions.until = {until}')
    )
    out = tmp_path / "out"
    status = main(["run", str(profile), "-o", str(out), "--no-rrd", "--no-report", "--allow-code"])
    said = capsys.readouterr()
    assert status == 70
    assert "return self.one.a_name_misspelt" in said.err
    assert "AttributeError" in said.err
    assert out.exists() == (until > 0)  # what it flew is a result; without an answer there is none


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"guidance.navigation": "smoother"}, "cannot run in pieces"),
        ({"guidance.navigation": "loos-15"}, "runs in pieces. Did you mean .loose-15."),
        ({"guidance.period_s": 0.12}, "must be a multiple of 0.05 s"),
        ({"guidance.latency_s": 0.01}, "latency_s"),
        ({"guidance.navigation": "mine:Mine"}, "is code that would run on this machine"),
    ],
)
def test_what_cannot_fly_is_refused_in_a_line(profile, change, message):
    with pytest.raises(Exception, match=message) as caught:
        closed_loop.fly(config.read_profile(profile, change))
    assert isinstance(caught.value, ConfigError) or "pieces" in str(caught.value)
