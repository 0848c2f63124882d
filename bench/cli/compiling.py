"""A second process that compiles the kernels of a first run, while this process flies and runs filters."""

from __future__ import annotations

import contextlib
import os
import pickle
import subprocess
import sys
import threading
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path

from bench.core.compilation.compiled import choose_cache, is_plain
from bench.core.records.specs import Profile
from bench.navigation.built_in import BUILT_IN

_START = "import sys; sys.path[:] = {}; from bench.cli import compiling; compiling.compile_for_parent()"


@contextlib.contextmanager
def compile_beside(profile: Profile) -> Iterator[None]:
    """Meanwhile compile the kernels of a profile in a second process, if the filters are not compiled yet.

    Both processes take kernels that the other does not compile at the moment
    (`bench.core.compilation.kernel_locks`). What the second one does not achieve, this one does. It ends
    with the block, and with this process.
    """
    own = tuple(choice for choice in profile.estimators if choice.use in BUILT_IN)
    done = [choose_cache() / f"{choice.use}.compiled" for choice in own]
    if not own or _count_cores() < 2 or not _is_cold(done):
        yield
        return
    nowhere = subprocess.DEVNULL
    try:
        child = subprocess.Popen(
            [sys.executable, "-c", _START.format(sys.path)],
            stdin=subprocess.PIPE, stdout=nowhere, stderr=nowhere,
        )  # fmt: skip
    except OSError:  # no room for another process
        yield
        return
    assert child.stdin is not None
    with child.stdin as line:
        try:
            with contextlib.suppress(BrokenPipeError):  # it has ended
                line.write(pickle.dumps(replace(profile, estimators=own)))
                line.flush()
            yield
        finally:
            child.kill()
            child.wait()
    for mark in done:
        mark.touch()


def _count_cores() -> int:
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def _is_cold(marks: Sequence[Path]) -> bool:
    """Return whether the cache can be written, has locks, and holds neither a mark nor the usual filter."""
    if sys.platform == "win32" or is_plain() or any(mark.exists() for mark in marks):
        return False
    folder = choose_cache()
    with contextlib.suppress(OSError):
        folder.mkdir(parents=True, exist_ok=True)
    return os.access(folder, os.W_OK) and not any(folder.rglob("*.fusion_kernel-*.nbi"))


def compile_for_parent() -> None:
    """Compile for the profile on stdin, in the process that :func:`compile_beside` starts."""
    profile = pickle.load(sys.stdin.buffer)
    threading.Thread(target=_follow_parent, daemon=True).start()
    from bench.cli.verbs.warm_verb import run_shortly

    run_shortly(profile, profile.estimators)
    os._exit(0)


def _follow_parent() -> None:
    """End this process with its parent, which then closes stdin."""
    os.read(0, 1)
    os._exit(1)
