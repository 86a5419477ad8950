"""What searches gain from a state on, estimated from their next steps."""

from __future__ import annotations

import torch
from torch import Tensor


def trace_returns(rewards: Tensor, dones: Tensor, values: Tensor, trace: float) -> Tensor:
    """Return the returns of TD(lambda) without discount, (T, B).

    Sutton and Barto (2018), "Reinforcement Learning", equation 12.18 in its recursive form.

    Parameters
    ----------
    rewards, dones : (T, B)
        Rewards of the steps, and which steps ended a search.
    values : (T + 1, B)
        Values of the states before the steps and after the last.
    trace : float
        Lambda.
    """
    returns = torch.empty_like(rewards)
    following = values[-1]
    for t in reversed(range(len(rewards))):
        mixed = (1.0 - trace) * values[t + 1] + trace * following
        following = rewards[t] + torch.where(dones[t], 0.0, mixed)
        returns[t] = following
    return returns
