"""The parts of a campaign, each by itself and without flights."""

from __future__ import annotations

import contextlib
import json
import os
import platform
import signal
import sys
import time
import tomllib
from concurrent.futures import Future
from concurrent.futures.process import BrokenProcessPool
from dataclasses import asdict
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pyarrow as pa
import pytest

import bench
from bench.core.records.specs import EstimatorChoice, EvaluationWindow, Guard
from bench.core.words.exceptions import ConfigError
from bench.core.words.wording import format_value
from bench.experiments.campaigns import (
    batches,
    campaign_file,
    campaign_tables,
    groups,
    journal,
    outcome,
    plan,
    pools,
    stored,
    worker,
)
from bench.experiments.campaigns.batches import ATTEMPTS, Lost, compute
from bench.experiments.campaigns.binned import BinnedRuns
from bench.experiments.campaigns.campaign_file import (
    CampaignSpec,
    is_campaign_file,
    read_campaign_file,
)
from bench.experiments.campaigns.groups import Group
from bench.experiments.campaigns.journal import Journal
from bench.experiments.campaigns.outcome import Campaign
from bench.experiments.campaigns.plan import Condition
from bench.experiments.campaigns.running import RunCounter
from bench.experiments.campaigns.worker import CHANNELS, choose_step, decode, encode
from bench.io.results import row_parts

# --- batches and pools ------------------------------------------------------------------------------------


class Fragile:
    """A pool of two workers of which an item ends its worker, and with it all that is under way."""

    workers, lost, remote = 2, (BrokenProcessPool,), False

    def __init__(self, bad: int) -> None:
        self.bad, self.given, self.recovered = bad, list[list[int]](), 0

    def submit(self, function: Any, work: Any, items: list[int]) -> Future[Any]:
        future: Future[Any] = Future()
        self.given.append(items)
        if self.bad in items:
            future.set_exception(BrokenProcessPool())
        else:
            future.set_result([(work(item), 0.5) for item in items])
        return future

    def recover(self) -> tuple[str, bool]:
        self.recovered += 1
        return f"reason {self.recovered}", True


def double(x: int) -> int:
    return 2 * x


@pytest.mark.parametrize("bad", [0, 30, 49])
def test_what_was_lost_runs_alone_and_an_item_that_ends_its_worker_twice_is_given_up(bad):
    pool = Fragile(bad)
    found = dict(compute(double, range(50), pool))
    assert found.pop(bad) == Lost(f"reason {pool.recovered}")
    assert found == {k: 2 * k for k in range(50) if k != bad}
    tried = [items for items in pool.given if bad in items]
    assert tried[-ATTEMPTS:] == [[bad]] * ATTEMPTS
    assert (
        len(tried) == pool.recovered == 3 + (len(tried[0]) > 1)
    )  # with others, a batch alone, twice an item


class Slow(Fragile):
    """The same, but that nothing finishes until nothing is left to be given."""

    def __init__(self, bad: int) -> None:
        super().__init__(bad)
        self.pending: list[tuple[Future[Any], Any]] = []
        self.before = list[int]()

    def submit(self, function: Any, work: Any, items: list[int]) -> Future[Any]:
        done = super().submit(function, work, items)
        if done.exception() is not None:
            return done
        self.before.append(len(self.pending))
        self.pending.append((Future(), done.result()))
        return self.pending[-1][0]

    def check(self) -> None:
        future, value = self.pending.pop(0)
        future.set_result(value)

    def recover(self) -> tuple[str, bool]:
        for future, _ in self.pending:
            future.set_exception(BrokenProcessPool())
        self.pending.clear()
        return super().recover()


def test_workers_never_wait_and_what_ends_with_a_worker_runs_again(monkeypatch):
    """Two batches for each of the two workers, and a new one as soon as one has finished."""
    monkeypatch.setattr(batches, "LOOK", 0.001)
    pool = Slow(-1)
    assert len(dict(compute(double, range(30), pool))) == 30
    assert pool.before == [0, 1, 2, *[3] * (len(pool.given) - 3)]
    pool = Slow(3)
    found = dict(compute(double, range(8), pool))
    assert found.pop(3) == Lost("reason 3")
    assert found == {k: 2 * k for k in range(8) if k != 3}
    assert pool.recovered == 3  # of all that were under way at once, then of the one twice


def test_what_is_to_be_first_is_alone():
    """Nothing else is given to the workers until it has finished."""
    pool, given = Fragile(-1), []
    for k, _ in compute(double, range(12), pool, first=[7, 3]):
        given.append((k, len(pool.given)))
    assert given[:2] == [(7, 1), (3, 2)]
    assert pool.given[:3] == [[7], [3], [0, 1, 2]]
    assert sorted(k for k, _ in given) == list(range(12))


def test_the_pace_is_the_mean_duration_of_an_item():
    ((value, seconds),) = batches.apply(lambda x: time.sleep(x), [0.02])
    assert value is None
    assert 0.02 <= seconds < 10.0
    pace = batches.Pace()
    pace.add(0.0)
    assert pace.choose_size(100, 2) == 1
    pace.add(1.0)  # 0.5 s each: 8 take four seconds
    assert (pace.choose_size(100, 2), pace.choose_size(9, 2), pace.choose_size(1, 2)) == (8, 3, 1)
    pace.add(100.0)
    assert pace.choose_size(100, 2) == 1


@pytest.mark.parametrize(
    ("codes", "told"),
    [
        ((-signal.SIGTERM, 128 + signal.SIGTERM, 3, None), "its worker process ended with exit status 3"),
        ((-signal.SIGTERM, -signal.SIGKILL), "its worker process was ended by SIGKILL"),
        ((143, -15), "its worker process ended"),
    ],
)
def test_of_workers_that_ended_the_first_that_was_not_asked_to_is_named(monkeypatch, codes, told):
    pool, ended = pools.ProcessPool(2), []
    pool._own = {k: SimpleNamespace(exitcode=code) for k, code in enumerate(codes)}  # type: ignore[misc]
    monkeypatch.setattr(pool, "_end", lambda at_once: ended.append(at_once))
    begun = time.monotonic()
    assert pool.recover() == (told, True)
    assert time.monotonic() - begun < 2.0
    assert ended == [True]


def test_a_worker_that_does_not_end_is_not_waited_for(monkeypatch):
    pool = pools.ProcessPool(2)
    pool._own = {1: SimpleNamespace(exitcode=None)}  # type: ignore[dict-item]
    monkeypatch.setattr(pool, "_end", lambda at_once: None)
    monkeypatch.setattr(pools, "PATIENCE", 0.02)
    assert pool.recover() == ("its worker process ended", True)


def test_workers_are_asked_to_end_before_they_are_ended(monkeypatch):
    """Only those that run; 3 s for all of them together."""
    sent, waited = [], []

    def make(pid: int | None, code: int | None) -> Any:
        return SimpleNamespace(pid=pid, exitcode=code, join=lambda seconds: waited.append((pid, seconds)))

    now = iter([10.0, 10.0, 11.0, 12.0, 20.0, 20.0, 24.0, 24.0])
    monkeypatch.setattr(pools, "time", SimpleNamespace(monotonic=lambda: next(now)))
    monkeypatch.setattr(os, "kill", lambda pid, number: sent.append((pid, number)))
    pool = pools.ProcessPool(2)
    pool._own = {k: make(*each) for k, each in enumerate(((7, None), (8, 0), (None, None)))}
    pool._end(at_once=True)
    assert sent == [(7, signal.SIGTERM), (7, signal.SIGKILL)]
    assert waited == [(7, 3.0), (8, 2.0), (None, 1.0), (7, 3.0), (8, 0.0), (None, 0.0)]
    assert pool._own == {}


def test_one_job_is_this_process_and_several_are_processes(monkeypatch):
    assert isinstance(pools.open_pool(1), pools.ExecutorPool)
    several = pools.open_pool(2)
    assert (type(several), several.workers) == (pools.ProcessPool, 2)
    with pytest.raises(SystemExit) as stopped:
        pools.exit_on_signal(signal.SIGTERM, None)
    assert stopped.value.code == 143
    if sys.platform == "linux":
        assert pools.count_processors() == len(os.sched_getaffinity(0))
    monkeypatch.setattr(sys, "platform", "another")
    for known, told in ((7, 7), (None, 1)):
        monkeypatch.setattr(os, "cpu_count", lambda known=known: known)
        assert pools.count_processors() == told


# --- the campaign file ------------------------------------------------------------------------------------


def read(folder: Path, text: str, **options: Any) -> CampaignSpec:
    (folder / "some.toml").write_text(text)
    return read_campaign_file(str(folder / "some.toml"), **options)


def test_a_campaign_file_that_names_profiles_alone_has_the_defaults(tmp_path):
    spec = read(tmp_path, 'profiles = ["survey", "static"]')
    assert spec == CampaignSpec("some", ("survey", "static"))
    assert (spec.runs, spec.flights, spec.seed, spec.estimators) == (200, 1, None, None)
    assert list(spec.conditions()) == [("survey", {}), ("static", {})]
    own = read(tmp_path, 'profiles = ["sub/x.toml"]\nestimators = ["own:X"]', allow_code=True)
    assert own.profiles == (os.path.relpath(tmp_path / "sub" / "x.toml"),)
    assert own.estimators == ("own:X",)
    assert is_campaign_file(str(tmp_path / "some.toml"))
    assert not is_campaign_file("survey")


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("[sweep]\na = []", r"some.toml: \[sweep\] a = \[\] must be a list of values"),
        ("[sweep]\na = [1]\n[[variant]]\na = 2", "a is given twice"),
        (f'estimators = ["own:{"x" * 80}"]', f"'own:{'x' * 56}' runs code"),
        (f"[sweep]\na = {list(range(5001))}", "more than 10000 conditions"),
    ],
)
def test_what_a_campaign_file_must_not_say(tmp_path, text, message):
    with pytest.raises(ConfigError, match=message):
        read(tmp_path, f'profiles = ["survey", "static"]\n{text}')


def test_the_most_conditions_are_taken(tmp_path):
    spec = read(tmp_path, f'profiles = ["survey", "static"]\n[sweep]\na = {list(range(5000))}')
    assert len(list(spec.conditions())) == 10_000


@pytest.mark.parametrize("value", [1, 2.5, True, False, 'a "b"', [1, [2.0, "x"]], {"a": 1, "b c": [True]}])
def test_a_value_is_written_as_toml(value):
    assert tomllib.loads(f"x = {format_value(value)}")["x"] == value
    assert "\n" not in format_value(value)
    assert campaign_file.flatten({"a": {"b": value}} if isinstance(value, int) else {"a.b": 1}).keys() == {
        "a.b"
    }


# --- the plan ---------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("guard", "words"),
    [
        (Guard(), []),
        (Guard(timeout=30.0), ["--timeout", "30"]),
        (Guard(memory=2.5e9, output=5e8), ["--memory", "2.5", "--output", "500"]),
        (Guard(timeout=0.5, in_process=True), ["--timeout", "0.5", "--in-process"]),
    ],
)
def test_limits_are_named_as_the_command_line_has_them(guard, words):
    assert plan.name_limits(guard) == words


def test_the_files_that_a_wrapper_names_are_found_from_file_to_file(tmp_path):
    texts = {
        "wrapper.sh": 'exec "$(dirname "$0")/build/inner.sh"',
        "inner.sh": "./program data.bin missing.bin wrapper.sh inner.sh",
        "program": "\x00",
        "data.bin": "x",
        "other.bin": "x",
    }
    for name, text in texts.items():
        (tmp_path / name).write_text(text)
    (tmp_path / "program").write_bytes(b"\xff\xfe other.bin")
    names = ("data.bin", "inner.sh", "program")
    assert plan.find_named_files([tmp_path / "wrapper.sh"]) == [tmp_path / name for name in names]
    (tmp_path / "inner.sh").write_text("program " + " " * (1 << 20))  # too large to be a wrapper
    assert plan.find_named_files([tmp_path / "wrapper.sh"]) == [tmp_path / "inner.sh"]
    choice = EstimatorChoice("command:./wrapper.sh {here}/data.bin {sensors}", "x", beside=tmp_path)
    found = plan.find_sources(choice)
    assert found == [tmp_path / "./wrapper.sh", tmp_path / "data.bin", tmp_path / "inner.sh"]
    shell = plan.find_sources(EstimatorChoice("command:sh wrapper.sh", "x", beside=tmp_path))
    assert [path.name for path in shell] == ["sh", "wrapper.sh", "inner.sh"]
    for use in ("command:", "command:'"):
        assert plan.find_sources(EstimatorChoice(use, "x", beside=tmp_path)) == []
    (tmp_path / "many.sh").write_text(" ".join(f"a{k}" for k in range(250)))
    for k in range(250):
        (tmp_path / f"a{k}").write_text("data.bin")
    assert len(plan.find_named_files([tmp_path / "many.sh"])) == 250  # what these name is too much
    for path in (*tmp_path.glob("a*"), tmp_path / "many.sh"):
        path.unlink()
    everything = plan.find_sources(EstimatorChoice("file:.", "x", beside=tmp_path))
    assert [path.name for path in everything] == sorted(texts)


@pytest.mark.parametrize(
    ("use", "names"),
    [
        ("own_alone:X", ["own_alone.py"]),
        ("own_package.deep:X", ["__init__.py", "deep.py"]),
        ("own_space:X", []),  # a folder without __init__.py has no origin
        ("own_missing:X", []),
        (".:X", []),
        ("bench.navigation:X", []),
        ("own_alone", []),
        ("command:own_alone", []),
        ("file:own_alone", []),
    ],
)
def test_the_sources_of_a_class_are_its_module_or_its_whole_package(tmp_path, monkeypatch, use, names):
    for name in ("own_package", "own_space"):
        (tmp_path / name).mkdir()
    for name in ("own_alone.py", "own_package/__init__.py", "own_package/deep.py", "command.py", "file.py"):
        (tmp_path / name).write_text("")
    monkeypatch.syspath_prepend(tmp_path)
    assert [path.name for path in plan.find_module_files(use)] == names


# --- the journal ------------------------------------------------------------------------------------------


def make_row(
    key: str = "k", metrics: dict[str, Any] | None = None, label: str = "x", **more: Any
) -> dict[str, Any]:
    own = {
        "metrics": {"converged": True, "pos_rmse_h_m": 1.0, **(metrics or {})},
        "states": 9,
        "nis_dof": {"baro": 3},
        "repetition": {},
        "instants": encode(np.ones((2, len(CHANNELS)))),
    }
    return {
        "key": key,
        "step": 1.0,
        "cpu_s": {},
        "estimator_cpu_s": {},
        "estimators": {label: {**own, **more}},
    }


@pytest.mark.parametrize(
    ("row", "good"),
    [
        (make_row(), True),
        ({"key": "k", "error": "why"}, True),
        (make_row(metrics={"pos_rmse_h_m": None, "verdict_text": "words"}), True),
        (make_row(metrics={"pos_rmse_h_m": -0.9e15}), True),
        (make_row(metrics={"pos_rmse_h_m": -1.1e15}), False),
        (make_row(metrics={"pos_rmse_h_m": "1"}), False),
        (make_row(metrics={"converged": 1}), False),
        (make_row(instants=encode(np.ones(len(CHANNELS) + 1))), False),
        (make_row(states=-1), False),
        ({**make_row(), "step": 0.0}, False),
        ({**make_row(), "more": 0.0}, False),
        ({**make_row(), "step": 1.1e15}, False),
    ],
)
def test_a_row_of_the_journal_is_what_a_run_writes(tmp_path, row, good):
    with Journal(tmp_path / "j") as new:
        new.append(row)
    with Journal(tmp_path / "j") as found:
        assert ("k" in found, found.damaged) == (good, 1 - good)


def test_runs_of_other_estimators_are_forgotten(tmp_path):
    with Journal(tmp_path / "j") as found:
        assert found.find_labels() == ()
        for row in ({"key": "lost", "error": "why"}, make_row("a"), make_row("b", label="y"), make_row("c")):
            found.append(row)
        assert found.find_labels() == ("x",)
        found.keep_runs_of(["x"])
        assert [key in found for key in ("lost", "a", "b", "c")] == [True, True, False, True]
        assert found.damaged == 1
    assert journal.sum_text(b"text") == b"982d9e3eb996f559"


# --- groups and their statistics --------------------------------------------------------------------------


def make_group(kept: np.ndarray, converged: list[bool], label: str = "x", **more: Any) -> Group:
    """A group of runs (R, K, C) at 1, 2, ... s whose figures count from 2 s on."""
    mean, percentiles = groups.describe(kept, np.array(converged))
    t = np.arange(1.0, kept.shape[1] + 1.0)
    metrics = tuple(
        {"converged": good, "reason": None if good else "late", "pos_rmse_h_m": 1.0 + k}
        for k, good in enumerate(converged)
    )
    given = {"metrics": metrics, "states": 9, "nis_dof": ({},) * len(converged), **more}
    window = EvaluationWindow(begin=2.0)
    return Group(
        0,
        Condition("p", {"a": 1}),
        label,
        (1,),
        window,
        t=t,
        mean=mean,
        percentiles=percentiles,
        kept_t=t,
        kept=kept,
        **given,
    )


def test_runs_of_a_condition_are_gathered_and_very_many_are_thinned(monkeypatch):
    """Of three runs, of which one is lost, with at most two exact: every second time is kept."""
    rng = np.random.default_rng(3)
    runs = [rng.uniform(1.0, 2.0, (6, len(CHANNELS))) for _ in range(3)]
    cell = SimpleNamespace(profile=SimpleNamespace(labels=("x",), seed=4, evaluation=EvaluationWindow()))
    conditions = {"conditions": (Condition("p", {}),)}
    rows = {
        str(k): {
            **make_row(
                metrics={"converged": k != 1}, instants=encode(one), states=9 - k, nis_dof={"baro": k}
            ),
            "step": 0.5,
        }
        for k, one in enumerate(runs)
    }
    lost: dict[str, Any] = {"lost": {"key": "lost", "error": "why"}}

    def gather(keys: str, most: int) -> list[Group]:
        monkeypatch.setattr(groups, "MOST_KEPT", 6 * most)
        fresh = {
            key: {**row, "estimators": {"x": dict(row["estimators"]["x"])}} for key, row in rows.items()
        } | lost
        listed = ["lost", *keys]
        return list(groups.gather_condition(SimpleNamespace(**conditions), 0, [cell], listed, fresh))  # type: ignore[arg-type]

    (exact,), (few,) = gather("012", 4), gather("012", 2)
    assert gather("", 2) == []
    assert (exact.states, exact.seeds, exact.nis_dof) == (9, (4,), ({"baro": 0}, {"baro": 1}, {"baro": 2}))
    assert exact.t.tolist() == few.t.tolist() == [0.5, 1.0, 1.5, 2.0, 2.5, 3.0]
    assert (exact.kept_t.tolist(), few.kept_t.tolist()) == (exact.t.tolist(), [1.0, 2.0, 3.0])
    good = np.mean([runs[0], runs[2]], axis=0)
    np.testing.assert_allclose(exact.mean, good, rtol=1e-6)
    np.testing.assert_allclose(few.mean, good, rtol=1e-6)
    np.testing.assert_allclose(few.kept, [one[1::2] for one in runs], rtol=1e-6)
    low, middle, high = few.percentiles
    assert (low < middle).all()
    assert (middle < high).all()


def test_figures_are_of_the_runs_that_converged_after_the_alignment():
    rng = np.random.default_rng(4)
    kept = rng.normal(size=(50, 8, len(CHANNELS))).astype(np.float32)
    kept[:, :, -1] = rng.chisquare(9, (50, 8))
    kept[0] = 1e6
    kept[3, 7] = np.nan  # there not all have values
    group = make_group(kept, [k > 0 for k in range(50)])
    found = outcome.summarize(group)
    size = np.hypot(kept[1:, 1:7, 0].astype(float), kept[1:, 1:7, 1])
    assert found.errors["cep50_m"].value == pytest.approx(np.quantile(size, 0.5, method="inverted_cdf"))
    assert found.errors["cep95_m"].value == pytest.approx(np.quantile(size, 0.95, method="inverted_cdf"))
    assert found.errors["pos_rmse_h_m"].value == pytest.approx(np.sqrt(np.mean(np.arange(2.0, 51.0) ** 2)))
    assert found.errors.keys() == {"cep50_m", "cep95_m", "pos_rmse_h_m"}
    assert (found.condition, found.runs, found.converged_runs) == ("p, a = 1", 50, 49)
    assert found.consistency is not None
    assert found.consistency.mean == pytest.approx(kept[1:, 1:7, -1].mean(), rel=1e-5)
    for less in (make_group(kept[:8], [k > 0 for k in range(8)]), make_group(kept, [True] * 50, states=0)):
        assert outcome.summarize(less).consistency is None
    few = outcome.summarize(make_group(kept[:3], [True, False, False]))
    assert (few.errors, few.converged.value, few.lost) == ({}, pytest.approx(1 / 3), "late")
    assert stored.make_outcome(stored.StoredOutcome.model_validate(asdict(few))).lost == "late"


def test_an_outcome_is_read_back_as_it_was_written():
    """With a number that is not finite, for which JSON has null."""
    kept = np.random.default_rng(4).chisquare(9, (50, 8, len(CHANNELS))).astype(np.float32)
    own = {"converged": True, "pos_rmse_h_m": 1.0, "nis_mean_baro": 1.2, "updates_baro": 10}
    found = outcome.summarize(
        make_group(kept, [True] * 50, metrics=(own,) * 50, nis_dof=({"baro": 10},) * 50)
    )
    row = json.loads(json.dumps(asdict(found), default=lambda array: array.tolist()))
    row["errors"]["cep50_m"]["low"] = None
    back = stored.make_outcome(stored.StoredOutcome.model_validate(row))
    assert np.isnan(back.errors["cep50_m"].low)
    assert back.errors["cep95_m"] == found.errors["cep95_m"]
    assert (back.converged, back.condition, back.label, back.runs) == (found.converged, "p, a = 1", "x", 50)
    assert back.sentences == found.sentences
    assert back.consistency.nis == found.consistency.nis
    assert back.consistency.nis["baro"].updates == 500
    assert (
        stored.make_outcome(stored.StoredOutcome.model_validate({**row, "consistency": None})).consistency
        is None
    )


def test_pairs_are_of_the_runs_in_which_both_converged():
    kept = np.zeros((4, 2, len(CHANNELS)), np.float32)
    first = make_group(kept, [True, True, False, True])
    second = make_group(kept, [True, True, True, False], "y")
    third = make_group(kept, [True, False, False, False], "z")
    none = make_group(kept, [True] * 4, "w", metrics=({"converged": True},) * 4)
    (pair,) = outcome.pair_runs([first, second, third, none])
    assert (pair.names, pair.first.tolist(), pair.second.tolist()) == (("x", "y"), [1.0, 2.0], [1.0, 2.0])
    assert outcome.pair_runs([first, second], "tilt") == []


@pytest.mark.parametrize(
    ("states", "converged", "known"), [(9, True, True), (0, True, False), (9, False, False)]
)
def test_the_band_of_nees_is_told_where_there_are_states_and_runs(states, converged, known):
    kept = np.ones((3, 2, len(CHANNELS)), np.float32)
    found = campaign_tables.describe_instants(make_group(kept, [converged] * 3, states=states))
    assert np.isfinite(found["nees_low"]).tolist() == np.isfinite(found["nees_high"]).tolist() == [known] * 2
    assert (found["condition"], found["estimator"], found["runs"]) == (
        [0] * 2,
        ["x"] * 2,
        [3 * converged] * 2,
    )
    assert found["t_s"].dtype == np.float64
    assert found["pos_err_n_m_p05"].dtype == np.float32


def test_columns_of_a_table_have_one_type():
    assert row_parts.unite([None, "a", 1]) == [None, "a", "1"]
    assert row_parts.unite([None, 2, 1.5]) == [None, 2, 1.5]
    values = campaign_tables.describe_condition(3, Condition("p", {"a": 1.5, "b": True, "c": [1, 2]}))
    assert values == {"condition": 3, "profile": "p", "a": 1.5, "b": True, "c": "[1, 2]"}


def test_blocks_of_a_table_are_joined_as_if_they_were_one():
    """Integers become numbers and numbers become texts, if any block has them; a column may begin late."""
    rows: list[dict[str, Any]] = [
        {"a": 1, "b": None, "c": True},
        {"a": 2, "d": 1},
        {"a": 2.5, "d": "x"},
        {"c": False},
    ]
    one, three = (
        row_parts.join_blocks([row_parts.stack_rows(rows[k : k + n]) for k in range(0, 4, n)]) for n in (4, 1)
    )
    assert list(one) == list(three) == ["a", "b", "c", "d"]
    for name, column in one.items():
        assert (three[name].type, three[name].to_pylist()) == (column.type, column.to_pylist())


def test_bins_are_as_wide_as_they_say():
    """2048 of equal width of asinh, from -1e8 to 1e8: 2.5 % of a value, or 2.5e-5 below 1e-3."""
    edges = 1e-3 * np.sinh(np.linspace(-np.arcsinh(1e11), np.arcsinh(1e11), 2049))
    for value in (-3.7, 2e-5, 1e-3, 0.37, 52_000.0):
        bins = BinnedRuns(1, 1)
        bins.add(np.array([[value]]))
        at = int(np.searchsorted(edges, value)) - 1
        assert bins.percentile(0)[0, 0] == pytest.approx(edges[at], rel=1e-9)
        assert bins.percentile(100)[0, 0] == pytest.approx(edges[at + 1], rel=1e-9)
    for value, end in ((1e9, edges[-1]), (-1e9, edges[1])):
        bins = BinnedRuns(1, 1)
        bins.add(np.array([[value]]))
        assert bins.percentile(100)[0, 0] == pytest.approx(end, rel=1e-9)


# --- what a worker keeps ----------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("duration", "rate", "step"),
    [(60.0, 10.0, 0.1), (60.0 + 1e-9, 10.0, 0.1), (60.1, 10.0, 0.2), (20.0, 10.0, 0.1), (7200.0, 4.0, 12.0)],
)
def test_the_step_of_the_instants_that_are_kept(duration, rate, step):
    assert choose_step(duration, rate) == pytest.approx(step)


def test_what_a_worker_keeps_of_a_run_is_short():
    text = worker.shorten("a" * 6000 + "b" * 6000)
    assert text == f"{'a' * 5000}\n[2000 bytes left out]\n{'b' * 5000}"
    assert worker.describe_error(ConfigError("what\nelse")) == "what else"
    assert worker.describe_error(ValueError("x" * 600)) == f"ValueError('{'x' * 488}"
    kinds = (1.0, 2, True, None, "a", np.inf, np.nan, [1], {})
    assert [worker.is_plain(one) for one in kinds] == [True] * 5 + [False] * 4
    values = np.arange(24.0).reshape(2, 12)
    assert np.array_equal(decode(encode(values)), values)


# --- a campaign -------------------------------------------------------------------------------------------


def make_campaign(rows: list[dict[str, Any]], *conditions: dict[str, Any], **more: Any) -> Campaign:
    table = pa.Table.from_pylist(rows)
    given: dict[str, Any] = {
        "outcomes": (), "comparisons": (), "runs": table, "epochs": None, "planned": 3, "finished": 3,
        "failed": {}, "conditions": conditions, "provenance": {}, "timing": {}, "interrupted": False,
        "folder": Path("some"),
    }  # fmt: skip
    return Campaign(**{**given, **more})


def test_a_campaign_says_whether_each_condition_keeps_what_is_required():
    need = {"metric": "pos_rmse_h_m", "most": 2.0, "share": 0.1}
    rows = [
        {"condition": k, "estimator": label, "pos_rmse_h_m": size, "converged": True}
        for k, label, size in ((0, "x", 1.0), (0, "y", 3.0), (1, "x", 3.0))
        for _ in range(40)
    ]
    first = {"values": {}, "as_flown": {"requirement": [need]}}
    second = {"values": {"a": 1, "b": "c"}, "as_flown": {"requirement": [{**need, "estimator": "x"}]}}
    found = make_campaign(rows, first, second).requirements
    assert [(one.label, one.word) for one in found] == [
        ("x", "met"),
        ("y", "missed"),
        ("a = 1, b = c: x", "missed"),
    ]
    told = make_campaign(rows, first, second).sentences
    assert told == tuple(one.sentence for one in found)
    assert "x: pos_rmse_h_m is at most 2 m in 40 of 40 runs" in told[0]
    none = {"values": {}, "as_flown": {}}
    assert make_campaign(rows, none, none).requirements == ()
    assert [one.label for one in make_campaign(rows, none, second).requirements] == ["a = 1, b = c: x"]
    assert repr(make_campaign(rows, none)) == "<Campaign: 3 of 3 runs>"


@pytest.mark.parametrize("options", [{"resume": True}, {"resume": True, "force": True, "out": "x"}])
def test_to_continue_needs_a_folder_and_does_not_replace_it(options):
    with pytest.raises(ConfigError, match="resume continues the campaign in out, and force replaces it"):
        bench.campaign("survey", 1, **options)


def test_the_counter_counts_runs_and_flight_time(monkeypatch):
    seen, now = [], iter([100.0, 102.0, 105.0])
    monkeypatch.setattr(
        "bench.experiments.campaigns.running.time", SimpleNamespace(perf_counter=lambda: next(now))
    )
    counter = RunCounter("some", 5, 2, seen.append)
    counter.count(20.0, failed=True)
    counter.count(30.0, failed=False)
    assert [(one.total, one.done, one.failed, one.new, one.elapsed, one.flown) for one in seen] == [
        (5, 2, 0, 0, 0.0, 0.0), (5, 3, 1, 1, 2.0, 20.0), (5, 4, 1, 2, 5.0, 50.0)
    ]  # fmt: skip


def test_runs_are_chosen_by_rank_or_number():
    sizes = [3.0, None, 1.0, 2.0, 5.0]
    rows = [
        {"estimator": label, "run": k, "pos_rmse_h_m": size, "command": f"{label} {k}"}
        for k, size in enumerate(sizes)
        for label in "xy"
    ]
    found = stored.choose_runs(make_campaign(rows, {}), ["best", "median", "worst", "1"])
    names = {"best, run 2": "x 2", "median, run 0": "x 0", "worst, run 4": "x 4", "run 1": "x 1"}
    assert found == names
    with pytest.raises(ConfigError, match=r"some: has no run '5'; best, median, worst, or a number up to 4"):
        stored.choose_runs(make_campaign(rows, {}), ["5"])
    for of in (rows[2:4], []):  # none has a size
        with pytest.raises(ConfigError, match="has no run 'best'"):
            stored.choose_runs(make_campaign(of, {}), ["best"])
    with pytest.raises(ConfigError, match="has 2 conditions"):
        stored.choose_runs(make_campaign(rows, {}, {}), ["best"])


@pytest.mark.parametrize(
    ("name", "columns", "message"),
    [
        ("runs.parquet", {"run": [1, 2], "pos_rmse_h_m": [1.0, None]}, None),
        (
            "runs.parquet",
            {"run": [1, 2], "pos_rmse_h_m": [1.0, np.inf]},
            "column 'pos_rmse_h_m' must hold finite",
        ),
        (
            "runs.parquet",
            {"run": [1, 2], "pos_rmse_h_m": ["1", "2"]},
            "column 'pos_rmse_h_m' must hold finite",
        ),
        ("epochs.parquet", {"run": [1, 2], "pos_rmse_h_m": [1.0, np.inf]}, None),
        ("epochs.parquet", {"run": [1, 2], "t_s": [1.0, np.nan]}, "column 't_s' must hold finite numbers"),
        ("runs.parquet", {"run": [1.0, 2.0]}, "column 'run' is of type double; it must be int64"),
        ("runs.parquet", {"other": [1]}, "column 'run' is missing; it must be int64"),
        ("runs.parquet", {"other": []}, None),
    ],
)
def test_the_columns_of_a_stored_table_are_checked(name, columns, message):
    table, wanted = pa.table(columns), {"run": "int64"}
    if message is None:
        stored.check_columns(Path(name), table, wanted)
    else:
        with pytest.raises(ConfigError, match=f"{name}: damaged: {message}"):
            stored.check_columns(Path(name), table, wanted)


# --- the cluster, without one -----------------------------------------------------------------------------


VERSIONS = {"bench": "1", "numpy": "2"}


class FakeClient:
    """The client of a scheduler with two machines of which one has no truth."""

    def __init__(self) -> None:
        self.found: dict[str, Any] = {"w": VERSIONS}
        self.sent: list[Any] = []
        self.get_executor = self.close = lambda **_: None

    def run(self, function: Any, *arguments: Any, workers: Any = None) -> Any:
        if workers is not None:
            self.sent.append((function, arguments, workers))
        return self.found

    def nthreads(self) -> dict[str, int]:
        return {"a": 2, "b": 1} if self.found else {}

    def upload_file(self, path: str, load: bool) -> None:
        self.sent.append((Path(path).name, load))


@pytest.fixture
def cluster(monkeypatch):
    """The module, and the client of its pools, which is not one."""
    pytest.importorskip("distributed", reason="pip install dask distributed")
    from bench.experiments.campaigns import cluster

    client = FakeClient()
    monkeypatch.setattr("distributed.Client", lambda *_, **__: client)
    monkeypatch.setattr(cluster, "describe_software", lambda: VERSIONS)
    return cluster, client


def test_a_truth_is_written_once_on_each_machine_without_it(cluster, monkeypatch):
    module, client = cluster
    pool, truths = module.ClusterPool("tcp", []), {"k": "truth", "gone": None}
    monkeypatch.setattr(module.results, "read_truth", truths.get)
    client.found = {"w1": ("one", True), "w2": ("two", False), "w3": ("two", False)}
    pool.share(["k", "gone"])
    assert client.sent == [(module.results.write_truth, ("k", "truth"), ["w3"])]
    assert pool.workers == 3
    client.sent.clear()
    client.found = {"w1": ("one", True)}
    pool.share(["k"])
    assert client.sent == []
    assert [module.find_truth(key) for key in truths] == [(platform.node(), True), (platform.node(), False)]
    client.found = {}
    assert pool.workers == 1


@pytest.mark.parametrize(
    ("found", "message"),
    [
        ({"w": {"bench": "1", "numpy": "2"}}, None),
        ({}, "tcp: has no workers"),
        ({"w": {"bench": "1"}}, "worker w: numpy None, here 2; equal versions are needed"),
        ({"w": {"bench": "0", "numpy": "2"}}, "worker w: bench 0, here 1; equal versions are needed"),
    ],
)
def test_workers_have_the_software_of_the_driver(cluster, found, message):
    module, client = cluster
    client.found = found
    with contextlib.nullcontext() if message is None else pytest.raises(ConfigError, match=message):
        module.ClusterPool("tcp", [])


def test_a_worker_that_cannot_import_is_told(cluster, monkeypatch):
    module, client = cluster

    def fail(function: Any) -> None:
        raise ImportError("none")

    monkeypatch.setattr(client, "run", fail)
    with pytest.raises(ConfigError, match=r"tcp: a worker cannot import this bench: ImportError\('none'\)"):
        module.ClusterPool("tcp", [])


def test_a_module_is_sent_as_it_is_and_a_package_packed(cluster, monkeypatch, tmp_path):
    module, client = cluster
    (tmp_path / "own_small").mkdir()
    for name in ("own_single.py", "own_small/__init__.py"):
        (tmp_path / name).write_text("")
    monkeypatch.syspath_prepend(tmp_path)
    uses = ("own_single:X", "own_small:X", "loose-15")
    module.ClusterPool("tcp", [EstimatorChoice(use, "x") for use in uses])
    assert client.sent == [("own_single.py", False), ("own_small.zip", False)]


def test_packages_that_were_sent_are_on_the_import_path_once(cluster, monkeypatch, tmp_path):
    module, _ = cluster
    for name in ("b.zip", "a.zip", "c.py"):
        (tmp_path / name).write_text("")
    monkeypatch.setattr("distributed.get_worker", lambda: SimpleNamespace(local_directory=str(tmp_path)))
    monkeypatch.setattr(sys, "path", ["first"])
    for _ in range(2):
        assert module.call(VERSIONS, double, 3) == 6
    assert sys.path == ["first", str(tmp_path / "a.zip"), str(tmp_path / "b.zip")]
