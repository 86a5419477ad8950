"""The map, the area and the coverage of a search on one fine raster, for fast trial and error."""

from __future__ import annotations

import math

import numpy as np

from wisar_planner.errors import FloatArray
from wisar_planner.pdm import Grid
from wisar_planner.planners.swath_kernels import Canvas, most_weight
from wisar_planner.search.area_raster import AreaRaster
from wisar_planner.search.problem import SearchProblem

# Cells per swath radius. A swath 2 r wide covers up to floor(2 r) + 1 rows, and annealing finds the
# places where it does; so 2 r, and 2 r sqrt(2) for diagonals, lie just under whole numbers.
COARSE, FINE = 3.495, 5.9975
# A step shorter than the swath needs cells no wider than this share of it.
_CELLS_PER_STEP = 3.0
# Cells of the largest raster, 9 bytes each; a wider search gets coarser cells.
_MOST_CELLS = 1 << 22
# Steps of room about given positions.
_ROOM = 16.0


class SearchRaster:
    """What trial-and-error planners work on: weights, area and coverage counts per cell.

    Where it would take more than 2^22 cells (38 MB), cells are wider than asked for.

    Parameters
    ----------
    problem : SearchProblem
        Supplies map, area, start, swath radius, step length and budget.
    cells_per_radius : float
        Cells per swath radius, COARSE or FINE; more where a step is short.
    around : (N, 2) float64, optional
        Positions in metres. The raster then covers these and some steps about them, and waypoints
        beyond it count as outside the area; else it covers all the budget can reach.

    Attributes
    ----------
    grid : Grid
        Where the cells lie.
    canvas : Canvas
        Weight of each cell in units of `unit`, and how often it is covered: zero between uses.
    unit : float
        Probability of a weight of 1.
    area : AreaRaster
        The area.
    radius, step : float
        Swath radius and step length in cells.
    """

    def __init__(
        self, problem: SearchProblem, cells_per_radius: float, around: FloatArray | None = None
    ) -> None:
        xmin, ymin, xmax, ymax = problem.area.bounds
        if around is None:
            around, reach = problem.start[None], problem.max_distance
        else:
            reach = _ROOM * problem.step_length
        # What can be flown to, and the swath beside it.
        low = np.maximum(around.min(axis=0) - reach, (xmin, ymin)) - problem.swath_radius
        high = np.minimum(around.max(axis=0) + reach, (xmax, ymax)) + problem.swath_radius
        cell = max(
            min(problem.swath_radius / cells_per_radius, problem.step_length / _CELLS_PER_STEP),
            math.sqrt(math.prod(high - low) / _MOST_CELLS),
        )
        self.grid = Grid.covering((*low, *high), cell)
        self.cells_per_radius = cells_per_radius
        self.radius = problem.swath_radius / cell
        self.step = problem.step_length / cell
        mass = problem.pdm.rasterize(self.grid)
        # Rollouts measure swaths twice as wide.
        most = most_weight(self.step, 2.0 * self.radius)
        self.unit = max(float(mass.max()), np.finfo(np.float64).tiny) / most
        self.canvas = Canvas.of(np.floor(mass / self.unit).astype(np.int32))
        # A hair inside the border, so that rounding never puts a waypoint outside.
        within = problem.area.polygon.buffer(-1e-7 * problem.step_length)
        self.area = AreaRaster.of(within, self.grid)

    def to_cells(self, points: FloatArray) -> FloatArray:
        """Return points in metres, (..., 2), as points in cells."""
        return (points - (self.grid.x0, self.grid.y0)) / self.grid.cell - 0.5

    def to_metres(self, points: FloatArray) -> FloatArray:
        """Return points in cells, (..., 2), as points in metres."""
        return (points + 0.5) * self.grid.cell + (self.grid.x0, self.grid.y0)
