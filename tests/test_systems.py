"""Guards elsewhere than on Linux: this Python without what Windows lacks, after its packages are imported."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import psutil

from bench.core.files.spawned import end_tree
from tests.test_installed import SET

ROOT = Path(__file__).parents[1]
WINDOWS = """
import mmap, multiprocessing, os, select, signal, subprocess, sys, types
import click, concurrent.futures.process, filterpy, jinja2, jsbsim, matplotlib, numba, numpy, platform, psutil
import pyarrow.parquet, pydantic, pygeomag, rich.console, scipy, shutil, socket, tempfile, uuid
psutil.signal = types.SimpleNamespace(**vars(signal))  # it ends processes by SIGKILL here
sys.modules |= dict.fromkeys(["fcntl", "resource", "termios", "pwd", "grp"])
lacking = {
    os: "fork geteuid getpgrp getuid killpg posix_fallocate pread pwrite sched_getaffinity setsid O_NOFOLLOW",
    signal: "SIGHUP SIGKILL SIGSTOP pthread_kill pthread_sigmask",
    select: "poll",
    mmap: "MADV_DONTNEED",
}
for module, names in lacking.items():
    for name in names.split():
        vars(module).pop(name, None)
sys.platform = "win32"
from bench.cli.command_line import main
sys.exit(main(sys.argv[1:]))
"""
MINE = """
from bench.navigation.built_in import load


class Mine:
    def run(self, sensors, initial):
        return load("gnss-only", {}).run(sensors, initial)
"""


def is_over(pid):
    """Return whether a process has ended; who inherits it may not have read its status yet."""
    try:
        return psutil.Process(pid).status() == psutil.STATUS_ZOMBIE
    except psutil.NoSuchProcess:
        return True


def test_on_windows_a_class_flies_unguarded_with_one_warning_and_a_program_keeps_its_limit(tmp_path):
    (tmp_path / "mine.py").write_text(MINE)
    slow = tmp_path / "slow.sh"
    slow.write_text("#!/bin/sh\nsleep 321 & echo $! > " + f"{tmp_path}/pid\nsleep 321\n")
    slow.chmod(0o755)
    filters = ["-e", "mine:Mine", "-e", "gnss-only", "-e", "command:./slow.sh {sensors} {solution}"]
    command = [
        sys.executable,
        "-c",
        WINDOWS,
        "run",
        "figure-eight",
        *filters,
        "--timeout",
        "4",
        "--json",
        *SET,
    ]
    path = os.pathsep.join([str(ROOT), str(tmp_path)])
    env = os.environ | {"PYTHONPATH": path, "TMPDIR": str(tmp_path)}  # others remove folders without locks
    done = subprocess.run(command, cwd=tmp_path, env=env, capture_output=True, text=True)
    assert "Traceback" not in done.stderr, done.stderr
    found = json.loads(done.stdout)
    assert found["Mine"]["pos_rmse_h_m"] == found["gnss-only"]["pos_rmse_h_m"]
    assert found["slow"]["reason"].startswith("failed: stopped after 4 s (--timeout)")
    assert done.stderr.count("bench: on Windows your class runs in the process of bench") == 1
    assert is_over(int((tmp_path / "pid").read_text()))


def test_here_a_class_has_its_process_and_nothing_is_printed(tmp_path):
    (tmp_path / "mine.py").write_text(MINE.replace("return", "import os; print(os.getpid()); return"))
    command = [sys.executable, "-m", "bench", "run", "figure-eight", "-e", "mine:Mine", *SET, "-o", "out"]
    env = os.environ | {"PYTHONPATH": os.pathsep.join([str(ROOT), str(tmp_path)])}
    with subprocess.Popen(
        command, cwd=tmp_path, env=env, stderr=subprocess.PIPE, stdout=-3, text=True
    ) as child:
        assert "on Windows" not in child.communicate()[1]
    assert int((tmp_path / "out/printed-Mine.txt").read_text()) != child.pid


def test_a_tree_of_processes_is_ended():
    code = (
        "import subprocess, sys; print(subprocess.Popen(['sleep', '321']).pid, flush=True); sys.stdin.read()"
    )
    pipe = subprocess.PIPE
    with subprocess.Popen([sys.executable, "-c", code], stdin=pipe, stdout=pipe) as child:
        assert child.stdout is not None
        below = int(child.stdout.readline())
        end_tree(child)
        assert child.returncode is not None
    assert is_over(below)
