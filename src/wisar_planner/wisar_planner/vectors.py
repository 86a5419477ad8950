"""Vector instructions for compiled kernels, where the compiler's own choice is far from the best.

What numba's intrinsics generate is LLVM's intermediate language: it says "eight cells" or "a row of
32 numbers", and runs on any processor.
"""

from __future__ import annotations

from typing import Any

from llvmlite import ir
from numba import types
from numba.core.errors import TypingError


def require(number: Any, *arrays: Any) -> None:
    """Raise TypingError unless arrays, given by their types, are contiguous and hold `number`.

    Vectors are read and written past all other checks: any other array would be misread.
    """
    for kind in arrays:
        if not isinstance(kind, types.Array) or kind.layout != "C" or kind.dtype != number:
            raise TypingError(f"a contiguous array of {number} is needed, not {kind}")


def pointer(context: Any, builder: Any, kind: Any, array: Any, at: Any, vector: Any) -> Any:
    """Return where a vector lies that begins at a flat index of a contiguous array.

    Parameters
    ----------
    context, builder
        As numba hands them to an intrinsic.
    kind, array
        Numba's type of the array, and its value.
    at
        The index, int64.
    vector : ir.VectorType
        Type of the vector.
    """
    data = context.make_array(kind)(context, builder, array).data
    return builder.bitcast(builder.gep(data, [at]), vector.as_pointer())


def spread(builder: Any, value: Any, vector: Any) -> Any:
    """Return a vector of one number in all places."""
    undefined = ir.Constant(vector, ir.Undefined)
    first = builder.insert_element(undefined, value, ir.Constant(ir.IntType(32), 0))
    everywhere = ir.Constant(ir.VectorType(ir.IntType(32), vector.count), [0] * vector.count)
    return builder.shuffle_vector(first, undefined, everywhere)


def zeros(vector: Any) -> Any:
    """Return a vector of zeros."""
    return ir.Constant(vector, [0] * vector.count)
