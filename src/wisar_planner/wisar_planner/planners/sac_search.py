"""The trained policy with search on top, within a time budget."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from wisar_planner.errors import FloatArray
from wisar_planner.planners.base import option
from wisar_planner.planners.cell_vectors import PERIODS
from wisar_planner.planners.lookahead import FIRST_SHARE, Lookahead
from wisar_planner.planners.monitor import Monitor
from wisar_planner.planners.sac import MODEL_HELP, trained_policy
from wisar_planner.planners.search_raster import SearchRaster
from wisar_planner.planners.stages import Found, WaysOn
from wisar_planner.planners.swath_kernels import ADD, REMOVE, paint_path, path_value
from wisar_planner.policy.model import DEFAULT_MODEL, Model
from wisar_planner.policy.rollout import Terrain, fly
from wisar_planner.search.problem import SearchProblem

# Most flights with random turns after the one with the most likely turns; time often allows fewer.
_RANDOM_FLIGHTS = 48
# Flights side by side.
_BATCH = 16
# Share of the time left after which a flight is given up: greedy rollouts take far less, and have
# the rest.
_FLIGHT_SHARE = 0.5
# A flight is given up no sooner than after so many seconds, within which most are done.
_PATIENCE_S = 0.1
# Other ways on leave the best path before this share of it.
_LAST_LEAVE = 0.9


@dataclass(frozen=True)
class SacSearch(Lookahead):
    """Flights of the trained policy, refined by annealing.

    First the policy flies its most likely turns, so that there is a good plan at once, then
    flights with random turns; the greedy rollouts that `Lookahead` starts from join them. The best
    are refined as there. Then the policy flies other ways on from somewhere on the best of all.
    Where the first flight would take more than half the time that is left for it, it is given up,
    and the rollouts are all there is.
    """

    name: ClassVar[str] = "sac_search"

    model: str = option(DEFAULT_MODEL, MODEL_HELP)

    def _first_paths(
        self, problem: SearchProblem, raster: SearchRaster, monitor: Monitor
    ) -> tuple[list[Found], WaysOn | None]:
        """Return flights of the policy, where it finds a way in the area, and greedy rollouts.

        Where the policy flies in time, it finds other ways on, too.
        """
        model = trained_policy(self.model)
        terrain = Terrain.of(problem)
        rng = np.random.default_rng(self.seed)
        found: list[Found] = []
        flown, count = 0, 1
        while count > 0:
            before = monitor.spent()
            paths = fly(
                problem, terrain, model, count=count, rng=rng if flown else None,
                on_step=_give_up(monitor),
            )  # fmt: skip
            if paths.shape[1] <= problem.steps:
                break
            for path in paths:
                found.append(self._valued(raster, path))
                monitor.report(path)
            if monitor.stopped():
                break
            flown += count
            # As many more as there is time for, if each takes as long as one of these.
            each_takes, left = (monitor.spent() - before) / count, FIRST_SHARE - monitor.spent()
            most = min(_BATCH, terrain.most_searches, 1 + _RANDOM_FLIGHTS - flown)
            count = most if each_takes == 0.0 else min(most, int(left / each_takes))
        ways_on = _ways_on(problem, terrain, model, rng, monitor) if found else None
        if found and monitor.stopped():
            return found, ways_on
        # On a long budget the flights alone take long: the rollouts get their time all the same.
        until = max(FIRST_SHARE, monitor.spent() + 0.5 * FIRST_SHARE)
        return found + self._rollouts(problem, raster, monitor, until), ways_on

    def _valued(self, raster: SearchRaster, path: FloatArray) -> Found:
        """Return a path in metres with its value on the raster."""
        points = raster.to_cells(path)
        tally = np.zeros(PERIODS, np.int64)
        arguments = (raster.canvas, points, 0, len(points) - 1, raster.radius)
        paint_path(*arguments, ADD, tally)
        value = path_value(tally, self.early_weight)
        paint_path(*arguments, REMOVE, tally)
        return Found(value, points)


def _ways_on(
    problem: SearchProblem,
    terrain: Terrain,
    model: Model,
    rng: np.random.Generator,
    monitor: Monitor,
) -> WaysOn:
    """Return what leaves a path at a random step and flies on with random turns, several times."""
    count = min(_BATCH, terrain.most_searches)
    last = math.ceil(_LAST_LEAVE * problem.steps)

    def ways_on(path: FloatArray) -> list[FloatArray]:
        flown = path[: 1 + int(rng.integers(last))]
        paths = fly(
            problem, terrain, model, flown=flown, count=count, rng=rng,
            on_step=lambda _: monitor.asked_to_stop() or monitor.ended(),
        )  # fmt: skip
        return list(paths) if paths.shape[1] > problem.steps else []

    return ways_on


def _give_up(monitor: Monitor) -> Callable[[FloatArray], bool]:
    """Return what says after each step of a flight whether to give it up."""
    until, patient_until = math.inf, math.inf

    def on_step(_: FloatArray) -> bool:
        nonlocal until, patient_until
        spent, now = monitor.spent(), time.monotonic()
        # From the end of the first step on: in a new process that step loads compiled code.
        if until == math.inf:
            until = spent + _FLIGHT_SHARE * (1.0 - spent)
            patient_until = now + _PATIENCE_S
        return monitor.asked_to_stop() or (spent > until and now > patient_until)

    return on_step
