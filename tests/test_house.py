"""The layout of the package: short files, one module of each name, no circular imports.

Every exemption says why it is there, and fails when it is no longer needed.
"""

from __future__ import annotations

import ast
import re
import tomllib
from collections.abc import Iterator
from graphlib import CycleError, TopologicalSorter
from pathlib import Path

from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

import bench
from tests.conftest import SLOWEST

PACKAGE = Path(bench.__file__).parent
MOST_LINES = 450

LONG_FILES = {
    "specs.py": "all that a profile asks for, in SI",
}


def modules() -> dict[str, Path]:
    """Return every module and package of bench by its dotted name."""
    found = {}
    for path in sorted(PACKAGE.rglob("*.py")):
        parts = path.relative_to(PACKAGE.parent).with_suffix("").parts
        found[".".join(parts[:-1] if parts[-1] == "__init__" else parts)] = path
    return found


def imported(name: str, path: Path, known: dict[str, Path]) -> Iterator[str]:
    """Yield the modules of bench that the statements of a file name, those in functions included.

    ``from bench.earth import RATE`` names ``bench.earth``, ``from bench import earth`` as well; the packages
    above a module, which Python imports first, are not counted.
    """
    package = name if path.name == "__init__.py" else name.rpartition(".")[0]
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names if alias.name in known)
        elif isinstance(node, ast.ImportFrom):
            above = package.split(".")[: len(package.split(".")) - node.level + 1] if node.level else []
            base = ".".join([*above, *([node.module] if node.module else [])])
            for alias in node.names:
                target = f"{base}.{alias.name}"
                if target in known or base in known:
                    yield target if target in known else base


def circle(graph: dict[str, set[str]]) -> list[str] | None:
    """Return modules that import each other in a circle, the first again at the end, or None."""
    try:
        TopologicalSorter(graph).prepare()
    except CycleError as error:
        return error.args[1]
    return None


def test_files_are_short():
    lengths = {
        path.relative_to(PACKAGE).as_posix(): len(path.read_text(encoding="utf-8").splitlines())
        for path in PACKAGE.rglob("*.py")
    }
    long = {name for name, lines in lengths.items() if lines > MOST_LINES}
    assert sorted(long - LONG_FILES.keys()) == [], "divide the file, or say in LONG_FILES why it is one thing"
    assert sorted(LONG_FILES.keys() - long) == [], "no longer long: take it out of LONG_FILES"


def test_options_of_the_evaluation_travel_as_one_record():
    """A further one is a key, a field of `EvaluationWindow` and its use: three files."""
    named = [path.name for path in PACKAGE.rglob("*.py") if re.search(r"\bfrom_s\b", path.read_text())]
    assert len(named) <= 8, f"pass EvaluationWindow on; from_s is named in {', '.join(sorted(named))}"


def test_a_module_name_is_used_once():
    names: dict[str, list[str]] = {}
    for name in modules():
        names.setdefault(name.rpartition(".")[2], []).append(name)
    twice = {short: full for short, full in names.items() if len(full) > 1 and short != "__main__"}
    assert twice == {}, "rename one of them"


def test_imports_are_not_circular():
    """Under TYPE_CHECKING and inside functions too; the package itself names what is public everywhere."""
    known = modules()
    del known["bench"]
    assert circle({name: set(imported(name, path, known)) - {name} for name, path in known.items()}) is None


def test_a_circle_is_found():
    assert circle({"a": {"b"}, "b": {"c"}, "c": {"a"}, "d": {"a"}}) is not None
    assert circle({"a": {"b", "c"}, "b": {"c"}, "c": set()}) is None


def test_the_tests_that_begin_first_are_there():
    sources = [path.read_text(encoding="utf-8") for path in Path(__file__).parent.rglob("test_*.py")]
    missing = [name for name in SLOWEST if not any(f"def {name}(" in source for source in sources)]
    assert missing == [], "take them out of SLOWEST"


def test_what_pip_is_to_install_is_this_project_and_an_extra_of_it():
    root = PACKAGE.parent
    project = tomllib.loads((root / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    extras = {f"{project['name']}[{extra}]" for extra in project["optional-dependencies"]}
    texts = [path.read_text(encoding="utf-8") for path in PACKAGE.rglob("*.[pm][yd]")]
    named = [name for text in texts for name in re.findall(r"pip install '([^']+)'", text)]
    assert named
    assert set(named) <= extras


def test_the_lock_holds_what_is_asked_for_with_hashes_and_no_host():
    """A version that pyproject.toml allows of every dependency, on both ends of the Pythons: make lock."""
    root = PACKAGE.parent
    project = tomllib.loads((root / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    text = (root / "requirements.lock").read_text(encoding="utf-8")
    assert "://" not in text
    entries = [
        entry for entry in text.replace("\\\n", "").splitlines() if entry and not entry.startswith("#")
    ]
    assert all(re.search(r" --hash=sha256:[0-9a-f]{64}", entry) for entry in entries)
    pins = [Requirement(entry.partition(" --hash")[0]) for entry in entries]
    wanted = map(Requirement, [*project["dependencies"], *project["optional-dependencies"]["test"]])
    for one in wanted:
        for python in ("3.11", "3.12"):
            here = {"python_version": python, "python_full_version": f"{python}.0"}
            if one.marker is not None and not one.marker.evaluate(here):
                continue
            found = [
                next(iter(pin.specifier)).version
                for pin in pins
                if canonicalize_name(pin.name) == canonicalize_name(one.name)
                if pin.marker is None or pin.marker.evaluate(here)
            ]
            assert len(found) == 1, f"{one} on Python {python}: {found}"
            assert found[0] in one.specifier, f"{one} on Python {python}: {found}"


def test_the_tests_of_the_oldest_versions_are_there():
    root = PACKAGE.parent
    makefile = (root / "Makefile").read_text(encoding="utf-8").replace("\\\n", " ")
    names = re.search(r"^MINIMA := (.*)", makefile, re.MULTILINE)[1].split()
    assert len(names) > 10
    assert [name for name in names if not (root / name).exists()] == []
