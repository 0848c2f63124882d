"""The door to numba: ``@kernel``, and the folder where compiled code is cached.

numba is imported when the first kernel is called: that takes a third of a second. Its own cache does not
notice a change in another module and would return stale results. The name of the cache folder is therefore a
hash of the sources that import this module and of all that they import, the versions of numba, numpy and
Python, and the CPU.

The first run compiles what it uses, once. A kernel that another one calls becomes a part of it: it gets
machine code and a file of its own only where Python calls it, too. What a filter may need and seldom does is
no part: it is called by its address (`bench.call_at`). numba carries every array of a tuple through every use
of the tuple: kernels take small tuples.
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
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import cache, cached_property, update_wrapper
from pathlib import Path
from typing import Any, NamedTuple, TypeVar, cast

import numpy as np

from bench.places import PACKAGE, cache_folder

_UNUSED_DAYS = 30
_IMPORT = re.compile(r"^\s*from (bench[\w.]*) import (\([^)]*\)|[^\n]*)", re.MULTILINE)
_WORD = re.compile(r"\w+")
_OPTIONS: dict[str, Any] = {"cache": True, "error_model": "numpy", "no_cfunc_wrapper": True, "_nrt": False}
_TRIED = ("0.68",)
"""Versions of numba whose inner parts are known; another one compiles everything, without shortcuts."""
_IDLE_PASSES = {
    "WithLifting",
    "InlineClosureLikes",
    "RewriteSemanticConstants",
    "DeadBranchPrune",
    "RewriteDynamicRaises",
    "MakeFunctionToJitFunction",
    "InlineInlinables",
    "FindLiterallyCalls",
    "LiteralUnroll",
    "LiteralPropagationSubPipelinePass",
    "InlineOverloads",
    "NopythonRewrites",
    "NoPythonSupportedFeatureValidation",
    "DumpParforDiagnostics",
}
_Function = TypeVar("_Function", bound=Callable[..., object])


class Kernel:
    """A function that numba compiles on its first call, for kernels that call it as for Python."""

    def __init__(self, function: Callable[..., Any], **options: Any) -> None:
        update_wrapper(self, function)
        self.py_func, self._options = function, _OPTIONS | options

    def __call__(self, *arguments: Any) -> Any:
        """Return what the function returns."""
        return self.dispatcher(*arguments)

    def __reduce__(self) -> str:
        """Return the name by which another process finds it."""
        return self.py_func.__qualname__

    @cached_property
    def dispatcher(self) -> Any:
        """The function as numba knows it."""
        import numba

        choose_cache()
        _time_compiling()
        shortcut: Any = {"pipeline_class": _compilers()[0]} if _takes_shortcuts() else {}
        made = numba.njit(**self._options, **shortcut)(self.py_func)
        known = made._cache._cache_file
        base = known._index_name.removesuffix(".nbi")
        made._cache._cache_file = _summed_files()(known._cache_path, base, known._source_stamp)
        return made

    @cached_property
    def _part(self) -> Any:
        """The function as a part of other kernels: never on disk, for it lies in what is."""
        import numba

        if not _takes_shortcuts():
            return self.dispatcher
        own = {"cache": False, "no_cpython_wrapper": True, "pipeline_class": _compilers()[1]}
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
        """What numba asks for where a kernel names another one."""
        return self._part._numba_type_


@cache
def _takes_shortcuts() -> bool:
    """Return whether :func:`_compilers` fits the installed numba."""
    import numba

    return numba.__version__.rpartition(".")[0] in _TRIED


@cache
def _compilers() -> tuple[type, type]:
    """Return the compiler of kernels, and that of a kernel as a part of another one.

    Half of numba's passes look for what no kernel has: closures, branches of other types, array expressions.
    A part is typed and translated. The kernel that it is a part of takes it in whole, and is optimised and
    made into machine code at once with all its parts.
    """
    from numba.core.codegen import JITCodeLibrary
    from numba.core.compiler import Compiler, Flags
    from numba.core.compiler_machinery import PassManager

    class SetFlags(Flags):
        """Flags by what is set of them: numba asks for a hash of all, default or not, at every operator."""

        def __hash__(self) -> int:
            return len(self._values)

        def __eq__(self, other: object) -> bool:
            same = isinstance(other, SetFlags) and self._values == other._values
            return same or bool(super().__eq__(other))  # type: ignore[no-untyped-call]

    class Whole(Compiler):
        def __init__(self, typing: Any, target: Any, library: Any, *rest: Any) -> None:
            args, returns, flags, names = rest
            if library is None:
                library = Sealed(target.codegen(), "kernel")  # type: ignore[no-untyped-call]
                library.enable_object_caching()
            kept = SetFlags(flags)  # type: ignore[no-untyped-call]
            super().__init__(typing, target, library, args, returns, kept, names)  # type: ignore[no-untyped-call]

        def define_pipelines(self) -> list[Any]:
            """Return numba's passes, less those that find nothing to do."""
            lean = PassManager("kernel")
            (whole,) = super().define_pipelines()  # type: ignore[no-untyped-call]
            lean.passes = [one for one in whole.passes if one[0].__name__ not in _IDLE_PASSES]
            lean.finalize()
            return [lean]

    class Sealed(JITCodeLibrary):
        def _optimize_final_module(self) -> None:
            """Let only the kernel be seen from outside: its parts then lie in it, or take what they use.

            numba's first passes are left out: they are for the counting of references.
            """
            import llvmlite.binding as llvm

            for one in self._final_module.functions:
                if not one.is_declaration and one.linkage == llvm.Linkage.linkonce_odr:
                    one.linkage = llvm.Linkage.internal
            passes, builder = self._codegen._module_pass_manager()
            passes.run(self._final_module, builder)

    class Library(JITCodeLibrary):
        def _optimize_final_module(self) -> None:
            """Leave it to the whole."""

        def _finalize_final_module(self) -> None:
            self._finalized = True

        @property
        def codegen(self) -> Any:
            return self

        def set_env(self, name: str, environment: object) -> None:
            """Forget what machine code would need."""

    class Part(Whole):
        def __init__(self, typing: Any, target: Any, library: Any, *rest: Any) -> None:
            library = library or Library(target.codegen(), "part")  # type: ignore[no-untyped-call]
            super().__init__(typing, target, library, *rest)

    return Whole, Part


@cache
def _summed_files() -> type:
    """Return the files of numba's cache with a sum in each: what is damaged is told once and made again."""
    import pickle

    from numba.core.caching import IndexDataCacheFile

    files: Any = IndexDataCacheFile

    class SummedFiles(files):  # type: ignore[misc]
        def _write(self, path: str, value: object) -> None:
            data = self._dump(value)
            with self._open_for_write(path) as file:
                file.write(hashlib.sha256(data).digest() + data)

        def _read(self, path: str) -> Any:
            whole = Path(path).read_bytes()
            if hashlib.sha256(whole[32:]).digest() != whole[:32]:
                raise ValueError(f"{path} is damaged")
            return pickle.loads(whole[32:])

        def _save_index(self, overloads: object) -> None:
            self._write(self._index_path, (self._source_stamp, overloads))

        def _load_index(self) -> Any:
            try:
                stamp, overloads = self._read(self._index_path)
            except FileNotFoundError:
                return {}
            except Exception:
                _tell_damage(self._cache_path)
                return {}
            return overloads if stamp == self._source_stamp else {}

        def _save_data(self, name: str, data: object) -> None:
            self._write(self._data_path(name), data)

        def _load_data(self, name: str) -> Any:
            try:
                return self._read(self._data_path(name))
            except OSError:  # numba compiles again
                raise
            except Exception:
                _tell_damage(self._cache_path)
                return None

    return SummedFiles


@cache
def _tell_damage(folder: str) -> None:
    print(f"bench: compiled code in {folder} is damaged; it is compiled again", file=sys.stderr)


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
    """CPU time that compiling took so far, without what was read from the cache, and who is told of it."""

    def __init__(self) -> None:
        self.cpu_s, self.watchers = 0.0, list[Callable[[bool], object]]()
        self._depth, self._begun, self._collects = 0, 0.0, False

    def turn(self, step: int) -> None:
        """Begin (1) or end (-1) one compilation; those of the parts of a kernel lie in its own.

        No garbage is collected meanwhile: looking through all that numba keeps takes a fifth of the time.
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
def _time_compiling() -> None:
    """Have numba tell the clock when it compiles."""
    from numba.core import event

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
    """Return the types of arguments as kernels are compiled for them."""
    look = _describe_types(arguments)
    found = _KNOWN_TYPES.get(look)
    if found is None:
        import numba

        found = KernelTypes(tuple(numba.typeof(one) for one in arguments), {})
        _KNOWN_TYPES[look] = found
    return found


def _describe_types(value: Any) -> Any:
    """Return what the type of a value follows from, without numba: of tuples, arrays and numbers."""
    if isinstance(value, tuple):
        kind = type(value)
        return kind if _holds_integers(kind) else (kind, *map(_describe_types, value))
    if isinstance(value, np.ndarray):
        return type(value), value.dtype.num, value.ndim, value.flags.num & _SEEN_FLAGS
    return type(value)


@cache
def _holds_integers(kind: type) -> bool:
    """Return whether a named tuple declares nothing but integers: its own type says it all."""
    hints = getattr(kind, "__annotations__", {}).values()
    return {"int"} == {getattr(one, "__forward_arg__", one) for one in hints}


def find_address(function: Callable[..., object], types: KernelTypes) -> int:
    """Return where the machine code of an inner kernel for arguments of such types lies (`bench.call_at`)."""
    at = types.addresses.get(function)
    if at is None:
        dispatcher = cast(Kernel, function).dispatcher
        dispatcher.compile(types.kinds)
        found = dispatcher.overloads[types.kinds]
        at = int(found.library.get_pointer_to_function(found.fndesc.llvm_func_name))
        types.addresses[function] = at
    return at


def _hash_sources() -> str:
    import numba

    digest = hashlib.sha256()
    for part in (numba.__version__, np.__version__, sys.version, platform.machine(), _name_cpu()):
        digest.update(part.encode())
    for name, text in sorted(_compiled_sources().items()):
        digest.update(name.encode() + text)
    return digest.hexdigest()[:24]


def _compiled_sources() -> dict[str, bytes]:
    """Return by name the modules that import this one, and those whose values they may have compiled in."""
    sources = {_name_module(path): path.read_bytes() for path in PACKAGE.rglob("*.py")}
    found: dict[str, bytes] = {}
    waiting = [name for name, text in sources.items() if b"bench.compiled" in text]
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
def choose_cache() -> Path:
    """Set the cache folder of numba and remove folders unused for 30 days; return the folder.

    With ``NUMBA_CACHE_DIR`` the folder is made there, and none is removed.
    """
    import numba

    own = os.environ.get("NUMBA_CACHE_DIR")
    folder = (Path(own) if own else cache_folder("kernels")) / _hash_sources()
    setattr(numba.config, "CACHE_DIR", str(folder))  # noqa: B010 - numba types its settings as constants
    if own:
        return folder
    if folder.exists():
        try:
            os.utime(folder)
        except OSError:  # a read-only shared cache is still used
            return folder
    _remove_unused(folder.parent, keep=folder)
    return folder


def _remove_unused(root: Path, keep: Path) -> None:
    oldest = time.time() - _UNUSED_DAYS * 86400
    try:
        stale = [f for f in root.iterdir() if f != keep and f.is_dir() and f.stat().st_mtime < oldest]
    except OSError:  # absent, or another process is removing folders
        return
    for folder in stale:
        shutil.rmtree(folder, ignore_errors=True)
