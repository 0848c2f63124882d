"""Confinement of the process of a filter by Landlock: from then on it may open only what a list allows.

It may read Python, system libraries, compiled kernels, the modules on the Python path, and files beside its
own module that it names. It may write into its working folder. System calls that could pass data to another
run without a file fail: shared memory, message queues, keys, attributes of files, sockets, and sessions,
which would outlive the filter. See landlock(7) and seccomp(2) of Linux.
"""

from __future__ import annotations

import ctypes
import os
import pkgutil
import platform
import shutil
import struct
import sys
from collections.abc import Iterator
from importlib.machinery import ModuleSpec
from importlib.util import find_spec
from pathlib import Path
from types import SimpleNamespace
from typing import Any

from bench.core.compilation.compiled import choose_cache

_CREATE_RULESET, _ADD_RULE, _RESTRICT_SELF, _NO_NEW_PRIVS = 444, 445, 446, 38  # system calls, and of prctl
_READ, _WRITE = 0b1101, 0b10  # bits of execute, read file and read folder; of write file
_OF_FILE = 0b1100_0000_0000_0111  # rights that a file has: those, truncate and ioctl
_RIGHTS = {1: 13, 2: 14, 3: 15, 4: 15}  # number of all rights, by version of Landlock; 16 from 5 on
_SYSTEM = ("/usr", "/lib", "/lib64", "/bin", "/etc/ld.so.cache", "/etc/localtime", "/sys/devices/system/cpu")
_PLAIN = ("/proc/cpuinfo", "/proc/meminfo", "/dev/null", "/dev/zero", "/dev/random", "/dev/urandom")
_SECCOMP, _FILTER = 22, 2  # of prctl
_REFUSED = {  # number of the machine in elf.h, and of its system calls: see unistd.h
    "x86_64": (0xC000003E, (29, 41, 64, 68, *range(90, 95), 109, 112, 132, *range(188, 191), 235, 240,
                            *range(248, 251), 260, 261, 268, 280)),
    "aarch64": (0xC00000B7, (*range(5, 8), *range(52, 56), 88, 154, 157, 180, 186, 190, 194, 198,
                             *range(217, 220))),
}  # fmt: skip
_REFUSED_BY_ALL = (425, 452, 463)  # io_uring_setup, fchmodat2, setxattrat
_NOT_NATIVE = 0x4000_0000  # system calls from here on are of the x32 ABI

HINT = "on a card a filter may open only its own files, by their whole path, and no sockets"


def make_place(home: Path) -> tuple[Path, dict[str, str]]:
    """Make a working folder with links to compiled kernels; return it and the environment of a process."""
    work, kernels = home / "work", choose_cache()
    work.mkdir()
    if kernels.is_dir():
        (home / "kernels").symlink_to(kernels)
        shutil.copytree(kernels, work / ".kernels" / kernels.name, copy_function=os.symlink)
    return work, os.environ | {"TMPDIR": str(work), "NUMBA_CACHE_DIR": str(work / ".kernels")}


def confine(module: str, home: Path) -> bool:
    """Confine this process to the files of a module and the folder of `make_place`; False if Linux cannot."""
    libc = ctypes.CDLL(None, use_errno=True)
    version = int(libc.syscall(_CREATE_RULESET, None, 0, 1)) if sys.platform == "linux" else 0
    if version < 1:
        return False
    every = (1 << _RIGHTS.get(version, 16)) - 1
    handled = (every, *([3] if version >= 4 else []), *([3] if version >= 6 else []))  # files, TCP, signals
    given = struct.pack(f"={len(handled)}Q", *handled)
    rules = libc.syscall(_CREATE_RULESET, given, len(given), 0)
    places = (sys.prefix, sys.base_prefix, *_SYSTEM, home / "kernels", home, *_find_modules(module))
    for allowed, rights in ((places, _READ), (_PLAIN, _READ | _WRITE), ([home / "work"], every)):
        for place in filter(os.path.exists, allowed):
            descriptor = os.open(place, os.O_PATH | os.O_CLOEXEC)
            rule = struct.pack("=Qi", rights if os.path.isdir(place) else rights & _OF_FILE, descriptor)
            libc.syscall(_ADD_RULE, rules, 1, rule, 0)
            os.close(descriptor)
    held = libc.prctl(_NO_NEW_PRIVS, 1, 0, 0, 0) == 0 and libc.syscall(_RESTRICT_SELF, rules, 0) == 0
    os.close(rules)
    return bool(held) and _refuse_calls(libc)


def _refuse_calls(libc: ctypes.CDLL) -> bool:
    """Let system calls that keep or send something without a file fail with EPERM; False if Linux cannot."""
    if platform.machine() not in _REFUSED:
        return False
    machine, numbers = _REFUSED[platform.machine()]
    refused = [(0x35, _NOT_NATIVE), *((0x15, number) for number in (*numbers, *_REFUSED_BY_ALL))]
    steps = [(0x20, 0, 0, 4), (0x15, 0, len(refused) + 2, machine), (0x20, 0, 0, 0)]  # load, compare, load
    steps += [(code, len(refused) - k, 0, value) for k, (code, value) in enumerate(refused)]
    steps += [(0x06, 0, 0, 0x7FFF_0000), (0x06, 0, 0, 0x0005_0001)]  # allow; refuse with EPERM
    code = ctypes.create_string_buffer(b"".join(struct.pack("=HBBI", *step) for step in steps))
    program = ctypes.create_string_buffer(struct.pack("@HP", len(steps), ctypes.addressof(code)))
    return bool(libc.prctl(_SECCOMP, _FILTER, program, 0, 0) == 0)


def _find_modules(own: str) -> Iterator[str | Path]:
    """Yield the modules on the Python path, and keep where they are: it cannot be listed any more."""
    places = [one for one in sys.path if not one.startswith((sys.prefix, sys.base_prefix))]
    names = {own.partition(".")[0], *(one.name for one in pkgutil.iter_modules(places))} - {"__main__"}
    specs: dict[str, ModuleSpec] = {name: spec for name in names if (spec := find_spec(name))}
    finder: Any = SimpleNamespace(find_spec=lambda name, path=None, target=None: specs.get(name))
    sys.meta_path.append(finder)
    for name, spec in specs.items():
        file = Path(spec.origin or "")
        yield from spec.submodule_search_locations or [str(file)]
        if name == own and not spec.submodule_search_locations and file.suffix == ".py":
            text = file.read_text("utf-8", errors="replace")
            yield from (one for one in file.parent.iterdir() if one.is_file() and one.name in text)
