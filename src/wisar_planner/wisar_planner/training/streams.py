"""Which random numbers belong to training, and which to validation.

PyTorch's CPU generator keeps the low 32 bits of its seed only. So seeds of trainings stay below
2^31 and validation has one above: no training can draw the maps that policies are judged on. Fresh
maps, which chose nothing, have another. The final evaluation draws its maps with NumPy, from
streams of its own (`evaluation.streams`).
"""

from __future__ import annotations

import torch

from wisar_planner.errors import InvalidInput

_SEEDS = 2**31
_VALIDATION_SEED = 2**31 + 1
_FRESH_SEED = 2**31 + 2


def check_seed(seed: int) -> None:
    """Raise InvalidInput where a training cannot have that seed."""
    if not 0 <= seed < _SEEDS:
        raise InvalidInput(f"seed must be at least 0 and below {_SEEDS}, not {seed}")


def training_generator(seed: int, device: torch.device) -> torch.Generator:
    """Return the generator of a training."""
    check_seed(seed)
    return torch.Generator(device=device).manual_seed(seed)


def validation_generator(device: torch.device) -> torch.Generator:
    """Return a generator that gives the same validation maps each time."""
    return torch.Generator(device=device).manual_seed(_VALIDATION_SEED)


def fresh_generator(device: torch.device) -> torch.Generator:
    """Return a generator that gives maps that neither training nor validation meets."""
    return torch.Generator(device=device).manual_seed(_FRESH_SEED)
