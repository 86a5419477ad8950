"""Eight cells of a raster at a time, for compiled kernels.

The runs of cells that a swath covers are a dozen cells long: too short for the vector loops that
the compiler makes of plain ones, which begin at 16 or 32 cells. These intrinsics write the vector
instructions themselves, in LLVM's own language, so that they run on any processor.

A block is `CELLS` cells from the flat index `at` on, of which those from `low` to before `high`
count.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from llvmlite import ir
from numba import types
from numba.extending import intrinsic

from wisar_planner.vectors import pointer, require, spread, zeros

#: Cells per block.
CELLS = 8
#: Periods that a cell's count is split into, and the bits that each has.
PERIODS, BITS = 4, 8

_INT = ir.IntType(32)
_VECTOR = ir.VectorType(_INT, CELLS)
_ZEROS = zeros(_VECTOR)
_PLACE = (types.int64, types.int32, types.int32)
_INDICES = ir.Constant(_VECTOR, list(range(CELLS)))


class _Block:
    """What the intrinsics have in common: loads, stores and the choice of cells."""

    def __init__(self, context: Any, builder: Any, low: Any, high: Any) -> None:
        self.context, self.builder = context, builder
        above = builder.icmp_signed(">=", _INDICES, self.spread(low))
        below = builder.icmp_signed("<", _INDICES, self.spread(high))
        self.chosen = builder.and_(above, below)

    def spread(self, value: Any) -> Any:
        """Return a block of one number."""
        return spread(self.builder, value, _VECTOR)

    def pointer(self, kind: Any, array: Any, at: Any) -> Any:
        """Return where a block of an array begins."""
        return pointer(self.context, self.builder, kind, array, at, _VECTOR)

    def load(self, pointer: Any) -> Any:
        """Return a block."""
        return self.builder.load(pointer, align=4)

    def store(self, block: Any, pointer: Any) -> None:
        """Write a block."""
        self.builder.store(block, pointer, align=4)

    def where(self, condition: Any, block: Any) -> Any:
        """Return a block with zeros where the condition does not hold."""
        return self.builder.select(condition, block, _ZEROS)

    def unseen(self, counts: Any, period: int) -> Any:
        """Return where no step until the end of a period sees."""
        mask = ir.Constant(_VECTOR, [(1 << BITS * (period + 1)) - 1] * CELLS)
        return self.builder.icmp_unsigned("==", self.builder.and_(counts, mask), _ZEROS)

    def add_unseen(self, counts: Any, weights: Any, period: int, pointer: Any) -> None:
        """Add the weights that are not seen until the end of a period to a block of sums."""
        gain = self.where(self.unseen(counts, period), weights)
        self.store(self.builder.add(self.load(pointer), gain), pointer)


def _tally_block(
    _: Any,
    counts: Any,
    weights: Any,
    at: Any,
    low: Any,
    high: Any,
    before: Any,
    after: Any,
    sums: Any,
) -> tuple[Any, Any]:
    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        counts, weights, at, low, high, before, after, sums = arguments
        block = _Block(context, builder, low, high)
        place = block.pointer(signature.args[0], counts, at)
        count = builder.add(block.load(place), block.where(block.chosen, block.spread(before)))
        weight = block.load(block.pointer(signature.args[1], weights, at))
        weight = block.where(block.chosen, weight)
        for period in range(PERIODS):
            first = ir.Constant(ir.IntType(64), period * CELLS)
            block.add_unseen(count, weight, period, block.pointer(signature.args[7], sums, first))
        after = block.where(block.chosen, block.spread(after))
        block.store(builder.add(count, after), place)
        return context.get_dummy_value()

    require(types.uint32, counts)
    require(types.int32, weights, sums)
    change = types.uint32
    return types.void(counts, weights, *_PLACE, change, change, sums), generate


def _measure_block(
    _: Any, counts: Any, weights: Any, at: Any, low: Any, high: Any, sums: Any
) -> tuple[Any, Any]:
    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        counts, weights, at, low, high, sums = arguments
        block = _Block(context, builder, low, high)
        count = block.load(block.pointer(signature.args[0], counts, at))
        weight = block.load(block.pointer(signature.args[1], weights, at))
        weight = block.where(block.chosen, weight)
        last = ir.Constant(ir.IntType(64), (PERIODS - 1) * CELLS)
        block.add_unseen(count, weight, PERIODS - 1, block.pointer(signature.args[5], sums, last))
        return context.get_dummy_value()

    require(types.uint32, counts)
    require(types.int32, weights, sums)
    return types.void(counts, weights, *_PLACE, sums), generate


def _count_block(_: Any, counts: Any, at: Any, low: Any, high: Any, change: Any) -> tuple[Any, Any]:
    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        counts, at, low, high, change = arguments
        block = _Block(context, builder, low, high)
        place = block.pointer(signature.args[0], counts, at)
        change = block.where(block.chosen, block.spread(change))
        block.store(builder.add(block.load(place), change), place)
        return context.get_dummy_value()

    require(types.uint32, counts)
    return types.void(counts, *_PLACE, types.uint32), generate


#: ``tally_block(counts, weights, at, low, high, before, after, sums)`` adds `before` to the counts
#: of a block, sums what is unseen then, and adds `after`: `sums`, (PERIODS, CELLS) int32, gain the
#: weight unseen until the end of each period, cell by cell.
tally_block: Callable[..., None] = intrinsic(_tally_block)
#: ``measure_block(counts, weights, at, low, high, sums)`` changes nothing but the sums of the last
#: period, by the weight that no step sees.
measure_block: Callable[..., None] = intrinsic(_measure_block)
#: ``count_block(counts, at, low, high, change)`` adds `change` to the counts of a block.
count_block: Callable[..., None] = intrinsic(_count_block)
