"""The best of many headings, one step ahead."""

from __future__ import annotations

import math
import time
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from wisar_planner.errors import FloatArray
from wisar_planner.planners.base import (
    OnProgress,
    OptionedPlanner,
    PlanProgress,
    ShouldStop,
    option,
)
from wisar_planner.planners.datum import coarse_map
from wisar_planner.planners.routing import route
from wisar_planner.search.path import SearchPath
from wisar_planner.search.problem import SearchProblem
from wisar_planner.search.seen_area import SeenArea

# Shares of a step that are tried where no whole step stays inside the area.
_SHORTER = (1.0, 0.5, 0.25, 0.125, 0.0625)


@dataclass(frozen=True)
class Greedy(OptionedPlanner):
    """Step for step in the direction that newly sees most, by the exact seen probability.

    Where no step gains more than the share `far_share` of what a step over the best unseen ground
    would, the drone flies there instead: to the place with the most unseen density for its
    distance, and on until a step gains enough again. Ties go to the heading with the smaller
    angle from east.
    """

    name: ClassVar[str] = "greedy"

    headings: int = option(
        48, "Number of evenly spaced headings tried at each step.", minimum=3, maximum=3600
    )
    far_share: float = option(
        0.1, "Share of the best unseen step under which a step gains too little to be flown.",
        minimum=0.0, maximum=1.0,
    )  # fmt: skip

    def plan(
        self,
        problem: SearchProblem,
        *,
        on_progress: OnProgress | None = None,
        should_stop: ShouldStop | None = None,
    ) -> SearchPath:
        """Return the path of the best steps; see `Planner.plan`."""
        began = time.monotonic()
        angles = np.arange(self.headings) * (2.0 * math.pi / self.headings)
        moves = problem.step_length * np.stack([np.cos(angles), np.sin(angles)], axis=-1)
        seen = SeenArea(problem.pdm, problem.swath_radius)
        seen.add(problem.start, problem.start)
        unseen = _Unseen(problem)
        waypoints = [problem.start]
        target: FloatArray | None = None
        for step in range(problem.steps):
            here = waypoints[-1]
            ends = _steps_inside(problem, here, moves)
            if len(ends) == 0:
                break
            gains = seen.gains(here, ends)
            best = int(np.argmax(gains))
            if gains[best] > self.far_share * unseen.best_step():
                target = None
            else:
                if target is None or np.hypot(*(target - here)) < problem.step_length:
                    target = unseen.target(here)
                best = _towards(problem, here, target, ends)
            seen.add(here, ends[best])
            unseen.remove(here, ends[best])
            waypoints.append(ends[best])
            if should_stop is not None and should_stop():
                break
            if on_progress is not None:
                on_progress(
                    PlanProgress(
                        elapsed_s=time.monotonic() - began,
                        efficiency=seen.probability / problem.probability_in_area,
                        fraction=(step + 1) / problem.steps,
                    )
                )
        return SearchPath(np.array(waypoints), problem.swath_radius, self.name)


class _Unseen:
    """What is left of the map on coarse cells; only for choosing targets."""

    def __init__(self, problem: SearchProblem) -> None:
        self.coarse = coarse_map(problem)
        self.centres = self.coarse.grid.centres()
        self.reach = problem.swath_radius
        self.step = problem.step_length
        self.cells_per_step = 2.0 * self.reach * self.step / self.coarse.grid.cell**2

    def best_step(self) -> float:
        """Return about what a step over the densest unseen ground would gain."""
        return float(self.coarse.mass.max()) * self.cells_per_step

    def target(self, here: FloatArray) -> FloatArray:
        """Return the place with the most unseen density for its distance."""
        distance = np.hypot(self.centres[..., 0] - here[0], self.centres[..., 1] - here[1])
        return self.coarse.centre(int(np.argmax(self.coarse.mass / (distance + self.step))))

    def remove(self, start: FloatArray, end: FloatArray) -> None:
        """Take out the cells whose centre a step sees."""
        grid, reach = self.coarse.grid, self.reach
        low = (np.minimum(start, end) - reach - (grid.x0, grid.y0)) / grid.cell
        high = (np.maximum(start, end) + reach - (grid.x0, grid.y0)) / grid.cell
        columns, rows = (
            slice(max(0, int(a)), max(0, int(b) + 1)) for a, b in zip(low, high, strict=True)
        )
        along, offset = end - start, self.centres[rows, columns] - start
        share = np.clip(offset @ along / (along @ along), 0.0, 1.0)
        distance = np.hypot(*(offset - share[..., None] * along).transpose(2, 0, 1))
        self.coarse.mass[rows, columns][distance <= reach] = 0.0


def _steps_inside(problem: SearchProblem, here: FloatArray, moves: FloatArray) -> FloatArray:
    """Return the ends of the steps that stay inside the area, shorter ones if no whole one does."""
    for share in _SHORTER:
        ends = here + share * moves
        inside = problem.area.contains_legs(here, ends)
        if inside.any():
            return ends[inside]
    return np.empty((0, 2))


def _towards(problem: SearchProblem, here: FloatArray, target: FloatArray, ends: FloatArray) -> int:
    """Return the step that comes nearest to the way inside the area to a target."""
    way = route(problem.area.polygon, here, target)
    legs = np.hypot(*np.diff(way, axis=0).T)
    ahead = min(problem.step_length, float(legs.sum()))
    along = np.concatenate([[0.0], np.cumsum(legs)])
    point = np.array([np.interp(ahead, along, way[:, axis]) for axis in (0, 1)])
    return int(np.argmin(np.hypot(*(ends - point).T)))
