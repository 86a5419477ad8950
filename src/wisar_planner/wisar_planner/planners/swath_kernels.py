"""Compiled kernels that draw swaths on a raster of coverage counts.

Coordinates are in cells: the centre of the cell in row i and column j is the point (j, i).
"""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt
from numba import njit

from wisar_planner.errors import FloatArray

CountArray = npt.NDArray[np.uint64]
WeightArray = npt.NDArray[np.int32]
KindArray = npt.NDArray[np.uint8]
TallyArray = npt.NDArray[np.int64]

# What `paint` does with the cells of a swath.
REMOVE, MEASURE, ADD = -1, 0, 1

# Steps fall into periods, which end after 1/8, 3/8, 3/4 and all of the path. A cell counts the
# steps of each in 16 bits of its own, so that what the path sees until the end of each period is
# known at any time.
PERIODS = 4
_BITS = 16

# Kinds of cells with respect to the area.
OUTSIDE, INSIDE, BORDER = 0, 1, 2


@njit(cache=True, nogil=True, inline="always")
def period_of(step: int, steps: int) -> int:
    """Return the period, 0 to 3, of a step of a path with `steps` steps."""
    if 4 * step >= 3 * steps:
        return 3
    if 8 * step >= 3 * steps:
        return 2
    return 1 if 8 * step >= steps else 0


@njit(cache=True, nogil=True)
def paint(
    counts: CountArray,
    weights: WeightArray,
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

    The cells whose centre lies within `radius` of the segment form one run in each row, because the
    swath is convex.

    Parameters
    ----------
    counts : (rows, columns) uint64
        How many steps of each period see each cell; changed unless `mode` is MEASURE.
    weights : (rows, columns) int32
        Probability of each cell in a fixed-point unit: whole numbers make removal the exact
        inverse of addition.
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
    rows, columns = counts.shape
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
    one = np.uint64(1) << np.uint64(_BITS * period)
    total = 0
    for y in range(max(0, math.ceil(ay - radius)), min(rows - 1, math.floor(by + radius)) + 1):
        if y <= left_low:
            left = ax - math.sqrt(max(0.0, square - (y - ay) ** 2))
        elif y >= left_high:
            left = bx - math.sqrt(max(0.0, square - (y - by) ** 2))
        else:
            left = left_x + (y - left_low) * slope
        if y <= right_low:
            right = ax + math.sqrt(max(0.0, square - (y - ay) ** 2))
        elif y >= right_high:
            right = bx + math.sqrt(max(0.0, square - (y - by) ** 2))
        else:
            right = right_x + (y - right_low) * slope
        first, last = max(0, math.ceil(left)), min(columns - 1, math.floor(right))
        if last < first:
            continue
        count, weight = counts[y, first : last + 1], weights[y, first : last + 1]
        if mode == MEASURE:
            total += _unseen(count, weight, PERIODS - 1)
        elif mode == ADD:
            for until in range(period, PERIODS):
                run = _unseen(count, weight, until)
                tally[until] += run
            total += run
            for c in range(len(count)):
                count[c] += one
        else:
            for c in range(len(count)):
                count[c] -= one
            for until in range(period, PERIODS):
                run = _unseen(count, weight, until)
                tally[until] -= run
            total -= run
    return total


@njit(cache=True, nogil=True, inline="always")
def _unseen(count: CountArray, weight: WeightArray, until: int) -> int:
    """Return the weight of the cells of a run that no step sees until the end of a period."""
    mask = np.uint64(0xFFFFFFFFFFFFFFFF) >> np.uint64(_BITS * (PERIODS - 1 - until))
    run = np.int32(0)  # A row of one swath fits 32 bits; that lets the loop vectorise.
    for c in range(len(count)):
        run += weight[c] if (count[c] & mask) == 0 else np.int32(0)
    return run


@njit(cache=True, nogil=True)
def paint_path(
    counts: CountArray,
    weights: WeightArray,
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
            counts, weights,
            points[i, 0], points[i, 1], points[i + 1, 0], points[i + 1, 1],
            radius, period_of(i, steps), mode, tally,
        )  # fmt: skip


@njit(cache=True, nogil=True)
def path_value(tally: TallyArray, early_weight: float) -> float:
    """Return the value of a path: what it sees, and what it sees early once more.

    `early_weight` times the mean of the weights seen after 1/8, 3/8 and 3/4 of the path is added to
    the weight seen in all.
    """
    return tally[3] + early_weight / 3.0 * (tally[0] + tally[1] + tally[2])


@njit(cache=True, nogil=True)
def classify(kinds: KindArray, edges: FloatArray) -> None:
    """Write the kind of every cell.

    Parameters
    ----------
    kinds : (rows, columns) uint8
        INSIDE or OUTSIDE by the cell's centre; BORDER for all cells that an edge touches, and some
        beside them.
    edges : (E, 4) float64
        Edges of all rings of the area, x0, y0, x1, y1.
    """
    rows, columns = kinds.shape
    kinds[:] = OUTSIDE
    crossings = np.empty(len(edges))
    for row in range(rows):
        count = 0
        for e in range(len(edges)):
            x0, y0, x1, y1 = edges[e, 0], edges[e, 1], edges[e, 2], edges[e, 3]
            if (y0 > row) != (y1 > row):
                crossings[count] = x0 + (row - y0) / (y1 - y0) * (x1 - x0)
                count += 1
        crossings[:count].sort()
        for pair in range(0, count - 1, 2):
            first = max(0, math.ceil(crossings[pair]))
            last = min(columns - 1, math.floor(crossings[pair + 1]))
            for column in range(first, last + 1):
                kinds[row, column] = INSIDE
    for e in range(len(edges)):
        x0, y0, x1, y1 = edges[e, 0], edges[e, 1], edges[e, 2], edges[e, 3]
        # Samples a cell apart or closer: the 3 x 3 cells about each hold all that the edge touches.
        samples = 1 + math.ceil(math.hypot(x1 - x0, y1 - y0))
        for s in range(samples + 1):
            share = s / samples
            row = math.floor(y0 + share * (y1 - y0) + 0.5)
            column = math.floor(x0 + share * (x1 - x0) + 0.5)
            for r in range(max(0, row - 1), min(rows, row + 2)):
                for c in range(max(0, column - 1), min(columns, column + 2)):
                    kinds[r, c] = BORDER


@njit(cache=True, nogil=True)
def inside(kinds: KindArray, edges: FloatArray, x: float, y: float) -> bool:
    """Return whether a point lies in the area.

    Parameters
    ----------
    kinds : (rows, columns) uint8
        OUTSIDE, INSIDE or BORDER for each cell.
    edges : (E, 4) float64
        Edges of all rings of the area, x0, y0, x1, y1; looked at in border cells alone.
    x, y : float
        The point.
    """
    row, column = math.floor(y + 0.5), math.floor(x + 0.5)
    if row < 0 or column < 0 or row >= kinds.shape[0] or column >= kinds.shape[1]:
        return False
    kind = kinds[row, column]
    if kind != BORDER:
        return kind == INSIDE
    odd = False
    for e in range(len(edges)):
        x0, y0, x1, y1 = edges[e, 0], edges[e, 1], edges[e, 2], edges[e, 3]
        if (y0 > y) != (y1 > y) and x < x0 + (y - y0) / (y1 - y0) * (x1 - x0):
            odd = not odd
    return odd
