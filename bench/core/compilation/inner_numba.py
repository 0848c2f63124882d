"""Inner parts of numba that kernels use: its passes, its libraries, the files of its cache.

They are not public and may change in any version: `bench.core.compilation.compiled` tries them on a small
kernel, and does without them if they fail.
"""

from __future__ import annotations

import hashlib
import sys
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

from bench.core.compilation.kernel_locks import is_locked, lock, unlock

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


@cache
def compilers() -> tuple[type, type]:
    """Return the compiler of kernels, and the compiler of a kernel that is a part of another kernel.

    Half of numba's passes look for what no kernel contains: closures, branches of other types, array
    expressions. A part is typed and translated. The enclosing kernel includes all its parts, and is optimized
    and compiled to machine code once, with them.
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
            super().__init__(_remember_types(typing), target, library, args, returns, kept, names)  # type: ignore[no-untyped-call]

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
def _remember_types(typing: Any) -> Any:
    """Return a typing context that finds the types of an operator on numbers and arrays once.

    numba tries all variants of the operator at each of its uses.
    """
    from numba.core import types

    known: dict[Any, Any] = {}
    kinds = (types.Number, types.Boolean, types.Array)

    class Remembering(type(typing)):  # type: ignore[misc]
        def _resolve_user_function_type(self, func: Any, args: Any, kws: Any, literals: Any = None) -> Any:
            if kws or type(func) is not types.Function or not all(isinstance(one, kinds) for one in args):
                return super()._resolve_user_function_type(func, args, kws, literals)
            if (found := known.get((func, args))) is None:
                found = super()._resolve_user_function_type(func, args, kws, literals)
                known[func, args] = found
            return found

    context = object.__new__(Remembering)
    context.__dict__ = typing.__dict__  # one state under both classes
    return context


@cache
def summed_files() -> type:
    """Return a class of numba cache files with checksums: a damaged file is reported once and made again.

    Of two processes that miss the same kernel, one compiles it.
    """
    import pickle

    from numba.core.caching import IndexDataCacheFile

    files: Any = IndexDataCacheFile

    class SummedFiles(files):  # type: ignore[misc]
        turn: Callable[[int], object]  # called with 1 and -1 when a wait for another process begins and ends

        def load(self, key: object) -> Any:
            """Return the cached kernel; without one, lock it and look again."""
            found = super().load(key)
            if found is None:
                waits = self.is_compiled_elsewhere()
                if waits:
                    self.turn(1)
                lock(Path(self._cache_path), self._index_name)
                if waits:
                    self.turn(-1)
                if (found := super().load(key)) is not None:
                    unlock(Path(self._cache_path), self._index_name)
            return found

        def save(self, key: object, data: object) -> None:
            try:
                super().save(key, data)
            finally:
                unlock(Path(self._cache_path), self._index_name)

        def is_compiled_elsewhere(self) -> bool:
            """Return whether another process compiles this kernel."""
            return is_locked(Path(self._cache_path), self._index_name)

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
