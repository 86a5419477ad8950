import numpy as np
import pytest

from wisar_planner import SearchPath, make_planner
from wisar_planner.planners.random_kernels import random_state, uniform
from wisar_planner.planners.refine import EARLY_WEIGHT, Schedule, annealing, exact_steps
from wisar_planner.planners.refine_kernels import _propose
from wisar_planner.planners.search_raster import COARSE, FINE, SearchRaster

MOVES = 11


def annealed(problem, path, iterations, seed):
    """The path after so many moves on a fine raster."""
    raster = SearchRaster(problem, FINE, path.waypoints)
    points = raster.to_cells(path.waypoints)
    state = random_state(np.random.default_rng(seed))
    for now in annealing(
        raster, points, Schedule(), state, iterations=iterations, early_weight=EARLY_WEIGHT
    ):
        points = now.points
    return SearchPath(exact_steps(problem, raster, points), problem.swath_radius)


def test_annealed_paths_see_more(paper_problem):
    for seed in range(60, 64):
        problem = paper_problem(seed)
        path = make_planner("greedy").plan(problem)
        better = annealed(problem, path, iterations=5000, seed=seed)
        assert better.seen_probability(problem.pdm) > path.seen_probability(problem.pdm)
        assert problem.area.contains(better.waypoints).all()
        np.testing.assert_array_equal(better.waypoints[0], problem.start)
        np.testing.assert_allclose(np.diff(better.distances), 8.0, rtol=1e-12)


def test_no_iterations_give_the_path_itself(paper_problem):
    problem = paper_problem(64)
    path = make_planner("greedy").plan(problem)
    same = annealed(problem, path, iterations=0, seed=0)
    np.testing.assert_allclose(same.waypoints, path.waypoints, atol=1e-9)


@pytest.mark.parametrize("move", range(MOVES))
@pytest.mark.parametrize("steps", [1, 2, 3, 5, 40])
def test_every_move_keeps_steps_and_ends(move, steps):
    rng = np.random.default_rng(move * 100 + steps)
    thresholds = np.where(np.arange(MOVES) < move, -1.0, 2.0)
    state = random_state(rng)
    tried = 0
    for _ in range(60):
        turns = rng.uniform(0.0, 2.0 * np.pi, steps)
        moves = 3.0 * np.stack([np.cos(turns), np.sin(turns)], axis=-1)
        points = np.cumsum(np.concatenate([[[5.0, 7.0]], moves]), axis=0)
        new = np.full_like(points, np.nan)
        a, b = _propose(points, new, 3.0, thresholds, state)
        if a < 0:
            continue
        tried += 1
        assert 0 <= a < b <= steps + 1
        path = points.copy()
        path[a + 1 : b] = new[a + 1 : b]
        np.testing.assert_allclose(np.hypot(*np.diff(path, axis=0).T), 3.0, rtol=1e-9)
        np.testing.assert_array_equal(path[: a + 1], points[: a + 1])
        np.testing.assert_array_equal(path[b:], points[b:])
    tail = move >= 7
    assert tried > 0 or (not tail and steps < 3)


def test_annealing_leaves_no_coverage_behind_and_keeps_its_tally(paper_problem):
    problem = paper_problem(67)
    raster = SearchRaster(problem, COARSE)
    points = raster.to_cells(make_planner("greedy").plan(problem).waypoints)
    state = random_state(np.random.default_rng(5))
    *_, last = annealing(raster, points, Schedule(), state, iterations=3000, early_weight=0.5)
    assert last.iterations == 3000
    assert last.fraction == 1.0
    assert not raster.canvas.counts.any()
    # The probability that it claims is that of its path, painted afresh.
    best = SearchPath(raster.to_metres(last.points), problem.swath_radius)
    assert last.probability == pytest.approx(best.seen_probability(problem.pdm), rel=0.02)


def test_random_numbers_are_uniform():
    state = random_state(np.random.default_rng(1))
    numbers = np.array([uniform(state) for _ in range(20_000)])
    assert 0.0 <= numbers.min() < 0.001
    assert 0.999 < numbers.max() < 1.0
    assert numbers.mean() == pytest.approx(0.5, abs=0.01)
    assert np.corrcoef(numbers[1:], numbers[:-1])[0, 1] == pytest.approx(0.0, abs=0.03)
