"""The area to be searched."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import numpy.typing as npt
import shapely
from shapely import MultiPolygon, Polygon

from wisar_planner.errors import FloatArray, InvalidInput, finite_array


@dataclass(frozen=True)
class SearchArea:
    """A polygon on the ground, in local metres; holes and several parts are allowed.

    Parameters
    ----------
    polygon : shapely.Polygon or shapely.MultiPolygon
        Valid, not empty, with a positive area.

    Raises
    ------
    InvalidInput
        When `polygon` is of another type, empty, without area, not finite or not valid.
    """

    polygon: Polygon | MultiPolygon

    def __post_init__(self) -> None:
        if not isinstance(self.polygon, Polygon | MultiPolygon):
            raise InvalidInput(
                f"polygon must be a shapely Polygon or MultiPolygon, not {type(self.polygon)}"
            )
        if self.polygon.is_empty or not self.polygon.area > 0.0:
            raise InvalidInput("polygon must have an area above 0: the search area is empty")
        if not np.isfinite(shapely.get_coordinates(self.polygon)).all():
            raise InvalidInput("polygon must have finite coordinates")
        if not self.polygon.is_valid:
            raise InvalidInput(
                f"polygon is not valid ({shapely.is_valid_reason(self.polygon)}); "
                "repair it, for example with shapely.make_valid"
            )
        shapely.prepare(self.polygon)

    @classmethod
    def rectangle(cls, x0: float, y0: float, x1: float, y1: float) -> SearchArea:
        """Return the rectangle between two opposite corners, m."""
        corners = finite_array([x0, y0, x1, y1], "rectangle", (4,))
        return cls(shapely.box(*corners))

    @classmethod
    def from_polygon(cls, polygon: Any) -> SearchArea:
        """Return the area of a shapely polygon or of a ring of vertices, (N, 2) m."""
        if not isinstance(polygon, shapely.Geometry):
            ring = finite_array(polygon, "polygon", (None, 2))
            if len(ring) < 3:
                raise InvalidInput(f"polygon needs at least 3 vertices, not {len(ring)}")
            polygon = Polygon(ring)
        return cls(polygon)

    @property
    def bounds(self) -> tuple[float, float, float, float]:
        """(xmin, ymin, xmax, ymax) in metres."""
        xmin, ymin, xmax, ymax = self.polygon.bounds
        return float(xmin), float(ymin), float(xmax), float(ymax)

    @property
    def area(self) -> float:
        """Area in m^2."""
        return float(self.polygon.area)

    @cached_property
    def middle(self) -> FloatArray:
        """Centre of the area, (2,) m; where that lies outside, as in a hole, a point inside."""
        centre = self.polygon.centroid
        inside = centre if self.polygon.covers(centre) else self.polygon.representative_point()
        middle = np.array([inside.x, inside.y])
        middle.flags.writeable = False
        return middle

    @cached_property
    def convex(self) -> bool:
        """Whether a straight leg between points of the area always stays inside."""
        return is_convex(self.polygon)

    def contains(self, points: npt.ArrayLike) -> npt.NDArray[np.bool_]:
        """Return which of `points`, (N, 2) m, lie in the area; its boundary belongs to it."""
        xy = finite_array(points, "points", (None, 2))
        return np.asarray(shapely.intersects_xy(self.polygon, xy[:, 0], xy[:, 1]))

    def contains_legs(self, starts: npt.ArrayLike, ends: npt.ArrayLike) -> npt.NDArray[np.bool_]:
        """Return which straight legs between points of the area stay in it, (N,).

        A leg may leave the area by a billionth of its extent: a border is no wider than rounding.

        Parameters
        ----------
        starts : (2,) or (N, 2) array_like
            Where the legs begin, m.
        ends : (N, 2) array_like
            Where they end, m.
        """
        ends = finite_array(ends, "ends", (None, 2))
        found = self.contains(ends)
        if self.convex or not found.any():
            return found
        legs = np.stack([np.broadcast_to(starts, ends.shape), ends], axis=1)[found]
        found[found] = shapely.covers(self._widened, shapely.linestrings(legs))
        return found

    @cached_property
    def _widened(self) -> Polygon | MultiPolygon:
        xmin, ymin, xmax, ymax = self.bounds
        widened = self.polygon.buffer(1e-9 * max(xmax - xmin, ymax - ymin), join_style="mitre")
        shapely.prepare(widened)
        return widened


def is_convex(polygon: Polygon | MultiPolygon) -> bool:
    """Return whether a polygon fills its convex hull, but for rounding."""
    return bool(polygon.convex_hull.area - polygon.area <= 1e-12 * polygon.area)
