"""Python does what the verbs do: run is its four steps, what was made is saved and read back, and an argument
that would have no effect is rejected."""

import inspect
import re
from dataclasses import fields, is_dataclass

import numpy as np
import pytest

import bench
from bench import pipeline
from bench.cli.command_line import commands
from bench.core.records.instruments import InstrumentReports
from bench.core.words import notebook
from bench.core.words.exceptions import ConfigError
from tests.test_words import LONGEST, MARKS, list_sentences, take_prose

FUNCTIONS = {
    "allan": "measure_allan",
    "campaign": "campaign",
    "card": "make_card",
    "check": "check",
    "compare": "compare_results",
    "convert": "convert_unit",
    "export": "export_run",
    "fixes": "solve_rinex",
    "fly": "fly",
    "list": "list_profiles",
    "navigate": "navigate",
    "report": "write_report",
    "run": "run",
    "score": "score_solution",
    "serve": "serve",
    "stream": "stream_run",
    "study": "study",
    "tune": "tune",
}
"""Verb -> what does it from Python."""
WITHOUT = {
    "record": "`write_result` writes the recording of a result",
    "show": "prints what `read_result` and `read_campaign` return",
    "cache": "looks after files of this machine",
    "guide": "shows pages",
    "new": "writes a starting point to edit",
    "view": "opens a window",
    "upgrade": "rewrites files of an earlier format",
    "warm": "compiles for this machine",
}
"""Verb without a function -> why."""

SHORT = {
    "duration_s": 20.0,
    "evaluation.from_s": 5.0,
    "gnss_outage": [],
    "leg": [{"kind": "straight", "duration_s": 5.0}],
}


@pytest.fixture(scope="module")
def profile():
    return bench.read_profile("figure-eight", SHORT, seed=3, estimators=["loose-15"])


def test_run_is_fly_sense_navigate_judge(profile):
    result = bench.run(profile)
    truth = bench.fly(profile)
    sensed = bench.sense(profile, truth)
    solution = bench.run_filter("loose-15", sensed.data, sensed.initial)
    errors, metrics = bench.evaluate(profile, truth, solution, sensed)
    np.testing.assert_array_equal(result.solutions["loose-15"].lla, solution.lla)
    np.testing.assert_array_equal(result.errors["loose-15"].pos_n, errors.pos_n)
    judged = result.metrics["loose-15"]
    assert {name: judged[name] for name in metrics} == metrics
    words = {
        "unmodeled_errors",
        "verdict",
        "verdict_reason",
        "verdict_text",
        "coverage_text",
        "drift_text",
        "outside",
    }
    assert judged.keys() - metrics.keys() == words
    assert result.seed == 3
    assert result.provenance["inputs"]["truth"]
    given = pipeline.run(profile, truth=truth).provenance["inputs"]
    assert given == {**result.provenance["inputs"], "truth": None}


def test_every_verb_has_its_function():
    assert set(commands.list_commands(None)) == FUNCTIONS.keys() | WITHOUT.keys()
    for name in FUNCTIONS.values():
        assert callable(getattr(bench, name))
        assert name in dir(bench)


def test_a_result_is_saved_and_read_back_with_its_truth_and_sensors(profile, tmp_path):
    result = bench.run(profile)
    assert result.events.select("leg")
    folder = bench.write_result(result, tmp_path / "short")
    assert (folder / "flight.rrd").is_file()
    loaded = bench.read_result(folder)
    np.testing.assert_array_equal(loaded.truth.lla, result.truth.lla)
    np.testing.assert_array_equal(loaded.sensors.fixes.lla, result.sensors.fixes.lla)
    again = bench.run_filter("loose-15", loaded.sensors, loaded.sensed.initial)
    np.testing.assert_array_equal(again.cov, result.solutions["loose-15"].cov)
    with pytest.raises(ConfigError, match="exists"):
        bench.write_result(result, folder)
    copy = bench.write_result(loaded, tmp_path / "copy")
    assert (copy / "flight.rrd").is_file()
    assert bench.read_result(copy).metrics == loaded.metrics


def test_another_draw_is_another_result(profile):
    first, second = (bench.run(profile, run=run).metrics["loose-15"]["pos_rmse_h_m"] for run in (0, 1))
    assert first != second


@pytest.mark.parametrize(
    "argument", [{"seed": 1}, {"estimators": ["loose-15"]}, {"sensors": {"imu": "stim300"}}]
)
def test_arguments_without_effect_are_refused(profile, argument):
    with pytest.raises(ConfigError, match="cannot be combined with a loaded profile"):
        bench.run(profile, **argument)


@pytest.mark.parametrize("run", [-1, 1.5])
def test_a_draw_is_a_whole_number(profile, run):
    with pytest.raises(ConfigError, match="must be a whole number, at least 0"):
        bench.run(profile, run=run)


def test_a_unit_is_exchanged_by_name():
    profile = bench.read_profile("figure-eight", {**SHORT, "sensors.imu": "stim300"})
    assert profile.sensors.imu.name == "stim300"
    assert "run" in dir(bench)
    with pytest.raises(AttributeError, match="has no attribute 'fligh'"):
        bench.fligh  # noqa: B018


def test_a_list_that_is_a_text_and_a_profile_that_is_none_are_one_line():
    for call, message in (
        (lambda: bench.run("figure-eight", estimators="loose-15"), r"give a list: \['loose-15'\]"),
        (lambda: bench.run(42), "profile = 42 must be a name or the path"),
        (lambda: bench.fly(3.5), "profile = 3.5 must be a name or the path"),
        (lambda: bench.run("figure-eight", sensors="stim300"), "must be a mapping"),
    ):
        with pytest.raises(ConfigError, match=message) as caught:
            call()
        assert len(str(caught.value).splitlines()) == 1


def test_a_campaign_asks_for_the_name_of_a_profile_that_is_read_already(profile):
    with pytest.raises(ConfigError, match="'figure-eight' is read already; give its name") as caught:
        bench.campaign(profile, 2)
    assert len(str(caught.value)) < 200


def test_overrides_and_seed_are_those_of_load_profile_in_every_step(profile):
    own = {"seed": 3, "overrides": SHORT}
    truth = bench.fly("figure-eight", **own)
    np.testing.assert_array_equal(truth.lla, bench.fly(profile).lla)
    sensed = bench.sense("figure-eight", truth, **own)
    np.testing.assert_array_equal(sensed.data.imu.dvel_b, bench.sense(profile, truth).data.imu.dvel_b)
    result = bench.run("figure-eight", estimators=["loose-15"], **own)
    errors, metrics = bench.evaluate("figure-eight", truth, result.solutions["loose-15"], **own)
    assert metrics["pos_rmse_h_m"] == result.metrics["loose-15"]["pos_rmse_h_m"]
    assert len(errors) == 201
    with pytest.raises(ConfigError, match="seed and overrides cannot be combined"):
        bench.fly(profile, seed=4)


def test_every_result_shows_itself_on_one_screen_and_as_a_frame(profile):
    result = bench.run(profile)
    for one in (profile, result, result.truth, result.sensed, result.sensors, result.sensed.initial,
                result.sensors.imu, result.errors["loose-15"], result.solutions["loose-15"]):  # fmt: skip
        shown = repr(one)
        assert len(shown) < 1600
        assert shown.count("\n") < 24
    assert "4000 rows, t = 0.005 to 20 s" in repr(result.sensors.imu)
    frame = result.frame()
    assert frame.loc["pos_rmse_h_m", "loose-15"] == result.metrics["loose-15"]["pos_rmse_h_m"]
    assert result.plot().axes


def test_what_draws_a_result_is_set_by_the_views(monkeypatch):
    monkeypatch.setattr(notebook, "_drawers", [])
    with pytest.raises(RuntimeError, match="it draws results"):
        notebook.draw(None)
    notebook.set_drawer(lambda result, *chosen, **look: (result, chosen, look))
    assert notebook.draw(1, "position", form="pdf") == (1, ("position",), {"form": "pdf"})


PUBLIC = [name for name in bench.__all__ if name[0] != "_"]
EMPTY = ("ConfigError", "EstimatorError", "FlightError")
"""Names whose first line says all: the errors, which have what `BenchError` has."""


def read_names(doc: str, section: str) -> set[str]:
    """Return the names of the entries of a section of a docstring."""
    found = re.search(rf"^{section}\n-+\n(.*?)(?=\n\n\w[\w ]*\n---|\Z)", doc, re.DOTALL | re.MULTILINE)
    heads = re.findall(r"^(\S[^:\n]*?)(?: : .*)?$", found[1], re.MULTILINE) if found else []
    return {name.lstrip("*") for head in heads for name in head.split(", ")}


@pytest.mark.parametrize("name", [name for name in PUBLIC if name not in EMPTY])
def test_a_public_name_explains_all_of_itself_and_has_an_example(name):
    one = getattr(bench, name)
    doc = inspect.getdoc(one) or ""
    assert ">>> " in doc.partition("Examples\n--------\n")[2]
    if inspect.isfunction(one):
        signature = inspect.signature(one)
        assert read_names(doc, "Parameters") == set(signature.parameters)
        returns = signature.return_annotation not in ("None", None)
        assert ("\nReturns\n---" in doc or "\nYields\n---" in doc) == returns
    elif is_dataclass(one):
        own = {field.name for field in fields(one) if not hasattr(InstrumentReports, field.name)}
        assert own <= read_names(doc, "Attributes")


@pytest.mark.parametrize("name", PUBLIC)
def test_a_public_docstring_reads_as_english_of_the_field(name):
    doc = inspect.getdoc(getattr(bench, name)) or ""
    text = doc.partition("\nExamples\n---")[0]
    first = text.partition("\n")[0]
    assert first.endswith((".", "``"))
    for pattern, _ in MARKS.values():
        assert not re.search(pattern, text, re.IGNORECASE), f"{name}: {pattern}"
    assert not re.search(r"\b(?:as for|judges?|believes?|unless it is told)\b", text, re.IGNORECASE)
    text = re.sub(r"^(?:\S.*\n(?= {4})|[\w ]+\n-+\n)", "\n", text, flags=re.MULTILINE)  # heads of entries
    assert [one for one in list_sentences(take_prose(text)) if len(one.split()) > LONGEST] == []


def test_entries_of_a_section_are_found():
    doc = "Do.\n\nParameters\n----------\na, b : int\n    Two.\n*rest\n    More.\n"
    doc += "\nReturns\n-------\nint\n    One."
    assert read_names(doc, "Parameters") == {"a", "b", "rest"}
    assert read_names(doc, "Returns") == {"int"}
