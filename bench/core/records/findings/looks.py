"""Look of a verdict on a terminal and on a page: one for each word."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Literal, NamedTuple

Kind = Literal["good", "wide", "bad", "none"]
"""Class of a verdict on a page; "wide" is a warning."""

STYLES: Mapping[Kind, str] = {"good": "green", "wide": "yellow", "bad": "bold red", "none": ""}
"""The same on a terminal."""


class VerdictLook(NamedTuple):
    """The color class of a verdict, and a sign for output without colors."""

    kind: Kind
    mark: str

    @property
    def style(self) -> str:
        """The look on a terminal."""
        return STYLES[self.kind]


_GOOD, _BAD = VerdictLook("good", "✓"), VerdictLook("bad", "✗")

LOOKS: Mapping[str, VerdictLook] = {
    **dict.fromkeys(("consistent", "better", "met", "held"), _GOOD),
    **dict.fromkeys(("overconfident", "diverged", "failed", "incomplete", "worse", "missed"), _BAD),
    **dict.fromkeys(("underconfident", "uneven"), VerdictLook("wide", "△")),
    "undecided": VerdictLook("wide", "?"),
    **dict.fromkeys(("no covariance", "not evaluated", "same"), VerdictLook("none", "–")),
}
"""Word of a verdict -> its look."""


def find_look(word: str) -> VerdictLook:
    """Return the look of a word; one that is unknown is taken for a bad verdict."""
    return LOOKS.get(word, _BAD)
