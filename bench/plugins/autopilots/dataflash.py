"""Self-describing records of DataFlash logs: ArduPilot's ``.bin``, and sdlog2 of PX4 before 2017.

A record is 0xA3 0x95, a type, and a body whose layout an earlier record FMT gives: name, a letter for each
field, labels (ArduPilot, libraries/AP_Logger/LogStructure.h; PX4, src/modules/sdlog2/sdlog2_format.h).
Whatever is not such a record is skipped, and counted.
"""

from __future__ import annotations

from array import array
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from bench.core.files.file_checks import check_file
from bench.core.mathematics.arrays import FloatArray, IntArray
from bench.core.words.exceptions import ConfigError

_HEAD = b"\xa3\x95"
_FMT, _FMT_LENGTH = 128, 89
_FORMAT = np.dtype([("type", "u1"), ("length", "u1"), ("name", "S4"), ("letters", "S16"), ("labels", "S64")])
_MOST_BYTES = 1_000_000_000
_LETTERS: Mapping[str, tuple[str, float]] = {
    "a": ("(32,)<i2", 1.0),
    "b": ("i1", 1.0),
    "B": ("u1", 1.0),
    "c": ("<i2", 0.01),
    "C": ("<u2", 0.01),
    "d": ("<f8", 1.0),
    "e": ("<i4", 0.01),
    "E": ("<u4", 0.01),
    "f": ("<f4", 1.0),
    "g": ("<f2", 1.0),
    "h": ("<i2", 1.0),
    "H": ("<u2", 1.0),
    "i": ("<i4", 1.0),
    "I": ("<u4", 1.0),
    "L": ("<i4", 1e-7),
    "M": ("u1", 1.0),
    "n": ("S4", 1.0),
    "N": ("S16", 1.0),
    "q": ("<i8", 1.0),
    "Q": ("<u8", 1.0),
    "Z": ("S64", 1.0),
}
"""Letter of a field -> its type, and the factor to the unit of its label."""


@dataclass(frozen=True, slots=True)
class _Layout:
    name: str
    body: np.dtype[np.void]
    factors: Mapping[str, float]


class DataFlash:
    """The records of a file, by name; columns are made at the first access.

    Raises
    ------
    ConfigError
        If the file holds no records.
    """

    def __init__(self, path: Path) -> None:
        check_file(path, path.name, _MOST_BYTES)
        self.shown = path.name
        raw = path.read_bytes()
        self._bytes = np.frombuffer(raw, np.uint8)
        self._layouts: dict[int, _Layout] = {}
        starts = self._follow(raw)
        self._starts = {
            layout.name: (layout, np.array(starts[kind]))
            for kind, layout in self._layouts.items()
            if starts[kind]
        }
        if not self._starts:
            raise ConfigError(f"{path.name}: no records of a DataFlash log (0xA3 0x95, with their FMT)")

    def _follow(self, raw: bytes) -> list[array[int]]:
        """Return where the records of each type start; read the layouts, count the bytes in between."""
        starts = [array("q") for _ in range(256)]
        lengths = [0] * 256
        lengths[_FMT] = _FMT_LENGTH
        at, end, self.skipped = 0, len(raw), 0
        while at + 3 <= end:
            kind = raw[at + 2]
            after = at + lengths[kind]
            if raw[at] == 0xA3 and raw[at + 1] == 0x95 and at < after <= end:
                if kind == _FMT:
                    lengths = self._learn(raw[at + 3 : after], lengths)
                # the last record before a damage is not whole
                if after == end or raw[after : after + 2] == _HEAD[: end - after]:
                    starts[kind].append(at)
                    at = after
                    continue
            found = raw.find(_HEAD, at + 1)
            found = end if found < 0 else found
            self.skipped += found - at
            at = found
        self.skipped += max(end - at, 0)
        return starts

    def _learn(self, body: bytes, lengths: list[int]) -> list[int]:
        """Store the layout in a FMT record, unless it contradicts its own length or an earlier layout."""
        row = np.frombuffer(body, _FORMAT)[0]
        name, letters, labels = (row[key].decode("latin-1") for key in ("name", "letters", "labels"))
        names = [label.strip() for label in labels.split(",")][: len(letters)]
        named = 0 < len(letters) == len(names) == len(set(names)) and all(names)
        if not named or set(letters) - set(_LETTERS):
            return lengths
        dtype = np.dtype([(label, _LETTERS[letter][0]) for label, letter in zip(names, letters, strict=True)])
        kind, length = int(row["type"]), int(row["length"])
        known = self._layouts.get(kind)
        if dtype.itemsize + 3 != length or kind == _FMT or (known and known.body != dtype):
            return lengths
        factors = {label: _LETTERS[letter][1] for label, letter in zip(names, letters, strict=True)}
        self._layouts[kind] = _Layout(name, dtype, factors)
        return [*lengths[:kind], length, *lengths[kind + 1 :]]

    @property
    def names(self) -> list[str]:
        """Names of the records there are."""
        return sorted(self._starts)

    def __contains__(self, name: str) -> bool:
        return name in self._starts

    def find_starts(self, name: str) -> IntArray:
        """Return where the records of a name start in the file (N,): their order among others."""
        return self._starts[name][1]

    def read(self, name: str) -> dict[str, FloatArray]:
        """Return the columns (N,) of the records of a name, in the unit of their label: numbers only."""
        layout = self._starts[name][0]
        table = self._gather(name)
        with np.errstate(invalid="ignore", over="ignore"):  # damage may be any number
            return {
                label: np.asarray(table[label], float) * factor
                for label, factor in layout.factors.items()
                if table[label].dtype.kind != "S" and table[label].ndim == 1
            }

    def read_text(self, name: str, label: str) -> list[str]:
        """Return a column of text; KeyError if there is none."""
        body = self._starts[name][0].body
        if label not in (body.names or ()) or body[label].kind != "S":
            raise KeyError(label)
        return [value.decode("latin-1").strip() for value in self._gather(name)[label].tolist()]

    def _gather(self, name: str) -> NDArray[np.void]:
        layout, starts = self._starts[name]
        bodies = np.lib.stride_tricks.sliding_window_view(self._bytes, layout.body.itemsize)
        return np.ascontiguousarray(bodies[starts + 3]).view(layout.body)[:, 0]
