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
from llvmlite.binding import get_host_cpu_features
from numba import njit, types
from numba.core import cgutils
from numba.extending import intrinsic

from wisar_planner.policy.observation import DIRECTIONS
from wisar_planner.vectors import pointer, require, spread

Float32Array = npt.NDArray[np.float32]

_ROW = ir.VectorType(ir.FloatType(), DIRECTIONS)
# A product and a sum may become one instruction.
_FUSED = ("contract",)
# Channels whose sums grow side by side, so that what they share is read once and additions do not
# wait for each other: as many as 32 vector registers hold, or 16.
_TOGETHER = 4 if get_host_cpu_features().get("avx512vl") else 2


class RingWeights(NamedTuple):
    """Parameters of one network, laid out for the kernel.

    Channels and outputs are filled up with zeros to a multiple of `_TOGETHER`.

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
        blocks = sum(name.startswith("ring") for name in parameters)

        def filled(name: str) -> Float32Array:
            value = parameters[name][0]
            over_channels = name.startswith("mix") or name == "output"
            fill = [(0, -value.shape[0] % _TOGETHER), (0, -value.shape[1] % _TOGETHER)]
            return np.pad(value, fill if over_channels else [fill[0], (0, 0)]).astype(np.float32)

        def stacked(name: str) -> Float32Array:
            return np.stack([filled(f"{name}{block}") for block in range(blocks)])

        return cls(
            *(filled(name) for name in ("view", "numbers", "bias")),
            *(stacked(name) for name in ("ring", "mix", "bias")),
            *(filled(name) for name in ("output", "output_bias")),
        )


def _add_products(
    _: Any,
    sums: Any,
    weights: Any,
    first: Any,
    count: Any,
    rows: Any,
    start: Any,
    apart: Any,
    stride: Any,
) -> tuple[Any, Any]:
    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        sums, weights, first, count, rows, start, apart, stride = arguments
        kinds = signature.args

        def row(kind: int, array: Any, index: Any) -> Any:
            return pointer(context, builder, kinds[kind], array, index, _ROW)

        def constant(value: int) -> Any:
            return ir.Constant(ir.IntType(64), value)

        places = [row(0, sums, constant(DIRECTIONS * channel)) for channel in range(_TOGETHER)]
        totals = [
            cgutils.alloca_once_value(builder, builder.load(place, align=4)) for place in places
        ]
        data = context.make_array(kinds[1])(context, builder, weights).data
        with cgutils.for_range(builder, count) as loop:
            along = builder.add(start, builder.mul(loop.index, stride))
            for channel, total in enumerate(totals):
                at = builder.add(first, builder.mul(constant(channel), count))
                weight = builder.load(builder.gep(data, [builder.add(at, loop.index)]))
                index = builder.add(along, builder.mul(constant(channel), apart))
                product = builder.fmul(
                    spread(builder, weight, _ROW),
                    builder.load(row(4, rows, index), align=4),
                    flags=_FUSED,
                )
                builder.store(builder.fadd(builder.load(total), product, flags=_FUSED), total)
        for place, total in zip(places, totals, strict=True):
            builder.store(builder.load(total), place, align=4)
        return context.get_dummy_value()

    require(types.float32, sums, weights, rows)
    index = types.int64
    signature = types.void(sums, weights, index, index, rows, index, index, index)
    return signature, generate


#: ``add_products(sums, weights, first, count, rows, start, apart, stride)`` adds to `DIRECTIONS`
#: numbers in each of the `_TOGETHER` rows c of `sums`, for k = 0 to `count` - 1,
#: ``weights[first + c * count + k]`` times those from ``rows[start + c * apart + k * stride]`` on.
#: All are float32 arrays; indices are flat.
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
    sums = np.empty((_TOGETHER, directions), np.float32)
    twice = np.empty((_TOGETHER, 2 * directions), np.float32)
    zero = np.float32(0.0)
    for b in range(searches):
        for d in range(directions):
            for v in range(width):
                columns[v, d] = view[b, d, v]
        for c in range(0, channels, _TOGETHER):
            for i in range(_TOGETHER):
                row = weights.bias[c + i, 0]
                for k in range(numbers.shape[1]):
                    row += weights.from_numbers[c + i, k] * numbers[b, k]
                sums[i] = row
            add_products(sums, weights.from_view, c * width, width, columns, 0, 0, directions)
            for i in range(_TOGETHER):
                for d in range(directions):
                    hidden[c + i, d] = max(sums[i, d], zero)
        for block in range(len(weights.rings)):
            for c in range(0, channels, _TOGETHER):
                # Written twice in a row, a ring can be read in full from any direction on.
                for i in range(_TOGETHER):
                    twice[i, :directions] = hidden[c + i]
                    twice[i, directions:] = hidden[c + i]
                sums[:] = zero
                add_products(
                    sums, weights.rings, (block * channels + c) * directions, directions,
                    twice, directions, 2 * directions, -1,
                )  # fmt: skip
                turned[c : c + _TOGETHER] = sums
            for c in range(0, channels, _TOGETHER):
                for i in range(_TOGETHER):
                    sums[i] = weights.biases[block, c + i, 0]
                add_products(
                    sums, weights.mixes, (block * channels + c) * channels, channels,
                    turned, 0, 0, directions,
                )  # fmt: skip
                for i in range(_TOGETHER):
                    for d in range(directions):
                        hidden[c + i, d] += max(sums[i, d], zero)
        for o in range(0, len(weights.output), _TOGETHER):
            for i in range(_TOGETHER):
                sums[i] = weights.output_bias[o + i, 0]
            add_products(sums, weights.output, o * channels, channels, hidden, 0, 0, directions)
            wanted = min(_TOGETHER, len(output) - o)
            output[o : o + wanted, b] = sums[:wanted]
