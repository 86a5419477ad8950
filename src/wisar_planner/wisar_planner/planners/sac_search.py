"""The trained policy with search on top, within a time budget."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from wisar_planner.errors import FloatArray
from wisar_planner.planners.base import option
from wisar_planner.planners.lookahead import FIRST_SHARE, Found, Lookahead, Monitor, taken
from wisar_planner.planners.sac import MODEL_HELP, trained_policy
from wisar_planner.planners.search_raster import SearchRaster
from wisar_planner.planners.swath_kernels import ADD, PERIODS, REMOVE, paint_path, path_value
from wisar_planner.policy.model import DEFAULT_MODEL
from wisar_planner.policy.rollout import Terrain, fly
from wisar_planner.search.problem import SearchProblem

# Flights with random turns after the one with the most likely turns.
_RANDOM_FLIGHTS = 16
# Flights side by side.
_BATCH = 16


@dataclass(frozen=True)
class SacSearch(Lookahead):
    """Flights of the trained policy, refined by annealing.

    First the policy flies its most likely turns, so that there is a good plan at once, then, unless
    a greedy rollout does better, flights with random turns; the greedy rollouts that `Lookahead`
    starts from join them. The best are refined as there.
    """

    name: ClassVar[str] = "sac_search"

    model: str = option(DEFAULT_MODEL, MODEL_HELP)

    def _first_paths(
        self, problem: SearchProblem, raster: SearchRaster, monitor: Monitor
    ) -> list[Found]:
        """Return flights of the policy, where it finds a way in the area, and greedy rollouts."""
        rollouts = self._rollouts(problem, raster, monitor)
        found = self._flights(problem, raster, monitor, rollouts)
        if found and monitor.stopped():
            return found
        # On a long budget the flights alone take long: the rollouts get their time all the same.
        until = max(FIRST_SHARE, monitor.spent() + 0.5 * FIRST_SHARE)
        return found + taken(rollouts, monitor, until)

    def _flights(
        self,
        problem: SearchProblem,
        raster: SearchRaster,
        monitor: Monitor,
        rollouts: Iterator[Found | None],
    ) -> list[Found]:
        """Return flights of the policy and the first rollout, which says what they are worth."""
        model = trained_policy(self.model)
        terrain = Terrain.of(problem)
        rng = np.random.default_rng(self.seed)

        def flown(count: int, rng: np.random.Generator | None) -> list[Found]:
            paths = fly(
                problem, terrain, model, count=count, rng=rng,
                on_step=(lambda _: monitor.asked_to_stop()) if found else None,
            )  # fmt: skip
            if paths.shape[1] <= problem.steps:
                return []
            return [self._valued(raster, path, monitor) for path in paths]

        found: list[Found] = []
        found += flown(1, None)
        if not found or monitor.stopped():
            return found
        greedy = next(rollouts, None)
        if greedy is not None:
            found.append(greedy)
            if greedy.value > found[0].value:
                return found  # a world that the policy does not know: its time is the rollouts'
        for first in range(0, _RANDOM_FLIGHTS, batch := min(_BATCH, terrain.most_searches)):
            more = flown(min(batch, _RANDOM_FLIGHTS - first), rng)
            found += more
            if not more or monitor.stopped() or monitor.spent() > FIRST_SHARE:
                break
        return found

    def _valued(self, raster: SearchRaster, path: FloatArray, monitor: Monitor) -> Found:
        """Return a path in metres with its value on the raster; tell what it sees."""
        points = raster.to_cells(path)
        tally = np.zeros(PERIODS, np.int64)
        arguments = (raster.counts, raster.weights, points, 0, len(points) - 1, raster.radius)
        paint_path(*arguments, ADD, tally)
        value, probability = path_value(tally, self.early_weight), tally[-1] * raster.unit
        paint_path(*arguments, REMOVE, tally)
        monitor.report(probability, 0.0)
        return Found(value, points)
