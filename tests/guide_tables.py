"""Write the tables of the guide that say what the code declares: ``make guide``.

A table stands between two comments of its page, the first of which names it. Its rows come from the same
declarations that the code checks against: names, limits, defaults, and the words below each.
"""

from __future__ import annotations

import re
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from types import NoneType, UnionType
from typing import Annotated, Any, Literal, Union, get_args, get_origin

from pydantic import BaseModel
from pydantic.fields import FieldInfo

from bench.config.fault_tables import FAULTS
from bench.errors import ConfigError
from bench.evaluation.metrics import METRICS
from bench.navigation import options
from bench.navigation.estimator import BUILT_IN, RECORDS, load
from bench.wording import as_toml, read_words
from bench.workbench.guide import FOLDER

Lines = Iterator[str]


# --- how a key is put ---------------------------------------------------------------------------------


def code(names: Iterable[str]) -> str:
    """Return names as code, separated by commas."""
    return ", ".join(f"`{name}`" for name in names)


def table(head: Sequence[str], rows: Iterable[Sequence[str]]) -> Lines:
    """Yield the lines of a Markdown table."""
    for cells in (head, ["---"] * len(head), *rows):
        line = " | ".join(cell.replace("|", "\\|") for cell in cells)
        yield f"|{line.replace(' ', '')}|" if cells[0] == "---" else f"| {line} |"


def toml(value: object) -> str:
    """Return a value as a profile has it."""
    return as_toml(value).replace("'", '"')


def describe_values(annotation: Any, checks: Sequence[Any] = ()) -> str:
    """Return what a key may hold, in words; empty if its default says it."""
    if get_origin(annotation) is Annotated:
        inner, *more = get_args(annotation)
        return describe_values(inner, [*more, *checks])
    limit = next(
        (text for check in checks if (text := getattr(getattr(check, "func", None), "words", ""))), ""
    )
    if limit:
        return limit
    origin, parts = get_origin(annotation), get_args(annotation)
    if origin is Literal:
        return code(map(toml, parts))
    if origin in (Union, UnionType):
        return " or ".join(filter(None, (describe_values(part) for part in parts if part is not NoneType)))
    if origin is tuple:
        inner = describe_values(parts[0])
        if Ellipsis in parts:
            return f"list of {inner}" if inner else "list"
        return f"{len(parts)} numbers" + (f", each {inner}" if inner else "")
    return ""


def describe_default(field: FieldInfo) -> str:
    """Return the default of a key; empty if it may be left out, or holds tables."""
    if field.is_required():
        return "required"
    value = field.get_default(call_default_factory=True)
    empty = value is None or isinstance(value, BaseModel) or value in ((), {})
    return "" if empty else code([toml(value)])


def describe_keys(
    model: type[BaseModel], words: Mapping[str, str], names: Iterable[str]
) -> Iterator[tuple[str, str, str, str]]:
    """Yield the name of each key, what it may be, its default and its words."""
    for name in names:
        field = model.model_fields[name]
        if name not in words:
            raise ConfigError(f"{model.__name__}.{name} has no words: write what it means below it")
        holds = describe_values(field.annotation, field.metadata)
        yield code([field.alias or name]), holds, describe_default(field), words[name]


def write_keys(what: str, model: type[BaseModel], words: Mapping[str, str], names: Iterable[str]) -> Lines:
    """Yield a table of the keys of a model; ``what`` stands above the keys."""
    yield from table((what, "may be", "default", "meaning"), describe_keys(model, words, names))


# --- estimators -----------------------------------------------------------------------------------------


def write_estimators() -> Lines:
    """Yield every built-in estimator with what it needs and the options that are fixed."""
    rows = [
        (
            code([name]),
            row.title,
            ", ".join(RECORDS[need] for need in load(name, {}).needs),  # type: ignore[attr-defined]
            code(f"{key} = {toml(value)}" for key, value in row.fixed.items()),
        )
        for name, row in BUILT_IN.items()
    ]
    yield from table(("`use`", "what it is", "needs", "fixed options"), rows)


def write_options() -> Lines:
    """Yield the options, those of each class of declarations under the estimators that have them."""
    for model in vars(options).values():
        if not (isinstance(model, type) and issubclass(model, options.Options)):
            continue
        owners = [name for name, row in BUILT_IN.items() if issubclass(row.options, model)]
        words, known = read_words(model), [read_words(base) for base in model.__bases__]
        own = [name for name in model.__annotations__ if all(words[name] != one.get(name) for one in known)]
        if own:
            yield from (f"Of {'all estimators' if len(owners) == len(BUILT_IN) else code(owners)}:", "")
            yield from write_keys("option", model, words, own)
            yield ""


# --- faults ---------------------------------------------------------------------------------------------


def write_faults() -> Lines:
    """Yield the kinds of faults with their keys, then the keys: those that are alike in a line."""
    kinds, keys = [], {}
    for model in FAULTS:
        kind = get_args(model.model_fields["kind"].annotation)[0]
        own = [name for name in model.model_fields if name not in ("kind", "start_s", "duration_s")]
        kinds.append((code([kind]), code(own), str(model.__doc__)))
        words = read_words(model) | {name: str(model.model_fields[name].description) for name in own}
        for cells in describe_keys(model, words, ["start_s", "duration_s", *own]):
            keys.setdefault(cells, []).append(kind)
    yield from table(("kind", "keys beside start and duration", "what happens"), kinds)
    yield ""
    of = {cells: "all" if len(found) == len(FAULTS) else code(found) for cells, found in keys.items()}
    rows = [(name, of[name, *cells], *cells) for name, *cells in sorted(keys, key=lambda cells: cells[0])]
    yield from table(("key", "of", "may be", "default", "meaning"), rows)


# --- metrics --------------------------------------------------------------------------------------------


def write_metrics() -> Lines:
    """Yield the metrics, those with the same words in one line."""
    names: dict[tuple[str, str], list[str]] = {}
    for metric in METRICS:
        names.setdefault((metric.words, metric.direction), []).append(metric.name)
    rows = [(code(found), *line) for line, found in names.items()]
    yield from table(("metric", "meaning", "judged"), rows)


TABLES: Mapping[str, Mapping[str, Callable[[], Lines]]] = {
    "estimators": {"built-in estimators": write_estimators, "options": write_options},
    "faults": {"faults": write_faults},
    "results": {"metrics": write_metrics},
}
"""Page -> name of a table -> what yields its lines."""


# --- pages ----------------------------------------------------------------------------------------------

_PLACE = re.compile(r"<!-- make guide writes: (.+?) -->\n(.*?)<!-- to here -->\n", re.DOTALL)


def rewrite_page(topic: str, text: str) -> str:
    """Return a page with its tables as the code declares them.

    Raises
    ------
    ConfigError
        If a table has no place on the page, or a place no table.
    """
    written, places = TABLES.get(topic, {}), [name for name, _ in _PLACE.findall(text)]
    if sorted(places) != sorted(written):
        raise ConfigError(f"{topic}.md: has places for {sorted(places)}; the tables are {sorted(written)}")

    def fill(place: re.Match[str]) -> str:
        lines = "\n".join(written[place[1]]()).strip("\n")
        return f"<!-- make guide writes: {place[1]} -->\n{lines}\n<!-- to here -->\n"

    return _PLACE.sub(fill, text)


def find_pages() -> dict[str, Path]:
    """Return the pages of the guide by topic."""
    return {path.stem: path for path in sorted(FOLDER.glob("*.md"))}


def main() -> int:
    """Write the pages whose tables have changed."""
    pages = find_pages()
    try:
        made = {path: rewrite_page(topic, path.read_text(encoding="utf-8")) for topic, path in pages.items()}
    except ConfigError as error:
        print(f"error: {error}", file=sys.stderr)
        return error.status
    for path, text in made.items():
        if text != path.read_text(encoding="utf-8"):
            path.write_text(text, encoding="utf-8")
            print(f"{path.name} is new")
    return 0


if __name__ == "__main__":
    sys.exit(main())
