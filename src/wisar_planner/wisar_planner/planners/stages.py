"""From some paths to the best plan: annealing in stages, then the gradient."""

from __future__ import annotations

import heapq
import math
from operator import attrgetter
from typing import NamedTuple

from wisar_planner.errors import FloatArray
from wisar_planner.planners.monitor import Monitor
from wisar_planner.planners.polish import MOST_STEPS, Polished, Polisher
from wisar_planner.planners.random_kernels import StateArray
from wisar_planner.planners.refine import Schedule, annealing, exact_steps
from wisar_planner.planners.search_raster import SearchRaster
from wisar_planner.search.problem import SearchProblem


class Found(NamedTuple):
    """A path in cells, and its value with what early weight adds, by the raster."""

    value: float
    points: FloatArray


class _Stage(NamedTuple):
    """One round of annealing: how many paths, and until which share of the budget."""

    paths: int
    until: float
    schedule: Schedule


# Many paths shortly, then the best of them longer. The rest of the budget is for the gradient.
_STAGES = (
    _Stage(16, 0.35, Schedule(0.1, 0.005)),
    _Stage(4, 0.5, Schedule(0.03, 0.004)),
)
# Where there is time for few moves a step.
_SHORT_STAGES = (
    _Stage(3, 0.35, Schedule(0.05, 0.005)),
    _Stage(1, 0.6, Schedule(0.04, 0.005)),
)
# So many moves a step are few, and so many moves are about what a machine makes in a second.
_FEW_MOVES, _MOVES_PER_SECOND = 700.0, 160_000.0
# How the best path is shaken before the gradient is followed from it once more, and for how many
# moves a step.
_SHAKE, _SHAKE_MOVES = Schedule(0.04, 0.004), 150
# An exact value with its gradient takes about as long as so many moves a step.
_MOVES_PER_VALUE = 2
# Paths whose exact value is compared where the search was stopped early.
_FINALISTS = 3


class Stages:
    """What makes the best plan of some paths within a budget.

    Parameters
    ----------
    problem : SearchProblem
        The search.
    raster : SearchRaster
        Of the problem, to anneal on.
    monitor : Monitor
        The budget.
    state : (1,) uint64
        Random state; advanced.
    early_weight : float
        See `path_value`.
    """

    def __init__(
        self,
        problem: SearchProblem,
        raster: SearchRaster,
        monitor: Monitor,
        state: StateArray,
        early_weight: float,
    ) -> None:
        self._problem = problem
        self._raster = raster
        self._monitor = monitor
        self._state = state
        self._early_weight = early_weight
        self._polisher = Polisher(problem, early_weight)

    def best_of(self, found: list[Found]) -> FloatArray:
        """Return the best path, (N + 1, 2) m, that the budget gives, from one or more."""
        monitor = self._monitor
        begins = 0.0
        for stage in self._stages():
            found = heapq.nlargest(stage.paths, found, key=attrgetter("value"))
            share = (stage.until - begins) / len(found)
            for i, each in enumerate(found):
                if monitor.stopped():
                    break
                found[i] = self._annealed(each, stage.schedule, begins + i * share, share)
            begins = stage.until
        most = _FINALISTS if monitor.stopped() else len(found)
        found = heapq.nlargest(most, found, key=attrgetter("value"))
        paths = [self._polisher.valued(self._in_metres(each.points)) for each in found]
        for i, path in enumerate(paths):
            if not monitor.ended():
                paths[i] = self._polished(path.waypoints)
        best = max(paths, key=attrgetter("value"))
        while not monitor.ended():
            best = max(best, self._polished(self._shaken(best.waypoints)), key=attrgetter("value"))
        return best.waypoints

    def _stages(self) -> tuple[_Stage, ...]:
        """Return the rounds of annealing that suit the budget."""
        steps = self._problem.steps
        moves = min(self._monitor.moves, _MOVES_PER_SECOND * self._monitor.seconds)
        stages = _SHORT_STAGES if moves < _FEW_MOVES * steps else _STAGES
        if steps > MOST_STEPS:  # There is no ascent.
            stages = (*stages[:-1], stages[-1]._replace(until=1.0))
        return stages

    def _annealed(self, found: Found, schedule: Schedule, begins: float, share: float) -> Found:
        """Return a path annealed for a share of the budget, which begins after another share."""
        monitor = self._monitor
        for now in annealing(
            self._raster, found.points, schedule, self._state,
            seconds=monitor.seconds_until(begins + share),
            iterations=monitor.moves_until(begins + share),
            early_weight=self._early_weight,
        ):  # fmt: skip
            found = Found(now.value, now.points)
            monitor.report(self._in_metres(found.points), begins + now.fraction * share)
            if monitor.stopped():
                break
        monitor.count(now.iterations)
        return found

    def _polished(self, waypoints: FloatArray) -> Polished:
        """Return a path after an ascent, as long as the budget lasts."""
        monitor, steps = self._monitor, self._problem.steps
        before = self._polisher.evaluations

        def on_progress(waypoints: FloatArray) -> bool:
            monitor.report(waypoints)
            return monitor.ended()

        left, cost = monitor.moves_until(1.0), _MOVES_PER_VALUE * steps
        path = self._polisher.polish(
            waypoints,
            on_progress=on_progress,
            most_evaluations=None if left is None else math.ceil(left / cost),
        )
        monitor.count((self._polisher.evaluations - before) * cost)
        return path

    def _shaken(self, waypoints: FloatArray) -> FloatArray:
        """Return a path near a polished one, but not on its hill."""
        monitor, steps = self._monitor, self._problem.steps
        points = self._raster.to_cells(waypoints)
        for now in annealing(
            self._raster, points, _SHAKE, self._state,
            seconds=monitor.seconds_until(1.0),
            iterations=_SHAKE_MOVES * steps,
            early_weight=self._early_weight,
        ):  # fmt: skip
            points = now.current
            if monitor.asked_to_stop():
                break
        monitor.count(now.iterations)
        return self._in_metres(points)

    def _in_metres(self, points: FloatArray) -> FloatArray:
        return exact_steps(self._problem, self._raster, points)
