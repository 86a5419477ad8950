import dataclasses
import itertools

import numpy as np
import pytest
import shapely

from wisar_planner import (
    GaussianMixture,
    InvalidInput,
    SearchArea,
    SearchProblem,
    make_planner,
)
from wisar_planner.evaluation.scenario import RandomMaps
from wisar_planner.policy.model import DEFAULT_MODEL, find_model, load_model, save_model


def check(problem, path):
    """What every path must keep: the start, the area, the budget."""
    assert path.planner == "sac"
    np.testing.assert_array_equal(path.waypoints[0], problem.start)
    assert problem.area.contains(path.waypoints).all()
    flown = shapely.LineString(path.waypoints) if len(path.waypoints) > 1 else problem.area.polygon
    assert problem.area.polygon.buffer(1e-6).covers(flown)
    assert path.length <= problem.max_distance * (1.0 + 1e-9)


@pytest.fixture
def l_shaped() -> SearchProblem:
    """An L of three squares; the start in one arm, the map's peak in the other."""
    square = shapely.box(0.0, 0.0, 100.0, 100.0)
    return SearchProblem(
        pdm=GaussianMixture(np.ones(1), np.array([[25.0, 85.0]]), 400.0 * np.eye(2)[None]),
        area=SearchArea.from_polygon(square.difference(shapely.box(50.0, 50.0, 101.0, 101.0))),
        start=np.array([95.0, 20.0]),
        step_length=8.0,
        swath_radius=2.5,
        max_distance=400.0,
    )


def one_gaussian(**changes) -> SearchProblem:
    problem = SearchProblem(
        pdm=GaussianMixture(np.ones(1), np.array([[60.0, 60.0]]), 500.0 * np.eye(2)[None]),
        area=SearchArea.rectangle(0.0, 0.0, 150.0, 150.0),
        start=np.array([75.0, 75.0]),
        step_length=8.0,
        swath_radius=2.5,
        max_distance=400.0,
    )
    return dataclasses.replace(problem, **changes)


@pytest.mark.parametrize("seed", range(4))
def test_flies_its_budget_in_whole_steps_inside_the_area(paper_problem, seed):
    problem = paper_problem(seed)
    path = make_planner("sac").plan(problem)
    check(problem, path)
    assert len(path.waypoints) == problem.steps + 1
    np.testing.assert_allclose(np.diff(path.distances), 8.0, rtol=1e-9)


def test_same_problem_same_plan(paper_problem):
    first, again = (make_planner("sac").plan(paper_problem(5)).waypoints for _ in range(2))
    np.testing.assert_array_equal(first, again)


def test_a_trained_policy_beats_the_lawnmower_by_far(paper_problem):
    problems = [paper_problem(seed) for seed in range(100, 112)]
    ours, theirs = (
        np.mean([make_planner(name).plan(p).probability_efficiency(p) for p in problems])
        for name in ("sac", "lawnmower")
    )
    assert ours > 1.5 * theirs


def test_plans_on_a_raster_map(far_modes):
    path = make_planner("sac").plan(far_modes)
    check(far_modes, path)
    assert path.probability_efficiency(far_modes) > 0.1


def test_plans_in_an_area_that_is_not_convex(l_shaped):
    path = make_planner("sac").plan(l_shaped)
    check(l_shaped, path)
    assert len(path.waypoints) == l_shaped.steps + 1


def test_plans_around_a_hole(holed_problem):
    check(holed_problem, make_planner("sac").plan(holed_problem))


def test_an_area_smaller_than_a_step_is_left_to_the_greedy_planner():
    problem = one_gaussian(
        area=SearchArea.rectangle(55.0, 55.0, 60.0, 60.0), start=np.array([56.0, 57.0])
    )
    path = make_planner("sac").plan(problem)
    check(problem, path)
    greedy = make_planner("greedy").plan(problem)
    np.testing.assert_array_equal(path.waypoints, greedy.waypoints)


def test_a_budget_below_a_step_stays_at_the_start():
    problem = one_gaussian(max_distance=5.0)
    path = make_planner("sac").plan(problem)
    np.testing.assert_array_equal(path.waypoints, problem.start[None])


def test_one_step_is_planned():
    problem = one_gaussian(max_distance=8.0)
    assert make_planner("sac").plan(problem).length == pytest.approx(8.0)


def test_stops_when_told_and_keeps_what_it_has(paper_problem):
    problem, asked = paper_problem(6), itertools.count(1)
    path = make_planner("sac").plan(problem, should_stop=lambda: next(asked) > 10)
    check(problem, path)
    assert 10 <= len(path.waypoints) <= 12
    whole = make_planner("sac").plan(problem)
    np.testing.assert_array_equal(path.waypoints, whole.waypoints[: len(path.waypoints)])


def test_progress_grows_and_ends_near_the_efficiency(paper_problem):
    problem, told = paper_problem(7), []
    path = make_planner("sac").plan(problem, on_progress=told.append)
    fractions = [each.fraction for each in told]
    assert fractions == sorted(fractions)
    assert len(told) > 30
    assert fractions[-1] == pytest.approx(1.0)
    efficiencies = [each.efficiency for each in told]
    assert efficiencies == sorted(efficiencies)
    assert efficiencies[-1] == pytest.approx(path.probability_efficiency(problem), rel=0.05)


def test_the_model_can_be_given_by_its_path_and_is_read_again_when_it_changes(
    paper_problem, tmp_path
):
    shipped, path = load_model(find_model(DEFAULT_MODEL)), tmp_path / "mine.safetensors"
    card = {"distribution": shipped.distribution}
    save_model(path, shipped.weights, card)
    problem = paper_problem(8)
    mine = make_planner("sac", model=str(path))
    np.testing.assert_array_equal(
        mine.plan(problem).waypoints, make_planner("sac").plan(problem).waypoints
    )
    save_model(path, {k: 0.5 * v for k, v in shipped.weights.items()}, card)
    assert (mine.plan(problem).waypoints != make_planner("sac").plan(problem).waypoints).any()


@pytest.mark.parametrize("name", ["sac", "sac_search"])
def test_a_model_that_is_not_there_is_refused(name, paper_problem):
    planner = make_planner(name, model="none")
    with pytest.raises(InvalidInput, match="'none' is neither a shipped model"):
        planner.plan(paper_problem(9))


def test_the_shipped_model_keeps_what_its_card_promises() -> None:
    """On the card's first maps exactly, and within the sampling error of its 1,000 maps."""
    stated = load_model(find_model(DEFAULT_MODEL)).card["evaluation"]
    check = stated["check"]
    scenario, planner = RandomMaps(), make_planner("sac")
    reached = [
        planner.plan(problem).probability_efficiency(problem)
        for problem in (scenario.problem(stated["seed"], i) for i in range(check["maps"]))
    ]
    assert np.mean(reached) == pytest.approx(check["e_p_mean"], rel=5e-3)
    error = stated["e_p_std"] / np.sqrt(check["maps"])
    assert abs(np.mean(reached) - stated["e_p_mean"]) < 4.0 * error
