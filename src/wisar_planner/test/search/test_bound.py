"""The bound for paths from the start; that for all paths is tested with the problem."""

import math
from dataclasses import replace

import numpy as np
import pytest
import shapely
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import linprog

from wisar_planner import GaussianMixture, Grid, RasterMap, SearchArea, SearchProblem, make_planner
from wisar_planner.errors import InvalidInput
from wisar_planner.search import SearchPath, reachable_bound, upper_bound


def random_problem(seed):
    """Return a problem whose probable ground is mostly out of reach, near, or all over."""
    rng = np.random.default_rng(seed)
    side = float(rng.choice([40.0, 150.0, 400.0]))
    polygon = shapely.box(0.0, 0.0, side, side * rng.uniform(0.4, 1.0))
    if rng.random() < 0.3:
        polygon = polygon.difference(shapely.box(0.3 * side, 0.1 * side, 0.6 * side, 0.3 * side))
    area = SearchArea.from_polygon(polygon)
    if rng.random() < 0.5:
        count = rng.integers(1, 9)
        root = rng.normal(size=(count, 2, 2)) * rng.uniform(3.0, 0.2 * side)
        pdm = GaussianMixture(
            rng.dirichlet(np.ones(count)),
            rng.uniform(0.0, side, (count, 2)),
            root @ root.transpose(0, 2, 1) + 4.0 * np.eye(2),
        )
    else:
        grid = Grid.covering(area.bounds, side / rng.integers(3, 30))
        mass = rng.random((grid.rows, grid.columns)) ** rng.integers(1, 20)
        pdm = RasterMap(mass / mass.sum(), grid)
    points = rng.uniform(0.0, area.bounds[2:], (100, 2))
    return SearchProblem(
        pdm=pdm,
        area=area,
        start=points[area.contains(points)][0],
        step_length=8.0,
        swath_radius=8.0 * rng.uniform(0.1, 0.6),
        max_distance=8.0 * rng.integers(1, 60),
    )


@given(st.integers(0, 10_000))
@settings(max_examples=15)
def test_no_path_from_the_start_beats_the_bound(seed):
    problem = random_problem(seed)
    bound = reachable_bound(problem)
    assert bound <= upper_bound(problem)
    for planner in (make_planner("greedy"), make_planner("lookahead", max_iterations=2000)):
        path = planner.plan(problem)
        assert path.probability_efficiency(problem) <= bound
        # Nor does a part of it.
        part = path.truncated(0.4 * path.length)
        assert part.probability_efficiency(problem) <= reachable_bound(problem, part.length)


@pytest.mark.parametrize("seed", range(3))
def test_long_annealing_stays_below_it_on_the_papers_maps(seed):
    problem = SearchProblem.paper(np.random.default_rng(seed))
    path = make_planner("lookahead", max_iterations=60_000).plan(problem)
    share = path.probability_efficiency(problem) / reachable_bound(problem)
    assert 0.75 < share < 1.0


def test_on_the_papers_maps_it_takes_some_of_the_gap():
    problems = [SearchProblem.paper(np.random.default_rng(seed)) for seed in range(50)]
    loose = np.mean([upper_bound(problem) for problem in problems])
    tight = np.mean([reachable_bound(problem) for problem in problems])
    assert 0.95 < tight / loose < 0.98


def test_it_is_the_upper_bound_where_the_start_is_the_middle_of_a_broad_mode():
    problem = SearchProblem(
        pdm=GaussianMixture(np.ones(1), np.full((1, 2), 100.0), 900.0 * np.eye(2)[None]),
        area=SearchArea.rectangle(0.0, 0.0, 200.0, 200.0),
        start=np.array([100.0, 100.0]),
        step_length=8.0,
        swath_radius=2.5,
        max_distance=2000.0,
    )
    loose = upper_bound(problem)
    assert loose * (1.0 - 1e-3) < reachable_bound(problem) <= loose
    corner = replace(problem, start=np.zeros(2))
    assert reachable_bound(corner) < 0.99 * loose


def ground(columns, rows, dense):
    """Return a raster map of cells of 1 m with probability on the cells that are `dense`."""
    mass = np.zeros((rows, columns))
    mass[dense] = 1.0
    return RasterMap(mass / mass.sum(), Grid(0.0, 0.0, 1.0, columns, rows))


def straight(pdm, start, distance):
    """Return a problem on it and a straight flight to the east."""
    area = SearchArea.rectangle(*pdm.bounds)
    problem = SearchProblem(pdm, area, np.array(start), 8.0, 4.0, distance)
    return problem, SearchPath([start, (start[0] + distance, start[1])], 4.0)


def test_a_strip_as_wide_as_the_swath_is_seen_whole():
    problem, path = straight(ground(400, 40, np.s_[16:24, 20:]), (20.0, 20.0), 320.0)
    seen = path.probability_efficiency(problem)
    assert seen <= reachable_bound(problem) <= seen * 1.01
    # Where the strip begins far away, the way there is lost.
    problem, path = straight(ground(400, 40, np.s_[16:24, 220:]), (20.0, 20.0), 320.0)
    seen = path.probability_efficiency(problem)
    assert seen <= reachable_bound(problem) <= seen * 1.03
    assert upper_bound(problem) > 1.4 * seen


def test_far_ground_counts_from_when_it_can_be_seen():
    problem, path = straight(ground(400, 120, np.s_[:, 100:]), (20.0, 60.0), 300.0)
    seen = path.probability_efficiency(problem)
    bound = reachable_bound(problem)
    assert seen <= bound
    # At most 2 R (L - 80 + R) square metres of the 300 x 120.
    assert bound == pytest.approx(8.0 * (300.0 - 80.0 + 4.0) / (300 * 120), rel=2e-3)
    beyond = replace(problem, max_distance=70.0)
    assert reachable_bound(beyond) == 0.0


@pytest.mark.parametrize("seed", range(6))
def test_it_solves_the_linear_programme(seed):
    rng = np.random.default_rng(seed)
    grid = Grid(-3.0, 5.0, 10.0, 14, 11)
    mass = rng.random((11, 14)) ** 3
    pdm = RasterMap(0.9 * mass / mass.sum(), grid)
    polygon = shapely.Polygon([(0, 0), (130, 20), (110, 120), (20, 100)])
    start = np.asarray(polygon.representative_point().coords[0]) + rng.uniform(-20, 20, 2)
    radius, length = 10.0, float(rng.uniform(20.0, 250.0))
    problem = SearchProblem(pdm, SearchArea(polygon), start, 15.0, radius, length)

    x, y = (grid.centres().reshape(-1, 2) - 5.0).T
    boxes = shapely.box(x, y, x + 10.0, y + 10.0)
    available = shapely.area(
        shapely.intersection(boxes, polygon.buffer(radius, join_style="mitre"))
    )
    near = shapely.distance(boxes, shapely.Point(start))
    rings = np.unique(near)
    limits = np.where(
        rings >= radius,
        2 * radius * np.maximum(length - rings + radius, 0.0),
        2 * radius * length + math.pi * (radius**2 - rings**2),
    )
    solved = linprog(
        -mass.ravel() * pdm.probability.sum() / mass.sum() / 100.0,
        A_ub=near[None, :] >= rings[:, None],
        b_ub=limits,
        bounds=np.column_stack([np.zeros_like(available), available]),
    )
    assert solved.success
    expected = -solved.fun / problem.probability_in_area
    assert expected <= reachable_bound(problem) * (1 + 1e-9)
    assert reachable_bound(problem) <= expected * (1 + 2e-3)


@pytest.mark.parametrize("seed", range(4))
def test_mixture_and_its_fine_raster_have_the_same_bound(seed):
    problem = SearchProblem.paper(np.random.default_rng(seed))
    grid = Grid.covering((-10, -10, 160, 160), 1.0)
    same = replace(problem, pdm=RasterMap(problem.pdm.rasterize(grid), grid))
    assert reachable_bound(same) == pytest.approx(reachable_bound(problem), rel=5e-3)


def test_pieces_bound_the_map_and_hold_its_mass():
    rng = np.random.default_rng(0)
    region = shapely.Polygon([(10, 10), (140, 30), (90, 130)])
    mixture = GaussianMixture.random(rng, (0, 0, 150, 150))
    grid = Grid.covering((0, 0, 150, 150), 7.0)
    for pdm in (mixture, RasterMap(mixture.rasterize(grid), grid)):
        pieces = pdm.density_pieces(region, 2.0)
        assert pieces.side <= 2.0
        assert pieces.areas.sum() == pytest.approx(region.area)
        mass = float(pieces.areas @ pieces.densities)
        assert pdm.integrate(region) <= mass * (1 + 1e-9)
        assert mass == pytest.approx(pdm.integrate(region), rel=5e-3)
    beside = pdm.density_pieces(shapely.box(500, 500, 510, 510), 2.0)
    assert len(beside.areas) == 0


def test_it_grows_with_the_distance():
    problem = SearchProblem.paper(np.random.default_rng(3))
    bounds = [reachable_bound(problem, d) for d in (0.0, 10.0, 100.0, 512.0, 1e4)]
    assert bounds == sorted(bounds)
    disc = SearchPath([problem.start], 2.5).probability_efficiency(problem)
    assert disc <= bounds[0] <= 1.2 * disc
    with pytest.raises(InvalidInput, match="distance"):
        reachable_bound(problem, math.nan)
