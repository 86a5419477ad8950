"""Flights of a policy."""

import numpy as np
from threadpoolctl import threadpool_info, threadpool_limits

from wisar_planner import SearchProblem
from wisar_planner.policy.model import DEFAULT_MODEL, find_model, load_model
from wisar_planner.policy.rollout import Terrain, fly


def test_flights_keep_to_one_core_and_leave_the_threads_as_they_were():
    """On a busy machine threads that wait for each other took ten times as long."""
    problem, during = SearchProblem.paper(np.random.default_rng(1)), []

    def threads():
        return [each["num_threads"] for each in threadpool_info() if each["user_api"] == "blas"]

    with threadpool_limits(2, user_api="blas"):
        before = threads()
        fly(
            problem, Terrain.of(problem), load_model(find_model(DEFAULT_MODEL)),
            on_step=lambda _: during.append(threads()) or True,
        )  # fmt: skip
        assert threads() == before
    assert during
    assert set(during[0]) == {1}
