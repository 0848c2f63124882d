"""What a killed process leaves is removed by the next one; what belongs to a living one stays."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from bench.core.files import scratch

HOLD = """
import sys, time
from pathlib import Path
from bench.core.files.scratch import make_scratch, set_aside
place = Path(sys.argv[1])
with make_scratch(place) as folder:
    (folder / "new").mkdir()
    (folder / "new" / "half").touch()
    if len(sys.argv) > 2:
        set_aside(folder, place / sys.argv[2])
    print("up", flush=True)
    time.sleep(60)
"""


def start(place: Path, *aside: str) -> subprocess.Popen[str]:
    """Start a process that holds a temporary folder in a place, with another folder set aside."""
    command = [sys.executable, "-c", HOLD, str(place), *aside]
    env = {**os.environ, "PYTHONPATH": str(Path(scratch.__file__).parents[1])}
    process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True, env=env)
    assert process.stdout is not None
    assert process.stdout.readline() == "up\n"
    return process


def end(process: subprocess.Popen[str], number: signal.Signals) -> None:
    process.send_signal(number)
    process.communicate(timeout=30)


def test_only_folders_of_killed_processes_of_this_machine_are_removed(tmp_path, monkeypatch):
    alive, killed = start(tmp_path), start(tmp_path)
    with monkeypatch.context() as elsewhere:
        elsewhere.setattr("platform.node", lambda: "another")
        other = tmp_path / f"{scratch.PREFIX}{scratch.identify_machine()}-0"
    other.mkdir()
    (tmp_path / f"{scratch.PREFIX}mine").mkdir()
    before = set(tmp_path.iterdir())
    assert len(before) == 4  # starting the second process has not removed the folder of the first
    end(killed, signal.SIGKILL)
    assert set(tmp_path.iterdir()) == before
    with scratch.make_scratch(tmp_path) as own:
        left = before - set(tmp_path.iterdir())
        assert len(left) == 1
        assert own not in before
    end(alive, signal.SIGINT)
    assert set(tmp_path.iterdir()) == {other, tmp_path / f"{scratch.PREFIX}mine"}


@pytest.mark.parametrize("taken", [False, True])
def test_what_was_set_aside_comes_back(tmp_path, taken):
    """Killed between the two renames of a replacement, a run loses nothing."""
    (tmp_path / "one").mkdir()
    (tmp_path / "one" / "old").touch()
    killed = start(tmp_path, "one")
    end(killed, signal.SIGKILL)
    if taken:
        (tmp_path / "one").mkdir()
    scratch.remove_abandoned(tmp_path)
    assert list(tmp_path.iterdir()) == [tmp_path / "one"]
    assert list((tmp_path / "one").iterdir()) == ([] if taken else [tmp_path / "one" / "old"])


def test_an_exception_leaves_nothing(tmp_path):
    (tmp_path / "one").mkdir()

    def interrupt() -> None:
        with scratch.make_scratch(tmp_path) as folder:
            scratch.set_aside(folder, tmp_path / "one")
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        interrupt()
    assert list(tmp_path.iterdir()) == [tmp_path / "one"]


def test_a_file_system_without_locks_is_no_reason_to_stop(tmp_path, monkeypatch):
    monkeypatch.setattr(scratch, "lock_folder", lambda folder: None)
    with scratch.make_scratch(tmp_path) as folder, scratch.make_scratch(tmp_path):
        assert folder.is_dir()
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("name", [b"../taken", b"a/b", b"\xff", b"", b"..", None])
def test_a_name_that_leads_elsewhere_is_not_followed_and_loses_nothing(tmp_path, name):
    """What was set aside stays where it is; the next command works."""
    place = tmp_path / "place"
    left = place / f"{scratch.PREFIX}{scratch.identify_machine()}-0"
    (left / "old").mkdir(parents=True)
    (left / "old" / "result").write_text("precious")
    if name is not None:
        (left / "name").write_bytes(name)
    for _ in range(2):
        with scratch.make_scratch(place):
            pass
    assert (left / "old" / "result").read_text() == "precious"
    assert sorted(one.name for one in tmp_path.iterdir()) == ["place"]


def test_folders_of_other_users_and_links_are_left_alone(tmp_path, monkeypatch):
    """In a shared place anybody may make them; a link as the lock would make a file elsewhere."""
    left, elsewhere = tmp_path / f"{scratch.PREFIX}{scratch.identify_machine()}-0", tmp_path / "elsewhere"
    (left / "old").mkdir(parents=True)
    (left / "name").write_text("home")
    (left / scratch.LOCK).symlink_to(elsewhere)
    scratch.remove_abandoned(tmp_path)
    assert not elsewhere.exists()
    assert left.exists()
    (left / scratch.LOCK).unlink()
    link = left.with_name(left.name[:-1] + "1")
    link.symlink_to(left)
    with monkeypatch.context() as other:
        other.setattr(os, "geteuid", lambda: os.getuid() + 1)
        scratch.remove_abandoned(tmp_path)
    assert (left / "old").exists()
    link.unlink()
    scratch.remove_abandoned(tmp_path)  # this one is our own
    assert (tmp_path / "home").is_dir()
    assert not left.exists()
