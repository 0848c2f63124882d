"""Drift without GNSS: measured against the covariance, the closed form and the tables of the register."""

from __future__ import annotations

from types import SimpleNamespace
from typing import get_args

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy import stats

import bench
from bench import pipeline
from bench.core.words.exceptions import ConfigError
from bench.evaluation.linear.drift_laws import drift_sd, split_drift
from bench.experiments.studies.linear_flight import GRADES, LOST, LinearFlight, Phase
from bench.experiments.studies.outage_study import outage_drift, outage_grades, outage_tables
from bench.experiments.studies.outage_study.outage_grades import Grown, find_time, plot_grades
from bench.experiments.studies.outage_study.outage_growth import Drift, pair_units
from bench.experiments.studies.outage_study.outage_tables import tell_drifts
from bench.io.config.listing import PROFILES
from tests.synthetic import turning

ALONE = {  # section 4, outage s: accelerometer m, gyro m, of the bias of each grade alone
    ("grade-1", 60): (0.18, 0.01),
    ("grade-1", 300): (4.4, 1.06),
    ("grade-1", 600): (16.9, 8.3),
    ("grade-2", 300): (21.8, 2.1),
    ("grade-2", 600): (84, 16.6),
    ("grade-3", 300): (43.6, 21.2),
    ("grade-3", 600): (169, 166),
}
PRINTED_AFTER = {"grade-1": 155, "grade-2": 140, "grade-3": 84, "MEMS": 37}  # 5 m east, S-turns [s]
DRAWS = 12
PHASES_FLOWN = get_args(Phase)


def make_drift(sizes, law=None):
    """Return the drift of R runs whose north error grows as sizes (R, D) by the second, reported as 2 m."""
    grid = np.arange(1.0, sizes.shape[1] + 1.0)
    grown = np.zeros((*sizes.shape, 5))
    grown[:, :, 0], grown[:, :, 3], grown[:, :, 4] = sizes, sizes**2, 4.0
    return Drift(grid, grown, law or {"gyro bias": 0.1 * grid, "receiver velocity": 0.2 * grid})


def test_a_convex_drift_reaches_its_limit_where_it_does():
    """t^3 / 1000 is 5 m after 17.1 s; between 10 and 600 s in a line it would be after 10 s."""
    t = np.arange(1.0, 601.0)
    assert find_time(t, t**3 / 1000.0, 5.0) == pytest.approx(5000.0 ** (1.0 / 3.0), abs=0.02)
    assert find_time(t, t, 0.5) == 1.0
    assert find_time(t, t, 600.0) is None
    assert find_time(3.0 * t, 3.0 * t, 20.0) == pytest.approx(20.0)
    assert find_time(t, np.where(t < 100, t, 0.0), 50.0) == pytest.approx(50.0)  # the first time


def test_the_drift_of_draws_that_are_known():
    """Two runs of t and 7 t: 5 t RMS, median 4 t; one is lost and in nothing."""
    t = np.arange(1.0, 11.0)
    lost = np.full(10, np.nan)
    drift = make_drift(np.array([t, lost, 7.0 * t]))
    assert (drift.lost, len(drift.good)) == (1, 2)
    assert_allclose(drift.rms[:, 0], 5.0 * t)
    assert_allclose(drift.error[:, 0], 5.0 * t)
    assert (drift.rms[:, 1] < drift.rms[:, 0]).all()
    assert drift.quantile(1, 0.5) == pytest.approx(8.0)
    assert_allclose(drift.claimed, 2.0)
    assert_allclose(drift.whole_law, np.hypot(0.1, 0.2) * t)
    value, low, high = drift.find_times(20.0)
    assert value == pytest.approx(4.0)
    assert low < value
    assert high is None
    assert make_drift(np.array([lost, t])).find_times(1.0) == (None, None, None)


def test_the_closed_form_is_divided_by_source():
    """On a straight course they are those of the datasheet; the receiver's wander is a part of its own."""
    options = outage_drift.Options(outages_s=(60.0,), gnss="matched-white")
    straight, wandering = (
        outage_drift.make_profile(options.model_copy(update={"gnss": gnss}), "adis16475", "straight", 60.0)
        for gnss in ("matched-white", "l1-code")
    )
    grid = outage_drift.make_grid(straight, (10.0, 60.0))
    assert grid[0] == 1.0
    assert grid[-1] == 60.0
    assert len(grid) == 60
    law, more = (outage_drift.find_law(one, grid) for one in (straight, wandering))
    assert "receiver velocity" not in law
    expected = split_drift(60.0, straight.sensors.imu)
    for name, values in law.items():
        assert values[-1] == pytest.approx(np.sqrt(2.0) * expected[name], rel=0.02), name
    own = wandering.sensors.gnss.vel_markov_sd
    assert more["receiver velocity"][-1] == pytest.approx(np.sqrt(2.0) * own * 60.0, rel=0.01)
    both = Drift(np.array(grid), np.zeros((2, 60, 5)), more).whole_law[-1]
    assert both == pytest.approx(np.sqrt(2.0) * drift_sd(60.0, wandering.sensors.imu, velocity=own), rel=0.02)


def test_units_are_paired_from_the_best_on_and_one_with_a_lost_draw_is_not():
    rng = np.random.default_rng(4)
    t, noise = np.arange(1.0, 101.0), np.abs(rng.standard_normal((8, 1)))
    lost = noise * t
    lost[3] = np.nan
    drifts = {
        ("worse", "straight"): make_drift(2.0 * noise * t),
        ("best", "straight"): make_drift(noise * np.where(np.abs(t - 60.0) < 20.0, t, 5.0 * t)),
        ("lost", "straight"): make_drift(0.1 * lost),
    }
    (pair,) = pair_units(drifts, ("worse", "lost", "best"), "straight")
    assert (pair.first, pair.second, pair.word) == ("best", "worse", "better")
    assert pair.ratio.value == pytest.approx(0.5)
    names = ("worse", "lost", "best")
    told = list(tell_drifts(names, "loose-full", drifts, {"straight": [pair]}, (60.0,), 5.0))
    assert any(
        "best over worse 0.5 (0.5 to 0.5, if no rare large run exists): better" in text for text in told
    )
    assert any("lost straight 1 of 8" in text for text in told)
    assert any("comes from: receiver velocity (worse, " in text for text in told)


def test_tables_words_and_pictures_of_a_drift_by_hand():
    """Four runs of 1, 2, 3 and 4 m/s, reported as 2 m/s; the closed form has 0.3 and 0.4 m/s."""
    t, speeds = np.arange(1.0, 61.0), np.array([1.0, 2.0, 3.0, 4.0])[:, None]
    drift = make_drift(speeds * t, {"gyro bias": 0.3 * t, "receiver velocity": 0.4 * t})
    drift.grown[:, :, 4] = np.square(2.0 * t)
    drifts = {("my/own.toml", "straight"): drift}
    units = {"my/own.toml": SimpleNamespace(grade="tactical")}
    tables = {
        one.name: one.columns for one in outage_tables.fill_drifts(drifts, units, (10.0, 60.0, 90.0), 5.0)
    }
    rms = np.sqrt(7.5)
    assert tables["drift"]["outage_s"] == [10.0, 60.0], "90 s were not flown"
    assert_allclose(tables["drift"]["drift_m"], [10.0 * rms, 60.0 * rms])
    assert_allclose(tables["drift"]["median_m"], [25.0, 150.0])
    assert_allclose(tables["drift"]["predicted_m"], [5.0, 30.0])
    assert_allclose(tables["reported"]["error_m"], tables["drift"]["drift_m"])
    assert_allclose(tables["reported"]["reported_m"], [20.0, 120.0])
    assert_allclose(tables["axes"]["north_m"], tables["drift"]["drift_m"])
    assert_allclose(tables["axes"]["largest_m"], [40.0, 240.0])
    assert_allclose(tables["sources"]["percent"], [36.0, 64.0] * 2)
    assert_allclose(
        [tables["times"][key][0] for key in ("after_s", "predicted_s", "reported_s")], [5.0 / rms, 10.0, 2.5]
    )
    longer, first, times, made, claims = tell_drifts(
        ["my/own.toml"], "mine", drifts, {"straight": []}, (10.0, 60.0, 110.0), 5.0
    )
    assert longer == "straight: the outage lasts 60 s; no result after 110 s."
    (_, last, *_) = tell_drifts(["my/own.toml"], "mine", drifts, {"straight": []}, (90.0,), 5.0)
    assert last.startswith("Drift after 60 s without GNSS"), "the last second that is flown"
    assert first.startswith(
        "Drift after 60 s without GNSS, straight, RMS and by the closed form [m]: my/own.toml 164 ("
    )
    assert first.endswith("), 30.")
    assert "my/own.toml 2 s (" in times
    assert made.endswith("comes from: receiver velocity (my/own.toml).")
    assert "in 2 of 2 cases." in claims
    silent = {("my/own.toml", "straight"): Drift(drift.grid, drift.grown * [1, 1, 1, 1, 100], drift.law)}
    *_, claims = tell_drifts(["my/own.toml"], "mine", silent, {"straight": []}, (10.0, 60.0), 5.0)
    assert claims.endswith("in 0 of 2 cases; not in, by unit: my/own.toml 2.")
    error, ratio = outage_tables.plot_drifts(["my/own.toml"], ["straight"], drifts)
    band, dots = error.series
    assert (band.key, dots.key) == ("own.toml", "own.toml reported")
    assert (band.widths, dots.widths) == ((1.5, 1.0, 1.0), (3.0,))
    assert_allclose(band.values[:, 0], rms * t)
    assert_allclose(dots.values[:, 0], 2.0 * dots.t)
    assert_allclose((dots.t[0], dots.t[-1]), (1.0, 60.0))
    assert_allclose(ratio.series[0].values[:, 0], rms / 0.5)


@pytest.mark.parametrize("good", [0, 1])
def test_of_less_than_two_draws_only_the_closed_form_is_told(good):
    t = np.arange(1.0, 61.0)
    drift = make_drift(np.array([t if k < good else np.nan * t for k in range(2)]))
    units, drifts = {"own": SimpleNamespace(grade="tactical")}, {("own", "turn"): drift}
    tables = {one.name: one.columns for one in outage_tables.fill_drifts(drifts, units, (10.0,), 5.0)}
    for name in ("drift_m", "low_m", "high_m"):
        assert tables["drift"][name] == [None]
    assert tables["drift"]["predicted_m"] == [pytest.approx(np.hypot(1.0, 2.0))]
    assert tables["reported"]["reported_m"] == ([pytest.approx(2.0)] if good else [None])
    assert tables["axes"]["north_m"] == ([pytest.approx(10.0)] if good else [None])
    assert tables["times"]["after_s"] == [None]


@pytest.mark.parametrize(
    ("phase", "last"),
    [
        ("straight", {"kind": "straight", "duration_s": 124.0}),
        ("turn", {"kind": "s-turns", "by_deg": 60.0, "bank_deg": 25.0, "count": 5}),
        ("climb", {"kind": "climb", "to_alt_m": 1200.0 + 1.5 * 144.0, "rate_mps": 1.5}),
    ],
)
def test_a_phase_begins_19_s_before_the_loss_and_ends_5_s_after_what_counts(phase, last):
    """131 s of legs before; GNSS is lost at 150 s for the longest outage and 2 s more."""
    profile = outage_drift.make_profile(outage_drift.Options(), "stim300", phase, 100.0)
    assert profile.document["leg"][-1] == last
    assert profile.sensors.gnss_outages == ((150.0, 252.0),)
    assert profile.document["start"]["alt_m"] == 1200.0
    assert profile.document["evaluation"]["output_hz"] == 1.0
    assert profile.flight.rate == 100.0


@pytest.mark.parametrize("own", [None, ("mine.toml", "yours.toml")])
def test_every_draw_is_in_the_drift_of_its_unit_and_phase(monkeypatch, own):
    """With runs that return who they are."""
    phases, made = own or ("straight", "climb"), {}
    options = outage_drift.Options(
        units=("grade-1", "stim300", "adis16475"), phases=("straight", "climb"), profiles=own,
        outages_s=(20.0, 5.0), runs=3, error_m=7.0,
    )  # fmt: skip
    elapsed, said = (5.0, 20.0), []

    class Work:
        def map(self, what, function, items, first=()):
            if function is outage_drift.fly:
                assert items == [("grade-1", phase, "profile") for phase in phases]
                return []
            return [np.full((3, 5), made[task.profile[:2]] + task.run) for task in items]

    def make(options, unit, phase, longest):
        assert longest == 20.0
        made[unit, phase] = 10.0 * len(made)
        return Flown((unit, phase, "profile"))

    class Flown(tuple):
        flight = property(lambda self: self)

    def tell(units, estimator, drifts, pairs, elapsed, limit):
        said.append((drifts, elapsed, limit))
        return []

    monkeypatch.setattr(outage_drift, "make_profile", make)
    monkeypatch.setattr(outage_drift.results, "truth_key", lambda flight: flight)
    monkeypatch.setattr(outage_drift, "make_grid", lambda one, at: (1.0, 2.0, float(len(one[1]))))
    monkeypatch.setattr(outage_drift, "find_law", lambda one, grid: {"law": np.full(3, made[one[:2]] + 0.5)})
    monkeypatch.setattr(outage_drift, "predict_grades", lambda longest, work: [longest])
    monkeypatch.setattr(outage_drift, "pair_units", lambda drifts, units, phase: [phase])
    monkeypatch.setattr(outage_drift, "tell_drifts", tell)
    for name in ("tell_grades", "fill_drifts", "fill_grades", "plot_drifts", "plot_grades"):
        monkeypatch.setattr(outage_drift, name, lambda *given: said.append(given) or ())
    outage_drift.run(options, Work())
    drifts, at, limit = said[0]
    assert (at, limit) == (elapsed, 7.0)
    assert said[1] == ([20.0], 7.0)
    assert list(drifts) == [(unit, phase) for phase in phases for unit in options.units]
    for case, drift in drifts.items():
        assert_allclose(drift.grown[:, 0, 0], made[case] + np.arange(3.0))
        assert drift.grid[2] == len(case[1])
        assert_allclose(drift.law["law"], made[case] + 0.5)


def test_the_closed_form_is_asked_with_the_headings_since_the_loss(monkeypatch):
    """One each second from the loss on, to the end of each time; sources of nothing are left out."""
    asked = []

    def split(T, imu, heading, velocity):
        asked.append((T, heading, velocity))
        return {"velocity": 2.0 * T, "gyro bias": T, "noise": 0.0}

    monkeypatch.setattr(outage_drift, "get_truth", lambda key, profile: turning(60.0, 10.0, turn_rate=0.05))
    monkeypatch.setattr(outage_drift.results, "truth_key", lambda flight: "key")
    monkeypatch.setattr(outage_drift, "split_drift", split)
    gnss = SimpleNamespace(vel_markov_sd=0.3)
    sensors = SimpleNamespace(gnss_outages=((20.0, 60.0),), imu=None, gnss=gnss)
    for grid in ((1.0, 5.0, 20.0), (1.0,)):
        found = outage_drift.find_law(SimpleNamespace(sensors=sensors, flight=None), grid)
        assert found.keys() == {"receiver velocity", "gyro bias"}
        assert_allclose(found["receiver velocity"], np.sqrt(8.0) * np.array(grid))
    for T, heading, velocity in asked:
        assert_allclose(heading, 0.7 + 0.05 * (20.0 + np.arange(T + 1.0)), atol=1e-9)
        assert velocity == 0.3


def test_a_flight_of_ones_own_is_lost_from_its_outage_on(tmp_path):
    path = tmp_path / "own.toml"
    text = (PROFILES / "gnss-denied-leg.toml").read_text()
    path.write_text(text.replace("start_s = 180.0", "start_s = 200.0"))
    options = outage_drift.Options(profiles=(str(path),), overrides={"rate_hz": 100}, seed=9)
    profile = outage_drift.make_profile(options, "stim300", str(path), 600.0)
    assert (profile.seed, profile.flight.rate) == (9, 100.0)
    assert profile.sensors.gnss_outages[0][0] == 200.0
    grid = outage_drift.make_grid(profile, (10.0, 60.5, 600.0))
    assert max(grid) == pytest.approx(240.0, abs=1.1)
    assert 60.5 in grid
    with pytest.raises(ConfigError, match=r"survey has no \[\[gnss_outage"):
        outage_drift.make_profile(options, "stim300", "survey", 60.0)


@pytest.mark.parametrize("phase", ["turn", "climb"])
def test_a_phase_lasts_as_long_as_the_outage(phase):
    profile = outage_drift.make_profile(outage_drift.Options(), "stim300", phase, 10.0)
    ((_, stop),) = profile.sensors.gnss_outages
    assert stop < pipeline.fly(profile).t[-1] < stop + 60.0


@pytest.fixture(scope="module")
def matched():
    """A unit and a receiver whose every error the filter models."""
    return bench.study(
        "outages", units="matched-mems", phases="straight", outages_s="60,300,600", gnss="matched-white",
        estimator="loose-15", runs=DRAWS, jobs=1,
    )  # fmt: skip


@pytest.mark.slow
def test_47_monte_carlo_lies_in_the_band_of_the_covariance(matched):
    """The squares of a matched filter over its variance: chi-square, of one to two axes for each run.

    A covariance of half the size leaves the 99.9 % band.
    """
    columns = {name: np.array(values) for name, values in matched.tables["reported"].columns.items()}
    ratio = np.square(columns["error_m"] / columns["reported_m"])
    low, high = stats.chi2.ppf([0.0005, 0.9995], DRAWS) / DRAWS
    assert ((low < ratio) & (ratio < high)).all(), ratio
    assert (4.0 * ratio > high).all()
    assert (columns["low_m"] < columns["error_m"]).all()
    assert (columns["error_m"] < columns["high_m"]).all()


@pytest.mark.slow
def test_47_the_biases_of_the_grades_alone(matched):
    """A-2.4.4 and A-2.4.7, and the growth of the covariances that stand in section 7.1."""
    table = matched.tables["grades"].columns
    rows = list(zip(*table.values(), strict=True))
    for (grade, outage), printed in ALONE.items():
        found = next(row for row in rows if row[:3] == (grade, "straight", outage))
        for value, one in zip(found[4:6], printed, strict=True):
            digits = len(f"{one}".replace(".", "").strip("0"))
            assert float(f"{value:.{digits}g}") == pytest.approx(one, rel=0.5 * 10.0 ** -(digits - 1))
    after = {row[0]: row[-1] for row in rows if row[1] == "s-turns"}
    for name, printed in PRINTED_AFTER.items():
        assert after[name] == pytest.approx(printed, abs=1.0), name
    grown = {row[:3]: row[3] for row in rows}
    assert grown["MEMS", "s-turns", 300.0] == pytest.approx(227.0, rel=0.02)
    assert grown["grade-3", "s-turns", 300.0] == pytest.approx(27.5, rel=0.02)


def test_a_climb_drifts_as_straight_flight_and_a_steady_turn_less():
    """A bias that turns with the aircraft cancels over the circle of 240 s."""
    straight, turn, climb = (
        LinearFlight(phase).predict_sd(GRADES["MEMS"], LOST + 300)[-1, 0]
        for phase in ("straight", "turn", "climb")
    )
    assert climb == pytest.approx(straight, rel=0.02)
    assert turn < 0.5 * straight


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"units": "stim"}, "imu = 'stim' is not in the catalog"),
        ({"phases": "loop"}, "must be one of straight"),
    ],
)
def test_a_wrong_name_is_one_line(given, message):
    with pytest.raises(ConfigError, match=message):
        bench.study("outages", **given)


def test_pictures_of_the_grades_begin_a_second_after_the_loss():
    """Three phases of two grades, and each bias alone once: all epochs but the first, which has no log."""
    t = np.arange(4.0)
    grades = [
        Grown(name, phase, t, size * t, 2.0 * size * t, 3.0 * size * t)
        for size, name in ((1.0, "grade-1"), (10.0, "grade-3"))
        for phase in ("straight", "turn", "s-turns")
    ]
    plots = {one.path[-1]: one for one in plot_grades(grades)}
    sizes = {
        "grades-straight": 1.0,
        "grades-s-turns": 1.0,
        "accelerometer-bias-alone": 2.0,
        "gyro-bias-alone": 3.0,
    }
    for name, factor in sizes.items():
        lines = plots[name].series
        assert [one.key for one in lines] == ["grade-1", "grade-3"]
        for size, one in zip((1.0, 10.0), lines, strict=True):
            assert_allclose(one.t, t[1:])
            assert_allclose(one.values[:, 0], factor * size * t[1:])


def test_the_end_of_an_outage_is_measured_before_the_fix_that_ends_it():
    t = np.arange(0.0, 101.0, 0.25)
    assert outage_drift.list_instants(t, (20.0, 50.0), (1.0, 30.0)).tolist() == [20.0, 21.0, 49.75]
    assert outage_drift.list_instants(t, (20.0, 50.1), (1.0, 30.1)).tolist() == [20.0, 21.0, 50.0]
    assert outage_drift.list_instants(t, (20.0, 52.0), (1.0, 30.0)).tolist() == [20.0, 21.0, 50.0]


def test_growth_is_the_error_less_that_at_the_loss(monkeypatch):
    """Errors of 3, 4, 10 m at the loss and 1, 2, 3 m/s from there on; covariances of 5 and 7 m^2."""
    profile = SimpleNamespace(
        estimators=["mine"], sensors=SimpleNamespace(gnss_outages=((20.0, 25.0),)), flight=None
    )
    at = np.array([20.0, 21.0, 22.0])
    cov = np.tile(np.diag([5.0, 7.0, 11.0]), (3, 1, 1))
    ends, first = list[float](), np.array([3.0, 4.0, 10.0])

    def judge(truth, one):
        assert_allclose(one.t, at)
        return SimpleNamespace(pos_n=first + np.outer(one.t - 20.0, [1.0, 2.0, 3.0]), t=one.t)

    truth = SimpleNamespace(t=np.array([0.0, 10.0, 30.0]))
    monkeypatch.setattr(outage_drift, "get_truth", lambda key, one: truth)
    monkeypatch.setattr(
        outage_drift,
        "pipeline",
        SimpleNamespace(
            check_times=lambda one, last: ends.append(last),
            sense=lambda one, truth, run: SimpleNamespace(data=made_data, initial=None),
            navigate=lambda use, data, initial: SimpleNamespace(cov=cov, t=data.output_t),
        ),
    )
    monkeypatch.setattr(outage_drift, "error_series", judge)
    monkeypatch.setattr(outage_drift, "replace", lambda data, output_t: SimpleNamespace(output_t=output_t))
    made_data = SimpleNamespace()
    found = outage_drift.measure_growth(outage_drift.DriftRun(profile, "key", 0, (1.0, 2.0)))
    assert_allclose(found, [[1.0, 2.0, 3.0, 16.0 + 36.0, 12.0], [2.0, 4.0, 6.0, 25.0 + 64.0, 12.0]])
    assert ends == [30.0]


def test_growth_by_grade_is_that_since_the_loss_and_each_bias_by_its_law():
    """Sigmas of 5 m at the loss and 13 m a second later: 12 m. Biases by A-2.4.4 and A-2.4.7, for short."""

    class Work:
        @staticmethod
        def map(what, do, items):
            sds = [np.hypot(5.0, 12.0 * np.arange(n + 1.0)) for _, n in items]
            return [dict.fromkeys(PHASES_FLOWN, sd) for sd in sds]

    found = outage_grades.predict_grades(10.5, Work)
    assert {(one.name, one.phase) for one in found} == {(g, p) for g in GRADES for p in PHASES_FLOWN}
    for one in found:
        sigmas = GRADES[one.name].sigmas
        assert_allclose(one.east, 12.0 * np.arange(601.0), rtol=1e-9)
        assert one.by_accel[10] == pytest.approx(0.5 * sigmas.da * 100.0, rel=1e-3)
        assert one.by_gyro[60] == pytest.approx(9.81 * sigmas.eps * 60.0**3 / 6.0, rel=5e-3)
    assert found[0].take([1.5, 2.0])[0] == pytest.approx([18.0, 24.0])


def test_the_better_unit_is_that_of_the_smaller_drift_and_not_of_the_smaller_limit():
    """4 m in every run, and 5 m RMS of runs from 0.1 to 10 m, whose interval begins below."""
    t, sizes = np.ones(61), np.array([0.1, 0.2, 0.1, 10.0])[:, None]
    drifts = {
        ("wide", "turn"): make_drift(sizes * t),
        ("steady", "turn"): make_drift(np.full((4, 1), 4.0) * t),
    }
    assert drifts["wide", "turn"].rms[59, 1] < 4.0 < drifts["wide", "turn"].rms[59, 0]
    (pair,) = pair_units(drifts, ("wide", "steady"), "turn")
    assert (pair.first, pair.second) == ("steady", "wide")


def test_a_flight_that_ends_in_the_outage_has_the_heading_of_its_end(monkeypatch):
    """Asked for longer than it lasts: the last attitude holds on."""
    truth = turning(30.0, 10.0)
    monkeypatch.setattr(outage_drift, "get_truth", lambda key, profile: truth)
    monkeypatch.setattr(outage_drift.results, "truth_key", lambda flight: "key")
    profile = outage_drift.make_profile(outage_drift.Options(), "stim300", "straight", 60.0)
    sensors = SimpleNamespace(gnss_outages=((25.0, 99.0),), imu=profile.sensors.imu, gnss=None)
    found = outage_drift.find_law(SimpleNamespace(sensors=sensors, flight=None), (5.0, 20.0))
    assert all(np.isfinite(values).all() for values in found.values())
