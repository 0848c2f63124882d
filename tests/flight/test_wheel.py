"""Every script and every aircraft of the jsbsim wheel ends in a flight or in one line."""

from __future__ import annotations

import re

import pytest

from tests.flight.wheel import fly, list_names


@pytest.mark.long
@pytest.mark.parametrize("name", list_names())
def test_what_others_wrote_flies_or_says_in_one_line_why_not(name, tmp_path, monkeypatch):
    monkeypatch.setenv("BENCH_CACHE", str(tmp_path))
    found = fly(name)
    assert found.status in (0, 2, 3), found.text
    assert found.status == 0 or re.fullmatch(r"error: .+", found.text)
