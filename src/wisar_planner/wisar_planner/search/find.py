"""When a path first passes a missing person."""

from __future__ import annotations

import numpy.typing as npt

from wisar_planner.errors import FloatArray, finite_array
from wisar_planner.search.find_kernels import first_distances
from wisar_planner.search.path import SearchPath


def distance_to_find(path: SearchPath, persons: npt.ArrayLike) -> FloatArray:
    """Return the distance flown when each person first lies within the swath radius.

    The entry into the disc around a person is solved on each leg; nothing is stepped.

    Parameters
    ----------
    path : SearchPath
        The path flown.
    persons : (P, 2) array_like
        Positions of the persons, m.

    Returns
    -------
    (P,) float64
        Distance in metres from the first waypoint; infinity for those never seen.
    """
    points = finite_array(persons, "persons", (None, 2))
    return first_distances(path.waypoints, path.distances, path.swath_radius, points)
