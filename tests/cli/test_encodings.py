"""Whatever a stream can encode, a verb ends as it should, and what it prints can be read."""

from __future__ import annotations

import os
import subprocess
import sys

import pytest

from bench.evaluation.metrics.key_figures import format_bounds
from tests.campaigns.test_campaign import PROFILE


def run(*arguments, encoding, cwd=None):
    return subprocess.run(
        [sys.executable, "-m", "bench", *arguments],
        env={**os.environ, "PYTHONIOENCODING": encoding},
        cwd=cwd,
        capture_output=True,
        check=False,
    )


@pytest.mark.parametrize(("encoding", "shown"), [("cp1252", "café ? ?"), ("ascii", "cafe ? ?")])
def test_a_run_prints_its_bounds_in_any_encoding(tmp_path, encoding, shown):
    assert "≥" in format_bounds("coverage_3sigma_pos_n", {"coverage_low_pos_n": 0.5})
    (tmp_path / "short.toml").write_text(PROFILE.replace("Short", "café Ω 🛩"), encoding="utf-8")
    done = run("run", "short.toml", "--table", "--no-rrd", "--no-report", encoding=encoding, cwd=tmp_path)
    assert (done.returncode, done.stderr) == (0, b"")
    said = done.stdout.decode(encoding)
    assert said.startswith(f"short: {shown}\n")
    assert ">=" in said


def test_each_character_is_written_by_the_nearest_that_there_is():
    text = run("guide", "conventions", encoding="ascii").stdout.decode("ascii")
    assert "at rest -9.8 m/s2 along down" in text
    assert " +-" in run("guide", "accuracy", encoding="ascii").stdout.decode("ascii")


def test_a_way_that_was_asked_for_is_kept():
    done = run("guide", "accuracy", encoding="ascii:xmlcharrefreplace")
    assert b"&#177;" in done.stdout
