"""A card says what the runs of the suite say, and only cards of equal suites compare."""

from __future__ import annotations

import json
import math
import re
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pytest
import scipy.stats
from markupsafe import escape

import bench
from bench.cli.command_line import main
from bench.core.mathematics import rotation
from bench.core.records.specs import Profile
from bench.core.words.exceptions import ConfigError
from bench.evaluation.ensembles.regression import average_changes
from bench.experiments.campaigns import running
from bench.experiments.campaigns.pools import ExecutorPool, SerialExecutor
from bench.experiments.card import card_comparison, card_lines, card_making
from bench.experiments.card.card_comparison import list_differences
from bench.experiments.card.card_suite import FULL, QUICK, Suite, SuiteFlight, move_events, vary_flight
from bench.io.config import read_profile
from bench.io.foreign.solution_folder import name_draw
from bench.views.report.card_page import write_card
from tests.campaigns import card_power
from tests.campaigns.test_campaign import PROFILE

FAULT = """
[[gnss_outage]]
start_s = 14.0
duration_s = 4.0
[[fault]]
kind = "spoofing"
start_s = 8.0
duration_s = 3.0
step_m = [400.0, 0.0, 0.0]
"""
GAP = [{"kind": "dropped", "sensor": "imu", "start_s": 12.0, "duration_s": 2.0}]
HEADING = {"initial_error_sd.heading_deg": 10.0}
DRAWS = 3
BOTH = ["-e", "loose-15", "--against", "loose-22", "--quick"]


def make_suite(fault: str = FAULT) -> Suite:
    Path("short.toml").write_text(PROFILE + fault)
    members = (
        SuiteFlight("short", "short.toml"),
        SuiteFlight("gap", "short.toml", {"fault": GAP}, "short"),
        SuiteFlight("heading", "short.toml", {**HEADING, "fault": []}),
    )
    return Suite("card-quick", (), draws=DRAWS, members=members)


def read_draws(flight: SuiteFlight, *estimators: str) -> list[Profile]:
    """Return the profile of each run of a flight."""
    return [
        read_profile(flight.profile, vary_flight(flight, draw), estimators=list(estimators))
        for draw in range(DRAWS)
    ]


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """A folder with two cards of loose-15, a page, and a card of loose-22."""
    place = tmp_path_factory.mktemp("card")
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(place)
        patch.setattr(card_making, "QUICK", make_suite())
        patch.setattr(running, "choose_pool", lambda *_: ExecutorPool(SerialExecutor(), 1))
        assert main(["card", *BOTH, "-o", "a.json", "--html", "a.html"]) == 0
        assert main(["card", *BOTH, "-o", "again.json"]) == 0
        assert main(["card", "-e", "loose-22", "--against", "loose-22", "--quick", "-o", "b.json"]) == 0
        yield place


def find(found: card_making.Card, flight: str, topic: str) -> card_lines.Line:
    same = (one for one in found.lines if (one.flight, one.topic) == (flight, topic))
    (line,) = (one for one in same if not one.figure.startswith("longest time"))
    return line


def test_a_card_says_what_the_runs_say(made):
    found = bench.read_card(made / "a.json")
    results = list(map(bench.run, read_draws(make_suite().members[0], "loose-15", "loose-22")))
    own, other = ([one.metrics[label] for one in results] for label in ("loose-15", "loose-22"))

    def ratio(name: str) -> float:
        return math.prod(a[name] / b[name] for a, b in zip(own, other, strict=True)) ** (1 / DRAWS)

    for topic, name in (
        ("accuracy", "pos_rmse_h_m"),
        ("height", "pos_rmse_d_m"),
        ("velocity", "vel_rmse_3d_mps"),
        ("tilt", "tilt_rmse_deg"),
        ("heading", "heading_rmse_deg"),
        ("outages", "outage_1_growth_h_m"),
    ):
        assert find(found, "short", topic).value == pytest.approx(ratio(name)), topic
    assert find(found, "short", "accuracy").by_draw == pytest.approx([one["pos_rmse_h_m"] for one in own])
    assert find(found, "short", "honesty").value == pytest.approx(sum(one["nees_mean"] for one in own) / 27)
    largest, noticed = (line for line in found.lines if (line.flight, line.topic) == ("short", "faults"))
    assert largest.value == pytest.approx(ratio("fault_1_max_h_m"))
    assert noticed.value == sum(one["fault_1_detected"] for one in own) / DRAWS
    assert find(found, "short", "convergence").value == 1.0
    for line in (*found.lines, found.speed):
        assert (line.low or -math.inf) <= (line.value or 0.0) <= (line.high or math.inf), line
    assert found.summary.startswith("loose-15 has a solution at all epochs, converged in 9 of 9 runs, is ")
    assert found.lines[0].sentence == "short: answers at all epochs."
    assert found.lines[1].sentence == "short: first answer after 0 s at most."
    assert (found.good, found.lost, found.options) == (True, (), {})
    assert "the bound holds for sensors without faults" in find(found, "short", "accuracy").sentence


def test_gaps_and_a_wrong_heading_have_lines_of_their_own(made):
    found = bench.read_card(made / "a.json")
    _, flight, other = make_suite().members
    gap = list(map(bench.run, read_draws(flight, "loose-15")))
    errors = [one.metrics["loose-15"]["pos_rmse_h_m"] for one in gap]
    line, plain = find(found, "gap", "robustness"), find(found, "short", "accuracy").by_draw
    assert line.by_draw == pytest.approx(errors)
    assert line.value == pytest.approx(
        math.prod(x / y for x, y in zip(errors, plain, strict=True)) ** (1 / DRAWS)
    )
    assert not [one for one in found.lines if (one.flight, one.topic) == ("gap", "faults")]
    _, times = (line for line in found.lines if (line.flight, line.topic) == ("heading", "convergence"))
    turned = map(bench.run, read_draws(other, "loose-15"))
    settled = [one.metrics["loose-15"]["heading_right_s_all"] for one in turned]
    assert list(times.by_draw) == settled
    assert times.value == sorted(settled)[1]


def test_an_estimator_without_attitude_has_no_line_of_heading():
    flight = SuiteFlight("heading", "short.toml", HEADING)
    rows = [{"converged": True, "heading_rmse_deg": 1.0, "heading_right_s_all": None}] * 3
    (line,) = card_lines.judge_heading(flight, rows)
    assert line.value is None
    assert card_lines.judge_heading(flight, [{"converged": True}] * 3) == []


def without_measured(card: card_making.Card) -> card_making.Card:
    """The audit of causality is drawn anew for each card."""
    lines = [
        line.model_copy(update={"sentence": ""} if line.topic == "causality" else {}) for line in card.lines
    ]
    return card.model_copy(update={"speed": None, "lines": tuple(lines)})


def test_equal_inputs_give_equal_lines_and_another_suite_another_hash(made, monkeypatch):
    first, again, other = (bench.read_card(made / name) for name in ("a.json", "again.json", "b.json"))
    assert first.speed.value > 0.0
    assert without_measured(again) == without_measured(first)
    assert other.suite_hash == first.suite_hash
    assert not any("times that of" in text for text in other.sentences)
    moved = make_suite(FAULT.replace("400.0", "401.0")).members[:1]
    monkeypatch.setattr(card_making, "QUICK", Suite("card-quick", (), draws=DRAWS, members=moved))
    assert bench.make_card("loose-22", against="loose-22", quick=True).suite_hash != first.suite_hash


def test_two_cards_compare_draw_by_draw(made, capsys):
    capsys.readouterr()
    assert main(["card", "--compare", "b.json", "a.json"]) == 0
    text = capsys.readouterr().out
    first, second = (bench.read_card(made / name) for name in ("b.json", "a.json"))
    found = bench.compare_cards(first, second)
    assert text.splitlines()[1:] == [line.sentence for line in found]
    values = {(line.topic, line.flight): line.values for line in found}
    pair = (find(one, "short", "honesty").value for one in (first, second))
    assert values["honesty", "short"] == tuple(pair)
    assert found[-1].sentence.startswith("speed: loose-22 takes ")
    assert re.fullmatch(r"\d+ figures are the same in every run.", found[-2].sentence)
    [whole, _] = bench.compare_cards(first, first, names=("x", "y"))
    judged = [line for line in first.lines if line.topic != "robustness"]
    assert whole.sentence == f"{len(judged)} figures are the same in every run."
    other = second.model_copy(update={"suite_hash": "0", "versions": {"bench": "0"}})
    with pytest.raises(ConfigError, match="the cards are from different suites: b has 4, quick"):
        bench.compare_cards(first, other, names=("b", "a"))
    assert list_differences(first, second) == []
    assert f"bench {first.versions['bench']} and 0" in list_differences(first, other)


def test_the_better_filter_is_named(made):
    line = find(bench.read_card(made / "a.json"), "short", "accuracy")

    def with_errors(values: list[float]) -> card_making.Card:
        base = bench.read_card(made / "a.json")
        return base.model_copy(update={"lines": (line.model_copy(update={"by_draw": tuple(values)}),)})

    cards = with_errors([1.0, 2.0, 3.0, 2.0, 1.0]), with_errors([1.1, 2.21, 3.29, 2.2, 1.1])
    [found] = bench.compare_cards(*cards, names=("x", "y"))[:1]
    assert found.sentence.endswith("): x is better.")
    [found] = bench.compare_cards(cards[1], with_errors([1.0, 2.5, 3.2, 2.3, 1.0]), names=("x", "y"))[:1]
    assert "): not proven to differ; a ratio of " in found.sentence
    assert found.better is None


@pytest.mark.slow
def test_a_filter_beside_itself_is_not_better_and_one_that_is_worse_is_found():
    """Of 300 pairs of cards at most 22 hold a false word; 10 % is found; intervals hold the truth."""
    rng = np.random.default_rng(31)
    assert 1 <= card_power.count_words(rng, 300, 0.05, 1.0)[0] <= 22
    assert card_power.count_words(rng, 60, 0.2, 1.1)[1] >= 48
    low, high = scipy.stats.binom.ppf([0.0005, 0.9995], 1000, 0.95)
    assert low <= card_power.count_inside(rng, 1000, 0.6, 0.5) <= high


def test_flights_that_share_their_noise_are_no_further_draws(made):
    """Seven times the same 8 runs prove no more than one time."""
    line = find(bench.read_card(made / "a.json"), "short", "accuracy")
    base = bench.read_card(made / "a.json")

    def repeat(flights: int, values: list[float]) -> card_making.Card:
        copies = [
            line.model_copy(update={"flight": f"flight {k}", "by_draw": tuple(values)})
            for k in range(flights)
        ]
        return base.model_copy(update={"lines": tuple(copies), "speed": None})

    other = [1.3, 0.9, 1.2, 0.9, 1.1, 1.0, 1.3, 0.9]
    for flights in (1, 7):
        [found, *_] = bench.compare_cards(repeat(flights, [1.0] * 8), repeat(flights, other), ("x", "y"))
        assert "not proven to differ" in found.sentence
    found = bench.compare_cards(repeat(7, [1.0] * 8), repeat(7, [1.3 * v for v in other]), ("x", "y"))
    assert [one.better for one in found] == ["x"] * 8
    assert found[0].sentence.startswith("all flights: ")


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("{", "x.json: not valid JSON"),
        ("[]", "x.json: must contain one JSON object"),
        ("{}", "x.json: format 1, expected format 2"),
        (None, "x.json: no such file"),
    ],
)
def test_what_is_no_card_is_refused(tmp_path, text, message):
    if text is not None:
        (tmp_path / "x.json").write_text(text)
    with pytest.raises(ConfigError, match=message):
        bench.read_card(tmp_path / "x.json")


def test_who_loses_the_worst_draws_is_not_said_to_have_the_future():
    """Of errors as large as the bound the smallest 24 of 40 are below it; a whole set that small is not."""
    errors = np.sort(np.sqrt(np.random.default_rng(1).chisquare(4.0, 40) / 4.0)).tolist()
    assert card_lines.compare_bound([*errors[:24], *[None] * 16], 1.0)[1] == ""
    assert card_lines.compare_bound(errors[:24], 1.0)[1] == "impossible"
    assert card_lines.compare_bound(errors, 1.0)[1] == ""


# --- what is right and yet no good ------------------------------------------------------------------------


def test_a_ratio_is_of_the_draws_that_both_have():
    """Geometric mean of the ratios, with the interval of Student's t of their logarithms."""
    own, other = (2.0, None, 3.0, 8.0, 5.0, None), (1.0, 7.0, 2.0, 2.0, None, None)
    logs = np.log([2.0, 1.5, 4.0])
    reach = scipy.stats.t.ppf(0.975, 2) * logs.std(ddof=1) / np.sqrt(3)
    found = card_lines.compare_rms(own, other)
    expected = np.exp(logs.mean() + reach * np.array([0.0, -1.0, 1.0]))
    assert [found.value, found.low, found.high] == pytest.approx(expected)
    for few in ((2.0, None), (None, 2.0), (0.0, 1.0)):
        assert card_lines.compare_rms(few, (1.0, 1.0)) is None
        assert card_lines.compare_rms((1.0, 1.0), few) is None


def test_a_filter_that_loses_its_worst_draws_is_not_better(made):
    line = find(bench.read_card(made / "a.json"), "short", "accuracy")
    base = bench.read_card(made / "a.json")

    def make(values: list[float | None]) -> card_making.Card:
        copies = tuple(
            line.model_copy(update={"flight": f"flight {k}", "by_draw": tuple(values)}) for k in range(2)
        )
        return base.model_copy(update={"lines": copies, "speed": None})

    whole = make([1.0, 1.1, 0.9, 1.0, 1.2, 0.9, 1.0, 9.0])
    picky = make([0.8, 0.9, 0.7, 0.8, 1.0, 0.7, 0.8, None])
    [found] = bench.compare_cards(picky, whole, names=("x", "y"))
    assert found.better is None
    assert "x is better in the runs that both have, but lost 2 that y kept" in found.sentence
    [found, *_] = bench.compare_cards(whole, picky, names=("y", "x"))
    assert "x is better in the runs that both have, but lost 2 that y kept" in found.sentence


def test_what_is_no_error_is_compared_in_words(made):
    base = bench.read_card(made / "a.json")

    def having(**changes):
        lines = [
            line.model_copy(update={**changes, "by_draw": ()})
            if line.topic in ("coverage", "causality")
            else line
            for line in base.lines
        ]
        return base.model_copy(update={"lines": tuple(lines)})

    told = [line.sentence for line in bench.compare_cards(having(value=0.5), having(value=None), ("x", "y"))]
    assert "short: look-ahead: 0.5 s and not proven." in told
    assert "short: answers at 50 and 0 % of the epochs." in told


def test_a_time_to_the_heading_is_compared_in_words(made):
    base = find(bench.read_card(made / "a.json"), "short", "convergence")
    line = base.model_copy(update={"figure": "median time to the heading [s]", "value": 12.5})
    told = card_comparison.tell_values(line, line.model_copy(update={"value": None}))
    assert told == "heading found after 12.5 s and never"


@pytest.mark.parametrize(
    ("one", "other", "same"),
    [
        (None, None, True),
        (None, 1.0, False),
        (1.0, None, False),
        (1.0, 1.0 + 0.9e-6, True),
        (1.0, 1.0 + 1.1e-6, False),
    ],
)
def test_a_value_of_a_card_is_the_same_but_for_the_processor(one, other, same):
    assert card_making.is_same_value(one, other) == same


def test_the_ratio_that_would_be_found_is_that_of_students_t():
    """Its quantile at the level, both sides, and that of the power, times the standard error."""
    change = average_changes(np.array([0.1, -0.2, 0.15, 0.05, -0.1, 0.02, 0.3, -0.12]))
    t = scipy.stats.t(7)
    ratio = np.exp((t.ppf(0.99) + t.ppf(0.8)) * change.standard_error)
    assert card_comparison.find_power(change, 0.02) == f"a ratio of {card_lines.write_figure(ratio)}"


def test_what_is_not_estimated_is_said():
    flight = SuiteFlight("short", "short.toml")
    rows = [{"converged": True, "availability_pos": share} for share in (1.0, 0.5, 1.0)]
    line = card_lines.judge_coverage(flight, rows)
    assert line.sentence == (
        "short: answers position at 50 % of the epochs, each in the run with the fewest; "
        "no velocity, no attitude."
    )
    assert (line.value, line.by_draw) == (0.5, (1.0, 0.5, 1.0))
    nothing = card_lines.judge_coverage(flight, [{"converged": False, "failed": True}] * 3)
    assert (nothing.value, nothing.sentence) == (0.0, "short: answers nothing.")


# --- repeating it -----------------------------------------------------------------------------------------


def test_a_card_is_verified_by_runs_that_nobody_knows_before(made, monkeypatch, capsys):
    monkeypatch.chdir(made)
    make_suite()
    assert main(["card", "--verify", "a.json"]) == 0
    assert "the repeated runs equal the card" in capsys.readouterr().out
    edited = json.loads((made / "a.json").read_text())
    for line in edited["lines"]:
        if line["topic"] == "accuracy":
            short = line["flight"] == "short"
            line["by_draw"] = [0.9 * value for value in line["by_draw"]] if short else []
    (made / "edited.json").write_text(json.dumps(edited))
    assert main(["card", "--verify", "edited.json"]) == 1
    told = capsys.readouterr().out
    assert re.search(r"short, run \d: horizontal error: card and repetition \d", told)
    assert re.search(r"gap, run \d: horizontal error: card and repetition - and \d", told)
    other = bench.read_card(made / "a.json").model_copy(update={"use": "loose-22"})
    assert any("is not the program that the card names" in text for text in card_making.verify_card(other))
    for change, message in (
        ({"use": ""}, "does not name its filter"),
        ({"suite_hash": "0"}, "the card is of suite 0"),
    ):
        with pytest.raises(ConfigError, match=message):
            card_making.verify_card(other.model_copy(update=change))


def test_a_reviewer_draws_noise_of_their_own_and_runs_are_kept(made, monkeypatch):
    monkeypatch.chdir(made)
    first = bench.make_card("loose-15", against="loose-22", quick=True, seed=77, runs=Path("kept"))
    base = bench.read_card(made / "a.json")
    assert first.seed == 77
    assert first.suite_hash != base.suite_hash
    assert first.program == base.program
    assert re.search(r" --seed \d+ --run 0$", first.commands["short"])
    assert first.commands["short"].split("--seed")[1] != base.commands["short"].split("--seed")[1]
    assert all(re.fullmatch("[0-9a-f]{16}", x) for x in (first.suite_hash, first.program, first.answers))
    assert "start_s" not in base.commands["short"]  # the spoof comes when the profile says, at 8 s
    starts = sorted(map(float, re.findall(r'"start_s" = ([\d.]+)', first.commands["short"])))
    assert [a != b for a, b in zip(starts, (8.0, 14.0), strict=True)] == [True, True]
    flown = []
    monkeypatch.setattr(running, "measure", lambda task: flown.append(task))
    again = bench.make_card("loose-15", against="loose-22", quick=True, seed=77, runs=Path("kept"))
    assert not flown
    assert without_measured(again) == without_measured(first)
    assert again.speed == first.speed


def test_a_card_shows_itself_in_a_notebook(made):
    found = bench.read_card(made / "a.json")
    assert found.summary in found._repr_html_()
    frame = found.frame()
    assert frame["value"].tolist() == pytest.approx([line.value for line in found.lines], nan_ok=True)
    (axes,) = found.plot("heading").axes
    assert len(repr(found)) < 400
    lines = [one for one in found.lines if one.topic == "heading" and one.value and one.low and one.high]
    (drawn,) = [one for one in axes.lines if one.get_marker() == "."]
    assert drawn.get_ydata().tolist() == [line.value for line in lines]
    assert [text.get_text() for text in axes.get_xticklabels()] == [line.flight for line in lines]


def test_the_page_of_a_card_says_the_same_and_executes_nothing(made, tmp_path):
    found = bench.read_card(made / "a.json")
    page = (made / "a.html").read_text()
    assert found.suite_hash in page
    assert found.uncertainty["runs"] == f"{DRAWS} of each of 3 flights"
    assert found.uncertainty["versions"] == found.versions
    for method in found.uncertainty["methods"].values():
        assert str(escape(method)) in page
    assert re.search(r"<span>written \d{4}-\d\d-\d\d \d\d:\d\d</span>", page)
    for line in found.lines:
        assert line.sentence.removeprefix(f"{line.flight}: ") in page
    hostile = found.model_copy(update={"estimator": "<script>alert(1)</script>"})
    write_card(tmp_path / "b.html", hostile)
    scripts: list[str] = []
    parser = HTMLParser()
    parser.handle_starttag = lambda tag, attributes: scripts.append(tag) if tag == "script" else None
    parser.feed((tmp_path / "b.html").read_text())
    assert len(scripts) == 1
    (tmp_path / "c.html").write_text("mine")
    with pytest.raises(ConfigError, match="bench did not write it"):
        write_card(tmp_path / "c.html", found)


def test_the_suite_names_flights_that_load():
    assert FULL.members[: len(QUICK.members)] == QUICK.members
    names = [one.name for one in FULL.members]
    assert len(set(names)) == len(names)
    for one in FULL.members:
        profile = read_profile(one.profile, one.values, estimators=["loose-15"])
        assert one.without in ("", *names)
        assert bool(profile.sensors.faults) >= bool(one.without)


def test_no_two_runs_of_a_suite_are_alike():
    """Each has its own place, heading, wind and noise; a seed draws others; the turns keep their size."""
    plan = [vary_flight(one, draw, seed) for one in QUICK.members for draw in range(8) for seed in (None, 5)]
    for keys in (("seed",), ("start.lat_deg", "start.lon_deg", "start.heading_deg")):
        assert len({tuple(values[key] for key in keys) for values in plan}) == len(plan), keys
    flight = SuiteFlight("out and back", "gnss-denied-leg")
    for draw in range(3):
        values = vary_flight(flight, draw)
        (back,) = (leg["to_heading_deg"] for leg in values["leg"] if "to_heading_deg" in leg)
        assert (back - values["start.heading_deg"]) % 360.0 == pytest.approx(180.0, abs=0.11)
    assert vary_flight(flight, 0) == vary_flight(flight, 0)
    assert "wind.speed_mps" not in vary_flight(SuiteFlight("x", "static"), 0)


def test_with_a_seed_what_breaks_comes_at_other_times_in_the_same_order():
    moved = {one.name: (one, move_events(one, 5)) for one in FULL.members}
    assert moved["gnss-faults"][1] == move_events(moved["gnss-faults"][0], 5)
    for name in ("gnss-faults", "imu-gaps", "figure-eight"):
        one, rows = moved[name]
        before = read_profile(one.profile, one.values).document
        (key,) = rows
        pairs = list(zip(before[key], rows[key], strict=True))
        assert any(a["start_s"] != b["start_s"] for a, b in pairs)
        assert [{**a, "start_s": 0} for a, _ in pairs] == [{**b, "start_s": 0} for _, b in pairs]
        ends = [b["start_s"] + b["duration_s"] for _, b in pairs]
        assert all(end < b["start_s"] for end, (_, b) in zip(ends, pairs[1:], strict=False))
        read_profile(one.profile, {**one.values, **rows})
        assert rows != move_events(one, 6)
    assert moved["late-fixes"][1]["fault"][0]["start_s"] == 0.0  # from the start to the end
    assert moved["survey"][1] == {}


@pytest.mark.parametrize("arguments", [[], ["-e", "loose-15", "--compare", "a", "b"]])
def test_a_card_is_made_or_compared(arguments, capsys):
    assert main(["card", *arguments]) == 2
    assert (
        "give one of -e NAME to evaluate, --compare A B, --verify FILE and --sensors DIR"
        in capsys.readouterr().err
    )


def test_solutions_of_a_folder_are_judged_draw_by_draw(made, monkeypatch, capsys):
    """Those of loose-15, written by hand, have its errors; a run without one is told."""
    monkeypatch.chdir(made)
    assert main(["card", "--sensors", "draws", "--quick"]) == 0
    assert "Next: solution.csv into each, then bench card -e file:draws --quick" in capsys.readouterr().out
    written = json.loads((made / "draws" / "suite.json").read_text())
    flights = {one.name: one for one in card_making.QUICK.members}
    assert len({row["folder"] for row in written["draws"]}) == DRAWS * len(flights)
    for row in written["draws"]:
        place = made / "draws" / row["folder"]
        assert sorted(path.name for path in place.iterdir()) == ["sensors"]
        assert not list((place / "sensors").glob("*truth*"))
        flight = flights[row["flight"]]
        profile = read_profile(flight.profile, vary_flight(flight, row["draw"]))
        sensed = bench.sense(profile, bench.fly(profile))
        found = bench.run_filter("loose-15", sensed.data, sensed.initial)
        euler = np.degrees(np.column_stack(rotation.to_euler(found.q_nb)))
        table = np.column_stack([found.t, np.degrees(found.lla[:, :2]), found.lla[:, 2], found.vel_n, euler])
        names = "t_s,lat_deg,lon_deg,alt_m,vel_n_mps,vel_e_mps,vel_d_mps,roll_deg,pitch_deg,heading_deg"
        np.savetxt(place / "solution.csv", table, "%.12g", ",", header=names, comments="")
    assert main(["card", "-e", "file:draws", "--against", "loose-15", "--quick", "-o", "files.json"]) == 0
    for flight in flights:
        line = find(bench.read_card(Path("files.json")), flight, "accuracy")
        assert line.value == pytest.approx(1.0, abs=1e-3)
    (made / "draws" / written["draws"][0]["folder"] / "solution.csv").unlink()
    assert main(["card", "-e", "file:draws", "--against", "loose-15", "--quick", "-o", "less.json"]) == 1
    (lost,) = bench.read_card(Path("less.json")).lost
    assert "no such file" in lost.reason
    assert lost.command.startswith("bench run short.toml -e file:draws")
    counted = find(bench.read_card(Path("less.json")), written["draws"][0]["flight"], "convergence")
    assert sum(counted.by_draw) == DRAWS - 1
    with pytest.raises(ConfigError, match="not replaced"):
        card_making.write_suite("draws", quick=True)


def test_the_name_of_a_draw_is_that_of_another_processor(made, monkeypatch):
    """Round-off leaves it, another run and another start do not."""
    monkeypatch.chdir(made)
    profile = read_profile("short.toml")
    truth = bench.fly(profile)
    one, other = (bench.sense(profile, truth, run) for run in range(2))
    name = name_draw(one.data, one.initial)
    moved = replace(one.initial, vel_n=one.initial.vel_n + 1e-15, q_nb=one.initial.q_nb - 1e-15)
    imu = replace(one.data.imu, dtheta_b=one.data.imu.dtheta_b * (1 + 1e-15))
    assert name_draw(replace(one.data, imu=imu), moved) == name
    assert name_draw(other.data, one.initial) != name
    assert name_draw(one.data, replace(one.initial, vel_n=one.initial.vel_n + 0.1)) != name
