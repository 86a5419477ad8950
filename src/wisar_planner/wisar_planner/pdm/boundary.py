"""Polygons as directed boundary pieces."""

from __future__ import annotations

from typing import Any

import numpy as np
import shapely
from shapely import MultiPolygon, Polygon

from wisar_planner.errors import FloatArray, InvalidInput


def checked_polygon(polygon: Any) -> Polygon | MultiPolygon:
    """Return `polygon` if it can be integrated over.

    Raises
    ------
    InvalidInput
        When it is not a valid shapely Polygon or MultiPolygon with finite coordinates.
    """
    if not isinstance(polygon, Polygon | MultiPolygon):
        raise InvalidInput(
            f"polygon must be a shapely Polygon or MultiPolygon, not {type(polygon).__name__}"
        )
    if not np.isfinite(shapely.get_coordinates(polygon)).all():
        raise InvalidInput("polygon must have finite coordinates")
    if not polygon.is_valid:
        raise InvalidInput(
            f"polygon is not valid ({shapely.is_valid_reason(polygon)}); "
            "repair it, for example with shapely.make_valid"
        )
    return polygon


def polygon_edges(polygon: Polygon | MultiPolygon) -> FloatArray:
    """Return the edges of `polygon` with its interior to their left.

    Returns
    -------
    (N, 5) float64
        Straight pieces ``(x0, y0, x1, y1, 0)`` as `ProbabilityMap.integrate_boundary` takes them.
    """
    oriented = shapely.orient_polygons(checked_polygon(polygon))
    rings = shapely.get_rings(shapely.get_parts(oriented))
    points, ring = shapely.get_coordinates(rings, return_index=True)
    within = ring[1:] == ring[:-1]
    edges = np.zeros((int(within.sum()), 5))
    edges[:, :2] = points[:-1][within]
    edges[:, 2:4] = points[1:][within]
    return edges
