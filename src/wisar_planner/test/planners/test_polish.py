import numpy as np
import pytest
import shapely

from wisar_planner import GaussianMixture, SearchArea, SearchPath, SearchProblem, make_planner
from wisar_planner.pdm.boundary import polygon_edges
from wisar_planner.planners import polish
from wisar_planner.planners.polish import Polisher
from wisar_planner.planners.polish_kernels import trespass

HOLED = shapely.box(0, 0, 20, 10).difference(shapely.box(8, 4, 12, 7))


def seen(problem, waypoints):
    return SearchPath(waypoints, problem.swath_radius).seen_probability(problem.pdm)


def check(problem, waypoints):
    np.testing.assert_array_equal(waypoints[0], problem.start)
    lengths = np.hypot(*np.diff(waypoints, axis=0).T)
    np.testing.assert_allclose(lengths, problem.step_length, rtol=1e-9)
    assert problem.area.contains_legs(waypoints[:-1], waypoints[1:]).all()


@pytest.mark.parametrize("early_weight", [0.0, 0.5])
def test_sees_more_and_ends_at_the_top(paper_problem, early_weight):
    for seed in range(70, 76):
        problem = paper_problem(seed)
        before = make_planner("sac").plan(problem).waypoints
        polisher = Polisher(problem, early_weight)
        path = polisher.polish(before)
        check(problem, path.waypoints)
        assert path.value > 1.002 * polisher.valued(before).value
        again = polisher.polish(path.waypoints)
        assert path.value <= again.value < 1.001 * path.value
        if early_weight == 0.0:
            assert path.value == pytest.approx(seen(problem, path.waypoints), rel=1e-12)
            assert path.value > 1.002 * seen(problem, before)


def test_early_weight_counts_what_is_seen_early(paper_problem):
    problem = paper_problem(77)
    waypoints = make_planner("sac").plan(problem).waypoints
    found = Polisher(problem, 0.6).valued(waypoints)
    seen_at = [seen(problem, waypoints[: n + 1]) for n in (8, 24, 48, 64)]
    assert found.value == pytest.approx(seen_at[3] + 0.6 * np.mean(seen_at[:3]), rel=1e-12)


def test_stays_in_an_area_that_the_probability_pulls_out_of():
    """The mode lies outside, so that the path runs along the border."""
    problem = SearchProblem(
        pdm=GaussianMixture([1.0], [[50.0, -20.0]], 300.0 * np.eye(2)[None]),
        area=SearchArea.rectangle(0.0, 0.0, 100.0, 100.0),
        start=np.array([20.0, 30.0]),
        step_length=8.0,
        swath_radius=2.5,
        max_distance=160.0,
    )
    before = make_planner("greedy").plan(problem).waypoints
    path = Polisher(problem, 0.0).polish(before)
    check(problem, path.waypoints)
    assert seen(problem, path.waypoints) > 1.01 * seen(problem, before)
    assert path.waypoints[:, 1].min() < problem.swath_radius


def test_stays_out_of_holes(holed_problem):
    before = make_planner("greedy").plan(holed_problem).waypoints
    path = Polisher(holed_problem, 0.0).polish(before)
    check(holed_problem, path.waypoints)
    assert seen(holed_problem, path.waypoints) >= seen(holed_problem, before)


def test_goes_part_of_the_way_where_the_whole_leaves_the_area(paper_problem, monkeypatch):
    """Without the push at the border, many an ascent ends outside."""
    problem = paper_problem(78)
    middle = problem.start
    low, high = middle - 13.0, middle + 13.0
    narrow = SearchProblem(
        problem.pdm, SearchArea.rectangle(*low, *high), middle, 8.0, 2.5, 256.0
    )  # fmt: skip
    monkeypatch.setattr(polish, "_PUSH", 0.0)
    before = make_planner("greedy").plan(narrow).waypoints
    path = Polisher(narrow, 0.0).polish(before)
    check(narrow, path.waypoints)
    assert path.value >= seen(narrow, before)


def test_ends_when_told(paper_problem):
    problem, told = paper_problem(79), []
    before = make_planner("sac").plan(problem).waypoints

    def on_progress(waypoints):
        told.append(seen(problem, waypoints))
        return len(told) == 5

    path = Polisher(problem, 0.0).polish(before, on_progress=on_progress)
    assert len(told) == 5
    assert path.value == pytest.approx(told[-1], rel=1e-12)
    assert told == sorted(told)


def test_ends_after_the_evaluations_it_is_given(paper_problem):
    problem = paper_problem(80)
    polisher = Polisher(problem, 0.5)
    polisher.polish(make_planner("sac").plan(problem).waypoints, most_evaluations=10)
    assert 10 <= polisher.evaluations < 40


def test_leaves_very_long_paths_as_they_are(paper_problem, monkeypatch):
    problem = paper_problem(81)
    before = make_planner("sac").plan(problem).waypoints
    monkeypatch.setattr(polish, "MOST_STEPS", 63)
    assert Polisher(problem, 0.0).polish(before).waypoints is before


def test_trespass_is_how_much_nearer_than_the_margin_points_are():
    points = np.random.default_rng(3).uniform((-3.0, -3.0), (23.0, 13.0), (400, 2))
    edges, pushes = polygon_edges(HOLED), np.empty_like(points)
    total = trespass(points, edges, 1.5, pushes)
    distance = shapely.distance(HOLED.boundary, shapely.points(points))
    depth = np.where(shapely.contains_xy(HOLED, *points.T), distance, -distance)
    assert total == pytest.approx((np.maximum(1.5 - depth, 0.0) ** 2).sum(), rel=1e-12)
    for i in range(0, 400, 7):
        for axis in range(2):
            sums = []
            for by in (-1e-6, 1e-6):
                moved = points[i : i + 1].copy()
                moved[0, axis] += by
                sums.append(trespass(moved, edges, 1.5, np.empty((1, 2))))
            assert pushes[i, axis] == pytest.approx((sums[1] - sums[0]) / 2e-6, abs=1e-5)


def test_a_vertex_of_the_area_may_be_repeated(paper_problem):
    """As in many a file; the polygon is valid all the same."""
    problem = paper_problem(82)
    corners = [(0, 0), (150, 0), (150, 0), (150, 150), (0, 150), (0, 0)]
    area = SearchArea(shapely.Polygon(corners))
    assert len(polygon_edges(area.polygon)) == 5
    same = SearchProblem(problem.pdm, area, problem.start, 8.0, 2.5, 512.0)
    before = make_planner("sac").plan(problem).waypoints
    expected = Polisher(problem, 0.0).polish(before).waypoints
    np.testing.assert_allclose(Polisher(same, 0.0).polish(before).waypoints, expected, atol=1e-9)
