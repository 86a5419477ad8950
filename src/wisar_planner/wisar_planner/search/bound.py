"""How much any path could see at best."""

from __future__ import annotations

import math

from wisar_planner.errors import InvalidInput
from wisar_planner.search.problem import SearchProblem


def upper_bound(problem: SearchProblem, distance: float | None = None) -> float:
    r"""Return a probability efficiency that no path of the problem can beat.

    A path of length L sees at most :math:`2 R L + \pi R^2` square metres, all of them within the
    swath radius R of the area as long as its waypoints and the legs between them stay inside. So
    it sees at most the mass of the most probable part of that size of the area widened by R.

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
    length = problem.max_distance if distance is None else float(distance)
    if not (math.isfinite(length) and length >= 0.0):
        raise InvalidInput(f"distance must be finite and not negative, not {distance}")
    radius = problem.swath_radius
    seen = 2.0 * radius * length + math.pi * radius**2
    # A mitred buffer contains the round one and keeps a rectangle a rectangle.
    region = problem.area.polygon.buffer(radius, join_style="mitre")
    return problem.pdm.most_probable_mass(region, seen) / problem.probability_in_area
