"""A new network learns to turn as a policy of another distribution or size does."""

from __future__ import annotations

import torch

from wisar_planner.policy.heading import DIRECTED
from wisar_planner.policy.network import forward
from wisar_planner.policy.observation import Observation
from wisar_planner.training.environment import SearchEnvironment
from wisar_planner.training.imitation_loss import imitation_loss
from wisar_planner.training.networks import Networks, Policy, learn, likeliest_turn, mirrored


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
    loss = imitation_loss(forward(actor, *Observation(view, shown.numbers))[0], DIRECTED, turn)
    learn(optimizer, loss, rate, done)
    with torch.no_grad():
        environment.step(likeliest_turn(actor, DIRECTED, shown))
    return float(loss.detach())
