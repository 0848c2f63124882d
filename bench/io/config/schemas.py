"""JSON schemas of the TOML files, for editors that complete keys and mark mistakes."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import partial
from typing import Any

from pydantic import BaseModel
from pydantic.json_schema import GenerateJsonSchema, JsonSchemaValue
from pydantic_core import core_schema

from bench.core.records.fields import figures_of, triad_figures_of
from bench.core.records.instruments import INSTRUMENTS
from bench.core.records.sensor_specs import TriadSpec
from bench.core.words.wording import read_words
from bench.io.config.datasheets import GnssSheet, ImuSheet, make_sheet_type
from bench.io.config.leg_tables import DeclaredTable
from bench.io.config.library import ForeignTable
from bench.io.config.log_tables import LogTable
from bench.io.config.profile_tables import ScriptTable, TrajectoryTable, make_profile_table
from bench.io.config.sheet import SpecTable
from bench.io.config.tables import Range
from bench.simulation.flight import legs
from bench.simulation.flight.legs.keys import keys_of

Schema = dict[str, Any]
DIALECT = "http://json-schema.org/draft-07/schema#"
"""The version that editors of TOML know."""


_SHARED = ("file", "format")  # keys of a sensor that may stand at the top of a log
_TRIADS: Mapping[Any, str] = {ImuSheet.model_fields[name].annotation: name for name in ("gyro", "accel")}


class _Generator(GenerateJsonSchema):
    """Adds to the schema of pydantic the limits of numbers, and the description below each key."""

    def function_after_schema(self, schema: core_schema.AfterValidatorFunctionSchema) -> JsonSchemaValue:
        made = super().function_after_schema(schema)
        check = schema["function"]["function"]
        if isinstance(check, Range) and made.get("type") in ("number", "integer"):
            made |= {"minimum": check.low, "maximum": check.high}
        return made

    def model_schema(self, schema: core_schema.ModelSchema) -> JsonSchemaValue:
        made = super().model_schema(schema)
        model: type[BaseModel] = schema["cls"]
        words, properties = _find_words(model), made.get("properties", {})
        for name, info in model.model_fields.items():
            here = properties.get(info.alias or name)
            if here is not None and (said := info.description or words.get(name)):
                here["description"] = said
        if model in _TRIADS:
            for field, figure in triad_figures_of(TriadSpec).items():
                for key in figure.keys(field, _TRIADS[model]) if figure.by_axis else ():
                    number = {k: v for k, v in properties[key].items() if k in ("anyOf", "description")}
                    axes = {"type": "array", "items": {"type": "number"}, "minItems": 3, "maxItems": 3}
                    properties[key] = {**number, "anyOf": [*number["anyOf"], axes]}
        return made


def _find_words(model: type[BaseModel]) -> dict[str, str]:
    """Return the description of each key, from its field, its spec or its leg class."""
    words = read_words(model)
    if issubclass(model, SpecTable) and hasattr(model, "spec"):
        of_spec = read_words(model.spec)
        figures = figures_of(model.spec).items()
        words |= {one.key(name): of_spec[name] for name, one in figures if name in of_spec}
    if model in _TRIADS:
        of_spec = read_words(TriadSpec)
        for name, figure in triad_figures_of(TriadSpec).items():
            words |= dict.fromkeys(figure.keys(name, _TRIADS[model]), of_spec.get(name, ""))
    if issubclass(model, DeclaredTable):
        words |= {entry.key.name: entry.key.words for entry in keys_of(model.made)}
    return words


def make_schema(model: type[BaseModel], title: str) -> Schema:
    """Return the JSON schema of a file.

    Parameters
    ----------
    model : type of BaseModel
        What checks the file.
    title : str
        What the file is, in words.
    """
    made = model.model_json_schema(schema_generator=_Generator, ref_template="#/definitions/{model}")
    if "$defs" in made:
        made["definitions"] = made.pop("$defs")
    return {"$schema": DIALECT, **made, "title": title}


def _make_profile_schema() -> Schema:
    """Return the schema of a profile: one with legs, a JSBSim script, or a table."""
    by_key: dict[str, type[BaseModel]] = {"script": ScriptTable, "trajectory": TrajectoryTable}
    made = make_schema(make_profile_table(legs.LEGS), "A profile of bench")
    definitions = made.pop("definitions")
    head = {key: made.pop(key) for key in ("$schema", "title")}
    for key, model in by_key.items():
        other = make_schema(model, "")
        definitions |= other.pop("definitions")
        made = {"if": {"required": [key]}, "then": _drop_head(other), "else": _drop_head(made)}
    return {**head, **made, "definitions": definitions}


def _drop_head(schema: Schema) -> Schema:
    return {key: value for key, value in schema.items() if key not in ("$schema", "title")}


def _make_log_schema() -> Schema:
    """Return the schema of a log; its sensors may share one file that is named at the top."""
    made = make_schema(LogTable, "A log of bench")
    shared = made["definitions"]["ImuTable"]["properties"]
    made["properties"] |= {key: shared[key] for key in _SHARED}
    for name in ("ImuTable", "GnssTable", "BaroTable", "ReferenceTable"):
        table = made["definitions"][name]
        table["required"] = [key for key in table.get("required", ()) if key not in _SHARED]
    return made


def _make_sheet_schema(kind: str) -> Schema:
    return make_schema(make_sheet_type(kind), f"The datasheet of a unit: {INSTRUMENTS[kind].title}")


SCHEMAS: Mapping[str, Callable[[], Schema]] = {
    "profile": _make_profile_schema,
    "log": _make_log_schema,
    "aircraft": lambda: make_schema(ForeignTable, "An aircraft of bench: aircraft.toml"),
    "imu": lambda: make_schema(ImuSheet, "The datasheet of an IMU"),
    "gnss": lambda: make_schema(GnssSheet, "The datasheet of a GNSS receiver"),
    **{kind: partial(_make_sheet_schema, kind) for kind in INSTRUMENTS},
}
"""Kind of file -> what makes its schema; those of a campaign are made where campaigns are."""
