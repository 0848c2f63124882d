"""Read TOML files into checked tables; one line for each problem."""

from __future__ import annotations

import re
import tomllib
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Literal, TypeVar, get_args, get_origin

from pydantic import AfterValidator, BaseModel, BeforeValidator, ConfigDict, ValidationError
from pydantic_core import ErrorDetails, PydanticCustomError

from bench.errors import MOST_MESSAGES, ConfigError
from bench.files import check_file
from bench.wording import as_toml, describe_error, suggest

_T = TypeVar("_T", bound=BaseModel)


@contextmanager
def collect_errors(wrong: list[str], place: str = "") -> Iterator[None]:
    """Catch a ConfigError and add its messages to a list, each behind the text ``place``."""
    try:
        yield
    except ConfigError as error:
        wrong.extend(f"{place}{message}" for message in error.messages)


class Table(BaseModel):
    """A table of a TOML file: no unknown keys, no type conversion, no NaN or infinity."""

    model_config = ConfigDict(extra="forbid", strict=True, frozen=True, allow_inf_nan=False, defer_build=True)


def between(low: float, high: float) -> AfterValidator:
    """Check that a number lies in [low, high], in the unit of its key."""

    def check(value: float) -> float:
        if not low <= value <= high:
            raise PydanticCustomError("range", "is outside {low} to {high}", {"low": low, "high": high})
        return value

    return AfterValidator(check)


def _not_negative(value: float) -> float:
    if value < 0:
        raise PydanticCustomError("message", "must not be negative")
    return value


NOT_NEGATIVE = AfterValidator(_not_negative)

ROWS = BeforeValidator(lambda value: tuple(value) if isinstance(value, list) else value)
"""Convert the array of a TOML file to a tuple."""


MOST_BYTES = 10_000_000
"""Largest TOML file that is read [byte]."""
_MOST_KEYS = 100_000  # in a file; one of 4 h of waypoints, a leg a second, has fewer
_LONGEST_KEY = 200  # [character]
_DEEPEST = 50  # tables and arrays within each other, and names in a dotted key
_NAME = r"(?:[\w-]++|\"[^\"\n]*+\"|'[^'\n]*+')"
_LONG_CHAIN = re.compile(rf"(?<![\w.-]){_NAME}(?:[ \t]*+\.[ \t]*+{_NAME}){{{_DEEPEST}}}")
"""A dotted key that is too long: the parser would need a time that grows with the square of its length."""


def read_toml(path: Path, shown: str) -> dict[str, Any]:
    """Return the content of a TOML file.

    Raises
    ------
    ConfigError
        If the file cannot be read, is too large or is not TOML. Messages call it ``shown``.
    """
    try:
        check_file(path, shown, MOST_BYTES)
        return _parse_toml(path.read_bytes().decode("utf-8"), shown)
    except FileNotFoundError:
        raise ConfigError(f"{shown}: no such file") from None
    except UnicodeDecodeError:
        raise ConfigError(f"{shown}: not a text file in UTF-8") from None
    except OSError as error:
        raise ConfigError(f"{shown}: {error.strerror or error}") from None
    except ValueError as error:  # a TOMLDecodeError, or a number with thousands of digits
        raise ConfigError(f"{shown}: not valid TOML: {error}") from None
    except RecursionError:
        raise ConfigError(f"{shown}: not valid TOML: too many brackets within brackets") from None


def _parse_toml(text: str, shown: str) -> dict[str, Any]:
    """Return the content of a TOML file; raise ConfigError if its keys are too many, too long or too deep.

    So it does for a text with a zero character.
    """
    if _LONG_CHAIN.search(text):
        raise ConfigError(f"{shown}: a dotted key has more than {_DEEPEST} names")
    if text.count("=") > _MOST_KEYS or text.count("[") > _MOST_KEYS:
        raise ConfigError(f"{shown}: more than {_MOST_KEYS} keys or tables")
    document = tomllib.loads(text)
    level: list[Any] = [document]
    for _ in range(_DEEPEST):
        keys = [key for item in level if isinstance(item, dict) for key in item]
        if (longest := max(keys, key=len, default="")) and len(longest) > _LONGEST_KEY:
            raise ConfigError(f"{shown}: the key {longest[:30]}... is longer than {_LONGEST_KEY} characters")
        values = [inner for item in level for inner in (item.values() if isinstance(item, dict) else item)]
        if any("\0" in value for value in values if isinstance(value, str)):  # no file has such a name
            raise ConfigError(f"{shown}: a text with the character \\u0000; leave it out")
        level = [value for value in values if isinstance(value, dict | list)]
        if not level:
            return document
    raise ConfigError(f"{shown}: more than {_DEEPEST} tables or arrays within each other")


def check_table(model: type[_T], document: Mapping[str, Any], shown: str) -> _T:
    """Validate a document and return it as a table.

    Raises
    ------
    ConfigError
        One message for each problem, with its place in the file ``shown``.
    """
    try:
        return model.model_validate(document)
    except ValidationError as error:
        details = error.errors(include_url=False)
    lines = [_explain(model, detail) for detail in details[:MOST_MESSAGES]]
    lines += [f"{detail['loc']}: {detail['msg']}" for detail in details[MOST_MESSAGES:]]  # they are counted
    raise ConfigError(*(f"{shown}: {line}" for line in lines)) from None


def _explain(model: type[BaseModel], detail: ErrorDetails) -> str:
    loc, kind, value = detail["loc"], detail["type"], detail["input"]
    context = detail.get("ctx", {})
    if kind == "union_tag_invalid":
        tag = str(context["tag"])
        known = [name.strip("'") for name in str(context["expected_tags"]).split(", ")]
        return f"{_name_table(loc)}: kind = {as_toml(tag)} is unknown{suggest(tag, known, 'kinds')}"
    if kind == "union_tag_not_found":
        return f"{_name_table(loc)}: kind is missing"
    place, key = _split_location(loc)
    if kind == "whole":
        return f"{_name_table(loc)}: {detail['msg']}"
    if kind == "extra_forbidden":
        place = f"{place}: " if place else ""
        return f"{place}unknown key {key!r}{suggest(key, _list_keys(model, loc[:-1]), 'keys')}"
    joint = ": " if place.startswith("[[") else " "
    place = f"{place}{joint}" if place else ""
    if kind == "missing":
        return f"{place}{key} is missing"
    return f"{place}{describe_error(key, value, kind, detail['msg'], context)}"


def _split_location(loc: Sequence[int | str]) -> tuple[str, str]:
    """Split a location into the name of its table, as written in the file, and the key."""
    if len(loc) == 2 and isinstance(loc[1], int):  # a row of a list that should be a table but is not
        return "", _name_table(loc)
    if isinstance(loc[-1], int):
        return _name_table(loc[:-2]), f"{loc[-2]}[{loc[-1]}]"
    return _name_table(loc[:-1]), str(loc[-1])


def _name_table(loc: Sequence[int | str]) -> str:
    """Name a table: ``[start]``, ``[sensors.assumed]``, ``[[leg]] 1 (climb)``, ``... points[0]``."""
    if len(loc) > 1 and isinstance(loc[1], int):
        inner = "".join(f"[{part}]" if isinstance(part, int) else f" {part}" for part in loc[3:])
        return f"[[{loc[0]}]] {loc[1] + 1}{''.join(f' ({tag})' for tag in loc[2:3])}{inner}"
    return f"[{'.'.join(str(part) for part in loc)}]" if loc else ""


def _list_keys(model: type[BaseModel], loc: Sequence[int | str]) -> list[str]:
    """Return the known keys of the table at a location of a model."""
    for part in loc:
        if isinstance(part, int):
            continue
        if part in model.model_fields:
            below = _list_models(model.model_fields[str(part)].annotation)
            if len(below) == 1:
                model = below[0]
            else:
                choices = below
        else:  # the tag of a union
            model = next(m for m in choices if part in get_args(m.model_fields["kind"].annotation))
    return [field.alias or name for name, field in model.model_fields.items()]


def _list_models(annotation: Any) -> list[type[BaseModel]]:
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return [annotation]
    if get_origin(annotation) is Literal:
        return []
    return [m for inner in get_args(annotation) for m in _list_models(inner)]
