import itertools
import math
import time

import numpy as np
import pytest
import shapely
from scipy import stats

from wisar_planner import GaussianMixture, SearchArea, SearchPath, SearchProblem, make_planner
from wisar_planner.planners import sac_search
from wisar_planner.planners.monitor import Monitor
from wisar_planner.planners.sac import trained_policy
from wisar_planner.policy.rollout import Terrain


def check(problem, path):
    assert path.planner == "sac_search"
    np.testing.assert_array_equal(path.waypoints[0], problem.start)
    assert problem.area.contains(path.waypoints).all()
    flown = shapely.LineString(path.waypoints) if len(path.waypoints) > 1 else problem.area.polygon
    assert problem.area.polygon.buffer(1e-6).covers(flown)
    assert path.length <= problem.max_distance * (1.0 + 1e-9)


def test_is_better_than_the_policy_alone(paper_problem):
    """Never much worse, as it compares on a raster; on 24 maps better by far more than chance.

    By ranks: the policy is bad on few maps, and much is gained there.
    """
    searched, alone = [], []
    planner = make_planner("sac_search", max_iterations=20_000, early_weight=0.0)
    for problem in map(paper_problem, range(20, 44)):
        path = planner.plan(problem)
        check(problem, path)
        searched.append(path.probability_efficiency(problem))
        alone.append(make_planner("sac").plan(problem).probability_efficiency(problem))
    assert (np.array(searched) >= 0.995 * np.array(alone)).all()
    assert stats.wilcoxon(searched, alone, alternative="greater").pvalue < 1e-3


def test_other_ways_begin_as_the_path_and_stay_in_the_area(paper_problem):
    problem = paper_problem(45)
    path = make_planner("greedy").plan(problem).waypoints
    monitor = Monitor(problem, math.inf, 1000, None, None)
    rng = np.random.default_rng(5)
    ways_on = sac_search._ways_on(
        problem, Terrain.of(problem), trained_policy("sac"), rng, monitor
    )  # fmt: skip
    left_at = set()
    for _ in range(8):
        ways = np.array(ways_on(path))
        assert ways.shape == (16, problem.steps + 1, 2)
        same = (ways == path).all(axis=(0, 2))
        left = int(same.argmin())
        left_at.add(left)
        assert same[:left].all()
        assert len(np.unique(ways[:, -1], axis=0)) == 16
        for way in ways:
            check(problem, SearchPath(way, problem.swath_radius, "sac_search"))
            steps = np.hypot(*np.diff(way, axis=0).T)
            np.testing.assert_allclose(steps, problem.step_length, rtol=1e-6)
    assert len(left_at) > 4
    monitor.count(1000)
    assert ways_on(path) == []


def test_more_iterations_are_better_on_average(paper_problem):
    """On maps enough to tell: on 24, 100,000 are better than 50 by four standard errors."""
    few, many = (
        np.mean(
            [
                make_planner("sac_search", max_iterations=n).plan(p).probability_efficiency(p)
                for p in map(paper_problem, range(40, 64))
            ]
        )
        for n in (50, 100_000)
    )
    assert many > 1.002 * few


def test_iterations_make_it_repeatable_and_seeds_differ(paper_problem):
    first, again, other = (
        make_planner("sac_search", max_iterations=1000, seed=seed).plan(paper_problem(32)).waypoints
        for seed in (1, 1, 2)
    )
    np.testing.assert_array_equal(first, again)
    assert (first != other).any()


def test_keeps_to_its_time(paper_problem):
    problem = paper_problem(33)
    planner = make_planner("sac_search", time_budget_s=0.8)
    planner.plan(problem)  # compile
    began = time.monotonic()
    check(problem, planner.plan(problem))
    assert 0.6 < time.monotonic() - began < 6.0


@pytest.mark.parametrize("after", [0, 1, 20])
def test_stops_when_told_with_a_whole_path(paper_problem, after):
    problem, asked = paper_problem(34), itertools.count(1)
    planner = make_planner("sac_search", time_budget_s=600.0)
    path = planner.plan(problem, should_stop=lambda: next(asked) > after)
    check(problem, path)
    assert len(path.waypoints) == problem.steps + 1
    assert next(asked) < after + 200


@pytest.fixture
def flown(monkeypatch):
    """The steps of each flight of the policy, in turn."""
    steps, fly = [], sac_search.fly

    def counted(*arguments, **options):
        paths = fly(*arguments, **options)
        steps.append(paths.shape[1] - 1)
        return paths

    monkeypatch.setattr(sac_search, "fly", counted)
    return steps


def test_the_first_flight_ends_when_told(paper_problem, flown):
    problem, asked = paper_problem(36), itertools.count(1)
    planner = make_planner("sac_search", max_iterations=1000)
    path = planner.plan(problem, should_stop=lambda: next(asked) > 10)
    assert flown == [11]
    check(problem, path)
    assert len(path.waypoints) == problem.steps + 1


@pytest.mark.parametrize(("patience_s", "steps"), [(-1.0, 33), (1e9, 64)])
def test_a_flight_that_takes_half_the_time_left_is_given_up(
    paper_problem, flown, monkeypatch, patience_s, steps
):
    """By a clock that goes on by 1/64 of the time whenever it is read; it is once before."""
    problem, read = paper_problem(37), itertools.count(1)
    monkeypatch.setattr(Monitor, "spent", lambda self: next(read) / 64)
    monkeypatch.setattr(sac_search, "_PATIENCE_S", patience_s)
    path = make_planner("sac_search", time_budget_s=0.01).plan(problem)
    assert flown[0] == steps
    check(problem, path)
    assert len(path.waypoints) == problem.steps + 1


def test_progress_never_falls(paper_problem):
    problem, told = paper_problem(35), []
    path = make_planner("sac_search", max_iterations=2000).plan(problem, on_progress=told.append)
    for values in ([p.efficiency for p in told], [p.fraction for p in told]):
        assert values == sorted(values)
    assert told[-1].efficiency == pytest.approx(path.probability_efficiency(problem), rel=0.03)


def test_plans_where_the_policy_finds_no_step():
    problem = SearchProblem(
        pdm=GaussianMixture(np.ones(1), np.array([[1.0, 2.0]]), 4.0 * np.eye(2)[None]),
        area=SearchArea.rectangle(0.0, 0.0, 5.0, 5.0),
        start=np.array([1.0, 1.0]),
        step_length=8.0,
        swath_radius=0.5,
        max_distance=64.0,
    )
    path = make_planner("sac_search", max_iterations=100).plan(problem)
    check(problem, path)
    assert path.length > 8.0


def test_plans_around_a_hole(holed_problem):
    path = make_planner("sac_search", max_iterations=500).plan(holed_problem)
    check(holed_problem, path)
    assert path.length > 0.9 * holed_problem.max_distance


def test_plans_on_a_raster_map(far_modes):
    path = make_planner("sac_search", max_iterations=1000).plan(far_modes)
    check(far_modes, path)
    assert path.probability_efficiency(far_modes) > 0.25
