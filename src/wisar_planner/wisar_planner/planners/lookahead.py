"""Anytime search over whole paths: greedy rollouts to promising places, then annealing."""

from __future__ import annotations

import dataclasses
import heapq
import itertools
import math
import time
from dataclasses import dataclass
from typing import ClassVar, NamedTuple

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from wisar_planner.errors import FloatArray
from wisar_planner.planners.base import (
    OnProgress,
    OptionedPlanner,
    PlanProgress,
    ShouldStop,
    option,
)
from wisar_planner.planners.cell_vectors import PERIODS
from wisar_planner.planners.greedy import Greedy
from wisar_planner.planners.random_kernels import random_state
from wisar_planner.planners.refine import EARLY_WEIGHT, Schedule, annealing, as_path
from wisar_planner.planners.rollout_kernels import rollout
from wisar_planner.planners.search_raster import COARSE, FINE, SearchRaster
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
# Paths whose exact seen probability is compared where the search was stopped early.
_FINALISTS = 3
# Share of the time that the first paths may take.
FIRST_SHARE = 0.2


class _Stage(NamedTuple):
    """One round of annealing: how many paths, how fine, until which share of the budget."""

    paths: int
    cells_per_radius: float
    until: float
    schedule: Schedule


# Many paths shortly, the best of them longer, the best of all to the end.
_STAGES = (
    _Stage(8, COARSE, 0.3, Schedule(0.05, 0.005)),
    _Stage(3, COARSE, 0.5, Schedule(0.03, 0.005)),
    _Stage(1, FINE, 1.0, Schedule(0.02, 0.002)),
)
# Where there is time for few moves a step: fewer paths, and longer on the raster of fast moves.
_SHORT_STAGES = (
    _Stage(3, COARSE, 0.3, Schedule(0.05, 0.005)),
    _Stage(1, COARSE, 0.75, Schedule(0.04, 0.005)),
    _Stage(1, FINE, 1.0, Schedule(0.01, 0.002)),
)
# So many moves a step are few, and so many moves are about what a machine makes in a second.
_FEW_MOVES, _MOVES_PER_SECOND = 700.0, 160_000.0


class Found(NamedTuple):
    """A path in cells, and its value with what early weight adds."""

    value: float
    points: FloatArray


@dataclass(frozen=True)
class Lookahead(OptionedPlanner):
    """The best path that a time budget finds; the bar for learned policies.

    First come rollouts, whole paths that fly straight to one of the peaks of the map (or to none),
    leave it in one of several directions and go on greedily, more or less closely along what they
    have seen. The best are refined by simulated annealing, see `annealing`: many for a short while,
    the best of those for longer, and the last one for the rest of the budget. All this works on
    rasters; only of a search that was stopped before one path was left, the best few are compared
    by their exact seen probability.
    """

    name: ClassVar[str] = "lookahead"

    time_budget_s: float = option(2.0, "Time to search, s.", minimum=0.01, maximum=86400.0)
    max_iterations: int = option(
        0,
        "Number of annealing moves; above 0 it replaces the time budget, and the path then depends "
        "on the problem and the seed alone.",
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
        monitor = Monitor(problem, self._seconds, on_progress, should_stop)
        raster = SearchRaster(problem, COARSE)
        found = self._first_paths(problem, raster, monitor)
        if not found:
            # No whole step stays inside the area everywhere: the greedy planner takes shorter ones.
            path = Greedy().plan(problem, on_progress=on_progress, should_stop=should_stop)
            return dataclasses.replace(path, planner=self.name)
        state = random_state(np.random.default_rng(self.seed))
        begins = 0.0
        for stage in self._stages(problem.steps):
            if monitor.stopped():
                break
            found = heapq.nlargest(stage.paths, found, key=lambda each: each.value)
            if stage.cells_per_radius != raster.cells_per_radius:
                flown = [raster.to_metres(each.points) for each in found]
                raster = SearchRaster(problem, stage.cells_per_radius, np.concatenate(flown))
                found = [
                    each._replace(points=raster.to_cells(points))
                    for each, points in zip(found, flown, strict=True)
                ]
            for i, each in enumerate(found):
                if monitor.stopped():
                    break
                share = (stage.until - begins) / len(found)
                until = begins + (i + 1) * share
                seconds = max(0.0, (until - monitor.spent()) * self._seconds)
                run = annealing(
                    raster, each.points, stage.schedule, state,
                    seconds=seconds if self._timed else math.inf,
                    iterations=None if self._timed else math.ceil(share * self.max_iterations),
                    early_weight=self.early_weight,
                )  # fmt: skip
                for now in run:
                    found[i] = Found(now.value, now.points)
                    monitor.report(now.probability, until - (1.0 - now.fraction) * share)
                    if monitor.stopped():
                        break
            begins = stage.until
        finalists = heapq.nlargest(_FINALISTS, found, key=lambda each: each.value)
        paths = [as_path(problem, raster, each.points, self.name) for each in finalists]
        return max(paths, key=lambda path: path.seen_probability(problem.pdm))

    @property
    def _timed(self) -> bool:
        return self.max_iterations == 0

    @property
    def _seconds(self) -> float:
        return self.time_budget_s if self._timed else math.inf

    def _stages(self, steps: int) -> tuple[_Stage, ...]:
        """Return the rounds of annealing for paths of so many steps."""
        moves = self.max_iterations or _MOVES_PER_SECOND * self.time_budget_s
        return _SHORT_STAGES if moves < _FEW_MOVES * steps else _STAGES

    def _first_paths(
        self, problem: SearchProblem, raster: SearchRaster, monitor: Monitor
    ) -> list[Found]:
        """Return the paths that the search begins with."""
        return self._rollouts(problem, raster, monitor, until=FIRST_SHARE)

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
                monitor.report(tally[-1] * raster.unit, 0.0)
            else:
                monitor.asked_to_stop()
            if monitor.stopped() or monitor.spent() > until:
                break
        return found


class Monitor:
    """The clock of a plan, the best it has to tell, and whether it was told to stop."""

    def __init__(
        self,
        problem: SearchProblem,
        seconds: float,
        on_progress: OnProgress | None,
        should_stop: ShouldStop | None,
    ) -> None:
        self._began = time.monotonic()
        self._seconds = seconds
        self._probability_in_area = problem.probability_in_area
        self._on_progress = on_progress
        self._should_stop = should_stop
        self._best = 0.0
        self._stopped = False

    def spent(self) -> float:
        """Return the share of the time that is spent; 0 without a time budget."""
        return (time.monotonic() - self._began) / self._seconds

    def stopped(self) -> bool:
        """Return whether the plan was told to stop when it last reported."""
        return self._stopped

    def asked_to_stop(self) -> bool:
        """Ask whether to stop."""
        self._stopped = self._should_stop is not None and self._should_stop()
        return self._stopped

    def report(self, probability: float, fraction: float) -> None:
        """Tell the best so far and ask whether to stop."""
        self._best = max(self._best, probability)
        if self._on_progress is not None:
            fraction = min(1.0, max(fraction, self.spent()))
            efficiency = self._best / self._probability_in_area
            elapsed = time.monotonic() - self._began
            self._on_progress(PlanProgress(elapsed, efficiency, fraction))
        self.asked_to_stop()


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
