"""The studies by linear covariance: their tables on a short flight, and the reference flight's numbers."""

from __future__ import annotations

import io
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from numpy.testing import assert_allclose
from rich.console import Console
from scipy import stats

import bench
from bench.cli.verbs.result_table import print_bound
from bench.core.mathematics.units import DEG, HOUR, STANDARD_GRAVITY
from bench.core.records.findings import series
from bench.core.words.exceptions import ConfigError
from bench.evaluation.linear.best_linear import Bound
from bench.evaluation.linear.directions import Observed, describe_direction, find_turns, observe
from bench.evaluation.linear.error_budget import Budget
from bench.evaluation.linear.quantities import QUANTITIES, compare_run, root_mean_interval
from bench.experiments.studies import bound as bound_study
from bench.experiments.studies import budget as budget_study
from bench.experiments.studies import observability
from bench.experiments.studies.budget import give_colors
from bench.experiments.studies.drawn_errors import key_instants, output_times, split_draws
from bench.experiments.studies.linear_flight import CLIMB, GRADES, LOST, STEADY, LinearFlight
from bench.io.config import read_profile
from tests.studies.made_units import write_unit

FLIGHT = """
aircraft = "aerosonde"
rate_hz = 100
seed = 7
[start]
lat_deg = 47.0
lon_deg = 11.0
alt_m = 1000.0
heading_deg = 40.0
speed_mps = 25.0
[[leg]]
kind = "straight"
duration_s = 12.0
[[leg]]
kind = "turn"
by_deg = 120.0
bank_deg = 30.0
[[leg]]
kind = "straight"
duration_s = 20.0
[sensors]
imu = "adis16475"
gnss = "l1-code"
baro = "bmp388"
[[gnss_outage]]
start_s = 26.0
duration_s = 8.0
[evaluation]
from_s = 5.0
[initial_error_sd]
pos_m = [3.0, 3.0, 5.0]
vel_mps = [0.2, 0.2, 0.2]
tilt_deg = 0.2
heading_deg = 0.5
[[estimator]]
use = "loose-full"
[[estimator]]
use = "smoother"
"""


@pytest.fixture(scope="module")
def flight(tmp_path_factory):
    path = tmp_path_factory.mktemp("flight") / "short.toml"
    path.write_text(FLIGHT)
    return str(path)


def test_an_outage_is_looked_at_before_the_first_fix_that_ends_it():
    """Fixes are missing from 400 s to 460 s: at 460 s there is one again."""
    rows = key_instants(np.arange(0.0, 601.0), read_profile("figure-eight"))
    assert rows == {"460 s, end of the outage": 459, "600 s, end of the flight": 600}


def test_the_budget_of_a_short_flight(flight):
    found = bench.study("budget", profiles=flight, estimator="loose-15", runs=140, jobs=1)
    table = {name: np.array(values) for name, values in found.tables["budget"].columns.items()}
    for t in np.unique(table["t_s"]):
        rows = table["t_s"] == t
        assert_allclose(table["percent"][rows].sum(), 100.0)
        assert (np.diff(table["percent"][rows]) <= 0).all()
    assert "gyro misalignment" in table["source"]
    sides = found.tables["side_by_side"].columns
    assert set(sides["agrees"]) == {"yes"}
    assert found.findings.good
    assert not found.findings.undecided
    assert {"horizontal-position", "heading-shares"} <= set(found.figures)
    areas = [one for one in found.figures["heading-shares"].series if one.band is not None]
    assert_allclose(areas[-1].values[:, 0], 100.0)
    thickness = [float(np.mean(one.values[:, 0] - one.values[:, 1])) for one in areas]
    assert thickness[:-1] == sorted(thickness[:-1], reverse=True)
    assert thickness[-1] < thickness[0], "the largest sources are shown, and the others summed"
    assert "At 34 s, end of the outage" in found.verdicts[0]


def make_budget(variances):
    """Return a budget of one time: variance by source, the same of every state."""
    names, values = tuple(variances), np.array(list(variances.values()))
    return Budget(np.array([10.0]), names, np.tile(values, (1, 9, 1)), np.full((1, 9), values.sum()))


def test_draws_and_covariance_agree_by_an_interval_that_can_fail():
    """Of 200 draws a ratio of variances of 1.1 agrees and one of 1.6 does not; 2 runs tell nothing."""
    budget = make_budget({"gyro": 4.0, "noise": 1.0, "small": 0.001})
    at = {"the end": 0}
    drawn = {"gyro": 4.0, "noise": 1.6, "all sources": 1.1 * 5.001, "small": 9.0}
    squares = {name: np.full((1, 9), value) for name, value in drawn.items()}
    rows = budget_study.pair_variances(budget, squares, at, 200)
    found = dict(zip(rows["source"], rows["agrees"], strict=True))
    assert found == {"gyro": "yes", "noise": "no", "all sources": "yes"}, "the small one is not compared"
    k = rows["source"].index("noise")
    low, high = (stats.chi2.ppf(p, 200) / 200 for p in (0.0005, 0.9995))
    assert rows["variance_ratio"][k] == pytest.approx(1.6)
    assert_allclose((rows["low"][k], rows["high"][k]), (1.6 / high, 1.6 / low))
    assert_allclose((rows["covariance"][k], rows["drawn"][k]), np.sqrt([2.0, 3.2]))  # horizontal: two states
    few = budget_study.pair_variances(budget, squares, at, 2)
    assert set(few["agrees"]) == {"cannot tell"}
    told = budget_study.compare(few, 2)
    assert "agree in 0 of 15 figures" in told[0]
    assert "In 15 figures 2 runs cannot tell" in told[1]
    assert any("They disagree on noise, heading at 10 s" in text for text in budget_study.compare(rows, 200))


def test_the_ranking_and_the_worst_claim_are_said():
    """By hand: shares of 4, 1 and 0.001, and a filter that reports a ninth of the variance of its heading."""
    budget = make_budget({"noise": 1.0, "gyro": 4.0, "small": 0.001})
    claimed = np.full((1, 9), 5.001)
    claimed[0, 8] /= 9.0
    budget = replace(budget, claimed=claimed)
    said = budget_study.rank(budget, 0, "10 s")
    assert said.startswith(
        f"At 10 s, of the variance: horizontal position {np.sqrt(10.002):.3g} m by gyro 80 %"
    )
    assert "gyro 80 % and noise 20 %" in said
    told = budget_study.judge_claim(budget, {"10 s": 0}, "mine", 3)
    assert (
        told[0] == "The worst reported sigmas of mine: at 10 s, its heading error is 3 times what it reports."
    )
    assert "rejected 3 scalar measurements" in told[1]
    assert len(budget_study.judge_claim(budget, {"10 s": 0}, "mine", 0)) == 1
    table = budget_study.tabulate_budget(budget, {"10 s": 0}, "mine").columns
    assert table["source"] == ["gyro", "noise", "small"]
    assert_allclose(table["percent"], 100.0 * np.array([4.0, 1.0, 0.001]) / 5.001)
    sd = np.sqrt([4.0, 1.0, 0.001])
    assert_allclose(table["height_m"], sd)
    assert_allclose(table["velocity_mps"], np.sqrt(2.0) * sd)
    assert_allclose(table["tilt_deg"], np.rad2deg(np.sqrt(2.0) * sd))
    assert_allclose(table["heading_deg"], np.rad2deg(sd))
    assert budget_study.find_sources(budget, [0]) == ["noise", "gyro"]
    axes = np.array([[1.0, 1.0, 9.0, 1, 1, 1, 1, 1, 1], [4.0, 4.0, 1.0, 1, 1, 1, 1, 1, 1]]).T[None]
    uneven = Budget(np.array([10.0]), ("gyro", "noise"), axes, axes.sum(axis=2))
    table = budget_study.tabulate_budget(uneven, {"10 s": 0}, "mine").columns
    assert (table["source"], table["percent"]) == (["noise", "gyro"], pytest.approx([80.0, 20.0]))
    squares = {name: axes[:, :, s] for s, name in enumerate(uneven.sources)}
    rows = budget_study.pair_variances(uneven, squares, {"10 s": 0}, 200)
    assert rows["source"][:4] == ["noise", "gyro", "gyro", "noise"], "the largest of each figure first"


def test_a_budget_of_few_draws_is_undecided(flight):
    found = bench.study(
        "budget", profiles=flight, runs=4, jobs=1, seed=3, overrides={"sensors.baro": "bmp390"}
    )
    assert found.findings.undecided
    assert found.findings.good
    assert "--runs 4" in found.command
    assert "--seed 3" in found.command
    assert "--set 'sensors.baro=\"bmp390\"'" in found.command


def test_the_bound_of_a_short_flight(flight):
    found = bench.study("bound", profiles=flight, runs=6, jobs=1)
    table = found.tables["bound"].columns
    assert set(table["estimator"]) == {"loose-full", "smoother"}
    for name, low, ratio, high in zip(
        table["estimator"], table["low"], table["ratio"], table["high"], strict=True
    ):
        assert low < ratio < high
        assert high > 1.0
        assert name == "smoother" or low < 1.0  # it is the best linear one, but for linearization
    assert found.findings.good
    assert_allclose(np.divide(table["rmse"], table["bound"]), table["ratio"])
    heading = next(
        ratio
        for name, phase, quantity, ratio in zip(
            *(table[key] for key in ("estimator", "phase", "quantity", "ratio")), strict=True
        )
        if (name, phase, quantity) == ("loose-full", "without GNSS", "heading")
    )
    assert f"heading {heading:.3g}." in next(
        text for text in found.verdicts if "without GNSS, over the bound" in text
    )
    best = found.tables["best_linear"].columns
    assert best["t_s"][-1] == pytest.approx(found.figures["heading"].series[0].t[-1])
    lines = {one.key: one.values[-1, 0] for one in found.figures["heading"].series}
    assert (lines["bound"], lines["smoothing"]) == pytest.approx(
        (best["heading_deg"][-1], best["heading_smoothed_deg"][-1])
    )


def test_a_run_is_held_against_the_bound_where_asked_for(flight):
    found = bench.run(flight, bound=True)
    for label, values in found.metrics.items():
        assert {row["phase"] for row in values["bound"]} == {"with GNSS", "without GNSS"}, label
        assert len(values["bound"]) == 10
        for row in values["bound"]:
            assert row["low"] < row["ratio"] < row["high"]
            assert row["ratio"] == pytest.approx(row["rmse"] / row["bound"])
            assert row["high"] > 1.0
    assert "bound" not in bench.run(flight).metrics["loose-full"]
    console = Console(width=80, file=io.StringIO(), record=True)
    print_bound(console, found.metrics)
    text = console.export_text()
    assert "heading without GNSS" in text
    assert max(map(len, text.splitlines())) <= 80
    with pytest.raises(ConfigError, match="position level"):
        bench.run("gnss-jammed", bound=True)


def test_the_interval_of_one_run_knows_the_correlation_of_its_errors():
    """Of 400 series with a correlation time of 20 samples few miss 1; as white noise most do."""
    rng, phi = np.random.default_rng(1), np.exp(-1 / 20)
    noise = rng.standard_normal((400, 300, 9)) * np.sqrt(1 - phi**2)
    noise[:, 0] /= np.sqrt(1 - phi**2)
    errors = np.array(noise)
    for k in range(1, 300):
        errors[:, k] += phi * errors[:, k - 1]
    heading, least = QUANTITIES[-1], np.ones((300, 9))
    held = [compare_run(one, least, heading) for one in errors]
    missed = np.mean([not one.low < 1.0 < one.high for one in held])
    assert missed < 0.02
    low, high = root_mean_interval(np.array([one.ratio for one in held]), 300.0)
    assert np.mean((low > 1.0) | (high < 1.0)) > 0.1


def test_what_has_no_linear_model_is_refused(flight):
    for given, message in (
        ({"estimator": "tight"}, "not tight of short"),
        ({"estimator": "smoother"}, "budget supports loose-15"),
        ({"units": "grade-9"}, "study budget: units: imu = 'grade-9' is not in the catalog"),
    ):
        with pytest.raises(ConfigError, match=message):
            bench.study("budget", profiles=flight, runs=2, jobs=1, **given)
    with pytest.raises(ConfigError, match="position level"):
        bench.study("bound", profiles="gnss-jammed", runs=2, jobs=1)
    behind = {"sensors.gnss.tracking_bandwidth_hz": 2.0}
    with pytest.raises(ConfigError, match="no lag of the receiver; set tracking_bandwidth_hz = 0"):
        bench.study("bound", profiles=flight, runs=2, jobs=1, overrides=behind)
    shaken = {"sensors.imu.clock.jitter_us": 9.0, "sensors.gnss.time_tag_error_s": 0.01}
    with pytest.raises(ConfigError, match="the linear model has no jitter, time_tag_error: set them to 0"):
        bench.study("bound", profiles=flight, runs=2, jobs=1, overrides=shaken)


def test_the_observability_of_a_short_flight(flight):
    """And #49 of the register on the reference flight: before and after the first S-turn, without turns."""
    found = bench.study("observability", profiles=flight, jobs=1)
    phases = found.tables["phases"].columns
    assert phases["phase"] == ["straight", "turn", "straight"]
    heading = phases["heading_before_deg"]
    assert heading[1] > 0.49
    assert phases["heading_after_deg"][1] < 0.5 * heading[1]
    start, before, after, end = [*heading[:2], *phases["heading_after_deg"][1:]]
    first = f"{start:.3g} deg at the start, {before:.3g} deg before the first turn at {phases['to_s'][0]:g} s"
    assert f"{first}, {after:.3g} deg after it, and {end:.3g} deg at the end" in found.verdicts[0]
    directions = found.tables["directions"].columns
    assert "before the first turn" in directions["when"]
    ratio = np.divide(directions["left_percent"], directions["best_percent"])
    assert_allclose(directions["condition"], ratio)
    assert (ratio > 1.0).all()
    left = [100.0 * phases["heading_after_deg"][k] / heading[k] for k in (1, 2)]
    told = "A turn leaves {:.0f} % of the heading uncertainty, straight flight after it {:.0f} %".format(
        *left
    )
    assert found.verdicts[1].startswith(told)
    keys = ("least_observable", "left_percent", "condition")
    rows = zip(found.verdicts[2:-1], *(directions[key] for key in keys), strict=True)
    for text, name, percent, condition in rows:
        said = f"{name}: {percent:.0f} % of its uncertainty at the start; condition {condition:.0f}."
        assert text.endswith(said)
    assert (
        "reduces its sigma: grade-3 from 0.41 to 0.0075 deg (0.31 in straight flight), MEMS"
        in found.verdicts[-1]
    )
    grade, *columns = found.tables["reference"].columns.values()
    for name, printed in {"grade-3": (0.42, 0.0075, 0.0084, 0.31), "MEMS": (3.06, 0.079, 0.094, 4.9)}.items():
        assert_allclose([column[list(grade).index(name)] for column in columns], printed, rtol=0.03)
    for line in found.figures["reference-heading"].series:
        assert_allclose(line.t, np.arange(1801.0))
        assert line.values.shape == (1801, 1)


def test_the_words_and_pictures_of_a_budget_by_hand():
    """Two sources of variance 9 and 16 of every state, and a covariance of a quarter of their sum, 25."""
    variance = np.tile([9.0, 16.0], (2, 9, 1)) * np.array([1.0, 4.0])[:, None, None]
    claimed = variance.sum(axis=2) / 4.0
    claimed[:, 2] /= 4.0
    made = Budget(np.array([10.0, 20.0]), ("gyro", "noise"), variance, claimed)
    text = budget_study.rank(made, 1, "20 s")
    assert text.startswith(
        "At 20 s, of the variance: horizontal position 14.1 m by noise 64 % and gyro 36 %;"
    )
    assert "height 10 m by noise 64 % and gyro 36 %" in text
    assert "heading 573 deg by noise 64 %" in text
    (told,) = budget_study.judge_claim(made, {"10 s": 0, "20 s": 1}, "mine", 0)
    assert told == (
        "The worst reported sigmas of mine: at 10 s, its height error is 4 times what it reports; at 20 s, "
        "its height "
        "error is 4 times what it reports."
    )
    assert "rejected 3 scalar" in budget_study.judge_claim(made, {"10 s": 0}, "mine", 3)[1]
    table = budget_study.tabulate_budget(made, {"20 s": 1}, "mine").columns
    assert table["source"] == ["noise", "gyro"]
    assert_allclose(table["percent"], [64.0, 36.0])
    assert_allclose(table["height_m"], [8.0, 6.0])
    plots = {one.path[1]: one for one in budget_study.plot_budget(made, "mine")}
    actual, claim = plots["height"].series
    assert_allclose((actual.t, actual.values[:, 0], claim.values[:, 0]), ([10, 20], [5, 10], [1.25, 2.5]))
    assert actual.colors != claim.colors
    first, edge, second, last = plots["height-shares"].series
    assert_allclose(last.values[:, 0], 100.0)
    assert_allclose(first.values, [[64.0, 0.0]] * 2)
    assert_allclose(edge.values[:, 0], 64.0)
    assert_allclose(second.values, [[100.0, 64.0]] * 2)


def test_what_is_known_before_and_after_turns_by_hand():
    """Straight, a turn of ten seconds, straight; a turn of two seconds is none."""
    t = np.arange(30.0)
    turning = ((t >= 10.0) & (t < 20.0)) | ((t >= 25.0) & (t < 27.0))
    smooth = observability.smooth_phases(turning, t)
    assert smooth.tolist() == ((t >= 10.0) & (t < 20.0)).tolist()
    phases = observability.split_phases(smooth)
    assert phases == [("straight", 0, 10), ("turn", 10, 20), ("straight", 20, 29)]
    states = np.array([1.0, 2.0, 4.0, 3.0, 1.0, 2.0, 1.0, 3.0, 2.0])
    units = np.repeat([DEG, DEG / HOUR, 1e-6 * STANDARD_GRAVITY], 3)
    left = np.column_stack([np.full(30, 0.1), np.linspace(1.0, 0.42, 30)])
    directions = np.tile(np.eye(9)[:, [5, 2]], (30, 1, 1))
    seen = Observed(t, (40.0 - t)[:, None] * states * units, left, directions)
    table = observability.tabulate_phases(seen, phases).columns
    assert (table["from_s"], table["to_s"]) == ([0.0, 10.0, 20.0], [10.0, 20.0, 29.0])
    for name, size in (("heading_%s_deg", 4), ("tilt_%s_deg", 2), ("gyro_%s_deg_h", 3), ("accel_%s_ug", 3)):
        assert_allclose(table[name % "before"], size * np.array([40.0, 30.0, 20.0]))
        assert_allclose(table[name % "after"], size * np.array([30.0, 20.0, 11.0]))
    rows = observability.tabulate_directions(seen, phases).columns
    assert rows["t_s"] == [10.0, 15.0, 20.0, 29.0]
    assert_allclose(rows["left_percent"], 100.0 * left[[10, 15, 20, 29], 1])
    assert_allclose(rows["best_percent"], 10.0)
    assert_allclose(rows["condition"], left[[10, 15, 20, 29], 1] / 0.1)
    assert (rows["least_observable"][0], rows["best"][0]) == ("heading 1.00", "gyro bias z 1.00")
    told = observability.tell_observed("made", seen, phases)
    assert told[0] == (
        "On made the heading is known to 160 deg at the start, 120 deg before the first turn at 10 s, 80 deg "
        "after it, and 44 deg at the end."
    )
    assert told[1].startswith("A turn leaves 67 % of the heading uncertainty, straight flight after it 55 %")
    assert told[-1].endswith("is heading 1.00: 42 % of its uncertainty at the start; condition 4.")
    (alone,) = observability.tell_observed("made", seen, [("straight", 0, 29)])[:1]
    assert alone == "On made there is no turn: the heading goes from 160 to 44 deg."
    plots = {one.path[1]: one for one in observability.plot_observed(seen, smooth)}
    known, foot = plots["heading"].series
    assert (known.colors, foot.widths) == (series.ESTIMATORS[:1], (2.0,))
    assert_allclose(known.values[:, 0], 4.0 * (40.0 - t))
    assert_allclose(foot.t, t[10:20])
    assert_allclose(foot.values, 0.8 * 44.0)
    most, least = plots["directions"].series
    assert_allclose(most.values[:, 0], 100.0 * left[:, 1])
    assert_allclose(least.values[:, 0], 10.0)
    assert most.colors != least.colors
    three = replace(
        seen,
        left=np.column_stack([left[:, 0], np.full(30, 0.3), left[:, 1]]),
        directions=np.tile(np.eye(9)[:, [5, 4, 2]], (30, 1, 1)),
    )
    rows = observability.tabulate_directions(three, phases).columns
    assert (rows["least_observable"][0], rows["best"][0]) == ("heading 1.00", "gyro bias z 1.00")
    most, least = observability.plot_observed(three, smooth)[-1].series
    assert_allclose([most.values[:, 0], least.values[:, 0]], [100.0 * left[:, 1], np.full(30, 10.0)])


def test_directions_of_a_standing_start():
    """Of two figures that are measured as a sum, the difference is what nothing tells."""
    n, s = 9 + 6, np.array([0.1, 0.1, 0.2, *[1e-4] * 3, *[1e-2] * 3])
    start = np.diag(np.concatenate([np.ones(6), s**2]))
    M = np.vstack([np.eye(9, n)[6:], np.eye(n)[9:]])
    h = M.T @ (np.eye(9)[2] / s[2] + np.eye(9)[5] / s[5])  # heading and gyro z, each in its unit
    K = start @ h / (h @ start @ h + 1e-6)
    after = start - np.outer(K, h @ start)
    bound = Bound(
        np.array([0.0, 1.0]), (), np.eye(n)[9:], start, np.array([start, after]), np.empty((0, 9, 9))
    )
    seen = observe(bound)
    assert_allclose(seen.left[0], 1.0)
    assert_allclose(seen.left[1, 0], np.sqrt(0.5e-6), rtol=1e-3)
    assert_allclose(seen.left[1, 1:], 1.0)
    known = replace(bound, start=start * (np.arange(n) != n - 1) * (np.arange(n) != n - 1)[:, None])
    fewer = observe(known)
    assert fewer.left.shape == (2, 8)
    assert_allclose(fewer.directions[:, 8], 0.0, atol=0)
    assert_allclose(fewer.left, seen.left[:, :8], rtol=1e-6)
    assert describe_direction(seen.directions[1][:, 0]) in (
        "heading 0.71, gyro bias z 0.71", "gyro bias z 0.71, heading 0.71",
    )  # fmt: skip


def test_a_source_keeps_its_color_unless_two_of_one_figure_have_the_same():
    colors = {}
    for names in (["gyro bias", "heading"], ["white noise", "tilt"], ["gyro bias", "tilt"]):
        give_colors(colors, names)
    first, second, *_ = series.ESTIMATORS
    assert (colors["gyro bias"], colors["heading"], colors["tilt"]) == (first, second, second)
    give_colors(colors, ["gyro bias", "white noise"])
    assert colors["gyro bias"] != colors["white noise"]


def test_each_unit_of_ones_own_is_asked_alone(flight, tmp_path):
    """Two files, one with ten times the gyro noise: tables and sentences as if it were alone."""
    names = [
        write_unit(tmp_path, name, 1.0, figures=f"[gyro]\nnoise_deg_sqrt_h = {noise}\n")
        for name, noise in (("quiet", 0.1), ("loud", 1.0))
    ]
    both = bench.study("observability", profiles=flight, units=names, jobs=1, seed=2)
    alone = bench.study("observability", profiles=flight, units=names[1], jobs=1, seed=2)
    quiet, loud = (both.tables[f"phases-{name}"].columns["heading_after_deg"] for name in ("quiet", "loud"))
    assert (np.array(loud) > np.array(quiet)).all()
    assert loud == alone.tables["phases"].columns["heading_after_deg"]
    assert f"loud: {alone.verdicts[0]}" in both.verdicts
    assert "heading-quiet" in both.figures
    assert f"--units {','.join(names)}" in both.command


@pytest.mark.parametrize(("rate_deg_s", "turns"), [(0.9, False), (-0.9, False), (1.1, True), (-1.1, True)])
def test_a_turn_is_a_degree_a_second_or_more(rate_deg_s, turns):
    """Straight for 10 s, then a turn through south, where the course jumps by 360 deg."""
    t = np.linspace(0.0, 30.0, 301)
    course = np.deg2rad(175.0 * np.sign(rate_deg_s) + rate_deg_s * np.maximum(t - 10.0, 0.0))
    truth = SimpleNamespace(t=t, vel_n=20.0 * np.column_stack([np.cos(course), np.sin(course), 0.0 * t]))
    assert find_turns(truth, np.array([3.0, 12.0, 15.6, 25.0])).tolist() == [False, turns, turns, turns]


def test_draws_are_split_over_workers_without_a_gap():
    assert list(split_draws(10, 4)) == [(0, 2), (2, 3), (5, 2), (7, 3)]
    assert list(split_draws(2, 4)) == [(0, 1), (1, 1)]


def test_a_place_of_the_linear_course_is_that_of_its_phase():
    """By hand: a circle in 240 s from the course at the loss of GNSS, a climb of 10 m/s, straight flight."""
    assert (2.0 * np.pi / STEADY, CLIMB) == (pytest.approx(240.0), 10.0)
    for phase, rate, climb in (("turn", STEADY, 0.0), ("climb", 0.0, CLIMB), ("straight", 0.0, 0.0)):
        flight = LinearFlight(phase)
        nav, force = flight.place(LOST + 90.0)
        course, flat = 0.8 + rate * 90.0, np.sqrt(200.0**2 - climb**2)
        assert_allclose(nav.V, [flat * np.sin(course), flat * np.cos(course), climb], atol=1e-9)
        level = flat * rate * np.array([np.cos(course), -np.sin(course)])
        assert_allclose(force, [*level, flight.earth.g], atol=1e-12)
        forward, up = (np.asarray(nav.B @ axis) for axis in np.eye(3)[:2])  # axes forward, up, right
        assert_allclose(forward, nav.V / 200.0, atol=1e-9)
        assert up[2] == pytest.approx(np.cos(np.arctan2(flat * rate, flight.earth.g)) * flat / 200.0)


def test_instants_of_a_study_are_whole_seconds_and_the_last_without_gnss():
    outages = SimpleNamespace(sensors=SimpleNamespace(gnss_outages=((0.0, 1.2), (3.0, 5.5), (7.0, 9.0))))
    truth = SimpleNamespace(t=np.arange(0.25, 10.26, 0.01))
    expected = [*np.arange(0.25, 10.3), 4.5, 8.0]
    assert_allclose(output_times(truth, outages), np.sort(expected))


def test_four_sources_are_named_and_layers_lie_by_share_and_by_size():
    """Of 35, 25, 20, 15 and 5 % the fifth is not told. What is large at its worst lies below."""
    text = budget_study.rank(make_budget({"a": 97.0, "b": 2.1, "c": 0.9}), 0, "10 s")
    assert "by a 97 % and b 2 %;" in text  # none of less than 2 %
    parts = dict(zip("abcde", (20.0, 35.0, 5.0, 25.0, 15.0), strict=True))
    said = budget_study.rank(make_budget(parts), 0, "10 s")
    assert "by b 35 %, d 25 %, a 20 % and e 15 %;" in said
    size = np.array([[0.9, 0.1], [30.0, 70.0]])[:, None, :] * np.ones((1, 9, 1))
    made = Budget(np.array([0.0, 1.0]), ("early", "late"), size, size.sum(axis=2))
    shares = next(one for one in budget_study.plot_budget(made, "mine") if one.path[1] == "heading-shares")
    assert [one.names[0] for one in shares.series if one.band is not None] == ["late", "early"]


@pytest.mark.parametrize(("size", "good"), [(2.0, True), (0.1, False)])
def test_an_estimator_is_held_against_its_own_bound_by_hand(size, good):
    """Errors of so many sigma in 20 runs: of the causal bound, 1, or that of smoothers, 0.5."""
    n = np.tile(np.eye(9), (4, 1, 1))
    bound = Bound(np.arange(4.0), (), np.empty((6, 0)), np.eye(9), n, 0.25 * n)
    signs = np.where(np.random.default_rng(1).integers(0, 2, (20, 4, 9)), 1.0, -1.0)
    signs *= np.sqrt(np.tile([0.5, 1.5], 10))[:, None, None]  # runs differ, their mean square is 1
    errors = {"filter": size * signs, "smoother": size * signs, "lost": np.nan * signs}
    smoothing = {"filter": False, "smoother": True, "lost": False}
    phases = {
        "with GNSS": np.array([True, True, False, False]),
        "without GNSS": np.array([False, False, True, True]),
    }
    columns, told, found = bound_study.hold_draws(bound, errors, smoothing, phases)
    assert found == good
    assert columns["estimator"] == ["filter"] * 10 + ["smoother"] * 10
    assert_allclose(columns["ratio"], np.repeat([size, 2.0 * size], 10))
    assert_allclose(columns["bound"][:5], [np.sqrt(2.0), 1.0, np.sqrt(2.0), np.sqrt(2.0) / DEG, 1.0 / DEG])
    assert_allclose(columns["rmse"][:5], size * np.array(columns["bound"][:5]))
    assert columns["phase"][:10] == ["with GNSS"] * 5 + ["without GNSS"] * 5
    text = f"horizontal position {size:g}, height {size:g}, horizontal velocity {size:g}, tilt {size:g}, "
    assert told[0] == f"filter, with GNSS, over the bound: {text}heading {size:g}."
    assert told[2].startswith(
        f"smoother, with GNSS, over the smoothing bound: horizontal position {2 * size:g}"
    )
    assert told[4] == "lost, with GNSS, over the bound: no errors."
    twice = {"first": 0.1 * signs, "second": 2.0 * signs}
    assert not bound_study.hold_draws(bound, twice, dict.fromkeys(twice, False), phases)[2]
    wide = replace(bound, causal=np.where(np.arange(9)[:, None] < 6, n, np.nan))
    held = bound_study.hold_draws(wide, {"low": 0.1 * signs}, {"low": False}, phases)[0]
    assert held["quantity"] == ["horizontal position", "height", "horizontal velocity"] * 2
    table = bound_study.tabulate_bound(bound, [1, 3]).columns
    assert table["t_s"] == [1.0, 3.0]
    assert_allclose(table["horizontal_m"], np.sqrt(2.0))
    assert_allclose(table["horizontal_smoothed_m"], np.sqrt(0.5))
    assert_allclose(table["heading_smoothed_deg"], 0.5 / DEG)
    plot = next(
        one
        for one in bound_study.plot_bound(bound, {"filter": errors["filter"]}, smoothing)
        if "tilt" in one.path
    )
    drawn, least, smoothed = plot.series
    assert_allclose(drawn.values, size * np.sqrt(2.0) / DEG)
    assert_allclose(least.values, np.sqrt(2.0) / DEG)
    assert_allclose(smoothed.values, np.sqrt(0.5) / DEG)


def test_the_reference_heading_by_hand():
    """Headings that fall from 5 and 7 deg, and from twice as much: four figures, lines and colors."""
    t = np.arange(1801.0)
    grown = {"grade-3": 5.0, "MEMS": 7.0}
    headings = {
        (name, turns): grown.get(name, 1.0) * (2.0 - turns) * (1.0 - t / 3600.0)
        for name in GRADES
        for turns in (True, False)
    }
    table, plot = observability.tabulate_reference(headings)
    k = list(GRADES).index("MEMS")
    found = [column[k] for name, column in table.columns.items() if name != "grade"]
    assert_allclose(found, [7.0 * (1.0 - at / 3600.0) for at in (240, 400, 1800)] + [7.0])
    assert [one.key for one in plot.series] == ["grade-3", "grade-3 straight", "MEMS", "MEMS straight"]
    assert [one.values[0, 0] for one in plot.series] == [5.0, 10.0, 7.0, 14.0]
    assert len({one.colors for one in plot.series}) == 4
