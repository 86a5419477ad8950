"""How much any path could see at best."""

from __future__ import annotations

import math

import numpy as np
import shapely
from shapely import MultiPolygon, Polygon

from wisar_planner.errors import InvalidInput
from wisar_planner.search.bound_kernels import scheduled_mass
from wisar_planner.search.path import SearchPath
from wisar_planner.search.problem import SearchProblem

# Time slots of the reachable bound: a distance is rounded down by less than 0.03% of the budget.
_SLOTS = 4096


def upper_bound(problem: SearchProblem, distance: float | None = None) -> float:
    r"""Return a probability efficiency that no path of the problem can beat.

    A path of length L sees at most :math:`2 R L + \pi R^2` square metres, all of them within the
    swath radius R of the area as long as its waypoints and the legs between them stay inside. So
    it sees at most the mass of the most probable part of that size of the area widened by R. For
    a path that leaves the area it does not hold, see `bound_holds`.

    Parameters
    ----------
    problem : SearchProblem
        The search problem.
    distance : float, optional
        Length L of the path, m; `problem.max_distance` unless given.

    Returns
    -------
    float
        Upper bound of the probability efficiency e_p. It may pass 1 slightly where a path can see
        mass outside the area, which the paper's e_p counts.

    Raises
    ------
    InvalidInput
        When `distance` is negative or not finite.
    """
    length = _checked_length(problem, distance)
    radius = problem.swath_radius
    seen = 2.0 * radius * length + math.pi * radius**2
    return problem.pdm.most_probable_mass(_visible(problem), seen) / problem.probability_in_area


def length_outside(problem: SearchProblem, path: SearchPath) -> float:
    """Return how many metres of a path lie outside the area by more than rounding."""
    legs = shapely.linestrings(np.stack((path.waypoints[:-1], path.waypoints[1:]), axis=1))
    widened = problem.area.polygon.buffer(1e-6 * problem.step_length, join_style="mitre")
    shapely.prepare(widened)
    # Leg by leg: where the path crosses itself, each time counts.
    leaving = legs[~shapely.covers(widened, legs)]
    return float(shapely.length(shapely.difference(leaving, widened)).sum())


def bound_holds(problem: SearchProblem, path: SearchPath) -> bool:
    """Return whether `upper_bound` holds for a path: it does for those that stay in the area.

    Patterns fly across between the separate parts of an area. What lies outside by less than a
    hundredth of the swath radius changes nothing.
    """
    return length_outside(problem, path) <= 0.01 * problem.swath_radius


def reachable_bound(problem: SearchProblem, distance: float | None = None) -> float:
    r"""Return a probability efficiency that no path from the start of the problem can beat.

    It is at most `upper_bound`, and lower where probable ground lies far from the start. It
    holds for paths that begin at `problem.start`; a pattern that begins at its own first point is
    bounded by `upper_bound` alone.

    Parameters
    ----------
    problem : SearchProblem
        The search problem.
    distance : float, optional
        Length L of the path, m; `problem.max_distance` unless given.

    Returns
    -------
    float
        Upper bound of the probability efficiency e_p.

    Raises
    ------
    InvalidInput
        When `distance` is negative or not finite.

    Notes
    -----
    *The limits.* After t metres the path is within t of the start. So it sees nothing farther
    than :math:`\rho` from the start before it has flown :math:`\rho - R`. A disc of radius R that
    moves a metre sees at most 2 R square metres that it did not see where it was. Hence, for
    every :math:`\rho`, the seen area farther than :math:`\rho` from the start is at most

    .. math:: c(\rho) = 2 R (L - \rho + R)  \text{ for } R \le \rho \le L + R, \qquad
              c(\rho) = 2 R L + \pi (R^2 - \rho^2)  \text{ for } \rho \le R,

    what the first disc sees out there and what the rest of the path adds; :math:`c(0)` is the
    limit of `upper_bound`.

    *The most mass within them.* Think of the path as time slots in which :math:`-c'(\rho)` square
    metres per metre of :math:`\rho` can be seen. The sets farther than some :math:`\rho` are
    nested, so areas keep within all limits exactly when they can be put into slots no earlier than
    their own :math:`\rho`: unit jobs with release dates. What can be scheduled is a (poly)matroid,
    on which the greedy algorithm, pieces by falling density, is exact (Edmonds 1971, "Matroids and
    the greedy algorithm", Mathematical Programming 1).

    *On a raster.* The map hands out squares as pieces of uniform density that are never less
    probable than the map (`ProbabilityMap.density_pieces`). A square counts as near as its nearest
    point, and distances are rounded down to slots: every limit is applied to less ground than it
    holds for, so the result remains a bound.
    """
    length = _checked_length(problem, distance)
    radius = problem.swath_radius
    reach = length + radius
    limit = shapely.box(*(problem.start - reach), *(problem.start + reach))
    parts = shapely.get_parts(shapely.intersection(_visible(problem), limit))
    region = MultiPolygon([part for part in parts if isinstance(part, Polygon)])
    pieces = problem.pdm.density_pieces(region, radius)
    # From the start to the nearest point of each square.
    low = pieces.corners - problem.start
    beside = np.maximum(np.maximum(low, -(low + pieces.side)), 0.0)
    near = np.hypot(beside[:, 0], beside[:, 1])
    rings = np.linspace(0.0, reach, _SLOTS + 1)
    limits = 2.0 * radius * np.minimum(reach - rings, length)
    limits += math.pi * np.maximum(radius**2 - rings**2, 0.0)
    # A hair nearer, lest rounding puts a square one slot too late.
    release = np.floor(near * ((1.0 - 1e-12) * _SLOTS / reach)).astype(np.int64)
    mass = scheduled_mass(
        np.argsort(-pieces.densities),
        np.minimum(release, _SLOTS),
        pieces.areas,
        pieces.densities,
        -np.diff(limits),
    )
    return min(mass / problem.probability_in_area, upper_bound(problem, length))


def _checked_length(problem: SearchProblem, distance: float | None) -> float:
    length = problem.max_distance if distance is None else float(distance)
    if not (math.isfinite(length) and length >= 0.0):
        raise InvalidInput(f"distance must be finite and not negative, not {distance}")
    return length


def _visible(problem: SearchProblem) -> Polygon | MultiPolygon:
    """Return the ground that can be seen from the area, or a little more."""
    # A mitred buffer contains the round one and keeps a rectangle a rectangle.
    return problem.area.polygon.buffer(problem.swath_radius, join_style="mitre")
