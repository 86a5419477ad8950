import dataclasses

import numpy as np
import pytest
import shapely
from hypothesis import given
from hypothesis import strategies as st

from wisar_planner import SearchArea, SearchProblem
from wisar_planner.planners.routing import clip_lines, pattern_path, route, waypoints_along

RING = shapely.box(0, 0, 10, 10).difference(shapely.box(4, 4, 6, 6))


def test_lines_are_clipped_in_flight_order():
    pieces = list(clip_lines(RING, np.array([[(12.0, 5.0), (-2.0, 5.0)]])))
    np.testing.assert_allclose(pieces, [[(10, 5), (6, 5)], [(4, 5), (0, 5)]])


def test_lines_outside_and_touching_points_give_nothing():
    assert (
        list(clip_lines(RING, np.array([[(20.0, 0.0), (30.0, 0.0)], [(-1, 1), (1, -1.0)]]))) == []
    )


def test_route_is_straight_where_it_can_be():
    np.testing.assert_allclose(
        route(RING, np.array([1.0, 1]), np.array([9.0, 1])), [(1, 1), (9, 1)]
    )


@pytest.mark.parametrize(("y", "corner"), [(4.5, 4.0), (5.5, 6.0)])
def test_route_takes_the_shorter_way_round(y, corner):
    way = route(RING, np.array([1.0, y]), np.array([9.0, y]))
    np.testing.assert_allclose(way, [(1, y), (4, y), (4, corner), (6, corner), (6, y), (9, y)])


def test_route_crosses_straight_between_separate_parts():
    parts = shapely.union(shapely.box(0, 0, 2, 2), shapely.box(5, 0, 7, 2))
    way = route(parts, np.array([1.0, 1]), np.array([6.0, 1]))
    np.testing.assert_allclose(way, [(1, 1), (2, 1), (5, 1), (6, 1)])


@pytest.mark.parametrize(("budget", "expected"), [(24.0, 4), (34.0, 4), (41.0, 6)])
def test_no_waypoint_stands_between_parts_of_an_area(budget, expected):
    """A line of two parts, 20 m each with 15 m between; the budget ends on the way or beyond."""
    parts = shapely.union(shapely.box(0, 0, 20, 20), shapely.box(35, 0, 55, 20))
    problem = dataclasses.replace(
        SearchProblem.paper(np.random.default_rng(0), start=(1.0, 10.0)), area=SearchArea(parts),
        max_distance=budget,
    )  # fmt: skip
    line = np.array([[[0.0, 10.0], [55.0, 10.0]]])
    path = pattern_path(problem, line, "pattern", from_start=False)
    whole = [(0, 10), (8, 10), (16, 10), (20, 10), (35, 10), (41, 10)]
    np.testing.assert_allclose(path.waypoints, whole[:expected])


@given(
    points=st.lists(st.tuples(st.integers(-50, 50), st.integers(-50, 50)), min_size=2, max_size=8),
    spacing=st.floats(0.5, 30.0),
    limit=st.floats(0.1, 400.0),
)
def test_waypoints_follow_the_polyline_up_to_the_limit(points, spacing, limit):
    polyline = np.array(points, dtype=float)
    if not np.any(polyline != polyline[0]):
        return
    waypoints = waypoints_along(polyline, spacing, limit)
    line = shapely.LineString(polyline)
    legs = np.hypot(*np.diff(waypoints, axis=0).T)
    assert legs.sum() == pytest.approx(min(limit, line.length), rel=1e-9)
    assert (legs > 0).all()
    assert legs.max() <= spacing * (1 + 1e-9)
    assert shapely.distance(line, shapely.points(waypoints)).max() < 1e-9
