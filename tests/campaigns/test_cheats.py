"""Each way to cheat, and each consistent mistake, is on the card of a small filter that commits it."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

import bench
from bench.cli.command_line import main
from bench.cli.verbs import guide
from bench.core.records.specs import Guard
from bench.core.words.exceptions import ConfigError
from bench.experiments.campaigns import running
from bench.experiments.campaigns.pools import ExecutorPool, SerialExecutor
from bench.experiments.campaigns.worker import hash_answers
from bench.experiments.card import card_causality, card_making, card_suite
from bench.experiments.card.card_causality import judge_causality
from bench.experiments.card.card_lines import CONVENTIONS, UNPROVEN, Line, Rows
from bench.experiments.card.card_suite import LATE, Suite, SuiteFlight, vary_flight
from bench.io.config import read_profile
from tests.campaigns import cheats
from tests.campaigns.cheat_table import CHEATS
from tests.campaigns.test_campaign import PROFILE

DRAWS = 3
SPOOF = {
    "kind": "spoofing", "start_s": 8.0, "duration_s": 3.0, "step_m": [400.0, 0.0, 0.0]
}  # fmt: skip
HALF_A_SECOND = {"kind": "latency", "sensor": "gnss", "start_s": 0.0, "duration_s": 20.0, "added_s": 0.5}
PLAIN = SuiteFlight("plain", "short.toml", {"sensors.gnss": "matched-white"})
LATE_FLIGHT = SuiteFlight(LATE, "short.toml", {"fault": [HALF_A_SECOND]})
HERE = Guard(in_process=True)


@pytest.fixture(scope="module")
def place(tmp_path_factory):
    """A folder with a flight of 20 s."""
    folder = tmp_path_factory.mktemp("cheats")
    (folder / "short.toml").write_text(PROFILE)
    return folder


@pytest.fixture(autouse=True)
def here(place, monkeypatch):
    """Cards of three runs of this flight, made in this process."""
    monkeypatch.chdir(place)
    monkeypatch.setattr(running, "choose_pool", lambda *_: ExecutorPool(SerialExecutor(), 1))
    use_flights(monkeypatch, PLAIN)


def use_flights(monkeypatch, *members: SuiteFlight, runs: int = DRAWS) -> None:
    monkeypatch.setattr(card_making, "QUICK", Suite("card-quick", (), draws=runs, members=members))


def judge(name: str, **options) -> card_making.Card:
    return bench.make_card(
        f"tests.campaigns.cheats:{name}", **{"against": "loose-15", "quick": True, "guard": HERE, **options}
    )


def find(found: card_making.Card, topic: str, flight: str = "plain") -> Line:
    return next(one for one in found.lines if (one.flight, one.topic) == (flight, topic))


@pytest.mark.parametrize(
    ("name", "reason"),
    [
        ("TooHigh", "height error is 5"),
        ("SinksOnPaper", "velocity error is 2"),
        ("HeadsWrong", "heading error is 9"),
        ("Frozen", "horizontal error is 19"),
        ("AnswersWhereItIsSure", "run 0: answers 60"),
        ("LosesItsHeading", "attitude is not finite"),
        ("SpeaksLate", "no solution before t = 14 s"),
        ("ClaimsWhereItIsSure", "covariance is not finite"),
        ("ClaimsToBeExact", "covariance is not positive definite"),
        ("StampsItsOwnTimes", "failed: its t must be sensors.output_t"),
        ("AnswersTwice", "failed: its t must be sensors.output_t"),
    ],
)
def test_no_draw_of_it_converges(name, reason):
    found = judge(name)
    line = find(found, "convergence")
    assert line.value == 0.0
    assert f"converged in 0 of {DRAWS} runs; run 0: " in line.sentence
    assert reason in line.sentence
    assert f"converged in 0 of {DRAWS} runs" in found.summary
    assert [one.draw for one in found.lost] == list(range(DRAWS))
    assert not found.good
    share = find(found, "coverage").value
    assert share == pytest.approx(
        {"AnswersWhereItIsSure": 0.5, "LosesItsHeading": 0.7}.get(name, share), abs=0.2
    )
    if name == "SpeaksLate":
        assert found.lines[1].sentence == "plain: first answer after 14 s at most."


def test_alarms_outside_faults_are_counted(monkeypatch):
    use_flights(monkeypatch, SuiteFlight("spoofed", "short.toml", {"fault": [SPOOF]}))
    always = judge("AlwaysAlarms")
    assert find(always, "alarms", "spoofed").value > 0.99
    assert "in alarm for 100" in find(always, "alarms", "spoofed").sentence
    noticed = [one for one in always.lines if one.topic == "faults"][-1]
    assert noticed.sentence == f"spoofed: detected {DRAWS} of {DRAWS} faults."
    use_flights(monkeypatch, PLAIN)
    assert find(judge("AlwaysAlarms"), "alarms").value > 0.99
    assert find(judge("AlarmsInTurns"), "alarms").value == pytest.approx(0.5, abs=0.05)
    assert find(judge("Wrong"), "alarms").value == 0.0


def test_a_claim_that_is_right_in_the_mean_alone_is_uneven():
    """Too narrow at half of the epochs, too wide at the others: the mean NEES is right."""
    honest, swings = (find(judge(name), "honesty") for name in ("Wrong", "Swings"))
    assert swings.value == pytest.approx(honest.value, rel=0.05)
    assert (honest.word != "uneven", swings.word) == (True, "uneven")
    assert "uneven, in the central 95 % of its distribution for" in swings.sentence


def test_who_knows_the_truth_is_below_the_bound_and_an_honest_filter_is_not():
    """The bound is the covariance of the best linear filter; a matched one comes near it."""
    cheat = judge("KnowsTheTruth")
    line = find(cheat, "accuracy")
    assert line.word == "impossible"
    assert "no causal filter can; it has the future, or the truth" in line.sentence
    assert not cheat.good
    assert "below the bound of causal filters in 2 figures" in cheat.summary
    profile = read_profile("short.toml", PLAIN.values, estimators=["loose-15"])
    least = bench.run(profile, bound=True).metrics["loose-15"]["bound"]
    by_name = {row["quantity"]: row["bound"] for row in least}
    assert line.over_bound[0] == pytest.approx(0.1 / by_name["horizontal position"], rel=0.05)
    honest = bench.make_card("loose-15", against="loose-22", quick=True)
    assert not [one for one in honest.lines if one.word == "impossible"]
    assert find(honest, "heading").over_bound is not None
    assert honest.good


@pytest.mark.slow
def test_what_a_filter_averages_over_runs_is_of_no_use(monkeypatch):
    """50 runs, each with its own wind and heading: it gains at most 2 %, where 50 of one truth gain much."""
    use_flights(monkeypatch, PLAIN, runs=50)
    ratio = find(judge("Averages"), "accuracy").value
    assert ratio > 0.98
    cheats._WAYS.clear()
    same = vary_flight(PLAIN, 0)
    monkeypatch.setattr(card_suite, "vary_flight", lambda flight, draw, seed: {**same, "seed": draw})
    assert find(judge("Averages"), "accuracy").value < 0.9


# --- the future -------------------------------------------------------------------------------------------


def test_fixes_taken_before_they_arrive_are_seconds_of_the_future(monkeypatch):
    use_flights(monkeypatch, LATE_FLIGHT)
    early, honest = (find(judge(name, audit=7), "causality", LATE) for name in ("TakesFixesEarly", "Wrong"))
    assert early.value == pytest.approx(0.5, abs=0.05)
    assert early.sentence.startswith(f"{LATE}: uses the future: 0.4")
    assert honest.value == 0.0
    assert honest.sentence.startswith(f"{LATE}: uses the future: no; other data after ")


def test_who_looks_ahead_on_other_flights_only_is_found(monkeypatch):
    use_flights(monkeypatch, LATE_FLIGHT, PLAIN)
    found = judge("SmoothsOnTime")
    assert find(found, "causality", LATE).sentence.startswith(
        f"{LATE}: uses the future: the whole record, on plain; audit "
    )
    assert not found.good
    line = find(judge("Wrong", audit=7), "causality", LATE)
    told, chance, audited = line.sentence.split("; ")[1:]
    assert re.fullmatch(r"other data after \d+ times in 2 runs, not confined", told)
    assert chance == "a look-ahead in 1 of 10 runs is found with 19 %"
    assert re.fullmatch(r"audit 7, [\d.e+-]+ times the CPU\.", audited)


def test_what_a_filter_remembers_of_other_runs_tells_it_no_future(monkeypatch):
    """Each run of the proof has a process of its own."""
    monkeypatch.setattr(card_causality, "_MOST", 2)
    use_flights(monkeypatch, PLAIN, runs=2)
    line = find(judge("Remembers", guard=Guard()), "causality")
    assert line.value > 0.0
    assert line.sentence.startswith("plain: uses the future: the whole record; audit ")


def test_what_is_proven_are_the_answers_of_the_card(monkeypatch):
    """Other answers in another process: the proof would be of another filter."""
    use_flights(monkeypatch, PLAIN, runs=2)
    found = judge("Throws", guard=Guard())
    line = find(found, "causality")
    assert (line.value, line.word) == (None, UNPROVEN)
    assert "it is not repeatable" in line.sentence
    assert not found.good
    assert "not repeatable" in found.summary


def list_rows(label: str) -> list[Rows]:
    draws = (vary_flight(PLAIN, draw) for draw in range(2))
    results = [bench.run(read_profile("short.toml", values, estimators=[label])) for values in draws]
    hashes = [hash_answers(one.solutions[label]) for one in results]
    return [[{"converged": True, "answers": text} for text in hashes]]


def test_a_smoother_is_marked_and_files_prove_nothing(monkeypatch):
    use_flights(monkeypatch, PLAIN, runs=2)
    Path("answers").mkdir(exist_ok=True)
    plan, labels = card_making.plan_card(card_making.QUICK, "smoother", "file:answers", HERE)
    told = [
        judge_causality(plan, card_making.QUICK, label, list_rows(label), 1.0)
        for label in labels
        if "ans" not in label
    ]
    assert told[0].sentence.startswith("plain: uses the future: the whole record; audit ")
    assert told[1].sentence.startswith("plain: uses the future: no; fed in pieces in 1 run; a look-ahead")
    files = judge_causality(plan, card_making.QUICK, labels[1], [[{"answers": "x"}]], 1.0)
    assert files.sentence == "plain: uses the future: not proven, its solution is a file."
    assert files.word == ""


# --- conventions ------------------------------------------------------------------------------------------


def test_a_filter_that_looks_like_a_wrong_convention_is_told_so_with_one_constant_for_all_draws():
    late, enu, honest, high = (
        [line for line in judge(name).lines if line.topic == CONVENTIONS]
        for name in ("IsLate", "SpeaksEnu", "Wrong", "Frozen")
    )
    assert "time offset" in late[0].figure
    assert "looks like answers that are 0.1" in late[0].sentence
    assert late[0].sentence.endswith(f"with the same constants in {DRAWS} runs.")
    assert enu[0].figure == "velocities east, north, up"
    assert (honest, high) == ([], [])


# --- options and requirements -----------------------------------------------------------------------------


def test_options_a_label_and_what_is_required_are_on_the_card(capsys):
    Path("need.toml").write_text(
        "[[requirement]]\nmetric = 'pos_rmse_h_m'\nmost = 0.001\nshare = 0.9\n"
        "[[requirement]]\nmetric = 'pos_rmse_h_m'\nmost = 100.0\nshare = 0.1\nflight = 'plain'\n"
    )
    own = ["card", "-e", "tests.campaigns.cheats:Gain", "--against", "loose-15", "--quick", "--in-process"]
    more = ["--option", "gain=100.0", "--label", "wide", "-o", "wide.json", "--require", "need.toml"]
    assert main([*own, *more, "--junit", "need.xml", "--force"]) == 1
    found = bench.read_card(Path("wide.json"))
    assert (found.estimator, found.options) == ("wide", {"gain": 100.0})
    assert re.search(r" --in-process --seed \d+ --run 0$", found.commands["plain"])
    once = bench.make_card("loose-15", against="loose-22", quick=True)
    ratio = find(found, "honesty").value / find(once, "honesty").value
    assert ratio == pytest.approx(1e-4, rel=1e-6)
    assert find(found, "honesty").word == "undecided"  # three runs
    assert find(found, "accuracy").by_draw == find(once, "accuracy").by_draw
    assert found.answers != once.answers
    words = [line.word for line in found.lines if line.topic == "requirements"]
    assert words == ["missed", "met"]
    assert "wide: pos_rmse_h_m is at most 0.001 m in 0 of 3 runs" in capsys.readouterr().out
    assert Path("need.xml").read_text().count("<testcase") == 2
    assert Path("cards/wide-quick/journal.jsonl").is_file()
    assert card_making.verify_card(found, guard=HERE) == []
    other = judge("Gain", label="one")
    assert (other.program != found.program, other.answers == once.answers) == (True, True)
    Path("need.toml").write_text("[[requirement]]\nmetric = 'pos_rmse_h_m'\nmost = 1.0\nflight = 'moon'\n")
    assert main([*own, "--require", "need.toml"]) == 2
    assert "need.toml: [[requirement]] 1: no flight 'moon'; there are plain" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("uses", "label", "options", "labels"),
    [
        (("loose-15", "loose-22"), None, None, ("loose-15", "loose-22")),
        (("loose-15", "loose-15"), None, None, ("loose-15", "loose-15")),
        (("free-inertial", "loose-22"), None, None, ("free-inertial", "loose-22")),
        (("loose-15", "free-inertial"), "wide", None, ("wide", "free-inertial")),
        (("loose-15", "loose-22"), "wide", {}, ("wide", "loose-22")),
        (("tests.campaigns.cheats:Gain", "loose-22"), None, {"gain": 2.0}, ("Gain", "loose-22")),
    ],
)
def test_the_estimators_of_a_card_have_their_labels(uses, label, options, labels):
    plan, found = card_making.plan_card(card_making.QUICK, *uses, HERE, label, options)
    assert found == (*labels, "free-inertial")
    assert set(found) == set(plan.cells[0].profile.labels)
    said = "^the card already has a filter 'loose-15'; use --label to rename yours$"
    for own, name in (("loose-22", "loose-15"), ("loose-15", None)):
        with pytest.raises(ConfigError, match=said):
            card_making.plan_card(card_making.QUICK, own, "loose-15", HERE, name, {"baro": False})


def test_the_guide_has_a_row_for_each_cheat_of_its_table():
    page = (guide.FOLDER / "card-scores.md").read_text(encoding="utf-8")
    table = page.partition("| who | what the card says |\n|---|---|\n")[2].partition("\n\n")[0]
    assert [row.split(" | ")[0].removeprefix("| ") for row in table.splitlines()] == [
        one.words for one in CHEATS
    ]
