"""The paper's drone: kinematics, what it sees, what it earns."""

from __future__ import annotations

import math

import numpy as np
import pytest

from wisar_planner.search import SearchPath, SearchProblem
from wisar_sim.heading_drone import HeadingDrone, by_boundary, by_cubature


@pytest.fixture
def problem() -> SearchProblem:
    return SearchProblem.paper(np.random.default_rng(7))


def random_walk(problem: SearchProblem, steps: int, seed: int = 0) -> SearchPath:
    headings = np.random.default_rng(seed).uniform(-math.pi, math.pi, steps)
    legs = problem.step_length * np.column_stack((np.cos(headings), np.sin(headings)))
    return SearchPath(np.vstack((problem.start, problem.start + np.cumsum(legs, axis=0))), 2.5)


def test_it_flies_every_step_once_and_then_stays(problem: SearchProblem) -> None:
    path = random_walk(problem, 12)
    drone = HeadingDrone(path, problem)
    assert (drone.state.step, drone.state.distance, drone.state.reward) == (0, 0.0, 0.0)
    for step in range(1, 13):
        state = drone.tick()
        assert state.step == step
        np.testing.assert_array_equal(state.position, path.waypoints[step])
        leg = path.waypoints[step] - path.waypoints[step - 1]
        turned = 8.0 * np.array([math.cos(state.heading), math.sin(state.heading)])
        np.testing.assert_allclose(turned, leg, atol=1e-9)
        assert state.distance == pytest.approx(8.0 * step)
    assert state.finished
    assert drone.tick() is state


def test_cubature_and_boundary_integral_agree(problem: SearchProblem) -> None:
    path = random_walk(problem, 20)
    seen = []
    for method in (by_cubature, by_boundary):
        drone = HeadingDrone(path, problem, method)
        seen.append([drone.tick().probability for _ in range(20)])
    # The polygon of the buffered path cuts its round corners: below a part in a thousand.
    np.testing.assert_allclose(seen[0], seen[1], rtol=2e-3)
    assert np.all(np.diff(seen[1]) >= -1e-12)


def test_rewards_follow_the_papers_cases(problem: SearchProblem) -> None:
    x, y = problem.pdm.means[0]
    # Two steps near a peak, back over what was seen, then far outside.
    path = SearchPath(np.array([[x, y], [x + 8, y], [x, y], [-500.0, y]]), 2.5)
    drone = HeadingDrone(path, problem, by_boundary)
    first, again, outside = (drone.tick() for _ in range(3))
    k = problem.area.area / (2.5 * (math.pi * 2.5 + 2 * 8.0))
    start = SearchPath(path.waypoints[:1], 2.5).seen_probability(problem.pdm)
    expected = 0.5 * k * (first.probability - start) / problem.probability_in_area
    assert first.reward == pytest.approx(expected)
    assert again.reward == -0.5
    assert (outside.reward, outside.out_of_area) == (-1.0, True)
