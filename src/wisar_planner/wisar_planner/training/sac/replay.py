"""Replay memory of many searches, in the order they were flown."""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

from wisar_planner.policy.observation import DIRECTIONS, NUMBERS, VIEW_WIDTH, Observation
from wisar_planner.training.networks import mirrored


class Batch(NamedTuple):
    """Transitions over n steps.

    Attributes
    ----------
    now, later : Observation
        Before the first and after the last step.
    action : (B,) float32
        Turn of the first step.
    reward : (B,) float32
        Discounted sum of the rewards until the search ended or n steps were flown.
    discount : (B,) float32
        What the value after the last step counts; 0 where the search ended.
    """

    now: Observation
    action: Tensor
    reward: Tensor
    later: Observation
    discount: Tensor


class Replay:
    """A ring of the last steps of all searches; transitions over n steps are made when sampled.

    Parameters
    ----------
    capacity : int
        Steps kept, of all searches together.
    searches : int
        Searches side by side.
    n_step : int
        Steps per transition.
    gamma : float
        Discount per step.
    device : torch.device
        Where to keep it.
    """

    def __init__(
        self, capacity: int, searches: int, n_step: int, gamma: float, device: torch.device
    ) -> None:
        self._rows = capacity // searches
        self._searches, self._n_step, self._gamma = searches, n_step, gamma
        shape = (self._rows, searches)
        self._view = torch.zeros(*shape, DIRECTIONS, VIEW_WIDTH, dtype=torch.float16, device=device)
        self._numbers = torch.zeros(*shape, NUMBERS, device=device)
        self._action = torch.zeros(shape, device=device)
        self._reward = torch.zeros(shape, device=device)
        self._done = torch.zeros(shape, dtype=torch.bool, device=device)
        #: Steps of each search that were added, with those that are forgotten.
        self.added = 0

    def tensors(self) -> dict[str, Tensor]:
        """Return its memory by name, for checkpoints."""
        return {
            "view": self._view,
            "numbers": self._numbers,
            "action": self._action,
            "reward": self._reward,
            "done": self._done,
        }

    def __len__(self) -> int:
        return min(self.added, self._rows) * self._searches

    def add(self, now: Observation, action: Tensor, reward: Tensor, done: Tensor) -> None:
        """Add one step of every search."""
        row = self.added % self._rows
        self._view[row] = now.view
        self._numbers[row] = now.numbers
        self._action[row], self._reward[row], self._done[row] = action, reward, done
        self.added += 1

    def sample(self, size: int, generator: torch.Generator) -> Batch:
        """Return random transitions, half of them mirrored left to right."""
        device = self._action.device
        kept = min(self.added, self._rows)
        age = torch.randint(self._n_step, kept, (size,), generator=generator, device=device)
        first = (self.added - 1 - age) % self._rows
        search = torch.randint(self._searches, (size,), generator=generator, device=device)
        reward = torch.zeros(size, device=device)
        discount = torch.ones(size, device=device)
        for i in range(self._n_step):
            row = (first + i) % self._rows
            reward += discount * self._reward[row, search]
            discount = discount * self._gamma * ~self._done[row, search]
        flip = torch.rand(size, generator=generator, device=device) < 0.5
        last = (first + self._n_step) % self._rows
        now, action = self._mirrored(first, search, flip)
        later, _ = self._mirrored(last, search, flip)
        return Batch(now, action, reward, later, discount)

    def _mirrored(self, row: Tensor, search: Tensor, flip: Tensor) -> tuple[Observation, Tensor]:
        """Return what searches showed and their actions then, some of them mirrored."""
        view, action = mirrored(self._view[row, search], self._action[row, search], flip)
        return Observation(view.float(), self._numbers[row, search]), action
