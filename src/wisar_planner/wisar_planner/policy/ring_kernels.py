"""The ring network of one policy, compiled, for NumPy: what `network.forward` says.

A plan asks the network for one turn at a time. There the array code spends most of its time
between its operations, and a ring kernel as a matrix does 32 times the reading that it needs.
Tests compare the two.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
from llvmlite import ir
from numba import njit, types
from numba.core import cgutils
from numba.extending import intrinsic

from wisar_planner.policy.observation import DIRECTIONS
from wisar_planner.vectors import pointer, require, spread, zeros

Float32Array = npt.NDArray[np.float32]

_ROW = ir.VectorType(ir.FloatType(), DIRECTIONS)
# A product and a sum may become one instruction.
_FUSED = ("contract",)


class RingWeights(NamedTuple):
    """Parameters of one network, laid out for the kernel.

    Attributes
    ----------
    from_view : (channels, VIEW_WIDTH)
    from_numbers : (channels, NUMBERS)
    bias : (channels, 1)
    rings : (blocks, channels, DIRECTIONS)
    mixes : (blocks, channels, channels)
    biases : (blocks, channels, 1)
    output : (outputs, channels)
    output_bias : (outputs, 1)
    """

    from_view: Float32Array
    from_numbers: Float32Array
    bias: Float32Array
    rings: Float32Array
    mixes: Float32Array
    biases: Float32Array
    output: Float32Array
    output_bias: Float32Array

    @classmethod
    def of(cls, parameters: Mapping[str, Float32Array]) -> RingWeights:
        """Return the parameters, as `network.forward` takes them, of the first network."""
        single = {
            name: np.ascontiguousarray(value[0], np.float32) for name, value in parameters.items()
        }
        blocks = sum(name.startswith("ring") for name in single)

        def stacked(name: str) -> Float32Array:
            return np.stack([single[f"{name}{block}"] for block in range(blocks)])

        return cls(
            *(single[name] for name in ("view", "numbers", "bias")),
            *(stacked(name) for name in ("ring", "mix", "bias")),
            *(single[name] for name in ("output", "output_bias")),
        )


def _add_products(
    _: Any,
    sums: Any,
    at: Any,
    weights: Any,
    first: Any,
    rows: Any,
    start: Any,
    stride: Any,
    count: Any,
) -> tuple[Any, Any]:
    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        sums, at, weights, first, rows, start, stride, count = arguments
        kinds = signature.args

        def element(kind: int, array: Any, index: Any) -> Any:
            data = context.make_array(kinds[kind])(context, builder, array).data
            return builder.load(builder.gep(data, [index]))

        # Sums of even and of odd rows: two chains of additions that do not wait for each other.
        place = pointer(context, builder, kinds[0], sums, at, _ROW)
        chains = [cgutils.alloca_once_value(builder, zeros(_ROW)) for _ in range(2)]
        builder.store(builder.load(place, align=4), chains[0])

        def add(k: Any, chain: Any) -> None:
            weight = spread(builder, element(2, weights, builder.add(first, k)), _ROW)
            index = builder.add(start, builder.mul(k, stride))
            row = builder.load(pointer(context, builder, kinds[4], rows, index, _ROW), align=4)
            product = builder.fmul(weight, row, flags=_FUSED)
            builder.store(builder.fadd(builder.load(chain), product, flags=_FUSED), chain)

        one = ir.Constant(ir.IntType(64), 1)
        with cgutils.for_range(builder, builder.lshr(count, one)) as loop:
            even = builder.shl(loop.index, one)
            add(even, chains[0])
            add(builder.add(even, one), chains[1])
        with builder.if_then(builder.trunc(count, ir.IntType(1))):
            add(builder.sub(count, one), chains[0])
        total = builder.fadd(*(builder.load(chain) for chain in chains))
        builder.store(total, place, align=4)
        return context.get_dummy_value()

    require(types.float32, sums, weights, rows)
    index = types.int64
    signature = types.void(sums, index, weights, index, rows, index, index, index)
    return signature, generate


#: ``add_products(sums, at, weights, first, rows, start, stride, count)`` adds to `DIRECTIONS`
#: numbers from ``sums[at]`` on, for k = 0 to `count` - 1, ``weights[first + k]`` times those from
#: ``rows[start + k * stride]`` on. All are float32 arrays; indices are flat.
add_products: Callable[..., None] = intrinsic(_add_products)


@njit(cache=True, nogil=True)
def ring_network(
    weights: RingWeights, view: Float32Array, numbers: Float32Array, output: Float32Array
) -> None:
    """Write the outputs of the network, (outputs, B, DIRECTIONS); see `network.forward`."""
    searches, directions, width = view.shape
    channels = len(weights.from_view)
    columns = np.empty((width, directions), np.float32)
    hidden = np.empty((channels, directions), np.float32)
    turned = np.empty((channels, directions), np.float32)
    mixed = np.empty(directions, np.float32)
    twice = np.empty(2 * directions, np.float32)
    zero = np.float32(0.0)
    for b in range(searches):
        for d in range(directions):
            for v in range(width):
                columns[v, d] = view[b, d, v]
        for c in range(channels):
            row = weights.bias[c, 0]
            for k in range(numbers.shape[1]):
                row += weights.from_numbers[c, k] * numbers[b, k]
            hidden[c] = row
            add_products(
                hidden, c * directions, weights.from_view, c * width, columns, 0, directions, width
            )
            for d in range(directions):
                hidden[c, d] = max(hidden[c, d], zero)
        for block in range(len(weights.rings)):
            for c in range(channels):
                # Written twice in a row, the ring can be read in full from any direction on.
                twice[:directions] = hidden[c]
                twice[directions:] = hidden[c]
                turned[c] = zero
                add_products(
                    turned, c * directions, weights.rings, (block * channels + c) * directions,
                    twice, directions, -1, directions,
                )  # fmt: skip
            for c in range(channels):
                mixed[:] = weights.biases[block, c, 0]
                add_products(
                    mixed, 0, weights.mixes, (block * channels + c) * channels,
                    turned, 0, directions, channels,
                )  # fmt: skip
                for d in range(directions):
                    hidden[c, d] += max(mixed[d], zero)
        for o in range(len(weights.output)):
            output[o, b] = weights.output_bias[o, 0]
            add_products(
                output, (o * searches + b) * directions, weights.output, o * channels,
                hidden, 0, directions, channels,
            )  # fmt: skip
