"""Filters that are silent or claim too much are told so on a flight of the card, and honest ones are not."""

from __future__ import annotations

from dataclasses import replace

import pytest

import bench
from bench.core.records.specs import Guard
from bench.experiments.campaigns import running
from bench.experiments.campaigns.pools import ExecutorPool, SerialExecutor
from bench.experiments.card import card_making
from bench.experiments.card.card_lines import CONVENTIONS
from bench.experiments.card.card_suite import QUICK
from tests.campaigns.silent_and_wrong import BOASTFUL, HONEST, SILENT

pytestmark = pytest.mark.long


@pytest.fixture(autouse=True)
def one_flight(monkeypatch):
    """Eight runs of the flight with the matched filter, in this process."""
    members = tuple(one for one in QUICK.members if one.name == "s-turns-matched")
    monkeypatch.setattr(running, "choose_pool", lambda *_: ExecutorPool(SerialExecutor(), 1))
    monkeypatch.setattr(card_making, "QUICK", replace(QUICK, members=members))


def judge(cheat: type) -> card_making.Card:
    use = f"tests.campaigns.silent_and_wrong:{cheat.__name__}"
    return bench.make_card(use, against="loose-15", quick=True, guard=Guard(in_process=True))


def read_word(found: card_making.Card) -> str:
    (line,) = (one for one in found.lines if one.topic == "honesty")
    return line.word


@pytest.mark.parametrize("cheat", SILENT)
def test_who_is_silent_is_told(cheat):
    found = judge(cheat)
    assert not found.good
    assert found.lost


@pytest.mark.parametrize("cheat", BOASTFUL)
def test_who_claims_what_is_not_so_is_told(cheat):
    assert read_word(judge(cheat)) in ("overconfident", "underconfident", "uneven")


@pytest.mark.parametrize("honest", HONEST)
def test_an_odd_filter_is_not_accused(honest):
    found = judge(honest)
    assert found.good, found.summary
    assert read_word(found) in ("consistent", "undecided")
    assert not [one for one in found.lines if one.topic == CONVENTIONS]
