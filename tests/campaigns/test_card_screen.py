"""The screen of a card by hand: a row for each flight, and a reason for each word that is not green."""

from __future__ import annotations

import io

import pytest
from rich.console import Console

from bench.cli.verbs.card_screen import print_card
from bench.experiments.card.card_lines import Line
from bench.experiments.card.card_making import LostDraw
from tests.campaigns.test_card_lines import make_card, make_line


def say(*of: Line, lost: tuple[LostDraw, ...] = (), flights: str = "fg") -> str:
    out = io.StringIO()
    commands = {flight: f"bench run {flight}" for flight in flights}
    print_card(Console(file=out, width=80), make_card(*of, commands=commands, lost=lost))
    return out.getvalue()


def make_flight(flight: str, word: str = "consistent", nees: float = 1.0, good: int = 3) -> list[Line]:
    by_draw = (1.0,) * good + (0.0,) * (3 - good)
    return [
        make_line("convergence", good / 3, flight=flight, word="count", by_draw=by_draw),
        make_line("accuracy", 1.5, flight=flight, low=1.25, high=1.75),
        make_line("honesty", nees, flight=flight, word=word),
    ]


def test_a_sound_card_has_rows_and_no_reason():
    said = say(*make_flight("f"), *make_flight("g"))
    assert "f             3/3   1.50   1.25 to 1.75    1.00  ✓ consistent" in said
    assert "✗" not in said
    assert "?" not in said
    assert "error ratio: horizontal error / horizontal error of y, same noise" in said


@pytest.mark.parametrize(("word", "mark"), [("overconfident", "✗"), ("underconfident", "△")])
def test_what_is_not_consistent_has_its_nees_and_the_command(word, mark):
    said = " ".join(say(*make_flight("f"), *make_flight("g", word, 60.0)).split())
    assert f"{mark} {word}" in said
    assert f"{word} on 1 flight: NEES 60.0 times its ideal value." in said
    assert "Find the cause of the first: bench run g" in said


def test_flights_that_are_not_consistent_have_the_range_of_their_nees():
    flights = [*make_flight("f", "overconfident", 182.0), *make_flight("g", "overconfident", 24.0)]
    said = " ".join(say(*flights).split())
    assert "overconfident on 2 flights: NEES 24.0 to 182 times its ideal value." in said
    assert "Find the cause of the first: bench run f" in said


def test_runs_that_diverged_have_their_numbers_a_reason_and_the_command():
    commands = {k: f"bench run g --run {k}" for k in (2, 5)}
    lost = tuple(LostDraw(flight="g", draw=k, reason=f"why {k}", command=one) for k, one in commands.items())
    said = " ".join(say(*make_flight("f"), *make_flight("g", good=1), lost=lost).split())
    assert "1/3" in said
    assert "✗ 2 diverged" in said
    assert "✗ g: runs 2, 5 diverged: why 2. Repeat: bench run g --run 2" in said


def test_the_future_a_convention_and_what_is_uneven_or_missed_is_said():
    found = [
        make_line("causality", 0.4, flight="f", sentence="f: uses the future: 0.4 s."),
        make_line("conventions", flight="f", sentence="f: looks like north."),
        make_line("accuracy", 0.5, flight="f", word="impossible", sentence="f: no causal filter can."),
        make_line("requirements", flight="f", word="missed", sentence="f: 5 m: missed."),
        make_line("requirements", flight="f", word="met", sentence="f: 9 m: met."),
        make_line("causality", 0.0, flight="g", sentence="g: uses the future: no."),
    ]
    said = say(*make_flight("f"), *make_flight("g"), *found)
    for text in (
        "✗ f: uses the future: 0.4 s.",
        "f: looks like north.",
        "✗ f: no causal filter",
        "✗ f: 5 m: missed.",
    ):
        assert text in said
    assert "9 m" not in said
    assert "uses the future: no" not in said


def test_a_filter_without_covariance_has_no_nees():
    said = say(make_line("convergence", 1.0, word="count", by_draw=(1.0, 1.0, 1.0)), flights="f")
    assert "f             3/3" in said
    assert "– no covariance" in said
