"""Open text files, packed or not: gzip (.gz), or compress of Unix (.Z) as archives have them."""

from __future__ import annotations

import codecs
import gzip
import io
import zlib
from pathlib import Path
from typing import TextIO

from bench.errors import ConfigError

MOST_UNPACKED = 4_000_000_000
"""Largest content of a packed file that is read [byte]."""

_GZIP, _COMPRESS, _ZIP = b"\x1f\x8b", b"\x1f\x9d", b"PK\x03\x04"
_CLEAR = 256  # code that begins the table of a block anew
_MOST_BITS = 16


def open_text(path: Path, shown: str) -> TextIO:
    """Open a text file, packed or not, for reading; a byte order mark is passed over.

    Raises
    ------
    ConfigError
        If it is packed in another way, or is damaged.
    OSError
        If it cannot be opened.
    """
    with path.open("rb") as file:
        magic = file.read(4)
        if magic[:2] == _COMPRESS:
            return io.StringIO(_expand(magic + file.read(), shown).decode("latin-1"), newline="")
    if magic == _ZIP:
        raise ConfigError(f"{shown}: is a ZIP archive; unpack the file first")
    if magic[:2] == _GZIP:
        return io.TextIOWrapper(gzip.open(path), encoding="latin-1", newline="")
    text = path.open(encoding="latin-1", newline="")
    text.seek(len(codecs.BOM_UTF8) if magic.startswith(codecs.BOM_UTF8) else 0)
    return text


def open_bytes(path: Path, shown: str) -> bytes:
    """Return the content of a file, packed with gzip or not; errors as for :func:`open_text`."""
    with path.open("rb") as file:
        packed = file.read(2) == _GZIP
    try:
        with gzip.open(path) if packed else path.open("rb") as file:
            content: bytes = file.read(MOST_UNPACKED + 1)
    except DAMAGED as error:
        raise ConfigError(f"{shown}: is damaged: {error}") from None
    if len(content) > MOST_UNPACKED:
        raise ConfigError(f"{shown}: unpacks to more than {MOST_UNPACKED / 1e9:g} GB")
    return content


DAMAGED = (EOFError, gzip.BadGzipFile, zlib.error)
"""What reading a damaged gzip file raises."""


def _expand(packed: bytes, shown: str) -> bytes:
    """Return the content of a .Z file: LZW with codes of 9 to 16 bits, lowest bit first.

    Welch, A Technique for High-Performance Data Compression, IEEE Computer 17 (6), 1984; the layout is that
    of compress 4.0: codes come in groups of eight, and a group is filled up when their width changes.
    """
    if len(packed) < 3 or packed[2] & 0x60 or not 9 <= packed[2] & 0x1F <= _MOST_BITS:
        raise ConfigError(f"{shown}: is not a .Z file that compress writes")
    most, block = packed[2] & 0x1F, bool(packed[2] & 0x80)
    table = [bytes((k,)) for k in range(256)] + ([b""] if block else [])
    first = len(table)
    bits, at, last, total = 9, 3, b"", 0
    out: list[bytes] = []
    while at < len(packed):
        group = packed[at : at + bits]  # eight codes
        at += bits
        value = int.from_bytes(group, "little")
        width = bits
        for k in range(8 * len(group) // width):
            code = value >> (k * width) & ((1 << width) - 1)
            if code == _CLEAR and block:
                del table[first:]
                bits, last = 9, b""
                break
            if code < len(table):
                text = table[code]
            elif code == len(table) and last:
                text = last + last[:1]
            else:
                raise ConfigError(f"{shown}: is damaged: a code before byte {at} stands for nothing")
            out.append(text)
            total += len(text)
            if last and len(table) < 1 << most:
                table.append(last + text[:1])
            last = text
            if len(table) + 1 > 1 << bits and bits < most:
                bits += 1
                break
        if total > MOST_UNPACKED:
            raise ConfigError(f"{shown}: unpacks to more than {MOST_UNPACKED / 1e9:g} GB")
    return b"".join(out)
