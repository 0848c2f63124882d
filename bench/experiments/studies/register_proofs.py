"""Run the tests that the rows of the register name, in the repository, and count what they say."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from xml.etree import ElementTree

from bench.core.files.places import PACKAGE
from bench.core.files.scratch import make_scratch
from bench.core.words.exceptions import ConfigError


@dataclass(frozen=True, slots=True)
class Proof:
    """What a test of a row said."""

    cases: int  # parametrized cases that ran
    failed: int  # of them, and those that were skipped
    seconds: float

    @property
    def holds(self) -> bool:
        """Whether it ran and nothing failed."""
        return self.cases > 0 and self.failed == 0


@dataclass(frozen=True, slots=True)
class Asked:
    """Tests of one file, for a worker."""

    root: Path
    file: str
    names: tuple[str, ...]


def find_root() -> Path:
    """Return the repository; ConfigError if bench is installed without its tests."""
    root = PACKAGE.parent
    if not (root / "tests" / "register").is_dir():
        raise ConfigError("study register: --prove runs the tests of the repository, which is not here")
    return root


def group_tests(root: Path, tests: Sequence[str]) -> list[Asked]:
    """Return tests ``path::name`` by their file, so that each file is run once."""
    files = dict.fromkeys(one.partition("::")[0] for one in tests)
    names = {file: [one.partition("::")[2] for one in tests if one.startswith(f"{file}::")] for file in files}
    return [Asked(root, file, tuple(dict.fromkeys(names[file]))) for file in files]


def run_tests(asked: Asked) -> dict[str, Proof]:
    """Run tests of a file with pytest and return what each says, by ``path::name``."""
    with make_scratch() as scratch:
        listed = scratch / "results.xml"
        nodes = [f"{asked.file}::{name}" for name in asked.names]
        options = ["-q", "-p", "no:cacheprovider", "-m", "slow or not slow", f"--junitxml={listed}"]
        command = [sys.executable, "-m", "pytest", *options, *nodes]
        done = subprocess.run(command, cwd=asked.root, capture_output=True, text=True, check=False)
        if done.returncode not in (0, 1):
            said = (done.stdout + done.stderr).strip()[-200:]
            raise ConfigError(f"study register: pytest did not run {asked.file}: {said}")
        cases = list(ElementTree.parse(listed).getroot().iter("testcase"))
    found = {}
    for name in asked.names:
        own = [case for case in cases if case.get("name", "").partition("[")[0] == name]
        failed = sum(any(child.tag in ("failure", "error", "skipped") for child in case) for case in own)
        seconds = sum(float(case.get("time", 0.0)) for case in own)
        found[f"{asked.file}::{name}"] = Proof(len(own), failed, seconds)
    return found
