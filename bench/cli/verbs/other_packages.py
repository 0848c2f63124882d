"""Additions of installed packages to bench, and the reasons why some of them cannot be used."""

from __future__ import annotations

from collections.abc import Collection

import click

from bench.cli.group import commands
from bench.core.files.installed import GROUPS, find_folders, find_installed, find_own, list_problems
from bench.experiments.studies import STUDIES
from bench.io import exports, log_formats
from bench.io.config.listing import CATALOG, KINDS, CatalogEntry
from bench.navigation.built_in import BUILT_IN


def _list_taken(group: str) -> Collection[str]:
    """Return the names that bench has in a group itself."""
    if group == "verbs":
        return commands.list_commands(click.Context(commands))
    names: dict[str, Collection[str]] = {
        "estimators": BUILT_IN,
        "exports": exports.FORMATS,
        "logs": log_formats.FORMATS,
        "studies": STUDIES,
    }
    return names.get(group, find_own(group))


def list_packages() -> list[CatalogEntry]:
    """Return every entry of an installed package that can be used, with its package; nothing is imported."""
    return [
        CatalogEntry(one.name, f"{one.place} of {one.package}", group)
        for group in GROUPS
        for one in find_installed(group, _list_taken(group)).values()
    ]


def list_plugin_problems() -> list[str]:
    """Return a line for each entry of an installed package that cannot be used."""
    return [line for group in GROUPS for line in list_problems(group, _list_taken(group))] + [
        f"{package}: {kind} {path.stem!r} is a name of bench itself; it keeps its own"
        for package, folder in find_folders("catalog").items()
        for kind in KINDS
        for path in sorted((folder / kind).glob("*.toml"))
        if (CATALOG / kind / path.name).is_file()
    ]
