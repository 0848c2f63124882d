"""Editors complete and check the TOML files by schemas made of the same declarations that bench checks by."""

from __future__ import annotations

import copy
import json
import tomllib
from pathlib import Path
from typing import Any

import jsonschema
import pytest

from bench.core.files.places import PACKAGE
from bench.io.config.schemas import SCHEMAS

AIRCRAFT = PACKAGE.parent / "aircraft"
LOGS = PACKAGE.parent / "tests" / "logs"
FILES = [("profile", path) for path in sorted((PACKAGE / "profiles").glob("*.toml"))]
FILES += [("aircraft", path) for path in sorted(AIRCRAFT.glob("*/aircraft.toml"))]
FILES += [("aircraft", path) for path in sorted(AIRCRAFT.glob("jsbsim/*.toml"))]
FILES += [(path.parent.name, path) for path in sorted((PACKAGE / "catalog").glob("*/*.toml"))]
FILES += [("log", LOGS / "drive.toml")]


@pytest.fixture(scope="module")
def validators() -> dict[str, Any]:
    made = {kind: make() for kind, make in SCHEMAS.items()}
    for schema in made.values():
        jsonschema.Draft7Validator.check_schema(schema)
    return {kind: jsonschema.Draft7Validator(schema) for kind, schema in made.items()}


def read(path: Path) -> dict[str, Any]:
    """Return a file as an editor gives it to a schema: dates are texts."""
    return json.loads(json.dumps(tomllib.loads(path.read_text(encoding="utf-8")), default=str))


def test_every_shipped_file_is_valid_and_every_kind_is_tried(validators):
    assert {kind for kind, _ in FILES} == SCHEMAS.keys()
    for kind, path in FILES:
        errors = [
            f"{path}: {error.json_path}: {error.message}"
            for error in validators[kind].iter_errors(read(path))
        ]
        assert errors == []


def put(document: dict[str, Any], place: str, value: Any) -> dict[str, Any]:
    """Return a copy of a document with another value at "table.key" or "table.0.key"."""
    changed = copy.deepcopy(document)
    *tables, key = place.split(".")
    here: Any = changed
    for name in tables:
        here = here[int(name)] if name.isdigit() else here[name]
    here[key] = value
    return changed


@pytest.mark.parametrize(
    ("kind", "path", "place", "value"),
    [
        ("profile", "profiles/figure-eight.toml", "start.lat_deg", 95.0),
        ("profile", "profiles/figure-eight.toml", "start.latitude", 47.0),
        ("profile", "profiles/figure-eight.toml", "leg.0.kind", "loop-the-loop"),
        ("profile", "profiles/figure-eight.toml", "aircraft", 5),
        ("profile", "profiles/figure-eight.toml", "sensors.imu", ["stim300"]),
        ("imu", "catalog/imu/stim300.toml", "gyro.noise_deg_sqrt_h", -1.0),
        ("imu", "catalog/imu/stim300.toml", "gyro.noise", 1.0),
        ("imu", "catalog/imu/stim300.toml", "class", "toy"),
        ("gnss", "catalog/gnss/l1-code.toml", "gnss.rate_hz", "ten"),
        ("baro", "catalog/baro/bmp388.toml", "baro.rate_hz", 1e9),
    ],
)
def test_a_mistake_is_marked(validators, kind, path, place, value):
    document = read(PACKAGE / path)
    assert not list(validators[kind].iter_errors(document))
    assert list(validators[kind].iter_errors(put(document, place, value)))


def test_a_figure_may_differ_by_axis_where_bench_takes_that(validators):
    sheet = read(PACKAGE / "catalog" / "imu" / "stim300.toml")
    by_axis = put(sheet, "gyro.noise_deg_sqrt_h", [0.1, 0.2, 0.3])
    assert not list(validators["imu"].iter_errors(by_axis))
    assert list(validators["imu"].iter_errors(put(sheet, "gyro.noise_deg_sqrt_h", [0.1, 0.2])))


def test_editors_show_the_words_below_each_figure():
    start = SCHEMAS["profile"]()["definitions"]["StartTable"]["properties"]
    assert start["lat_deg"]["maximum"] == 90
    silent = []
    for kind, make in SCHEMAS.items():
        schema = make()
        tables = {**schema["definitions"], "": schema}
        silent += [
            f"{kind}: {table}.{key}"
            for table, one in tables.items()
            for key, about in one.get("properties", {}).items()
            if "number" in json.dumps(about) and not about.get("description")
        ]
    assert silent == []
