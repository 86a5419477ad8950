"""Flights of a policy."""

import numpy as np
import shapely
from hypothesis import given
from hypothesis import strategies as st
from threadpoolctl import threadpool_info, threadpool_limits

from wisar_planner import Grid, SearchProblem
from wisar_planner.policy.model import DEFAULT_MODEL, find_model, load_model
from wisar_planner.policy.rollout import Terrain, cells_inside, fly
from wisar_planner.policy.unseen_map import BLOCK


@given(
    corners=st.lists(
        st.tuples(st.floats(-20.0, 120.0), st.floats(-20.0, 90.0)), min_size=3, max_size=9
    ),
    hole=st.booleans(),
)
def test_cells_are_inside_whose_centre_is(corners, hole):
    polygon = shapely.MultiPoint(corners).convex_hull.buffer(3.0)
    if hole:
        polygon = polygon.difference(polygon.centroid.buffer(7.0))
    grid = Grid(-5.3, 2.1, 1.7, 4 * BLOCK, 3 * BLOCK)
    expected = shapely.contains_xy(polygon, *np.moveaxis(grid.centres(), -1, 0))
    np.testing.assert_array_equal(cells_inside(polygon, grid), expected)


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
