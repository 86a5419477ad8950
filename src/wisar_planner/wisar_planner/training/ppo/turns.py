"""Random turns of a policy that chooses among directions, and how likely they were."""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

from wisar_planner.policy.heading import SPACING, directions_and_offsets, wrapped
from wisar_planner.training.divergence import check_finite


class Turns(NamedTuple):
    """Turns of n searches: a direction each, and a deviation from it.

    Attributes
    ----------
    direction : (n,) int64
        The directions' numbers.
    deviation : (n,) float32
        Deviations in units of pi.
    """

    direction: Tensor
    deviation: Tensor

    def turn(self) -> Tensor:
        """Return the turns, (n,), in units of pi."""
        result: Tensor = wrapped(SPACING * self.direction + self.deviation)
        return result


def random_turns(output: Tensor, noise: float, generator: torch.Generator) -> Turns:
    """Return a draw for each search.

    Parameters
    ----------
    output : (ACTOR_OUTPUTS, n, DIRECTIONS)
        What the actor's network returned.
    noise : float
        Standard deviation around the policy's turn in the direction, in units of pi.
    generator : torch.Generator
        Source of randomness.

    Raises
    ------
    Diverged
        When the output is not finite.
    """
    check_finite("outputs of the policy", output)
    logits, offsets = directions_and_offsets(output)
    direction = torch.multinomial(torch.softmax(logits, dim=-1), 1, generator=generator)
    offset = offsets.gather(1, direction)[:, 0]
    deviation = offset + noise * torch.randn(
        offset.shape, generator=generator, device=offset.device
    )
    return Turns(direction[:, 0], deviation)


def log_likelihood(output: Tensor, turns: Turns, noise: float) -> tuple[Tensor, Tensor]:
    """Return the logarithm of the turns' likelihood but for a constant, and the entropy, (n,).

    The entropy is that of the directions. Parameters as in `random_turns`.
    """
    logits, offsets = directions_and_offsets(output)
    logarithms = torch.log_softmax(logits, dim=-1)
    direction = turns.direction[:, None]
    apart = (turns.deviation - offsets.gather(1, direction)[:, 0]) / noise
    likelihood = logarithms.gather(1, direction)[:, 0] - 0.5 * apart.square()
    return likelihood, -(logarithms.exp() * logarithms).sum(dim=-1)
