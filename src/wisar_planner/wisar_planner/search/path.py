"""A search path and what it is worth."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt
import shapely
from shapely import MultiPolygon, Polygon

from wisar_planner.errors import FloatArray, InvalidInput, finite_array, positive
from wisar_planner.pdm import ProbabilityMap
from wisar_planner.search.seen_area import gains_along, probability_seen

if TYPE_CHECKING:
    from wisar_planner.search.problem import SearchProblem


@dataclass(frozen=True, eq=False)
class SearchPath:
    """Waypoints joined by straight legs, flown with a sensor that sees a swath below.

    Parameters
    ----------
    waypoints : (N + 1, 2) array_like
        Positions, m; the first row is the first point.
    swath_radius : float
        Distance to either side of the path that is seen, m.
    planner : str
        Name of the planner that made the path.
    transit_length : float
        Length of a leg from the start that was put in front of the search, m.

    Raises
    ------
    InvalidInput
        When there is no waypoint, one is not finite or repeats the one before it, or a length is
        negative or not finite.
    """

    waypoints: FloatArray
    swath_radius: float
    planner: str = ""
    transit_length: float = 0.0

    def __post_init__(self) -> None:
        waypoints = finite_array(self.waypoints, "waypoints", (None, 2))
        if len(waypoints) == 0:
            raise InvalidInput("waypoints is empty: a path needs at least one point")
        still = (waypoints[1:] == waypoints[:-1]).all(axis=1)
        if still.any():
            i = int(still.argmax()) + 1
            raise InvalidInput(f"waypoints[{i}] repeats the waypoint before it; drop the step")
        waypoints.flags.writeable = False
        object.__setattr__(self, "waypoints", waypoints)
        object.__setattr__(self, "swath_radius", positive(self.swath_radius, "swath_radius"))
        transit = float(self.transit_length)
        if not (math.isfinite(transit) and transit >= 0.0):
            raise InvalidInput(f"transit_length must be finite and not negative, not {transit}")

    @cached_property
    def distances(self) -> FloatArray:
        """Distance flown at each waypoint, (N + 1,), m."""
        legs = np.hypot(*np.diff(self.waypoints, axis=0).T)
        distances = np.concatenate([[0.0], np.cumsum(legs)])
        distances.flags.writeable = False
        return distances

    @property
    def length(self) -> float:
        """Length of the path, m."""
        return float(self.distances[-1])

    def point_at(self, distances: npt.ArrayLike) -> FloatArray:
        """Return the positions, (M, 2) m, after `distances`, (M,) m; clamped to the path's ends."""
        d = finite_array(distances, "distances", (None,))
        return np.column_stack(
            [np.interp(d, self.distances, self.waypoints[:, axis]) for axis in (0, 1)]
        )

    def truncated(self, max_distance: float) -> SearchPath:
        """Return the path's first `max_distance` metres; the path itself if it is no longer."""
        if not (math.isfinite(max_distance) and max_distance >= 0.0):
            raise InvalidInput(f"max_distance must be finite and not negative, not {max_distance}")
        if self.length <= max_distance:
            return self
        kept = self.waypoints[self.distances < max_distance]
        end = self.point_at([max_distance])
        if len(kept) == 0 or (kept[-1] != end[0]).any():
            kept = np.concatenate([kept, end])
        return SearchPath(
            kept, self.swath_radius, self.planner, min(self.transit_length, max_distance)
        )

    def seen_area(self, quad_segs: int = 16) -> Polygon | MultiPolygon:
        """Return the seen area as a polygon (the paper's h_t): the path buffered by the radius.

        Parameters
        ----------
        quad_segs : int
            Segments per quarter circle. The polygon lies inside the true area; metrics use the
            true one, with round ends.
        """
        line = (
            shapely.LineString(self.waypoints)
            if len(self.waypoints) > 1
            else shapely.Point(self.waypoints[0])
        )
        return line.buffer(self.swath_radius, quad_segs=quad_segs)

    def seen_probability(self, pdm: ProbabilityMap) -> float:
        """Return the probability that the path sees (the paper's p_t at its end).

        The integral over everything within the swath radius of the path, counted once, whether
        inside the search area or not.
        """
        return probability_seen(pdm, self.waypoints, self.swath_radius)

    def probability_at_waypoints(self, pdm: ProbabilityMap) -> FloatArray:
        """Return the probability seen so far at each waypoint, (N + 1,)."""
        return np.cumsum(gains_along(pdm, self.waypoints, self.swath_radius))

    def probability_over_distance(
        self, pdm: ProbabilityMap, distances: npt.ArrayLike
    ) -> FloatArray:
        """Return the probability seen after each of `distances`.

        Parameters
        ----------
        pdm : ProbabilityMap
            Where the person may be.
        distances : (M,) array_like
            Distances flown, m, in any order; past the end of the path the last value holds.
            `walking_distances` gives the paper's.

        Returns
        -------
        (M,) float64
        """
        wanted = np.clip(finite_array(distances, "distances", (None,)), 0.0, self.length)
        stops = np.unique(np.concatenate([self.distances, wanted]))
        points = np.column_stack(
            [np.interp(stops, self.distances, self.waypoints[:, axis]) for axis in (0, 1)]
        )
        seen = np.cumsum(gains_along(pdm, points, self.swath_radius))
        return seen[np.searchsorted(stops, wanted)]

    def probability_efficiency(self, problem: SearchProblem) -> float:
        """Return e_p: the probability seen over the probability in the search area."""
        return self.seen_probability(problem.pdm) / problem.probability_in_area


def walking_distances(max_distance: float, steps: int = 50) -> FloatArray:
    """Return the distances at which the paper evaluates a path, (steps + 1,) m, from 0 up."""
    if steps < 1:
        raise InvalidInput(f"steps must be at least 1, not {steps}")
    return np.linspace(0.0, positive(max_distance, "max_distance"), steps + 1)
