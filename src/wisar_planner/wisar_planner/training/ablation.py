"""Variants of the policy that lack one of its parts, to measure what each part is worth.

They train by the same command (`ablation: NAME` in the configuration) and are validated like the
policy itself; they cannot be shipped.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor

from wisar_planner.errors import InvalidInput
from wisar_planner.policy import network
from wisar_planner.policy.network import Parameters
from wisar_planner.policy.observation import (
    COARSE_FROM,
    DIRECTIONS,
    DISTANCES,
    MIDDLE_FROM,
    NUMBERS,
    VIEW_WIDTH,
    Observation,
)
from wisar_planner.training.environment import SearchEnvironment
from wisar_planner.training.networks import Networks, make_networks
from wisar_planner.training.worlds import WorldDistribution

_WIDTH = 256


class Network(NamedTuple):
    """How to make networks, as `networks.make_networks`, and how to use them."""

    make: Callable[..., Networks]
    forward: Callable[[Parameters, Tensor, Tensor], Tensor]


def make_network(ablation: str) -> Network:
    """Return the network of an ablation: the ring network, but for `mlp`."""
    if ablation == "mlp":
        return Network(_make_mlps, _mlp)
    return Network(make_networks, network.forward)


def make_environment(
    ablation: str,
    count: int,
    distribution: WorldDistribution,
    generator: torch.Generator,
    *,
    stagger: bool = False,
) -> SearchEnvironment:
    """Return the environment of an ablation; see `SearchEnvironment`."""
    if ablation == "absolute_heading":
        return _AbsoluteHeading(count, distribution, generator, stagger=stagger)
    if ablation in _HIDDEN:
        return _Blinkered(count, distribution, generator, stagger=stagger, hidden=_HIDDEN[ablation])
    return SearchEnvironment(count, distribution, generator, stagger=stagger)


class _Blinkered(SearchEnvironment):
    """The environment with columns of the view blanked."""

    def __init__(
        self,
        count: int,
        distribution: WorldDistribution,
        generator: torch.Generator,
        *,
        stagger: bool,
        hidden: npt.NDArray[np.bool_],
    ) -> None:
        super().__init__(count, distribution, generator, stagger=stagger)
        self._shown = torch.tensor(~hidden, device=generator.device).float()

    def observe(self) -> Observation:
        """Return what the searches show, less what is hidden."""
        shown = super().observe()
        return Observation(shown.view * self._shown, shown.numbers)


class _AbsoluteHeading(SearchEnvironment):
    """The environment with the view and the action counted from east, as in the paper.

    The last heading is no longer in the observation but by what has been seen.
    """

    def observe(self) -> Observation:
        """Return what the searches show, the first direction due east."""
        self.heading = torch.zeros_like(self.heading)
        return super().observe()

    def step(self, action: Tensor) -> tuple[Tensor, Tensor]:
        """Fly one step in the direction of `action` times pi from east."""
        self.heading = torch.zeros_like(self.heading)
        return super().step(action)


_GAIN = np.arange(VIEW_WIDTH) == len(DISTANCES)
_DISTANCE = np.append(DISTANCES, math.nan)
_HIDDEN: dict[str, npt.NDArray[np.bool_]] = {
    "no_fine_scale": _DISTANCE < MIDDLE_FROM,
    "no_middle_scale": (_DISTANCE >= MIDDLE_FROM) & (_DISTANCE < COARSE_FROM),
    "no_coarse_scale": _DISTANCE >= COARSE_FROM,
    "no_step_gain": _GAIN,
}

#: Names of the ablations; "" is the policy itself.
ABLATIONS = ("", "mlp", "absolute_heading", *_HIDDEN)


def check_ablation(name: str) -> None:
    """Raise InvalidInput where no ablation has that name."""
    if name not in ABLATIONS:
        raise InvalidInput(f"ablation must be one of {', '.join(ABLATIONS[1:])}, not {name!r}")


def _make_mlps(
    rng: np.random.Generator,
    *,
    networks: int,
    channels: int,
    blocks: int,
    device: torch.device,
    outputs: int = 1,
) -> Networks:
    """Return random perceptrons with two hidden layers, as the paper's kind, side by side."""
    widths = [DIRECTIONS * VIEW_WIDTH + NUMBERS, _WIDTH, _WIDTH, outputs * DIRECTIONS]
    parameters = {}
    for i, (fan_in, fan_out) in enumerate(itertools.pairwise(widths)):
        scale = math.sqrt(2.0 / fan_in) * (0.1 if i == 2 else 1.0)
        weights = scale * rng.standard_normal((networks, fan_in, fan_out))
        parameters[f"weights{i}"] = torch.tensor(weights, dtype=torch.float32)
        parameters[f"bias{i}"] = torch.zeros(networks, 1, fan_out)
    return {k: each.to(device).requires_grad_() for k, each in parameters.items()}


def _mlp(parameters: Parameters, view: Tensor, numbers: Tensor) -> Tensor:
    """Return the outputs, (networks, outputs, B, DIRECTIONS)."""
    hidden = torch.cat([view.flatten(1), numbers], dim=1)[None]
    for i in range(3):
        hidden = hidden @ parameters[f"weights{i}"] + parameters[f"bias{i}"]
        hidden = torch.relu(hidden) if i < 2 else hidden
    networks, batch = hidden.shape[:2]
    return hidden.reshape(networks, batch, -1, DIRECTIONS).permute(0, 2, 1, 3)
