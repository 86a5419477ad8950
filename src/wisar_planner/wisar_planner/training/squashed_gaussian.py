"""The policy's distribution: a Gaussian squashed by tanh to -1 to 1."""

from __future__ import annotations

import math

import torch
from torch import Tensor


def sample(
    mean: Tensor, log_std: Tensor, shape: torch.Size, generator: torch.Generator
) -> tuple[Tensor, Tensor]:
    """Return random values and the logarithms of their probability densities.

    Haarnoja et al. (2018), appendix C.

    Parameters
    ----------
    mean, log_std : Tensor
        Mean and logarithm of the standard deviation before the squashing.
    shape : torch.Size
        Shape of the result, to which the two are broadcast.
    generator : torch.Generator
        Source of randomness.
    """
    noise = torch.randn(shape, generator=generator, device=mean.device)
    raw = mean + log_std.exp() * noise
    # log(1 - tanh^2), in a form that does not round to log(0).
    squash = 2.0 * (math.log(2.0) - raw - torch.nn.functional.softplus(-2.0 * raw))
    log_normal = -0.5 * noise.square() - log_std - 0.5 * math.log(2.0 * math.pi)
    return torch.tanh(raw), log_normal - squash
