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


@njit(cache=True, nogil=True)
def see(
    unseen: Float32Array,
    before: Float32Array,
    start: Float32Array,
    end: Float32Array,
    step: Float32Array,
    radius: Float32Array,
    window: int,
    block: int,
) -> tuple[Float32Array, npt.NDArray[np.int64]]:
    """Take out what flights see; return how much that was, and the corners of what changed.

    Parameters
    ----------
    unseen : (B, rows, columns)
        The finest raster; changed.
    before : (B, 2)
        Where the last flight of each search began, NaN before the first; changed.
    start, end : (B, 2)
        Ends of the flights, in cells.
    step, radius : (B,)
        Step length and swath radius, in cells.
    window, block : int
        Side of the square that a step can touch, and what its corner is a multiple of.
    """
    searches, rows, columns = unseen.shape
    seen = np.zeros(searches, np.float32)
    corners = np.zeros((searches, 2), np.int64)
    for b in range(searches):
        half = 0.5 * (step[b] + 2.0 * radius[b]) + 1.0
        x0 = block * math.floor((0.5 * (start[b, 0] + end[b, 0]) - half) / block)
        y0 = block * math.floor((0.5 * (start[b, 1] + end[b, 1]) - half) / block)
        x0 = min(max(x0, 0), columns - window)
        y0 = min(max(y0, 0), rows - window)
        corners[b] = x0, y0
        first = math.isnan(before[b, 0])
        for y in range(y0, y0 + window):
            for x in range(x0, x0 + window):
                density = unseen[b, y, x]
                if density <= 0.0:
                    continue
                covered = _covered(x, y, start[b], end[b], radius[b])
                if covered == 0.0:
                    continue
                if not first:
                    overlap = _covered(x, y, before[b], start[b], radius[b])
                    covered = max(covered - overlap, 0.0) / max(1.0 - overlap, 1e-6)
                seen[b] += np.float32(density * covered)
                unseen[b, y, x] = np.float32(density - density * covered)
        before[b] = start[b]
    return seen, corners


@njit(cache=True, nogil=True)
def _covered(x: int, y: int, start: Float32Array, end: Float32Array, radius: float) -> float:
    """Return the share of a cell that the swath of a flight covers."""
    along_x, along_y = end[0] - start[0], end[1] - start[1]
    length = along_x * along_x + along_y * along_y
    px, py = x + 0.5 - start[0], y + 0.5 - start[1]
    share = (px * along_x + py * along_y) / max(length, 1e-12)
    share = min(max(share, 0.0), 1.0)
    dx, dy = px - share * along_x, py - share * along_y
    return min(max(radius - math.sqrt(dx * dx + dy * dy) + 0.5, 0.0), 1.0)


@njit(cache=True, nogil=True)
def average(
    fine: Float32Array, coarse: Float32Array, corners: npt.NDArray[np.int64], side: int, ratio: int
) -> None:
    """Set cells of a coarser raster to the means of blocks of `ratio` x `ratio` finer ones.

    Parameters
    ----------
    fine, coarse : (B, rows, columns)
        The rasters; the coarser one is changed.
    corners : (B, 2)
        Column and row of the first cells to set.
    side : int
        Cells to set along each side.
    ratio : int
        Finer cells per coarser one.
    """
    for b in range(len(fine)):
        for y in range(corners[b, 1], corners[b, 1] + side):
            for x in range(corners[b, 0], corners[b, 0] + side):
                total = 0.0
                for i in range(ratio * y, ratio * (y + 1)):
                    for j in range(ratio * x, ratio * (x + 1)):
                        total += fine[b, i, j]
                coarse[b, y, x] = np.float32(total / (ratio * ratio))


@njit(cache=True, nogil=True)
def interpolate(
    raster: Float32Array,
    scale: float,
    position: Float32Array,
    unit: Float32Array,
    reach: Float32Array,
    view: Float32Array,
) -> None:
    """Write the values at distances ahead in each direction, bilinear between cells.

    Parameters
    ----------
    raster : (B, rows, columns)
        The values.
    scale : float
        Cells of the raster per cell of the finest one.
    position : (B, 2)
        From where, in cells of the finest raster.
    unit : (B, D, 2)
        Unit vectors of the directions.
    reach : (B, R)
        Distances, in cells of the finest raster.
    view : (B, D, R)
        Where to.
    """
    searches, rows, columns = raster.shape
    for b in range(searches):
        for d in range(unit.shape[1]):
            for r in range(reach.shape[1]):
                x = (position[b, 0] + unit[b, d, 0] * reach[b, r]) * scale - 0.5
                y = (position[b, 1] + unit[b, d, 1] * reach[b, r]) * scale - 0.5
                j = min(max(math.floor(x), 0), columns - 2)
                i = min(max(math.floor(y), 0), rows - 2)
                u, v = min(max(x - j, 0.0), 1.0), min(max(y - i, 0.0), 1.0)
                lower = raster[b, i, j] + u * (raster[b, i, j + 1] - raster[b, i, j])
                upper = raster[b, i + 1, j] + u * (raster[b, i + 1, j + 1] - raster[b, i + 1, j])
                view[b, d, r] = np.float32(lower + v * (upper - lower))


@njit(cache=True, nogil=True)
def step_gains(
    unseen: Float32Array,
    position: Float32Array,
    unit: Float32Array,
    ahead: Float32Array,
    aside: Float32Array,
    gains: Float32Array,
) -> None:
    """Write the mean unseen density at points ahead and aside in each direction.

    Parameters
    ----------
    unseen : (B, rows, columns)
        The finest raster.
    position, unit
        As in `interpolate`.
    ahead, aside : (B, P)
        Where the points are, in cells.
    gains : (B, D)
        Where to.
    """
    searches, rows, columns = unseen.shape
    for b in range(searches):
        for d in range(unit.shape[1]):
            cos, sin = unit[b, d, 0], unit[b, d, 1]
            total = 0.0
            for p in range(ahead.shape[1]):
                x = position[b, 0] + ahead[b, p] * cos - aside[b, p] * sin
                y = position[b, 1] + ahead[b, p] * sin + aside[b, p] * cos
                j = min(max(math.floor(x), 0), columns - 1)
                i = min(max(math.floor(y), 0), rows - 1)
                total += max(unseen[b, i, j], np.float32(0.0))
            gains[b, d] = np.float32(total / ahead.shape[1])
