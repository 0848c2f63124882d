"""Finished results are compared run by run, whatever their order, and what differs is said."""

from __future__ import annotations

import json

import numpy as np
import pytest

import bench
from bench.cli.command_line import main
from bench.core.words.exceptions import ConfigError
from bench.evaluation.ensembles import ensemble
from bench.experiments.baselines import comparing
from bench.experiments.baselines.baseline_file import Baseline, EstimatorValues
from bench.experiments.baselines.comparing import Side
from bench.experiments.baselines.verdict_rows import BY_SEED
from tests.test_api import SHORT


def make_side(name, values, keys, truth="a", label="mine"):
    estimator = EstimatorValues(
        epochs=1000,
        expected={},
        converged=(True,) * len(values),
        metrics={"pos_rmse_h_m": tuple(values), "heading_rmse_deg": tuple(0.1 * np.array(values))},
    )
    draws = Baseline(
        profile="", requested=None, seed=0, versions={}, truth="flight", sensors=tuple(keys),
        estimators={label: estimator},
    )  # fmt: skip
    return Side(name, {"flight": draws}, {"flight": {"title": name}}, {"flight": truth})


@pytest.fixture
def draws():
    """Twenty draws with errors of many sizes, and the same made 10 % worse with 5 % scatter."""
    rng = np.random.default_rng(4)
    before = 10.0 * np.exp(rng.normal(0.0, 0.5, 20))
    return before, before * 1.1 * np.exp(rng.normal(0.0, 0.05, 20))


def test_runs_are_paired_by_seed_and_number(draws):
    before, after = draws
    keys = [f"seed 1, run {k}" for k in range(20)]
    turned = np.random.default_rng(5).permutation(20)
    other = make_side("other", after[turned], [keys[k] for k in turned])
    found = comparing.compare_sides(make_side("first", before, keys), other)
    assert {row.word for row in found.verdicts if row.metric != "converged"} == {"worse"}
    assert found.differences == ("runs: 20 and 20, 20 in both",)
    check_sentence(found, "other is worse")
    lost = make_side("other", after[turned], [f"seed 2, run {k}" for k in turned])
    unpaired = comparing.compare_sides(make_side("first", before, keys), lost)
    assert {row.word for row in unpaired.verdicts if row.metric != "converged"} == {"undecided"}
    assert "runs: 20 and 20, none in both" in unpaired.differences
    check_sentence(unpaired, "undecided")


def test_another_unit_is_paired_by_seed_and_it_is_said(draws):
    before, after = draws
    keys = [f"seed 1, run {k}" for k in range(20)]
    first, other = make_side("first", before, keys), make_side("other", after, keys)
    for side, unit in ((first, "stim300"), (other, "mpu-9250")):
        side.documents["flight"]["sensors"] = {"imu": unit, "assumed": {"imu": "stim300"}}
    found = comparing.compare_sides(first, other)
    assert {row.note for row in found.verdicts} == {BY_SEED}
    assert {row.word for row in found.verdicts if row.metric != "converged"} == {"worse"}
    assert found.differences == ("sensors.imu: stim300 and mpu-9250",)
    (sentence,) = found.sentences
    rare = "if no rare large run exists"
    assert sentence.endswith(f"by 20 pairs, {rare}, other sensor data, paired by seed")
    other.documents["flight"]["sensors"]["imu"] = "stim300"  # what the filter assumes is its own
    other.documents["flight"]["sensors"]["assumed"] = {"imu": "mpu-9250"}
    assert {row.note for row in comparing.compare_sides(first, other).verdicts} == {""}


def check_sentence(found, said):
    """The one sentence says what the row of the table says."""
    (row,) = (row for row in found.verdicts if row.metric == "pos_rmse_h_m")
    (sentence,) = found.sentences
    assert sentence.startswith("mine: horizontal error ")
    assert f": {said}, {row.format_change()} by 20 {'pairs' if row.paired else 'draws each'}" in sentence


def test_a_sentence_claims_no_more_than_its_row_among_many():
    """20 pairs 6 % apart: proven alone at 95 %, not among the 61 rows that the table holds at 99 %."""
    rng = np.random.default_rng(6)
    before = 10.0 * np.exp(rng.normal(0.0, 0.1, 20))
    ratio = rng.normal(0.0, 0.1, 20)
    ratio += 0.06 - ratio.mean()
    keys = [f"seed 1, run {k}" for k in range(20)]
    first, other = make_side("first", before, keys), make_side("other", before * np.exp(ratio), keys)
    for side, values in ((first, before), (other, before * np.exp(rng.normal(0.0, 0.5, 20)))):
        metrics = side.draws["flight"].estimators["mine"].metrics
        metrics |= {f"drift_{k}m_percent": tuple(values) for k in range(60)}
    alone, low, high = comparing.compare_sides(first, other), *find_interval(before, ratio)
    assert low * high > 0.0
    check_sentence(alone, "undecided")


def find_interval(before, ratio):
    """Return the 95 % interval of the difference of the pooled errors by itself."""
    found = ensemble.compare_rmse(("a", "b"), before, before * np.exp(ratio), "m")
    return found.difference.low, found.difference.high


def test_another_truth_gives_no_pairs(draws):
    before, after = draws
    keys = [f"seed 1, run {k}" for k in range(20)]
    found = comparing.compare_sides(
        make_side("first", before, keys), make_side("other", after, keys, truth="b")
    )
    assert not any(row.paired for row in found.verdicts)
    assert found.differences == ("truth: the same profile was flown differently",)


def test_a_single_estimator_of_each_is_compared_whatever_its_label(draws):
    before, after = draws
    keys = [f"seed 1, run {k}" for k in range(20)]
    first = make_side("first", before, keys, label="loose-15")
    found = comparing.compare_sides(first, make_side("other", after, keys, label="mine"))
    assert {row.estimator for row in found.verdicts} == {"loose-15, mine"}
    two = make_side("two", after, keys, label="mine")
    two.draws["flight"].estimators["third"] = two.draws["flight"].estimators["mine"]
    with pytest.raises(ConfigError, match="has no filter in common with first: mine, third and loose-15"):
        comparing.compare_sides(first, two)


@pytest.mark.parametrize("count", [1, 20])
def test_what_did_not_converge_is_told_with_the_reason(draws, count):
    before, after = (values[:count] for values in draws)
    keys = [f"seed 1, run {k}" for k in range(count)]
    other = make_side("other", after, keys)
    mine = other.draws["flight"].estimators["mine"]
    lost = {"converged": (*mine.converged[1:], False), "reasons": ("",) * (count - 1) + ("900 m off",)}
    other.draws["flight"].estimators["mine"] = mine.model_copy(update=lost)
    found = comparing.compare_sides(make_side("first", before, keys), other)
    assert found.sentences[-1] == f"mine: in other 1 of {count} runs diverged or failed, the first: 900 m off"
    notes = [row.note for row in found.verdicts if row.metric == "converged"]
    assert notes == ["lost in run 19, run 19: 900 m off"] * (count > 1)


def test_estimators_of_one_side_alone_are_named(draws):
    keys = [f"seed 1, run {k}" for k in range(20)]
    first, other = (
        make_side(name, values, keys) for name, values in zip(("first", "other"), draws, strict=True)
    )
    (own,) = other.draws["flight"].estimators
    other.draws["flight"].estimators["third"] = other.draws["flight"].estimators[own]
    assert "only in other: third" in comparing.compare_sides(first, other).differences
    assert "only in other: third" in comparing.compare_sides(other, first).differences


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    place = tmp_path_factory.mktemp("compared")
    for name, changes, options in (
        ("a", {}, {"estimators": ["loose-15", "gnss-only"]}),
        ("b", {}, {"estimators": ["loose-15"]}),
        ("c", {"sensors.imu": "stim300"}, {"estimators": ["loose-15"]}),
        ("d", {"start.alt_m": 900.0}, {"estimators": ["loose-15"]}),
    ):
        profile = bench.read_profile("figure-eight", {**SHORT, **changes}, seed=3, **options)
        bench.write_result(bench.run(profile), place / name, recording=False, report=False)
    return place


def test_folders_are_compared_and_laid_over_each_other(folder, monkeypatch, capsys):
    monkeypatch.chdir(folder)
    same, other, flown = bench.compare_results(["a", "b", "c", "d"])
    assert same.differences == ("only in a: gnss-only",)
    assert {row.word for row in same.verdicts} == {"same"}
    assert "sensors.imu: adis16475 and stim300" in other.differences
    assert {row.word for row in other.verdicts if row.metric.startswith("pos_rmse")} == {"undecided"}
    assert any("alt_m" in text for text in flown.differences)
    assert flown.differences[0] == "the flight: figures of different flights do not compare the filters"
    assert main(["compare", "a", "c", "-o", "both", "--json"]) == 0
    out, err = capsys.readouterr()
    (found,) = json.loads(out)
    assert found["other"] == "c"
    assert "loose-15: horizontal error" in err
    merged = bench.read_result("both")
    assert list(merged.metrics) == ["loose-15, a", "gnss-only, a", "loose-15, c"]
    assert np.array_equal(
        merged.solutions["loose-15, c"].lla, bench.read_result("c").solutions["loose-15"].lla
    )
    assert (folder / "both" / "flight.rrd").is_file()
    page = (folder / "both" / "report.html").read_text(encoding="utf-8")
    assert all(f"<li>{text}</li>" in page for text in (*other.sentences, *other.differences))
    assert main(["compare", "a", "d", "-o", "no"]) == 2
    assert "d: not drawn over a, it is of another flight or log" in capsys.readouterr().err
    assert not (folder / "no").exists()


def test_what_cannot_be_compared_is_said_in_a_line(folder, tmp_path, monkeypatch):
    monkeypatch.chdir(folder)
    with pytest.raises(ConfigError, match="at least two folders"):
        bench.compare_results(["a"])
    with pytest.raises(ConfigError, match="contains no results"):
        bench.compare_results(["a", tmp_path])
