"""The checks of a card, without flights: causality, conventions, comparison, the times of what breaks."""

from __future__ import annotations

import hashlib
import json
from dataclasses import asdict
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import scipy.stats

import bench
from bench.core.records.specs import EstimatorChoice
from bench.core.words.exceptions import EstimatorFailedError
from bench.evaluation.ensembles.regression import Change
from bench.experiments.card import card_causality, card_comparison, card_conventions, card_suite
from bench.experiments.card.card_bound import bound_errors_of
from bench.experiments.card.card_causality import hash_all_answers, judge_causality
from bench.experiments.card.card_comparison import compare_cards, name_cards
from bench.experiments.card.card_lines import SAME, SHARE, Line, write_figure
from bench.experiments.card.card_suite import FULL, LATE, QUICK, VERSION, Suite, SuiteFlight, move_events
from bench.io.config import read_profile
from tests.campaigns.test_campaign import PROFILE
from tests.campaigns.test_card_lines import RARE, make_card, make_line

NO, SOME, MORE = (0.0, "no"), (0.4, "0.4 s"), (2.0, "the whole record")


def make_plan(count: int, choice: EstimatorChoice, draws: int = 1, **profile: Any) -> tuple[Any, Suite]:
    """A plan of flights 0, 1, ... with one filter, of which the second has late fixes."""
    cells = [
        SimpleNamespace(
            condition=k, profile=SimpleNamespace(number=k // draws, estimators=(choice,), **profile)
        )
        for k in range(count * draws)
    ]
    names = ["zero", LATE, "two", "three"][:count]
    suite = Suite("s", (), draws=draws, members=tuple(SuiteFlight(name, "p") for name in names))
    return SimpleNamespace(cells=cells), suite


# --- causality --------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("count", "found", "told", "value", "word"),
    [
        (1, {0: NO}, "zero: uses the future: no; fed in pieces in 1 run; a look-ahead in 1 of 10", 0.0, ""),
        (4, dict.fromkeys(range(4), NO), "runs is found with 34 %; audit 11, 0 times", 0.0, ""),
        (4, {0: NO, 1: NO, 2: MORE, 3: SOME}, "the future: the whole record, on two; audit 11.", 2.0, ""),
        (4, {1: SOME}, f"{LATE}: uses the future: 0.4 s; audit 11.", 0.4, ""),
        (4, {0: "bad", 1: NO}, "future: not proven, bad, on zero; audit 11.", None, "not proven"),
        (2, {1: NO, 0: "y" * 300}, f"not proven, {'y' * 200}, on zero; audit 11.", None, "not proven"),
    ],
)
def test_each_flight_is_examined_until_one_shows_a_look_ahead(monkeypatch, count, found, told, value, word):
    asked = []

    def examine(self: Any, plan: Any, suite: Any, flight: int, own: Any) -> tuple[float, str]:
        asked.append(flight)
        self.fed += 1
        if isinstance(found[flight], str):
            raise EstimatorFailedError(found[flight])
        return found[flight]

    monkeypatch.setattr(card_causality._Audit, "examine", examine)
    plan, suite = make_plan(count, EstimatorChoice("loose-15", "x"))
    line = judge_causality(plan, suite, "x", [[{"answers": "a"}]] * count, 3.0, 11)
    late = 1 if count > 1 else 0
    assert asked == [late, *(k for k in range(count) if k != late)][: len(asked)]
    assert len(asked) == count or found[asked[-1]] != NO
    assert told in line.sentence
    assert (line.flight, line.value, line.low, line.word) == (suite.members[late].name, value, value, word)


def test_runs_and_times_follow_from_the_number_and_from_all_answers(monkeypatch):
    """Nobody knows the number before the answers are given, and with it the audit can be repeated."""
    drawn: list[int] = []

    def examine(self: Any, *_: Any) -> tuple[float, str]:
        drawn.append(int(self.rng.integers(1 << 40)))
        return NO

    monkeypatch.setattr(card_causality._Audit, "examine", examine)
    plan, suite = make_plan(1, EstimatorChoice("loose-15", "x"))
    for answers, number in (("a", 1), ("a", 1), ("b", 1), ("a", 2), ("a", None), ("a", None)):
        judge_causality(plan, suite, "x", [[{"answers": answers}]], 3.0, number)
    assert drawn[0] == drawn[1]
    assert len(set(drawn)) == 5
    digest = hashlib.sha256(b"a None").hexdigest()
    assert hash_all_answers([{"answers": "a"}, {}]) == digest[:16]


# --- conventions ------------------------------------------------------------------------------------------


def test_a_convention_is_searched_in_three_broken_draws_of_a_flight_on_which_nothing_breaks(monkeypatch):
    flown, searched = [], []
    sensed = lambda profile, truth: SimpleNamespace(  # noqa: E731
        data=SimpleNamespace(antenna_b=[profile.number]), initial=truth
    )
    fake = SimpleNamespace(
        fly=lambda profile: next(k % 4 for k, cell in enumerate(plan.cells) if cell.profile is profile),
        sense=sensed,
        navigate=lambda choice, data, draw: flown.append(draw) or draw,
    )
    monkeypatch.setattr(card_conventions, "pipeline", fake)
    rows = [{"convention": "north", "x": 1}, {"convention": "time"}, {"convention": "north"}]
    answer: dict[str, Any] = {"looks_like": rows, "why_text": "Looks like north."}
    monkeypatch.setattr(card_conventions, "find_mistakes", lambda *given: searched.append(given) or answer)
    window = SimpleNamespace(begin=5.0)
    plan, suite = make_plan(
        3, EstimatorChoice("own:X", "x"), 4, evaluation=window, sensors=SimpleNamespace(faults=())
    )
    for cell in plan.cells[:4]:
        cell.profile.sensors = SimpleNamespace(faults=("one",))
    good, bad, wide = {"verdict": "consistent"}, {"verdict": "overconfident"}, {"verdict": "diverged"}
    own = [[bad] * 4, [good, bad, bad, good], [bad, good, wide, bad]]
    (line,) = card_conventions.judge_conventions(plan, suite, "x", own)
    assert line.sentence == "two: looks like north, with the same constants in 3 runs."
    assert (line.flight, line.figure, flown) == ("two", "north and time", [0, 2, 3])
    assert searched == [([0, 2, 3], [0, 2, 3], [2], 5.0)]
    (faulty,) = card_conventions.judge_conventions(plan, suite, "x", [[bad] * 2, [good, bad], [good] * 2])
    assert faulty.sentence == "zero: looks like north, with the same constants in 2 runs."
    assert card_conventions.judge_conventions(plan, suite, "x", [[good, bad]] * 3) == []
    answer.clear()
    assert card_conventions.judge_conventions(plan, suite, "x", own) == []
    built_in, suite = make_plan(1, EstimatorChoice("loose-15", "x"), 4, sensors=SimpleNamespace(faults=()))
    assert card_conventions.judge_conventions(built_in, suite, "x", [[bad] * 4]) == []


# --- the suite --------------------------------------------------------------------------------------------


def test_what_breaks_moves_by_less_than_half_of_its_gaps_and_20_s(monkeypatch):
    """Of gaps of 10, 20, 20, 265 and 80 s to begin, neighbors and end 0.4, at most 20 s."""
    starts, lasts = (0.0, 60.0, 100.0, 130.0, 300.0), (1.0, 10.0, 10.0, 5.0, 20.0)
    document: dict[str, Any] = {
        "fault": [
            {"start_s": a, "duration_s": d, "kind": "x"} for a, d in zip(starts[:4], lasts[:4], strict=True)
        ],
        "gnss_outage": [{"start_s": starts[4], "duration_s": lasts[4]}],
        "duration_s": 400.0,
    }
    profile = SimpleNamespace(document=document, evaluation=SimpleNamespace(begin=50.0))
    monkeypatch.setattr(card_suite, "read_profile", lambda *_, **__: profile)

    def shifts(count: int) -> np.ndarray:
        moved = [move_events(SuiteFlight("f", "p"), seed) for seed in range(count)]
        assert all([row["kind"] for row in one["fault"]] == ["x"] * 4 for one in moved)
        return (
            np.array(
                [[row["start_s"] for key in ("fault", "gnss_outage") for row in one[key]] for one in moved]
            )
            - starts
        )

    found, room = shifts(400), np.array([0.0, 4.0, 8.0, 8.0, 20.0])
    for ends in (found.max(axis=0), -found.min(axis=0)):
        assert (ends <= room + 0.05).all()
        assert (ends >= 0.97 * room).all()
    document["gnss_outage"][0]["start_s"] = 360.0  # 20 s before the end
    starts = (*starts[:4], 360.0)
    assert np.abs(shifts(200)[:, 4]).max() == pytest.approx(8.0, abs=0.2)
    del document["duration_s"]
    assert np.abs(shifts(200)[:, 4]).max() == pytest.approx(20.0, abs=0.3)


def test_a_change_of_the_suite_changes_its_version():
    """Cards of one version compare: whoever changes a flight writes the next version, and its hash here."""
    text = json.dumps([[asdict(one) for one in FULL.members], FULL.draws, QUICK.draws, len(QUICK.members)])
    assert (VERSION, hashlib.sha256(text.encode()).hexdigest()[:16]) == (4, "12dbbbdbc939c4ed")


# --- the bound --------------------------------------------------------------------------------------------


@pytest.fixture
def short(tmp_path, monkeypatch):
    (tmp_path / "short.toml").write_text(PROFILE)
    monkeypatch.chdir(tmp_path)


@pytest.mark.parametrize(
    ("values", "why"),
    [
        ({"sensors.airspeed": "ms4525do"}, "no bound: it knows no airspeed"),
        (
            {"sensors.imu.layout.accel_cone_deg": 3.0},
            "no bound: the linear model needs accelerometers along the axes",
        ),
    ],
)
def test_where_there_is_no_bound_the_reason_is_told(short, values, why):
    found, told = bound_errors_of(read_profile("short.toml", values, estimators=["loose-15"]))
    assert found == {}
    assert told.startswith(why)


def test_who_stands_still_has_no_bound():
    profile = read_profile("static", {"leg.1.duration_s": 70.0}, estimators=["loose-15"])
    assert bound_errors_of(profile) == ({}, "no bound: it stands still, and a filter may know that")


DROPPED = [{"kind": "dropped", "sensor": "imu", "start_s": 9.0, "duration_s": 1.0}]


@pytest.mark.parametrize(
    ("values", "of"),
    [
        ({"fault": DROPPED}, "sensors without faults"),
        ({"alignment.kind": "course", "evaluation.from_s": 12.0}, "a given start and a known attitude"),
        ({"sensors.mag": "rm3100"}, "a known attitude"),
        ({"initial_error_sd.heading_deg": 11.0}, "a known attitude"),
        ({"sensors.mag": "rm3100", "fault": DROPPED}, "sensors without faults and a known attitude"),
    ],
)
def test_what_the_linear_model_lacks_counts_as_known(short, values, of):
    """So the bound is no larger than that of the plain flight; where the attitude is known it has none."""
    plain, found = (
        bound_errors_of(
            read_profile("short.toml", {"evaluation.from_s": 12.0, **one}, estimators=["loose-15"])
        )
        for one in ({}, values)
    )
    assert (plain[1], found[1]) == ("", f"the bound holds for {of}")
    assert set(plain[0]) - set(found[0]) == ({"tilt", "heading"} if "attitude" in of else set())
    for topic, least in found[0].items():
        assert least <= plain[0][topic] * (1.0 + 1e-9), topic


def test_the_bound_of_a_topic_is_that_of_a_run(short):
    """The run is held against it at the same epochs; of velocity it counts the horizontal part alone."""
    profile = read_profile("short.toml", {"sensors.gnss": "matched-white"}, estimators=["loose-15"])
    found, why = bound_errors_of(profile)
    rows = {
        row["quantity"]: row["bound"] for row in bench.run(profile, bound=True).metrics["loose-15"]["bound"]
    }
    titles = {"accuracy": "horizontal position", "height": "height", "tilt": "tilt", "heading": "heading"}
    assert why == ""
    for topic, title in titles.items():
        assert found[topic] == pytest.approx(rows[title], rel=1e-9), topic
    assert rows["horizontal velocity"] < found["velocity"] < 1.5 * rows["horizontal velocity"]


# --- comparison -------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("topic", "figure", "one", "other", "told"),
    [
        ("convergence", "median time [s]", 12.5, None, "heading found after 12.5 s and never"),
        ("coverage", "longest time [s]", None, 2.0, "first answer after never and 2 s"),
        ("coverage", SHARE, 0.25, None, "answers at 25 and 0 % of the epochs"),
        ("causality", "look-ahead [s]", None, 0.5, "look-ahead: not proven and 0.5 s"),
        ("accuracy", "horizontal error", 1.0, 2.0, None),
    ],
)
def test_values_without_a_test_are_told(topic, figure, one, other, told):
    pair = (make_line(topic, value, figure=figure) for value in (one, other))
    assert card_comparison.tell_values(*pair) == told


def test_counts_are_told_without_a_test():
    pair = (
        make_line("faults", 0.5, figure="faults detected", word="count", by_draw=x)
        for x in ((1.0, 0.0, None), (1.0, 1.0, 1.0))
    )
    assert card_comparison.tell_values(*pair) == "faults detected: 1 and 3 of 3"


@pytest.mark.parametrize(
    ("topic", "figure", "flight", "differs", "told"),
    [
        (
            "tilt", "tilt", "f", True,
            f"f: tilt of a 0.500 times that of b (0.500 to 0.500{RARE}): a is better.",
        ),
        ("tilt", "tilt", "f", None, f"f: tilt of a 0.500 times that of b (0.500 to 0.500{RARE})."),
        ("honesty", "NEES", "f", True, "f: NEES is 1.20 and 2.00 times its expectation: a is nearer."),
        (
            "honesty", "NEES", "all flights", True,
            "all flights: NEES of a in a run off by 0.500 times the factor of b (0.500 to 0.500): "
            "a is nearer.",
        ),
    ],
)  # fmt: skip
def test_a_change_is_told(topic, figure, flight, differs, told):
    pair = (make_line(topic, value, figure=figure) for value in (1.2, 2.0))
    found = card_comparison.tell_change(
        ("a", "b"), *pair, flight, Change(np.log(0.5), 0.0, 7.0, 8), 0.05, differs
    )
    assert found.sentence == told
    assert found.better == ("a" if differs else None)
    assert found.values == ((None, None) if flight == "all flights" else (1.2, 2.0))


def test_what_is_not_proven_says_what_would_be_found():
    pair = (make_line("tilt", value) for value in (1.2, 2.0))
    change, t = Change(0.1, 0.1, 7.0, 8), scipy.stats.t(7)
    found = card_comparison.tell_change(("a", "b"), *pair, "f", change, 0.05, differs=False)
    low, high, ratio = np.exp(
        [0.1 - 0.1 * t.ppf(0.975), 0.1 + 0.1 * t.ppf(0.975), 0.1 * (t.ppf(0.975) + t.ppf(0.8))]
    )
    told = f"f: tilt of a 1.11 times that of b ({write_figure(low)} to {write_figure(high)}{RARE})"
    assert (
        found.sentence
        == f"{told}: not proven to differ; a ratio of {write_figure(ratio)} would be found in 80%."
    )
    other = card_comparison.tell_change(
        ("a", "b"), *[make_line("tilt", 1.0)] * 2, "f", change, 0.05, differs=True
    )
    assert other.better == "b"


def test_draws_are_compared_by_the_logs_of_their_ratios():
    """Of NEES by those of the factors between each run and its expectation."""
    x, y = (2.0, 4.0, None, 0.0, 0.5), (1.0, 0.25, 1.0, 1.0, 2.0)
    pair = [make_line("tilt", by_draw=one) for one in (x, y)]
    log2, nan = np.log(2.0), np.nan
    assert card_comparison.list_changes(*pair) == pytest.approx(
        [log2, 4 * log2, nan, nan, -2 * log2], nan_ok=True
    )
    pair = [make_line("honesty", by_draw=one) for one in (x, y)]
    assert card_comparison.list_changes(*pair) == pytest.approx([log2, 0.0, nan, nan, 0.0], nan_ok=True)
    few = [make_line("tilt", by_draw=one) for one in ((1.0, None), (2.0, 2.0))]
    assert card_comparison.list_changes(*few) is None
    assert card_comparison.list_changes(few[1], few[1]).tolist() == [0.0, 0.0]


def test_a_draw_counts_once_on_however_many_flights():
    changes = np.array([[0.1, 0.4, -0.2, np.nan], [0.3, np.nan, 0.5, np.nan]])
    means = [0.1, 0.4]
    by_draw = [(0.0 - 0.1) / 2, 0.3, (-0.3 + 0.1) / 2]
    found = card_comparison.pool_flights(changes)
    assert found.estimate == pytest.approx(np.mean(means))
    assert (found.standard_error, found.dof) == (pytest.approx(scipy.stats.sem(by_draw)), 2)


def make_pair(topic: str, flight: str, x: list[float | None], y: list[float | None]) -> Any:
    one, other = (make_line(topic, flight=flight, by_draw=tuple(each)) for each in (x, y))
    return one, other, card_comparison.list_changes(one, other)


def test_flights_are_tested_on_the_share_of_their_quantity(monkeypatch):
    """Holm: of two quantities 2.5 % and 5 %; of the two flights of one half of its 2.5 %, and all of it."""
    seen = []
    monkeypatch.setattr(
        card_comparison, "tell_change",
        lambda names, one, other, flight, change, *rest: seen.append((one.topic, flight, *rest)),
    )  # fmt: skip
    ones = [1.0, 1.1, 0.9, 1.05, 0.95]
    clear, clearer = [2.0, 2.1, 1.9, 2.0, 2.05], [2.0, 2.2, 1.8, 2.1, 1.9]
    same = [1.01, 1.09, 0.91, 1.04, 0.96]
    quantities = [
        [make_pair("tilt", "f", ones, clear), make_pair("tilt", "g", ones, clearer)],
        [make_pair("height", "f", ones, same), make_pair("height", "g", ones, same)],
        [make_pair("heading", "f", ones, clear)],
    ]
    card_comparison.judge_quantities(("a", "b"), quantities)
    by = {(topic, flight): (level, differs) for topic, flight, level, differs in seen}
    assert by["tilt", "all flights"][1] is by["heading", "f"][1] is True
    assert sorted(by[key][0] for key in (("tilt", "all flights"), ("heading", "f"))) == pytest.approx(
        [0.05 / 3, 0.025]
    )
    assert sorted(by["tilt", x][0] for x in "fg") == pytest.approx([0.05 / 6, 0.05 / 3])
    assert [by["tilt", x][1] for x in "fg"] == [True, True]
    assert by["height", "all flights"] == (pytest.approx(0.05), False)
    assert by["height", "f"] == by["height", "g"] == (pytest.approx(0.05), None)
    assert ("heading", "all flights") not in by


def test_lost_draws_matter_where_a_filter_is_proven_better_alone():
    ones, doubles = [1.0, 1.1, 0.9, 1.05, None], [2.0, 2.1, 1.9, 2.0, 2.0]
    (found,) = card_comparison.judge_quantities(("a", "b"), [[make_pair("tilt", "f", ones, doubles)]])
    told = "a is better in the runs that both have, but lost 1 that b kept: not proven to differ"
    assert (found.sentence, found.better, found.flight) == (
        f"all flights: tilt: {told}.",
        None,
        "all flights",
    )
    (found,) = card_comparison.judge_quantities(("a", "b"), [[make_pair("tilt", "f", doubles, ones)]])
    assert found.sentence.startswith(
        "all flights: tilt: b is better in the runs that both have, but lost 1 that a "
    )
    (found,) = card_comparison.judge_quantities(
        ("a", "b"), [[make_pair("tilt", "f", doubles, [*ones[:4], 1.0])]]
    )
    assert found.better == "b"
    near = [1.1, 1.0, 1.0, 1.0, 1.0]
    (found,) = card_comparison.judge_quantities(("a", "b"), [[make_pair("tilt", "f", ones, near)]])
    assert "f: tilt of a " in found.sentence


@pytest.mark.parametrize(
    ("factor", "same"), [(1.0 + 0.9 * SAME, True), (1.0 + 1.1 * SAME, False), (1.5, False)]
)
def test_values_that_differ_by_the_processor_are_the_same(factor, same):
    assert SAME == 1e-6
    one, other = (make_line("tilt", by_draw=(1.0, x, None)) for x in (2.0 * factor, 2.0))
    assert card_comparison.are_same(one, other) == same
    assert not card_comparison.are_same(one, make_line("tilt", by_draw=(1.0, 2.0)))


@pytest.mark.parametrize("topic", ["robustness", "requirements", "conventions"])
def test_what_is_not_of_the_noise_alone_is_not_compared(topic):
    cards = [make_card(make_line(topic, by_draw=(x, 2.0 * x, 3.0 * x))) for x in (1.0, 2.0)]
    assert compare_cards(*cards, names=("a", "b")) == []


def test_speeds_are_compared_if_both_have_one_and_names_are_those_of_files_if_need_be():
    def with_speed(value: float | None) -> Any:
        return make_card(speed=make_line("speed", value))

    (line,) = compare_cards(with_speed(3.0), with_speed(2.0), ("a", "b"))
    assert (line.sentence, line.values) == ("speed: a takes 1.50 times the CPU of b.", (3.0, 2.0))
    for pair in ((3.0, None), (None, 3.0)):
        assert compare_cards(*map(with_speed, pair), ("a", "b")) == []
    assert compare_cards(with_speed(3.0), make_card(), ("a", "b")) == []
    assert compare_cards(make_card(), with_speed(3.0), ("a", "b")) == []
    cards = [make_card(estimator=name) for name in ("x", "y")]
    assert name_cards(cards, ("p", "q")) == ("x", "y")
    assert name_cards(cards[:1] * 2, ("p", "q")) == ("p", "q")


def test_lines_of_one_card_alone_are_left_out():
    lines: list[Line] = [make_line("tilt", flight=name, by_draw=(1.0, 2.0)) for name in "fg"]
    (line,) = compare_cards(make_card(*lines), make_card(lines[0]), ("a", "b"))
    assert line.sentence == "1 figures are the same in every run."
