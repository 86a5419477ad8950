"""Compiled kernel of the share of each grid cell that a polygon covers."""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from wisar_planner.errors import FloatArray


@njit(cache=True)
def coverage(
    edges: FloatArray, x0: float, y0: float, cell: float, rows: int, columns: int
) -> FloatArray:
    """Return the covered share of each cell, (rows, columns), of the polygon with these edges.

    Each edge is cut at the borders of cells. A piece of height h in a cell covers, to its right,
    h times the mean distance to the cell's right border there, and h of every cell further right:
    added up as differences along the row and summed from the left at the end.
    """
    change = np.zeros((rows, columns + 1))
    for e in range(len(edges)):
        ax, ay = (edges[e, 0] - x0) / cell, (edges[e, 1] - y0) / cell
        bx, by = (edges[e, 2] - x0) / cell, (edges[e, 3] - y0) / cell
        if ay == by:
            continue
        # The interior is to the left: it is to the right-hand side in x where the edge goes down.
        sign = 1.0
        if ay < by:
            sign = -1.0
        else:
            ax, ay, bx, by = bx, by, ax, ay
        slope = (bx - ax) / (by - ay)
        for row in range(max(0, math.floor(ay)), min(rows, math.ceil(by))):
            low, high = max(ay, float(row)), min(by, row + 1.0)
            if high <= low:
                continue
            left, right = ax + (low - ay) * slope, ax + (high - ay) * slope
            if left > right:
                left, right = right, left
            if left >= columns:
                continue
            height = sign * (high - low)
            if right <= 0.0:
                change[row, 0] += height
                continue
            width = right - left
            column = max(0, math.floor(left))
            if left < 0.0:  # What lies left of the grid covers its rows in full.
                change[row, 0] += height * (-left / width)
            while column < columns:
                start, end = max(left, float(column)), min(right, column + 1.0)
                share = height if width == 0.0 else height * max(end - start, 0.0) / width
                inside = share * (column + 1.0 - 0.5 * (start + end))
                change[row, column] += inside
                change[row, column + 1] += share - inside
                column += 1
                if right <= column:
                    break
    for row in range(rows):
        total = 0.0
        for column in range(columns):
            total += change[row, column]
            change[row, column] = total
    return change[:, :columns].copy()
