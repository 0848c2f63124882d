"""DataFlash files for tests: records written from rows, and read one by one with struct."""

from __future__ import annotations

import struct
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

HEAD, FMT = b"\xa3\x95", 128
CODES = {
    **{letter: letter for letter in "bBhHiIqQfd"},
    **{"c": "h", "C": "H", "e": "i", "E": "I", "L": "i", "M": "B", "g": "e"},
    **{"n": "4s", "N": "16s", "Z": "64s", "a": "64s"},
}
SCALES = {"c": 0.01, "C": 0.01, "e": 0.01, "E": 0.01, "L": 1e-7}

Kinds = Mapping[str, tuple[str, str]]
"""Name of a record -> its letters, its labels."""


def describe(number: int, name: str, letters: str, labels: str) -> bytes:
    """Return the FMT of a record."""
    length = 3 + struct.calcsize("<" + "".join(CODES[letter] for letter in letters))
    body = struct.pack("<BB4s16s64s", number, length, name.encode(), letters.encode(), labels.encode())
    return HEAD + bytes([FMT]) + body


def write_flash(path: Path, kinds: Kinds, rows: Sequence[tuple[str, Sequence[Any]]]) -> Path:
    """Write records in their order; values are in the unit of their label."""
    numbers = {name: number for number, name in enumerate(kinds, 1)}
    parts = [describe(numbers[name], name, *kinds[name]) for name in kinds]
    for name, values in rows:
        letters = kinds[name][0]
        plain = [
            value.encode() if isinstance(value, str) else
            round(value / SCALES.get(letter, 1.0)) if CODES[letter] not in ("f", "d") else value
            for letter, value in zip(letters, values, strict=True)
        ]  # fmt: skip
        body = struct.pack("<" + "".join(CODES[letter] for letter in letters), *plain)
        parts.append(HEAD + bytes([numbers[name]]) + body)
    path.write_bytes(b"".join(parts))
    return path


def unpack(path: Path) -> list[tuple[str, int, dict[str, Any]]]:
    """Return name, place and values of every record of a sound file."""
    raw, at, known, found = path.read_bytes(), 0, {}, []
    known[FMT] = ("FMT", "BBnNZ", ["Type", "Length", "Name", "Format", "Columns"])
    while at + 3 <= len(raw):
        assert raw[at : at + 2] == HEAD, at
        name, letters, labels = known[raw[at + 2]]
        layout = struct.Struct("<" + "".join(CODES[letter] for letter in letters))
        if at + 3 + layout.size > len(raw):
            break
        values = layout.unpack_from(raw, at + 3)
        if name == "FMT":
            texts = [value.rstrip(b"\0").decode() for value in values[2:]]
            known[values[0]] = (texts[0], texts[1], texts[2].split(","))
        scaled = (
            value if isinstance(value, bytes) else value * SCALES.get(letter, 1)
            for letter, value in zip(letters, values, strict=True)
        )
        found.append((name, at, dict(zip(labels, scaled, strict=False))))
        at += 3 + layout.size
    return found
