"""A new network learns to turn as a policy of another distribution or size does."""

from __future__ import annotations

import torch
from torch import Tensor

from wisar_planner.policy.heading import (
    DIRECTED,
    SPACING,
    directions_and_offsets,
    likeliest_turn,
    wrapped,
)
from wisar_planner.policy.network import forward
from wisar_planner.policy.observation import DIRECTIONS, Observation
from wisar_planner.training.environment import SearchEnvironment
from wisar_planner.training.improvement.networks import Networks, Policy, learn, mirrored

# Directions within this many of the wanted turn share its likelihood (standard deviation), and
# those that are nearer than one have an offset that leads to it.
_BLUR = 0.4
_OFFSET_WEIGHT = 5.0


def imitate_step(
    environment: SearchEnvironment,
    actor: Networks,
    teacher: Policy,
    optimizer: torch.optim.Optimizer,
    rate: float,
    done: float,
) -> float:
    """Learn a teacher's turns where the searches are, and fly them on by a step (DAgger).

    Parameters
    ----------
    environment : SearchEnvironment
        The searches.
    actor : networks
        Learns in place.
    teacher : callable
        The policy to imitate.
    optimizer : torch.optim.Optimizer
        Of the actor.
    rate, done : float
        See `learn`.

    Returns
    -------
    float
        The loss.
    """
    generator = environment.generator
    with torch.no_grad():
        shown = environment.observe()
        wanted = teacher(shown)
    flip = torch.rand(len(wanted), generator=generator, device=wanted.device) < 0.5
    view, turn = mirrored(shown.view, wanted, flip)
    loss = _loss(forward(actor, *Observation(view, shown.numbers))[0], turn)
    learn(optimizer, loss, rate, done)
    with torch.no_grad():
        environment.step(likeliest_turn(forward(actor, *shown)[0], DIRECTED))
    return float(loss.detach())


def _loss(output: Tensor, wanted: Tensor) -> Tensor:
    logits, offsets = directions_and_offsets(output)
    directions = SPACING * torch.arange(DIRECTIONS, device=wanted.device)
    apart = wrapped(wanted[:, None] - directions) / SPACING
    likelihood = torch.softmax(-0.5 * (apart / _BLUR).square(), dim=-1)
    surprise = -(likelihood * torch.log_softmax(logits, dim=-1)).sum(dim=-1)
    missed = ((apart.abs() < 1.0) * (offsets / SPACING - apart).abs()).sum(dim=-1)
    return (surprise + _OFFSET_WEIGHT * missed).mean()
