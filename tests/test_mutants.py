"""The tool of ``make mutants``, on a package of a few lines whose tests detect some errors and not others."""

from __future__ import annotations

import textwrap
import time
from pathlib import Path

import pytest

from bench.core.files.places import PACKAGE
from bench.core.words.exceptions import BenchError
from tests.builders import is_running
from tests.mutants.__main__ import EQUIVALENT, examine, main, read_equivalent
from tests.mutants.sites import draw, find_mutants
from tests.mutants.trial import Trial

SOURCES = {
    "pyproject.toml": '[tool.hatch.build.targets.sdist]\ninclude = ["bench", "tests"]\n',
    "bench/__init__.py": "",
    "bench/tiny/__init__.py": "",
    "bench/tiny/way.py": """
        from types import FunctionType

        FAR = 100.0

        def kernel(function):
            \"\"\"Hide the lines of a function from coverage, as numba does.\"\"\"
            return FunctionType(function.__code__.replace(co_filename="machine code"), globals())

        @kernel
        def _square_kernel(x):
            return x * x

        def square(x):
            return _square_kernel(x)

        def is_far(x):
            return x > FAR

        def first(rows):
            return rows[0]

        def left_alone(x):
            return -x

        def scale(x):
            return x / 1

        def print_difference(a, b):
            print(a - b)
    """,
    "tests/__init__.py": "",
    "tests/test_way.py": """
        import subprocess, sys
        import pytest
        from bench.tiny import way

        @pytest.fixture(scope="module")
        def row():
            return way.first([[7, 8], [9]])

        def test_the_fixture_is_made_here(row):
            assert row

        def test_the_first_row(row):
            assert row == [7, 8]

        def test_square():
            assert way.square(3.0) == 9.0

        def test_far():
            assert way.is_far(1000.0)
            assert not way.is_far(1.0)

        def test_scale():
            assert way.scale(4) == 4

        def test_in_another_process():
            code = "from bench.tiny import way; way.print_difference(5, 2)"
            assert subprocess.check_output([sys.executable, "-c", code], text=True) == "3\\n"

        def test_that_fails():
            assert way.square(3.0) == 10.0
    """,
    "tests/mutants/equivalent.toml": """
        [[equivalent]]
        file = "bench/tiny/way.py"
        where = "scale"
        before = "return x / 1"
        after = "return (x * 1)"
        reason = "dividing by one is multiplying by one"
    """,
    "tests/hang.py": """
        import subprocess, sys

        def test_hang():
            child = subprocess.Popen([sys.executable, "-c", "import time; time.sleep(600)"])
            open("child", "w").write(str(child.pid))
            child.wait()
    """,
}


@pytest.fixture
def tree(tmp_path, monkeypatch) -> Path:
    monkeypatch.setenv("BENCH_CACHE", str(tmp_path / "cache"))
    monkeypatch.setenv("PYTEST_XDIST_AUTO_NUM_WORKERS", "1")
    for name, text in SOURCES.items():
        path = tmp_path / "tree" / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(textwrap.dedent(text).lstrip())
    return tmp_path / "tree"


def test_what_tests_notice_and_what_they_do_not(tree, tmp_path, capsys):
    lines = list(examine(tree, "tiny", seed=1, count=30, tests=["tests/test_way.py"]))
    results = {line.partition(" (")[0] for line in lines[:-1] if not line.startswith("  ")}
    assert results == {
        "unnoticed: bench/tiny/way.py:3",  # FAR, executed at the import: its test is found by its name
        "noticed: bench/tiny/way.py:11 _square_kernel",  # of a kernel: by the name of the kernel
        "noticed: bench/tiny/way.py:17 is_far",
        "noticed: bench/tiny/way.py:20 first",  # in a fixture that another test makes
        "unnoticed: bench/tiny/way.py:23 left_alone",
        "noticed: bench/tiny/way.py:29 print_difference",  # in a process that a test starts
    }
    at = lines.index("unnoticed: bench/tiny/way.py:23 left_alone (sign; no test executes it)")
    assert lines[at + 1 : at + 3] == ["  - return -x", "  + return x"]
    assert "  + FAR = 200.0" in lines
    assert lines[-1].startswith(
        "5 of 7 detected, 0 of them by taking too long; drawn from 7 with seed 1, 1 marked"
    )
    assert "1 tests did not pass" in capsys.readouterr().out

    for name, text in SOURCES.items():
        assert (tree / name).read_text() == textwrap.dedent(text).lstrip(), name
    (kept,) = (tmp_path / "cache" / "mutants").iterdir()
    assert list(examine(tree, "tiny/way.py", seed=1, count=0, tests=["tests/test_way.py"]))
    assert [*(tmp_path / "cache" / "mutants").iterdir()] == [kept]
    assert "Finding out" not in capsys.readouterr().out, "what was measured is kept"


def test_a_copy_of_bench_holds_what_its_tests_need(tmp_path):
    copy = Trial(PACKAGE.parent, tmp_path).root
    for name in (
        "bench/core/mathematics/earth.py",
        "aircraft/systems/guidance.xml",
        "tests/conftest.py",
        "pyproject.toml",
        ".gitignore",
    ):
        assert (copy / name).read_bytes() == (PACKAGE.parent / name).read_bytes()
    assert not (copy / ".venv").exists()


def test_a_test_that_hangs_is_ended_with_what_it_started(tree, tmp_path):
    (tmp_path / "scratch").mkdir()
    trial = Trial(tree, tmp_path / "scratch")
    child = trial.root / "child"
    for limit in (2.0, 10.0, 100.0):  # on a busy machine the test begins late
        status, _ = trial.run_tests("tests/hang.py", variables={}, limit=limit)
        assert status is None
        if child.exists() and child.read_text():
            break
    pid, deadline = int(child.read_text()), time.monotonic() + 60.0
    while is_running(pid) and time.monotonic() < deadline:
        time.sleep(0.05)
    assert not is_running(pid)


@pytest.mark.parametrize(
    ("source", "kind", "mutants"),
    [
        ("a + b", "sign", ["(a - b)"]),
        ("a - b", "term", ["a"]),
        ("a + b", "term", ["a", "b"]),
        ("-a", "sign", ["a"]),
        ("a * (b + c)", "factor", ["(a / (b + c))"]),
        ("2.5 @ a", "factor", ["5.0 @ a"]),
        ("a[0, 3:6, i]", "index", ["a[1, 3:6, i]", "a[0, 2:6, i]", "a[0, 3:5, i]"]),
        ("np.deg2rad(a) if b else DEG", "unit", ["a if b else DEG", "np.deg2rad(a) if b else 1.0"]),
        ("a <= b < c", "comparison", ["(a >= b < c)", "(a <= b > c)"]),
        ("a is not b", "comparison", ["(a is b)"]),
        ("a and b and c", "term", ["(b and c)", "(a and c)", "(a and b)"]),
        ('"ab" + c', "sign", []),
        ('f"{a - b}"', "sign", []),
    ],
)
def test_the_errors_of_a_line(source, kind, mutants, tmp_path):
    path = tmp_path / "one.py"
    path.write_text(f"def compute():\n    return {source}  # größer\n")
    found = [one for one in find_mutants(path, tmp_path) if one.kind == kind]
    plain = [one.after.removesuffix("  # größer").removeprefix("return ") for one in found]
    assert plain == mutants
    for one in found:
        compile(one.apply(path.read_bytes()), "one.py", "exec")


def test_a_draw_repeats_and_takes_every_kind():
    root = PACKAGE.parent
    paths = sorted((PACKAGE / "experiments" / "studies").glob("*.py"))
    mutants = [one for path in paths for one in find_mutants(path, root)]
    drawn = draw(mutants, 60, seed=3)
    assert drawn == draw(mutants, 60, seed=3)
    assert drawn != draw(mutants, 60, seed=4)
    assert len(set(drawn)) == 60
    assert {one.kind for one in drawn} == {"sign", "factor", "index", "unit", "term", "comparison"}


def test_every_entry_of_the_list_of_equivalents_is_a_mutant_of_the_tree():
    read_equivalent(PACKAGE.parent)


def test_an_entry_that_is_no_mutant_any_more_is_told(tree):
    path = tree / EQUIVALENT
    path.write_text(path.read_text().replace("return x / 1", "return x / 3"))
    with pytest.raises(BenchError, match=r"in bench/tiny/way.py scale no mutant turns 'return x / 3' into"):
        read_equivalent(tree)


def test_an_unknown_package_is_told_with_all_of_them(capsys):
    assert main(["navigatoin", "--seed=1"]) != 0
    assert capsys.readouterr().err.startswith("error: PACKAGE=navigatoin: name a package or module of bench")
