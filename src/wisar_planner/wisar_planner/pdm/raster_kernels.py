"""Compiled kernels of the raster map.

Inside a kernel lengths are in cells: column i spans [i, i + 1), row j spans [j, j + 1).
`prefix[j, i]` is the probability in row j left of column i.
"""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt
from numba import njit

from wisar_planner.errors import FloatArray

_HALF_PI = 0.5 * math.pi


@njit(cache=True)
def _row_function(prefix: FloatArray, row: int, column: int) -> tuple[float, float]:
    """Return (a, b) such that a + b x is the probability of row `row` left of x in a column."""
    columns = prefix.shape[1] - 1
    if row < 0 or row >= prefix.shape[0] or column < 0:
        return 0.0, 0.0
    if column >= columns:
        return prefix[row, columns], 0.0
    b = prefix[row, column + 1] - prefix[row, column]
    return prefix[row, column] - b * column, b


@njit(cache=True)
def _border(index: int, limit: int, forward: bool) -> float:
    """Return the next border in the direction of travel; infinite beyond the grid."""
    if forward:
        return math.inf if index >= limit else max(index + 1.0, 0.0)
    return -math.inf if index < 0 else min(float(index), float(limit))


@njit(cache=True)
def _along_segment(x0: float, y0: float, x1: float, y1: float, prefix: FloatArray) -> float:
    """Return the integral of the row function dy along a segment."""
    rows, columns = prefix.shape[0], prefix.shape[1] - 1
    dx, dy = x1 - x0, y1 - y0
    if dy == 0.0:
        return 0.0
    column = min(max(math.floor(x0), -1), columns)
    row = min(max(math.floor(y0), -1), rows)
    # On a border, the cell ahead.
    if dx < 0.0 and x0 == column and column >= 0:
        column -= 1
    if dy < 0.0 and y0 == row and row >= 0:
        row -= 1
    total = 0.0
    t = 0.0
    while t < 1.0:
        tx = (_border(column, columns, dx > 0.0) - x0) / dx if dx != 0.0 else math.inf
        ty = (_border(row, rows, dy > 0.0) - y0) / dy
        after = max(min(tx, ty, 1.0), t)
        a, b = _row_function(prefix, row, column)
        total += (a + b * (x0 + 0.5 * (t + after) * dx)) * dy * (after - t)
        if tx <= after:
            column = column + 1 if dx > 0.0 else column - 1
        if ty <= after:
            row = row + 1 if dy > 0.0 else row - 1
        t = after
    return total


@njit(cache=True)
def _angle_at_x(cosine: float, quadrant: int) -> float:
    """Return the angle in [0, 2 pi] of the given quadrant with that cosine."""
    angle = math.acos(min(max(cosine, -1.0), 1.0))
    return angle if quadrant < 2 else 2.0 * math.pi - angle


@njit(cache=True)
def _angle_at_y(sine: float, quadrant: int) -> float:
    """Return the angle in [0, 2 pi] of the given quadrant with that sine."""
    angle = math.asin(min(max(sine, -1.0), 1.0))
    if quadrant == 0:
        return angle
    return math.pi - angle if quadrant < 3 else 2.0 * math.pi + angle


@njit(cache=True)
def _along_arc(
    cx: float, cy: float, theta0: float, theta1: float, radius: float, prefix: FloatArray
) -> float:
    """Return the integral of the row function dy along an arc that turns left."""
    rows, columns = prefix.shape[0], prefix.shape[1] - 1
    total = 0.0
    theta = theta0
    quarter = math.floor(theta0 / _HALF_PI)
    while theta < theta1:
        # In one quadrant, x and y go one way each.
        end = min(theta1, (quarter + 1) * _HALF_PI)
        quadrant = quarter % 4
        turns = (quarter - quadrant) * _HALF_PI
        right, up = quadrant >= 2, quadrant == 0 or quadrant == 3
        x, y = cx + radius * math.cos(theta), cy + radius * math.sin(theta)
        column = min(max(math.floor(x), -1), columns)
        row = min(max(math.floor(y), -1), rows)
        while theta < end:
            next_x = _border(column, columns, right) - cx
            next_y = _border(row, rows, up) - cy
            at_x = turns + _angle_at_x(next_x / radius, quadrant)
            at_y = turns + _angle_at_y(next_y / radius, quadrant)
            if abs(next_x) > radius:  # Out of reach, unless just passed by rounding.
                at_x = math.inf
            if abs(next_y) > radius:
                at_y = math.inf
            after = max(min(at_x, at_y, end), theta)
            a, b = _row_function(prefix, row, column)
            rise = radius * (math.sin(after) - math.sin(theta))
            bulge = 0.5 * (after - theta) + 0.25 * (math.sin(2.0 * after) - math.sin(2.0 * theta))
            total += (a + b * cx) * rise + b * radius * radius * bulge
            if at_x <= after:
                column = column + 1 if right else column - 1
            if at_y <= after:
                row = row + 1 if up else row - 1
            theta = after
        quarter += 1
    return total


@njit(cache=True)
def integrate_boundary(
    pieces: FloatArray,
    owners: npt.NDArray[np.int64],
    count: int,
    prefix: FloatArray,
    x0: float,
    y0: float,
    cell: float,
) -> FloatArray:
    r"""Return the probability of the raster in each of `count` regions given by their boundaries.

    Green's theorem: :math:`\oint P(x, y) \, dy`, where P is the probability per length of the row
    left of x. In a cell P is linear in x, so pieces cut at cell borders integrate in closed form.
    """
    result = np.zeros(count)
    for i in range(len(pieces)):
        px, py, a, b, radius = pieces[i]
        px, py = (px - x0) / cell, (py - y0) / cell
        if radius == 0.0:
            part = _along_segment(px, py, (a - x0) / cell, (b - y0) / cell, prefix)
        elif b >= a:
            part = _along_arc(px, py, a, b, radius / cell, prefix)
        else:
            part = -_along_arc(px, py, b, a, radius / cell, prefix)
        result[owners[i]] += part
    return result
