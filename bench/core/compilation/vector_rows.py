"""The functions of `bench.core.compilation.wide_rows` as vector instructions: eight columns at a time.

The compiler may not work on several columns at once where it cannot prove that rows do not overlap, and it
takes short loops apart before it tries. The functions here write the vector instructions themselves.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, cast

from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.extending import intrinsic

LANES = 8
"""Numbers of a vector: one cache line; a processor with shorter vectors takes two or four."""
_VECTOR = ir.VectorType(ir.DoubleType(), LANES)
_INDEX = ir.IntType(64)


def _instructions(write: Callable[..., Any]) -> Callable[..., None]:
    """Make a function for kernels from ``write``, which returns its signature and writes its instructions."""
    return cast(Callable[..., None], intrinsic(write))


class _RowArguments:
    """The arguments of a function as the instructions see them: arrays by number."""

    def __init__(self, context: Any, builder: Any, types_: Sequence[Any], values: Sequence[Any]) -> None:
        self.builder = builder
        self.arrays = [
            context.make_array(one)(context, builder, value) if isinstance(one, types.Array) else None
            for one, value in zip(types_, values, strict=True)
        ]

    def pointer(self, array: int, row: Any, column: Any) -> Any:
        found = self.arrays[array]
        assert found is not None
        b = self.builder
        *_, width = cgutils.unpack_tuple(b, found.shape)
        return b.gep(found.data, [b.add(b.mul(row, width), column)])

    def load(self, array: int, row: Any, column: Any) -> Any:
        place = self.builder.bitcast(self.pointer(array, row, column), _VECTOR.as_pointer())
        return self.builder.load(place, align=8)

    def store(self, vector: Any, array: int, row: Any, column: Any) -> None:
        place = self.builder.bitcast(self.pointer(array, row, column), _VECTOR.as_pointer())
        self.builder.store(vector, place, align=8)

    def repeat(self, number: Any) -> Any:
        """Return a vector of one number."""
        none = ir.Constant(_VECTOR, ir.Undefined)
        first = self.builder.insert_element(none, number, ir.IntType(32)(0))
        lanes = ir.Constant(ir.VectorType(ir.IntType(32), LANES), [0] * LANES)
        return self.builder.shuffle_vector(first, none, lanes)

    def add_product(self, total: Any, a: Any, b: Any) -> Any:
        """Return total + a b, rounded once where the processor can."""
        kind = ir.FunctionType(_VECTOR, [_VECTOR] * 3)
        name = f"llvm.fmuladd.v{LANES}f64"
        return self.builder.call(
            cgutils.get_or_insert_function(self.builder.module, kind, name), [a, b, total]
        )

    def columns(self, first: Any, last: Any) -> Any:
        """Loop over the first column of each vector."""
        return cgutils.for_range_slice(self.builder, first, last, _INDEX(LANES))


def row_sums(pattern: Sequence[Sequence[int]], upper_rows: int) -> Callable[..., None]:
    """Return a function that adds multiples of rows to rows, with the factors that are not always zero.

    Parameters
    ----------
    pattern : sequence of sequences of int
        For each row i of the result the rows k that are added to it.
    upper_rows : int
        Number of rows of ``upper``; a row k from there on is row ``k - upper_rows`` of ``lower``.

    Returns
    -------
    add_rows(start, factors, upper, lower, target, first, last)
        ``target[i] = start[i] + sum of factors[i, k] source[k] over k in pattern[i]``. All rows are read
        before one is written, so ``target`` may be one of the others.
    """
    needed = sorted({k for row in pattern for k in row})

    @_instructions
    def add_rows(
        _: Any, start: Any, factors: Any, upper: Any, lower: Any, target: Any, first: Any, last: Any
    ) -> Any:
        def write(context: Any, builder: Any, signature: Any, given: Any) -> Any:
            rows = _RowArguments(context, builder, signature.args, given)
            with rows.columns(given[5], given[6]) as (column, _):
                source = {
                    k: rows.load(2, _INDEX(k), column)
                    if k < upper_rows
                    else rows.load(3, _INDEX(k - upper_rows), column)
                    for k in needed
                }
                totals = [rows.load(0, _INDEX(i), column) for i in range(len(pattern))]
                for i, terms in enumerate(pattern):
                    for k in terms:
                        factor = builder.load(rows.pointer(1, _INDEX(i), _INDEX(k)))
                        totals[i] = rows.add_product(totals[i], rows.repeat(factor), source[k])
                    rows.store(totals[i], 4, _INDEX(i), column)
            return context.get_dummy_value()

        return types.void(start, factors, upper, lower, target, first, last), write

    return add_rows


@_instructions
def add_row(_, target, i, factor, source, k, first, last):  # type: ignore[no-untyped-def]
    """``target[i] += factor source[k]``."""

    def write(context: Any, builder: Any, signature: Any, given: Any) -> Any:
        rows = _RowArguments(context, builder, signature.args, given)
        factor = rows.repeat(given[2])
        with rows.columns(given[5], given[6]) as (column, _):
            total = rows.load(0, given[1], column)
            rows.store(rows.add_product(total, factor, rows.load(3, given[4], column)), 0, given[1], column)
        return context.get_dummy_value()

    return types.void(target, types.int64, types.float64, source, types.int64, first, last), write


@_instructions
def set_row(_, target, i, factor, source, k, first, last):  # type: ignore[no-untyped-def]
    """``target[i] = factor source[k]``."""

    def write(context: Any, builder: Any, signature: Any, given: Any) -> Any:
        rows = _RowArguments(context, builder, signature.args, given)
        factor = rows.repeat(given[2])
        with rows.columns(given[5], given[6]) as (column, _):
            rows.store(builder.fmul(factor, rows.load(3, given[4], column)), 0, given[1], column)
        return context.get_dummy_value()

    return types.void(target, types.int64, types.float64, source, types.int64, first, last), write


@_instructions
def scale_row(_, target, i, factor, scale, source, k, first, last):  # type: ignore[no-untyped-def]
    """``target[i] = factor scale source[k]``, by elements; ``scale`` (n,) is a row of its own."""

    def write(context: Any, builder: Any, signature: Any, given: Any) -> Any:
        rows = _RowArguments(context, builder, signature.args, given)
        factor = rows.repeat(given[2])
        with rows.columns(given[6], given[7]) as (column, _):
            scaled = builder.fmul(factor, rows.load(3, _INDEX(0), column))
            rows.store(builder.fmul(scaled, rows.load(4, given[5], column)), 0, given[1], column)
        return context.get_dummy_value()

    return types.void(target, types.int64, types.float64, scale, source, types.int64, first, last), write
