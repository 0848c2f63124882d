"""A second process that compiles the kernels of a first run, while this process flies and runs filters."""

from __future__ import annotations

import contextlib
import os
import signal
import sys
import threading
from collections.abc import Iterator, Sequence
from pathlib import Path

from bench.core.compilation.compiled import choose_cache, is_plain
from bench.core.records.specs import EstimatorChoice, Profile
from bench.navigation.built_in import BUILT_IN


@contextlib.contextmanager
def compile_beside(profile: Profile) -> Iterator[None]:
    """Compile the kernels of a profile in a second process during the block, if they are not compiled yet.

    Each process takes kernels that the other one is not compiling (`bench.core.compilation.kernel_locks`).
    The second process ends with the block, or with this process, which compiles what remains.
    """
    own = tuple(choice for choice in profile.estimators if choice.use in BUILT_IN)
    done = [choose_cache() / f"{choice.use}.compiled" for choice in own]
    if not own or not _can_fork() or not _is_cold(done):
        yield
        return
    from bench import pipeline

    for choice in own:
        pipeline.build_estimator(choice)  # its modules, once for both
    read, write = os.pipe()
    child = os.fork()
    if not child:
        os.close(write)
        _compile(profile, own, read)
    os.close(read)
    try:
        yield
    finally:
        os.close(write)
        os.kill(child, signal.SIGKILL)
        os.waitpid(child, 0)
    for mark in done:
        mark.touch()


def _can_fork() -> bool:
    """Return whether this is Linux with two cores or more, and a process with one thread."""
    if sys.platform != "linux" or len(os.sched_getaffinity(0)) < 2:
        return False
    return len(os.listdir("/proc/self/task")) == 1


def _is_cold(marks: Sequence[Path]) -> bool:
    """Return whether the cache can be written, has locks, and holds neither a mark nor the usual filter."""
    if is_plain() or any(mark.exists() for mark in marks):
        return False
    folder = choose_cache()
    with contextlib.suppress(OSError):
        folder.mkdir(parents=True, exist_ok=True)
    return os.access(folder, os.W_OK) and not any(folder.rglob("*.fusion_kernel-*.nbi"))


def _compile(profile: Profile, choices: tuple[EstimatorChoice, ...], parent: int) -> None:
    """Compile, print nothing, and end; ``parent`` is a pipe that its end closes."""
    try:
        nowhere = os.open(os.devnull, os.O_RDWR)
        for stream in range(3):
            os.dup2(nowhere, stream)
        threading.Thread(target=_follow, args=(parent,), daemon=True).start()
        from bench.cli.verbs.warm_verb import run_shortly

        run_shortly(profile, choices)
    finally:
        os._exit(0)


def _follow(parent: int) -> None:
    os.read(parent, 1)
    os._exit(1)
