"""Tuning finds the noise that is there, from runs or from withheld fixes, and evaluates it on other data."""

from __future__ import annotations

import json
import math
import re
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scipy.stats import multivariate_normal

import bench
from bench import pipeline
from bench.cli.command_line import main
from bench.core.files.places import PACKAGE
from bench.core.records.data import Innovations, no_innovations
from bench.core.records.run_records import ErrorSeries
from bench.core.records.specs import DEFAULT_GUARD
from bench.core.words.exceptions import ConfigError
from bench.evaluation.ensembles.ensemble import Estimate
from bench.experiments.campaigns.pools import ExecutorPool, ProcessPool, SerialExecutor
from bench.experiments.campaigns.worker import RunTask
from bench.experiments.tuning import noise_factors, trials
from bench.experiments.tuning.trials import HeldOutScore, LogTrial, ProfileTrial, measure_costs
from bench.io.config import read_profile
from bench.io.results import truth_key
from tests.campaigns import tune_power
from tests.campaigns.test_campaign import PROFILE

WRONG = 4.0  # times the noise of the receiver on board


class HerePool(ExecutorPool):
    def __init__(self, workers: int) -> None:
        super().__init__(SerialExecutor(), workers)


@pytest.fixture
def here(tmp_path, monkeypatch) -> Path:
    """A profile whose filter assumes a receiver that is far worse than the one on board."""
    text = (PACKAGE / "catalog" / "gnss" / "matched-white.toml").read_text()
    lines = []
    for line in text.splitlines():
        key, equals, value = line.partition(" = ")
        noise = equals and "white_sd" in key and not key.startswith('"')
        lines.append(f"{key} = {WRONG * float(value.partition('#')[0])}" if noise else line)
    (tmp_path / "poor.toml").write_text("\n".join(lines))
    profile = PROFILE.replace("l1-code", "matched-white").replace(
        "[evaluation]", '[sensors.assumed]\ngnss = "poor.toml"\n[evaluation]'
    )
    (tmp_path / "short.toml").write_text(profile)
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(noise_factors, "ProcessPool", HerePool)
    return tmp_path


def test_the_noise_of_the_receiver_is_found_and_written(here, capsys):
    names = ("gnss.gnss.pos_", "gnss.gnss.vel_")
    factors = [word for name in names for word in ("--factor", name)]
    assert main(["tune", "short.toml", "-e", "loose-15", "--runs", "8", "--json", *factors]) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["converged"]
    for name in names:
        low, high = found["intervals"][name]
        assert (low or 0.0) < 1 / WRONG < high < 1.0
    sensors = read_profile("short.toml", {"sensors.assumed.gnss": "tuned/gnss-tuned.toml"}).sensors
    for name, key in zip(names, ("pos_h_white_sd", "vel_white_sd"), strict=True):
        ratio = getattr(sensors.assumed.gnss, key) / getattr(sensors.gnss, key)
        assert ratio == pytest.approx(WRONG * found["factors"][name], rel=1e-4)


def test_before_and_after_are_on_other_draws(here):
    seen: list[Any] = []
    found = bench.tune(
        "short.toml",
        "loose-15",
        factors=["gnss.gnss."],
        runs=3,
        evaluations=8,
        progress=lambda now: seen.append((now.done, now.total, now.cost)),
    )
    assert found.evaluations == len(seen) == 8
    assert not found.converged
    assert found.intervals == {"gnss.gnss.": (None, None)}
    assert "NOT converged" in found.sentences[0]
    assert found.before.nees_ratio.value < found.after.nees_ratio.value  # it reported too little
    results = [bench.run("short.toml", run=k, estimators=["loose-15"]) for k in (3, 4, 5)]
    mean = sum(one.metrics["loose-15"]["pos_rmse_h_m"] ** 2 for one in results) / 3
    assert found.before.rmse_h_m.value == pytest.approx(math.sqrt(mean))
    assert any("times the datasheet" in text for text in found.sentences)


def test_a_state_that_is_missing_is_told_by_innovations_that_repeat(here):
    """A receiver whose error wanders: no white noise makes the innovations white, a state for it does."""
    options: Any = {"factors": ["gnss.gnss.pos_"], "runs": 8, "evaluations": 3}
    wandering = {"sensors.gnss": "l1-code", "sensors.assumed.gnss": "l1-code"}
    value, edge = {}, {}
    for label in ("loose-15", "loose-22"):
        found = bench.tune("short.toml", label, overrides=wandering, **options)
        value[label], edge[label] = found.after.repetition["gnss_position"]
        told = [text for text in found.sentences if text.startswith("innovations of gnss_position still")]
        assert bool(told) == (label == "loose-15")
    assert value["loose-15"] > 2 * edge["loose-15"]
    assert abs(value["loose-22"]) < edge["loose-22"]


@pytest.mark.parametrize(
    ("factor", "ends", "told"),
    [
        (100.0, (50.0, None), "the bound"),
        (0.0101, (None, 0.02), "the bound"),
        (60.0, (40.0, 90.0), "60 times the datasheet (40 to 90)"),
        (1.0, (None, 2.0), "do not bound it: at most 2 times"),
        (1.0, (0.5, None), "do not bound it: at least 0.5 times"),
        (1.0, (None, None), "do not bound it: any factor does"),
        (90.0, (40.0, 95.0), "90 times the datasheet (40 to 95)"),  # 0.977 of the log of the bound
        (92.0, (40.0, 95.0), "92 times the datasheet: the bound"),
    ],
)
def test_what_is_known_of_a_factor_is_told(factor, ends, told):
    one = Estimate(1.0, 0.9, 1.1)
    judged, name = HeldOutScore(one, one, {}), "imu.gyro.noise"
    found = noise_factors.Tuning(
        "x", "consistency", {name: factor}, {name: ends}, True, 3, 3, judged, judged, 9, {}
    )
    assert told in found.sentences[1]


def test_draws_that_are_lost_are_told(here):
    """A filter that converges in fewer runs is no better for those that it keeps."""
    one = Estimate(1.0, 0.9, 1.1)
    kept, lost = HeldOutScore(one, one, {}), HeldOutScore(one, one, {}, lost=3)
    ends = {"imu.gyro.noise": (0.9, 1.1)}
    found = noise_factors.Tuning(
        "x", "consistency", {"imu.gyro.noise": 1.0}, ends, True, 3, 3, kept, lost, 9, {}
    )
    assert found.sentences[-1] == "runs that did not converge, which are in neither figure: 0 before, 3 after"
    whole = noise_factors.Tuning(
        "x", "consistency", {"imu.gyro.noise": 1.0}, ends, True, 3, 3, kept, kept, 9, {}
    )
    assert not any("did not converge" in text for text in whole.sentences)


def test_the_draws_that_judge_count_those_they_lose(here, monkeypatch):
    good = {"converged": True, "pos_rmse_h_m": 3.0, "nees_mean": 4.5, "nees_states": 9.0}
    rows = [{"metrics": {**good, "converged": k not in (1, 4)}, "repetition": {}} for k in range(6)]
    trial = object.__new__(ProfileTrial)
    trial.label, trial._runs = "x", 6
    asked = []
    monkeypatch.setattr(
        trial,
        "_compute",
        lambda *given: asked.append(given[2]) or [{"estimators": {"x": row}} for row in rows],
    )
    found = trial.judge({})
    assert (found.lost, asked) == (2, [range(6, 12)])
    assert (found.rmse_h_m.value, found.nees_ratio.value) == pytest.approx((3.0, 0.5))
    monkeypatch.setattr(trial, "_compute", lambda *_: [{"estimators": {"x": row}} for row in rows[:2]])
    with pytest.raises(ConfigError, match="too few runs converged"):
        trial.judge({})


def test_the_cost_of_a_draw_is_the_log_score_of_its_errors(here):
    """By another library, epoch by epoch."""
    profile = read_profile("short.toml", estimators=["loose-15"])
    truth = bench.fly(profile)
    sensed = pipeline.sense(profile, truth, 2)
    solution = pipeline.navigate(profile.estimators[0], sensed.data, sensed.initial)
    errors, _ = pipeline.measure(profile, truth, solution)
    rows = np.flatnonzero(solution.t >= profile.evaluation.begin - 1e-6)
    by_hand = [
        -multivariate_normal(np.zeros(9), solution.cov[k], allow_singular=True).logpdf(
            np.concatenate([errors.pos_n[k], errors.vel_n[k], errors.phi_n[k]])
        )
        - 4.5 * np.log(2 * np.pi)
        for k in rows
    ]
    row = measure_costs(RunTask("2", truth_key(profile.flight), profile, 2, 1.0))
    assert row["consistency"] == pytest.approx(np.mean(by_hand), rel=1e-6)
    assert row["rmse"] == pytest.approx(np.square(errors.pos_n[rows, :2]).sum(axis=1).mean())


def test_a_filter_that_claims_nothing_cannot_be_tuned(here):
    with pytest.raises(ConfigError, match="reports no accuracy"):
        bench.tune("short.toml", "tests.campaigns.test_lost_draws:PositionsOnly", runs=2)


def test_a_log_is_tuned_on_its_first_half_and_judged_on_the_second(monkeypatch):
    """Ten segments of each half, from the begin of the evaluation: their sums by hand."""
    rng, t = np.random.default_rng(9), np.arange(211.0)
    pos_n, nees, z = rng.normal(size=(211, 3)), rng.chisquare(9, 211), rng.normal(size=211)
    none = np.zeros((211, 3))
    errors = ErrorSeries(t, pos_n, none, none, none[:, 0], nees, 9)
    rows = [(now, 0, 0, one, 2.0, 1.0, True) for now, one in zip(t, z, strict=True)]
    innovations = Innovations.from_rows(("baro",), rows)
    result = SimpleNamespace(
        metrics={"x": {}},
        profile={},
        errors={"x": errors},
        solutions={"x": SimpleNamespace(innovations=innovations)},
    )
    given = []
    log = SimpleNamespace(spec=SimpleNamespace(evaluation=SimpleNamespace(begin=10.0)))
    monkeypatch.setattr(
        trials.log_pipeline, "read_log", lambda source, **more: given.append((source, more)) or log
    )
    monkeypatch.setattr(trials.log_pipeline, "navigate", lambda _: result)
    monkeypatch.setattr(trials, "list_assumed", lambda _: {})
    trial = LogTrial("log.toml", "x", {"a": 1, "b": 2}, allow_code=True, guard=DEFAULT_GUARD)

    square = np.square(pos_n[:, :2]).sum(axis=1)
    score = 0.5 * (np.square(z) / 2.0 + np.log(2.0))
    parts = [slice(10, 21), *(slice(k + 1, k + 11) for k in range(20, 210, 10))]  # a sample each second
    for goal, values in (("rmse", square), ("consistency", score)):
        costs = trial.score({"b": 3}, goal)
        assert costs == pytest.approx([values[part].sum() * 10 / 101 for part in parts[:10]])
    same = {"estimators": ["x"], "allow_code": True, "guard": DEFAULT_GUARD}
    assert given[0] == ("log.toml", {"overrides": {"a": 1, "b": 2}, **same})
    assert given[1] == ("log.toml", {"overrides": {"a": 1, "b": 3}, **same})
    judged = trial.judge({})
    assert judged.rmse_h_m.value == pytest.approx(
        np.sqrt(np.mean([square[one].mean() for one in parts[10:]]))
    )
    assert judged.nees_ratio.value == pytest.approx(nees[111:211].mean() / 9)
    late = z[111:]
    assert judged.repetition["baro"][0] == pytest.approx(late[1:] @ late[:-1] / (late @ late))
    result.solutions["x"].innovations = no_innovations()
    with pytest.raises(ConfigError, match="--goal rmse tunes without them"):
        trial.score({}, "consistency")


def test_costs_of_rmse_are_relative_to_the_datasheets(here, monkeypatch):
    """The search begins at 1, whatever the meters of the flight are."""
    judged, seen = HeldOutScore(Estimate(1.0, 0.9, 1.1), Estimate(1.0, 0.9, 1.1), {}), list[float]()

    class Fake:
        label, beside, assumed = "x", here, {"gnss": "poor.toml"}

        def __init__(self, *_: Any) -> None: ...

        def score(self, figures: Any, goal: str) -> Any:
            size = sum(np.log(value) for value in figures.values())
            return np.array([49.0, 51.0]) * (1.0 + (size - first) ** 2)

        def judge(self, figures: Any) -> HeldOutScore:
            return judged

    text = (here / "poor.toml").read_text()
    white = [float(x) for x in re.findall(r"^pos_._white_sd_m = ([\d.]+)", text, re.MULTILINE)]
    first = sum(np.log(white))
    monkeypatch.setattr(noise_factors, "ProfileTrial", Fake)
    names = ["gnss.gnss.pos_h_white,gnss.gnss.pos_v_white"]
    bench.tune(
        "short.toml",
        "x",
        goal="rmse",
        factors=names,
        evaluations=3,
        progress=lambda now: seen.append(now.cost),
    )
    assert seen[:2] == pytest.approx([50.0, 1.0])
    seen.clear()
    bench.tune("short.toml", "x", factors=names, evaluations=3, progress=lambda now: seen.append(now.cost))
    assert seen[0] == pytest.approx(50.0)
    workers: list[int] = []
    monkeypatch.setattr(noise_factors, "ProcessPool", lambda count: workers.append(count) or HerePool(count))
    for jobs in (3, None):
        bench.tune("short.toml", "x", factors=names, evaluations=1, jobs=jobs)
    assert workers == [3, noise_factors.count_processors()]


def test_draws_cost_the_same_in_processes_of_their_own(here, monkeypatch):
    names = ["gnss.gnss.pos_h_white,gnss.gnss.pos_v_white"]

    def tune():
        return bench.tune("short.toml", "loose-15", factors=names, runs=2, evaluations=1, jobs=1)

    expected = tune()
    monkeypatch.setattr(noise_factors, "ProcessPool", ProcessPool)
    found = tune()
    assert (found.factors, found.before, found.after) == (expected.factors, expected.before, expected.after)


@pytest.mark.slow
def test_four_wrong_values_are_found_again(tmp_path, monkeypatch):
    """Eight runs whose filter is right but for four noises; they hardly show that of the accelerometers."""
    monkeypatch.setattr(noise_factors, "ProcessPool", HerePool)
    wrong = tune_power.WRONG
    given = {**tune_power.FLIGHT, **tune_power.write_wrong(tmp_path)}
    found = bench.tune("figure-eight-matched", "loose-15", runs=8, seed=31_057, overrides=given)
    assert found.converged
    assert found.agreed == found.starts == 3
    for name, (start, factor) in zip(found.factors, wrong.items(), strict=True):
        assert start in name
        low, high = found.intervals[name]
        if start == "accel":
            assert low is None  # none at all would do
            assert "do not bound it: at most" in " ".join(found.sentences)
            assert high is not None
            assert 1.0 < high * factor < 6.0
        else:
            assert found.factors[name] * factor == pytest.approx(1.0, abs=0.2)
            assert low is not None
            assert high is not None
            assert low * factor < 1.0 < high * factor
    assert 0.8 < found.after.nees_ratio.value < 1.25


@pytest.mark.long
def test_intervals_hold_the_right_noises_on_flights():
    """100 tunings, each on runs of its own; the accelerometers' noise does not show.

    95 % of the intervals are to hold: 88 to 99 of 100 are its band of 99.2 %. Noises that show are found
    nearer than the one that does not, whose interval mostly has no lower end.
    """
    rows = list(tune_power.repeat(100))
    assert all(row.converged for row in rows)
    counts = tune_power.count(rows)
    assert all(88 <= held <= 99 for held, *_ in counts.values())
    assert all(counts[noise][1] > counts["accel"][1] for noise in ("gyro", "pos", "vel"))
    assert counts["accel"][2] > len(rows) / 2
    told = [" ".join(row.sentences) for row in rows if row.intervals["accel"][0] is None]
    assert all("imu.accel.noise" in text and "these data do not bound it: at most" in text for text in told)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"factors": ["imu.gyro.nose"]}, "no assumed figure begins with"),
        (
            {"overrides": {"sensors.assumed.imu.gyro.noise_deg_sqrt_h": 1.0}},
            "starts from datasheets in files",
        ),
    ],
)
def test_a_wrong_request_is_refused(here, options, message):
    with pytest.raises(ConfigError, match=message):
        bench.tune("short.toml", "loose-15", **options)


@pytest.mark.parametrize(
    ("value", "cost"),
    [(2.5, 2.5), (-3.0, -3.0), (0.9e6, 0.9e6), (1.5e6, 1e6), (np.nan, 1e6), (np.inf, 1e6), (-np.inf, 1e6)],
)
def test_what_is_lost_costs_most(value, cost):
    assert trials.limit_cost(value) == cost


def make_tuning(**changes: Any) -> noise_factors.Tuning:
    one, other = Estimate(2.0, 1.5, 2.5), Estimate(1.0, 0.9, 1.1)
    given: dict[str, Any] = {
        "label": "x", "goal": "consistency", "factors": {}, "intervals": {}, "converged": True, "starts": 3,
        "agreed": 3, "before": HeldOutScore(one, one, {}), "after": HeldOutScore(other, other, {}),
        "evaluations": 9, "datasheets": {},
    }  # fmt: skip
    return noise_factors.Tuning(**{**given, **changes})


def test_a_search_and_what_it_changes_are_told():
    told = make_tuning().sentences
    assert told == (
        "converged after 9 sets of factors; 3 of 3 starts came to the same cost",
        "NEES over its expectation, on data not used for tuning: 2 (1.5 to 2.5) before, 1 (0.9 to 1.1) after"
        ", if no rare large run exists",
        "horizontal RMSE [m], on data not used for tuning: 2 (1.5 to 2.5) before, 1 (0.9 to 1.1) after, "
        "if no rare large run exists",
    )
    assert (
        make_tuning(agreed=2)
        .sentences[0]
        .endswith("2 of 3 starts came to the same cost, the best of them is given")
    )
    lost = make_tuning()
    lost = make_tuning(before=HeldOutScore(lost.before.rmse_h_m, lost.before.nees_ratio, {}, lost=2))
    assert lost.sentences[-1] == "runs that did not converge, which are in neither figure: 2 before, 0 after"


@pytest.mark.parametrize(
    ("value", "band", "told"),
    [(0.15, 0.05, True), (-0.15, 0.05, True), (0.08, 0.05, False), (0.15, 0.2, False)],
)
def test_innovations_that_repeat_by_more_than_a_tenth_are_told(value, band, told):
    one = Estimate(1.0, 0.9, 1.1)
    last = make_tuning(after=HeldOutScore(one, one, {"baro": (value, band)})).sentences[-1]
    text = "innovations of baro still repeat from one update to the next: correlation"
    assert last.startswith(f"{text} {value:.2f}, within {band:.2f} is right; ") == told


def test_figures_are_grouped_by_how_they_begin():
    known = {
        "imu.gyro.noise_x": 1.0,
        "imu.accel.noise_x": 2.0,
        "gnss.gnss.pos_h_white_sd": 3.0,
        "baro.baro.noise": 4.0,
    }
    found = noise_factors.group_figures(known, None)
    assert found == {
        "imu.gyro.noise": ["imu.gyro.noise_x"],
        "imu.accel.noise": ["imu.accel.noise_x"],
        "gnss.gnss.pos_h_white,gnss.gnss.pos_v_white": ["gnss.gnss.pos_h_white_sd"],
    }
    two = noise_factors.group_figures(known, ["imu.gyro,baro"])
    assert two == {"imu.gyro,baro": ["imu.gyro.noise_x", "baro.baro.noise"]}
    assert noise_factors.scale(two, known, np.array([3.0])) == {
        "imu.gyro.noise_x": 3.0,
        "baro.baro.noise": 12.0,
    }
    with pytest.raises(ConfigError, match=r"no assumed figure begins with 'imu\.gyra'"):
        noise_factors.group_figures(known, ["imu.gyro", "imu.gyra"])
    with pytest.raises(ConfigError, match="have no noise parameter to tune"):
        noise_factors.group_figures({"baro.baro.noise": 4.0}, None)


def test_figures_above_zero_of_the_assumed_datasheets_are_known(tmp_path):
    (tmp_path / "own.toml").write_text(
        "name = 'x'\nlevel = 3.0\n[gnss]\na = 2\nb = 0.0\nc = -1.0\nd = 'text'\n"
    )
    trial: Any = SimpleNamespace(assumed={"gnss": "own.toml"}, beside=tmp_path, label="x")
    assert noise_factors.read_figures(trial) == {"gnss.gnss.a": 2.0}
    texts = noise_factors.write_datasheets(trial, {"gnss.gnss.a": 2.5})
    assert texts["gnss"].splitlines() == [
        "# own.toml, its noise tuned for x by bench tune.", "name = 'x'", "level = 3.0", "[gnss]", "a = 2.5",
        "b = 0.0", "c = -1.0", "d = 'text'",
    ]  # fmt: skip
