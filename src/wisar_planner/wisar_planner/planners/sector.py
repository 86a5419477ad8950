"""The sector search of the IAMSAR manual."""

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

# One pattern: three triangles that meet in the datum, nine legs of one radius.
_LEGS = 9
# Every further pattern lies half-way between the tracks flown so far.
_ROTATIONS = (0.0, math.pi / 6.0, math.pi / 12.0, math.pi / 4.0)


@dataclass(frozen=True)
class Sector(OptionedPlanner):
    """Sector search (VS) of the IAMSAR manual, vol. II and III.

    Three equilateral triangles that meet in the datum, the most probable point, flown with turns of
    120 degrees to the right; when they are done, a second pattern turned by 30 degrees, as the
    manual says, and two more between them. Legs are clipped to the area and joined along its
    border. The path ends early where the four patterns are shorter than the budget.
    """

    name: ClassVar[str] = "sector"

    radius: float = option(
        0.0, "Length of a leg, m; 0 lets one pattern take the whole budget.", minimum=0.0
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
        radius = self.radius or problem.max_distance / _LEGS
        # Out, across, back through the datum and out again: two turns of 120 degrees, then none.
        turns = np.array([0, 1, 2, 2, 3, 4, 4, 5, 6]) * (-2.0 * math.pi / 3.0)
        headings = self.heading + (turns[None] - np.array(_ROTATIONS)[:, None]).ravel()
        moves = radius * np.stack([np.cos(headings), np.sin(headings)], axis=-1)
        centre = datum(problem)
        corners = np.concatenate([centre[None], centre + np.cumsum(moves, axis=0)])
        lines = np.stack([corners[:-1], corners[1:]], axis=1)
        return pattern_path(problem, lines, self.name, from_start=self.from_start)
