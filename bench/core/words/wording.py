"""Wording of messages: numbers, a wrong value as written in TOML, and text without control characters."""

from __future__ import annotations

import difflib
import functools
import json
import sys
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from bench.core.mathematics.units import unit_of
from bench.core.words.renames import rename


def replace_control(text: str) -> str:
    """Return a text with ``?`` for characters that move the cursor or turn the direction of writing.

    They are all that Python does not print as they are, but for the end of a line and spaces.
    """
    if text.isprintable():
        return text
    return "".join(c if c == "\n" or c.isprintable() or c in _SPACES else "?" for c in text)


def one_line(text: str) -> str:
    """Return a title or a name from a file on one line, without control characters."""
    return replace_control(text.replace("\n", " "))


def format_count(number: int, what: str) -> str:
    """Return a number of things in words.

    Examples
    --------
    >>> format_count(1, "gap"), format_count(2, "fix")
    ('1 gap', '2 fixes')
    """
    return f"{number} {what}" if number == 1 else f"{number} {what}{'es' if what.endswith('x') else 's'}"


_SPACES = "\u00a0\u2002\u2003\u2007\u2009\u202f\u3000"
"""Spaces that Python does not count as printable."""


def quantity(key: str, value: object) -> str:
    """Return ``key = value unit`` as it is written in the file."""
    text = f"{key} = {as_toml(value)}"
    is_number = isinstance(value, (int, float)) and not isinstance(value, bool)
    unit = unit_of(_strip_index(key)) if is_number else ""
    return f"{text} {unit}" if unit else text


def _strip_index(key: str) -> str:
    return key.partition("[")[0]  # pos_m[1] is an entry of pos_m


def suggest(wrong: str, known: Iterable[str], what: str) -> str:
    """Return the end of a message: the nearest known name, if any is near, and the list of all."""
    names = sorted(known)
    lower = {name.lower(): name for name in names}
    meant = _translate(wrong.lower())
    near = difflib.get_close_matches(meant, lower, n=1) or [
        one for one in lower if one.startswith(f"{meant}_")
    ]
    hint = f". Did you mean {lower[near[0]]!r}?" if near else ""
    return f"{hint}\n  known {what}: {', '.join(names) if names else '(none)'}"


_ALSO_CALLED = {
    "angular_random_walk": "noise",
    "arw": "noise",
    "velocity_random_walk": "noise",
    "vrw": "noise",
    "bias_stability": "bias_instability",
    "in_run_bias": "bias_instability",
    "lat": "lat_deg",
    "lon": "lon_deg",
    "altitude": "alt_m",
    "latitude": "lat_deg",
    "longitude": "lon_deg",
}
"""What datasheets and users call a key -> how its name begins here."""


def _translate(wrong: str) -> str:
    """Return a key by the name that it has here; anything else as it is."""
    if (today := rename(wrong)) != wrong:
        return today
    for other in sorted(_ALSO_CALLED, key=len, reverse=True):
        if wrong == other or wrong.startswith(f"{other}_"):
            return _ALSO_CALLED[other] + wrong.removeprefix(other)
    return wrong


def tell_where(path: str) -> str:
    """Return the end of "no such file" for a path of a profile, which is relative to the profile."""
    return "" if Path(path).is_absolute() else " beside the profile"


def describe_error(key: str, value: object, kind: str, message: str, context: Mapping[str, Any]) -> str:
    """Return ``key = value unit`` and what it must be, from the kind and context of a pydantic error."""
    if kind == "range":
        unit = unit_of(_strip_index(key))
        limits = f"{context['low']:g} to {context['high']:g}{' ' + unit if unit else ''}"
        return f"{quantity(key, value)} is outside {limits}"
    return f"{quantity(key, value)} {_describe_wanted(kind, message, context)}"


def _describe_wanted(kind: str, message: str, context: Mapping[str, Any]) -> str:
    if kind == "message":
        return message
    if kind == "literal_error":
        return f"must be {context['expected']}"
    if kind == "too_short" or kind == "too_long":
        few, limit = kind == "too_short", context["min_length" if kind == "too_short" else "max_length"]
        return f"must have {'at least' if few else 'at most'} {limit} {'entry' if limit == 1 else 'entries'}"
    if kind == "missing_positional_only_argument" or kind == "missing":
        return "has too few values"
    limits = {"greater_than": "above", "greater_than_equal": "at least", "less_than_equal": "at most"}
    if kind in limits:
        return f"must be {limits[kind]} {next(iter(context.values())):g}"
    kinds = {
        "float_parsing": "a number",
        "int_parsing": "a whole number",
        "float_type": "a number",
        "finite_number": "a finite number",
        "int_type": "a whole number",
        "int_from_float": "a whole number",
        "string_type": "a text in quotes",
        "bool_type": "true or false",
        "model_type": "a table",
        "model_attributes_type": "a table",
        "dict_type": "a table",
        "tuple_type": "a list",
        "date_type": "a date, as 2026-01-31",
    }
    return f"must be {kinds[kind]}" if kind in kinds else f"is wrong: {message}"


def format_number(value: Any, digits: int = 4) -> str:
    """Return a number with so many digits, without a power of ten below ten million; a dash for None.

    Examples
    --------
    >>> format_number(15510.4), format_number(2.0 / 3.0, 3), format_number(None)
    ('15510', '0.667', '-')
    """
    if value is None:
        return "-"
    text = f"{value:.{digits}g}"
    return f"{float(text):.0f}" if "e+" in text and abs(value) < 1e7 else text


def quote_toml(text: str) -> str:
    """Return a text as a string of TOML on one line: only JSON escapes what is outside 16 bits in two halves.

    Examples
    --------
    >>> print(quote_toml('a "b"'))
    "a \\"b\\""
    """
    return json.dumps(text, ensure_ascii=False).replace("\x7f", "\\u007f")


def format_value(value: object) -> str:
    """Return a value of TOML as text in one line, with all its digits."""
    if isinstance(value, Mapping):
        inner = (f"{quote_toml(key)} = {format_value(one)}" for key, one in value.items())
        return f"{{{', '.join(inner)}}}"
    if isinstance(value, list | tuple):
        return f"[{', '.join(map(format_value, value))}]"
    if isinstance(value, bool):
        return str(value).lower()
    return quote_toml(value) if isinstance(value, str) else str(value)


def as_toml(value: object) -> str:
    """Return a value as it would be written in a TOML file, shortened to 60 characters."""
    if isinstance(value, bool):
        text = str(value).lower()
    elif isinstance(value, list | tuple):
        text = f"[{', '.join(as_toml(v) for v in value)}]"
    elif isinstance(value, Mapping):
        text = "{ ... }"
    elif isinstance(value, str | float):
        text = repr(value).removesuffix(".0")
    else:
        text = str(value)
    return text if len(text) <= 60 else f"{text[:57]}..."


def read_words(kind: type) -> dict[str, str]:
    """Return the text below each field of a class and its bases, by name of the field, on one line.

    Help and guide ask for them here. They are read from the source when asked for, so that no import has to.
    """
    found: dict[str, str] = {}
    for owner in reversed(kind.__mro__):
        file = getattr(sys.modules[owner.__module__], "__file__", None)
        found |= _read_fields(file).get(owner.__qualname__, {}) if file else {}
    return found


@functools.cache
def _read_fields(file: str) -> dict[str, dict[str, str]]:
    """Return the text below each field by class and field of a file."""
    import ast
    from itertools import pairwise

    found: dict[str, dict[str, str]] = {}
    for one in ast.parse(Path(file).read_text(encoding="utf-8")).body:
        if isinstance(one, ast.ClassDef):
            for field, text in pairwise(one.body):
                match field, text:
                    case ast.AnnAssign(ast.Name(name)), ast.Expr(ast.Constant(str(words))):
                        found.setdefault(one.name, {})[name] = " ".join(words.split())
    return found
