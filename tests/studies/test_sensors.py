"""The study of units: its answer where the order of the units is known, and never one that lost a run."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy import stats

import bench
from bench.core.records.findings import series
from bench.core.words.exceptions import ConfigError
from bench.evaluation.requirements.required_metrics import MET
from bench.experiments.studies.drawn_errors import UnitFlight
from bench.experiments.studies.unit_study import unit_limits, unit_table
from bench.experiments.studies.unit_study.catalog_units import CLASSES, find_typical, find_units, list_units
from bench.experiments.studies.unit_study.unit_answer import find_margin
from bench.experiments.studies.unit_study.unit_limits import VarianceShares, find_limit
from bench.experiments.studies.unit_study.unit_ranking import UnitFlown, rank_units
from bench.experiments.studies.unit_study.unit_table import Options, find_law
from tests.studies.made_units import write_unit

METRIC = "outage_1_drift_h_m"


class Flights:
    """Stands for campaigns: the errors of a unit are those of a law, the same runs for all."""

    def __init__(self, law, document=None):
        self.law, self.document = law, document or {"gnss_outage": [{}]}
        self.flown = []

    def progress(self, what, done, of):
        pass

    def map(self, what, function, items):
        return [function(one) for one in items]

    def campaign(self, what, spec, first=0):
        rows = []
        for number, values in enumerate(spec.varied):
            unit, filled = Path(values["sensors.imu"]).stem, len(values) > 1
            for label in spec.estimators:
                for run in range(first, spec.runs):
                    error = self.law(unit, run, filled)
                    self.flown.append((unit, run, filled))
                    rows.append({
                        "condition": number, "run": run, "estimator": label,
                        "converged": bool(np.isfinite(error)), METRIC: error if np.isfinite(error) else None,
                    })  # fmt: skip
        table = SimpleNamespace(to_pylist=lambda: rows)
        return SimpleNamespace(runs=table, conditions=[{"as_flown": self.document}])


@pytest.fixture(autouse=True)
def no_budget(monkeypatch):
    monkeypatch.setattr(unit_table, "find_limit", lambda *args: None)


def ask(names, flights, **more):
    """Return the findings and the answer of the study of made flights."""
    options = Options(units=names, **more)
    units = find_units("sensors", names)
    (answer,) = unit_table.answer(options, units, options.profiles[0], flights)
    return unit_table.run(options, flights), answer


def write(tmp_path, **grades):
    return [write_unit(tmp_path, name, 1.0, grade) for name, grade in grades.items()]


def steady(**sizes):
    """Return a law: a size by unit times the same Rayleigh error of each run."""
    runs = np.hypot(*np.random.default_rng(1).standard_normal((2, 1000)))
    return lambda unit, run, filled: sizes[unit] * runs[run]


def test_from_cheap_to_dear_a_class_is_on_the_front_only_if_it_is_better(tmp_path):
    """By hand: c is a hundredth better than b, of a lower class, which is no difference; d is better."""
    names = write(tmp_path, a="consumer", b="consumer", c="industrial", d="tactical")
    found, answer = ask(names, Flights(steady(a=9.0, b=4.0, c=4.04, d=3.0)))
    assert [Path(step.best.unit).stem for step in answer.ranking.front] == ["b", "d"]
    assert [step.pays for step in answer.ranking.steps] == [True, False, True]
    (text,) = [one for one in found.verdicts if "cheapest class first" in one]
    assert "no better than" in text
    assert "0.75 times" in text
    assert not answer.ranking.alike
    table = next(one for one in found.tables if one.name == "units").columns
    assert table["verdict"] == ["usable"] * 4
    assert table["runs"] == [6] * 4
    (figure,) = found.figures
    assert figure.series[0].labels == ("a", "b", "c", "d")
    dots, front = figure.series
    assert (dots.colors, dots.widths) == (series.ESTIMATORS[:1], (4.0,))
    assert front.colors == dots.colors
    assert_allclose(dots.t, [1.0, 1.0, 2.0, 3.0])
    assert_allclose(dots.values[:, 0], table["rms"])
    assert_allclose(front.t, [1.0, 3.0])
    assert_allclose(front.values[:, 0], [table["rms"][1], table["rms"][3]])
    assert [at for at, _ in figure.ticks] == [1.0, 2.0, 3.0, 4.0]
    assert [name for _, name in figure.ticks] == list(CLASSES)


def test_a_unit_that_lost_a_draw_is_never_recommended(tmp_path):
    names = write(tmp_path, good="consumer", lost="consumer", dear="tactical", gone="consumer")
    whole = steady(good=4.0, lost=1.0, dear=3.0, gone=1.0)

    def law(unit, run, filled):
        return np.nan if (unit, run) == ("lost", 4) or unit == "gone" else whole(unit, run, filled)

    found, answer = ask(names, Flights(law))
    assert {Path(step.best.unit).stem for step in answer.ranking.steps} == {"good", "dear"}
    assert not any("lost" in pair.first for step in answer.ranking.steps for pair in step.beside)
    table = next(one for one in found.tables if one.name == "units").columns
    assert table["verdict"] == ["usable", "not usable", "usable", "not usable"]
    assert table["lost"] == [0, 1, 0, 6]
    assert any("not usable on this flight" in one and "lost.toml 1 of 6" in one for one in found.verdicts)
    assert found.figures[0].series[1].labels == ("lost",), "of the other no error is known"


def test_of_those_that_meet_the_smallest_the_lightest_and_the_cheapest_are_named(tmp_path):
    """By hand: a is the smallest of all but misses; b is 10 x 20 x 30 mm, c lighter; d has no size."""
    names = write(tmp_path, a="consumer", b="industrial", c="industrial", d="tactical")
    products = (
        "length_mm = 1.0\nwidth_mm = 1.0\nheight_mm = 1.0\nmass_kg = 0.001\n",
        "length_mm = 30.0\nwidth_mm = 20.0\nheight_mm = 10.0\nmass_kg = 0.05\npower_mw = 1500.0\n",
        "length_mm = 40.0\nwidth_mm = 20.0\nheight_mm = 10.0\nmass_kg = 0.04\n",
        "price_usd = 900.0\nprice_date = 2026-03-01\n",
    )
    for name, text in zip(names, products, strict=True):
        with Path(name).open("a") as file:
            file.write(f"[product]\n{text}")
    sizes = {"a": 20.0, "b": 4.0, "c": 4.0, "d": 4.0}
    law = Flights(lambda unit, run, filled: sizes[unit])
    found, _ = ask(names, law, most=10.0, runs=73, max_runs=73)
    (told,) = [one.replace(f"{tmp_path}/", "") for one in found.verdicts if "of the 3 units" in one]
    assert told.partition(": ")[2] == (
        "smallest b.toml (6 cm^3, of 2), lightest c.toml (0.04 kg, of 2), "
        "least power b.toml (1500 mW, of 1), cheapest by its price d.toml (900 USD, of 1); "
        "without a size: d.toml."
    )
    table = next(one for one in found.tables if one.name == "products").columns
    assert table["volume_cm3"] == pytest.approx([1e-3, 6.0, 8.0, None])
    bare, _ = ask(write(tmp_path, a="consumer"), Flights(steady(a=1.0)), most=10.0)
    assert not any("units that meet it" in one for one in bare.verdicts)
    assert all(one.name != "products" for one in bare.tables)


@pytest.mark.parametrize("size", [0.999, 1.001])
def test_a_requirement_that_is_just_met_or_just_missed(tmp_path, size):
    """73 of 73 runs show 95 % while runs are added; the cheaper class errs twice as much."""
    names = write(tmp_path, cheap="consumer", dear="industrial")
    sizes = {"cheap": 20.0, "dear": 10.0 * size}
    found, answer = ask(
        names, Flights(lambda unit, run, filled: sizes[unit]), most=10.0, runs=73, max_runs=73
    )
    if size < 1.0:
        assert Path(answer.ranking.recommended.best.unit).stem == "dear"
        assert (found.good, found.undecided) == (True, False)
        assert "(industrial) meets the requirement" in found.verdicts[0]
        assert found.verdicts[0].endswith("of the runs, margin 1.")
        table = next(one for one in found.tables if one.name == "units").columns
        assert table["verdict"] == ["missed", "met"]
        assert table["margin"] == pytest.approx([0.5, 1.0 / size])
        limit = found.figures[0].series[-1]
        assert_allclose((limit.t, limit.values[:, 0]), ([1.0, 4.0], [10.0, 10.0]))
    else:
        assert answer.ranking.recommended is None
        assert (found.good, found.undecided) == (False, False)
        assert "no unit meets the requirement" in found.verdicts[0]


def test_a_unit_without_a_class_that_may_meet_a_requirement_is_no_cheaper_one(tmp_path):
    names = [write_unit(tmp_path, "none", 1.0, grade=""), *write(tmp_path, dear="tactical")]
    document = {"requirement": [{"metric": METRIC, "most": 10.0, "share": 0.5}]}
    law = lambda unit, run, filled: 5.0 if unit == "dear" else 8.0 + 4.0 * (run % 2)  # noqa: E731
    found, answer = ask(names, Flights(law, document), runs=8, max_runs=8)
    assert answer.ranking.flown[names[0]].verdict == "undecided"
    assert answer.ranking.list_undecided() == []
    assert (found.good, found.undecided) == (True, False)


def test_a_requirement_of_the_profile_is_judged_and_more_draws_are_flown_for_it(tmp_path):
    """Only 59 runs can show 95 %: so many are flown, unless fewer are asked for; they say what would do."""
    names = write(tmp_path, cheap="consumer", dear="tactical")
    document = {"requirement": [{"metric": METRIC, "most": 10.0, "share": 0.95}]}
    flights = Flights(lambda unit, run, filled: 5.0 if unit == "dear" else 50.0, document)
    found, answer = ask(names, flights)
    assert answer.metric == METRIC
    assert (found.good, found.undecided) == (True, False)
    assert max(run for unit, run, _ in flights.flown if unit == "dear") == 72
    assert max(run for unit, run, _ in flights.flown if unit == "cheap") == 5, "it is missed for certain"
    assert "(tactical) meets the requirement" in found.verdicts[0]
    found, answer = ask(names, flights, max_runs=24)
    assert (found.good, found.undecided) == (True, True)
    assert any("233 runs would show it in 90 % of cases" in one for one in found.verdicts)
    assert "no unit is shown to meet the requirement" in found.verdicts[0]
    assert not ask(names, flights, max_runs=73)[0].undecided


def test_a_cheaper_class_that_may_meet_is_not_passed_over_in_silence(tmp_path):
    """Eight runs do not decide of a unit that keeps the limit in half of them; the dear one keeps it."""
    names = write(tmp_path, cheap="consumer", dear="industrial", beside="industrial")
    document = {"requirement": [{"metric": METRIC, "most": 12.0, "share": 0.5}]}
    sizes = {"dear": 5.0, "beside": 6.0}
    flights = Flights(lambda unit, run, filled: sizes.get(unit, 10.0 + 4.0 * (run % 2)), document)
    found, answer = ask(names, flights, runs=8, max_runs=8)
    assert (found.good, found.undecided, answer.undecided) == (True, True, True)
    assert "(industrial) meets the requirement" in found.verdicts[0]
    assert "at most 12 m in 50 % of the runs" in found.verdicts[0]
    assert "Cheaper, but undecided: " + names[0] in found.verdicts[0]
    found, answer = ask(names[1:], flights, runs=8, max_runs=8)
    assert (found.good, found.undecided) == (True, False)
    assert "(industrial) meets the requirement" in found.verdicts[0]


def test_of_an_undecided_pair_the_unit_with_fewer_draws_flies_again():
    """A fifth apart. A pair that takes far more runs than the most is left as it is."""
    runs = np.hypot(*np.random.default_rng(3).standard_normal((2, 2, 12)))
    one, other = runs[0], 1.2 * runs[0] * np.exp(0.2 * (runs[1] - 1.25))

    def list_open(first, second, most):
        flown = [UnitFlown("a", "consumer", first), UnitFlown("b", "consumer", second)]
        return set(unit_table.list_open(rank_units(flown, 0.017), most))

    assert list_open(one[:6], other[:6], 24) == {"a", "b"}
    assert list_open(one, other[:6], 24) == {"b"}
    assert list_open(one[:6], other, 24) == {"a"}
    assert list_open(one[:6], other[:6], 2) == set()


def test_where_all_err_the_same_the_imu_does_not_matter(tmp_path):
    names = write(tmp_path, a="consumer", b="tactical", c="navigation")
    found, answer = ask(names, Flights(steady(a=1.01, b=1.0, c=1.005)))
    assert answer.ranking.alike
    assert any("all 3 usable units are within 1.0 %" in one for one in found.verdicts)
    _, lone = ask(names[:1], Flights(steady(a=1.0)))
    assert not lone.ranking.alike
    _, other = ask(names, Flights(steady(a=1.1, b=1.0, c=1.0)))
    assert not other.ranking.alike
    noise = np.random.default_rng(2).uniform(0.7, 1.3, (2, 24))
    (noisy,) = unit_table.answer(
        Options(units=names[:2]),
        find_units("sensors", names[:2]),
        "gnss-denied-leg",
        Flights(lambda unit, run, filled: float(noise["ab".index(unit), run])),
    )
    assert noisy.ranking.spread < 1.05, "so few runs do not show it"
    assert not noisy.ranking.alike


def test_the_answer_says_if_it_rests_on_figures_that_no_source_states(tmp_path):
    """A sheet without bias instabilities looks best with zero in their place, and is not."""
    bare = "[gyro]\nnoise_deg_sqrt_h = 0.2\n[accel]\nnoise_m_s_sqrt_h = 0.03\n"
    names = [
        write_unit(tmp_path, "bare", 1.0, "consumer", bare),
        write_unit(tmp_path, "full", 1.0, "consumer"),
    ]
    sizes = {("bare", False): 1.0, ("bare", True): 9.0, ("full", True): 3.0, ("full", False): 3.0}
    flights = Flights(lambda unit, run, filled: sizes[unit, filled] * (1.0 + 0.1 * (run % 3)))
    found, answer = ask(names, flights)
    assert Path(answer.ranking.front[0].best.unit).stem == "full"
    assert Path(answer.bare.front[0].best.unit).stem == "bare"
    (text,) = [one for one in found.verdicts if "the answer depends on parameters" in one]
    assert "full.toml; if they are zero," in text
    gaps = next(one for one in found.tables if one.name == "gaps").columns
    rows = list(zip(gaps["unit"], gaps["absent"], gaps["key"], gaps["basis"], strict=True))
    assert (names[0], "gyro bias instability", "gyro.bias_instability_deg_h", "assumed") in rows
    assert (names[0], "gyro bandwidth", "", "no limit") in rows
    same, _ = ask(names, Flights(steady(bare=1.0, full=3.0)))
    assert any("with zero instead the answer is the same" in one for one in same.verdicts)


def test_draws_are_added_for_pairs_that_they_decide_and_for_no_other(tmp_path):
    """a and b differ by a fifth in runs of their own; c is far off and keeps its 6 runs."""
    names = write(tmp_path, a="industrial", b="industrial", c="industrial")
    rng = np.random.default_rng(8)
    own = {name: np.hypot(*rng.standard_normal((2, 100))) for name in "ab"}
    sizes = {"a": 1.0, "b": 1.3}

    def law(unit, run, filled):
        return 50.0 + 0.1 * run if unit == "c" else sizes[unit] * own[unit][run]

    flights = Flights(law)
    _, answer = ask(names, flights, max_runs=100)
    assert {run for unit, run, _ in flights.flown if unit == "c"} == set(range(6))
    runs = len(answer.ranking.flown[names[0]].values)
    assert runs > 6
    assert {run for unit, run, _ in flights.flown if unit == "a"} == set(range(runs))


@pytest.mark.parametrize("imu_share", [1.0, 0.9])
def test_of_two_units_a_tenth_apart_the_wrong_one_is_named_seldom(tmp_path, imu_share):
    """200 repetitions, figures a tenth apart, the same runs; the rest of the variance is the receiver's.

    Wrong in at most 5 %, undecided in at most 20 %.
    """
    names = [write_unit(tmp_path, "better", 1.0), write_unit(tmp_path, "worse", 1.1)]
    sizes = {"better": 1.0, "worse": 1.1}
    wrong = undecided = 0
    for seed in range(200):
        rng = np.random.default_rng(seed)
        by_imu = np.sqrt(imu_share) * rng.standard_normal((100, 2))
        other = np.sqrt(1.0 - imu_share) * rng.standard_normal((100, 2))

        def law(unit, run, filled, by_imu=by_imu, other=other):
            return float(np.hypot(*(sizes[unit] * by_imu[run] + other[run])))

        options = Options(units=names)
        (answer,) = unit_table.answer(options, find_units("sensors", names), "gnss-denied-leg", Flights(law))
        (step,) = answer.ranking.steps
        if any(pair.word == "undecided" for pair in step.beside):
            undecided += 1
        elif Path(step.best.unit).stem == "worse":
            wrong += 1
    assert wrong <= 10
    assert undecided <= 40


def test_of_two_equal_units_none_is_named_better_more_often_than_is_allowed(tmp_path):
    """200 repetitions with runs that are alike by nine tenths, looked at up to three times: 5 % at most."""
    names = [write_unit(tmp_path, "one", 1.0), write_unit(tmp_path, "other", 1.0)]
    units, named = find_units("sensors", names), 0
    for seed in range(200):
        rng = np.random.default_rng(seed)
        shared, own = (
            rng.standard_normal((100, 2)),
            dict(zip(("one", "other"), rng.standard_normal((2, 100, 2)), strict=False)),
        )

        def law(unit, run, filled, shared=shared, own=own):
            return float(np.hypot(*(0.9 * shared[run] + np.sqrt(0.19) * own[unit][run])))

        (answer,) = unit_table.answer(Options(units=names), units, "gnss-denied-leg", Flights(law))
        named += not answer.ranking.steps[0].beside
    assert named <= stats.binom.ppf(0.999, 200, 0.05)


def test_every_unit_of_the_catalog_has_a_class():
    units = list_units()
    assert {unit.grade for unit in units.values()} == {*CLASSES, "synthetic"}
    assert len(units) >= 20
    assert "gyro bandwidth" in find_units("sensors", ["stim300"])["stim300"].absent
    assert not find_units("sensors", ["stim300"])["stim300"].typical
    assert find_law("icm-42688-p") > find_law("stim300") > find_law("hg9900")


def test_what_is_typical_of_a_class_is_the_median_of_its_units():
    """By hand from the catalog: misalignments of 1 and 0.75 mrad and what else is tactical."""
    bias, correlation = find_typical("consumer", "gyro", "bias instability")
    assert (bias.key, bias.value, bias.assumed) == ("gyro.bias_instability_deg_h", 5.0, True)
    assert (correlation.key, correlation.value) == ("gyro.bias_correlation_s", 300.0)
    (noise,) = find_typical("tactical", "gyro", "noise")
    known = [0.01, 0.125, 0.04, 0.05, 0.06, 0.012, 0.07, 0.15]  # deg/sqrt(h) of the eight
    assert len(noise.units) == len(known)
    assert not noise.assumed
    assert noise.value * (60.0 if noise.key.endswith("sqrt_hz") else 1.0) == pytest.approx(np.median(known))
    assert find_typical("synthetic", "gyro", "noise") == ()
    assert list_units()["lsm6dsl"].filled["sensors.imu.gyro.bias_instability_deg_h"] == 5.0


def test_what_is_wrong_is_one_line():
    for given, message in (
        ({"units": "stim"}, "imu = 'stim' is not in the catalog"),
        ({"units": "kvh-dsp-1760"}, "has no accelerometers"),
        ({"metric": "pos_rmse"}, "metric: 'pos_rmse' is unknown"),
        ({"runs": 1}, "runs = 1"),
    ):
        with pytest.raises(ConfigError, match=message):
            bench.study("sensors", **given)


@pytest.mark.slow
def test_units_of_ones_own_are_flown_with_what_is_set(tmp_path, monkeypatch):
    """Two made units of one class, a factor of two apart, on real flights, and what limits there."""
    monkeypatch.undo()
    names = [write_unit(tmp_path, "half", 1.0), write_unit(tmp_path, "whole", 2.0)]
    found = bench.study(
        "sensors", units=names, runs=3, max_runs=3, jobs=1, seed=5,
        overrides={"gnss_outage.1.duration_s": 60.0, "rate_hz": 100},
    )  # fmt: skip
    table = found.tables["units"].columns
    assert table["verdict"] == ["usable", "usable"]
    assert table["rms"][0] < table["rms"][1]
    assert "--seed 5" in found.command
    assert "--set gnss_outage.1.duration_s=60.0" in found.command
    (limit,) = [one for one in found.verdicts if one.startswith("What limits")]
    assert "at 240 s, end of the outage is" in limit
    assert MET == "met"


def test_the_best_of_many_units_is_no_better_for_being_chosen():
    """Sixteen dear units beside a cheap one, all alike: a class is put forward as rarely as is said."""
    rng, wrong, flights = np.random.default_rng(1), 0, 400
    for errors in np.sqrt(rng.chisquare(4.0, (flights, 17, 6))):
        units = [UnitFlown(f"u{k}", "tactical" if k else "consumer", row) for k, row in enumerate(errors)]
        wrong += len(rank_units(units, 0.05).front) > 1
    assert wrong <= stats.binom.ppf(0.999, flights, 0.05)


def test_what_limits_is_the_largest_share_unless_another_filter_would_gain_much():
    shares = {"the IMU": 0.7, "the receiver": 0.299, "the start": 0.001}
    told = VarianceShares("flight", "mine", "100 s", 2.0, shares, 1.25).tell("unit")
    assert told == (
        "What limits mine with unit on flight at 100 s is the IMU: of the variance the IMU 70 %, the "
        "receiver 30 % (expected 2 m RMS); the best linear filter would have 80 % of the error."
    )
    assert VarianceShares("flight", "mine", "100 s", 2.0, shares, 2.0).limiting == "the filter"


def test_shares_are_those_of_the_budget_by_hand(monkeypatch):
    """Sources of 1, 2, 9 and 4 m2 horizontally at the end of the longest outage; the best filter has 4 m2."""
    t = np.arange(5.0)
    variance = np.full((5, 3, 4), 1e6)
    variance[1, :2] = [[0.5, 1.0, 4.5, 2.0]] * 2
    best = np.full((5, 3), 1e6)
    best[1, :2] = 2.0
    sources = [SimpleNamespace(part=part) for part in ("gyro", "accel", "gnss", "initial")]
    outages = ((0.0, 2.0), (3.0, 4.0))
    profile = SimpleNamespace(
        name="flight", seed=1, estimators=[SimpleNamespace(label="mine")],
        sensors=SimpleNamespace(gnss_outages=outages),
    )  # fmt: skip
    monkeypatch.setattr(UnitFlight, "load", lambda self: (profile, SimpleNamespace(t=t)))
    monkeypatch.setattr(
        unit_limits.pipeline, "build_estimator", lambda choice: unit_limits.Loose.__new__(unit_limits.Loose)
    )
    monkeypatch.setattr(unit_limits.sensors, "sense", lambda *args: SimpleNamespace(data=None))
    monkeypatch.setattr(unit_limits, "split_errors", lambda *args: SimpleNamespace(t=t, variance=variance))
    monkeypatch.setattr(unit_limits, "model_errors", lambda *args, **more: SimpleNamespace(sources=sources))
    monkeypatch.setattr(unit_limits, "variance_of", lambda *args, **more: best)
    for name in ("check_aiding", "record_gains", "bound_flight"):
        monkeypatch.setattr(unit_limits, name, lambda *args, **more: None)
    found = find_limit(UnitFlight("flight"))
    assert list(found.shares) == ["the receiver", "the start", "the IMU"]
    assert list(found.shares.values()) == pytest.approx([9 / 16, 4 / 16, 3 / 16])
    assert (found.sd, found.over_best) == (pytest.approx(4.0), pytest.approx(2.0))
    assert found.when == "2 s, end of the outage"
    profile.sensors.gnss_outages = ()
    assert find_limit(UnitFlight("flight")).when == "4 s, end of the flight"


def test_the_margin_is_the_limit_over_the_draw_that_has_to_keep_it():
    """By hand: the median of 1 to 9 m is 5 m. A least value has none, nor another figure, nor a lost draw."""
    flown = UnitFlown("unit", "tactical", np.arange(1.0, 10.0))
    row = {"metric": METRIC, "most": 20.0, "share": 0.5}
    assert find_margin(flown, [{**row, "metric": "other", "most": 1.0}, row], METRIC) == pytest.approx(4.0)
    assert find_margin(flown, [row], "other") is None
    assert find_margin(flown, [{"metric": METRIC, "least": 1.0, "share": 0.5}], METRIC) is None
    lost = UnitFlown("unit", "tactical", np.array([1.0, np.nan, 2.0]))
    assert find_margin(lost, [row], METRIC) is None
    assert (lost.lost, lost.verdict, flown.verdict) == (1, "not usable", "usable")
