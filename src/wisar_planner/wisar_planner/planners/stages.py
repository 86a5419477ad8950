"""From some paths to the best plan: annealing in stages, the gradient, and other ways on."""

from __future__ import annotations

import heapq
import math
from collections.abc import Callable, Sequence
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
    """One round of annealing: how many paths, and for which share of the budget."""

    paths: int
    share: float
    schedule: Schedule


# Many paths shortly, then the best of them longer. The rest of the budget is for the gradient.
_STAGES = (
    _Stage(16, 0.15, Schedule(0.1, 0.005)),
    _Stage(4, 0.15, Schedule(0.03, 0.004)),
)
# Where there is time for few moves a step.
_SHORT_STAGES = (
    _Stage(3, 0.15, Schedule(0.05, 0.005)),
    _Stage(1, 0.25, Schedule(0.04, 0.005)),
)
# So many moves a step are few, and so many moves are about what a machine makes in a second.
_FEW_MOVES, _MOVES_PER_SECOND = 700.0, 160_000.0
# Where there are other ways on, annealing has its share of no more than so many moves a step.
_MOST_MOVES = 1250.0
# How the best path is shaken before the gradient is followed from it once more, and for how many
# moves a step.
_SHAKE, _SHAKE_MOVES = Schedule(0.04, 0.004), 150
# An exact value with its gradient takes about as long as so many moves a step.
_MOVES_PER_VALUE = 2
# Paths whose exact value is compared where the search was stopped early.
_FINALISTS = 3
# Of so many tries to leave the best path, one shakes it and the others take other ways on.
_TRIES_PER_SHAKE = 3
# Another way on takes a policy about as long as so many moves a step.
_MOVES_PER_WAY = 5


class _Round(NamedTuple):
    """One round of a race uphill: how many paths, for how many iterations.

    Paths that are behind the best plan by more than a share of what it is worth are left out.
    """

    paths: int
    iterations: int | None
    behind: float


# Most ways end below the best plan: a few iterations tell, and leave time for others.
_RACE = (
    _Round(4, 10, 0.03),
    _Round(2, 30, 0.012),
    _Round(1, 60, 0.005),
    _Round(1, None, 0.002),
)

WaysOn = Callable[[FloatArray], Sequence[FloatArray]]
"""Takes a path, (N + 1, 2) m, and returns others that begin with some of its steps, if any."""


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
    ways_on : callable, optional
        Goes on otherwise from somewhere on the best path; without it that is only shaken.
    """

    def __init__(
        self,
        problem: SearchProblem,
        raster: SearchRaster,
        monitor: Monitor,
        state: StateArray,
        early_weight: float,
        ways_on: WaysOn | None = None,
    ) -> None:
        self._problem = problem
        self._raster = raster
        self._monitor = monitor
        self._state = state
        self._early_weight = early_weight
        self._polisher = Polisher(problem, early_weight)
        self._ways_on = ways_on

    def best_of(self, found: list[Found]) -> FloatArray:
        """Return the best path, (N + 1, 2) m, that the budget gives, from one or more."""
        monitor = self._monitor
        for stage in self._stages():
            found = heapq.nlargest(stage.paths, found, key=attrgetter("value"))
            begins = monitor.spent()
            share = max(0.0, min(stage.share, 1.0 - begins)) / len(found)
            for i, each in enumerate(found):
                if monitor.stopped():
                    break
                found[i] = self._annealed(each, stage.schedule, begins + i * share, share)
        most = _FINALISTS if monitor.stopped() else len(found)
        found = heapq.nlargest(most, found, key=attrgetter("value"))
        paths = [self._polisher.valued(self._in_metres(each.points)) for each in found]
        for i, path in enumerate(paths):
            if not monitor.ended():
                paths[i] = self._polished(path.waypoints)
        best = max(paths, key=attrgetter("value"))
        tries = 0
        while not monitor.ended():
            tries += 1
            other = self._another_way(best) if tries % _TRIES_PER_SHAKE else None
            best = max(best, other or self._shaken(best), key=attrgetter("value"))
        return best.waypoints

    def _stages(self) -> tuple[_Stage, ...]:
        """Return the rounds of annealing that suit the budget."""
        steps = self._problem.steps
        moves = min(self._monitor.moves, _MOVES_PER_SECOND * self._monitor.seconds) / steps
        stages = _SHORT_STAGES if moves < _FEW_MOVES else _STAGES
        if steps > MOST_STEPS:  # There is no ascent.
            return (*stages[:-1], stages[-1]._replace(share=1.0))
        if self._ways_on is None:
            return stages
        share = min(1.0, _MOST_MOVES / moves)
        return tuple(stage._replace(share=share * stage.share) for stage in stages)

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

    def _polished(self, waypoints: FloatArray, most_iterations: int | None = None) -> Polished:
        """Return a path after an ascent, as long as the budget lasts."""
        monitor, cost = self._monitor, _MOVES_PER_VALUE * self._problem.steps
        before = self._polisher.evaluations

        def on_progress(waypoints: FloatArray) -> bool:
            monitor.report(waypoints)
            return monitor.ended()

        left = monitor.moves_until(1.0)
        path = self._polisher.polish(
            waypoints,
            on_progress=on_progress,
            most_iterations=most_iterations,
            most_evaluations=None if left is None else math.ceil(left / cost),
        )
        monitor.count((self._polisher.evaluations - before) * cost)
        return path

    def _another_way(self, best: Polished) -> Polished | None:
        """Return the winner of a race uphill between other ways on; None if all are far behind."""
        paths = [] if self._ways_on is None else self._ways_on(best.waypoints)
        racers = [self._polisher.valued(path) for path in paths]
        cost = (_MOVES_PER_WAY + _MOVES_PER_VALUE) * self._problem.steps
        self._monitor.count(cost * len(racers))
        for each in _RACE:
            racers = heapq.nlargest(each.paths, racers, key=attrgetter("value"))
            racers = [path for path in racers if path.value >= (1.0 - each.behind) * best.value]
            for i, path in enumerate(racers):
                if not self._monitor.ended():
                    racers[i] = self._polished(path.waypoints, each.iterations)
        return max(racers, key=attrgetter("value"), default=None)

    def _shaken(self, best: Polished) -> Polished:
        """Return what an ascent makes of a path near the best one, but not on its hill."""
        monitor, steps = self._monitor, self._problem.steps
        points = self._raster.to_cells(best.waypoints)
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
        return self._polished(self._in_metres(points))

    def _in_metres(self, points: FloatArray) -> FloatArray:
        return exact_steps(self._problem, self._raster, points)
