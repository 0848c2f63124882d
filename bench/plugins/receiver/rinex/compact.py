"""Restore RINEX observations from Compact RINEX, versions 1 and 3 (Hatanaka compression).

Hatanaka, A Compression Format and Tools for GNSS Observation Data, Bulletin of the Geographical Survey
Institute 55 (2008) 21-30. Each value is an integer, of which the file has the difference of order k to the
epochs before; text has only the characters that change. The package hatanaka takes a seventh of the time,
0.04 instead of 0.26 s for 1.7 MB, by a C program that gets the whole file; here memory stays small, and
damage costs only the epochs until the next one that begins anew.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from typing import TextIO

from bench.core.words.exceptions import ConfigError

LONGEST = 4096  # characters of a line; 255 observables, more than any receiver writes, fit in one
_LONGEST_COMPACT = 2 * LONGEST  # the same values with the marks of an epoch that begins anew
_MOST_ORDER = 9
_LEAST, _MOST = -(10**12), 10**13  # thousandths outside of which a value is wider than its field of 14
_MARK = re.compile(r"(\d)&(-?\d+)")


class CompactText:
    """A Compact RINEX file as the RINEX file that it was made of, line by line.

    ``lost`` counts the epochs that cannot be restored, ``reasons`` has why the first is: after a damaged line
    nothing is known until the next epoch that begins anew.
    """

    def __init__(self, file: TextIO, shown: str, first: str) -> None:
        self._file, self._shown = file, shown
        self._number = 1
        self._lines = self._restore(first)
        self.lost = 0
        self.reasons: list[str] = []

    def readline(self, most: int = -1) -> str:
        """Return the next line with its end; empty at the end of the file."""
        return next(self._lines, "")

    def _next(self) -> str | None:
        """Return the next line, None at the end of the file; raise ValueError if it is too long."""
        line = self._file.readline(_LONGEST_COMPACT + 1)
        self._number += 1
        if len(line) > _LONGEST_COMPACT:
            while line and not line.endswith("\n"):
                line = self._file.readline(_LONGEST_COMPACT)
            raise ValueError("a line is too long")
        return line.rstrip("\r\n") if line else None

    def _lose(self, number: int, why: str) -> None:
        self.lost += 1
        self.reasons = self.reasons or [f"{self._shown}: line {number}: {why}"]

    def _restore(self, first: str) -> Iterator[str]:
        version = first[:3].strip()
        if not version.startswith(("1", "3")):
            raise ConfigError(f"{self._shown}: line 1: Compact RINEX {version} must be version 1 or 3")
        modern = version.startswith("3")
        types: dict[str, int] = {}
        try:
            self._next()
            while (line := self._next()) is not None:
                yield line + "\n"
                _count_types(line, types)
                if line[60:73] == "END OF HEADER":
                    break
        except ValueError as error:
            raise ConfigError(f"{self._shown}: line {self._number}: {error}: not a RINEX file") from None
        yield from self._restore_epochs(modern, types)

    def _restore_epochs(self, modern: bool, types: dict[str, int]) -> Iterator[str]:
        head, begin = "", ">" if modern else "&"
        arcs: dict[str, _Arcs] = {}
        known = False
        while True:
            try:
                if (line := self._next()) is None:
                    return
                if line[:1] == begin:
                    head, arcs, known = line.replace("&", " ") if not modern else line, {}, True
                elif known:
                    head = _change(head, line)
                else:
                    continue
                flag = head[31 if modern else 28 :][:1]
                count = int(head[32:35] if modern else head[29:32])
                if flag.strip() and flag > "1":
                    yield head.rstrip() + "\n"
                    for _ in range(count):
                        line = self._next() or ""
                        yield line + "\n"
                        _count_types(line, types)
                    continue
                clock = self._next()
                del clock
                names = head[41 if modern else 32 :]
                sats = [names[3 * k : 3 * k + 3] for k in range(count)]
                now = {}
                for k, sat in enumerate(sats):
                    system = sat[:1] if modern else " "
                    before = arcs.get(sat)
                    now[sat] = before if before is not None else _Arcs(types[system])
                    text = self._next()
                    if text is None:
                        ends = f"the file ends before satellite {k + 1} of {count} of the epoch"
                        self._lose(self._number - 1, ends)
                        return
                    now[sat].read(text)
                arcs = now
            except (ValueError, KeyError, IndexError):
                self._lose(self._number, "the epoch cannot be restored")
                known = False
                continue
            yield from (_write_modern if modern else _write_classic)(head, sats, now)


class _Arcs:
    """The values of one satellite: differences of each observable, and flags."""

    def __init__(self, count: int) -> None:
        self._state: list[list[int] | None] = [None] * count
        self._order = [0] * count
        self.flags = ""

    def read(self, text: str) -> None:
        """Take the line of an epoch.

        Raises
        ------
        ValueError
            If a value is no number, does not fit into its field, or goes on from none.
        """
        parts = text.split(" ", len(self._state))
        if len(parts) > len(self._state):
            self.flags = _change(self.flags, parts.pop())
        parts += [""] * (len(self._state) - len(parts))
        for k, part in enumerate(parts):
            if not part:
                self._state[k] = None
            elif part[1:2] == "&":
                mark = _MARK.fullmatch(part)
                if mark is None or not 0 < int(mark[1]) <= _MOST_ORDER:
                    raise ValueError(part)
                self._order[k], self._state[k] = int(mark[1]), [int(mark[2])]
            else:
                state = self._state[k]
                if state is None:
                    raise ValueError(part)
                if len(state) <= self._order[k]:  # the order of the differences still grows
                    state.append(0)
                state[-1] = int(part)
                for j in range(len(state) - 2, -1, -1):
                    state[j] += state[j + 1]
            if (state := self._state[k]) is not None and not _LEAST < state[0] < _MOST:
                raise ValueError(part)

    def write(self) -> list[str]:
        """Return the fields of the observables, 16 characters each."""
        flags = self.flags.ljust(2 * len(self._state))
        return [
            f"{state[0] / 1000:14.3f}{flags[2 * k : 2 * k + 2]}" if state is not None else " " * 16
            for k, state in enumerate(self._state)
        ]


def _change(before: str, changes: str) -> str:
    """Return a text with its changes: a blank keeps a character, & makes it a blank."""
    width = max(len(before), len(changes))
    pairs = zip(before.ljust(width), changes.ljust(width), strict=True)
    return "".join(old if new == " " else " " if new == "&" else new for old, new in pairs)


def _count_types(line: str, types: dict[str, int]) -> None:
    """Take the number of observables from a line of a header."""
    label = line[60:80].strip()
    if label == "SYS / # / OBS TYPES" and line[:1].strip():
        types[line[0]] = int(line[3:6])
    elif label == "# / TYPES OF OBSERV" and line[:6].strip():
        types[" "] = int(line[:6])


def _write_modern(head: str, sats: list[str], arcs: dict[str, _Arcs]) -> Iterator[str]:
    yield head[:35].rstrip() + "\n"
    for sat in sats:
        yield (sat + "".join(arcs[sat].write())).rstrip() + "\n"


def _write_classic(head: str, sats: list[str], arcs: dict[str, _Arcs]) -> Iterator[str]:
    for k in range(0, max(len(sats), 1), 12):
        yield (head[:32] if k == 0 else " " * 32) + "".join(sats[k : k + 12]) + "\n"
    for sat in sats:
        fields = arcs[sat].write()
        for k in range(0, len(fields), 5):
            yield "".join(fields[k : k + 5]).rstrip() + "\n"
