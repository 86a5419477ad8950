"""Local hill climbing with global warming and convolution, the heuristic of Lin and Goodrich."""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
import numpy.typing as npt

from wisar_planner.errors import FloatArray, InvalidInput
from wisar_planner.pdm import Grid
from wisar_planner.planners.base import OnProgress, OptionedPlanner, ShouldStop, option
from wisar_planner.planners.lhc_gw_conv_kernels import climb
from wisar_planner.search.path import SearchPath
from wisar_planner.search.problem import SearchProblem


@dataclass(frozen=True)
class LhcGwConv(OptionedPlanner):
    """LHC_GW_CONV of Lin and Goodrich (IROS 2009), on the grid of Ewers et al.

    The area is cut into cells of one step length, from its lower-left corner. From the start's
    cell the drone moves again and again to the most probable of the eight neighbours and empties
    it. *Convolution*: neighbours that tie are told apart by the mass of a box of `kernel` cells
    around each. A visited cell is entered only where no neighbour is unvisited, the cell just left
    only where there is no other.

    *Global warming*: the climb is repeated on maps lowered by i / (`levels` + 1) of the highest
    cell, i = 0 .. `levels` - 1, so that slopes drown and only peaks are left to climb; the path
    that collects most on the original map is kept. A diagonal move is longer than a straight one;
    the distance counts, and the path is cut at the maximum distance.

    The first waypoint is the start itself, the others are centres of cells. Only cells are entered
    whose centre lies in the area, and only where the way there does.
    """

    name: ClassVar[str] = "lhc_gw_conv"

    levels: int = option(
        20, "Number of warming levels that are tried, the unwarmed map being the first.", minimum=1
    )
    kernel: int = option(
        3, "Side of the box that breaks ties, in cells; an odd number.", minimum=1, maximum=999
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.kernel % 2 == 0:
            raise InvalidInput(f"kernel must be odd, not {self.kernel}")

    def plan(
        self,
        problem: SearchProblem,
        *,
        on_progress: OnProgress | None = None,
        should_stop: ShouldStop | None = None,
    ) -> SearchPath:
        """Return the best climb of all warming levels; see `Planner.plan`."""
        grid = Grid.covering(problem.area.bounds, problem.step_length)
        cells = problem.pdm.rasterize(grid)
        centres = grid.centres()
        allowed = problem.area.contains(centres.reshape(-1, 2)).reshape(cells.shape)
        cells = np.where(allowed, cells, 0.0)
        row, column = _cell_of(grid, problem.start)
        budget = problem.max_distance / grid.cell
        moves = _moves(problem, centres, allowed, row, column)
        best_score, best = -1.0, np.array([[row, column]], np.float64)
        for level in range(self.levels):
            warming = cells.max() * level / (self.levels + 1)
            path, score = climb(cells, moves, row, column, budget, warming, self.kernel)
            if score > best_score:
                best_score, best = score, path
            if should_stop is not None and should_stop():
                break
        steps = best.astype(np.int64)
        waypoints = centres[steps[:, 0], steps[:, 1]]
        waypoints[0] = problem.start
        flown = SearchPath(waypoints, problem.swath_radius, self.name)
        return flown.truncated(problem.max_distance)


def _moves(
    problem: SearchProblem,
    centres: FloatArray,
    allowed: npt.NDArray[np.bool_],
    row: int,
    column: int,
) -> npt.NDArray[np.bool_]:
    """Return which neighbours each cell can be left for, (rows, columns, 3, 3).

    The way from the start's cell, (row, column), begins at the start itself, later at its centre.
    """
    rows, columns = allowed.shape
    moves = np.zeros((rows, columns, 3, 3), dtype=np.bool_)
    for dr, dc in itertools.product((-1, 0, 1), repeat=2):
        if dr == dc == 0:
            continue
        here = slice(max(0, -dr), rows - max(0, dr)), slice(max(0, -dc), columns - max(0, dc))
        there = slice(max(0, dr), rows + min(0, dr)), slice(max(0, dc), columns + min(0, dc))
        possible = allowed[here] & allowed[there]
        possible[possible] = problem.area.contains_legs(
            centres[here][possible], centres[there][possible]
        )
        moves[..., dr + 1, dc + 1][here] = possible
        r, c = row + dr, column + dc
        if 0 <= r < rows and 0 <= c < columns:
            first = problem.area.contains_legs(problem.start, centres[r, c][None])[0]
            later = moves[row, column, dr + 1, dc + 1] or not allowed[row, column]
            moves[row, column, dr + 1, dc + 1] = allowed[r, c] and first and later
    return moves


def _cell_of(grid: Grid, point: FloatArray) -> tuple[int, int]:
    column = int((point[0] - grid.x0) / grid.cell)
    row = int((point[1] - grid.y0) / grid.cell)
    return min(row, grid.rows - 1), min(column, grid.columns - 1)
