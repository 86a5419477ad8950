"""Flights of other turns than the policy's own, to see which would have been better."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import torch
from torch import Tensor

from wisar_planner.policy.heading import wrapped
from wisar_planner.training.environment import SearchEnvironment
from wisar_planner.training.improvement.config import ImprovementConfig
from wisar_planner.training.networks import (
    Networks,
    Policy,
    mirrored,
    state_value,
)
from wisar_planner.training.worlds import WorldDistribution


class Labels(NamedTuple):
    """What the branches of n states came to.

    Attributes
    ----------
    view, numbers
        See `Observation`; the view in half precision.
    turns : (n, K) float32
        Turns of the branches in units of pi, the policy's own first.
    returns : (n, K) float32
        What each gains, the value of where it leads to included, in steps over the most probable
        ground.
    """

    view: Tensor
    numbers: Tensor
    turns: Tensor
    returns: Tensor

    def sample(self, size: int, generator: torch.Generator) -> Labels:
        """Return random ones, half of them mirrored left to right, the view in full precision."""
        device = generator.device
        some = torch.randint(len(self.turns), (size,), generator=generator, device=device)
        flip = torch.rand(size, generator=generator, device=device) < 0.5
        view, turns = mirrored(self.view[some].float(), self.turns[some], flip)
        return Labels(view, self.numbers[some], turns, self.returns[some])


def fly_branches(
    config: ImprovementConfig,
    policy: Policy,
    value: Networks,
    generator: torch.Generator,
    on_steps: Callable[[int], None],
) -> Labels:
    """Fly branches from states that a policy comes to.

    Parameters
    ----------
    config : ImprovementConfig
        The configuration.
    policy : callable
        The policy; followed after the first turn of each branch.
    value : networks
        What the policy gains after the end of a branch.
    generator : torch.Generator
        Source of randomness.
    on_steps : callable
        Told how many steps were flown.
    """
    searches = max(1, config.environments // config.branches)
    trunk = SearchEnvironment(searches, config.worlds, generator, stagger=True)
    copies = _Copies(searches * config.branches, config.worlds, generator)
    found: list[Labels] = []
    with torch.no_grad():
        while searches * len(found) < config.labels:
            shown = trunk.observe()
            own = policy(shown)
            turns = _branch_turns(own, config, generator)
            copies.branch_off(trunk, config.branches)
            returns = copies.fly(turns.flatten(), policy, value, config.horizon)
            found.append(
                Labels(shown.view.half(), shown.numbers, turns, returns.reshape(turns.shape))
            )
            # Two steps on, where the branches tell something new.
            trunk.step(own)
            trunk.step(policy(trunk.observe()))
            on_steps(len(returns) * config.horizon)
    return Labels(*(torch.cat(each) for each in zip(*found, strict=True)))


def _branch_turns(own: Tensor, config: ImprovementConfig, generator: torch.Generator) -> Tensor:
    """Return the turns of branches, (B, K): the policy's own and others to its left and right."""
    shape = (len(own), config.branches - 1)
    random = torch.rand(2, *shape, generator=generator, device=own.device)
    low, high = config.deviations
    deviation = low * (high / low) ** random[0] * torch.where(random[1] < 0.5, -1.0, 1.0) / 180.0
    return torch.cat([own[:, None], wrapped(own[:, None] + deviation)], dim=1)


class _Copies(SearchEnvironment):
    """Searches that go on from where others are, and do not begin anew when they end."""

    def __init__(
        self, count: int, distribution: WorldDistribution, generator: torch.Generator
    ) -> None:
        self._made = False
        super().__init__(count, distribution, generator)
        self._made = True

    def _begin(self, searches: Tensor) -> None:
        if not self._made:
            super()._begin(searches)

    def branch_off(self, trunk: SearchEnvironment, branches: int) -> None:
        """Become `branches` copies of each search of another environment."""
        for mine, theirs in zip(self.tensors().values(), trunk.tensors().values(), strict=True):
            mine.copy_(theirs.repeat_interleave(branches, dim=0))

    def fly(self, turn: Tensor, policy: Policy, value: Networks, horizon: int) -> Tensor:
        """Return what a first turn and then a policy gain, (B,)."""
        gained = torch.zeros_like(turn)
        searching = torch.ones_like(turn)
        for _ in range(horizon):
            reward, done = self.step(turn)
            gained += searching * reward
            searching = searching * ~done
            # Those that have ended fly on, but nothing counts any more.
            self.steps_left.clamp_(min=1.0)
            shown = self.observe()
            turn = policy(shown)
        return gained + searching * state_value(value, shown)
