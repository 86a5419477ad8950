"""What search teaches: views as the policy sees them, turns that see more."""

import dataclasses

import numpy as np
import pytest
import torch

from wisar_planner import SearchProblem
from wisar_planner.policy.heading import DIRECTED, wrapped
from wisar_planner.policy.model import find_model, load_model
from wisar_planner.policy.observation import Observation
from wisar_planner.policy.rollout import Terrain, fly
from wisar_planner.search.area import SearchArea
from wisar_planner.search.path import SearchPath
from wisar_planner.training.expert_iteration.config import ExpertConfig
from wisar_planner.training.expert_iteration.labels import (
    Labels,
    _along,
    _best_try,
    _unseen_after,
    lesson,
)
from wisar_planner.training.networks import likeliest_turn
from wisar_planner.training.worlds import WorldDistribution

MIXED = WorldDistribution(
    paper_share=0.5, sides=(10.0, 20.0), radii=(0.3, 0.6), budgets=(20, 40), field_share=0.5
)
CONFIG = ExpertConfig(flights=8, remembered_flights=8, tries=4, moves=200, worlds=MIXED)


@pytest.fixture(scope="module")
def model():
    return load_model(find_model("sac"))


@pytest.fixture(scope="module")
def taught(model):
    return lesson(CONFIG, model, (4, 4), (3, 0))


@pytest.mark.parametrize("flown", [0, 1, 20])
@pytest.mark.parametrize("swath_radius", [2.5, 4.5])
def test_along_its_own_path_a_policy_is_shown_what_it_saw(model, flown, swath_radius) -> None:
    """From the views its network says the very turns that it flew, as no border is near."""
    inner = SearchProblem.paper(np.random.default_rng(7), start=(75.0, 75.0))
    problem = dataclasses.replace(
        inner,
        area=SearchArea.rectangle(-600.0, -600.0, 750.0, 750.0),
        swath_radius=swath_radius,
    )
    terrain = Terrain.of(problem)
    path = fly(problem, terrain, model)[0]
    labels = _along(terrain, path[: flown + 1], path[flown:])
    weights = {name: torch.tensor(value) for name, value in model.weights.items()}
    shown = Observation(torch.tensor(labels.view).float(), torch.tensor(labels.numbers))
    said = likeliest_turn(weights, DIRECTED, shown).numpy()
    assert len(said) == problem.steps - flown
    # Views are kept in half precision, and where two ways are as good, that may decide.
    agree = np.abs(wrapped(said - labels.turn)) < 2e-3
    assert agree.mean() > 0.95


def test_search_sees_more_than_the_policy(taught) -> None:
    assert taught.found > 1.01 * taught.seen > 0.0


@pytest.mark.parametrize("flown", [0, 30])
def test_the_best_of_some_ways_on_is_begun_with(flown) -> None:
    """By the exact seen probability; of a policy that random turns make better now and then."""
    model = load_model(find_model("sac_plain"))
    better = []
    for seed in range(6):
        problem = SearchProblem.paper(np.random.default_rng(seed))
        terrain = Terrain.of(problem)
        path = fly(problem, terrain, model)[0]
        before, rest = path[: flown + 1], path[flown:]
        raster = _unseen_after(problem, before)
        arguments = (raster, raster.to_cells(rest), 12, np.random.default_rng(4))
        best = raster.to_metres(_best_try(problem, terrain, model, before, *arguments))
        rng = np.random.default_rng(4)
        ways = fly(problem, terrain, model, flown=before, count=12, rng=rng)[:, flown:]
        found, own, *others = (
            SearchPath(np.concatenate([before, way[1:]]), 2.5).seen_probability(problem.pdm)
            for way in (best, rest, *ways)
        )
        # The raster may take one for the best that is so by a hair.
        assert found == pytest.approx(max(own, *others), rel=2e-3)
        better.append(found / own - 1.0)
    assert np.mean(better) > 0.005


def test_labels_are_finite_turns_of_whole_flights(taught) -> None:
    view, numbers, turn = taught.labels
    assert len(view) == len(numbers) == len(turn) > 8 * 8
    assert np.isfinite(view).all()
    assert np.isfinite(numbers).all()
    assert (np.abs(turn) <= 1.0).all()
    assert np.ptp(turn) > 0.2


def test_the_same_seed_gives_the_same_lesson_and_another_another(model, taught) -> None:
    again, other = (lesson(CONFIG, model, (4, 4), seed) for seed in ((3, 0), (3, 1)))
    for name in Labels._fields:
        np.testing.assert_array_equal(getattr(taught.labels, name), getattr(again.labels, name))
    assert again.found == taught.found
    assert other.found != taught.found


def test_a_lesson_without_flights_is_empty(model) -> None:
    labels, seen, found = lesson(CONFIG, model, (0, 0), (1,))
    assert (len(labels.turn), seen, found) == (0, 0.0, 0.0)


def test_what_search_is_said_to_find_is_what_its_path_sees(model, monkeypatch) -> None:
    """From the first step on in the paper's setup, by the exact seen probability of both paths."""
    from wisar_planner.training.expert_iteration import labels as module

    flights = []

    def spy(terrain, flown, rest):
        flights.append((terrain, flown, rest))
        return _along(terrain, flown, rest)

    monkeypatch.setattr(module, "_along", spy)
    monkeypatch.setattr(module, "_FEWEST_STEPS", 64)
    problems = []
    real = module.random_problems

    def kept(*arguments):
        for problem in real(*arguments):
            problems.append(problem)
            yield problem

    monkeypatch.setattr(module, "random_problems", kept)
    paper = dataclasses.replace(CONFIG, worlds=WorldDistribution())
    told = lesson(paper, model, (2, 0), (5,))
    exact = sum(
        SearchPath(rest, problem.swath_radius, "sac").seen_probability(problem.pdm) / terrain.unit
        for problem, (terrain, _, rest) in zip(problems, flights, strict=True)
    )
    # Annealing finds the places where a raster's cells count for a little more.
    assert told.found == pytest.approx(exact, rel=0.008)
