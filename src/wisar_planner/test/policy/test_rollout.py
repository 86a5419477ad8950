"""Flights of a policy."""

import numpy as np
import pytest

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


@pytest.mark.parametrize("flown", [0, 1, 30, 64])
def test_a_flight_goes_on_as_if_it_had_not_been_cut(flown):
    problem = SearchProblem.paper(np.random.default_rng(5))
    terrain, model = Terrain.of(problem), load_model(find_model(DEFAULT_MODEL))
    seen = []

    def told(now):
        seen.append(now.copy())
        return False

    whole = fly(problem, terrain, model, on_step=told)[0]
    at_the_time = [now[0] for now in seen]
    on = fly(problem, terrain, model, flown=whole[: flown + 1], count=3, on_step=told)
    assert on.shape == (3, problem.steps + 1, 2)
    np.testing.assert_array_equal(on[:, : flown + 1], np.repeat(whole[None, : flown + 1], 3, 0))
    np.testing.assert_array_equal(on, np.repeat(on[:1], 3, 0))
    # The next steps are the same; what rounding changes may decide between two ways at any later.
    soon = slice(flown + 1, flown + 4)
    np.testing.assert_allclose(on[0, soon], whole[soon], atol=1e-4)
    told_next = seen[problem.steps :][:3]
    np.testing.assert_allclose([now[0] for now in told_next], at_the_time[flown:][:3], rtol=1e-6)
