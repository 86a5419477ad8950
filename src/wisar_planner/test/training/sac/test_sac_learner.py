import dataclasses
import math

import numpy as np
import pytest
import torch
from torch.distributions import Normal, TanhTransform, TransformedDistribution

from wisar_planner.policy.heading import value_at
from wisar_planner.policy.network import forward
from wisar_planner.policy.observation import DIRECTIONS, NUMBERS, VIEW_WIDTH, Observation
from wisar_planner.training.sac.learner import Sac, SacSettings
from wisar_planner.training.sac.replay import Batch

TINY = SacSettings(channels=8, blocks=1)


def learner(**settings):
    settings = dataclasses.replace(TINY, **settings)
    return Sac(settings, np.random.default_rng(1), torch.device("cpu"))


def observation(size, generator):
    view = torch.rand(size, DIRECTIONS, VIEW_WIDTH, generator=generator)
    return Observation(view, torch.rand(size, NUMBERS, generator=generator))


def transitions(size, generator, *, discount):
    return Batch(
        now=observation(size, generator),
        action=2.0 * torch.rand(size, generator=generator) - 1.0,
        reward=torch.rand(size, generator=generator),
        later=observation(size, generator),
        discount=torch.full((size,), discount),
    )


@pytest.mark.parametrize(("wanted", "grows"), [(0.6, True), (-4.0, False)])
def test_temperature_steers_the_entropy(generator, wanted, grows):
    sac = learner()
    batch = transitions(16, generator, discount=0.9)
    found = [sac.update(batch, wanted, 1.0, generator) for _ in range(3)]
    assert all((wanted > figures["entropy"]) == grows for figures in found)
    temperatures = [float(figures["temperature"]) for figures in found]
    assert temperatures == sorted(temperatures, reverse=not grows)
    assert temperatures[0] != temperatures[-1]


def test_temperature_has_a_floor(generator):
    sac = learner(temperature_rate=5.0, least_temperature=0.01)
    batch = transitions(16, generator, discount=0.9)
    for _ in range(3):
        temperature = sac.update(batch, -9.0, 1.0, generator)["temperature"]
    assert float(temperature) == pytest.approx(0.01)
    assert sac.log_temperature.item() == pytest.approx(math.log(0.01))


def test_the_target_of_a_terminal_transition_is_the_reward_alone(generator):
    batch = transitions(16, generator, discount=0.0)
    sac = learner()
    with torch.no_grad():
        values = forward(sac.critics, *batch.now)[:, 0]
        taken = value_at(values, batch.action[None, :, None].expand(2, -1, -1))[..., 0]
        expected = 0.5 * (taken - batch.reward).square().sum(dim=0).mean()
    found = sac.update(batch, -1.0, 1.0, generator)["critic_loss"]
    torch.testing.assert_close(found, expected)
    on = batch._replace(discount=torch.ones(16))
    assert abs(float(learner().update(on, -1.0, 1.0, generator)["critic_loss"] - expected)) > 1e-4


def test_the_target_of_others_adds_the_soft_value_of_the_lesser_critic(generator):
    """With a policy that hardly varies, against the value at its most likely turn."""
    sac = learner()
    with torch.no_grad():
        sac.actor["output_bias"][0, 1] = -20.0  # standard deviation exp(-5)
    batch = transitions(16, generator, discount=0.5)
    with torch.no_grad():
        turn = sac.act(batch.later, None)
        values = value_at(
            forward(sac.targets, *batch.later)[:, 0], turn[None, :, None].expand(2, -1, -1)
        )[..., 0]
        log_std = -5.0
        squash = torch.log1p(-turn.square())
        log_probability = -0.5 - log_std - 0.5 * math.log(2.0 * math.pi) - squash
        target = batch.reward + 0.5 * (values.amin(dim=0) - 0.02 * log_probability)
        now = value_at(
            forward(sac.critics, *batch.now)[:, 0],
            batch.action[None, :, None].expand(2, -1, -1),
        )[..., 0]
        expected = 0.5 * (now - target).square().sum(dim=0).mean()
    found = sac.update(batch, -1.0, 1.0, generator)["critic_loss"]
    assert float(found) == pytest.approx(float(expected), rel=0.02)


def test_log_probabilities_are_those_of_a_squashed_normal(generator):
    sac = learner()
    shown = observation(32, generator)
    action, log_probability = sac._sample(shown, generator)
    mean, log_std = sac._policy(shown)
    squashed = TransformedDistribution(Normal(mean, log_std.exp()), TanhTransform())
    torch.testing.assert_close(log_probability, squashed.log_prob(action.T).T, rtol=1e-3, atol=1e-3)
    assert action.shape == (32, TINY.action_samples)


def test_targets_follow_the_critics_slowly(generator):
    sac = learner(tau=0.25, critic_rate=0.01)
    before = sac.targets["output"].clone()
    sac.update(transitions(16, generator, discount=0.9), -1.0, 1.0, generator)
    expected = before + 0.25 * (sac.critics["output"].detach() - before)
    torch.testing.assert_close(sac.targets["output"], expected)
    assert (sac.critics["output"] != before).any()


def test_a_rate_of_nothing_learns_nothing(generator):
    sac, untouched = learner(), learner()
    sac.update(transitions(16, generator, discount=0.9), -1.0, 0.0, generator)
    for name, value in untouched.actor.items():
        torch.testing.assert_close(sac.actor[name], value, rtol=0.0, atol=0.0)
    assert sac.log_temperature == untouched.log_temperature


def test_acting_is_random_with_a_generator_and_the_same_without(generator):
    sac, shown = learner(), observation(8, generator)
    likely = sac.act(shown, None)
    torch.testing.assert_close(likely, sac.act(shown, None), rtol=0.0, atol=0.0)
    first, second = (sac.act(shown, generator) for _ in range(2))
    assert (first != second).all()
    for action in (likely, first, second):
        assert action.shape == (8,)
        assert (action.abs() <= 1.0).all()


def test_it_learns_to_turn_to_the_wanted_direction(generator):
    """One-step searches whose reward is how near the turn is to one of two marked directions.

    With one alone, symmetry would point the untrained network there.
    """
    sac = learner(critic_rate=0.01, actor_rate=0.005)

    def shown(size):
        wanted, other = torch.randint(DIRECTIONS, (2, size), generator=generator)
        view = torch.zeros(size, DIRECTIONS, VIEW_WIDTH)
        view[torch.arange(size), wanted, 0] = 1.0
        view[torch.arange(size), other, 1] = 1.0
        return Observation(view, torch.zeros(size, NUMBERS)), wanted * 2.0 / DIRECTIONS

    def worth(action, wanted):
        return torch.cos(math.pi * (action - wanted))

    test, wanted = shown(200)
    assert float(worth(sac.act(test, None), wanted).mean()) < 0.7
    for _ in range(200):
        now, goal = shown(64)
        action = 2.0 * torch.rand(64, generator=generator) - 1.0
        batch = Batch(now, action, worth(action, goal), now, torch.zeros(64))
        sac.update(batch, -1.0, 1.0, generator)
    assert float(worth(sac.act(test, None), wanted).mean()) > 0.9
