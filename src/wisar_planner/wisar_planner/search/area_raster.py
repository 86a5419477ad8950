"""The search area on a raster, for compiled kernels that ask of thousands of points.

Coordinates are in cells: the centre of the cell in row i and column j is the point (j, i).
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
import shapely
from numba import njit

from wisar_planner.errors import FloatArray
from wisar_planner.pdm.grid import Grid
from wisar_planner.search.area import is_convex

KindArray = npt.NDArray[np.uint8]

#: Kinds of cells with respect to the area.
OUTSIDE, INSIDE, BORDER = 0, 1, 2


class AreaRaster(NamedTuple):
    """A polygon on a raster.

    Attributes
    ----------
    kinds : (rows, columns) uint8
        INSIDE or OUTSIDE by the cell's centre; BORDER for all cells that an edge touches, and some
        beside them.
    edges : (E, 4) float64
        Edges of all rings, x0, y0, x1, y1; looked at in border cells alone.
    convex : bool
        Whether a straight leg between points of the area always stays inside.
    """

    kinds: KindArray
    edges: FloatArray
    convex: bool

    @classmethod
    def of(cls, polygon: shapely.Polygon | shapely.MultiPolygon, grid: Grid) -> AreaRaster:
        """Return a polygon on the cells of a grid; both in metres."""
        edges = [np.empty((0, 4))]
        for ring in shapely.get_rings(shapely.get_parts(polygon)):
            metres = shapely.get_coordinates(ring)
            vertices = (metres - (grid.x0, grid.y0)) / grid.cell - 0.5
            edges.append(np.concatenate([vertices[:-1], vertices[1:]], axis=1))
        kinds = np.empty((grid.rows, grid.columns), np.uint8)
        area = cls(kinds, np.concatenate(edges), is_convex(polygon))
        _classify(area)
        return area

    def centres_inside(self) -> npt.NDArray[np.bool_]:
        """Return which cells have their centre inside, (rows, columns)."""
        found = self.kinds == INSIDE
        rows, columns = np.nonzero(self.kinds == BORDER)
        found[rows, columns] = _points_inside(self, columns, rows)
        return found


@njit(cache=True, nogil=True)
def _classify(area: AreaRaster) -> None:
    """Write the kind of every cell."""
    kinds, edges = area.kinds, area.edges
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
def inside(area: AreaRaster, x: float, y: float) -> bool:
    """Return whether a point lies in the area; beyond the raster nothing does."""
    kinds, edges = area.kinds, area.edges
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


@njit(cache=True, nogil=True)
def leg_inside(area: AreaRaster, x0: float, y0: float, x1: float, y1: float) -> bool:
    """Return whether a straight leg from a point of the area stays in it to the end.

    What crosses the border on the first thousandth of the leg counts as inside: a search may begin
    on the border.
    """
    if not inside(area, x1, y1):
        return False
    return (
        area.convex or _clear_of_border(area, x0, y0, x1, y1) or not _crosses(area, x0, y0, x1, y1)
    )


@njit(cache=True, nogil=True)
def _clear_of_border(area: AreaRaster, x0: float, y0: float, x1: float, y1: float) -> bool:
    """Return whether a leg is sure to meet no edge.

    It looks once per cell of the leg's length; an edge between two looks is seen by the border
    cells about it.
    """
    rows, columns = area.kinds.shape
    looks = 1 + math.ceil(math.hypot(x1 - x0, y1 - y0))
    for k in range(looks + 1):
        row = math.floor(y0 + k / looks * (y1 - y0) + 0.5)
        column = math.floor(x0 + k / looks * (x1 - x0) + 0.5)
        if row < 0 or column < 0 or row >= rows or column >= columns:
            return False
        if area.kinds[row, column] != INSIDE:
            return False
    return True


@njit(cache=True, nogil=True)
def _crosses(area: AreaRaster, x0: float, y0: float, x1: float, y1: float) -> bool:
    """Return whether a leg crosses an edge after its first thousandth."""
    dx, dy = x1 - x0, y1 - y0
    for e in range(len(area.edges)):
        ax, ay = area.edges[e, 0] - x0, area.edges[e, 1] - y0
        ex, ey = area.edges[e, 2] - area.edges[e, 0], area.edges[e, 3] - area.edges[e, 1]
        cross = dx * ey - dy * ex
        if cross == 0.0:
            continue  # Parallel: other edges of the ring tell.
        along, share = (ax * ey - ay * ex) / cross, (ax * dy - ay * dx) / cross
        if 1e-3 <= along <= 1.0 and 0.0 <= share <= 1.0:
            return True
    return False


@njit(cache=True, nogil=True)
def _points_inside(
    area: AreaRaster, x: npt.NDArray[np.int64], y: npt.NDArray[np.int64]
) -> npt.NDArray[np.bool_]:
    """Return which points lie in the area, (N,)."""
    found = np.empty(len(x), np.bool_)
    for i in range(len(x)):
        found[i] = inside(area, x[i], y[i])
    return found
