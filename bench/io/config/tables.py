"""Check the content of TOML files as tables; one line for each problem."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any, Literal, TypeVar, get_args, get_origin

from pydantic import AfterValidator, BaseModel, BeforeValidator, ConfigDict, ValidationError
from pydantic_core import ErrorDetails, PydanticCustomError

from bench.core.words.exceptions import MOST_MESSAGES, ConfigError
from bench.core.words.wording import as_toml, describe_error, suggest

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


@dataclass(frozen=True)
class Range:
    """The values [low, high] of a number, in the unit of its key."""

    low: float
    high: float

    @property
    def words(self) -> str:
        """The range in words."""
        return f"{self.low:.16g} to {self.high:.16g}"

    def __call__(self, value: float) -> float:
        """Return a value in the range; reject another."""
        if not self.low <= value <= self.high:
            limits = {"low": self.low, "high": self.high}
            raise PydanticCustomError("range", "is outside {low} to {high}", limits)
        return value


def between(low: float, high: float) -> AfterValidator:
    """Check that a number lies in [low, high], in the unit of its key."""
    return AfterValidator(Range(low, high))


def _not_negative(value: float) -> float:
    if value < 0:
        raise PydanticCustomError("message", "must not be negative")
    return value


NOT_NEGATIVE = AfterValidator(_not_negative)

ROWS = BeforeValidator(lambda value: tuple(value) if isinstance(value, list) else value)
"""Convert the array of a TOML file to a tuple."""


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
