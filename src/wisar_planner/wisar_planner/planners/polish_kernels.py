"""Compiled kernel of the polishing: how far waypoints are from the border of the area."""

from __future__ import annotations

import math

from numba import njit

from wisar_planner.errors import FloatArray


@njit(cache=True, nogil=True)
def trespass(points: FloatArray, edges: FloatArray, margin: float, push: FloatArray) -> float:
    """Return the sum of squares of how much nearer than `margin` to the border points are.

    Outside the area they count as nearer by as much as they are outside.

    Parameters
    ----------
    points : (N, 2) float64
        Points, m.
    edges : (E, 5) float64
        Edges of the area, see `polygon_edges`.
    margin : float
        Smallest distance wanted, m.
    push : (N, 2) float64
        The gradient of the sum; written.
    """
    total = 0.0
    for i in range(len(points)):
        x, y = points[i, 0], points[i, 1]
        push[i, 0] = push[i, 1] = 0.0
        nearest, away_x, away_y, inside = math.inf, 0.0, 0.0, False
        for e in range(len(edges)):
            x0, y0, x1, y1 = edges[e, 0], edges[e, 1], edges[e, 2], edges[e, 3]
            dx, dy = x1 - x0, y1 - y0
            if (y0 > y) != (y1 > y) and x < x0 + (y - y0) / dy * dx:
                inside = not inside
            # A vertex may be repeated: an edge without extent.
            along, extent = (x - x0) * dx + (y - y0) * dy, dx * dx + dy * dy
            along = (
                min(max(along / extent, 0.0), 1.0) if extent > 0.0 else 0.0
            )  # A repeated vertex.
            from_x, from_y = x - x0 - along * dx, y - y0 - along * dy
            square = from_x * from_x + from_y * from_y
            if square < nearest:
                nearest, away_x, away_y = square, from_x, from_y
        distance = math.sqrt(nearest)
        depth = distance if inside else -distance
        if depth >= margin or distance == 0.0:
            continue
        total += (margin - depth) ** 2
        scale = -2.0 * (margin - depth) / depth
        push[i, 0], push[i, 1] = scale * away_x, scale * away_y
    return total
