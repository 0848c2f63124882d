"""Which tests execute a line, by the contexts that coverage has written down.

Coverage sees no line of a kernel, for numba compiles it, and sees what stands outside of functions only at
the import. Both are executed by the tests that execute a line with their name; if that is a line of another
kernel, by the tests that execute that one.

A result that a test file keeps (``@cache``) or shares (``made_once``) belongs to the first test that asks for
it, so the tests of such files are taken together. A truth that is read from the cache has executed nothing:
of `bench.simulation.flight`, tests are found that fly.
"""

from __future__ import annotations

import ast
import json
import re
from collections import defaultdict
from collections.abc import Iterator, Sequence
from functools import cached_property
from pathlib import Path

import coverage
from coverage import CoverageData

from bench.core.words.exceptions import BenchError
from tests.mutants.plugin import CONTEXT, REPORTED, SHARED
from tests.mutants.sites import Place, walk
from tests.mutants.trial import Trial

_DATA, _TESTS = "lines", "tests.json"
_SETTINGS = """
[run]
core = ctrace
parallel = true
data_file = {data}
include =
    {root}/bench/*
    {root}/tests/*
context = ${{{context}-}}
"""
_KEEPS = re.compile(r"@(functools\.)?cache\b")
_SHARES = re.compile(r"\b(made_once|recorded)\(")


def measure(trial: Trial, tests: Sequence[str], found: Path) -> None:
    """Run tests of an unchanged tree; write into a folder which lines each executes and how it went."""
    settings, reported = found / "settings", found / _TESTS
    settings.write_text(_SETTINGS.format(root=trial.root, data=found / _DATA, context=CONTEXT), "utf-8")
    variables = {"COVERAGE_PROCESS_START": settings, REPORTED: reported}
    status, output = trial.run_tests("-nauto", "--dist=worksteal", *tests, variables=variables)
    if status not in (0, 1) or not reported.exists():  # 1: a test failed, and is left out
        raise BenchError(f"the tests do not run in a copy of the tree; pytest says\n{output[-2000:]}")
    coverage.Coverage(config_file=str(settings)).combine([str(found)])
    told = {"root": str(trial.root), "tests": json.loads(reported.read_text("utf-8"))}
    reported.write_text(json.dumps(told), "utf-8")


class Executed:
    """The lines of a tree, and the tests that executed them."""

    def __init__(self, root: Path, found: Path) -> None:
        """Read what `measure` wrote into a folder; ``root`` is the tree, where it is now."""
        self._root = root
        self._data = CoverageData(str(found / _DATA))
        self._data.read()
        told = json.loads((found / _TESTS).read_text("utf-8"))
        self._measured, tests = told["root"], told["tests"]
        self._fixtures = {nodeid: one["fixtures"] for nodeid, one in tests.items() if one["passed"]}
        self.seconds: dict[str, float] = {nodeid: tests[nodeid]["seconds"] for nodeid in self._fixtures}
        self.left_out = len(tests) - len(self.seconds)
        self._places: dict[str, dict[str, set[Place]]] = {}

    def find_tests(self, file: str, place: Place) -> set[str]:
        """Return the tests that passed and executed a place of a file."""
        contexts = self._follow(file, place, set())
        return {nodeid for context in contexts for nodeid in self._list_tests(context)}

    def _follow(self, file: str, place: Place, followed: set[tuple[str, str]]) -> set[str]:
        """Return the contexts of a place, and of the lines that execute it by its name."""
        by_line = self._data.contexts_by_lineno(f"{self._measured}/{file}")
        found = {one for line in range(place.first, place.last + 1) for one in by_line.get(line, ()) if one}
        if place.name and (file, place.name) not in followed:
            followed.add((file, place.name))
            for other, naming in self._find_names(place.name, file):
                found |= self._follow(other, naming, followed)
        return found

    def _find_names(self, name: str, file: str) -> Iterator[tuple[str, Place]]:
        """Yield where a name of a file is used: there, and in files that mention the module."""
        path = Path(file)
        module = re.compile(rf"\b{path.parent.name if path.stem == '__init__' else path.stem}\b")
        for other, text in self._sources.items():
            if name in text and (other == file or module.search(text)):
                if other not in self._places:
                    self._places[other] = defaultdict(set)
                    for node, place in walk(ast.parse(text)):
                        if isinstance(node, ast.Name | ast.Attribute) and isinstance(node.ctx, ast.Load):
                            used = node.id if isinstance(node, ast.Name) else node.attr
                            self._places[other][used].add(place)
                yield from ((other, place) for place in self._places[other].get(name, ()))

    @cached_property
    def _sources(self) -> dict[str, str]:
        paths = sorted(path for folder in ("bench", "tests") for path in (self._root / folder).rglob("*.py"))
        return {path.relative_to(self._root).as_posix(): path.read_text(encoding="utf-8") for path in paths}

    def _list_tests(self, context: str) -> Iterator[str]:
        """Yield the tests of a context; with them those that may have been given what it made."""
        if context.startswith(SHARED):
            where, _, fixture = context.removeprefix(SHARED).rpartition(">")
            yield from (
                one for one, used in self._fixtures.items() if one.startswith(where) and fixture in used
            )
        else:
            together = self._together.get(find_file(context), ())
            yield from (one for one in self._fixtures if one == context or find_file(one) in together)

    @cached_property
    def _together(self) -> dict[str, set[str]]:
        """The files whose tests keep or share results -> those that do so with them."""
        shares = {file for file, text in self._sources.items() if _SHARES.search(text)}
        keeps = {file: {file} for file, text in self._sources.items() if _KEEPS.search(text)}
        return keeps | {file: shares | keeps.get(file, set()) for file in shares}


def find_file(nodeid: str) -> str:
    """Return the file of a test."""
    return nodeid.partition("::")[0]
