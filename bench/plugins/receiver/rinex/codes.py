"""Which observables of a RINEX file a receiver of one or two bands uses, by system and version."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

from bench.core.records.orbit_sets import BEIDOU, GALILEO, GLONASS, GPS

SYSTEMS = {"G": GPS, "R": GLONASS, "E": GALILEO, "C": BEIDOU}
OTHERS = {"J": "QZSS", "S": "SBAS", "I": "NavIC"}
"""Systems that are read over and left out."""

CODES = {
    "G": (("1C", "1W", "1P", "1L", "1X", "1S"), ("2W", "2P", "2L", "2X", "2S", "2C")),
    "R": (("1C", "1P"), ("2C", "2P")),
    "E": (("1C", "1X", "1B"), ("5Q", "5X", "5I", "7Q", "7X", "7I")),
    "C": (("2I", "2X", "2Q", "1I", "1Q"), ("6I", "6X", "6Q", "7I", "7X", "7Q")),
}
"""Codes of both carriers in order of preference: RINEX 3.05, tables 13 to 20. BeiDou's B1C needs another
message than the D1 and D2 that navigation files have for all satellites."""
_CODES_2 = {
    "G": (("C1", "P1"), ("P2", "C2")),
    "R": (("C1", "P1"), ("P2", "C2")),
    "E": (("C1",), ("C5", "C7")),
    "C": (("C2",), ("C6", "C7")),
}
"""The same of RINEX 2."""


class Signal(NamedTuple):
    """Positions of code, Doppler, C/N0 and phase of a signal among the observables."""

    code: int
    doppler: Sequence[int]  # its own, then those of the other signals of the carrier
    cn0: Sequence[int]  # the same
    phase: int  # -1: missing
    band: int  # RINEX digit of its carrier


Signals = tuple[Sequence[Signal], Sequence[Signal]]
"""Those of both carriers in order of preference; the first one that a satellite has at an epoch is used."""


def find_signals(letter: str, types: Sequence[str], version: float) -> Signals:
    """Return the signals of a system among the observables of a file.

    In RINEX 3.02 the B1I of BeiDou is 1I, 1Q or 1X, in all others 2I, 2Q or 2X; 1X is B1C from 3.04 on.
    """
    first, second = (_CODES_2 if version < 3 else CODES)[letter]
    if letter == "C" and round(100 * version) == 302:
        first = ("1I", "1X", "1Q", *first)
    at = {name: k for k, name in enumerate(types)}
    return _find(letter, first, at, version), _find(letter, second, at, version)


def _find(letter: str, codes: Sequence[str], at: Mapping[str, int], version: float) -> list[Signal]:
    found: list[tuple[int, str, int]] = []
    for code in codes:
        name = code if version < 3 else f"C{code}"
        if name in at:
            digit = code[1] if version < 3 else code[0]
            band = 2 if letter == "C" and digit == "1" else int(digit)
            found.append((at[name], digit if version < 3 else code, band))
    signals = []
    for place, own, band in found:
        names = dict.fromkeys([own, *(other for _, other, its in found if its == band)])
        doppler, cn0 = ([at[kind + one] for one in names if kind + one in at] for kind in "DS")
        signals.append(Signal(place, doppler, cn0, at.get(f"L{own}", -1), band))
    return signals
