"""The requirement that a workflow installs is what is installed here, where another machine can reach it."""

from __future__ import annotations

import json
import subprocess
from importlib.metadata import PathDistribution
from pathlib import Path

import pytest

from bench.experiments.baselines import pinning
from bench.experiments.baselines.pinning import find_requirement

COMMIT = "0123456789abcdef0123456789abcdef01234567"


@pytest.fixture
def install(tmp_path, monkeypatch):
    """Return a function that makes the metadata of an installation, as pip writes them."""
    folder = tmp_path / "site" / "ins_gnss_bench-1.2.dist-info"
    folder.mkdir(parents=True)
    (folder / "METADATA").write_text("Metadata-Version: 2.1\nName: ins-gnss-bench\nVersion: 1.2\n")

    def noted(url: str | None, **more: object) -> None:
        note = folder / "direct_url.json"
        note.unlink(missing_ok=True)
        if url is not None:
            note.write_text(json.dumps({"url": url, **more}))

    monkeypatch.setattr(pinning, "distribution", lambda name: PathDistribution(folder))
    return noted


@pytest.mark.parametrize(
    ("url", "more", "requirement"),
    [
        (None, {}, "ins-gnss-bench==1.2"),
        (
            "https://git.example/lab/bench.git",
            {"vcs_info": {"vcs": "git", "commit_id": COMMIT, "requested_revision": "main"}},
            f"ins-gnss-bench @ git+https://git.example/lab/bench.git@{COMMIT}",
        ),
        (
            "https://files.example/ins_gnss_bench-1.2-py3-none-any.whl",
            {"archive_info": {"hashes": {"sha256": "ab12"}}},
            "ins-gnss-bench @ https://files.example/ins_gnss_bench-1.2-py3-none-any.whl#sha256=ab12",
        ),
    ],
)
def test_what_others_can_reach_is_pinned_as_it_is(install, url, more, requirement):
    install(url, **more)
    assert find_requirement() == (requirement, "")


@pytest.mark.parametrize(
    ("remote", "pinned"),
    [
        ("https://git.example/lab/bench.git", "git+https://git.example/lab/bench.git@"),
        ("https://me:secret@git.example/lab/bench.git", "git+https://git.example/lab/bench.git@"),
        ("git@git.example:lab/bench.git", "git+ssh://git@git.example/lab/bench.git@"),
    ],
)
def test_a_working_copy_is_pinned_by_its_remote_and_commit(install, tmp_path, remote, pinned):
    copy = tmp_path / "a copy"
    copy.mkdir()
    for command in (
        ["init", "-q"],
        ["-c", "user.name=x", "-c", "user.email=x@x", "commit", "-q", "--allow-empty", "-m", "x"],
        ["remote", "add", "origin", remote],
    ):
        subprocess.run(["git", "-c", "init.defaultBranch=main", *command], cwd=copy, check=True)
    head = subprocess.run(["git", "rev-parse", "HEAD"], cwd=copy, check=True, capture_output=True, text=True)
    install(copy.as_uri(), dir_info={"editable": True})
    assert find_requirement() == (f"ins-gnss-bench @ {pinned}{head.stdout.strip()}", "")


def test_a_wheel_is_pinned_if_it_lies_in_the_repository(install, tmp_path):
    wheel = tmp_path / "repository" / "wheels" / "ins_gnss_bench-1.2-py3-none-any.whl"
    wheel.parent.mkdir(parents=True)
    wheel.touch()
    install(wheel.as_uri(), archive_info={})
    assert find_requirement(tmp_path / "repository")[0] == f"./wheels/{wheel.name}"
    requirement, remark = find_requirement(tmp_path / "site")
    assert requirement == "ins-gnss-bench==1.2"
    assert wheel.name in remark


def test_a_folder_without_a_remote_is_told(install, tmp_path):
    install(tmp_path.as_uri(), dir_info={"editable": True})
    requirement, remark = find_requirement(Path())
    assert requirement == "ins-gnss-bench==1.2"
    assert "no remote" in remark
