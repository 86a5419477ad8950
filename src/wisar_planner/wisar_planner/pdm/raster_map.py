"""A probability map from a GIS raster: probability per cell, uniform inside a cell."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt
from shapely import MultiPolygon, Polygon

from wisar_planner.errors import FloatArray, InvalidInput, finite_array
from wisar_planner.pdm import raster_kernels as kernels
from wisar_planner.pdm.boundary import checked_polygon, polygon_edges
from wisar_planner.pdm.coverage_kernels import coverage
from wisar_planner.pdm.grid import Grid
from wisar_planner.pdm.protocol import DensityPieces, IntArray

# Squares that `density_pieces` cuts cells into, unless the cells alone are more.
_MOST_PIECES = 200_000

# Numbers that `sample` holds in an array at a time.
_MOST_NOISE = 2_000_000


@dataclass(frozen=True, eq=False)
class RasterMap:
    """A grid of probabilities; outside it there is none.

    Parameters
    ----------
    probability : (rows, columns) array_like
        Probability that the person is in the cell, row 0 south; not negative, with a sum above 0
        and at most 1. The sum is kept as given: what is missing lies off the map.
    grid : Grid
        Where the cells are.

    Raises
    ------
    InvalidInput
        When a value is negative or not finite, shapes disagree, or the sum is 0 or above 1.
    """

    probability: FloatArray
    grid: Grid
    _prefix: FloatArray = field(init=False, repr=False)

    def __post_init__(self) -> None:
        if not isinstance(self.grid, Grid):
            raise InvalidInput(f"grid must be a Grid, not {type(self.grid).__name__}")
        shape = (self.grid.rows, self.grid.columns)
        probability = finite_array(self.probability, "probability", shape)
        if (probability < 0.0).any():
            raise InvalidInput(
                f"probability must not be negative, but a cell holds {probability.min():g}; "
                "set no-data cells to 0"
            )
        total = float(probability.sum())
        if not 0.0 < total <= 1.0 + 1e-6:
            raise InvalidInput(
                f"probability must sum to more than 0 and at most 1, not {total:.9g}; "
                "divide it by its sum"
            )
        prefix = np.zeros((shape[0], shape[1] + 1))
        np.cumsum(probability, axis=1, out=prefix[:, 1:])
        probability.flags.writeable = False
        prefix.flags.writeable = False
        object.__setattr__(self, "probability", probability)
        object.__setattr__(self, "_prefix", prefix)

    @property
    def bounds(self) -> tuple[float, float, float, float]:
        """(xmin, ymin, xmax, ymax) of the grid, m."""
        return self.grid.bounds

    def density(self, points: npt.ArrayLike) -> FloatArray:
        """Return the density in 1/m^2, (N,), at `points`, (N, 2) m; 0 outside the grid.

        A border between cells belongs to the cell to its north or east; the outer border of the
        grid belongs to the grid.
        """
        xy = finite_array(points, "points", (None, 2))
        xmin, ymin, xmax, ymax = self.bounds
        x, y = np.ascontiguousarray(xy.T)
        inside = (x >= xmin) & (y >= ymin) & (x <= xmax) & (y <= ymax)
        column, row = (
            np.minimum(((along[inside] - low) / self.grid.cell).astype(np.int64), count - 1)
            for along, low, count in (
                (x, xmin, self.grid.columns),
                (y, ymin, self.grid.rows),
            )
        )
        values = np.zeros(len(xy))
        values[inside] = self.probability[row, column] / self.grid.cell**2
        return values

    def integrate(self, polygon: Polygon | MultiPolygon) -> float:
        """Return the probability inside `polygon`: every cell by the share of it that is covered.

        Exact to rounding. Raises InvalidInput when `polygon` is no valid polygon.
        """
        edges = polygon_edges(polygon)
        return float(self.integrate_boundary(edges, np.zeros(len(edges), np.int64), 1)[0])

    def integrate_boundary(self, pieces: FloatArray, owners: IntArray, count: int) -> FloatArray:
        """Return the probability inside each region; see `ProbabilityMap.integrate_boundary`."""
        grid = self.grid
        return kernels.integrate_boundary(
            pieces, owners, count, self._prefix, grid.x0, grid.y0, grid.cell
        )

    def sample(self, count: int, rng: np.random.Generator) -> FloatArray:
        """Return `count` random positions, (count, 2) m: a cell, then uniform inside it.

        The cell is drawn by the Gumbel-max trick, first its row by the rows' totals, then its
        column: a maximum of Gumbel variables is a Gumbel variable at the logarithm of the summed
        weights, so this draws as one maximum over all cells would, at the cost of one row.
        """
        with np.errstate(divide="ignore"):
            log_rows = np.log(self._prefix[:, -1])
            log_cells = np.log(self.probability)
        rows = np.empty(count, np.int64)
        for chunk, noise in _noise(count, self.grid.rows, rng):
            rows[chunk] = (log_rows + noise).argmax(axis=1)
        columns = np.empty(count, np.int64)
        for chunk, noise in _noise(count, self.grid.columns, rng):
            columns[chunk] = (log_cells[rows[chunk]] + noise).argmax(axis=1)
        cells = np.column_stack([columns, rows]) + rng.random((count, 2))
        return np.asarray((self.grid.x0, self.grid.y0) + cells * self.grid.cell)

    def rasterize(self, grid: Grid) -> FloatArray:
        """Return the probability in each cell of `grid`, (rows, columns), row 0 south.

        Cells give by the share of them that a new cell covers: exact, and mass is kept wherever
        `grid` covers this map.
        """
        rows = _shared_out(self.probability, self.grid.y_edges, grid.y_edges)
        cells = _shared_out(np.ascontiguousarray(rows.T), self.grid.x_edges, grid.x_edges)
        return np.ascontiguousarray(cells.T)

    def most_probable_mass(self, region: Polygon | MultiPolygon, area: float) -> float:
        """Return the mass of the most probable part of `region` of `area` m^2.

        The densest cells are taken until the area is used up, the last one in part. It is exact,
        and so the least upper bound of the mass in any part of that size.
        """
        grid = self.grid
        covered = coverage(
            polygon_edges(region), grid.x0, grid.y0, grid.cell, grid.rows, grid.columns
        )
        covered = np.clip(covered, 0.0, 1.0).ravel()
        order = np.argsort(-self.probability, axis=None, kind="stable")
        sizes = covered[order]
        used = np.cumsum(sizes)
        taken = np.clip(max(area, 0.0) / grid.cell**2 - (used - sizes), 0.0, sizes)
        return float(taken @ self.probability.ravel()[order])

    def density_pieces(self, region: Polygon | MultiPolygon, side: float) -> DensityPieces:
        """Return the covered cells, or equal parts of them; see `ProbabilityMap.density_pieces`."""
        grid = self.grid
        xmin, ymin, xmax, ymax = checked_polygon(region).bounds
        low = np.floor((np.array([xmin, ymin]) - (grid.x0, grid.y0)) / grid.cell)
        high = np.ceil((np.array([xmax, ymax]) - (grid.x0, grid.y0)) / grid.cell)
        most = (grid.columns, grid.rows)
        column, row = np.clip(low, 0, most).astype(np.int64)
        end_column, end_row = np.clip(high, 0, most).astype(np.int64)
        cells = self.probability[row:end_row, column:end_column]
        if cells.size == 0:
            return DensityPieces(np.empty((0, 2)), grid.cell, np.empty(0), np.empty(0))
        finer = math.floor(math.sqrt(_MOST_PIECES / cells.size))
        parts = max(1, min(math.ceil(grid.cell / side), finer))
        part = grid.cell / parts
        x0, y0 = grid.x0 + float(column) * grid.cell, grid.y0 + float(row) * grid.cell
        rows, columns = cells.shape[0] * parts, cells.shape[1] * parts
        covered = coverage(polygon_edges(region), x0, y0, part, rows, columns)
        within = np.nonzero((covered > 0.0) & (cells.repeat(parts, 0).repeat(parts, 1) > 0.0))
        return DensityPieces(
            corners=np.asarray(np.column_stack(within[::-1]) * part + (x0, y0), np.float64),
            side=part,
            areas=np.minimum(covered[within], 1.0) * part**2,
            densities=cells[within[0] // parts, within[1] // parts] / grid.cell**2,
        )


def _noise(count: int, width: int, rng: np.random.Generator) -> Iterator[tuple[slice, FloatArray]]:
    """Yield Gumbel noise, (count, width) in all, some rows at a time, and which rows they are.

    The generator gives the same numbers in pieces as at once, so the draws do not depend on the
    size of a piece; all at once would be gigabytes for many draws on a large raster.
    """
    height = max(1, _MOST_NOISE // width)
    for first in range(0, count, height):
        chunk = slice(first, min(first + height, count))
        yield chunk, rng.gumbel(size=(chunk.stop - first, width))


def _shared_out(amounts: FloatArray, old: FloatArray, new: FloatArray) -> FloatArray:
    """Return what each new interval gets of the amounts in old ones, by the shares it covers.

    Parameters
    ----------
    amounts : (n, m) float64
        What the old intervals hold.
    old, new : (n + 1,), (k + 1,) float64
        Borders between intervals, rising.

    Returns
    -------
    (k, m) float64
    """
    borders = np.union1d(old, new)
    low, high = max(old[0], new[0]), min(old[-1], new[-1])
    borders = borders[(borders >= low) & (borders <= high)]
    shared = np.zeros((len(new) - 1, amounts.shape[1]))
    if len(borders) < 2:
        return shared
    # Each piece between two borders lies in one interval of either kind.
    middle = 0.5 * (borders[:-1] + borders[1:])
    within = np.searchsorted(old, middle, side="right") - 1
    into = np.searchsorted(new, middle, side="right") - 1
    share = np.diff(borders) / np.diff(old)[within]
    firsts = np.flatnonzero(np.diff(into, prepend=-1))
    shared[into[firsts]] = np.add.reduceat(amounts[within] * share[:, None], firsts, axis=0)
    return shared
