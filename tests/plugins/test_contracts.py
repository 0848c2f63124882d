"""What a plug-in imports of the rooms of bench, and that these import none of it."""

from __future__ import annotations

import ast
import re

import pytest

from tests.test_house import PACKAGE, imported, modules

MOST = {"papers": 47, "receiver": 42, "graph": 24, "hil": 24, "autopilots": 19}
"""Plug-in -> how many modules of the rooms it may import, in functions and for types too."""

ROOMS = {
    "papers": "core evaluation experiments io navigation pipeline simulation",
    "receiver": "cli core evaluation io navigation simulation views",
    "graph": "core navigation",
    "hil": "cli core io navigation pipeline simulation",
    "autopilots": "core io simulation",
}
"""Plug-in -> the rooms that it imports from."""


def list_imports() -> dict[str, set[str]]:
    """Return what each module of bench imports or names."""
    known = modules()
    del known["bench"]
    return {name: set(imported(name, path, known)) for name, path in known.items()}


IMPORTS = list_imports()


def test_every_plugin_has_its_contract():
    assert {path.parent.name for path in (PACKAGE / "plugins").glob("*/__init__.py")} == set(MOST)


@pytest.mark.parametrize("plugin", MOST)
def test_a_plugin_imports_from_few_modules_of_its_rooms_and_of_no_other_plugin(plugin):
    own = f"bench.plugins.{plugin}"
    found = {
        target
        for name, targets in IMPORTS.items()
        if f"{name}.".startswith(f"{own}.")
        for target in targets
        if not f"{target}.".startswith(f"{own}.")
    }
    assert {name.split(".")[1] for name in found} == set(ROOMS[plugin].split())
    assert len(found) <= MOST[plugin], sorted(found)


def test_nothing_else_names_a_module_of_a_plugin():
    """Neither as an import nor as a text of any kind; `bench` itself does for checkers of types."""
    for name, path in modules().items():
        if name.startswith("bench.plugins"):
            continue
        text = path.read_text(encoding="utf-8")
        if name == "bench":
            text = ast.unparse([one for one in ast.parse(text).body if not isinstance(one, ast.If)])
        named = re.findall(r"bench\.plugins\.\w+", text)
        assert named == [], f"{path.relative_to(PACKAGE)} reaches past the entry points"
    reaching = {
        name
        for name, targets in IMPORTS.items()
        if not name.startswith("bench.plugins")
        if any(target.startswith("bench.plugins") for target in targets)
    }
    assert reaching == set()
