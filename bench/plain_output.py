"""Output on a stream that cannot write every character: a sign like it in its place, and never an error."""

from __future__ import annotations

import codecs
import sys
import unicodedata
from io import TextIOWrapper

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
}
_LINES = range(0x2500, 0x2580)  # that draw boxes
_HANDLER = "bench.plain"


def let_streams_write_all() -> None:
    """Let the streams of this process write what their encoding has no characters for.

    One that has been given a way of its own to do so, as by ``PYTHONIOENCODING=ascii:replace``, keeps it.
    """
    codecs.register_error(_HANDLER, _write_plainly)
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, TextIOWrapper) and stream.errors in ("strict", "backslashreplace"):
            stream.reconfigure(errors=_HANDLER)


def _write_plainly(error: UnicodeError) -> tuple[str, int]:
    """Return ASCII for the characters that a codec has none for, and where it goes on."""
    if not isinstance(error, UnicodeEncodeError):
        raise error
    wrong = error.object[error.start : error.end]
    return "".join(map(_find_sign, wrong)), error.end


def _find_sign(character: str) -> str:
    if ord(character) in _LINES:
        return "-"
    bare = unicodedata.normalize("NFKD", character).encode("ascii", "ignore").decode()
    return _SIGNS.get(character) or bare or "?"
