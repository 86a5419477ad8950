"""Search problems of random worlds, and flights there."""

import dataclasses

import numpy as np
import pytest
import torch

from wisar_planner.planners.registry import make_planner
from wisar_planner.policy.model import find_model, load_model
from wisar_planner.search.bound import upper_bound
from wisar_planner.training.judging import fly_problem
from wisar_planner.training.problems import random_problems
from wisar_planner.training.worlds import random_worlds


def test_problems_are_their_worlds(distribution) -> None:
    """Density, area, start, step, swath and budget, of either kind of worlds."""
    paper = round(distribution.paper_share * 6)
    problems = list(random_problems(6, distribution, torch.Generator().manual_seed(5)))
    generator = torch.Generator().manual_seed(5)
    k = 0
    for share, count in ((1.0, paper), (0.0, 6 - paper)):
        if not count:
            continue
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
    """By the exact seen probability of the same path and the exact bound."""
    model = load_model(find_model("sac"))
    for problem in random_problems(3, distribution, torch.Generator().manual_seed(2)):
        efficiency, share = fly_problem(problem, model)
        path = make_planner("sac").plan(problem)
        exact = path.seen_probability(problem.pdm) / problem.probability_in_area
        assert efficiency == pytest.approx(exact, rel=0.03)
        assert share == pytest.approx(exact / upper_bound(problem), rel=0.03)
        assert share <= 1.0
