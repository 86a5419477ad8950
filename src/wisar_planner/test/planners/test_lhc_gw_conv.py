import numpy as np
import pytest

from wisar_planner import Grid, RasterMap, SearchArea, SearchProblem, make_planner


def plan(cells, start, budget, **options):
    """Plan on a raster of 10 m cells, given with its top row first; start as (column, row)."""
    mass = np.array(cells, dtype=float)[::-1]
    rows, columns = mass.shape
    problem = SearchProblem(
        pdm=RasterMap(mass / mass.sum(), Grid(0.0, 0.0, 10.0, columns, rows)),
        area=SearchArea.rectangle(0.0, 0.0, 10.0 * columns, 10.0 * rows),
        start=10.0 * np.array(start) + 5.0,
        step_length=10.0,
        swath_radius=3.0,
        max_distance=budget,
    )
    path = make_planner("lhc_gw_conv", **options).plan(problem)
    return [tuple(p) for p in np.round((path.waypoints - 5.0) / 10.0, 9)], path


def test_climbs_to_the_best_of_eight_neighbours():
    cells = [
        [0, 0, 0, 9],
        [0, 2, 5, 1],
        [1, 1, 1, 1],
    ]  # fmt: skip
    way, path = plan(cells, (0, 0), 10.0 * (3 * np.sqrt(2.0)) - 1e-6, levels=1)
    # Diagonals all the way: 2 beats 1, 5 is beside it, 9 is up and to the right.
    assert way[:3] == [(0, 0), (1, 1), (2, 1)]
    assert way[3] == (3, 2)
    assert path.length == pytest.approx(10.0 * (1 + 2 * np.sqrt(2.0)), abs=10.0)


def test_diagonal_distance_counts_and_the_path_is_cut():
    cells = [[0, 0, 9], [0, 5, 0], [1, 0, 0]]
    way, path = plan(cells, (0, 0), 20.0, levels=1)
    assert path.length == pytest.approx(20.0)
    share = 20.0 / np.sqrt(2.0) / 10.0
    assert way == [(0, 0), (1, 1), pytest.approx((share, share))]


def test_box_breaks_ties():
    cells = [
        [0, 0, 0, 0, 0],
        [1, 0, 0, 0, 3],
        [0, 2, 1, 2, 0],
    ]  # fmt: skip
    way, _ = plan(cells, (2, 0), 10.0, levels=1)
    assert way[1] == (3, 0)
    mirrored, _ = plan([row[::-1] for row in cells], (2, 0), 10.0, levels=1)
    assert mirrored[1] == (1, 0)


def test_visited_cells_come_last_and_the_way_back_after_them():
    # A corridor: with nothing unvisited ahead it turns round at its end.
    way, _ = plan([[1, 2, 3]], (0, 0), 40.0, levels=1)
    assert way == [(0, 0), (1, 0), (2, 0), (1, 0), (0, 0)]


def test_global_warming_drowns_a_foothill():
    cells = [
        [0, 0, 0, 0, 0, 0],
        [3, 0, 4, 5, 9, 9],
        [2, 3, 0, 0, 9, 9],
        [0, 0, 0, 0, 0, 0],
    ]  # fmt: skip
    _, cold = plan(cells, (1, 2), 60.0, levels=1)
    _, warm = plan(cells, (1, 2), 60.0, levels=20, kernel=5)
    problem_map = RasterMap(
        np.array(cells, dtype=float)[::-1] / np.sum(cells), Grid(0.0, 0.0, 10.0, 6, 4)
    )
    assert warm.seen_probability(problem_map) >= cold.seen_probability(problem_map)


def test_first_waypoint_is_the_start_itself():
    mass = np.ones((5, 5)) / 25.0
    problem = SearchProblem(
        pdm=RasterMap(mass, Grid(0.0, 0.0, 10.0, 5, 5)),
        area=SearchArea.rectangle(0.0, 0.0, 50.0, 50.0),
        start=np.array([1.0, 2.0]),
        step_length=10.0,
        swath_radius=3.0,
        max_distance=100.0,
    )
    path = make_planner("lhc_gw_conv").plan(problem)
    np.testing.assert_array_equal(path.waypoints[0], (1.0, 2.0))
    np.testing.assert_allclose(path.waypoints[1:-1] % 10.0, 5.0)
