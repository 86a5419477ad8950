"""How far a policy's turns are from wanted ones, as a loss to learn them by."""

from __future__ import annotations

import torch
from torch import Tensor

from wisar_planner.policy.heading import (
    GAUSSIAN,
    SPACING,
    directions_and_offsets,
    likeliest_turn,
    wrapped,
)
from wisar_planner.policy.observation import DIRECTIONS

# Up to this deviation a Gaussian's turn is mended as a square error, degrees; beyond it the error
# grows as a logarithm: where two ways are about as good, the policy need not choose the other.
_TOLERANCE = 4.0
# Directions within this many of the wanted turn share its likelihood (standard deviation), and
# those that are nearer than one have an offset that leads to it.
_BLUR = 0.4
_OFFSET_WEIGHT = 5.0


def imitation_loss(output: Tensor, distribution: str, wanted: Tensor) -> Tensor:
    """Return the mean loss of a policy that should turn as wanted.

    Parameters
    ----------
    output : (ACTOR_OUTPUTS, B, DIRECTIONS)
        What the actor's network returned.
    distribution : str
        How its turns are distributed, see `policy.heading`.
    wanted : (B,)
        Turns in units of pi.
    """
    if distribution == GAUSSIAN:
        apart = wrapped(likeliest_turn(output, GAUSSIAN) - wanted) * (180.0 / _TOLERANCE)
        return torch.log1p(apart.square()).mean()
    logits, offsets = directions_and_offsets(output)
    directions = SPACING * torch.arange(DIRECTIONS, device=wanted.device)
    apart = wrapped(wanted[:, None] - directions) / SPACING
    likelihood = torch.softmax(-0.5 * (apart / _BLUR).square(), dim=-1)
    surprise = -(likelihood * torch.log_softmax(logits, dim=-1)).sum(dim=-1)
    missed = ((apart.abs() < 1.0) * (offsets / SPACING - apart).abs()).sum(dim=-1)
    return (surprise + _OFFSET_WEIGHT * missed).mean()
