"""Anytime search over whole paths: greedy rollouts to promising places, then annealing."""

from __future__ import annotations

import dataclasses
import itertools
import math
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from wisar_planner.errors import FloatArray
from wisar_planner.planners.base import OnProgress, OptionedPlanner, ShouldStop, option
from wisar_planner.planners.cell_vectors import PERIODS
from wisar_planner.planners.greedy import Greedy
from wisar_planner.planners.monitor import Monitor
from wisar_planner.planners.random_kernels import random_state
from wisar_planner.planners.refine import EARLY_WEIGHT, exact_steps
from wisar_planner.planners.rollout_kernels import rollout
from wisar_planner.planners.search_raster import COARSE, SearchRaster
from wisar_planner.planners.stages import Found, Stages, WaysOn
from wisar_planner.planners.swath_kernels import path_value
from wisar_planner.search.path import SearchPath
from wisar_planner.search.problem import SearchProblem

# Headings per step of a rollout.
_HEADINGS = 24
# Rollouts: how strongly they keep to what is seen, and their first headings at the target.
_HUGS = (0.0, 0.1, 0.2)
_ARRIVALS = (math.nan, *(2.0 * math.pi * k / 8 for k in range(8)))
# Most places that rollouts fly to first.
_MOST_TARGETS = 6
# Share of the time that the first paths may take.
FIRST_SHARE = 0.2


@dataclass(frozen=True)
class Lookahead(OptionedPlanner):
    """The best path that a time budget finds; the bar for learned policies.

    First come rollouts, whole paths that fly straight to one of the peaks of the map (or to none),
    leave it in one of several directions and go on greedily, more or less closely along what they
    have seen. The best are refined by simulated annealing on a raster: many for a short while, the
    best of those for longer. These go up the gradient of what they really see; then the best of all
    is shaken and does so again, until the budget is spent. See `Stages`.
    """

    name: ClassVar[str] = "lookahead"

    time_budget_s: float = option(2.0, "Time to search, s.", minimum=0.01, maximum=86400.0)
    max_iterations: int = option(
        0,
        "Number of annealing moves, or of what takes as long; above 0 it replaces the time budget, "
        "and the path then depends on the problem and the seed alone.",
        minimum=0,
    )
    early_weight: float = option(
        EARLY_WEIGHT,
        "Worth of probability seen early: this share of the mean probability seen after 1/8, 3/8 "
        "and 3/4 of the path is added to what the whole path sees; 0 counts the end alone.",
        minimum=0.0,
    )
    seed: int = option(0, "Seed of the random choices.", minimum=0)

    def plan(
        self,
        problem: SearchProblem,
        *,
        on_progress: OnProgress | None = None,
        should_stop: ShouldStop | None = None,
    ) -> SearchPath:
        """Return the best path found in time; see `Planner.plan`."""
        if problem.steps == 0:
            return SearchPath(problem.start[None], problem.swath_radius, self.name)
        timed = self.max_iterations == 0
        monitor = Monitor(
            problem,
            self.time_budget_s if timed else math.inf,
            math.inf if timed else self.max_iterations,
            on_progress,
            should_stop,
        )
        raster = SearchRaster(problem, COARSE)
        found, ways_on = self._first_paths(problem, raster, monitor)
        if not found:
            # No whole step stays inside the area everywhere: the greedy planner takes shorter ones.
            path = Greedy().plan(problem, on_progress=on_progress, should_stop=should_stop)
            return dataclasses.replace(path, planner=self.name)
        state = random_state(np.random.default_rng(self.seed))
        stages = Stages(problem, raster, monitor, state, self.early_weight, ways_on)
        return SearchPath(stages.best_of(found), problem.swath_radius, self.name)

    def _first_paths(
        self, problem: SearchProblem, raster: SearchRaster, monitor: Monitor
    ) -> tuple[list[Found], WaysOn | None]:
        """Return the paths that the search begins with, and what finds other ways on from one."""
        return self._rollouts(problem, raster, monitor, until=FIRST_SHARE), None

    def _rollouts(
        self, problem: SearchProblem, raster: SearchRaster, monitor: Monitor, until: float
    ) -> list[Found]:
        """Return rollouts, the likeliest kinds first: all, or until a share of the time is spent.

        The first is flown in any case. Those that find no way in the area are left out.
        """
        blocks, block_cells, targets = _blocks(problem, raster)
        start = raster.to_cells(problem.start)
        tally = np.zeros(PERIODS, np.int64)
        found = []
        for arrival, hug, target in itertools.product(_ARRIVALS, _HUGS, [-1, *targets]):
            points = np.empty((problem.steps + 1, 2))
            points[0] = start
            complete = rollout(
                raster.canvas, raster.area, raster.radius,
                raster.step, blocks, block_cells, target, arrival, hug, _HEADINGS, points, tally,
            )  # fmt: skip
            if complete:
                found.append(Found(path_value(tally, self.early_weight), points))
                monitor.report(exact_steps(problem, raster, points))
            else:
                monitor.asked_to_stop()
            if monitor.stopped() or monitor.spent() > until:
                break
        return found


def _blocks(problem: SearchProblem, raster: SearchRaster) -> tuple[FloatArray, float, list[int]]:
    """Return coarse blocks of the map, the cells in each, and the blocks worth flying to.

    A block is a quarter of the radius of the disc that the whole budget covers. Worth flying to are
    local maxima, by their weight times the share of the budget that is left on arrival.
    """
    covered = 2.0 * raster.radius * raster.step * max(problem.steps, 1)
    size = max(1, round(0.25 * math.sqrt(covered / math.pi)))
    rows, columns = (math.ceil(n / size) for n in raster.canvas.weights.shape)
    padded = np.zeros((rows * size, columns * size))
    padded[: raster.canvas.weights.shape[0], : raster.canvas.weights.shape[1]] = (
        raster.canvas.weights
    )
    weight = padded.reshape(rows, size, columns, size).sum(axis=(1, 3))
    y, x = np.mgrid[0:rows, 0:columns] * size + 0.5 * (size - 1)
    centres = np.stack([x, y], axis=-1)
    inside = problem.area.contains(raster.to_metres(centres).reshape(-1, 2)).reshape(x.shape)
    start = raster.to_cells(problem.start)
    if not inside.any():
        return np.array([[*start, 0.0]]), float(size**2), []
    weight = np.where(inside, weight, 0.0)
    distance = np.hypot(*(centres - start).transpose(2, 0, 1))
    worth = weight * np.maximum(0.0, 1.0 - distance / (raster.step * max(problem.steps, 1)))
    around = sliding_window_view(np.pad(weight, 1), (3, 3)).max(axis=(2, 3))
    peaks = (weight == around) & (worth > 0.05 * worth.max())
    order = np.flatnonzero(inside)
    targets = np.flatnonzero(peaks.ravel()[order])
    targets = targets[np.argsort(-worth.ravel()[order][targets], kind="stable")][:_MOST_TARGETS]
    blocks = np.concatenate([centres.reshape(-1, 2), weight.reshape(-1, 1)], axis=1)[order]
    return blocks, float(size**2), [int(t) for t in targets]
