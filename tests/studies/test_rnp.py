"""Required navigation performance: the flight's own error, and a satellite that runs away."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy import stats

import bench
from bench import pipeline
from bench.core.mathematics import earth
from bench.core.mathematics.units import STANDARD_GRAVITY
from bench.core.records.data import Events, no_events
from bench.core.records.findings import series
from bench.core.records.specs import EvaluationWindow
from bench.core.words.exceptions import ConfigError
from bench.evaluation.ensembles import rare_events
from bench.experiments.studies import rare_errors, rnp, stanford
from bench.experiments.studies.watched_flights import WatchedFlight
from bench.io.config import read_profile
from bench.simulation.flight.guidance.off_track import measure_off_track
from bench.simulation.flight.legs.tracks import Waypoint, Waypoints

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
    return bench.study("rnp", jobs=1, profiles=flight, runs=2, vertical_limit_m=60.0)


def test_a_satellite_that_runs_away_is_left_out_and_misleads_nobody(flight, result):
    one = rnp.watch_run(rnp.RnpRun(rnp.Options(profiles=flight), 0))
    assert not one.alarm.any()
    assert (one.error < one.level).all()
    assert np.isfinite(one.level).all()
    stanford = result.tables["stanford"].columns
    for part, runs in zip(stanford["part"], stanford["runs"], strict=True):
        assert runs == (2 if part == "available, bounded" else 0), part


def test_a_satellite_that_creeps_away_is_followed_by_its_own_state(tmp_path):
    """0.3 m/s, 12 m after 40 s: no range of it is far enough off to be rejected, and the position stays."""
    errors = []
    start, _, rest = FLIGHT.partition("[[fault]]")
    sound = start + rest[rest.index("[initial_error_sd]") :]
    for name, text in (("creeps", FLIGHT.replace("ramp_mps = 20.0", "ramp_mps = 0.3")), ("sound", sound)):
        path = tmp_path / f"{name}.toml"
        path.write_text(text)
        one = rnp.watch_run(rnp.RnpRun(rnp.Options(profiles=str(path)), 0))
        assert not one.alarm.any()
        assert (one.error < one.level).all()
        errors.append(one.error)
    assert np.abs(errors[0] - errors[1]).max() < 0.5


def test_levels_of_a_filter_that_trusts_its_fixes_do_not_allow_for_the_fault(flight):
    one = rnp.watch_run(rnp.RnpRun(rnp.Options(profiles=flight, estimator="loose-22"), 0))
    assert not one.alarm.any()
    assert np.isfinite(one.level).all()


def ask(monkeypatch, across, off, level=10.0, error=2.0, crashes=(), **more):
    """Return the findings of flights of 100 s with errors of navigation and of the flight by number.

    Those in ``crashes`` end after 40 s.
    """
    truth = SimpleNamespace(t=np.arange(0.0, 100.0))
    made = SimpleNamespace(name="made", evaluation=EvaluationWindow())
    monkeypatch.setattr(rnp, "make_profile", lambda options: made)
    monkeypatch.setattr(rnp, "load_flight", lambda *args: (made, truth, None))

    def fly(number):
        t = truth.t[:40] if number in crashes else truth.t
        one, n = error(number) if callable(error) else error, len(t)
        return WatchedFlight(
            t, np.full((n, 2), one), np.full((n, 2), level), np.zeros(n, bool),
            np.full(n, across(number)), np.full(n, off(number)), number in crashes,
        )  # fmt: skip

    work = SimpleNamespace(
        progress=lambda *args: None, map=lambda what, do, items, first: [fly(one.number) for one in items]
    )
    return rnp.run(rnp.Options(profiles="made", **more), work)


def words(found):
    table = next(one for one in found.tables if one.name == "rnp").columns
    return {figure: word for figure, word in zip(table["figure"], table["word"], strict=True) if word}


def test_60_flights_far_within_meet_what_60_flights_can_show(monkeypatch):
    lines = ("accuracy", "availability")
    found = ask(monkeypatch, lambda k: 3.0, lambda k: -1.0, lines=lines)
    assert words(found) == {
        "time with TSE within RNP": "met", "availability, horizontal": "met", "availability, vertical": "met",
    }  # fmt: skip
    assert (found.good, found.undecided, found.runs) == (True, False, 60)
    assert (
        "RNP 0.3 (556 m): met; across track, turns included, the total error is below 4 m"
        in found.verdicts[0]
    )


def test_what_hours_cannot_show_is_undecided_and_says_how_many_would(monkeypatch):
    found = ask(monkeypatch, lambda k: 3.0, lambda k: -1.0, hours=5.0)
    assert found.runs == 180
    assert (found.good, found.undecided) == (True, True)
    assert words(found)["TSE beyond twice RNP, per hour"] == "undecided"
    assert words(found)["hazardously misleading, per hour, vertical"] == "undecided"
    (text,) = [one for one in found.verdicts if one.startswith("Undecided by 180 flights, 5 h")]
    assert "TSE beyond twice RNP, per hour (300000 h more would decide)" in text
    assert "risk of an alert in 15 s, horizontal (120 h more would decide)" in text  # of 29957 operations


def test_a_total_error_beyond_rnp_misses_it_though_each_part_is_within(monkeypatch):
    """Believed 300 m left of the track and 400 m right of the truth: 700 m are beyond 556."""
    found = ask(monkeypatch, lambda k: 400.0, lambda k: -300.0, lines="accuracy,containment")
    assert words(found) == {
        "time with TSE within RNP": "missed",
        "TSE beyond twice RNP, per hour": "undecided",
    }
    assert not found.good
    other = ask(monkeypatch, lambda k: 400.0, lambda k: 300.0, lines="accuracy")
    assert words(other) == {"time with TSE within RNP": "met"}
    for off, beyond in ((2.1 * 555.6, 36.0), (1.9 * 555.6, 0.0)):  # every flight of 100 s is one event
        found = ask(monkeypatch, lambda k: 0.0, lambda k, off=off: off, lines="containment")
        (table,) = (one.columns for one in found.tables if one.name == "rnp")
        assert table["value"] == [pytest.approx(beyond)]
    without = ask(monkeypatch, lambda k: np.nan, lambda k: np.nan, lines="integrity")
    assert not any("No leg is along waypoints" in text for text in without.verdicts)
    without = ask(monkeypatch, lambda k: np.nan, lambda k: np.nan, lines="accuracy,integrity")
    assert without.verdicts[0].startswith("No leg is along waypoints or to a runway")


def test_one_flight_that_misleads_hazardously_misses_integrity(monkeypatch):
    """An error of 60 m in height, a level of 10 m and a limit of 50 m; in the plane the limit is farther."""
    found = ask(monkeypatch, lambda k: 0.0, lambda k: 0.0, error=lambda k: 60.0 if k == 7 else 2.0)
    assert words(found)["hazardously misleading, per hour, vertical"] == "missed"
    assert words(found)["hazardously misleading, per hour, horizontal"] == "undecided"
    assert words(found)["flights whose errors beyond the limit are told in 10 s, vertical"] == "missed"
    assert any("Vertical" in one and "hazardously in 1" in one for one in found.verdicts)


def test_a_crash_counts_as_one_and_shortens_no_other_flight(monkeypatch):
    """One of 60: it is beyond twice RNP, and where no alarm tells of it, it misleads hazardously."""
    found = ask(monkeypatch, lambda k: 3.0, lambda k: -1.0, crashes=(7,))
    table = next(one for one in found.tables if one.name == "rnp")
    assert "60 flights, 1.67 h" in table.title  # of 100 s each
    judged = words(found)
    assert judged["TSE beyond twice RNP, per hour"] == "missed"
    assert judged["hazardously misleading, per hour, horizontal"] == "missed"
    assert judged["time with TSE within RNP"] == "undecided"  # 99 %, of which one flight has 40
    assert "1 of 60 flights crashed, the first at 39 s" in found.verdicts[0]
    assert "10 % of its mean square by the flight" in found.verdicts[1]
    alone = ask(monkeypatch, lambda k: 3.0, lambda k: -1.0, crashes=range(60), lines="accuracy,containment")
    assert alone.verdicts[0].startswith("60 of 60 flights crashed")
    assert words(alone) == {"time with TSE within RNP": "met", "TSE beyond twice RNP, per hour": "missed"}


def test_the_total_error_is_divided_between_navigation_and_flight(monkeypatch):
    """Across flights variances of 1 and 3: three quarters by the flight."""
    sign = lambda k: 1.0 if k % 2 else -1.0  # noqa: E731
    other = lambda k: 1.0 if k % 4 < 2 else -1.0  # noqa: E731
    found = ask(monkeypatch, sign, lambda k: np.sqrt(3.0) * other(k), lines="accuracy")
    assert "75 % of its mean square by the flight" in found.verdicts[0]


def test_flights_have_turbulence_of_their_own_if_there_is_any(monkeypatch):
    flown = []

    def fly(profile):
        flown.append(profile.seed)
        return SimpleNamespace(t=np.arange(0.0, 1000.0))

    monkeypatch.setattr(rnp.pipeline, "fly", fly)
    for severity, seeds in (("none", [3]), ("light", [3, 4, 5])):
        flown.clear()
        rnp.load_flight.cache_clear()
        options = rnp.Options(
            profiles="waypoints", estimator="loose-15", seed=3, units="stim300",
            overrides={"wind.turbulence": severity},
        )  # fmt: skip
        loaded = [rnp.load_flight(options, k)[0] for k in range(3)]
        assert flown == seeds
        assert loaded[2].sensors.imu.gyro.bias_instability > 0.0
        assert all(len(rnp.load_flight(options, k)[1].t) == 1000 for k in range(3))
    rnp.load_flight.cache_clear()


def test_levels_and_limits_of_kilometers_have_no_power_of_ten(monkeypatch):
    found = ask(monkeypatch, lambda k: 0.0, lambda k: 0.0, level=2345.0, alert_limit_m=18520.0, runs=2)
    text = "median 2340 m, alert limit 18520 m; the error was larger than the level in 0 of 2 flights"
    assert any(text in one for one in found.verdicts)


def test_the_filter_that_flies_is_that_of_the_option():
    with pytest.raises(ConfigError, match=r"^study rnp: --set guidance\.navigation: --estimator sets the"):
        bench.study("rnp", profiles="waypoints-closed", overrides={"guidance.navigation": "loose-22"}, jobs=1)
    whole = {"guidance": {"navigation": "loose-22", "period_s": 0.5}}
    profile = rnp.make_profile(
        rnp.Options(profiles="waypoints-closed", estimator="loose-15", overrides=whole)
    )
    assert (profile.guidance.navigation.use, profile.guidance.period) == ("loose-15", 0.5)


def test_a_line_that_is_none_is_named():
    with pytest.raises(ConfigError, match=r"lines: 'accurancy' is unknown\. Did you mean 'accuracy'"):
        bench.study("rnp", profiles="waypoints", lines="accurancy")


def test_without_satellites_tight_is_refused(tmp_path, monkeypatch):
    path = tmp_path / "fixes.toml"
    path.write_text(
        FLIGHT.partition("[[fault]]")[0].replace("sky-l1", "l1-code") + "[[estimator]]\nuse = 'loose-15'\n"
    )
    with pytest.raises(ConfigError, match="--gnss sky-l1"):
        bench.study("rnp", jobs=1, profiles=str(path), runs=2)
    bare = SimpleNamespace(name="bare", sensors=SimpleNamespace(gnss=None))
    monkeypatch.setattr(rnp, "read_profile", lambda *_: bare)
    with pytest.raises(ConfigError, match="bare has none"):
        rnp.make_profile(rnp.Options(profiles="bare"))
    bare.sensors.gnss, bare.guidance = SimpleNamespace(sky=object()), None
    assert rnp.make_profile(rnp.Options(profiles="bare")) is bare


def fly_by_hand(side, apart, wind_layers=()):
    """Return a flight 25 m/s along two tracks at right angles, an arc between them, all moved to the right.

    The tracks are 14 m off the start's meridian; the second turns to a side, 1 right, -1 left.
    """
    bank, speed, wind = np.deg2rad(30.0), 25.0, 4.0
    radius = (speed + wind) ** 2 / (STANDARD_GRAVITY * np.tan(bank))
    way = np.arange(-300.0, 2014.0 - radius, 5.0)
    turned = np.linspace(0.0, 0.5 * np.pi, 60)
    out = np.arange(radius, 2300.0, 5.0)
    own = radius - side * apart  # of the arc that is flown
    north = np.concatenate(
        [way, 2014.0 - radius + own * np.sin(turned), np.full(len(out), 2014.0 - side * apart)]
    )
    east = np.concatenate([
        np.full(len(way), apart), side * (radius - own * np.cos(turned)), side * out,
    ]) - 14.0  # fmt: skip
    origin = np.array([0.8, 0.2, 500.0])
    at = earth.to_ecef(origin) + np.column_stack([north, east, 0 * north]) @ earth.matrix_en(0.8, 0.2).T
    t = np.arange(len(north)) * 0.2
    points = ((0.0, -14.0), (2014.0, -14.0), (2014.0, -14.0 + side * 2200.0))
    leg = Waypoints(points=tuple(Waypoint(north=n, east=e) for n, e in points), bank=bank)
    truth = SimpleNamespace(
        t=t, lla=earth.to_geodetic(at), vel_n=np.tile([speed, 0.0, 0.0], (len(t), 1)),
        events=Events.from_rows([(0.0, t[-1] + 1.0, "leg", "")]),
    )  # fmt: skip
    spec = SimpleNamespace(
        legs=(leg,), lat=0.8, lon=0.2, alt=500.0, speed=speed, wind_speed=wind, wind_layers=wind_layers
    )
    return spec, truth, (len(way), len(turned))


@pytest.mark.parametrize("side", [1.0, -1.0])
@pytest.mark.parametrize("apart", [7.0, -12.0])
def test_the_flight_is_as_far_off_its_tracks_and_arcs_as_it_was_moved(side, apart):
    spec, truth, (straight, arc) = fly_by_hand(side, apart)
    off, course = measure_off_track(spec, truth, np.arange(len(truth.t)))
    on = np.isfinite(off)
    assert_allclose(off[on], apart, atol=0.05)
    turn = slice(straight, straight + arc)
    assert on[turn].all()
    assert_allclose(course[turn], side * np.linspace(0.0, 0.5 * np.pi, arc), atol=2e-3)
    assert_allclose(course[straight + arc + 20], side * 0.5 * np.pi, atol=1e-3)
    assert not on[:40].any()
    assert on[straight - 100 : -40].all()


def test_with_a_wind_that_changes_with_height_turns_have_no_track():
    spec, truth, (straight, arc) = fly_by_hand(1.0, 7.0, wind_layers=("any",))
    off, _ = measure_off_track(spec, truth, np.arange(len(truth.t)))
    assert np.isnan(off[straight : straight + arc]).all()
    assert_allclose(off[np.isfinite(off)], 7.0, atol=0.05)


def test_where_a_filter_flies_the_total_error_is_that_of_the_truth_and_the_parts_add_up_to_it(tmp_path):
    """FTE anew, from the estimated positions themselves, and NSE by the positions of both: within 1 mm."""
    text = (Path(bench.__file__).parent / "profiles" / "waypoints-closed.toml").read_text()
    points = text.index("  { north_m = -1900.0, east_m = 1000.0 }"), text.index("]\n\n[[leg]]")
    path = tmp_path / "short.toml"
    path.write_text((text[: points[0]] + text[points[1] :]).replace("rate_hz  = 200", "rate_hz  = 100"))
    options = rnp.Options(profiles=str(path), estimator="loose-15", lines="accuracy")
    one = rnp.watch_run(rnp.RnpRun(options, 1))
    profile, truth, steered = rnp.load_flight(options, 1)
    assert profile.guidance.navigation.use == "loose-15"
    rows = np.searchsorted(truth.t, one.t - 1e-6)
    off, course = measure_off_track(profile.flight, truth, rows)
    on = np.isfinite(off)
    assert on.sum() > 30
    assert np.nanmax(np.abs(one.off - one.across - off)) < 1e-3
    answers = steered.lla[np.searchsorted(steered.t, one.t - 1e-6)]
    north, east, _ = earth.difference_n(answers, truth.lla[rows]).T
    assert_allclose(one.across[on], (east * np.cos(course) - north * np.sin(course))[on], atol=1e-3)
    lla = truth.lla.copy()
    lla[rows] = answers
    believed, _ = measure_off_track(profile.flight, replace(truth, lla=lla), rows)
    both = on & np.isfinite(believed) & (np.abs(np.gradient(course)) < 1e-6)
    assert both.sum() > 20
    assert_allclose(one.off[both], believed[both], atol=0.01)
    assert np.abs(one.across[on]).max() > 0.3
    rnp.load_flight.cache_clear()


def test_waypoints_are_flown_within_meters():
    profile = read_profile("waypoints", {}, None, ("loose-15",))
    truth = pipeline.fly(profile)
    off, _ = measure_off_track(profile.flight, truth, np.arange(0, len(truth.t), 200))
    assert np.isfinite(off).mean() > 0.7
    assert np.nanmax(np.abs(off)) < 12.0


def test_levels_over_time_are_the_least_and_errors_the_largest_of_all_flights(monkeypatch):
    found = ask(monkeypatch, lambda k: 0.0, lambda k: 0.0, error=lambda k: 1.0 + k, runs=3)
    for plane, limit in (("horizontal", 555.6), ("vertical", 50.0)):
        (plot,) = [one for one in found.figures if one.path[1] == f"levels-{plane}"]
        for line, value in zip(plot.series, (10.0, 3.0, limit), strict=True):
            assert_allclose(line.t, np.arange(100.0))
            assert_allclose(line.values, value)
        assert len({line.colors for line in plot.series}) == 3
        (plot,) = [one for one in found.figures if one.path[1] == f"stanford-{plane}"]
        dots, equal, most = plot.series
        assert (dots.colors, dots.widths) == (series.ESTIMATORS[:1], (1.2,))
        assert_allclose(np.sort(dots.t), np.repeat([1.0, 2.0, 3.0], 100))
        assert_allclose(dots.values, 10.0)
        assert_allclose(equal.t, [1.0, 1.5 * limit])
        assert_allclose(equal.values[:, 0], equal.t)
        assert_allclose(most.values, limit)


def test_instants_are_the_rows_of_whole_seconds_whatever_their_last_digits():
    """From the first second that is evaluated to the last of the truth, each the row nearest to it."""
    t = np.arange(601) / 100.0
    t[300], t[400] = 3.0 - 1e-9, 4.0 + 1e-9
    profile = SimpleNamespace(evaluation=SimpleNamespace(begin=1.2))
    assert rnp.choose_rows(SimpleNamespace(t=t), profile).tolist() == [200, 300, 400, 500, 600]
    later = rnp.choose_rows(SimpleNamespace(t=t[250:550]), profile)
    assert later.tolist() == [50, 150, 250]


def test_steering_errors_are_those_of_the_answer_at_the_instant(monkeypatch):
    t = np.array([0.0, 1.0 + 1e-9, 2.0 - 1e-9, 3.0])
    errors = SimpleNamespace(t=t, pos_n=np.outer(np.arange(4.0), [1.0, 2.0, 3.0]))
    monkeypatch.setattr(rnp, "error_series", lambda *_: errors)
    found = rnp.find_steering_errors(None, None, np.array([1.0, 2.0, 2.5, 4.0]))
    assert found[:, 0].tolist() == [1.0, 2.0, 3.0, 3.0]


@pytest.mark.parametrize(("event", "word", "high"), [(False, "met", 1e-5), (True, "undecided", None)])
def test_alerts_of_one_flight_come_together_and_may_decide_less(monkeypatch, event, word, high):
    """A rate that is met, but with all alerts in one flight of eight the risk may be above 1e-4."""
    begun, lost = np.ones((8, 50), bool), np.zeros((8, 50), bool)
    lost[3, :5] = event
    met = rnp.JudgedFigure(rnp.Estimate(0.0, 0.0, 1e-5), "met", 2.0)
    monkeypatch.setattr(rnp, "count_windows", lambda watched, seconds: (begun, lost))
    monkeypatch.setattr(rnp, "judge_rate", lambda count, tried, most: met)
    rows = list(rnp.list_continuity([None, None], rnp.Options(profiles="waypoints")))
    assert [row["figure"] for row in rows] == [f"risk of an alert in 15 s, {plane}" for plane in rnp.PLANES]
    for row in rows:
        assert row["word"] == word
        assert row["more_h"] == pytest.approx(2.0 * 15.0 / 3600.0)
        assert row["high"] == high if high else 1e-4 < row["high"] <= 1.0
        assert row["value"] == (5.0 / 400.0 if event else 0.0)


@pytest.mark.parametrize("steered", [False, True])
def test_a_flight_is_watched_in_the_plane_and_in_height_by_hand(monkeypatch, steered):
    """Errors of 3, 4 and -12 m. Where answers steered it, at the first of them from each second on."""
    truth = SimpleNamespace(t=np.linspace(0.0, 4.0, 401), events=no_events())
    answers = (
        SimpleNamespace(t=np.array([0.0, 0.7, 1.0 - 1e-9, 1.4, 2.3 + 1e-9, 3.0, 3.2])) if steered else None
    )
    profile = SimpleNamespace(evaluation=EvaluationWindow(1.0), flight=None)
    sensed = SimpleNamespace()

    def measure(truth, solution):
        n = len(solution.t)
        return SimpleNamespace(t=solution.t, pos_n=np.tile([3.0, 4.0, -12.0], (n, 1)))

    level = SimpleNamespace(level=np.full((3, 2), 20.0), alarm=np.zeros(3, bool))
    monkeypatch.setattr(rnp, "load_flight", lambda options, number: (profile, truth, answers))
    monkeypatch.setattr(rnp.pipeline, "sense", lambda *given: sensed)
    monkeypatch.setattr(rnp, "navigate", lambda profile, sensed, t: SimpleNamespace(t=t))
    monkeypatch.setattr(rnp, "error_series", measure)
    monkeypatch.setattr(rnp, "protect_fault_free", lambda solution: level)
    found = rnp.watch_run(rnp.RnpRun(rnp.Options(profiles="made", estimator="loose-15"), 0))
    assert_allclose(found.t, [1.0, 2.3, 3.0] if steered else [1.0, 2.0, 3.0, 4.0])
    assert_allclose(found.error, [[5.0, 12.0]] * len(found.t))
    assert np.isnan(found.across).all()
    assert not found.crashed


@pytest.mark.parametrize("steered", [False, True])
def test_errors_across_track_are_those_to_the_right_of_the_course_by_hand(monkeypatch, steered):
    """3 m north and 4 m east on a course of 30 deg; the truth is 7 m right of its track."""
    truth = SimpleNamespace(t=np.arange(4.0), events=no_events())
    profile = SimpleNamespace(evaluation=EvaluationWindow(0.0), flight=object.__new__(rnp.FlightSpec))
    apart = SimpleNamespace(t=truth.t, pos_n=np.tile([3.0, 4.0, 0.0], (4, 1)))
    path = SimpleNamespace(right=np.full(4, 7.0), course=np.full(4, np.deg2rad(30.0)))
    level = SimpleNamespace(level=np.full((4, 2), 20.0), alarm=np.zeros(4, bool))
    answers = SimpleNamespace(t=truth.t) if steered else None
    monkeypatch.setattr(rnp, "load_flight", lambda options, number: (profile, truth, answers))
    monkeypatch.setattr(rnp.pipeline, "sense", lambda *given: None)
    monkeypatch.setattr(rnp, "navigate", lambda profile, sensed, t: SimpleNamespace(t=t))
    monkeypatch.setattr(rnp, "error_series", lambda truth, solution: apart)
    monkeypatch.setattr(rnp, "protect_fault_free", lambda solution: level)
    monkeypatch.setattr(rnp, "measure_off_path", lambda flight, truth, rows: path)
    found = rnp.watch_run(rnp.RnpRun(rnp.Options(profiles="made", estimator="loose-15"), 0))
    across = 4.0 * np.sqrt(0.75) - 3.0 * 0.5
    assert_allclose(found.across, across)
    assert_allclose(found.off, 7.0 + across if steered else 7.0)


def test_each_subfilter_is_without_one_satellite_and_has_all_others(monkeypatch):
    """Two systems that use a number twice."""
    system, sat = np.array([0, 1, 0, 1, 0]), np.array([3, 3, 5, 4, 3])
    seen = [(0, 3), (0, 5), (1, 3), (1, 4)]

    monkeypatch.setattr(rnp, "list_satellites", lambda o: seen)
    monkeypatch.setattr(rnp, "take_rows", lambda o, kept: kept)
    monkeypatch.setattr(rnp, "replace", lambda one, **new: next(iter(new.values())))
    sensed = SimpleNamespace(data=SimpleNamespace(observations=SimpleNamespace(system=system, sat=sat)))
    for (lost, number), kept in zip(seen, rnp.leave_out(sensed), strict=True):
        assert kept.tolist() == [(a, b) != (lost, number) for a, b in zip(system, sat, strict=True)]


def test_a_risk_is_undecided_without_an_operation_and_never_above_one(monkeypatch):
    """No window at all; none that begins without an alert; half of the flights, lost in every window."""
    begun = np.zeros((8, 50), bool)
    options = rnp.Options(profiles="waypoints")
    for windows in (None, (begun, begun)):
        monkeypatch.setattr(rnp, "count_windows", lambda watched, seconds, windows=windows: windows)
        for row in rnp.list_continuity([None, None], options):
            assert (row["word"], row["value"], row["more_h"]) == ("undecided", None, None)
    begun[:4] = True
    monkeypatch.setattr(rnp, "count_windows", lambda watched, seconds: (begun, begun))
    assert [row["high"] for row in rnp.list_continuity([None, None], options)] == [1.0, 1.0]


def test_the_parts_of_the_stanford_diagram_by_hand():
    """Two flights of four epochs: bounded, beyond the limit of 50 m, misleading, hazardous; an alarm."""
    error = np.array([[1.0, 1.0, 20.0, 60.0], [1.0, 1.0, 1.0, 60.0]])
    level = np.array([[10.0, 51.0, 10.0, 10.0], [10.0, 10.0, 10.0, 10.0]])
    alarm = np.array([[False] * 4, [False, False, False, True]])
    both = [stanford.Watched(1.0, error, level, alarm, 50.0)] * 2
    found = stanford.tabulate_stanford(both).columns
    assert found["plane"] == ["horizontal"] * 4 + ["vertical"] * 4
    assert found["instants_percent"][:4] == [50.0, 25.0, 12.5, 12.5]
    assert found["runs"][:4] == [2, 2, 1, 1]
    assert found["runs_low_percent"][2] == pytest.approx(100.0 * stats.beta.ppf(0.025, 1, 2))
    assert found["runs_high_percent"][2] == pytest.approx(100.0 * stats.beta.ppf(0.975, 2, 1))
    assert found["runs_high_percent"][0] == 100.0


def test_a_rare_error_has_a_rate_without_flying_as_many_hours(flight, monkeypatch):
    """The horizontal limit is exceeded by about a quarter of the runs, the vertical one by all."""
    monkeypatch.setattr(rare_events, "REPETITIONS", 2)
    options = {"profiles": (flight,), "estimator": "loose-15", "runs": 2, "lines": ("integrity",)}
    plain = [rnp.measure_largest(rnp.RnpRun(rnp.Options(**options), k)) for k in range(12)]
    limit = float(np.quantile([one[0] for one in plain], 0.75))
    found = bench.study("rnp", **options, jobs=1, rare_runs=20, alert_limit_m=limit, vertical_limit_m=1e-3)
    columns = found.tables["rnp"].columns
    rows = [dict(zip(columns, row, strict=True)) for row in zip(*columns.values(), strict=True)]
    horizontal, vertical = (row for row in rows if "beyond the alert limit" in row["figure"])
    per_hour = 3600.0 / 56.0  # of one event in each flight
    assert 0.05 * per_hour < horizontal["value"] < 0.6 * per_hour
    assert vertical["value"] == pytest.approx(per_hour, rel=0.05)
    assert (horizontal["word"], horizontal["required"]) == ("undecided", "<= 1e-05")
    assert sum("subset simulation of" in line for line in found.verdicts) == 2


def test_a_flight_that_a_filter_guides_is_not_moved():
    with pytest.raises(ConfigError, match="--rare-runs: a filter guides this flight"):
        bench.study("rnp", profiles=("waypoints-closed",), estimator="loose-15", rare_runs=20, jobs=1)


@pytest.mark.parametrize(
    ("errors", "largest"),
    [
        ([[3.0, -4.0, 1.0], [0.0, 0.0, -2.0]], [5.0, 2.0]),
        ([[0.0, np.nan, 1.0]], [np.inf, 1.0]),
        ([], [np.inf] * 2),
    ],
)
def test_the_largest_error_of_a_run_is_infinite_without_a_solution(errors, largest):
    assert rare_errors.find_largest(np.reshape(errors, (-1, 3))).tolist() == largest
