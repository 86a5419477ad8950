"""Flights of a policy."""

import numpy as np
import shapely
from hypothesis import given
from hypothesis import strategies as st

from wisar_planner import Grid, SearchPath, SearchProblem
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
