"""The verb guide: list the topics of the guide, or show one in the terminal."""

from __future__ import annotations

import difflib
import os
import pydoc
import re
from collections.abc import Iterable
from pathlib import Path

from rich.console import Console
from rich.markdown import Markdown
from rich.pager import Pager

from bench.core.files.places import PACKAGE
from bench.core.words.exceptions import ConfigError
from bench.core.words.wording import suggest

FOLDER = PACKAGE / "guide"
"""One Markdown file per topic; its ``README.md`` lists these, and the pages beside the code of plug-ins."""

_WIDEST = 100  # columns of a rendered page
_PAGES = 3  # that are named where a word is no topic
_ENTRY = re.compile(r"^- \[(?P<topic>[a-z-]+)\]\((?:[./\w]+/)?(?P=topic)\.md\): (?P<about>.+)$", re.MULTILINE)
_LINK = re.compile(r"\[([^]\n]+)\]\((?:[^)\s]*/)?([\w-]+)\.md\)")  # which a terminal cannot follow
_FOLDED = 120  # columns from which on the limits and the default of a key have their own
_KEYS = re.compile(r"(\| [^\n]*\| meaning) \| allowed \| default \|\n\|[-|]+\n((?:\|.*\n)*)")
_COMMENT = re.compile(r"^<!--.*?-->\n", re.MULTILINE)


def read_topics() -> dict[str, str]:
    """Return the topics and their descriptions, in the order of the guide."""
    text = (FOLDER / "README.md").read_text(encoding="utf-8")
    return {entry["topic"]: entry["about"] for entry in _ENTRY.finditer(text)}


def find_pages() -> dict[str, Path]:
    """Return the pages by topic."""
    found = [*FOLDER.glob("*.md"), *(PACKAGE / "plugins").glob("*/*.md")]
    return {path.stem: path for path in sorted(found) if path.stem != "README"}


def list_topics(console: Console) -> None:
    """Print every topic with a description of one line."""
    from bench.cli.verbs.printing import print_table
    from bench.core.records.findings import make_table  # numbers, which who reads a page does without

    rows = list(read_topics().items())
    table = make_table("topics", "Topics (bench guide TOPIC)", ("topic", "how to"), rows)
    print_table(console, table)


def show_topic(topic: str, console: Console) -> None:
    """Print one topic: rendered in a pager on a terminal, as Markdown elsewhere.

    Raises
    ------
    ConfigError
        If there is no such topic; the message lists the nearest name and all names.
    """
    known = read_topics()
    if topic not in known:
        is_near = difflib.get_close_matches(topic.lower(), known, n=1)
        pages = "" if is_near else _tell_pages(topic, known)
        raise ConfigError(f"no topic {topic!r}{pages}{suggest(topic, known, 'topics')}")
    text = find_pages()[topic].read_text(encoding="utf-8")
    if not console.is_terminal:
        console.print(text, soft_wrap=True, end="")
        return
    text = _COMMENT.sub("", _LINK.sub(_name_topic, text))
    if console.width < _FOLDED:
        text = _KEYS.sub(_fold_keys, text)
    page = Markdown(text, code_theme="ansi_dark")
    with console.pager(_ColorPager(), styles=True):
        console.print(page, width=min(console.width, _WIDEST))


def _fold_keys(table: re.Match[str]) -> str:
    """Return a table of keys with limits and defaults appended to the meaning, for a narrow screen."""
    lines = [f"{table[1]} |", "|---" * (table[1].count("|")) + "|"]
    for row in table[2].splitlines():
        *cells, meaning, allowed, default = row.removeprefix("| ").removesuffix(" |").split(" | ")
        parts = [meaning, allowed and f"({allowed})", default and f"[{default}]"]
        lines.append(f"| {' | '.join([*cells, ' '.join(filter(None, parts))])} |")
    return "\n".join(lines) + "\n"


def _name_topic(link: re.Match[str]) -> str:
    """Return the words of a link, followed by the topic if the words differ from it."""
    words, topic = link.groups()
    return words if topic in (words, "README") else f"{words} (bench guide {topic})"


def _tell_pages(word: str, topics: Iterable[str]) -> str:
    """Return a text with the pages that mention a word most often; empty if no page does."""
    sought = re.compile(rf"\b{re.escape(word)}", re.IGNORECASE)
    pages = find_pages()
    counts = {name: len(sought.findall(pages[name].read_text(encoding="utf-8"))) for name in topics}
    most = sorted((name for name in counts if counts[name]), key=lambda name: -counts[name])[:_PAGES]
    return f". Mentioned in: {', '.join(most)}" if most else ""


class _ColorPager(Pager):
    """The pager of the user; less shows colors, and quits at once if the page fits the screen."""

    def show(self, content: str) -> None:
        os.environ.setdefault("LESS", "FRX")
        pydoc.pager(content)
