"""Compiled kernels of the gradient of the seen probability."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import numpy.typing as npt
from numba import njit

from wisar_planner.errors import FloatArray
from wisar_planner.search.capsule_kernels import part_point
from wisar_planner.search.union_kernels import CAPSULES, Union

_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(3)


@njit(cache=True)
def boundary_samples(
    union: Union, longest: float
) -> tuple[FloatArray, FloatArray, FloatArray, npt.NDArray[np.int64]]:
    """Return points along the boundary of a union, and what moves the boundary there.

    Parameters
    ----------
    union : Union
        The union of the capsules of a path's steps.
    longest : float
        Longest stretch, m, that one rule of three points integrates along.

    Returns
    -------
    points : (M, 2) float64
        Where they are, m.
    pulls : (M, 2) float64
        Outward normals times the length of boundary that a point stands for, m.
    shares : (M,) float64
        How much of a motion of the step's end the boundary follows there; the rest of 1 it follows
        the step's start.
    steps : (M,) int64
        The steps whose swaths end there.
    """
    capsules, pieces = union.capsules, union.pieces
    count = 0
    for i in range(union.used[CAPSULES]):
        index = capsules[i]["first"]
        while index >= 0:
            count += _panels(capsules[i]["radius"], pieces[index], longest) * len(_NODES)
            index = pieces[index]["next"]
    points, pulls = np.empty((count, 2)), np.empty((count, 2))
    shares, steps = np.empty(count), np.empty(count, np.int64)
    at = 0
    for i in range(union.used[CAPSULES]):
        capsule = capsules[i]
        ax, ay, ux, uy = capsule["ax"], capsule["ay"], capsule["ux"], capsule["uy"]
        radius, length = capsule["radius"], capsule["length"]
        index = capsule["first"]
        while index >= 0:
            piece = pieces[index]
            part = piece["part"]
            panels = _panels(radius, piece, longest)
            half = 0.5 * (piece["end"] - piece["begin"]) / panels
            for k in range(panels):
                middle = piece["begin"] + (2 * k + 1) * half
                for node in range(len(_NODES)):
                    t = middle + half * _NODES[node]
                    x, y = part_point(capsule, part, t)
                    points[at, 0], points[at, 1] = ax + x, ay + y
                    steps[at] = capsule["step"]
                    weight = half * _WEIGHTS[node]
                    if part == 0:
                        shares[at] = t / length
                        pulls[at, 0], pulls[at, 1] = weight * uy, -weight * ux
                    elif part == 2:
                        shares[at] = 1.0 - t / length
                        pulls[at, 0], pulls[at, 1] = -weight * uy, weight * ux
                    elif part == 1:
                        shares[at] = 1.0
                        pulls[at, 0] = weight * (x - capsule["bx"] + ax)
                        pulls[at, 1] = weight * (y - capsule["by"] + ay)
                    else:
                        shares[at] = 0.0
                        pulls[at, 0], pulls[at, 1] = weight * x, weight * y
                    at += 1
            index = piece["next"]
    return points, pulls, shares, steps


@njit(cache=True)
def _panels(radius: float, piece: Any, longest: float) -> int:
    """Return into how many stretches a piece is cut."""
    extent = piece["end"] - piece["begin"]
    length = extent * radius if piece["part"] % 2 == 1 else extent
    return max(1, math.ceil(length / longest))


@njit(cache=True)
def add_pulls(
    densities: FloatArray,
    pulls: FloatArray,
    shares: FloatArray,
    steps: npt.NDArray[np.int64],
    weight: float,
    gradient: FloatArray,
) -> None:
    """Add the gradient with respect to each waypoint, (N + 1, 2), times a weight."""
    for k in range(len(densities)):
        step = steps[k]
        for axis in range(2):
            pull = weight * densities[k] * pulls[k, axis]
            gradient[step + 1, axis] += shares[k] * pull
            gradient[step, axis] += (1.0 - shares[k]) * pull
