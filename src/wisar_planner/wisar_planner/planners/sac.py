"""The trained policy alone."""

from __future__ import annotations

import dataclasses
import itertools
import time
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import ClassVar

from wisar_planner.errors import FloatArray
from wisar_planner.planners.base import (
    OnProgress,
    OptionedPlanner,
    PlanProgress,
    ShouldStop,
    option,
)
from wisar_planner.planners.greedy import Greedy
from wisar_planner.policy.model import DEFAULT_MODEL, Model, find_model, load_model
from wisar_planner.policy.rollout import Terrain, fly
from wisar_planner.search.path import SearchPath
from wisar_planner.search.problem import SearchProblem

MODEL_HELP = "Trained policy: name of a shipped one, or path of a .safetensors file."


@dataclass(frozen=True)
class SacPolicy(OptionedPlanner):
    """One flight of a trained policy, see docs/policy.md.

    It began with soft actor-critic (Haarnoja 2018, Ewers 2024). At each step the most likely turn
    is flown. Where the policy finds no whole step that stays in the area, the greedy planner plans.
    """

    name: ClassVar[str] = "sac"

    model: str = option(DEFAULT_MODEL, MODEL_HELP)

    def plan(
        self,
        problem: SearchProblem,
        *,
        on_progress: OnProgress | None = None,
        should_stop: ShouldStop | None = None,
    ) -> SearchPath:
        """Return the policy's path; see `Planner.plan`."""
        began = time.monotonic()
        model = trained_policy(self.model)
        steps = itertools.count(1)
        stopped = False

        def on_step(seen: FloatArray) -> bool:
            nonlocal stopped
            if on_progress is not None:
                elapsed, fraction = time.monotonic() - began, next(steps) / problem.steps
                efficiency = float(seen[0]) / problem.probability_in_area
                on_progress(PlanProgress(elapsed, efficiency, fraction))
            stopped = should_stop is not None and should_stop()
            return stopped

        waypoints = fly(problem, Terrain.of(problem), model, on_step=on_step)[0]
        path = SearchPath(waypoints, problem.swath_radius, self.name)
        if len(path.waypoints) <= problem.steps and not stopped:
            path = Greedy().plan(problem, on_progress=on_progress, should_stop=should_stop)
            return dataclasses.replace(path, planner=self.name)
        return path


def trained_policy(name: str) -> Model:
    """Return the model of that name or path; read again when its file has changed.

    Raises
    ------
    InvalidInput
        See `find_model` and `load_model`.
    """
    path = find_model(name)
    return _loaded(path, path.stat().st_mtime_ns)


@lru_cache(maxsize=4)
def _loaded(path: Path, _changed_ns: int) -> Model:
    return load_model(path)
