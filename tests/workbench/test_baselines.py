"""What ``bench check`` says of values that are made up here: same, better, worse or undecided.

What is flown is the business of the pipeline's tests; that the statistics hold what they promise is shown in
tests/evaluation/test_regression.py.
"""

import io
import json
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from xml.etree import ElementTree

import numpy as np
import pytest
from rich.console import Console

from bench import pipeline
from bench.cli.verbs.check_verb import print_verdicts
from bench.core.mathematics.random_streams import stream
from bench.core.records.data import ImuData
from bench.core.records.specs import DEFAULT_GUARD, EvaluationWindow, Guard
from bench.core.words.exceptions import ConfigError
from bench.evaluation.metrics.run_metrics import METRICS
from bench.experiments.baselines import baseline_draws, checking
from bench.experiments.baselines.annotations import annotate
from bench.experiments.baselines.baseline_draws import Draw, EstimatorDraw
from bench.experiments.baselines.baseline_file import CPU, read_baseline
from bench.experiments.baselines.checking import check, record_baselines
from bench.experiments.baselines.digests import digest_record
from bench.experiments.baselines.junit import write_junit
from bench.experiments.baselines.verdict_rows import BY_SEED, OTHER_TRUTH, UNPAIRED, Verdict
from bench.experiments.campaigns.batches import Lost
from bench.navigation.built_in import load
from bench.navigation.models.loose_tight import Loose
from tests.cli import test_cli


def usual(k, scale=1.0, scatter=0.0, nees=9.0):
    """The metrics of run k: an RMSE about 2 m that differs by 30 % between runs."""
    noise = stream(1, k, "test").normal(size=4)
    rmse = 2.0 * np.exp(0.3 * noise[0]) * scale * np.exp(scatter * noise[1])
    return {
        "pos_rmse_h_m": float(rmse),
        "nees_mean": float(nees * np.exp(0.2 * noise[2])),
        "coverage_3sigma_pos_n": 0.99,
    }


@pytest.fixture
def measure(monkeypatch):
    """Replace flights by made-up metrics of run k; return the runs that were measured."""
    measured = []

    def install(
        metrics_of=usual,
        sensors=str,
        converged=lambda k: True,
        labels=("loose-15",),
        reason="lost",
        seed=7,
        truth="truth",
    ):
        class Made:
            draws, truth_digest, prepare = None, truth, list

            def __init__(self, source):
                self.source, self.name, self.labels, self.seed = source, Path(source).stem, labels, seed

            def measure(self, k):
                measured.append((self.name, k))
                row = EstimatorDraw(converged(k), reason, metrics_of(k), {"nees_mean": 9.0}, 500)
                return Draw(sensors(k), dict.fromkeys(labels, row))

        monkeypatch.setattr(checking, "open_experiment", lambda source, *_: Made(source))
        measured.clear()
        return measured

    return install


def words(verdicts):
    return {row.metric: row.word for row in verdicts}


@pytest.fixture
def recorded(measure, tmp_path):
    """The folder of a baseline of 80 runs of `usual`."""
    measure()
    record_baselines(["survey.toml"], directory=tmp_path)
    return tmp_path


# --- what is said ---------------------------------------------------------------------------------------


def test_unchanged_code_is_the_same_and_flies_twenty_draws(recorded, measure):
    measured = measure()
    verdicts = check(directory=recorded)
    assert set(words(verdicts).values()) == {"same"}
    assert set(words(verdicts)) == {"converged", "pos_rmse_h_m", "nees_mean", "coverage_3sigma_pos_n"}
    assert measured == [("survey", k) for k in range(20)]


def test_another_processor_is_the_same_even_without_a_tolerance(recorded, measure):
    path = recorded / "survey.json"
    path.write_text(path.read_text().replace('"tolerance": 0.02', '"tolerance": 0'))
    measure(lambda k: {**usual(k, 1 + 5e-7), "coverage_3sigma_pos_n": 0.99 - 1 / 500})
    assert set(words(check(directory=recorded)).values()) == {"same"}


@pytest.mark.parametrize(
    ("change", "word"),
    [
        ({"scale": 1.10, "scatter": 0.05}, "worse"),
        ({"scale": 0.90, "scatter": 0.05}, "better"),
        ({"scale": 1.01}, "same"),  # within 2 %
        ({"scale": 1.03}, "worse"),  # on every run: nothing else explains it
    ],
)
def test_a_change_has_its_word(recorded, measure, change, word):
    measure(lambda k: usual(k, **change))
    (row,) = (row for row in check(directory=recorded) if row.metric == "pos_rmse_h_m")
    assert row.word == word
    assert row.paired
    if word != "same":
        assert row.low <= row.change <= row.high
        assert row.low * row.high > 0
        assert row.sentence.startswith(f"{word}: loose-15 on survey, pos_rmse_h_m 2.")


def test_what_stays_undecided_has_doubled_its_draws_and_does_not_fail(recorded, measure):
    measured = measure(lambda k: usual(k, 1.08, 0.6))
    verdicts = check(directory=recorded)
    assert words(verdicts)["pos_rmse_h_m"] == "undecided"
    assert measured == [("survey", k) for k in range(80)]
    assert {row.metric: row.draws for row in verdicts}["nees_mean"] == 20  # decided at the first look


def test_doubling_ends_with_the_draws_of_the_baseline(measure, tmp_path):
    measure()
    record_baselines(["survey.toml"], directory=tmp_path, runs=20)
    measured = measure(lambda k: usual(k, 1.08, 0.6))
    assert words(check(directory=tmp_path))["pos_rmse_h_m"] == "undecided"
    assert len(measured) == 20


@pytest.mark.parametrize(("nees", "word"), [(12.0, "worse"), (6.75, "worse"), (9.0, "same")])
def test_nees_is_worse_if_it_leaves_its_expectation_either_way(recorded, measure, nees, word):
    measure(lambda k: usual(k, nees=nees))
    assert words(check(directory=recorded))["nees_mean"] == word


def test_nees_that_comes_nearer_is_better(measure, tmp_path):
    measure(lambda k: usual(k, nees=30.0))
    record_baselines(["survey.toml"], directory=tmp_path)
    measure(lambda k: usual(k, nees=20.0))
    assert words(check(directory=tmp_path))["nees_mean"] == "better"


def test_a_new_divergence_on_the_same_draw_is_worse_and_named(recorded, measure):
    measure(converged=lambda k: k not in (13, 15), reason="failed: run() raised ValueError")
    verdicts = check(directory=recorded)
    assert words(verdicts) == {**dict.fromkeys(words(verdicts), "same"), "converged": "worse"}
    (row,) = (row for row in verdicts if row.word == "worse")
    assert row.note == "lost in run 13, 15, run 13: failed: run() raised ValueError"
    assert (row.old, row.new) == (1.0, 0.9)


def test_a_draw_that_ends_its_process_is_lost_and_the_others_count(recorded, measure, monkeypatch):
    def compute(function, draws, pool, first):
        yield from ((j, Lost("ended by SIGSEGV") if k == 3 else function(k)) for j, k in enumerate(draws))

    measured = measure()
    monkeypatch.setattr(checking, "compute", compute)
    verdicts = check(directory=recorded)
    assert len(measured) == 19
    assert words(verdicts) == {**dict.fromkeys(words(verdicts), "same"), "converged": "worse"}
    (row,) = (row for row in verdicts if row.word == "worse")
    assert (row.draws, row.note) == (20, "lost in run 3, run 3: ended by SIGSEGV")


class FailsAtTimes(Loose):
    """Raises in some runs of the noise."""

    def run(self, sensors, initial):
        if fails_in_draw(sensors.imu.dtheta_b[0, 0]):
            raise ValueError("unlucky")
        return super().run(sensors, initial)


def fails_in_draw(rate):
    return round(1e12 * abs(rate)) % 2 == 0


def every_metric(k, worse=0.0):
    """A value of each metric in run k; ``worse`` moves it away from what it should be."""
    found = {}
    for metric, noise in zip(METRICS, stream(1, k, "every").normal(size=len(METRICS)), strict=True):
        name = metric.name.format("1")
        value = np.exp(0.3 * noise + worse)
        if metric.direction == "matched":
            value = {"nees": 9.0 * value, "nis_": 3.0 * value, "faul": 1.0}.get(name[:4], 0.9 - worse)
        found[name] = float(value)
    return found


def test_every_metric_is_judged_or_said_not_to_be(measure, tmp_path):
    judged = [m.name.format("1") for m in METRICS if m.direction != "not evaluated"]
    watched = {name for name in every_metric(0) if baseline_draws.is_watched(name)}
    assert watched == set(judged)
    measure(lambda k: {name: every_metric(k)[name] for name in judged})
    record_baselines(["survey.toml"], directory=tmp_path)
    measure(lambda k: {name: every_metric(k, worse=0.1)[name] for name in judged})
    found = words(check(directory=tmp_path))
    assert found == {"converged": "same", **dict.fromkeys(judged, "worse"), "fault_1_detected": "same"}


def test_an_offset_in_time_that_is_gone_is_better_and_a_new_one_worse(measure, tmp_path):
    measure(lambda k: {"time_offset_ms": 5.0 + 0.1 * k if k % 2 else None})
    record_baselines(["survey.toml"], directory=tmp_path)
    for values, word in (((0.0, None), "better"), ((5.0, 5.0), "worse")):
        measure(lambda k, values=values: {"time_offset_ms": values[k % 2] and values[k % 2] + 0.1 * k})
        assert words(check(directory=tmp_path))["time_offset_ms"] == word


def test_a_draw_in_which_the_filter_raises_counts_and_the_others_are_flown(tmp_path, monkeypatch):
    (tmp_path / "short.toml").write_text(test_cli.PROFILE)
    here = Guard(in_process=True)
    flight = baseline_draws.FlightDraws(
        str(tmp_path / "short.toml"), [f"{__name__}:FailsAtTimes"], False, here
    )
    flight.prepare()
    rows = [flight.measure(k).estimators["FailsAtTimes"] for k in range(6)]
    failed = [not row.converged for row in rows]
    assert set(failed) == {True, False}
    for row in rows:
        assert (row.reason == "failed: run() raised ValueError: unlucky") == (not row.converged)
        assert any(value is not None for value in row.metrics.values()) == row.converged
    monkeypatch.setattr(pipeline, "sense", lambda *_: 1 / 0)
    assert flight.measure(0) == baseline_draws.lose_draw(flight, "ZeroDivisionError('division by zero')")
    whole = baseline_draws.make_baseline(flight, [Draw("", {"x": row}) for row in rows], None).estimators["x"]
    assert whole.converged == tuple(not one for one in failed)
    assert whole.expected["nees_mean"] == 9.0


def test_an_estimator_that_fails_in_every_draw_has_no_baseline(measure, tmp_path):
    measure(lambda k: {"pos_rmse_h_m": None}, converged=lambda k: False, reason="failed: no such thing")
    message = "survey: loose-15 has no value in 80 runs, nothing to compare with; run 0: failed: no such"
    with pytest.raises(ConfigError, match=message):
        record_baselines(["survey.toml"], directory=tmp_path)
    assert not list(tmp_path.iterdir())


def test_a_metric_that_is_lost_is_worse(recorded, measure):
    measure(lambda k: usual(k) | ({"nees_mean": None} if k == 4 else {}))
    (row,) = (row for row in check(directory=recorded) if row.metric == "nees_mean")
    assert (row.word, row.note) == ("worse", "no value in run 4")


def test_an_estimator_that_is_gone_is_worse(recorded, measure):
    measure(labels=("other",))
    (row,) = check(directory=recorded)
    assert (row.word, row.note) == ("worse", "the profile has no such filter")


def with_fault(k, noticed, delay=3.0):
    return {
        "fault_1_detected": float(noticed),
        "fault_1_delay_s": delay if noticed else None,
        "pos_rmse_h_m": 2.0,
    }


def test_faults_are_counts_and_their_delay_counts_where_both_noticed_them(measure, tmp_path):
    measure(lambda k: with_fault(k, k != 0))
    record_baselines(["survey.toml"], directory=tmp_path)
    measure(lambda k: with_fault(k, k != 5))
    verdicts = {row.metric: row for row in check(directory=tmp_path, runs=40)}
    assert verdicts["fault_1_detected"].note == "lost in run 5, gained in run 0"
    assert verdicts["fault_1_detected"].word == "same"  # as many as before
    assert verdicts["fault_1_delay_s"].draws == 38
    assert verdicts["fault_1_delay_s"].word == "same"
    measure(lambda k: with_fault(k, False))
    verdicts = {row.metric: row for row in check(directory=tmp_path)}
    assert verdicts["fault_1_detected"].word == "worse"
    assert "fault_1_delay_s" not in verdicts


def test_other_draws_are_compared_unpaired_and_it_is_said(recorded, measure):
    measure(lambda k: usual(k + 1000), sensors=lambda k: f"other {k}", seed=8)
    rows = {row.metric: row for row in check(directory=recorded)}
    assert not any(row.paired for row in rows.values())
    assert rows["pos_rmse_h_m"].note == UNPAIRED
    assert rows["pos_rmse_h_m"].word in ("same", "undecided")
    measure(lambda k: usual(k + 1000, 3.0), sensors=lambda k: f"other {k}", seed=8)
    assert words(check(directory=recorded))["pos_rmse_h_m"] == "worse"


def test_a_flight_that_moved_is_said_loudly_where_every_figure_is_the_same(recorded, measure):
    measure(truth="moved")
    rows = check(directory=recorded)
    assert {row.word for row in rows} == {"same"}
    assert {(row.paired, row.note) for row in rows} == {(False, OTHER_TRUTH)}
    console = Console(width=80, record=True, file=io.StringIO())
    print_verdicts(console, rows)
    assert "survey: the flight differs from the baseline" in console.export_text().replace("\n", " ")
    (line,) = annotate(rows, Path("base"), {"GITHUB_ACTIONS": "true"})
    assert line.startswith(
        "::warning file=base/survey.json,title=survey%3A another flight::survey: the flight"
    )


def test_other_draws_of_which_one_broke_are_compared_all_the_same(recorded, measure):
    """Before and after there are different numbers of values, and no pairs."""
    measure(lambda k: usual(k, 3.0), sensors=lambda k: f"other {k}", converged=lambda k: k != 3, seed=8)
    rows = {row.metric: row for row in check(directory=recorded)}
    assert not any(row.paired for row in rows.values())
    assert (rows["pos_rmse_h_m"].word, rows["pos_rmse_h_m"].draws) == ("worse", 19)
    assert rows["nees_mean"].word in ("same", "undecided")


def test_what_is_not_paired_or_needs_more_draws_is_said_once(measure, tmp_path):
    measure()
    record_baselines(["survey.toml"], directory=tmp_path, runs=20)
    measure(lambda k: usual(k + 1000, 1.2), sensors=lambda k: f"other {k}", seed=8)
    console = Console(width=80, record=True, file=io.StringIO())
    print_verdicts(console, check(directory=tmp_path))
    text = console.export_text().replace("\n", " ")
    assert f"(20 runs; {UNPAIRED})" in text
    assert text.count("not paired") == 1
    assert "Baselines of 80 runs would decide more" in text


def test_a_changed_unit_is_paired_by_seed_and_it_is_said(recorded, measure):
    """Draws that differ by 30 % hide a change of 5 % from all tests but those of pairs."""
    measure(lambda k: usual(k, 1.05, 0.02), sensors=lambda k: f"noisier {k}")
    rows = {row.metric: row for row in check(directory=recorded)}
    assert {(row.paired, row.note) for row in rows.values()} == {(True, BY_SEED)}
    assert rows["pos_rmse_h_m"].word == "worse"
    assert rows["pos_rmse_h_m"].high - rows["pos_rmse_h_m"].low < 0.1
    console = Console(width=80, record=True, file=io.StringIO())
    print_verdicts(console, list(rows.values()))
    assert console.export_text().count("paired by seed") == 2  # of all, and in the sentence
    measure(lambda k: usual(k, 1.05, 0.02), sensors=lambda k: f"noisier {k}", seed=8)
    other = {row.metric: row for row in check(directory=recorded)}["pos_rmse_h_m"]
    assert other.word == "undecided"
    assert other.high - other.low > 0.3


def test_a_divergence_of_another_unit_is_a_count(recorded, measure):
    """On other noise a run that diverges proves nothing by itself."""
    measure(sensors=lambda k: f"noisier {k}", converged=lambda k: k != 3)
    rows = {row.metric: row for row in check(directory=recorded)}
    assert rows["converged"].word == "undecided"
    assert "lost in run 3" in rows["converged"].note


def test_values_that_are_set_are_kept_with_the_baseline(measure, tmp_path, monkeypatch):
    measure()
    made, given = checking.open_experiment, []
    monkeypatch.setattr(
        checking, "open_experiment", lambda *all_of: (given.append(all_of[4]), made(all_of[0]))[1]
    )
    record_baselines(["survey.toml"], directory=tmp_path, overrides={"sensors.imu": "stim300"})
    check(directory=tmp_path)
    check(directory=tmp_path, overrides={"sensors.gnss": "l1-code", "sensors.imu": "mpu-9250"})
    record_baselines(directory=tmp_path)
    stim = {"sensors.imu": "stim300"}
    assert given == [stim, stim, {"sensors.gnss": "l1-code", "sensors.imu": "mpu-9250"}, stim]
    assert read_baseline(tmp_path / "survey.json").overrides == stim


@pytest.mark.parametrize(("factor", "word"), [(1.15, "same"), (1.6, "worse"), (0.5, "better")])
def test_cpu_time_is_judged_with_a_tolerance_of_its_own(measure, tmp_path, factor, word):
    """It may miss in the first run of each process; a busy machine is no loss."""

    def timed(k, factor=1.0, first=0):
        return {**usual(k), CPU: None if k == first else 5.0 * factor * (1 + 0.1 * (k % 3))}

    measure(timed)
    record_baselines(["survey.toml"], directory=tmp_path)
    measure(lambda k: timed(k, factor, 7))
    assert words(check(directory=tmp_path))[CPU] == word


def test_the_cpu_time_of_a_filter_is_in_units_of_the_strapdown(tmp_path, monkeypatch):
    """One that works twice takes twice as long, whatever the machine."""
    (tmp_path / "short.toml").write_text(test_cli.PROFILE)
    monkeypatch.chdir(tmp_path)
    here = Guard(in_process=True)
    uses = [f"{__name__}:{name}" for name in ("WorksOnce", "WorksTwice")]
    flight = baseline_draws.FlightDraws("short.toml", uses, True, here, cpu=True)
    flight.prepare()
    draws = [flight.measure(k) for k in range(6)]
    values = [[draw.estimators[label].metrics[CPU] for draw in draws] for label in flight.labels]
    assert [row[0] for row in values] == [None, None]
    once, twice = (min(row[1:]) for row in values)
    assert once > 1.0
    assert 1.3 < twice / once < 3.0  # a busy machine shares its caches


class WorksOnce:
    times = 1

    def run(self, sensors, initial):
        for _ in range(self.times):
            found = load("loose-15", {}).run(sensors, initial)
        return found


class WorksTwice(WorksOnce):
    times = 2


def test_a_few_other_draws_are_left_out_of_the_pairs(recorded, measure):
    measure(sensors=lambda k: "other" if k == 3 else str(k))
    rows = check(directory=recorded)
    assert {(row.paired, row.draws, row.word) for row in rows} == {(True, 19, "same")}


# --- files ----------------------------------------------------------------------------------------------


def test_a_profile_has_one_name_and_is_found_from_any_folder(measure, tmp_path, monkeypatch):
    measure()
    monkeypatch.chdir(tmp_path)
    (path,) = record_baselines(["flights/survey.toml"], directory="limits", runs=20)
    assert str(path) == "limits/survey.json"
    assert json.loads(path.read_text())["profile"] == "../flights/survey.toml"
    for name in ("survey", "survey.toml", "flights/survey.toml"):
        assert check([name], directory="limits")[0].profile == "survey"
    (tmp_path / "elsewhere").mkdir()
    monkeypatch.chdir(tmp_path / "elsewhere")
    assert read_baseline(Path("../limits/survey.json")).profile == "../flights/survey.toml"
    with pytest.raises(ConfigError, match=r"is the baseline of another profile, \.\./flights/survey\.toml"):
        record_baselines(["survey.toml"], directory="../limits", runs=20)


def test_two_files_of_one_name_are_refused_and_no_other_file_is_checked_instead(
    measure, tmp_path, monkeypatch
):
    measured = measure()
    monkeypatch.chdir(tmp_path)
    for path in (Path("a/two.toml"), Path("b/two.toml")):
        path.parent.mkdir()
        path.touch()
    with pytest.raises(ConfigError, match=r"^a/two\.toml and b/two\.toml have one name, 'two'"):
        record_baselines(["a/two.toml", "b/two.toml"], directory="limits", runs=20)
    assert measured == []
    assert not Path("limits").exists()
    assert len(record_baselines(["a/two.toml", "b/../a/two.toml"], directory="limits", runs=20)) == 1
    measured.clear()
    for others, message in (
        (["a/two.toml", "b/two.toml"], r"^a/two\.toml and b/two\.toml have one name, 'two'"),
        (["two", "b/two.toml"], r"^a/two\.toml and b/two\.toml have one name"),
        (["b/two.toml"], r"two\.json: is the baseline of a/two\.toml, not of b/two\.toml"),
    ):
        with pytest.raises(ConfigError, match=message):
            check(others, directory="limits")
    assert measured == []
    assert check(["two", "a/two.toml"], directory="limits")
    with pytest.raises(ConfigError, match="have one name, 'two'"):
        record_baselines(["two", "b/two.toml"], directory="limits", runs=20)


def test_every_value_of_every_draw_is_stored_on_a_line_for_each_metric(recorded):
    lines = (recorded / "survey.json").read_text().splitlines()
    (line,) = (line for line in lines if '"pos_rmse_h_m"' in line)
    stored = json.loads("{" + line.strip().rstrip(",") + "}")["pos_rmse_h_m"]
    assert stored == pytest.approx([usual(k)["pos_rmse_h_m"] for k in range(80)], rel=1e-9)


def test_changes_says_what_moved_and_why(recorded, measure):
    measure(lambda k: usual(k, 0.5))
    record_baselines(directory=recorded, reason="tighter gate")
    measure(lambda k: usual(k, 0.505))
    record_baselines(directory=recorded)
    first, second, third = (recorded / "CHANGES.md").read_text().splitlines()[-3:]
    assert first.endswith(" loose-15, survey: first record, 80 runs.*")
    assert " loose-15, survey: pos_rmse_h_m 2." in second
    assert second.endswith("; tighter gate.*")
    assert third.endswith(
        " loose-15, survey: recorded again, 1 number moved, none by more than 2 %; say here why.*"
    )


def test_programs_of_a_baseline_need_permission(measure, tmp_path):
    measure()
    program = ["command:./filter {sensors} {solution}"]
    record_baselines(["survey.toml"], directory=tmp_path, estimators=program, runs=20)
    with pytest.raises(ConfigError, match="runs code on this machine"):
        check(directory=tmp_path)
    assert check(directory=tmp_path, allow_code=True)
    assert check(directory=tmp_path, estimators=program)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("{", "survey.json: not valid JSON"),
        ("[]", "survey.json: must contain one JSON object"),
        (('"seed": 7', '"seed": 7.5'), "survey.json: seed = 7.5 must be a whole number"),
        (('"tolerance": 0.02', '"tolerance": -1'), "tolerance = -1 must not be negative"),
        (('"sensors": ["0", ', '"sensors": ['), "converged must have 79 values, one for each run; got 80"),
        (('"truth"', '"trut"'), "survey.json: unknown key 'trut'. Did you mean 'truth'?"),
    ],
)
def test_a_malformed_baseline_says_where_and_what(recorded, measure, text, message):
    path = recorded / "survey.json"
    path.write_text(text if isinstance(text, str) else path.read_text().replace(*text))
    measured = measure()
    with pytest.raises(ConfigError) as raised:
        check(directory=recorded)
    assert any(message in line for line in raised.value.messages), raised.value.messages
    assert measured == []


def test_what_is_not_there_is_named(recorded, measure, tmp_path):
    with pytest.raises(ConfigError, match=r"nowhere: no baseline \(\*\.json\)"):
        check(directory=tmp_path / "nowhere")
    with pytest.raises(ConfigError, match=r"no baseline 'survy'\. Did you mean 'survey'\?"):
        check(["survy"], directory=recorded)
    with pytest.raises(ConfigError, match=r"no filter 'loose-16'\. Did you mean 'loose-15'"):
        check(directory=recorded, estimators=["loose-16"])
    with pytest.raises(ConfigError, match="runs = 1 must be at least 2"):
        check(directory=recorded, runs=1)
    with pytest.raises(ConfigError, match="runs = 19 must be at least 20"):
        record_baselines(["survey.toml"], directory=recorded, runs=19)
    with pytest.raises(ConfigError, match="no baseline to record again"):
        record_baselines(directory=tmp_path / "nowhere")


def test_junit_holds_failures_and_what_is_undecided(recorded, measure, tmp_path):
    measure(lambda k: usual(k, 1.08, 0.6, nees=12.0))
    verdicts = check(directory=recorded)
    path = tmp_path / "out" / "check.xml"
    for strict, failed in ((False, ["nees_mean"]), (True, ["pos_rmse_h_m", "nees_mean"])):
        write_junit(path, verdicts, strict=strict)
        (suite,) = ElementTree.parse(path).getroot()
        assert suite.attrib["tests"] == "4"
        assert [case.attrib["name"] for case in suite if case.find("failure") is not None] == failed


def test_junit_is_xml_whatever_a_profile_is_called(measure, tmp_path):
    """Control characters and bytes that are not UTF-8 are in names of files, and not in XML."""
    measure()
    record_baselines(["survey.toml"], directory=tmp_path, runs=20)
    measure(lambda k: usual(k, nees=12.0))
    name = "a\x01\x1b[31m\n<&\udce9\ufffe"
    verdicts = [replace(row, profile=name, estimator=name, note=name) for row in check(directory=tmp_path)]
    write_junit(tmp_path / "check.xml", verdicts)
    (suite,) = ElementTree.parse(tmp_path / "check.xml").getroot()
    assert suite.attrib["name"] == "a??[31m <&??"
    assert any("<&" in case[0].attrib["message"] for case in suite if len(case))


@pytest.mark.parametrize(
    ("environment", "lines"),
    [
        ({}, []),
        (
            {"GITHUB_ACTIONS": "true"},
            [
                "::error file=base/50%25%3Aa%2Cb.json,title=loose-15%3A pos_rmse_h_m is worse::worse: "
                "loose-15 on 50%25:a,b, pos_rmse_h_m 2 -> 3 m, +50.0%25 (+40.0%25 to +60.0%25) in 20 runs, "
                "if no rare large run exists"
            ],
        ),
        (
            {"TF_BUILD": "True"},
            [
                "##vso[task.logissue type=error;sourcepath=base/50%AZP25:a,b.json]worse: "
                "loose-15 on 50%AZP25:a,b, pos_rmse_h_m 2 -> 3 m, +50.0%AZP25 "
                "(+40.0%AZP25 to +60.0%AZP25) in 20 runs, if no rare large run exists"
            ],
        ),
    ],
)
def test_ci_shows_what_is_worse_beside_the_change(environment, lines):
    row = Verdict(
        "50%:a,b", "loose-15", "pos_rmse_h_m", "m", "worse", 2.0, 3.0, 0.5, 0.4, 0.6, True, 20, True, ""
    )
    rows = [row, replace(row, word="same"), replace(row, word="better")]
    assert list(annotate(rows, Path("base"), environment)) == lines
    unsure = [replace(row, word="undecided")]
    levels = [next(iter(annotate(unsure, Path(), environment, strict=one)), "") for one in (False, True)]
    assert ["warning" in line for line in levels] == [bool(environment), False]


def test_the_verdict_survives_80_columns(recorded, measure):
    measure(lambda k: usual(k, 1.1, 0.01, nees=12.0))
    console = Console(width=80, record=True, file=io.StringIO())
    print_verdicts(console, check(directory=recorded))
    text = console.export_text()
    assert "survey, loose-15: 2 worse, 2 same (20 runs)" in text
    assert sum("worse " in line and "_" in line for line in text.splitlines()) >= 2
    assert "coverage" not in text


# --- digests and expectations -----------------------------------------------------------------------------


def imu(noise, bits=0.0):
    t = np.arange(1000) / 100.0
    drawn = stream(1, noise, "imu").normal(size=(1000, 3))
    return ImuData(t, np.full(1000, 0.01), np.ones(1000, bool), 1e-4 * drawn * (1 + bits), 0.1 + drawn)


def test_a_digest_is_of_the_draw_and_not_of_the_processor():
    assert digest_record(imu(1)) == digest_record(imu(1, bits=1e-13))
    assert digest_record(imu(1)) != digest_record(imu(2))


def test_a_recording_is_cut_into_stretches(monkeypatch):
    t = np.arange(0.0, 110.0)
    errors = SimpleNamespace(
        t=t, pos_n=np.outer(t, [1.0, 0.0, 2.0]), vel_n=np.ones((110, 3)), nees=t, states=6
    )
    result = SimpleNamespace(
        errors={"x": errors}, metrics={"x": {"converged": True, "reason": None}}, sensors=imu(1)
    )
    log = SimpleNamespace(
        spec=SimpleNamespace(evaluation=EvaluationWindow(9.0)),
        records=SimpleNamespace(imu=SimpleNamespace(t=np.array([109.0]))),
        estimators={"x": None},
    )
    monkeypatch.setattr(baseline_draws.log_pipeline, "read_log", lambda *a, **k: log)
    monkeypatch.setattr(baseline_draws.log_pipeline, "navigate", lambda log: result)
    recording = baseline_draws.Recording("drive.toml", None, False, DEFAULT_GUARD)
    assert (recording.name, recording.draws) == ("drive", 20)
    row = recording.measure(1).estimators["x"]
    inside = np.arange(14.0, 19.0)
    assert row.metrics["pos_rmse_h_m"] == pytest.approx(np.sqrt(np.mean(inside**2)))
    assert row.metrics["nees_mean"] == pytest.approx(16.0)
    assert (row.epochs, row.expected) == (5, {"nees_mean": 6.0})
