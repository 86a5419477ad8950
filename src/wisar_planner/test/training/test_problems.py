"""Search problems of random worlds, and flights there."""

import dataclasses

import numpy as np
import pytest
import torch

from wisar_planner.planners.registry import make_planner
from wisar_planner.policy.model import find_model, load_model
from wisar_planner.search.bound import upper_bound
from wisar_planner.training import worlds as module
from wisar_planner.training.environment import SearchEnvironment
from wisar_planner.training.judging import fly_problem
from wisar_planner.training.problems import random_problems
from wisar_planner.training.worlds import WorldDistribution, random_worlds


def test_problems_are_their_worlds(distribution) -> None:
    """Density, area, start, step, swath and budget, of either kind of worlds."""
    problems = list(random_problems(2, 4, distribution, torch.Generator().manual_seed(5)))
    generator = torch.Generator().manual_seed(5)
    k = 0
    for share, count in ((1.0, 2), (0.0, 4)):
        kind = dataclasses.replace(distribution, paper_share=share)
        worlds = random_worlds(count, kind, generator)
        for i in range(count):
            problem = problems[k]
            k += 1
            low, high, start = (
                each[i].numpy().astype(float) for each in (worlds.low, worlds.high, worlds.start)
            )
            assert problem.area.bounds == pytest.approx((*low, *high))
            np.testing.assert_allclose(problem.start, start, atol=1e-4)
            assert problem.step_length == pytest.approx(float(worlds.step[i]))
            assert problem.swath_radius == pytest.approx(float(worlds.radius[i]))
            assert problem.steps == int(worlds.steps[i])
            density = worlds.density[i].numpy()
            cells = np.stack(np.nonzero(density > 0.0)[::-1], axis=1)
            expected = density[density > 0.0] / density[density > 0.0].sum(dtype=float)
            np.testing.assert_allclose(problem.pdm.density(cells + 0.5), expected, rtol=1e-5)
    assert k == len(problems)


def test_a_flight_is_judged_as_the_planner_is(distribution) -> None:
    """By the exact seen probability of the same path, and the bound."""
    model = load_model(find_model("sac"))
    for problem in random_problems(1, 2, distribution, torch.Generator().manual_seed(2)):
        efficiency, share = fly_problem(problem, model)
        path = make_planner("sac").plan(problem)
        exact = path.seen_probability(problem.pdm) / problem.probability_in_area
        assert efficiency == pytest.approx(exact, rel=1e-9)
        assert share == pytest.approx(exact / upper_bound(problem), rel=1e-9)
        assert share <= 1.0


@pytest.mark.parametrize("at_once", [16, 4096])
def test_maps_of_the_papers_setup_are_those_of_an_environment(monkeypatch, at_once) -> None:
    """So that policies of all runs are judged on the same; however many are drawn at once."""
    monkeypatch.setattr(module, "_AT_ONCE", at_once)
    environment = SearchEnvironment(40, WorldDistribution(), torch.Generator().manual_seed(8))
    problems = list(random_problems(40, 0, WorldDistribution(), torch.Generator().manual_seed(8)))
    starts = np.array([problem.start for problem in problems])
    np.testing.assert_allclose(starts, environment.position.numpy(), atol=1e-4)
    assert [len(part) for part in module.parts(40)] == ([16, 16, 8] if at_once == 16 else [40])
