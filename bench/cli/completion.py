"""Shell completion of arguments: names of profiles, filters, sensors, topics and keys."""

from __future__ import annotations

from collections.abc import Callable, Iterable

import click

Completer = Callable[[click.Context, click.Parameter, str], list[str]]


def _list_profiles() -> Iterable[str]:
    from pathlib import Path

    from bench.io.config.listing import PROFILES

    return [*(path.stem for path in PROFILES.glob("*.toml")), *(path.name for path in Path().glob("*.toml"))]


def _list_estimators() -> Iterable[str]:
    from bench.core.files.installed import find_installed
    from bench.navigation.built_in import BUILT_IN

    return [*BUILT_IN, *find_installed("estimators", BUILT_IN)]


def _list_imus() -> Iterable[str]:
    from bench.io.config.listing import find_sheets

    return find_sheets("imu")


def _list_topics() -> Iterable[str]:
    from bench.cli.verbs.guide import read_topics

    return read_topics()


def _list_settings() -> Iterable[str]:
    """Return the keys of single tables of a profile, and the sensors by name, as --set takes them."""
    from bench.io.config.listing import KINDS, find_sheets
    from bench.io.config.schemas import SCHEMAS

    whole = SCHEMAS["profile"]()
    schema, tables = whole["else"]["else"], whole["definitions"]
    for key, about in schema["properties"].items():
        place = str(about.get("$ref", "")).rpartition("/")[2]
        rows = tables.get(place, {}).get("properties", {})
        yield from (f"{key}.{name}=" for name in rows) if rows else (f"{key}=",)
    for kind in KINDS:
        yield from (f"sensors.{kind}={name}" for name in find_sheets(kind))


def _complete(names: Callable[[], Iterable[str]]) -> Completer:
    def find(ctx: click.Context, param: click.Parameter, incomplete: str) -> list[str]:
        return sorted({name for name in names() if name.startswith(incomplete)})

    return find


profile = _complete(_list_profiles)
estimator = _complete(_list_estimators)
imu = _complete(_list_imus)
topic = _complete(_list_topics)
setting = _complete(_list_settings)
