"""Every equation that is cited by its number stands on the page of equations, and each one there is cited."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path

import pytest

from bench.core.files.places import PACKAGE

PAGE = PACKAGE / "guide" / "equations.md"
TESTS = PACKAGE.parent / "tests"
NUMBER = r"[AB]-T?\d+(?:\.\d+)*(?:\.[A-Z]\d?|[A-Za-z])?|B-[A-Z]|equations \d+(?:\.\d)?"
"""A number of an equation, table or chapter of a source, or of a part of the register."""
CITED = re.compile(
    rf"(?<![\w-])({NUMBER})(?![\w-])(?:(?:/|[\s#]+to[\s#]+(?:[AB]-(?:[\d.]+\.)?)?)([A-Z]?\d+)(?![\w-]))?"
)
"""One, or a range by its ends: "A-5.1.2 to A-5.1.4", "A-5.2.1/2"."""


def find_ids(text: str) -> Iterator[str]:
    """Every id that a text cites, those within its ranges too."""
    for first, last in CITED.findall(text):
        yield first
        if last and first[-1].isdigit():
            stem = first.rstrip("0123456789")
            for number in range(int(first[len(stem) :]) + 1, int(last.lstrip("G")) + 1):
                yield f"{stem}{number}"


def find_entries(page: str) -> list[str]:
    """The ids of the entries of a page: what is bold."""
    return [id_ for id_ in re.findall(r"\*\*([^*]+)\*\*", page) if CITED.fullmatch(id_)]


def find_missing(entries: list[str], texts: dict[str, str]) -> list[str]:
    """Every citation without an entry, and the file that has it."""
    return [f"{name}: {id_}" for name, text in texts.items() for id_ in find_ids(text) if id_ not in entries]


def read_texts(folder: Path) -> dict[str, str]:
    """The text of every file of a folder that may cite."""
    paths = (path for path in sorted(folder.rglob("*")) if path.suffix in (".py", ".md", ".toml"))
    return {
        str(path.relative_to(folder.parent)): path.read_text(encoding="utf-8")
        for path in paths
        if path not in (PAGE, Path(__file__))
    }


def test_every_citation_leads_to_an_entry_and_no_entry_is_dead():
    entries = find_entries(PAGE.read_text(encoding="utf-8"))
    assert len(entries) == len(set(entries)) > 100
    texts = read_texts(PACKAGE) | read_texts(TESTS)
    assert find_missing(entries, texts) == []
    assert [name for name, text in texts.items() if re.search(r"\([25]\.[1-5]\.\d+\)", text)] == []
    cited = {id_ for text in texts.values() for id_ in find_ids(text)}
    assert [id_ for id_ in entries if id_ not in cited] == []


def test_a_citation_without_an_entry_is_found():
    texts = {"a.py": "P as in (A-5.4.5), A-9.9.9g and B-1.", "b.md": "B-20 to B-22"}
    assert find_missing(["A-5.4.5", "B-1", "B-20", "B-22"], texts) == ["a.py: A-9.9.9g", "b.md: B-21"]


@pytest.mark.parametrize(
    ("text", "ids"),
    [
        ("(A-5.4.8R), A-5.1.D; B-10b, B-N", ["A-5.4.8R", "A-5.1.D", "B-10b", "B-N"]),
        ("A-T2.4.1: bias, A-5.1.1Q, A-5.1.4g. A-4", ["A-T2.4.1", "A-5.1.1Q", "A-5.1.4g", "A-4"]),
        ("A-2.2.G1 to G3", ["A-2.2.G1", "A-2.2.G2", "A-2.2.G3"]),
        ("A-5.1.9 to\n# A-5.1.11.", ["A-5.1.9", "A-5.1.10", "A-5.1.11"]),
        ("(A-5.2.1/2), (equations 7.1)", ["A-5.2.1", "A-5.2.2", "equations 7.1"]),
        ("RA-1, UTF-A-1, [A-Z], B-spline, A-1st, TR8350.2 equations 4-5", []),
    ],
)
def test_numbers_and_ranges_are_read(text, ids):
    assert list(find_ids(text)) == ids


def test_the_page_names_both_sources():
    text = PAGE.read_text(encoding="utf-8").partition("\n## ")[0]
    assert re.search(r"\*\*Source A\*\*: diploma thesis.*neither its author nor its year", text, re.DOTALL)
    assert re.search(r"\*\*Source B\*\*: S\. N\. Vlasik, .*2013", text, re.DOTALL)
