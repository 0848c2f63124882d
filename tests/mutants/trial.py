"""A copy of the tree in which tests are run, with caches of its own; the tree itself is only read."""

from __future__ import annotations

import os
import shutil
import signal
import subprocess
import sys
import tomllib
from collections.abc import Mapping
from pathlib import Path

from tests.mutants import plugin

_FOREIGN = ("PYTHONPATH", "NUMBA_CACHE_DIR", "COVERAGE_", "MUTANTS_", "PYTEST_ADDOPTS", "PYTEST_XDIST_WORKER")
"""What the names of variables begin with that are not passed on."""


class Trial:
    """A copy of a tree in a temporary folder: its sources may be changed, its tests run."""

    def __init__(self, root: Path, scratch: Path) -> None:
        self.root, self.scratch, self._changes = scratch / "tree", scratch, 0
        settings = tomllib.loads((root / "pyproject.toml").read_text(encoding="utf-8"))
        held = settings["tool"]["hatch"]["build"]["targets"]["sdist"]["include"]
        for name in ["pyproject.toml", *(pattern.lstrip("/") for pattern in held)]:
            (self.root / name).parent.mkdir(parents=True, exist_ok=True)
            if (root / name).is_dir():
                shutil.copytree(root / name, self.root / name, ignore=shutil.ignore_patterns("__pycache__"))
            else:
                shutil.copy2(root / name, self.root / name)
        (scratch / "plugin").mkdir()
        shutil.copy(plugin.__file__, scratch / "plugin" / "mutants_plugin.py")

    def run_tests(
        self, *arguments: str, variables: Mapping[str, Path], limit: float | None = None
    ) -> tuple[int | None, str]:
        """Run pytest; return its exit status, None if it took longer than the limit [s], and its output."""
        environment = {name: value for name, value in os.environ.items() if not name.startswith(_FOREIGN)}
        environment |= {name: str(path) for name, path in variables.items()}
        environment["BENCH_CACHE"] = str(self.scratch / "cache")
        environment["PYTHONPATH"] = os.pathsep.join([str(self.root), str(self.scratch / "plugin")])
        command = [sys.executable, "-m", "pytest", "-p", "mutants_plugin", "-p", "no:cacheprovider", "-q"]
        command += ["--hypothesis-seed=0", f"--basetemp={self.scratch / 'temporary'}", *arguments]
        with (self.scratch / "output").open("w+", encoding="utf-8", errors="replace") as output:
            process = subprocess.Popen(
                command, cwd=self.root, env=environment, stdout=output, stderr=output, process_group=0
            )
            try:
                status: int | None = process.wait(limit)
            except subprocess.TimeoutExpired:
                status = None
            finally:
                if process.poll() is None:
                    os.killpg(process.pid, signal.SIGKILL)  # with the processes that tests have started
                    process.wait()
            output.seek(0)
            return status, output.read()

    def write(self, file: str, source: bytes) -> None:
        """Write a source so that no compiled file of an earlier one is taken for it.

        Python knows them by length and second of the last change, so each change gets a second of its own.
        """
        path = self.root / file
        self._changes += 1
        second = path.stat().st_mtime + self._changes
        path.write_bytes(source)
        os.utime(path, (second, second))
