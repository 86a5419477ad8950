"""Anytime refinement of paths by annealing moves that keep every step's length."""

from __future__ import annotations

import math
import time
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from wisar_planner.errors import FloatArray
from wisar_planner.planners.cell_vectors import PERIODS
from wisar_planner.planners.random_kernels import StateArray
from wisar_planner.planners.refine_kernels import THRESHOLDS, anneal
from wisar_planner.planners.search_raster import SearchRaster
from wisar_planner.planners.swath_kernels import ADD, REMOVE, paint_path, path_value
from wisar_planner.search.problem import SearchProblem

# Default of what probability seen early is worth in addition, see `path_value`.
EARLY_WEIGHT = 0.5
# Moves per call of the kernel: at first, and always where a number of moves is asked for.
_SLICE = 1000
# Aim for the time of one call, s: short enough to stop soon, long enough to cost nothing.
_SLICE_S = 0.02


@dataclass(frozen=True)
class Schedule:
    """Temperatures of an annealing run, falling geometrically.

    Parameters
    ----------
    hot, cold : float
        First and last temperature, in shares of the path's mean gain per step.
    """

    hot: float = 0.02
    cold: float = 0.002

    def at(self, fraction: float) -> float:
        """Return the temperature after a share of the run."""
        return self.hot * (self.cold / self.hot) ** fraction


@dataclass(frozen=True)
class Annealed:
    """Where an annealing run stands.

    Parameters
    ----------
    points : (N + 1, 2) float64
        The best path so far, in cells.
    current : (N + 1, 2) float64
        The path that annealing has come to, in cells.
    value : float
        What annealing maximises: the weight that the best path sees plus what early weight adds.
    probability : float
        Probability that it sees, by the raster.
    iterations : int
        Moves tried so far.
    fraction : float
        Share of the run that is done.
    """

    points: FloatArray
    current: FloatArray
    value: float
    probability: float
    iterations: int
    fraction: float


def annealing(
    raster: SearchRaster,
    points: FloatArray,
    schedule: Schedule,
    state: StateArray,
    *,
    seconds: float = math.inf,
    iterations: int | None = None,
    early_weight: float = 0.0,
) -> Iterator[Annealed]:
    """Anneal a path in slices.

    Simulated annealing (Kirkpatrick et al. 1983) over moves that keep the length of every step:
    steps are exchanged, reversed, mirrored, relocated or bent within a stretch whose ends stay, and
    the tail is turned or regrown. A move is judged by the change of coverage it makes on the
    raster, so its cost does not grow with the path.

    Parameters
    ----------
    raster : SearchRaster
        The raster. Its counts are in use until the iterator ends or is dropped.
    points : (N + 1, 2) float64
        The path in cells, N >= 1.
    schedule : Schedule
        Temperatures.
    state : (1,) uint64
        Random state; advanced.
    seconds, iterations
        The run ends with the first of them; the temperature falls with the share of `iterations`
        that is done or, without them, with the time.
    early_weight : float
        What weight seen early is worth in addition, see `path_value`.

    Yields
    ------
    Annealed
        After each slice; at least once, unless `iterations` is 0.
    """
    began = time.monotonic()
    best_points, current = points.copy(), points.copy()
    steps = len(points) - 1
    tallies = np.zeros((2, PERIODS), np.int64)
    paint_path(raster.canvas, current, 0, steps, raster.radius, ADD, tallies[0])
    tallies[1] = tallies[0]
    unit = max(1.0, path_value(tallies[0], early_weight) / steps)
    done, size, fraction, ahead = 0, _SLICE, 0.0, 0.0
    try:
        while fraction < 1.0 and iterations != 0:
            if iterations is not None:
                size = min(_SLICE, iterations - done)
                ahead = (done + size) / iterations
            anneal(
                raster.canvas, raster.area, raster.radius, raster.step,
                early_weight, current, best_points, tallies,
                size, unit * schedule.at(fraction), unit * schedule.at(ahead), THRESHOLDS, state,
            )  # fmt: skip
            done += size
            spent = (time.monotonic() - began) / seconds if seconds > 0.0 else 1.0
            if iterations is not None:
                fraction = 1.0 if spent >= 1.0 else ahead
            else:
                slice_s = max((spent - fraction) * seconds, 1e-6)
                size = max(1, round(size * min(2.0, _SLICE_S / slice_s)))
                ahead = min(1.0, 2.0 * spent - fraction)
                fraction = min(1.0, spent)
            value = path_value(tallies[1], early_weight)
            probability = tallies[1, -1] * raster.unit
            yield Annealed(best_points, current, value, probability, done, fraction)
    finally:
        paint_path(raster.canvas, current, 0, steps, raster.radius, REMOVE, tallies[0])


def exact_steps(problem: SearchProblem, raster: SearchRaster, points: FloatArray) -> FloatArray:
    """Return points in cells in metres, (N + 1, 2), from the problem's start in exact steps."""
    moves = np.diff(raster.to_metres(points), axis=0)
    moves *= problem.step_length / np.hypot(*moves.T)[:, None]
    return problem.start + np.concatenate([np.zeros((1, 2)), np.cumsum(moves, axis=0)])
