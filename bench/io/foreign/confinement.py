"""Confinement of the process of a filter by Landlock: from then on it may open only what a list allows.

It may read Python, system libraries, compiled kernels, the modules on the Python path, and files beside its
own module that it names. It may write into its working folder. See landlock(7) of Linux.
"""

from __future__ import annotations

import ctypes
import os
import pkgutil
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

HINT = "on a card a filter may open only its own files, by their whole path"


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
    return bool(held)


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
