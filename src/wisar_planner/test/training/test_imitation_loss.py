"""A loss by which policies learn wanted turns."""

import pytest
import torch

from wisar_planner.policy.heading import (
    ACTOR_OUTPUTS,
    DISTRIBUTIONS,
    SPACING,
    likeliest_turn,
    wrapped,
)
from wisar_planner.policy.observation import DIRECTIONS
from wisar_planner.training.imitation_loss import imitation_loss


@pytest.mark.parametrize("distribution", DISTRIBUTIONS)
def test_outputs_that_follow_the_loss_turn_as_wanted(distribution, generator):
    wanted = 2.0 * torch.rand(32, generator=generator) - 1.0
    output = torch.randn(ACTOR_OUTPUTS, 32, DIRECTIONS, generator=generator).requires_grad_()
    optimizer = torch.optim.Adam([output], lr=0.05)
    for _ in range(400):
        optimizer.zero_grad()
        imitation_loss(output, distribution, wanted).backward()
        optimizer.step()
    apart = wrapped(likeliest_turn(output.detach(), distribution) - wanted).abs()
    assert float(apart.max()) < 0.1 * SPACING


@pytest.mark.parametrize("distribution", DISTRIBUTIONS)
def test_the_loss_is_least_where_the_policy_turns_as_wanted(distribution):
    output = torch.zeros(ACTOR_OUTPUTS, 1, DIRECTIONS)
    output[0, 0, 3] = 6.0
    turn = likeliest_turn(output, distribution)

    def loss(apart):
        return float(imitation_loss(output, distribution, wrapped(turn + apart)))

    assert all(loss(apart) > loss(0.0) for apart in (-0.02, 0.02, -0.05, 0.05))
    assert all(loss(apart) > loss(0.0) + 1.0 for apart in (-0.1, 0.1, 0.5, 1.0))
