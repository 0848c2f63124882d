"""A baseline regresses when a mean leaves its tolerance on the wrong side, and only then.

False-alarm rate of a recorded tolerance: 0.1 % per metric when the spread sets it, less
when its floor does. The smallest change it catches at even odds is the tolerance itself.
The runs are made up here: what is flown is the business of the pipeline's tests.
"""

import json
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from bench import baselines
from bench.baselines import Statistic, check, compare, measure, read, record, write
from bench.errors import ConfigError
from bench.run_result import RunResult

PROFILE = SimpleNamespace(name="survey", seed=7)


def result(metrics, run=0):
    return RunResult(
        profile={},
        seed=7,
        run=run,
        metrics=metrics,
        errors={},
        solutions={},
        provenance={"versions": {"bench": "0.1.0", "numpy": "2.0"}},
    )


def sound(**metrics):
    return {"converged": True, "reason": None, **metrics}


@pytest.fixture
def bench_of(monkeypatch):
    """Replace the flight by made-up metrics of run k; return what was flown."""
    flown = []

    def install(metrics_of):
        def fly(profile):
            flown.append(("fly", profile.name))
            return "truth"

        def run(profile, run, truth):
            assert truth == "truth"
            flown.append(("run", run))
            return result(metrics_of(run), run)

        monkeypatch.setattr(baselines, "load_profile", lambda source: SimpleNamespace(name=source, seed=7))
        monkeypatch.setattr(baselines, "pipeline", SimpleNamespace(fly=fly, run=run))
        return flown

    return install


SPREAD = (1.9, 2.0, 2.2, 2.1, 1.8)


def usual(scale=1.0, nees=9.0):
    return lambda k: {
        "loose-15": sound(
            pos_rmse_h_m=scale * SPREAD[k % 5],
            pos_rmse_h_m_all=50.0,
            pos_max_h_m=7.0,
            nees_mean=nees,
            heading_convergence_s=3.0,
            unmodelled=["scale factor"],
        )
    }


# --- measure and record --------------------------------------------------------------------------------


def test_statistics_are_mean_and_standard_error_of_the_metrics_with_a_direction():
    found = measure([result(usual()(k)) for k in range(5)])["loose-15"]
    assert set(found) == {"converged", "pos_rmse_h_m", "nees_mean"}
    assert found["pos_rmse_h_m"].mean == pytest.approx(2.0)
    assert found["pos_rmse_h_m"].standard_error == pytest.approx(np.std(SPREAD, ddof=1) / np.sqrt(5))
    assert found["pos_rmse_h_m"].n == 5
    assert found["converged"] == Statistic(1.0, 0.0, 5)


def test_a_run_that_diverged_counts_in_converged_and_nowhere_else():
    diverged = {"loose-15": {"converged": False, "reason": "why", "pos_rmse_h_m": None, "nees_mean": None}}
    found = measure([result(usual()(0)), result(diverged), result(usual()(1)), result(diverged)])["loose-15"]
    assert found["converged"].mean == 0.5
    assert found["pos_rmse_h_m"].n == 2
    assert found["pos_rmse_h_m"].mean == pytest.approx(1.95)


def test_a_record_flies_once_draws_the_sensors_n_times_and_says_where_each_tolerance_comes_from(bench_of):
    flown = bench_of(usual())
    told = []
    baseline = record(PROFILE, 5, progress=lambda *step: told.append(step))
    assert flown == [("fly", "survey"), *(("run", k) for k in range(5))]
    assert told == [("survey", k, 5) for k in range(6)]
    assert (baseline["profile"], baseline["seed"], baseline["runs"]) == ("survey", 7, 5)
    assert baseline["versions"]["numpy"] == "2.0"
    rmse = baseline["estimators"]["loose-15"]["pos_rmse_h_m"]
    assert rmse["tolerance"] == pytest.approx(0.02 * 2.0)
    assert rmse["direction"] == "lower"
    assert rmse["reason"] == "2% of the mean: same draws, another processor"
    nees = baseline["estimators"]["loose-15"]["nees_mean"]
    assert nees["tolerance"] == pytest.approx(0.02 * 9.0)
    assert nees["direction"] == "both"


@pytest.mark.parametrize(
    ("name", "value", "tolerance"),
    [
        ("pos_rmse_h_m", 2.0, 0.04),
        ("pos_rmse_h_m", 0.0, 0.0),
        ("coverage_3sigma_pos_n", 0.0, 0.02),  # a fraction may be 0
        ("nees_mean", 1000.0, 20.0),
        ("converged", True, 0.0),
    ],
)
def test_the_tolerance_is_2_percent(bench_of, name, value, tolerance):
    bench_of(lambda k: {"loose-15": sound() | {name: value}})
    assert record(PROFILE, 3)["estimators"]["loose-15"][name]["tolerance"] == pytest.approx(tolerance)


def test_fewer_draws_raise_one_false_alarm_in_a_thousand():
    """20000 baselines of 10 normal runs, each checked with the first 4; 99.9 % band of the count of alarms.

    Ten draws leave Student's t with 9 degrees of freedom; the normal quantile in its place alarms too often.
    """
    draws = np.random.default_rng(5).normal(size=(20_000, 10))
    standard_error = draws.std(axis=1, ddof=1) / np.sqrt(10)
    difference = np.abs(draws[:, :4].mean(axis=1) - draws.mean(axis=1)) / standard_error
    allowed = baselines._allow_for_fewer_draws({"n": 10, "standard_error": 1.0}, 4)
    band = 3.29 * np.sqrt(20)
    assert np.sum(difference > allowed) < 20 + band
    assert allowed == pytest.approx(4.781 * np.sqrt(1.5), rel=1e-3)  # t of 9 degrees, 99.9 %, from tables


def test_one_run_has_no_spread(bench_of):
    bench_of(usual())
    with pytest.raises(ConfigError, match="runs = 1 must be at least 2"):
        record(PROFILE, 1)


# --- compare -------------------------------------------------------------------------------------------


def baseline_of(direction, mean=10.0, tolerance=1.0, n=5):
    limit = {
        "mean": mean,
        "standard_error": 0.1,
        "n": n,
        "tolerance": tolerance,
        "direction": direction,
        "reason": "by hand",
    }
    return {
        "profile": "survey",
        "seed": 7,
        "runs": n,
        "versions": {},
        "estimators": {"loose-15": {"pos_rmse_h_m": limit}},
    }


@pytest.mark.parametrize(
    ("direction", "measured", "regressed", "improved"),
    [
        ("lower", 10.0, False, False),
        ("lower", 10.9, False, False),
        ("lower", 11.1, True, False),
        ("lower", 9.1, False, False),
        ("lower", 8.9, False, True),
        ("higher", 11.1, False, True),
        ("higher", 8.9, True, False),
        ("both", 10.9, False, False),
        ("both", 11.1, True, False),
        ("both", 8.9, True, False),
    ],
)
def test_worse_is_beyond_the_tolerance_on_the_wrong_side(direction, measured, regressed, improved):
    found = {"loose-15": {"pos_rmse_h_m": Statistic(measured, 0.1, 5)}}
    (verdict,) = compare(baseline_of(direction), found)
    assert (verdict.regressed, verdict.improved) == (regressed, improved)
    assert (verdict.profile, verdict.estimator, verdict.metric) == ("survey", "loose-15", "pos_rmse_h_m")
    assert (verdict.expected, verdict.measured, verdict.tolerance) == (10.0, measured, 1.0)


@pytest.mark.parametrize("found", [{}, {"loose-15": {}}])
def test_a_metric_that_no_run_has_any_more_is_a_regression(found):
    (verdict,) = compare(baseline_of("lower"), found)
    assert verdict.regressed
    assert verdict.measured is None


def test_a_metric_without_a_limit_is_not_judged():
    found = {"loose-15": {"pos_rmse_h_m": Statistic(10.0, 0.1, 5), "cep50_m": Statistic(1e9, 0.1, 5)}}
    assert [verdict.metric for verdict in compare(baseline_of("lower"), found)] == ["pos_rmse_h_m"]


@pytest.mark.parametrize("m", [1, 4, 5, 50])
def test_other_draws_than_the_baseline_has_widen_the_tolerance(m):
    found = {"loose-15": {"pos_rmse_h_m": Statistic(10.0, 0.1, m)}}
    baseline = baseline_of("lower")
    (verdict,) = compare(baseline, found)
    limit = baseline["estimators"]["loose-15"]["pos_rmse_h_m"]
    wider = verdict.tolerance - limit["tolerance"]
    assert (wider == 0.0) if m == limit["n"] else (wider > 0.0)


# --- files and check -----------------------------------------------------------------------------------


def test_what_is_recorded_is_read_back_and_passes(bench_of, tmp_path):
    flown = bench_of(usual())
    baseline = record(PROFILE, 5)
    path = write(tmp_path / "limits", baseline)
    assert path == tmp_path / "limits" / "survey.json"
    assert read(path) == baseline
    assert [p.name for p in path.parent.iterdir()] == ["survey.json"]
    flown.clear()
    verdicts = check(tmp_path / "limits")
    assert flown == [("fly", "survey"), *(("run", k) for k in range(5))]
    assert [verdict.metric for verdict in verdicts] == ["converged", "pos_rmse_h_m", "nees_mean"]
    assert not any(verdict.regressed or verdict.improved for verdict in verdicts)


@pytest.mark.parametrize(
    ("metrics_of", "regressed", "improved"),
    [
        (usual(scale=1.01), [], []),
        (usual(scale=1.03), ["pos_rmse_h_m"], []),
        (usual(scale=0.5), [], ["pos_rmse_h_m"]),
        (usual(nees=9.2), ["nees_mean"], []),
        (usual(nees=8.8), ["nees_mean"], []),
        (
            lambda k: {"loose-15": {"converged": False, "reason": "why", "pos_rmse_h_m": None}},
            ["converged", "pos_rmse_h_m", "nees_mean"],
            [],
        ),
        (lambda k: {"other": sound()}, ["converged", "pos_rmse_h_m", "nees_mean"], []),
    ],
)
def test_check_finds_what_changed(bench_of, tmp_path, metrics_of, regressed, improved):
    bench_of(usual())
    write(tmp_path, record(PROFILE, 5))
    bench_of(metrics_of)
    verdicts = check(tmp_path)
    assert [verdict.metric for verdict in verdicts if verdict.regressed] == regressed
    assert [verdict.metric for verdict in verdicts if verdict.improved] == improved


def test_a_baseline_of_another_seed_or_without_limits_is_refused(bench_of, tmp_path, monkeypatch):
    bench_of(usual())
    baseline = record(PROFILE, 5)
    write(tmp_path, baseline | {"seed": 8})
    with pytest.raises(ConfigError, match="seed = 8 differs from the profile's seed = 7"):
        check(tmp_path)
    write(tmp_path, baseline | {"estimators": {"loose-15": {}}})
    with pytest.raises(ConfigError, match="holds no limit"):
        check(tmp_path)


def test_check_takes_the_profiles_and_runs_asked_for(bench_of, tmp_path):
    flown = bench_of(usual())
    for name in ("survey", "loiter"):
        write(tmp_path, record(SimpleNamespace(name=name, seed=7), 5))
    flown.clear()
    assert {verdict.profile for verdict in check(tmp_path, ["loiter"], runs=2)} == {"loiter"}
    assert flown == [("fly", "loiter"), ("run", 0), ("run", 1)]
    assert {verdict.profile for verdict in check(tmp_path)} == {"loiter", "survey"}


def test_a_profile_of_ones_own_is_found_again_from_any_folder(bench_of, tmp_path, monkeypatch):
    flown = bench_of(usual())
    limits, elsewhere = tmp_path / "limits", tmp_path / "elsewhere"
    elsewhere.mkdir()
    monkeypatch.chdir(tmp_path)
    path = write(limits, record(PROFILE, 2, source="flights/survey.toml"))
    assert path.name == "survey.json"
    assert json.loads(path.read_text())["profile"] == "../flights/survey.toml"
    monkeypatch.chdir(elsewhere)
    flown.clear()
    assert check(limits)[0].profile == "survey"
    assert flown[0] == ("fly", str(tmp_path / "flights" / "survey.toml"))
    assert check(Path("../limits"))[0].profile == "survey"
    assert flown[-3] == ("fly", "../flights/survey.toml")


def test_a_write_that_fails_leaves_the_old_baseline_and_nothing_else(bench_of, tmp_path, monkeypatch):
    bench_of(usual())
    path = write(tmp_path, record(PROFILE, 5))
    before = path.read_bytes()

    def full(self, target):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(type(path), "replace", full)
    with pytest.raises(OSError, match="No space left"):
        write(tmp_path, record(PROFILE, 4))
    assert path.read_bytes() == before
    assert list(tmp_path.iterdir()) == [path]


def spoiled(**changes):
    baseline = baseline_of("lower")
    limit = baseline["estimators"]["loose-15"]["pos_rmse_h_m"]
    for key, value in changes.items():
        target = baseline if key in baseline else limit
        if value is None:
            del target[key]
        else:
            target[key] = value
    return json.dumps(baseline)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("{", "survey.json: not valid JSON"),
        ("[]", "survey.json: must hold one JSON object"),
        (spoiled(seed=None), "survey.json: seed is missing"),
        (spoiled(runs=1.5), "survey.json: runs = 1.5 must be a whole number"),
        (spoiled(mean="2"), "survey.json: [estimators.loose-15.pos_rmse_h_m]: mean = '2' must be a number"),
        (
            spoiled(mean=float("nan")),
            "[estimators.loose-15.pos_rmse_h_m]: mean = nan must be a finite number",
        ),
        (spoiled(tolerance=None), "[estimators.loose-15.pos_rmse_h_m]: tolerance is missing"),
        (
            spoiled(tolerance=-1.0),
            "[estimators.loose-15.pos_rmse_h_m]: tolerance = -1 must not be negative",
        ),
        (spoiled(direction="up"), "direction = 'up' must be 'lower', 'higher' or 'both'"),
        (spoiled(estimators={"loose-15": 3}), "loose-15 = 3 must be a table"),
        (
            spoiled(reason=None)[:-4] + ', "reasn": ""}}}}',
            "[estimators.loose-15.pos_rmse_h_m]: unknown key 'reasn'. Did you mean 'reason'?",
        ),
    ],
)
def test_a_malformed_baseline_says_where_and_what(bench_of, tmp_path, text, message):
    flown = bench_of(usual())
    (tmp_path / "survey.json").write_text(text)
    with pytest.raises(ConfigError) as raised:
        check(tmp_path)
    assert any(message in line for line in raised.value.messages), raised.value.messages
    assert flown == []


def test_baselines_that_are_not_there_are_named(bench_of, tmp_path):
    bench_of(usual())
    with pytest.raises(ConfigError, match="no baseline"):
        check(tmp_path / "nowhere")
    write(tmp_path, record(PROFILE, 5))
    with pytest.raises(ConfigError, match=r"no baseline 'survy'\. Did you mean 'survey'\?"):
        check(tmp_path, ["survy"])
    with pytest.raises(ConfigError, match="runs = 0 must be at least 1"):
        check(tmp_path, runs=0)
    with pytest.raises(ConfigError, match="no such file"):
        read(tmp_path / "absent.json")
