"""The paper's integral of the seen area: cubature over its constrained Delaunay triangulation."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import shapely
from numpy.polynomial.legendre import leggauss, legroots, legvander
from shapely import MultiPolygon, Polygon

from wisar_planner.errors import FloatArray, InvalidInput, positive
from wisar_planner.pdm import ProbabilityMap, RasterMap
from wisar_planner.pdm.boundary import checked_polygon
from wisar_planner.search.path import SearchPath


@dataclass(frozen=True)
class CubatureResult:
    """An integral with what is known of its error.

    Parameters
    ----------
    value : float
        Probability in the polygon.
    error : float
        Estimate of the absolute error, on the safe side.
    triangles : int
        Number of triangles in the end.
    """

    value: float
    error: float
    triangles: int


def integrate_by_cubature(
    pdm: ProbabilityMap,
    polygon: Polygon | MultiPolygon,
    tolerance: float = 1e-9,
    *,
    max_triangles: int = 2_000_000,
) -> CubatureResult:
    """Return the probability of a map with a smooth density inside a polygon.

    The polygon is cut into triangles by a constrained Delaunay triangulation. On each the rules of
    degree 5 and 9 are compared; those that disagree by more than their share are cut in four at
    the midpoints of their sides until the differences sum to no more than the tolerance. The rule
    of degree 9 gives the value, so the estimate is as a rule much larger than the true error. Where
    density is narrow both rules may be wrong alike: each triangle is therefore cut once at least,
    and what the four parts say otherwise than the whole counts, too.

    Parameters
    ----------
    pdm : ProbabilityMap
        Its `density` must be smooth; a `RasterMap` is integrated cell by cell instead, exactly.
    polygon : shapely.Polygon or shapely.MultiPolygon
        Where to integrate, m; holes and several parts allowed.
    tolerance : float
        Absolute error to reach.
    max_triangles : int
        Where to give up.

    Raises
    ------
    InvalidInput
        When `polygon` is not valid, or the tolerance is not reached with `max_triangles`.
    """
    polygon = checked_polygon(polygon)
    tolerance = positive(tolerance, "tolerance")
    if isinstance(pdm, RasterMap):
        return CubatureResult(pdm.integrate(polygon), 0.0, 0)
    whole = _triangulate(polygon)
    if not len(whole):
        return CubatureResult(0.0, 0.0, 0)
    said = _apply(_DEGREE_9, pdm, whole)
    triangles = _quarter(whole)
    value, error, count = 0.0, 0.0, len(whole)
    while len(triangles):
        coarse, fine = (_apply(rule, pdm, triangles) for rule in (_DEGREE_5, _DEGREE_9))
        surprise = np.abs(fine.reshape(4, len(said)).sum(axis=0) - said)
        errors = np.maximum(np.abs(fine - coarse), np.tile(_SURPRISE * surprise, 4))
        count += len(triangles)
        remaining = tolerance - error
        # Keep the triangles with the smallest errors as long as they use up at most half of what
        # is left of the tolerance; all of them if they fit.
        used = np.cumsum(np.sort(errors))
        allowed = remaining if used[-1] <= remaining else 0.5 * remaining
        kept = np.zeros(len(errors), dtype=bool)
        kept[np.argsort(errors)[: np.searchsorted(used, allowed, side="right")]] = True
        value += float(fine[kept].sum())
        error += float(errors[kept].sum())
        if count + 4 * np.count_nonzero(~kept) > max_triangles:
            raise InvalidInput(
                f"tolerance {tolerance:g} is out of reach with {max_triangles} triangles; raise it"
            )
        said = fine[~kept]
        triangles = _quarter(triangles[~kept])
    return CubatureResult(value, error, count)


def seen_probability_by_cubature(
    path: SearchPath | Polygon | MultiPolygon, pdm: ProbabilityMap, tolerance: float = 1e-6
) -> float:
    """Return the probability that a path sees, computed as in the paper.

    Parameters
    ----------
    path : SearchPath or polygon
        A path, whose buffered polygon is taken with 16 segments per quarter circle, or the polygon
        itself. `SearchPath.seen_probability` takes the true arcs and is the one to prefer: the
        polygon lacks up to 0.16% of the area of the half circles.
    pdm : ProbabilityMap
        Where the person may be.
    tolerance : float
        Absolute error of the cubature.
    """
    polygon = path.seen_area() if isinstance(path, SearchPath) else path
    return integrate_by_cubature(pdm, polygon, tolerance).value


@dataclass(frozen=True)
class _Rule:
    """Barycentric nodes, (Q, 3), and weights that sum to 1, (Q,)."""

    nodes: FloatArray
    weights: FloatArray


def gauss_jacobi(n: int) -> tuple[FloatArray, FloatArray]:
    """Return n >= 2 nodes and weights of Gauss quadrature on (-1, 1) with the weight 1 - x.

    SciPy has it, too, but takes a node as long to import as everything else together. The nodes are
    the zeros of (P_n - P_n+1) / (1 - x) with Legendre's polynomials P (Szego 1939, 4.5.4).
    """
    zeros = legroots([0.0] * n + [1.0, -1.0])
    x = np.sort(zeros.real)[:-1]
    moments = np.zeros(n)
    moments[:2] = 2.0, -2.0 / 3.0
    return x, np.linalg.solve(legvander(x, n - 1).T, moments)


def _conical_rule(n: int) -> _Rule:
    """Return the conical product rule of n x n nodes, of degree 2 n - 1 (Stroud 1971, 2.6)."""
    # Gauss-Jacobi across the triangle takes up the shrinking width, Gauss-Legendre runs along it.
    x, wx = gauss_jacobi(n)
    y, wy = leggauss(n)
    s, t = np.meshgrid(0.5 * (1.0 + x), 0.5 * (1.0 + y), indexing="ij")
    second = t * (1.0 - s)
    nodes = np.stack([1.0 - s - second, s, second], axis=-1).reshape(-1, 3)
    return _Rule(nodes, (wx[:, None] * wy[None, :]).ravel() / 4.0)


_DEGREE_5 = _conical_rule(3)
_DEGREE_9 = _conical_rule(5)
# Share of what four parts say otherwise than the whole that counts as the error of each: for a
# smooth density theirs is a thousandth of it.
_SURPRISE = 1.0 / 64.0


def _triangulate(polygon: Polygon | MultiPolygon) -> FloatArray:
    """Return the corners of the constrained Delaunay triangles of a polygon, (N, 3, 2)."""
    triangles = shapely.get_parts(shapely.constrained_delaunay_triangles(polygon))
    corners = shapely.get_coordinates(triangles).reshape(-1, 4, 2)
    return np.ascontiguousarray(corners[:, :3])


def _apply(rule: _Rule, pdm: ProbabilityMap, triangles: FloatArray) -> FloatArray:
    """Return the integral over each triangle, (N,)."""
    first, second = triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0]
    areas = 0.5 * np.abs(first[:, 0] * second[:, 1] - first[:, 1] * second[:, 0])
    points = np.einsum("qc,nci->nqi", rule.nodes, triangles)
    density = pdm.density(points.reshape(-1, 2)).reshape(len(triangles), -1)
    return np.asarray(areas * (density @ rule.weights))


def _quarter(triangles: FloatArray) -> FloatArray:
    """Return four similar triangles for each, (4 N, 3, 2)."""
    a, b, c = triangles[:, 0], triangles[:, 1], triangles[:, 2]
    ab, bc, ca = 0.5 * (a + b), 0.5 * (b + c), 0.5 * (c + a)
    parts = [(a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca)]
    return np.concatenate([np.stack(part, axis=1) for part in parts])
