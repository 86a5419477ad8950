"""Parallel lines over the whole area, the plain coverage pattern."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from wisar_planner.planners.base import OnProgress, OptionedPlanner, ShouldStop, option
from wisar_planner.planners.routing import clip_lines, pattern_path
from wisar_planner.search.path import SearchPath
from wisar_planner.search.problem import SearchProblem


@dataclass(frozen=True)
class Lawnmower(OptionedPlanner):
    """Parallel lines along x from one corner of the area to the opposite side.

    The baseline of Ewers et al. (parallel swaths, Galceran and Carreras 2013): the lines are offset
    by the step length and the path is cut at the maximum distance. The pattern knows nothing of
    the map. It begins at its own first point, in the corner of the area's bounds nearest the
    start, and its first line lies on the edge itself. Lines are clipped to the area; where an area
    is not a rectangle, the way from one line to the next follows the border if it cannot be
    straight. Waypoints stand at the ends of the lines and every step length between them.
    """

    name: ClassVar[str] = "lawnmower"

    lane_spacing: float = option(
        0.0, "Distance between neighbouring lines, m; 0 takes the step length, as in the paper.",
        minimum=0.0,
    )  # fmt: skip
    from_start: bool = option(
        False, "Fly, and count, the leg from the start to the first point of the pattern."
    )

    def plan(
        self,
        problem: SearchProblem,
        *,
        on_progress: OnProgress | None = None,
        should_stop: ShouldStop | None = None,
    ) -> SearchPath:
        """Return the lines as one path; see `Planner.plan`."""
        spacing = self.lane_spacing or problem.step_length
        xmin, ymin, xmax, ymax = problem.area.bounds
        lanes = 1 + math.floor((ymax - ymin) / spacing + 1e-9)
        offsets = spacing * np.arange(lanes)
        near_south = problem.start[1] - ymin <= ymax - problem.start[1]
        near_west = problem.start[0] - xmin <= xmax - problem.start[0]
        y = ymin + offsets if near_south else ymax - offsets
        eastward = (np.arange(lanes) % 2 == 0) == near_west
        x0, x1 = np.where(eastward, xmin, xmax), np.where(eastward, xmax, xmin)
        lines = np.stack([np.stack([x0, y], axis=-1), np.stack([x1, y], axis=-1)], axis=1)
        if next(clip_lines(problem.area.polygon, lines), None) is None:
            # All lines pass by an area narrower than their spacing: fly one through its inside.
            lines = lines[:1]
            lines[:, :, 1] = problem.area.polygon.representative_point().y
        return pattern_path(problem, lines, self.name, from_start=self.from_start)
