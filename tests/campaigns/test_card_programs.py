"""The programs of the guide, in C++ and Python, get cards that say the same of both."""

from __future__ import annotations

import re
import shutil
import subprocess
from pathlib import Path

import pytest

import bench
from bench.core.files.places import PACKAGE
from bench.experiments.campaigns import running
from bench.experiments.campaigns.pools import ExecutorPool, SerialExecutor
from bench.experiments.card import card_making
from bench.experiments.card.card_suite import Suite, SuiteFlight
from tests.campaigns.test_campaign import PROFILE

COMPILER = shutil.which("c++") or shutil.which("g++")


def read_block(topic: str, name: str) -> str:
    page = (PACKAGE / "guide" / f"{topic}.md").read_text()
    found = re.search(rf"^```\w+ {re.escape(name)}\n(.*?)^```$", page, re.DOTALL | re.MULTILINE)
    assert found is not None, name
    return found[1]


@pytest.mark.skipif(COMPILER is None, reason="no C++ compiler here")
def test_a_filter_in_cpp_gets_the_card_of_the_same_filter_in_python(tmp_path, monkeypatch):
    """And the hash of what ran is that of the program and of what a wrapper calls."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setattr(running, "choose_pool", lambda *_: ExecutorPool(SerialExecutor(), 1))
    Path("short.toml").write_text(PROFILE)
    flight = SuiteFlight("plain", "short.toml", {})
    monkeypatch.setattr(card_making, "QUICK", Suite("card-quick", (), draws=2, members=(flight,)))
    for topic, name in (("filter-in-cpp", "carry.cpp"), ("filter-protocol", "carry_fix.py")):
        Path(name).write_text(read_block(topic, name))
    subprocess.check_call([str(COMPILER), "-O2", "-Wall", "-Werror", "-o", "carry", "carry.cpp"])
    Path("wrapper.sh").write_text('#!/bin/sh\nexec "$(dirname "$0")/carry" "$@"\n')
    Path("wrapper.sh").chmod(0o755)

    def judge(use: str, **options: object) -> card_making.Card:
        return bench.make_card(use, against="free-inertial", quick=True, **options)

    own = judge("command:./wrapper.sh {sensors} {solution}")
    same = judge("carry_fix:Carry")
    for topic in ("accuracy", "height", "velocity", "honesty"):
        lines = [next(line for line in one.lines if line.topic == topic) for one in (own, same)]
        assert lines[0].by_draw == pytest.approx(lines[1].by_draw, rel=1e-2), topic  # its Earth is round
    (causal,) = (line.sentence for line in own.lines if line.topic == "causality")
    assert causal.startswith("plain: uses the future: no; other data after ")
    assert ", not confined; " in causal
    assert own.lines[0].sentence == "plain: answers at all epochs; no attitude."
    assert own.good
    assert judge("carry_fix:Carry", options={"acceleration": 8.0}).answers != same.answers
    with Path("carry").open("ab") as file:
        file.write(b"\0")  # what the wrapper calls has changed
    assert judge("command:./wrapper.sh {sensors} {solution}").program != own.program
