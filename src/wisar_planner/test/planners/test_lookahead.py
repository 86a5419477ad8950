import time

import numpy as np
import pytest

from wisar_planner import make_planner
from wisar_planner.planners import lookahead
from wisar_planner.search import upper_bound


def test_is_never_much_below_greedy_and_far_ahead_on_average(paper_problem):
    planner = make_planner("lookahead", max_iterations=4000)
    ours, greedy, bound = [], [], []
    for problem in map(paper_problem, range(100, 112)):
        ours.append(planner.plan(problem).probability_efficiency(problem))
        greedy.append(make_planner("greedy").plan(problem).probability_efficiency(problem))
        bound.append(upper_bound(problem))
        assert ours[-1] <= bound[-1]
    assert (np.array(ours) > 0.97 * np.array(greedy)).all()
    assert np.mean(ours) > 0.84 * np.mean(bound)
    assert np.mean(ours) > 1.08 * np.mean(greedy)


def test_steps_have_one_length(paper_problem):
    path = make_planner("lookahead", max_iterations=2000).plan(paper_problem(31))
    np.testing.assert_allclose(np.diff(path.distances), 8.0, rtol=1e-12)
    assert len(path.waypoints) == 65


def test_more_iterations_are_better_on_average(paper_problem):
    few, many = (
        np.mean(
            [
                make_planner("lookahead", max_iterations=n).plan(p).probability_efficiency(p)
                for p in map(paper_problem, range(40, 46))
            ]
        )
        for n in (100, 10_000)
    )
    assert many > few


def test_seeds_differ_and_repeat(paper_problem):
    first, again, other = (
        make_planner("lookahead", max_iterations=3000, seed=s).plan(paper_problem(32)).waypoints
        for s in (1, 1, 2)
    )
    np.testing.assert_array_equal(first, again)
    assert (first != other).any()


def test_early_weight_brings_probability_forward(paper_problem):
    def quarter(weight):
        planner = make_planner("lookahead", max_iterations=4000, early_weight=weight)
        return np.mean(
            [
                planner.plan(p).probability_at_waypoints(p.pdm)[16]
                for p in map(paper_problem, range(50, 58))
            ]
        )

    assert quarter(5.0) > quarter(0.0)


def test_keeps_to_its_time(paper_problem):
    problem = paper_problem(33)
    planner = make_planner("lookahead", time_budget_s=0.5)
    planner.plan(problem)  # compile
    began = time.monotonic()
    planner.plan(problem)
    assert 0.4 < time.monotonic() - began < 1.5


def test_flies_on_to_a_far_mode(far_modes):
    path = make_planner("lookahead", max_iterations=2000).plan(far_modes)
    assert path.probability_efficiency(far_modes) > 0.95


def test_hole_is_not_searched_from_inside(holed_problem):
    path = make_planner("lookahead", max_iterations=5000).plan(holed_problem)
    assert holed_problem.area.contains(path.waypoints).all()
    greedy = make_planner("greedy").plan(holed_problem)
    assert path.probability_efficiency(holed_problem) >= greedy.probability_efficiency(
        holed_problem
    )


@pytest.mark.parametrize("option", ["time_budget_s", "max_iterations", "early_weight", "seed"])
def test_options_are_described(option):
    from wisar_planner.planners import planner_options

    assert option in planner_options("lookahead")


def test_asks_to_stop_where_no_rollout_finds_a_way(paper_problem, monkeypatch):
    tried = []
    monkeypatch.setattr(lookahead, "rollout", lambda *_: tried.append(1))
    make_planner("lookahead").plan(paper_problem(33), should_stop=lambda: len(tried) == 2)
    assert len(tried) == 2
