"""A policy that learns to turn as another does, in the states that it comes to itself."""

from __future__ import annotations

from collections.abc import Callable

import torch
from torch import Tensor

from wisar_planner.policy.network import forward
from wisar_planner.policy.observation import DIRECTIONS, NUMBERS, VIEW_WIDTH, Observation
from wisar_planner.training.environment import SearchEnvironment
from wisar_planner.training.imitation_loss import imitation_loss
from wisar_planner.training.improvement.config import ImprovementConfig
from wisar_planner.training.networks import (
    Networks,
    Policy,
    learn,
    likeliest_turn,
    mirrored,
    optimizer_of,
)


def imitate(
    config: ImprovementConfig,
    actor: Networks,
    distribution: str,
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
    distribution : str
        How its turns are distributed, see `policy.heading`.
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
    states = _States(flights * config.environments, generator.device)
    losses = []
    for update in range(config.imitation_updates):
        while states.count * config.imitation_updates <= update * states.capacity:
            with torch.no_grad():
                shown = environment.observe()
                states.add(shown, teacher(shown))
                environment.step(likeliest_turn(actor, distribution, shown))
            on_steps(config.environments)
        shown, target = states.sample(config.batch, generator)
        loss = imitation_loss(forward(actor, *shown)[0], distribution, target)
        learn(optimizer, loss, config.imitation_rate, update / config.imitation_updates)
        losses.append(loss.detach())
        on_update()
    return float(torch.stack(losses[-max(1, len(losses) // 10) :]).mean())


class _States:
    """What searches showed, and the teacher's turns there."""

    def __init__(self, capacity: int, device: torch.device) -> None:
        self.capacity, self.count = capacity, 0
        shape = (capacity, DIRECTIONS, VIEW_WIDTH)
        self._view = torch.empty(shape, dtype=torch.float16, device=device)
        self._numbers = torch.empty(capacity, NUMBERS, device=device)
        self._turn = torch.empty(capacity, device=device)

    def add(self, shown: Observation, turn: Tensor) -> None:
        """Keep what all searches show."""
        place = slice(self.count, self.count + len(turn))
        self._view[place], self._numbers[place] = shown.view, shown.numbers
        self._turn[place] = turn
        self.count += len(turn)

    def sample(self, size: int, generator: torch.Generator) -> tuple[Observation, Tensor]:
        """Return random states and their turns, half of them mirrored left to right."""
        device = generator.device
        some = torch.randint(self.count, (size,), generator=generator, device=device)
        flip = torch.rand(size, generator=generator, device=device) < 0.5
        view, turn = mirrored(self._view[some].float(), self._turn[some], flip)
        return Observation(view, self._numbers[some]), turn
