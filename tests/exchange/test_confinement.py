"""A confined filter opens its own files and no others; honest filters run as without."""

from __future__ import annotations

import ctypes
import os
import platform
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from bench import pipeline
from bench.core.records.specs import EstimatorChoice, Guard
from bench.core.words.exceptions import EstimatorFailedError
from bench.io.config import read_profile
from bench.io.foreign import confinement
from bench.navigation.built_in import load
from bench.simulation import sensors
from tests.builders import assert_same_solution
from tests.synthetic import turning

OWN = """
import ctypes, os, socket, subprocess, sys, tempfile
from pathlib import Path
import numpy as np
import helper
from bench.navigation.built_in import load

TABLE = Path(__file__).with_name("table.npy")

class Reads:
    def __init__(self, *, path=""):
        self.path = path
    def run(self, data, initial):
        import late_helper
        if self.path:
            Path(self.path).read_bytes()
        return late_helper.scale(load("loose-15", {}).run(data, initial), helper.ONE * np.load(TABLE)[0])

class Lists(Reads):
    def run(self, data, initial):
        os.listdir(self.path)

class Writes(Reads):
    def run(self, data, initial):
        Path(self.path).write_text("seen")

class Keeps(Reads):
    def run(self, data, initial):
        assert os.listdir(".") == [".kernels"], os.listdir(".")
        Path(tempfile.gettempdir(), "seen").write_text("seen")
        assert subprocess.run(["/bin/sh", "-c", "cat seen; echo"], capture_output=True).stdout == b"seen\\n"
        np.random.default_rng().normal()
        os.remove("seen")
        return super().run(data, initial)

class Calls(Reads):
    def run(self, data, initial):
        libc = ctypes.CDLL(None, use_errno=True)
        tries = {
            "shmget": lambda: libc.shmget(0x5A5A, 64, 0o1600),
            "semget": lambda: libc.semget(0x5A5A, 1, 0o1600),
            "msgget": lambda: libc.msgget(0x5A5A, 0o1600),
            "mq_open": lambda: libc.mq_open(b"/bench-test", 0o102, 0o600, None),
            "keys": lambda: libc.syscall(KEYS, b"user", b"bench-test", b"1", 1, -4),
            "xattr": lambda: os.setxattr(__file__, "user.seen", b"1") or 0,
            "utime": lambda: os.utime(__file__, (1, 1)) or 0,
            "chmod": lambda: os.chmod(__file__, 0o640) or 0,
            "group": lambda: os.setpgid(0, 0) or 0,
            "session": lambda: libc.setsid(),
            "udp": lambda: socket.socket(socket.AF_INET, socket.SOCK_DGRAM).fileno(),
        }
        def has_failed(call):
            ctypes.set_errno(0)
            try:
                return call() < 0 and ctypes.get_errno() == 1
            except PermissionError:
                return True
        done = [name for name in tries if not has_failed(tries[name])]
        raise RuntimeError(f"has done {done}")
"""


def confinement_version() -> int:
    return ctypes.CDLL(None).syscall(444, None, 0, 1)


@pytest.fixture
def place(tmp_path, monkeypatch) -> Path:
    """A folder to stand in, with a filter, its helpers and its table, and results of others."""
    (tmp_path / "mine.py").write_text(OWN)
    (tmp_path / "helper.py").write_text("ONE = 1.0\n")
    (tmp_path / "late_helper.py").write_text(
        "def scale(found, one):\n    return found if one == 1.0 else None\n"
    )
    np.save(tmp_path / "table.npy", np.ones(1))
    for name in ("runs", "cards"):
        (tmp_path / name).mkdir()
        (tmp_path / name / "kept.txt").write_text("the truth")
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(str(tmp_path))
    return tmp_path


@pytest.fixture(scope="module")
def sensed():
    return sensors.sense(turning(20.0, 100.0), read_profile("figure-eight").sensors, 4, 0)


@contextmanager
def confined(name: str, **options) -> Iterator[Any]:
    guard = Guard(timeout=120.0, confined=True)
    one = pipeline.build_estimator(EstimatorChoice(f"mine:{name}", name, options, guard=guard))
    try:
        yield one
    finally:
        one.close()


@pytest.mark.parametrize("name", ["Reads", "Keeps"])
def test_an_ordinary_filter_runs_as_without(place, sensed, name):
    """With kernels, a module that it imports late, a table beside it, a program, and temporary files."""
    with confined(name) as one:
        assert one.confined == (confinement_version() > 0)
        found = one.run(sensed.data, sensed.initial)
    home = Path(tempfile.gettempdir())
    assert not (home / "seen").exists()
    assert_same_solution(found, load("loose-15", {}).run(sensed.data, sensed.initial))


@pytest.mark.parametrize(
    ("name", "path"),
    [
        ("Reads", "{place}/runs/kept.txt"),
        ("Reads", "{place}/cards/kept.txt"),
        ("Reads", "{place}/other.toml"),
        ("Reads", "{cache}/truth/kept.npy"),
        ("Reads", "/proc/{parent}/maps"),
        ("Reads", "/proc/{parent}/cmdline"),
        ("Reads", "/proc/self/environ"),
        ("Lists", "{place}"),
        ("Lists", "{place}/cards"),
        ("Lists", "/tmp"),
        ("Writes", "{place}/seen.txt"),
        ("Writes", "{place}/mine.py"),
    ],
)
def test_what_is_not_its_own_stays_closed(place, sensed, monkeypatch, name, path):
    if not confinement_version():
        pytest.skip("this system has no Landlock")
    monkeypatch.setenv("BENCH_CACHE", str(place / "cache"))
    (place / "cache" / "truth").mkdir(parents=True)
    (place / "cache" / "truth" / "kept.npy").write_text("the truth")
    (place / "other.toml").write_text("seed = 5")
    path = path.format(place=place, cache=place / "cache", parent=os.getpid())
    with confined(name, path=path) as one, pytest.raises(EstimatorFailedError) as caught:
        one.run(sensed.data, sensed.initial)
    assert f"PermissionError: [Errno 13] Permission denied: '{path}'" in str(caught.value)
    assert "on a card a filter may open only its own files" in str(caught.value)
    with suppress(FileNotFoundError):
        assert (place / "mine.py").read_text() == OWN
        assert not (place / "seen.txt").exists()


def test_nothing_outlives_the_process_without_a_file(place, sensed):
    """System V and POSIX queues, keys, times and attributes of its own file, a group or session, a socket."""
    if not confinement_version():
        pytest.skip("this system has no Landlock")
    keys = {"x86_64": 248, "aarch64": 217}[platform.machine()]
    (place / "mine.py").write_text(f"{OWN}\nKEYS = {keys}\n")
    with confined("Calls") as one, pytest.raises(EstimatorFailedError, match=r"has done \[\]"):
        one.run(sensed.data, sensed.initial)


def test_another_machine_is_not_confined(monkeypatch):
    monkeypatch.setattr(confinement.platform, "machine", lambda: "riscv64")
    assert not confinement._refuse_calls(ctypes.CDLL(None))


def test_without_it_the_same_filter_reads_them(place, sensed):
    choice = EstimatorChoice(
        "mine:Reads", "free", {"path": f"{place}/runs/kept.txt"}, guard=Guard(timeout=120.0)
    )
    one = pipeline.build_estimator(choice)
    assert not one.confined
    one.run(sensed.data, sensed.initial)
    one.close()


def test_a_system_without_it_is_told(place, monkeypatch):
    monkeypatch.setattr(confinement.sys, "platform", "darwin")
    assert not confinement.confine("mine", place)
