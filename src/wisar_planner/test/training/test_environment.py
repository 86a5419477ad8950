import math

import numpy as np
import pytest
import shapely
import torch

from wisar_planner import GaussianMixture, SearchPath
from wisar_planner.training.divergence import Diverged
from wisar_planner.training.environment import SearchEnvironment
from wisar_planner.training.worlds import WorldDistribution


def random_turns(count, generator):
    return 2.0 * torch.rand(count, generator=generator) - 1.0


def test_searches_stay_in_their_area(distribution, generator):
    environment = SearchEnvironment(32, distribution, generator)
    for _ in range(12):
        before, heading = environment.position.clone(), environment.heading.clone()
        left, step = environment.steps_left.clone(), environment.unseen.step.clone()
        low, high = environment.low.clone(), environment.high.clone()
        action = random_turns(32, generator)
        reward, done = environment.step(action)
        assert torch.isfinite(reward).all()
        assert (reward >= 0.0).all()
        flying, now = ~done, environment.position
        assert ((now >= low) & (now <= high))[flying].all()
        flown = torch.linalg.vector_norm(now - before, dim=1)
        torch.testing.assert_close(flown[flying], step[flying], rtol=1e-4, atol=1e-3)
        torch.testing.assert_close(environment.steps_left[flying], left[flying] - 1.0)
        # Where the wanted heading stays inside, it is flown.
        wanted = heading + math.pi * action
        end = before + step[:, None] * torch.stack([wanted.cos(), wanted.sin()], dim=1)
        free = flying & ((end >= low) & (end <= high)).all(dim=1)
        torch.testing.assert_close(now[free], end[free])
    assert (
        (environment.position >= environment.low) & (environment.position <= environment.high)
    ).all()


def test_some_heading_stays_inside_the_smallest_area(generator):
    distribution = WorldDistribution(paper_share=0.0, sides=(2.0, 2.0), radii=(0.05, 1.0))
    environment = SearchEnvironment(64, distribution, generator)
    for _ in range(30):
        environment.step(random_turns(64, generator))
        now = environment.position
        assert ((now >= environment.low) & (now <= environment.high)).all()


@pytest.mark.parametrize("turn", [math.nan, math.inf])
def test_a_turn_that_is_no_number_is_refused(generator, turn):
    environment = SearchEnvironment(3, WorldDistribution(), generator)
    before = {name: each.clone() for name, each in environment.tensors().items()}
    with pytest.raises(Diverged, match="lower its learning rates"):
        environment.step(torch.tensor([0.1, turn, 0.2]))
    for name, each in environment.tensors().items():
        torch.testing.assert_close(each, before[name], rtol=0.0, atol=0.0, equal_nan=True)


def test_searches_end_when_their_budget_is_flown_and_start_anew(generator):
    distribution = WorldDistribution(paper_share=0.0, budgets=(2, 6), sides=(6.0, 9.0))
    environment = SearchEnvironment(16, distribution, generator)
    flown, budget = torch.zeros(16), environment.steps.clone()
    assert 2 <= budget.min() < budget.max() <= 6
    ended = 0
    for _ in range(15):
        _, done = environment.step(random_turns(16, generator))
        flown += 1.0
        torch.testing.assert_close(done, flown == budget)
        ended += int(done.sum())
        flown[done], budget[done] = 0.0, environment.steps[done]
        torch.testing.assert_close(environment.steps_left, budget - flown)
    assert ended > 32


def test_a_staggered_start_has_part_of_the_budget_flown(generator):
    environment = SearchEnvironment(64, WorldDistribution(), generator, stagger=True)
    assert (environment.steps == 64.0).all()
    assert environment.steps_left.min() >= 1.0
    assert environment.steps_left.max() <= 64.0
    assert environment.steps_left.std() > 10.0


@pytest.fixture
def paper_world(generator, mixtures):
    """An environment of 4 paper worlds, and their maps."""
    environment = SearchEnvironment(4, WorldDistribution(), generator)
    weights, means, deviations, _ = mixtures[0]
    maps = [
        GaussianMixture(w / w.sum(), m, d[:, :, None] ** 2 * np.eye(2))
        for w, m, d in zip(weights, means, deviations, strict=True)
    ]
    return environment, maps


def test_mass_in_the_area_is_that_of_the_mixture(paper_world):
    environment, maps = paper_world
    # The unit is unknown here, but the same for the whole raster of a search.
    centre = environment.position.floor() + 0.5
    unseen = environment.unseen.levels[0].clamp(min=0.0)
    for i, pdm in enumerate(maps):
        low, high = environment.low[i].numpy(), environment.high[i].numpy()
        x, y = (int(each) for each in low + np.where(centre[i].numpy() < 75.0, 100.0, 30.0))
        unit = float(unseen[i, y, x]) / float(pdm.density(np.array([[x + 0.5, y + 0.5]]))[0])
        in_area = pdm.integrate(shapely.box(*low, *high))
        assert float(environment.in_area[i]) / unit == pytest.approx(in_area, rel=1e-3)


def test_what_a_search_sees_is_the_exact_efficiency(paper_world, generator):
    environment, maps = paper_world
    points, rewards = [environment.position.clone()], []
    in_area, seen = environment.in_area.clone(), environment.seen.clone()
    swept = 2.0 * environment.unseen.radius * environment.unseen.step
    for _ in range(40):
        reward, done = environment.step(0.15 * random_turns(4, generator))
        assert not done.any()
        points.append(environment.position.clone())
        rewards.append(reward)
    share = (seen + swept * torch.stack(rewards).sum(dim=0)) / in_area
    torch.testing.assert_close(environment.seen / in_area, share, rtol=1e-4, atol=1e-5)
    paths = torch.stack(points, dim=1).double().numpy()
    for i, (pdm, path) in enumerate(zip(maps, paths, strict=True)):
        area = shapely.box(*environment.low[i].numpy(), *environment.high[i].numpy())
        exact = SearchPath(path, 2.5).seen_probability(pdm) / pdm.integrate(area)
        assert float(share[i]) == pytest.approx(exact, rel=0.01)


def test_no_reward_beats_the_most_probable_ground(generator):
    """The unit of reward: the mean over a search is at most 1, the disc at its start aside."""
    environment = SearchEnvironment(16, WorldDistribution(), generator)
    total = torch.zeros(16)
    for _ in range(64):
        gains = environment.observe().view[:, :, -1]
        action = gains.argmax(dim=1) / 16.0
        reward, done = environment.step(torch.where(action > 1.0, action - 2.0, action))
        total += reward
    assert done.all()
    assert (total < 64.0).all()
    assert total.mean() > 20.0


def test_state_that_is_written_back_goes_on_the_same(distribution):
    first = SearchEnvironment(8, distribution, torch.Generator().manual_seed(1))
    second = SearchEnvironment(8, distribution, torch.Generator().manual_seed(2))
    turns = torch.Generator().manual_seed(3)
    first.step(random_turns(8, turns))
    for name, tensor in second.tensors().items():
        tensor.copy_(first.tensors()[name])
    second.generator.set_state(first.generator.get_state())
    for _ in range(5):
        action = random_turns(8, turns)
        for ours, theirs in zip(first.step(action), second.step(action), strict=True):
            torch.testing.assert_close(ours, theirs, rtol=0.0, atol=0.0)
    for ours, theirs in zip(first.observe(), second.observe(), strict=True):
        torch.testing.assert_close(ours, theirs, rtol=0.0, atol=0.0)
