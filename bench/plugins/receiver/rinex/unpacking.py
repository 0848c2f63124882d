"""Open files, packed or not: gzip (.gz), or compress of Unix (.Z) as archives have them, block by block."""

from __future__ import annotations

import codecs
import gzip
import io
import re
import zlib
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any

from bench.core.files.file_checks import check_file
from bench.core.files.framed_stream import find_frames
from bench.core.words.exceptions import ConfigError

BLOCK = 1 << 16
"""Read and unpacked at a time, at least [byte]."""
MOST_BYTES = 2_000_000_000
"""Largest file that is read [byte]."""
MOST_UNPACKED = 4_000_000_000
"""Largest content of a packed file that is read [byte]."""

_GZIP, _COMPRESS, _ZIP = b"\x1f\x8b", b"\x1f\x9d", b"PK\x03\x04"
_CLEAR = 256  # code that begins the table of a block anew
_MOST_BITS = 16
_TAIL = 256  # of the text of a code that the table holds [byte]; what is before it is that of another code


class UnpackingError(Exception):
    """A packed file is damaged, or contains too much; the text follows the name of the file."""


def open_text(path: Path, shown: str) -> io.TextIOWrapper:
    """Open a text file, packed or not, for reading; a byte order mark is passed over.

    What is opened raises `UnpackingError`, here or where it is read.

    Raises
    ------
    ConfigError
        If it is packed in another way.
    OSError
        If it cannot be opened.
    """
    file = open_binary(path, shown)
    try:
        if file.peek(len(codecs.BOM_UTF8)).startswith(codecs.BOM_UTF8):
            file.read(len(codecs.BOM_UTF8))
    except UnpackingError:
        file.close()
        raise
    return io.TextIOWrapper(file, encoding="latin-1", newline="")


def open_binary(path: Path, shown: str) -> io.BufferedReader:
    """Open a file, packed or not, for reading; errors as for :func:`open_text`."""
    packed: io.BufferedReader = io.BufferedReader(io.FileIO(path), BLOCK)
    magic = packed.peek(len(_ZIP))
    if magic.startswith(_ZIP):
        packed.close()
        raise ConfigError(f"{shown}: is a ZIP archive; unpack the file first")
    if magic.startswith(_GZIP):
        blocks = iter(partial(gzip.GzipFile(fileobj=packed).read, BLOCK), b"")
        return io.BufferedReader(_Unpacked(packed, blocks), BLOCK)
    if magic.startswith(_COMPRESS):
        return io.BufferedReader(_Unpacked(packed, _expand(packed)), BLOCK)
    return packed


def read_frames(
    path: Path, shown: str, mark: re.Pattern[bytes], longest: int, measure: Callable[[bytes, int], int]
) -> Iterator[bytes | None]:
    """Yield the frames of a stream, packed or not, as `find_frames` does.

    Raises
    ------
    ConfigError
        If the file cannot be read or unpacked, or is too large.
    """
    try:
        check_file(path, shown, MOST_BYTES)
        with open_binary(path, shown) as file:
            yield from find_frames(file, mark, longest, measure)
    except UnpackingError as error:
        raise ConfigError(f"{shown}: {error}") from None
    except OSError as error:
        raise ConfigError(f"{shown}: {error.strerror or error}") from None


class _Unpacked(io.RawIOBase):
    """The content of a packed file, which comes in blocks."""

    def __init__(self, packed: io.BufferedReader, blocks: Iterator[bytes]) -> None:
        self._packed, self._blocks = packed, blocks
        self._block, self._total = memoryview(b""), 0

    def readable(self) -> bool:
        """Return that it can be read."""
        return True

    def readinto(self, buffer: Any) -> int:
        """Fill a buffer; return the number of bytes, 0 at the end."""
        filled = 0
        while filled < len(buffer):
            if not self._block and not self._take():
                break
            count = min(len(buffer) - filled, len(self._block))
            buffer[filled : filled + count] = self._block[:count]
            self._block, filled = self._block[count:], filled + count
        return filled

    def _take(self) -> bool:
        """Unpack the next block; return whether there is one."""
        try:
            block = next(self._blocks, b"")
        except (EOFError, gzip.BadGzipFile, zlib.error) as error:
            raise UnpackingError(f"is damaged: {error}") from None
        self._block, self._total = memoryview(block), self._total + len(block)
        if self._total > MOST_UNPACKED:
            raise UnpackingError(f"unpacks to more than {MOST_UNPACKED / 1e9:g} GB")
        return bool(block)

    def close(self) -> None:
        """Close the packed file, too."""
        self._packed.close()
        super().close()


def _expand(packed: io.BufferedReader) -> Iterator[bytes]:
    """Yield the content of a .Z file: LZW with codes of 9 to 16 bits, lowest bit first.

    Welch, A Technique for High-Performance Data Compression, IEEE Computer 17 (6), 1984; the layout is that
    of compress 4.0: codes come in groups of eight, and a group is filled up when their width changes.
    The text of a code is that of the code before it, and its tail.
    """
    head = packed.read(3)
    if len(head) < 3 or head[2] & 0x60 or not 9 <= head[2] & 0x1F <= _MOST_BITS:
        raise UnpackingError("is not a .Z file that compress writes")
    most, block = head[2] & 0x1F, bool(head[2] & 0x80)
    tails = [bytes((k,)) for k in range(256)] + ([b""] if block else [])
    before = [-1] * len(tails)
    first = len(tails)
    bits, at, last, text = 9, 3, -1, b""
    out, size = list[bytes](), 0
    while group := packed.read(bits):  # eight codes
        at += bits
        value, width = int.from_bytes(group, "little"), bits
        for k in range(8 * len(group) // width):
            code = value >> (k * width) & ((1 << width) - 1)
            if code == _CLEAR and block:
                del tails[first:], before[first:]
                bits, last = 9, -1
                break
            if code < len(tails):
                parts, here = [tails[code]], before[code]
                while here >= 0:
                    parts.append(tails[here])
                    here = before[here]
                text = b"".join(reversed(parts))
            elif code == len(tails) and last >= 0:
                text += text[:1]
            else:
                raise UnpackingError(f"is damaged: a code before byte {at} stands for nothing")
            out.append(text)
            size += len(text)
            if last >= 0 and len(tails) < 1 << most:
                whole = len(tails[last]) == _TAIL
                tails.append(text[:1] if whole else tails[last] + text[:1])
                before.append(last if whole else before[last])
            last = code
            if len(tails) + 1 > 1 << bits and bits < most:
                bits += 1
                break
        if size >= BLOCK:
            yield b"".join(out)
            out, size = [], 0
    yield b"".join(out)
