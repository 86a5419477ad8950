"""What searches showed and gained while a policy flew them with random turns."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator
from typing import NamedTuple

import torch
from torch import Tensor

from wisar_planner.policy.network import forward
from wisar_planner.policy.observation import Observation
from wisar_planner.training.environment import SearchEnvironment
from wisar_planner.training.networks import Networks, mirrored, state_value
from wisar_planner.training.ppo.config import PpoConfig
from wisar_planner.training.ppo.turns import log_likelihood, random_turns
from wisar_planner.training.returns import trace_returns


class Experience(NamedTuple):
    """n states and what came of them.

    Attributes
    ----------
    view, numbers
        See `Observation`; the view in half precision.
    direction, deviation
        See `Turns`.
    log_likelihood : (n,)
        Logarithm of the turns' likelihood when they were drawn.
    advantage : (n,)
        What was gained beyond the value of the state; mean 0 and standard deviation 1 over the
        searches that were flown together.
    returns : (n,)
        What was gained, and how much it differed from the value.
    surprise : (n,)
        The difference of the two, in steps over the most probable ground.
    """

    view: Tensor
    numbers: Tensor
    direction: Tensor
    deviation: Tensor
    log_likelihood: Tensor
    advantage: Tensor
    returns: Tensor
    surprise: Tensor

    def batches(self, size: int, generator: torch.Generator) -> Iterator[Experience]:
        """Yield each state once, in random order, views in full precision."""
        order = torch.randperm(len(self.view), generator=generator, device=generator.device)
        for first in range(0, len(order), size):
            some = order[first : first + size]
            found = Experience(*(each[some] for each in self))
            yield found._replace(view=found.view.float())


def make_environments(config: PpoConfig, generator: torch.Generator) -> list[SearchEnvironment]:
    """Return the searches of the paper's setup and the others, in an environment each.

    Apart, those of the paper's setup need smaller rasters, and advantages, which vary more in the
    other worlds, are measured by their own kind.
    """
    paper = round(config.worlds.paper_share * config.environments)
    parts = ((paper, 1.0), (config.environments - paper, 0.0))
    return [
        SearchEnvironment(
            count, dataclasses.replace(config.worlds, paper_share=share), generator, stagger=True
        )
        for count, share in parts
        if count
    ]


@torch.no_grad()
def fly_window(
    config: PpoConfig,
    environment: SearchEnvironment,
    actor: Networks,
    value: Networks,
    noise: float,
    generator: torch.Generator,
) -> Experience:
    """Fly searches on for a window, half of the turns as if in the mirror image of the world.

    Parameters
    ----------
    config : PpoConfig
        The configuration.
    environment : SearchEnvironment
        The searches.
    actor, value : networks
        The policy, and what it is expected to gain.
    noise : float
        See `random_turns`.
    generator : torch.Generator
        Source of randomness.
    """
    states, turns, likelihoods, rewards, dones, values = [], [], [], [], [], []
    for _ in range(config.window):
        shown = environment.observe()
        flip = torch.rand(len(shown.view), generator=generator, device=generator.device) < 0.5
        # In half precision at once, so that the policy sees the same now and when it learns.
        view = mirrored(shown.view, shown.numbers, flip)[0].half()
        shown = Observation(view.float(), shown.numbers)
        output = forward(actor, *shown)[0]
        drawn = random_turns(output, noise, generator)
        turns.append(drawn)
        likelihoods.append(log_likelihood(output, drawn, noise)[0])
        values.append(state_value(value, shown))
        states.append(Observation(view, shown.numbers))
        reward, done = environment.step(torch.where(flip, -1.0, 1.0) * drawn.turn())
        rewards.append(reward)
        dones.append(done)
    values.append(state_value(value, environment.observe()))
    expected = torch.stack(values)
    returns = trace_returns(torch.stack(rewards), torch.stack(dones), expected, config.trace)
    surprise = (returns - expected[:-1]).flatten()
    advantage = surprise - surprise.mean()
    advantage = advantage / advantage.square().mean().sqrt().clamp(min=1e-6)
    view, numbers = (torch.cat(each) for each in zip(*states, strict=True))
    direction, deviation = (torch.cat(each) for each in zip(*turns, strict=True))
    return Experience(
        view, numbers, direction, deviation, torch.cat(likelihoods), advantage, returns.flatten(),
        surprise,
    )  # fmt: skip
