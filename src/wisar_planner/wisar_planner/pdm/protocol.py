"""What a probability map offers to planners and metrics."""

from __future__ import annotations

from typing import NamedTuple, Protocol, runtime_checkable

import numpy as np
import numpy.typing as npt
from shapely import MultiPolygon, Polygon

from wisar_planner.errors import FloatArray
from wisar_planner.pdm.grid import Grid

IntArray = npt.NDArray[np.int64]


class DensityPieces(NamedTuple):
    """Pieces of uniform density, each somewhere in a square of its own or of several pieces.

    Attributes
    ----------
    corners : (N, 2) float64
        Lower-left corners of the squares, m.
    side : float
        Side of all squares, m.
    areas : (N,) float64
        Area of each piece, m^2.
    densities : (N,) float64
        Its probability density, 1/m^2.
    """

    corners: FloatArray
    side: float
    areas: FloatArray
    densities: FloatArray


@runtime_checkable
class ProbabilityMap(Protocol):
    """Probability density of the missing person's position over the ground, in metres.

    The total mass is at most 1; what is missing lies off the map.
    """

    @property
    def bounds(self) -> tuple[float, float, float, float]:
        """(xmin, ymin, xmax, ymax) in metres of where practically all mass lies."""

    def density(self, points: npt.ArrayLike) -> FloatArray:
        """Return the density in 1/m^2, (N,), at `points`, (N, 2) m."""

    def integrate(self, polygon: Polygon | MultiPolygon) -> float:
        """Return the probability inside `polygon` (holes and several parts allowed)."""

    def integrate_boundary(self, pieces: FloatArray, owners: IntArray, count: int) -> FloatArray:
        """Return the probability inside each of `count` regions given by their boundaries.

        Parameters
        ----------
        pieces : (N, 5) float64
            Directed boundary pieces with the region to their left, in any order. A straight
            piece is ``(x0, y0, x1, y1, 0)``; an arc about ``(x, y)`` is
            ``(x, y, theta0, theta1, radius)``, turning left where ``theta1 > theta0``.
        owners : (N,) int64
            Number of the region that a piece belongs to.
        count : int
            Number of regions.

        Returns
        -------
        (count,) float64
            Probability of each region. The boundary of a region must close.
        """

    def sample(self, count: int, rng: np.random.Generator) -> FloatArray:
        """Return `count` random positions, (count, 2) m, drawn from the map."""

    def rasterize(self, grid: Grid) -> FloatArray:
        """Return the probability in each cell of `grid`, (rows, columns), row 0 south."""

    def most_probable_mass(self, region: Polygon | MultiPolygon, area: float) -> float:
        """Return an upper bound of the mass in any part of `region` of `area` m^2 at most."""

    def density_pieces(self, region: Polygon | MultiPolygon, side: float) -> DensityPieces:
        """Return pieces of uniform density that bound the mass of every part of `region`.

        Any part of `region` holds at most the mass of the densest pieces of the same area in the
        same squares.

        Parameters
        ----------
        region : shapely.Polygon or shapely.MultiPolygon
            What to cut up.
        side : float
            Largest side of a square, m; wider where it would take too many.
        """
