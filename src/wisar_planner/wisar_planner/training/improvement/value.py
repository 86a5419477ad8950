"""What a policy will gain from a state on, learned from its flights."""

from __future__ import annotations

from collections.abc import Callable

import torch

from wisar_planner.policy.observation import Observation
from wisar_planner.training.environment import SearchEnvironment
from wisar_planner.training.improvement.config import ImprovementConfig
from wisar_planner.training.networks import (
    Networks,
    Policy,
    learn,
    optimizer_of,
    state_value,
)
from wisar_planner.training.returns import trace_returns

# Steps of each search between updates.
_WINDOW = 16


def learn_value(
    config: ImprovementConfig,
    policy: Policy,
    value: Networks,
    generator: torch.Generator,
    on_steps: Callable[[int], None],
) -> float:
    """Fly a policy and let the value learn from the returns of TD(lambda).

    Parameters
    ----------
    config : ImprovementConfig
        The configuration.
    policy : callable
        The policy.
    value : networks
        Learns in place.
    generator : torch.Generator
        Source of randomness.
    on_steps : callable
        Told how many steps were flown.

    Returns
    -------
    float
        Root mean square of the last differences between returns and values, in steps over the
        most probable ground.
    """
    environment = SearchEnvironment(config.environments, config.worlds, generator, stagger=True)
    optimizer = optimizer_of(value, config.value_rate)
    windows = max(1, config.valued_steps // (config.environments * _WINDOW))
    shown, error = environment.observe(), 0.0
    for window in range(windows):
        with torch.no_grad():
            states, rewards, dones = [], [], []
            for _ in range(_WINDOW):
                states.append(shown)
                reward, done = environment.step(policy(shown))
                rewards.append(reward)
                dones.append(done)
                shown = environment.observe()
            values = torch.stack([state_value(value, each) for each in [*states, shown]])
            returns = trace_returns(
                torch.stack(rewards), torch.stack(dones), values, config.trace
            ).flatten()
            error = float((returns - values[:-1].flatten()).square().mean().sqrt())
            view, numbers = (torch.cat(each) for each in zip(*states, strict=True))
        order = torch.randperm(len(returns), generator=generator, device=generator.device)
        for first in range(0, len(order), config.batch):
            some = order[first : first + config.batch]
            predicted = state_value(value, Observation(view[some], numbers[some]))
            loss = (predicted - returns[some]).square().mean()
            learn(optimizer, loss, config.value_rate, window / windows)
        on_steps(config.environments * _WINDOW)
    return error
