"""The wheel holds all it needs: in an empty environment, started in an empty folder, it flies."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import zipfile
from pathlib import Path

import pytest

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
    endings = (".py", ".toml", ".md", ".png", ".typed")
    wanted = {path.relative_to(ROOT).as_posix() for path in package if path.suffix in endings}
    wanted |= {
        f"bench/{p.relative_to(ROOT).as_posix()}" for p in (ROOT / "aircraft").rglob("*") if p.is_file()
    }
    assert wanted <= held
    assert any(name.endswith("LICENSE") for name in held)
    assert not {name.split("/")[0] for name in held if ".dist-info" not in name} - {"bench"}


@pytest.mark.slow
def test_installed_into_an_empty_environment_it_flies_in_an_empty_folder(wheel, tmp_path):
    here = tmp_path / "empty"
    here.mkdir()
    run(sys.executable, "-m", "venv", tmp_path / "env", cwd=here)
    scripts = tmp_path / "env" / ("Scripts" if os.name == "nt" else "bin")
    run(scripts / "pip", "install", "--quiet", "--disable-pip-version-check", wheel, cwd=here)
    out = run(
        scripts / "bench", "run", "figure-eight", "--json", cwd=here, BENCH_CACHE=str(tmp_path / "cache")
    )
    assert json.loads(out)["loose-15"]["converged"] is True
    (folder,) = (here / "runs").iterdir()
    assert json.loads((folder / "result.json").read_text())["provenance"]["commit"] is None
    assert (folder / "flight.rrd").stat().st_size > 1e6
