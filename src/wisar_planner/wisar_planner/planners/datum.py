"""The datum of a search pattern: the most probable point of the map inside the area."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from wisar_planner.errors import FloatArray
from wisar_planner.pdm import Grid, ProbabilityMap
from wisar_planner.search.area import SearchArea
from wisar_planner.search.problem import SearchProblem

# A raster for finding the datum or a direction needs no more cells than this along a side.
_MOST_CELLS = 512


class CoarseMap(NamedTuple):
    """The map on cells of about one swath radius, for finding places rather than for gains.

    Parameters
    ----------
    grid : Grid
        Where the cells lie.
    mass : (rows, columns) float64
        Probability in each cell; zero in cells whose centre lies outside the area.
    """

    grid: Grid
    mass: FloatArray

    def centre(self, index: int) -> FloatArray:
        """Return the centre, (2,) m, of the cell with a flat index."""
        row, column = divmod(int(index), self.grid.columns)
        lower_left = np.array([self.grid.x0, self.grid.y0])
        return lower_left + self.grid.cell * (np.array([column, row]) + 0.5)


def coarse_map(problem: SearchProblem) -> CoarseMap:
    """Return the coarse map of a problem's area."""
    return _coarse(problem.pdm, problem.area, problem.swath_radius)


def datum(problem: SearchProblem) -> FloatArray:
    """Return the most probable point inside the area, (2,) m; see `most_probable_point`."""
    return most_probable_point(problem.pdm, problem.area, problem.swath_radius)


def most_probable_point(pdm: ProbabilityMap, area: SearchArea, radius: float) -> FloatArray:
    """Return the most probable point of a map inside an area, to about one swath radius.

    Parameters
    ----------
    pdm : ProbabilityMap
        The map.
    area : SearchArea
        The area.
    radius : float
        The swath radius, m.

    Returns
    -------
    (2,) float64
        The point, m. Where the area is too small to hold the centre of a probable cell, it is a
        point inside it.
    """
    coarse = _coarse(pdm, area, radius)
    best = int(np.argmax(coarse.mass))
    if coarse.mass.flat[best] > 0.0:
        return coarse.centre(best)
    within = area.polygon.representative_point()
    return np.array([within.x, within.y])


def _coarse(pdm: ProbabilityMap, area: SearchArea, radius: float) -> CoarseMap:
    """Return the map on cells of one swath radius, or larger where these would be too many."""
    xmin, ymin, xmax, ymax = area.bounds
    grid = Grid.covering(area.bounds, max(radius, max(xmax - xmin, ymax - ymin) / _MOST_CELLS))
    mass = pdm.rasterize(grid)
    inside = area.contains(grid.centres().reshape(-1, 2)).reshape(mass.shape)
    return CoarseMap(grid, np.where(inside, mass, 0.0))
