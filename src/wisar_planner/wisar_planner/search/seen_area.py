"""The area that a drone has seen, step by step."""

from __future__ import annotations

import copy
import math
from collections.abc import Callable
from typing import Any

import numpy as np
import numpy.typing as npt

from wisar_planner.errors import FloatArray, InvalidInput, finite_array, positive
from wisar_planner.pdm import ProbabilityMap
from wisar_planner.search import union_kernels as kernels
from wisar_planner.search.capsule_kernels import CAPSULE, MOST_CUTS


class SeenArea:
    """The union of everything within the swath radius of the steps flown so far.

    The area has true round ends and is kept exactly; a step costs the same after 50 steps as
    after 5,000, as long as as many of them pass near by.

    Parameters
    ----------
    pdm : ProbabilityMap
        Where the person may be.
    swath_radius : float
        Distance to either side of a step that is seen, m.

    Attributes
    ----------
    probability : float
        Probability seen so far: the sum of the gains of all steps added.

    Raises
    ------
    InvalidInput
        When `swath_radius` is not finite and positive.
    """

    def __init__(self, pdm: ProbabilityMap, swath_radius: float) -> None:
        self.pdm = pdm
        self.swath_radius = positive(swath_radius, "swath_radius")
        self.probability = 0.0
        self._union = CapsuleUnion(self.swath_radius, steps=16)

    def add(self, start: npt.ArrayLike, end: npt.ArrayLike) -> float:
        """Add a step and return the probability that it newly sees.

        Parameters
        ----------
        start, end : (2,) array_like
            Ends of the step, m. They may be equal: hovering sees a disc.

        Raises
        ------
        InvalidInput
            When an end is not a finite point.
        """
        gain = float(self._union.add(_point(start, "start"), _point(end, "end"), self.pdm)[0])
        self.probability += gain
        return gain

    def gains(self, start: npt.ArrayLike, ends: npt.ArrayLike) -> FloatArray:
        """Return what each of several candidate steps would newly see, without adding any.

        Parameters
        ----------
        start : (2,) array_like
            Where the steps begin, m.
        ends : (M, 2) array_like
            Where they end, m.

        Returns
        -------
        (M,) float64

        Raises
        ------
        InvalidInput
            When a point is not finite.
        """
        candidates = finite_array(ends, "ends", (None, 2))
        return self._union.gains(_point(start, "start")[0], candidates, self.pdm)

    def copy(self) -> SeenArea:
        """Return an independent copy."""
        other = copy.copy(self)
        other._union = self._union.copy()
        return other


def gains_along(pdm: ProbabilityMap, waypoints: FloatArray, radius: float) -> FloatArray:
    """Return the probability newly seen at each waypoint of a path, (N + 1,).

    The first is that of the disc around the first waypoint.
    """
    union = CapsuleUnion(radius, steps=len(waypoints))
    return union.add(np.concatenate([waypoints[:1], waypoints[:-1]]), waypoints, pdm)


def probability_seen(pdm: ProbabilityMap, waypoints: FloatArray, radius: float) -> float:
    """Return the probability within `radius` of a path, (N + 1, 2) m."""
    union = CapsuleUnion(radius, steps=len(waypoints))
    legs = max(len(waypoints) - 1, 1)  # A single point is a leg of length 0.
    union.add(waypoints[:legs], waypoints[-legs:])
    boundary = union.boundary()
    return float(pdm.integrate_boundary(boundary, np.zeros(len(boundary), np.int64), 1)[0])


def _point(value: npt.ArrayLike, name: str) -> FloatArray:
    """Return a point as an array, (1, 2)."""
    point = np.asarray(value, dtype=np.float64)
    if point.shape != (2,) or not math.isfinite(point[0] + point[1]):
        raise InvalidInput(f"{name} must be a point of two finite numbers in metres, not {value!r}")
    return point.reshape(1, 2)


class CapsuleUnion:
    """Owner of the arrays that the kernels work on; they grow when a kernel finds them full."""

    def __init__(self, radius: float, steps: int) -> None:
        self.radius = radius
        self.arrays = kernels.Union(
            capsules=np.empty(steps + 1, CAPSULE),
            boxes=np.empty((steps + 1, 5, 4)),
            pieces=np.empty(8 * steps, kernels.PIECE),
            cells=_empty_cells(16 * steps),
            entries=np.empty(8 * steps, kernels.ENTRY),
            used=np.zeros(8, np.int64),
            neighbours=np.empty(64, np.int64),
            fresh=np.empty(256, kernels.PIECE),
            covers=np.empty((4, 128, 2)),
            n_covers=np.empty(4, np.int64),
            cuts=np.empty((2, 4, MOST_CUTS)),
            cut_counts=np.empty((2, 4), np.int64),
            out=np.empty((16 * steps + 64, 5)),
            owners=np.empty(16 * steps + 64, np.int64),
        )
        self.arrays.used[kernels.FREE] = -1

    def add(
        self, starts: FloatArray, ends: FloatArray, pdm: ProbabilityMap | None = None
    ) -> FloatArray:
        """Add steps and return what each newly sees, (N,); nothing, (0,), without a map."""
        return self._run(
            lambda first: kernels.add_steps(
                self.arrays, self.radius, starts, ends, first, pdm is not None
            ),
            len(ends),
            pdm,
        )

    def gains(self, start: FloatArray, ends: FloatArray, pdm: ProbabilityMap) -> FloatArray:
        """Return what each of several steps would newly see, (N,)."""
        return self._run(
            lambda first: kernels.try_steps(self.arrays, self.radius, start, ends, first),
            len(ends),
            pdm,
        )

    def boundary(self) -> FloatArray:
        """Return the boundary of the union as pieces, (N, 5)."""
        return kernels.union_boundary(self.arrays)

    def copy(self) -> CapsuleUnion:
        """Return a copy that shares only the room to work in."""
        other = copy.copy(self)
        kept = ("capsules", "boxes", "pieces", "cells", "entries", "used")
        other.arrays = self.arrays._replace(
            **{name: getattr(self.arrays, name).copy() for name in kept}
        )
        return other

    def _run(
        self, kernel: Callable[[int], int], count: int, pdm: ProbabilityMap | None
    ) -> FloatArray:
        """Run a kernel over all its steps, growing the arrays whenever it stops for room."""
        self.arrays.used[kernels.OUT] = 0
        done = kernel(0)
        while done < count:
            self._grow()
            done = kernel(done)
        if pdm is None:
            return np.empty(0)
        written = self.arrays.used[kernels.OUT]
        gains = pdm.integrate_boundary(
            self.arrays.out[:written], self.arrays.owners[:written], count
        )
        return np.maximum(gains, 0.0)  # Negative only by rounding.

    def _grow(self) -> None:
        """Double all arrays."""
        old = self.arrays
        cells = _empty_cells(2 * len(old.cells))
        kernels.rehash(old.cells, cells)
        longer = {
            name: np.concatenate([getattr(old, name), np.empty_like(getattr(old, name))])
            for name in (
                "capsules", "boxes", "pieces", "entries", "neighbours", "fresh", "out", "owners",
            )
        }  # fmt: skip
        covers = np.empty((4, 2 * old.covers.shape[1], 2))
        self.arrays = old._replace(cells=cells, covers=covers, **longer)


def _empty_cells(count: int) -> npt.NDArray[Any]:
    """Return an empty hash table for at least `count` cells; its size is a power of two."""
    cells = np.empty(1 << max(4, math.ceil(math.log2(count))), kernels.CELL)
    cells["key"] = kernels.EMPTY_KEY
    return cells
