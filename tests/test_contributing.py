"""What the next contributor reads and runs: its commands exist, its forms are forms, its versions agree."""

from __future__ import annotations

import re
import shutil
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest
import yaml

from bench.cli.verbs import guide
from tests.workbench.test_guide import blocks, command_lines, parsed

ROOT = Path(__file__).parents[1]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
PAGE = ROOT / "CONTRIBUTING.md"
TEXT = PAGE.read_text(encoding="utf-8")
SCHEMAS = {
    ".github/workflows/test.yml": "github-workflows",
    ".github/workflows/weekly.yml": "github-workflows",
    ".github/workflows/release.yml": "github-workflows",
    ".github/dependabot.yml": "dependabot",
    ".github/ISSUE_TEMPLATE/config.yml": "github-issue-config",
    ".github/ISSUE_TEMPLATE/wrong-number.yml": "github-issue-forms",
    ".github/ISSUE_TEMPLATE/unread-file.yml": "github-issue-forms",
    ".github/ISSUE_TEMPLATE/wish.yml": "github-issue-forms",
    "CITATION.cff": "citation-file-format",
}
"""Files that others read -> the schema of each, as it comes with check-jsonschema."""

INSTALLED = {"pre-commit"}
"""Programs that a command of the page has installed."""


def read(name: str) -> dict:
    return yaml.safe_load((ROOT / name).read_text(encoding="utf-8"))


def make_targets() -> set[str]:
    return set(re.findall(r"^([\w./-]+):", (ROOT / "Makefile").read_text(encoding="utf-8"), re.MULTILINE))


def check_program(path: str) -> None:
    """It is in the environment that ``make .venv/ready`` sets up: the one that runs this."""
    name = path.removeprefix(".venv/bin/")
    assert name != path
    assert name in INSTALLED or shutil.which(name, path=str(Path(sys.executable).parent)), path


@pytest.mark.parametrize(("file", "schema"), SCHEMAS.items())
def test_a_file_that_others_read_follows_its_schema(file, schema):
    command = [
        "check_jsonschema",
        "--default-filetype=yaml",
        f"--builtin-schema=vendor.{schema}",
        ROOT / file,
    ]
    done = subprocess.run([sys.executable, "-m", *command], capture_output=True, text=True)
    assert done.returncode == 0, done.stdout


def test_every_file_of_the_forge_has_a_schema():
    found = {path.relative_to(ROOT).as_posix() for path in (ROOT / ".github").rglob("*") if path.is_file()}
    assert found == {file for file in SCHEMAS if file.startswith(".github/")}


def test_every_command_of_the_page_exists():
    commands = [words for block in blocks(PAGE) if block.kind == "sh" for words, _ in command_lines(block)]
    assert len(commands) >= 8
    for program, *rest in commands:
        if program == "make":
            assert rest[0] in make_targets(), rest
            continue
        check_program(program)
        if program.endswith("/bench"):
            parsed(rest)
        elif program.endswith("/pytest"):
            assert all((ROOT / path).exists() for path in rest), rest


def test_what_sentences_of_the_page_name_exists():
    for target in re.findall(r"`make ([\w./-]+)", TEXT):
        assert target in make_targets(), target
    topics = re.findall(r"`bench guide ([\w-]+)`", TEXT)
    assert {"extending", "conventions", "regression"} <= set(topics) <= set(guide.read_topics())
    paths = re.findall(r"`((?:bench|tests|aircraft)/[\w./-]+|[A-Z]+(?:\.md)?)`", TEXT)
    assert len(paths) >= 6
    assert [path for path in paths if not (ROOT / path).exists()] == []
    assert "\n## The tree\n" in TEXT


def test_a_commit_runs_what_make_lint_runs():
    (repository,) = read(".pre-commit-config.yaml")["repos"]
    hooks = [hook["entry"].split() for hook in repository["hooks"]]
    recipe = re.search(r"^lint:.*\n((?:\t.*\n)+)", (ROOT / "Makefile").read_text(), re.MULTILINE)
    assert recipe is not None
    checks = [line.split() for line in recipe[1].replace("$(BIN)", ".venv/bin").splitlines()]
    plain = [
        [word for word in words if word != "." and not word.startswith("--")] for words in (*hooks, *checks)
    ]
    assert plain[: len(hooks)] == plain[len(hooks) :]
    for words in hooks:
        check_program(words[0])


def test_the_citation_is_of_this_version():
    citation = read("CITATION.cff")
    assert citation["version"] == PROJECT["version"]
    assert citation["license"] == PROJECT["license"] == "Apache-2.0"
    assert citation["keywords"] == PROJECT["keywords"]


def test_the_core_is_locked_to_the_versions_that_are_tested():
    """Each requirement of ``make run`` is one of ``make test``, hashes included, and nothing is missing."""
    whole, core = (
        set(re.split(r"\n(?=\S)", (ROOT / name).read_text(encoding="utf-8").strip()))
        for name in ("requirements.lock", "requirements-core.lock")
    )
    assert core < whole
    named = {re.match(r"[\w.-]+", row)[0] for row in core}
    assert {re.match(r"[\w-]+", row)[0] for row in PROJECT["dependencies"]} <= named
    assert not named & {"pytest", "mypy", "ruff", "gtsam", "zensical"}
