"""Flights of a policy."""

import numpy as np

from wisar_planner import SearchPath, SearchProblem
from wisar_planner.policy.model import DEFAULT_MODEL, find_model, load_model
from wisar_planner.policy.rollout import Terrain, fly


def test_flights_stay_in_the_area_and_see_what_they_say():
    """The seen share that a flight reports is that of its path, by the exact integral."""
    problem = SearchProblem.paper(np.random.default_rng(1))
    terrain, told = Terrain.of(problem), []
    paths = fly(
        problem, terrain, load_model(find_model(DEFAULT_MODEL)), count=3,
        rng=np.random.default_rng(2), on_step=lambda seen: bool(told.append(seen.copy())),
    )  # fmt: skip
    assert paths.shape == (3, problem.steps + 1, 2)
    assert problem.area.contains(paths.reshape(-1, 2)).all()
    exact = [SearchPath(path, problem.swath_radius).seen_probability(problem.pdm) for path in paths]
    np.testing.assert_allclose(told[-1], exact, rtol=0.02)
