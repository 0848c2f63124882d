"""Required navigation performance: the flight's own error, and a satellite that runs away."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
from numpy.testing import assert_allclose

import bench
from bench import earth, pipeline
from bench.config import load_profile
from bench.data import Events
from bench.errors import ConfigError
from bench.flight.legs.tracks import Waypoint, Waypoints
from bench.flight.off_track import measure_off_track
from bench.studies import rnp

FLIGHT = """
aircraft = "aerosonde"
rate_hz = 100
seed = 11
[start]
lat_deg = 47.0
lon_deg = 11.0
alt_m = 1000.0
heading_deg = 40.0
speed_mps = 25.0
[[leg]]
kind = "straight"
duration_s = 60.0
[sensors]
imu = "adis16475"
gnss = "sky-l1"
baro = "bmp388"
[evaluation]
from_s = 5.0
[[fault]]
kind = "satellite-clock"
start_s = 20.0
duration_s = 40.0
satellites = ["G06"]
ramp_mps = 20.0
[initial_error_sd]
pos_m = [3.0, 3.0, 5.0]
vel_mps = [0.2, 0.2, 0.2]
tilt_deg = 0.2
heading_deg = 0.5
[[estimator]]
use = "loose-15"
"""


@pytest.fixture(scope="module")
def flight(tmp_path_factory):
    path = tmp_path_factory.mktemp("flight") / "fault.toml"
    path.write_text(FLIGHT)
    return str(path)


@pytest.fixture(scope="module")
def result(flight):
    return bench.study("rnp", jobs=1, profile=flight, draws=2, vertical_limit_m=60.0)


def test_a_satellite_that_runs_away_is_left_out_and_misleads_nobody(flight, result):
    one = rnp.watch_run(rnp._Run(rnp.Options(profile=flight), 0))
    assert not one.alarm.any()
    assert (one.error < one.level).all()
    assert np.isfinite(one.level).all()
    stanford = result.tables["stanford"].columns
    for part, runs in zip(stanford["part"], stanford["runs"], strict=True):
        assert runs == (2 if part == "available, bounded" else 0), part


def test_a_satellite_that_creeps_away_is_followed_by_its_own_state(tmp_path):
    """0.3 m/s, 12 m after 40 s: no range of it is far enough off to be refused, and the position stays."""
    errors = []
    start, _, rest = FLIGHT.partition("[[fault]]")
    sound = start + rest[rest.index("[initial_error_sd]") :]
    for name, text in (("creeps", FLIGHT.replace("ramp_mps = 20.0", "ramp_mps = 0.3")), ("sound", sound)):
        path = tmp_path / f"{name}.toml"
        path.write_text(text)
        one = rnp.watch_run(rnp._Run(rnp.Options(profile=str(path)), 0))
        assert not one.alarm.any()
        assert (one.error < one.level).all()
        errors.append(one.error)
    assert np.abs(errors[0] - errors[1]).max() < 0.5


def test_levels_of_a_filter_that_trusts_its_fixes_do_not_allow_for_the_fault(flight):
    one = rnp.watch_run(rnp._Run(rnp.Options(profile=flight, estimator="loose-22"), 0))
    assert not one.alarm.any()
    assert np.isfinite(one.level).all()


def test_levels_and_limits_of_kilometres_have_no_power_of_ten():
    none = np.zeros((2, 3), bool)
    watched = SimpleNamespace(level=np.array([2345.0]), limit=18520.0, misleading=none, hazardous=none)
    told = rnp._tell({}, [watched] * 2, SimpleNamespace(draws=2, estimator="tight"), [])
    assert "median 2340 m, alert limit 18520 m; the error was larger than the level in 0 of 2 runs" in told[1]


def test_without_satellites_tight_is_refused(tmp_path):
    path = tmp_path / "fixes.toml"
    path.write_text(
        FLIGHT.partition("[[fault]]")[0].replace("sky-l1", "l1-code") + "[[estimator]]\nuse = 'loose-15'\n"
    )
    with pytest.raises(ConfigError, match="--gnss sky-l1"):
        bench.study("rnp", jobs=1, profile=str(path), draws=2)


def test_the_flight_is_as_far_off_its_tracks_as_it_was_moved():
    """A motion by hand along two tracks at right angles, 7 m to the right of both."""
    north = np.concatenate([np.linspace(-500.0, 2007.0, 251), np.full(250, 2007.0)])
    east = np.concatenate([np.full(251, -7.0), np.linspace(-7.0, 2500.0, 250)])
    origin = np.array([0.8, 0.2, 500.0])
    at = earth.to_ecef(origin) + np.column_stack([north, east, 0 * north]) @ earth.matrix_en(0.8, 0.2).T
    lla = earth.to_geodetic(at)
    t = np.arange(len(north)) * 0.4
    leg = Waypoints(
        points=tuple(Waypoint(north=n, east=e) for n, e in ((0.0, -14.0), (2014.0, -14.0), (2014.0, 2400.0))),
        bank=np.deg2rad(30.0),
    )
    truth = SimpleNamespace(
        t=t, lla=lla, vel_n=np.tile([25.0, 0.0, 0.0], (len(t), 1)),
        events=Events.from_rows([(0.0, t[-1] + 1.0, "leg", "")]),
    )  # fmt: skip
    spec = SimpleNamespace(legs=(leg,), lat=0.8, lon=0.2, alt=500.0)
    off, course = measure_off_track(spec, truth, np.arange(len(t)))
    on = np.isfinite(off)
    assert_allclose(off[on], 7.0, atol=0.01)
    assert sorted({round(float(np.degrees(c))) for c in course[on]}) == [0, 90]
    assert on.mean() > 0.5


def test_waypoints_are_flown_within_metres():
    profile = load_profile("waypoints", {}, None, ("loose-15",))
    truth = pipeline.fly(profile)
    off, _ = measure_off_track(profile.flight, truth, np.arange(0, len(truth.t), 200))
    assert np.isfinite(off).mean() > 0.4
    assert np.nanmax(np.abs(off)) < 5.0
