"""A policy that learns to turn as another does, in the states that it comes to itself."""

from __future__ import annotations

from collections.abc import Callable

import torch
from torch import Tensor

from wisar_planner.policy.heading import actor_distribution
from wisar_planner.policy.network import forward
from wisar_planner.training.environment import SearchEnvironment
from wisar_planner.training.improvement.config import ImprovementConfig
from wisar_planner.training.improvement.networks import (
    Networks,
    Policy,
    learn,
    likeliest_turn,
    mirrored,
    optimizer_of,
    wrapped,
)


def imitate(
    config: ImprovementConfig,
    actor: Networks,
    teacher: Policy,
    generator: torch.Generator,
    on_steps: Callable[[int], None],
    on_update: Callable[[], None],
) -> float:
    """Let an actor learn a teacher's turns (DAgger: the actor flies, the teacher says better).

    Parameters
    ----------
    config : ImprovementConfig
        The configuration.
    actor : networks
        Learns in place.
    teacher : callable
        The policy to imitate.
    generator : torch.Generator
        Source of randomness.
    on_steps, on_update : callable
        Told how many steps were flown, and of each update.

    Returns
    -------
    float
        Mean loss of the last tenth of the updates.
    """
    environment = SearchEnvironment(config.environments, config.worlds, generator, stagger=True)
    optimizer = optimizer_of(actor, config.imitation_rate)
    flights = max(1, config.imitated_steps // config.environments)
    states: list[tuple[Tensor, Tensor, Tensor]] = []
    losses = []
    for update in range(config.imitation_updates):
        while len(states) * config.imitation_updates <= update * flights:
            with torch.no_grad():
                shown = environment.observe()
                states.append((shown.view.half(), shown.numbers, teacher(shown)))
                environment.step(likeliest_turn(actor, shown))
            on_steps(config.environments)
        view, numbers, target = _batch(states, config.batch, generator)
        turn = torch.tanh(actor_distribution(forward(actor, view, numbers)[0])[0])
        deviation = wrapped(turn - target) * (180.0 / config.tolerance)
        loss = torch.log1p(deviation.square()).mean()
        learn(optimizer, loss, config.imitation_rate, update / config.imitation_updates)
        losses.append(loss.detach())
        on_update()
    return float(torch.stack(losses[-max(1, len(losses) // 10) :]).mean())


def _batch(
    states: list[tuple[Tensor, Tensor, Tensor]], size: int, generator: torch.Generator
) -> tuple[Tensor, Tensor, Tensor]:
    """Return random states and their turns, half of them mirrored left to right."""
    device = generator.device
    searches = len(states[0][2])
    place = torch.randint(len(states) * searches, (size,), generator=generator, device=device)
    flip = torch.rand(size, generator=generator, device=device) < 0.5
    pairs = [divmod(each, searches) for each in place.tolist()]
    view, numbers, target = (torch.stack([states[i][k][j] for i, j in pairs]) for k in range(3))
    view, target = mirrored(view.float(), target, flip)
    return view, numbers, target
