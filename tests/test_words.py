"""The pages and the help texts read once: few marks of hard sentences, no private terms."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from pathlib import Path

import click
import pytest

from bench.cli.command_line import commands
from bench.cli.verbs import guide
from bench.core.files.places import PACKAGE

ROOT = Path(__file__).parents[1]
PAGES = {"README": ROOT / "README.md", "CONTRIBUTING": ROOT / "CONTRIBUTING.md", **guide.find_pages()}
TUTORIALS = ("first-run", "choose-imu", "evaluate-log", "first-ekf", "filter-in-cpp", "ci-check")
SILENT = ("g++", "bench new check")
"""Commands that print nothing, or what differs from machine to machine."""

MARKS = {
    "that of": (r"\b(?:that|those) of\b", 0.3),
    "tell": (r"\b(?:tells?|told|telling)\b", 0.5),
    "say": (r"\b(?:says?|said)\b", 1.0),
}
"""Mark -> what it matches, and how many in 1000 words of prose a page may have."""
LONGEST = 35
"""Words of the longest sentence."""

BANNED = (
    "believed again", "fooled", "dishonest", "way back", "noise draw", "unjudged", "errs by", "is of no use",
)  # fmt: skip
"""Private terms without an everyday use."""


def take_prose(text: str) -> str:
    """Return the prose of a page: without code, tables, formulas and headings, links as their words."""
    text = re.sub(r"<!--.*?-->|```.*?```|\$\$.*?\$\$|!\[[^\]]*\]\([^)]*\)", "\n\n", text, flags=re.DOTALL)
    lines = ["" if line.lstrip().startswith(("|", "#")) else line for line in text.splitlines()]
    text = re.sub(r"\[([^\]]*)\]\([^)]*\)", r"\1", "\n".join(lines))
    return re.sub(r"`[^`]*`", "x", text)


def list_sentences(prose: str) -> list[str]:
    """Return the sentences of paragraphs and entries of lists."""
    parts = re.split(r"\n\s*\n|\n(?=\s*(?:[-*]|\d+\.) )", prose)
    return [
        one for part in parts for one in re.split(r"(?<=[.!?:;])\s+(?=[A-Zx\"'(*])", " ".join(part.split()))
    ]


def count_marks(text: str) -> tuple[list[int], int, int]:
    """Return how often each of the marks stands in a page, its long sentences, and its words."""
    prose = take_prose(text)
    counts = [len(re.findall(pattern, prose, re.IGNORECASE)) for pattern, _ in MARKS.values()]
    long = sum(len(one.split()) > LONGEST for one in list_sentences(prose))
    return counts, long, len(re.findall(r"[A-Za-z][\w'-]*", prose))


@pytest.mark.parametrize("page", PAGES)
def test_a_page_has_few_marks_of_hard_sentences(page):
    counts, long, words = count_marks(PAGES[page].read_text(encoding="utf-8"))
    limits = [int(most * words / 1000.0) for _, most in MARKS.values()]
    for name, count, limit in zip(MARKS, counts, limits, strict=True):
        assert count <= limit, f"{page}: {name!r} stands {count} times, {limit} at most"
    assert long == 0, f"{page}: {long} sentences have more than {LONGEST} words"


@pytest.mark.parametrize("page", PAGES)
def test_a_page_has_no_private_terms(page):
    prose = take_prose(PAGES[page].read_text(encoding="utf-8")).lower()
    assert [term for term in BANNED if page != "CONTRIBUTING" and term in prose] == []


MOST_WORDS = 400
"""Words of a page that shows how to do one thing."""


def list_pages_below(heading: str) -> list[str]:
    """Return the pages that the guide lists below a heading."""
    text = (guide.FOLDER / "README.md").read_text(encoding="utf-8").partition(f"## {heading}\n")[2]
    return re.findall(r"^- \[([\w-]+)\]", text.partition("\n## ")[0], re.MULTILINE)


@pytest.mark.parametrize("page", list_pages_below("How to"))
def test_a_how_to_is_short(page):
    assert count_marks(PAGES[page].read_text(encoding="utf-8"))[2] <= MOST_WORDS


def test_the_pages_together_are_no_book():
    """Without the equations, which are looked up; each page is listed once, below one heading."""
    counts = {page: count_marks(path.read_text(encoding="utf-8"))[2] for page, path in PAGES.items()}
    assert len(list_pages_below("How to")) >= 18
    assert sum(counts.values()) - counts["equations"] <= 22_000


@pytest.mark.parametrize("page", TUTORIALS)
def test_each_command_of_a_tutorial_shows_its_output(page):
    text = PAGES[page].read_text(encoding="utf-8")
    for block in re.finditer(r"```sh\n(.*?)```\n+(.{7})", text, re.DOTALL):
        if not block[1].startswith(SILENT):
            assert block[2] == "```text", f"{page}: {block[1].strip()} shows no output"


def find_helps() -> Iterator[tuple[str, str]]:
    """Yield the help texts of verbs, studies and options by their place on the command line."""

    def read(command: click.Command, name: str, parent: click.Context) -> Iterator[tuple[str, str]]:
        parts = (command.help or "").split("\n\n")  # those that begin with a \b are laid out by hand
        yield name, "\n\n".join(part for part in parts if "\b" not in part)
        for option in command.params:
            yield f"{name} {option.opts[0]}", str(getattr(option, "help", None) or "")
        if isinstance(command, click.Group):
            here = click.Context(command, parent=parent)
            for below in command.list_commands(here):
                found = command.get_command(here, below)
                assert found is not None
                yield from read(found, f"{name} {below}", here)

    yield from read(commands, "bench", click.Context(commands))


def test_help_texts_read_once():
    helps = dict(find_helps())
    assert len(helps) > 400
    for name, text in helps.items():
        prose = take_prose(text)
        for mark, (pattern, _) in MARKS.items():
            assert not re.search(pattern, prose, re.IGNORECASE), f"{name}: {mark!r}"
        assert [term for term in BANNED if term in prose.lower()] == [], name
        assert [one for one in list_sentences(prose) if len(one.split()) > LONGEST] == [], name


HARD = {
    "that of": r"\b(?:that|those) of\b",
    "begins without a verb": r"\A(?:What|Whether|It|How|Where|That|Those|Who)\b",
    "who": r"\b(?:who|whoever|whose)\b",
    "tell": r"\b(?:tells?|told)\b",
    "say": r"\b(?:says?|said)\b",
    "judge": r"\b(?:judges?|judged|believes?)\b",
}
MOST_HARD = 40
"""Docstrings inside the package whose first paragraph has a mark of `HARD`, of 4900; it may only fall."""


def test_docstrings_inside_get_no_harder_to_read():
    kinds = (ast.Module, ast.ClassDef, ast.FunctionDef)
    trees = [ast.parse(path.read_text(encoding="utf-8")) for path in PACKAGE.rglob("*.py")]
    docs = [ast.get_docstring(one) for tree in trees for one in ast.walk(tree) if isinstance(one, kinds)]
    firsts = [" ".join(doc.partition("\n\n")[0].split()) for doc in docs if doc]
    assert len(firsts) > 4000
    hard = [first for first in firsts if any(re.search(pattern, first) for pattern in HARD.values())]
    assert len(hard) <= MOST_HARD


def test_marks_are_counted_in_prose_alone():
    text = (
        "# Those of it\n\nThat of a says so. `that of`\n\n| told |\n\n```sh\ntell\n```\n" + "word " * 36 + "."
    )
    assert count_marks(text) == ([1, 0, 1], 1, 42)
