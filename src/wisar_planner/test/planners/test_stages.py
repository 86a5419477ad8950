import math
import time

import numpy as np
import pytest

from wisar_planner import make_planner
from wisar_planner.planners import stages
from wisar_planner.planners.monitor import Monitor
from wisar_planner.planners.random_kernels import random_state
from wisar_planner.planners.search_raster import COARSE, SearchRaster
from wisar_planner.planners.stages import Found, Stages


def made(problem, monitor, ways_on=None):
    """The search of a problem, and the greedy path to begin with."""
    raster = SearchRaster(problem, COARSE)
    state = random_state(np.random.default_rng(1))
    points = raster.to_cells(make_planner("greedy").plan(problem).waypoints)
    return Stages(problem, raster, monitor, state, 0.5, ways_on), Found(0.0, points)


def test_a_budget_of_moves_is_spent_and_hardly_exceeded(paper_problem):
    problem = paper_problem(90)
    monitor = Monitor(problem, math.inf, 40_000, None, None)
    search, path = made(problem, monitor)
    search.best_of([path])
    assert 1.0 <= monitor.spent() < 1.5
    assert monitor.ended()
    assert not monitor.stopped()


def test_more_moves_see_more(paper_problem):
    seen = []
    for moves in (2_000, 100_000):
        values = []
        for problem in map(paper_problem, range(91, 97)):
            search, path = made(problem, Monitor(problem, math.inf, moves, None, None))
            values.append(search._polisher.valued(search.best_of([path])).value)
        seen.append(np.mean(values))
    assert seen[1] > 1.005 * seen[0]


def test_a_better_way_on_is_taken_to_its_top(paper_problem):
    problem = paper_problem(100)
    better = make_planner("sac").plan(problem).waypoints
    monitor = Monitor(problem, math.inf, 60_000, None, None)
    search, path = made(problem, monitor, lambda _: [better])
    # Not annealed, so that the policy's path is far ahead.
    search._stages = lambda: ()
    best = search._polisher.valued(search.best_of([path]))
    assert best.value > 1.001 * search._polisher.valued(better).value


def test_ways_that_are_far_behind_change_nothing_and_count(paper_problem):
    problem = paper_problem(101)
    asked = []

    def ways_on(waypoints):
        asked.append(waypoints)
        return [np.array([waypoints[i % 2] for i in range(len(waypoints))])] * 16

    values = []
    for ways in (None, ways_on):
        monitor = Monitor(problem, math.inf, 60_000, None, None)
        search, path = made(problem, monitor, ways)
        best = search.best_of([path])
        assert 1.0 <= monitor.spent() < 1.5
        values.append(search._polisher.valued(best).value)
    assert len(asked) > 0
    assert values[1] > 0.98 * values[0]


def test_other_ways_have_what_a_long_budget_leaves(paper_problem):
    """Annealing has as many moves of a long budget as of one of 1,250 moves a step."""
    problem = paper_problem(102)
    shares = []
    for moves in (1250, 12_500):
        monitor = Monitor(problem, math.inf, moves * problem.steps, None, None)
        search, _ = made(problem, monitor, lambda _: [])
        alone, _ = made(problem, monitor)
        shares.append(
            [
                stage.share / whole.share
                for stage, whole in zip(search._stages(), alone._stages(), strict=True)
            ]
        )
    np.testing.assert_allclose(shares, [[1.0, 1.0], [0.1, 0.1]])


@pytest.mark.parametrize("most_steps", [63, 64])
def test_paths_too_long_for_the_ascent_are_annealed_to_the_end(
    paper_problem, monkeypatch, most_steps
):
    monkeypatch.setattr(stages, "MOST_STEPS", most_steps)
    problem = paper_problem(97)
    search, _ = made(problem, Monitor(problem, math.inf, 40_000, None, None))
    assert (search._stages()[-1].share == 1.0) == (most_steps < problem.steps)


def test_told_to_stop_it_compares_what_it_has_by_what_is_really_seen(paper_problem):
    """A path to and fro is the better one by its value, which is wrong, and is annealed first."""
    problem = paper_problem(98)
    monitor = Monitor(problem, 600.0, math.inf, None, lambda: True)
    search, path = made(problem, monitor)
    to_and_fro = np.array([path.points[i % 2] for i in range(len(path.points))])
    best = search.best_of([Found(1e30, to_and_fro), path])
    assert monitor.stopped()
    greedy = make_planner("greedy").plan(problem)
    least = search._polisher.valued(greedy.waypoints).value
    assert search._polisher.valued(best).value >= least * (1.0 - 1e-9)


def test_what_is_left_of_a_budget(paper_problem):
    problem = paper_problem(99)
    counted = Monitor(problem, math.inf, 1000, None, None)
    counted.count(250)
    assert counted.spent() == 0.25
    assert counted.moves_until(0.5) == 250
    assert counted.moves_until(0.1) == 1
    assert counted.seconds_until(0.5) == math.inf
    timed = Monitor(problem, 3600.0, math.inf, None, None)
    timed.count(10**9)
    assert timed.spent() < 0.5
    assert timed.moves_until(0.5) is None
    assert 1000.0 < timed.seconds_until(0.5) <= 1800.0
    assert timed.seconds_until(0.0) == 0.0


def test_reports_are_exact_and_not_too_many(paper_problem):
    problem, told, asked = paper_problem(100), [], []
    path = make_planner("sac").plan(problem)
    monitor = Monitor(problem, 3600.0, math.inf, told.append, lambda: bool(asked.append(1)))
    for _ in range(50):
        monitor.report(path.waypoints)
    assert len(asked) == 50
    assert 1 <= len(told) < 50
    assert told[0].efficiency == pytest.approx(path.probability_efficiency(problem), rel=1e-12)
    time.sleep(0.03)
    monitor.report(path.waypoints)
    assert len(told) >= 2
