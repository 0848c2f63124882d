"""Entry points that plug-ins and other packages add to bench; no code of other packages is imported here.

A package names in its ``pyproject.toml`` under ``[project.entry-points."bench.GROUP"]``:

- ``estimators``: NAME = "module:Class", a filter that ``-e NAME`` and ``use = "NAME"`` run;
- ``catalog``: any name = "package.folder", a folder with ``imu/NAME.toml``, ``gnss/NAME.toml`` ...;
- ``aircraft``: any name = "package.folder", a folder with ``NAME/aircraft.toml`` and ``NAME/NAME.xml``;
- ``exports``: NAME = "module" with ``FORMATS`` and ``write``, as those of `bench.io.exports`;
- ``logs``: NAME = "module" that reads recordings of the format NAME, as `bench.io.log_formats` says;
- ``fixes``: NAME = "module" that reads the files of GNSS receivers, as `bench.io.fix_readers` says;
- ``studies``: NAME = "module" with ``Options`` and ``run``, as `bench.experiments.studies` says;
- ``verbs``: NAME = "module:command", a ``click.Command`` that ``bench NAME`` runs.

The plug-ins in `bench.plugins` are entries of the project's own distribution. They come first, no other
package can take their names, and they run in this process as the rest of bench does.
"""

from __future__ import annotations

import contextlib
import re
from ast import literal_eval
from collections.abc import Collection, Iterator
from dataclasses import dataclass
from functools import cache
from importlib import import_module
from importlib.metadata import EntryPoint, PackageNotFoundError, distribution, entry_points
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from bench.core.files.places import PACKAGE
from bench.core.words.exceptions import ConfigError
from bench.core.words.wording import one_line

GROUPS = ("estimators", "catalog", "aircraft", "exports", "logs", "fixes", "studies", "verbs")
_OWN = "ins-gnss-bench"  # the distribution of bench
_OF_OBJECTS = {"estimators": "module:Class", "verbs": "module:command"}
_OF_FOLDERS = ("catalog", "aircraft")
_NAME = re.compile(r"[A-Za-z0-9_.-]{1,100}")
_MODULE = re.compile(r"[A-Za-z_]\w*(\.[A-Za-z_]\w*)*")


@dataclass(frozen=True, slots=True)
class Installed:
    """One addition of an entry point."""

    name: str
    place: str  # "module:Class", "module" or "package.folder"
    package: str  # that brings it, with its version


def find_own(group: str) -> dict[str, str]:
    """Return the entries of a group by the plug-ins of bench: name -> "module" or "module:attribute".

    Raises
    ------
    ConfigError
        If the installed metadata does not name every plug-in.
    """
    return {name: place for one, name, place in _list_own() if one == group}


def list_modules(package: str) -> list[str]:
    """Return the names of the modules below a package of bench, without importing them."""
    found = sorted(_find_source(package).with_suffix("").rglob("[!_]*.py"))
    return [".".join(one.with_suffix("").relative_to(PACKAGE.parent).parts) for one in found]


def read_constant(module: str, name: str) -> Any:
    """Return a literal that a module of bench assigns, without importing the module; None if it has none."""
    source = _find_source(module).read_text(encoding="utf-8")
    _, found, rest = source.partition(f"\n{name} = ")
    lines = rest.splitlines()
    for count in range(1, len(lines) + 1) if found else ():
        with contextlib.suppress(SyntaxError):  # a literal of more lines
            return literal_eval("\n".join(lines[:count]))
    return None


def _find_source(module: str) -> Path:
    return PACKAGE.joinpath(*module.split(".")[1:]).with_suffix(".py")


@cache
def _list_own() -> list[tuple[str, str, str]]:
    try:
        entries = list(distribution(_OWN).entry_points)
    except PackageNotFoundError:
        entries = []
    found = [
        (one.group.removeprefix("bench."), one.name, one.value)
        for one in entries
        if one.value.startswith("bench.plugins.")
    ]
    there = {path.parent.name for path in (PACKAGE / "plugins").glob("*/__init__.py")}
    if there - {place.split(".")[2] for _, _, place in found}:
        raise ConfigError(
            f"{PACKAGE}: the installed metadata does not name its plug-ins; in the checkout: pip install -e ."
        )
    return found


def find_installed(group: str, taken: Collection[str] = ()) -> dict[str, Installed]:
    """Return the entries of a group by installed packages, by name; broken entries are left out.

    Parameters
    ----------
    group : str
        One of `GROUPS`.
    taken : collection of str
        Names of bench itself, which no package can take.
    """
    return {one.name: one for one, wrong in _examine(group, taken) if not wrong}


def find_class(use: str, taken: Collection[str]) -> str:
    """Return the ``module:Class`` of a filter that a package adds; any other text as it is."""
    own = None if ":" in use or use in taken else find_installed("estimators", taken).get(use)
    return use if own is None else own.place


def import_installed(what: str, one: Installed, *functions: str) -> Any:
    """Import the module of another package's entry, which must have functions of these names.

    Raises
    ------
    ConfigError
        If it cannot be imported or lacks one: a line that names the package.
    """
    place, shown = one.place.partition(":")[0], f"{what} {one.name!r} of {one.package}"
    try:
        module = import_module(place)
    except (Exception, SystemExit) as error:
        kind = "" if isinstance(error, ImportError) else f"{type(error).__name__}: "
        raise ConfigError(f"{shown}: {kind}{one_line(str(error))}") from error
    for name in functions:
        if not callable(getattr(module, name, None)):
            raise ConfigError(f"{shown}: {place} has no function {name}")
    return module


def list_problems(group: str, taken: Collection[str] = ()) -> list[str]:
    """Return a line for each entry of a group that cannot be used."""
    return [f"{one.package}: {group} {one.name!r} {wrong}" for one, wrong in _examine(group, taken) if wrong]


def find_folders(group: str) -> dict[str, Path]:
    """Return the folders that installed packages add to "catalog" or "aircraft", by package."""
    found = {one.package: _locate(one.place) for one in find_installed(group).values()}
    return {package: folder for package, folder in found.items() if folder is not None}


def _examine(group: str, taken: Collection[str]) -> Iterator[tuple[Installed, str]]:
    """Yield each entry and what is wrong with it; an empty text if nothing is."""
    seen: dict[str, str] = {}
    found = entry_points(group=".".join(("bench", group)))
    entries = sorted(found, key=lambda one: (one.name, _name_package(one)))
    for entry in entries:
        if entry.dist is not None and re.sub(r"[-_.]+", "-", entry.dist.name).lower() == _OWN:
            continue
        one = Installed(entry.name[:100], entry.value[:200], _name_package(entry))
        module, colon, attribute = entry.value.partition(":")
        shape = _OF_OBJECTS.get(group, "folder" if group in _OF_FOLDERS else "module")
        fits = bool(_MODULE.fullmatch(module)) and (
            attribute.isidentifier() if group in _OF_OBJECTS else not colon
        )
        wrong = ""
        if not _NAME.fullmatch(entry.name):
            wrong = "is no name of letters, digits, '-', '_' and '.', 100 at most"
        elif entry.name in taken:
            wrong = "is a name of bench itself; it keeps its own"
        elif entry.name in seen and seen[entry.name] != one.package:
            wrong = f"is a name of {seen[entry.name]}, too, which comes first"
        elif not fits:
            wrong = f"= {one.place!r} does not have the form {shape!r}"
        elif shape == "folder" and _locate(one.place) is None:
            wrong = f"= {one.place!r}: there is no such folder"
        else:
            seen[entry.name] = one.package
        yield one, wrong


def _name_package(entry: EntryPoint) -> str:
    return f"{entry.dist.name} {entry.dist.version}" if entry.dist is not None else "an unknown package"


def _locate(place: str) -> Path | None:
    """Return the folder "package.folder" without importing the package; None if there is none."""
    top, *rest = place.split(".")
    try:
        spec = find_spec(top)  # finds, but does not import, a package that is in no other
    except (ImportError, ValueError):
        return None
    roots = spec.submodule_search_locations if spec is not None else None
    folders = (Path(root).joinpath(*rest) for root in roots or ())
    return next((folder for folder in folders if folder.is_dir()), None)
