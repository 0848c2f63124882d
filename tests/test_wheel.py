"""The wheel holds all it needs: beside what it requires, started in an empty folder, it flies.

The source distribution holds the whole tree, so that its tests can be run and a change be made.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tarfile
import zipfile
from email import message_from_bytes
from importlib.metadata import Distribution, distribution
from pathlib import Path

import pytest
from packaging.requirements import Requirement

ROOT = Path(__file__).parents[1]


def run(*command: object, cwd: Path, **extra: str) -> str:
    """Run a command that knows nothing of this tree, and return what it prints."""
    env = {
        name: value for name, value in os.environ.items() if not name.startswith(("PYTHON", "VIRTUAL_ENV"))
    }
    done = subprocess.run([str(c) for c in command], cwd=cwd, env=env | extra, capture_output=True, text=True)
    assert done.returncode == 0, f"{command}\n{done.stdout}\n{done.stderr}"
    return done.stdout


@pytest.fixture(scope="module")
def wheel(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("wheel")
    pip = (sys.executable, "-m", "pip", "wheel", "--quiet", "--disable-pip-version-check")
    run(*pip, "--no-deps", "--no-build-isolation", "--wheel-dir", folder, ROOT, cwd=folder)
    (built,) = folder.glob("*.whl")
    return built


def test_the_wheel_holds_every_file_of_the_package_and_the_aircraft(wheel):
    held = set(zipfile.ZipFile(wheel).namelist())
    package = (ROOT / "bench").rglob("*")
    endings = (".py", ".toml", ".md", ".png", ".typed", ".js", ".css", ".jinja")
    wanted = {
        path.relative_to(ROOT).as_posix()
        for path in package
        if path.suffix in endings or path.name == "LICENSE"
    }
    wanted |= {
        f"bench/{p.relative_to(ROOT).as_posix()}" for p in (ROOT / "aircraft").rglob("*") if p.is_file()
    }
    assert wanted <= held
    assert any(name.endswith("LICENSE") for name in held)
    assert not {name.split("/")[0] for name in held if ".dist-info" not in name} - {"bench"}


def test_the_source_distribution_holds_the_tree(tmp_path):
    if not (ROOT / ".git").exists():
        pytest.skip("git says what the tree is")
    hatchling = (sys.executable, "-m", "hatchling", "build", "--target", "sdist", "--directory", tmp_path)
    run(*hatchling, cwd=ROOT)
    (built,) = tmp_path.glob("*.tar.gz")
    with tarfile.open(built) as archive:
        held = {name.partition("/")[2] for name in archive.getnames()}
    known = {name for name in run("git", "ls-files", cwd=ROOT).splitlines() if (ROOT / name).exists()}
    new = run("git", "ls-files", "--others", "--exclude-standard", cwd=ROOT).splitlines()
    assert known - held == set()
    assert held - known - {*new, "PKG-INFO"} == set()


def required(wheel: Path) -> dict[str, Distribution]:
    """Return the installed distributions that a wheel needs, and those that they need, by name."""
    (name,) = (n for n in zipfile.ZipFile(wheel).namelist() if n.endswith(".dist-info/METADATA"))
    todo = message_from_bytes(zipfile.ZipFile(wheel).read(name)).get_all("Requires-Dist", [])
    found: dict[str, Distribution] = {}
    while todo:
        wanted = Requirement(todo.pop())
        applies = (
            (wanted.marker.evaluate({"extra": e}) for e in ("", *wanted.extras)) if wanted.marker else [True]
        )
        if any(applies) and wanted.name not in found:
            found[wanted.name] = distribution(wanted.name)
            todo += found[wanted.name].requires or []
    return found


@pytest.mark.slow
def test_installed_beside_nothing_but_what_it_requires_it_flies_in_an_empty_folder(wheel, tmp_path):
    """The environment links to the installed files of each required package; pip finds nothing missing.

    A filter without a large kernel flies: none is compiled in this environment yet.
    """
    here, env = tmp_path / "empty", tmp_path / "env"
    here.mkdir()
    run(sys.executable, "-m", "venv", "--without-pip", env, cwd=here)
    scripts = env / ("Scripts" if os.name == "nt" else "bin")
    site = Path(
        run(scripts / "python", "-c", "import site; print(site.getsitepackages()[0])", cwd=here).strip()
    )
    for each in required(wheel).values():
        for top in {file.parts[0] for file in each.files or ()} - {"..", "__pycache__"}:
            if not (site / top).exists():
                (site / top).symlink_to(each.locate_file(top))
    pip = (sys.executable, "-m", "pip", "--python", scripts / "python", "--disable-pip-version-check")
    run(*pip, "install", "--quiet", "--no-index", "--no-compile", wheel, cwd=here)
    flight = ("run", "figure-eight", "-e", "gnss-only", "--json")
    out = run(scripts / "bench", *flight, cwd=here, BENCH_CACHE=str(tmp_path / "cache"))
    assert json.loads(out)["gnss-only"]["converged"] is True
    (folder,) = (here / "runs").iterdir()
    assert json.loads((folder / "result.json").read_text())["provenance"]["commit"] is None
    assert (folder / "flight.rrd").stat().st_size > 1e6
