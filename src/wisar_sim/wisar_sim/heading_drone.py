"""The paper's drone: it flies steps of constant length along the headings of a plan."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from wisar_planner.errors import FloatArray, InvalidInput
from wisar_planner.search import SearchPath, SearchProblem
from wisar_planner.search.cubature import seen_probability_by_cubature
from wisar_planner.search.reward import shaped_reward

SeenProbability = Callable[[SearchPath, SearchProblem], float]


def by_cubature(path: SearchPath, problem: SearchProblem) -> float:
    """Return p_t by cubature over the triangulated buffered path, as in the paper."""
    return seen_probability_by_cubature(path, problem.pdm)


def by_boundary(path: SearchPath, problem: SearchProblem) -> float:
    """Return p_t by the exact integral along the boundary of the seen area."""
    return path.seen_probability(problem.pdm)


@dataclass(frozen=True)
class DroneState:
    """The drone after a step.

    Parameters
    ----------
    step : int
        Steps flown.
    position : (2,) ndarray
        Metres east and north.
    heading : float
        Direction of the last step, radians from east, counter-clockwise.
    distance : float
        Metres flown.
    probability : float
        p_t, the probability seen so far.
    probability_efficiency : float
        e_p = p_t / p_A.
    reward : float
        The paper's shaped reward of the last step; 0 before the first.
    out_of_area : bool
        Whether the position lies outside the search area.
    finished : bool
        Whether the plan is flown.
    """

    step: int
    position: FloatArray
    heading: float
    distance: float
    probability: float
    probability_efficiency: float
    reward: float
    out_of_area: bool
    finished: bool


class HeadingDrone:
    """Flies a plan step by step (Ewers et al., agent dynamics) and keeps count of what it sees.

    Parameters
    ----------
    path : SearchPath
        The plan.
    problem : SearchProblem
        Map and area that the probability and the reward refer to.
    seen_probability : callable
        How p_t is computed.

    Raises
    ------
    InvalidInput
        When `path` has no waypoint.
    """

    def __init__(
        self,
        path: SearchPath,
        problem: SearchProblem,
        seen_probability: SeenProbability = by_cubature,
    ) -> None:
        if len(path.waypoints) == 0:
            raise InvalidInput("path has no waypoints: there is nothing to fly")
        self._path = path
        self._problem = problem
        self._seen_probability = seen_probability
        self.state = self._state_at(0, heading=0.0, previous_probability=0.0)

    @property
    def steps(self) -> int:
        """Steps of the plan."""
        return len(self._path.waypoints) - 1

    def tick(self) -> DroneState:
        """Fly one step and return the new state; a finished flight stays where it is."""
        if not self.state.finished:
            step = self.state.step + 1
            east, north = self._path.waypoints[step] - self._path.waypoints[step - 1]
            heading = float(np.arctan2(north, east))
            self.state = self._state_at(step, heading, self.state.probability)
        return self.state

    def _state_at(self, step: int, heading: float, previous_probability: float) -> DroneState:
        flown = SearchPath(self._path.waypoints[: step + 1], self._path.swath_radius)
        probability = self._seen_probability(flown, self._problem)
        position = self._path.waypoints[step]
        reward = 0.0
        if step > 0:
            gain = probability - previous_probability
            reward = float(shaped_reward(self._problem, [gain], position[None, :])[0])
        return DroneState(
            step=step,
            position=position,
            heading=heading,
            distance=float(flown.length),
            probability=probability,
            probability_efficiency=probability / self._problem.probability_in_area,
            reward=reward,
            out_of_area=not self._problem.area.contains(position[None, :])[0],
            finished=step == self.steps,
        )
