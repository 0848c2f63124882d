"""The page of a card."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from datetime import datetime
from pathlib import Path
from statistics import median

from bench.core.files import durable
from bench.core.records.findings import FindingTable, make_table
from bench.core.records.findings.looks import find_look
from bench.core.words.notebook import ShownText
from bench.core.words.wording import format_number
from bench.evaluation.ensembles.ensemble import qualify
from bench.evaluation.requirements.required_metrics import trace
from bench.experiments.card.card_lines import CONVENTIONS, Line
from bench.experiments.card.card_making import Card, describe_suite
from bench.views.report import page
from bench.views.report.forest import RatioRow, draw_ratios

_TITLES = {
    "coverage": "Does it answer?",
    "convergence": "Does it converge?",
    "causality": "Does it use the future?",
    "honesty": "Does it know its error?",
    CONVENTIONS: "Which convention may be wrong?",
    "accuracy": "How accurate is it?",
    "height": "How accurate is its height?",
    "velocity": "How accurate is its velocity?",
    "tilt": "How accurate are roll and pitch?",
    "heading": "How accurate is its heading?",
    "outages": "How does it hold through outages?",
    "faults": "Does it detect and survive faults?",
    "alarms": "Does it raise false alarms?",
    "robustness": "What do gaps in the IMU and late fixes do to it?",
    "requirements": "Does it keep what is required?",
    "speed": "How fast is it?",
}
"""Topic -> its heading, in the order of the page."""

_DRAWN = {
    "accuracy": "Horizontal error / horizontal error of {}",
    "heading": "Heading error / heading error of {}",
    "honesty": "NEES over its expectation",
}
"""Topics that have a picture -> what it shows."""

_UNITS = {"accuracy": "m", "height": "m", "velocity": "m/s", "tilt": "deg", "heading": "deg"}
"""Topics whose runs are errors -> their unit."""

_SIZE = "median of the runs"


def write_card(path: Path, card: Card) -> None:
    """Write a card as a page that needs no other file and no network.

    Raises
    ------
    bench.ConfigError
        If a file is there that bench did not write.
    OSError
        If the file cannot be written; an existing file is left unchanged.
    """
    page.check_page(path, force=True)
    lines = [*card.lines, *([card.speed] if card.speed else [])]
    topics = {title: [line for line in lines if line.topic == topic] for topic, title in _TITLES.items()}
    lost = [(one.flight, one.draw, one.reason, ShownText(one.command, code=True)) for one in card.lost]
    text = page.render(
        "card.html.jinja",
        interactive=False,
        title=f"Card of {card.estimator}",
        card=card,
        origin=list(page.list_provenance(card.uncertainty or {"versions": card.versions})),
        suite=describe_suite(card),
        written=page.write_minute(datetime.now()),
        rare=qualify(card.draws),
        pictures=list(_draw(card)),
        topics=[
            (title, trace(card.findings) if title == _TITLES["requirements"] else _tabulate(own))
            for title, own in topics.items()
            if own
        ],
        lost=make_table("lost", "", ("flight", "draw", "why", "repeat it"), lost),
    )
    durable.write(path, text)


def _draw(card: Card) -> Iterator[tuple[str, str]]:
    """Yield title and drawing of the topics that have a picture."""
    for topic, title in _DRAWN.items():
        rows = [
            RatioRow(line.flight, line.value, line.low, line.high, _find_kind(line))
            for line in card.lines
            if line.topic == topic
        ]
        if rows:
            title = title.format(card.against)
            yield title, draw_ratios(title, rows)


def _find_kind(line: Line) -> str:
    return find_look(line.word).kind if line.topic == "honesty" else ""


def _describe_size(line: Line) -> str:
    """Return the median error of the draws with its unit; "" where a line has no error."""
    draws = [value for value in line.by_draw if value is not None]
    unit = _UNITS.get(line.topic)
    return f"{format_number(median(draws), 3)} {unit}" if unit and draws else ""


def _tabulate(lines: Sequence[Line]) -> FindingTable:
    """Return the table of the lines of a topic, with their size if they are errors."""
    names = ("flight", "value", "95 % interval", _SIZE, "in words")
    table = make_table("topic", "", names, list(map(_make_row, lines)))
    shown = {name: cells for name, cells in table.columns.items() if name != _SIZE or cells[0]}
    return replace(table, columns=shown)


def _make_row(line: Line) -> tuple[str | ShownText, ...]:
    """Return flight, value, interval, size and sentence of a line."""
    ends = " to ".join("open" if end is None else format_number(end) for end in (line.low, line.high))
    text = line.sentence.removeprefix(f"{line.flight}: ").removeprefix(f"{line.topic}: ")
    never = "never" if line.topic in ("convergence", "coverage") else "-"
    value = ShownText(never if line.value is None else format_number(line.value), tip=line.figure)
    return line.flight, value, ends, _describe_size(line), ShownText(text, _find_kind(line))
