"""What each line of a card says, by rows that are written by hand."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
import scipy.stats

from bench.core.words.exceptions import ConfigError
from bench.evaluation.linear.quantities import count_freedom
from bench.experiments.card import card_lines as lines
from bench.experiments.card.card_lines import Line
from bench.experiments.card.card_making import AGAINST, Card, LostDraw, read_card
from bench.experiments.card.card_suite import SuiteFlight

FLIGHT, HURT = SuiteFlight("f", "p"), SuiteFlight("g", "p", {}, "f")
RARE = ", if no rare large run exists"
TURNED = SuiteFlight("h", "p", {"initial_error_sd.heading_deg": 10.0})


def rows(lost: tuple[int, ...] = (), **columns: Any) -> list[dict[str, Any]]:
    """Return a row for each run; ``lost`` did not converge."""
    count = len(next(iter(columns.values())))
    each = {name: list(values) for name, values in columns.items()}
    return [
        {"converged": k not in lost, **{name: column[k] for name, column in each.items()}}
        for k in range(count)
    ]


# --- how many runs ---------------------------------------------------------------------------------------


def test_the_draws_that_converged_are_counted():
    own = rows(lost=(1, 2), reason=["", "bad\nnews", "worse"])
    line = lines.judge_convergence(FLIGHT, own)
    assert line.sentence == "f: converged in 1 of 3 runs; run 1: bad news."
    assert (line.by_draw, line.word) == ((1.0, 0.0, 0.0), "count")
    exact = scipy.stats.binomtest(1, 3).proportion_ci(0.95, "exact")
    assert [line.value, line.low, line.high] == pytest.approx([1 / 3, exact.low, exact.high])
    long = lines.judge_convergence(FLIGHT, rows(lost=(0,), reason=["x" * 300]))
    assert long.sentence == f"f: converged in 0 of 1 runs; run 0: {'x' * 200}."


@pytest.mark.parametrize(
    ("pos", "vel", "phi", "told", "by_draw"),
    [
        ([1.0, 1.0], [1.0, 1.0], [1.0, 1.0], "answers at all epochs", (1.0, 1.0)),
        ([1.0, 1.0], [1.0, 1.0], [None, None], "answers at all epochs; no attitude", (1.0, 1.0)),
        (
            [0.75, 0.25], [1.0, 1.0], [0.5, None],
            "answers position at 25 %, velocity at 100 %, attitude at 0 % of the epochs, "
            "each in the run with the fewest",
            (0.5, 0.0),
        ),
        ([None, None], [None, None], [None, None], "answers nothing", (0.0, 0.0)),
    ],
)  # fmt: skip
def test_what_is_answered_is_told_by_block(pos, vel, phi, told, by_draw):
    line = lines.judge_coverage(
        FLIGHT, rows(availability_pos=pos, availability_vel=vel, availability_phi=phi)
    )
    assert line.sentence == f"f: {told}."
    assert (line.value, line.low, line.high) == (min(by_draw), min(by_draw), max(by_draw))
    assert line.by_draw == by_draw


def test_the_longest_time_to_an_answer_is_that_of_all_draws():
    line = lines.judge_start(FLIGHT, rows(availability_vel_all=[1.0, 0.5], first_answer_s_all=[2.5, 4.0]))
    assert line.sentence == "f: first answer after 4 s at most."
    assert (line.value, line.low, line.high, line.by_draw) == (4.0, 2.5, 4.0, (2.5, 4.0))
    one = lines.judge_start(FLIGHT, rows(availability_vel_all=[1.0, None], first_answer_s_all=[2.5, 4.0]))
    assert one.sentence == "f: never answers in some run."
    assert (one.value, one.low, one.high, one.by_draw) == (None, 2.5, None, (2.5, None))


# --- errors -----------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("own", "other", "bound", "word", "told", "median"),
    [
        ([4.0, 2.0], [2.0, 1.0], ({}, ""), "", "2.00 (2.00 to 2.00) times that of y{}", (2, 80)),
        (
            [4.0, 4.0], [2.0, 2.0], ({"accuracy": 1.0}, ""), "",
            "2.00 (2.00 to 2.00) times that of y and 4.00 (4.00 to 4.00) times the bound{}", (2, 50),
        ),
        (
            [1.0, 1.0], None, ({"accuracy": 2.0}, ""), "impossible",
            "0.500 (0.500 to 0.500) times the bound{}: no causal filter can; it has the future, or the truth",
            (1, 50),
        ),
        (
            [0.95, 0.95], None, ({"accuracy": 1.0}, ""), "", "0.950 (0.950 to 0.950) times the bound{}",
            (0.95, 50),
        ),
        (
            [4.0, None, 4.0], [2.0, 1.0, 2.0], ({}, "no bound: why"), "",
            "2.00 (2.00 to 2.00) times that of y, in the 2 of 3 runs that converged{}; no bound: why",
            (2, 50),
        ),
        (
            [4.0, 4.0], [1.0, 1.0], ({"accuracy": 2.0}, "it is of this"), "",
            "4.00 (4.00 to 4.00) times that of y and 2.00 (2.00 to 2.00) times the bound{}; it is of this",
            (4, 50),
        ),
    ],
)  # fmt: skip
def test_an_error_is_told_beside_another_and_the_bound(own, other, bound, word, told, median):
    mine = rows(pos_rmse_h_m=own)
    theirs = [] if other is None else rows(pos_rmse_h_m=other)
    (line,) = lines.compare_errors(FLIGHT, mine, theirs, "y", bound)
    told = told.format(RARE)
    middle = f"median {median[0]:.3g}, 0 of 2 runs above 3 times the median (below 78 % of all)"
    assert (
        line.sentence
        == f"f: horizontal error {told}; {middle}, the largest run {median[1]} % of the sum of squares."
    )
    assert (line.topic, line.word, line.by_draw) == ("accuracy", word, tuple(own))
    least = bound[0].get("accuracy")
    assert line.over_bound == (None if least is None else pytest.approx([own[0] / least] * 3))
    assert line.value == pytest.approx(own[0] / other[0] if other else own[0] / least)


def test_only_the_first_line_says_why_there_is_no_bound_and_faults_are_of_flights_that_have_their_own():
    names = ("pos_rmse_h_m", "pos_rmse_d_m", "fault_1_max_h_m", "outage_1_growth_h_m", "outage_2_growth_h_m")
    own = rows(**dict(zip(names, ([2.0] * 2, [2.0] * 2, [3.0] * 2, [3.0] * 2, [4.0] * 2), strict=True)))
    other = rows(**{name: [1.0] * 2 for name in names})
    for flight, topics in ((FLIGHT, ["accuracy", "height", "outages", "faults"]), (HURT, None)):
        found = lines.compare_errors(flight, own, other, "y", ({}, "no bound: why"))
        assert [line.topic for line in found] == (topics or ["accuracy", "height", "outages"])
        assert ["why" in line.sentence for line in found] == [True] + [False] * (len(found) - 1)
        assert found[2].by_draw == pytest.approx([math.sqrt(12.5)] * 2)


def test_a_filter_is_below_the_bound_where_the_spread_of_its_draws_leaves_no_doubt():
    """The limit is that of a chi-square with the freedom of the runs; the interval that of the jackknife."""
    values = np.array([0.5, 0.8, 0.7, 0.6, 0.75, 0.55])
    n, squares = len(values), values**2
    left = 0.5 * np.log((squares.sum() - squares) / (n - 1))
    error = np.sqrt((n - 1) ** 2 / n * left.var(ddof=1))
    rms, freedom = np.sqrt(squares.mean()), count_freedom(squares)
    most = rms * np.sqrt(freedom / scipy.stats.chi2.ppf(1e-5, freedom))
    assert most > rms / 0.9
    for bound, word in ((0.999 * most, ""), (1.001 * most, "impossible")):
        found, told = lines.compare_bound(values.tolist(), bound)
        reach = np.exp(scipy.stats.t.ppf(0.975, n - 1) * error)
        expected = np.array([rms, rms / reach, rms * reach]) / bound
        assert [found.value, found.low, found.high] == pytest.approx(expected)
        assert told == word
    for few, bound in (([1.0], 2.0), ([1.0, 0.0], 2.0), ([1.0, 1.0], None), ([1.0, 1.0], 0.0)):
        assert lines.compare_bound(few, bound) == (None, "")


@pytest.mark.parametrize("freedom", [1, 4])
def test_eight_draws_at_the_bound_itself_are_never_below_it(freedom):
    """Of 2000 cards of one error with few independent ones in a run, which is what wanders slowly."""
    drawn = np.sqrt(np.random.default_rng(3).chisquare(freedom, (2000, 8)) / freedom)
    assert not any(lines.compare_bound(own.tolist(), 1.0)[1] for own in drawn)
    assert all(lines.compare_bound((0.02 * own).tolist(), 1.0)[1] for own in drawn[:200])


def test_metrics_are_found_by_their_ends_and_pooled_by_draw():
    one = [
        {"outage_1_growth_h_m": 1.0, "outage_1_h_m": 1.0, "x_growth_h_m": 1.0, "outage_2_growth_h_m": None}
    ]
    assert lines.find_names(one, "outage_", "_growth_h_m") == ["outage_1_growth_h_m"]
    assert lines.find_names([{"pos": 1.0, "pos_all": 1.0}], "pos", "") == ["pos"]
    own = rows(lost=(1,), a=[3.0, 3.0, 1.0], b=[4.0, 4.0, None])
    assert lines.pool_names(own, ["a", "b"]) == (pytest.approx(math.sqrt(12.5)), None, None)
    assert lines.pool_names(own, []) == (None, None, None)
    row = {"converged": True, "pos_rmse_h_m": 3.0, "nees_mean": 18.0, "nees_states": 9}
    assert {k: v for k, v in lines.list_values(row).items() if v} == {"accuracy": 3.0, "honesty": 2.0}
    assert lines.list_values({**row, "converged": False})["honesty"] is None


def test_an_error_without_events_is_held_against_the_same_flight():
    own, without = rows(pos_rmse_h_m=[4.0, 6.0]), rows(pos_rmse_h_m=[2.0, 3.0])
    (line,) = lines.judge_robustness(HURT, own, without)
    told = f"g: horizontal error 2.00 (2.00 to 2.00) times its own on the same flight without them{RARE}."
    assert (line.sentence, line.by_draw) == (told, (4.0, 6.0))
    assert lines.judge_robustness(HURT, own[:1], without[:1]) == []


# --- covariances and alarms ---------------------------------------------------------------------------------

WAVES = [-0.2, 0.2] * 4


@pytest.mark.parametrize(
    ("ratios", "inside", "word"),
    [
        ([2.0] * 3, 0.1, "overconfident"),
        ([0.5] * 3, 0.1, "underconfident"),
        ([1.0] * 3, 0.85, "consistent"),
        ([1.0] * 3, 0.75, "uneven"),
        ([0.9 + wave for wave in WAVES], 0.85, "undecided"),  # 0.71 to 1.19
        ([1.15 + wave for wave in WAVES], 0.85, "undecided"),  # 0.96 to 1.42
        ([1.15 + wave for wave in WAVES], 0.75, "uneven"),
    ],
)
def test_a_claim_has_its_word(ratios, inside, word):
    own = rows(
        nees_mean=[9.0 * one for one in ratios],
        nees_states=[9] * len(ratios),
        nees_inside_95=[inside] * len(ratios),
    )
    lost = {"converged": False, "nees_mean": 900.0, "nees_states": 9}
    (line,) = lines.judge_honesty(FLIGHT, [*own, lost])
    assert line.word == word
    assert line.value == pytest.approx(np.mean(ratios))
    assert line.by_draw == (*(pytest.approx(one) for one in ratios), None)
    if len(set(ratios)) == 1:
        told = f"NEES is {ratios[0]:#.3g} ({ratios[0]:#.3g} to {ratios[0]:#.3g}) times its expectation"
        even = f"f: {told}: {word}."
        uneven = f"f: {told}: uneven, in the central 95 % of its distribution for 75 % of the time."
        assert line.sentence == (uneven if word == "uneven" else even)
    assert lines.judge_honesty(FLIGHT, [*own[:1], lost]) == []


def test_a_line_of_consistency_names_the_trade_and_keeps_the_metrics_of_blocks_and_axes():
    """Velocity sigmas too small and attitude sigmas too large, with a NEES of all states that is right."""
    waves = 1.0 + 0.5 * np.array(WAVES)
    own = rows(
        nees_mean=9.0 * 0.9 * waves, nees_states=[9] * 8, nees_inside_95=[0.95] * 8,
        nees_ratio_pos=0.92 * waves, nees_ratio_vel=1.47 * waves, nees_ratio_phi=0.23 * waves,
        log_score_pos=[2.0, 4.0] * 4, coverage_1sigma_pos_n=[0.6] * 8, log_score_pos_all=[9.0] * 8,
    )  # fmt: skip
    (line,) = lines.judge_honesty(FLIGHT, own)
    assert line.word == "overconfident"
    assert line.sentence.endswith(
        "times its expectation (position 0.920, velocity 1.47, attitude 0.230): "
        "overconfident in velocity (NEES/3 is 1.47), underconfident in attitude (0.23)."
    )
    known = {"nees_ratio_pos": 0.92, "nees_ratio_vel": 1.47, "nees_ratio_phi": 0.23, "log_score_pos": 3.0}
    assert line.parts == pytest.approx({**known, "coverage_1sigma_pos_n": 0.6})


def test_alarms_are_counted_where_faults_are_and_where_none_is():
    own = rows(
        fault_1_detected=[1.0, 0.0, None],
        false_alarm_share=[0.2, 0.3, None],
        false_alarm_rate_per_h=[1.0, 3.0, None],
    )
    noticed, alarm = lines.judge_alarms(FLIGHT, own)
    assert noticed.sentence == "f: detected 1 of 2 faults."
    assert (noticed.value, noticed.word, noticed.by_draw) == (0.5, "count", (1.0, 0.0))
    high = 0.25 + scipy.stats.t.ppf(0.975, 1) * 0.05
    told = f"25.0 (0.00 to {100.0 * high:.1f}) % of the time outside faults, 2 false alarms an hour"
    assert alarm.sentence == f"f: in alarm for {told}."
    assert (alarm.low, alarm.high) == (0.0, pytest.approx(high))
    assert alarm.by_draw == (0.2, 0.3, None)
    assert lines.judge_alarms(HURT, own) == []
    assert [line.topic for line in lines.judge_alarms(FLIGHT, own[:1])] == ["faults"]
    most = lines.estimate_share(np.array([0.2, 0.9]))
    assert (most.value, most.low, most.high) == (pytest.approx(0.55), 0.0, 1.0)


# --- times ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("times", "ends", "told"),
    [
        (range(1, 9), (4.5, 1.0, 8.0), "after 4.5 s (1 s to 8 s)"),
        ([*range(1, 7), None, None], (4.0, 1.0, None), "after 4 s (1 s to never)"),
        ([1, 2, 3], (2.0, None, None), "after 2 s (the start to never)"),
        ([1, 2, *[None] * 6], (None, 1.0, None), None),
    ],
)
def test_the_median_time_to_the_heading_counts_who_never_finds_it(times, ends, told):
    """Of eight values the ends of the interval are the first and the last: 2 / 2^8 is outside."""
    own = rows(
        heading_rmse_deg=[1.0 for _ in times],
        heading_right_s_all=[None if x is None else float(x) for x in times],
    )
    (line,) = lines.judge_heading(TURNED, own)
    text = "most runs never find the heading"
    text = text if told is None else f"half of the runs have the heading within 3 deg of the truth {told}"
    assert line.sentence == f"h: {text}."
    assert (line.value, line.low, line.high) == ends
    assert lines.judge_heading(FLIGHT, own) == []
    lost = [{**row, "converged": False} for row in own]
    assert lines.judge_heading(TURNED, lost)[0].value is None


def test_speed_is_the_median_over_the_same_runs():
    line = lines.measure_speed([2.0, 4.0, 6.0], [1.0, 1.0, 2.0], "y")
    told = "speed: 3 (3 to 3) times the CPU of y on the same samples; measured anew for each card."
    assert (line.sentence, line.value, line.low) == (told, 3.0, None)
    many = lines.measure_speed([2.0 * k for k in range(1, 9)], [2.0] * 8, "y")
    assert "speed: 4.5 (1 to 8) times" in many.sentence
    assert lines.measure_speed([], [], "y") is None


# --- the card ---------------------------------------------------------------------------------------------


def make_line(topic: str, value: float | None = None, **more: Any) -> Line:
    return Line(**{
        "topic": topic, "flight": "f", "figure": topic, "value": value, "low": value, "high": value,
        "sentence": "f: said.", **more,
    })  # fmt: skip


def make_card(*of: Line, **more: Any) -> Card:
    return Card(**{
        "estimator": "x", "against": "y", "suite": "3, quick", "suite_hash": "0", "draws": 3, "versions": {},
        "lines": of, "speed": None, **more,
    })  # fmt: skip


COUNTED = make_line("convergence", 1.0, word="count", by_draw=(1.0, 1.0, 1.0))
ALL = make_line("coverage", 1.0, figure=lines.SHARE)
HONEST = make_line("causality", 0.0, sentence="f: uses the future: no.")
LOST = LostDraw(flight="f", draw=0, reason="why", command="bench run")


@pytest.mark.parametrize(
    ("of", "told"),
    [
        ([COUNTED], "x converged in 3 of 3 runs."),
        ([COUNTED, ALL, HONEST], "x has a solution at all epochs and converged in 3 of 3 runs."),
        (
            [
                ALL, make_line("coverage", 0.5, figure=lines.SHARE), make_line("coverage", 0.1),
                COUNTED, make_line("convergence", 0.5, word="count", by_draw=(1.0, 0.0)),
                make_line("convergence", 5.0, by_draw=(5.0, 5.0)),
                *(make_line("honesty", 1.0, word=word) for word in ("fair", "wide", "fair")),
                make_line("accuracy", 2.0), make_line("accuracy", 0.5, word="impossible"),
                make_line("accuracy"), make_line("causality", 0.4, sentence="f: uses the future: 0.4 s."),
                *(make_line("requirements", word=word) for word in ("met", "missed", "met")),
            ],
            "x has a solution at 50 % or more of the epochs, converged in 4 of 5 runs, is fair on 2, wide "
            "on 1 of "
            "3 flights, has 0.500 to 2.00 times the horizontal error of y, uses the future: 0.4 s, is below "
            "the bound of causal filters in 1 figures and meets 2 of 3 requirements.",
        ),
    ],
)  # fmt: skip
def test_a_card_in_a_sentence(of, told):
    assert make_card(*of).summary == told


def test_a_card_beside_itself_has_no_ratio():
    assert "horizontal error" not in make_card(COUNTED, make_line("accuracy", 1.0), against="x").summary


@pytest.mark.parametrize(
    ("of", "lost", "good"),
    [
        ([HONEST, make_line("requirements", word="met"), make_line("tilt", 3.0)], (), True),
        ([make_line("causality")], (), True),
        ([HONEST], (LOST,), False),
        ([make_line("causality", 0.1)], (), False),
        ([make_line("causality", word="not proven")], (), False),
        ([make_line("height", 0.5, word="impossible")], (), False),
        ([make_line("requirements", word="undecided")], (), False),
    ],
)
def test_a_card_is_good_if_nothing_is_wrong(of, lost, good):
    assert make_card(COUNTED, *of, lost=lost).good == good


def test_a_card_names_what_is_required_and_ends_with_the_speed():
    found = make_card(
        COUNTED, make_line("requirements", figure="tilt", word="met"), speed=make_line("speed", 2.0)
    )
    (one,) = found.findings
    assert (one.label, one.metric, one.word, one.sentence) == ("f: x", "tilt", "met", "f: said.")
    assert len(found.sentences) == 3
    assert len(make_card(COUNTED).sentences) == 1
    assert AGAINST == "loose-full"


def test_a_file_without_a_line_of_convergence_is_no_card(tmp_path):
    for of, message in (([ALL], "none of its lines has the topic 'convergence'"), ([ALL, COUNTED], None)):
        (tmp_path / "x.json").write_text(make_card(*of).model_dump_json())
        if message is None:
            assert read_card(tmp_path / "x.json") == make_card(*of)
        else:
            with pytest.raises(ConfigError, match=message):
                read_card(tmp_path / "x.json")
