"""A drawn sample of the points of `tests.faults`, and that no other module writes what stays."""

from __future__ import annotations

import errno
import os
import re
import shutil
import stat
import subprocess
import sys
from pathlib import Path

import pytest

import bench
from bench.core.files import durable
from bench.core.files.scratch import LOCK

PACKAGE = Path(bench.__file__).parent

if sys.platform == "win32":
    pytest.skip("Windows has no fork", allow_module_level=True)


def test_what_is_struck_is_whole_afterwards():
    from tests import faults

    wrong = faults.strike(16, seed=3, say=lambda text: None)
    assert not wrong, "\n".join(wrong)


def test_a_store_that_writes_in_place_is_caught(tmp_path):
    """A work that opens its file under its own name: killed while it writes, old and new are lost."""
    from tests import faults

    def write(folder, version):
        path = folder / "in-place.txt"
        with path.open("w", encoding="utf-8") as file:
            file.write(f"version {version} begins\n")
            file.flush()
            durable.before("write", path)
            file.write(f"version {version} ends\n")

    work = faults.replaced("in-place", write, tmp_path)
    before = tmp_path / "before"
    before.mkdir()
    write(before, 1)
    points = faults.list_points(work, tmp_path / "known-in-place-1")
    assert points == ["write in-place.txt"]
    state, fault = faults.check_point(work, before, tmp_path / "struck", 0, "killed")
    assert state == "damaged"
    assert "neither old nor new" in fault


@pytest.mark.parametrize("way", ["write", "sync", "rename"])
def test_a_file_that_cannot_be_written_leaves_the_old_one(tmp_path, monkeypatch, way):
    path = tmp_path / "file.txt"
    durable.write(path, "old")

    def fail(action, path):
        if action == way:
            raise OSError(errno.ENOSPC, "full", str(path))

    monkeypatch.setattr(durable, "before", fail)
    with pytest.raises(OSError, match="full"):
        durable.write(path, "new")
    assert path.read_text() == "old"
    assert os.listdir(tmp_path) == ["file.txt"]


def test_the_content_is_on_the_disk_before_the_name_and_the_name_at_the_end(tmp_path, monkeypatch):
    path, waited = tmp_path / "file.txt", list[tuple[bool, bool]]()

    def wait(descriptor):
        waited.append((stat.S_ISDIR(os.fstat(descriptor).st_mode), path.exists()))

    monkeypatch.setattr(os, "fsync", wait)
    durable.write(path, "new")
    assert waited == [(False, False), (True, True)]


WRITES = re.compile(
    r"""write_text\(|write_bytes\(|\.open\(\s*["'][wax]|(?<![.\w])open\([^)]*["'][wax]|os\.(replace|rename)\("""
    r"""|\.rename\(|np\.savez?\(\s*(path|folder)|savetxt\(\s*(path|folder)|write_table\([^)]*\b(path|part)\b,\s*comp"""
    r"""|savefig\(\s*(path|folder)|savemat\(\s*(path|folder)|pwrite\("""
)
ELSEWHERE = {
    "bench/core/files/durable.py": "the module itself",
    "bench/core/files/scratch.py": "temporary folders, which end with their process",
    "bench/core/compilation/compiled.py": "compiled code, with sums of its own",
    "bench/simulation/flight/child_process.py": "messages to and from the process of a flight, in scratch",
    "bench/simulation/flight/model_files.py": "models for one flight, in scratch",
    "bench/io/foreign/record_messages.py": "records for the process of a filter, in scratch",
    "bench/io/foreign/outside.py": "messages to and from programs, in scratch",
    "bench/io/foreign/filter_process.py": "messages of the process of a filter, in scratch",
    "bench/experiments/campaigns/cluster.py": "a module packed for workers, in a temporary folder",
}


def test_only_one_module_writes_what_stays():
    found = {
        path.relative_to(PACKAGE.parent).as_posix()
        for path in PACKAGE.rglob("*.py")
        if WRITES.search(path.read_text(encoding="utf-8").replace("durable.", "by "))
    }
    assert found <= ELSEWHERE.keys(), sorted(found - ELSEWHERE.keys())


AUDITED = """
import os, sys
kept, outside = sys.argv[1], []
allowed = "/core/files/durable.py", "/core/files/scratch.py", "/experiments/campaigns/journal.py"

def hook(event, arguments):
    if event == "open":
        path, mode, flags = arguments
        writes = set(mode or "") & set("wax+") or (flags or 0) & (os.O_WRONLY | os.O_RDWR)
        name = os.fspath(path) if not isinstance(path, int) else ""
        if writes and name and os.path.abspath(name).startswith(kept):
            frame, files = sys._getframe(1), []
            while frame is not None:
                files.append(frame.f_code.co_filename)
                frame = frame.f_back
            own = [file for file in files if "/bench/" in file and "/tests/" not in file]
            if own and not own[0].endswith(allowed):
                outside.append(f"{name}: {own[0]}")

sys.addaudithook(hook)
from bench.cli.command_line import main
os.chdir(kept)
for words in (
    ["run", "short.toml", "-o", "run"],
    ["campaign", "short.toml", "--runs", "2", "--jobs", "1", "-o", "campaign"],
    ["export", "run", "--to", "csv", "-o", "csv"],
    ["report", "run", "--figures", "svg", "-o", "figures"],
):
    try:
        end = main(words)
    except SystemExit as error:
        end = error.code
    assert not end, (words, end)
print("OUTSIDE", *outside, sep="\\n")
"""


@pytest.mark.skipif(shutil.which("strace") is None, reason="no strace here")
def test_no_library_writes_past_that_module(tmp_path):
    """The system tells of every file that is opened for writing: all have the name of one being written."""
    from tests.faults import PROFILE

    (tmp_path / "short.toml").write_text(PROFILE, encoding="utf-8")
    traced = tmp_path / "traced"
    words = ["run", str(tmp_path / "short.toml"), "-o", str(tmp_path / "run")]
    strace = ["strace", "-f", "-qq", "-e", "trace=openat,open,creat", "-o", str(traced)]
    command = [*strace, sys.executable, "-m", "bench", *words]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if "ptrace" in done.stderr and done.returncode:
        pytest.skip("tracing is not allowed here")
    assert done.returncode == 0, done.stderr[-2000:]
    written = re.findall(r'"([^"]*)", O_(?:WRONLY|RDWR)', traced.read_text(encoding="utf-8"))
    inside = [Path(name) for name in written if name.startswith(str(tmp_path))]
    assert len(inside) > 10
    assert [path for path in inside if not durable.is_part(path.name) and path.name != LOCK] == []


def test_commands_write_by_that_module_alone(tmp_path):
    """Python tells of every file that is opened; locks and the journal's own file are opened elsewhere."""
    from tests.faults import PROFILE

    (tmp_path / "short.toml").write_text(PROFILE, encoding="utf-8")
    done = subprocess.run(
        [sys.executable, "-c", AUDITED, str(tmp_path)], capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr[-2000:]
    assert done.stdout.partition("OUTSIDE")[2].strip() == "", done.stdout
    assert (tmp_path / "run" / "result.json").exists()
