"""The layout of the package: short files, one module of each name, no circular imports.

Every exemption says why it is there, and fails when it is no longer needed.
"""

from __future__ import annotations

import ast
import re
import sys
import tomllib
from collections import Counter
from collections.abc import Iterator
from graphlib import CycleError, TopologicalSorter
from pathlib import Path

import pytest
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

import bench
from bench.experiments.studies import STUDIES
from tests.conftest import SLOWEST

PACKAGE = Path(bench.__file__).parent
MOST_LINES = 450
MOST_MODULES = 20  # of a folder
MOST_ARROWS = 40  # between rooms
LONGEST_CHAIN = 46  # modules that import each other one after the other
MOST_CODE = 60  # lines of a function
MOST_FILES = {"navigate": 50, "read_profile": 26}  # whose code runs
ROOMS = (
    "cli",
    "views",
    "experiments",
    "pipeline",
    "io",
    "evaluation",
    "navigation",
    "simulation",
    "core",
)
"""From the highest to the lowest."""
LONG_FUNCTIONS = {
    "align_on_the_move": "one alignment, in the order of its equations",
    "align_at_rest": "the same at rest",
    "go": "the run of a filter, in which every state is in sight",
}
""":func:`test_functions_are_short` leaves these out, and kernels, which call nothing."""


def modules() -> dict[str, Path]:
    """Return every module and package of bench by its dotted name."""
    found = {}
    for path in sorted(PACKAGE.rglob("*.py")):
        parts = path.relative_to(PACKAGE.parent).with_suffix("").parts
        found[".".join(parts[:-1] if parts[-1] == "__init__" else parts)] = path
    return found


def imported(name: str, path: Path, known: dict[str, Path]) -> Iterator[str]:
    """Yield the modules of bench that a file imports or names, in functions and for types only included.

    ``from bench.core.mathematics.earth import RATE`` names ``bench.core.mathematics.earth``, ``from bench
    import earth`` as well; the packages above a module, which Python imports first, are not counted. A public
    name of ``bench`` is a name of where it lives. So does the text "bench.core.mathematics.earth" or
    "bench.core.mathematics.earth:Earth", which may be imported later; f"bench.simulation.sensors.{kind}" and
    f"{__name__}.{kind}" name every module of that package.
    """
    package = name if path.name == "__init__.py" else name.rpartition(".")[0]
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Constant) and isinstance(node.value, str):
            yield from {node.value.partition(":")[0]} & known.keys()
        elif isinstance(node, ast.JoinedStr):
            folder = read_start(node, name)
            yield from (one for one in known if folder in known and one.rpartition(".")[0] == folder)
        elif isinstance(node, ast.Attribute):
            root = isinstance(node.value, ast.Name) and node.value.id == "bench"
            yield from [bench._PUBLIC[node.attr]] if root and node.attr in bench._PUBLIC else ()
        elif isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names if alias.name in known)
        elif isinstance(node, ast.ImportFrom):
            above = package.split(".")[: len(package.split(".")) - node.level + 1] if node.level else []
            base = ".".join([*above, *([node.module] if node.module else [])])
            for alias in node.names:
                target = f"{base}.{alias.name}"
                if base == "bench" and alias.name in bench._PUBLIC:
                    yield bench._PUBLIC[alias.name]
                if target in known or base in known:
                    yield target if target in known else base


def read_start(text: ast.JoinedStr, name: str) -> str:
    """Return the package at the start of an f-string of the module ``name``; prose names none."""
    start = ""
    for part in text.values:
        if isinstance(part, ast.Constant):
            is_prose = re.fullmatch(r"[\w.]*", part.value) is None
            return "" if is_prose else (start + part.value).rpartition(".")[0]
        if ast.unparse(part.value) != "__name__":
            break
        start += name
    return ""


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
    assert [name for name, lines in lengths.items() if lines > MOST_LINES] == [], "divide the file"


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


def test_a_class_name_is_used_once():
    """A leading underscore does not make another name; every study has its ``Options``, by the contract."""
    names: dict[str, list[str]] = {}
    for name, path in modules().items():
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.ClassDef):
                names.setdefault(node.name.lstrip("_"), []).append(name)
    twice = {cls: homes for cls, homes in names.items() if len(homes) > 1}
    studies = {entry.module for entry in STUDIES.values()}
    assert set(twice.pop("Options")) - studies == {"bench.navigation.options"}
    assert twice == {}, "rename one of them"


def read_floors() -> dict[str, list[str]]:
    """Return the floors of each package that has some, from the highest: "studies | report", say."""
    project = tomllib.loads((PACKAGE.parent / "pyproject.toml").read_text(encoding="utf-8"))
    contracts = project["tool"]["importlinter"]["contracts"]
    return {one["containers"][0]: one["layers"] for one in contracts if one["type"] == "layers"}


def list_arrows_up(package: str, floors: list[str], graph: dict[str, set[str]]) -> list[str]:
    """Return the imports inside a package that do not go down; those joined by ":" may know each other."""
    floor = {room: k for k, names in enumerate(floors) for room in re.split(r" [|:] ", names)}
    below = package.count(".") + 1
    wrong = []
    for name, targets in graph.items():
        for target in sorted(targets):
            if not (name.startswith(f"{package}.") and target.startswith(f"{package}.")):
                continue
            one, other = (each.split(".")[below] for each in (name, target))
            level = floor[one] == floor[other] and ":" in floors[floor[one]]
            if one != other and not level and floor[one] >= floor[other]:
                wrong.append(f"{name} -> {target}")
    return wrong


@pytest.fixture(scope="module")
def graph():
    """The modules of bench that each one imports or names."""
    known = modules()
    del known["bench"]
    return {name: set(imported(name, path, known)) - {name} for name, path in known.items()}


def room(name: str) -> str:
    return name.split(".")[1]


def test_the_root_holds_the_rooms_and_the_plugins():
    found = {path.name for path in PACKAGE.iterdir() if path.name not in ("__pycache__", "aircraft")}
    data = {"catalog", "profiles", "guide"}
    assert found == {*ROOMS, *data, "plugins", "__init__.py", "__main__.py", "py.typed"}
    assert [one for one in ROOMS if not (PACKAGE / one / "README.md").is_file()] == []


def test_no_import_goes_up_and_there_are_few_arrows(graph):
    """import-linter sees neither texts nor, here, imports for types."""
    for package, floors in read_floors().items():
        assert list_arrows_up(package, floors, graph) == []
    assert tuple(read_floors()["bench"]) == ("plugins", "__main__ : cli", *ROOMS[1:])
    arrows = {(room(name), room(one)) for name, found in graph.items() for one in found}
    between = {(one, other) for one, other in arrows if one != other and {one, other} <= {*ROOMS}}
    assert len(between) <= MOST_ARROWS


def test_a_folder_holds_few_modules():
    counts = Counter(path.parent for path in PACKAGE.rglob("*.py"))
    assert {str(folder): count for folder, count in counts.items() if count > MOST_MODULES} == {}


def test_chains_of_imports_are_short(graph):
    order = TopologicalSorter(graph).static_order()
    longest: dict[str, list[str]] = {}
    for name in order:
        longest[name] = [name, *max((longest[one] for one in graph[name]), key=len, default=[])]
    chain = max(longest.values(), key=len)
    assert len(chain) <= LONGEST_CHAIN, " -> ".join(chain)


def count_code(source: str, function: ast.FunctionDef) -> int:
    """Return the lines of a function's body that are neither empty, nor a comment, nor its docstring."""
    first = function.body[1:] if ast.get_docstring(function) else function.body
    lines = source.splitlines()[first[0].lineno - 1 : function.end_lineno] if first else []
    return sum(1 for line in lines if line.strip() and not line.strip().startswith("#"))


def test_functions_are_short():
    found, used = {}, set()
    for path in PACKAGE.rglob("*.py"):
        source = path.read_text(encoding="utf-8")
        for one in ast.walk(ast.parse(source)):
            if not isinstance(one, ast.FunctionDef) or one.name.endswith("kernel"):
                continue
            if (
                count := count_code(source, one)
            ) > MOST_CODE and path.name != "starting_point.py":  # what bench new writes
                used.add(one.name)
                found[f"{path.name}: {one.name}"] = count
    assert {name: n for name, n in found.items() if name.split(": ")[1] not in LONG_FUNCTIONS} == {}
    assert set(LONG_FUNCTIONS) <= used, "no exemption without need"


def list_files_run(function) -> set[str]:
    """Return the files of bench whose functions run in a second call."""
    function()
    seen = set()

    def watch(frame, event, argument):
        if event == "call" and frame.f_code.co_name != "<module>":
            seen.add(frame.f_code.co_filename)

    sys.setprofile(watch)
    try:
        function()
    finally:
        sys.setprofile(None)
    return {name for name in seen if name.startswith(str(PACKAGE))}


def test_few_files_run_for_one_answer():
    profile = bench.read_profile("static", {"leg.1.duration_s": 40, "evaluation.from_s": 20})
    sensed = bench.sense(profile, bench.fly(profile))
    navigate = list_files_run(lambda: bench.run_filter("loose-15", sensed.data, sensed.initial))
    assert len(navigate) <= MOST_FILES["navigate"], sorted(navigate)
    load = list_files_run(lambda: bench.read_profile("figure-eight"))
    assert len(load) <= MOST_FILES["read_profile"], sorted(load)


def test_an_import_that_goes_up_is_found():
    floors = ["top", "left | right", "one : two"]
    down = {"bench.top.a": {"bench.left", "bench.two"}, "bench.one": {"bench.two"}, "bench.two": set()}
    assert list_arrows_up("bench", floors, down) == []
    for name, target in [("one", "left"), ("left", "right"), ("two", "top.a")]:
        arrow = {f"bench.{name}": {f"bench.{target}"}}
        assert list_arrows_up("bench", floors, arrow) == [f"bench.{name} -> bench.{target}"]


def test_imports_by_text_and_for_types_are_seen(tmp_path):
    known = dict.fromkeys(
        [
            "bench.core.mathematics.earth",
            "bench.simulation.sensors",
            "bench.simulation.sensors.baro",
            "bench.simulation.sensors.gnss",
        ]
    )
    for source, found in {
        "row = ('a title', 'bench.core.mathematics.earth:RATE')": {"bench.core.mathematics.earth"},
        "import_module('bench.core.mathematics.earth')": {"bench.core.mathematics.earth"},
        "import_module(f'bench.simulation.sensors.{kind}')": {
            "bench.simulation.sensors.baro",
            "bench.simulation.sensors.gnss",
        },
        "import_module(f'{__name__}.{kind}')": {
            "bench.simulation.sensors.baro",
            "bench.simulation.sensors.gnss",
        },
        "if TYPE_CHECKING:\n    from bench.simulation.sensors.gnss import Fixes": {
            "bench.simulation.sensors.gnss"
        },
        "'see bench.core.mathematics.earth'; f'bench.{group}'": set(),
    }.items():
        (tmp_path / "__init__.py").write_text(source)
        assert set(imported("bench.simulation.sensors", tmp_path / "__init__.py", known)) == found, source


def test_readme_shows_the_floors_as_they_are():
    text = (PACKAGE.parent / "CONTRIBUTING.md").read_text(encoding="utf-8")
    shown = re.search(r"```text\n(plugins > [^`]*)```", text)[1]
    assert [" ".join(one.split()) for one in shown.split(">")] == read_floors()["bench"]


def test_imports_are_not_circular(graph):
    """Under TYPE_CHECKING and inside functions too; the package itself names what is public everywhere."""
    assert circle(graph) is None


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
    names = (project["name"], ".")
    extras = {f"{name}[{extra}]" for name in names for extra in project["optional-dependencies"]}
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
