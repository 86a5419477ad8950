"""The creeping line search of the IAMSAR manual."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from wisar_planner.planners.base import OnProgress, OptionedPlanner, ShouldStop, option
from wisar_planner.planners.datum import coarse_map, datum
from wisar_planner.planners.routing import pattern_path
from wisar_planner.search.path import SearchPath
from wisar_planner.search.problem import SearchProblem


@dataclass(frozen=True)
class CreepingLine(OptionedPlanner):
    """Creeping line (CS) of the IAMSAR manual, vol. II and III.

    Parallel legs that creep across from the end of the area where the person is most likely. The
    first leg has its middle in the datum, the most probable point; of the four directions along
    the pattern's axes it creeps in the one that passes most probability. Legs are clipped to the
    area and joined along its border. The path ends where the area does.
    """

    name: ClassVar[str] = "creeping_line"

    track_spacing: float = option(
        0.0, "Distance between neighbouring legs, m; 0 takes the swath width.", minimum=0.0
    )
    leg_length: float = option(
        0.0, "Length of a leg, m; 0 takes the side of the square that the budget covers.",
        minimum=0.0,
    )  # fmt: skip
    heading: float = option(
        0.0, "Direction of one of the pattern's axes, radians counter-clockwise from east."
    )
    from_start: bool = option(False, "Fly, and count, the leg from the start to the first leg.")

    def plan(
        self,
        problem: SearchProblem,
        *,
        on_progress: OnProgress | None = None,
        should_stop: ShouldStop | None = None,
    ) -> SearchPath:
        """Return the pattern as one path; see `Planner.plan`."""
        spacing = self.track_spacing or 2.0 * problem.swath_radius
        length = self.leg_length or math.sqrt(problem.max_distance * spacing)
        depth = problem.max_distance * spacing / length
        coarse = coarse_map(problem)
        centres, mass = coarse.grid.centres(), coarse.mass
        centre = datum(problem)
        best, along, across = -1.0, np.zeros(2), np.zeros(2)
        for quarter in range(4):
            angle = self.heading + 0.5 * math.pi * quarter
            ahead = np.array([math.cos(angle), math.sin(angle)])
            aside = np.array([-ahead[1], ahead[0]])
            forward, sideward = (centres - centre) @ ahead, (centres - centre) @ aside
            passed = (forward >= 0.0) & (forward <= depth) & (np.abs(sideward) <= length / 2.0)
            if (seen := float(mass[passed].sum())) > best:
                best, along, across = seen, ahead, aside
        if (problem.start - centre) @ across > 0.0:
            across = -across  # The first leg begins at its end nearer to the start.
        xmin, ymin, xmax, ymax = problem.area.bounds
        legs = 1 + math.ceil(math.hypot(xmax - xmin, ymax - ymin) / spacing)
        middles = centre + spacing * np.arange(legs)[:, None] * along
        sides = np.where(np.arange(legs) % 2 == 0, 0.5, -0.5)[:, None] * length * across
        lines = np.stack([middles - sides, middles + sides], axis=1)
        return pattern_path(problem, lines, self.name, from_start=self.from_start)
