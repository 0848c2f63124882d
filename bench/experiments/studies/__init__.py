"""Questions that a designer asks before buying sensors, each answered by a table, figures and sentences.

A study is a module with ``Options``, a `StudyOptions`, ``run(options, work) -> Findings`` and ``QUESTION``, a
text. One below this folder has ``STUDY``, its place and its name, too, and is listed nowhere else; one
elsewhere is an entry point ``bench.studies`` of its package.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from importlib import import_module
from typing import Any, NamedTuple

from bench.core.files.installed import (
    find_installed,
    find_own,
    import_installed,
    list_modules,
    read_constant,
)


class StudyEntry(NamedTuple):
    """Module and question of a study."""

    module: str
    question: str


def _declared() -> Iterator[tuple[str, StudyEntry]]:
    below = {module: read_constant(module, "STUDY") for module in list_modules(__name__)}
    own = sorted((*study, module) for module, study in below.items() if study)
    for name, module in [*(row[1:] for row in own), *find_own("studies").items()]:
        yield name, StudyEntry(module, read_constant(module, "QUESTION"))


STUDIES: Mapping[str, StudyEntry] = dict(_declared())
"""Name of a study of bench, of a plug-in last -> its module and its question, in a line."""


def find_studies() -> dict[str, StudyEntry]:
    """Return the studies by name, studies of packages last; no package is imported."""
    added = find_installed("studies", STUDIES)
    return {**STUDIES, **{name: StudyEntry(one.place, f"of {one.package}") for name, one in added.items()}}


def import_study(name: str) -> Any:
    """Return the module of a study of `find_studies`.

    Raises
    ------
    ConfigError
        If it is another package's and cannot be imported: a line that names the package.
    """
    if name in STUDIES:
        return import_module(STUDIES[name].module)
    return import_installed("study", find_installed("studies", STUDIES)[name], "run")
