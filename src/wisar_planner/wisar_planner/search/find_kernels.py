"""Compiled kernel of the distance to find."""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from wisar_planner.errors import FloatArray


@njit(cache=True)
def first_distances(
    waypoints: FloatArray, distances: FloatArray, radius: float, persons: FloatArray
) -> FloatArray:
    """Return the distance flown when each person first lies within `radius`, else infinity."""
    found = np.full(len(persons), np.inf)
    square = radius * radius
    for p in range(len(persons)):
        px, py = persons[p, 0], persons[p, 1]
        dx, dy = px - waypoints[0, 0], py - waypoints[0, 1]
        if dx * dx + dy * dy <= square:
            found[p] = 0.0
            continue
        for i in range(len(waypoints) - 1):
            length = distances[i + 1] - distances[i]
            ux = (waypoints[i + 1, 0] - waypoints[i, 0]) / length
            uy = (waypoints[i + 1, 1] - waypoints[i, 1]) / length
            dx, dy = px - waypoints[i, 0], py - waypoints[i, 1]
            along = dx * ux + dy * uy
            if along < 0.0:  # Flying away from a person who was not in sight at the waypoint.
                continue
            across = dx * uy - dy * ux
            inside = square - across * across
            if inside < 0.0:
                continue
            entry = along - math.sqrt(inside)
            if entry <= length:
                found[p] = distances[i] + max(entry, 0.0)
                break
    return found
