"""Output on a stream that may be closed or full: the verb continues, and its results are kept."""

from __future__ import annotations

import codecs
import errno
import os
import select
import sys
import unicodedata
from io import BufferedWriter, FileIO, RawIOBase, TextIOWrapper
from typing import Any

_SIGNS = {
    "≥": ">=",
    "≤": "<=",
    "±": "+-",
    "–": "-",
    "−": "-",
    "σ": "sigma",
    "√": "sqrt",
    "°": " deg",
    "•": "*",
    "✓": "ok",
    "✗": "FAIL",
    "△": "warn",
}
_LINES = range(0x2500, 0x2580)  # that draw boxes
_HANDLER = "bench.plain"


class _Steady(RawIOBase):
    """The file of a stream; after a write error, the rest is dropped and the reason is kept."""

    def __init__(self, file: FileIO) -> None:
        self.file = file
        self.lost: OSError | None = None

    def writable(self) -> bool:
        """Return that it can be written."""
        return True

    def fileno(self) -> int:
        """Return the descriptor of the file."""
        return self.file.fileno()

    def isatty(self) -> bool:
        """Return whether the file is a terminal."""
        return self.file.isatty()

    def write(self, data: Any) -> int:
        """Write to the file, and return how many bytes it took."""
        if self.lost is None:
            try:
                while (taken := self.file.write(data)) is None:  # a pipe that does not block, and is full
                    select.select([], [self.file], [])
                return taken
            except OSError as error:
                self.lost = error
        return len(data)


def let_streams_write_all() -> None:
    """Let the streams of this process take whatever is printed.

    A sign like it stands for a character that the encoding lacks, unless the stream has a way of its own, as
    by ``PYTHONIOENCODING=ascii:replace``. What a closed pipe or a full device does not take is dropped.
    """
    codecs.register_error(_HANDLER, _write_plainly)
    for name in ("stdin", "stdout", "stderr"):
        stream = getattr(sys, name)
        if stream is None:  # closed: the next file would be opened in its place
            setattr(sys, name, open(os.devnull, "r+"))  # noqa: SIM115 - for good
        elif name != "stdin":
            setattr(sys, name, _steady(stream))


def _steady(stream: Any) -> Any:
    """Return a stream to the same file that accepts any text; return a stream without a file unchanged."""
    if not isinstance(stream, TextIOWrapper):
        return stream
    own = stream.errors not in ("strict", "backslashreplace", "surrogateescape")
    file: Any = getattr(stream.buffer, "raw", stream.buffer)  # itself if Python does not buffer
    return TextIOWrapper(
        BufferedWriter(_Steady(file)),
        stream.encoding,
        stream.errors if own else _HANDLER,
        line_buffering=stream.line_buffering,
        write_through=stream.write_through,
    )


def find_lost() -> OSError | None:
    """Return the reason why the standard output is incomplete; None if it is complete or its reader ended."""
    sys.stdout.flush()
    lost = getattr(getattr(sys.stdout.buffer, "raw", None), "lost", None)
    return None if lost is None or lost.errno == errno.EPIPE else lost


def _write_plainly(error: UnicodeError) -> tuple[str, int]:
    """Return ASCII replacements for characters that a codec cannot encode, and the next position."""
    if not isinstance(error, UnicodeEncodeError):
        raise error
    wrong = error.object[error.start : error.end]
    return "".join(map(_find_sign, wrong)), error.end


def _find_sign(character: str) -> str:
    if ord(character) in _LINES:
        return "-"
    bare = unicodedata.normalize("NFKD", character).encode("ascii", "ignore").decode()
    return _SIGNS.get(character) or bare or "?"
