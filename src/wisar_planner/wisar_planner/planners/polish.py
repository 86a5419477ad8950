"""The last hundredths of a plan: headings by the gradient of the exact seen probability."""

from __future__ import annotations

import importlib
import math
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
import scipy  # Its parts are imported when they are used first, which `preload` may do.

from wisar_planner.errors import FloatArray
from wisar_planner.pdm.boundary import polygon_edges
from wisar_planner.planners.polish_kernels import trespass
from wisar_planner.search.gradient import seen_with_gradient
from wisar_planner.search.problem import SearchProblem

#: Longest path, in steps, that is polished; its metric is a full matrix of that size.
MOST_STEPS = 1000
# How near to the border waypoints may come without being pushed away, in swath radii, and how
# strong the push is there, in units of the strongest pull of the probability.
_MARGIN, _PUSH = 0.02, 4.0
# Share of its mean that is added to the diagonal of the metric: headings alone count, too.
_DAMPING = 0.1
# Steps back from the end of the ascent where that has left the area.
_SHARES = (1.0, 0.5, 0.25, 0.1)
# Where progress per iteration falls below this share of a step's mean gain, the ascent ends.
_TOLERANCE = 1e-5


def preload() -> None:
    """Import what polishing takes of SciPy, which takes as long as all else of a node's start."""
    for part in ("linalg", "optimize"):
        importlib.import_module(f"scipy.{part}")


class Polished(NamedTuple):
    """A path, and what it is worth."""

    value: float
    waypoints: FloatArray


class Polisher:
    """Moves paths of a problem uphill, to where their exact value has no slope any more.

    Annealing judges moves by a raster, and random moves rarely hit the best headings. From where
    it ends, the headings of all steps go up the gradient of the exact seen probability together, by
    L-BFGS (Liu and Nocedal 1989). Lengths of steps stay. As a heading moves all waypoints after it,
    headings are measured by how far they move these. Near the border of the area waypoints are
    pushed back; a path that leaves the area all the same goes only part of the way.

    Parameters
    ----------
    problem : SearchProblem
        Supplies map, area and swath radius.
    early_weight : float
        What probability seen early is worth in addition: this share of the mean of that seen after
        1/8, 3/8 and 3/4 of the path.

    Attributes
    ----------
    evaluations : int
        How often a value and its gradient have been computed.
    """

    def __init__(self, problem: SearchProblem, early_weight: float) -> None:
        self._problem = problem
        self._margin = _MARGIN * problem.swath_radius
        self._edges = polygon_edges(problem.area.polygon)
        steps = problem.steps
        self._prefixes, self._weights = [steps], [1.0]
        if early_weight > 0.0:
            early = [math.ceil(share * steps / 8) for share in (1, 3, 6)]
            self._prefixes, self._weights = [*early, steps], [early_weight / 3.0] * 3 + [1.0]
        self.evaluations = 0

    def valued(self, waypoints: FloatArray) -> Polished:
        """Return a path of all the problem's steps as it is, with its value."""
        return Polished(self._value(waypoints)[0], waypoints)

    def polish(
        self,
        waypoints: FloatArray,
        *,
        on_progress: Callable[[FloatArray], bool] = lambda _: False,
        most_iterations: int | None = None,
        most_evaluations: int | None = None,
    ) -> Polished:
        """Return a path that is worth as much or more.

        Parameters
        ----------
        waypoints : (N + 1, 2) float64
            The path, m: all of the problem's steps.
        on_progress : callable
            Told of the path after each iteration; returns whether to stop.
        most_iterations, most_evaluations : int
            The ascent ends after so many iterations and about so many evaluations; None: at the
            top.
        """
        before, slope = self._value(waypoints)
        start = Polished(before, waypoints)
        steps = len(waypoints) - 1
        if steps > MOST_STEPS or before <= 0.0:
            return start
        ascent = _Ascent(waypoints)
        push = _PUSH * float(np.abs(slope).max()) / self._margin
        unit = steps / before
        pushes = np.empty_like(waypoints)

        def loss(moved: FloatArray) -> tuple[float, FloatArray]:
            points = ascent.path(moved)
            value, gradient = self._value(points)
            value -= push * trespass(points, self._edges, self._margin, pushes)
            return -unit * value, -unit * ascent.slope(moved, gradient - push * pushes)

        def on_iteration(intermediate_result: Any) -> None:
            if on_progress(ascent.path(intermediate_result.x)):
                raise StopIteration

        result = scipy.optimize.minimize(
            loss, np.zeros(steps), jac=True, method="L-BFGS-B", callback=on_iteration,
            options={
                "maxcor": 20, "ftol": _TOLERANCE / steps, "gtol": 0.0,
                "maxiter": most_iterations or 1 << 30, "maxfun": most_evaluations or 1 << 30,
            },
        )  # fmt: skip
        for share in _SHARES:
            points = ascent.path(share * result.x)
            if self._problem.area.contains_legs(points[:-1], points[1:]).all():
                found = self.valued(points)
                if found.value > before:
                    return found
        return start

    def _value(self, waypoints: FloatArray) -> tuple[float, FloatArray]:
        self.evaluations += 1
        radius = self._problem.swath_radius
        return seen_with_gradient(
            self._problem.pdm, waypoints, radius, self._prefixes, self._weights
        )


class _Ascent:
    """The headings of a path as coordinates in which no direction is much steeper than others.

    Headings h move waypoints by A h for small h. With A'A, and a little of the identity, as the
    metric, a unit of each coordinate moves waypoints by about the same sum of squares.
    """

    def __init__(self, waypoints: FloatArray) -> None:
        moves = np.diff(waypoints, axis=0)
        self._start = waypoints[:1]
        self._lengths = np.hypot(*moves.T)
        self._headings = np.arctan2(moves[:, 1], moves[:, 0])
        steps = len(moves)
        left = np.arange(steps, 0, -1)
        across = np.column_stack([-moves[:, 1], moves[:, 0]])
        metric = (across @ across.T) * np.minimum.outer(left, left)
        metric[np.diag_indices(steps)] += _DAMPING * np.trace(metric) / steps
        self._root = scipy.linalg.cholesky(metric)

    def path(self, moved: FloatArray) -> FloatArray:
        """Return the waypoints, (N + 1, 2) m, for coordinates, (N,); 0 is where it began."""
        steps = self._lengths[:, None] * self._directions(moved)
        return np.concatenate([self._start, self._start + np.cumsum(steps, axis=0)])

    def slope(self, moved: FloatArray, gradient: FloatArray) -> FloatArray:
        """Return the gradient by coordinates for that by waypoints, (N + 1, 2)."""
        after = np.cumsum(gradient[:0:-1], axis=0)[::-1]  # A heading moves all waypoints after it.
        cos, sin = self._directions(moved).T
        by_headings = self._lengths * (after[:, 1] * cos - after[:, 0] * sin)
        return scipy.linalg.solve_triangular(self._root, by_headings, trans="T", check_finite=False)

    def _directions(self, moved: FloatArray) -> FloatArray:
        turns = scipy.linalg.solve_triangular(self._root, moved, check_finite=False)
        turned = self._headings + turns
        return np.column_stack([np.cos(turned), np.sin(turned)])
