"""A kernel that calls another one by its address, which takes no part of it into itself.

What a kernel names is compiled with it, whether a run gets there or not. A kernel that is given addresses
(:func:`bench.core.compilation.compiled.find_address`) is compiled without what lies there, and that only
where it is asked for. The call costs as much as one of a function in C; nothing of it can be kept in
registers.
"""

from __future__ import annotations

from typing import Any

from numba import types
from numba.core import cgutils
from numba.extending import intrinsic


@intrinsic
def call_at(_, address, *arguments):  # type: ignore[no-untyped-def]
    """Call the kernel at an address, from another kernel, and return its result, an int.

    Nothing is checked: it must have been compiled for arguments of exactly these types.
    """
    kinds = [types.unliteral(kind) for kind in arguments]

    def write(context: Any, builder: Any, signature: Any, values: Any) -> Any:
        kind = context.call_conv.get_function_type(types.int64, kinds)
        place = builder.inttoptr(values[0], kind.as_pointer())
        status, result = context.call_conv.call_function(
            builder, place, types.int64, kinds, cgutils.unpack_tuple(builder, values[1])
        )
        with cgutils.if_unlikely(builder, status.is_error):
            context.call_conv.return_status_propagate(builder, status)
        return result

    return types.int64(address, types.StarArgTuple(kinds)), write
