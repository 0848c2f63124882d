"""A verdict looks the same wherever it stands."""

import io
from typing import get_args

import pytest
from rich.text import Text

from bench.cli.verbs.check_verb import tabulate_verdicts
from bench.cli.verbs.console import PlainConsole
from bench.cli.verbs.printing import print_findings
from bench.core.records.findings import FindingTable
from bench.core.records.findings.looks import LOOKS, find_look
from bench.evaluation.consistency import verdict
from bench.evaluation.ensembles import ensemble_consistency, paired_draws
from bench.evaluation.requirements import required_metrics
from bench.experiments.baselines.verdict_rows import Verdict, Word

WORDS = {
    *get_args(Word),
    *get_args(paired_draws.Word),
    *get_args(ensemble_consistency.Word),
    required_metrics.MET,
    required_metrics.MISSED,
    required_metrics.UNDECIDED,
    *(value for name, value in vars(verdict).items() if name.isupper() and isinstance(value, str)),
}


def test_every_word_has_its_look():
    assert len(WORDS) > 12
    assert sorted(WORDS - LOOKS.keys()) == []
    assert find_look("something else").kind == "bad"
    assert [find_look(word).kind for word in ("better", "undecided", "worse", "same")] == [
        "good", "wide", "bad", "none",
    ]  # fmt: skip


def print_table(table, width=80):
    file = io.StringIO()
    print_findings(PlainConsole(file=file, width=width, force_terminal=True), ["A sentence."], [table])
    return Text.from_ansi(file.getvalue()), file.getvalue()


@pytest.mark.parametrize(("word", "code"), [("undecided", "33"), ("worse", "1;31"), ("met", "32")])
def test_a_word_in_any_table_has_its_color_and_others_have_none(word, code):
    _, colored = print_table(FindingTable("x", "", {"unit": ["a", "b"], "told": [word, f"{word} by far"]}))
    assert f"\x1b[{code}m{word}" in colored
    assert colored.count(f"\x1b[{code}m") == 1


def verdict_row(metric, word, note=""):
    return Verdict("p", "f", metric, "m", word, 1.0, 2.0, 1.0, 0.5, 1.5, True, 20, True, note)


def test_verdicts_are_one_table_for_check_and_compare():
    """The words of a note take the room that is left, and nothing of it is cut."""
    note = "a note of some length on what the figures of this metric do not say at all"
    table = tabulate_verdicts(
        [verdict_row("a", "worse"), verdict_row("b", "undecided", note)], heads=("x", "y")
    )
    assert list(table.columns) == ["metric", "x", "y", "verdict", "change, + is worse"]
    plain, _ = print_table(table, width=70)
    lines = plain.plain.splitlines()
    assert max(map(len, lines)) <= 70
    assert set(note.split()) <= set(plain.plain.split())
    assert lines[-1] == "A sentence."


def test_single_draws_are_compared_without_a_word():
    table = tabulate_verdicts([verdict_row("a", "undecided", "one run: no interval")])
    assert list(table.columns) == ["metric", "before", "now"]
