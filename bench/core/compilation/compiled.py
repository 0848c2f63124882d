"""Numba kernels: the decorator ``@kernel``, and the folder where compiled code is cached.

numba is imported when the first kernel is called: that takes a third of a second. Its own cache does not
detect a change in another module and would return stale results. The name of the cache folder is therefore a
hash of the sources that import this module and of all that they import, the versions of numba, numpy and
Python, and the CPU.

The first run compiles what it uses, once. A kernel that another one calls becomes a part of it: it gets
machine code and a file of its own only where Python calls it, too. What a filter may need and seldom does is
no part: it is called by its address (`bench.core.compilation.call_at`). numba carries every array of a tuple
through every use of the tuple: kernels take small tuples.

All this uses numba's inner parts (`bench.core.compilation.inner_numba`). Where they are other ones than
these, or ``BENCH_PLAIN_KERNELS`` is set, kernels are plain: ``njit(cache=True)`` and loops, with the same
bits.
"""

from __future__ import annotations

import gc
import hashlib
import os
import platform
import re
import shutil
import sys
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager, suppress
from functools import cache, cached_property, update_wrapper
from pathlib import Path
from typing import Any, NamedTuple, TypeVar, cast

import numpy as np

from bench.core.compilation.inner_numba import compilers, summed_files
from bench.core.files.places import PACKAGE, cache_folder

_UNUSED_DAYS = 30
_IMPORT = re.compile(r"^\s*from (bench[\w.]*) import (\([^)]*\)|[^\n]*)", re.MULTILINE)
_WORD = re.compile(r"\w+")
_OPTIONS: dict[str, Any] = {"cache": True, "error_model": "numpy", "no_cfunc_wrapper": True, "_nrt": False}
_TRIED = ("0.68",)
"""Versions of numba whose inner parts are known; another one compiles everything, without shortcuts."""
_PLAIN = "BENCH_PLAIN_KERNELS"
_Function = TypeVar("_Function", bound=Callable[..., object])


class Kernel:
    """A function that numba compiles on its first call, for kernels that call it as for Python."""

    def __init__(self, function: Callable[..., Any], **options: Any) -> None:
        update_wrapper(self, function)
        self.py_func, self._options = function, _OPTIONS | options

    def __call__(self, *arguments: Any) -> Any:
        """Call the compiled function and return its result."""
        return self.dispatcher(*arguments)

    def __reduce__(self) -> str:
        """Return the name by which another process finds it."""
        return self.py_func.__qualname__

    @cached_property
    def dispatcher(self) -> Any:
        """The function as numba knows it."""
        choose_cache()
        time_compiling()
        return _make_plain()(self.py_func) if is_plain() else self.made

    @cached_property
    def made(self) -> Any:
        """The function as numba knows it, made with numba's inner parts."""
        import numba

        shortcut: Any = {"pipeline_class": compilers()[0]} if takes_shortcuts() else {}
        made = numba.njit(**self._options, **shortcut)(self.py_func)
        if self._options["cache"]:
            known = made._cache._cache_file
            base = known._index_name.removesuffix(".nbi")
            made._cache._cache_file = summed_files()(known._cache_path, base, known._source_stamp)
            made._cache._cache_file.turn = _CLOCK.turn
        return made

    @cached_property
    def _part(self) -> Any:
        """The function as a part of other kernels: never on disk, for it lies in what is."""
        import numba

        if not takes_shortcuts():
            return self.made
        own = {"cache": False, "no_cpython_wrapper": True, "pipeline_class": compilers()[1]}
        part: Any = numba.njit(**self._options | own)(self.py_func)
        unliteral: Any = numba.types.unliteral
        find = part.get_call_template

        def find_typed(args: Any, kws: Any) -> Any:
            """Take a constant for a number: it is one for the optimizer, and the part is translated once."""
            return find(tuple(map(unliteral, args)), {name: unliteral(kind) for name, kind in kws.items()})

        part.get_call_template = find_typed
        return part

    @property
    def _numba_type_(self) -> Any:
        """Return the numba type of this kernel, which numba reads when another kernel names this kernel."""
        return self._part._numba_type_


@cache
def takes_shortcuts() -> bool:
    """Return whether `bench.core.compilation.inner_numba.compilers` fits the installed numba."""
    import numba

    return numba.__version__.rpartition(".")[0] in _TRIED


@cache
def is_plain() -> bool:
    """Return whether kernels are plain: as the environment asks, or where numba's inner parts are others."""
    if os.environ.get(_PLAIN):
        return True
    tried = _find_folder() / "tried"
    try:
        _try_inner_parts(compiles=not tried.exists())
    except Exception as error:  # whatever is not there, or is another one
        reason = " ".join(f"{type(error).__name__}: {error}".split())[:200]
        print(f"bench: kernels are plain, and filters slower, with this numba: {reason}", file=sys.stderr)
        return True
    with suppress(OSError):  # a cache that can only be read
        tried.parent.mkdir(parents=True, exist_ok=True)
        tried.touch()
    return False


def _try_inner_parts(*, compiles: bool) -> None:
    """Make a small kernel that uses each inner part of numba; raise an exception if that fails.

    With ``compiles``, set when a cache folder is first used, also compile and call the kernel.
    """
    import numba

    from bench.core.compilation.call_at import call_at
    from bench.core.compilation.vector_rows import LANES, add_row

    setattr(numba.config, "CACHE_DIR", str(_find_folder()))  # noqa: B010
    part = Kernel(_add_number, no_cpython_wrapper=True)

    def call(at, rows):  # type: ignore[no-untyped-def]
        add_row(rows, 0, 2.0, rows, 1, 0, LANES)
        return part(rows) + call_at(at, rows)

    inner, whole = part.made, Kernel(call, cache=False).made
    if not compiles:
        return
    rows = np.arange(2.0 * LANES).reshape(2, LANES)
    found = whole(_find_code(inner, (numba.typeof(rows),)), rows)
    if found != 2 or not np.array_equal(rows[0], 2.0 + 3.0 * np.arange(LANES) + 2.0 * LANES):
        raise ValueError("a kernel gives wrong numbers")


def _add_number(rows):  # type: ignore[no-untyped-def]
    for k in range(rows.shape[1]):
        rows[0, k] += 1.0
    return 1


@cache
def _make_plain() -> Callable[..., Any]:
    """Return the decorator of plain kernels; each can name others, as numba's own kernels do."""
    import numba
    from numba.extending import typeof_impl

    @typeof_impl.register(Kernel)
    def find_type(value: Kernel, context: object) -> Any:
        return numba.typeof(value.dispatcher)

    return cast(Callable[..., Any], numba.njit(cache=True, error_model="numpy"))


def kernel(function: _Function) -> _Function:
    """Compile a function on its first call: arrays in and out, no checks, no fastmath.

    It counts no references, for at every call and every row taken that costs as much as a division; hence it
    cannot make an array: work memory is given to it. Division follows IEEE 754 (infinity and NaN, no
    exception), as numpy does.
    """
    return cast(_Function, Kernel(function))


def inner(function: _Function) -> _Function:
    """Compile a function that only kernels call; without its Python wrapper this takes a third less time."""
    return cast(_Function, Kernel(function, no_cpython_wrapper=True))


def on_arrays(formula: Callable[..., Any]) -> Callable[..., Any]:
    """Return the formula of a kernel without branches, for arrays and by numpy: nothing is compiled."""
    return cast(Kernel, formula).py_func


class _CompileClock:
    """CPU time of compiling so far, without reading the cache, and the watchers notified of compilations."""

    def __init__(self) -> None:
        self.cpu_s, self.watchers = 0.0, list[Callable[[bool], object]]()
        self._depth, self._begun, self._collects = 0, 0.0, False

    def turn(self, step: int) -> None:
        """Begin (1) or end (-1) one compilation; compilations of the parts of a kernel are nested in its own.

        No garbage is collected meanwhile: a search of all objects that numba keeps takes a fifth of the time.
        """
        self._depth += step
        if self._depth == (1 if step > 0 else 0):
            if step > 0:
                self._collects = gc.isenabled()
                gc.disable()
            elif self._collects:
                gc.enable()
            now = time.process_time()
            self.cpu_s += 0.0 if step > 0 else now - self._begun
            self._begun = now
            for tell in self.watchers:
                tell(step > 0)


_CLOCK = _CompileClock()


@cache
def time_compiling() -> None:
    """Have numba notify the clock when it compiles; if numba cannot, no times are measured."""
    try:
        from numba.core import event
    except ImportError:
        return

    class Listener(event.Listener):
        def on_start(self, event: object) -> None:
            _CLOCK.turn(1)

        def on_end(self, event: object) -> None:
            _CLOCK.turn(-1)

    event.register("numba:compile", Listener())


def read_compile_time() -> float:
    """Return the CPU time that this process has compiled so far [s]."""
    return _CLOCK.cpu_s


@contextmanager
def watch_compiling(tell: Callable[[bool], object]) -> Iterator[None]:
    """Call a function with True whenever compiling begins, with False when it ends."""
    _CLOCK.watchers.append(tell)
    try:
        yield
    finally:
        _CLOCK.watchers.remove(tell)


class KernelTypes(NamedTuple):
    """The types of arguments as kernels are compiled for them; equal ones are one object."""

    kinds: tuple[Any, ...]
    addresses: dict[Any, int]  # by kernel, of those that were looked up


_KNOWN_TYPES: dict[Any, KernelTypes] = {}
_SEEN_FLAGS = 0x1 | 0x2 | 0x100 | 0x400  # C, Fortran, aligned, writeable: what numba sees of an array


def types_of(*arguments: Any) -> KernelTypes:
    """Return the types of arguments for which kernels are compiled."""
    look = _describe_types(arguments)
    found = _KNOWN_TYPES.get(look)
    if found is None:
        import numba

        found = KernelTypes(tuple(numba.typeof(one) for one in arguments), {})
        _KNOWN_TYPES[look] = found
    return found


def _describe_types(value: Any) -> Any:
    """Return what determines the numba type of a tuple, array or number, found without numba."""
    if isinstance(value, tuple):
        kind = type(value)
        return kind if _holds_integers(kind) else (kind, *map(_describe_types, value))
    if isinstance(value, np.ndarray):
        return type(value), value.dtype.num, value.ndim, value.flags.num & _SEEN_FLAGS
    return type(value)


@cache
def _holds_integers(kind: type) -> bool:
    """Return whether a named tuple declares only integers, so that its type alone describes it."""
    hints = getattr(kind, "__annotations__", {}).values()
    return {"int"} == {getattr(one, "__forward_arg__", one) for one in hints}


_NUMBERS: dict[Any, int] = {}  # of plain kernels that are called by address, each in its caller


def make_caller(kernels: Iterable[Callable[..., int]]) -> Callable[..., int]:
    """Return a function that calls these kernels by address (`call_at`), or plain kernels by number."""
    if not is_plain():
        from bench.core.compilation.call_at import call_at

        return cast(Callable[..., int], call_at)
    import numba

    compile_ = numba.njit(error_model="numpy")
    caller: Any = None
    for number, one in enumerate(kernels, 1):
        _NUMBERS[one] = number
        caller = compile_(_make_choice(number, one, caller))
    return cast(Callable[..., int], caller)


def _make_choice(number: int, own: Callable[..., int], others: Any) -> Callable[..., int]:
    def call_last(at: int, *arguments: Any) -> int:
        return own(*arguments)

    def call(at: int, *arguments: Any) -> int:
        return own(*arguments) if at == number else others(at, *arguments)

    return call_last if others is None else call


def find_address(function: Callable[..., object], types: KernelTypes) -> int:
    """Return where the machine code of an inner kernel for arguments of such types lies (`make_caller`)."""
    if is_plain():
        return _NUMBERS[function]
    at = types.addresses.get(function)
    if at is None:
        dispatcher = cast(Kernel, function).dispatcher
        at = types.addresses[function] = _find_code(dispatcher, types.kinds)
    return at


def find_addresses(wanted: Sequence[tuple[Callable[..., object], KernelTypes]]) -> list[int]:
    """Return where the code of several inner kernels lies (:func:`find_address`).

    Those that another process compiles now come last.
    """
    found, waiting = dict[int, int](), dict(enumerate(wanted))
    while waiting:
        number = next((i for i in waiting if not _is_compiled_elsewhere(*waiting[i])), min(waiting))
        found[number] = find_address(*waiting.pop(number))
    return [found[i] for i in range(len(wanted))]


def _is_compiled_elsewhere(function: Callable[..., object], types: KernelTypes) -> bool:
    if function in types.addresses or is_plain():
        return False
    return bool(cast(Kernel, function).dispatcher._cache._cache_file.is_compiled_elsewhere())


def _find_code(dispatcher: Any, kinds: tuple[Any, ...]) -> int:
    dispatcher.compile(kinds)
    found = dispatcher.overloads[kinds]
    return int(found.library.get_pointer_to_function(found.fndesc.llvm_func_name))


def hash_sources() -> str:
    """Return the name of the cache: a hash of numba, the processor and all sources that kernels depend on."""
    import numba

    digest = hashlib.sha256()
    bounds = f"bounds {os.environ.get('NUMBA_BOUNDSCHECK', '')}"
    for part in (numba.__version__, np.__version__, sys.version, platform.machine(), _name_cpu(), bounds):
        digest.update(part.encode())
    for name, text in sorted(_compiled_sources().items()):
        digest.update(name.encode() + text)
    return digest.hexdigest()[:24]


def _compiled_sources() -> dict[str, bytes]:
    """Return the sources, by name, of the modules that import this module, and of all their imports."""
    sources = {_name_module(path): path.read_bytes() for path in PACKAGE.rglob("*.py")}
    found: dict[str, bytes] = {}
    waiting = [name for name, text in sources.items() if b"bench.core.compilation.compiled" in text]
    while waiting:
        name = waiting.pop()
        if name in sources and name not in found:
            found[name] = sources[name]
            for module, names in _IMPORT.findall(sources[name].decode()):
                waiting += [module, *(f"{module}.{one}" for one in _WORD.findall(names))]
    return found


def _name_module(path: Path) -> str:
    parts = path.relative_to(PACKAGE.parent).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


def _name_cpu() -> str:
    from llvmlite import binding

    return f"{binding.get_host_cpu_name()} {binding.get_host_cpu_features().flatten()}"


@cache
def _find_folder() -> Path:
    own = os.environ.get("NUMBA_CACHE_DIR")
    return (Path(own) if own else cache_folder("kernels")) / hash_sources()


@cache
def choose_cache() -> Path:
    """Set the cache folder of numba and remove folders unused for 30 days; return the folder.

    With ``NUMBA_CACHE_DIR`` the folder is made there, and none is removed.
    """
    import numba

    folder = _find_folder()
    if is_plain():
        folder = folder.with_name(f"{folder.name}-plain")
    setattr(numba.config, "CACHE_DIR", str(folder))  # noqa: B010 - numba types its settings as constants
    if "NUMBA_CACHE_DIR" in os.environ:
        return folder
    if folder.exists():
        try:
            os.utime(folder)
        except OSError:  # a read-only shared cache is still used
            return folder
    remove_unused(folder.parent, keep=folder)
    return folder


def remove_unused(root: Path, keep: Path) -> None:
    """Remove the folders beside ``keep`` that nothing has used for a month."""
    oldest = time.time() - _UNUSED_DAYS * 86400
    try:
        stale = [f for f in root.iterdir() if f != keep and f.is_dir() and f.stat().st_mtime < oldest]
    except OSError:  # absent, or another process is removing folders
        return
    for folder in stale:
        shutil.rmtree(folder, ignore_errors=True)
