"""Titles, names and messages of other people reach a terminal without control or bidirectional characters."""

from __future__ import annotations

import ast
import io
import re
from pathlib import Path

import pytest
from rich.progress import Progress, TextColumn
from rich.table import Table
from rich.text import Text

import bench
from bench import pipeline
from bench.cli.command_line import main
from bench.cli.verbs.console import PlainConsole
from bench.core.words.exceptions import FlightError
from bench.core.words.wording import one_line, replace_control
from bench.io import results
from tests.cli.test_cli import PROFILE
from tests.exchange.exported import make_run

EVIL = "\x1b]0;title\x07\x1b[2J\u202ea\u2066b\u200f\x9bc\x85d\u2028e\r\x08\x00\x7f[red]:smile:"
BAD = re.compile("[\x00-\x08\x0b-\x1f\x7f-\x9f\u200b-\u200f\u2028-\u202e\u2060-\u2069\ufeff]")
SEEN = "?]0;title??[2J?a?b??c?d?e"


def test_printable_text_stays_as_it_is():
    text = "Größe 5 °, Δv ≥ 3 σ · 日本\n  second line"
    assert replace_control(text) == text
    assert one_line(text) == text.replace("\n", " ")
    assert replace_control("100\u00a0km\u2009h") == "100\u00a0km\u2009h"
    assert not BAD.search(replace_control(EVIL))
    assert replace_control(EVIL).startswith(SEEN)


@pytest.mark.parametrize("terminal", [False, True])
def test_everything_that_rich_prints_is_cleaned(terminal):
    """Tables, their titles and headers, styled texts, progress, status; only rich's own codes are left."""
    file = io.StringIO()
    console = PlainConsole(file=file, force_terminal=terminal, width=200)
    table = Table(EVIL, title=EVIL)
    table.add_row(EVIL)
    table.add_row(Text(EVIL, "red"))
    console.print(EVIL, table, Text(EVIL))
    console.print(EVIL, style="bold red", soft_wrap=True)
    with Progress(TextColumn("{task.description}", markup=False), console=console) as bar:
        bar.add_task(EVIL)
    with console.status(Text(EVIL)):
        pass
    out = re.sub(r"\x1b\[[\d;]*[mKA]|\x1b\[\?25[lh]|\r", "", file.getvalue())  # of rich
    assert not BAD.search(out)
    assert out.count("[red]:smile:") >= 4


def test_verbs_print_through_this_door_only():
    """No module of the verbs makes a console of its own, or prints; JSON is in ASCII."""
    for folder in ("cli", "cli/verbs", "cli/new_files"):
        for path in (Path(bench.__file__).parent / folder).glob("*.py"):
            calls = [node for node in ast.walk(ast.parse(path.read_text())) if isinstance(node, ast.Call)]
            names = {ast.unparse(call.func) for call in calls}
            assert not names & {"print", "Console", "sys.stdout.write", "sys.stderr.write", "click.secho"}, (
                path
            )
            for call in calls:
                if ast.unparse(call.func) == "click.echo" and not isinstance(call.args[0], ast.Constant):
                    assert ast.unparse(call.args[0]).startswith(
                        ("to_json(", "f'error: {replace_control(", "replace_control(", "ctx.get_help(")
                    ), path
    assert results.to_json(EVIL).isascii()


@pytest.fixture
def here(tmp_path, monkeypatch) -> Path:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("BENCH_CACHE", str(tmp_path / "cache"))
    return tmp_path


def say(capsys, *arguments: str) -> str:
    main(list(arguments))
    out, err = capsys.readouterr()
    text = out + err
    assert not BAD.search(text.replace("\r", "")), (arguments, text)
    assert "Traceback" not in text
    return text


SAID = EVIL.replace("\x00", "")  # a file with this character is rejected
NAME = SAID.replace("\x08", "")


def test_hostile_names_in_the_answer_of_every_verb(here, capsys, monkeypatch):
    """Names of files and folders, options, titles and messages, in results and in errors."""
    title = "".join(f"\\u{ord(c):04x}" if BAD.match(c) or c == "\n" else c for c in SAID + "\nerror: none")
    (here / f"{NAME}.toml").write_text(PROFILE.replace('"Half a minute"', f'"{title}"'))
    (here / "short.toml").write_text(PROFILE.replace('"Half a minute"', f'"{title}"'))
    make_run(here / NAME)
    texts = [
        say(capsys, "run", NAME),
        say(capsys, "run", f"{NAME}.toml", "--set", f"{NAME}=1"),
        say(capsys, "run", f"{NAME}.toml", "--set", f"title={NAME}", "-e", NAME),
        say(capsys, "run", "short.toml", "-e", NAME),
        say(capsys, "run", "short.toml", "--set", f"aircraft={NAME}"),
        say(capsys, "run", "short.toml", "-o", f"{NAME}/none/\x1b"),
        say(capsys, "guide", NAME),
        say(capsys, "new", "estimator", NAME),
        say(capsys, "list", NAME),
        say(capsys, "view", NAME),
        say(capsys, "view", f"{NAME}-none"),
        say(capsys, "check", NAME, "--baselines", NAME),
        say(capsys, "navigate", f"{NAME}.toml"),
        say(capsys, "fixes", NAME, NAME),
        say(capsys, "allan", NAME),
        say(capsys, "allan", "--log", NAME),
        say(capsys, "export", NAME, "--to", "nmea", "-o", f"{NAME}-nmea"),
        say(capsys, "export", NAME, "--to", NAME),
        say(capsys, "export", NAME, "--to", "csv", "--with", NAME),
        say(capsys, "score", NAME, NAME, "--label", NAME),
        say(capsys, "stream", NAME, "--udp", NAME),
        say(capsys, NAME),
    ]
    assert all(texts)

    def lost(*args, **keywords):
        raise FlightError(f"leg {EVIL}: into the ground")

    monkeypatch.setattr(pipeline.steps, "fly", lost)
    assert SEEN in say(capsys, "run", "short.toml")


def test_a_hostile_title_is_one_line_of_a_result(here, capsys):
    """A title and a label that a results folder holds, printed with metrics by bench score."""
    make_run(here / "run")
    run = results.read_result(here / "run")
    summary = results.read_summary(here / "run")
    results.write_json(
        here / "run" / "result.json",
        summary | {"format": 2, "profile": run.profile | {"title": f"{EVIL}\nx"}},
    )
    assert main(["export", "run", "--to", "csv", "-o", "out", "--with", "solution:made"]) == 0
    capsys.readouterr()
    table = next((here / "out").glob("solution-made.csv"))
    text = say(capsys, "score", str(table), "run", "--label", "again")
    assert text.startswith(SEEN)
    assert text.splitlines()[0].count(" x: seed") == 1
