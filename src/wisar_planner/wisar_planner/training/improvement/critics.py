"""Which turns are better than others, learned from branches."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import torch
from torch import Tensor

from wisar_planner.policy.heading import value_at
from wisar_planner.policy.network import forward
from wisar_planner.training.improvement.branches import Labels
from wisar_planner.training.improvement.config import ImprovementConfig
from wisar_planner.training.networks import (
    Networks,
    learn,
    make_networks,
    optimizer_of,
)


def learn_critics(
    config: ImprovementConfig,
    labels: Labels,
    rng: np.random.Generator,
    generator: torch.Generator,
    on_update: Callable[[], None],
) -> tuple[Networks, float]:
    """Return critics of the branches' turns, and the share of the variance that they leave.

    The critics learn differences between the branches of a state: what these have in common says
    nothing about the turn.

    Parameters
    ----------
    config : ImprovementConfig
        The configuration.
    labels : Labels
        The branches.
    rng : numpy.random.Generator
        Source of the critics' first parameters.
    generator : torch.Generator
        Source of the batches.
    on_update : callable
        Told after each update.
    """
    critics = make_networks(
        rng,
        networks=config.critics,
        channels=config.channels,
        blocks=config.blocks,
        device=generator.device,
    )
    optimizer = optimizer_of(critics, config.critic_rate)
    left, there = 0.0, 0.0
    for update in range(config.critic_updates):
        batch = labels.sample(config.batch, generator)
        values = forward(critics, batch.view, batch.numbers)[:, 0]
        valued = value_at(values, batch.turns.expand(config.critics, -1, -1))
        returns = _centred(batch.returns)
        error = (_centred(valued) - returns).square().mean(dim=(1, 2))
        learn(optimizer, error.sum(), config.critic_rate, update / config.critic_updates)
        if update >= 0.9 * config.critic_updates:
            left += float(error.detach().mean())
            there += float(returns.square().mean())
        on_update()
    return critics, left / max(there, 1e-12)


def _centred(values: Tensor) -> Tensor:
    return values - values.mean(dim=-1, keepdim=True)
