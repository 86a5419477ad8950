import numpy as np
import pytest
import shapely

from wisar_planner import GaussianMixture, SearchArea, SearchProblem, make_planner


def problem(area, start, *, step=4.0, budget=1000.0):
    polygon = area if isinstance(area, shapely.Geometry) else shapely.box(*area)
    centre = polygon.representative_point()
    return SearchProblem(
        pdm=GaussianMixture(np.ones(1), [[centre.x, centre.y]], 100.0 * np.eye(2)[None]),
        area=SearchArea.from_polygon(polygon),
        start=np.asarray(start, dtype=float),
        step_length=step,
        swath_radius=1.0,
        max_distance=budget,
    )


def test_small_rectangle_by_hand():
    path = make_planner("lawnmower").plan(problem((0, 0, 10, 8), (1, 1)))
    expected = [
        (0, 0), (4, 0), (8, 0), (10, 0),
        (10, 4), (6, 4), (2, 4), (0, 4),
        (0, 8), (4, 8), (8, 8), (10, 8),
    ]  # fmt: skip
    np.testing.assert_allclose(path.waypoints, expected, atol=1e-12)
    assert path.planner == "lawnmower"
    assert path.transit_length == 0.0


@pytest.mark.parametrize(
    ("start", "first", "second"),
    [
        ((9, 1), (10, 0), (6, 0)),
        ((1, 7), (0, 8), (4, 8)),
        ((9, 7), (10, 8), (6, 8)),
    ],
)
def test_begins_in_the_corner_nearest_the_start(start, first, second):
    path = make_planner("lawnmower").plan(problem((0, 0, 10, 8), start))
    np.testing.assert_allclose(path.waypoints[:2], [first, second])


def test_is_cut_at_the_budget():
    path = make_planner("lawnmower").plan(problem((0, 0, 10, 8), (1, 1), budget=15.0))
    np.testing.assert_allclose(path.waypoints[-1], (9, 4))
    assert path.length == pytest.approx(15.0, abs=1e-12)


def test_lane_spacing_replaces_the_step():
    path = make_planner("lawnmower", lane_spacing=2.0).plan(problem((0, 0, 10, 8), (1, 1)))
    assert sorted(set(path.waypoints[:, 1])) == [0, 2, 4, 6, 8]


def test_from_start_flies_and_counts_the_transit():
    path = make_planner("lawnmower", from_start=True).plan(
        problem((0, 0, 10, 8), (3, 4), budget=8.0)
    )
    np.testing.assert_allclose(path.waypoints, [(3, 4), (0.6, 0.8), (0, 0), (3, 0)], atol=1e-12)
    assert path.transit_length == pytest.approx(5.0)


def test_from_start_may_use_up_the_budget():
    path = make_planner("lawnmower", from_start=True).plan(
        problem((0, 0, 10, 8), (3, 4), budget=2.0)
    )
    assert path.length == pytest.approx(2.0)
    assert path.transit_length == pytest.approx(2.0)


def test_lanes_are_clipped_to_a_triangle():
    triangle = shapely.Polygon([(0, 0), (16, 0), (0, 16)])
    path = make_planner("lawnmower").plan(problem(triangle, (1, 1)))
    # Lanes of 16, 12, 8 and 4 m, and the slanted or upright ways between them; a point on top.
    corners = [(0, 0), (16, 0), (12, 4), (0, 4), (0, 8), (8, 8), (4, 12), (0, 12)]
    for corner in corners:
        assert np.hypot(*(path.waypoints - corner).T).min() < 1e-9
    ways = 4 * np.sqrt(2.0) + 4 + 4 * np.sqrt(2.0)
    assert path.length == pytest.approx(16 + 12 + 8 + 4 + ways)


def test_goes_round_a_hole_along_its_border():
    area = shapely.box(0, 0, 12, 8).difference(shapely.box(4, 3, 8, 6))
    path = make_planner("lawnmower").plan(problem(area, (1, 1)))
    assert shapely.covers(area.buffer(1e-9), shapely.LineString(path.waypoints))
    # The middle lane, at 4 m, meets the hole 1 m above its lower edge: down, across and up again.
    assert path.length == pytest.approx(12 + 4 + (4 + 1 + 4 + 1 + 4) + 4 + 12)


def test_area_between_the_lanes_gets_one_line():
    diamond = shapely.Polygon([(0, 0), (1, -1), (2, 0), (1, 1)]).buffer(-0.1)
    thin = shapely.affinity.translate(diamond, 0.0, 0.3)
    path = make_planner("lawnmower", lane_spacing=50.0).plan(problem(thin, (1, 0.3)))
    assert path.length > 0.5
    assert shapely.covers(thin.buffer(1e-9), shapely.LineString(path.waypoints))
