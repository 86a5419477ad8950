"""Compiled loops of the mass-keeping warp."""

from __future__ import annotations

import numpy as np
from numba import njit

from wisar_planner.errors import FloatArray

# A quadrilateral cut by four lines has at most eight corners.
_MOST_CORNERS = 8


@njit(cache=True)
def split_cells(corners: FloatArray, mass: FloatArray, target: FloatArray) -> None:
    """Add the mass of quadrilateral cells to the cells of a grid, split by overlap.

    Parameters
    ----------
    corners : (R + 1, C + 1, 2) float64
        Corners of the source cells in units of target columns and rows.
    mass : (R, C) float64
        Mass of the source cells.
    target : (rows, columns) float64
        Added to in place. What overlaps none of its cells goes to the nearest.
    """
    rows, columns = target.shape
    quad = np.empty((2, _MOST_CORNERS))
    half = np.empty((2, _MOST_CORNERS))
    strip = np.empty((2, _MOST_CORNERS))
    piece = np.empty((2, _MOST_CORNERS))
    for r in range(mass.shape[0]):
        for c in range(mass.shape[1]):
            if mass[r, c] == 0.0:
                continue
            for axis in range(2):
                quad[axis, 0] = corners[r, c, axis]
                quad[axis, 1] = corners[r, c + 1, axis]
                quad[axis, 2] = corners[r + 1, c + 1, axis]
                quad[axis, 3] = corners[r + 1, c, axis]
            density = mass[r, c] / _area(quad, 4)
            first, last = np.floor(quad[0, :4].min()), np.floor(quad[0, :4].max())
            for i in range(int(first), int(last) + 1):
                count = _cut(quad, 4, 0, i, 1.0, half)
                count = _cut(half, count, 0, i + 1, -1.0, strip)
                if count == 0:
                    continue
                column = min(max(i, 0), columns - 1)
                low, high = np.floor(strip[1, :count].min()), np.floor(strip[1, :count].max())
                for j in range(int(low), int(high) + 1):
                    corners_left = _cut(strip, count, 1, j, 1.0, half)
                    corners_left = _cut(half, corners_left, 1, j + 1, -1.0, piece)
                    row = min(max(j, 0), rows - 1)
                    target[row, column] += density * _area(piece, corners_left)


@njit(cache=True)
def _area(polygon: FloatArray, count: int) -> float:
    """Return the area of a polygon (2, count) by the shoelace formula."""
    total = 0.0
    for k in range(2, count):
        # About the first corner, so that large coordinates do not cancel.
        ax, ay = polygon[0, k - 1] - polygon[0, 0], polygon[1, k - 1] - polygon[1, 0]
        bx, by = polygon[0, k] - polygon[0, 0], polygon[1, k] - polygon[1, 0]
        total += ax * by - ay * bx
    return abs(total) / 2.0


@njit(cache=True)
def _cut(
    polygon: FloatArray, count: int, axis: int, bound: float, side: float, kept: FloatArray
) -> int:
    """Keep the part of a convex polygon on one side of an axis-parallel line.

    The clipping of Sutherland and Hodgman (1974) by one line; `side` is 1 to keep what is above
    `bound`, -1 to keep what is below. Returns the number of corners written to `kept`.
    """
    written = 0
    for k in range(count):
        following = (k + 1) % count
        here = side * (polygon[axis, k] - bound)
        there = side * (polygon[axis, following] - bound)
        if here >= 0.0:
            kept[0, written], kept[1, written] = polygon[0, k], polygon[1, k]
            written += 1
        if (here > 0.0 and there < 0.0) or (here < 0.0 and there > 0.0):
            share = here / (here - there)
            other = polygon[1 - axis, k]
            kept[1 - axis, written] = other + share * (polygon[1 - axis, following] - other)
            kept[axis, written] = bound
            written += 1
    return written
