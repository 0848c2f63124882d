"""The card of a filter on one screen: its summary, a row for each flight, and the reasons."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
from rich.console import Console

from bench.cli.verbs.printing import print_table, print_wrapped
from bench.core.records.findings import FindingTable
from bench.core.records.findings.looks import find_look
from bench.core.words.notebook import ShownFigure
from bench.evaluation.ensembles.ensemble import qualify
from bench.evaluation.ensembles.rare_runs import measure_scatter
from bench.experiments.card.card_lines import CONVENTIONS, COUNT, Line, write_figure
from bench.experiments.card.card_making import Card, LostDraw, describe_suite

_BROKEN = ("overconfident", "underconfident")
_MOST_LOST = 3  # flights with runs that diverged, each with its reason


def print_card(console: Console, card: Card) -> None:
    """Print the summary, a row for each flight, and the reason for each verdict that is not green."""
    console.print(card.summary)
    rows = [_CardRow(card, flight) for flight in card.commands]
    heads: dict[str, Sequence[object]] = {
        "flight": [row.flight for row in rows],
        "converged": [ShownFigure(row.converged) for row in rows],
        "error\nratio": [ShownFigure(row.ratio) for row in rows],
        "95 % interval": [ShownFigure(row.interval) for row in rows],
        "NEES\n/ideal": [ShownFigure(row.nees) for row in rows],
        "verdict": [row.verdict for row in rows],
    }
    print_table(console, FindingTable("card", "", heads))
    for text in _explain(card, rows):
        print_wrapped(console, text, "bold red" if text[0] == "✗" else "")
    text = f"error ratio: horizontal error / horizontal error of {card.against}, same noise"
    errors = [[x for x in line.by_draw if x is not None] for line in card.lines if line.topic == "accuracy"]
    scatters = [measure_scatter(np.array(one)) for one in errors if one]
    if scatters:  # the flight with the most large runs, or with the largest one
        worst = max(scatters, key=lambda one: (one.most, one.share))
        text += f"{qualify(card.draws)}; at most {worst.large_words}"
    print_wrapped(console, text, "dim")
    print_wrapped(console, describe_suite(card), "dim")


class _CardRow:
    """Values that the screen shows for one flight of a card, taken from the lines of the card."""

    def __init__(self, card: Card, flight: str) -> None:
        lines = [line for line in card.lines if line.flight == flight]
        counts = _find(lines, "convergence", COUNT)
        error, claim = _find(lines, "accuracy"), _find(lines, "honesty")
        good = [value for value in counts.by_draw if value] if counts else []
        self.flight, self.lost = flight, bool(counts) and len(good) < card.draws
        self.converged = f"{len(good)}/{card.draws}"
        self.ratio = write_figure(error.value) if error else "-"
        self.interval = f"{write_figure(error.low)} to {write_figure(error.high)}" if error else "-"
        self.nees = write_figure(claim.value) if claim else "-"
        self.sentence = claim.sentence if claim else ""
        self.value = claim.value if claim else None
        self.word = claim.word if claim else "no covariance"
        shown = f"{card.draws - len(good)} diverged" if self.lost else self.word
        self.verdict = f"{'✗' if self.lost else find_look(self.word).mark} {shown}"


def _find(lines: list[Line], topic: str, word: str = "") -> Line | None:
    return next((one for one in lines if one.topic == topic and word in ("", one.word)), None)


def _explain(card: Card, rows: list[_CardRow]) -> Iterator[str]:
    """Yield why flights are not consistent, what diverged, and every other line with a negative word."""
    broken = [row for row in rows if row.word in _BROKEN]
    if broken:
        values = sorted(row.value for row in broken if row.value is not None)
        told = broken[0].sentence.rpartition(": ")[2].rstrip(".")
        told = f"; {broken[0].flight}: {told}" if " in " in told else ""
        nees = " to ".join(dict.fromkeys(map(write_figure, (values[0], values[-1]))))
        command = card.commands[broken[0].flight]
        yield (
            f"✗ {broken[0].word if len({row.word for row in broken}) == 1 else 'not consistent'} on "
            f"{len(broken)} flight{'s' if len(broken) > 1 else ''}: NEES {nees} times its ideal value{told}. "
            f"Find the cause of the first: {command}"
        )
    by_flight: dict[str, list[LostDraw]] = {}
    for one in card.lost:
        by_flight.setdefault(one.flight, []).append(one)
    for flight, lost in list(by_flight.items())[:_MOST_LOST]:
        runs = f"run{'s' if len(lost) > 1 else ''} {', '.join(str(one.draw) for one in lost)} diverged"
        yield f"✗ {flight}: {runs}: {lost[0].reason[:200]}. Repeat: {lost[0].command}"
    if len(by_flight) > _MOST_LOST:
        yield f"✗ {len(by_flight) - _MOST_LOST} more flights with runs that diverged; -o FILE writes all."
    known = {"", COUNT, "met", *_BROKEN, "consistent"}
    for line in card.lines:
        ahead = line.topic == "causality" and line.value not in (0.0, None)
        if ahead or line.topic == CONVENTIONS or line.word not in known:
            yield f"{'✗' if ahead else find_look(line.word).mark} {line.sentence}"
