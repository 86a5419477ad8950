"""The paper's probability map: a weighted sum of bivariate normal densities."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt
from shapely import MultiPolygon, Polygon

from wisar_planner.errors import FloatArray, InvalidInput, finite_array, positive
from wisar_planner.pdm import mixture_kernels as kernels
from wisar_planner.pdm.boundary import checked_polygon, polygon_edges
from wisar_planner.pdm.coverage_kernels import coverage
from wisar_planner.pdm.grid import Grid
from wisar_planner.pdm.protocol import DensityPieces, IntArray

# A covariance whose axes differ by more than this is singular for all that doubles can tell.
_LARGEST_CONDITION = 1e12


@dataclass(frozen=True, eq=False)
class GaussianMixture:
    """A mixture of K bivariate normal distributions with full covariances.

    Parameters
    ----------
    weights : (K,) array_like
        Probability of each component, not negative, summing to 1 within 1e-6; normalised exactly.
    means : (K, 2) array_like
        Centres, m.
    covariances : (K, 2, 2) array_like
        Symmetric positive definite, m^2.

    Raises
    ------
    InvalidInput
        When K is 0, shapes disagree, a value is not finite, weights are negative or do not sum to
        1, or a covariance is not symmetric or is singular.

    Notes
    -----
    Equation (1) of the paper with weights 1/K and the sum over i = 1..K.
    """

    weights: FloatArray
    means: FloatArray
    covariances: FloatArray
    _components: FloatArray = field(init=False, repr=False)

    def __post_init__(self) -> None:
        weights = finite_array(self.weights, "weights", (None,))
        count = len(weights)
        if count == 0:
            raise InvalidInput("weights is empty: a mixture needs at least one component")
        means = finite_array(self.means, "means", (count, 2))
        covariances = finite_array(self.covariances, "covariances", (count, 2, 2))
        if (weights < 0.0).any():
            raise InvalidInput(f"weights must not be negative, but one is {weights.min():g}")
        total = float(weights.sum())
        if abs(total - 1.0) > 1e-6:
            raise InvalidInput(f"weights must sum to 1, not {total:.9g}; divide them by their sum")
        weights /= total
        size = np.abs(covariances).max(axis=(1, 2))
        skew = np.abs(covariances[:, 0, 1] - covariances[:, 1, 0])
        eigenvalues = np.linalg.eigvalsh(covariances)
        for k in range(count):
            if skew[k] > 1e-9 * size[k]:
                raise InvalidInput(f"covariances[{k}] must be symmetric")
            if not eigenvalues[k, 0] * _LARGEST_CONDITION > eigenvalues[k, 1]:
                raise InvalidInput(
                    f"covariances[{k}] must be positive definite, but its eigenvalues are "
                    f"{eigenvalues[k, 0]:g} and {eigenvalues[k, 1]:g}; give it a width both ways"
                )
        whitening = np.linalg.inv(np.linalg.cholesky(covariances))
        components = np.column_stack(
            [
                weights,
                means,
                whitening[:, 0, 0],
                whitening[:, 1, 0],
                whitening[:, 1, 1],
                1.0 / np.sqrt(eigenvalues[:, 0]),
            ]
        )
        for name, array in (
            ("weights", weights),
            ("means", means),
            ("covariances", covariances),
            ("_components", components),
        ):
            array.flags.writeable = False
            object.__setattr__(self, name, array)

    @classmethod
    def random(
        cls,
        rng: np.random.Generator,
        area: tuple[float, float, float, float],
        components: int = 4,
        variance: float = 500.0,
    ) -> GaussianMixture:
        """Return a random map of the paper's kind.

        Parameters
        ----------
        rng : numpy.random.Generator
            Source of randomness.
        area : (xmin, ymin, xmax, ymax)
            Rectangle in which the means are uniform, m.
        components : int
            Number of components, all of the same weight.
        variance : float
            Variance along both axes, m^2.
        """
        if components < 1:
            raise InvalidInput(f"components must be at least 1, not {components}")
        xmin, ymin, xmax, ymax = area
        means = rng.uniform((xmin, ymin), (xmax, ymax), size=(components, 2))
        covariances = np.tile(positive(variance, "variance") * np.eye(2), (components, 1, 1))
        return cls(np.full(components, 1.0 / components), means, covariances)

    @property
    def bounds(self) -> tuple[float, float, float, float]:
        """(xmin, ymin, xmax, ymax), m: six standard deviations around every mean."""
        reach = 6.0 * np.sqrt(np.diagonal(self.covariances, axis1=1, axis2=2))
        xmin, ymin = (self.means - reach).min(axis=0)
        xmax, ymax = (self.means + reach).max(axis=0)
        return float(xmin), float(ymin), float(xmax), float(ymax)

    def density(self, points: npt.ArrayLike) -> FloatArray:
        """Return the density in 1/m^2, (N,), at `points`, (N, 2) m."""
        return kernels.density(finite_array(points, "points", (None, 2)), self._components)

    def integrate(self, polygon: Polygon | MultiPolygon) -> float:
        """Return the probability inside `polygon`, to about 1e-14.

        By Green's theorem along the edges. The closed form (`pdm.closed_form`) and the paper's
        cubature (`search.cubature`) give the same and take longer.

        Raises
        ------
        InvalidInput
            When `polygon` is no valid polygon.
        """
        edges = polygon_edges(polygon)
        return float(self.integrate_boundary(edges, np.zeros(len(edges), np.int64), 1)[0])

    def integrate_boundary(self, pieces: FloatArray, owners: IntArray, count: int) -> FloatArray:
        """Return the probability inside each region; see `ProbabilityMap.integrate_boundary`."""
        return kernels.integrate_boundary(pieces, owners, count, self._components)

    def sample(self, count: int, rng: np.random.Generator) -> FloatArray:
        """Return `count` random positions, (count, 2) m.

        The component is drawn by the Gumbel-max trick, the position by its Cholesky factor.
        """
        with np.errstate(divide="ignore"):
            scores = np.log(self.weights) + rng.gumbel(size=(count, len(self.weights)))
        chosen = scores.argmax(axis=1)
        factors = np.linalg.cholesky(self.covariances)
        noise = rng.standard_normal((count, 2))
        return self.means[chosen] + np.einsum("nij,nj->ni", factors[chosen], noise)

    def rasterize(self, grid: Grid) -> FloatArray:
        """Return the probability in each cell of `grid`, (rows, columns), row 0 south.

        Exact to rounding where all covariances are diagonal (products of distribution functions);
        otherwise to about 1e-12 of a cell's mass scale, by quadrature along y.
        """
        if (self.covariances[:, 0, 1] != 0.0).any():
            return kernels.cell_masses(grid.x_edges, grid.y_edges, self._components)
        deviations = np.sqrt(np.diagonal(self.covariances, axis1=1, axis2=2))
        x = (grid.x_edges[:, None] - self.means[:, 0]) / deviations[:, 0]
        y = (grid.y_edges[:, None] - self.means[:, 1]) / deviations[:, 1]
        across, up = (np.diff(kernels.normal(edges), axis=0) for edges in (x, y))
        return np.asarray((up * self.weights) @ across.T)

    def most_probable_mass(self, region: Polygon | MultiPolygon, area: float) -> float:
        r"""Return an upper bound of the mass in any part of `region` of `area` m^2 at most.

        For every density level :math:`\lambda` and every set S of that area,
        :math:`\int_S p \le \lambda |S| + \int (p - \lambda)^+`, with equality for the set above
        the right level. The integral is bounded cell by cell on a grid from value, gradient and
        curvature, so the result is rigorous; at the paper's setup it is within 0.05% of the
        least bound.
        """
        if not area > 0.0:
            return 0.0
        _, _, ranges = self._cell_ranges(checked_polygon(region), math.inf)
        low, high = 0.0, float(ranges[:, 1].max())
        for _ in range(40):
            level = 0.5 * (low + high)
            if kernels.excess(ranges, level)[1] > area:
                low = level
            else:
                high = level
        bound = min(level * area + kernels.excess(ranges, level)[0] for level in (low, high))
        return min(bound, self.integrate(region))

    def density_pieces(self, region: Polygon | MultiPolygon, side: float) -> DensityPieces:
        r"""Return two pieces per cell of a grid; see `ProbabilityMap.density_pieces`.

        In a cell the density lies between bounds a and b, and has a mean of at most m. Its
        :math:`\int (p - \lambda)^+` is convex in p, so for every level it is at most that of a
        cell that has the density b on the share (m - a) / (b - a) of it and a on the rest. Hence
        no part of the cell holds more than the same area of these two pieces, the denser first.
        """
        grid, covered, ranges = self._cell_ranges(checked_polygon(region), side)
        low, high, mean, area = ranges.T
        spread = high - low
        share = np.divide(mean - low, spread, out=np.ones_like(spread), where=spread > 0.0)
        share = np.clip(share, 0.0, 1.0)
        row, column = np.nonzero(covered > 0.0)
        corners = np.column_stack([column, row]) * grid.cell + (grid.x0, grid.y0)
        return DensityPieces(
            corners=np.concatenate([corners, corners]),
            side=grid.cell,
            areas=np.concatenate([share * area, (1.0 - share) * area]),
            densities=np.concatenate([high, low]),
        )

    def _cell_ranges(
        self, region: Polygon | MultiPolygon, side: float
    ) -> tuple[Grid, FloatArray, FloatArray]:
        """Return a grid over `region`, the share of its cells within, and `kernels.cell_ranges`."""
        xmin, ymin, xmax, ymax = region.bounds
        # Cells a fraction of the narrowest component wide, but no more than a hundred thousand.
        finest = min(0.05 / float(self._components[:, 6].max()), side)
        cell = max(finest, math.sqrt((xmax - xmin) * (ymax - ymin) / 100_000))
        grid = Grid.covering((xmin, ymin, xmax, ymax), cell)
        covered = coverage(
            polygon_edges(region), grid.x0, grid.y0, grid.cell, grid.rows, grid.columns
        )
        ranges = kernels.cell_ranges(grid.x0, grid.y0, grid.cell, covered, self._components)
        return grid, covered, ranges
