"""Compiled kernels of what the policy sees, for NumPy: a plan looks at thousands of points a step.

They compute what `unseen_map` and `observation` say in array operations, in an order that needs no
intermediate arrays; tests compare the two.
"""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt
from numba import njit

Float32Array = npt.NDArray[np.float32]
# Arrays of the levels, the finest first.
Levels = tuple[Float32Array, Float32Array, Float32Array]


@njit(cache=True, nogil=True)
def see(
    levels: Levels,
    before: Float32Array,
    start: Float32Array,
    end: Float32Array,
    radius: Float32Array,
    window: int,
    block: int,
    ratio: int,
) -> Float32Array:
    """Take out what flights see; return how much that was, (B,).

    Parameters
    ----------
    levels : three (B, rows, columns) arrays
        The rasters, the finest first; changed.
    before : (B, 2)
        Where the last flight of each search began, NaN before the first; changed.
    start, end : (B, 2)
        Ends of the flights, in cells.
    radius : (B,)
        Swath radius, in cells.
    window, block : int
        Side of the square that a step can touch, and what its corner is a multiple of.
    ratio : int
        Cells of a raster per cell of the next one.
    """
    unseen = levels[0]
    searches, rows, columns = unseen.shape
    # So far may the window's corner lie from the middle of a flight.
    half = 0.5 * (window - block + 1)
    seen = np.zeros(searches, np.float32)
    for b in range(searches):
        ax, ay = start[b]
        bx, by = end[b]
        cx, cy = before[b]
        x0 = block * math.floor((0.5 * (ax + bx) - half) / block)
        y0 = block * math.floor((0.5 * (ay + by) - half) / block)
        x0 = min(max(x0, 0), columns - window)
        y0 = min(max(y0, 0), rows - window)
        for y in range(y0, y0 + window):
            for x in range(x0, x0 + window):
                density = unseen[b, y, x]
                if density <= 0.0:
                    continue
                covered = _covered(x, y, ax, ay, bx, by, radius[b])
                if covered == 0.0:
                    continue
                if not math.isnan(cx):
                    overlap = _covered(x, y, cx, cy, ax, ay, radius[b])
                    covered = max(covered - overlap, 0.0) / max(1.0 - overlap, 1e-6)
                seen[b] += np.float32(density * covered)
                unseen[b, y, x] = np.float32(density - density * covered)
        before[b] = start[b]
        _average(levels[0][b], levels[1][b], x0, y0, window, ratio)
        x0, y0, side = x0 // ratio, y0 // ratio, window // ratio
        _average(levels[1][b], levels[2][b], x0, y0, side, ratio)
    return seen


@njit(cache=True, nogil=True)
def _covered(x: int, y: int, ax: float, ay: float, bx: float, by: float, radius: float) -> float:
    """Return the share of a cell that the swath of a flight from (ax, ay) to (bx, by) covers."""
    along_x, along_y = bx - ax, by - ay
    length = along_x * along_x + along_y * along_y
    px, py = x + 0.5 - ax, y + 0.5 - ay
    share = (px * along_x + py * along_y) / max(length, 1e-12)
    share = min(max(share, 0.0), 1.0)
    dx, dy = px - share * along_x, py - share * along_y
    square = dx * dx + dy * dy
    # Most cells of a window are farther off.
    if square >= (radius + 0.5) ** 2:
        return 0.0
    return min(max(radius - math.sqrt(square) + 0.5, 0.0), 1.0)


@njit(cache=True, nogil=True)
def _average(
    fine: Float32Array, coarse: Float32Array, x0: int, y0: int, side: int, ratio: int
) -> None:
    """Set cells of a coarser raster to the means of blocks of `ratio` x `ratio` finer ones.

    Parameters
    ----------
    fine, coarse : (rows, columns)
        The rasters; the coarser one is changed.
    x0, y0 : int
        Column and row of the first of the finer cells.
    side : int
        Finer cells along each side.
    ratio : int
        Finer cells per coarser one.
    """
    for y in range(y0 // ratio, (y0 + side) // ratio):
        for x in range(x0 // ratio, (x0 + side) // ratio):
            total = 0.0
            for i in range(ratio * y, ratio * (y + 1)):
                for j in range(ratio * x, ratio * (x + 1)):
                    total += fine[i, j]
            coarse[y, x] = np.float32(total / (ratio * ratio))


@njit(cache=True, nogil=True)
def write_view(
    levels: Levels,
    ratio: int,
    position: Float32Array,
    heading: Float32Array,
    distances: Levels,
    swath: Levels,
    step: Float32Array,
    radius: Float32Array,
    brightest: float,
    view: Float32Array,
) -> None:
    """Write the view of searches, see `observation.Observation`.

    Parameters
    ----------
    levels : three (B, rows, columns) arrays
        Unseen density, the finest raster first.
    ratio : int
        Cells of a raster per cell of the next one.
    position : (B, 2)
        From where, in cells of the finest raster.
    heading : (B,)
        Where the first direction points, rad.
    distances : three (R,) arrays
        Distances that are read from each level, in steps.
    swath : three (P,) arrays
        Points on a step's swath, see `observation`.
    step, radius : (B,)
        Step length and swath radius, in cells of the finest raster.
    brightest : float
        Greatest density that is written.
    view : (B, D, R's + 1)
        Where to: the density at the distances of all levels, then the mean density of the swath.
    """
    ahead, aside = np.empty_like(swath[0]), np.empty_like(swath[0])
    cells = np.empty(len(ahead), np.int64)
    for b in range(len(position)):
        for p in range(len(ahead)):
            ahead[p] = swath[0][p] * step[b] + swath[2][p] * radius[b]
            aside[p] = swath[1][p] * radius[b]
        x, y = position[b]
        directions = view.shape[1]
        for d in range(directions):
            angle = heading[b] + np.float32(2.0 * math.pi * d / directions)
            cos, sin = math.cos(angle), math.sin(angle)
            column, scale = 0, np.float32(1.0)
            for level in range(len(levels)):
                for distance in distances[level]:
                    reach = step[b] * distance
                    density = _interpolated(
                        levels[level][b], scale * (x + cos * reach), scale * (y + sin * reach)
                    )
                    view[b, d, column] = min(density, brightest)
                    column += 1
                scale /= np.float32(ratio)
            density = _mean_ahead(levels[0][b], x, y, cos, sin, ahead, aside, cells)
            view[b, d, column] = min(density, brightest)


@njit(cache=True, nogil=True)
def _interpolated(raster: Float32Array, x: float, y: float) -> float:
    """Return the value at a point, bilinear between cells."""
    rows, columns = raster.shape
    x, y = x - np.float32(0.5), y - np.float32(0.5)
    # For what is not negative, cutting off is rounding down, and much faster.
    j = int(min(max(x, np.float32(0.0)), np.float32(columns - 2)))
    i = int(min(max(y, np.float32(0.0)), np.float32(rows - 2)))
    u = min(max(x - np.float32(j), np.float32(0.0)), np.float32(1.0))
    v = min(max(y - np.float32(i), np.float32(0.0)), np.float32(1.0))
    lower = raster[i, j] + u * (raster[i, j + 1] - raster[i, j])
    upper = raster[i + 1, j] + u * (raster[i + 1, j + 1] - raster[i + 1, j])
    return lower + v * (upper - lower)


@njit(cache=True, nogil=True)
def _mean_ahead(
    unseen: Float32Array,
    x: float,
    y: float,
    cos: float,
    sin: float,
    ahead: Float32Array,
    aside: Float32Array,
    cells: npt.NDArray[np.int64],
) -> float:
    """Return the mean unseen density at points ahead and aside; `cells` is room for as many."""
    zero = np.float32(0.0)
    rows, columns = unseen.shape
    right, top = np.float32(columns - 1), np.float32(rows - 1)
    # Where the cells are in one loop, which the compiler makes vectors of, reading in another.
    for p in range(len(ahead)):
        column = min(max(x + ahead[p] * cos - aside[p] * sin, zero), right)
        row = min(max(y + ahead[p] * sin + aside[p] * cos, zero), top)
        cells[p] = np.int32(row) * np.int32(columns) + np.int32(column)
    flat = unseen.reshape(-1)
    total = zero
    for p in range(len(ahead)):
        total += max(flat[cells[p]], zero)
    return total / np.float32(len(ahead))


@njit(cache=True, nogil=True)
def write_numbers(
    levels: Levels,
    steps_left: Float32Array,
    scales: tuple[float, float, float, float],
    step: Float32Array,
    radius: Float32Array,
    brightest: float,
    numbers: Float32Array,
) -> None:
    """Write the numbers of searches, see `observation.Observation`.

    Parameters
    ----------
    levels, step, radius, brightest
        As in `write_view`.
    steps_left : (B,)
        Steps that the searches have left.
    scales : four floats
        Scales of the steps left.
    numbers : (B, NUMBERS)
        Where to.
    """
    for b in range(len(numbers)):
        for k in range(4):
            numbers[b, k] = math.exp(-steps_left[b] / scales[k])
        numbers[b, 4] = math.log(steps_left[b]) / 4.0
        numbers[b, 5] = radius[b] / step[b]
        for level in (1, 2):
            numbers[b, 5 + level] = min(levels[level][b].max(), brightest)
