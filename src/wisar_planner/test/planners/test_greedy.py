import numpy as np
import pytest

from wisar_planner import GaussianMixture, SearchArea, SearchProblem, SeenArea, make_planner


def test_every_step_is_the_best_of_its_headings(paper_problem):
    problem = paper_problem(21)
    path = make_planner("greedy", headings=16, far_share=0.0).plan(problem)
    seen = SeenArea(problem.pdm, problem.swath_radius)
    seen.add(problem.start, problem.start)
    angles = 2.0 * np.pi * np.arange(16) / 16
    for here, there in zip(path.waypoints[:-1], path.waypoints[1:], strict=True):
        ends = here + 8.0 * np.stack([np.cos(angles), np.sin(angles)], axis=-1)
        ends = ends[problem.area.contains(ends)]
        best = seen.gains(here, ends).max()
        assert seen.add(here, there) == pytest.approx(best, abs=1e-12)


def test_steps_have_one_length(paper_problem):
    path = make_planner("greedy").plan(paper_problem(22))
    np.testing.assert_allclose(np.diff(path.distances), 8.0, rtol=1e-9)
    assert len(path.waypoints) == 65


def test_flies_on_to_a_far_mode_when_nothing_is_left_near_by(far_modes):
    path = make_planner("greedy").plan(far_modes)
    assert path.probability_efficiency(far_modes) > 0.9
    lazy = make_planner("greedy", far_share=0.0).plan(far_modes)
    assert lazy.probability_efficiency(far_modes) < 0.5


def test_goes_round_a_hole_to_a_far_mode(holed_problem):
    problem = SearchProblem(
        pdm=GaussianMixture(np.ones(1), np.array([[95.0, 50.0]]), 9.0 * np.eye(2)[None]),
        area=holed_problem.area,
        start=np.array([5.0, 50.0]),
        step_length=8.0,
        swath_radius=2.5,
        max_distance=240.0,
    )
    path = make_planner("greedy").plan(problem)
    assert path.probability_efficiency(problem) > 0.8


def test_takes_shorter_steps_where_no_whole_one_fits():
    problem = SearchProblem(
        pdm=GaussianMixture(np.ones(1), np.array([[2.5, 2.5]]), 4.0 * np.eye(2)[None]),
        area=SearchArea.rectangle(0.0, 0.0, 5.0, 5.0),
        start=np.array([2.5, 2.5]),
        step_length=8.0,
        swath_radius=1.0,
        max_distance=64.0,
    )
    path = make_planner("greedy").plan(problem)
    assert len(path.waypoints) > 1
    assert np.diff(path.distances).max() < 8.0


def test_progress_grows_to_the_result(paper_problem):
    problem, told = paper_problem(23), []
    path = make_planner("greedy").plan(problem, on_progress=told.append)
    assert told[-1].fraction == 1.0
    assert told[-1].efficiency == pytest.approx(path.probability_efficiency(problem), abs=1e-9)


def test_beats_the_lawnmower_on_average(paper_problem):
    ratio = {
        name: np.mean(
            [
                make_planner(name).plan(p).probability_efficiency(p)
                for p in map(paper_problem, range(30))
            ]
        )
        for name in ("greedy", "lawnmower")
    }
    assert ratio["greedy"] > 2.0 * ratio["lawnmower"]
