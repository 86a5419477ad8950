import math
from dataclasses import replace

import numpy as np
import pytest
import shapely

from wisar_planner.errors import InvalidInput
from wisar_planner.pdm import Grid, RasterMap
from wisar_planner.search import (
    SearchArea,
    SearchPath,
    SearchProblem,
    scaled_reward,
    shaped_reward,
    upper_bound,
)
from wisar_planner.search.problem import MOST_STEPS


def paper(seed=0, **changes):
    return replace(SearchProblem.paper(np.random.default_rng(seed)), **changes)


def test_the_papers_problem():
    problem = paper()
    assert problem.steps == 64
    assert (problem.step_length, problem.swath_radius, problem.max_distance) == (8.0, 2.5, 512.0)
    assert problem.area.area == 22500.0
    assert problem.area.contains(problem.start[None, :])[0]
    assert problem.probability_in_area == problem.pdm.integrate(shapely.box(0, 0, 150, 150))
    given = SearchProblem.paper(np.random.default_rng(0), start=(3, 4))
    np.testing.assert_array_equal(given.start, (3, 4))
    np.testing.assert_array_equal(given.pdm.means, problem.pdm.means)


def test_steps_do_not_suffer_from_rounding():
    assert paper(step_length=0.1, max_distance=0.3).steps == 3
    assert paper(max_distance=7.9).steps == 0


def test_a_search_of_far_too_many_steps_is_refused_in_the_users_words():
    names = {"step": "--step", "budget": "--budget"}
    paper(step_length=0.01, max_distance=0.01 * MOST_STEPS).check_steps(**names)
    for endless in (
        paper(step_length=0.01, max_distance=0.01 * MOST_STEPS + 0.01),
        paper(step_length=1e-300, max_distance=1e300),
    ):
        with pytest.raises(InvalidInput, match="give a longer --step or a smaller --budget"):
            endless.check_steps(**names)


def test_areas():
    area = SearchArea.from_polygon([(0, 0), (10, 0), (10, 10)])
    assert area.bounds == (0, 0, 10, 10)
    assert area.area == 50.0
    inside = area.contains([[9, 1], [1, 9], [10, 5], [0, 0]])
    np.testing.assert_array_equal(inside, [True, False, True, True])
    island = SearchArea(shapely.union_all([shapely.box(0, 0, 1, 1), shapely.box(5, 5, 6, 6)]))
    np.testing.assert_array_equal(island.contains([[0.5, 0.5], [3, 3], [5.5, 5.5]]), [1, 0, 1])


def test_the_middle_of_an_area_is_its_centre_or_else_inside():
    square = shapely.box(0, 0, 10, 10)
    even = SearchArea(square)
    np.testing.assert_allclose(even.middle, [5.0, 5.0], rtol=1e-12)
    with pytest.raises(ValueError, match="read-only"):  # all callers share it
        even.middle[0] = 6.0
    holed = square.difference(shapely.box(3, 3, 7, 7))
    parts = shapely.union_all([square, shapely.box(90, 0, 100, 10)])
    for area in map(SearchArea, (holed, parts)):
        assert not area.polygon.covers(area.polygon.centroid)
        assert area.contains(area.middle[None, :])[0]


@pytest.mark.parametrize(
    ("polygon", "named"),
    [
        (shapely.Polygon(), "empty"),
        (shapely.Polygon([(0, 0), (1, 1), (2, 2)]), "empty"),
        (shapely.Polygon([(0, 0), (1, 1), (1, 0), (0, 1)]), "polygon"),
        (shapely.Point(0, 0), "polygon"),
        ([(0, 0), (1, 1)], "polygon"),
        ([(0, 0), (1, math.nan), (2, 0)], "polygon"),
    ],
)
def test_bad_areas_are_named(polygon, named):
    with pytest.raises(InvalidInput, match=named):
        SearchArea.from_polygon(polygon)


@pytest.mark.parametrize(
    ("changes", "named"),
    [
        ({"start": (151.0, 5.0)}, "start"),
        ({"start": (math.nan, 5.0)}, "start"),
        ({"step_length": 0.0}, "step_length"),
        ({"step_length": "far"}, "step_length"),
        ({"swath_radius": -1.0}, "swath_radius"),
        ({"max_distance": math.inf}, "max_distance"),
        ({"pdm": None}, "pdm"),
        ({"area": shapely.box(0, 0, 1, 1)}, "area"),
        ({"area": SearchArea.rectangle(1e5, 0, 2e5, 10), "start": (1e5, 0)}, "area"),
    ],
)
def test_bad_problems_are_named(changes, named):
    with pytest.raises(InvalidInput, match=named):
        paper(**changes)


def test_a_step_over_even_ground_earns_one():
    grid = Grid(0, 0, 10.0, 15, 15)
    problem = paper(pdm=RasterMap(np.full((15, 15), 1 / 225), grid))
    path = SearchPath([[50, 50], [58, 50]], 2.5)
    gain = path.seen_probability(problem.pdm)
    assert scaled_reward(problem, [gain])[0] == pytest.approx(1.0, rel=1e-9)


def test_the_shaped_reward_has_three_cases():
    problem = paper()
    unit = 1.0 / scaled_reward(problem, 1.0)
    gains = unit * np.array([2.0, 0.1001, 0.0999, 2.0])
    positions = [[10, 10], [10, 10], [10, 10], [-1, 10]]
    np.testing.assert_allclose(shaped_reward(problem, gains, positions), [1.0, 0.05005, -0.5, -1.0])
    strict = shaped_reward(problem, gains, positions, epsilon=3.0, w_oob=2.0, w_0=0.1)
    np.testing.assert_allclose(strict, [-0.1, -0.1, -0.1, -2.0])


def test_the_mean_bound_of_the_papers_setup():
    bounds = [upper_bound(paper(seed)) for seed in range(100)]
    assert np.mean(bounds) == pytest.approx(0.345, abs=0.01)


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("as_raster", [False, True])
def test_no_path_beats_the_bound(seed, as_raster):
    problem = paper(seed)
    if as_raster:
        grid = Grid.covering((-20, -20, 170, 170), 5.0)
        problem = replace(problem, pdm=RasterMap(problem.pdm.rasterize(grid), grid))
    # The best paths there are: short, straight through a peak, and a tight meander over it.
    peak = problem.pdm.rasterize(Grid.covering((0, 0, 150, 150), 2.0))
    row, column = np.unravel_index(peak.argmax(), peak.shape)
    centre = np.array([2.0 * column + 1.0, 2.0 * row + 1.0])
    lanes = np.arange(-20, 21, 5.0)
    meander = [((-1) ** k * x, y) for k, y in enumerate(lanes) for x in (-20, 20)]
    for points in ([(0, 0), (0.5, 0)], [(-8, 0), (8, 0)], meander):
        waypoints = np.clip(centre + points, 0, 150)
        moved = np.append(True, (np.diff(waypoints, axis=0) != 0.0).any(axis=1))
        path = SearchPath(waypoints[moved], 2.5)
        bound = upper_bound(problem, path.length)
        assert path.probability_efficiency(problem) <= bound
    assert bound < 1.0


def test_the_bound_grows_with_the_distance_up_to_all_there_is():
    problem = paper()
    bounds = [upper_bound(problem, d) for d in (0.0, 100.0, 512.0, 1e5)]
    assert bounds == sorted(bounds)
    wide = problem.pdm.integrate(shapely.box(-2.5, -2.5, 152.5, 152.5))
    assert bounds[-1] == pytest.approx(wide / problem.probability_in_area)
    with pytest.raises(InvalidInput, match="distance"):
        upper_bound(problem, -1.0)


def test_an_area_smaller_than_the_swath_is_seen_at_once():
    area = SearchArea.rectangle(70, 70, 71, 71)
    problem = paper(area=area, start=(70.5, 70.5))
    path = SearchPath([problem.start], 2.5)
    assert path.probability_efficiency(problem) > 1.0
    assert path.probability_efficiency(problem) <= upper_bound(problem, 0.0)
