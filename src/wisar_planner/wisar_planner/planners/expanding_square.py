"""The expanding square search of the IAMSAR manual."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from wisar_planner.planners.base import OnProgress, OptionedPlanner, ShouldStop, option
from wisar_planner.planners.datum import datum
from wisar_planner.planners.routing import pattern_path
from wisar_planner.search.path import SearchPath
from wisar_planner.search.problem import SearchProblem


@dataclass(frozen=True)
class ExpandingSquare(OptionedPlanner):
    """Expanding square (SS) of the IAMSAR manual, vol. II and III.

    From the datum, the most probable point, legs of 1, 1, 2, 2, 3, 3 ... track spacings with right
    turns between them, until the budget is flown or the square has outgrown the area. Legs are
    clipped to the area and joined along its border.
    """

    name: ClassVar[str] = "expanding_square"

    track_spacing: float = option(
        0.0, "Distance between neighbouring tracks, m; 0 takes the swath width.", minimum=0.0
    )
    heading: float = option(
        math.pi / 2.0, "Direction of the first leg, radians counter-clockwise from east."
    )
    from_start: bool = option(False, "Fly, and count, the leg from the start to the datum.")

    def plan(
        self,
        problem: SearchProblem,
        *,
        on_progress: OnProgress | None = None,
        should_stop: ShouldStop | None = None,
    ) -> SearchPath:
        """Return the pattern as one path; see `Planner.plan`."""
        spacing = self.track_spacing or 2.0 * problem.swath_radius
        centre = datum(problem)
        xmin, ymin, xmax, ymax = problem.area.bounds
        reach = max(centre[0] - xmin, xmax - centre[0], centre[1] - ymin, ymax - centre[1])
        # A leg of that many spacings, seen in any direction, lies beyond the area's far corner.
        legs = 4 * (1 + math.ceil(math.sqrt(2.0) * reach / spacing))
        number = np.arange(legs)
        headings = self.heading - 0.5 * math.pi * number
        lengths = spacing * (number // 2 + 1)
        moves = lengths[:, None] * np.stack([np.cos(headings), np.sin(headings)], axis=-1)
        corners = np.concatenate([centre[None], centre + np.cumsum(moves, axis=0)])
        lines = np.stack([corners[:-1], corners[1:]], axis=1)
        return pattern_path(problem, lines, self.name, from_start=self.from_start)
