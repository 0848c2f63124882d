"""Write the tables of the guide that say what the code declares: ``make guide``.

A table stands between two comments of its page, the first of which names it. Its rows come from the same
declarations that the code checks against: names, limits, defaults, and the words below each.
"""

from __future__ import annotations

import re
import sys
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from types import NoneType, UnionType
from typing import Annotated, Any, Literal, NamedTuple, Union, get_args, get_origin

from pydantic import BaseModel, WithJsonSchema
from pydantic.fields import FieldInfo

from bench.cli.verbs.guide import find_pages
from bench.core.mathematics.units import from_si
from bench.core.records.fields import figures_of, triad_figures_of
from bench.core.records.instruments import INSTRUMENTS
from bench.core.records.sensor_specs import GnssSpec, SampleClockSpec, ThermalSpec, TriadSpec, VibrationSpec
from bench.core.records.sky_spec import SkySpec
from bench.core.words.exceptions import STATUSES, ConfigError
from bench.core.words.wording import as_toml, read_words
from bench.evaluation.metrics.run_metrics import METRICS
from bench.experiments.campaigns.campaign_file import CampaignTable
from bench.io.config.datasheets import ImuSheet, LayoutTable
from bench.io.config.fault_tables import FAULTS
from bench.io.config.library import ForeignTable
from bench.io.config.listing import KeyEntry, list_legs
from bench.io.config.log_tables import FileTable, LogTable
from bench.io.config.profile_tables import AntennaTable, ProfileTable, ScriptTable, TrackTable
from bench.io.config.sheet import MOST, ProductTable, Sheet, SpecTable
from bench.io.config.sky_sheet import SkyTable
from bench.io.config.tables import Range
from bench.io.exports import FORMATS
from bench.navigation import options
from bench.navigation.built_in import BUILT_IN, load
from bench.navigation.estimator import RECORDS

Lines = Iterator[str]


# --- how a key is put ---------------------------------------------------------------------------------


class Key(NamedTuple):
    """The cells of a key in a table."""

    names: str
    meaning: str
    limits: str
    default: str


def make_key(names: Iterable[str], default: str, words: str, limits: str) -> Key:
    """Return the cells of a key; ``limits`` are its allowed values, if its type has more."""
    meaning, _, said = words.removesuffix(".").partition(". Default: ")
    return Key(code(names), meaning, limits, default or said)


def code(names: Iterable[str]) -> str:
    """Return names as code, separated by commas."""
    return ", ".join(f"`{name}`" for name in names)


def toml(value: object) -> str:
    """Return a value as a file has it."""
    return as_toml(value).replace("'", '"')


def write_table(head: Sequence[str], rows: Iterable[Sequence[str]]) -> Lines:
    """Yield the lines of a Markdown table, and an empty one."""
    yield f"| {' | '.join(head)} |"
    yield "|---" * len(head) + "|"
    for cells in rows:
        yield f"| {' | '.join(cell.replace('|', chr(92) + '|') for cell in cells)} |"
    yield ""


def write_keys(what: str, keys: Iterable[Key]) -> Lines:
    """Yield the table of some keys; ``what`` says whose."""
    yield from write_table((what, "meaning", "allowed", "default"), keys)


def find_words(kind: type, name: str, words: Mapping[str, str]) -> str:
    """Return the words of a field of a declaration."""
    if name not in words:
        raise ConfigError(f"{kind.__name__}.{name} has no words: write what it means below it")
    return words[name]


def list_keys(model: type[BaseModel], names: Iterable[str] | None = None) -> list[Key]:
    """Return the keys of a model, or some of them."""
    words, found = read_words(model), []
    figures = list_figures(model.spec) if issubclass(model, SpecTable) else []
    made = {key.names.strip("`"): key for key in figures}
    for name in model.model_fields if names is None else names:
        field = model.model_fields[name]
        if name in made:
            found.append(made[name])
            continue
        said = field.description or find_words(model, name, words)
        limits = describe_limits(field.annotation, field.metadata)
        found.append(make_key([field.alias or name], describe_default(field), said, limits))
    return found


def describe_limits(annotation: Any, checks: Sequence[Any] = ()) -> str:
    """Return what a key may be, in words; empty if its type alone says it."""
    if get_origin(annotation) is Annotated:
        inner, *more = get_args(annotation)
        return describe_limits(inner, [*more, *checks])
    for check in checks:
        if limit := getattr(getattr(check, "func", None), "words", ""):
            return str(limit)
        if (least := getattr(check, "ge", None)) is not None:
            return f"at least {least}"
        if isinstance(check, WithJsonSchema):
            return code(map(toml, check.json_schema["anyOf"][0]["enum"]))
    origin, parts = get_origin(annotation), get_args(annotation)
    if origin is Literal:
        return code(map(toml, parts))
    if origin in (Union, UnionType):
        return " or ".join(filter(None, (describe_limits(part) for part in parts if part is not NoneType)))
    if origin is tuple:
        inner = describe_limits(parts[0])
        if Ellipsis in parts:
            return f"a list of {inner}" if inner else "a list"
        return f"{len(parts)} numbers" + (f", each {inner}" if inner else "")
    return ""


def describe_default(field: FieldInfo) -> str:
    """Return the default of a key; empty if it may be left out."""
    if field.is_required():
        return "required"
    value = field.get_default(call_default_factory=True)
    empty = value is None or isinstance(value, BaseModel) or value in ("", (), [], {})
    return "" if empty else code([toml(value)])


def list_figures(spec: type) -> list[Key]:
    """Return the keys of the figures of a spec; what is 0 or more is not said to be."""
    words, found = read_words(spec), []
    for name, one in figures_of(spec).items():
        key, limits = one.key(name), Range(one.low, one.high).words
        if (one.low, one.high) == (0, MOST):
            limits = "above 0" if one.reported or one.reciprocal else ""
        default = "" if one.reciprocal else "required"
        if one.default is not None and not one.reciprocal:
            default = code([f"{from_si(key, one.default):.10g}"])
        found.append(make_key([key], default, drop_unit(find_words(spec, name, words)), limits))
    return found


def drop_unit(words: str) -> str:
    """Return the words of a figure without its unit in brackets: that of the file is the end of its key."""
    return re.sub(r" \[[^]]*\](?=[.;])", "", words)


# --- filters -----------------------------------------------------------------------------------------


def write_estimators() -> Lines:
    """Yield every built-in filter with what it needs and the options that are fixed."""
    rows = [
        (
            code([name]),
            row.title,
            ", ".join(RECORDS[need] for need in load(name, {}).needs),  # type: ignore[attr-defined]
            code(f"{key} = {toml(value)}" for key, value in row.fixed.items()),
        )
        for name, row in BUILT_IN.items()
    ]
    yield from write_table(("`use`", "what it is", "needs", "fixed options"), rows)


def write_options() -> Lines:
    """Yield the options, those of each class of declarations under the filters that have them."""
    models = [*vars(options).values(), *(row.options for row in BUILT_IN.values())]
    for model in dict.fromkeys(one for one in models if isinstance(one, type)):
        if not issubclass(model, options.Options):
            continue
        owners = [name for name, row in BUILT_IN.items() if issubclass(row.options, model)]
        words, known = read_words(model), [read_words(base) for base in model.__bases__]
        own = [
            name for name in model.__annotations__ if all(words.get(name) != one.get(name) for one in known)
        ]
        if own:
            yield from (f"Of {'all estimators' if len(owners) == len(BUILT_IN) else code(owners)}:", "")
            yield from write_keys("option", list_keys(model, own))


# --- profiles -------------------------------------------------------------------------------------------


def write_tables(model: type[BaseModel], skipped: Collection[str] = (), places: Sequence[str] = ()) -> Lines:
    """Yield the keys of a file or of the tables at some places, and those of the tables below them."""
    below: dict[type[BaseModel], list[str]] = {}
    fields = {name: one.annotation for name, one in model.model_fields.items() if name not in skipped}
    for name in sorted(fields, key=lambda name: name not in model.__annotations__):  # its own come first
        inner = ".".join([*(place.strip("[]") for place in places[:1]), name])
        place = f"[[{inner}]]" if get_origin(fields[name]) is tuple else f"[{inner}]"
        for found in find_tables(fields[name]):
            below.setdefault(found, []).append(place)
    plain = [name for name in fields if not find_tables(fields[name])]
    if plain:
        yield from write_keys(f"key of {code(places) or 'the top of the file'}", list_keys(model, plain))
    for found, where in below.items():
        yield from write_tables(found, skipped, where)


def write_log() -> Lines:
    """Yield the keys of a log, those of all its files once."""
    files = [
        f"[{name}]"
        for name, one in LogTable.model_fields.items()
        if any(issubclass(found, FileTable) for found in find_tables(one.annotation))
    ]
    yield from write_keys(f"key of {code(files)}", list_keys(FileTable))
    yield from write_tables(LogTable, ("estimator", *FileTable.model_fields))


def find_tables(annotation: Any) -> list[type[BaseModel]]:
    """Return the types of the tables that a key holds."""
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return [annotation]
    parts = () if get_origin(annotation) is Literal else get_args(annotation)
    return [found for part in parts for found in find_tables(part)]


def write_legs() -> Lines:
    """Yield the kinds of legs with their keys, then the keys: those that are alike in a line."""
    kinds, of = [], {}
    for leg in list_legs():
        for key in leg.keys:
            of.setdefault(describe_leg_key(key), []).append(leg.name)
        kinds.append((code([leg.name]), code(key.name for key in leg.keys), leg.title))
    yield from write_table(("kind", "keys", "flies"), kinds)
    yield from write_shared_keys(of, len(kinds))


def describe_leg_key(key: KeyEntry) -> Key:
    """Return the cells of a key of a leg."""
    default = "required" if key.required else "" if key.default is None else code([toml(key.default)])
    limits = code(f'"{text}"' for text in key.choices)
    if key.low is not None and key.high is not None:
        limits = Range(key.low, key.high).words
    return make_key([key.name], default, f"{key.words[0].upper()}{key.words[1:]}.", limits)


def write_shared_keys(of: Mapping[Key, Sequence[str]], kinds: int) -> Lines:
    """Yield a table of keys and of the kinds that have them, out of so many."""
    rows = [
        (key.names, "all" if len(found) == kinds else code(found), *key[1:])
        for key, found in sorted(of.items())
    ]
    yield from write_table(("key", "of", "meaning", "allowed", "default"), rows)


# --- datasheets -----------------------------------------------------------------------------------------


def write_imu() -> Lines:
    """Yield the keys of an IMU: those of both triads, those of one, and its other tables."""
    words, both = read_words(TriadSpec), "`[gyro]` and `[accel]`"
    keys: dict[str, list[Key]] = {both: [], "`[gyro]`": [], "`[accel]`": []}
    for name, one in triad_figures_of(TriadSpec).items():
        said = drop_unit(find_words(TriadSpec, name, words)) + (" By axis." if one.by_axis else "")
        same = one.gyro == one.accel
        for place, triad in ((both, "gyro"),) if same else (("`[gyro]`", "gyro"), ("`[accel]`", "accel")):
            if names := one.keys(name, triad):
                keys[place].append(make_key(names, "", said, ""))
    choices = ImuSheet.model_fields["gyro"].annotation.model_fields  # type: ignore[union-attr]
    for name in ("bias_model", "noise_shape", "dead_zone_kind"):
        limits = describe_limits(choices[name].annotation)
        keys[both].append(make_key([name], describe_default(choices[name]), words[name], limits))
    for place, found in keys.items():
        yield from write_keys(f"key of {place}", found)
    yield from write_keys("key of `[thermal]`", list_figures(ThermalSpec))
    yield from write_keys("key of `[vibration]`", list_figures(VibrationSpec))
    yield from write_keys("key of `[clock]`", list_figures(SampleClockSpec))
    yield from write_keys("key of `[layout]`", list_keys(LayoutTable))


def write_instruments() -> Lines:
    """Yield the keys of each aiding instrument, and of the further tables of its datasheet."""
    for name, row in INSTRUMENTS.items():
        for part, spec in {name: row.spec, **row.parts}.items():
            yield from write_keys(f"{row.title}, key of `[{part}]`", list_figures(spec))


# --- faults ---------------------------------------------------------------------------------------------


def write_faults() -> Lines:
    """Yield the kinds of faults with their keys, then the keys: those that are alike in a line."""
    kinds, of = [], {}
    for model in FAULTS:
        kind = get_args(model.model_fields["kind"].annotation)[0]
        keys = list_keys(model, [name for name in model.model_fields if name != "kind"])
        for key in keys:
            of.setdefault(key, []).append(kind)
        own = [key.names for key in keys if key.names not in ("`start_s`", "`duration_s`")]
        kinds.append((code([kind]), ", ".join(own), str(model.__doc__)))
    yield from write_table(("kind", "keys beside start and duration", "what happens"), kinds)
    yield from write_shared_keys(of, len(FAULTS))


# --- metrics --------------------------------------------------------------------------------------------


def write_metrics() -> Lines:
    """Yield the metrics, those with the same words in one line."""
    names: dict[tuple[str, str], list[str]] = {}
    for metric in METRICS:
        names.setdefault((metric.words, metric.direction), []).append(metric.name)
    yield from write_table(("metric", "meaning", "judged"), [(code(n), *line) for line, n in names.items()])


# --- what goes out --------------------------------------------------------------------------------------


def write_exports() -> Lines:
    """Yield the formats in which a run can be exported."""
    rows = [(code([name]), one.title) for name, one in FORMATS.items()]
    yield from write_table(("`--to`", "content"), rows)


def write_statuses() -> Lines:
    """Yield the exit statuses."""
    rows = [(str(number), words) for number, words in STATUSES.items()]
    yield from write_table(("status", "meaning"), rows)


# --- pages ----------------------------------------------------------------------------------------------


TABLES: Mapping[str, Mapping[str, Callable[[], Lines]]] = {
    "estimators": {"built-in filters": write_estimators, "options": write_options},
    "profiles": {
        "tables": lambda: write_tables(ProfileTable, ("leg", "fault")),
        "antenna": lambda: write_keys("key of `[antenna]`", list_keys(AntennaTable)),
        "legs": write_legs,
    },
    "aircraft": {
        "aircraft.toml": lambda: write_tables(ForeignTable),
        "scripts": lambda: write_keys("key", list_keys(ScriptTable, ScriptTable.__annotations__)),
        "track": lambda: write_keys("key of `[track]`", list_keys(TrackTable)),
    },
    "faults": {"faults": write_faults},
    "sensors": {
        "all datasheets": lambda: (
            *write_keys("key", list_keys(Sheet)),
            *write_keys("key of `[product]`", list_keys(ProductTable)),
        ),
        "imu": write_imu,
        "gnss": lambda: write_keys("key of `[gnss]`", list_figures(GnssSpec)),
        "sky": lambda: write_keys(
            "key of `[sky]`", [*list_keys(SkyTable, SkyTable.__annotations__), *list_figures(SkySpec)]
        ),
        "instruments": write_instruments,
    },
    "log-format": {"tables": write_log},
    "campaigns": {"campaign file": lambda: write_keys("key", list_keys(CampaignTable))},
    "other-tools": {"exports": write_exports},
    "results": {"exit statuses": write_statuses, "metrics": write_metrics},
}
"""Page -> name of a table -> what yields its lines."""

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
