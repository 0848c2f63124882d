"""A swept value: what is linear in it is."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy import stats

import bench
from bench.core.files.places import PACKAGE
from bench.core.words.exceptions import ConfigError
from bench.experiments.studies import sensitivity
from bench.experiments.studies.sensitivity import Options, Swept, compare_ends, find_values
from bench.experiments.studies.study import read_options

METRIC = "pos_rmse_h_m"


def test_the_drift_of_a_free_ins_at_rest_is_linear_in_the_bias_of_its_gyros(tmp_path):
    """A-2.4.7, the same runs: twice the bias makes twice the error, but for what the rest of it makes."""
    text = (PACKAGE / "profiles" / "static.toml").read_text().replace("rate_hz  = 200", "rate_hz = 100")
    short = tmp_path / "rest.toml"
    short.write_text(text.replace("duration_s = 600.0", "duration_s = 150.0"))
    key = "sensors.imu.gyro.turn_on_bias_sd_deg_h"
    asked = {"key": key, "values": "300,600", "estimators": "free-inertial", "runs": 2}
    result = bench.study("sensitivity", profiles=str(short), jobs=1, **asked)
    table = result.tables["sensitivity"].columns
    error = [v for v, name in zip(table["value"], table["metric"], strict=True) if name == "pos_rmse_h_m"]
    assert error[1] / error[0] == pytest.approx(2.0, rel=0.1)
    given = "--values 300,600 --estimators free-inertial --runs 2"
    assert result.command == f"bench study sensitivity {short} {key} {given}"
    assert result.figures["pos_rmse_h_m"].across == "deg/h"


def ask(law, **more):
    """Return the findings on made runs, whose error is a law of value and draw, and what was flown."""
    flown = []

    def campaign(what, spec, first):
        flown.append((first, spec.runs))
        rows = [
            {"estimator": "mine", "condition": k, "run": run, "converged": bool(np.isfinite(error)),
             METRIC: error, "heading_rmse_deg": 2.0 * error}
            for k, given in enumerate(spec.varied)
            for run in range(first, spec.runs)
            for error in [law(given["rate_hz"], run)]
        ]  # fmt: skip
        return SimpleNamespace(runs=SimpleNamespace(to_pylist=lambda: rows))

    options = Options(profiles="s-turns", key="rate_hz", values="1,2", runs=4, max_runs=9, **more)
    return sensitivity.ask_profile(options, SimpleNamespace(campaign=campaign)), flown


def test_draws_are_added_until_the_ends_are_told_apart():
    """By hand: twice the error on every run is decided at once; what is alike by noise never is."""
    noise = np.random.default_rng(1).uniform(1.0, 3.0, (3, 9))
    found, flown = ask(lambda value, run: value * noise[0, run])
    assert flown == [(0, 4)]
    assert (found.good, found.runs) == (True, 4)
    assert (
        "on the same runs 1 over 2 0.5 (0.5 to 0.5, if no rare large run exists): better" in found.verdicts[0]
    )
    rms = [np.sqrt(np.mean(np.square(value * noise[0, :4]))) for value in (1.0, 2.0)]
    assert f"mine: {METRIC} from {rms[0]:.3g} (" in found.verdicts[0]
    assert f"at 1 Hz to {rms[1]:.3g} (" in found.verdicts[0]
    assert_allclose(found.figures[0].series[0].values[:, 0], rms)
    found, flown = ask(lambda value, run: noise[int(value), run])
    assert flown == [(0, 4), (4, 8), (8, 9)]
    assert found.runs == 9
    found, _ = ask(lambda value, run: np.nan if (value, run) == (2, 3) else value * noise[0, run])
    assert not found.good


def test_the_values_are_around_the_own_one_unless_given():
    def values(key, **more):
        return find_values(read_options("sensitivity", Options, {"profiles": "s-turns", "key": key, **more}))

    assert values("sensors.gnss.rate_hz") == [0.25, 0.5, 1.0, 2.0, 4.0]
    assert values("leg.1.duration_s", values="1,2") == [1, 2]
    assert values("sensors.imu", values="stim300,vn-100") == ["stim300", "vn-100"]
    with pytest.raises(ConfigError, match="no number of its own in s-turns; give --values"):
        values("aircraft")


def test_the_best_of_many_values_is_no_better_for_being_chosen():
    """Ten values that are alike: the best and the worst of them are told apart as rarely as is said."""
    rng, wrong, flights = np.random.default_rng(1), 0, 400
    for errors in np.sqrt(rng.chisquare(4.0, (flights, 10, 12))):
        swept = [
            Swept(value, tuple({"run": k, "converged": True, METRIC: one} for k, one in enumerate(row)))
            for value, row in enumerate(errors)
        ]
        pair = compare_ends(swept, METRIC, 0.05)
        assert pair is not None
        wrong += pair.word == "better"
    assert wrong <= stats.binom.ppf(0.999, flights, 0.05)


def test_the_ends_of_three_values_have_a_third_of_the_error_each():
    errors = np.array([[1.0, 1.2, 0.9, 1.1], [1.5, 1.4, 1.7, 1.6], [2.0, 2.5, 1.8, 2.3]])
    swept = [
        Swept(value, tuple({"run": k, "converged": True, METRIC: one} for k, one in enumerate(row)))
        for value, row in enumerate(errors)
    ]
    pair, alone = compare_ends(swept, METRIC, 0.03), compare_ends(swept[::2], METRIC, 0.01)
    assert pair == alone
    assert (pair.first, pair.second) == ("0", "2")
    table = sensitivity.tabulate_sweep(
        Options(profiles="s-turns", key="sensors.gnss.rate_hz"), {"mine": swept}
    ).columns
    assert list(table) == ["estimator", "rate_hz", "metric", "value", "low", "high", "runs", "lost"]
    assert table["value"][0] == pytest.approx(np.sqrt(np.mean(errors[0] ** 2)))
