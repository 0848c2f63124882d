"""Filters on many logs: which is better is said of all logs together, and of none that hides its losses."""

from __future__ import annotations

import numpy as np
import pytest
from rich.console import Console
from scipy import stats

import bench
from bench.cli.command_line import main
from bench.cli.verbs.check_verb import list_sources
from bench.cli.verbs.log_campaign import are_logs
from bench.core.words.exceptions import DONE, NEGATIVE, WRONG
from bench.experiments.studies import recorded_logs
from bench.experiments.studies.recorded_logs import LogResult, compare_filters, name_logs
from bench.io.results.study_folder import read_study
from tests.exchange import drives

LABELS = ("first", "second")


def rows(first, second):
    """Return the results of two filters by log; NaN is a log that a filter lost."""
    return [
        LogResult(f"log {k}", label, "", "", bool(np.isfinite(value)), {"horizontal_m": float(value)})
        for k, pair in enumerate(zip(first, second, strict=True))
        for label, value in zip(LABELS, pair, strict=True)
    ]


def test_a_filter_twice_as_good_everywhere_is_better_and_by_how_much():
    errors = np.array([0.1, 1.0, 10.0, 3.0, 0.5])
    scatter = np.exp([0.02, -0.02, 0.01, 0.0, -0.01])
    ((name, label, ratio, logs, word),) = compare_filters(rows(errors, 0.5 * errors * scatter), LABELS)
    assert (name, label, logs, word) == ("horizontal_m", "second", 5, "better")
    assert ratio.value == pytest.approx(0.5, rel=1e-6)
    half = stats.t.ppf(0.975, 4) * np.log(scatter).std(ddof=1) / np.sqrt(5.0)
    assert np.log(ratio.high / ratio.value) == pytest.approx(half, rel=1e-6)


def test_a_filter_that_leaves_out_the_logs_it_would_lose_is_not_better():
    errors = np.array([0.1, 1.0, 10.0, 3.0, 0.5, 2.0])
    chosen = np.where(errors > 5.0, np.nan, 0.5 * errors * np.exp(0.01 * np.arange(6)))
    ((*_, logs, word),) = compare_filters(rows(errors, chosen), LABELS)
    assert logs == 5
    assert word == "undecided: it lost logs that the other kept"
    ((*_, word),) = compare_filters(rows(chosen, errors), LABELS)
    assert word == "undecided: it lost logs that the other kept"
    ((*_, word),) = compare_filters(rows(errors, np.where(errors < 0.2, np.nan, 2.1 * errors**1.01)), LABELS)
    assert word == "worse"


def test_equal_filters_are_seldom_told_apart():
    """300 pairs of 12 logs, four quantities: any false word in at most 5 %, by the 99.9 % band."""
    rng, false = np.random.default_rng(5), 0
    for _ in range(300):
        found = [
            LogResult(f"log {k}", label, "", "", good=True, values=dict(zip("abcd", values, strict=True)))
            for k in range(12)
            for label in LABELS
            for values in [np.exp(0.3 * rng.standard_normal(4)).tolist()]
        ]
        false += any(word != "undecided" for *_, word in compare_filters(found, LABELS))
    assert 1 <= false <= stats.binom.ppf(0.9995, 300, 0.05)


def test_two_logs_tell_nothing_of_scatter():
    assert list(compare_filters(rows([1.0, 2.0], [0.5, 1.0]), LABELS)) == []


def test_logs_have_the_shortest_names_that_tell_them_apart(tmp_path):
    paths = [tmp_path / "a" / "one.toml", tmp_path / "b" / "one.toml"]
    assert name_logs(paths) == ["a/one", "b/one"]
    assert name_logs([*paths[:1], tmp_path / "b" / "two.toml"]) == ["one", "two"]


def test_filters_run_side_by_side_on_a_folder_of_logs(tmp_path, capsys):
    """A log that cannot be read is a row with its reason, and the other logs have their results."""
    folder = tmp_path / "drives"
    for name in ("one", "two", "three"):
        (folder / name).mkdir(parents=True)
        drives.write_log(folder / name).rename(folder / name / f"{name}.toml")
    (folder / "two" / "imu.csv").unlink()
    logs = [str(folder / name) for name in ("one", "two", "three")]
    out = tmp_path / "out"
    assert (
        main(["campaign", *logs, "-e", "loose-15", "-e", "gnss-only", "--jobs", "1", "-o", str(out)])
        == NEGATIVE
    )
    said = capsys.readouterr().out
    assert "loose-15, 3 logs:" in said
    assert "two: " in said
    assert "imu.csv" in said.partition("two: ")[2]
    table = read_study(out).tables["logs"].columns
    assert table["log"] == ["one", "one", "two", "three", "three"]
    plain = bench.navigate(bench.read_log(folder / "one" / "one.toml", estimators=["loose-15"]), outages=None)
    assert table["horizontal_m"][0] == pytest.approx(plain.metrics["loose-15"]["pos_rmse_h_m"])
    assert (out / "report.html").is_file()


@pytest.mark.parametrize(
    ("given", "says"),
    [
        (
            ["{log}", "figure-eight", "-o", "x"],
            "figure-eight is not a log. Put several profiles into CAMPAIGN",
        ),
        (["{log}", "--runs", "3", "-o", "x"], "--runs is for profiles, not for logs"),
        (["{log}", "--timeout", "3", "-o", "x"], "--timeout is for profiles, not for logs"),
        (["{log}"], "name the folder for the results of logs: -o DIR"),
        (["{log}", "{log}", "-o", "x"], "is given twice; it would count as two trials"),
        (["{pair}", "-o", "x"], "would share a.toml; rename one"),
        (["{empty}", "-o", "x"], "no LOG.toml in this folder"),
    ],
)
def test_what_logs_do_not_have_is_refused_in_a_line(tmp_path, capsys, monkeypatch, given, says):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "empty").mkdir()
    (tmp_path / "pair").mkdir()
    for name in ("a.bin", "a.ulg"):
        (tmp_path / "pair" / name).write_bytes(b"")
    places = {
        "pair": str(tmp_path / "pair"),
        "log": str(drives.write_log(tmp_path)),
        "empty": str(tmp_path / "empty"),
    }
    assert main(["campaign", *(one.format(**places) for one in given)]) == WRONG
    said = capsys.readouterr().err
    assert says in said
    assert said.count("\n") == 1


def test_a_recording_that_cannot_be_read_is_a_row_with_status_1(tmp_path, capsys):
    drives.write_log(tmp_path)
    (tmp_path / "broken.ulg").write_bytes(b"nothing")
    given = ["campaign", str(tmp_path), "-e", "gnss-only", "--jobs", "1", "-o", str(tmp_path / "o")]
    assert main(given) == NEGATIVE
    assert "broken.ulg" in capsys.readouterr().out
    table = read_study(tmp_path / "o").tables["logs"].columns
    assert dict(zip(table["log"], table["verdict"], strict=True))["broken"] == "no result"


def test_datasheets_beside_logs_are_no_logs(tmp_path):
    """The shell finds them by *.toml."""
    log = drives.write_log(tmp_path)
    files = sorted(str(path) for path in tmp_path.glob("*.toml"))
    assert len(files) == 4
    assert main(["campaign", *files, "-e", "gnss-only", "--jobs", "1", "-o", str(tmp_path / "o")]) == DONE
    given = ["check", *files, "-e", "gnss-only", "--baselines", str(tmp_path / "b"), "--jobs", "1"]
    assert main([*given, "--record", "--reason", "new"]) == DONE
    assert [path.stem for path in (tmp_path / "b").glob("*.json")] == [log.stem]
    assert main(given) == DONE


def test_a_change_names_the_logs_of_a_folder_that_got_worse(tmp_path, capsys):
    """Of two logs one gets a wrong lever arm; a recording that cannot be read is said and left out."""
    folder = tmp_path / "fleet"
    for name in ("one", "two"):
        (folder / name).mkdir(parents=True)
        drives.write_log(folder / name).rename(folder / name / f"{name}.toml")
    (folder / "two" / "broken.ulg").write_bytes(b"nothing")
    given = ["check", str(folder / "one"), str(folder / "two"), "-e", "loose-15"]
    given += ["--baselines", str(tmp_path / "b"), "--jobs", "1"]
    assert main([*given, "--record", "--reason", "new"]) == DONE
    assert sorted(path.stem for path in (tmp_path / "b").glob("*.json")) == ["one", "two"]
    assert "no log: " in capsys.readouterr().out
    assert main(given) == DONE
    assert "the same on all 2" in capsys.readouterr().out
    log = folder / "two" / "two.toml"
    log.write_text(log.read_text().replace("[0.4, 0.3, -1.5]", "[9.4, 0.3, -1.5]"))
    assert main(given) == NEGATIVE
    said = capsys.readouterr().out
    assert "worse on 1 of 2 (two)" in said
    assert "the flight differs from" not in said
    (folder / "empty").mkdir()
    assert main(["check", str(folder / "empty")]) == WRONG
    assert "no LOG.toml here" in capsys.readouterr().err


def test_the_name_of_a_profile_wins_over_a_folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "static").mkdir()
    assert not are_logs(["static"])
    assert are_logs([str(tmp_path / "static")])
    assert list_sources(["static"], Console()) == ["static"]


def test_one_log_is_enough_for_a_table(tmp_path):
    drives.write_log(tmp_path)
    assert (
        main(["campaign", str(tmp_path), "-e", "gnss-only", "--jobs", "1", "-o", str(tmp_path / "o")]) == DONE
    )


def test_values_of_a_log_are_those_that_are_known():
    drifts = [
        {"estimator": label, "duration_s": seconds, "median_h_m": 10.0 * seconds}
        for label in LABELS
        for seconds in (10.0, 25.0, 60.0)
    ]
    metrics = {"pos_rmse_h_m": 2.0, "pos_rmse_d_m": None, "vel_rmse_3d_mps": np.inf}
    found = dict(recorded_logs.list_values("first", metrics, drifts))
    assert found == {"horizontal_m": 2.0, "drift_10_s_m": 100.0, "drift_60_s_m": 600.0}, "25 s is no cut"


def test_words_tables_and_pictures_of_logs_by_hand():
    found = [
        LogResult("a", "first", "consistent", "", True, {"horizontal_m": 1.0, "velocity_mps": 0.2}),
        LogResult("a", "second", "overconfident", "", True, {"horizontal_m": 3.0}),
        LogResult("b", "first", "consistent", "", True, {"horizontal_m": 2.0, "drift_10_s_m": 0.0}),
        LogResult("b", "second", "diverged", "1 km off", False, {}),
        LogResult("c", "", "no result", "it is empty", False, {}),
    ]
    ratio = recorded_logs.Estimate(2.0, 1.5, 3.0)
    told = [
        ("horizontal_m", "second", ratio, 5, "worse"),
        ("velocity_mps", "second", ratio, 4, "better"),
        ("drift_10_s_m", "second", ratio, 3, "undecided"),
    ]
    assert list(recorded_logs.tell_logs(found, LABELS, 3, told)) == [
        "first, 3 logs: consistent on 2.",
        "second, 3 logs: overconfident on 1, diverged on 1.",
        "second: horizontal error 2 (1.5 to 3) times that of first on 5 logs"
        ", if no rare large run exists: worse.",
        "second: velocity error 2 (1.5 to 3) times that of first on 4 logs"
        ", if no rare large run exists: better.",
        "1 of 3 comparisons with first are undecided; the table has them.",
        "b, second: 1 km off",
        "c: it is empty",
    ]
    few = list(recorded_logs.tell_logs(found[:1], LABELS, 1, []))
    assert few[0] == "first, 1 log: consistent on 1."
    assert few[-1] == "Fewer than 3 logs have results of both filters: nothing is compared."
    assert not [text for text in recorded_logs.tell_logs(found[:1], LABELS[:1], 1, []) if "Fewer" in text]
    logs, pairs = recorded_logs.tabulate_logs(found, told)
    assert list(logs.columns) == [
        "log",
        "estimator",
        "verdict",
        "horizontal_m",
        "velocity_mps",
        "drift_10_s_m",
    ]
    assert logs.columns["estimator"] == ["first", "second", "first", "second", "-"]
    assert logs.columns["velocity_mps"] == [0.2, None, None, None, None]
    assert pairs.columns["quantity"] == ["horizontal error", "velocity error", "drift in 10 s without GNSS"]
    assert (pairs.columns["low"][0], pairs.columns["high"][0], pairs.columns["logs"][0]) == (1.5, 3.0, 5)
    assert len(list(recorded_logs.tabulate_logs(found, []))) == 1
    plots = {one.path[1]: one for one in recorded_logs.plot_logs(found, LABELS, ["a", "b", "c"])}
    assert list(plots) == ["horizontal", "velocity_mps"], "a drift of 0 has no place on a logarithm"
    first, second = plots["horizontal"].series
    assert (first.t.tolist(), first.values.tolist()) == ([1.0, 2.0], [[1.0], [2.0]])
    assert (second.t.tolist(), second.values.tolist()) == ([1.0], [[3.0]])
    assert first.colors != second.colors
    assert plots["horizontal"].title == "horizontal error [m]"
    assert plots["velocity_mps"].title == "velocity error [m/s]"
    assert plots["horizontal"].ticks == ((1.0, "a"), (2.0, "b"), (3.0, "c"))
