"""What a verb writes replaces nothing that is there, unless --force says so."""

from __future__ import annotations

import click
import pytest

import bench
from bench.cli.command_line import commands, main
from bench.core.words.exceptions import WRONG
from tests.test_api import SHORT


def _list_verbs(group, path=()):
    for name in group.list_commands(None):
        command = group.get_command(None, name)
        if isinstance(command, click.Group) and name != "study":
            yield from _list_verbs(command, (*path, name))
        else:
            yield " ".join((*path, name)), command


def test_every_verb_that_writes_where_it_is_told_has_force():
    verbs = {
        name: {option for parameter in command.params for option in parameter.opts}
        for name, command in _list_verbs(commands)
    }
    writing = {name for name, options in verbs.items() if "--out" in options}
    assert {"run", "fixes", "allan", "report", "record", "card"} <= writing
    assert {name for name in writing if "--force" not in verbs[name]} == set()


@pytest.mark.parametrize(
    ("arguments", "name"),
    [
        (["fixes", "no.obs", "no.nav", "-o"], "fixes.csv"),
        (["fixes", "no.obs", "no.nav", "--report"], "page.html"),
        (["allan", "--log", "no.csv", "-o"], "allan.png"),
        (["card", "-e", "loose-99", "-o"], "card.json"),
        (["card", "-e", "loose-99", "--html"], "page.html"),
    ],
)
def test_a_file_is_replaced_only_with_force(tmp_path, monkeypatch, capsys, arguments, name):
    """It is rejected before the work, which here cannot be done; with --force the work is tried."""
    monkeypatch.chdir(tmp_path)
    place = tmp_path / name
    place.write_text('<meta name="generator" content="bench">')
    before = place.read_bytes()
    assert main([*arguments, name]) == WRONG
    assert capsys.readouterr().err == f"error: {name}: exists; --force replaces it\n"
    assert main([*arguments, name, "--force"]) == WRONG
    assert "exists" not in capsys.readouterr().err
    assert place.read_bytes() == before


def test_a_page_that_bench_did_not_write_stays_even_with_force(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "mine.html").write_text("mine")
    for arguments in (
        ["fixes", "no.obs", "no.nav", "--report", "mine.html", "--force"],
        ["card", "-e", "loose-99", "--html", "mine.html", "--force"],
    ):
        assert main(arguments) == WRONG
        assert "mine.html: not replaced, bench did not write it" in capsys.readouterr().err


def test_pages_recordings_and_figures_elsewhere_are_replaced_only_with_force(tmp_path, monkeypatch, capsys):
    """Those in the folder itself are made again: they show nothing but what is in it."""
    monkeypatch.chdir(tmp_path)
    outage = {**SHORT, "gnss_outage": [{"start_s": 10.0, "duration_s": 5.0}]}
    result = bench.run(bench.read_profile("figure-eight", outage, estimators=["free-inertial"]))
    bench.write_result(result, "flight", recording=False)
    for arguments in (
        ["report", "flight", "-o", "page.html"],
        ["record", "flight", "-o", "flight.rrd"],
        ["report", "flight", "--figures", "svg", "-o", "figures"],
    ):
        assert [main(arguments), main(arguments), main([*arguments, "--force"])] == [0, WRONG, 0]
        assert f"{arguments[-1]}: " in capsys.readouterr().err
    assert [main(["report", "flight"]), main(["report", "flight"])] == [0, 0]
    assert main(["report", "flight", "--figures", "svg", "-o", "flight", "--force"]) == WRONG
    assert "flight: not replaced, it is no folder of figures" in capsys.readouterr().err
