"""Compiled kernels that draw swaths on a raster of coverage counts.

Coordinates are in cells: the centre of the cell in row i and column j is the point (j, i).
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from numba import njit

from wisar_planner.errors import FloatArray
from wisar_planner.planners.cell_vectors import (
    BITS,
    CELLS,
    PERIODS,
    count_block,
    measure_block,
    tally_block,
)

TallyArray = npt.NDArray[np.int64]

# What `paint` does with the cells of a swath.
REMOVE, MEASURE, ADD = -1, 0, 1


class Canvas(NamedTuple):
    """What swaths are painted on.

    Attributes
    ----------
    counts : (rows, columns) uint32
        How many steps of each period see each cell, 8 bits for each of four periods: what a path
        sees until the end of each is known at any time. Where more than 255 steps of a period see
        one cell, that cell is valued wrongly as long as they do; removal stays exact.
    weights : (rows, columns) int32
        Probability of each cell in a fixed-point unit: whole numbers make removal the exact
        inverse of addition. See `most_weight`.
    spans : (2, rows) float64
        Room for the first and last cells of a swath in each row.
    sums : (4, 8) int32
        Room for sums of weights.
    """

    counts: npt.NDArray[np.uint32]
    weights: npt.NDArray[np.int32]
    spans: FloatArray
    sums: npt.NDArray[np.int32]

    @classmethod
    def of(cls, weights: npt.NDArray[np.int32]) -> Canvas:
        """Return a canvas on which nothing is painted.

        Raises
        ------
        ValueError
            When there are fewer than `CELLS` cells.
        """
        if weights.size < CELLS:
            raise ValueError(f"a canvas has {CELLS} cells at least, not {weights.size}")
        return cls(
            np.zeros(weights.shape, np.uint32),
            np.ascontiguousarray(weights, np.int32),
            np.empty((2, len(weights))),
            np.empty((PERIODS, CELLS), np.int32),
        )


def most_weight(step: float, radius: float) -> float:
    """Return the greatest weight of a cell for which sums over a swath hold 32 bits.

    Parameters
    ----------
    step, radius : float
        Step length and swath radius in cells.
    """
    # A row of n cells adds up to (n - 1) / CELLS + 1 weights to a sum, and every row to all of it.
    cells = 2.0 * radius * step + math.pi * radius**2
    return (2.0**31 - 1.0) / ((cells / CELLS) + 2.0 * (step + 2.0 * radius + 2.0))


@njit(cache=True, nogil=True, inline="always")
def period_of(step: int, steps: int) -> int:
    """Return the period, 0 to 3, of a step of a path with `steps` steps.

    Periods end after 1/8, 3/8, 3/4 and all of the path.
    """
    if 4 * step >= 3 * steps:
        return 3
    if 8 * step >= 3 * steps:
        return 2
    return 1 if 8 * step >= steps else 0


@njit(cache=True, nogil=True)
def paint(
    canvas: Canvas,
    ax: float,
    ay: float,
    bx: float,
    by: float,
    radius: float,
    period: int,
    mode: int,
    tally: TallyArray,
) -> int:
    """Add, remove or measure the swath of one step.

    Parameters
    ----------
    canvas : Canvas
        Its counts are changed unless `mode` is MEASURE.
    ax, ay, bx, by : float
        Ends of the step.
    radius : float
        Swath radius.
    period : int
        Period of the step.
    mode : int
        ADD, REMOVE or MEASURE.
    tally : (4,) int64
        Weight seen until the end of each period; kept up to date unless `mode` is MEASURE.

    Returns
    -------
    int
        Change of the weight that is seen in all; what adding would change for MEASURE.
    """
    counts, weights, sums = canvas.counts, canvas.weights, canvas.sums
    row, rows = _spans(canvas.spans, counts.shape, ax, ay, bx, by, radius)
    change = _change(period, mode)
    before = change if mode == REMOVE else np.uint32(0)
    after = change if mode == ADD else np.uint32(0)
    sums[:] = 0
    for k in range(rows):
        at, end = _run(canvas.spans, counts.shape, row, k)
        while at < end:
            first, low, high = _block(at, end, counts.size)
            if mode == MEASURE:
                measure_block(counts, weights, first, low, high, sums)
            else:
                tally_block(counts, weights, first, low, high, before, after, sums)
            at = first + CELLS
    if mode == MEASURE:
        return _total(sums, PERIODS - 1)
    for until in range(period, PERIODS):
        tally[until] += mode * _total(sums, until)
    return mode * _total(sums, PERIODS - 1)


@njit(cache=True, nogil=True, inline="always")
def _total(sums: npt.NDArray[np.int32], period: int) -> int:
    total = np.int64(0)
    for c in range(CELLS):
        total += sums[period, c]
    return total


@njit(cache=True, nogil=True, inline="always")
def _change(period: int, mode: int) -> np.uint32:
    """Return what a step of a period adds to a count, or its inverse."""
    one = np.uint32(1) << np.uint32(BITS * period)
    return np.uint32(one) if mode == ADD else np.uint32(-np.int64(one))


@njit(cache=True, nogil=True)
def _spans(
    spans: FloatArray,
    shape: tuple[int, int],
    ax: float,
    ay: float,
    bx: float,
    by: float,
    radius: float,
) -> tuple[int, int]:
    """Write the first and last column of a swath in each row; return the first row and how many.

    The cells whose centre lies within `radius` of the segment form one run in each row, because the
    swath is convex.
    """
    if ay > by:
        ax, bx = bx, ax
        ay, by = by, ay
    dx, dy = bx - ax, by - ay
    length = math.sqrt(dx * dx + dy * dy)
    ux, uy = (dx / length, dy / length) if length > 0.0 else (1.0, 0.0)
    # The straight sides touch the discs about the ends at these heights, left and right.
    left_low, left_high = ay + radius * ux, by + radius * ux
    right_low, right_high = ay - radius * ux, by - radius * ux
    left_x, right_x = ax - radius * uy, ax + radius * uy
    slope = dx / dy if dy > 1e-9 else 0.0
    square = radius * radius
    row = max(0, math.ceil(ay - radius))
    rows = min(shape[0] - 1, math.floor(by + radius)) - row + 1
    for k in range(rows):
        # Without a branch, so that the compiler makes vectors of it.
        y = float(row) + float(k)
        low = math.sqrt(max(0.0, square - (y - ay) ** 2))
        high = math.sqrt(max(0.0, square - (y - by) ** 2))
        left, right = left_x + (y - left_low) * slope, right_x + (y - right_low) * slope
        left = ax - low if y <= left_low else (bx - high if y >= left_high else left)
        right = ax + low if y <= right_low else (bx + high if y >= right_high else right)
        spans[0, k] = np.ceil(max(0.0, left))
        spans[1, k] = np.floor(min(float(shape[1] - 1), right))
    return row, rows


@njit(cache=True, nogil=True, inline="always")
def _run(spans: FloatArray, shape: tuple[int, int], row: int, k: int) -> tuple[int, int]:
    """Return the flat indices of the first cell of a row's run and of the one after its last."""
    start = (row + k) * shape[1]
    return start + np.int64(spans[0, k]), start + np.int64(spans[1, k]) + 1


@njit(cache=True, nogil=True, inline="always")
def _block(at: int, end: int, size: int) -> tuple[int, np.int32, np.int32]:
    """Return the block of cells from `at` on, and which of its cells lie in a run until `end`.

    At the end of a raster of `size` cells the block begins before `at`.
    """
    first = min(at, size - CELLS)
    return first, np.int32(at - first), np.int32(min(end - first, CELLS))


@njit(cache=True, nogil=True)
def paint_path(
    canvas: Canvas,
    points: FloatArray,
    first: int,
    last: int,
    radius: float,
    mode: int,
    tally: TallyArray,
) -> None:
    """Add or remove the steps of a path between the points `first` and `last`; see `paint`."""
    steps = len(points) - 1
    for i in range(first, last):
        paint(
            canvas, points[i, 0], points[i, 1], points[i + 1, 0], points[i + 1, 1],
            radius, period_of(i, steps), mode, tally,
        )  # fmt: skip


@njit(cache=True, nogil=True)
def count_path(
    canvas: Canvas, points: FloatArray, first: int, last: int, radius: float, mode: int
) -> None:
    """Do what `paint_path` does to the counts, in half the time, for whoever has the tally."""
    counts, steps = canvas.counts, len(points) - 1
    for i in range(first, last):
        row, rows = _spans(
            canvas.spans, counts.shape,
            points[i, 0], points[i, 1], points[i + 1, 0], points[i + 1, 1], radius,
        )  # fmt: skip
        change = _change(period_of(i, steps), mode)
        for k in range(rows):
            at, end = _run(canvas.spans, counts.shape, row, k)
            while at < end:
                first_cell, low, high = _block(at, end, counts.size)
                count_block(counts, first_cell, low, high, change)
                at = first_cell + CELLS


@njit(cache=True, nogil=True)
def path_value(tally: TallyArray, early_weight: float) -> float:
    """Return the value of a path: what it sees, and what it sees early once more.

    `early_weight` times the mean of the weights seen after 1/8, 3/8 and 3/4 of the path is added to
    the weight seen in all.
    """
    return tally[3] + early_weight / 3.0 * (tally[0] + tally[1] + tally[2])
