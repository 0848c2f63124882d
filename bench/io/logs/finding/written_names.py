"""Words and units in the column names of other people."""

from __future__ import annotations

import re
from collections.abc import Mapping

from bench.core.mathematics.units import ENDINGS, split_unit

_WRITTEN = {unit.symbol.replace("^", "").lower(): ending for ending, unit in ENDINGS.items()}
"""Unit in brackets behind a name -> ending."""
FOREIGN = re.compile(r"f(oo|ee)?t(/s)?|kno?ts?|kn|mph|min|h|hours?")
"""Units that no column of a log has."""
IN_BRACKETS = re.compile(r"[\[(](?!\d+[\])])")
"""A unit, but no index."""
_RUN_TOGETHER = {
    **{"_dps": "_deg_s", "_degps": "_deg_s", "_degs": "_deg_s", "_radps": "_rad_s", "_rads": "_rad_s"},
    **{"_kmh": "_km_h", "_kph": "_km_h", "_mps2": "_m_s2", "_ms2": "_m_s2", "_mss": "_m_s2"},
}
"""Endings of units as others write them -> ending."""
_SPELLINGS = {
    "°": "deg",
    "degrees": "deg",
    "dps": "deg/s",
    "µ": "u",
    "μ": "u",
    "²": "2",
    "/s1": "/s",
    "/s/s": "/s2",
    "sec": "s",
    "kmh": "km/h",
    "kph": "km/h",
}
_ACCURACY = re.compile(r"(.*_)?(sd|std|stddev|sigma|var|cov|accuracy)(_.*)?")
_NO_GRAVITY = re.compile(r"(.*_)?(linear|lin|free|user|gravity|bias|mag).*")
"""Words of accelerations other than the specific force, in the tables of phones and filters."""


def split_name(name: str) -> tuple[str, str]:
    """Return the words of a name, and the ending of its unit, which may follow in brackets.

    A unit that no column of a log has is returned unchanged; empty if there is none.
    """
    name = re.sub(r"\[\d+\]", "", name.lower()).replace("[", "(")  # gyroADC[0] (deg/s)
    words, _, bracket = re.sub(r"[\])].*", "", name).partition("(")
    words = words.strip().lstrip("#").strip().replace(" ", "_")
    for theirs, ours in _RUN_TOGETHER.items():
        if words.endswith(theirs):
            return words.removesuffix(theirs), ours
    stem = split_unit(words)[0]
    if stem != words:
        return stem, words[len(stem) :]
    written = re.sub(r"[\s^]", "", re.sub(r"[ .*·]*s\.?\^?-", "/s", bracket.strip()))
    for theirs, ours in _SPELLINGS.items():
        written = written.replace(theirs, ours)
    return stem, written if FOREIGN.fullmatch(written) else _WRITTEN.get(written, "")


def find_name(pattern: str, plain: Mapping[str, tuple[str, str]], taken: Mapping[str, str]) -> str | None:
    """Return the shortest name that fits a pattern, is not taken, and does not name an accuracy.

    A pattern that ends in "_m" is for names with that unit.
    """
    fitting = [
        name
        for name, (stem, ending) in plain.items()
        if re.fullmatch(pattern, f"{stem}{ending}" if pattern.endswith("_m") else stem)
        and not any(other.fullmatch(stem) for other in (_ACCURACY, _NO_GRAVITY))
        and name not in taken.values()
    ]
    return min(fitting, key=len, default=None)
