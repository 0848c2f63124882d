"""What a forge runs and what a release contains: pins, versions, targets, licenses of embedded files."""

from __future__ import annotations

import re
import subprocess
import tomllib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import yaml

from tests.test_contributing import PROJECT, ROOT, make_targets

WORKFLOWS = {path.stem: path for path in (ROOT / ".github/workflows").iterdir()}
SYSTEMS = {"ubuntu-latest", "macos-latest", "windows-latest"}
VERSIONS = [
    one.rpartition(" ")[2] for one in PROJECT["classifiers"] if re.fullmatch(r".*Python :: 3\.\d+", one)
]
NEWEST = "3.14"  # Python of the workflows
OWN = {".py", ".md", ".toml", ".xml", ".typed"}
"""Endings of files that are written for bench."""


def read_jobs(name: str) -> dict[str, Any]:
    jobs: dict[str, Any] = yaml.safe_load(WORKFLOWS[name].read_text(encoding="utf-8"))["jobs"]
    return jobs


def list_steps() -> Iterator[tuple[str, dict[str, Any]]]:
    for name in WORKFLOWS:
        for job, content in read_jobs(name).items():
            yield from ((f"{name}.{job}", step) for step in content["steps"])


def find_unpinned(text: str) -> list[str]:
    """Return the actions of a workflow that are not a whole commit with its version beside it."""
    used = re.findall(r"uses: *(.*)", text)
    return [one for one in used if not re.fullmatch(r"[\w./-]+@[0-9a-f]{40} # v\d+\.\d+\.\d+", one)]


@pytest.mark.parametrize("name", WORKFLOWS)
def test_each_action_is_pinned_and_each_version_is_one_commit(name):
    text = "".join(path.read_text(encoding="utf-8") for path in WORKFLOWS.values())
    assert find_unpinned(WORKFLOWS[name].read_text(encoding="utf-8")) == []
    pins = set(re.findall(r"uses: ([\w./-]+)@(\w+)", text))
    assert len(pins) == len({action for action, _ in pins}) >= 6


def test_a_tag_and_a_short_commit_are_no_pins():
    whole = "0123456789" * 4
    text = f"uses: a/b@v4\nuses: a/b@{whole[:12]} # v4.0.0\nuses: a/b@{whole}\nuses: a/b@{whole} # v4.0.0\n"
    assert find_unpinned(text) == ["a/b@v4", f"a/b@{whole[:12]} # v4.0.0", f"a/b@{whole}"]


def test_ci_runs_on_each_system_with_the_oldest_python_and_the_newest():
    assert PROJECT["requires-python"] == f">={VERSIONS[0]}"
    assert int(VERSIONS[-1][2:]) <= int(NEWEST[2:])  # a classifier follows the first run
    ends, jobs = [VERSIONS[0], NEWEST], read_jobs("test")
    axes = {name: job["strategy"]["matrix"] for name, job in jobs.items()}
    assert axes["test"]["python"] == axes["systems"]["python"] == ends
    assert {jobs["test"]["runs-on"], *axes["systems"]["os"]} == SYSTEMS == set(axes["minima"]["os"])
    for name, job in (("weekly", "newest"), ("release", "try")):
        matrix = read_jobs(name)[job]["strategy"]["matrix"]
        assert (set(matrix["os"]), matrix["python"]) == (SYSTEMS, ends)
    single = {step.get("with", {}).get("python-version") for _, step in list_steps()} - {None}
    assert single == {*ends, "${{ matrix.python }}"}


def test_every_target_that_a_workflow_makes_exists():
    made = {}
    for job, step in list_steps():
        for line in re.findall(r"\bmake ([^#|&\n]*)", str(step.get("run", ""))):
            made.setdefault(job, []).extend(word for word in line.split() if "=" not in word)
    assert {one for words in made.values() for one in words} <= make_targets()
    weekly = {job.partition(".")[2]: words for job, words in made.items() if job.startswith("weekly")}
    assert weekly == {name: [name] for name in ("long", "bounds", "mutants", "newest", "audit")}


def test_only_the_last_job_of_a_release_may_publish_and_it_waits_for_every_trial():
    jobs = read_jobs("release")
    assert set(jobs["publish"]["needs"]) == {*jobs} - {"build", "publish"}
    assert [name for name, job in jobs.items() if "id-token" in job.get("permissions", {})] == ["publish"]
    for name, path in WORKFLOWS.items():
        content = yaml.safe_load(path.read_text(encoding="utf-8"))
        assert content["permissions"] == {"contents": "read"}, name
        assert "secrets." not in path.read_text(encoding="utf-8")


def test_the_tools_of_a_release_are_locked():
    text = (ROOT / "requirements-release.lock").read_text(encoding="utf-8")
    named = {re.match(r"[\w.-]+", row)[0] for row in re.split(r"\n(?=\S)", text)}
    groups = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["dependency-groups"]
    assert {re.match(r"[\w-]+", one)[0] for one in groups["release"]} <= named
    assert all("--hash=sha256:" in row for row in re.split(r"\n(?=\S)", text.strip()))


def read_tables() -> tuple[dict[str, list[str]], set[str]]:
    """Return the folders by others with their rows, and the folders by bench, of ``LICENSES.md``."""
    others, _, own = (ROOT / "LICENSES.md").read_text(encoding="utf-8").partition("## By bench")
    rows = [[cell.strip() for cell in row.split("|")[1:-1]] for row in re.findall(r"^\| `.*", others, re.M)]
    return {row[0].strip("`"): row[1:] for row in rows}, set(re.findall(r"^\| `(.*?)`", own, re.M))


def test_each_embedded_file_has_a_line_with_its_license():
    if not (ROOT / ".git").exists():
        pytest.skip("git says what the tree is")
    listed = subprocess.run(["git", "ls-files"], cwd=ROOT, capture_output=True, text=True, check=True)
    files = [Path(name) for name in listed.stdout.splitlines() if "/" in name and name[0] != "."]
    texts = [path for path in files if path.name.startswith(("LICENSE", "NOTICE"))]
    others, own = read_tables()
    assert {path.parent.as_posix() for path in texts} == set(others)
    data = {path.parent.as_posix() for path in files if path.suffix not in OWN and path not in texts}
    assert data == {*others, *own}
    for folder, (_, terms, shipped) in others.items():
        assert re.search(r"MIT|BSD|Apache|README", terms), folder
        assert (shipped == "yes") == folder.startswith(("bench/", "aircraft/"))
        if shipped == "yes":
            assert f"{folder}/LICENSE" in PROJECT["license-files"]
        pages = [path for path in (ROOT / folder / "README.md", ROOT / "LICENSES.md") if path.exists()]
        words = "".join(path.read_text(encoding="utf-8") for path in pages)
        for text in texts:
            if text.parent.as_posix() == folder and len(pages) > 1:
                stem = text.name.removesuffix(".txt").partition(".")[2]
                assert stem in words, f"{text} is named nowhere"
