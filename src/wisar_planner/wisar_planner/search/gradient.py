"""How the probability that a path sees changes when its waypoints move."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from wisar_planner.errors import FloatArray
from wisar_planner.pdm import ProbabilityMap
from wisar_planner.search import gradient_kernels as kernels
from wisar_planner.search.seen_area import CapsuleUnion

# Longest stretch of boundary, in swath radii, that the density is sampled three times along.
_STRETCH = 1.0


def seen_with_gradient(
    pdm: ProbabilityMap,
    waypoints: FloatArray,
    radius: float,
    prefixes: Sequence[int],
    weights: Sequence[float],
) -> tuple[float, FloatArray]:
    r"""Return the probability seen, summed over several parts of a path, and its gradient.

    When waypoints move, the probability seen changes by what the boundary of the seen area sweeps
    (Reynolds' transport theorem): :math:`dP = \oint p(x) \, n \cdot dx \, ds` along the boundary
    of the union of all swaths. A side of a swath follows both ends of its step, the nearer one
    more; a round end follows its waypoint.

    Parameters
    ----------
    pdm : ProbabilityMap
        Where the person may be.
    waypoints : (N + 1, 2) float64
        The path, m, N >= 1.
    radius : float
        Swath radius, m.
    prefixes : sequence of int
        Parts of the path, each from its begin, by their number of steps; rising, 1 to N.
    weights : sequence of float
        What the probability that each part sees counts.

    Returns
    -------
    value : float
        The weighted sum; exact.
    gradient : (N + 1, 2) float64
        Its derivative by each coordinate, 1/m. Along the boundary the density is sampled: exact to
        some 1e-5 of the largest for smooth maps, less so for rasters of coarse cells.
    """
    union = CapsuleUnion(radius, steps=len(waypoints))
    gradient = np.zeros_like(waypoints)
    boundaries, begin = [], 0
    for end, weight in zip(prefixes, weights, strict=True):
        union.add(waypoints[begin:end], waypoints[begin + 1 : end + 1])
        boundaries.append(union.boundary())
        points, pulls, shares, steps = kernels.boundary_samples(union.arrays, _STRETCH * radius)
        kernels.add_pulls(pdm.density(points), pulls, shares, steps, weight, gradient)
        begin = end
    regions = np.repeat(np.arange(len(boundaries)), [len(each) for each in boundaries])
    seen = pdm.integrate_boundary(np.concatenate(boundaries), regions, len(boundaries))
    return float(seen @ np.asarray(weights)), gradient
